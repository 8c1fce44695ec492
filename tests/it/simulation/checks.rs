//! Checks of an inspector's events against the simulator's ground truth.

use super::ground_truth::{Clash, Span};
use crate::common::inspection::{FAULTS, describe};

use super::random_scenario::ForeignNodes;
use super::{Inspector, Run};
use descan::discovery::{EventKind, OwnAddress, Presence};
use descan::finding::{FindingKind, FindingState};
use descan::sim::{DeviceAction, DeviceSpec, Fault};
use descan::text::Name;
use descan::time::{Duration, Instant};
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::{Address, Header};
use descan::wire::node::{Mode, Uid};
use std::collections::{BTreeMap, BTreeSet};

const PERIOD: Duration = Duration::from_secs(1);
/// Time limit for confirming a detectable conflict, and for clearing one that has ended.
const TEN_SECONDS: Duration = Duration::from_secs(10);
/// Tolerance of the time at which a state began.
const SAMPLED: Duration = Duration::from_millis(100);

/// The state of one finding over time.
struct Course {
    kind: FindingKind,
    addresses: Vec<Address>,
    names: Vec<Name>,
    changes: Vec<(Instant, FindingState)>,
}

impl Course {
    fn at(&self, time: Instant) -> Option<FindingState> {
        self.changes.iter().take_while(|(at, _)| *at <= time).last().map(|(_, it)| *it)
    }

    /// Returns the time of the last change from no finding to suspected.
    fn opened_last(&self) -> Instant {
        let mut opened = Instant::ZERO;
        let mut open = false;
        for &(at, state) in &self.changes {
            let opens = state != FindingState::Cleared;
            if opens && !open {
                opened = at;
            }
            open = opens;
        }
        opened
    }

    fn concerns(&self, address: Address) -> bool {
        self.addresses.contains(&address)
    }
}

fn courses(it: &Inspector) -> Vec<Course> {
    let mut courses = BTreeMap::new();
    for (at, event) in &it.events {
        let EventKind::Finding { key, state } = &event.kind else { continue };
        let found = it.engine.findings().iter().find(|finding| finding.key == *key);
        let course = courses.entry(key.clone()).or_insert_with(|| Course {
            kind: key.kind,
            addresses: found.map_or_else(Vec::new, |finding| finding.addresses.clone()),
            names: found.map_or_else(Vec::new, |finding| finding.names.clone()),
            changes: Vec::new(),
        });
        course.changes.push((*at, *state));
    }
    courses.into_values().collect()
}

pub fn judge(run: &Run) -> Vec<String> {
    let mut wrong = Vec::new();
    for number in 0..run.inspectors.len() {
        let mut case = Case {
            run,
            it: &run.inspectors[number],
            number,
            courses: courses(&run.inspectors[number]),
            wrong: &mut wrong,
        };
        case.accusations();
        case.detections();
        case.clearings();
        case.contests();
        case.inventory();
        case.quiet();
    }
    addresses_of_inspectors(run, &mut wrong);
    wrong
}

struct Case<'a> {
    run: &'a Run,
    it: &'a Inspector,
    number: usize,
    courses: Vec<Course>,
    wrong: &'a mut Vec<String>,
}

impl Case<'_> {
    fn complain(&mut self, wrong: Vec<String>) {
        let number = self.number;
        self.wrong.extend(wrong.into_iter().map(|what| format!("inspector {number}: {what}")));
    }

    fn clashes(&self) -> Vec<(Clash, Span)> {
        self.run.truth.clashes().collect()
    }

    fn spec(&self, device: usize) -> &DeviceSpec {
        &self.run.world.scenario.devices[device]
    }

    fn is_clear(&self) -> bool {
        self.run.world.is_clear(self.number) && self.it.cut_off.is_empty()
    }

    // --- no false positives --------------------------------------------------------------

    fn accusations(&mut self) {
        let clashes = self.clashes();
        let mut wrong = Vec::new();
        for course in &self.courses {
            let confirmed = course.changes.iter().filter(|(_, it)| *it == FindingState::Confirmed);
            for &(at, _) in confirmed {
                if !self.is_justified(course, at, &clashes) {
                    wrong.push(format!(
                        "{at} {} at {:?} is confirmed",
                        course.kind, course.addresses
                    ));
                }
            }
        }
        self.complain(wrong);
    }

    fn is_justified(&self, course: &Course, at: Instant, clashes: &[(Clash, Span)]) -> bool {
        let inspector = &self.run.world.inspectors[self.number];
        let going_on = |clash: &Clash, span: &Span| {
            let until = span.until.min(at);
            // The inspector's clock ran ahead meanwhile.
            let ahead = inspector.lens.ahead(until).saturating_sub(inspector.lens.ahead(span.from));
            course.addresses.iter().any(|&address| clash.concerns(address))
                && span.from <= at
                && at.since(span.until) < TEN_SECONDS
                && (matches!(clash, Clash::Uid(..))
                    || until.since(span.from) + ahead + SAMPLED >= PERIOD.mul_f64(3.0))
        };
        let config = &inspector.config;
        let names = |one: usize, other: usize| {
            let name = |at: usize| self.run.sim.device_state(self.run.devices[at]).name;
            name(one) != name(other)
        };
        let uid = |at: usize| self.run.sim.device_state(self.run.devices[at]).uid;
        // Two devices that never give way are in conflict even during silent phases, because they
        // destroy each other's frames.
        let both_on: Vec<_> = self.run.truth.both_on().collect();
        let any = |fits: &dyn Fn(&Clash) -> bool| {
            let mut clashes = clashes.iter().chain(&both_on);
            clashes.any(|(clash, span)| going_on(clash, span) && fits(clash))
        };
        // Of three and more devices, different ones are in conflict in turns, and two may differ that
        // are together for a moment only: the conflict is certain, and what differs was received.
        let crowd = self.crowd_at(course);
        let crowded = |fits: &dyn Fn(&Clash) -> bool| {
            let recent = crowd.iter().filter(|(_, span)| {
                span.from <= at + SAMPLED && at.since(span.until) < TEN_SECONDS
            });
            let began = crowd.iter().filter(|(_, span)| span.from <= at).rev();
            let began = began.fold(at, |began, (_, span)| {
                // Evidence of one conflict counts for the next one as long as it is remembered.
                if began.since(span.until) < PERIOD * 5 { began.min(span.from) } else { began }
            });
            at.since(began) >= PERIOD.mul_f64(4.0) && recent.clone().any(|(clash, _)| fits(clash))
        };
        match course.kind {
            FindingKind::OneAddressTwoNames => {
                let fits = |it: &Clash| matches!(*it, Clash::Address(_, a, b) if names(a, b));
                any(&fits) || crowded(&fits)
            }
            FindingKind::AnswersDoubled
                if self.responds_twice(course)
                    || self.is_only_copied_response(course)
                    || self.is_shared_after_losses(course, at) =>
            {
                true
            }
            FindingKind::SameNameSameAddress | FindingKind::AnswersDoubled => {
                // A listen-only inspector may not receive the names, another not yet both, and
                // the heartbeats of equal UIDs tell no names.
                any(&|it| {
                    matches!(*it, Clash::Address(_, a, b)
                        if config.listen_only
                            || course.names.len() < 2
                            || uid(a) == uid(b)
                            || self.spec(a).faults.has(Fault::NoDes)
                            || is_unreadable(self.spec(a))
                            || is_unreadable(self.spec(b))
                            || !names(a, b))
                }) || crowded(&|_| true)
                    // Its two responses are sent at once, so their frames interleave.
                    || self.responds_twice(course)
            }
            FindingKind::OneAddressTwoIdentities => {
                // Two devices with one UID that keep resolving their address differ in the U bit
                // meanwhile.
                let stubborn = |it: usize| self.spec(it).faults.has(Fault::KeepsAddress);
                let fits = |it: &Clash| {
                    matches!(*it, Clash::Address(_, a, b)
                        if uid(a) != uid(b) || stubborn(a) && stubborn(b))
                };
                // Two devices that claim an address in turns, each after the other gave way, differ
                // too.
                let again = self.run.truth.contended();
                let joined = again.iter().any(|(clash, span)| going_on(clash, span) && fits(clash));
                any(&fits) || crowded(&fits) || joined
            }
            FindingKind::OneUidTwoAddresses => {
                let are_on = |(clash, span): (Clash, Span)| {
                    going_on(&clash, &span)
                        && course.addresses.iter().all(|&address| clash.concerns(address))
                        && at.since(span.from) >= PERIOD * 5
                };
                any(&|it| matches!(it, Clash::Uid(..))) || self.run.truth.same_uid_on().any(are_on)
            }
            FindingKind::NonConforming => {
                self.run.world.foreign.as_ref().is_some_and(ForeignNodes::is_extended)
            }
            FindingKind::TwoDebugDevices
            | FindingKind::AddressContested
            | FindingKind::FramesRepeated => false,
            // All other confirmed findings are observed directly, not inferred.
            // Frames that are lost at the same place again and again look like that.
            FindingKind::MalformedAnswer if self.run.world.is_very_lossy() => true,
            FindingKind::MalformedAnswer => {
                let faulty = |spec: &DeviceSpec| {
                    [Fault::DropFrame, Fault::WrongSequence, Fault::HugeLength]
                        .iter()
                        .any(|fault| spec.faults.has(*fault))
                };
                any(&|_| true)
                    || self.run.world.scenario.devices.iter().zip(&self.run.devices).any(
                        |(it, id)| {
                            let now = self.run.sim.device_state(*id).address;
                            faulty(it)
                                && (course
                                    .addresses
                                    .iter()
                                    .any(|&address| is_fixed(it, address) || now == Some(address))
                                    || course.names.iter().any(|name| name.as_bytes() == it.name))
                        },
                    )
            }
            _ => true,
        }
    }

    /// Returns true if a device at the address responds twice to each request.
    fn responds_twice(&self, course: &Course) -> bool {
        let devices = self.run.world.scenario.devices.iter().zip(&self.run.devices);
        let timetable = &self.run.world.scenario.timetable;
        let has_action = |spec: &DeviceSpec, action: &DeviceAction| {
            timetable.iter().any(|it| it.device == spec.label && it.action == *action)
        };
        // For a moment is not enough.
        let mut faulty = devices.filter(|(spec, _)| {
            has_action(spec, &DeviceAction::AddFault(Fault::RespondsTwice))
                && !has_action(spec, &DeviceAction::RemoveFault(Fault::RespondsTwice))
        });
        faulty.any(|(_, id)| {
            self.run.sim.device_state(*id).address.is_some_and(|address| course.concerns(address))
        })
    }

    /// Returns true if two devices share the address now, and responses there may have looked doubled
    /// before to a listener that lost requests.
    fn is_shared_after_losses(&self, course: &Course, at: Instant) -> bool {
        let is_lossy = self.run.world.scenario.rx_loss > 0.0;
        let is_now = |(clash, span): (Clash, Span)| {
            matches!(clash, Clash::Address(address, ..) if course.concerns(address))
                && span.from <= at
                && at <= span.until + SAMPLED
        };
        let inspector = &self.run.world.inspectors[self.number];
        is_lossy && inspector.config.listen_only && self.run.truth.clashes().any(is_now)
    }

    /// Returns true if a gateway repeats a device without heartbeats, whose copies would show it, or
    /// many of these are lost.
    fn is_only_copied_response(&self, course: &Course) -> bool {
        let gateway = self.run.world.inspectors[self.number].lens.gateway;
        gateway.is_some_and(|gateway| {
            let mut devices = self.run.world.scenario.devices.iter();
            course.concerns(gateway.address)
                && (self.run.world.is_very_lossy()
                    || devices.any(|spec| {
                        is_fixed(spec, gateway.address) && spec.faults.has(Fault::NoHeartbeat)
                    }))
        })
    }

    /// Returns the conflicts at an address that three and more devices share, by their end; empty
    /// for two.
    fn crowd_at(&self, course: &Course) -> Vec<(Clash, Span)> {
        let here = |clash: &Clash| {
            let concerned = course.addresses.iter().any(|&address| clash.concerns(address));
            matches!(clash, Clash::Address(..)) && concerned
        };
        let all = self.run.truth.clashes().chain(self.run.truth.both_on());
        let mut crowd: Vec<(Clash, Span)> = all.filter(|(clash, _)| here(clash)).collect();
        let both = crowd.iter().flat_map(|(clash, _)| match *clash {
            Clash::Address(_, one, other) => [one, other],
            Clash::Uid(..) => unreachable!(),
        });
        if both.collect::<BTreeSet<usize>>().len() < 3 {
            return Vec::new();
        }
        crowd.sort_by_key(|(_, span)| span.until);
        crowd
    }

    // --- no false negatives --------------------------------------------------------------

    fn detections(&mut self) {
        let mut wrong = Vec::new();
        for (clash, span) in self.clashes() {
            let mut from = span.from.max(self.begin());
            if let Some((at, until)) = self.run.world.broken
                && (from..from + TEN_SECONDS).contains(&(Instant::ZERO + at))
            {
                from = Instant::ZERO + until;
            }
            if span.until.since(from) < TEN_SECONDS || !self.can_see(clash, from, span.until) {
                continue;
            }
            // A device without heartbeats is received only when it responds, once per round.
            let due = from + if self.beats(clash) { TEN_SECONDS } else { PERIOD * 25 };
            // With lost or delayed frames, the evidence pauses and starts again.
            let lossy = self.run.world.scenario.rx_loss > 0.0;
            // So does that of three and more devices that destroy each other's frames.
            let crowd = match clash {
                Clash::Address(at, ..) => {
                    self.courses.iter().any(|it| it.concerns(at) && !self.crowd_at(it).is_empty())
                }
                Clash::Uid(..) => false,
            };
            // Requests to nodes of another protocol, whose identifiers look like those of devices,
            // take the turns of others.
            let has_others = self.run.world.foreign.as_ref().is_some_and(ForeignNodes::is_extended);
            // Late heartbeats hide the phases, and nothing else differs.
            let is_late = match clash {
                Clash::Address(_, one, other) => {
                    let (one, other) = (self.spec(one), self.spec(other));
                    one.name == other.name
                        && (one.uid == other.uid || one.uid.is_blank() || other.uid.is_blank())
                        && one.max_heartbeat_delay.max(other.max_heartbeat_delay) > PERIOD / 5
                }
                Clash::Uid(..) => false,
            };
            let slow = lossy || crowd || has_others || is_late || self.run.world.is_crowded();
            let due = due + PERIOD * if slow { 5 } else { 0 };
            if span.until < due {
                continue;
            }
            let fitting = |course: &&Course| match clash {
                Clash::Address(at, ..) => {
                    course.concerns(at)
                        && course.kind.is_conflict()
                        && course.kind != FindingKind::OneUidTwoAddresses
                }
                Clash::Uid(one, other) => {
                    course.kind == FindingKind::OneUidTwoAddresses
                        && course.concerns(one)
                        && course.concerns(other)
                }
            };
            if self.run.world.is_very_lossy() {
                // The heartbeats of one of them may be lost five times in a row.
                let due = from + TEN_SECONDS * 2;
                let mut fits = self.courses.iter().filter(fitting).flat_map(|it| &it.changes);
                let is_reported =
                    fits.any(|(at, state)| *at <= due && *state == FindingState::Confirmed);
                if span.until >= due && !is_reported {
                    wrong.push(format!("{clash:?} from {} is not confirmed by {due}", span.from));
                }
                continue;
            }
            let mut times: Vec<Instant> = self
                .courses
                .iter()
                .flat_map(|course| course.changes.iter().map(|(at, _)| *at))
                .filter(|at| (due..span.until).contains(at))
                .collect();
            times.push(due);
            times.push(span.until);
            for time in times {
                let best = self.courses.iter().filter(fitting).filter_map(|it| it.at(time)).max();
                // Five and more that contend and silence each other are in turns one, two or more
                // for some seconds.
                let is_reported = best == Some(FindingState::Confirmed)
                    || self.contend(clash, time) && best == Some(FindingState::Suspected);
                if !is_reported {
                    wrong.push(format!(
                        "{clash:?} from {} until {} is {best:?} at {time}",
                        span.from, span.until
                    ));
                    break;
                }
            }
        }
        self.complain(wrong);
    }

    /// Returns true if five and more devices shared the address of a conflict in turns, not long
    /// before `time`.
    fn contend(&self, clash: Clash, time: Instant) -> bool {
        let Clash::Address(address, ..) = clash else { return false };
        let mut here = BTreeSet::new();
        for (other, span) in self.run.truth.clashes().chain(self.run.truth.both_on()) {
            if let Clash::Address(at, one, two) = other
                && at == address
                && span.from <= time
                && time.since(span.until) <= TEN_SECONDS
            {
                here.extend([one, two]);
            }
        }
        here.len() >= 5
    }

    fn begin(&self) -> Instant {
        Instant::ZERO + self.run.world.inspectors[self.number].from
    }

    /// Returns true if two devices were at `address` in turns and cannot be told apart: same name,
    /// and same UID or UIDs not received because no heartbeat was sent, not even to claim the
    /// address. Then only the U bit could distinguish them.
    fn is_same_to_all(&self, clash: Clash, address: Address) -> bool {
        match clash {
            Clash::Address(at, one, other) => {
                let (one, other) = (self.spec(one), self.spec(other));
                let beats = self.it.engine.device_at(at).map_or(0, |row| row.heartbeat.count);
                let works = |it: &DeviceSpec| it.mode.is_none() && !it.uid.is_blank();
                let unheard = beats == 0 && works(one) == works(other);
                at == address && one.name == other.name && (one.uid == other.uid || unheard)
            }
            Clash::Uid(..) => false,
        }
    }

    fn beats(&self, clash: Clash) -> bool {
        match clash {
            Clash::Address(_, one, other) => {
                [one, other].iter().all(|&it| !self.spec(it).faults.has(Fault::NoHeartbeat))
            }
            Clash::Uid(..) => true,
        }
    }

    /// Returns true if both devices send distinguishable frames, and these are received.
    fn can_see(&self, clash: Clash, from: Instant, until: Instant) -> bool {
        let inspector = &self.run.world.inspectors[self.number];
        let lens = &inspector.lens;
        let between = |at: Duration| (from..until).contains(&(Instant::ZERO + at));
        if lens.deaf.is_some_and(|deaf| between(deaf.from) || between(deaf.until))
            || lens.jump.is_some_and(|jump| between(jump.at))
            || self.it.cut_off.iter().any(|at| (from..until).contains(at))
        {
            return false;
        }
        let (one, other) = match clash {
            Clash::Address(_, one, other) => (self.spec(one), self.spec(other)),
            Clash::Uid(one, other) => {
                let beats = |address| {
                    let mut at = self.run.world.scenario.devices.iter();
                    at.any(|spec| is_fixed(spec, address) && spec.faults.has(Fault::NoHeartbeat))
                };
                return !beats(one) && !beats(other);
            }
        };
        let both = |fault| !one.faults.has(fault) && !other.faults.has(fault);
        let beat = both(Fault::NoHeartbeat);
        let rounds = beat || !inspector.config.round_period.is_zero();
        // A response with an absurd length does not even identify its request.
        let mumbles = |it: &DeviceSpec| it.faults.has(Fault::HugeLength) && is_unreadable(it);
        let answer = both(Fault::NoDes)
            && !inspector.config.listen_only
            && rounds
            && !mumbles(one)
            && !mumbles(other);
        let uids = !one.uid.is_blank() && !other.uid.is_blank() && one.uid != other.uid;
        // If all devices respond twice, every request seems to have been sent twice.
        let twice = self.all_are_shared();
        // Responses to broadcasts often wait for the bus together; equal ones merge then.
        beat && uids
            || answer
                && !self.run.world.is_very_lossy()
                && (one.name != other.name
                    || beat && lens.doubled.is_none() && !lens.echo && !twice)
    }

    /// Returns true if each of several addresses has two devices.
    fn all_are_shared(&self) -> bool {
        let clashes = self.clashes();
        let shared = |spec: &DeviceSpec| {
            clashes.iter().any(|(clash, _)| match *clash {
                Clash::Address(address, ..) => is_fixed(spec, address),
                Clash::Uid(..) => false,
            })
        };
        let devices = &self.run.world.scenario.devices;
        devices.len() > 2 && devices.iter().all(shared)
    }

    // --- ended conflicts are cleared -----------------------------------------------------

    fn clearings(&mut self) {
        let end = Instant::ZERO + self.run.world.end;
        let mut wrong = Vec::new();
        // A device that responds twice does so until the end.
        let goes_on = |course: &&Course| {
            matches!(course.kind, FindingKind::AnswersDoubled | FindingKind::SameNameSameAddress)
                && (self.responds_twice(course) || self.is_only_copied_response(course))
        };
        let conflicts = self.courses.iter().filter(|course| course.kind.is_conflict());
        for course in conflicts.filter(|course| !goes_on(course)) {
            let over = self
                .run
                .truth
                .clashes()
                .chain(self.run.truth.both_on())
                .filter(|(clash, _)| course.addresses.iter().any(|&it| clash.concerns(it)))
                .map(|(clash, _)| self.run.truth.over(clash))
                .max()
                .unwrap_or(Instant::ZERO)
                .max(self.begin());
            let last_word = course.at(end);
            // A finding suspected again later has another cause, or none.
            let opened_for_it = course.opened_last() < over + TEN_SECONDS;
            let calm = Instant::ZERO + self.run.world.calm;
            // A suspicion without a cause may come from the last event of the scenario.
            let over = if course.at(over).is_none() { over.max(calm) } else { over };
            // If requests are lost, their responses seem surplus for a while. A listen-only
            // inspector depends on the requests of others, one every ten seconds, and cannot send
            // follow-up requests.
            let missed = self.run.world.scenario.rx_loss > 0.0;
            let waits = self.run.world.inspectors[self.number].config.listen_only;
            let more = if waits { 8 } else { 3 * u32::from(missed) };
            let due = over + TEN_SECONDS + PERIOD * more;
            if due < end && opened_for_it && last_word != Some(FindingState::Cleared) {
                wrong.push(format!(
                    "{} at {:?} is still {last_word:?}, though over at {over}",
                    course.kind, course.addresses
                ));
            }
            let at_due = course.at(due.max(calm));
            if due.max(calm) < end && at_due == Some(FindingState::Confirmed) {
                wrong.push(format!(
                    "{} at {:?} is {at_due:?} at {due}, though over at {over}",
                    course.kind, course.addresses
                ));
            }
        }
        self.complain(wrong);
    }

    // --- address resolution --------------------------------------------------------------

    /// Checks contested addresses: two devices claim one and send heartbeats there in turns for
    /// less than five periods.
    fn contests(&mut self) {
        const ARSLV: u8 = 1;
        /// Heartbeats of one UID, until one with another follows.
        #[derive(Debug)]
        struct Turn {
            first: Instant,
            last: Instant,
            uid: Uid,
        }
        let mut wrong = Vec::new();
        // Boards swapped to and fro look the same if heartbeats of one are farther apart.
        let lossy = self.run.world.scenario.rx_loss > 0.0;
        let interleaves =
            |one: &Turn, next: &Turn| !lossy || next.first.since(one.last) <= PERIOD.mul_f64(2.6);
        let mut seen: BTreeMap<Address, Vec<Turn>> = BTreeMap::new();
        let mut claims: BTreeMap<(Address, Uid), Instant> = BTreeMap::new();
        for frame in &self.it.frames {
            let Some(header) = frame.platform_id().map(Header::decode) else { continue };
            let beat = header.response && header.broadcast && header.service.number() == 1;
            let Some(uid) = frame.data().first_chunk::<6>().map(|bytes| Uid(*bytes)) else {
                continue;
            };
            if beat && header.is_conforming() && !uid.is_blank() {
                let course = seen.entry(header.source).or_default();
                match course.last_mut().filter(|last| last.uid == uid) {
                    Some(turn) => turn.last = frame.time,
                    None => course.push(Turn { first: frame.time, last: frame.time, uid }),
                }
                if frame.data().get(6) == Some(&ARSLV) {
                    claims.insert((header.source, uid), frame.time);
                }
            }
        }
        for (address, course) in seen {
            let turns = course.windows(4).any(|turns| {
                let (second, third) = (turns[1].first, turns[2].first);
                let has_claimed = |turn: &Turn| {
                    let claim = claims.get(&(address, turn.uid));
                    claim.is_some_and(|claim| *claim <= third && second.since(*claim) < PERIOD * 4)
                };
                turns[0].uid == turns[2].uid
                    && turns[1].uid == turns[3].uid
                    && turns[3].first.since(second) < PERIOD * 5
                    && interleaves(&turns[0], &turns[2])
                    && interleaves(&turns[1], &turns[3])
                    && turns[..2].iter().all(has_claimed)
            });
            let is_reported = self.courses.iter().any(|course| {
                course.concerns(address)
                    && (course.kind == FindingKind::AddressContested
                        || course.changes.iter().any(|(_, it)| *it == FindingState::Confirmed))
            });
            // While many frames are destroyed, a claim of the other and then that it gave up the
            // address report it.
            let broken = self.run.world.broken;
            let is_near = |at: Instant| {
                broken.is_some_and(|(from, until)| {
                    at + PERIOD * 5 >= Instant::ZERO + from
                        && at <= Instant::ZERO + until + PERIOD * 5
                })
            };
            let events = || {
                let here = self.it.events.iter().map(|(_, event)| event);
                here.filter(|event| event.address == Some(address) && is_near(event.time))
            };
            let claimed = events()
                .find(|event| matches!(event.kind, EventKind::Claimed { holder: Some(_), .. }));
            let is_reported = is_reported
                || claimed.is_some_and(|claim| {
                    events().any(|event| {
                        event.time > claim.time
                            && matches!(event.kind, EventKind::GaveUpAddress { .. })
                    })
                });
            let late = course.last().is_some_and(|turn| {
                (Instant::ZERO + self.run.world.end).since(turn.first) < PERIOD * 9
            });
            let jumped = self.run.world.inspectors[self.number].lens.jump.is_some();
            if turns && !is_reported && !late && !jumped && address != Address::DEBUG {
                wrong.push(format!("{address} was contested, and nothing says so: {course:?}"));
            }
        }
        self.complain(wrong);
    }

    // --- final state ---------------------------------------------------------------------

    fn inventory(&mut self) {
        let config = &self.run.world.inspectors[self.number].config;
        let lossy = self.run.world.scenario.rx_loss > 0.0;
        let end = Instant::ZERO + self.run.world.end;
        let clashes = self.clashes();
        // Two devices that drive each other bus-off again and again are never online together.
        let both_on: Vec<_> = self.run.truth.both_on().collect();
        let clashing = |address: Address| {
            clashes.iter().chain(&both_on).any(|(clash, span)| {
                clash.concerns(address) && end.since(span.until) < TEN_SECONDS * 2
            })
        };
        // Without every third frame, requests fail again and again, and devices without heartbeats
        // stay unknown.
        if self.run.world.is_overfull() || self.run.world.is_very_lossy() {
            return;
        }
        // Beside another protocol, nothing is requested before a heartbeat or a DES message.
        let mut devices = self.run.world.scenario.devices.iter();
        if self.run.world.foreign.is_some()
            && devices.all(|spec| spec.faults.has(Fault::NoHeartbeat))
        {
            return;
        }
        // Devices that have not settled at the end.
        let moving = |address: Address| {
            self.it.events.iter().any(|(at, event)| {
                let moves =
                    matches!(event.kind, EventKind::Claimed { .. } | EventKind::Moved { .. });
                moves && event.address == Some(address) && end.since(*at) < TEN_SECONDS
            })
        };
        let mut wrong = Vec::new();
        let mut occupied = [false; 128];
        for (spec, &id) in self.run.world.scenario.devices.iter().zip(&self.run.devices) {
            let truth = self.run.sim.device_state(id);
            let (Some(address), Some(_)) = (truth.address, truth.mode) else { continue };
            occupied[address.index()] = true;
            if clashing(address) || truth.counters.0 > 0 {
                continue;
            }
            let quiet = spec.faults.has(Fault::NoHeartbeat);
            let Some(device) = self.it.engine.device_at(address) else {
                if !(quiet && (config.listen_only || config.round_period.is_zero())) {
                    wrong.push(format!("{truth:?} is not known"));
                }
                continue;
            };
            if !quiet && !lossy && device.presence != Presence::Online {
                wrong.push(format!("{truth:?} is {}", device.presence));
            }
            // The heartbeat after its claim is due after the end.
            let due = spec.heartbeat.unwrap_or(PERIOD) + spec.max_heartbeat_delay;
            let is_claimed = device.mode == Some(Mode::Arslv)
                && !matches!(truth.mode, Some(Mode::Init | Mode::Arslv))
                && device.heartbeat.last.is_some_and(|last| end.since(last) < due);
            if !quiet && !is_claimed && device.mode != truth.mode {
                wrong.push(format!("{truth:?} is in {:?}", device.mode));
            }
            let mute = FAULTS.iter().any(|fault| {
                spec.faults.has(*fault)
                    && *fault != Fault::RepeatsRequestDst
                    && *fault != Fault::NoHeartbeat
            });
            // A device that sends nothing unsolicited and gets no more requests may have been
            // replaced.
            let unheard = (quiet || truth.uid.is_blank()) && config.round_period.is_zero();
            // Boards with equal names and without UIDs can swap addresses undetected.
            let alike = truth.name == b"TWIN" && truth.uid.is_blank()
                || clashes.iter().any(|(clash, _)| self.is_same_to_all(*clash, address));
            let asks = matches!(self.it.engine.own_address(), OwnAddress::Held(_));
            if !asks || config.listen_only || mute || unheard || alike {
                continue;
            }
            if !device.is_named(truth.name) {
                wrong.push(format!(
                    "{truth:?} is known as {:?}: {:?}",
                    device.name, device.name_query
                ));
            }
            let services: Option<Vec<Vec<Vec<u8>>>> = device.services.as_ref().map(|services| {
                let strings = |service: &descan::discovery::DeviceService| {
                    let two = [&service.name, &service.version].into_iter();
                    two.chain(&service.extra).map(|it| it.as_bytes().to_vec()).collect()
                };
                services.iter().map(strings).collect()
            });
            let unlucky = !self.is_clear() && device.services_query.fault.is_some();
            if services.as_deref() != Some(truth.services) && !unlucky {
                wrong.push(format!(
                    "{truth:?} lists {:?}: {:?}",
                    services.map(|it| it.len()),
                    device.services_query
                ));
            }
        }
        let ours: Vec<Address> = self
            .run
            .inspectors
            .iter()
            .filter_map(|it| match it.engine.own_address() {
                OwnAddress::Held(address) => Some(address),
                _ => None,
            })
            .collect();
        // Part of the identifiers of another protocol are those of nodes without DES.
        let has_others = self.run.world.foreign.as_ref().is_some_and(ForeignNodes::is_extended);
        let nodes = Address::nodes().filter(|&at| !clashing(at) && !moving(at) && !has_others);
        for address in nodes {
            let rows = self.it.engine.devices().iter();
            // A device that left before the end is online for 2.5 periods more.
            let has_just_left = |last| !occupied[address.index()] && end.since(last) < PERIOD * 3;
            let here: Vec<String> = rows
                .filter(|device| !device.heartbeat.last.is_some_and(has_just_left))
                .filter(|device| {
                    device.address == address && device.is_present() && !device.is_debug
                })
                .filter(|_| !ours.contains(&address))
                .map(|device| format!("{:?} {}", device.name, device.presence))
                .collect();
            if here.len() > usize::from(occupied[address.index()]) {
                // A device without heartbeats is lost after three rounds, if there are rounds.
                let mut rows = self.it.engine.devices().iter();
                if rows.all(|it| it.address != address || it.heartbeat.count > 1) {
                    wrong.push(format!("{address}: {here:?} are here"));
                }
            }
        }
        self.complain(wrong);
    }

    /// Returns true if the device at `to` cannot be distinguished from one that was at `from`: same
    /// name, and no different UIDs.
    fn may_have_moved(&self, from: Address, to: Address) -> bool {
        let at = |address| {
            self.run.world.scenario.devices.iter().filter(move |it| is_fixed(it, address))
        };
        at(from).any(|one| {
            at(to).any(|other| {
                let mute = [one, other].iter().any(|it| it.faults.has(Fault::NoHeartbeat));
                one.name == other.name && (mute || one.uid == other.uid)
            })
        })
    }

    // --- no invented devices -------------------------------------------------------------

    fn quiet(&mut self) {
        let world = &self.run.world;
        let mut wrong = Vec::new();
        // Devices that start at once compete for an address. Responses to those that left it wait
        // for a flow control frame that is never sent, and are received together later.
        let contended = world.inspectors.len() > 2;
        // It resolves its address again, and is lost for at most that time.
        let is_calm = |at| !self.run.truth.has_other_bitrate(at, PERIOD * 10);
        for (at, event) in self.it.events.iter().filter(|(at, _)| self.is_clear() && is_calm(*at)) {
            let Some(address) = event.address else { continue };
            let owners = world.scenario.devices.iter().filter(|spec| is_fixed(spec, address));
            let untouched = owners.clone().count() > 0
                && owners.clone().all(|it| !world.touched.contains(&it.label) && is_regular(it));
            // A device that gave way takes any free address, even that of a device not yet switched
            // on.
            let mut guests = self.run.truth.seen_at(address);
            let is_visited = guests.any(|it| world.touched.contains(&self.spec(it).label));
            let inspector = event.device.and_then(|it| self.it.engine.device(it));
            if !untouched || is_visited || inspector.is_none_or(|device| device.is_debug) {
                continue;
            }
            // Its first intervals are not known yet.
            let begin = self.it.events.iter().find(|(_, it)| it.address == Some(address));
            let is_measured = owners.clone().all(|spec| {
                let begin = begin.map_or(*at, |(begin, _)| *begin);
                spec.heartbeat.is_none_or(|period| at.since(begin) > period * 4)
            });
            // Half the period is that of two devices half a period apart, too.
            let is_half = |spec: &DeviceSpec| {
                let half = PERIOD.mul_f64(0.4)..PERIOD.mul_f64(0.6);
                spec.heartbeat.is_some_and(|period| half.contains(&period))
            };
            let odd = match &event.kind {
                EventKind::Presence(_) | EventKind::Returned { .. } if !is_measured => false,
                EventKind::Finding { key, .. }
                    if key.kind == FindingKind::SameNameSameAddress
                        && owners.clone().any(is_half) =>
                {
                    false
                }
                EventKind::Moved { from } => !self.may_have_moved(*from, address),
                EventKind::Presence(_) | EventKind::Returned { .. } | EventKind::Rebooted => true,
                EventKind::Finding { key, .. } => {
                    let excused = key.kind == FindingKind::OneUidTwoAddresses
                        || contended && key.kind == FindingKind::SameNameSameAddress;
                    key.kind.is_conflict() && !excused
                }
                _ => false,
            };
            if odd {
                wrong.push(format!("{at} {}, but nothing happened", describe(event)));
            }
        }
        self.complain(wrong);
    }
}

fn is_fixed(spec: &DeviceSpec, address: Address) -> bool {
    matches!(spec.address, AddressSetting::Fixed(at) | AddressSetting::Preferred(at) if at == address)
}

/// Returns true if its heartbeats are received regularly.
fn is_regular(spec: &DeviceSpec) -> bool {
    // Its responses also identify the requester.
    let told = !spec.faults.has(Fault::NoHeartbeat) && !spec.faults.has(Fault::RepeatsRequestDst);
    told && spec.max_heartbeat_delay < Duration::from_millis(80)
}

/// Checks that several inspectors share the bus, each at its own address.
fn addresses_of_inspectors(run: &Run, wrong: &mut Vec<String>) {
    let mut held = Vec::new();
    for (number, it) in run.inspectors.iter().enumerate() {
        if run.world.inspectors[number].config.listen_only {
            continue;
        }
        let OwnAddress::Held(address) = it.engine.own_address() else {
            // Its controller goes bus-off again after each restart, or no address is free.
            if !it.cut_off.is_empty() || run.devices.len() > 120 {
                continue;
            }
            wrong.push(format!("inspector {number} has no address: {:?}", it.engine.own_address()));
            continue;
        };
        // Among nodes of another protocol nothing is sent, not even a claim.
        if it.engine.counters().sent == 0 {
            continue;
        }
        if held.contains(&address) {
            wrong.push(format!("two inspectors are at {address}"));
        }
        held.push(address);
        let devices = run.devices.iter().map(|&id| run.sim.device_state(id));
        if devices.into_iter().any(|state| state.address == Some(address)) {
            wrong.push(format!("inspector {number} sits at a device's address {address}"));
        }
    }
}

/// Returns true if the name of that device cannot be read: it takes several frames, which the
/// device sends wrongly.
fn is_unreadable(spec: &DeviceSpec) -> bool {
    let broken = [Fault::DropFrame, Fault::WrongSequence, Fault::HugeLength];
    spec.name.len() > 6 && broken.iter().any(|fault| spec.faults.has(*fault))
}
