//! Hand-written and generated logs, and the address conflicts that `scan --json` and `watch --json`
//! find in them. On a log, no requests can be sent.

use crate::common::inspection;
use crate::common::program::{command, run_with_input, text};
use descan::sim::Scenario;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

const FEED: &str = "8AFA6C972411";
const SENS: &str = "C35B70000000";
const PUMP: &str = "9338E1BB0AD9";
const BLANK: &str = "000000000000";

/// A finding: kind, confidence, address.
type Told = (String, String, u64);

/// Kinds and addresses.
type Confirmed = &'static [(&'static str, u64)];

/// Description, log, and the findings that must be confirmed.
type Case = (String, Log, Confirmed);

/// Encodes a name as response data.
type Encode<'a> = &'a dyn Fn(&str) -> String;

/// A log under construction. Times are in seconds since its first second.
#[derive(Clone, Default)]
struct Log {
    lines: Vec<(f64, String)>,
    rnd7: u32,
    /// The DST of heartbeats and broadcast requests, or `None` to draw it at random.
    constant: Option<u32>,
}

impl Log {
    fn frame(&mut self, at: f64, id: u32, data: &str) {
        self.lines.push((at, format!("{id:08X}#{data}")));
    }

    fn random(&mut self) -> u32 {
        self.rnd7 = (self.rnd7 + 5) % 128;
        self.constant.unwrap_or(self.rnd7)
    }

    /// Adds heartbeats of a working node, one per `period`, with that data.
    fn beats(mut self, source: u32, from: f64, until: f64, period: f64, data: &str) -> Self {
        for count in 0.. {
            let at = from + f64::from(count) * period;
            if at >= until {
                return self;
            }
            let rnd7 = self.random();
            self.frame(at, 0x0700_0001 | source << 17 | rnd7 << 10, data);
        }
        self
    }

    /// Adds heartbeats each second, of DEV_CFG_UID, mode WORK and no error.
    fn lives(self, source: u32, from: f64, until: f64, uid: &str) -> Self {
        self.beats(source, from, until, 1.0, &format!("{uid}0400"))
    }

    /// Adds a broadcast name request.
    fn asks(&mut self, at: f64, by: u32, data: &str) {
        let rnd7 = self.random();
        self.frame(at, 0x0200_0002 | by << 17 | rnd7 << 10, data);
    }

    fn answers(&mut self, at: f64, source: u32, to: u32, data: &str) {
        self.frame(at, 0x0500_0002 | source << 17 | to << 10, data);
    }

    /// Adds a broadcast name request from `by` every `every` seconds, with these names as responses
    /// from address 14.
    fn asked(mut self, until: f64, every: f64, by: u32, names: &[&str]) -> Self {
        for count in 0.. {
            let at = 0.7 + f64::from(count) * every;
            if at >= until {
                return self;
            }
            self.asks(at, by, "0444455301");
            for (place, name) in names.iter().enumerate() {
                self.answers(at + 0.002 * (place as f64 + 1.0), 14, by, &isotp(name));
            }
        }
        self
    }

    fn and(mut self, other: &Log, later: f64) -> Self {
        self.lines.extend(other.lines.iter().map(|(at, line)| (at + later, line.clone())));
        self
    }

    fn text(mut self) -> String {
        self.lines.sort_by(|one, other| one.0.total_cmp(&other.0));
        let line = |(at, frame)| format!("({:.6}) can0 {frame}\n", 1_436_509_052.0 + at);
        self.lines.into_iter().map(line).collect()
    }
}

fn raw(name: &str) -> String {
    let bytes = name.bytes().fold("01".to_owned(), |mut text, byte| {
        write!(text, "{byte:02X}").unwrap();
        text
    });
    bytes + "00"
}

fn isotp(name: &str) -> String {
    format!("{:02X}{}", name.len() + 2, raw(name))
}

fn run(folder: &Path, arguments: &[&str], log: &str) -> Vec<Value> {
    std::fs::write(folder.join("session.log"), log).unwrap();
    let arguments = [arguments, &["--json", "file:session.log"]].concat();
    let output = command(&arguments, folder).output().expect("the program starts");
    let text = String::from_utf8(output.stdout).unwrap();
    let values = serde_json::Deserializer::from_str(&text).into_iter();
    values.map(|value| value.expect("JSON")).collect()
}

fn told(finding: &Value) -> Told {
    let word = |key: &str| finding[key].as_str().unwrap().to_owned();
    (word("kind"), word("confidence"), finding["address"].as_u64().unwrap_or(999))
}

/// Returns the findings that `watch` reports, in order.
fn watched(folder: &Path, log: &str) -> Vec<Told> {
    let values = run(folder, &["watch"], log);
    let findings = values.iter().filter(|value| value["event"] == "finding");
    findings.map(|value| told(&value["finding"])).collect()
}

/// Returns the findings that `scan` reports.
fn scanned(folder: &Path, log: &str) -> Vec<Told> {
    let values = run(folder, &["scan"], log);
    values[0]["findings"].as_array().unwrap().iter().map(told).collect()
}

/// Returns what is wrong unless a log ends with exactly these findings confirmed and `watch` never
/// confirmed others.
fn fault(folder: &Path, log: &str, confirmed: Confirmed) -> Option<String> {
    let sure = |findings: Vec<Told>| -> BTreeSet<(String, u64)> {
        let sure = findings.into_iter().filter(|told| told.1 == "confirmed");
        sure.map(|(kind, _, address)| (kind, address)).collect()
    };
    let wanted = confirmed.iter().map(|(kind, address)| ((*kind).to_owned(), *address)).collect();
    let (watched, scanned) = (sure(watched(folder, log)), sure(scanned(folder, log)));
    (watched != wanted || scanned != wanted)
        .then(|| format!("expected {wanted:?}, watch {watched:?}, scan {scanned:?}"))
}

#[track_caller]
fn check(cases: Vec<Case>) {
    let folder = tempfile::tempdir().unwrap();
    let faults = cases.into_iter().filter_map(|(label, log, confirmed)| {
        fault(folder.path(), &log.text(), confirmed).map(|fault| format!("{label}: {fault}\n"))
    });
    let faults: String = faults.collect();
    assert!(faults.is_empty(), "{faults}");
}

const DOUBLED: Confirmed = &[("answers-doubled", 14)];
const SAME_NAME: Confirmed = &[("same-name-same-address", 14)];
const TWO_NAMES: Confirmed = &[("one-address-two-names", 14)];
const TWO_IDENTITIES: Confirmed = &[("one-address-two-identities", 14)];
const NOTHING: Confirmed = &[];

#[test]
fn two_heartbeat_senders_at_one_address_are_found() {
    let mut cases: Vec<Case> = Vec::new();
    for constant in [None, Some(0), Some(127)] {
        for seconds in [6.0, 10.0] {
            for gap in [0.05, 0.3, 0.45, 0.65, 0.95] {
                for data in ["8AFA6C9724110400", "0000000000000400", "8AFA6C97241104", FEED, ""] {
                    let log = Log { constant, ..Log::default() }
                        .lives(20, 0.73, seconds, PUMP)
                        .beats(14, 0.1, seconds, 1.0, data)
                        .beats(14, 0.1 + gap, seconds, 1.0, data);
                    let label = format!("{data} {gap} s apart for {seconds} s, DST {constant:?}");
                    // A device that begins almost a second later is present for less than five
                    // periods. With a constant DST, a close heartbeat may be a copy.
                    let is_short = gap > 0.9 && seconds < 10.0;
                    let may_be_copy = constant.is_some() && !(0.1..0.9).contains(&gap);
                    if !is_short && !may_be_copy {
                        cases.push((label, log, SAME_NAME));
                    }
                }
            }
            for gap in [0.0005, 0.3, 0.5] {
                let log = Log { constant, ..Log::default() }.lives(14, 0.1, seconds, FEED).lives(
                    14,
                    0.1 + gap,
                    seconds,
                    SENS,
                );
                cases.push((format!("two UIDs {gap} s apart, {seconds} s"), log, TWO_IDENTITIES));
            }
        }
    }
    check(cases);
}

#[test]
fn two_senders_with_another_period_are_suspected() {
    let folder = tempfile::tempdir().unwrap();
    let data = format!("{FEED}0400");
    let suspected = [("same-name-same-address".to_owned(), "suspected".to_owned(), 14)];
    let folder = folder.path();
    for (period, part) in
        [(0.65, 0.25), (0.8, 0.2), (0.9, 0.25), (1.1, 0.27), (1.5, 0.15), (2.0, 0.2), (3.0, 0.3)]
    {
        let seconds = 30.0 * period;
        let two = Log::default().beats(14, 0.1, seconds, period, &data);
        let mut two = two.beats(14, 0.1 + part * period, seconds, period, &data);
        assert_eq!(scanned(folder, &two.clone().text()), suspected, "{part} of {period} s apart");
        // Of 60 heartbeats, some are lost.
        for lost in [21, 33, 46] {
            two.lines.remove(lost);
        }
        let lossy = two.lives(20, 0.73, seconds, PUMP);
        let label = format!("{part} of {period} s apart, with losses");
        assert_eq!(scanned(folder, &lossy.clone().text()), suspected, "{label}");
        assert_eq!(watched(folder, &lossy.text()), suspected, "{label}");
    }
    // One board that restarts after two heartbeats.
    for (period, pause) in [(1.0, 0.3), (1.0, 0.4), (1.0, 2.5)] {
        let cycle = period + pause;
        let one = Log::default().beats(14, 0.1, 30.0 * cycle, cycle, &data);
        let one = one.beats(14, 0.1 + period, 30.0 * cycle, cycle, &data);
        assert_eq!(scanned(folder, &one.text()), [], "{period} s, restarts after {pause} s");
    }
}

/// Kinds of what is found in 60 s of two boards at address 14 with this period, `apart` seconds from each other.
fn kinds_of_two(folder: &Path, period: f64, apart: f64) -> Vec<String> {
    let data = format!("{FEED}0400");
    let two = Log::default().beats(14, 0.1, 60.0, period, &data);
    let two = two.beats(14, 0.1 + apart, 60.0, period, &data).lives(20, 0.73, 60.0, PUMP);
    scanned(folder, &two.text()).into_iter().map(|told| told.0).collect()
}

#[test]
fn two_senders_whose_period_is_a_little_off_are_found() {
    let folder = tempfile::tempdir().unwrap();
    for period in [0.95, 0.97, 0.98, 0.99, 1.01, 1.02, 1.03, 1.05] {
        for apart in [0.02, 0.05, 0.08, 0.085, 0.09, 0.095, 0.11, 0.13, 0.2, 0.3, 0.47] {
            let kinds = kinds_of_two(folder.path(), period, apart);
            assert_eq!(kinds, ["same-name-same-address"], "each {period} s, {apart} s apart");
        }
    }
}

#[test]
fn two_names_with_another_period_are_one_conflict() {
    let folder = tempfile::tempdir().unwrap();
    let data = format!("{FEED}0400");
    let two = Log::default().beats(14, 0.1, 90.0, 2.0, &data).beats(14, 0.5, 90.0, 2.0, &data);
    let two = two.asked(90.0, 5.0, 0, &["FEED", "SENS"]);
    let told = watched(folder.path(), &two.text());
    assert!(told.iter().any(|told| told.0 == "one-address-two-names"), "{told:?}");
    assert!(told.iter().all(|told| told.0 != "same-name-same-address"), "{told:?}");
}

#[test]
fn restarts_after_the_second_sender_left_are_not_suspected() {
    let folder = tempfile::tempdir().unwrap();
    let data = format!("{FEED}0400");
    let mut log = Log::default().beats(14, 0.5, 60.0, 2.0, &data);
    // The one that stays restarts each 80 s.
    for restart in 0..5 {
        let from = 0.1 + 80.0 * f64::from(restart);
        log = log.beats(14, from, from + 79.0, 2.0, &data);
    }
    let told = watched(folder.path(), &log.text());
    let states: Vec<&str> = told.iter().map(|told| told.1.as_str()).collect();
    assert_eq!(states, ["suspected", "cleared"]);
}

#[test]
fn gateway_with_constant_rnd7_and_long_period_is_no_conflict() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = Log { constant: Some(5), ..Log::default() };
    for (address, first, uid) in [(14, 0.1, FEED), (20, 0.9, PUMP), (21, 1.7, SENS)] {
        log = log.beats(address, first, 60.0, 2.5, &format!("{uid}0400"));
    }
    for (at, line) in log.lines.clone() {
        log.lines.push((at + 0.29, line));
    }
    let found = scanned(folder.path(), &log.text());
    assert!(found.iter().all(|(kind, ..)| kind != "same-name-same-address"), "{found:?}");
}

#[test]
fn equal_heartbeats_soon_after_each_are_suspected() {
    let folder = tempfile::tempdir().unwrap();
    let suspected = [("same-name-same-address".to_owned(), "suspected".to_owned(), 14)];
    for (seed, delay) in [0.002, 0.02, 0.05, 0.08].into_iter().enumerate() {
        for (jitter, lost, period, pause) in [
            (0.0, 0.0, 1.0, 0.0),
            (0.004, 0.0, 1.0, 0.0),
            (0.002, 0.2, 1.0, 0.0),
            (0.0, 0.0, 1.01, 0.0),
            (0.0, 0.0, 0.98, 0.0),
            (0.0, 0.0, 1.0, 2.4),
            (0.0, 0.0, 1.0, 0.37),
        ] {
            // A gateway repeats one of two devices, or there are two boards.
            let mut rng = fastrand::Rng::with_seed(seed as u64);
            let data = format!("{FEED}0400");
            let log = Log { constant: Some(0), ..Log::default() };
            let log = log.beats(14, 0.1, 30.0, period, &data);
            let last = log.lines.last().unwrap().0;
            // After a restart it goes on in another phase.
            let mut log = log.beats(14, last + period + pause, 60.0, period, &data);
            for (at, line) in log.lines.clone() {
                log.lines.push((at + (delay + jitter * (rng.f64() - 0.5)).max(0.0005), line));
            }
            log.lines.retain(|_| rng.f64() >= lost);
            let log = log.lives(20, 0.73, 60.0, PUMP).text();
            let label = format!("{delay} s, {jitter} s, {lost} lost, {period} s, {pause} s");
            assert_eq!(scanned(folder.path(), &log), suspected, "{label}");
            let found = watched(folder.path(), &log);
            assert!(found.iter().all(|told| told.1 != "confirmed"), "{label}: {found:?}");
        }
    }
}

/// The log with each of these frames a second time, `delay` seconds later.
fn repeated(log: Log, delay: f64, is_repeated: impl Fn(&str) -> bool) -> Log {
    let copies: Vec<(f64, String)> =
        log.lines.iter().filter(|(_, line)| is_repeated(line)).cloned().collect();
    let mut log = log;
    log.lines.extend(copies.into_iter().map(|(at, line)| (at + delay, line)));
    log
}

#[test]
fn gateway_that_repeats_constant_rnd7_is_suspected_at_most() {
    let folder = tempfile::tempdir().unwrap();
    let is_of_14 = |line: &str| line.starts_with("071C") || line.starts_with("051C");
    for period in [0.5, 0.6, 0.7, 0.75, 1.0, 2.0] {
        for delay in [0.005, 0.02, 0.05] {
            let constant = Log { constant: Some(0), ..Log::default() };
            let device = constant.beats(14, 0.1, 60.0, period, &format!("{FEED}0400"));
            let log = repeated(device, delay, is_of_14).lives(20, 0.73, 60.0, PUMP);
            let found = watched(folder.path(), &log.text());
            let wrong = found.iter().find(|told| told.1 == "confirmed");
            assert_eq!(wrong, None, "each {period} s, {delay} s later");
        }
    }
    // The answers, too, of a device that is asked.
    for (delay, every) in [(0.0008, 1.0), (0.02, 5.0), (0.06, 3.0)] {
        let constant = Log { constant: Some(0), ..Log::default() };
        let device = constant.lives(14, 0.1, 60.0, FEED).asked(60.0, every, 5, &["FEED"]);
        let log = repeated(device, delay, is_of_14).lives(20, 0.73, 60.0, PUMP);
        let found = watched(folder.path(), &log.text());
        let wrong = found.iter().find(|told| told.1 == "confirmed");
        assert_eq!(wrong, None, "{delay} s later, asked each {every} s: {found:?}");
    }
    // All devices of a bus, later than copies with a constant RND7 are known by their delay.
    for delay in [0.11, 0.15, 0.2] {
        let mut log = Log::default().lives(20, 0.73, 60.0, PUMP).lives(21, 0.41, 60.0, SENS);
        log.constant = Some(0);
        let log = repeated(log.lives(14, 0.1, 60.0, FEED), delay, |_| true);
        let found = watched(folder.path(), &log.text());
        let wrong = found.iter().find(|told| told.1 == "confirmed");
        assert_eq!(wrong, None, "all {delay} s later");
        assert!(found.iter().any(|told| told.0 == "frames-repeated"), "all {delay} s later");
    }
}

#[test]
fn two_boards_behind_a_gateway_that_repeats_both_are_found() {
    let folder = tempfile::tempdir().unwrap();
    for apart in [0.2, 0.35, 0.4] {
        for delay in [0.002, 0.02, 0.06] {
            for first in [0.1, 20.1] {
                let log = Log::default().lives(14, 0.1, 60.0, FEED);
                let log = log.lives(14, first + apart, 60.0, FEED);
                let found = scanned(folder.path(), &repeated(log, delay, |_| true).text());
                let is_found = found.iter().any(|told| told.0 == "same-name-same-address");
                assert!(is_found, "{apart} s apart, copies {delay} s later: {found:?}");
            }
        }
    }
}

#[test]
fn device_that_restarts_again_and_again_is_suspected_at_most() {
    let folder = tempfile::tempdir().unwrap();
    for cycle in [1.05, 1.1, 1.38, 1.4, 1.42, 2.1] {
        // The first heartbeat comes soon after the reset.
        let mut log = Log::default().lives(20, 0.73, 60.0, PUMP);
        for reset in 0..(60.0 / cycle) as u32 {
            let reset = f64::from(reset) * cycle;
            log = log.lives(14, reset + 0.05, reset + cycle, FEED);
        }
        let found = watched(folder.path(), &log.text());
        let wrong = found.iter().find(|told| told.1 == "confirmed");
        assert_eq!(wrong, None, "restarts each {cycle} s");
    }
}

#[test]
fn two_close_boards_with_a_long_period_are_suspected() {
    let folder = tempfile::tempdir().unwrap();
    for apart in [0.02, 0.04, 0.06, 0.08] {
        let kinds = kinds_of_two(folder.path(), 2.0, apart);
        assert_eq!(kinds, ["same-name-same-address"], "{apart} s apart");
    }
}

#[test]
fn fast_device_whose_heartbeats_are_often_late_is_not_confirmed() {
    let folder = tempfile::tempdir().unwrap();
    for seed in 0..20 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut log = Log::default().beats(14, 0.1, 40.0, 0.5, &format!("{FEED}0400"));
        for (at, _) in &mut log.lines {
            if rng.f64() < 0.1 {
                *at += 0.25 * rng.f64();
            }
        }
        let found = watched(folder.path(), &log.lives(20, 0.73, 40.0, PUMP).text());
        let wrong = found.iter().find(|told| told.1 == "confirmed");
        assert_eq!(wrong, None, "seed {seed}");
    }
}

/// Heartbeats of several nodes at address 14, one per `phases`, with equal or different UIDs.
fn together(phases: &[f64], seconds: f64, is_equal: bool) -> Log {
    let uid =
        |at: usize| if is_equal { FEED.to_owned() } else { format!("{:02X}B341044000", at + 1) };
    let lives =
        |log: Log, (at, phase): (usize, &f64)| log.lives(14, 0.1 + phase, seconds, &uid(at));
    phases.iter().enumerate().fold(Log::default().lives(20, 0.73, seconds, PUMP), lives)
}

#[test]
fn three_to_nine_senders_at_one_address_are_found() {
    let mut cases: Vec<Case> = Vec::new();
    let uneven = [0.0, 0.21, 0.33, 0.58, 0.71, 0.85, 0.4, 0.93, 0.12];
    for count in 3..=9 {
        let even: Vec<f64> = (0..count).map(|at| at as f64 / count as f64).collect();
        for seconds in [10.0, 20.0] {
            for phases in [&even[..], &uneven[..count]] {
                let label = format!("{phases:?} for {seconds} s");
                let log = together(phases, seconds, false);
                cases.push((format!("other UIDs, {label}"), log, TWO_IDENTITIES));
            }
            // Equal ones at even phases look like one node with a shorter period.
            if count <= 6 {
                let label = format!("{count} at uneven phases for {seconds} s");
                let log = together(&uneven[..count], seconds, true);
                cases.push((format!("equal UIDs, {label}"), log, SAME_NAME));
            }
        }
    }
    check(cases);
}

#[test]
fn conflict_of_senders_with_unlike_periods_is_confirmed_once() {
    let folder = tempfile::tempdir().unwrap();
    for (first, second) in [(0.2, 1.0), (0.1, 1.0), (0.1, 2.0), (1.0, 0.2), (1.0, 3.0), (1.0, 5.0)]
    {
        let log = Log::default().beats(14, 0.05, 95.0, first, &format!("{FEED}0400"));
        let log = log.beats(14, 20.037, 70.0, second, &format!("{PUMP}0400"));
        let events = run(folder.path(), &["watch"], &log.text());
        let states: Vec<&str> = events
            .iter()
            .filter(|event| event["event"] == "finding")
            .map(|event| event["finding"]["confidence"].as_str().unwrap())
            .collect();
        assert_eq!(
            states,
            ["suspected", "confirmed", "cleared"],
            "each {first} s, each {second} s"
        );
        let lost = events.iter().find(|event| event["event"] == "lost");
        assert!(lost.is_none(), "each {first} s, each {second} s: {lost:?}");
    }
}

#[test]
fn text_of_conflict_counts_the_devices() {
    let folder = tempfile::tempdir().unwrap();
    for (count, begin) in [(2, "Two devices"), (3, "3 devices"), (9, "8 or more devices")] {
        let phases: Vec<f64> = (0..count).map(|at| f64::from(at) / f64::from(count)).collect();
        let report = run(folder.path(), &["scan"], &together(&phases, 20.0, false).text());
        let finding = &report[0]["findings"][0];
        let text = finding["text"].as_str().unwrap();
        assert!(text.starts_with(&format!("{begin} share address 14: ")), "{text}");
        let uids = finding["uids"].as_array().unwrap();
        assert_eq!(uids.len(), count.min(8) as usize, "{finding:#}");
        assert!(uids.iter().all(|uid| text.contains(uid.as_str().unwrap())), "{finding:#}");
    }
}

#[test]
fn conflict_of_three_lasts_while_two_remain() {
    let folder = tempfile::tempdir().unwrap();
    for phases in [[0.0, 0.33, 0.66], [0.0, 0.1, 0.2], [0.0, 0.45, 0.62]] {
        for is_equal in [false, true] {
            if is_equal && phases[1] > 0.3 && phases[1] < 0.4 {
                continue;
            }
            let mut log = together(&phases, 40.0, is_equal);
            // The third leaves.
            let is_third = |at: f64| {
                let periods = at - 0.1 - phases[2];
                (periods - periods.round()).abs() < 1e-6
            };
            log.lines.retain(|(at, _)| *at < 15.0 || !is_third(*at));
            let label = format!("{phases:?}, equal: {is_equal}");
            let values = run(folder.path(), &["watch"], &log.text());
            let states = || values.iter().map(|it| &it["finding"]["confidence"]);
            assert!(states().all(|state| state != "cleared"), "{label}");
            assert!(states().any(|state| state == "confirmed"), "{label}");
            let output = command(&["watch", "file:session.log"], folder.path()).output().unwrap();
            let lines = String::from_utf8(output.stdout).unwrap();
            assert!(!lines.contains("gave up"), "{label}: {lines}");
        }
    }
}

#[test]
fn equal_random_numbers_are_not_taken_for_a_bridge() {
    let mut cases: Vec<Case> = Vec::new();
    for (seconds, every) in [(12.0, 0.7), (20.0, 1.0), (30.0, 1.9)] {
        for uid in [BLANK, FEED] {
            let one = Log::default().lives(14, 0.1, seconds, uid);
            let questions = |names| Log::default().asked(seconds, every, 5, names);
            for apart in [0.02, 0.045, 0.3, 0.44] {
                let two = one.clone().and(&one, apart).and(&questions(&["FEED", "FEED"]), 0.0);
                let label = format!("two of {uid} {apart} s apart, asked each {every} s");
                cases.push((label, two, SAME_NAME));
                let alone = one.clone().and(&questions(&["FEED"]), 0.0);
                let mut copies = alone.clone();
                let doubled = alone.clone().and(&copies, apart);
                let label = format!("a bridge, {apart} s later, asked each {every} s");
                cases.push((label, doubled, NOTHING));
                copies.lines.retain(|(_, line)| !line.starts_with("02"));
                let doubled = alone.and(&copies, apart);
                let label = format!("a bridge to us, {apart} s later, asked each {every} s");
                cases.push((label, doubled, NOTHING));
            }
        }
    }
    check(cases);
}

#[test]
fn repeated_frames_do_not_raise_contested_address() {
    let folder = tempfile::tempdir().unwrap();
    for apart in [0.0003, 0.02, 0.045] {
        let alone = Log::default().lives(14, 0.1, 20.0, FEED).asked(20.0, 0.7, 5, &["FEED"]);
        let mut copies = alone.clone();
        // One heartbeat has no duplicate: the copy is lost.
        let is_lost = |at: f64, line: &str| line.starts_with("07") && (10.0..10.9).contains(&at);
        copies.lines.retain(|(at, line)| !line.starts_with("02") && !is_lost(*at, line));
        assert_eq!(copies.lines.len(), 20 + 28 - 1, "{:?}", copies.lines);
        let log = alone.and(&copies, apart).text();
        for told in [watched(folder.path(), &log), scanned(folder.path(), &log)] {
            let mut kinds = told.iter().map(|(kind, ..)| kind);
            assert!(kinds.all(|kind| kind != "address-contested"), "{apart} s later: {told:?}");
            let suspected = told.iter().filter(|(kind, confidence, _)| {
                confidence == "suspected" && kind != "frames-repeated"
            });
            assert!(suspected.count() <= 1, "{apart} s later: {told:?}");
        }
    }
}

#[test]
fn ambiguous_heartbeats_are_suspected_at_most() {
    let mut cases: Vec<Case> = Vec::new();
    for seconds in [6.0, 10.0, 30.0] {
        let half = Log::default().lives(14, 0.1, seconds, FEED).lives(14, 0.6, seconds, FEED);
        cases.push((format!("half a period apart for {seconds} s"), half, NOTHING));
        for period in [0.1, 0.25, 0.5, 0.7, 2.0, 5.0] {
            let odd = Log::default().beats(14, 0.1, seconds, period, "8AFA6C9724110400");
            cases.push((format!("a period of {period} s for {seconds} s"), odd, NOTHING));
        }
    }
    let short = Log::default().lives(14, 0.1, 4.0, FEED).lives(14, 0.4, 4.0, SENS);
    cases.push(("two UIDs for four seconds".to_owned(), short, NOTHING));
    check(cases);
    // Suspected only.
    let folder = tempfile::tempdir().unwrap();
    let half = Log::default().lives(14, 0.1, 10.0, FEED).lives(14, 0.6, 10.0, FEED);
    let suspected = ("same-name-same-address".to_owned(), "suspected".to_owned(), 14);
    assert_eq!(scanned(folder.path(), &half.text()), [suspected]);
}

#[test]
fn two_responses_to_foreign_request_are_a_conflict() {
    let mut cases: Vec<Case> = Vec::new();
    for (seconds, every) in [(6.0, 1.0), (7.0, 2.0), (10.0, 3.0), (12.0, 5.0), (31.0, 10.0)] {
        for by in [0, 5] {
            for beats in [true, false] {
                let log = Log::default();
                let log = if beats { log.lives(14, 0.1, seconds, FEED) } else { log };
                let label = format!("each {every} s for {seconds} s by {by}, beats: {beats}");
                let asked = |names| log.clone().asked(seconds, every, by, names);
                cases.push((format!("one name {label}"), asked(&["ACT", "ACT"]), DOUBLED));
                cases.push((format!("two names {label}"), asked(&["FEED", "SENS"]), TWO_NAMES));
                cases.push((format!("innocent {label}"), asked(&["ACT"]), NOTHING));
            }
        }
    }
    check(cases);
}

#[test]
fn conflict_is_found_in_either_framing() {
    let fd = |name: &str| format!("#0{}", isotp(name));
    let padded = |name: &str| format!("{:0<16}", isotp(name));
    let framings: [(&str, &str, Encode<'_>); 4] = [
        ("raw", "44455301", &raw),
        ("ISO-TP, padded", "0444455301000000", &padded),
        ("ISO-TP on FD", "#00444455301", &fd),
        ("ISO-TP", "0444455301", &isotp),
    ];
    let mut cases: Vec<Case> = Vec::new();
    for (framing, question, answer) in framings {
        for (names, confirmed) in [
            (["ACT", "ACT"].as_slice(), DOUBLED),
            (&["FEED", "SENS"], TWO_NAMES),
            (&["ACT"], NOTHING),
        ] {
            let mut log = Log::default().lives(14, 0.1, 10.0, FEED);
            for round in 0..5 {
                let at = 0.7 + f64::from(round) * 2.0;
                log.asks(at, 0, question);
                for (place, name) in names.iter().enumerate() {
                    log.answers(at + 0.002 + 0.002 * place as f64, 14, 0, &answer(name));
                }
            }
            cases.push((format!("{names:?} in {framing}"), log, confirmed));
        }
    }
    check(cases);
}

#[test]
fn unsolicited_names_are_evaluated() {
    let mut cases: Vec<Case> = Vec::new();
    for (seconds, every) in [(8.0, 1.0), (22.0, 5.0), (42.0, 10.0)] {
        let mut log = Log::default().lives(14, 0.1, seconds, FEED).asked(
            seconds,
            every,
            0,
            &["FEED", "SENS"],
        );
        log.lines.retain(|(_, line)| !line.ends_with("#0444455301"));
        cases.push((format!("each {every} s"), log, TWO_NAMES));
    }
    check(cases);
}

/// Two boards at 14 with names of their own, the second one from 10.4 s until `left`, each asked once.
fn two_named_boards(seconds: f64, left: f64) -> Log {
    let mut log =
        Log::default().lives(14, 0.1, seconds, FEED).lives(14, 10.4, left.min(seconds), PUMP);
    for (at, name) in [(0.7, "AAA"), (10.6, "BBB")] {
        log.asks(at, 0, "0444455301");
        log.answers(at + 0.002, 14, 0, &isotp(name));
    }
    log
}

#[test]
fn named_board_is_there_while_it_sends_heartbeats() {
    let folder = tempfile::tempdir().unwrap();
    let log = two_named_boards(40.0, 99.0).text();
    let events = run(folder.path(), &["watch"], &log);
    let lost: Vec<_> = events.iter().filter(|value| value["event"] == "lost").collect();
    assert!(lost.is_empty(), "{lost:#?}");
    let findings: Vec<Told> = watched(folder.path(), &log);
    assert!(findings.iter().all(|(kind, ..)| kind != "address-contested"), "{findings:?}");
    // The names are an observation of the conflict that stays.
    let states: Vec<_> = findings.iter().map(|(kind, state, _)| (&kind[..], &state[..])).collect();
    assert!(states.contains(&("one-address-two-identities", "confirmed")), "{states:?}");
    assert!(!states.contains(&("one-address-two-identities", "cleared")), "{states:?}");
}

#[test]
fn board_that_stays_keeps_its_name_and_uid() {
    let folder = tempfile::tempdir().unwrap();
    let values = run(folder.path(), &["scan"], &two_named_boards(60.0, 20.0).text());
    let devices = values[0]["devices"].as_array().unwrap();
    let text = |device: &Value, key: &str| device[key].as_str().unwrap_or("–").to_owned();
    let here = devices.iter().filter(|device| device["address"] == 14);
    let mut here: Vec<_> =
        here.map(|device| ["name", "presence", "uid"].map(|key| text(device, key))).collect();
    here.sort();
    assert_eq!(here.len(), 2, "{devices:#?}");
    assert_eq!(
        (&*here[0][0], &*here[0][1], &*here[1][0], &*here[1][1]),
        ("AAA", "online", "BBB", "lost")
    );
    assert_ne!(here[0][2], here[1][2]);
}

/// A board at 14: name, UID, and the times between which it sends heartbeats.
struct NamedBoard {
    name: &'static str,
    uid: &'static str,
    phase: f64,
    present: Vec<(f64, f64)>,
}

impl NamedBoard {
    fn new(name: &'static str, uid: &'static str, phase: f64, present: &[(f64, f64)]) -> Self {
        Self { name, uid, phase, present: present.to_vec() }
    }

    fn heartbeats(&self) -> Vec<f64> {
        let all = (0..200).map(|second| f64::from(second) + self.phase);
        let is_present =
            |at: &f64| self.present.iter().any(|&(from, until)| (from..until).contains(at));
        all.filter(is_present).collect()
    }

    /// Returns the time since its last heartbeat.
    fn silence(&self, at: f64) -> f64 {
        let before = self.heartbeats().into_iter().rfind(|heard| *heard < at + 0.01);
        before.map_or(f64::INFINITY, |heard| at - heard)
    }
}

/// Returns a log of the boards; `names`: when a name was asked, and which boards responded.
fn log_of_boards(boards: &[&NamedBoard], names: &[(f64, &[&NamedBoard])]) -> Log {
    let mut log = Log::default();
    for board in boards {
        for at in board.heartbeats() {
            log = log.lives(14, at, at + 0.5, board.uid);
        }
    }
    for (at, responding) in names {
        log.asks(*at, 0, "0444455301");
        for (place, board) in responding.iter().enumerate() {
            log.answers(at + 0.002 * (place as f64 + 1.0), 14, 0, &isotp(board.name));
        }
    }
    log
}

/// Returns what `watch` and `scan` say wrongly about the boards of a log: presence and UID by name,
/// and whether one of them gave way.
fn faults_about_boards(folder: &Path, boards: &[&NamedBoard], log: Log) -> Vec<String> {
    let end = log.lines.iter().map(|(at, _)| *at).fold(0.0, f64::max);
    let text = log.text();
    let mut faults = Vec::new();
    for value in run(folder, &["watch"], &text) {
        let at = value["time"].as_f64().unwrap_or(0.0) - 1_436_509_052.0;
        let board = boards.iter().find(|board| value["name"] == board.name);
        match (value["event"].as_str().unwrap_or_default(), board) {
            ("lost", Some(board)) if board.silence(at) < 3.9 => {
                faults.push(format!(
                    "{at:.2}: {} lost, {:.1} s after a heartbeat",
                    board.name,
                    board.silence(at)
                ));
            }
            ("finding", _) if value["finding"]["kind"] == "address-contested" => {
                faults.push(format!("{at:.2}: a board gave way"));
            }
            _ => {}
        }
    }
    let devices = run(folder, &["scan"], &text)[0]["devices"].as_array().unwrap().clone();
    for device in devices.iter().filter(|device| device["address"] == 14) {
        let Some(board) = boards.iter().find(|board| device["name"] == board.name) else {
            continue;
        };
        let (presence, silence) = (device["presence"].as_str().unwrap(), board.silence(end));
        let is_wrong = silence < 1.1 && presence == "lost" || silence > 9.0 && presence != "lost";
        if is_wrong {
            faults.push(format!("{} is {presence}, {silence:.1} s after a heartbeat", board.name));
        }
        let bytes =
            (0..6).map(|at| u8::from_str_radix(&board.uid[2 * at..2 * at + 2], 16).unwrap());
        let uid = descan::wire::node::Uid(bytes.collect::<Vec<_>>().try_into().unwrap());
        let uid = uid.text(&descan::wire::profile::Profile::default().uid).to_string();
        if device["uid"] != uid {
            faults.push(format!("{} has the UID {}, not {uid:?}", board.name, device["uid"]));
        }
    }
    faults
}

#[test]
fn known_board_that_returns_beside_another_one_is_there() {
    let folder = tempfile::tempdir().unwrap();
    for uids in [[FEED, PUMP], [BLANK, PUMP], [FEED, BLANK]] {
        let one = NamedBoard::new("BBB", uids[0], 0.1, &[(0.0, 12.0), (30.0, 60.0)]);
        let other = NamedBoard::new("AAA", uids[1], 0.4, &[(12.0, 60.0)]);
        let log = log_of_boards(&[&one, &other], &[(4.5, &[&one]), (26.5, &[&other])]);
        let faults = faults_about_boards(folder.path(), &[&one, &other], log);
        assert!(faults.is_empty(), "{uids:?}: {faults:#?}");
    }
}

#[test]
fn known_board_that_replaces_another_one_again_has_its_own_row() {
    let folder = tempfile::tempdir().unwrap();
    for uids in [[FEED, PUMP], [BLANK, PUMP], [FEED, BLANK]] {
        let one = NamedBoard::new("BBB", uids[0], 0.1, &[(0.0, 12.0), (26.0, 40.0)]);
        let other = NamedBoard::new("AAA", uids[1], 0.4, &[(12.0, 26.0), (40.0, 60.0)]);
        let log = log_of_boards(&[&one, &other], &[(4.5, &[&one]), (18.5, &[&other])]);
        let text = log.clone().text();
        let faults = faults_about_boards(folder.path(), &[&one, &other], log);
        assert!(faults.is_empty(), "{uids:?}: {faults:#?}");
        let events = run(folder.path(), &["watch"], &text);
        let events: Vec<_> = events.iter().filter(|it| it["address"] == 14).collect();
        let late = |event: &str| events.iter().filter(|it| it["event"] == event).count();
        assert_eq!(late("returned"), 2, "each once: {events:#?}");
        assert!(late("uid") <= 1, "only the first swap is one to an unknown board: {events:#?}");
    }
}

#[test]
fn two_named_boards_one_without_uid_are_a_conflict_of_names() {
    let folder = tempfile::tempdir().unwrap();
    for uids in [[FEED, BLANK], [BLANK, FEED]] {
        let one = NamedBoard::new("AAA", uids[0], 0.1, &[(0.0, 60.0)]);
        let other = NamedBoard::new("BBB", uids[1], 0.4, &[(10.0, 60.0)]);
        let log = log_of_boards(&[&one, &other], &[(4.5, &[&one]), (14.5, &[&other])]);
        let scanned = scanned(folder.path(), &log.clone().text());
        let confirmed: Vec<_> =
            scanned.iter().filter(|(_, state, _)| state == "confirmed").collect();
        assert_eq!(confirmed, [&("one-address-two-names".to_owned(), "confirmed".to_owned(), 14)]);
        let faults = faults_about_boards(folder.path(), &[&one, &other], log);
        assert!(faults.is_empty(), "{uids:?}: {faults:#?}");
    }
}

#[test]
fn names_of_two_boards_are_part_of_the_conflict_that_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let one = NamedBoard::new("AAA", FEED, 0.1, &[(0.0, 90.0)]);
    let other = NamedBoard::new("BBB", PUMP, 0.4, &[(10.0, 90.0)]);
    let both: &[&NamedBoard] = &[&one, &other];
    let names: Vec<_> = (1..8).map(|count| (f64::from(count) * 4.0 + 0.5, both)).collect();
    let events = run(folder.path(), &["watch"], &log_of_boards(both, &names).text());
    let findings = events.iter().map(|event| &event["finding"]).filter(|it| !it.is_null());
    let cleared: Vec<_> = findings.filter(|it| it["confidence"] == "cleared").collect();
    assert_eq!(cleared.len(), 1, "{cleared:#?}");
    assert_eq!(cleared[0]["superseded_by"], "one-address-two-identities", "{cleared:#?}");
}

#[test]
fn random_logs_of_two_named_boards_show_each_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let mut wrong = Vec::new();
    for seed in 0..80 {
        let mut random = fastrand::Rng::with_seed(seed);
        let mut windows = |first: f64| {
            let mut windows = vec![(first, first + 10.0 + random.f64() * 20.0)];
            while let Some((_, until)) = windows.last().filter(|(_, until)| *until < 80.0) {
                let from = until + 8.0 + random.f64() * 10.0;
                windows.push((from, from + 10.0 + random.f64() * 20.0));
            }
            windows.into_iter().map(|(from, until)| (from, until.min(100.0))).collect::<Vec<_>>()
        };
        let one = NamedBoard::new("AAA", FEED, 0.1, &windows(0.0));
        let uid = if seed % 3 == 0 { BLANK } else { PUMP };
        // The second one joins when the name of the first one is known.
        let other = NamedBoard::new("BBB", uid, 0.4, &windows(6.0 + seed as f64 / 10.0));
        let mut names: Vec<(f64, Vec<&NamedBoard>)> = vec![(4.5, vec![&one])];
        for count in 1..10 {
            // They have sent a heartbeat since.
            let at = 10.0 * f64::from(count) + 5.0;
            let has_joined = |board: &&NamedBoard| {
                board.present.iter().any(|&(from, until)| from + 2.0 < at && at < until)
            };
            let mut present: Vec<_> = [&other, &one].into_iter().filter(has_joined).collect();
            present.truncate(random.usize(1..3));
            names.push((at, present));
        }
        let names: Vec<_> = names.iter().map(|(at, boards)| (*at, &boards[..])).collect();
        let log = log_of_boards(&[&one, &other], &names);
        for fault in faults_about_boards(folder.path(), &[&one, &other], log) {
            wrong.push(format!("seed {seed}: {fault}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Returns address, name, UID and presence of each device that has a name, sorted.
fn named_devices(folder: &Path, log: Log) -> Vec<(u64, String, String, String)> {
    let scan = run(folder, &["scan"], &log.text());
    let text = |device: &Value, key: &str| device[key].as_str().unwrap_or("–").to_owned();
    let devices = scan[0]["devices"].as_array().unwrap().iter();
    let named = devices.filter(|device| device["name"].is_string());
    let mut all: Vec<_> = named
        .map(|it| {
            let address = it["address"].as_u64().unwrap();
            (address, text(it, "name"), text(it, "uid"), text(it, "presence"))
        })
        .collect();
    all.sort();
    all
}

#[test]
fn known_boards_that_swap_addresses_move_both() {
    let folder = tempfile::tempdir().unwrap();
    for back in [21.0, 24.0, 30.0] {
        let mut log = Log::default().lives(9, 0.1, 20.0, FEED).lives(30, 0.3, 20.0, PUMP);
        log.answers(5.0, 9, 0, &isotp("AAA"));
        log.answers(6.0, 30, 0, &isotp("BBB"));
        let log = log.lives(30, back + 0.1, 80.0, FEED).lives(9, back + 0.3, 80.0, PUMP);
        let own = |address, name: &str, uid: &str| {
            (address, name.to_owned(), uid.to_owned(), "online".to_owned())
        };
        assert_eq!(
            named_devices(folder.path(), log),
            [own(9, "BBB", "DSCANPK9"), own(30, "AAA", "BOILER01")],
            "back at {back} s"
        );
    }
}

#[test]
fn new_uid_of_a_named_row_is_shown_once_it_is_alone() {
    let folder = tempfile::tempdir().unwrap();
    for gap in [0.5, 1.0, 4.0, 20.0] {
        let mut log = Log::default().lives(14, 0.1, 5.0, FEED).lives(14, 4.1 + gap, 60.0, PUMP);
        log.answers(2.0, 14, 0, &isotp("AAA"));
        let devices = named_devices(folder.path(), log);
        assert_eq!(devices.len(), 1, "gap of {gap} s: {devices:?}");
        assert_eq!((&*devices[0].2, &*devices[0].3), ("DSCANPK9", "online"), "gap of {gap} s");
    }
}

#[test]
fn board_asleep_when_another_one_took_its_address_is_asleep() {
    let folder = tempfile::tempdir().unwrap();
    let log = Log::default().lives(14, 0.1, 10.0, FEED).lives(14, 22.4, 60.0, PUMP);
    let mut log = log.beats(14, 10.1, 13.0, 1.0, &format!("{FEED}0600"));
    log.answers(2.0, 14, 0, &isotp("AAA"));
    log.answers(35.0, 14, 0, &isotp("BBB"));
    let devices = named_devices(folder.path(), log);
    let shown: Vec<_> = devices.iter().map(|(_, name, uid, is)| (&**name, &**uid, &**is)).collect();
    assert_eq!(shown, [("AAA", "BOILER01", "asleep"), ("BBB", "DSCANPK9", "online")]);
}

#[test]
fn device_that_takes_the_address_of_one_asleep_has_its_own_mode() {
    let folder = tempfile::tempdir().unwrap();
    let log = Log::default().lives(14, 0.1, 20.0, FEED).lives(30, 0.3, 10.0, PUMP);
    let log = log.beats(14, 20.1, 21.0, 1.0, &format!("{FEED}0600"));
    let log = log.beats(14, 24.0, 24.5, 1.0, &format!("{PUMP}0100"));
    let mut log = log.lives(14, 25.0, 30.0, PUMP);
    log.answers(2.0, 14, 0, &isotp("AAA"));
    log.answers(3.0, 30, 0, &isotp("BBB"));
    let values = run(folder.path(), &["watch"], &log.text());
    let modes = values.iter().filter(|value| value["event"] == "mode" && value["name"] == "BBB");
    let modes: Vec<_> = modes.map(|it| (it["from"].as_str(), it["mode"].as_str())).collect();
    assert_eq!(modes, [(Some("ARSLV"), Some("WORK"))], "{values:#?}");
    assert!(values.iter().any(|value| value["event"] == "moved"), "{values:#?}");
}

#[test]
fn board_beside_one_that_only_responds_keeps_its_uid() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = Log::default().lives(14, 0.1, 80.0, FEED);
    for (at, name) in [(1, "AAA"), (21, "BBB"), (31, "AAA"), (41, "BBB"), (51, "BBB"), (71, "BBB")]
    {
        log.answers(f64::from(at), 14, 0, &isotp(name));
    }
    let devices = named_devices(folder.path(), log);
    assert_eq!(devices[0].1, "AAA");
    assert_eq!((&*devices[0].2, &*devices[0].3), ("BOILER01", "online"), "{devices:?}");
}

#[test]
fn name_after_a_conflict_is_no_evidence_of_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = two_named_boards(60.0, 20.0);
    log.asks(45.0, 0, "0444455301");
    log.answers(45.002, 14, 0, &isotp("AAA"));
    let values = run(folder.path(), &["watch"], &log.text());
    let findings = values.iter().filter(|value| value["event"] == "finding");
    let late = findings.filter(|value| value["time"].as_f64().unwrap() > 1_436_509_052.0 + 40.0);
    let late: Vec<_> = late.collect();
    assert!(late.is_empty(), "{late:#?}");
}

#[test]
fn uid_conflict_and_debug_conflict_are_found() {
    let mut cases: Vec<Case> = Vec::new();
    for seconds in [6.0, 10.0, 30.0] {
        let uid = Log::default().lives(12, 0.1, seconds, FEED).lives(13, 0.4, seconds, FEED);
        let what: Confirmed = &[("one-uid-two-addresses", 12)];
        cases.push((format!("one UID for {seconds} s"), uid, what));
        let blank = Log::default().lives(12, 0.1, seconds, BLANK).lives(13, 0.4, seconds, BLANK);
        cases.push((format!("blank UIDs for {seconds} s"), blank, NOTHING));
        let debug = Log::default().lives(0, 0.1, seconds, FEED).lives(0, 0.4, seconds, SENS);
        let what: Confirmed = &[("two-debug-devices", 0)];
        cases.push((format!("two at 0 for {seconds} s"), debug, what));
    }
    check(cases);
}

/// Returns a log of three devices with a request every two seconds.
fn peace(seconds: f64) -> Log {
    let log = Log::default()
        .lives(14, 0.1, seconds, FEED)
        .lives(20, 0.23, seconds, PUMP)
        .lives(21, 0.36, seconds, SENS);
    log.asked(seconds, 2.0, 5, &["FEED"])
}

#[test]
fn apparent_conflicts_are_not_confirmed() {
    let mut cases: Vec<Case> = Vec::new();
    for delay in [0.0003, 0.004, 0.03] {
        let doubled = peace(20.0).and(&peace(20.0), delay);
        cases.push((format!("a bridge repeats everything {delay} s later"), doubled, NOTHING));
        let alone = Log::default().lives(14, 0.1, 20.0, FEED);
        let doubled = alone.clone().and(&alone, delay);
        cases.push((format!("a bridge repeats the only device {delay} s later"), doubled, NOTHING));
    }
    for pause in [0.0, 0.35, 0.9, 7.0] {
        let twice = peace(10.2).and(&peace(10.2), 10.2 + pause);
        cases.push((format!("replayed twice, {pause} s between"), twice, NOTHING));
    }
    for pause in [0.2, 0.4, 0.8, 1.3, 2.35] {
        let reboot = Log::default().lives(14, 0.1, 6.0, FEED).lives(14, 5.1 + pause, 20.0, FEED);
        cases.push((format!("a reboot, {pause} s without a heartbeat"), reboot, NOTHING));
        let swap = Log::default().lives(14, 0.1, 6.0, FEED).lives(14, 5.1 + pause, 20.0, SENS);
        let mut old = Log::default().asked(5.0, 1.0, 0, &["FEED"]);
        old.lines.extend(Log::default().asked(14.0, 1.0, 0, &["SENS"]).and_at(6.0));
        cases.push((format!("a board swap in {pause} s"), swap.and(&old, 0.0), NOTHING));
    }
    let mut bursts = peace(30.0);
    bursts.lines.retain(|(at, _)| !(10.0..12.5).contains(at) && !(18.0..18.7003).contains(at));
    cases.push(("bursts of lost frames".to_owned(), bursts, NOTHING));
    let mut unheard = Log::default().asked(30.0, 0.5, 0, &["FEED"]);
    let mut questions = 0..;
    unheard.lines.retain(|(_, line)| {
        !line.ends_with("#0444455301") || questions.next().is_some_and(|count| count % 3 != 2)
    });
    cases.push(("each third question is lost".to_owned(), unheard, NOTHING));
    let mut broken = peace(20.0);
    for count in 0..100 {
        broken.frame(f64::from(count) * 0.2 + 0.03, 0x2000_0088, "0000000000000000");
    }
    let what: Confirmed = &[("bus-errors", 999)];
    cases.push(("error frames in between".to_owned(), broken, what));
    check(cases);
}

/// Tests that one board with a shorter period than expected is never two, however often it restarts or is
/// replaced in its first seconds.
#[test]
fn restarting_board_with_a_shorter_period_is_not_confirmed() {
    let boards = [FEED, SENS, "000000000000"];
    let cases = (0..60).map(|seed| {
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut between = |from: f64, until: f64| from + (until - from) * rng.f64();
        let period = [0.5, 0.5, 0.25, 0.4, 0.7][seed as usize % 5];
        let (mut log, mut at, mut lives) = (Log::default(), 0.0, Vec::new());
        for life in 0..=1 + seed % 3 {
            let is_last = life == 1 + seed % 3;
            let until = at + if is_last { 40.0 } else { between(0.6, 6.0) };
            let board = boards[between(0.0, 3.0) as usize];
            log = log.beats(14, at + between(0.0, period), until, period, &format!("{board}0400"));
            lives.push(format!("{at:.3} to {until:.3} {board}"));
            at = until + between(0.0, 1.5);
        }
        (format!("seed {seed}, a period of {period} s, {lives:?}"), log, NOTHING)
    });
    check(cases.collect());
}

impl Log {
    /// Returns its lines, shifted by so many seconds.
    fn and_at(self, later: f64) -> Vec<(f64, String)> {
        Log::default().and(&self, later).lines
    }
}

#[test]
fn clock_jumps_and_partial_logs_raise_no_conflict() {
    let folder = tempfile::tempdir().unwrap();
    let collision = Log::default().lives(14, 0.1, 20.0, FEED).lives(14, 0.4, 20.0, FEED);
    for (log, confirmed) in [(peace(20.0), NOTHING), (collision, SAME_NAME)] {
        let text = log.text();
        for (from, jump) in [3600.0, 60.0, 1.4, 0.6, -0.6, -1.4, -60.0, -3600.0]
            .into_iter()
            .flat_map(|jump| [(2.9, jump), (9.9, jump)])
        {
            let mut moved = String::new();
            for line in text.lines() {
                let (time, rest) = line[1..].split_once(") ").unwrap();
                let time: f64 = time.parse().unwrap();
                let time = if time > 1_436_509_052.0 + from { time + jump } else { time };
                writeln!(moved, "({time:.6}) {rest}").unwrap();
            }
            let fault = fault(folder.path(), &moved, confirmed);
            assert_eq!(fault, None, "the clock jumps by {jump} s after {from} s");
        }
        for skipped in [1, 8, 11, 17] {
            let rest: String = text.lines().skip(skipped).flat_map(|line| [line, "\n"]).collect();
            assert_eq!(fault(folder.path(), &rest, confirmed), None, "{skipped} lines skipped");
        }
        // Two recordings of the same bus in one file.
        assert_eq!(fault(folder.path(), &text.repeat(2), confirmed), None, "twice in a file");
    }
}

#[test]
fn each_log_interface_is_its_own_bus() {
    let folder = tempfile::tempdir().unwrap();
    let one = Log::default().lives(14, 0.1, 10.0, FEED).text();
    let other = Log::default().lives(14, 0.4, 10.0, SENS).text().replace("can0", "vcan7");
    let mut lines: Vec<&str> = one.lines().chain(other.lines()).collect();
    lines.sort_unstable();
    assert_eq!(fault(folder.path(), &(lines.join("\n") + "\n"), NOTHING), None);
    let collision = Log::default().lives(14, 0.1, 10.0, FEED).lives(14, 0.4, 10.0, SENS).text();
    let quiet = Log::default().lives(14, 0.2, 10.0, PUMP).text().replace("can0", "vcan7");
    let mut lines: Vec<&str> = collision.lines().chain(quiet.lines()).collect();
    lines.sort_unstable();
    let values = run(folder.path(), &["scan"], &(lines.join("\n") + "\n"));
    let findings = values[0]["findings"].as_array().unwrap();
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert_eq!((&findings[0]["bus"], &findings[0]["address"]), (&"can0".into(), &14.into()));
}

/// Returns the findings in a scenario's transcript.
fn transcript(scenario: &str) -> Vec<Told> {
    let lines = scenario.lines().filter_map(|line| line.split_once(" * finding "));
    let told = lines.map(|(_, finding)| {
        let words: Vec<&str> = finding.split(' ').collect();
        let address = words.get(3).map_or(999, |address| address.parse().unwrap());
        (words[0].to_owned(), words[1].to_owned(), address)
    });
    told.collect()
}

#[test]
fn scenario_log_gives_the_findings_of_the_live_bus() {
    let folder = tempfile::tempdir().unwrap();
    let scenarios = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scenarios");
    let mut compared = 0;
    for entry in std::fs::read_dir(scenarios).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let scenario = std::fs::read_to_string(&path).unwrap();
        let mut settings = scenario.lines().filter(|line| line.starts_with("set "));
        // An engine that sends requests receives other frames than a log contains.
        let asks = scenario.lines().any(|line| line.starts_with(' ') && line.contains(" > "));
        let is_heard = !asks && settings.all(|setting| setting == "set listen-only");
        if !is_heard || !(name.starts_with("row_") || name.starts_with("innocent_")) {
            continue;
        }
        let (mut log, mut end) = (String::new(), String::new());
        for line in scenario.lines().filter(|line| line.starts_with(|first: char| first != ' ')) {
            let words: Vec<&str> = line.split(' ').collect();
            match words[..] {
                ["#" | "set", ..] => {}
                [time, "show"] => time.clone_into(&mut end),
                [time, frame] => writeln!(log, "({time}) can0 {frame}").unwrap(),
                _ => panic!("{name}: {line}"),
            }
        }
        // A log ends with its last line: a non-platform frame extends it to the end.
        writeln!(log, "({end}) can0 7FF#").unwrap();
        let told = watched(folder.path(), &log);
        assert_eq!(told, transcript(&scenario), "{name}");
        let confirmed = told.iter().any(|told| told.1 == "confirmed");
        assert!(!(confirmed && name.starts_with("innocent_")), "{name}");
        compared += 1;
    }
    assert!(compared > 25, "{compared} scenarios");
}

#[test]
fn static_addresses_in_file_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = Log::default().lives(12, 0.1, 8.0, FEED).lives(31, 0.4, 8.0, SENS);
    log.asks(0.7, 0, "0444455301");
    log.answers(0.702, 12, 0, &isotp("FEED"));
    log.answers(0.704, 31, 0, &isotp("SENS"));
    let log = log.text();
    let with = |entries: &str| {
        let file = format!("{{ \"devices\": [ {entries} ] }}");
        std::fs::write(folder.path().join("des.json"), file).unwrap();
        scanned(folder.path(), &log).into_iter().map(|told| (told.0, told.2)).collect::<Vec<_>>()
    };
    let kind = |kind: &str, address: u64| (kind.to_owned(), address);
    let feed = r#"{ "name": "FEED", "address": 31, "static": true }"#;
    let told = with(feed);
    assert!(told.contains(&kind("wrong-address", 12)), "FEED answers from 12: {told:?}");
    assert!(told.contains(&kind("static-address-taken", 31)), "SENS is at 31: {told:?}");
    let told = with(&format!(r#"{feed}, {{ "name": "ACT", "address": 31, "static": true }}"#));
    assert!(told.contains(&kind("file-duplicate-address", 31)), "{told:?}");
    let told = with(&format!("{feed}, {feed}"));
    assert!(told.iter().any(|told| told.0 == "file-duplicate-entry"), "{told:?}");
    let told = with(r#"{ "name": "FEED", "address": 12, "static": true }"#);
    assert_eq!(told, [], "all as it should be");
}

/// Returns a log of candump as it prints frames without times; remote frames are left out.
fn without_times(log: &str) -> String {
    let frames = log.lines().filter_map(|line| line.split(' ').nth(2)?.split_once('#'));
    let frames = frames.filter(|(_, data)| data.bytes().all(|digit| digit.is_ascii_hexdigit()));
    frames.fold(String::new(), |mut printed, (id, data)| {
        let bytes: Vec<_> =
            data.as_bytes().chunks(2).map(|it| str::from_utf8(it).unwrap()).collect();
        writeln!(printed, "  can0  {id:>8}   [{}]  {}", bytes.len(), bytes.join(" ")).unwrap();
        printed
    })
}

#[test]
fn log_without_times_shows_no_conflict_by_rhythm() {
    let folder = tempfile::tempdir().unwrap();
    let many = Scenario::with_many_devices(250_000, 20, 5);
    let constant = Log { constant: Some(5), ..Log::default() };
    let constant = constant.lives(14, 0.1, 60.0, FEED).lives(20, 0.2, 60.0, PUMP);
    let constant = constant.lives(21, 0.3, 60.0, SENS).text();
    for log in [peace(60.0).text(), constant, inspection::log(&many, 20)] {
        assert_eq!(scanned(folder.path(), &log), [], "with times");
        let printed = without_times(&log);
        assert_eq!(scanned(folder.path(), &printed), []);
        let output = run_with_input(&["scan", "-", "--json"], folder.path(), printed.as_bytes());
        let piped: Value = serde_json::from_str(&text(&output.stdout)).unwrap();
        assert_eq!(piped["findings"].as_array().unwrap().len(), 0, "{piped}");
    }
    // What an order shows needs no times.
    let two = Log::default().lives(14, 0.0, 20.0, FEED).lives(14, 0.4, 20.0, SENS);
    let found = scanned(folder.path(), &without_times(&two.text()));
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!((found[0].0.as_str(), found[0].2), ("one-address-two-identities", 14));
}

#[test]
fn two_senders_with_equal_times_are_a_conflict() {
    let folder = tempfile::tempdir().unwrap();
    let expected = [("same-name-same-address".to_owned(), "confirmed".to_owned(), 14)];
    // An adapter delivers several frames together.
    let data = format!("{FEED}0400");
    let two = Log::default().beats(14, 0.0, 20.0, 1.000_013, &data);
    let two = two.beats(14, 0.0, 20.0, 1.000_013, &data);
    assert_eq!(scanned(folder.path(), &two.text()), expected);
}

/// Returns a log whose times are in steps of `step` seconds.
fn in_steps(log: Log, step: f64) -> Log {
    let round = |(at, line): (f64, String)| ((at / step).floor() * step, line);
    Log { lines: log.lines.into_iter().map(round).collect(), ..log }
}

#[test]
fn healthy_bus_in_a_coarse_log_has_no_conflict() {
    let folder = tempfile::tempdir().unwrap();
    let data = format!("{FEED}0400");
    for step in [0.1, 1.0] {
        for period in [0.1, 0.25, 0.35, 0.5, 0.7, 1.0, 1.5, 2.5, 5.0] {
            for constant in [None, Some(5)] {
                let log = Log { constant, ..Log::default() };
                let log = log.beats(14, 0.03, 60.0, period + 0.000_02, &data);
                let log = log.beats(20, 0.37, 60.0, 5.0, &format!("{PUMP}0400"));
                let log = log.beats(21, 0.71, 60.0, 5.0, &format!("{SENS}0400"));
                let mut found = scanned(folder.path(), &in_steps(log, step).text());
                found.retain(|told| told.1 != "cleared");
                assert_eq!(found, [], "{period} s in steps of {step} s, {constant:?}");
            }
        }
    }
}

#[test]
fn fast_sender_in_steps_of_a_system_clock_is_not_confirmed() {
    let folder = tempfile::tempdir().unwrap();
    for step in [1.0 / 64.0, 0.02, 0.05] {
        for period in [0.04, 0.05, 0.07, 0.08, 0.12] {
            let log = Log::default().beats(14, 0.033, 20.0, period, &format!("{FEED}0400"));
            let found = scanned(folder.path(), &in_steps(log, step).text());
            let confirmed = found.iter().filter(|told| told.1 == "confirmed").count();
            assert_eq!(confirmed, 0, "{period} s in steps of {step} s: {found:?}");
        }
    }
}

#[test]
fn two_senders_in_a_coarse_log_are_a_conflict() {
    let folder = tempfile::tempdir().unwrap();
    let data = format!("{FEED}0400");
    let expected = [("same-name-same-address".to_owned(), "confirmed".to_owned(), 14)];
    for (step, expected) in [(0.1, &expected[..]), (1.0, &[])] {
        let two = Log::default().beats(14, 0.03, 60.0, 1.000_02, &data);
        let two = two.beats(14, 0.33, 60.0, 1.000_02, &data);
        let log = in_steps(two, step).text();
        assert_eq!(scanned(folder.path(), &log), expected, "{step} s");
        let output = run_with_input(&["scan", "-"], folder.path(), log.as_bytes());
        let warning = text(&output.stderr);
        let step = if expected.is_empty() { "1000 ms" } else { "100 ms" };
        assert!(warning.contains(&format!("times in steps of {step}: devices")), "{warning}");
    }
}

#[test]
fn constant_rnd7_of_a_fast_sender_is_not_taken_for_copies() {
    let folder = tempfile::tempdir().unwrap();
    for period in [0.04, 0.08, 0.099_9, 0.101] {
        let log = Log { constant: Some(5), ..Log::default() };
        let mut log = log.beats(14, 0.033, 60.0, period, &format!("{FEED}0400"));
        for count in [40, 41, 90, 170] {
            log.lines.remove(count);
        }
        log = log.beats(20, 0.041, 60.0, period, &format!("{PUMP}0400"));
        let mut found = scanned(folder.path(), &log.text());
        // Of one that is much faster, two boards are suspected at first.
        found.retain(|(kind, confidence, _)| kind == "frames-repeated" || confidence != "cleared");
        assert_eq!(found, [], "{period} s");
    }
}

#[test]
fn bridge_in_a_coarse_log_is_not_taken_for_two_senders() {
    let folder = tempfile::tempdir().unwrap();
    let constant = Log { constant: Some(5), ..Log::default() };
    let mut log = constant.lives(14, 0.0, 20.0, FEED);
    for (at, line) in log.lines.clone() {
        // A copy with the time of the frame, or of the next step of the clock.
        let delay = if at < 0.5 { 0.0 } else { 0.01 };
        log.lines.push((at + delay, line));
    }
    let found = scanned(folder.path(), &log.text());
    assert!(found.iter().all(|told| told.1 != "confirmed"), "{found:?}");
}
