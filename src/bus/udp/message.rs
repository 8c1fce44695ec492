//! Datagrams of python-can's `udp_multicast` bus: a msgpack map for each frame.
//!
//! python-can's reader fails on a missing field, so every field is written, in python-can's order.
//! A datagram that is not a valid frame is rejected. Pure.

use crate::frame::{CanId, Frame, FrameKind};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize, Serializer};

/// Largest datagram, in bytes; larger ones are not frames.
pub(super) const MAX_DATAGRAM: usize = 2_048;

#[derive(Serialize)]
struct Outgoing<'m> {
    timestamp: f64,
    arbitration_id: u32,
    is_extended_id: bool,
    is_remote_frame: bool,
    is_error_frame: bool,
    channel: Option<()>,
    dlc: usize,
    #[serde(serialize_with = "as_bytes")]
    data: &'m [u8],
    is_fd: bool,
    bitrate_switch: bool,
    error_state_indicator: bool,
}

fn as_bytes<S: Serializer>(data: &&[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(data)
}

#[derive(Deserialize)]
struct Incoming<'m> {
    arbitration_id: u32,
    is_extended_id: bool,
    #[serde(default)]
    is_remote_frame: bool,
    #[serde(default)]
    is_error_frame: bool,
    /// Name of the bus at the sender.
    #[serde(default, rename = "channel")]
    _channel: Option<IgnoredAny>,
    dlc: u64,
    #[serde(borrow)]
    data: &'m [u8],
    #[serde(default)]
    is_fd: bool,
    #[serde(default)]
    bitrate_switch: bool,
    #[serde(default)]
    error_state_indicator: bool,
}

/// Encodes a frame with its time in Unix seconds; `None` for a frame that cannot exist.
pub fn encode(frame: &Frame, unix_seconds: f64) -> Option<Vec<u8>> {
    let (arbitration_id, is_extended_id) = match frame.id {
        CanId::Standard(id) => (u32::from(id), false),
        CanId::Extended(id) => (id, true),
    };
    let is_remote_frame = frame.kind == FrameKind::Remote;
    let outgoing = Outgoing {
        timestamp: unix_seconds,
        arbitration_id,
        is_extended_id,
        is_remote_frame,
        is_error_frame: frame.kind == FrameKind::Error,
        channel: None,
        dlc: frame.len(),
        data: frame.data(),
        is_fd: frame.is_fd,
        bitrate_switch: frame.is_fd && frame.bit_rate_switch,
        error_state_indicator: frame.is_fd && frame.error_state,
    };
    // python-can rejects more data than a frame can have.
    let most = if frame.is_fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA };
    let is_whole = frame.len() <= most && (!frame.is_fd || frame.kind == FrameKind::Data);
    is_whole.then(|| rmp_serde::to_vec_named(&outgoing).ok()).flatten()
}

/// Decodes a datagram; `None` if it is malformed.
pub fn decode(datagram: &[u8]) -> Option<Frame> {
    let incoming: Incoming = rmp_serde::from_slice(datagram).ok()?;
    if incoming.is_error_frame && incoming.arbitration_id <= CanId::MAX_EXTENDED {
        let fits = incoming.data.len() <= Frame::MAX_CLASSIC_DATA && !incoming.is_remote_frame;
        return fits.then(|| Frame::error(incoming.arbitration_id, incoming.data));
    }
    let id = if incoming.is_extended_id {
        CanId::extended(incoming.arbitration_id)?
    } else {
        CanId::standard(incoming.arbitration_id)?
    };
    let len = usize::try_from(incoming.dlc).ok()?;
    if incoming.is_remote_frame {
        let fits = len <= Frame::MAX_CLASSIC_DATA && !incoming.is_fd;
        return fits.then(|| Frame::remote(id, len));
    }
    let most = if incoming.is_fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA };
    if len != incoming.data.len() || len > most {
        return None;
    }
    if !incoming.is_fd {
        return Some(Frame::new(id, incoming.data));
    }
    let mut frame = Frame::fd(0, incoming.data, 0);
    frame.id = id;
    frame.bit_rate_switch = incoming.bitrate_switch;
    frame.error_state = incoming.error_state_indicator;
    Some(frame)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Sent by python-can 4.6 for `Message(arbitration_id=0x123, is_extended_id=False,
    /// data=[1, 2], timestamp=1.5)`.
    const OF_PYTHON: &[u8] = b"\x8b\xa9timestamp\xcb\x3f\xf8\0\0\0\0\0\0\xaearbitration_id\
        \xcd\x01\x23\xaeis_extended_id\xc2\xafis_remote_frame\xc2\xaeis_error_frame\xc2\
        \xa7channel\xc0\xa3dlc\x02\xa4data\xc4\x02\x01\x02\xa5is_fd\xc2\xaebitrate_switch\xc2\
        \xb5error_state_indicator\xc2";

    #[test]
    fn encoding_equals_that_of_python_can() {
        let frame = Frame::new(CanId::Standard(0x123), &[1, 2]);
        assert_eq!(encode(&frame, 1.5).as_deref(), Some(OF_PYTHON));
        assert_eq!(decode(OF_PYTHON), Some(frame));
    }

    #[test]
    fn every_kind_of_frame_comes_back() {
        let mut fd = Frame::fd(0x1ABC_DEF0, &[7; 33], 0);
        fd.error_state = true;
        for frame in [
            Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1]),
            Frame::remote(CanId::Standard(0x123), 4),
            Frame::remote(CanId::Extended(0x123), 0),
            Frame::error(0x24, &[0, 1, 2, 3, 4, 5, 6, 7]),
            fd,
        ] {
            assert_eq!(decode(&encode(&frame, 5.0).unwrap()), Some(frame));
        }
    }

    #[test]
    fn impossible_message_is_not_a_frame() {
        let changed = |from: &[u8], to: &[u8]| {
            let at = OF_PYTHON.windows(from.len()).position(|it| it == from).unwrap();
            let mut datagram = OF_PYTHON.to_vec();
            datagram.splice(at..at + from.len(), to.iter().copied());
            decode(&datagram)
        };
        assert!(changed(b"dlc\x02", b"dlc\x02").is_some());
        // A length that differs from the data's; a negative one; an identifier beyond 11 bits; data
        // that is not a bin; a bin that is shorter than its length.
        assert_eq!(changed(b"dlc\x02", b"dlc\x08"), None);
        assert_eq!(changed(b"dlc\x02", b"dlc\xff"), None);
        assert_eq!(changed(b"\xcd\x01\x23", b"\xcd\x08\x00"), None);
        assert_eq!(changed(b"\xc4\x02\x01\x02", b"\x92\xc0\xc0"), None);
        assert_eq!(changed(b"\xc4\x02\x01\x02", b"\xc6\xff\xff\xff\xff\x01\x02"), None);
        assert_eq!(changed(b"\xa7channel\xc0", b"\xa7channel\xa4can0").unwrap().len(), 2);
        // Deep nesting, and a long map.
        let deep = [vec![0x91; 60_000], vec![0xC0]].concat();
        assert_eq!(changed(b"\xa7channel\xc0", &[b"\xa7channel", &deep[..]].concat()), None);
        assert_eq!(decode(b"\xdf\xff\xff\xff\xff"), None);
        assert_eq!(decode(b""), None);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_do_no_harm(
            head in 0..OF_PYTHON.len(),
            rest in proptest::collection::vec(any::<u8>(), 0..300),
        ) {
            decode(&[&OF_PYTHON[..head], &rest].concat());
        }
    }
}
