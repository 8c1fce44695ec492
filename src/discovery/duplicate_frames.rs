//! Frames that come twice: a bridge, a gateway or an echo sends again what was on the bus.
//!
//! Two devices at one address are given away by frames that come once too often, and so is
//! something in between that repeats everything. It is told by its repeating *everything*: the
//! heartbeats of several addresses, RND7 and all, each again after a moment. While that goes on,
//! the second of two equal frames is left out before anything is learnt from it. Where devices
//! hear questions twice, they answer twice: then all of those that are asked do, or nearly all.
//!
//! Two boards whose random numbers are equal, as those of new ones may well be, draw the same RND7
//! each time. Then the phase between their heartbeats gives them away: what sends again is not much
//! quicker with answers than with heartbeats.
//!
//! Does not judge devices.

use super::address_history::REPEATED_WITHIN;
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Copies in a row from the only address that beats.
const COPIES_OF_ONE: u32 = 3;
/// So many answers in a row that come twice much quicker than heartbeats do, are two devices'.
const FAST_PAIRS: usize = 3;
/// By how much quicker, at least: as unsteady as what sends again may be.
const FAST_PAIR_MARGIN: Duration = Duration::from_millis(5);
/// Frames of which a copy may still come.
const MAX_OPEN: usize = 1024;

#[derive(Clone, Copy, Debug)]
struct RecentHeartbeat {
    frame: Frame,
    copied: bool,
    /// Its sender draws a new RND7 each time.
    varies: bool,
}

#[derive(Debug)]
pub(super) struct DuplicateFrameDetector {
    period: Duration,
    beats: Vec<Option<RecentHeartbeat>>,
    /// Heartbeats in a row that came twice, and from which address the last one was.
    copies: u32,
    copied: Option<Address>,
    /// Whether copies came from several addresses.
    several: bool,
    until: Instant,
    /// The longest that a copy of a heartbeat took, and the shortest in this row.
    delay: Duration,
    shortest: Option<Duration>,
    /// When the last answers came twice, and how quickly.
    twice: VecDeque<(Instant, Duration)>,
    /// Frames that a copy may come of, by the hash of what was on the wire.
    open: VecDeque<(Instant, u64)>,
    echoed_until: Instant,
    responses: RoundResponses,
}

/// Who answered the last question to all, and who did twice.
#[derive(Debug, Default)]
struct RoundResponses {
    asked_at: Instant,
    once: u128,
    twice: u128,
}

impl DuplicateFrameDetector {
    pub fn new(period: Duration) -> Self {
        Self {
            period,
            beats: vec![None; Address::COUNT],
            copies: 0,
            copied: None,
            several: false,
            until: Instant::ZERO,
            delay: Duration::ZERO,
            shortest: None,
            twice: VecDeque::new(),
            open: VecDeque::new(),
            echoed_until: Instant::ZERO,
            responses: RoundResponses::default(),
        }
    }

    /// Whether everything comes twice.
    pub fn is_active(&self, now: Instant) -> bool {
        now < self.until
    }

    /// Whether a frame, a heartbeat or (`beat`) not, is the second of two, to be left out.
    pub fn is_copy(&mut self, now: Instant, beat: bool, frame: &Frame) -> bool {
        if !self.is_active(now) {
            self.open.clear();
            return false;
        }
        let window = (self.delay * 2).max(Duration::from_millis(20));
        while self.open.front().is_some_and(|(at, _)| now.since(*at) > window) {
            self.open.pop_front();
        }
        let mut hasher = DefaultHasher::new();
        (frame.platform_id(), frame.data()).hash(&mut hasher);
        let hash = hasher.finish();
        let at = self.open.iter().position(|(_, open)| *open == hash);
        if let Some((first, _)) = at.and_then(|at| self.open.remove(at)) {
            if !beat {
                self.note_duplicate(now, now.since(first));
            }
            return true;
        }
        if self.open.len() == MAX_OPEN {
            self.open.pop_front();
        }
        self.open.push_back((now, hash));
        false
    }

    /// Takes a heartbeat from `address`, before [`is_copy`](Self::is_copy) is asked about it.
    pub fn note_heartbeat(&mut self, now: Instant, address: Address, frame: &Frame) {
        let period = self.period;
        if self.beats.iter().flatten().all(|beat| now.since(beat.frame.time) > period * 3) {
            self.several = false;
            self.twice.clear();
        }
        let is_on = self.is_active(now);
        let last = &mut self.beats[address.index()];
        let copied = last.filter(|beat| !beat.copied && beat.frame.same_on_wire(frame));
        let late = copied.map(|beat| now.since(beat.frame.time));
        let varies = last.is_some_and(|beat| beat.varies);
        let most = if varies { period / 2 } else { REPEATED_WITHIN };
        if let (Some(late), Some(beat)) = (late.filter(|late| *late <= most), last.as_mut()) {
            beat.copied = true;
            self.copies += 1;
            self.several |= self.copied.is_some_and(|other| other != address);
            self.copied = Some(address);
            self.shortest = Some(self.shortest.map_or(late, |shortest| shortest.min(late)));
            let alone = self.copies >= COPIES_OF_ONE && self.is_single_source(now, address);
            if self.several || alone && !self.has_two_responders() {
                self.until = now + period * 3;
                self.delay = self.delay.max(late);
            }
            return;
        }
        // The one before had no copy in all this time.
        if last.is_some_and(|beat| !beat.copied && now.since(beat.frame.time) > most) {
            if is_on {
                // One may be lost: the next copy counts again.
                self.copies = self.copies.min(COPIES_OF_ONE - 1);
            } else {
                self.copies = 0;
                self.several = false;
                self.copied = None;
                self.shortest = None;
            }
        }
        let other = last.is_some_and(|beat| !beat.frame.same_on_wire(frame));
        *last = Some(RecentHeartbeat {
            frame: frame.with_time(now),
            copied: false,
            varies: varies || other,
        });
    }

    fn is_single_source(&self, now: Instant, address: Address) -> bool {
        let mut beats = self.beats.iter().enumerate().filter(|(at, _)| *at != address.index());
        beats.all(|(_, beat)| beat.is_none_or(|beat| now.since(beat.frame.time) > self.period * 3))
    }

    /// An answer came that is equal to one that long before.
    pub fn note_duplicate(&mut self, now: Instant, took: Duration) {
        // What comes in one burst counts once.
        let last = self.twice.back_mut().filter(|(at, _)| now.since(*at) < self.period / 4);
        if let Some((_, longest)) = last {
            *longest = took.max(*longest);
        } else {
            if self.twice.len() == FAST_PAIRS {
                self.twice.pop_front();
            }
            self.twice.push_back((now, took));
        }
        if !self.several && self.has_two_responders() {
            self.until = self.until.min(now);
        }
    }

    /// Whether those whose heartbeats seem to come twice answer as two devices do.
    fn has_two_responders(&self) -> bool {
        let Some(shortest) = self.shortest else { return false };
        let quick = |(_, took): &(Instant, Duration)| {
            *took <= shortest / 2 && *took + FAST_PAIR_MARGIN <= shortest
        };
        self.twice.len() == FAST_PAIRS && self.twice.iter().all(quick)
    }

    /// A frame of ours came back as somebody else's: devices may have heard it twice as well.
    pub fn note_own_echo(&mut self, now: Instant) {
        self.echoed_until = now + self.period * 3;
    }

    /// A question to all; those of one round belong together.
    pub fn note_broadcast(&mut self, now: Instant) {
        if now.since(self.responses.asked_at) > self.period / 2 {
            self.responses = RoundResponses { asked_at: now, once: 0, twice: 0 };
        }
    }

    /// An answer to a question to all from `address`; `extra`: one more than there were questions.
    pub fn note_response(&mut self, address: Address, extra: bool) {
        let bit = 1 << address.index();
        self.responses.once |= bit;
        if extra {
            self.responses.twice |= bit;
        }
    }

    /// Whether questions reach devices twice, as far as their answers tell: a second answer is
    /// then nobody else's.
    pub fn asks_twice(&self, now: Instant) -> bool {
        if self.is_active(now) || now < self.echoed_until {
            return true;
        }
        let (once, twice) = (self.responses.once.count_ones(), self.responses.twice.count_ones());
        twice >= 2 && twice * 10 >= once * 9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_secs(1);

    fn address(number: u8) -> Address {
        Address::from_bits(number)
    }

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    /// A heartbeat from `source` with that RND7.
    fn beat(source: u32, rnd7: u32, millis: u64) -> Frame {
        Frame::classic(0x0700_0001 | source << 17 | rnd7 << 10, &[1; 8]).with_time(at(millis))
    }

    fn hear(duplicate_frames: &mut DuplicateFrameDetector, frame: &Frame) -> bool {
        let source = (frame.platform_id().unwrap() >> 17) as u8;
        duplicate_frames.note_heartbeat(frame.time, address(source), frame);
        duplicate_frames.is_copy(frame.time, true, frame)
    }

    #[test]
    fn what_repeats_everything_is_recognised_and_its_copies_left_out() {
        let mut duplicate_frames = DuplicateFrameDetector::new(PERIOD);
        for second in 0..3 {
            for source in [5, 9] {
                let start = second * 1000 + u64::from(source) * 50;
                assert!(!hear(&mut duplicate_frames, &beat(source, second as u32, start)));
                let copy = hear(&mut duplicate_frames, &beat(source, second as u32, start + 12));
                assert!(copy || second == 0, "the copy in second {second} is left out");
            }
        }
        assert!(duplicate_frames.is_active(at(3000)));
        assert!(!duplicate_frames.is_active(at(6000)), "it is over when no more copies come");
    }

    #[test]
    fn two_equal_devices_at_one_address_are_no_bridge() {
        let mut duplicate_frames = DuplicateFrameDetector::new(PERIOD);
        for second in 0..20 {
            for (source, phase) in [(5, 0), (5, 60), (9, 500)] {
                hear(&mut duplicate_frames, &beat(source, 0, second * 1000 + phase));
            }
        }
        assert!(!duplicate_frames.is_active(at(20_000)));
    }

    #[test]
    fn when_all_devices_answer_twice_they_were_asked_twice() {
        let mut duplicate_frames = DuplicateFrameDetector::new(PERIOD);
        for source in 1..=4 {
            duplicate_frames.note_response(address(source), source == 1);
        }
        assert!(!duplicate_frames.asks_twice(at(0)), "one of four");
        for source in 2..=4 {
            duplicate_frames.note_response(address(source), true);
        }
        assert!(duplicate_frames.asks_twice(at(10)), "all four");
    }
}
