//! Identifiers of all that a node sends: the type of each message, and which one wins arbitration
//! (CAN platform 4.2 and 4.3).

use super::{
    Act, Bench, Board, BoardSpec, CONTINUE, KitFrame, NAME, PERIOD, SERVICES, heartbeats, mode,
    request_id, responses,
};
use std::collections::BTreeSet;

/// U, D, R, B and ERR of what a working node sends: RSP_CC_TGT, refused and not, and RSP_CC_UNSC.
const WORKING: [u32; 3] = [0b00100, 0b00101, 0b00111];
/// The same of a node that does not work: RSP_CU_TGT and RSP_CU_UNSC.
const NOT_WORKING: [u32; 3] = [0b10100, 0b10101, 0b10111];
const BROADCAST: u32 = 1 << 25;
const IDENTIFY: u16 = 0x018;
const MODE: u16 = 0x019;
/// A DES request of a reserved type, which a node refuses.
const RESERVED: &[u8] = &[4, b'D', b'E', b'S', 3];

/// U, D, R, B and ERR.
fn flags(frame: &KitFrame) -> u32 {
    frame.id >> 24
}

/// A node with services that need several frames.
fn spec(address: u8) -> BoardSpec {
    let services = (0..3u8).flat_map(|at| [&[at][..], b"SRVX\x001.0\x00"].concat());
    BoardSpec { services: services.collect(), ..BoardSpec::new(address) }
}

/// A node that does not leave CFG by itself.
fn in_cfg(address: u8) -> BoardSpec {
    BoardSpec { autostart: false, ..spec(address) }
}

/// What a requester is answered: refused, and not.
struct Answers {
    refused: Vec<KitFrame>,
    given: Vec<KitFrame>,
}

/// Asks a node for all that it answers; `d`: it does not work. All answers go to the requester.
fn answers(board: &mut Board, requester: u8, address: u8, d: bool) -> Answers {
    let id = |service| request_id(requester, address, d, service);
    let mut ask = |id: u32, data: &[u8]| {
        let frames = board.exchange(&KitFrame::classic(id, data));
        assert!(!frames.is_empty(), "{id:08X} is not answered");
        for frame in &frames {
            let fields = frame.id & 0x00FF_FFFF;
            assert_eq!(fields, request_id(address, requester, false, (id & 0x3FF) as u16));
        }
        frames
    };
    let given = [
        ask(id(2), NAME),
        ask(id(2) | BROADCAST, NAME),
        ask(id(2), b"DES\x01"),
        ask(id(2), SERVICES),
        ask(id(2), CONTINUE),
        ask(id(0x011), &[]),
        ask(id(0x011), b"BOARD1"),
        ask(id(IDENTIFY), &[]),
    ];
    let refused = [
        ask(id(2), RESERVED),
        ask(id(2), b"DES\x02"),
        ask(id(0x012), &[1]),
        ask(id(0x016), &[0x80]),
        ask(id(MODE), &[7]),
    ];
    Answers { refused: refused.concat(), given: given.concat() }
}

fn assert_flags(frames: &[KitFrame], expected: u32) {
    assert!(!frames.is_empty());
    for frame in frames {
        assert_eq!(flags(frame), expected, "{frame:?}");
    }
}

/// Enters a mode by commands of the bench; returns the node.
fn board_in(code: u8) -> Board {
    let mut board = Board::running(&if code == mode::CFG { in_cfg(12) } else { spec(12) });
    match code {
        mode::UFUNC => board.driver.run("fault 0 1"),
        mode::BOOT => board.driver.run("limit 0 3"),
        mode::IDLE => board.driver.run("mode 0 6"),
        _ => Vec::new(),
    };
    let beats = heartbeats(&board.pass(2 * PERIOD));
    assert_eq!(beats.last().unwrap().data[6], code);
    board
}

#[test]
fn answers_and_heartbeats_have_the_flags_of_the_mode() {
    for code in [mode::WORK, mode::UFUNC, mode::CFG, mode::BOOT] {
        let works = code == mode::WORK || code == mode::UFUNC;
        let mut board = board_in(code);
        // In BOOT a node has no services: one frame, and none after flow control.
        if code != mode::BOOT {
            let Answers { refused, given } = answers(&mut board, 0, 12, !works);
            assert_flags(&refused, if works { WORKING[0] } else { NOT_WORKING[0] });
            assert_flags(&given, if works { WORKING[1] } else { NOT_WORKING[1] });
        }
        let beats = heartbeats(&board.pass(3 * PERIOD));
        assert_flags(&beats, if works { WORKING[2] } else { NOT_WORKING[2] });
        assert!(beats.iter().all(|beat| beat.id & 0x00FE_03FF == 12 << 17 | 1), "{beats:?}");
    }
}

#[test]
fn boot_and_idle_answer_as_nodes_that_do_not_work() {
    let mut board = board_in(mode::BOOT);
    for (data, expected) in [(NAME, 1), (SERVICES, 1), (RESERVED, 0)] {
        let frames = board.exchange(&KitFrame::classic(request_id(0, 12, true, 2), data));
        assert_flags(&frames, NOT_WORKING[expected]);
    }
    let mut board = board_in(mode::IDLE);
    assert_flags(&heartbeats(&board.pass(3 * PERIOD)), NOT_WORKING[2]);
    let wake = |data: &[u8]| KitFrame::classic(request_id(0, 12, true, MODE), data);
    assert_flags(&board.exchange(&wake(&[7])), NOT_WORKING[0]);
    assert_flags(&board.exchange(&wake(&[mode::WORK])), NOT_WORKING[1]);
    assert_flags(&heartbeats(&board.pass(3 * PERIOD)), WORKING[2]);
}

#[test]
fn address_claim_is_unsolicited_data_of_no_working_node() {
    let mut board = Board::new(&spec(12));
    let frames = heartbeats(&board.pass(5 * PERIOD));
    let (claims, beats): (Vec<_>, Vec<_>) = frames.into_iter().partition(|frame| frame.once);
    assert_eq!(claims.len(), 1);
    assert_flags(&claims, NOT_WORKING[2]);
    assert_flags(&beats, WORKING[2]);
}

#[test]
fn higher_priority_is_a_lower_identifier() {
    // From the highest priority to the lowest: what working nodes send, then what the others do;
    // answers before heartbeats, refusals before other answers.
    let mut kinds: [Vec<u32>; 6] = Default::default();
    let mut take = |kind: usize, frames: &[KitFrame]| {
        kinds[kind].extend(frames.iter().map(|frame| frame.id));
    };
    for address in [1, 64, 127] {
        for (spec, first) in [(spec(address), 0), (in_cfg(address), 3)] {
            let mut board = Board::new(&spec);
            take(5, &heartbeats(&board.pass(5 * PERIOD))[..1]); // The claim.
            for requester in [0, 100, 126] {
                let Answers { refused, given } = answers(&mut board, requester, address, first > 0);
                take(first, &refused);
                take(first + 1, &given);
            }
            take(first + 2, &heartbeats(&board.pass(3 * PERIOD)));
        }
    }
    for pair in kinds.windows(2) {
        let (higher, lower) = (pair[0].iter().max().unwrap(), pair[1].iter().min().unwrap());
        assert!(higher < lower, "{higher:08X} {lower:08X}");
    }
    // Of one kind: the lower source first, then the lower destination, then the lower service.
    for kind in &mut kinds {
        kind.sort_unstable();
        let fields = |id: &u32| (id >> 17 & 0x7F, id >> 10 & 0x7F, id & 0x3FF);
        assert!(kind.is_sorted_by_key(fields), "{kind:08X?}");
        let sources: BTreeSet<u32> = kind.iter().map(|id| fields(id).0).collect();
        assert_eq!(sources, BTreeSet::from([1, 64, 127]));
    }
}

#[test]
fn destinations_of_heartbeats_are_random() {
    let mut board = Board::running(&spec(12));
    let beats = heartbeats(&board.pass(100 * PERIOD));
    let destinations: BTreeSet<u32> = beats.iter().map(|beat| beat.id >> 10 & 0x7F).collect();
    // Of 100 random numbers of 7 bits about 70 differ.
    assert!((50..=90).contains(&destinations.len()), "{destinations:?}");
    assert!(destinations.first() < Some(&16) && destinations.last() > Some(&111));
    let acts = board.receive(&KitFrame::classic(request_id(0, 13, false, 2) | BROADCAST, NAME));
    assert_eq!(acts, Vec::<Act>::new());
    let answer = responses(&board.poll());
    assert_eq!(answer[0].id, 0x0518_0002, "not to the random destination of the broadcast");
}
