//! The frames of several logs by their numbers, in the order in which they were taken.
//!
//! Inputs: the logs, and each batch of frames that was taken from one of them. Output: a source of all
//! frames. Bounded: the order of the batches has a room in bytes; of a longer session the first frames
//! cannot be read again. Does not know files.

use crate::app::varint::{read_varint, write_varint};
use crate::frame::{BusIndex, Frame};
use crate::log::FrameSource;
use crate::time::Instant;
use std::collections::VecDeque;
use std::io;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Frames between two places from which the order is read.
const SPACING: u64 = 4096;
/// A place between two batches.
#[derive(Debug)]
struct OrderPlace {
    /// Number of the next frame.
    number: u64,
    /// Bytes of the order before it.
    bytes: u64,
    /// Number of frames of each log before it.
    taken: Vec<u64>,
    /// Time of the next frame of each log, as it was taken.
    times: Vec<Option<Instant>>,
}

/// The place of a log, and numbers of its frames.
type LogPart = (usize, Range<u64>);

/// In which order the frames were taken.
#[derive(Debug)]
struct FrameOrder {
    /// A batch as one number: its length times the number of logs, plus the place of its log.
    bytes: VecDeque<u8>,
    /// Most bytes.
    room: usize,
    /// Bytes that were dropped.
    dropped: u64,
    places: VecDeque<OrderPlace>,
    /// Number of all frames, and of those of each log.
    end: u64,
    taken: Vec<u64>,
    /// Buses of the interfaces of each log.
    buses: Vec<Vec<BusIndex>>,
}

impl FrameOrder {
    fn logs(&self) -> u64 {
        self.taken.len() as u64
    }

    fn push(&mut self, log: usize, frames: &[Frame]) {
        let Some(first) = frames.first() else { return };
        if self.places.back().is_none_or(|last| self.end - last.number >= SPACING) {
            self.places.push_back(OrderPlace {
                number: self.end,
                bytes: self.dropped + self.bytes.len() as u64,
                taken: self.taken.clone(),
                times: vec![None; self.taken.len()],
            });
        }
        if let Some(last) = self.places.back_mut() {
            last.times[log].get_or_insert(first.time);
        }
        let count = frames.len() as u64;
        let batch = count * self.logs() + log as u64;
        write_varint(&mut self.bytes, batch);
        self.end += count;
        self.taken[log] += count;
        while self.bytes.len() > self.room && self.places.len() > 1 {
            self.places.pop_front();
            let kept = self.places.front().map_or(self.dropped, |first| first.bytes);
            self.bytes.drain(..(kept - self.dropped) as usize);
            self.dropped = kept;
        }
    }

    /// The parts of the logs in which frames are, in their order, and the place before them.
    fn parts(&self, numbers: &Range<u64>) -> Option<(&OrderPlace, Vec<LogPart>)> {
        let after = self.places.partition_point(|place| place.number <= numbers.start);
        let place = self.places.get(after.checked_sub(1)?)?;
        let from = usize::try_from(place.bytes - self.dropped).ok()?;
        let mut bytes = self.bytes.range(from..).copied();
        let (mut at, mut next, mut parts) = (place.number, place.taken.clone(), Vec::new());
        while at < numbers.end {
            let batch = read_varint(&mut bytes)?;
            let (log, count) = ((batch % self.logs()) as usize, batch / self.logs());
            let begin = numbers.start.saturating_sub(at).min(count);
            let end = count.min(numbers.end - at);
            if begin < end {
                parts.push((log, next[log] + begin..next[log] + end));
            }
            next[log] += count;
            at += count;
        }
        Some((place, parts))
    }
}

/// The order of the frames of several logs, for what takes them; clones share it.
#[derive(Clone, Debug)]
pub struct InterleavedOrder(Arc<Mutex<FrameOrder>>);

impl InterleavedOrder {
    /// Notes the next frames, which are of one log.
    pub fn push(&self, log: usize, frames: &[Frame]) {
        self.order().push(log, frames);
    }

    /// Sets the buses of the interfaces of a log.
    pub fn set_buses(&self, log: usize, buses: &[BusIndex]) {
        self.order().buses[log] = buses.to_vec();
    }

    // A panic of another thread leaves nothing half-done in here, so its poison is ignored.
    fn order(&self) -> MutexGuard<'_, FrameOrder> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Several logs as one source of frames.
#[derive(Debug)]
pub struct InterleavedLogs {
    logs: Vec<Box<dyn FrameSource>>,
    order: InterleavedOrder,
}

impl InterleavedLogs {
    /// Returns logs of which no frame was taken. The frames of the log at place n have bus n, and those
    /// of its further interfaces the buses after it, until their buses are set. The order takes `room`
    /// bytes at most, one or two for each batch.
    pub fn new(logs: Vec<Box<dyn FrameSource>>, room: usize) -> Self {
        let count = logs.len();
        let order = FrameOrder {
            bytes: VecDeque::new(),
            room,
            dropped: 0,
            places: VecDeque::new(),
            end: 0,
            taken: vec![0; count],
            buses: vec![Vec::new(); count],
        };
        Self { logs, order: InterleavedOrder(Arc::new(Mutex::new(order))) }
    }

    /// The order, to note the frames that are taken.
    pub fn order(&self) -> InterleavedOrder {
        self.order.clone()
    }
}

impl FrameSource for InterleavedLogs {
    fn numbers(&self) -> Range<u64> {
        let order = self.order.order();
        let firsts: Vec<u64> = self.logs.iter().map(|log| log.numbers().start).collect();
        let is_readable = |place: &&OrderPlace| {
            place.taken.iter().zip(&firsts).all(|(taken, first)| taken >= first)
        };
        let first = order.places.iter().find(is_readable);
        first.map_or(order.end, |place| place.number)..order.end
    }

    fn read(&mut self, numbers: Range<u64>, take: &mut dyn FnMut(Frame)) -> io::Result<()> {
        let (taken, times, parts, buses) = {
            let order = self.order.order();
            let Some((place, parts)) = order.parts(&numbers) else { return Ok(()) };
            (place.taken.clone(), place.times.clone(), parts, order.buses.clone())
        };
        let mut frames: Vec<VecDeque<Frame>> = Vec::with_capacity(self.logs.len());
        for (at, log) in self.logs.iter_mut().enumerate() {
            let mut own = parts.iter().filter(|(log, _)| *log == at).map(|(_, part)| part);
            let (Some(first), Some(time)) = (own.next(), times[at]) else {
                frames.push(VecDeque::new());
                continue;
            };
            let end = own.next_back().unwrap_or(first).end;
            let (mut number, mut start, mut wanted) = (taken[at], None, VecDeque::new());
            log.read(number..end, &mut |frame| {
                let start = *start.get_or_insert(frame.time);
                if number >= first.start {
                    let interface = usize::from(frame.bus.0).saturating_sub(at);
                    let bus = buses[at].get(interface).copied().unwrap_or(frame.bus);
                    wanted.push_back(frame.with_time(time + frame.time.since(start)).with_bus(bus));
                }
                number += 1;
            })?;
            frames.push(wanted);
        }
        for (log, part) in parts {
            for _ in part {
                let Some(frame) = frames[log].pop_front() else { return Ok(()) };
                take(frame);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Duration;

    const ROOM: usize = 100_000;

    /// A log of frames 10 ms apart; the identifier is the number of the frame.
    #[derive(Debug)]
    struct NumberedLog {
        bus: BusIndex,
        numbers: Range<u64>,
    }

    fn frame(number: u64, bus: BusIndex) -> Frame {
        let time = Instant::ZERO + Duration::from_millis(10) * number as u32;
        Frame::classic(number as u32, &[]).with_bus(bus).with_time(time)
    }

    impl FrameSource for NumberedLog {
        fn numbers(&self) -> Range<u64> {
            self.numbers.clone()
        }

        fn read(&mut self, numbers: Range<u64>, take: &mut dyn FnMut(Frame)) -> io::Result<()> {
            numbers.for_each(|number| take(frame(number, self.bus)));
            Ok(())
        }
    }

    fn logs(starts: [u64; 3]) -> InterleavedLogs {
        let log = |(at, start): (usize, u64)| -> Box<dyn FrameSource> {
            Box::new(NumberedLog { bus: BusIndex(at as u8), numbers: start..1 << 40 })
        };
        InterleavedLogs::new(starts.into_iter().enumerate().map(log).collect(), ROOM)
    }

    /// Takes random batches; returns all frames as they were taken: each log with a delay of its own, the
    /// second one as bus 7.
    fn take_batches(order: &InterleavedOrder, seed: u64, count: usize) -> Vec<Frame> {
        let mut rng = fastrand::Rng::with_seed(seed);
        order.set_buses(1, &[BusIndex(7)]);
        let (mut next, mut all) = ([0; 3], Vec::new());
        while all.len() < count {
            let log = rng.usize(0..3);
            let begin: u64 = next[log];
            next[log] += rng.u64(1..200);
            let bus = BusIndex([0, 7, 2][log]);
            let delay = Duration::from_secs(5 * log as u64);
            let taken = (begin..next[log]).map(|number| frame(number, bus));
            let taken: Vec<Frame> = taken.map(|it| it.with_time(it.time + delay)).collect();
            order.push(log, &taken);
            all.extend(taken);
        }
        all
    }

    #[test]
    fn frames_are_read_in_the_order_in_which_they_were_taken() {
        for seed in 0..20 {
            let mut logs = logs([0; 3]);
            let all = take_batches(&logs.order(), seed, 20_000);
            assert_eq!(logs.numbers(), 0..all.len() as u64);
            let mut rng = fastrand::Rng::with_seed(seed);
            for _ in 0..50 {
                let from = rng.usize(0..all.len());
                let to = (from + rng.usize(0..9000)).min(all.len());
                let mut read = Vec::new();
                logs.read(from as u64..to as u64, &mut |frame| read.push(frame)).unwrap();
                assert!(read == all[from..to], "seed {seed}, {from} to {to}");
            }
        }
    }

    #[test]
    fn frames_before_the_restart_of_a_log_are_not_read() {
        let logs = logs([0, 3_000, 0]);
        let all = take_batches(&logs.order(), 1, 30_000);
        let numbers = logs.numbers();
        assert_eq!(numbers.end, all.len() as u64);
        let before =
            all[..numbers.start as usize].iter().filter(|it| it.bus == BusIndex(7)).count();
        assert!((3_000..6_000).contains(&before), "{before}");
    }

    #[test]
    fn order_is_bounded() {
        let logs = logs([0; 3]);
        let order = logs.order();
        for number in 0..ROOM as u64 * 2 {
            order.push((number % 3) as usize, &[frame(number / 3, BusIndex(0))]);
        }
        let bytes = order.order().bytes.len();
        assert!(bytes <= ROOM, "{bytes}");
        let numbers = logs.numbers();
        assert!(numbers.start > 0 && numbers.start < numbers.end / 2 + 2 * SPACING, "{numbers:?}");
    }
}
