//! Verdicts on logs that look like a conflict and are none, or the other way round: heartbeats of
//! unusual periods, with losses, in unusual phases, repeated by gateways, or of boards in turns.

use descan::discovery::{Config, Engine, EventKind};
use descan::finding::{FindingKind, FindingState};
use descan::frame::Frame;
use descan::time::{Duration, Instant};
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::Mode;
use descan::wire::profile::Profile;

const ADDRESS: u8 = 14;

fn micros(seconds: f64) -> u64 {
    (seconds * 1e6) as u64
}

/// Frames of a log, in any order.
struct LogWriter {
    rng: fastrand::Rng,
    frames: Vec<Frame>,
}

/// Findings at the address of a log.
struct Verdicts {
    confirmed: Vec<(f64, FindingKind)>,
    cleared: Vec<(f64, FindingKind)>,
    /// Open findings at the end.
    open: Vec<FindingKind>,
    /// Kinds of all findings there.
    kinds: Vec<FindingKind>,
}

impl Verdicts {
    /// Returns true if a finding was confirmed last before `until`, not cleared.
    fn was_confirmed(&self, until: f64) -> bool {
        let last = |changes: &[(f64, FindingKind)]| {
            changes.iter().map(|change| change.0).filter(|at| *at < until).fold(0.0, f64::max)
        };
        last(&self.confirmed) > last(&self.cleared)
    }
}

impl LogWriter {
    fn new(seed: u64) -> Self {
        Self { rng: fastrand::Rng::with_seed(seed), frames: Vec::new() }
    }

    fn push(&mut self, at: f64, id: u32, data: &[u8]) {
        let time = Instant::from_micros(micros(at));
        self.frames.push(Frame::classic(id, data).with_time(time));
    }

    /// A heartbeat in WORK, with a jitter of 1 ms.
    fn heartbeat(&mut self, at: f64, address: u8, uid: u8) {
        self.heartbeat_in(Mode::Work, at, address, uid);
    }

    fn heartbeat_in(&mut self, mode: Mode, at: f64, address: u8, uid: u8) {
        let rnd7 = self.rng.u8(..128);
        let node = Address::new(address).unwrap();
        let service = Profile::default().heartbeat_service();
        let is_working = mode.is_working() == Some(true);
        let id = Header::unsolicited(node, rnd7, !is_working, service).encode();
        let at = at + f64::from(self.rng.u16(..1000)) / 1e6;
        // Codes of the default profile: in the order of the modes.
        self.push(at, id, &[uid, uid, uid, uid, uid, uid, mode as u8, 0]);
    }

    /// Heartbeats of one device, of which a share is lost.
    fn heartbeats(&mut self, uid: u8, period: f64, (from, until): (f64, f64), loss: f64) {
        let mut at = from;
        while at < until {
            if self.rng.f64() >= loss {
                self.heartbeat(at, ADDRESS, uid);
            }
            at += period;
        }
    }

    /// A name request to the address, and a response after each of these delays, in seconds.
    fn name_query(&mut self, at: f64, responses: &[(f64, &str)]) {
        let node = Address::new(ADDRESS).unwrap();
        let request = Header::request(Address::new(5).unwrap(), node, false, des());
        self.push(at, request.encode(), b"\x04DES\x01");
        let id = request.response(node, false).encode();
        for (delay, name) in responses {
            let data = [&[name.len() as u8 + 2, 1], name.as_bytes(), &[0]].concat();
            self.push(at + delay, id, &data);
        }
    }

    /// A services request to the address, the first frame of the response, and flow control for it.
    fn aborted_transfer(&mut self, at: f64, has_flow_control: bool) {
        let node = Address::new(ADDRESS).unwrap();
        let request = Header::request(Address::new(5).unwrap(), node, false, des());
        self.push(at, request.encode(), b"\x04DES\x02");
        let id = request.response(node, false).encode();
        self.push(at + 0.002, id, b"\x10\x20\x02\x01DES\0");
        if has_flow_control {
            self.push(at + 0.004, request.encode(), &[0x30, 0, 0]);
        }
    }

    /// A services request to the address, the whole response, and flow control for it.
    fn whole_transfer(&mut self, at: f64) {
        let node = Address::new(ADDRESS).unwrap();
        let request = Header::request(Address::new(5).unwrap(), node, false, des());
        self.push(at, request.encode(), b"\x04DES\x02");
        let id = request.response(node, false).encode();
        self.push(at + 0.002, id, b"\x10\x0a\x02\0DES\0");
        self.push(at + 0.004, request.encode(), &[0x30, 0, 0]);
        self.push(at + 0.006, id, b"\x211.0\0");
    }

    /// Plays the log to an inspector in listen-only mode.
    fn verdicts(mut self, end: f64) -> Verdicts {
        self.frames.sort_by_key(|frame| frame.time);
        let config = Config { listen_only: true, ..Config::default() };
        let mut engine = Engine::new(Instant::ZERO, config);
        let end = Instant::from_micros(micros(end));
        let run_until = |engine: &mut Engine, until: Instant| {
            while let Some(due) = engine.poll_timeout().filter(|due| *due <= until) {
                engine.handle_timeout(due);
            }
        };
        for frame in &self.frames {
            run_until(&mut engine, frame.time);
            engine.handle_frame(frame);
        }
        run_until(&mut engine, end);
        let (mut confirmed, mut cleared) = (Vec::new(), Vec::new());
        while let Some(event) = engine.poll_event() {
            let at = event.time.since(Instant::ZERO).as_secs_f64();
            match event.kind {
                EventKind::Finding { key, state: FindingState::Confirmed } => {
                    confirmed.push((at, key.kind));
                }
                EventKind::Finding { key, state: FindingState::Cleared } => {
                    cleared.push((at, key.kind));
                }
                _ => {}
            }
        }
        let findings = engine.findings();
        let open = findings.iter().filter(|it| it.state != FindingState::Cleared);
        let open = open.map(|it| it.key.kind).collect();
        Verdicts {
            confirmed,
            cleared,
            open,
            kinds: findings.iter().map(|it| it.key.kind).collect(),
        }
    }
}

fn des() -> Service {
    Profile::default().des_service()
}

#[test]
fn fast_heartbeats_with_losses_are_of_one_device() {
    for period in [0.1, 0.2, 0.25, 0.3, 0.5] {
        let confirmed = (0..40).filter(|seed| {
            let mut log = LogWriter::new(*seed);
            log.heartbeats(1, period, (0.1, 60.0), [0.1, 0.2, 0.3, 0.4][*seed as usize % 4]);
            for second in 0..60 {
                log.heartbeat(f64::from(second) + 0.37, 10, 2);
            }
            !log.verdicts(60.0).confirmed.is_empty()
        });
        assert_eq!(confirmed.count(), 0, "period {period} s");
    }
}

#[test]
fn heartbeats_of_two_devices_are_confirmed_in_spite_of_losses() {
    for (other_uid, phase) in [(2, 0.04), (2, 0.45), (1, 0.04), (1, 0.3)] {
        for loss in [0.0, 0.1, 0.2] {
            let missed = (0..20).filter(|seed| {
                let mut log = LogWriter::new(*seed);
                log.heartbeats(1, 1.0, (0.1, 60.0), loss);
                log.heartbeats(other_uid, 1.0, (0.1 + phase, 60.0), loss);
                log.verdicts(60.0).confirmed.is_empty()
            });
            assert_eq!(missed.count(), 0, "UID {other_uid}, phase {phase}, loss {loss}");
        }
    }
}

#[test]
fn conflict_of_two_uids_stays_while_both_send() {
    for seed in 0..40 {
        let mut log = LogWriter::new(seed);
        log.heartbeats(1, 1.0, (0.1, 60.0), 0.2);
        log.heartbeats(2, 1.0, (0.5, 60.0), 0.2);
        let verdicts = log.verdicts(59.0);
        assert_eq!(verdicts.cleared, [], "seed {seed}");
    }
}

#[test]
fn conflict_of_equal_devices_stays_while_both_send() {
    for (phase, loss) in [(0.1, 0.2), (0.3, 0.2), (0.33, 0.2), (0.45, 0.2), (0.2, 0.3), (0.4, 0.3)]
    {
        for seed in 0..30 {
            let mut log = LogWriter::new(seed);
            log.heartbeats(1, 1.0, (0.1, 120.0), loss);
            let first = times_of(&log.frames);
            log.heartbeats(1, 1.0, (0.1 + phase, 120.0), loss);
            let other = times_of(&log.frames[first.len()..]);
            let verdicts = log.verdicts(119.0);
            let is_wrong = |at: f64| {
                let are_received = is_received(&first, at) && is_received(&other, at);
                // With more losses, what is suspected may be cleared.
                are_received && (loss < 0.3 || verdicts.was_confirmed(at))
            };
            let cleared = verdicts.cleared.iter().map(|it| it.0);
            let wrong: Vec<f64> = cleared.filter(|at| is_wrong(*at)).collect();
            assert!(wrong.is_empty(), "{wrong:?}, phase {phase}, loss {loss}, seed {seed}");
        }
    }
}

#[test]
fn contest_of_blank_uids_for_four_periods_is_not_confirmed() {
    for seed in 0..400 {
        let mut log = LogWriter::new(seed);
        let (phase, shared) = (log.rng.f64(), 4.0 + 0.9 * log.rng.f64());
        let began = 8.0 + phase;
        log.heartbeats(0, 1.0, (0.1, 40.0), 0.0);
        log.heartbeats(0, 1.0, (began, began + shared), 0.0);
        let last = times_of(&log.frames).last().copied().unwrap_or(0.0);
        let confirmed = log.verdicts(40.0).confirmed;
        assert!(confirmed.is_empty(), "{confirmed:?}, seed {seed}, from {began} to {last}");
    }
}

#[test]
fn equal_devices_beside_one_that_restarts_are_confirmed() {
    for (has_second, seed) in (0..40).map(|seed| (seed % 2 == 0, seed)) {
        let mut log = LogWriter::new(seed);
        if has_second {
            log.heartbeats(1, 1.0, (0.1, 40.0), 0.0);
            log.heartbeats(1, 1.0, (0.44, 40.0), 0.0);
        }
        let cycle = 1.2 + 1.5 * log.rng.f64();
        let mut at = 0.2;
        while at < 40.0 {
            log.heartbeat_in(Mode::Arslv, at, ADDRESS, 1);
            log.heartbeat(at + 1.0, ADDRESS, 1);
            at += cycle;
        }
        let confirmed = log.verdicts(40.0).confirmed;
        assert_eq!(!confirmed.is_empty(), has_second, "seed {seed}, {cycle} s: {confirmed:?}");
    }
}

#[test]
fn lost_requests_of_fast_polling_are_not_doubled_answers() {
    for (is_doubled, seed) in (0..40).map(|seed| (seed % 2 == 0, seed)) {
        let mut log = LogWriter::new(seed);
        log.heartbeats(1, 1.0, (0.1, 30.0), 0.0);
        let interval = [0.025, 0.033, 0.05, 0.1][seed as usize / 2 % 4];
        for count in 0..(29.0 / interval) as u32 {
            let at = 0.5 + f64::from(count) * interval;
            let delay = 0.001 + 0.004 * log.rng.f64();
            let both = [(delay, "FEED"), (delay + 0.002, "FEED")];
            let first = log.frames.len();
            log.name_query(at, &both[..=usize::from(is_doubled)]);
            if log.rng.f64() < 0.2 {
                log.frames.remove(first);
            }
        }
        let confirmed = log.verdicts(30.0).confirmed;
        assert_eq!(!confirmed.is_empty(), is_doubled, "seed {seed}, {interval} s: {confirmed:?}");
    }
}

#[test]
fn two_phases_are_confirmed_after_two_names_were_received_once() {
    for phase in [0.1, 0.3, 0.46] {
        for seed in 0..20 {
            let mut log = LogWriter::new(seed);
            log.heartbeats(1, 1.0, (0.1, 30.0), 0.0);
            log.heartbeats(1, 1.0, (0.1 + phase, 30.0), 0.0);
            log.name_query(1.2, &[(0.002, "FEED")]);
            log.name_query(2.2, &[(0.002, "PUMP")]);
            let confirmed = log.verdicts(30.0).confirmed;
            let is_in_time = confirmed.iter().any(|(at, _)| *at < 12.0);
            assert!(is_in_time, "phase {phase}, seed {seed}: {confirmed:?}");
        }
    }
}

/// Returns true if a device sent one of these heartbeats in the last five periods before `until`.
fn is_received(times: &[f64], until: f64) -> bool {
    times.iter().any(|at| (until - 4.999..until).contains(at))
}

/// Returns the times of frames in seconds.
fn times_of(frames: &[Frame]) -> Vec<f64> {
    frames.iter().map(|frame| frame.time.since(Instant::ZERO).as_secs_f64()).collect()
}

#[test]
fn equal_devices_almost_half_a_period_apart_are_confirmed() {
    for phase in [0.485, 0.49, 0.51, 0.516] {
        for seed in 0..10 {
            let mut log = LogWriter::new(seed);
            log.heartbeats(1, 1.0, (0.1, 40.0), 0.0);
            log.heartbeats(1, 1.0, (0.1 + phase, 40.0), 0.0);
            let verdicts = log.verdicts(40.0);
            let kinds: Vec<FindingKind> = verdicts.confirmed.iter().map(|it| it.1).collect();
            assert_eq!(kinds, [FindingKind::SameNameSameAddress], "phase {phase}, seed {seed}");
            assert_eq!(verdicts.open, kinds, "phase {phase}, seed {seed}");
        }
    }
}

#[test]
fn nine_devices_at_one_address_are_confirmed() {
    for seed in 0..20 {
        let mut log = LogWriter::new(seed);
        for place in 0..9 {
            let phase = f64::from(place) / 9.0 + log.rng.f64() * 0.05;
            log.heartbeats(1, 1.0, (0.1 + phase, 30.0), 0.0);
        }
        assert!(!log.verdicts(30.0).confirmed.is_empty(), "seed {seed}");
    }
}

/// Of such a sender some intervals are long and short in turns by chance.
#[test]
fn one_fast_sender_with_much_jitter_is_not_confirmed() {
    for period in [0.2, 0.33, 0.4, 0.5, 0.55, 0.7] {
        for seed in 0..24 {
            let jitter = 0.06 + 0.01 * f64::from(seed as u32 % 3);
            let mut log = LogWriter::new(seed);
            let mut due = 0.1;
            while due < 60.0 {
                // Nearly the normal distribution, in parts of the period.
                let normal: f64 = (0..12).map(|_| log.rng.f64()).sum::<f64>() - 6.0;
                log.heartbeat(due + normal * jitter * period, ADDRESS, 1);
                due += period;
            }
            let confirmed = log.verdicts(60.0).confirmed;
            assert!(confirmed.is_empty(), "{period} s, {jitter}, seed {seed}: {confirmed:?}");
        }
    }
}

/// Some firmware sends a heartbeat with each response, besides those of its period.
#[test]
fn heartbeats_with_responses_are_no_second_sender() {
    for interval in [1.0, 1.5, 2.0, 5.0] {
        for seed in 0..20 {
            let mut log = LogWriter::new(seed);
            log.heartbeats(1, 1.0, (0.1, 60.0), 0.0);
            let mut at = 10.0 + log.rng.f64();
            while at < 40.0 {
                log.name_query(at, &[(0.002, "FEED")]);
                log.heartbeat(at + 0.004, ADDRESS, 1);
                at += interval;
            }
            let verdicts = log.verdicts(60.0);
            assert_eq!(verdicts.confirmed, [], "{interval} s, seed {seed}");
        }
    }
}

/// Some firmware sends a heartbeat at each change of its mode, besides those of its period.
#[test]
fn heartbeats_at_mode_changes_are_no_second_sender() {
    for stay in [1.7, 2.0, 3.1] {
        for seed in 0..20 {
            let mut log = LogWriter::new(seed);
            let mut changes = vec![5.0 + log.rng.f64()];
            (1..20).for_each(|it| changes.push(changes[0] + stay * f64::from(it)));
            let mode =
                |passed: usize| if passed.is_multiple_of(2) { Mode::Work } else { Mode::Ufunc };
            for second in 0..60 {
                let at = f64::from(second) + 0.1;
                let passed = changes.iter().filter(|it| **it < at).count();
                log.heartbeat_in(mode(passed), at, ADDRESS, 1);
            }
            for (number, at) in changes.iter().enumerate() {
                log.heartbeat_in(mode(number + 1), *at, ADDRESS, 1);
            }
            let verdicts = log.verdicts(60.0);
            assert_eq!(verdicts.confirmed, [], "{stay} s, seed {seed}");
        }
    }
}

#[test]
fn heartbeats_at_random_times_are_not_confirmed() {
    for rate in [0.1, 0.2, 0.3] {
        for seed in 0..20 {
            let mut log = LogWriter::new(seed);
            log.heartbeats(1, 1.0, (0.1, 200.0), 0.0);
            let mut at = 0.0;
            while at < 200.0 {
                log.heartbeat(at, ADDRESS, 1);
                at += -(1.0 - log.rng.f64()).ln() / rate;
            }
            let verdicts = log.verdicts(200.0);
            assert_eq!(verdicts.confirmed, [], "{rate}/s, seed {seed}");
        }
    }
}

/// The heartbeats of the second device are not those that its responses prompt.
#[test]
fn two_devices_that_respond_are_confirmed() {
    for phase in [0.1, 0.25, 0.4] {
        for seed in 0..20 {
            let mut log = LogWriter::new(seed);
            log.heartbeats(1, 1.0, (0.1, 60.0), 0.0);
            log.heartbeats(1, 1.0, (0.1 + phase, 60.0), 0.0);
            for number in 0..50 {
                let at = 5.0 + f64::from(number) * (0.9 + 0.2 * log.rng.f64());
                log.name_query(at, &[(0.002, "FEED")]);
            }
            let confirmed = log.verdicts(60.0).confirmed;
            let is_in_time = confirmed.iter().any(|(at, _)| *at < 15.0);
            assert!(is_in_time, "phase {phase}, seed {seed}: {confirmed:?}");
        }
    }
}

#[test]
fn boards_of_two_names_in_turns_are_not_confirmed() {
    for pause in [0.05, 0.5, 2.0] {
        for seed in 0..30 {
            let mut log = LogWriter::new(seed);
            let mut at = 0.1;
            let mut names = Vec::new();
            for turn in 0..8 {
                let stays = 3.0 + log.rng.f64() * 6.0;
                log.heartbeats(1 + turn % 2, 1.0, (at, at + stays), 0.0);
                names.push((at, at + stays, ["FEED", "PUMP"][usize::from(turn) % 2]));
                at += stays + pause;
            }
            for number in 0..10 {
                let request = 2.0 + 5.0 * f64::from(number);
                let there = names.iter().find(|it| it.0 < request && request < it.1);
                let response: Vec<(f64, &str)> =
                    there.map(|it| (0.003, it.2)).into_iter().collect();
                log.name_query(request, &response);
            }
            let verdicts = log.verdicts(60.0);
            assert_eq!(verdicts.confirmed, [], "pause {pause} s, seed {seed}");
        }
    }
}

#[test]
fn replaced_board_found_elsewhere_gave_up_nothing() {
    for seed in 0..20 {
        let mut log = LogWriter::new(seed);
        log.heartbeats(1, 1.0, (0.1, 20.0), 0.0);
        log.heartbeats(2, 1.0, (20.8, 60.0), 0.0);
        for second in 24..60 {
            log.heartbeat(f64::from(second), 33, 1);
        }
        let verdicts = log.verdicts(60.0);
        assert!(!verdicts.kinds.contains(&FindingKind::AddressContested), "seed {seed}");
    }
}

#[test]
fn two_gateways_are_no_conflict() {
    for seed in 0..20 {
        let mut log = LogWriter::new(seed);
        log.heartbeats(1, 1.0, (0.1, 60.0), 0.0);
        for second in 0..60 {
            log.heartbeat(f64::from(second) + 0.55, 10, 2);
        }
        (0..12).for_each(|it| log.name_query(2.7 + 5.0 * f64::from(it), &[(0.003, "FEED")]));
        let of_device: Vec<Frame> =
            log.frames.iter().filter(|it| is_of(it, ADDRESS)).copied().collect();
        for frame in of_device {
            for delay in [9_000, 23_000] {
                let jitter = log.rng.u64(..800);
                let time = frame.time + Duration::from_micros(delay + jitter);
                log.frames.push(frame.with_time(time));
            }
        }
        let verdicts = log.verdicts(60.0);
        assert_eq!(verdicts.confirmed, [], "seed {seed}");
        assert_eq!(verdicts.open, [FindingKind::FramesRepeated], "seed {seed}");
    }
}

#[test]
fn gateway_that_loses_copies_is_no_conflict() {
    for seed in 0..40 {
        let mut log = LogWriter::new(seed);
        log.heartbeats(1, 1.0, (0.1, 60.0), 0.0);
        for second in 0..60 {
            log.heartbeat(f64::from(second) + 0.55, 10, 2);
        }
        (0..12).for_each(|it| log.name_query(2.7 + 5.0 * f64::from(it), &[(0.003, "FEED")]));
        let of_device: Vec<Frame> =
            log.frames.iter().filter(|it| is_of(it, ADDRESS)).copied().collect();
        for frame in of_device {
            if log.rng.f64() >= 0.2 {
                let time = frame.time + Duration::from_micros(27_000 + log.rng.u64(..800));
                log.frames.push(frame.with_time(time));
            }
        }
        let verdicts = log.verdicts(60.0);
        assert_eq!(verdicts.confirmed, [], "seed {seed}");
        assert!(verdicts.kinds.contains(&FindingKind::FramesRepeated), "seed {seed}");
    }
}

#[test]
fn doubled_answers_are_confirmed_between_fast_heartbeats() {
    for period in [0.1, 0.2, 1.0, 3.0] {
        let mut log = LogWriter::new(1);
        log.heartbeats(1, period, (0.1, 60.0), 0.0);
        let responses = [(0.003, "FEED"), (0.009, "FEED")];
        (0..12).for_each(|it| log.name_query(2.74 + 5.0 * f64::from(it), &responses));
        let verdicts = log.verdicts(60.0);
        assert!(
            verdicts.confirmed.iter().any(|it| it.1 == FindingKind::AnswersDoubled),
            "period {period} s: {:?}",
            verdicts.kinds
        );
        assert_eq!(verdicts.cleared, [], "period {period} s");
    }
}

/// Frames of another protocol that conform to a targeted request of the heartbeat service.
#[test]
fn requests_of_the_heartbeat_service_are_no_evidence() {
    let mut log = LogWriter::new(1);
    for second in 0..30 {
        log.heartbeat(f64::from(second) + 0.55, 10, 2);
    }
    for number in 0..300 {
        let data = [0, 0x13, log.rng.u8(..), log.rng.u8(..), 0x7F, log.rng.u8(..), 0xFF, 0xFF];
        log.push(0.05 + 0.1 * f64::from(number), 0x09F2_0001, &data);
    }
    assert_eq!(log.verdicts(30.0).confirmed, []);
}

fn is_of(frame: &Frame, address: u8) -> bool {
    frame.platform_id().is_some_and(|id| Header::decode(id).source.number() == address)
}

#[test]
fn transfer_without_flow_control_is_no_fault_of_the_device() {
    for has_flow_control in [false, true] {
        let mut log = LogWriter::new(1);
        log.heartbeats(1, 1.0, (0.1, 30.0), 0.0);
        for round in 0..10 {
            log.aborted_transfer(f64::from(round) * 2.5 + 0.5, has_flow_control);
        }
        let kinds: Vec<FindingKind> =
            log.verdicts(30.0).confirmed.iter().map(|(_, kind)| *kind).collect();
        let expected: &[FindingKind] =
            if has_flow_control { &[FindingKind::MalformedAnswer] } else { &[] };
        assert_eq!(kinds, expected, "flow control: {has_flow_control}");
    }
}

#[test]
fn transfer_that_always_stops_at_one_place_is_confirmed() {
    for (interval, period) in [(0.3, 1.0), (0.9, 1.0), (6.0, 1.0), (10.0, 1.0), (10.0, 3.0)] {
        let mut log = LogWriter::new(1);
        log.heartbeats(1, period, (0.1, 100.0), 0.0);
        for round in 0..6 {
            log.aborted_transfer(f64::from(round) * interval + 0.5, true);
        }
        let verdicts = log.verdicts(100.0);
        let kinds: Vec<FindingKind> = verdicts.confirmed.iter().map(|(_, kind)| *kind).collect();
        assert_eq!(kinds, [FindingKind::MalformedAnswer], "every {interval} s");
    }
}

#[test]
fn lost_frames_after_a_whole_transfer_are_no_fault() {
    for (whole, aborted, expected) in [
        (1, 4, &[][..]),
        (0, 4, &[FindingKind::MalformedAnswer]),
        (1, 12, &[FindingKind::MalformedAnswer]),
    ] {
        let mut log = LogWriter::new(1);
        log.heartbeats(1, 1.0, (0.1, 60.0), 0.0);
        for round in 0..whole + aborted {
            let at = f64::from(round) * 2.5 + 0.5;
            if round < whole {
                log.whole_transfer(at);
            } else {
                log.aborted_transfer(at, true);
            }
        }
        let verdicts = log.verdicts(60.0);
        let kinds: Vec<FindingKind> = verdicts.confirmed.iter().map(|(_, kind)| *kind).collect();
        assert_eq!(kinds, expected, "{whole} whole, {aborted} aborted");
    }
}

#[test]
fn boards_that_never_leave_address_resolution_are_confirmed() {
    for mode in [Mode::Init, Mode::Arslv] {
        let mut log = LogWriter::new(1);
        for second in 0..30 {
            log.heartbeat_in(mode, f64::from(second) + 0.1, ADDRESS, 1);
            log.heartbeat_in(mode, f64::from(second) + 0.45, ADDRESS, 2);
        }
        let verdicts = log.verdicts(30.0);
        let [(at, FindingKind::OneAddressTwoIdentities)] = verdicts.confirmed[..] else {
            panic!("{}: {:?}", mode.name(), verdicts.confirmed);
        };
        assert!(at < 15.0, "{}: {at} s", mode.name());
    }
}

#[test]
fn late_heartbeats_with_losses_are_of_one_device() {
    for period in [0.3, 0.5, 0.7] {
        let confirmed = (0..40).filter(|seed| {
            let mut log = LogWriter::new(*seed);
            let mut at = 0.1;
            while at < 60.0 {
                let late = if log.rng.f64() < 0.3 { log.rng.f64() * 0.2 * period } else { 0.0 };
                if log.rng.f64() >= 0.3 {
                    log.heartbeat(at + late, ADDRESS, 1);
                }
                at += period;
            }
            !log.verdicts(60.0).confirmed.is_empty()
        });
        assert_eq!(confirmed.count(), 0, "period {period} s");
    }
}

#[test]
fn fast_device_with_late_heartbeats_is_not_confirmed() {
    let mut wrong = Vec::new();
    for period in [0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7, 0.8] {
        for percent in (4..100).step_by(4) {
            let mut log = LogWriter::new(1);
            for beat in 0..(60.0 / period) as u32 {
                let late = if beat % 41 == 40 { f64::from(percent) / 100.0 } else { 0.0 };
                log.heartbeat(0.1 + (f64::from(beat) + late) * period, ADDRESS, 1);
            }
            if !log.verdicts(60.0).confirmed.is_empty() {
                wrong.push(format!("{period} s, {percent} % late"));
            }
        }
    }
    assert!(wrong.is_empty(), "confirmed: {wrong:?}");
}

#[test]
fn third_device_in_a_sixth_of_the_period_is_confirmed() {
    for phases in [&[0.0, 0.5, 0.667][..], &[0.0, 0.333, 0.5], &[0.0, 0.167]] {
        let mut log = LogWriter::new(1);
        for phase in phases {
            log.heartbeats(1, 1.0, (0.1 + phase, 20.0), 0.0);
        }
        let [(at, FindingKind::SameNameSameAddress)] = log.verdicts(20.0).confirmed[..] else {
            panic!("{phases:?}");
        };
        assert!(at < 10.0, "{phases:?}: {at} s");
    }
}

#[test]
fn fast_device_whose_phase_changes_is_not_confirmed() {
    for period in [0.1, 0.25, 0.3, 0.5, 0.7] {
        for seed in 0..20 {
            let mut log = LogWriter::new(seed);
            let loss = f64::from(seed as u32 % 4) / 10.0;
            log.heartbeats(1, period, (0.1 + 0.2 * period, 30.0), loss);
            log.heartbeats(1, period, (0.1 + (30.0 / period).ceil() * period, 60.0), loss);
            assert_eq!(log.verdicts(60.0).confirmed, [], "period {period} s, seed {seed}");
        }
    }
}

/// A name in several frames whose requester does not send flow control, and then services.
#[test]
fn services_after_an_unfinished_name_are_not_mixed_with_it() {
    for pause in [0.002, 0.01, 0.05] {
        let mut log = LogWriter::new(1);
        log.heartbeats(1, 1.0, (0.1, 60.0), 0.0);
        let node = Address::new(ADDRESS).unwrap();
        let request = Header::request(Address::new(5).unwrap(), node, false, des());
        let id = request.response(node, false).encode();
        for round in 0..10 {
            let at = f64::from(round) * 5.0 + 0.5;
            log.push(at, request.encode(), b"\x04DES\x01");
            log.push(at + 0.001, id, b"\x10\x0D\x01LONGN");
            let at = at + 0.001 + pause;
            log.push(at, request.encode(), b"\x04DES\x02");
            log.push(at + 0.001, id, b"\x10\x0A\x02\0DES\0");
            log.push(at + 0.002, request.encode(), &[0x30, 0, 0]);
            log.push(at + 0.003, id, b"\x211.0\0");
        }
        assert_eq!(log.verdicts(60.0).kinds, [], "services {pause} s later");
    }
}
