//! The examples in tests/vectors, byte for byte.

use super::{Act, PERIOD, responses, unhex};
use super::{
    Bench, Board, BoardSpec, CONTINUE, Driver, KitFrame, NAME, SERVICES, data, des_request,
};
use serde_json::Value;

fn vectors(text: &str) -> Vec<Value> {
    serde_json::from_str(text).unwrap()
}

fn list(value: &Value) -> Vec<Vec<u8>> {
    value.as_array().unwrap().iter().map(|it| unhex(it.as_str().unwrap())).collect()
}

/// Sends a request, permits a long response, and returns the frames.
fn exchange(spec: &BoardSpec, request: &KitFrame) -> Vec<KitFrame> {
    let mut board = Board::running(spec);
    let mut frames = board.exchange(request);
    if matches!(frames[0].data[..], [0x10..=0x1F, ..]) {
        board.receive(&KitFrame { data: CONTINUE.to_vec(), ..request.clone() });
        frames.extend(responses(&board.pass(PERIOD)));
    }
    frames
}

#[test]
fn kit_name_responses_match_the_vectors() {
    for vector in vectors(include_str!("../../vectors/names.json")) {
        let mut spec = BoardSpec::new(12);
        spec.name = unhex(vector["name"].as_str().unwrap());
        let frames = exchange(&spec, &des_request(NAME));
        assert_eq!(data(&frames), list(&vector["isotp"]), "{vector}");
        assert!(frames.iter().all(|frame| frame.id == 0x0518_0002));
        let raw = exchange(&spec, &des_request(b"DES\x01"));
        match vector["raw"].as_str() {
            Some(text) => assert_eq!(data(&raw), [unhex(text)]),
            None => assert_eq!(raw, [KitFrame::classic(0x0418_0002, &[])], "refused: {vector}"),
        }
    }
}

#[test]
fn kit_services_responses_match_the_vectors() {
    let mut count = 0;
    for vector in vectors(include_str!("../../vectors/services.json")) {
        if !vector["finding"].is_null() {
            continue;
        }
        let mut spec = BoardSpec::new(12);
        spec.services = unhex(vector["payload"].as_str().unwrap())[1..].to_vec();
        for (key, fd) in [("isotp", false), ("isotp_fd", true)] {
            if vector.get(key).is_some() {
                let request = KitFrame { fd, ..des_request(SERVICES) };
                let frames = exchange(&spec, &request);
                assert_eq!(data(&frames), list(&vector[key]), "{key}: {vector}");
                assert!(frames.iter().all(|frame| frame.fd == fd));
                count += 1;
            }
        }
    }
    assert!(count > 20, "{count} vectors");
}

#[test]
fn kit_identifier_fields_match_the_vectors() {
    let mut driver = Driver::start();
    for vector in vectors(include_str!("../../vectors/identifiers.json")) {
        let field = |name: &str| vector["fields"][name].as_u64().unwrap();
        let kind = vector["type"].as_str().unwrap();
        let is_conforming = match kind {
            "NONCONFORMING" => false,
            "DEBUG" => field("dst") == 127,
            _ => true,
        };
        let expected = format!(
            "{} {} {} {}",
            field("src"),
            field("dst"),
            field("srv"),
            u8::from(is_conforming)
        );
        let acts = driver.run(&format!("id {}", vector["id"].as_str().unwrap()));
        assert_eq!(acts, [Act::Other(expected)], "{vector}");
    }
}
