//! Bus time by sender and by service: of the last ten seconds, of longer spans, and of all time.
//!
//! Input: the frames of one bus with their length in bits. Output: sums that change every ten
//! seconds, or with the unit of a longer span; in the first ten seconds every second. Counting a frame
//! allocates nothing. Bounded: sums of 28 units, which copies share. Does not know the bit rate and names.

use crate::frame::{CanId, Frame, FrameKind};
use crate::wire::id::{Address, Header, MessageType, Service};
use std::collections::VecDeque;
use std::sync::Arc;

/// Number of service numbers.
const SERVICES: usize = 1024;
/// Seconds of the smallest unit.
const TEN: u64 = 10;
/// For each unit its seconds, and how many of them are kept: two minutes, ten minutes, an hour.
const UNITS: [(u64, usize); 3] = [(TEN, 12), (60, 10), (600, 6)];
/// Tens without a frame that are added one by one: more than the longest span.
const MAX_EMPTY: u64 = 400;

/// Bus time in some seconds by sender and by service, in nominal bit times.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ShareCounts {
    /// Length in seconds; 0 before the first second is over.
    pub seconds: u64,
    /// Bus time of all frames.
    pub bits: u64,
    /// Bus time of frames that report a bus error.
    pub errors: u64,
    /// Bus time of frames that are not of the CAN platform: 11-bit identifiers, remote frames.
    pub non_platform: u64,
    /// Bus time of the frames that descan sent.
    pub own: u64,
    /// By number, ascending; none is 0.
    senders: Vec<(u16, u64)>,
    services: Vec<(u16, u64)>,
}

impl ShareCounts {
    /// Adds the counts of other seconds.
    fn add(&mut self, other: &Self) {
        self.seconds += other.seconds;
        self.bits += other.bits;
        self.errors += other.errors;
        self.non_platform += other.non_platform;
        self.own += other.own;
        merge(&mut self.senders, &other.senders);
        merge(&mut self.services, &other.services);
    }

    /// Bus time of each address that sent something.
    pub fn senders(&self) -> impl Iterator<Item = (Address, u64)> {
        self.senders.iter().map(|(at, bits)| (Address::from_bits(*at as u8), *bits))
    }

    /// Bus time of each service with a frame; debug messages have none.
    pub fn services(&self) -> impl Iterator<Item = (Service, u64)> {
        self.services.iter().map(|(number, bits)| (Service::from_bits(*number), *bits))
    }

    /// Size in bytes.
    fn size(&self) -> usize {
        size_of::<Self>() + (self.senders.len() + self.services.len()) * size_of::<(u16, u64)>()
    }
}

/// Adds sorted counts to others.
fn merge(to: &mut Vec<(u16, u64)>, from: &[(u16, u64)]) {
    for (number, bits) in from {
        match to.binary_search_by_key(number, |(number, _)| *number) {
            Ok(at) => to[at].1 += bits,
            Err(at) => to.insert(at, (*number, *bits)),
        }
    }
}

/// Counts of the running ten seconds: a place for each number, so that counting is cheap.
#[derive(Clone, Debug)]
struct RunningCounts {
    bits: u64,
    errors: u64,
    non_platform: u64,
    own: u64,
    senders: Box<[u32; Address::COUNT]>,
    services: Box<[u32; SERVICES]>,
}

impl RunningCounts {
    fn new() -> Self {
        let (senders, services) = (Box::new([0; Address::COUNT]), Box::new([0; SERVICES]));
        Self { bits: 0, errors: 0, non_platform: 0, own: 0, senders, services }
    }

    /// Sets all counts to 0.
    fn clear(&mut self) {
        self.senders.fill(0);
        self.services.fill(0);
        (self.bits, self.errors, self.non_platform, self.own) = (0, 0, 0, 0);
    }

    fn add(&mut self, frame: &Frame, bits: u64) {
        self.bits += bits;
        if frame.is_tx {
            self.own += bits;
        }
        let bits_of_frame = u32::try_from(bits).unwrap_or(u32::MAX);
        match (frame.kind, frame.id) {
            (FrameKind::Error, _) => self.errors += bits,
            (FrameKind::Data, CanId::Extended(id)) => {
                let header = Header::decode(id);
                let sender = &mut self.senders[header.source.index()];
                *sender = sender.saturating_add(bits_of_frame);
                // In a debug message the number is that of the message.
                if header.message_type() != MessageType::Debug {
                    let service = &mut self.services[usize::from(header.service.number())];
                    *service = service.saturating_add(bits_of_frame);
                }
            }
            _ => self.non_platform += bits,
        }
    }

    /// Returns the counts as those of so many seconds.
    fn counts(&self, seconds: u64) -> ShareCounts {
        let sums = |all: &[u32]| -> Vec<(u16, u64)> {
            let some = (0..).zip(all).filter(|(_, bits)| **bits > 0);
            some.map(|(number, bits)| (number, u64::from(*bits))).collect()
        };
        ShareCounts {
            seconds,
            bits: self.bits,
            errors: self.errors,
            non_platform: self.non_platform,
            own: self.own,
            senders: sums(&self.senders[..]),
            services: sums(&self.services[..]),
        }
    }
}

/// The last units of one length, and the running one.
#[derive(Clone, Debug, Default)]
struct UnitRow {
    whole: VecDeque<Arc<ShareCounts>>,
    running: ShareCounts,
}

/// Sums of the running ten seconds, of the units before, and of all time.
#[derive(Clone, Debug)]
pub struct LoadShares {
    /// First second of the running ten.
    start: u64,
    running: RunningCounts,
    /// Those of [`UNITS`].
    rows: [UnitRow; UNITS.len()],
    /// Until the running ten; before the first ten seconds are over until the last second.
    total: Arc<ShareCounts>,
    is_first: bool,
}

impl LoadShares {
    /// Returns sums that start with this second.
    pub(super) fn new(second: u64) -> Self {
        Self {
            start: second,
            running: RunningCounts::new(),
            rows: Default::default(),
            total: Arc::default(),
            is_first: true,
        }
    }

    /// Counts a frame of so many bits.
    pub(super) fn add(&mut self, frame: &Frame, bits: u64) {
        self.running.add(frame, bits);
    }

    /// Takes that all seconds before `second` are over.
    pub(super) fn advance(&mut self, second: u64) {
        let seconds = second.saturating_sub(self.start);
        if seconds < TEN {
            if self.is_first {
                self.total = Arc::new(self.running.counts(seconds));
            }
            return;
        }
        if std::mem::take(&mut self.is_first) {
            self.total = Arc::default();
        }
        let ten = self.running.counts(TEN);
        self.push(&ten);
        self.running.clear();
        // Tens in which nothing was received; the clock of a log may advance by years.
        let empty = seconds / TEN - 1;
        for _ in 0..empty.min(MAX_EMPTY) {
            self.push(&ShareCounts { seconds: TEN, ..ShareCounts::default() });
        }
        Arc::make_mut(&mut self.total).seconds += empty.saturating_sub(MAX_EMPTY) * TEN;
        self.start += seconds / TEN * TEN;
    }

    /// Takes the counts of ten seconds.
    fn push(&mut self, ten: &ShareCounts) {
        Arc::make_mut(&mut self.total).add(ten);
        for (row, (seconds, most)) in self.rows.iter_mut().zip(UNITS) {
            row.running.add(ten);
            if row.running.seconds >= seconds {
                if row.whole.len() == most {
                    row.whole.pop_front();
                }
                row.whole.push_back(Arc::new(std::mem::take(&mut row.running)));
            }
        }
    }

    /// The sums of the last whole ten seconds; before, of the first whole seconds.
    pub fn latest(&self) -> &ShareCounts {
        self.rows[0].whole.back().unwrap_or(&self.total)
    }

    /// The sums of the last so many seconds, in whole units; `None` or less time since the start: of all.
    pub fn span(&self, seconds: Option<u64>) -> Arc<ShareCounts> {
        let is_row = |(unit, most): &(u64, usize)| seconds == Some(unit * *most as u64);
        let row = UNITS.iter().position(is_row);
        match (row, seconds) {
            (Some(row), Some(seconds)) if self.total.seconds > seconds => {
                let mut sum = ShareCounts::default();
                self.rows[row].whole.iter().for_each(|unit| sum.add(unit));
                Arc::new(sum)
            }
            _ => Arc::clone(&self.total),
        }
    }

    /// Size in bytes, as of a copy.
    pub(super) fn size(&self) -> usize {
        let running = size_of::<[u32; Address::COUNT]>() + size_of::<[u32; SERVICES]>();
        let row = |row: &UnitRow| {
            row.running.size() + row.whole.iter().map(|unit| unit.size()).sum::<usize>()
        };
        running + self.total.size() + self.rows.iter().map(row).sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame that an address sends.
    fn frame(source: u8) -> Frame {
        Frame::new(CanId::Extended(0x0400_0001 | u32::from(source) << 17), &[0; 8])
    }

    #[test]
    fn spans_are_of_their_last_units() {
        let mut shares = LoadShares::new(7);
        for second in 7..7 + 5000 {
            let source = if second < 4000 { 10 } else { 11 };
            shares.add(&frame(source), 100);
            shares.advance(second + 1);
        }
        for (span, seconds) in [(120, 120), (600, 600), (3600, 3600)] {
            let sum = shares.span(Some(span));
            assert_eq!((sum.seconds, sum.bits), (seconds, seconds * 100), "{span}");
        }
        assert_eq!(shares.span(None).seconds, 5000);
        let of_10 = |span| -> u64 {
            let sum = shares.span(span);
            sum.senders().filter(|(at, _)| at.number() == 10).map(|(_, bits)| bits).sum()
        };
        assert_eq!(of_10(None), 3993 * 100);
        assert_eq!(of_10(Some(120)), 0);
        assert_eq!(of_10(Some(600)), 0);
        // The last whole unit of ten minutes ends up to ten minutes ago.
        assert!((2500..=3200).contains(&(of_10(Some(3600)) / 100)), "{}", of_10(Some(3600)));
        assert_eq!(shares.latest().seconds, TEN);
    }

    #[test]
    fn first_seconds_are_shown_and_years_cost_little() {
        let mut shares = LoadShares::new(0);
        shares.add(&frame(10), 50);
        shares.advance(1);
        assert_eq!((shares.latest().seconds, shares.span(Some(120)).bits), (1, 50));
        shares.advance(100_000_000);
        assert_eq!(shares.span(None).seconds, 100_000_000);
        assert_eq!((shares.span(None).bits, shares.span(Some(120)).bits), (50, 0));
        assert!(shares.size() < 20_000, "{}", shares.size());
    }
}
