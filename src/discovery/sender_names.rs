//! Names of senders: which row is that of which sender of heartbeats, at an address that several
//! devices may use.
//!
//! A heartbeat shows no name, and a name response no UID. While a single sender is at the address,
//! or while all others are known by name, a name received there is that of this sender. Heartbeats
//! without a UID are of one more sender: a device sends its UID each time, or never.

use super::{AddressSender, DeviceId};
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::{Heartbeat, Mode, Uid};
use std::ops::Range;

/// Maximum number of senders stored; beyond that the one silent for the longest time is dropped.
/// Bounds the memory: two senders at each address.
const MAX_SENDERS: usize = 256;
/// Periods without a heartbeat for which a sender may still be at its address. After that it is
/// stale (protocol §4.6).
const PRESENT_PERIODS: f64 = 2.5;
/// Number of responses in a row with another name after which the next one shows that the only
/// sender has it. One may be that of a device without heartbeats.
const CONTRADICTIONS: u32 = 1;
/// The same where another device responds too: some in a row may be its, when responses of the
/// sender are lost.
const CONTRADICTIONS_SHARED: u32 = 3;
/// Periods without a heartbeat after which a sender was absent.
const ABSENT_PERIODS: u32 = 5;
/// Deviation of an interval from the one before it up to which both are a period. Chosen: the bus
/// delays heartbeats by some milliseconds.
const INTERVAL_TOLERANCE: f64 = 0.2;
/// Number of intervals equal to the one before them that show a period. With 30 % of the heartbeats
/// lost, four double periods in a row are one in five hundred.
const EQUAL_INTERVALS: u32 = 3;

/// A sender of heartbeats at an address.
#[derive(Clone, Copy, Debug)]
struct NamedSender {
    address: Address,
    /// All 00 where its heartbeats carry none.
    uid: Uid,
    last: Instant,
    /// First heartbeat after its last absence of more than five periods.
    since: Instant,
    /// First heartbeat, before any absence.
    first: Instant,
    /// Last mode; `None` if its heartbeats carry none.
    mode: Option<Mode>,
    /// Time between its last two heartbeats.
    interval: Duration,
    /// Number of intervals in a row that are equal to the one before them.
    equal_count: u32,
    /// Row of its name, if known.
    row: Option<DeviceId>,
    /// Row of another name than its own, or of a name that another sender had, received while it was
    /// the only sender.
    contradicted_by: Option<DeviceId>,
    /// Number of times in a row that this name was received.
    contradictions: u32,
    /// True if its own name was received after it: another device, which sends no heartbeats or the
    /// same UID, is there too.
    is_shared: bool,
}

impl NamedSender {
    fn new(now: Instant, address: Address, uid: Uid) -> Self {
        Self {
            address,
            uid,
            last: now,
            since: now,
            first: now,
            mode: None,
            interval: Duration::ZERO,
            equal_count: 0,
            row: None,
            contradicted_by: None,
            contradictions: 0,
            is_shared: false,
        }
    }

    fn note_heartbeat(&mut self, now: Instant, period: Duration) {
        let interval = now.since(self.last);
        if interval > self.period().unwrap_or(period).max(period) * ABSENT_PERIODS {
            self.since = now;
        }
        let deviation = interval.abs_diff(self.interval);
        let is_equal = deviation < self.interval.mul_f64(INTERVAL_TOLERANCE);
        self.equal_count = if is_equal { self.equal_count.saturating_add(1) } else { 0 };
        (self.last, self.interval) = (now, interval);
    }

    /// Returns its period, if its last heartbeats show it.
    fn period(&self) -> Option<Duration> {
        (self.equal_count >= EQUAL_INTERVALS).then_some(self.interval)
    }
}

/// Senders of heartbeats on one bus, and the rows of their names. UIDs that it returns are blank for
/// a sender without one.
#[derive(Clone, Debug, Default)]
pub(super) struct SenderNames {
    /// In the order of their addresses.
    senders: Vec<NamedSender>,
}

impl SenderNames {
    /// Notes a heartbeat. `period`: that of the slowest sender at its address.
    pub fn note_heartbeat(
        &mut self,
        now: Instant,
        address: Address,
        period: Duration,
        heartbeat: Heartbeat,
    ) {
        if let Some(sender) = self.find_mut(address, heartbeat.uid) {
            sender.note_heartbeat(now, period);
            sender.mode = heartbeat.mode.or(sender.mode);
            return;
        }
        let new = NamedSender::new(now, address, known_or_blank(heartbeat.uid));
        let sender = NamedSender { mode: heartbeat.mode, ..new };
        if self.senders.len() == MAX_SENDERS {
            let all = self.senders.iter().enumerate();
            let oldest = all.min_by_key(|(_, sender)| sender.last).map_or(0, |(at, _)| at);
            self.senders.remove(oldest);
        }
        let at = self.range_of(address).end;
        self.senders.insert(at, sender);
    }

    fn range_of(&self, address: Address) -> Range<usize> {
        let begin = self.senders.partition_point(|it| it.address < address);
        let here = self.senders[begin..].iter().take_while(|it| it.address == address);
        begin..begin + here.count()
    }

    fn at(&self, address: Address) -> &[NamedSender] {
        &self.senders[self.range_of(address)]
    }

    fn at_mut(&mut self, address: Address) -> &mut [NamedSender] {
        let range = self.range_of(address);
        &mut self.senders[range]
    }

    /// Returns the UID of the sender whose name was received at `address`; `None` if it may be that
    /// of several. `named`: the row of that name, if there is one.
    pub fn sender_of_name(
        &self,
        now: Instant,
        address: Address,
        period: Duration,
        named: Option<DeviceId>,
    ) -> Option<Uid> {
        let present: Vec<&NamedSender> = self.present(now, address, period).collect();
        if let Some(row) = named
            && let Some(sender) = present.iter().find(|sender| sender.row == Some(row))
        {
            return Some(sender.uid);
        }
        // A device may respond before its first heartbeat.
        let is_expected = named.is_some_and(|row| self.of_row(row, address).is_some());
        let mut unnamed = present.iter().filter(|sender| sender.row.is_none());
        let unnamed = (unnamed.next(), unnamed.next());
        match (unnamed, &*present) {
            ((Some(sender), None), _) if !is_expected => Some(sender.uid),
            (_, [only]) if named.is_some() && only.contradicted_by == named => {
                let most = if only.is_shared { CONTRADICTIONS_SHARED } else { CONTRADICTIONS };
                (only.contradictions >= most).then_some(only.uid)
            }
            _ => None,
        }
    }

    /// Notes that a name was received at `address` whose row is `row`; `sender`: what
    /// [`sender_of_name`](Self::sender_of_name) returned for it.
    pub fn note_name(
        &mut self,
        now: Instant,
        address: Address,
        period: Duration,
        row: DeviceId,
        sender: Option<Uid>,
    ) {
        if sender.is_some() {
            let had_name = self.row_of(address, sender) == Some(row);
            for other in self.at_mut(address) {
                other.row = other.row.filter(|own| *own != row);
            }
            if let Some(sender) = self.find_mut(address, sender) {
                sender.row = Some(row);
                sender.is_shared = had_name && (sender.is_shared || sender.contradictions > 0);
                (sender.contradicted_by, sender.contradictions) = (None, 0);
            }
            return;
        }
        let present: Vec<Uid> = self.present(now, address, period).map(|it| it.uid).collect();
        if let [only] = *present
            && let Some(sender) = self.find_mut(address, Some(only))
        {
            let is_again = sender.contradicted_by.replace(row) == Some(row);
            sender.contradictions = if is_again { sender.contradictions + 1 } else { 1 };
        }
    }

    /// Replaces row `new` by `old`, into which it was merged.
    pub fn merge_rows(&mut self, old: DeviceId, new: DeviceId) {
        for sender in self.senders.iter_mut().filter(|sender| sender.row == Some(new)) {
            sender.row = Some(old);
        }
    }

    /// Returns the row of a sender's name.
    pub fn row_of(&self, address: Address, uid: Option<Uid>) -> Option<DeviceId> {
        let uid = known_or_blank(uid);
        self.at(address).iter().find(|it| it.uid == uid)?.row
    }

    /// Returns the UID in the heartbeats of the device of a row.
    pub fn uid_of(&self, row: DeviceId, address: Address) -> Option<Uid> {
        Some(self.of_row(row, address)?.uid)
    }

    /// Returns the last mode of the device of a row.
    pub fn mode_of(&self, row: DeviceId, address: Address) -> Option<Mode> {
        self.of_row(row, address)?.mode
    }

    /// Returns the last heartbeat of the device of a row. Without a UID it may be that of another
    /// device, once another name was received.
    pub fn last_of(&self, row: DeviceId, address: Address) -> Option<Instant> {
        let sender = self.of_row(row, address)?;
        let is_certain = !sender.uid.is_blank() || sender.contradicted_by.is_none();
        is_certain.then_some(sender.last)
    }

    /// Returns true if another sender than that with this UID is at `address`.
    pub fn is_shared(
        &self,
        now: Instant,
        address: Address,
        period: Duration,
        uid: Option<Uid>,
    ) -> bool {
        let uid = known_or_blank(uid);
        self.present(now, address, period).any(|it| it.uid != uid)
    }

    /// Returns the sender without a UID at `address`, unless it has been absent for more than five
    /// periods. `current`: the row at the address, for a sender whose name is not known.
    pub fn blank_sender(
        &self,
        now: Instant,
        address: Address,
        period: Duration,
        current: Option<DeviceId>,
    ) -> Option<AddressSender> {
        let sender = self.at(address).iter().find(|it| it.uid == Uid::BLANK)?;
        let device = sender.row.or(current)?;
        (now.since(sender.last) < period * ABSENT_PERIODS).then_some(AddressSender {
            uid: Uid::BLANK,
            device,
            mode: sender.mode,
            since: sender.since,
            first: sender.first,
            last: sender.last,
        })
    }

    /// Returns the longest period of the senders at `address`; `None` if none is known.
    pub fn longest_period(&self, now: Instant, address: Address) -> Option<Duration> {
        let present = self.at(address).iter().filter_map(|sender| {
            let period = sender.period()?;
            (now.since(sender.last) < period.mul_f64(PRESENT_PERIODS)).then_some(period)
        });
        present.max()
    }

    /// Returns true if two senders are at `address` whose names are known and differ, and neither
    /// took the place of the other.
    pub fn are_two_named(&self, now: Instant, address: Address, period: Duration) -> bool {
        let named = || self.present(now, address, period).filter(|sender| sender.row.is_some());
        let are_beside = |one: &NamedSender, other: &NamedSender| {
            one.row != other.row && one.last > other.since && other.last > one.since
        };
        named().any(|one| named().any(|other| are_beside(one, other)))
    }

    fn find_mut(&mut self, address: Address, uid: Option<Uid>) -> Option<&mut NamedSender> {
        let uid = known_or_blank(uid);
        self.at_mut(address).iter_mut().find(|it| it.uid == uid)
    }

    fn of_row(&self, row: DeviceId, address: Address) -> Option<&NamedSender> {
        self.at(address).iter().find(|it| it.row == Some(row))
    }

    fn present(
        &self,
        now: Instant,
        address: Address,
        period: Duration,
    ) -> impl Iterator<Item = &NamedSender> {
        let limit = period.mul_f64(PRESENT_PERIODS);
        self.at(address).iter().filter(move |it| now.since(it.last) < limit)
    }
}

fn known_or_blank(uid: Option<Uid>) -> Uid {
    uid.and_then(Uid::not_blank).unwrap_or(Uid::BLANK)
}
