//! The service of heartbeats, and their period.
//!
//! Heartbeats are unsolicited and regular, and every node sends them (CAN platform §3.2.4). Frames of
//! another service may be so, too: what decides is that nodes which do not work send them (U = 1),
//! and that they carry a UID, another one for each node.

use super::layout::has_other_content;
use super::period::Period;
use super::unsolicited::{UnsolicitedFrames, UnsolicitedSender};
use super::{Certainty, MAX_FRAMES, ProfileProposal};
use crate::frame::Frame;
use crate::text::counted;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Service};
use crate::wire::node::Uid;
use crate::wire::profile::{HeartbeatProfile, ProfileKey, ProfileValue};

/// Time of listening before any is proposed: in it, heartbeats of up to a second come several times,
/// beside regular frames of other services that come more often.
const MIN_LISTENING: Duration = Duration::from_secs(8);
/// Frames of all nodes, and of each.
const MIN_FRAMES: u32 = 10;
const MIN_FRAMES_EACH: u32 = 3;
const MIN_NODES: usize = 2;
/// Frames of one node from which on it is known whether they are regular.
const MIN_KNOWN: u32 = 6;
/// Periods for which a node was there before its heartbeats are expected.
const EXPECTED_AFTER: f64 = 4.0;
/// Part of the nodes that send them, at least: one may be faulty.
const MIN_COVERED: f64 = 0.8;
/// Contents of a node that works, and of one that does not: WORK, UFUNC with two error codes; INIT,
/// ARSLV, CFG, BOOT.
const MAX_WORKING: usize = 3;
const MAX_NON_WORKING: usize = 4;
/// Services that a reason names.
const MAX_NAMED: usize = 4;

/// The heartbeats of a bus.
#[derive(Debug)]
pub(super) struct Heartbeats<'a> {
    service: Service,
    period: Period,
    /// Their senders, by address.
    pub senders: Vec<(Address, &'a UnsolicitedSender)>,
    certainty: Certainty,
}

/// What distinguishes heartbeats from other regular frames, the stronger sign first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct HeartbeatSigns {
    /// A node sends them while it works and while it does not, with other contents.
    in_both_modes: bool,
    /// Each node has its own content, as long as a UID.
    own_contents: bool,
}

impl<'a> Heartbeats<'a> {
    /// Finds them; `None` if no service is known to be theirs.
    pub fn find(frames: &'a UnsolicitedFrames, listening: Duration) -> Option<Self> {
        if listening < MIN_LISTENING || frames.is_full() {
            return None;
        }
        let services = frames.services().into_iter();
        let all: Vec<ServiceFrames<'a>> =
            services.map(|service| ServiceFrames::new(frames, service)).collect();
        let fitting: Vec<(&ServiceFrames<'a>, Self)> =
            all.iter().filter_map(|of| Some((of, of.heartbeats(frames, listening)?))).collect();
        let (best, found) = fitting.iter().max_by_key(|(of, _)| of.signs)?;
        let is_rival = |other: &ServiceFrames<'_>| {
            let fits = fitting.iter().any(|(of, _)| of.service == other.service);
            let may_be = fits || other.is_early();
            let has_uids = frames.has_uids(other.service);
            if best.signs.in_both_modes {
                (may_be || has_uids) && frames.has_non_working(other.service)
            } else if best.signs.own_contents {
                // A heartbeat carries the UID (CAN platform §3.2.4); shorter frames do not.
                may_be && other.may_have_uid() || has_uids || other.signs > best.signs
            } else {
                may_be || has_uids || other.signs > best.signs
            }
        };
        let mut others = all.iter().filter(|of| of.service != best.service);
        if others.any(is_rival) {
            return None;
        }
        let is_certain = best.signs != HeartbeatSigns::default() && fitting.len() == 1;
        let certainty = if is_certain { Certainty::Certain } else { Certainty::Likely };
        Some(Self { certainty, senders: found.senders.clone(), ..*found })
    }

    /// Proposals of service and period.
    pub fn proposals(&self) -> Vec<ProfileProposal> {
        let nodes = counted(self.senders.len() as u64, "node");
        let seconds = self.period.micros / 1e6;
        let contents = self.senders.iter().filter_map(|(_, sender)| sender.contents.first());
        let mut frames: Vec<Frame> = contents.take(MAX_FRAMES).map(|it| it.frame).collect();
        frames.sort_by_key(|frame| frame.time);
        let period = match seconds * 1000.0 {
            999.5.. => format!("{seconds:.2} s"),
            millis @ 100.0.. => format!("{millis:.0} ms"),
            millis => format!("{millis:.1} ms"),
        };
        let mut proposals = vec![
            ProfileProposal {
                key: ProfileKey::Heartbeat,
                value: ProfileValue::Service(self.service.number()),
                certainty: self.certainty,
                evidence: format!("{nodes}, every {period}"),
                frames: frames.clone(),
            },
            ProfileProposal {
                key: ProfileKey::PeriodMs,
                value: ProfileValue::Number(self.period.millis()),
                certainty: self.certainty,
                evidence: format!(
                    "{} of {nodes}",
                    counted(self.period.intervals as u64, "interval")
                ),
                frames,
            },
        ];
        if !self.period.is_exact() {
            proposals.truncate(1);
        }
        proposals
    }
}

/// Why the service of heartbeats is not known.
pub(super) fn why_unknown(frames: &UnsolicitedFrames, listening: Duration) -> String {
    let seconds = MIN_LISTENING.as_secs();
    let services = frames.services().into_iter();
    let all: Vec<ServiceFrames<'_>> =
        services.map(|service| ServiceFrames::new(frames, service)).collect();
    let fitting: Vec<String> = all
        .iter()
        .filter(|of| of.heartbeats(frames, listening).is_some())
        .take(MAX_NAMED)
        .map(|of| format!("0x{:03X}", of.service.number()))
        .collect();
    if frames.is_full() {
        "more sources and services than a bus of the platform has".to_owned()
    } else if listening < MIN_LISTENING {
        format!("frames of {:.1} s; {seconds} s are needed", listening.as_secs_f64())
    } else if !all.iter().any(|of| of.senders.len() >= MIN_NODES) {
        "no service with unsolicited frames of two nodes whose contents stay the same".to_owned()
    } else if !fitting.is_empty() {
        format!("several services may be theirs, as {}", fitting.join(", "))
    } else {
        "no service that all nodes send regularly".to_owned()
    }
}

/// Frames with one service number that may be heartbeats.
struct ServiceFrames<'a> {
    service: Service,
    /// Their senders, by address.
    senders: Vec<(Address, &'a UnsolicitedSender)>,
    signs: HeartbeatSigns,
}

impl<'a> ServiceFrames<'a> {
    fn new(frames: &'a UnsolicitedFrames, service: Service) -> Self {
        let senders = frames.senders_of(service);
        let is_own = |(at, sender): &(Address, &UnsolicitedSender)| {
            let mut others = senders.iter().filter(|(other, _)| other != at);
            others.all(|(_, other)| has_other_content(sender, other, Uid::LEN))
        };
        let signs = HeartbeatSigns {
            in_both_modes: senders.iter().any(|(_, sender)| changes_with_mode(sender)),
            own_contents: senders.len() >= MIN_NODES && senders.iter().all(is_own),
        };
        Self { service, senders, signs }
    }

    /// Returns true if there are too few to tell whether they are regular.
    fn is_early(&self) -> bool {
        let most = self.senders.iter().map(|(_, sender)| sender.received()).max();
        most.is_some_and(|most| most < MIN_KNOWN)
    }

    /// Returns true if they are long enough for a UID.
    fn may_have_uid(&self) -> bool {
        let contents = self.senders.iter().flat_map(|(_, sender)| &sender.contents);
        contents.into_iter().any(|content| content.data().len() >= Uid::LEN)
    }

    /// They as heartbeats; `None` if they are too few, irregular, or not of all nodes.
    fn heartbeats(
        &self,
        frames: &UnsolicitedFrames,
        listening: Duration,
    ) -> Option<Heartbeats<'a>> {
        let mut senders = self.senders.clone();
        senders.retain(|(_, sender)| sender.frames >= MIN_FRAMES_EACH);
        let total: u32 = senders.iter().map(|(_, sender)| sender.frames).sum();
        if senders.len() < MIN_NODES || total < MIN_FRAMES {
            return None;
        }
        let single = senders.iter().map(|(_, sender)| *sender);
        let single: Vec<&UnsolicitedSender> = single.filter(|it| !it.alternates()).collect();
        let period = Period::find(&single)?;
        senders.retain(|(_, sender)| period.is_of(sender));
        let with_rnd7 = senders.iter().filter(|(_, sender)| sender.has_random_rnd7()).count();
        let expected_after = EXPECTED_AFTER * period.micros / 1e6;
        let was_there =
            |first: Instant, last: Instant| last.since(first).as_secs_f64() >= expected_after;
        let (mut expected, mut covered) = (0, 0);
        for (source, ..) in frames.sources().filter(|(_, first, last)| was_there(*first, *last)) {
            expected += 1;
            covered += usize::from(senders.iter().any(|(of, _)| *of == source));
        }
        let fits = senders.len() >= MIN_NODES
            && with_rnd7 * 2 >= senders.len()
            && f64::from(covered as u32) >= MIN_COVERED * f64::from(expected)
            && HeartbeatProfile::PERIODS.contains(&period.millis())
            && listening.as_secs_f64() >= expected_after;
        let Self { service, .. } = *self;
        fits.then_some(Heartbeats { service, period, senders, certainty: Certainty::Likely })
    }
}

/// Returns true if a sender sends other contents while it works than while it does not, and few of each:
/// those of its modes.
fn changes_with_mode(sender: &UnsolicitedSender) -> bool {
    let of = |is_non_working| {
        sender.contents.iter().filter(move |it| it.is_non_working == is_non_working)
    };
    let [working, others] = [false, true].map(|u| of(u).count());
    (1..=MAX_WORKING).contains(&working)
        && (1..=MAX_NON_WORKING).contains(&others)
        && of(false).all(|working| of(true).all(|other| other.data() != working.data()))
}
