//! Malformed requests: data of frames on the service of DES that no responder may stumble over.
//!
//! Does not know how a device reacts.

/// A malformed request: its data, and what is wrong with them.
pub(super) const MALFORMED: &[(&[u8], &str)] = &[
    (&[], "an empty frame"),
    (b"D", "one byte"),
    (b"DES", "a request without its type"),
    (b"\x03DES", "a single frame without the type"),
    (b"\x07DES\x01", "a single frame that is longer than its data"),
    (b"\x00DES\x01", "a single frame of no length"),
    (b"\x04DEX\x01", "another magic"),
    (b"\x08DES\x01\x00\x00\x00", "a single frame of 8 bytes"),
    (b"\x21DES\x01", "a consecutive frame without a first one"),
    (b"\x30\x00\x00", "flow control without a transfer"),
    (b"\x3F\x00\x00", "flow control with a reserved status"),
    (b"\x30", "flow control without its values"),
    (b"\x10\x04DES\x01", "a first frame that fits a single frame"),
    (b"\x10", "a first frame without its length"),
    (b"\x10\x00\xFF\xFF\xFF\xFFDE", "a first frame of 4 GiB"),
    (b"\xF0DES\x01", "an unknown frame type"),
    (b"DES\x01\xFF\xFF\xFF\xFF", "bytes behind the type"),
    (b"\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF", "all bits 1"),
];

/// Frames of a request of 4095 bytes that ends after some of them.
pub(super) fn endless(frames: usize) -> Vec<Vec<u8>> {
    let first = b"\x1F\xFFDES\x01AA".to_vec();
    let consecutive = (0..frames).map(|at| {
        let mut data = vec![0x41; 8];
        data[0] = 0x20 | (at as u8 + 1) & 0x0F;
        data
    });
    std::iter::once(first).chain(consecutive).collect()
}
