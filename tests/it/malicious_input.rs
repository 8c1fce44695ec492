//! Malicious frames: no panic, bounded memory, no control characters on the terminal.

use crate::checks::engine::{EngineStep, check_rows, run};
use crate::common::sweep;
use descan::discovery::{Config, Engine};
use descan::frame::{CanId, Frame};
use descan::time::Instant;
use descan::wire::id::{Address, Header, Service};
use proptest::prelude::*;

fn any_bytes(most: usize) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), 0..=most)
}

/// Generates bytes that resemble DES and ISO 15765-2 often enough to reach the inner code.
fn likely_bytes() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        any_bytes(8),
        any_bytes(64),
        (
            prop::sample::select(vec![0x10u8, 0x1F, 0x20, 0x21, 0x22, 0x30, 0x31, 0x32]),
            any_bytes(7)
        )
            .prop_map(|(first, rest)| [vec![first], rest].concat()),
        (1u8..8, prop::sample::select(vec![1u8, 2]), any_bytes(6))
            .prop_map(|(length, kind, rest)| [vec![length, kind], rest].concat()),
        (prop::sample::select(vec![1u8, 2]), any_bytes(7)).prop_map(|(kind, rest)| [
            vec![kind],
            rest
        ]
        .concat()),
        Just(b"DES\x01".to_vec()),
        Just(b"\x04DES\x02".to_vec()),
        Just(vec![0x10, 0x00, 0xFF, 0xFF, 0xFF, 0xFF, 2, 0]),
    ]
}

fn likely_header() -> impl Strategy<Value = u32> {
    let flags = (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>());
    let service = prop::sample::select(vec![1u16, 2, 2, 2, 0x10, 0x3FF]);
    (flags, 0u8..6, 0u8..6, service).prop_map(|(flags, source, destination, service)| {
        Header {
            from_non_working: flags.0,
            to_non_working: flags.1,
            response: flags.2,
            broadcast: flags.3,
            no_error: flags.4,
            source: Address::from_bits(source),
            destination: Address::from_bits(destination),
            service: Service::from_bits(service),
        }
        .encode()
    })
}

fn any_frame() -> impl Strategy<Value = Frame> {
    prop_oneof![
        8 => (likely_header(), likely_bytes(), any::<bool>()).prop_map(|(id, data, ours)| {
            let mut frame = Frame::new(CanId::Extended(id), &data);
            frame.is_fd = data.len() > 8;
            frame.is_tx = ours && data.len() % 3 == 0;
            frame
        }),
        1 => (0u32..0x2000_0000, any_bytes(8)).prop_map(|(id, data)| Frame::classic(id, &data)),
        1 => (0u16..0x800, 0usize..9)
            .prop_map(|(id, len)| Frame::remote(CanId::Standard(id), len)),
        1 => (0u32..0x2000_0000, any_bytes(8)).prop_map(|(class, data)| Frame::error(class, &data)),
    ]
}

/// Time between two frames in microseconds; the timestamps of a log may be at any distance.
fn any_pause() -> impl Strategy<Value = u64> {
    prop_oneof![500 => 0u64..400_000, 1 => any::<u64>()]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: sweep::cases(256), ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_frames_do_not_break_the_engine(
        frames in prop::collection::vec((any_frame(), any_pause()), 1..400),
        listen_only in any::<bool>(),
        seed in any::<u64>(),
    ) {
        let config = Config { listen_only, seed, ..Config::default() };
        let steps = frames
            .into_iter()
            .flat_map(|(frame, pause)| [EngineStep::Pause(pause), EngineStep::Frame(frame)]);
        run(config, false, steps);
    }
}

#[test]
fn changing_names_do_not_grow_memory() {
    let mut engine = Engine::new(Instant::ZERO, Config::default());
    let header =
        Header::request(Address::DEBUG, Address::from_bits(12), false, Service::from_bits(2))
            .response(Address::from_bits(12), false);
    for number in 0..5_000u32 {
        let now = Instant::from_micros(u64::from(number) * 2_000);
        let [_, a, b, c] = number.to_be_bytes();
        let data = [6, 1, b'A' + a, b'A' + (b >> 4), b'A' + (b & 15), b'A' + (c >> 4), c | 0x40, 0];
        engine.handle_frame(&Frame::classic(header.encode(), &data).with_time(now));
        engine.handle_timeout(now);
        while engine.poll_transmit(now).is_some() {}
    }
    assert!(engine.devices().len() <= 512);
    check_rows(&engine);
    assert!(engine.findings().len() <= 512);
    assert!(std::iter::from_fn(|| engine.poll_event()).count() <= 4096);
}
