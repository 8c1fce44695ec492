//! Statistics of identifiers and calls of all frames until a moment: kept now and then while frames are
//! taken, and counted from there to the moment that is wanted.
//!
//! Bounded in bytes. Does not know how statistics are shown.

use super::identifiers::IdentifierLink;
use super::{Calls, FrameStore, Identifiers};
use crate::app::buses::Buses;
use crate::app::history::most_redundant;
use crate::frame::{BusIndex, Frame};
use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Most frames between two snapshots: counted in about 20 ms. Those that others are near to are dropped
/// when they take too much room.
const MAX_SPACING: u64 = 1 << 18;
/// Fewest snapshots of a full store.
const MIN_SNAPSHOTS: u64 = 8;

/// Identifiers and calls of some frames.
#[derive(Clone, Debug, Default)]
pub struct FrameStatistics {
    /// Statistics of the frames of each identifier.
    pub identifiers: Identifiers,
    /// Statistics of calls.
    pub calls: Calls,
}

impl FrameStatistics {
    /// Counts a frame of these buses.
    pub(super) fn add(&mut self, frame: &Frame, number: u64, buses: &Buses) {
        add_identifier(&mut self.identifiers, frame, number, buses);
        if let Some(bus) = buses.get(frame.bus) {
            self.calls.add(frame, number, &bus.config().profile);
        }
    }

    /// Ends a second.
    fn tick(&mut self, now: Instant, timeout: impl Fn(BusIndex) -> Duration) {
        self.identifiers.tick();
        self.calls.tick(now, timeout);
    }
}

/// Places of the rows of a frame in the tables of identifiers; `None` where it has none.
#[derive(Clone, Copy, Debug)]
pub struct IdentifierRows {
    /// In the first table, with the frame before.
    pub link: Option<IdentifierLink>,
    /// Among the identifiers as they are.
    pub unmasked: Option<usize>,
    /// Among the broadcasts where DBC files have messages.
    pub described: Option<usize>,
}

/// Counts a frame of these buses in the tables of identifiers that are for it.
pub fn add_identifier(
    identifiers: &mut Identifiers,
    frame: &Frame,
    number: u64,
    buses: &Buses,
) -> IdentifierRows {
    let link = identifiers.add(frame, number);
    let is_unmasked = !buses.speaks_des(frame.bus);
    let unmasked = is_unmasked.then(|| identifiers.add_unmasked(frame, number)).flatten();
    let has_message = || buses.has_message(frame);
    let is_described = !buses.messages().is_empty();
    let described = is_described.then(|| identifiers.add_described(frame, number, has_message));
    IdentifierRows { link, unmasked, described: described.flatten() }
}

/// Statistics at the end of a second.
#[derive(Clone, Debug)]
struct StatisticsSnapshot {
    /// Number of frames that are counted.
    frames: u64,
    second: u64,
    size: usize,
    statistics: FrameStatistics,
}

/// Statistics of past moments.
#[derive(Debug)]
pub(super) struct StatisticsHistory {
    /// Oldest first.
    snapshots: VecDeque<StatisticsSnapshot>,
    /// Frames between two snapshots.
    spacing: u64,
    room: usize,
}

impl StatisticsHistory {
    /// Returns a history of at most `room` bytes, beside a store of so many frames.
    pub fn new(room: usize, capacity: u64) -> Self {
        let spacing = (capacity / MIN_SNAPSHOTS).min(MAX_SPACING);
        Self { snapshots: VecDeque::new(), spacing, room }
    }

    /// Gives them more room, in bytes.
    pub fn add_room(&mut self, more: usize) {
        self.room += more;
    }

    /// Keeps statistics at the end of a second if the last snapshot is long ago. `store` has the frames.
    pub fn keep(
        &mut self,
        now: Instant,
        store: &FrameStore,
        identifiers: &Identifiers,
        calls: &Calls,
    ) {
        let last = self.snapshots.back().map_or(0, |last| last.frames);
        if store.end() < last + self.spacing {
            return;
        }
        let size = identifiers.size() + calls.size();
        while self.snapshots.len() > 1 && self.snapshots[1].frames < store.first() {
            self.snapshots.pop_front();
        }
        while self.size() + size > self.room && !self.snapshots.is_empty() {
            let frames = self.snapshots.iter().map(|snapshot| snapshot.frames);
            let frames = frames.chain([store.end()]);
            self.snapshots.remove(most_redundant(frames).unwrap_or(0));
        }
        if size > self.room {
            return;
        }
        self.snapshots.push_back(StatisticsSnapshot {
            frames: store.end(),
            second: second_of(now),
            size,
            statistics: FrameStatistics { identifiers: identifiers.clone(), calls: calls.clone() },
        });
    }

    fn size(&self) -> usize {
        self.snapshots.iter().map(|snapshot| snapshot.size).sum()
    }

    /// Begins to count the frames before `frames`, until a time.
    pub fn count(&self, store: &FrameStore, frames: u64, time: Instant) -> StatisticsCount {
        let is_usable = |it: &&StatisticsSnapshot| {
            it.frames >= store.first() && it.frames <= frames && it.second <= second_of(time)
        };
        match self.snapshots.iter().rev().find(is_usable) {
            Some(snapshot) => StatisticsCount {
                statistics: snapshot.statistics.clone(),
                next: snapshot.frames,
                second: Some(snapshot.second),
                frames,
                time,
            },
            None => StatisticsCount {
                statistics: FrameStatistics::default(),
                next: 0,
                second: None,
                frames,
                time,
            },
        }
    }
}

/// Statistics that are being counted.
#[derive(Debug)]
pub struct StatisticsCount {
    statistics: FrameStatistics,
    /// Number of the next frame.
    next: u64,
    /// The second that is not over; `None` before the first frame.
    second: Option<u64>,
    /// Until this number of frames, and this time.
    frames: u64,
    time: Instant,
}

impl StatisticsCount {
    /// Counts at most `most` frames. Returns true when all are counted.
    pub(in crate::app) fn run(&mut self, store: &FrameStore, buses: &Buses, most: u64) -> bool {
        let end = self.frames.min(self.next.max(store.oldest()).saturating_add(most));
        for (number, frame) in store.frames_from(self.next).take_while(|(it, _)| *it < end) {
            self.pass_to(frame.time, buses);
            self.statistics.add(&frame, number, buses);
        }
        self.next = end;
        if end < self.frames {
            return false;
        }
        self.pass_to(self.time, buses);
        true
    }

    fn pass_to(&mut self, time: Instant, buses: &Buses) {
        let now = second_of(time);
        let second = self.second.unwrap_or(now);
        // After two ticks without frames, more change nothing.
        for _ in 0..now.saturating_sub(second).min(2) {
            self.statistics.tick(time, |bus| buses.profile(bus).calls.timeout());
        }
        self.second = Some(second.max(now));
    }

    /// The statistics, as far as they are counted.
    pub fn statistics(&self) -> &FrameStatistics {
        &self.statistics
    }

    /// Number of frames that are still to be counted.
    pub fn left(&self) -> u64 {
        self.frames - self.next
    }
}

fn second_of(time: Instant) -> u64 {
    time.as_micros() / 1_000_000
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::capture::Traffic;
    use crate::discovery::Config;
    use crate::wire::id::{Address, Header, Service};

    /// A request, its response, or a broadcast.
    fn frame(number: u64, time: Instant) -> Frame {
        let nodes = (number / 3 % 5) as u8;
        let response = !number.is_multiple_of(3);
        let (client, server) = (Address::from_bits(100), Address::from_bits(nodes));
        let header = Header {
            from_non_working: false,
            to_non_working: false,
            response,
            broadcast: number.is_multiple_of(11),
            no_error: !number.is_multiple_of(7),
            source: if response { server } else { client },
            destination: if response { client } else { server },
            service: Service::from_bits(0x20),
        };
        Frame::classic(header.encode(), &number.to_be_bytes()).with_time(time)
    }

    fn text(statistics: (&Identifiers, &Calls)) -> String {
        format!("{:?} {:?}", statistics.0.rows(), statistics.1.rows())
    }

    #[test]
    fn statistics_of_a_past_moment_are_those_of_that_moment() {
        let buses = Buses::new(Instant::ZERO, vec![("can0".into(), Config::default())]);
        let mut traffic = Traffic::new(0, 1 << 20);
        let mut rng = fastrand::Rng::with_seed(7);
        let (mut now, mut moments) = (Instant::ZERO, Vec::new());
        for number in 0..200_000 {
            let time = now + Duration::from_micros(rng.u64(0..2_000));
            for second in second_of(now)..second_of(time) {
                traffic.tick(Instant::from_micros((second + 1) * 1_000_000), &buses);
            }
            now = time;
            traffic.push(&frame(number, now), &buses);
            if rng.u16(..) < 20 {
                let shown = text((&traffic.identifiers, &traffic.calls));
                moments.push((traffic.capture.end(), now, shown));
            }
        }
        let first = traffic.capture.first();
        assert!(first > 100_000, "the oldest frames are dropped: {first}");
        let oldest = traffic.history.snapshots.iter().find(|it| it.frames >= first).unwrap().frames;
        let mut compared = 0;
        for (frames, time, shown) in moments.iter().filter(|(frames, ..)| *frames >= oldest) {
            let mut count = traffic.count_until(*frames, *time);
            while !count.run(&traffic.capture, &buses, 777) {}
            assert_eq!(count.left(), 0);
            let counted = count.statistics();
            assert_eq!(text((&counted.identifiers, &counted.calls)), *shown, "{frames} at {time}");
            compared += 1;
        }
        assert!(compared > 5, "{compared} moments");
    }

    #[test]
    fn snapshots_are_bounded_and_reach_all_times() {
        let buses = Buses::new(Instant::ZERO, vec![("can0".into(), Config::default())]);
        let room = 600_000;
        let mut traffic = Traffic::new(1 << 30, room);
        for number in 0..2_000_000_u64 {
            let time = Instant::from_micros(number * 1_000);
            if number.is_multiple_of(1_000) {
                traffic.tick(time, &buses);
            }
            traffic.push(&Frame::classic(number as u32 % 9, &[]).with_time(time), &buses);
        }
        let history = &traffic.history;
        assert!(history.size() <= room, "{}", history.size());
        let places: Vec<u64> = history.snapshots.iter().map(|it| it.frames).collect();
        let steps = places.windows(2).map(|it| it[1] - it[0]);
        let (least, most) = (steps.clone().min().unwrap(), steps.max().unwrap());
        assert!(places.len() >= 4 && most <= 2 * least + 1_000, "{places:?}");
    }
}
