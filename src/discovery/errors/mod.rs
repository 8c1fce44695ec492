//! Bus errors from error frames: of the bus as a whole, and of one address at which two devices
//! destroy each other's frames (protocol §5.5).
//!
//! An error frame does not show whose frame failed. But two devices at one address that respond to
//! one request with different bytes destroy each other's response repeatedly, some sixteen times,
//! until both are error-passive: a burst of errors between the request and the response, or instead
//! of it, each time that address is requested, while the rest of the bus is clean. So a *window* is
//! open while an address is expected to send, from a request to its response, or around a heartbeat
//! that is due, and the errors in it are compared with those outside.
//!
//! An address is named only if
//!
//! * three or more frames failed in each of three windows, with fewer valid ones between, while no
//!   other node was expected to send; or eight or more in each of two windows, with next to no
//!   valid ones between;
//! * and of other bursts, when it was not expected to send, there are at most a third as many,
//!   except those that follow another address;
//! * and its windows are not clean when the request is repeated, some seconds later;
//! * and outside of windows next to nothing fails: at most three frames and 2 % of all, and not
//!   more than one in a second. On a disturbed bus, with a wrong bit rate or bad termination, no
//!   address is named.
//!
//! Even then it is only suspected: a faulty transceiver looks the same.
//!
//! `window` holds the errors while an address is expected to send, `background` all others, `rate`
//! the errors of the bus as a whole; `report` turns them into findings. Does not know the texts of
//! findings.

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
use background::{Background, MAX_RUN_COUNT};
use rate::ErrorRate;
use std::collections::VecDeque;
use window::{BURST, BroadcastWindow, LONGEST_BURST, Window};

/// Maximum number of open windows; beyond that the oldest is dropped. Bounds the memory; each is
/// open for less than a second.
const MAX_WINDOWS: usize = 32;
/// Maximum number of suspects; beyond that no further address is added. Bounds the requests that
/// check them.
const MAX_SUSPECTS: usize = 16;
/// Sum of the weights of its bursts from which an address is named. Three bursts, or two long ones;
/// tuned with the simulation.
const NAME_FROM_WEIGHT: u32 = 6;
/// Successive clean windows that drop a suspect, and that clear an address that was named. Tuned
/// with the simulation.
const CLEAN_TO_DROP: u32 = 2;
const CLEAN_TO_CLEAR: u32 = 3;
/// Successive clean heartbeats that do so. Chosen: two devices rarely send heartbeats at the same
/// time, so a clean one shows less than a clean response.
const CLEAN_HEARTBEATS: u32 = 10;
/// Time after a burst in which a clean window does not count: of two devices that stopped, one may
/// be back. Chosen: a device that reboots after bus-off needs seconds.
const RESTART_TIME: Duration = Duration::from_secs(5);
/// Maximum number of requests that check a suspect, and the delay of the first, longer with each:
/// not a fraction of the heartbeat period, or an effect of every heartbeat would meet every
/// request. Protocol §5.3.
const MAX_FOLLOW_UPS: u32 = 6;
const FOLLOW_UP_DELAY: Duration = Duration::from_millis(770);
/// Interval of the requests to an address that was named. Long, because its devices may reboot with
/// each burst.
const REPORTED_FOLLOW_UP_DELAY: Duration = Duration::from_millis(20_370);
/// Time without another burst after which a suspect is dropped, or its finding cleared. Two
/// requests to an address that was named, and one that is lost.
const SUSPECT_LIFETIME: Duration = Duration::from_secs(45);
/// Increase of the receive error counter (REC) since its last report that shows a burst. Two
/// destroyed frames: REC grows by 8 each (ISO 11898-1).
const MIN_REC_STEP: u8 = 16;
/// Minimum time from the first burst to naming an address: a disturbance of the bus affects others
/// in that time. Tuned with the simulation.
const MIN_SUSPECT_TIME: Duration = Duration::from_millis(2500);
/// Maximum number of bursts stored. Bounds the memory.
const MAX_BURSTS: usize = 64;
/// Minimum interval between updates of the text of the bus finding: error frames may arrive by the
/// thousand. Chosen: five updates per second can be read.
const TEXT_INTERVAL: Duration = Duration::from_millis(200);

/// Frame that an address is expected to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ExpectedFrame {
    Response(Request),
    Heartbeat,
}

/// An address with errors in its windows.
#[derive(Clone, Debug)]
struct Suspect {
    address: Address,
    expected: ExpectedFrame,
    /// Sum of the weights of its bursts, and their number.
    weight: u32,
    bursts: u32,
    /// Clean windows since the last burst.
    clean: u32,
    began: Instant,
    last: Instant,
    /// Evidence collected until the address is named.
    evidence: Vec<Evidence>,
    /// True if it did not respond when a burst may have been its own or another's.
    has_not_responded: bool,
    /// Time until which it may respond to descan's last request.
    response_until: Option<Instant>,
    /// True if its request was postponed.
    is_postponed: bool,
    follow_up_count: u32,
    next_follow_up: Option<Instant>,
    is_reported: bool,
}

impl Suspect {
    /// Returns when the suspect is dropped without another burst.
    fn ends(&self) -> Instant {
        self.last + SUSPECT_LIFETIME
    }
}

/// Result of checking a suspect.
#[derive(Clone, Debug)]
enum SuspectOutcome {
    /// Errors follow the address; with the new evidence.
    Reported(Address, ExpectedFrame, Vec<Evidence>),
    /// Errors do not follow the address, or no longer.
    Cleared(Address),
}

/// State of the errors on one bus.
#[derive(Clone, Debug, Default)]
pub(super) struct BusErrorTracker {
    rate: ErrorRate,
    /// Time of the last update of the bus finding's text, and whether another is needed.
    text_written_at: Instant,
    is_text_outdated: bool,
    /// Error counters (TEC, REC) of the controller in the last report.
    counters: Option<(u8, u8)>,
    windows: Vec<Window>,
    suspects: Vec<Suspect>,
    background: Background,
    broadcast: Option<BroadcastWindow>,
    /// Last bursts, and the addresses expected to send at that time, one bit each.
    bursts: VecDeque<(Instant, u128)>,
    /// Number of the last failed frame, and how many failed in a row.
    run: (u64, u64),
    outcomes: VecDeque<SuspectOutcome>,
    /// Number of frames received.
    frames: u64,
}

impl BusErrorTracker {
    /// Notes a frame; `frames` were received before it. Returns true if that changes when
    /// [`handle_timeout`](Self::handle_timeout) is due.
    pub fn note_frame(&mut self, now: Instant, frames: u64) -> bool {
        let is_back = self.rate.note_frame(now, frames);
        self.is_text_outdated |= is_back;
        is_back
    }

    /// Notes a request to `address` whose response is awaited until `ends`.
    pub fn note_request(
        &mut self,
        address: Address,
        request: Request,
        ends: Instant,
        frame: &Frame,
    ) {
        let due = ExpectedFrame::Response(request);
        if let Some(open) = self.window(address, due) {
            // Repeated, or in another framing.
            open.ends = open.ends.max(ends);
        } else {
            self.open(address, due, ends, Some(*frame));
        }
    }

    /// Notes a broadcast request that the addresses `awaited` (one bit each) may respond to until
    /// `ends`.
    pub fn note_broadcast(&mut self, now: Instant, ends: Instant, awaited: u128, frame: &Frame) {
        let before = self.broadcast.take().filter(|it| now < it.ends);
        // The request is sent in two framings and to two modes; a node responds once.
        let (more, responded) = before.map_or((0, 0), |it| (it.awaited, it.responded));
        let awaited = (awaited | more) & !responded;
        self.broadcast = Some(BroadcastWindow { request: *frame, ends, awaited, responded });
    }

    /// Notes a part of a response; the rest is awaited until `ends`.
    pub fn note_partial_response(&mut self, address: Address, ends: Instant) {
        for window in &mut self.windows {
            if window.address == address && window.due != ExpectedFrame::Heartbeat {
                window.ends = window.ends.max(ends);
            }
        }
    }

    /// Notes a complete response; `frames` were received in all.
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
            broadcast.responded |= 1 << address.index();
        }
        self.close(now, address, ExpectedFrame::Response(request), Some(frame));
    }

    /// Notes a heartbeat.
    pub fn note_heartbeat(&mut self, now: Instant, address: Address, frame: &Frame) {
        if self.windows.is_empty() && self.suspects.is_empty() {
            return;
        }
        self.close(now, address, ExpectedFrame::Heartbeat, Some(frame));
    }

    /// Notes lost frames: a response may have been among them.
    pub fn note_lost_frames(&mut self) {
        self.windows.clear();
    }

    /// Forgets `address`, whose device is lost.
    pub fn forget(&mut self, address: Address) {
        self.windows.retain(|window| window.address != address);
        let named = self.suspects.iter().position(|it| it.address == address && it.is_reported);
        if let Some(at) = named {
            self.end(at);
        }
    }

    /// Handles a restart of the controller.
    pub fn restart(&mut self) {
        self.rate.restart();
        self.windows.clear();
    }

    /// Returns true if a suspect may still be named.
    pub fn has_pending_suspect(&self) -> bool {
        let mut open = self.suspects.iter().filter(|suspect| !suspect.is_reported);
        open.any(|suspect| suspect.weight > 0 && suspect.next_follow_up.is_some())
    }

    /// Returns true if `address` is a suspect, so that further requests show more.
    pub fn is_suspect(&self, address: Address) -> bool {
        self.suspects.iter().any(|suspect| suspect.address == address)
    }

    /// Decides whether a request may be sent to `address` now, whose response may take until
    /// `until`; returns a later time otherwise. Only one suspect is requested at a time, because
    /// errors could not be attributed otherwise. Suspects take turns: the one requested longest ago
    /// that waits comes first.
    pub fn postpone_recheck(
        &mut self,
        now: Instant,
        address: Address,
        until: Instant,
    ) -> Option<Instant> {
        let at = self.suspects.iter().position(|suspect| suspect.address == address)?;
        let own = self.suspects[at].response_until;
        let others = self.suspects.iter().filter(|suspect| suspect.address != address);
        let busy = others.filter_map(|suspect| suspect.response_until).max();
        let later = busy.filter(|until| now < *until).or_else(|| {
            let before =
                self.suspects.iter_mut().filter(|it| it.is_postponed && it.response_until < own);
            // Only once: its request may no longer be planned.
            before.min_by_key(|it| it.response_until)?.is_postponed = false;
            Some(until)
        });
        let suspect = &mut self.suspects[at];
        suspect.is_postponed = later.is_some();
        if later.is_none() {
            suspect.response_until = Some(until);
        }
        later
    }

    /// Returns how many frames failed according to a report. Drivers that do not report each error
    /// report the counters when they pass a limit.
    fn broken(&mut self, report: &ErrorReport) -> u64 {
        let before = self.counters;
        self.counters = report.counters().or(before);
        if report.is_bus_error() {
            return 1;
        }
        let (true, Some((_, received))) = (report.is_error_state(), report.counters()) else {
            return 0;
        };
        // The transmit error counter (TEC) also rises without acknowledgement.
        let risen = received.saturating_sub(before.map_or(0, |(_, received)| received));
        if risen >= MIN_REC_STEP { BURST } else { 0 }
    }

    /// Attributes failed frames to the addresses expected to send. `due_heartbeat` returns the only
    /// address whose heartbeat is due now, its last heartbeat, and when the next is overdue.
    fn attribute(
        &mut self,
        now: Instant,
        report: &ErrorReport,
        broken: u64,
        frame: &Frame,
        due_heartbeat: impl FnOnce() -> Option<(Address, Option<Frame>, Instant)>,
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
            match due_heartbeat() {
                Some((address, last, overdue)) => {
                    self.open(address, ExpectedFrame::Heartbeat, overdue, last);
                }
                None => self.background.count(now, broken, self.frames),
            }
        } else if expected.count_ones() > 1 {
            self.windows.iter_mut().for_each(|window| window.shared += broken);
            return;
        } else if windows == 0
            && let Some((_, request, ends)) = broadcast
        {
            // All other addresses have responded.
            let address = Address::from_bits(expected.trailing_zeros() as u8);
            self.open(address, ExpectedFrame::Response(Request::Name), ends, Some(request));
        }
        // The first of several requests to one address gets its response first.
        let number = self.frames;
        if let Some(window) = self.windows.first_mut() {
            window.note(broken, number, frame);
        }
    }

    /// Stores a burst with the addresses expected to send, one bit each.
    fn note_burst(&mut self, now: Instant, broken: u64, expected: u128) {
        let (last, before) = self.run;
        let before = if self.frames == last + 1 { before } else { 0 };
        let count = before + broken;
        self.run = (self.frames, count);
        let passes = |limit: u64| before < limit && count >= limit;
        // A longer series is not a burst of one address.
        let endless = passes(LONGEST_BURST + 1);
        if passes(BURST) || endless {
            if self.bursts.len() == MAX_BURSTS {
                self.bursts.pop_front();
            }
            self.bursts.push_back((now, if endless { 0 } else { expected }));
        }
    }

    /// Returns how many of the stored bursts neither this suspect explains nor another one with
    /// several bursts.
    fn unexplained(&self, now: Instant, suspect: &Suspect) -> u32 {
        let others = self.suspects.iter().filter(|it| it.bursts > 1);
        let explained = others.fold(0u128, |bits, it| bits | 1 << it.address.index());
        let own = 1u128 << suspect.address.index();
        let unexplained = self.bursts.iter().filter(|(at, expected)| {
            let others = expected.is_power_of_two() && expected & explained != 0;
            now.since(*at) < SUSPECT_LIFETIME && expected & own == 0 && !others
        });
        unexplained.count() as u32
    }

    /// Names suspects with enough evidence, and clears those named wrongly.
    fn judge(&mut self, now: Instant) {
        let clean = self.background.is_clean();
        let mut at = 0;
        while at < self.suspects.len() {
            let suspect = &self.suspects[at];
            let unexplained = self.unexplained(now, suspect);
            let (hits, enough) = (suspect.bursts, suspect.weight >= NAME_FROM_WEIGHT);
            if suspect.is_reported && unexplained > hits || !suspect.is_reported && enough && !clean
            {
                self.end(at);
                continue;
            }
            let suspect = &mut self.suspects[at];
            let lasting = now.since(suspect.began) >= MIN_SUSPECT_TIME;
            if enough && lasting && !suspect.is_reported && unexplained * 3 <= hits {
                suspect.is_reported = true;
                suspect.next_follow_up = Some(now + REPORTED_FOLLOW_UP_DELAY);
                let evidence = std::mem::take(&mut suspect.evidence);
                self.outcomes.push_back(SuspectOutcome::Reported(
                    suspect.address,
                    suspect.expected,
                    evidence,
                ));
            }
            at += 1;
        }
    }

    fn window(&mut self, address: Address, due: ExpectedFrame) -> Option<&mut Window> {
        self.windows.iter_mut().find(|window| window.address == address && window.due == due)
    }

    fn open(&mut self, address: Address, due: ExpectedFrame, ends: Instant, cause: Option<Frame>) {
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

    /// Closes a window: the expected frame arrived, or did not in time (`came` is `None`).
    fn close(&mut self, now: Instant, address: Address, due: ExpectedFrame, came: Option<&Frame>) {
        let at = self.windows.iter().position(|it| it.address == address && it.due == due);
        let Some(at) = at else {
            if due == ExpectedFrame::Heartbeat {
                self.record_clean_window(now, address, due);
            }
            return;
        };
        let window = self.windows.remove(at);
        self.background.advance(now, self.frames);
        let in_time = due == ExpectedFrame::Heartbeat && came.is_some();
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
            // Scattered errors, errors before a heartbeat in time, or an endless series.
            let run = if window.errors > LONGEST_BURST { f64::MAX } else { MAX_RUN_COUNT };
            self.background.broken += (window.errors as f64).min(run);
        }
    }

    /// Records a burst in a window of this address alone.
    fn record_burst(&mut self, now: Instant, window: &Window, weight: u32, came: Option<&Frame>) {
        if let (Some(first), true) = (window.first, self.background.is_clean()) {
            self.rate.exclude(first.time, now, window.errors);
            self.is_text_outdated = false;
        }
        let Some(suspect) = self.suspect(now, window) else { return };
        suspect.weight += weight;
        if suspect.bursts == 0 {
            suspect.began = now;
        }
        suspect.bursts += 1;
        suspect.clean = 0;
        suspect.expected = window.due;
        suspect.last = now;
        if suspect.evidence.len() < 16 {
            suspect.evidence.extend(window.evidence(came));
        }
        let after = if suspect.is_reported { REPORTED_FOLLOW_UP_DELAY } else { FOLLOW_UP_DELAY };
        suspect.next_follow_up = Some(now + after);
        if !self.background.is_clean() {
            self.suspects.retain(|suspect| suspect.is_reported);
        }
        self.judge(now);
    }

    /// Plans a separate request after a burst that may have been this address's or another's.
    fn schedule_recheck(&mut self, now: Instant, window: &Window, responded: bool) {
        if !self.background.is_clean() {
            return;
        }
        // One after the other, so that windows do not overlap; addresses without a response first.
        let queue = self.suspects.iter().filter(|suspect| responded || suspect.has_not_responded);
        let queue = queue.filter_map(|suspect| suspect.next_follow_up).max();
        let at = queue.unwrap_or(now).max(now) + FOLLOW_UP_DELAY;
        if let Some(suspect) = self.suspect(now, window) {
            if !responded {
                suspect.has_not_responded = true;
                suspect.last = now;
            }
            suspect.next_follow_up.get_or_insert(at);
        }
    }

    /// Returns the suspect of a window, new if needed; `None` if there are too many.
    fn suspect(&mut self, now: Instant, window: &Window) -> Option<&mut Suspect> {
        let known = self.suspects.iter().position(|suspect| suspect.address == window.address);
        if known.is_none() {
            if self.suspects.len() == MAX_SUSPECTS {
                return None;
            }
            self.suspects.push(Suspect {
                address: window.address,
                expected: window.due,
                weight: 0,
                bursts: 0,
                clean: 0,
                began: now,
                last: now,
                evidence: Vec::new(),
                has_not_responded: false,
                response_until: None,
                is_postponed: false,
                follow_up_count: 0,
                next_follow_up: None,
                is_reported: false,
            });
        }
        let at = known.unwrap_or(self.suspects.len() - 1);
        self.suspects.get_mut(at)
    }

    /// Records an expected frame without errors.
    fn record_clean_window(&mut self, now: Instant, address: Address, due: ExpectedFrame) {
        let at = self.suspects.iter().position(|it| it.address == address && it.expected == due);
        let Some(at) = at else { return };
        let suspect = &mut self.suspects[at];
        if now.since(suspect.last) < RESTART_TIME
            && (suspect.has_not_responded || suspect.weight > 0)
        {
            return;
        }
        suspect.clean += 1;
        let enough = match (due, suspect.is_reported) {
            (ExpectedFrame::Heartbeat, _) => CLEAN_HEARTBEATS,
            (_, true) => CLEAN_TO_CLEAR,
            (_, false) if suspect.weight == 0 => 1,
            (_, false) => CLEAN_TO_DROP,
        };
        if suspect.clean >= enough {
            self.end(at);
        }
    }

    fn end(&mut self, at: usize) {
        let suspect = self.suspects.remove(at);
        if suspect.is_reported {
            self.outcomes.push_back(SuspectOutcome::Cleared(suspect.address));
        }
    }

    fn poll_timeout(&self, frames: u64) -> Option<Instant> {
        let windows = self.windows.iter().map(|window| window.ends);
        let suspects =
            self.suspects.iter().flat_map(|suspect| [Some(suspect.ends()), suspect.next_follow_up]);
        let text = self.is_text_outdated.then(|| self.text_written_at + TEXT_INTERVAL);
        windows.chain(suspects.flatten()).chain(self.rate.poll_timeout(frames)).chain(text).min()
    }

    /// Closes windows that are over and drops old suspects. Calls `query` for addresses to be
    /// requested again, with the time of their last burst; it returns true if the request is
    /// planned.
    fn handle_timeout(
        &mut self,
        now: Instant,
        mut query: impl FnMut(Address, Request, Instant) -> bool,
    ) {
        while let Some(window) = self.windows.iter().find(|window| window.ends <= now) {
            let (address, due) = (window.address, window.due);
            self.close(now, address, due, None);
        }
        while let Some(at) = self.suspects.iter().position(|suspect| suspect.ends() <= now) {
            self.end(at);
        }
        if self.suspects.iter().any(|suspect| suspect.is_reported) {
            self.judge(now);
        }
        for suspect in
            self.suspects.iter_mut().filter(|it| it.next_follow_up.is_some_and(|at| at <= now))
        {
            let ExpectedFrame::Response(request) = suspect.expected else {
                suspect.next_follow_up = None;
                continue;
            };
            let is_sent = query(suspect.address, request, suspect.last);
            suspect.follow_up_count += u32::from(is_sent);
            let after = if suspect.is_reported {
                REPORTED_FOLLOW_UP_DELAY
            } else {
                FOLLOW_UP_DELAY + Duration::from_secs(suspect.follow_up_count.into())
            };
            let more = suspect.is_reported || suspect.follow_up_count < MAX_FOLLOW_UPS;
            suspect.next_follow_up = more.then(|| now + after);
        }
    }
}
