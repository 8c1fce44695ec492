//! Heartbeat periods that are measured, not assumed: slow and fast devices, lost heartbeats, boards
//! that take turns. The engine listens only, without a profile of the user.

use descan::discovery::{Config, Engine, Event, EventKind, Presence};
use descan::finding::{FindingKind, FindingState};
use descan::frame::Frame;
use descan::time::{Duration, Instant};

/// One sender of heartbeats.
#[derive(Clone, Copy)]
struct Sender {
    address: u32,
    uid: [u8; 6],
    period: u64,
    phase: u64,
}

impl Sender {
    /// A sender with a UID made from its number; times in milliseconds.
    fn new(address: u32, number: u8, period: u64, phase: u64) -> Self {
        Self { address, uid: [number, 0x27, 0x51, number, 0x33, 0x11], period, phase }
    }

    fn heartbeat(&self, at: u64, rnd7: u32) -> Frame {
        let id = 0x0700_0001 | self.address << 17 | rnd7 << 10;
        let data = [&self.uid[..], &[4, 0]].concat();
        Frame::classic(id, &data).with_time(Instant::from_micros(at * 1000))
    }
}

/// What an engine reports about a sequence of frames.
struct Report {
    engine: Engine,
    events: Vec<Event>,
}

impl Report {
    /// Passes the frames to an engine, which listens until `end`, in milliseconds.
    fn of(mut frames: Vec<Frame>, end: u64) -> Self {
        frames.sort_by_key(|frame| frame.time);
        let config = Config { listen_only: true, ..Config::default() };
        let mut engine = Engine::new(Instant::ZERO, config);
        let mut events = Vec::new();
        let end = Instant::from_micros(end * 1000);
        for frame in frames.into_iter().map(Some).chain([None]) {
            let at = frame.map_or(end, |frame| frame.time);
            while let Some(due) = engine.poll_timeout().filter(|due| *due <= at) {
                engine.handle_timeout(due);
            }
            if let Some(frame) = frame {
                engine.handle_frame(&frame);
            }
            events.extend(std::iter::from_fn(|| engine.poll_event()));
        }
        Self { engine, events }
    }

    /// Returns the time from the start to the first confirmation of a conflict.
    fn confirmed_after(&self) -> Option<Duration> {
        let confirmed = self.events.iter().find(|event| {
            matches!(&event.kind, EventKind::Finding { key, state }
                if key.kind.is_conflict() && *state == FindingState::Confirmed)
        });
        confirmed.map(|event| event.time.since(Instant::ZERO))
    }
}

/// Heartbeats of a sender in a time span in milliseconds, each lost with a probability.
fn heartbeats(
    sender: Sender,
    span: std::ops::Range<u64>,
    loss: f64,
    rng: &mut fastrand::Rng,
) -> Vec<Frame> {
    let mut frames = Vec::new();
    let mut at = span.start + sender.phase;
    while at < span.end {
        let rnd7 = rng.u32(..128);
        if rng.f64() >= loss {
            frames.push(sender.heartbeat(at, rnd7));
        }
        at += sender.period;
    }
    frames
}

#[test]
fn healthy_devices_of_any_period_raise_no_events() {
    for period in [200, 700, 1000, 1500, 2000, 3000, 4500] {
        let mut rng = fastrand::Rng::with_seed(period);
        let senders = (1..=8).map(|n| Sender::new(n, n as u8, period, rng.u64(..period)));
        let senders: Vec<Sender> = senders.collect();
        let frames = senders.iter().flat_map(|it| heartbeats(*it, 0..60_000, 0.0, &mut rng));
        let report = Report::of(frames.collect(), 60_000);
        let odd: Vec<_> = report
            .events
            .iter()
            .filter(|event| {
                matches!(
                    event.kind,
                    EventKind::Presence(_)
                        | EventKind::Returned { .. }
                        | EventKind::Rebooted
                        | EventKind::Finding { .. }
                )
            })
            .collect();
        assert!(odd.is_empty(), "{period} ms: {odd:?}");
        assert_eq!(report.engine.devices().len(), 8, "{period} ms");
        let missed: u64 = report.engine.devices().iter().map(|it| it.heartbeat.missed).sum();
        assert_eq!(missed, 0, "{period} ms");
    }
}

#[test]
fn slow_device_among_others_is_lost_twice_at_most() {
    for period in [3000, 5000, 8000, 20_000] {
        let mut rng = fastrand::Rng::with_seed(period);
        let others = (1..=8).map(|n| Sender::new(n, n as u8, 1000, rng.u64(..1000)));
        let mut senders: Vec<Sender> = others.collect();
        senders.push(Sender::new(20, 20, period, 500));
        let end = period * 6;
        let frames = senders.iter().flat_map(|it| heartbeats(*it, 0..end, 0.0, &mut rng));
        let report = Report::of(frames.collect(), end);
        let is_lost = |event: &&Event| {
            matches!(event.kind, EventKind::Presence(Presence::Stale | Presence::Lost))
        };
        let lost: Vec<_> = report.events.iter().filter(is_lost).collect();
        let most = if period > 10_000 { 4 } else { 2 };
        assert!(lost.len() <= most, "{period} ms: {lost:?}");
    }
}

#[test]
fn silent_device_is_lost_after_five_of_its_own_periods() {
    for period in [500, 1000, 3000] {
        let mut rng = fastrand::Rng::with_seed(period);
        let end = 20 * period;
        let mut frames = heartbeats(Sender::new(1, 1, period, 0), 0..end, 0.0, &mut rng);
        frames.extend(heartbeats(Sender::new(2, 2, period, 300), 0..2 * end, 0.0, &mut rng));
        frames.extend(heartbeats(Sender::new(3, 3, period, 400), 0..2 * end, 0.0, &mut rng));
        let report = Report::of(frames, 2 * end);
        let lost = report
            .events
            .iter()
            .find(|event| matches!(event.kind, EventKind::Presence(Presence::Lost)));
        let before = Instant::from_micros((end - period) * 1000);
        let after = lost.expect("it is lost").time.since(before);
        assert_eq!(after, Duration::from_millis(5 * period), "{period} ms");
    }
}

#[test]
fn two_uids_at_one_address_are_confirmed_at_any_period() {
    for period in [200, 1000, 3000] {
        for phase in [50, 300, 500, 700] {
            let phase = phase * period / 1000;
            let mut rng = fastrand::Rng::with_seed(phase);
            let mut frames = heartbeats(Sender::new(9, 1, period, 0), 0..60_000, 0.0, &mut rng);
            frames.extend(heartbeats(Sender::new(9, 2, period, phase), 0..60_000, 0.0, &mut rng));
            frames.extend(heartbeats(Sender::new(10, 3, period, 100), 0..60_000, 0.0, &mut rng));
            let report = Report::of(frames, 60_000);
            let after = report.confirmed_after().expect("two devices are confirmed");
            let limit = Duration::from_millis(period * 10).max(Duration::from_secs(10));
            assert!(after <= limit, "every {period} ms, {phase} ms apart: after {after:?}");
        }
    }
}

#[test]
fn two_uids_with_lost_heartbeats_are_confirmed_within_20_s() {
    for seed in 0..300 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let phase = rng.u64(20..980);
        let mut frames = heartbeats(Sender::new(9, 1, 1000, 0), 0..20_000, 0.3, &mut rng);
        frames.extend(heartbeats(Sender::new(9, 2, 1000, phase), 0..20_000, 0.3, &mut rng));
        let report = Report::of(frames, 20_000);
        assert!(report.confirmed_after().is_some(), "seed {seed}, {phase} ms apart");
    }
}

#[test]
fn boards_swapped_to_and_fro_are_never_confirmed() {
    for seed in 0..300 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let (mut frames, mut at, mut number) = (Vec::new(), 0, 1);
        while at < 60_000 {
            let until = at + rng.u64(3000..5000);
            let sender = Sender::new(9, number, 1000, rng.u64(..900));
            frames.extend(heartbeats(sender, at..until, 0.3, &mut rng));
            (at, number) = (until, 3 - number);
        }
        let report = Report::of(frames, 60_000);
        let findings = report.engine.findings().iter();
        let findings: Vec<FindingKind> = findings.map(|finding| finding.key.kind).collect();
        assert!(report.confirmed_after().is_none(), "seed {seed}: {findings:?}");
    }
}
