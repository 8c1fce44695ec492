//! Disruptions: frames from the address of the device, and commands that change its mode; what the device
//! does then.
//!
//! Input: frames and time. Output: frames to send, and what the device did. Does not know the rules.

use super::observer::Observer;
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use crate::wire::node::{Heartbeat, Mode, Uid};
use crate::wire::profile::Profile;

/// Periods after a frame from its address in which a heartbeat shows that a device keeps it: during
/// address resolution it listens for 1.5 of them.
const WATCHED: f64 = 1.4;
/// Periods in which a heartbeat may have been queued before.
const QUEUED: f64 = 0.05;
/// Periods for which an address is occupied, and between two frames meanwhile.
const OCCUPIED: f64 = 5.0;
/// See [`OCCUPIED`].
const OCCUPIED_EVERY: f64 = 0.4;
/// Periods in which a device is back, or its mode changed.
const RETURN: f64 = 12.0;
/// See [`RETURN`].
const MODE_CHANGE: f64 = 4.0;

/// What is done to a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DisruptionKind {
    /// A frame from its address, with that U.
    Displace { from_non_working: bool },
    /// Frames from its address while it resolves its address.
    Occupy,
    /// A command to change its mode.
    SetMode(Mode),
}

/// What a device did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DisruptionPhase {
    /// Watched until then.
    Watching(Instant),
    /// It is awaited, until then.
    Returning(Instant),
}

/// A disruption that is under way.
#[derive(Clone, Debug)]
pub(super) struct Disruption {
    pub kind: DisruptionKind,
    pub was_working: bool,
    uid: Option<Uid>,
    period: Duration,
    own: Address,
    device: Address,
    /// When the first frame was on the bus.
    pub sent_at: Option<Instant>,
    asked_at: Instant,
    phase: DisruptionPhase,
    next_frame: Option<Instant>,
    out: Vec<Frame>,
    /// A heartbeat from its address while it was watched.
    pub heartbeat: Option<Frame>,
    /// Its answer to a command.
    pub answer: Option<Frame>,
    /// Where it came back.
    pub returned: Option<Address>,
    pub frames: Vec<Frame>,
    random: u8,
}

impl Disruption {
    /// Begins one.
    pub fn new(
        now: Instant,
        kind: DisruptionKind,
        (own, device): (Address, Address),
        observer: &Observer,
        profile: &Profile,
        random: u8,
    ) -> Self {
        let period = profile.heartbeat.period();
        let was_working = observer.is_working() == Some(true);
        let mut disruption = Self {
            kind,
            was_working,
            uid: observer.uid().and_then(Uid::not_blank),
            period,
            own,
            device,
            sent_at: None,
            asked_at: now,
            phase: DisruptionPhase::Watching(now + period * 3),
            next_frame: None,
            out: Vec::new(),
            heartbeat: None,
            answer: None,
            returned: None,
            frames: Vec::new(),
            random,
        };
        disruption.push_frame(profile);
        disruption
    }

    fn push_frame(&mut self, profile: &Profile) {
        let frame = match self.kind {
            DisruptionKind::SetMode(mode) => {
                let service = crate::wire::id::Service::from_bits(profile.commands.mode);
                let mut header = Header::request(self.own, self.device, !self.was_working, service);
                header.no_error = profile.request_err;
                Frame::classic(header.encode(), &[profile.modes.codes()[mode as usize]])
            }
            DisruptionKind::Displace { from_non_working } => {
                self.foreign_heartbeat(from_non_working, profile)
            }
            DisruptionKind::Occupy => self.foreign_heartbeat(false, profile),
        };
        self.out.push(frame);
    }

    /// A heartbeat of another node at the address of the device.
    fn foreign_heartbeat(&mut self, from_non_working: bool, profile: &Profile) -> Frame {
        self.random = self.random.wrapping_mul(5).wrapping_add(17) & 0x7F;
        let service = profile.heartbeat_service();
        let header = Header::unsolicited(self.device, self.random, from_non_working, service);
        let mode = if from_non_working { Mode::Cfg } else { Mode::Work };
        let uid = Some(Uid([0xD5, 0xCA, 0x4E, 0, 0, self.device.number()]));
        let heartbeat = Heartbeat { uid, mode: Some(mode), error: Some(0) };
        let (data, len) = heartbeat.encode(&profile.heartbeat, &profile.modes.codes());
        Frame::classic(header.encode(), &data[..len])
    }

    /// Returns the next frame to send.
    pub fn poll_transmit(&mut self) -> Option<Frame> {
        self.out.pop()
    }

    /// Takes a frame of the bus.
    pub fn handle_frame(&mut self, frame: &Frame, profile: &Profile) {
        let Some(header) = frame.platform_id().map(Header::decode) else { return };
        if frame.is_tx {
            self.note_own(frame, header);
            return;
        }
        let Some(sent) = self.sent_at else { return };
        let is_heartbeat = header.response && header.service == profile.heartbeat_service();
        if is_heartbeat && header.source == self.device {
            self.note_heartbeat(frame, header, sent);
        } else if is_heartbeat
            && self.uid.is_some()
            && profile.heartbeat_of(frame.data()).uid == self.uid
        {
            self.keep(frame);
            self.returned = Some(header.source);
        } else if matches!(self.kind, DisruptionKind::SetMode(_))
            && header.response
            && header.source == self.device
            && header.service.number() == profile.commands.mode
        {
            self.keep(frame);
            self.answer = Some(*frame);
        }
    }

    fn note_own(&mut self, frame: &Frame, header: Header) {
        if header.source != self.device && !matches!(self.kind, DisruptionKind::SetMode(_)) {
            return;
        }
        self.keep(frame);
        if self.sent_at.is_some() {
            return;
        }
        self.sent_at = Some(frame.time);
        let (watched, every) = match self.kind {
            DisruptionKind::Displace { .. } => (WATCHED, None),
            DisruptionKind::Occupy => (OCCUPIED, Some(OCCUPIED_EVERY)),
            DisruptionKind::SetMode(_) => (MODE_CHANGE, None),
        };
        self.phase = DisruptionPhase::Watching(frame.time + self.period.mul_f64(watched));
        self.next_frame = every.map(|every| frame.time + self.period.mul_f64(every));
    }

    fn note_heartbeat(&mut self, frame: &Frame, header: Header, sent: Instant) {
        let is_queued = frame.time.since(sent) < self.period.mul_f64(QUEUED);
        match (self.kind, self.phase) {
            (_, DisruptionPhase::Returning(_)) => {
                self.keep(frame);
                self.returned = Some(self.device);
            }
            _ if is_queued => {}
            (DisruptionKind::SetMode(mode), _) => {
                let is_reached = mode.is_working() == Some(!header.from_non_working);
                if is_reached && self.heartbeat.is_none() {
                    self.keep(frame);
                    self.heartbeat = Some(*frame);
                }
            }
            _ => {
                self.keep(frame);
                self.heartbeat.get_or_insert(*frame);
            }
        }
    }

    fn keep(&mut self, frame: &Frame) {
        if self.frames.len() < super::MAX_PROOF_FRAMES {
            self.frames.push(*frame);
        }
    }

    /// Does what is due; returns true while it is under way.
    pub fn handle_timeout(&mut self, now: Instant, profile: &Profile) -> bool {
        if self.next_frame.is_some_and(|at| at <= now) {
            self.push_frame(profile);
            self.next_frame = Some(now + self.period.mul_f64(OCCUPIED_EVERY));
        }
        match self.phase {
            DisruptionPhase::Watching(until) if now >= until => {
                self.next_frame = None;
                let keeps = matches!(self.kind, DisruptionKind::SetMode(_))
                    || self.heartbeat.is_some() && self.kind != DisruptionKind::Occupy;
                if keeps || self.sent_at.is_none() {
                    return false;
                }
                self.phase = DisruptionPhase::Returning(now + self.period.mul_f64(RETURN));
                true
            }
            DisruptionPhase::Watching(_) => {
                let is_set = matches!(self.kind, DisruptionKind::SetMode(_));
                !(is_set && self.heartbeat.is_some() && self.answer.is_some())
            }
            DisruptionPhase::Returning(until) => self.returned.is_none() && now < until,
        }
    }

    /// When something is due.
    pub fn due(&self) -> Instant {
        if !self.out.is_empty() || self.returned.is_some() && self.is_returning() {
            return self.asked_at;
        }
        let (DisruptionPhase::Watching(until) | DisruptionPhase::Returning(until)) = self.phase;
        self.next_frame.map_or(until, |at| at.min(until))
    }

    fn is_returning(&self) -> bool {
        matches!(self.phase, DisruptionPhase::Returning(_))
    }
}
