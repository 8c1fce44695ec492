//! What is remembered of one address, to tell two senders apart: names, UIDs and service lists
//! that take turns, answers set against questions, the rhythm of heartbeats.
//!
//! Does not decide what any of it amounts to: [`super::conflict_detector`] does.

use crate::frame::Frame;
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Header};
use crate::wire::node::Uid;
use std::collections::VecDeque;

/// Answers later than this after a question are not set against it.
const RESPONSE_WINDOW: Duration = Duration::from_secs(2);

/// Two answers to one question come within less than this of each other.
pub(super) const PAIR_WINDOW: Duration = Duration::from_millis(125);
/// A heartbeat that comes again within this was repeated by something on its way, as far as is
/// known of a sender that may or may not draw RND7: two devices whose heartbeats are equal because
/// they do not are seldom so close.
pub(super) const REPEATED_WITHIN: Duration = Duration::from_millis(100);

/// Something that takes turns between two values: A, B, A, B.
#[derive(Debug)]
pub(super) struct Alternation<T> {
    pub now: Option<T>,
    pub before: Option<T>,
    pub returns: u32,
    pub changed: Instant,
    /// When the second of the two was seen first.
    pub since: Instant,
}

impl<T> Default for Alternation<T> {
    fn default() -> Self {
        Self { now: None, before: None, returns: 0, changed: Instant::ZERO, since: Instant::ZERO }
    }
}

impl<T: PartialEq + Clone> Alternation<T> {
    /// Takes the value seen now. Returns how often a value came back, if it did just now.
    pub fn see(&mut self, now: Instant, value: &T, forget_after: Duration) -> Option<u32> {
        if self.now.as_ref() == Some(value) {
            return None;
        }
        if now.since(self.changed) > forget_after {
            self.returns = 0;
            self.before = None;
        }
        self.changed = now;
        if self.before.as_ref() == Some(value) {
            self.returns += 1;
        } else {
            self.returns = 0;
            self.since = now;
        }
        let returned = self.before.as_ref() == Some(value);
        self.before = self.now.replace(value.clone());
        returned.then_some(self.returns)
    }
}

/// Who asked, and whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(super) struct QueryParties {
    pub by: Address,
    /// One node, not all.
    pub targeted: bool,
}

/// Answers set against questions, for one kind of question in one framing; each asker's apart.
#[derive(Debug, Default)]
pub(super) struct QueryResponseMatcher {
    open: [Option<OpenQueries>; REQUESTERS],
}

/// Askers whose questions to one node are told apart.
const REQUESTERS: usize = 4;
/// Questions of one asker that wait for an answer at the same time.
const MAX_WAITING: usize = 16;

/// Questions of one asker that answers may still come to.
#[derive(Debug)]
struct OpenQueries {
    by: Address,
    /// Whether none of them went to all.
    targeted: bool,
    /// When those were asked that have no answer yet.
    waiting: VecDeque<Instant>,
    asked_at: Instant,
    /// The first answer since the last of them, and when it was taken in.
    first_response: Option<(Instant, Frame)>,
}

/// An answer more than there were questions.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurplusResponse {
    /// The first answer.
    pub first: Frame,
    /// How long before this one it came.
    pub apart: Duration,
    /// Whether the question went to one node alone.
    pub targeted: bool,
}

impl OpenQueries {
    fn new(by: Address) -> Self {
        let asked_at = Instant::ZERO;
        Self { by, targeted: true, waiting: VecDeque::new(), asked_at, first_response: None }
    }

    fn ask(&mut self, now: Instant, targeted: bool) {
        // A question that was not answered in time, perhaps because nobody was there yet, must not
        // excuse a second answer to a later one.
        self.waiting.retain(|asked_at| now.since(*asked_at) <= RESPONSE_WINDOW);
        self.targeted = targeted && (self.waiting.is_empty() || self.targeted);
        if self.waiting.len() == MAX_WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(now);
        self.asked_at = now;
        self.first_response = None;
    }
}

impl QueryResponseMatcher {
    pub fn ask(&mut self, now: Instant, asking: QueryParties) {
        let by =
            |open: &Option<OpenQueries>| open.as_ref().is_some_and(|open| open.by == asking.by);
        let at = self.open.iter().position(by).unwrap_or_else(|| {
            // The oldest makes room.
            let asked_at = |at: &usize| self.open[*at].as_ref().map(|open| open.asked_at);
            let oldest = (0..REQUESTERS).min_by_key(asked_at).unwrap_or(0);
            self.open[oldest] = None;
            oldest
        });
        let open = self.open[at].get_or_insert_with(|| OpenQueries::new(asking.by));
        open.ask(now, asking.targeted);
    }

    /// Counts an answer, to whom it is where that is known; otherwise to whoever has none yet.
    /// Comes back with whether the question went to all, and with what is one too many, less than
    /// `together` after the first.
    pub fn response(
        &mut self,
        now: Instant,
        to: Option<Address>,
        together: Duration,
        frame: &Frame,
    ) -> (bool, Option<SurplusResponse>) {
        let fresh = |open: &&mut OpenQueries| now.since(open.asked_at) <= RESPONSE_WINDOW;
        let mut open = self.open.iter_mut().flatten().filter(fresh);
        let open = match to {
            Some(to) => open.find(|open| open.by == to),
            None => open.min_by_key(|open| (open.waiting.is_empty(), open.asked_at)),
        };
        let Some(open) = open else { return (false, None) };
        // Of several the newest is rather answered than one that has waited for long.
        let awaited = open.waiting.pop_back().is_some();
        let (first_at, first) = *open.first_response.get_or_insert((now, *frame));
        let apart = now.since(first_at);
        let targeted = open.targeted;
        // Each node answers only questions to its kind; one that comes much later answers a
        // question that we missed.
        let more = !awaited || is_of_another_kind(&first, frame);
        if !more || apart >= together {
            return (!targeted, None);
        }
        (!targeted, Some(SurplusResponse { first, apart, targeted }))
    }
}

/// Whether one answer comes from a node in a working mode and the other does not.
fn is_of_another_kind(one: &Frame, other: &Frame) -> bool {
    let not_working =
        |frame: &Frame| frame.platform_id().map(|id| Header::decode(id).sender_not_working);
    not_working(one) != not_working(other)
}

#[derive(Clone, Copy, Debug)]
pub(super) struct HeartbeatRecord {
    pub time: Instant,
    pub frame: Frame,
}

/// How heartbeats from one address follow each other.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeartbeatPattern {
    /// They come at twice the rate.
    pub twice: bool,
    /// They come in two clear phases.
    pub phases: bool,
    /// Since when there are two, if one of both is so.
    pub since: Option<Instant>,
}

/// What is remembered of one address.
#[derive(Debug, Default)]
pub(super) struct AddressHistory {
    pub names: Alternation<Name>,
    pub uids: Alternation<Uid>,
    pub services: Alternation<u64>,
    pub working: Alternation<bool>,
    /// When a node in no working mode sent something last, and when one in a working mode did.
    pub seen: [Option<Instant>; 2],
    /// The question before went to both kinds.
    pub asked_both: bool,
    pub tallies: [[QueryResponseMatcher; 2]; 2],
    pub beats: VecDeque<HeartbeatRecord>,
    /// For how many heartbeats in a row they came at twice the rate.
    pub twice_for: u32,
}

/// Whether a long gap follows a short one each time, far more regularly than chance has it: two
/// steady senders almost half a period apart.
fn has_two_phases(gaps: &[f64]) -> bool {
    let range = |from: usize| {
        let every_other = gaps.iter().skip(from).step_by(2);
        every_other.fold((f64::MAX, f64::MIN), |(low, high), &gap| (low.min(gap), high.max(gap)))
    };
    let (even, odd) = (range(0), range(1));
    let apart = (even.0 - odd.1).max(odd.0 - even.1);
    apart > 0.04 && apart > 3.0 * (even.1 - even.0).max(odd.1 - odd.0)
}

/// Heartbeats kept per address: six intervals and one more.
const BEATS: usize = 8;

impl AddressHistory {
    pub fn tally(&mut self, request: Request, framing: Framing) -> &mut QueryResponseMatcher {
        &mut self.tallies[request as usize][framing as usize]
    }

    /// Takes a heartbeat; false where it only repeats the one before: RND7 and all, at once, from
    /// a sender that draws a new RND7 each time.
    pub fn beat(&mut self, now: Instant, frame: &Frame, period: Duration) -> bool {
        if let Some(last) = self.beats.back()
            && last.frame.same_on_wire(frame)
        {
            let mut older = self.beats.iter().rev().skip(1);
            // Whether it draws RND7 shows from one of its heartbeats to the next.
            let next = older.find(|beat| last.time.since(beat.time) > period / 2);
            let within = match next.map(|beat| beat.frame.same_on_wire(frame)) {
                Some(true) => Duration::ZERO,
                Some(false) => period / 2,
                None => REPEATED_WITHIN,
            };
            if now.since(last.time) <= within {
                return false;
            }
        }
        if self.beats.len() == BEATS {
            self.beats.pop_front();
        }
        self.beats.push_back(HeartbeatRecord { time: now, frame: *frame });
        true
    }

    /// How heartbeats follow each other.
    pub fn rhythm(&self, period: Duration) -> HeartbeatPattern {
        let Some(last) = self.beats.back() else { return HeartbeatPattern::default() };
        let recent = self.beats.iter().filter(|beat| last.time.since(beat.time) < period * 4);
        // The newest itself must have come too soon, or it is over already.
        let before = self.beats.iter().rev().nth(1);
        let soon = before.is_some_and(|beat| last.time.since(beat.time) < period.mul_f64(0.85));
        let twice = soon && recent.count() >= 7;
        // So many in so little time are two's for a period at least.
        let rate = HeartbeatPattern { twice, phases: false, since: Some(last.time - period) };
        if self.beats.len() < BEATS - 1 {
            return rate;
        }
        let period = period.as_secs_f64();
        let mut gaps = [0.0; BEATS - 1];
        let pairs = self.beats.iter().zip(self.beats.iter().skip(1));
        let mut count = 0;
        for (gap, (a, b)) in gaps.iter_mut().zip(pairs) {
            *gap = b.time.since(a.time).as_secs_f64() / period;
            count += 1;
        }
        let gaps = &gaps[..count];
        let whole = gaps.windows(2).all(|two| (0.85..=1.15).contains(&(two[0] + two[1])));
        let apart = gaps.windows(2).all(|two| (two[0] - two[1]).abs() > 0.15);
        // Where one of both fell silent the newest gap is a whole period.
        let goes_on = (gaps[count - 1] - gaps[count - 3]).abs() < 0.1;
        if whole && goes_on && (apart || has_two_phases(gaps)) {
            // By the second of them both had begun, unless the first gap is a whole period; then
            // by the third.
            let short = gaps.iter().copied().fold(f64::MAX, f64::min);
            let alone = (gaps[0] - gaps[2]).abs() > short / 4.0;
            let second = self.beats.get(1 + usize::from(alone));
            return HeartbeatPattern { phases: true, since: second.map(|beat| beat.time), ..rate };
        }
        rate
    }
}
