//! Detector of repeated frames: a bridge, a gateway or an echo sends every frame again, or those of
//! one device (protocol §5.4). Input: heartbeats, responses and their times; output: whether a frame
//! is a copy to be ignored, and which addresses are repeated.
//!
//! Repeated frames look like two devices at one address. The difference is that the copies include
//! RND7 and follow after a steady delay: those of one address, or of several, and then of
//! all. While that is so, the second of two equal frames is ignored. If devices receive requests
//! twice, they respond twice: then all of those addressed do, or nearly all.
//!
//! Two boards with equal random numbers, as new ones may have, generate the same RND7 each time.
//! They differ from a bridge in the phase between their heartbeats: a bridge is not much faster
//! with responses than with heartbeats.

use super::history::RecordedHeartbeat;
use crate::discovery::address_table::AddressTable;
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Successive copied heartbeats of one address that show repeated frames. Chance gives two senders
/// equal RND7 once in 128: three in a row once in two million.
pub(super) const COPIES_OF_ONE: u32 = 3;
/// Time in which a gateway forwards a frame: it waits for a few others.
pub(in crate::discovery) const MAX_FORWARDING_DELAY: Duration = Duration::from_millis(100);
/// Difference between the delays of copies of two addresses up to which one bridge makes both: some
/// frames more or less wait in it. Two senders have equal RND7 by chance at any time.
const BRIDGE_JITTER: Duration = Duration::from_millis(50);
/// Periods without a further copy after which frames are no longer repeated. Chosen: some copies may
/// be lost.
const REPEATED_PERIODS: u32 = 3;
/// Heartbeats in a row without a copy that show another timing than that of copies. With 30 % of all
/// frames lost, five received ones have no copy once in 50 times.
const MAX_UNCOPIED: u32 = 5;
/// Difference between the delays of copies up to which they are steady: a copy waits for other
/// frames of a busy bus. Tuned with the simulation.
const DELAY_JITTER: Duration = Duration::from_millis(15);
/// Successive response pairs, much closer than heartbeat pairs, that show two devices. As
/// `COPIES_OF_ONE`.
const FAST_PAIRS: usize = 3;
/// Minimum difference between the delays of heartbeat and response pairs: the jitter of a bridge.
const FAST_PAIR_MARGIN: Duration = Duration::from_millis(5);
/// Last intervals between heartbeats, and the number of those that no lost original explains from which on
/// several senders do. Chosen: half of two periods each.
const TIMED_GAPS: usize = 8;
const MIN_OTHER_GAPS: usize = 4;
/// Maximum number of frames whose copy may still arrive. Bounds the memory: all frames of
/// 0.1 s at 1 Mbit/s.
const MAX_OPEN: usize = 1024;

/// Detector of repeated frames on one bus.
#[derive(Clone, Debug)]
pub(super) struct RepeatedFrameDetector {
    period: Duration,
    /// Address and time of the last heartbeat, and of the last one from another address.
    last_heartbeat: Option<(Address, Instant)>,
    last_of_another: Option<(Address, Instant)>,
    /// Number of successive copied heartbeats, and the address and delay of the last one.
    copy_count: u32,
    last_copied: Option<(Address, Duration)>,
    /// Time until which heartbeats of several addresses are copied.
    several_sources_until: Instant,
    active_until: Instant,
    /// Longest delay of a copied heartbeat.
    delay: Duration,
    /// Shortest delay of the copied heartbeats of this series.
    shortest: Option<Duration>,
    /// Longest delay of a copy that was received, at least [`MAX_FORWARDING_DELAY`].
    longest_delay: Duration,
    response_pairs: ResponsePairs,
    /// Frames whose copy may still arrive, by the hash of identifier and data.
    awaiting_copy: VecDeque<(Instant, u64)>,
    echoed_until: Instant,
    responses: RoundResponses,
    /// Copied heartbeats of each address.
    series: AddressTable<CopySeries>,
}

/// Shortest and longest delay of copies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::discovery) struct DelayRange {
    pub shortest: Duration,
    pub longest: Duration,
}

/// What the text of repeated frames says.
#[derive(Clone, Debug)]
pub(in crate::discovery) struct RepeatedFrames {
    /// Whose frames are repeated; none: those of all.
    pub addresses: Vec<Address>,
    /// Of the last copies of each address.
    pub delays: DelayRange,
    /// Delay of most of them.
    pub usual_delay: Duration,
    /// A frame arrived more than twice.
    pub is_further_copy: bool,
}

/// Successive copied heartbeats of one address.
#[derive(Clone, Debug, Default)]
struct CopySeries {
    count: u32,
    /// Time of the last heartbeat, and of the last one with a copy.
    heard_at: Option<Instant>,
    copied_at: Option<Instant>,
    /// Delays of the last copies.
    delays: [Duration; COPIES_OF_ONE as usize],
    /// Shortest and longest of them.
    shortest: Duration,
    longest: Duration,
    /// Longest delay of further copies of one heartbeat, and the time of the last one.
    further: Duration,
    further_at: Option<Instant>,
    active_until: Instant,
    /// Number of heartbeats in a row without a copy.
    uncopied: u32,
    /// Time of the last heartbeat that came as late as a copy and was none.
    differs_at: Option<Instant>,
    response_pairs: ResponsePairs,
}

impl CopySeries {
    /// Takes the delay of a copy. It counts if the sender generates RND7: others may be equal by chance.
    fn add(&mut self, now: Instant, delay: Duration, period: Duration, has_random_rnd7: bool) {
        let is_first = !is_recent(now, self.copied_at, period);
        if is_first || has_random_rnd7 && self.count == 0 {
            self.delays.fill(delay);
        }
        self.copied_at = Some(now);
        self.uncopied = 0;
        self.delays.rotate_left(1);
        self.delays[COPIES_OF_ONE as usize - 1] = delay;
        let [first, rest @ ..] = self.delays;
        self.shortest = rest.into_iter().fold(first, Duration::min);
        self.longest = rest.into_iter().fold(first, Duration::max);
        self.count += u32::from(has_random_rnd7);
    }

    /// Returns true if the copies come with a steady delay.
    fn is_steady(&self) -> bool {
        self.longest.saturating_sub(self.shortest) <= DELAY_JITTER.max(self.shortest / 2)
    }
}

/// Returns true if further copies were still due after one at that time.
fn is_recent(now: Instant, at: Option<Instant>, period: Duration) -> bool {
    at.is_some_and(|at| now.since(at) < period * REPEATED_PERIODS)
}

/// Returns true if one bridge may make copies with both delays.
fn is_about_as_late(one: Duration, other: Duration) -> bool {
    one.max(other) <= one.min(other) * 2 + BRIDGE_JITTER
}

fn median(delays: &mut [Duration]) -> Option<Duration> {
    delays.sort_unstable();
    delays.get(delays.len() / 2).copied()
}

/// Last pairs of equal responses.
#[derive(Clone, Debug, Default)]
struct ResponsePairs(VecDeque<ResponsePair>);

#[derive(Clone, Copy, Debug)]
struct ResponsePair {
    at: Instant,
    /// Longest time between the two responses; a burst of pairs counts once.
    delay: Duration,
}

impl ResponsePairs {
    fn add(&mut self, now: Instant, delay: Duration, period: Duration) {
        let last = self.0.back_mut().filter(|last| now.since(last.at) < period / 4);
        if let Some(last) = last {
            last.delay = delay.max(last.delay);
            return;
        }
        if self.0.len() == FAST_PAIRS {
            self.0.pop_front();
        }
        self.0.push_back(ResponsePair { at: now, delay });
    }

    /// Returns the time of the first pair, if responses come in pairs as from two devices, not from
    /// a bridge: much closer than heartbeats, of which the closest are `shortest` apart.
    fn two_responders_since(&self, shortest: Duration) -> Option<Instant> {
        let quick = |pair: &ResponsePair| {
            pair.delay <= shortest / 2 && pair.delay + FAST_PAIR_MARGIN <= shortest
        };
        let are_quick = self.0.len() == FAST_PAIRS && self.0.iter().all(quick);
        self.0.front().filter(|_| are_quick).map(|pair| pair.at)
    }
}

/// Addresses that responded to the last broadcast request once and twice, one bit each.
#[derive(Clone, Debug, Default)]
struct RoundResponses {
    sent_at: Instant,
    once: u128,
    twice: u128,
}

impl RepeatedFrameDetector {
    pub fn new(period: Duration) -> Self {
        Self {
            period,
            last_heartbeat: None,
            last_of_another: None,
            copy_count: 0,
            last_copied: None,
            several_sources_until: Instant::ZERO,
            active_until: Instant::ZERO,
            delay: Duration::ZERO,
            shortest: None,
            longest_delay: MAX_FORWARDING_DELAY,
            response_pairs: ResponsePairs::default(),
            awaiting_copy: VecDeque::new(),
            echoed_until: Instant::ZERO,
            responses: RoundResponses::default(),
            series: AddressTable::new(),
        }
    }

    /// Sets the heartbeat period of most addresses.
    pub fn set_period(&mut self, period: Duration) {
        self.period = period;
    }

    /// Returns true if all frames are repeated.
    pub fn is_active(&self, now: Instant) -> bool {
        now < self.active_until
    }

    /// Returns true if the frames of `address` are repeated.
    pub fn is_repeated(&self, now: Instant, address: Address) -> bool {
        self.is_active(now) || now < self.series[address].active_until
    }

    /// Returns true if copies, some of whose originals are lost, explain the timing of the heartbeats
    /// of `address`, which were received at `times`, without copies: they have copies, none came as late as a
    /// copy and was another one, and nearly all came about whole periods apart.
    pub fn explains_timing(
        &self,
        now: Instant,
        address: Address,
        times: &VecDeque<Instant>,
        period: Duration,
    ) -> bool {
        let CopySeries { differs_at, uncopied, longest, further, .. } = self.series[address];
        let recent = self.period * 10;
        // A copy whose original is lost comes as late.
        let late = self.delay.max(longest).max(further) + DELAY_JITTER * 2;
        let is_other = |gap: Duration| gap > late && gap + late < period;
        let gaps = times.iter().rev().zip(times.iter().rev().skip(1));
        let gaps = gaps.take(TIMED_GAPS).map(|(next, one)| next.since(*one));
        self.is_repeated(now, address)
            && uncopied < MAX_UNCOPIED
            && differs_at.is_none_or(|at| now.since(at) > recent)
            && gaps.filter(|gap| is_other(*gap)).count() < MIN_OTHER_GAPS
    }

    /// Returns the longest delay of the copies of addresses other than `address`; zero if they have none.
    pub fn longest_delay_of_others(&self, now: Instant, address: Address) -> Duration {
        if self.is_bus_repeated(now) {
            return self.delay + DELAY_JITTER;
        }
        let others = Address::all().filter(|other| *other != address).map(|it| &self.series[it]);
        let repeated = others.filter(|series| now < series.active_until);
        repeated.map(|series| series.longest + DELAY_JITTER).max().unwrap_or_default()
    }

    /// Returns whose frames are repeated, and how late: of `address`, or of several with `None`.
    pub fn repeated_frames(&self, now: Instant, address: Option<Address>) -> RepeatedFrames {
        let (addresses, repeated) = match address {
            Some(address) => (vec![address], vec![&self.series[address]]),
            None => (self.repeated_addresses(now), self.copied_series(now)),
        };
        let further = |series: &&&CopySeries| self.is_recent(now, series.further_at);
        let further: Vec<Duration> =
            repeated.iter().filter(further).map(|series| series.further).collect();
        let longest = repeated.iter().map(|series| series.longest).chain(further.iter().copied());
        let shortest = || repeated.iter().map(|series| series.shortest);
        RepeatedFrames {
            addresses,
            delays: DelayRange {
                shortest: shortest().min().unwrap_or(self.delay),
                longest: longest.max().unwrap_or(self.delay),
            },
            usual_delay: median(&mut shortest().collect::<Vec<_>>()).unwrap_or(self.delay),
            is_further_copy: !further.is_empty(),
        }
    }

    fn is_recent(&self, now: Instant, at: Option<Instant>) -> bool {
        is_recent(now, at, self.period)
    }

    /// Returns the copied heartbeats of each address that has them: of senders that generate RND7, if there are
    /// any.
    fn copied_series(&self, now: Instant) -> Vec<&CopySeries> {
        let all = || Address::all().map(|address| &self.series[address]);
        let is_copied = |series: &&CopySeries| self.is_recent(now, series.copied_at);
        let random: Vec<&CopySeries> =
            all().filter(|series| series.count > 0).filter(is_copied).collect();
        if random.is_empty() { all().filter(is_copied).collect() } else { random }
    }

    /// Returns true if the copies of most addresses are about as late, as those of one bridge.
    fn are_of_one_bridge(&self, now: Instant) -> bool {
        let mut delays: Vec<Duration> =
            self.copied_series(now).iter().map(|series| series.shortest).collect();
        let Some(usual) = median(&mut delays) else { return false };
        let count = delays.iter().filter(|delay| is_about_as_late(**delay, usual)).count();
        count * 4 >= delays.len() * 3
    }

    /// Returns the addresses whose frames are repeated, if other nodes send frames without copies; else none.
    fn repeated_addresses(&self, now: Instant) -> Vec<Address> {
        let has_no_copies = |address: Address| {
            let series = &self.series[address];
            series.uncopied >= MAX_UNCOPIED && self.is_recent(now, series.heard_at)
        };
        if !Address::all().any(has_no_copies) {
            return Vec::new();
        }
        let is_copied = |address: &Address| self.is_recent(now, self.series[*address].copied_at);
        Address::all().filter(is_copied).collect()
    }

    /// Returns true if the frames of several addresses, so probably all, are repeated.
    pub fn is_bus_repeated(&self, now: Instant) -> bool {
        self.is_active(now) && now < self.several_sources_until
    }

    /// Returns true if a frame of `source` is the copy of an earlier one, to be ignored.
    /// `heartbeat`: whether it is a heartbeat.
    pub fn is_copy(
        &mut self,
        now: Instant,
        source: Address,
        heartbeat: bool,
        frame: &Frame,
    ) -> bool {
        if !self.is_repeated(now, source) {
            return false;
        }
        let series = &self.series[source];
        let delay = self.delay.max(series.longest).max(series.further);
        let window = (delay * 2).max(Duration::from_millis(20));
        // A request that is repeated later than that has an equal response.
        let window = if heartbeat {
            window
        } else {
            window.min(MAX_FORWARDING_DELAY * 2).max(self.delay * 2)
        };
        let longest = self.longest_delay * 2;
        while self.awaiting_copy.front().is_some_and(|(at, _)| now.since(*at) > longest) {
            self.awaiting_copy.pop_front();
        }
        let mut hasher = DefaultHasher::new();
        (frame.platform_id(), frame.data()).hash(&mut hasher);
        let hash = hasher.finish();
        let mut awaiting = self.awaiting_copy.iter();
        let at = awaiting.position(|(at, open)| *open == hash && now.since(*at) <= window);
        // It stays: two gateways make two copies.
        if let Some((first, _)) = at.and_then(|at| self.awaiting_copy.get(at)).copied() {
            if !heartbeat {
                self.note_duplicate(now, source, now.since(first));
            }
            return true;
        }
        if self.awaiting_copy.len() == MAX_OPEN {
            self.awaiting_copy.pop_front();
        }
        self.awaiting_copy.push_back((now, hash));
        false
    }

    /// Notes a heartbeat from `address`; call before [`is_copy`](Self::is_copy).
    pub fn note_heartbeat(&mut self, now: Instant, address: Address, recorded: RecordedHeartbeat) {
        let period = self.period;
        let series = &mut self.series[address];
        let delay = self.delay.max(series.longest);
        let is_other = !recorded.may_be_copy;
        if is_other && recorded.gap.is_some_and(|gap| gap <= delay + DELAY_JITTER) {
            series.differs_at = Some(now);
        }
        if self.last_heartbeat.is_none_or(|(_, at)| now.since(at) > period * 3) {
            self.several_sources_until = Instant::ZERO;
            self.response_pairs = ResponsePairs::default();
        }
        let series = &mut self.series[address];
        series.heard_at = Some(now);
        if let Some(delay) = recorded.copy_delay {
            series.add(now, delay, period, recorded.has_random_rnd7);
            self.longest_delay = self.longest_delay.max(delay);
            self.note_copied_heartbeat(now, address, delay);
            if recorded.has_random_rnd7 {
                self.note_copy_of_one(now, address);
            }
        } else if let Some(delay) = recorded.further_copy_delay {
            if !is_recent(now, series.further_at.replace(now), period) {
                series.further = Duration::ZERO;
            }
            series.further = series.further.max(delay).min(MAX_FORWARDING_DELAY);
        } else if recorded.previous_has_no_copy {
            series.uncopied = series.uncopied.saturating_add(1);
            // One copy may be lost: the next one counts again.
            series.count = if now < series.active_until {
                series.count.min(COPIES_OF_ONE - 1)
            } else {
                series.count.saturating_sub(1)
            };
            if self.is_active(now) {
                self.copy_count = self.copy_count.min(COPIES_OF_ONE - 1);
            } else {
                self.copy_count = 0;
                self.several_sources_until = Instant::ZERO;
                self.last_copied = None;
                self.shortest = None;
            }
        }
        if self.last_heartbeat.is_some_and(|(last, _)| last != address) {
            self.last_of_another = self.last_heartbeat;
        }
        self.last_heartbeat = Some((address, now));
    }

    fn note_copied_heartbeat(&mut self, now: Instant, address: Address, delay: Duration) {
        self.copy_count += 1;
        let is_of_one_bridge = |(other, other_delay): (Address, Duration)| {
            other != address && is_about_as_late(delay, other_delay)
        };
        if self.copy_count >= COPIES_OF_ONE
            && self.last_copied.is_some_and(is_of_one_bridge)
            && self.are_of_one_bridge(now)
        {
            self.several_sources_until = now + self.period * REPEATED_PERIODS;
        }
        self.last_copied = Some((address, delay));
        self.shortest = Some(self.shortest.map_or(delay, |shortest| shortest.min(delay)));
        let alone = self.copy_count >= COPIES_OF_ONE && self.is_single_source(now, address);
        if now < self.several_sources_until || alone && self.two_responders_since().is_none() {
            self.active_until = now + self.period * REPEATED_PERIODS;
            self.delay = self.delay.max(delay);
        }
    }

    fn note_copy_of_one(&mut self, now: Instant, address: Address) {
        let period = self.period;
        let series = &mut self.series[address];
        let has_two = series.response_pairs.two_responders_since(series.shortest).is_some();
        if series.count >= COPIES_OF_ONE && series.is_steady() && !has_two {
            series.active_until = now + period * REPEATED_PERIODS;
        }
    }

    /// Returns true if no other address sends heartbeats.
    fn is_single_source(&self, now: Instant, address: Address) -> bool {
        let mut last = [self.last_heartbeat, self.last_of_another].into_iter().flatten();
        last.all(|(other, at)| other == address || now.since(at) > self.period * 3)
    }

    /// Notes a response of `address` equal to one received `delay` before.
    pub fn note_duplicate(&mut self, now: Instant, address: Address, delay: Duration) {
        self.response_pairs.add(now, delay, self.period);
        let series = &mut self.series[address];
        series.response_pairs.add(now, delay, self.period);
        if series.response_pairs.two_responders_since(series.shortest).is_some() {
            series.active_until = series.active_until.min(now);
        }
        if now >= self.several_sources_until && self.two_responders_since().is_some() {
            self.active_until = self.active_until.min(now);
        }
    }

    /// Returns since when responses come in pairs as from two devices, not from a bridge.
    fn two_responders_since(&self) -> Option<Instant> {
        self.response_pairs.two_responders_since(self.shortest?)
    }

    /// Returns since when `address` responds twice although its heartbeats seemed repeated: two
    /// devices with equal random numbers.
    pub fn two_devices_since(&self, address: Address) -> Option<Instant> {
        let series = &self.series[address];
        let is_copied = series.count >= COPIES_OF_ONE;
        series.response_pairs.two_responders_since(series.shortest).filter(|_| is_copied)
    }

    /// Notes that a frame of descan was repeated: devices may have received it twice as well.
    pub fn note_own_echo(&mut self, now: Instant) {
        self.echoed_until = now + self.period * 3;
    }

    /// Notes a broadcast request; those of one enumeration round belong together.
    pub fn note_broadcast(&mut self, now: Instant) {
        if now.since(self.responses.sent_at) > self.period / 2 {
            self.responses = RoundResponses { sent_at: now, once: 0, twice: 0 };
        }
    }

    /// Notes a response to a broadcast request; `extra`: it is beyond the number of requests.
    pub fn note_response(&mut self, address: Address, is_surplus: bool) {
        let bit = 1 << address.index();
        self.responses.once |= bit;
        if is_surplus {
            self.responses.twice |= bit;
        }
    }

    /// Returns true if devices seem to receive requests twice, so that a second response is not
    /// another device's.
    pub fn has_duplicate_requests(&self, now: Instant) -> bool {
        if self.is_active(now) || now < self.echoed_until {
            return true;
        }
        let (once, twice) = (self.responses.once.count_ones(), self.responses.twice.count_ones());
        twice >= 2 && twice * 10 >= once * 9
    }
}

#[cfg(test)]
mod tests {
    use super::super::history::HeartbeatHistory;
    use super::*;

    const PERIOD: Duration = Duration::from_secs(1);

    fn address(number: u8) -> Address {
        Address::from_bits(number)
    }

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    /// A heartbeat from `source` with `rnd7`.
    fn heartbeat(source: u32, rnd7: u32, millis: u64) -> Frame {
        Frame::classic(0x0700_0001 | source << 17 | rnd7 << 10, &[1; 8]).with_time(at(millis))
    }

    /// A detector with the heartbeats that it needs.
    struct DoubledBus {
        histories: Vec<HeartbeatHistory>,
        repeated_frames: RepeatedFrameDetector,
    }

    impl DoubledBus {
        fn new() -> Self {
            let histories = (0..Address::COUNT).map(|_| HeartbeatHistory::default()).collect();
            Self { histories, repeated_frames: RepeatedFrameDetector::new(PERIOD) }
        }

        /// Processes a heartbeat; returns true if it is a copy to be ignored.
        fn process(&mut self, frame: &Frame) -> bool {
            let source = address((frame.platform_id().unwrap() >> 17) as u8);
            let recorded = self.histories[source.index()].record(
                frame.time,
                frame,
                PERIOD,
                Some(Duration::ZERO),
            );
            self.repeated_frames.note_heartbeat(frame.time, source, recorded);
            self.repeated_frames.is_copy(frame.time, source, true, frame)
        }
    }

    #[test]
    fn bridge_repeating_all_frames_is_detected() {
        let mut bus = DoubledBus::new();
        for second in 0..3 {
            for source in [5, 9] {
                let start = second * 1000 + u64::from(source) * 50;
                assert!(!bus.process(&heartbeat(source, second as u32, start)));
                let copy = bus.process(&heartbeat(source, second as u32, start + 12));
                // The third copied heartbeat shows it.
                let is_shown = second > 1 || second == 1 && source == 9;
                assert_eq!(copy, is_shown, "the copy of {source} in second {second}");
            }
        }
        assert!(bus.repeated_frames.is_active(at(3000)));
        assert!(!bus.repeated_frames.is_active(at(6000)), "ends without further copies");
    }

    #[test]
    fn equal_devices_at_one_address_are_not_a_bridge() {
        let mut bus = DoubledBus::new();
        for second in 0..20 {
            for (source, phase) in [(5, 0), (5, 60), (9, 500)] {
                bus.process(&heartbeat(source, 0, second * 1000 + phase));
            }
        }
        assert!(!bus.repeated_frames.is_active(at(20_000)));
    }

    #[test]
    fn all_devices_responding_twice_got_two_requests() {
        let mut repeated_frames = RepeatedFrameDetector::new(PERIOD);
        for source in 1..=4 {
            repeated_frames.note_response(address(source), source == 1);
        }
        assert!(!repeated_frames.has_duplicate_requests(at(0)), "one of four");
        for source in 2..=4 {
            repeated_frames.note_response(address(source), true);
        }
        assert!(repeated_frames.has_duplicate_requests(at(10)), "all four");
    }
}
