//! The kit in C and the node in Rust, with the same random frames: both do the same.

use super::node_bench::NodeBench;
use super::{Act, Bench, BoardSpec, KitFrame, KitProcess, SingleBoard, hex, mode, request_id};
use fastrand::Rng;

/// Services and data of requests; those that change the address are left out, for the phases of the
/// two nodes differ after a new start.
const REQUESTS: [(u16, &[u8]); 15] = [
    (2, &[4, b'D', b'E', b'S', 1]),
    (2, &[4, b'D', b'E', b'S', 2]),
    (2, &[4, b'D', b'E', b'S', 3]),
    (2, b"DES\x01"),
    (2, b"DES\x02"),
    (2, &[0x10, 9, b'D', b'E', b'S', 1, 0, 0]),
    (0x010, &[]),
    (0x011, &[]),
    (0x016, &[]),
    (0x011, b"OTHER!"),
    (0x012, &[1]),
    (0x018, &[]),
    (0x019, &[mode::CFG]),
    (0x019, &[mode::WORK]),
    (0x155, &[1, 2]),
];

fn random_frame(random: &mut Rng) -> KitFrame {
    let from = [0, 5, 9, 33, 77][random.usize(..5)];
    let is_fd = random.u8(..4) == 0;
    if random.bool() {
        let flow = [0x30, 0x30, 0x30, 0x31, 0x32, 0x33][random.usize(..6)];
        let st_min = [0, 1, 5, 20, 127, 0x80][random.usize(..6)];
        let id = request_id(from, 12, random.bool(), 2);
        return KitFrame { fd: is_fd, ..KitFrame::classic(id, &[flow, random.u8(..4), st_min]) };
    }
    let (service, data) = match random.u8(..60) {
        0 => (0x019, &[mode::IDLE][..]),
        _ => REQUESTS[random.usize(..REQUESTS.len())],
    };
    let to = [12, 12, 12, 12, 13][random.usize(..5)];
    let broadcast = u32::from(random.u8(..6) == 0) << 25;
    let id = request_id(from, to, random.bool(), service) | broadcast;
    KitFrame { fd: is_fd, ..KitFrame::classic(id, data) }
}

/// What a node does with a frame, without its heartbeats.
fn acts_on<B: Bench>(board: &mut SingleBoard<B>, frame: &KitFrame, step: u32) -> Vec<Act> {
    board.now = board.now.wrapping_add(step);
    let time = format!("time {}", board.now);
    let text = format!("frame 0 {:08X} {} {}", frame.id, hex(&frame.data), u8::from(frame.fd));
    let mut acts = Vec::new();
    for command in [&time, "poll 0", &text, "poll 0"] {
        acts.extend(board.driver.run(command));
    }
    for act in &acts {
        if let Act::Send { slot, .. } = act {
            board.driver.run(&format!("result 0 {slot} 1"));
        }
    }
    acts.retain(|act| !matches!(act, Act::Wait(_) | Act::Send { slot: 0, .. }));
    acts
}

#[test]
fn both_nodes_do_the_same_with_random_frames() {
    let services = (0..9u8).flat_map(|at| [&[at][..], b"SRVX\x001.0\x00"].concat());
    let spec = BoardSpec { services: services.collect(), ..BoardSpec::new(12) };
    let mut sent = 0;
    for seed in 0..40 {
        let mut random = Rng::with_seed(seed);
        let mut c = SingleBoard::<KitProcess>::running(&spec);
        let mut rust = SingleBoard::<NodeBench>::running(&spec);
        for at in 0..1500 {
            let frame = random_frame(&mut random);
            let step = [0, 1000, 1000, 4000, 25_000, 400_000][random.usize(..6)];
            let acts = acts_on(&mut c, &frame, step);
            assert_eq!(acts_on(&mut rust, &frame, step), acts, "seed {seed}, {at}: {frame:?}");
            sent += super::responses(&acts).len();
        }
    }
    assert!(sent > 5000, "{sent} responses");
}
