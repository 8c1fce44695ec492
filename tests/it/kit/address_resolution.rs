//! INIT, ARSLV and the modes (CAN platform §3.2.4): bit rate, addresses, who gives way.

use super::{
    Act, Bench, Board, BoardSpec, KitFrame, NAME, PERIOD, TestBus, des_request, heartbeat,
};
use super::{PREFERRED, heartbeats, mode, modes, request_id};

const LISTEN: u32 = PERIOD * 3 / 2;

#[test]
fn lone_start_listens_then_claims_its_address() {
    let (mut board, acts) = Board::starting_at(&BoardSpec::new(12), 7);
    assert_eq!(acts, [Act::Bus { rate: 0, silent: true }]);
    let acts = board.pass(2 * LISTEN - 1);
    assert_eq!(acts, [Act::Mode(mode::ARSLV)], "silent for twice 1.5 periods");
    board.holds = true;
    let acts = board.pass_timed(PERIOD + 2000);
    assert_eq!(acts[0].1, Act::Bus { rate: 0, silent: false });
    let Act::Send { slot: 0, frame } = &acts[1].1 else { panic!("{acts:?}") };
    assert!(frame.once, "a claim is not repeated");
    assert_eq!(frame.id & 0x1FFE_03FF, 0x1718_0001, "unsolicited, U = 1, from 12");
    assert_eq!(frame.data, *b"BOARD1\x01\x00");
    board.holds = false;
    board.command("result 0 0 1");
    assert_eq!(modes(&board.poll()), [mode::WORK]);
    let beats = board.pass_timed(3 * PERIOD);
    assert_eq!(beats.len(), 3);
    assert!(beats.iter().all(|(_, act)| matches!(act, Act::Send { frame, .. }
        if frame.id & 0x1FFE_03FF == 0x0718_0001 && frame.data == *b"BOARD1\x04\x00")));
    let gaps: Vec<u32> = beats.windows(2).map(|pair| pair[1].0.wrapping_sub(pair[0].0)).collect();
    assert_eq!(gaps, [PERIOD, PERIOD]);
}

#[test]
fn mode_set_before_the_first_poll_does_not_skip_init() {
    for code in [mode::WORK, mode::ARSLV, mode::INIT] {
        let mut board = Board { driver: super::Driver::start(), now: 0, holds: false };
        board.driver.set_up(0, &BoardSpec::new(12));
        board.driver.run("init 0");
        board.driver.run(&format!("mode 0 {code}"));
        let acts = board.pass(2 * LISTEN - 1);
        let silent = Act::Bus { rate: 0, silent: true };
        assert_eq!(acts, [silent, Act::Mode(mode::ARSLV)], "{code}");
    }
}

#[test]
fn mode_set_after_a_conflict_does_not_keep_the_address() {
    let mut board = Board::running(&BoardSpec::new(12));
    board.receive(&heartbeat(12, *b"BOARD2", true));
    board.driver.run(&format!("mode 0 {}", mode::CFG));
    let modes = modes(&board.poll());
    assert_eq!(modes, [mode::ARSLV], "another node uses its address");
}

#[test]
fn failed_claim_is_repeated_after_a_random_time() {
    let mut board = Board::new(&BoardSpec::new(12));
    board.holds = true;
    let acts = board.pass(4 * PERIOD + 2000);
    assert_eq!(heartbeats(&acts).len(), 1);
    board.command("result 0 0 2");
    let acts = board.pass(PERIOD + 10_000);
    assert_eq!(heartbeats(&acts).len(), 1);
    assert!(!acts.iter().any(|act| matches!(act, Act::Bus { .. })), "stays active: {acts:?}");
}

#[test]
fn addresses_in_use_are_not_claimed() {
    let starts = |setting: u8, used: &[(u8, u8)], micros: u32| {
        let mut board = Board::new(&BoardSpec::new(setting));
        board.take(&heartbeat(1, *b"BOARD2", true)); // Ends INIT.
        for (from, to) in used {
            board.receive(&KitFrame::classic(request_id(*from, *to, false, 0x155), &[]));
        }
        let acts = board.pass(micros);
        heartbeats(&acts).first().map(KitFrame::source)
    };
    assert_eq!(starts(12, &[(3, 5)], 3 * PERIOD), Some(12));
    assert_eq!(starts(12, &[(12, 5)], 3 * PERIOD), None, "fixed: listens on");
    assert_eq!(starts(12, &[(12, 5)], 5 * PERIOD), Some(12), "until it is free");
    assert_eq!(starts(PREFERRED + 12, &[(3, 5)], 3 * PERIOD), Some(12));
    let other = starts(PREFERRED + 12, &[(3, 12)], 3 * PERIOD).unwrap();
    assert!(![0, 3, 12].contains(&other));
    let all_but_99: Vec<(u8, u8)> = (1..128).filter(|it| *it != 99).map(|it| (it, 0)).collect();
    let mut board = Board::new(&BoardSpec::new(0));
    let mut claimed = None;
    for _ in 0..20 {
        for (from, to) in &all_but_99 {
            board.receive(&KitFrame::classic(request_id(*from, *to, false, 0x155), &[]));
        }
        let acts = board.pass(PERIOD);
        claimed = claimed.or(heartbeats(&acts).first().map(KitFrame::source));
    }
    assert_eq!(claimed, Some(99), "the only free one");
}

#[test]
fn broadcast_destination_is_not_an_address_in_use() {
    let mut board = Board::new(&BoardSpec::new(PREFERRED + 12));
    board.take(&heartbeat(1, *b"BOARD2", true)); // Ends INIT.
    board.receive(&KitFrame::classic(0x0200_0155 | 3 << 17 | 12 << 10, &[]));
    let acts = board.pass(5 * PERIOD);
    assert_eq!(heartbeats(&acts)[0].source(), 12);
}

#[test]
fn other_claim_while_waiting_starts_again() {
    let mut board = Board::new(&BoardSpec::new(PREFERRED + 12));
    board.pass(2 * LISTEN);
    let acts = board.take(&heartbeat(12, *b"BOARD2", false));
    assert!(acts.is_empty(), "silent before, silent after: {acts:?}");
    board.receive(&heartbeat(12, *b"BOARD2", false));
    let acts = board.pass(5 * PERIOD);
    assert_ne!(heartbeats(&acts)[0].source(), 12);
}

#[test]
fn bus_errors_in_init_change_a_preferred_bit_rate() {
    let rates = |bitrate: u8| {
        let mut spec = BoardSpec::new(12);
        spec.bitrate = bitrate;
        let (mut board, mut acts) = Board::starting_at(&spec, 0);
        for _ in 0..4 {
            board.pass(PERIOD / 10);
            board.command("errors 0 520");
            acts.extend(board.poll());
        }
        acts.into_iter()
            .filter_map(|act| match act {
                Act::Bus { rate, silent: true } => Some(rate),
                _ => None,
            })
            .collect::<Vec<u8>>()
    };
    assert_eq!(rates(0x81), [1, 2, 3, 0, 1]);
    assert_eq!(rates(2), [2, 2, 2, 2, 2], "fixed");
}

#[test]
fn frame_in_init_ends_the_bit_rate_search() {
    let mut board = Board::new(&BoardSpec::new(12));
    board.command("errors 0 520");
    board.pass(1000);
    let acts = board.take(&heartbeat(3, *b"BOARD2", true));
    assert_eq!(modes(&acts), [mode::ARSLV]);
    let acts = board.pass(3 * PERIOD);
    assert!(acts.contains(&Act::Bus { rate: 1, silent: false }), "{acts:?}");
}

#[test]
fn error_counter_at_its_limit_leaves_the_bus() {
    let mut board = Board::running(&BoardSpec::new(12));
    board.command("errors 0 127");
    assert!(modes(&board.pass(PERIOD)).is_empty());
    board.command("errors 0 128");
    let acts = board.pass(PERIOD);
    assert_eq!(modes(&acts), [mode::INIT]);
    assert!(acts.contains(&Act::Bus { rate: 0, silent: true }));
    assert!(heartbeats(&board.pass(PERIOD)).is_empty());
}

#[test]
fn working_node_gives_way_to_working_senders_only() {
    let mut board = Board::running(&BoardSpec::new(PREFERRED + 12));
    let acts = board.take(&heartbeat(12, *b"BOARD2", false));
    assert!(modes(&acts).is_empty(), "a claim");
    let acts = board.take(&heartbeat(12, *b"BOARD2", true));
    assert_eq!(acts, [Act::Bus { rate: 0, silent: true }, Act::Mode(mode::ARSLV)]);
    board.receive(&heartbeat(12, *b"BOARD2", true));
    let acts = board.pass(4 * PERIOD);
    let address = heartbeats(&acts)[0].source();
    assert!(address != 12 && address != 0);
    assert_eq!(modes(&acts), [mode::WORK]);
}

#[test]
fn configured_node_gives_way_to_every_sender() {
    let mut spec = BoardSpec::new(12);
    spec.autostart = false;
    let mut board = Board::running(&spec);
    let acts = board.take(&heartbeat(12, *b"BOARD2", false));
    assert_eq!(modes(&acts), [mode::ARSLV]);
}

#[test]
fn idle_node_keeps_its_address() {
    let mut board = Board::running(&BoardSpec::new(12));
    board.command("mode 0 6");
    assert_eq!(modes(&board.poll()), [mode::IDLE]);
    let acts = board.take(&heartbeat(12, *b"BOARD2", true));
    assert!(modes(&acts).is_empty(), "{acts:?}");
}

#[test]
fn start_mode_follows_the_settings() {
    let started = |change: fn(&mut BoardSpec)| {
        let mut spec = BoardSpec::new(12);
        change(&mut spec);
        let mut board = Board::new(&spec);
        *modes(&board.pass(5 * PERIOD)).last().unwrap()
    };
    assert_eq!(started(|_| {}), mode::WORK);
    assert_eq!(started(|spec| spec.autostart = false), mode::CFG);
    assert_eq!(started(|spec| spec.address = 0), mode::CFG);
    assert_eq!(started(|spec| spec.uid = [0; 6]), mode::CFG);
    assert_eq!(started(|spec| spec.uid = [0xFF; 6]), mode::CFG);
}

#[test]
fn limit_and_error_change_the_mode() {
    let mut board = Board::running(&BoardSpec::new(12));
    board.command("fault 0 7");
    let acts = board.pass(PERIOD);
    assert_eq!(modes(&acts), [mode::UFUNC]);
    assert_eq!(heartbeats(&acts)[0].data, *b"BOARD1\x05\x07");
    board.command("fault 0 0");
    assert_eq!(modes(&board.poll()), [mode::WORK]);
    board.command("limit 0 2");
    assert_eq!(modes(&board.poll()), [mode::CFG]);
    board.command("mode 0 4");
    assert!(modes(&board.poll()).is_empty());
    board.command("limit 0 3");
    assert_eq!(modes(&board.poll()), [mode::BOOT]);
    let services = KitFrame::classic(request_id(0, 12, true, 2), super::SERVICES);
    assert_eq!(board.exchange(&services)[0].data, [1, 2], "no services in BOOT");
    board.command("limit 0 4");
    board.command("mode 0 4");
    assert_eq!(modes(&board.poll()), [mode::WORK]);
}

#[test]
fn working_node_with_the_same_uid_ends_work() {
    let mut board = Board::running(&BoardSpec::new(12));
    board.receive(&heartbeat(40, *b"BOARD1", false));
    assert!(modes(&board.poll()).is_empty(), "it does not work");
    board.receive(&heartbeat(40, *b"BOARD1", true));
    assert_eq!(modes(&board.poll()), [mode::CFG]);
    board.command("mode 0 4");
    assert!(modes(&board.pass(6 * PERIOD)).is_empty());
    board.command("mode 0 4");
    assert_eq!(modes(&board.poll()), [mode::WORK], "the other is gone");
}

#[test]
fn heartbeats_keep_their_phase_across_the_wrap_of_time() {
    let start = 0u32.wrapping_sub(6 * PERIOD);
    let (mut board, _) = Board::starting_at(&BoardSpec::new(12), start);
    let acts = board.pass_timed(12 * PERIOD);
    let beats: Vec<u32> = acts
        .iter()
        .filter(|(_, act)| matches!(act, Act::Send { slot: 0, frame } if !frame.once))
        .map(|(at, _)| *at)
        .collect();
    assert!(beats.len() >= 8, "{beats:?}");
    assert!(beats.windows(2).all(|pair| pair[1].wrapping_sub(pair[0]) == PERIOD), "{beats:?}");
    assert!(beats[0] > start && *beats.last().unwrap() < start, "over the wrap");
}

#[test]
fn node_sends_nothing_and_answers_nothing_before_its_claim() {
    let mut board = Board::new(&BoardSpec::new(12));
    for _ in 0..3 {
        let acts = board.receive(&des_request(NAME));
        assert!(heartbeats(&acts).is_empty() && super::responses(&acts).is_empty());
        let acts = board.pass(PERIOD / 2);
        assert!(heartbeats(&acts).is_empty() && super::responses(&acts).is_empty());
    }
}

#[test]
fn two_nodes_with_one_address_end_at_two() {
    for seed in 0..20u32 {
        let mut specs = [BoardSpec::new(PREFERRED + 12), BoardSpec::new(PREFERRED + 12)];
        specs[1].uid = *b"BOARD2";
        for (number, spec) in (0u32..).zip(&mut specs) {
            spec.entropy = 1 + seed * 7 + number;
        }
        let mut bus = TestBus::new(&specs);
        bus.switch_on(0);
        bus.pass(u64::from(seed) * 100_000);
        bus.switch_on(1);
        bus.pass(20 * u64::from(PERIOD));
        assert_eq!((bus.mode(0), bus.mode(1)), (mode::WORK, mode::WORK), "seed {seed}");
        let (one, two) = (bus.address(0).unwrap(), bus.address(1).unwrap());
        assert!(one != two && (one == 12 || two == 12), "seed {seed}: {one} {two}");
    }
}

#[test]
fn fresh_boards_end_at_different_addresses() {
    let spec = |entropy| BoardSpec { uid: [0; 6], autostart: false, entropy, ..BoardSpec::new(0) };
    let specs: Vec<BoardSpec> = (0..8).map(|number| spec(0x1000 + number)).collect();
    let mut bus = TestBus::new(&specs);
    for number in 0..specs.len() {
        bus.switch_on(number);
    }
    bus.pass(30 * u64::from(PERIOD));
    let mut addresses: Vec<u8> =
        (0..specs.len()).map(|number| bus.address(number).unwrap()).collect();
    addresses.sort_unstable();
    addresses.dedup();
    assert_eq!(addresses.len(), specs.len());
    assert!((0..specs.len()).all(|number| bus.mode(number) == mode::CFG));
}

#[test]
fn third_node_finds_the_bit_rate_of_two_others() {
    let spec = |address, uid: &[u8; 6], bitrate| BoardSpec {
        uid: *uid,
        bitrate,
        ..BoardSpec::new(address)
    };
    let specs = [spec(12, b"BOARD1", 2), spec(13, b"BOARD2", 2), spec(14, b"BOARD3", 0x80)];
    let mut bus = TestBus::new(&specs);
    bus.switch_on(0);
    bus.switch_on(1);
    bus.pass(8 * u64::from(PERIOD));
    let before = bus.log.len();
    bus.switch_on(2);
    bus.pass(10 * u64::from(PERIOD));
    assert_eq!((bus.nodes[2].rate, bus.mode(2), bus.address(2)), (2, mode::WORK, Some(14)));
    let others = bus.log[before..].iter().filter(|(_, sender, _)| *sender < 2).count();
    assert_eq!(others, 20, "nothing is destroyed");
}

#[test]
fn rebooted_node_returns_to_its_address() {
    let mut specs = [BoardSpec::new(PREFERRED + 12), BoardSpec::new(PREFERRED + 13)];
    specs[1].uid = *b"BOARD2";
    let mut bus = TestBus::new(&specs);
    bus.switch_on(0);
    bus.switch_on(1);
    bus.pass(8 * u64::from(PERIOD));
    bus.switch_off(0);
    bus.pass(u64::from(PERIOD) / 2);
    bus.switch_on(0);
    bus.pass(8 * u64::from(PERIOD));
    assert_eq!((bus.address(0), bus.mode(0)), (Some(12), mode::WORK));
}

#[test]
fn heartbeat_that_waits_does_not_delay_responses() {
    let mut board = Board::running(&BoardSpec::new(12));
    board.holds = true;
    let first = board.pass_timed(PERIOD);
    assert!(matches!(first[..], [(_, Act::Send { slot: 0, .. })]), "{first:?}");
    let acts = board.pass(3 * PERIOD);
    assert!(heartbeats(&acts).is_empty(), "one at a time: {acts:?}");
    assert_eq!(board.exchange(&des_request(NAME)).len(), 1);
    // Those that were left out are not made up for, and the phase is kept.
    board.driver.run("result 0 0 1");
    board.holds = false;
    let next = board.pass_timed(2 * PERIOD);
    let times: Vec<u32> = next
        .iter()
        .filter(|(_, act)| matches!(act, Act::Send { slot: 0, .. }))
        .map(|(at, _)| *at)
        .collect();
    assert_eq!(times.len(), 2, "{next:?}");
    assert!(times.iter().all(|at| (at - first[0].0) % PERIOD < 2000), "{times:?}");
}

#[test]
fn filters_pass_what_the_kit_needs() {
    let mut board = Board::running(&BoardSpec::new(12));
    let mut passes = |id: u32| !board.command(&format!("filters 0 {id:08X}")).is_empty();
    assert!(passes(request_id(0, 12, false, 2)) && passes(request_id(0, 12, true, 0x10)));
    assert!(passes(0x0200_0002 | 99 << 10), "name request to all");
    assert!(passes(heartbeat(40, *b"BOARD2", true).id));
    assert!(passes(0x0500_0155 | 12 << 17 | 3 << 10), "from its own address");
    assert!(!passes(request_id(0, 13, false, 2)));
    assert!(!passes(0x0600_0155 | 40 << 17 | 12 << 10), "data to all");
}
