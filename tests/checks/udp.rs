//! Datagrams of the multicast bus: an input is a datagram.

use super::Target;
use super::protocol::check_shape;
use descan::bus::{decode_datagram, encode_datagram};

/// Target `udp`.
pub const UDP: Target = Target {
    name: "udp",
    check: |input| {
        if let Some(frame) = decode_datagram(input) {
            check_shape(&frame);
            let again = encode_datagram(&frame, 1.5).expect("a frame that exists");
            assert_eq!(decode_datagram(&again), Some(frame), "{again:?}");
        }
    },
    words: &[
        b"\xa9timestamp\xcb",
        b"\xaearbitration_id",
        b"\xaeis_extended_id",
        b"\xafis_remote_frame",
        b"\xaeis_error_frame",
        b"\xa7channel",
        b"\xa3dlc",
        b"\xa4data\xc4\x08",
        b"\xa5is_fd",
        b"\xaebitrate_switch",
        b"\xb5error_state_indicator",
        b"\xc2",
        b"\xc3",
        b"\xc0",
        b"\x8b",
        b"\xcd\x01\x23",
        b"\xce\x1f\xff\xff\xff",
        b"\xc4\x40",
        b"\xc5",
        b"\xc6\xff\xff\xff\xff",
        b"\x91\x91\x91\x91",
        b"\xdf\xff\xff\xff\xff",
    ],
};
