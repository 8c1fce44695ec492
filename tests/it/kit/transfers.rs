//! Responses in several frames: flow control, several requesters, full transmit buffers.

use super::{
    Act, Bench, Board, BoardSpec, CONTINUE, KitFrame, NAME, PERIOD, SERVICES, data, des_request,
};
use super::{request_id, responses};

/// 61 bytes: a first frame and eight consecutive ones.
fn long() -> BoardSpec {
    let services = (0..6u8).flat_map(|at| {
        let mut service = vec![at];
        service.extend(b"SRVX\x001.0\x00");
        service
    });
    BoardSpec { services: services.collect(), ..BoardSpec::new(12) }
}

fn from(requester: u8, data: &[u8]) -> KitFrame {
    KitFrame::classic(request_id(requester, 12, false, 2), data)
}

#[test]
fn transfer_waits_for_flow_control() {
    let mut board = Board::running(&long());
    let first = board.exchange(&des_request(SERVICES));
    assert_eq!(data(&first), [[0x10, 61, 2, 0, b'S', b'R', b'V', b'X']]);
    assert!(responses(&board.pass(PERIOD / 2)).is_empty());
    board.receive(&des_request(CONTINUE));
    let rest = responses(&board.pass(20_000));
    let numbers: Vec<u8> = rest.iter().map(|frame| frame.data[0]).collect();
    assert_eq!(numbers, [0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x27, 0x28]);
}

#[test]
fn block_size_and_stmin_are_kept() {
    let mut board = Board::running(&long());
    board.exchange(&des_request(SERVICES));
    board.receive(&des_request(&[0x30, 3, 20]));
    let sent = |acts: &[(u32, Act)]| -> Vec<u32> {
        acts.iter()
            .filter(|(_, act)| matches!(act, Act::Send { slot: 1, .. }))
            .map(|(at, _)| *at)
            .collect()
    };
    let times = sent(&board.pass_timed(PERIOD / 2));
    assert_eq!(times.len(), 3);
    assert!(times.windows(2).all(|pair| (20_000..23_000).contains(&(pair[1] - pair[0]))));
    board.receive(&des_request(&[0x30, 2, 0xF5]));
    let times = sent(&board.pass_timed(PERIOD / 2));
    assert_eq!(times.len(), 2);
    assert!((500..3000).contains(&(times[1] - times[0])));
    board.receive(&des_request(&[0x30, 0, 0x80]));
    let times = sent(&board.pass_timed(PERIOD / 2));
    assert_eq!(times.len(), 3);
    assert!((127_000..130_000).contains(&(times[1] - times[0])), "reserved: 127 ms");
}

#[test]
fn stmin_counts_from_the_end_of_transmission() {
    let mut board = Board::running(&long());
    board.exchange(&des_request(SERVICES));
    board.receive(&des_request(&[0x30, 0, 10]));
    board.holds = true;
    assert_eq!(responses(&board.pass(30_000)).len(), 1, "waits in the transmit buffer");
    board.driver.run("result 0 1 1");
    assert!(responses(&board.pass(9_000)).is_empty());
    assert_eq!(responses(&board.pass(3_000)).len(), 1);
}

#[test]
fn wait_prolongs_and_overflow_ends_a_transfer() {
    let mut board = Board::running(&long());
    board.exchange(&des_request(SERVICES));
    for _ in 0..5 {
        board.receive(&des_request(&[0x31, 0, 0]));
        assert!(responses(&board.pass(PERIOD - 10_000)).is_empty());
    }
    board.receive(&des_request(CONTINUE));
    assert_eq!(responses(&board.pass(20_000)).len(), 8);
    board.exchange(&des_request(SERVICES));
    for _ in 0..17 {
        board.receive(&des_request(&[0x31, 0, 0]));
    }
    board.receive(&des_request(CONTINUE));
    assert!(responses(&board.pass(20_000)).is_empty(), "16 in a row at most");
    board.exchange(&des_request(SERVICES));
    board.receive(&des_request(&[0x32, 0, 0]));
    board.receive(&des_request(CONTINUE));
    assert!(responses(&board.pass(20_000)).is_empty());
    assert_eq!(board.exchange(&des_request(NAME)).len(), 1);
}

#[test]
fn missing_flow_control_ends_a_transfer() {
    let mut board = Board::running(&long());
    board.exchange(&des_request(SERVICES));
    board.pass(PERIOD + 10_000);
    board.receive(&des_request(CONTINUE));
    assert!(responses(&board.pass(20_000)).is_empty(), "N_Bs");
}

#[test]
fn repeated_request_begins_its_transfer_again() {
    let mut board = Board::running(&long());
    board.exchange(&des_request(SERVICES));
    board.receive(&des_request(&[0x30, 2, 0]));
    board.pass(20_000);
    assert_eq!(board.exchange(&des_request(SERVICES))[0].data[0], 0x10);
    board.receive(&des_request(CONTINUE));
    assert_eq!(responses(&board.pass(20_000)).len(), 8);
    // While a frame of it waits in the transmit buffer.
    board.exchange(&des_request(SERVICES));
    board.receive(&des_request(CONTINUE));
    board.holds = true;
    board.poll();
    board.receive(&des_request(SERVICES));
    board.driver.run("result 0 1 1");
    board.holds = false;
    let frames = responses(&board.pass(10_000));
    assert_eq!(data(&frames)[0][0], 0x10);
}

#[test]
fn flow_control_before_the_end_of_transmission_is_noticed() {
    let mut board = Board::running(&long());
    board.holds = true;
    assert_eq!(board.exchange(&des_request(SERVICES)).len(), 1);
    // The controller knows that the frame was sent; des_poll was not called since.
    board.driver.run("result 0 1 1");
    board.receive(&des_request(CONTINUE));
    assert_eq!(responses(&board.poll()).len(), 1);
}

#[test]
fn several_requesters_are_served_at_once() {
    let mut board = Board::running(&long());
    for requester in [0, 5, 9] {
        assert_eq!(board.exchange(&from(requester, SERVICES)).len(), 1);
    }
    assert!(board.exchange(&from(77, NAME)).is_empty(), "more than DES_REQUESTERS");
    assert_eq!(board.command("dropped 0"), [Act::Other("dropped 1".to_owned())]);
    for requester in [9, 5, 0] {
        board.receive(&from(requester, CONTINUE));
    }
    let frames = responses(&board.pass(50_000));
    let to = |frame: &KitFrame| (frame.id >> 10 & 0x7F) as u8;
    let first: Vec<u8> = frames[..3].iter().map(to).collect();
    assert!([0, 5, 9].iter().all(|it| first.contains(it)), "in turns: {first:?}");
    for requester in [0, 5, 9] {
        let of: Vec<u8> =
            frames.iter().filter(|it| to(it) == requester).map(|it| it.data[0]).collect();
        assert_eq!(of, [0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x27, 0x28]);
    }
    assert_eq!(board.exchange(&from(77, NAME)).len(), 1);
}

#[test]
fn flow_control_of_others_changes_nothing() {
    let mut board = Board::running(&long());
    board.exchange(&des_request(SERVICES));
    board.receive(&from(7, CONTINUE));
    assert!(responses(&board.pass(20_000)).is_empty());
    let broadcast = KitFrame::classic(0x0200_0002 | 99 << 10, CONTINUE);
    board.receive(&broadcast);
    assert_eq!(responses(&board.pass(20_000)).len(), 8);
}

#[test]
fn requests_of_one_requester_are_answered_in_turn() {
    let mut board = Board::running(&long());
    board.exchange(&des_request(SERVICES));
    assert!(board.exchange(&des_request(NAME)).is_empty());
    assert!(board.exchange(&des_request(b"DES\x01")).is_empty());
    board.receive(&des_request(CONTINUE));
    let frames = data(&responses(&board.pass(50_000)));
    assert_eq!(frames.len(), 10);
    assert_eq!(frames[8], [6, 1, b'F', b'E', b'E', b'D', 0]);
    assert_eq!(frames[9], [1, b'F', b'E', b'E', b'D', 0]);
}

#[test]
fn rejected_frame_is_sent_later_unchanged() {
    let mut board = Board::running(&long());
    board.exchange(&des_request(SERVICES));
    board.receive(&des_request(CONTINUE));
    board.driver.run("refuse 0 1");
    assert!(responses(&board.pass(10_000)).is_empty());
    board.driver.run("refuse 0 0");
    let numbers: Vec<u8> =
        responses(&board.pass(50_000)).iter().map(|frame| frame.data[0]).collect();
    assert_eq!(numbers, [0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x27, 0x28]);
}

#[test]
fn requests_reach_nodes_of_the_addressed_mode() {
    let mut board = Board::running(&BoardSpec::new(12));
    let broadcast = |d: u32| KitFrame::classic(0x0200_0002 | d << 27 | 99 << 10, NAME);
    assert_eq!(board.exchange(&broadcast(0)).len(), 1);
    assert!(board.exchange(&broadcast(1)).is_empty());
    board.command("mode 0 2");
    board.poll();
    assert!(board.exchange(&broadcast(0)).is_empty());
    let answer = board.exchange(&broadcast(1));
    assert_eq!(answer[0].id, 0x1518_0002, "RSP_CU_TGT");
}

#[test]
fn malformed_requests_are_not_answered() {
    let mut board = Board::running(&BoardSpec::new(12));
    let bad: [&[u8]; 9] = [
        b"",
        b"DES",
        b"XES\x01",
        b"DEX\x01",
        &[4, b'D', b'E', b'S'],
        &[5, b'D', b'E', b'S', 1, 0],
        &[3, b'D', b'E', b'S', 1],
        &[0, 4, b'D', b'E', b'S', 1],
        &[0x10, 8, b'D', b'E', b'S', 1, 0, 0],
    ];
    for bytes in bad {
        assert!(board.exchange(&des_request(bytes)).is_empty(), "{bytes:?}");
    }
    let escape = KitFrame { fd: true, ..des_request(&[0, 4, b'D', b'E', b'S', 1]) };
    assert_eq!(board.exchange(&escape).len(), 1, "the escape of CAN FD");
    let non_conforming = KitFrame::classic(0x1000_0002 | 12 << 10, NAME);
    assert!(board.exchange(&non_conforming).is_empty());
}

#[test]
fn reserved_request_is_refused_if_targeted() {
    let mut board = Board::running(&BoardSpec::new(12));
    for request in [&[4, b'D', b'E', b'S', 3][..], b"DES\x00"] {
        assert_eq!(
            board.exchange(&des_request(request)),
            [KitFrame::classic(0x0418_0002, &[])],
            "ERR = 0"
        );
    }
    let broadcast = KitFrame::classic(0x0200_0002 | 99 << 10, &[4, b'D', b'E', b'S', 3]);
    assert!(board.exchange(&broadcast).is_empty());
}

#[test]
fn raw_response_on_fd_is_padded_to_a_dlc() {
    let mut board = Board::running(&BoardSpec::new(12));
    let request = KitFrame { fd: true, ..des_request(b"DES\x02") };
    let frames = board.exchange(&request);
    assert_eq!(frames[0].data, *b"\x02\x00DES\x001.0\x00\xCC\xCC");
}
