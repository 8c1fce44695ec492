//! Frames that the user sends as they are, once or several times.
//!
//! One sequence at a time. Each frame follows the one before when that is on the bus, the interval is
//! over, and the steady share of the bus allows it, answers included: a frame of address 0 has priority
//! over nearly all others. A sequence ends by itself if a frame is not acknowledged, descan loses its
//! address or the bus cannot be used; none is continued later. Does not know what the frames do.

use super::device_requests::RequestObstacle;
use super::device_tracker::DeviceTracker;
use super::event::EventKind;
use super::outbox::nominal_bits;
use super::requester::Requester;
use super::{Config, Engine};
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};

/// Time in which a frame must be on the bus. Chosen: behind a transmit queue that is full for a while.
const CONFIRMATION_TIMEOUT: Duration = Duration::from_secs(3);
/// Most frames of a sequence, all copies together. Chosen: at the steady share of 125 kbit/s they take two
/// minutes.
const MAX_FRAMES: u64 = 2000;

/// Frames to send one after the other, all of them several times.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameSequence {
    /// The frames, at least one.
    pub frames: Vec<Frame>,
    /// How often they are sent, at least once; at most 2000 frames in all.
    pub copies: u32,
    /// Least time between two copies.
    pub interval: Duration,
    /// The DST of broadcasts is random: each copy after the first has a new one.
    pub renews_destination: bool,
}

impl FrameSequence {
    /// Time from one frame to the next at least: what the steady share of the bus allows.
    pub fn spacing(&self, config: &Config, present: usize) -> Duration {
        let rate = config.steady_budget * f64::from(config.bits_per_second());
        let longest = self.frames.iter().map(|frame| bits(frame, present)).fold(0.0, f64::max);
        Duration::from_micros((longest / rate.max(1.0) * 1e6) as u64)
    }
}

/// Identity of a sequence on its bus; never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SequenceId(u64);

/// Why a sequence ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SequenceEnd {
    /// All frames are on the bus.
    #[error("all were sent")]
    Complete,
    /// The user stopped it.
    #[error("stopped")]
    Stopped,
    /// The controller became error-passive or bus-off.
    #[error("the controller is error-passive or bus-off: no ACK, or frames are destroyed")]
    ControllerErrors,
    /// A frame was not on the bus in time.
    #[error("the last frame was not on the bus within 3 s")]
    NotConfirmed,
    /// descan gave its address up.
    #[error("descan gave up its address")]
    AddressLost,
    /// Something else forbids to send.
    #[error("{0}")]
    Obstacle(RequestObstacle),
}

/// A sequence that is being sent.
#[derive(Clone, Debug)]
struct RunningSequence {
    id: SequenceId,
    sequence: FrameSequence,
    own: Option<Address>,
    /// Number of frames that were put into the transmit queue, of all copies.
    queued: u64,
    /// The last of them until it is on the bus, and when that is overdue.
    waiting: Option<(Frame, Instant)>,
    /// When the next copy begins at the earliest.
    due: Instant,
}

impl RunningSequence {
    fn frames(&self) -> u64 {
        self.sequence.frames.len() as u64
    }

    fn total(&self) -> u64 {
        self.frames() * u64::from(self.sequence.copies)
    }

    /// Number of copies whose frames are all on the bus.
    fn sent_copies(&self) -> u32 {
        (self.queued - u64::from(self.waiting.is_some())).checked_div(self.frames()).unwrap_or(0)
            as u32
    }
}

/// Sequences of one bus.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameSequences {
    running: Option<RunningSequence>,
    next_id: u64,
    /// When the share of the bus allows the next frame.
    free_at: Instant,
}

impl FrameSequences {
    fn start(
        &mut self,
        now: Instant,
        sequence: FrameSequence,
        own: Option<Address>,
    ) -> Option<SequenceId> {
        let frames = sequence.frames.len() as u64 * u64::from(sequence.copies);
        if self.running.is_some() || !(1..=MAX_FRAMES).contains(&frames) {
            return None;
        }
        let id = SequenceId(self.next_id);
        self.next_id += 1;
        self.running =
            Some(RunningSequence { id, sequence, own, queued: 0, waiting: None, due: now });
        Some(id)
    }

    /// Ends the running sequence.
    fn end(&mut self, why: SequenceEnd) -> Option<EventKind> {
        let running = self.running.take()?;
        Some(EventKind::SequenceEnded { sequence: running.id, copies: running.sent_copies(), why })
    }

    /// Takes a frame of descan that is on the bus.
    fn note_sent(&mut self, frame: &Frame) -> Option<EventKind> {
        let running = self.running.as_mut()?;
        running.waiting.take_if(|(waiting, _)| waiting.same_on_wire(frame))?;
        let copy = (running.queued - 1).checked_div(running.frames())? as u32 + 1;
        Some(EventKind::FrameSent { sequence: running.id, copy, frame: *frame })
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let running = self.running.as_ref()?;
        Some(match &running.waiting {
            Some((_, deadline)) => *deadline,
            None if running.queued == running.total() => Instant::ZERO,
            None => self.next_at(running),
        })
    }

    /// When the next frame is due. The frames of one copy follow each other: they are one request to all.
    fn next_at(&self, running: &RunningSequence) -> Instant {
        let is_within = !running.queued.is_multiple_of(running.frames().max(1));
        if is_within { Instant::ZERO } else { running.due.max(self.free_at) }
    }
}

/// Bits of a frame and of the answers that it demands.
fn bits(frame: &Frame, present: usize) -> f64 {
    let own = nominal_bits(frame);
    let Some(header) = frame.platform_id().map(Header::decode) else { return own };
    let answers = match (header.response, header.broadcast) {
        (true, _) => 0,
        (false, false) => 1,
        (false, true) => present,
    };
    own * (1 + answers) as f64
}

impl Requester {
    /// Sends the next frame of the sequence if it is due, and ends the sequence.
    pub(super) fn send_sequence(&mut self, tracker: &mut DeviceTracker) {
        let now = tracker.now;
        let Some(running) = &self.sequences.running else { return };
        let held = self.local_node.held();
        let is_whole = running.waiting.is_none() && running.queued == running.total();
        let is_overdue = running.waiting.is_some_and(|(_, deadline)| deadline <= now);
        let end = if is_whole {
            Some(SequenceEnd::Complete)
        } else if let Some(why) = self.request_obstacle(tracker) {
            Some(SequenceEnd::Obstacle(why))
        } else if running.own != held {
            Some(SequenceEnd::AddressLost)
        } else {
            is_overdue.then_some(SequenceEnd::NotConfirmed)
        };
        if let Some(end) = end {
            self.end_sequence(tracker, end);
        } else if running.waiting.is_none() && self.sequences.next_at(running) <= now {
            self.queue_next(tracker);
        }
    }

    fn queue_next(&mut self, tracker: &mut DeviceTracker) {
        let now = tracker.now;
        let present = tracker.device_table.devices().iter().filter(|it| it.is_present()).count();
        let rate = tracker.config.steady_budget * f64::from(tracker.config.bits_per_second());
        let Some(running) = &mut self.sequences.running else { return };
        let place = running.queued % running.frames().max(1);
        let Some(mut frame) = running.sequence.frames.get(place as usize).copied() else { return };
        if running.queued >= running.frames()
            && running.sequence.renews_destination
            && let Some(id) = frame.platform_id()
        {
            let mut header = Header::decode(id);
            header.destination = Address::from_bits(self.rng.u8(..128));
            frame.id = crate::frame::CanId::Extended(header.encode());
        }
        if place == 0 {
            running.due = now + running.sequence.interval;
        }
        running.queued += 1;
        running.waiting = Some((frame, now + CONFIRMATION_TIMEOUT));
        let time = Duration::from_micros((bits(&frame, present) / rate.max(1.0) * 1e6) as u64);
        self.sequences.free_at = self.sequences.free_at.max(now) + time;
        if let Some(header) = frame.platform_id().map(Header::decode)
            && header.broadcast
            && !header.response
            && running.own == Some(header.source)
        {
            tracker.recent_requests.note_broadcast(now, header.destination, true);
        }
        self.outbox.push(frame);
    }

    /// Ends the sequence, if one is running.
    pub(super) fn end_sequence(&mut self, tracker: &mut DeviceTracker, why: SequenceEnd) {
        if let Some(event) = self.sequences.end(why) {
            tracker.emit_bus_event(event);
        }
    }

    /// Notes a frame of descan that is on the bus.
    pub(super) fn note_sequence_frame(&mut self, tracker: &mut DeviceTracker, frame: &Frame) {
        if let Some(event) = self.sequences.note_sent(frame) {
            tracker.emit_bus_event(event);
            tracker.wake_at(tracker.now);
        }
    }

    /// Returns when the sequence is due.
    pub(super) fn sequence_timeout(&self) -> Option<Instant> {
        self.sequences.poll_timeout()
    }
}

impl Engine {
    /// Command: sends frames as they are. Each frame that is on the bus is an [`EventKind::FrameSent`], the
    /// end an [`EventKind::SequenceEnded`]. Returns `None` if another sequence is being sent, or it has
    /// no frame or more than 2000.
    pub fn send_frames(&mut self, now: Instant, sequence: FrameSequence) -> Option<SequenceId> {
        self.tracker.advance(now);
        let own = self.requester.local_node.held();
        let id = self.requester.sequences.start(self.tracker.now, sequence, own);
        self.tracker.wake_at(self.tracker.now);
        id
    }

    /// Command: sends no further frame of the running sequence.
    pub fn stop_frames(&mut self, now: Instant, why: SequenceEnd) {
        self.tracker.advance(now);
        self.requester.end_sequence(&mut self.tracker, why);
    }

    /// Returns true while a sequence is being sent.
    pub fn is_sending_frames(&self) -> bool {
        self.requester.sequences.running.is_some()
    }
}
