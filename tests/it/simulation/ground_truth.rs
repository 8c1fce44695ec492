//! Ground truth of a run: which devices shared an address or a UID, and when, sampled from the
//! simulator.

use descan::sim::{Fault, Scenario, Sim, SimDeviceId};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::Address;
use std::collections::{BTreeMap, BTreeSet};

/// Pauses shorter than this do not end a conflict.
const PAUSE: Duration = Duration::from_secs(3);

/// The time span of a conflict without a pause.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    pub from: Instant,
    /// The last sample in which it was present.
    pub until: Instant,
}

/// Two devices in conflict, by their index in the scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Clash {
    Address(Address, usize, usize),
    Uid(Address, Address),
}

#[derive(Default)]
pub struct Truth {
    spans: BTreeMap<Clash, Vec<Span>>,
    sampled: Option<Instant>,
    /// The end of the time in which both devices of a pair were on and neither gives way: they
    /// return to their address however often they silence each other.
    both_on: BTreeMap<Clash, Span>,
    /// When devices with one UID and different fixed addresses were on, though one may hold its
    /// address for moments only, because it claims it again and again.
    same_uid_on: BTreeMap<Clash, Vec<Span>>,
    /// The devices ever seen at each address.
    seen_at: BTreeMap<Address, BTreeSet<usize>>,
    /// When a device transmitted at another bit rate than that of the bus.
    other_bitrate: Vec<Span>,
}

impl Truth {
    /// Samples all devices.
    pub fn sample(
        &mut self,
        now: Instant,
        sim: &Sim,
        devices: &[SimDeviceId],
        scenario: &Scenario,
    ) {
        let specs = &scenario.devices;
        let mut rates = devices.iter().filter_map(|id| sim.device_state(*id).active_bitrate);
        if rates.any(|rate| rate != scenario.bitrate) {
            add_sample(&mut self.other_bitrate, self.sampled, now);
        }
        let mut at: BTreeMap<Address, Vec<usize>> = BTreeMap::new();
        for (index, &id) in devices.iter().enumerate() {
            if let Some(address) = sim.device_state(id).address {
                at.entry(address).or_default().push(index);
            }
        }
        for (&address, here) in &at {
            self.seen_at.entry(address).or_default().extend(here);
            for (one, other) in pairs(here) {
                self.see(now, Clash::Address(address, one, other));
            }
        }
        let mut uids: BTreeMap<[u8; 6], Vec<Address>> = BTreeMap::new();
        for (&address, here) in &at {
            for &index in here {
                let uid = sim.device_state(devices[index]).uid;
                let known = uids.entry(uid.0).or_default();
                if !uid.is_blank() && !known.contains(&address) {
                    known.push(address);
                }
            }
        }
        for addresses in uids.values().filter(|addresses| addresses.len() > 1) {
            for (one, other) in pairs(addresses) {
                self.see(now, Clash::Uid(one.min(other), one.max(other)));
            }
        }
        let mut fixed: BTreeMap<[u8; 6], Vec<Address>> = BTreeMap::new();
        for (spec, &id) in specs.iter().zip(devices) {
            if let (AddressSetting::Fixed(address), Some(_)) =
                (spec.address, sim.device_state(id).mode)
            {
                let uid = sim.device_state(id).uid;
                if !uid.is_blank() {
                    fixed.entry(uid.0).or_default().push(address);
                }
            }
        }
        for addresses in fixed.values() {
            for (one, other) in pairs(addresses).filter(|(one, other)| one != other) {
                let clash = Clash::Uid(one.min(other), one.max(other));
                note(&mut self.same_uid_on, self.sampled, now, clash);
            }
        }
        self.sampled = Some(now);
        let mut stubborn: BTreeMap<Address, Vec<usize>> = BTreeMap::new();
        for (index, spec) in specs.iter().enumerate() {
            if let AddressSetting::Fixed(address) = spec.address
                && spec.faults.has(Fault::KeepsAddress)
                && sim.device_state(devices[index]).mode.is_some()
            {
                stubborn.entry(address).or_default().push(index);
            }
        }
        for (address, here) in stubborn {
            for (one, other) in pairs(&here) {
                let clash = Clash::Address(address, one, other);
                let span = Span { from: now, until: now };
                self.both_on.entry(clash).or_insert(span).until = now;
            }
        }
    }

    fn see(&mut self, now: Instant, clash: Clash) {
        note(&mut self.spans, self.sampled, now, clash);
    }

    /// Returns the devices that ever held that address, by their index in the scenario.
    pub fn seen_at(&self, address: Address) -> impl Iterator<Item = usize> + '_ {
        self.seen_at.get(&address).into_iter().flatten().copied()
    }

    /// Returns true if a device transmitted at another bit rate than that of the bus, now or less than
    /// `before` ago: others may be bus-off by that, as the bit rate search of CiA 801 has it.
    pub fn has_other_bitrate(&self, at: Instant, before: Duration) -> bool {
        self.other_bitrate.iter().any(|span| span.from <= at && at <= span.until + before)
    }

    /// Returns when both devices of a pair that never gives way were on.
    pub fn both_on(&self) -> impl Iterator<Item = (Clash, Span)> + '_ {
        self.both_on.iter().map(|(clash, span)| (*clash, *span))
    }

    /// Returns when devices with one UID and different fixed addresses were on.
    pub fn same_uid_on(&self) -> impl Iterator<Item = (Clash, Span)> + '_ {
        let all = self.same_uid_on.iter();
        all.flat_map(|(clash, spans)| spans.iter().map(|span| (*clash, *span)))
    }

    /// Returns the conflicts, with pauses shorter than three periods bridged.
    pub fn contended(&self) -> Vec<(Clash, Span)> {
        let mut joined: Vec<(Clash, Span)> = Vec::new();
        for (clash, span) in self.clashes() {
            match joined.last_mut() {
                Some((other, before))
                    if *other == clash && span.from.since(before.until) < PAUSE =>
                {
                    before.until = span.until;
                }
                _ => joined.push((clash, span)),
            }
        }
        joined
    }

    /// Returns when the conflict ended for good.
    pub fn over(&self, clash: Clash) -> Instant {
        let last = self.spans.get(&clash).and_then(|spans| spans.last()).map(|span| span.until);
        let both_on = self.both_on.get(&clash).map(|span| span.until);
        last.max(both_on).unwrap_or(Instant::ZERO)
    }

    /// Returns all conflicts with their time spans.
    pub fn clashes(&self) -> impl Iterator<Item = (Clash, Span)> + '_ {
        self.spans.iter().flat_map(|(clash, spans)| spans.iter().map(|span| (*clash, *span)))
    }
}

/// Returns each two of `all`, in their order.
fn pairs<T: Copy>(all: &[T]) -> impl Iterator<Item = (T, T)> + '_ {
    let first = all.iter().enumerate();
    first.flat_map(|(place, &one)| all[place + 1..].iter().map(move |&other| (one, other)))
}

/// Notes a conflict in the sample of `now`; the sample before was that of `sampled`.
fn note(
    all: &mut BTreeMap<Clash, Vec<Span>>,
    sampled: Option<Instant>,
    now: Instant,
    clash: Clash,
) {
    add_sample(all.entry(clash).or_default(), sampled, now);
}

/// Adds a sample to the last span if the sample before was in it, too.
fn add_sample(spans: &mut Vec<Span>, sampled: Option<Instant>, now: Instant) {
    match spans.last_mut() {
        Some(span) if Some(span.until) == sampled => span.until = now,
        _ => spans.push(Span { from: now, until: now }),
    }
}

impl Clash {
    pub fn concerns(self, address: Address) -> bool {
        match self {
            Clash::Address(at, ..) => at == address,
            Clash::Uid(one, other) => one == address || other == address,
        }
    }
}
