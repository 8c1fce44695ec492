//! History of one address: the recent values in its frames, its heartbeats and its responses. The
//! only store of them; bounded.
//!
//! Does not decide what an observation means: the detectors do.

use super::prompted_heartbeats::PromptedHeartbeats;
use super::query_responses::QueryResponseMatcher;
use super::recent_values::{MAX_VALUES, RecentValues};
use super::rhythm::{alternating_period, delay_of_close_pairs, last_in_other_phase};
use super::time_resolution::is_coarse;
use crate::frame::Frame;
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::Framing;
use crate::wire::node::Uid;
use std::collections::VecDeque;

/// A heartbeat received again within this time was repeated on its way, if its sender is not known
/// to generate RND7. Two devices that do not, and so send equal heartbeats, are rarely this close:
/// a tenth of the default period.
const COPY_WINDOW: Duration = Duration::from_millis(100);
/// Longest delay of a bridge: of 300 frames in its queue, at 125 kbit/s.
pub(super) const LONGEST_DELAY: Duration = Duration::from_millis(300);
/// The same in periods: less than the half after which two equal devices may send in turns.
const COPY_PERIODS: f64 = 0.49;
/// The same in periods of a fast sender, whose next heartbeat comes after them.
const MAX_COPY_PERIODS: f64 = 0.95;
/// The same for the first two heartbeats. Chosen: less than the period of any device.
const FIRST_COPY_WINDOW: Duration = Duration::from_millis(20);
/// Copies of one heartbeat with a constant RND7: of three gateways. More are those of a fast sender.
const MAX_COPIES: u32 = 3;
/// Frames of heartbeats stored per address: the last two are evidence.
const MAX_FRAMES: usize = 2;
/// Maximum number of senders at one address that are distinguished by their phases: as many as
/// values are remembered.
pub(super) const MAX_PHASES: usize = 8;
/// Heartbeat times stored per address: of eight periods of that many senders, and some more of one
/// with a tenth of the period.
pub(super) const MAX_TIMES: usize = 96;

/// Deviation from whole periods, in periods, that shows another sender or a reboot. As that of a
/// late heartbeat.
const OTHER_PHASE: f64 = 0.12;
/// Heartbeats at twice the rate that count as evidence: enough time for the follow-up requests. Eight
/// periods: six follow-up requests, one per second, and their responses (protocol §5.3).
pub(super) const MAX_DOUBLE_RATE_HEARTBEATS: u32 = 16;
/// Shortest interval that is a whole period: less the jitter of a busy bus.
pub(super) const WHOLE_PERIOD: f64 = 0.85;
/// Periods for which heartbeats in turns show that two devices are there. With 30 % of the
/// heartbeats lost, ten heartbeats of two UIDs without a return are rarer than one in a thousand.
const SWAP_PERIODS: u32 = 10;

/// Periods without heartbeats in turns after which the next ones are those of other senders. Chosen: as
/// many as show the phases although heartbeats are lost.
const TURN_PERIODS: u32 = 10;
/// Time of six follow-up requests, one per second, and their responses (protocol §5.3).
const FOLLOW_UP_TIME: Duration = Duration::from_secs(8);

/// Whether a sender generates a new RND7 for each heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
enum Rnd7 {
    #[default]
    Unknown,
    Constant,
    Random,
}

/// Recent heartbeats of one address.
#[derive(Clone, Debug, Default)]
pub(super) struct HeartbeatHistory {
    /// Times of the last heartbeats, at most [`MAX_TIMES`]; without copies, and without those that may
    /// be copies where times are coarse.
    times: VecDeque<Instant>,
    /// The last heartbeats, at most [`MAX_FRAMES`], with their time of reception.
    frames: VecDeque<Frame>,
    rnd7: Rnd7,
    /// Number of copies of the last heartbeat that were received.
    copy_count: u32,
    /// True if the last heartbeat may be a late copy of the one before.
    is_late_copy: bool,
    /// Time of the last heartbeat or copy.
    received_at: Option<Instant>,
    /// Time from the one before to the last heartbeat that is not a copy.
    gap_before: Option<Duration>,
    /// Those that an event prompted.
    pub prompted: PromptedHeartbeats,
}

/// How a heartbeat relates to the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RecordedHeartbeat {
    /// Time since the previous heartbeat, if this one is its first copy.
    pub copy_delay: Option<Duration>,
    /// The same if it is a further copy, as of a second gateway.
    pub further_copy_delay: Option<Duration>,
    /// Time since the previous heartbeat.
    pub gap: Option<Duration>,
    /// True if the previous heartbeat was not copied, and a copy can no longer arrive.
    pub previous_has_no_copy: bool,
    /// True if this heartbeat is equal to the previous one and may have come soon after it.
    pub may_be_copy: bool,
    /// True if this heartbeat is not a copy, or its sender is known to send equal ones.
    pub is_new: bool,
    /// True if its sender generates a new RND7 for each heartbeat, so that equal ones are copies.
    pub has_random_rnd7: bool,
}

impl HeartbeatHistory {
    /// Records a heartbeat. A copy of the previous one is equal including RND7, and received soon
    /// after it, as far as the `resolution` of times shows that; `None` without times.
    pub fn record(
        &mut self,
        now: Instant,
        frame: &Frame,
        period: Duration,
        resolution: Option<Duration>,
    ) -> RecordedHeartbeat {
        let before_next = LONGEST_DELAY.min(period.mul_f64(MAX_COPY_PERIODS));
        let longest_delay = period.mul_f64(COPY_PERIODS).max(before_next);
        let rounding = resolution.unwrap_or_default();
        let is_coarse = is_coarse(rounding, period);
        let window = match self.rnd7 {
            Rnd7::Random => longest_delay + rounding,
            Rnd7::Constant | Rnd7::Unknown if is_coarse => COPY_WINDOW + rounding,
            Rnd7::Constant | Rnd7::Unknown => COPY_WINDOW,
        };
        let received_gap = self.received_at.replace(now).map(|before| now.since(before));
        let last = self.frames.back();
        let gap = last.map(|last| now.since(last.time));
        let is_changed = last.is_some_and(|last| last.data() != frame.data());
        // Without times it is not known whether it came soon.
        let is_equal = last.is_some_and(|last| last.same_on_wire(frame));
        let may_be_copy = is_equal && gap.is_some_and(|gap| gap <= window) && resolution.is_some();
        let is_copy = may_be_copy
            && (self.rnd7 == Rnd7::Random || !is_coarse && self.is_before_next(received_gap));
        let copy_delay = gap.filter(|_| is_copy && self.copy_count == 0);
        let further_copy_delay = gap.filter(|_| is_copy && self.copy_count > 0);
        // A fast sender sends the next heartbeat before that.
        let is_late = gap.is_some_and(|gap| gap > window || !is_equal || self.gap_before.is_some());
        // A copy that is as late as those of other addresses cannot be distinguished from another heartbeat.
        let is_late_copy = is_equal && !is_copy && gap.is_some_and(|gap| gap <= longest_delay);
        let was_late_copy = std::mem::replace(&mut self.is_late_copy, is_late_copy);
        let previous_has_no_copy =
            self.copy_count == 0 && !is_copy && is_late && !is_late_copy && !was_late_copy;
        let is_new = !is_copy || self.rnd7 == Rnd7::Constant;
        match (last, gap) {
            (Some(last), _) if last.id != frame.id => {
                if self.rnd7 == Rnd7::Unknown {
                    self.drop_copies(longest_delay);
                }
                self.rnd7 = Rnd7::Random;
            }
            (Some(_), Some(gap)) if gap > period / 2 && self.rnd7 == Rnd7::Unknown => {
                self.rnd7 = Rnd7::Constant;
            }
            _ => {}
        }
        if is_copy {
            self.copy_count = self.copy_count.saturating_add(1);
        } else {
            self.copy_count = 0;
            self.gap_before = received_gap;
        }
        if is_new {
            self.prompted.note(now, is_changed, rounding);
            if !(is_coarse && may_be_copy) {
                push_bounded(&mut self.times, now, MAX_TIMES);
            }
            push_bounded(&mut self.frames, frame.with_time(now), MAX_FRAMES);
        }
        let has_random_rnd7 = self.rnd7 == Rnd7::Random;
        RecordedHeartbeat {
            copy_delay,
            further_copy_delay,
            gap,
            previous_has_no_copy,
            may_be_copy,
            is_new,
            has_random_rnd7,
        }
    }

    /// Returns true if a heartbeat, equal to the last one and received soon after it, comes before the
    /// next one of its sender is due: that of a fast sender is equal, and comes as soon as the one before.
    fn is_before_next(&self, received_gap: Option<Duration>) -> bool {
        if self.copy_count > 0 {
            return self.copy_count < MAX_COPIES;
        }
        let longest = self.gap_before.map(|before| before.mul_f64(COPY_PERIODS));
        received_gap.is_some_and(|gap| gap <= longest.unwrap_or(FIRST_COPY_WINDOW))
    }

    /// Drops the times of equal heartbeats that turn out to be copies, after at most `delay`: their
    /// sender generates RND7.
    fn drop_copies(&mut self, delay: Duration) {
        let mut before = None;
        self.times.retain(|at| before.replace(*at).is_none_or(|before| at.since(before) > delay));
    }

    /// The last heartbeat, with its time of reception.
    pub fn last(&self) -> Option<&Frame> {
        self.frames.back()
    }

    /// The heartbeat before the last one.
    pub fn previous(&self) -> Option<&Frame> {
        self.frames.iter().rev().nth(1)
    }

    /// Returns true if the sender generates a new RND7 for each heartbeat.
    pub fn has_random_rnd7(&self) -> bool {
        self.rnd7 == Rnd7::Random
    }

    /// Returns the delay between heartbeats that may be copies and their originals: nothing tells them apart, and
    /// they are so close together as those of one device that a gateway repeats. `delay`: that of copies of
    /// other addresses.
    pub fn delay_of_likely_copies(&self, period: Duration, delay: Duration) -> Option<Duration> {
        let longest = COPY_WINDOW.max(delay).min(period.mul_f64(COPY_PERIODS));
        let delay = delay_of_close_pairs(&self.times, longest);
        delay.filter(|_| !self.has_random_rnd7())
    }

    /// Times of the last heartbeats, oldest first, at most [`MAX_TIMES`].
    pub fn times(&self) -> &VecDeque<Instant> {
        &self.times
    }
}

/// Appends a value and drops the oldest beyond `max`.
pub(super) fn push_bounded<T>(values: &mut VecDeque<T>, value: T, max: usize) {
    if values.len() == max {
        values.pop_front();
    }
    values.push_back(value);
}

/// Heartbeats of two senders in turns.
#[derive(Clone, Copy, Debug)]
struct HeartbeatTurns {
    /// Period of each of both.
    period: Duration,
    /// Time of the first heartbeat that showed it.
    since: Instant,
    /// Time of the last one.
    last: Instant,
}

/// History of one address.
#[derive(Clone, Debug, Default)]
pub(super) struct AddressHistory {
    pub names: RecentValues<Name>,
    /// Time of the last name response.
    pub name_at: Option<Instant>,
    /// The last name response.
    pub name_frame: Option<Frame>,
    /// Number of times, half a period apart or more, at which the last name was received again.
    pub name_repeats: u32,
    name_repeated_at: Option<Instant>,
    pub uids: RecentValues<Uid>,
    /// Heartbeat period of the slowest sender, where another one is faster.
    pub longest_period: Option<Duration>,
    /// Time of the first heartbeat with each of the UIDs that were received last, before any absence
    /// of their devices; at most [`MAX_VALUES`].
    first_by_uid: VecDeque<(Uid, Instant)>,
    /// Time of the last heartbeat with a blank UID or none.
    pub last_without_uid: Option<Instant>,
    /// UID, unless blank or none, and time of the last heartbeat before the device was lost.
    pub before_loss: Option<(Option<Uid>, Instant)>,
    /// Hashes of services responses.
    pub services: RecentValues<u64>,
    /// The last frame of the last services response.
    pub services_frame: Option<Frame>,
    /// U bits: true in a working mode.
    pub working: RecentValues<bool>,
    /// Time of the last frame of a non-working node and of a working node, indexed by `working`.
    pub seen: [Option<Instant>; 2],
    /// True if the previous request was sent with both values of the D bit.
    pub sent_both: bool,
    pub heartbeats: HeartbeatHistory,
    /// Time of the last heartbeat of a node that is about to change its mode, as after a reboot.
    pub resolving_at: Option<Instant>,
    /// Time of the first heartbeat since when all were of such nodes.
    pub resolving_since: Option<Instant>,
    /// Times of the last heartbeats of nodes that are not about to change their mode, at most
    /// [`MAX_TIMES`]: a reboot does not make them more frequent, since the first one comes a period
    /// after the claim.
    pub settled: VecDeque<Instant>,
    /// Time of the last heartbeat that one sender does not explain, by their number.
    pub crowded_at: Option<Instant>,
    /// Time of the last heartbeat of another sender than the one before it: with another UID, or in
    /// another phase.
    pub sender_changed_at: Option<Instant>,
    /// Time of the last heartbeat that showed a second sender by its content or its timing.
    pub second_sender_at: Option<Instant>,
    /// Delay of the last copy, if it was the heartbeat of the second of two devices that were found.
    pub delay_of_two: Option<Duration>,
    /// Heartbeats in turns, if not of the expected period.
    turns: Option<HeartbeatTurns>,
    /// Number of heartbeats at twice the rate, less those that came after a whole period.
    pub double_rate_count: u32,
    /// What the last malformed response was for; `None`: not known, most likely services.
    pub malformed: Option<Request>,
    /// Responses in a row that were aborted at one place.
    pub aborted: u32,
    /// True for each type of request that got a valid response.
    pub responded: [bool; 2],
    matchers: [[QueryResponseMatcher; 2]; 2],
}

impl AddressHistory {
    /// Returns the matcher for this kind of request and framing.
    pub fn matcher(&mut self, request: Request, framing: Framing) -> &mut QueryResponseMatcher {
        &mut self.matchers[request as usize][framing as usize]
    }

    /// Notes a heartbeat of a node that is not about to change its mode.
    pub fn note_settled(&mut self, now: Instant) {
        push_bounded(&mut self.settled, now, MAX_TIMES);
    }

    /// Notes a heartbeat with this UID, not blank. Call before it is added to `uids`.
    pub fn note_sender(&mut self, now: Instant, uid: Option<Uid>, period: Duration) {
        let Some(previous) = self.heartbeats.previous() else { return };
        let periods = now.since(previous.time).as_secs_f64() / period.as_secs_f64();
        let is_other_phase = (periods - periods.round()).abs() > OTHER_PHASE;
        let is_other_uid = uid.is_some_and(|uid| self.uids.current().is_some_and(|it| *it != uid));
        if is_other_phase || is_other_uid {
            self.sender_changed_at = Some(now);
        }
    }

    /// Notes when a device with this UID first sent a heartbeat from the address.
    pub fn note_first(&mut self, uid: Uid, first: Instant) {
        if self.first_by_uid.back() != Some(&(uid, first)) {
            self.first_by_uid.retain(|(known, _)| *known != uid);
            push_bounded(&mut self.first_by_uid, (uid, first), MAX_VALUES);
        }
    }

    /// Time of the first heartbeat with this UID, as noted.
    pub fn first_of(&self, uid: Uid) -> Option<Instant> {
        self.first_by_uid.iter().find(|(known, _)| *known == uid).map(|(_, first)| *first)
    }

    /// Notes a name response; `is_repeated`: with the name of the last one.
    pub fn note_name_response(&mut self, now: Instant, is_repeated: bool, period: Duration) {
        if !is_repeated {
            self.name_repeats = 0;
        } else if self.name_repeated_at.is_none_or(|at| now.since(at) >= period / 2) {
            self.name_repeats += 1;
            self.name_repeated_at = Some(now);
        }
    }

    /// Notes whether the last heartbeat came at twice the rate. One device with half the period is at
    /// twice the rate again and again, with late or lost heartbeats between.
    pub fn note_rate(&mut self, is_double: bool, period: Duration) {
        let mut times = self.heartbeats.times().iter().rev();
        let gap = times.next().zip(times.next()).map(|(last, before)| last.since(*before));
        if is_double {
            let count = self.double_rate_count + 1;
            self.double_rate_count = count.min(MAX_DOUBLE_RATE_HEARTBEATS + 1);
        } else if gap.is_none_or(|gap| gap > period.mul_f64(WHOLE_PERIOD)) {
            self.double_rate_count = self.double_rate_count.saturating_sub(1);
        }
    }

    /// Notes whether the last heartbeats alternate in two phases, if not of the `expected` period.
    /// Returns true if they do, and no gateway explains it.
    pub fn note_turns(&mut self, now: Instant, expected: Duration) -> bool {
        let times = self.heartbeats.times();
        let mut last_gaps = times.iter().rev().zip(times.iter().rev().skip(1)).take(2);
        let is_delay = |(last, before): (&Instant, &Instant)| last.since(*before) <= LONGEST_DELAY;
        if !self.heartbeats.has_random_rnd7() && last_gaps.any(is_delay) {
            return false;
        }
        let found = alternating_period(times, expected);
        // Later ones may be lost.
        let goes_on = |turns: &HeartbeatTurns| {
            let other = last_in_other_phase(times, turns.period);
            other.is_some_and(|other| now.since(other) <= turns.period * 2)
        };
        let known = self.turns.filter(|turns| now.since(turns.last) <= turns.period * TURN_PERIODS);
        let period = found.or(known.filter(goes_on).map(|turns| turns.period));
        self.turns = match period {
            Some(period) => {
                let since = known.map_or(now, |turns| turns.since);
                Some(HeartbeatTurns { period, since, last: now })
            }
            None => known,
        };
        period.is_some()
    }

    /// Returns true if heartbeats alternate for longer than requests need to show whether two devices
    /// send them.
    pub fn are_turns_followed_up(&self, now: Instant) -> bool {
        self.turns.is_some_and(|turns| now.since(turns.since) > FOLLOW_UP_TIME)
    }

    /// Returns true if another device took the place of the one that sent heartbeats at `then`:
    /// there were no heartbeats of two senders in turns.
    pub fn is_swapped(&self, now: Instant, then: Instant, period: Duration) -> bool {
        let both = self.second_sender_at.max(self.crowded_at);
        self.sender_changed_at.is_some_and(|at| at >= then)
            && both.is_none_or(|at| now.since(at) > period * SWAP_PERIODS)
    }

    /// Forgets everything: the device is lost. If its period is not known, it may be so long that the
    /// last heartbeat, unless that was a claim, is the one before its next.
    pub fn forget(&mut self, is_period_known: bool) {
        let with_uid = self.uids.last();
        let with_uid = with_uid.map(|(uid, at)| (Some(*uid), at));
        let without_uid = self.last_without_uid.map(|at| (None, at));
        let last = with_uid.into_iter().chain(without_uid).max_by_key(|(_, at)| *at);
        let is_scheduled = |at: &Instant| self.resolving_at.is_none_or(|claimed| claimed < *at);
        let before_loss = last.filter(|(_, at)| !is_period_known && is_scheduled(at));
        *self = Self { before_loss, ..Self::default() };
    }

    /// Forgets the values that could alternate.
    pub fn forget_values(&mut self) {
        self.names = RecentValues::default();
        self.uids = RecentValues::default();
        self.services = RecentValues::default();
        self.name_frame = None;
        self.name_at = None;
        self.services_frame = None;
        self.responded = [false; 2];
    }
}
