//! Arbitration, merging, bus errors, acknowledgement, error counters.

use super::{after, is_error, polled, two_stations};
use descan::frame::bits::FrameBits;
use descan::frame::{CanId, Frame, FrameKind};
use descan::sim::{ControllerState, Scenario, Sim};
use descan::time::{Duration, Instant};

#[test]
fn lowest_identifier_wins_arbitration() {
    let (mut sim, one, two) = two_stations();
    let watcher = sim.attach();
    for (station, id, byte) in
        [(one, 0x300, 0), (two, 0x200, 1), (one, 0x100, 2), (two, 0x400, 3), (one, 0x100, 4)]
    {
        assert!(sim.transmit(station, Frame::classic(id, &[byte])));
    }
    sim.transmit(two, Frame::new(CanId::Standard(0), &[5]));
    sim.transmit(two, Frame::new(CanId::Standard(1), &[6]));
    let order: Vec<u8> =
        after(&mut sim, watcher, 100).iter().map(|frame| frame.data()[0]).collect();
    // The standard identifier 0 begins as the extended ones do, and ends before them; 1 is more
    // than their first eleven bits.
    assert_eq!(order, [5, 2, 4, 1, 0, 3, 6]);
}

#[test]
fn frame_duration_equals_its_bits() {
    let (mut sim, one, two) = two_stations();
    let frame = Frame::classic(0x0AAA_A555, &[1, 2, 3]);
    sim.transmit(one, frame);
    sim.transmit(one, frame);
    let bits = u64::from(FrameBits::of(&frame).total());
    let seen = after(&mut sim, two, 100);
    assert_eq!(seen[0].time, Instant::from_micros((bits - 3) * 8), "ends before intermission");
    assert_eq!(seen[1].time.since(seen[0].time), Duration::from_micros(bits * 8));
    assert_eq!(sim.frame_duration(&frame), Duration::from_micros(bits * 8));
    let totals = sim.statistics();
    assert_eq!((totals.frames, totals.bits), (2, 2 * bits));
    assert_eq!(totals.busy_nanos, 2 * bits * 8000);
}

#[test]
fn sender_gets_loopback_after_transmission() {
    let (mut sim, one, two) = two_stations();
    sim.transmit(one, Frame::classic(5, &[1]));
    assert_eq!(sim.poll_frame(one), None);
    let (own, seen) = (after(&mut sim, one, 10), polled(&mut sim, two));
    assert!(own.len() == 1 && own[0].is_tx, "{own:?}");
    assert!(seen.len() == 1 && !seen[0].is_tx, "{seen:?}");
}

#[test]
fn equal_simultaneous_frames_merge() {
    let (mut sim, one, two) = two_stations();
    let watcher = sim.attach();
    sim.transmit(one, Frame::classic(5, &[1, 2]));
    sim.transmit(two, Frame::classic(5, &[1, 2]));
    assert_eq!(after(&mut sim, watcher, 10).len(), 1);
    for station in [one, two] {
        let own = polled(&mut sim, station);
        assert!(own.len() == 1 && own[0].is_tx, "each believes it sent it: {own:?}");
    }
}

#[test]
fn equal_frames_merge_only_with_ack_of_third_node() {
    let (mut sim, one, two) = two_stations();
    sim.transmit(one, Frame::classic(5, &[1]));
    sim.transmit(two, Frame::classic(5, &[1]));
    assert!(after(&mut sim, one, 20).iter().all(is_error));
}

#[test]
fn different_data_collides_until_error_passive() {
    let (mut sim, one, two) = two_stations();
    let watcher = sim.attach();
    sim.transmit(one, Frame::classic(5, &[0x00]));
    sim.transmit(two, Frame::classic(5, &[0x80]));
    // One bit of data, 8 bits of error flags: the first error has ended.
    sim.advance(Instant::from_micros(60 * 8));
    assert_eq!((sim.status(one).tec, sim.status(two).tec), (8, 8));
    assert_eq!(sim.status(watcher).rec, 1);
    let seen = after(&mut sim, watcher, 100);
    let errors = seen.iter().filter(|frame| is_error(frame)).count();
    assert_eq!(errors, 16, "16 × 8 is error-passive");
    // Then the recessive sender no longer destroys the other frame, and sends its own after it.
    let data: Vec<u8> =
        seen.iter().filter(|frame| !is_error(frame)).map(|frame| frame.data()[0]).collect();
    assert_eq!(data, [0x00, 0x80]);
    assert_eq!((sim.status(one).tec, sim.status(two).tec), (127, 135));
    assert_eq!(sim.status(two).state, ControllerState::ErrorPassive);
    assert_eq!(sim.status(watcher).rec, 14, "two good frames");
}

#[test]
fn error_frames_match_linux() {
    let (mut sim, one, two) = two_stations();
    let watcher = sim.attach();
    sim.transmit(one, Frame::classic(5, &[0x00]));
    sim.transmit(two, Frame::classic(5, &[0x80]));
    sim.advance(Instant::from_micros(600));
    let [sent, ..] = polled(&mut sim, one)[..] else { panic!("no report") };
    let [seen, ..] = polled(&mut sim, watcher)[..] else { panic!("no report") };
    // PROT | BUSERROR | CNT; kind TX | BIT, place DATA, TEC 8 – and STUFF, REC 1.
    assert_eq!(sent.to_string(), "20000288#0000810A00000800");
    assert_eq!(seen.to_string(), "20000288#0000040000000001");
}

#[test]
fn bridged_frame_does_not_affect_waiting_frames() {
    let (mut sim, one, two) = two_stations();
    let watcher = sim.attach();
    for _ in 0..40 {
        for others in [&[0x80], &[0x00]] {
            sim.transmit(one, Frame::classic(5, &[0x00]));
            sim.forward(two, Frame::classic(5, others));
            let seen: Vec<_> = after(&mut sim, watcher, 10).iter().map(Frame::to_string).collect();
            assert_eq!(seen, [format!("00000005#{:02X}", others[0]), "00000005#00".into()]);
        }
    }
    let kept = polled(&mut sim, two);
    assert_eq!(kept.iter().filter(|frame| frame.is_tx).count(), 80);
    assert_eq!(kept.len(), 160);
    for station in [one, two, watcher] {
        let status = sim.status(station);
        assert_eq!((status.state, status.tec, status.rec), (ControllerState::ErrorActive, 0, 0));
    }
}

#[test]
fn repeated_tx_errors_cause_bus_off_and_restart() {
    let (mut sim, one, two) = two_stations();
    sim.attach();
    let mut log = Vec::new();
    for _ in 0..40 {
        sim.transmit(one, Frame::classic(5, &[0x00]));
        sim.transmit(two, Frame::classic(5, &[0x80]));
        log.extend(after(&mut sim, two, 100));
    }
    assert_eq!(sim.status(two).state, ControllerState::BusOff);
    assert_ne!(sim.status(one).state, ControllerState::BusOff);
    assert!(!sim.transmit(two, Frame::classic(6, &[])), "bus-off takes no frames");
    let classes: Vec<u32> = log
        .iter()
        .filter(|frame| is_error(frame))
        .map(|frame| match frame.id {
            CanId::Extended(id) => id & 0x1FF,
            CanId::Standard(_) => 0,
        })
        .collect();
    // Warning, passive (CRTL), then BUSOFF last.
    assert!(classes.contains(&0x04));
    assert_eq!(classes.iter().rfind(|class| **class != 0x88), Some(&0x40));
    assert!(after(&mut sim, two, 1000).is_empty());
    sim.set_link(two, true);
    assert_eq!(sim.status(two).state, ControllerState::ErrorActive);
    assert!(sim.transmit(two, Frame::classic(6, &[])));
    assert!(after(&mut sim, two, 100).iter().any(|frame| frame.is_tx));
}

#[test]
fn single_node_gets_no_ack_and_no_bus_off() {
    let mut sim = Sim::new(&Scenario::new(500_000), 1);
    let me = sim.attach();
    sim.transmit(me, Frame::classic(5, &[1]));
    let seen = after(&mut sim, me, 1000);
    assert!(seen.iter().all(is_error));
    // ACK | BUSERROR | CNT, place ACK.
    assert_eq!(seen[0].to_string(), "200002A0#0000001900000800");
    let status = sim.status(me);
    assert_eq!((status.state, status.tec, status.queued), (ControllerState::ErrorPassive, 128, 1));
    // A listen-only node acknowledges nothing; an active one does.
    let other = sim.attach();
    sim.set_listen_only(other, true);
    assert!(after(&mut sim, me, 100).iter().all(is_error));
    sim.set_listen_only(other, false);
    assert!(after(&mut sim, me, 100).iter().any(|frame| frame.is_tx));
    assert_eq!(sim.status(me).tec, 127);
}

#[test]
fn listen_only_and_cut_link_transmit_nothing() {
    let (mut sim, one, two) = two_stations();
    sim.set_listen_only(one, true);
    sim.transmit(one, Frame::classic(5, &[]));
    assert!(after(&mut sim, two, 100).is_empty());
    sim.set_link(one, false);
    assert_eq!(sim.status(one).state, ControllerState::Down);
    assert!(!sim.transmit(one, Frame::classic(5, &[])));
    sim.set_link(one, true);
    sim.set_listen_only(one, false);
    assert!(after(&mut sim, two, 100).is_empty());
}

#[test]
fn wrong_bit_rate_breaks_bus_unless_listen_only() {
    let (mut sim, one, two) = two_stations();
    let stranger = sim.attach();
    sim.set_bitrate(stranger, 250_000);
    sim.set_listen_only(stranger, true);
    sim.transmit(one, Frame::classic(5, &[]));
    assert_eq!(after(&mut sim, two, 10).len(), 1);
    let heard = polled(&mut sim, stranger);
    assert!(heard.len() == 1 && is_error(&heard[0]), "{heard:?}");
    sim.set_listen_only(stranger, false);
    sim.transmit(one, Frame::classic(5, &[]));
    assert!(is_error(&after(&mut sim, two, 3)[0]));
    sim.set_bitrate(stranger, 125_000);
    assert!(after(&mut sim, two, 10).iter().any(|frame| frame.kind == FrameKind::Data));
}

#[test]
fn disturbed_frames_are_retransmitted() {
    let mut scenario = Scenario::new(125_000);
    scenario.frame_error_probability = 0.2;
    let mut sim = Sim::new(&scenario, 3);
    let (one, two) = (sim.attach(), sim.attach());
    for byte in 0..100 {
        sim.transmit(one, Frame::classic(5, &[byte]));
    }
    let seen = after(&mut sim, two, 1000);
    let data: Vec<u8> =
        seen.iter().filter(|frame| !is_error(frame)).map(|frame| frame.data()[0]).collect();
    assert_eq!(data, (0..100).collect::<Vec<u8>>());
    let errors = seen.len() - data.len();
    assert!((5..60).contains(&errors), "{errors}");
    assert_eq!(sim.statistics().errors, errors as u64);
}

#[test]
fn observer_can_miss_frames_others_receive() {
    let mut scenario = Scenario::new(1_000_000);
    scenario.rx_loss = 0.5;
    let mut sim = Sim::new(&scenario, 3);
    let (one, two) = (sim.attach(), sim.attach());
    for byte in 0..100 {
        sim.transmit(one, Frame::classic(5, &[byte]));
    }
    let seen = after(&mut sim, two, 100).len();
    assert!((20..80).contains(&seen), "{seen}");
    assert_eq!(sim.status(two).rx_lost, 100 - seen as u64);
    assert_eq!(polled(&mut sim, one).len(), 100, "its own are never lost");
}

#[test]
fn fd_frames_use_the_data_bit_rate() {
    let mut scenario = Scenario::new(500_000);
    scenario.data_bitrate = 5_000_000;
    let mut sim = Sim::new(&scenario, 1);
    let (one, two) = (sim.attach(), sim.attach());
    let frame = Frame::fd(0x0AAA_A555, &[0x55; 64], 0xCC);
    sim.transmit(one, frame);
    let seen = after(&mut sim, two, 10);
    assert!(seen[0].same_on_wire(&frame));
    let bits = FrameBits::of(&frame);
    let nanos = u64::from(bits.nominal) * 2000 + u64::from(bits.data) * 200;
    assert_eq!(sim.statistics().busy_nanos, nanos);
}

#[test]
fn full_transmit_queue_rejects_and_counts() {
    let mut sim = Sim::new(&Scenario::new(125_000), 1);
    let me = sim.attach();
    let taken = (0..2000).filter(|_| sim.transmit(me, Frame::classic(5, &[]))).count();
    assert_eq!(taken, 1024);
    assert_eq!(sim.status(me).tx_rejected, 2000 - 1024);
}
