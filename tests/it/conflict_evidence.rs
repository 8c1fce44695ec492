//! Evidence frame by frame: two senders at one address, received with listen-only, in sequences
//! that the simulated devices rarely produce.

use descan::discovery::{Config, Engine};
use descan::finding::{FindingKind, FindingState};
use descan::frame::Frame;
use descan::time::Instant;

const ADDRESS: u32 = 5;
/// The address of the requester.
const ASKER: u32 = 1;

/// The frames on the bus, with times in milliseconds.
#[derive(Default)]
struct Story(Vec<(u64, Frame)>);

impl Story {
    /// Adds heartbeats without a UID, one per second from `phase` until `until`.
    fn beats(mut self, phase: u64, until: u64) -> Self {
        for (count, at) in (phase..until).step_by(1000).enumerate() {
            let rnd7 = (count as u32 * 37 + phase as u32) % 128;
            let id = 0x0700_0001 | ADDRESS << 17 | rnd7 << 10;
            self.0.push((at, Frame::classic(id, &[0, 0, 0, 0, 0, 0, 4, 0])));
        }
        self
    }

    /// Adds a name request and these responses to it, one after the other.
    fn asked(mut self, at: u64, answers: &[&[u8; 1]]) -> Self {
        let question = Frame::classic(ASKER << 17 | ADDRESS << 10 | 2, b"\x04DES\x01");
        self.0.push((at, question));
        for (place, [name]) in (1..).zip(answers) {
            let id = 0x0500_0002 | ADDRESS << 17 | ASKER << 10;
            self.0.push((at + 10 * place, Frame::classic(id, &[3, 1, *name, 0])));
        }
        self
    }

    /// Runs an engine that receives all frames; calls `each` after every frame.
    fn heard(mut self, mut each: impl FnMut(u64, &Engine)) -> Engine {
        self.0.sort_by_key(|(at, _)| *at);
        let config = Config { listen_only: true, ..Config::default() };
        let mut engine = Engine::new(Instant::ZERO, config);
        for (millis, frame) in self.0 {
            let at = Instant::from_micros(millis * 1000);
            while let Some(due) = engine.poll_timeout().filter(|due| *due <= at) {
                engine.handle_timeout(due);
            }
            engine.handle_frame(&frame.with_time(at));
            each(millis, &engine);
        }
        engine
    }
}

fn state(engine: &Engine, kind: FindingKind) -> Option<FindingState> {
    engine.findings().iter().find(|it| it.key.kind == kind).map(|it| it.state)
}

const SAME: FindingKind = FindingKind::SameNameSameAddress;
const DOUBLED: FindingKind = FindingKind::AnswersDoubled;
const NAMES: FindingKind = FindingKind::OneAddressTwoNames;

#[test]
fn heartbeats_half_a_period_apart_are_two_devices() {
    let engine = Story::default().beats(0, 20_000).beats(450, 20_000).heard(|_, _| {});
    assert_eq!(state(&engine, SAME), Some(FindingState::Confirmed));
}

#[test]
fn heartbeats_at_twice_the_rate_are_one_device() {
    let engine = Story::default().beats(0, 40_000).beats(500, 40_000).heard(|at, engine| {
        assert_ne!(state(engine, SAME), Some(FindingState::Confirmed), "at {at} ms");
    });
    assert_eq!(state(&engine, SAME), Some(FindingState::Cleared), "and left in peace");
}

#[test]
fn response_evidence_survives_heartbeat_noise() {
    let mut story = Story::default().beats(0, 40_000).beats(500, 40_000);
    for second in 0..12 {
        story = story.asked(second * 1000 + 250, &[b"A", b"A"]);
    }
    let engine = story.heard(|at, engine| {
        if at > 12_000 {
            assert_eq!(state(engine, SAME), Some(FindingState::Confirmed), "at {at} ms");
        }
    });
    assert_eq!(state(&engine, NAMES), None);
}

#[test]
fn burst_of_malformed_responses_counts_once() {
    let mut story = Story::default().beats(0, 24_000);
    for at in [3250, 3350, 3450, 8700] {
        story = story.asked(at, &[b"A", b"A"]);
    }
    let engine = story.heard(|at, engine| {
        assert_ne!(state(engine, DOUBLED), Some(FindingState::Confirmed), "at {at} ms");
    });
    assert_eq!(state(&engine, DOUBLED), Some(FindingState::Cleared));
}

#[test]
fn conflict_stays_confirmed_when_second_name_appears() {
    let story = Story::default().beats(0, 12_000).beats(300, 12_000);
    let story = story.asked(9000, &[b"A"]).asked(9200, &[b"B"]).asked(9400, &[b"A"]);
    story.heard(|at, engine| {
        if (9000..12_000).contains(&at) {
            let best = state(engine, SAME).max(state(engine, NAMES));
            assert_eq!(best, Some(FindingState::Confirmed), "at {at} ms");
        }
        if at > 9410 {
            assert_eq!(state(engine, SAME), Some(FindingState::Cleared), "reported as that alone");
        }
    });
}

#[test]
fn names_of_many_devices_at_one_address_are_counted() {
    for (names, expected) in [
        (&[b"A", b"B"][..], "Two devices share address 5: A and B both respond."),
        (&[b"A", b"B", b"C"], "Several devices share address 5: A, B and C respond."),
        (
            &[b"A", b"B", b"C", b"D", b"E", b"F"],
            "Several devices share address 5: A, B, C, D and 2 more respond.",
        ),
    ] {
        let mut log = Story::default().beats(0, 12_000);
        for round in 0..8 {
            log = log.asked(1500 + round * 1000, names);
        }
        let engine = log.heard(|_, _| {});
        let mut findings = engine.findings().iter().filter(|it| it.key.kind == NAMES);
        assert_eq!(findings.next().map(|it| it.text.as_str()), Some(expected));
    }
}
