//! The exact examples of `tests/vectors`: every byte of identifiers, names, services responses,
//! UIDs and framings.

use descan::time::Instant;
use descan::wire::des::{self, ServicesResponse};
use descan::wire::framing::{Framing, classify_response};
use descan::wire::id::Header;
use descan::wire::isotp::{
    FlowControl, FlowStatus, Pci, Reassembly, ReassemblyProgress, Segmenter,
};
use descan::wire::node::Uid;
use descan::wire::profile::UidProfile;
use serde_json::Value;

fn vectors(text: &str) -> Vec<Value> {
    let all: Vec<Value> = serde_json::from_str(text).expect("vectors are JSON arrays");
    assert!(!all.is_empty());
    all
}

fn bytes(value: &Value) -> Vec<u8> {
    let text = value.as_str().expect("a string of hex digits");
    (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap())
        .collect()
}

fn strings(value: &Value) -> Vec<Vec<u8>> {
    value.as_array().expect("a list").iter().map(bytes).collect()
}

/// Sends `message` to a receiver that permits all frames at once.
fn sent(message: &[u8], fd: bool) -> Vec<Vec<u8>> {
    let mut sender = Segmenter::new(message.to_vec(), fd);
    let mut frames = Vec::new();
    while !sender.is_done() {
        if let Some(segment) = sender.poll(Instant::ZERO) {
            let padding = if fd { 0xCC } else { 0 };
            frames.push(segment.into_frame(0, fd, padding).data().to_vec());
        } else {
            let go = FlowControl { status: FlowStatus::Continue, block_size: 0, st_min: 0 };
            sender.handle_flow(Instant::ZERO, go).unwrap();
        }
    }
    frames
}

/// Reassembles the message carried by `frames`.
fn received(frames: &[Vec<u8>], fd: bool) -> Vec<u8> {
    let mut transfer: Option<Reassembly<Vec<u8>>> = None;
    for data in frames {
        match Pci::decode(data, fd).expect("a frame of ISO 15765-2") {
            Pci::Single(message) => return message.to_vec(),
            Pci::First { length, data: first } => {
                let (now, buffer) = (Instant::ZERO, vec![0; des::MAX_MESSAGE]);
                transfer =
                    Some(Reassembly::start(now, length, first, data.len(), 0, buffer).unwrap());
            }
            Pci::Consecutive { sequence, data } => {
                let transfer = transfer.as_mut().expect("a first frame came before");
                if transfer.push(Instant::ZERO, sequence, data).unwrap() == ReassemblyProgress::Done
                {
                    return transfer.message().to_vec();
                }
            }
            Pci::Flow(_) => panic!("nobody sends flow control here"),
        }
    }
    panic!("the message never ended")
}

#[test]
fn identifiers_match_the_vectors() {
    for vector in vectors(include_str!("../vectors/identifiers.json")) {
        let id = u32::from_str_radix(vector["id"].as_str().unwrap(), 16).unwrap();
        let header = Header::decode(id);
        let bit = |name: &str| vector["fields"][name] == 1;
        let number = |name: &str| vector["fields"][name].as_u64().unwrap();
        assert_eq!(header.from_non_working, bit("u"), "{vector}");
        assert_eq!(header.to_non_working, bit("d"), "{vector}");
        assert_eq!(header.response, bit("r"), "{vector}");
        assert_eq!(header.broadcast, bit("b"), "{vector}");
        assert_eq!(header.no_error, bit("err"), "{vector}");
        assert_eq!(u64::from(header.source.number()), number("src"), "{vector}");
        assert_eq!(u64::from(header.destination.number()), number("dst"), "{vector}");
        assert_eq!(u64::from(header.service.number()), number("srv"), "{vector}");
        assert_eq!(header.message_type().name(), vector["type"].as_str().unwrap(), "{vector}");
        assert_eq!(header.encode(), id, "{vector}");
    }
}

#[test]
fn names_match_the_vectors() {
    for vector in vectors(include_str!("../vectors/names.json")) {
        let (name, message) = (bytes(&vector["name"]), bytes(&vector["payload"]));
        assert_eq!(des::encode_name(&name).collect::<Vec<_>>(), message, "{vector}");
        assert_eq!(des::decode_name(&message), (Some(&name[..]), None), "{vector}");
        let frames = strings(&vector["isotp"]);
        assert_eq!(sent(&message, false), frames, "{vector}");
        assert_eq!(received(&frames, false), message, "{vector}");
        let raw = (message.len() <= 8).then_some(message);
        assert_eq!(vector["raw"].as_str().map(|_| bytes(&vector["raw"])), raw, "{vector}");
    }
}

#[test]
fn services_match_the_vectors() {
    for vector in vectors(include_str!("../vectors/services.json")) {
        let message = bytes(&vector["payload"]);
        let answer = ServicesResponse::decode(&message);
        let read: Vec<Vec<Vec<u8>>> =
            answer.services().map(|s| s.strings().map(<[u8]>::to_vec).collect()).collect();
        let expected: Vec<Vec<Vec<u8>>> =
            vector["services"].as_array().unwrap().iter().map(strings).collect();
        assert_eq!(read, expected, "{vector}");
        let indices: Vec<usize> = answer.services().map(|s| s.index.into()).collect();
        assert_eq!(indices, (0..expected.len()).collect::<Vec<_>>(), "{vector}");
        let fault = answer.fault().map(|fault| fault.to_string());
        assert_eq!(fault.as_deref(), vector["finding"].as_str(), "{vector}");
        if fault.is_none() {
            assert_eq!(des::encode_services(&expected).collect::<Vec<_>>(), message, "{vector}");
        }
        for (key, fd) in [("isotp", false), ("isotp_fd", true)] {
            if vector.get(key).is_some() {
                let frames = strings(&vector[key]);
                assert_eq!(sent(&message, fd), frames, "{key} of {vector}");
                assert_eq!(received(&frames, fd), message, "{key} of {vector}");
            }
        }
    }
}

#[test]
fn uids_match_the_vectors() {
    let alphabet = UidProfile::default();
    for vector in vectors(include_str!("../vectors/uids.json")) {
        let raw: [u8; 6] = bytes(&vector["bytes"]).try_into().unwrap();
        let text = vector["text"].as_str().unwrap();
        assert_eq!(Uid(raw).text(&alphabet).to_string(), text, "{vector}");
        assert_eq!(Uid::parse(text, &alphabet), Some(Uid(raw)), "{vector}");
    }
    assert_eq!(Uid([0xFF; 6]).text(&alphabet).to_string(), "", "a blank UID has no text");
}

#[test]
fn framings_match_the_vectors() {
    for vector in vectors(include_str!("../vectors/framing.json")) {
        let expected = match vector["framing"].as_str().unwrap() {
            "isotp" => Some(Framing::Isotp),
            "raw" => Some(Framing::Raw),
            "none" => None,
            other => panic!("{other}?"),
        };
        let data = bytes(&vector["data"]);
        assert_eq!(classify_response(&data, data.len() > 8, false), expected, "{vector}");
    }
}
