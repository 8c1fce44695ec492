//! Whether a bus speaks DES, by the frames of other nodes (protocol §4.2).
//!
//! Of the 29-bit identifiers of other protocols, up to three quarters conform to the platform by
//! chance. So an address is not a device, and no device is requested, before a heartbeat that fits,
//! a DES message or a claim was received; and where many identifiers are impossible instead, the
//! bus speaks another protocol. The first frame that fits may do so by chance: until another one
//! confirms it, impossible identifiers refute it; 11-bit ones only if none does so in time, since they
//! may be of other devices on a mixed bus.

use super::observation::{Observation, ObservationKind, PlatformContent};
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, ServicesResponse};
use crate::wire::framing::{Framing, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header};
use crate::wire::isotp::Pci;
use crate::wire::node::Mode;
use crate::wire::profile::HeartbeatProfile;

/// Number of impossible identifiers that show another protocol: fewer may be noise, or one device
/// with faulty firmware.
const MIN_IMPOSSIBLE: u64 = 10;
/// Number of impossible identifiers from which on one plausible frame does not show DES. Chosen: a
/// stray frame and its repetition do not make a bus doubtful.
const MIN_DOUBTFUL: u64 = 3;
/// Bytes of a heartbeat that are compared: those of a UID.
const UID_BYTES: usize = 6;
/// Longest time between two heartbeats with one UID and different RND7 that show a device, in periods
/// of the profile. Chosen: three intervals of a device with five times the period.
const SAME_UID_PERIODS: f64 = 15.0;
/// Number of heartbeats of one source in the period of the profile that show a device that does not
/// generate RND7. Other protocols send constant data too, but rarely in this period; and of frames
/// every half period, so many in a row with every other one lost are rarer than one in 500 if 30 %
/// are lost.
const MIN_PERIODIC: i8 = 5;
/// Count of these heartbeats after other data with one identifier, or an interval that is not a
/// multiple of the period: 13 more are
/// needed then. Of frames every half period, every other one may be lost for a while.
const NOT_PERIODIC: i8 = -8;
/// Longest interval between two of them, in periods. A device is lost after as many.
const MAX_PERIODS: f64 = 5.0;
/// Deviation of their intervals, as a fraction of the period. As that of a measured period.
const PERIOD_TOLERANCE: f64 = 0.15;

/// What the frames of other nodes show about the protocol of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum BusVerdict {
    /// No frame was received.
    #[default]
    Silent,
    /// Frames were received, but nothing that tells DES from another protocol.
    Unknown,
    /// The bus speaks DES, perhaps among other protocols: a heartbeat that fits or a DES message
    /// was received.
    Des,
    /// The bus speaks another protocol: impossible identifiers prevail, and no frame fits DES.
    Foreign,
}

impl BusVerdict {
    /// Returns the name in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Silent => "silent",
            Self::Unknown => "unknown",
            Self::Des => "des",
            Self::Foreign => "foreign",
        }
    }
}

/// Frames of other nodes on a bus, by their identifiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct BusTraffic {
    /// Data and remote frames.
    pub frames: u64,
    /// Those with an 11-bit identifier, and remote frames.
    pub non_platform: u64,
    /// Those with a 29-bit identifier that is none of the nine message types.
    pub non_conforming: u64,
    /// True if a heartbeat that fits or a DES message was received.
    pub has_des: bool,
}

impl BusTraffic {
    /// Returns the verdict.
    pub fn verdict(&self) -> BusVerdict {
        match self {
            _ if self.has_des => BusVerdict::Des,
            _ if self.frames == 0 => BusVerdict::Silent,
            _ if self.is_mostly_impossible() => BusVerdict::Foreign,
            _ => BusVerdict::Unknown,
        }
    }

    /// Returns why a bus is taken for one that speaks another protocol, as a sentence without a
    /// period; `None` for other verdicts.
    pub fn foreign_reason(&self) -> Option<String> {
        if self.verdict() != BusVerdict::Foreign {
            return None;
        }
        let Self { frames, non_platform, non_conforming, .. } = *self;
        if non_platform == frames {
            return Some(format!(
                "this bus does not speak DES: all {frames} frames have 11-bit identifiers"
            ));
        }
        let share = (non_platform + non_conforming) * 100 / frames.max(1);
        Some(format!(
            "this bus does not speak DES: {frames} frames, {share} % of identifiers impossible in \
             it, no heartbeat, no DES message"
        ))
    }

    /// Returns true if impossible identifiers prevail: in logs of 38 NMEA 2000 buses they are 27 % and
    /// more, in those of two Cyphal buses 84 % and more.
    fn is_mostly_impossible(&self) -> bool {
        self.impossible() >= MIN_IMPOSSIBLE && self.impossible() * 5 >= self.frames
    }

    /// The same for the 29-bit identifiers alone.
    fn has_mostly_non_conforming(&self) -> bool {
        let extended = self.frames.saturating_sub(self.non_platform);
        self.non_conforming >= MIN_IMPOSSIBLE && self.non_conforming * 5 >= extended
    }

    /// Returns the number of frames whose identifiers no DES device sends.
    fn impossible(&self) -> u64 {
        self.non_platform + self.non_conforming
    }
}

/// How well a frame fits DES.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DesFit {
    None,
    /// A heartbeat whose mode contradicts its U bit.
    Contradictory,
    /// Other protocols have such frames by chance.
    Plausible,
    Certain,
}

/// Collects the signs of a bus's protocol.
#[derive(Clone, Debug)]
pub(super) struct ProtocolDetector {
    traffic: BusTraffic,
    /// True if `has_des` is beyond doubt.
    is_confirmed: bool,
    /// Time of the first frame that fits, until `is_confirmed`.
    first_fit_at: Option<Instant>,
    /// True if frames that fit a heartbeat do not come in the period of the profile.
    is_contradicted: bool,
    /// Heartbeat period of the profile.
    period: Duration,
    /// Offset of the mode in a heartbeat; `None` if the profile has none.
    mode_offset: Option<u8>,
    /// Last plausible heartbeats of each address with two UIDs, as two boards send them, until
    /// `is_confirmed`; the newer one first.
    heartbeats: [[Option<PlausibleHeartbeat>; 2]; Address::COUNT],
}

/// A frame that may be a heartbeat.
#[derive(Clone, Copy, Debug)]
struct PlausibleHeartbeat {
    at: Instant,
    id: Option<u32>,
    /// Begin of the data, at most those of a UID.
    uid: [u8; UID_BYTES],
    /// Number of those with one identifier that came in the period of the profile, or the rest of
    /// [`NOT_PERIODIC`].
    periodic: i8,
}

impl ProtocolDetector {
    pub fn new(heartbeat: &HeartbeatProfile) -> Self {
        Self {
            traffic: BusTraffic::default(),
            is_confirmed: false,
            first_fit_at: None,
            is_contradicted: false,
            period: heartbeat.period(),
            mode_offset: heartbeat.mode_offset,
            heartbeats: [[None; 2]; Address::COUNT],
        }
    }

    pub fn traffic(&self) -> BusTraffic {
        self.traffic
    }

    /// Returns true if the bus speaks DES beyond doubt: not only by one frame that fits.
    pub fn is_confirmed(&self) -> bool {
        self.is_confirmed
    }

    /// Notes a frame of another node.
    pub fn note_frame(&mut self, observation: &Observation<'_>) {
        self.traffic.frames += 1;
        match observation.kind {
            ObservationKind::Error | ObservationKind::NonPlatform => {
                self.traffic.non_platform += 1;
            }
            ObservationKind::Platform(header, _) if !header.is_conforming() => {
                self.traffic.non_conforming += 1;
            }
            ObservationKind::Platform(..) if self.is_confirmed => return,
            ObservationKind::Platform(header, content) => {
                self.judge_conforming(header, content, observation);
            }
        }
        if !self.traffic.has_des || self.is_confirmed {
            (self.first_fit_at, self.is_contradicted) = (None, false);
            return;
        }
        let first = *self.first_fit_at.get_or_insert(observation.at);
        let is_late =
            self.is_contradicted || observation.at.since(first) > self.period.mul_f64(MAX_PERIODS);
        let is_refuted = self.traffic.has_mostly_non_conforming()
            || is_late && self.traffic.is_mostly_impossible();
        self.traffic.has_des = !is_refuted;
    }

    /// Judges a frame whose identifier conforms to the platform.
    fn judge_conforming(
        &mut self,
        header: Header,
        content: PlatformContent,
        observation: &Observation<'_>,
    ) {
        let fit = des_fit(header, content, observation.frame, self.mode_offset);
        let is_heartbeat = matches!(content, PlatformContent::Heartbeat(_));
        let is_repeated = is_heartbeat
            && fit != DesFit::None
            && self.repeats_heartbeat(header.source, observation);
        match fit {
            DesFit::None => {}
            DesFit::Certain => self.is_confirmed = true,
            DesFit::Plausible => {
                self.is_confirmed |= is_repeated;
                // On a doubtful bus, one plausible frame is not enough.
                self.traffic.has_des |= self.traffic.impossible() < MIN_DOUBTFUL;
            }
            DesFit::Contradictory => {
                self.traffic.has_des |= is_repeated && self.traffic.impossible() < MIN_DOUBTFUL;
            }
        }
        self.traffic.has_des |= self.is_confirmed;
    }

    /// Returns true if a source sent heartbeats with the same UID before, as devices do: with
    /// another RND7, or in the period of the profile. Other protocols have identifiers that fit by
    /// chance, and send constant data, but with one identifier.
    fn repeats_heartbeat(&mut self, source: Address, observation: &Observation<'_>) -> bool {
        let Observation { at, frame, .. } = *observation;
        let mut uid = [0; UID_BYTES];
        for (byte, data) in uid.iter_mut().zip(frame.data()) {
            *byte = *data;
        }
        let id = frame.platform_id();
        let last = &mut self.heartbeats[source.index()];
        let before = last.iter().flatten().find(|before| before.uid == uid).copied();
        let newest = last[0];
        if newest.is_some_and(|newest| newest.uid != uid) {
            last[1] = newest;
        }
        let periods = |since: Instant| at.since(since).as_secs_f64() / self.period.as_secs_f64();
        // Data that changes with the same identifier is no UID.
        let is_constant = newest.is_none_or(|newest| newest.uid == uid || newest.id != id);
        let periodic = match before {
            _ if !is_constant => NOT_PERIODIC,
            Some(before) => match periods(before.at) {
                one if (one - 1.0).abs() <= PERIOD_TOLERANCE => before.periodic.saturating_add(1),
                // Heartbeats between them were lost.
                some if (some - some.round().max(1.0)).abs() <= PERIOD_TOLERANCE => {
                    if some <= MAX_PERIODS + PERIOD_TOLERANCE { before.periodic } else { 1 }
                }
                _ => NOT_PERIODIC,
            },
            None => 1,
        };
        last[0] = Some(PlausibleHeartbeat { at, id, uid, periodic });
        self.is_contradicted |= periodic == NOT_PERIODIC;
        let is_again =
            |before: PlausibleHeartbeat| before.id != id && periods(before.at) <= SAME_UID_PERIODS;
        before.is_some_and(is_again) || periodic >= MIN_PERIODIC
    }
}

/// Returns how well a frame with a conforming identifier fits a heartbeat of the profile, or part
/// of a DES message.
fn des_fit(
    header: Header,
    content: PlatformContent,
    frame: &Frame,
    mode_offset: Option<u8>,
) -> DesFit {
    match content {
        PlatformContent::Heartbeat(heartbeat) if header.response => {
            let working = heartbeat.mode.and_then(Mode::is_working);
            let is_short = mode_offset.is_none_or(|offset| frame.len() <= usize::from(offset));
            let fits = working.is_none_or(|working| working != header.from_non_working);
            match heartbeat.mode {
                _ if is_short => DesFit::Plausible,
                Some(_) if fits => DesFit::Plausible,
                Some(_) => DesFit::Contradictory,
                None => DesFit::None,
            }
        }
        PlatformContent::Request(Some(_)) => DesFit::Certain,
        PlatformContent::Response => classify_response(frame.data(), frame.is_fd, false)
            .map_or(DesFit::None, |framing| response_fit(frame, framing)),
        _ => DesFit::None,
    }
}

/// Returns how well a frame fits a DES response.
fn response_fit(frame: &Frame, framing: Framing) -> DesFit {
    let message = match (framing, Pci::decode(frame.data(), frame.is_fd)) {
        (Framing::Raw, _) => strip_raw_padding(frame.data()),
        (Framing::Isotp, Ok(Pci::Single(message))) => message,
        (Framing::Isotp, Ok(Pci::First { data, .. })) => {
            let is_des = matches!(data.first(), Some(&(des::TYPE_NAME | des::TYPE_SERVICES)));
            return if is_des { DesFit::Plausible } else { DesFit::None };
        }
        (Framing::Isotp, _) => return DesFit::None,
    };
    match message.first() {
        Some(&des::TYPE_NAME) => match des::decode_name(message) {
            (Some(name), None) if name.iter().all(u8::is_ascii_graphic) => DesFit::Certain,
            (Some(_), _) => DesFit::Plausible,
            (None, _) => DesFit::None,
        },
        Some(&des::TYPE_SERVICES) if ServicesResponse::decode(message).fault().is_none() => {
            DesFit::Plausible
        }
        _ => DesFit::None,
    }
}
