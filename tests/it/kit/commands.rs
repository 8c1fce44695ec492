//! Descriptor, writes of settings and commands, and requests for the application.

use super::{
    Act, Bench, Board, BoardSpec, KitFrame, PERIOD, PREFERRED, heartbeats, mode, modes, request_id,
    responses,
};

const UID: u16 = 0x011;
const BSPD: u16 = 0x015;
const ADDR: u16 = 0x016;
const IDENTIFY: u16 = 0x018;
const MODE: u16 = 0x019;
const REBOOT: u16 = 0x01A;

fn to(service: u16, data: &[u8]) -> KitFrame {
    KitFrame::classic(request_id(0, 12, false, service), data)
}

fn done(service: u16) -> [KitFrame; 1] {
    [KitFrame::classic(0x0518_0000 | u32::from(service), &[])]
}

fn refused(service: u16) -> [KitFrame; 1] {
    [KitFrame::classic(0x0418_0000 | u32::from(service), &[])]
}

/// Passes a request, and returns what the node did within 5 ms.
fn acts(board: &mut Board, frame: &KitFrame) -> Vec<Act> {
    let mut acts = board.receive(frame);
    acts.extend(board.pass(5000));
    acts
}

#[test]
fn descriptor_fields_are_read() {
    let mut board = Board::running(&BoardSpec { bitrate: 0x82, ..BoardSpec::new(PREFERRED + 12) });
    let expected: [(u16, &[u8]); 8] = [
        (0x010, &[1, 2, 3, 4, 5, 6]),
        (0x011, b"BOARD1"),
        (0x012, &[0x44, 0x33, 0x22, 0x11]),
        (0x013, &[0x02, 0x01, 0x04, 0x03]),
        (0x014, &[3, 1, 0, 2, 0x80]),
        (0x015, &[0x82]),
        (0x016, &[0x8C]),
        (0x017, &[1]),
    ];
    for (service, data) in expected {
        let expected = KitFrame::classic(0x0518_0000 | u32::from(service), data);
        assert_eq!(board.exchange(&to(service, &[])), [expected]);
    }
    // All at once, of one requester.
    for (service, _) in expected {
        board.receive(&to(service, &[]));
    }
    assert_eq!(responses(&board.pass(50_000)).len(), 8);
    assert_eq!(board.exchange(&to(0x012, &[1])), refused(0x012), "cannot be written");
}

#[test]
fn address_write_is_stored_and_acts_after_its_response() {
    let mut board = Board::running(&BoardSpec::new(12));
    let acts = acts(&mut board, &to(ADDR, &[PREFERRED + 20]));
    let store = Act::Store { uid: b"BOARD1".to_vec(), address: 0x94, bitrate: 0x80 };
    assert_eq!(acts[0], store);
    assert_eq!(responses(&acts), done(ADDR));
    assert_eq!(modes(&acts), [mode::ARSLV]);
    let acts = board.pass(4 * PERIOD);
    assert_eq!(heartbeats(&acts)[0].source(), 20);
    assert_eq!(modes(&acts), [mode::WORK]);
}

#[test]
fn bit_rate_write_begins_again_at_that_rate() {
    let mut board = Board::running(&BoardSpec::new(12));
    let acts = acts(&mut board, &to(BSPD, &[2]));
    assert_eq!(responses(&acts), done(BSPD));
    assert!(acts.contains(&Act::Bus { rate: 2, silent: true }), "{acts:?}");
    assert_eq!(modes(&acts), [mode::INIT]);
}

#[test]
fn uid_write_changes_the_heartbeat() {
    let mut board = Board::running(&BoardSpec::new(12));
    assert_eq!(board.exchange(&to(UID, b"OTHER!")), done(UID));
    assert_eq!(heartbeats(&board.pass(PERIOD))[0].data, *b"OTHER!\x04\x00");
}

#[test]
fn invalid_or_locked_writes_are_refused() {
    let mut board = Board::running(&BoardSpec::new(12));
    for (service, data) in
        [(ADDR, &[0x80][..]), (ADDR, &[1, 2]), (BSPD, &[4]), (BSPD, &[0x84]), (UID, b"SHORT")]
    {
        let acts = acts(&mut board, &to(service, data));
        assert_eq!(responses(&acts), refused(service), "{data:?}");
        assert_eq!(acts.len(), 1, "nothing is stored: {acts:?}");
    }
    board.driver.run("locked 0 1");
    assert_eq!(board.exchange(&to(ADDR, &[20])), refused(ADDR));
    assert_eq!(board.exchange(&to(ADDR, &[]))[0].data, [12], "unchanged");
}

#[test]
fn mode_command_changes_the_mode_after_its_response() {
    let mut board = Board::running(&BoardSpec::new(12));
    let acts = acts(&mut board, &to(MODE, &[mode::CFG]));
    assert_eq!(responses(&acts), done(MODE));
    assert_eq!(modes(&acts), [mode::CFG]);
    assert!(board.exchange(&to(MODE, &[mode::WORK])).is_empty(), "D = 0 is for working nodes");
    let to_cfg = |data: &[u8]| KitFrame::classic(request_id(0, 12, true, MODE), data);
    for data in [&[7][..], &[], &[mode::WORK, 0]] {
        assert_eq!(board.exchange(&to_cfg(data))[0].id, 0x1418_0000 | u32::from(MODE));
    }
    assert_eq!(modes(&super::commands::acts(&mut board, &to_cfg(&[mode::WORK]))), [mode::WORK]);
}

#[test]
fn idle_node_beats_and_waits_for_the_mode_command() {
    let mut board = Board::running(&BoardSpec::new(12));
    let acts = acts(&mut board, &to(MODE, &[mode::IDLE]));
    assert_eq!(heartbeats(&acts)[0].data[6], mode::IDLE, "at once");
    assert_eq!(heartbeats(&board.pass(3 * PERIOD)).len(), 3);
    let to_idle = |service, data: &[u8]| KitFrame::classic(request_id(0, 12, true, service), data);
    assert!(board.exchange(&to_idle(2, super::NAME)).is_empty());
    assert!(board.exchange(&to_idle(UID, &[])).is_empty());
    assert_eq!(board.exchange(&to_idle(MODE, &[mode::WORK])).len(), 1);
    assert_eq!(board.exchange(&to(UID, &[])).len(), 1, "awake");
}

#[test]
fn second_command_before_the_response_is_dropped() {
    let mut board = Board::running(&BoardSpec::new(12));
    board.holds = true;
    board.receive(&to(ADDR, &[20]));
    assert_eq!(responses(&board.poll()).len(), 1, "waits in the transmit buffer");
    let acts = board.receive(&to(BSPD, &[2]));
    assert!(acts.is_empty(), "nothing is stored: {acts:?}");
    assert_eq!(board.command("dropped 0"), [Act::Other("dropped 1".to_owned())]);
    board.driver.run("result 0 1 1");
    board.holds = false;
    assert_eq!(modes(&board.pass(5000)), [mode::ARSLV], "the first one acts");
}

#[test]
fn work_command_needs_uid_and_address() {
    let spec = BoardSpec { uid: [0; 6], ..BoardSpec::new(12) };
    let mut board = Board::running(&spec);
    let to_cfg = |service, data: &[u8]| KitFrame::classic(request_id(0, 12, true, service), data);
    let answer = board.exchange(&to_cfg(MODE, &[mode::WORK]));
    assert_eq!(answer[0].id >> 24 & 1, 0, "ERR = 0");
    board.exchange(&to_cfg(UID, b"BOARD7"));
    let answer = board.exchange(&to_cfg(MODE, &[mode::WORK]));
    assert_eq!(answer[0].id >> 24 & 1, 1);
}

#[test]
fn identify_and_reboot_inform_the_firmware() {
    let mut board = Board::running(&BoardSpec::new(12));
    let done_first = acts(&mut board, &to(IDENTIFY, &[]));
    assert_eq!(done_first.last(), Some(&Act::Identify));
    assert_eq!(responses(&done_first), done(IDENTIFY));
    assert_eq!(board.exchange(&to(REBOOT, &[1])), refused(REBOOT));
    let acts = acts(&mut board, &to(REBOOT, &[]));
    assert_eq!(responses(&acts), done(REBOOT));
    assert!(acts.contains(&Act::Reboot));
    assert_eq!(modes(&acts), [mode::INIT]);
}

#[test]
fn other_requests_are_for_the_application() {
    let mut board = Board::running(&BoardSpec::new(12));
    let app = [Act::ForApplication];
    assert_eq!(board.receive(&to(0x155, &[1])), app);
    assert_eq!(board.receive(&KitFrame::classic(0x0600_0155 | 5 << 17, &[])), app, "data to all");
    assert_eq!(board.receive(&KitFrame::classic(request_id(0, 13, false, 0x155), &[])), []);
    assert_eq!(board.receive(&KitFrame::classic(request_id(0, 12, true, 0x155), &[])), []);
    assert_eq!(board.receive(&to(2, super::NAME)), []);
}
