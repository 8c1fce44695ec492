//! Tests of frames, fast enough for millions of them.
//!
//! Input: a filter and the buses as they are known. Names, services and types are looked up once, into
//! sets of addresses, of services and of roles. Output: which frames match. Does not know where frames
//! are stored, nor how they are shown.

use super::Filter;
use super::expression::Expression;
use super::field::Field;
use super::test::{Addresses, Test, TextValue, any_of};
use super::value::{BytePattern, IdPattern, NumberRange, TimeBound};
use crate::app::buses::{Bus, BusTypes, Buses, FrameTypes};
use crate::app::capture::decoded::{self, FrameRole};
use crate::app::capture::frame_store::FrameStore;
use crate::app::capture::transfer;
use crate::discovery::OwnAddress;
use crate::frame::{BusIndex, CanId, Frame, FrameKind};
use crate::time::Instant;
use crate::wire::id::{Address, Header, MessageType, Service};
use crate::wire::node::{Heartbeat, Mode, Uid};
use crate::wire::profile::Profile;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Number of service numbers.
const SERVICES: usize = 1024;
/// Random bits of a broadcast's identifier (RND7).
const RANDOM: u32 = 0x7F << 10;

/// What a prepared filter depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct KnownBuses {
    buses: usize,
    /// Number of buses that speak another protocol.
    foreign: usize,
    /// Changes with every name.
    names: u64,
    /// Changes with the types of devices.
    types: u64,
    /// Changes with descan's own addresses.
    own: u64,
}

impl KnownBuses {
    fn of(buses: &Buses) -> Self {
        let own = |bus: &Bus| match bus.own_address() {
            OwnAddress::Held(address) => u64::from(address.number()) + 1,
            _ => 0,
        };
        let indices = (0..buses.len()).map(|index| BusIndex(index as u8));
        Self {
            buses: buses.len(),
            foreign: indices.filter(|index| buses.is_foreign(*index)).count(),
            names: buses.names_revision(),
            types: buses.types_revision(),
            own: buses.iter().fold(0, |sum: u64, bus| sum.wrapping_mul(131) + own(bus)),
        }
    }
}

/// A filter that is ready for many frames of the same buses.
#[derive(Debug)]
pub struct FrameMatcher {
    known: KnownBuses,
    expression: Expression<FrameTest>,
    buses: Vec<BusFacts>,
}

/// What the tests need to know about a bus.
#[derive(Debug)]
struct BusFacts {
    profile: Arc<Profile>,
    is_foreign: bool,
    types: BusTypes,
}

/// A test with everything looked up. Lists of sets are by bus.
#[derive(Debug)]
enum FrameTest {
    Never,
    Word(Box<WordTest>),
    Source(Vec<NamedAddresses>),
    /// True: broadcasts, too.
    Destination(Vec<NamedAddresses>, bool),
    Either(Vec<NamedAddresses>),
    EitherIn(Addresses),
    Service(Vec<Services>),
    Role(Roles),
    Bus(Vec<bool>),
    Id(Vec<IdPattern>),
    Length(Vec<NumberRange>),
    Interval(Vec<NumberRange>),
    Data(Vec<BytePattern>),
    Text(Vec<TextValue>),
    /// A bit for each of [`Mode::ALL`].
    Mode(u8),
    Uid(Vec<TextValue>),
    Since(TimeBound),
    Until(TimeBound),
    Error,
    Failed,
    ByDescan,
    Any(Vec<Self>),
}

/// A word without a field: in a name, a service, a role or the meaning.
#[derive(Debug)]
struct WordTest {
    ends: Vec<NamedAddresses>,
    services: Vec<Services>,
    roles: Roles,
    /// The word as a whole identifier; `None` for one that is none, or is an address.
    id: Option<IdPattern>,
    text: TextValue,
}

/// Addresses by the name of their device, which may change.
#[derive(Debug, Default)]
struct NamedAddresses {
    always: Addresses,
    /// Addresses whose devices changed, with the times from which on they are in the set or not.
    changing: Vec<(Address, Vec<(Instant, bool)>)>,
    has_changing: Addresses,
}

impl NamedAddresses {
    fn contains(&self, address: Address, time: Instant) -> bool {
        if !self.has_changing.contains(address) {
            return self.always.contains(address);
        }
        let times = self.changing.iter().find(|(own, _)| *own == address).map(|(_, times)| times);
        let Some(times) = times else { return false };
        let later = times.partition_point(|(since, _)| *since <= time);
        times.get(later.saturating_sub(1)).is_some_and(|(_, is_in)| *is_in)
    }
}

/// A set of services.
#[derive(Debug)]
struct Services {
    /// A bit for each number that is in the set on all devices.
    numbers: [u64; SERVICES / 64],
    /// Names in the set, of numbers that have a name on some types of devices.
    by_type: BTreeMap<u16, TypedService>,
}

/// A service number that has a name on some types of devices.
#[derive(Debug)]
struct TypedService {
    /// The names that are in the set.
    names: BTreeSet<String>,
    /// All types have one name: that of a request to all, too.
    is_unanimous: bool,
}

impl Services {
    fn contains(&self, service: Service) -> bool {
        let number = usize::from(service.number());
        self.numbers.get(number / 64).is_some_and(|word| word >> (number % 64) & 1 != 0)
    }
}

/// A set of roles and message types.
#[derive(Clone, Copy, Debug, Default)]
struct Roles {
    roles: u16,
    types: u16,
}

impl Roles {
    fn contains(self, role: FrameRole, kind: Option<MessageType>) -> bool {
        let is_type = kind.is_some_and(|kind| self.types >> kind as u16 & 1 != 0);
        self.roles >> role as u16 & 1 != 0 || is_type
    }
}

impl Filter {
    /// Prepares the filter for the frames of buses as they are known now: names are those of a
    /// frame's moment.
    pub fn for_frames(&self, buses: &Buses) -> FrameMatcher {
        let facts = buses.iter().enumerate().map(|(index, bus)| BusFacts {
            profile: bus.config().profile.clone(),
            is_foreign: buses.is_foreign(BusIndex(index as u8)),
            types: BusTypes::of(buses, BusIndex(index as u8)),
        });
        let lookup = Lookup { buses };
        FrameMatcher {
            known: KnownBuses::of(buses),
            expression: self.expression.map(|test| lookup.prepare(test)),
            buses: facts.collect(),
        }
    }

    /// Returns true if frames match or not by frames before them: by intervals, or by the bytes of transfers.
    pub fn looks_back(&self) -> bool {
        let mut looks = false;
        self.expression.for_each(&mut |test| {
            looks |= matches!(test, Test::Interval(_) | Test::Data(_));
        });
        looks
    }

    /// Returns true if frames match or not by the names of devices.
    pub(in crate::app) fn needs_names(&self) -> bool {
        let mut needs = false;
        self.expression.for_each(&mut |test| {
            needs |= match test {
                Test::Word(_) => true,
                // The type of a device may be known by its name.
                Test::Text(field, _) => matches!(
                    field,
                    Field::Name
                        | Field::Source
                        | Field::Destination
                        | Field::Device
                        | Field::Service
                        | Field::Text
                ),
                _ => false,
            };
        });
        needs
    }
}

/// Looks up what tests need.
struct Lookup<'a> {
    buses: &'a Buses,
}

impl Lookup<'_> {
    fn prepare(&self, test: &Test) -> FrameTest {
        match test {
            Test::Word(word) => FrameTest::Word(Box::new(WordTest {
                ends: self.named(|name, address| word.is_in(name) || word.is_address(address)),
                services: self.services(|name, _| word.is_in(name)),
                roles: roles(|role, kind| word.is_role(role, kind)),
                id: Some(&word.text)
                    .filter(|text| !Address::all().any(|it| it.to_string() == **text))
                    .and_then(|text| IdPattern::parse(&format!("={text}"))),
                text: word.clone(),
            })),
            Test::Text(field, values) => self.prepare_texts(*field, values),
            Test::Address(set) => FrameTest::EitherIn(*set),
            Test::Id(patterns) => FrameTest::Id(patterns.clone()),
            Test::Length(ranges) => FrameTest::Length(ranges.clone()),
            Test::Interval(ranges) => FrameTest::Interval(ranges.clone()),
            Test::Data(patterns) => FrameTest::Data(patterns.clone()),
            Test::Since(bound) => FrameTest::Since(*bound),
            Test::Until(bound) => FrameTest::Until(*bound),
            Test::Error => FrameTest::Error,
            Test::ByDescan => FrameTest::ByDescan,
        }
    }

    fn prepare_texts(&self, field: Field, values: &[TextValue]) -> FrameTest {
        let end = || {
            self.named(|name, address| {
                any_of(values, |value| value.is_in(name) || value.is_address(address))
            })
        };
        match field {
            Field::Source => FrameTest::Source(end()),
            Field::Destination => {
                let is_all = any_of(values, |value| matches!(&*value.text, "all" | "*"));
                FrameTest::Destination(end(), is_all)
            }
            Field::Device => FrameTest::Either(end()),
            Field::Name => {
                FrameTest::Either(self.named(|name, _| any_of(values, |value| value.is_in(name))))
            }
            Field::Service => FrameTest::Service(self.services(|name, number| {
                any_of(values, |value| match value.number {
                    Some(range) => range.contains(u64::from(number)),
                    None => value.is_in(name),
                })
            })),
            Field::Type => FrameTest::Role(roles(|role, kind| {
                any_of(values, |value| value.is_role(role, kind))
            })),
            Field::Mode => {
                let bits = Mode::ALL.iter().enumerate().map(|(at, mode)| {
                    u8::from(any_of(values, |value| value.begins(mode.name()))) << at
                });
                FrameTest::Mode(bits.sum())
            }
            Field::Bus => {
                let is_it = |name: &str| any_of(values, |value| value.is_in(name));
                FrameTest::Bus(self.buses.iter().map(|bus| is_it(&bus.name)).collect())
            }
            Field::State => FrameTest::Any(values.iter().map(state).collect()),
            Field::Text => FrameTest::Text(values.to_vec()),
            Field::Uid => FrameTest::Uid(values.to_vec()),
            Field::Address
            | Field::Id
            | Field::Length
            | Field::Data
            | Field::Interval
            | Field::Since
            | Field::Until => FrameTest::Never,
        }
    }

    /// Addresses whose name and number `fits` accepts.
    fn named(&self, fits: impl Fn(&str, Address) -> bool) -> Vec<NamedAddresses> {
        let of_bus = |(index, bus): (usize, &Bus)| {
            let mut set = NamedAddresses::default();
            for address in Address::all() {
                // A number is not a part of a name.
                let is_own = self.buses.is_own_address(BusIndex(index as u8), address);
                let unnamed = || if is_own { "own" } else { "" };
                let holders = bus.names().holders(address).iter();
                let mut times: Vec<(Instant, bool)> = holders
                    .map(|holder| match &holder.name {
                        Some(name) => (holder.since, fits(&name.to_string(), address)),
                        None => (holder.since, fits(unnamed(), address)),
                    })
                    .collect();
                times.dedup_by_key(|(_, is_in)| *is_in);
                match &times[..] {
                    [] if fits(unnamed(), address) => set.always.insert(address),
                    [(_, true)] => set.always.insert(address),
                    [] | [_] => {}
                    _ => {
                        set.has_changing.insert(address);
                        set.changing.push((address, times));
                    }
                }
            }
            set
        };
        self.buses.iter().enumerate().map(of_bus).collect()
    }

    /// Services whose name and number `fits` accepts.
    fn services(&self, fits: impl Fn(&str, u16) -> bool) -> Vec<Services> {
        let of_bus = |index: usize| {
            let index = BusIndex(index as u8);
            let profile = self.buses.profile(index);
            let mut set = Services { numbers: [0; SERVICES / 64], by_type: BTreeMap::new() };
            for number in 0..SERVICES as u16 {
                let name = profile.service_name(Service::from_bits(number)).unwrap_or_default();
                if fits(name, number) {
                    set.numbers[usize::from(number) / 64] |= 1 << (number % 64);
                }
            }
            for (number, mut names) in self.buses.service_names_of_types(index) {
                let is_unanimous = names.len() == 1;
                names.retain(|name| fits(name, number));
                if !names.is_empty() {
                    set.by_type.insert(number, TypedService { names, is_unanimous });
                }
            }
            set
        };
        (0..self.buses.len()).map(of_bus).collect()
    }
}

fn roles(is_it: impl Fn(FrameRole, Option<MessageType>) -> bool) -> Roles {
    let mut set = Roles::default();
    for role in FrameRole::ALL {
        set.roles |= u16::from(is_it(role, None)) << role as u16;
    }
    // Of the types, those that no role is enough for.
    for kind in MessageType::ALL {
        let is_type = is_it(FrameRole::Standard, Some(kind)) && !is_it(FrameRole::Standard, None);
        set.types |= u16::from(is_type) << kind as u16;
    }
    set
}

fn state(value: &TextValue) -> FrameTest {
    if value.begins("error") {
        FrameTest::Error
    } else if value.begins("failed") {
        FrameTest::Failed
    } else {
        FrameTest::ByDescan
    }
}

/// A frame and where it is stored.
struct TestedFrame<'a> {
    frame: &'a Frame,
    header: Option<Header>,
    role: FrameRole,
    profile: Option<&'a Profile>,
    types: Option<&'a BusTypes>,
    stored: Option<(&'a FrameStore, u64)>,
}

impl FrameMatcher {
    /// Returns true if the buses are known as they were when the filter was prepared.
    pub fn is_current(&self, buses: &Buses) -> bool {
        self.known == KnownBuses::of(buses)
    }

    /// Returns the source of a DEBUG message; `None` for other frames.
    pub fn debug_source(&self, frame: &Frame) -> Option<Address> {
        let id = frame.platform_id()?;
        let facts = self.buses.get(usize::from(frame.bus.0));
        let role = FrameRole::of(frame, facts.is_some_and(|facts| facts.is_foreign));
        (role == FrameRole::Debug).then(|| Header::decode(id).source)
    }

    /// Returns true if a frame matches; `stored` is where it is, if it is. Without it, an interval
    /// matches no frame, and the data of a transfer is that of the frame.
    pub fn is_match(&self, frame: &Frame, stored: Option<(&FrameStore, u64)>) -> bool {
        if self.expression.is_empty() {
            return true;
        }
        let facts = self.buses.get(usize::from(frame.bus.0));
        let role = FrameRole::of(frame, facts.is_some_and(|facts| facts.is_foreign));
        let header = match (frame.kind, frame.id) {
            (FrameKind::Data, CanId::Extended(id)) if role != FrameRole::Foreign => {
                Some(Header::decode(id))
            }
            _ => None,
        };
        let profile = facts.map(|facts| &*facts.profile);
        let types = facts.map(|facts| &facts.types);
        let tested = TestedFrame { frame, header, role, profile, types, stored };
        self.expression.is_match(&mut |test| tested.passes(test))
    }
}

impl TestedFrame<'_> {
    fn passes(&self, test: &FrameTest) -> bool {
        let (frame, bus) = (self.frame, usize::from(self.frame.bus.0));
        match test {
            FrameTest::Never => false,
            FrameTest::Word(word) => self.has_word(word),
            FrameTest::Source(sets) => self.is_source_in(sets.get(bus)),
            FrameTest::Destination(sets, is_all) => {
                let is_broadcast = self.header.is_some_and(|header| header.broadcast);
                if is_broadcast { *is_all } else { self.is_destination_in(sets.get(bus)) }
            }
            FrameTest::Either(sets) => {
                self.is_source_in(sets.get(bus)) || self.is_destination_in(sets.get(bus))
            }
            FrameTest::EitherIn(set) => self.header.is_some_and(|header| {
                set.contains(header.source)
                    || (!header.broadcast && set.contains(header.destination))
            }),
            FrameTest::Service(sets) => self.is_service_in(sets.get(bus)),
            FrameTest::Role(set) => set.contains(self.role, self.header.map(Header::message_type)),
            FrameTest::Bus(buses) => buses.get(bus).copied().unwrap_or(false),
            FrameTest::Id(patterns) => patterns.iter().any(|pattern| self.has_id(pattern)),
            FrameTest::Length(ranges) => {
                ranges.iter().any(|range| range.contains(frame.len() as u64))
            }
            FrameTest::Interval(ranges) => self
                .interval_micros()
                .is_some_and(|micros| ranges.iter().any(|range| range.contains(micros))),
            FrameTest::Data(patterns) => self.has_data(patterns),
            FrameTest::Text(values) => {
                let meaning = self.meaning();
                !meaning.is_empty() && any_of(values, |value| value.is_in(&meaning))
            }
            FrameTest::Mode(modes) => self
                .heartbeat()
                .and_then(|beat| beat.mode)
                .is_some_and(|mode| modes >> mode as u8 & 1 != 0),
            FrameTest::Uid(values) => {
                let uid = self.heartbeat().and_then(|beat| beat.uid);
                uid.is_some_and(|uid| self.is_uid(uid, values))
            }
            FrameTest::Since(bound) => bound.is_since(frame.time),
            FrameTest::Until(bound) => bound.is_until(frame.time),
            FrameTest::Error => self.is_error(),
            FrameTest::Failed => self.role == FrameRole::FailedResponse,
            FrameTest::ByDescan => frame.is_tx,
            FrameTest::Any(tests) => tests.iter().any(|test| self.passes(test)),
        }
    }

    fn is_source_in(&self, set: Option<&NamedAddresses>) -> bool {
        let (Some(header), Some(set)) = (self.header, set) else { return false };
        set.contains(header.source, self.frame.time)
    }

    fn is_destination_in(&self, set: Option<&NamedAddresses>) -> bool {
        let (Some(header), Some(set)) = (self.header, set) else { return false };
        !header.broadcast && set.contains(header.destination, self.frame.time)
    }

    fn is_service_in(&self, set: Option<&Services>) -> bool {
        let (Some(header), Some(set)) = (self.header, set) else { return false };
        if self.role == FrameRole::Debug {
            return false;
        }
        set.contains(header.service)
            || set.by_type.get(&header.service.number()).is_some_and(|typed| {
                let to_all = !header.response && header.broadcast && typed.is_unanimous;
                let own = self.frame_types().service(header.service);
                own.map_or(to_all, |service| typed.names.contains(&service.name))
            })
    }

    fn has_word(&self, word: &WordTest) -> bool {
        let bus = usize::from(self.frame.bus.0);
        self.is_source_in(word.ends.get(bus))
            || self.is_destination_in(word.ends.get(bus))
            || self.is_service_in(word.services.get(bus))
            || word.roles.contains(self.role, self.header.map(Header::message_type))
            || word.id.as_ref().is_some_and(|id| self.has_id(id))
            || {
                let meaning = self.meaning();
                !meaning.is_empty() && word.text.is_in(&meaning)
            }
    }

    /// Returns true if an identifier matches, as it is or without the random bits of a broadcast.
    fn has_id(&self, pattern: &IdPattern) -> bool {
        match self.frame.id {
            _ if self.frame.kind == FrameKind::Error => false,
            CanId::Standard(id) => pattern.is_match(u32::from(id), 3),
            CanId::Extended(id) => {
                let is_random = || self.header.is_some_and(|header| header.broadcast);
                pattern.is_match(id, 8)
                    || pattern.is_match(id & !RANDOM, 8) && is_random() && !self.has_message()
            }
        }
    }

    fn interval_micros(&self) -> Option<u64> {
        let (store, number) = self.stored.filter(|_| self.frame.kind != FrameKind::Error)?;
        let has_fixed_bits = self.role == FrameRole::Foreign || self.has_message();
        let before = if has_fixed_bits {
            store.previous_with_all_bits(number)
        } else {
            store.previous(number)
        };
        let before = store.time_of(before?)?;
        u64::try_from(self.frame.time.since(before).as_micros()).ok()
    }

    fn has_data(&self, patterns: &[BytePattern]) -> bool {
        if patterns.iter().any(|pattern| pattern.is_in(self.frame.data(), 0)) {
            return true;
        }
        let Some(((store, number), profile)) = self.stored.zip(self.profile) else { return false };
        // The bytes of a transfer until those of this frame, where they end with them.
        let is_it = |header: Header| header.service == profile.des_service();
        let message = self
            .header
            .filter(|header| is_it(*header))
            .and_then(|_| transfer::message_until(store, number, self.frame));
        message.is_some_and(|(message, own)| {
            patterns.iter().any(|pattern| pattern.is_in(&message, own))
        })
    }

    fn heartbeat(&self) -> Option<Heartbeat> {
        let (header, profile) = self.header.zip(self.profile)?;
        let is_heartbeat = header.response && header.service == profile.heartbeat_service();
        is_heartbeat.then(|| profile.heartbeat_of(self.frame.data()))
    }

    fn is_uid(&self, uid: Uid, values: &[TextValue]) -> bool {
        let Some(profile) = self.profile else { return false };
        let text = decoded::uid_text(profile, uid);
        any_of(values, |value| value.is_in(&text))
    }

    fn is_error(&self) -> bool {
        match self.role {
            FrameRole::Error | FrameRole::FailedResponse | FrameRole::NonConforming => true,
            _ => {
                self.header.is_some_and(|header| !header.is_conforming())
                    || self.described().is_some_and(|(_, is_malformed)| is_malformed)
            }
        }
    }

    /// The meaning of a platform frame, and true if it is malformed.
    fn described(&self) -> Option<(String, bool)> {
        let (header, profile) = self.header.zip(self.profile)?;
        Some(decoded::describe_data(profile, self.frame_types(), header, self.frame))
    }

    /// The meaning of the frame, as the screen shows it.
    fn meaning(&self) -> String {
        decoded::meaning_of(self.frame, self.role, self.profile, self.frame_types())
    }

    /// Returns true if a DBC file has its message.
    fn has_message(&self) -> bool {
        self.frame_types().message().is_some()
    }

    /// What the catalogue says about the frame.
    fn frame_types(&self) -> FrameTypes<'_> {
        let types = self.types.map(|types| types.of_frame(self.header, self.frame));
        types.unwrap_or_default()
    }
}
