//! Error frames as evidence: of a bus that is disturbed, and of one address at which two
//! devices destroy each other's frames.
//!
//! An error frame does not say whose frame broke. But two devices at one address that answer
//! one question with different bytes break each other's answer again and again, some sixteen
//! times, until both are error-passive: a burst of errors between the question and the answer,
//! or instead of it, each time that address is asked, while the rest of the bus is clean. So a
//! *window* is kept open while an address is expected to send, from a question to its answer,
//! or about a heartbeat that is due, and what breaks in it is set against what breaks outside.
//!
//! An address is named only where
//!
//! * in each of three windows three frames or more broke, with fewer whole ones between, at a
//!   time at which nobody else was expected to send; or in each of two windows eight or more,
//!   with next to no whole ones between;
//! * and of other bursts, when it was not expected to send, there are at most a third as many,
//!   but for those that follow another address;
//! * and its windows are not clean when it is asked again, some seconds later;
//! * and outside of windows next to nothing breaks: at most three frames and 2 % of all, and
//!   not more than one in a second. On a
//!   bus that is disturbed, at a wrong rate or badly terminated, nobody is named.
//!
//! Even then it is only suspected: a bad transceiver looks the same.
//!
//! `window` holds what broke while an address was expected to send, `background` what broke
//! otherwise, `rate` the errors of the bus as a whole; `telling` is what the engine does with them.

mod background;
mod rate;
mod report;
mod window;

pub(super) use rate::{BusErrorSummary, Cause};

use crate::error_report::ErrorReport;
use crate::finding::Evidence;
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::id::Address;
use background::{Background, RUN_COUNTS};
use rate::ErrorRate;
use std::collections::VecDeque;
use window::{BURST, BroadcastWindow, LONGEST_BURST, Window};

/// Windows that are open at the same time; beyond that the oldest is forgotten.
const MAX_WINDOWS: usize = 32;
/// Addresses that are looked into at the same time; beyond that nobody new is.
const MAX_SUSPECTS: usize = 16;
/// How much names an address.
const NAMED_FROM: u32 = 6;
/// Clean windows in a row that end a suspicion, and that clear an address that was named.
const CLEAN: u32 = 2;
const CLEAN_NAMED: u32 = 3;
/// The same for heartbeats, of which there are more.
const CLEAN_BEATS: u32 = 10;
/// For so long after a burst a clean window says nothing: of two devices that gave up one may
/// be back.
const RESTART: Duration = Duration::from_secs(5);
/// Questions to look into a suspicion, at most, and how far apart, more with each: no part of
/// the heartbeat's period, or what happens with every heartbeat would meet every question.
const FOLLOW_UPS: u32 = 6;
const FOLLOW_UP_AFTER: Duration = Duration::from_millis(770);
/// How often an address that was named is asked again. Seldom: its devices may begin anew with
/// each burst.
const ASK_NAMED: Duration = Duration::from_millis(20_370);
/// A suspicion without another burst ends after this, and so does a finding.
const MEMORY: Duration = Duration::from_secs(45);
/// How far the receive error counter must have gone up since it was last reported to tell of a
/// burst just now.
const COUNTED: u8 = 16;
/// How long it must go on: what disturbs the bus meets others meanwhile.
const LASTING: Duration = Duration::from_millis(2500);
/// Bursts that are remembered.
const MAX_BURSTS: usize = 64;
/// How often the finding about the bus is worded: error frames may come by the thousand.
const WORDS: Duration = Duration::from_millis(200);

/// What an address is expected to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Due {
    Answer(Request),
    Heartbeat,
}

/// An address in whose windows frames broke.
#[derive(Debug)]
struct Suspect {
    address: Address,
    due: Due,
    /// What its bursts count together, and how many they are.
    weight: u32,
    hits: u32,
    /// Clean windows since the last burst.
    clean: u32,
    began: Instant,
    last: Instant,
    /// Evidence until the address is named.
    evidence: Vec<Evidence>,
    /// Whether it did not answer when a burst may have been its own, or another's.
    silent: bool,
    /// Until when it may answer our last question.
    asked_until: Option<Instant>,
    /// Whether it was put off when it was to be asked.
    waits: bool,
    follow_ups: u32,
    ask_at: Option<Instant>,
    named: bool,
}

impl Suspect {
    fn ends(&self) -> Instant {
        self.last + MEMORY
    }
}

/// What becomes of an address that was looked into.
#[derive(Debug)]
enum SuspectOutcome {
    /// Errors follow it; with the evidence that is new.
    Named(Address, Due, Vec<Evidence>),
    /// They do not, or no more.
    Cleared(Address),
}

/// What is known of the errors on a bus.
#[derive(Debug, Default)]
pub(super) struct BusErrorTracker {
    rate: ErrorRate,
    /// When the finding about the bus was worded last, and whether it is to be anew.
    worded: Instant,
    outdated: bool,
    /// The controller's error counters, as they were reported last.
    counters: Option<(u8, u8)>,
    windows: Vec<Window>,
    suspects: Vec<Suspect>,
    background: Background,
    broadcast: Option<BroadcastWindow>,
    /// The last bursts, and who was expected to send then: one bit for each address.
    bursts: VecDeque<(Instant, u128)>,
    /// The number of the last frame that broke, and how many broke in a row.
    run: (u64, u64),
    verdicts: VecDeque<SuspectOutcome>,
    /// Frames heard, as far as it was told.
    frames: u64,
}

impl BusErrorTracker {
    /// A frame comes; `frames` came before it. Whether that changes when
    /// [`handle_timeout`](Self::handle_timeout) is due.
    pub fn note_frame(&mut self, now: Instant, frames: u64) -> bool {
        self.rate.note_frame(now, frames)
    }

    /// A question to `address` passed by; its answer is awaited until `ends`.
    pub fn note_request(
        &mut self,
        address: Address,
        request: Request,
        ends: Instant,
        frame: &Frame,
    ) {
        let due = Due::Answer(request);
        if let Some(open) = self.window(address, due) {
            // Asked in another framing, or again.
            open.ends = open.ends.max(ends);
        } else {
            self.open(address, due, ends, Some(*frame));
        }
    }

    /// A question to all passed by, which the addresses `awaited` (one bit each) may answer until
    /// `ends`.
    pub fn note_broadcast(&mut self, now: Instant, ends: Instant, awaited: u128, frame: &Frame) {
        let before = self.broadcast.take().filter(|it| now < it.ends);
        // Asked in two framings, or in two modes, whoever answered once has answered.
        let (more, answered) = before.map_or((0, 0), |it| (it.awaited, it.answered));
        let awaited = (awaited | more) & !answered;
        self.broadcast = Some(BroadcastWindow { request: *frame, ends, awaited, answered });
    }

    /// Part of an answer came: the rest is awaited until `ends`.
    pub fn note_partial_response(&mut self, address: Address, ends: Instant) {
        for window in &mut self.windows {
            if window.address == address && window.due != Due::Heartbeat {
                window.ends = window.ends.max(ends);
            }
        }
    }

    /// A whole answer came; `frames` were heard in all.
    pub fn note_response(
        &mut self,
        now: Instant,
        address: Address,
        request: Request,
        frame: &Frame,
        frames: u64,
    ) {
        self.frames = frames;
        if let Some(broadcast) = &mut self.broadcast {
            broadcast.awaited &= !(1 << address.index());
            broadcast.answered |= 1 << address.index();
        }
        self.close(now, address, Due::Answer(request), Some(frame));
    }

    /// A heartbeat came.
    pub fn note_heartbeat(&mut self, now: Instant, address: Address, frame: &Frame) {
        if self.windows.is_empty() && self.suspects.is_empty() {
            return;
        }
        self.close(now, address, Due::Heartbeat, Some(frame));
    }

    /// Frames were lost before they reached us: an answer may have been among them.
    pub fn note_lost_frames(&mut self) {
        self.windows.clear();
    }

    /// The node at `address` is lost.
    pub fn forget(&mut self, address: Address) {
        self.windows.retain(|window| window.address != address);
        let named = self.suspects.iter().position(|it| it.address == address && it.named);
        if let Some(at) = named {
            self.end(at);
        }
    }

    /// The controller begins anew.
    pub fn restart(&mut self) {
        self.rate.restart();
        self.windows.clear();
    }

    /// Whether an address is being looked into that may yet be named.
    pub fn has_pending_suspect(&self) -> bool {
        let mut open = self.suspects.iter().filter(|suspect| !suspect.named);
        open.any(|suspect| suspect.weight > 0 && suspect.ask_at.is_some())
    }

    /// Whether errors followed `address`, so that asking it shows more.
    pub fn is_suspect(&self, address: Address) -> bool {
        self.suspects.iter().any(|suspect| suspect.address == address)
    }

    /// `address` is about to be asked, and may answer until `until`. When it is to be asked
    /// instead, where that is not now: of those that are looked into each is asked alone, or it
    /// would never be known whose frames break. They take turns: who was asked before it and waits
    /// comes first.
    pub fn postpone_recheck(
        &mut self,
        now: Instant,
        address: Address,
        until: Instant,
    ) -> Option<Instant> {
        let at = self.suspects.iter().position(|suspect| suspect.address == address)?;
        let own = self.suspects[at].asked_until;
        let others = self.suspects.iter().filter(|suspect| suspect.address != address);
        let busy = others.filter_map(|suspect| suspect.asked_until).max();
        let later = busy.filter(|until| now < *until).or_else(|| {
            let before = self.suspects.iter_mut().filter(|it| it.waits && it.asked_until < own);
            // Only once: it may not be to be asked any more.
            before.min_by_key(|it| it.asked_until)?.waits = false;
            Some(until)
        });
        let suspect = &mut self.suspects[at];
        suspect.waits = later.is_some();
        if later.is_none() {
            suspect.asked_until = Some(until);
        }
        later
    }

    /// How many frames broke, as far as a report tells. Drivers that do not report each broken
    /// frame report the counters when they pass a limit.
    fn broken(&mut self, report: &ErrorReport) -> u64 {
        let before = self.counters;
        self.counters = report.counters().or(before);
        if report.is_broken_frame() {
            return 1;
        }
        let (true, Some((_, received))) = (report.is_error_state(), report.counters()) else {
            return 0;
        };
        // The transmit counter goes up where nobody acknowledges, too.
        let risen = received.saturating_sub(before.map_or(0, |(_, received)| received));
        if risen >= COUNTED { BURST } else { 0 }
    }

    /// Sets broken frames against who is expected to send. `beating` finds the one address
    /// whose heartbeat is due now, its last one, and when the next is overdue.
    fn attribute(
        &mut self,
        now: Instant,
        report: &ErrorReport,
        broken: u64,
        frame: &Frame,
        beating: impl FnOnce() -> Option<(Address, Option<Frame>, Instant)>,
    ) {
        self.background.advance(now, self.frames);
        if report.is_while_sending() {
            self.background.count(now, broken, self.frames);
            self.note_burst(now, broken, 0);
            return;
        }
        let broadcast = self.broadcast.as_ref().filter(|it| now < it.ends);
        let broadcast = broadcast.map(|it| (it.awaited, it.request, it.ends));
        let windows = self.windows.iter().fold(0, |bits, it| bits | 1 << it.address.index());
        let expected: u128 = windows | broadcast.map_or(0, |(awaited, ..)| awaited);
        self.note_burst(now, broken, expected);
        if expected == 0 {
            match beating() {
                Some((address, last, overdue)) => self.open(address, Due::Heartbeat, overdue, last),
                None => self.background.count(now, broken, self.frames),
            }
        } else if expected.count_ones() > 1 {
            self.windows.iter_mut().for_each(|window| window.shared += broken);
            return;
        } else if windows == 0
            && let Some((_, request, ends)) = broadcast
        {
            // All others have answered.
            let address = Address::from_bits(expected.trailing_zeros() as u8);
            self.open(address, Due::Answer(Request::Name), ends, Some(request));
        }
        // Of several questions to one address the first is answered first.
        let number = self.frames;
        if let Some(window) = self.windows.first_mut() {
            window.note(broken, number, frame);
        }
    }

    /// Remembers bursts, with who was expected to send, one bit each.
    fn note_burst(&mut self, now: Instant, broken: u64, expected: u128) {
        let (last, before) = self.run;
        let before = if self.frames == last + 1 { before } else { 0 };
        let count = before + broken;
        self.run = (self.frames, count);
        let passes = |limit: u64| before < limit && count >= limit;
        // What goes on for longer is no burst of anybody's.
        let endless = passes(LONGEST_BURST + 1);
        if passes(BURST) || endless {
            if self.bursts.len() == MAX_BURSTS {
                self.bursts.pop_front();
            }
            self.bursts.push_back((now, if endless { 0 } else { expected }));
        }
    }

    /// How many of the bursts that are remembered neither this suspect explains nor another one
    /// that is as suspicious.
    fn unexplained(&self, now: Instant, suspect: &Suspect) -> u32 {
        let others = self.suspects.iter().filter(|it| it.hits > 1);
        let explained = others.fold(0u128, |bits, it| bits | 1 << it.address.index());
        let own = 1u128 << suspect.address.index();
        let unexplained = self.bursts.iter().filter(|(at, expected)| {
            let others = expected.is_power_of_two() && expected & explained != 0;
            now.since(*at) < MEMORY && expected & own == 0 && !others
        });
        unexplained.count() as u32
    }

    /// Names those against whom there is enough, and takes back who was named wrongly.
    fn judge(&mut self, now: Instant) {
        let clean = self.background.is_clean();
        let mut at = 0;
        while at < self.suspects.len() {
            let suspect = &self.suspects[at];
            let unexplained = self.unexplained(now, suspect);
            let (hits, enough) = (suspect.hits, suspect.weight >= NAMED_FROM);
            if suspect.named && unexplained > hits || !suspect.named && enough && !clean {
                self.end(at);
                continue;
            }
            let suspect = &mut self.suspects[at];
            let lasting = now.since(suspect.began) >= LASTING;
            if enough && lasting && !suspect.named && unexplained * 3 <= hits {
                suspect.named = true;
                suspect.ask_at = Some(now + ASK_NAMED);
                let evidence = std::mem::take(&mut suspect.evidence);
                self.verdicts.push_back(SuspectOutcome::Named(
                    suspect.address,
                    suspect.due,
                    evidence,
                ));
            }
            at += 1;
        }
    }

    fn window(&mut self, address: Address, due: Due) -> Option<&mut Window> {
        self.windows.iter_mut().find(|window| window.address == address && window.due == due)
    }

    fn open(&mut self, address: Address, due: Due, ends: Instant, cause: Option<Frame>) {
        if self.windows.len() == MAX_WINDOWS {
            self.windows.remove(0);
        }
        self.windows.push(Window {
            address,
            due,
            cause,
            ends,
            errors: 0,
            shared: 0,
            span: None,
            first: None,
            last: None,
        });
    }

    /// What was expected came, or did not in time.
    fn close(&mut self, now: Instant, address: Address, due: Due, came: Option<&Frame>) {
        let at = self.windows.iter().position(|it| it.address == address && it.due == due);
        let Some(at) = at else {
            if due == Due::Heartbeat {
                self.record_clean_window(now, address, due);
            }
            return;
        };
        let window = self.windows.remove(at);
        self.background.advance(now, self.frames);
        let in_time = due == Due::Heartbeat && came.is_some();
        let weight = window.weight().filter(|_| !in_time);
        if let Some(weight) = weight {
            self.record_burst(now, &window, weight, came);
        } else if window.errors == 0 && window.shared == 0 {
            if came.is_some() {
                self.record_clean_window(now, address, due);
            }
        } else if window.shared >= BURST && window.errors < BURST {
            self.schedule_recheck(now, &window, came.is_some());
        } else {
            // Here and there, in time all the same, or without end.
            let run = if window.errors > LONGEST_BURST { f64::MAX } else { RUN_COUNTS };
            self.background.broken += (window.errors as f64).min(run);
        }
    }

    /// There was a burst in a window of an address, and in nobody else's.
    fn record_burst(&mut self, now: Instant, window: &Window, weight: u32, came: Option<&Frame>) {
        if let (Some(first), true) = (window.first, self.background.is_clean()) {
            self.rate.exclude(first.time, now, window.errors);
            self.outdated = false;
        }
        let Some(suspect) = self.suspect(now, window) else { return };
        suspect.weight += weight;
        if suspect.hits == 0 {
            suspect.began = now;
        }
        suspect.hits += 1;
        suspect.clean = 0;
        suspect.due = window.due;
        suspect.last = now;
        if suspect.evidence.len() < 16 {
            suspect.evidence.extend(window.evidence(came));
        }
        let after = if suspect.named { ASK_NAMED } else { FOLLOW_UP_AFTER };
        suspect.ask_at = Some(now + after);
        if !self.background.is_clean() {
            self.suspects.retain(|suspect| suspect.named);
        }
        self.judge(now);
    }

    /// There was a burst that may have been this address's or another's: ask it alone.
    fn schedule_recheck(&mut self, now: Instant, window: &Window, answered: bool) {
        if !self.background.is_clean() {
            return;
        }
        // One after the other, so that each window stands alone; first who did not answer.
        let queue = self.suspects.iter().filter(|suspect| answered || suspect.silent);
        let queue = queue.filter_map(|suspect| suspect.ask_at).max();
        let at = queue.unwrap_or(now).max(now) + FOLLOW_UP_AFTER;
        if let Some(suspect) = self.suspect(now, window) {
            if !answered {
                suspect.silent = true;
                suspect.last = now;
            }
            suspect.ask_at.get_or_insert(at);
        }
    }

    fn suspect(&mut self, now: Instant, window: &Window) -> Option<&mut Suspect> {
        let known = self.suspects.iter().position(|suspect| suspect.address == window.address);
        if known.is_none() {
            if self.suspects.len() == MAX_SUSPECTS {
                return None;
            }
            self.suspects.push(Suspect {
                address: window.address,
                due: window.due,
                weight: 0,
                hits: 0,
                clean: 0,
                began: now,
                last: now,
                evidence: Vec::new(),
                silent: false,
                asked_until: None,
                waits: false,
                follow_ups: 0,
                ask_at: None,
                named: false,
            });
        }
        let at = known.unwrap_or(self.suspects.len() - 1);
        self.suspects.get_mut(at)
    }

    /// What was expected of an address came, and nothing broke.
    fn record_clean_window(&mut self, now: Instant, address: Address, due: Due) {
        let at = self.suspects.iter().position(|it| it.address == address && it.due == due);
        let Some(at) = at else { return };
        let suspect = &mut self.suspects[at];
        if now.since(suspect.last) < RESTART && (suspect.silent || suspect.weight > 0) {
            return;
        }
        suspect.clean += 1;
        let enough = match (due, suspect.named) {
            (Due::Heartbeat, _) => CLEAN_BEATS,
            (_, true) => CLEAN_NAMED,
            (_, false) if suspect.weight == 0 => 1,
            (_, false) => CLEAN,
        };
        if suspect.clean >= enough {
            self.end(at);
        }
    }

    fn end(&mut self, at: usize) {
        let suspect = self.suspects.remove(at);
        if suspect.named {
            self.verdicts.push_back(SuspectOutcome::Cleared(suspect.address));
        }
    }

    fn poll_timeout(&self, frames: u64) -> Option<Instant> {
        let windows = self.windows.iter().map(|window| window.ends);
        let suspects =
            self.suspects.iter().flat_map(|suspect| [Some(suspect.ends()), suspect.ask_at]);
        let words = self.outdated.then(|| self.worded + WORDS);
        windows.chain(suspects.flatten()).chain(self.rate.poll_timeout(frames)).chain(words).min()
    }

    /// Closes what is over. Who is to be asked once more comes back through `ask`, with when it
    /// was last under suspicion; true where it was asked.
    fn handle_timeout(
        &mut self,
        now: Instant,
        mut ask: impl FnMut(Address, Request, Instant) -> bool,
    ) {
        while let Some(window) = self.windows.iter().find(|window| window.ends <= now) {
            let (address, due) = (window.address, window.due);
            self.close(now, address, due, None);
        }
        while let Some(at) = self.suspects.iter().position(|suspect| suspect.ends() <= now) {
            self.end(at);
        }
        if self.suspects.iter().any(|suspect| suspect.named) {
            self.judge(now);
        }
        for suspect in self.suspects.iter_mut().filter(|it| it.ask_at.is_some_and(|at| at <= now)) {
            let Due::Answer(request) = suspect.due else {
                suspect.ask_at = None;
                continue;
            };
            let asked = ask(suspect.address, request, suspect.last);
            suspect.follow_ups += u32::from(asked);
            let after = if suspect.named {
                ASK_NAMED
            } else {
                FOLLOW_UP_AFTER + Duration::from_secs(suspect.follow_ups.into())
            };
            let more = suspect.named || suspect.follow_ups < FOLLOW_UPS;
            suspect.ask_at = more.then(|| now + after);
        }
    }
}
