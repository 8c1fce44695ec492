//! Random frames of every kind.

use descan::frame::{CanId, Frame};
use descan::time::Instant;
use proptest::prelude::*;

pub fn any_id() -> impl Strategy<Value = CanId> {
    prop_oneof![
        (0_u16..0x800).prop_map(CanId::Standard),
        (0_u32..0x2000_0000).prop_map(CanId::Extended),
    ]
}

/// Generates any valid frame, of bus 0, sent by descan or by another node.
pub fn any_frame() -> impl Strategy<Value = Frame> {
    let bytes = |most| proptest::collection::vec(any::<u8>(), 0..=most);
    let frame = prop_oneof![
        (any_id(), bytes(8)).prop_map(|(id, data)| Frame::new(id, &data)),
        (any_id(), 0_usize..=8).prop_map(|(id, len)| Frame::remote(id, len)),
        (0_u32..0x2000_0000, bytes(8)).prop_map(|(class, data)| Frame::error(class, &data)),
        (any_id(), bytes(64), any::<(bool, bool)>()).prop_map(|(id, data, flags)| {
            let mut frame = Frame::fd(0, &data, 0xCC);
            frame.id = id;
            (frame.bit_rate_switch, frame.error_state) = flags;
            frame
        }),
    ];
    (frame, any::<bool>(), 0_u64..1 << 40).prop_map(|(mut frame, ours, micros)| {
        frame.is_tx = ours;
        frame.with_time(Instant::from_micros(micros))
    })
}
