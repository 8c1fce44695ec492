//! Frames that the user composes and sends: what forbids it, the questions, what became of each.
//!
//! A sending is done when its frames are on the bus and the answers that it demands are there, or do not
//! come. It is a line of the timeline then. Answers that come later are kept with it until the next one.
//! Does not know how fields are typed or drawn.

use super::answer_text::{answer_text, format_millis};
use super::notices::TimelineEntry;
use super::timeline_kind::TimelineKind;
use super::{App, Bus, Effect, format_duration};
use crate::composer::{
    Answer, AnswerCollector, Composed, Composition, KnownNode, Mistake, Receivers, Repeat,
    Surroundings,
};
use crate::discovery::{Event, EventKind, FrameSequence, OwnAddress, SequenceEnd, SequenceId};
use crate::frame::{BusIndex, Frame};
use crate::status::BusState;
use crate::text::counted;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use std::collections::VecDeque;

/// Sendings that are kept. Bounds the memory.
const MAX_SENDINGS: usize = 50;
/// Answers that are kept of a sending; the others are counted.
const MAX_ANSWERS: usize = 128;

/// An answer to a frame that was sent.
#[derive(Clone, Debug)]
pub struct SentAnswer {
    /// When its last frame was received.
    pub time: Instant,
    /// The answer.
    pub answer: Answer,
    /// Name and address of the sender.
    pub who: String,
    /// Its name; `None` if it is not known.
    pub name: Option<String>,
    /// What it says.
    pub text: String,
}

/// What became of frames that were sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendingResult {
    /// All copies are on the bus, and are answered where one node must.
    Done,
    /// An answer is an error response.
    Refused,
    /// A copy to one node was not answered in time.
    NoAnswer,
    /// Not all copies were sent.
    Ended(SequenceEnd),
}

/// Frames that were composed and sent.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SentFrames {
    /// Bus.
    pub bus: BusIndex,
    /// The composition.
    pub composition: Composition,
    /// What it made.
    pub composed: Composed,
    /// How often it is to be sent.
    pub repeat: Repeat,
    /// Time of the user's consent.
    pub asked: Instant,
    /// Number of copies on the bus.
    pub copies: u32,
    /// Time of the last frame on the bus.
    pub last_sent: Option<Instant>,
    /// The last answers, at most 128, oldest first.
    pub answers: VecDeque<SentAnswer>,
    /// Number of answers.
    pub answer_count: u32,
    /// Number of error responses.
    pub errors: u32,
    /// Number of copies with an answer.
    pub answered: u32,
    /// Shortest, sum and longest of the latencies.
    latencies: Option<(Duration, Duration, Duration)>,
    /// Why no more frames are sent; `None` while they are.
    pub end: Option<SequenceEnd>,
    /// What became of it; `None` until it is done.
    pub result: Option<SendingResult>,
    /// Why it was stopped: the receiver is not the one that was asked for.
    receiver_change: Option<String>,
    /// Number of frames on the bus.
    frames: u32,
    sequence: SequenceId,
    wait: Duration,
    collector: AnswerCollector,
}

impl SentFrames {
    /// When the wait for answers is over; `None` while frames are being sent.
    fn closes_at(&self) -> Option<Instant> {
        self.end?;
        Some(self.last_sent.unwrap_or(self.asked) + self.wait)
    }

    /// Shortest, mean and longest latency; `None` without an answer.
    pub fn latency(&self) -> Option<(Duration, Duration, Duration)> {
        let (least, sum, most) = self.latencies?;
        Some((least, sum / self.answer_count.max(1), most))
    }

    fn add(&mut self, answer: SentAnswer) {
        let latency = answer.answer.latency;
        let (least, sum, most) = self.latencies.unwrap_or((latency, Duration::ZERO, latency));
        self.latencies = Some((least.min(latency), sum + latency, most.max(latency)));
        let is_further = self.answers.iter().any(|it| it.answer.copy == answer.answer.copy);
        self.answered += u32::from(!is_further);
        self.answer_count += 1;
        self.errors += u32::from(answer.answer.is_error);
        if self.answers.len() == MAX_ANSWERS {
            self.answers.pop_front();
        }
        self.answers.push_back(answer);
    }

    /// What became of it, as far as it is known at `now`.
    fn result_at(&self, now: Instant) -> Option<SendingResult> {
        let end = self.end?;
        if end != SequenceEnd::Complete {
            return Some(SendingResult::Ended(end));
        }
        let is_over = self.closes_at().is_none_or(|at| at <= now) && !self.collector.is_receiving();
        let is_answered = self.composed.needs_answer()
            && self.answered >= self.copies
            && !self.collector.is_receiving();
        if self.composed.may_be_answered() && !is_over && !is_answered {
            return None;
        }
        Some(match self.composed.needs_answer() {
            _ if self.errors > 0 => SendingResult::Refused,
            true if self.answered < self.copies => SendingResult::NoAnswer,
            _ => SendingResult::Done,
        })
    }
}

/// All that was sent, and random numbers for what is composed.
#[derive(Debug, Default)]
pub(super) struct Sendings {
    list: VecDeque<SentFrames>,
    /// Compositions of earlier runs, in words, the latest first.
    earlier: Vec<String>,
    rng: Option<fastrand::Rng>,
    rnd7: u8,
}

impl Sendings {
    /// Returns none; `earlier`: compositions of earlier runs, in words, the latest first.
    pub fn new(earlier: Vec<String>) -> Self {
        Self { earlier, ..Self::default() }
    }
}

impl App {
    /// Compositions that were sent, also in earlier runs, the latest first, each once.
    pub(super) fn sent_compositions(&self) -> Vec<Composition> {
        let now = self.sent_frames().rev().map(|sent| sent.composition.clone());
        let earlier = self.sendings.earlier.iter().filter_map(|it| Composition::parse(it).ok());
        let mut all: Vec<Composition> = Vec::new();
        for composition in now.chain(earlier) {
            if !all.contains(&composition) {
                all.push(composition);
            }
        }
        all
    }

    /// What was composed and sent, oldest first, at most 50.
    pub fn sent_frames(&self) -> impl DoubleEndedIterator<Item = &SentFrames> {
        self.sendings.list.iter()
    }

    /// The sending whose frames are being sent, or whose answers are awaited.
    pub fn running_sending(&self) -> Option<&SentFrames> {
        self.sendings.list.back().filter(|it| it.result.is_none())
    }

    /// The devices of a bus, as a composition needs them.
    pub fn known_nodes(&self, bus: BusIndex) -> Vec<KnownNode> {
        let Some(of) = self.shown_buses().get(bus) else { return Vec::new() };
        let alphabet = &of.config().profile.uid;
        let present = of.devices().iter().filter(|device| device.is_present());
        let current =
            present.filter(|it| of.device_at(it.address).is_none_or(|now| now.id == it.id));
        let mut nodes: Vec<KnownNode> = current
            .map(|device| {
                let is_shared = self.shown_buses().has_confirmed_conflict(device);
                KnownNode {
                    address: device.address,
                    name: device.name.as_ref().map(ToString::to_string),
                    uid: device.uid.map(|uid| uid.text(alphabet).to_string()),
                    is_working: device.is_working,
                    framing: device.framing,
                    boards: of.senders_at(device.address).len().max(1 + usize::from(is_shared)),
                }
            })
            .collect();
        nodes.sort_by_key(|node| node.address);
        nodes
    }

    /// Makes the frames of a composition for a bus.
    ///
    /// # Errors
    ///
    /// What is wrong with it.
    pub fn compose(&self, bus: BusIndex, composition: &Composition) -> Result<Composed, Mistake> {
        let mut composed = self.with_surroundings(bus, |around| composition.compose(around))?;
        if let Receivers::One(address) = composed.receivers {
            let nodes = self.known_nodes(bus);
            composed.receiver_node = nodes.into_iter().find(|node| node.address == address);
        }
        Ok(composed)
    }

    /// How the one receiver differs from that which was asked for; `None` if it does not.
    fn receiver_change(
        &self,
        bus: BusIndex,
        composition: &Composition,
        composed: &Composed,
    ) -> Option<String> {
        let Receivers::One(address) = composed.receivers else { return None };
        let again = match self.compose(bus, composition) {
            Ok(again) => again,
            Err(why) => return Some(why.text),
        };
        if again.receiver != composed.receiver || again.frames != composed.frames {
            return Some(format!(
                "it was asked for {}, now it is {} to {}",
                composed.receiver,
                again.frame_text(),
                again.receiver
            ));
        }
        let (asked, now) = (composed.receiver_node.as_ref()?, again.receiver_node?);
        if asked.uid.is_some() && asked.uid != now.uid {
            let uid = now.uid.unwrap_or_else(|| "none".to_owned());
            return Some(format!("another device is at {address} now, its UID is {uid}"));
        }
        let joined = now.boards > asked.boards;
        joined.then(|| format!("another device is at {address}, too, now"))
    }

    pub(super) fn with_surroundings<T>(
        &self,
        bus: BusIndex,
        run: impl FnOnce(Surroundings<'_>) -> T,
    ) -> T {
        let (profile, nodes) = (self.shown_buses().profile(bus), self.known_nodes(bus));
        let own = self.shown_buses().get(bus).and_then(|bus| match bus.own_address() {
            OwnAddress::Held(own) => Some(own),
            _ => None,
        });
        run(Surroundings { profile: &profile, own, nodes: &nodes, rnd7: self.sendings.rnd7 })
    }

    /// Draws the random DST of the next broadcast.
    pub fn renew_random_destination(&mut self, bus: BusIndex) {
        let of = self.bus(bus);
        let seed = of.map_or(0, |bus| bus.config().seed);
        let own = of.map(Bus::own_address);
        let rng = self.sendings.rng.get_or_insert_with(|| fastrand::Rng::with_seed(!seed));
        let rnd7 = rng.u8(..128);
        // Responses with the DST of the request must differ from those to descan.
        let is_own = own == Address::new(rnd7).map(OwnAddress::Held);
        self.sendings.rnd7 = if is_own { rnd7 ^ 0x40 } else { rnd7 };
    }

    /// Why nothing can be sent on a bus; `None` if frames can.
    pub fn sending_obstacle(&self, index: BusIndex) -> Option<String> {
        let bus = self.bus(index)?;
        if let Some(why) = self.tx_obstacle(index, bus) {
            return Some(why);
        }
        if bus.is_foreign() {
            return Some("the bus speaks another protocol".to_owned());
        }
        match bus.own_address() {
            OwnAddress::Held(_) => None,
            _ => Some("descan has no address on this bus yet".to_owned()),
        }
    }

    /// What is sent, without a question mark, and what it does.
    pub fn sending_sentences(
        &self,
        bus: BusIndex,
        composed: &Composed,
        repeat: Repeat,
    ) -> (String, String) {
        let mut sent = format!("Send {} to {}", composed.frame_text(), composed.receiver);
        let mut effects = Vec::new();
        if repeat.copies > 1 {
            let spacing = self.least_spacing(bus, composed);
            let interval = repeat.interval.max(spacing * composed.frames.len() as u32);
            let (copies, interval_text) = (repeat.copies, format_millis(interval));
            sent = format!("{sent}, {copies} times, one every {interval_text}");
            if interval > repeat.interval {
                effects.push("The steady share of the bus allows no more.".to_owned());
            }
        }
        if let Some(change) = &composed.change {
            effects.insert(0, format!("It {change}."));
        }
        effects.extend(composed.warnings.iter().map(|warning| {
            let mut letters = warning.chars();
            let first = letters.next().map(char::to_uppercase);
            let first: String = first.into_iter().flatten().collect();
            format!("{first}{}.", letters.as_str())
        }));
        (sent, effects.join(" "))
    }

    fn least_spacing(&self, bus: BusIndex, composed: &Composed) -> Duration {
        let Some(bus) = self.bus(bus) else { return Duration::ZERO };
        let present = bus.devices().iter().filter(|device| device.is_present()).count();
        sequence_of(composed, Repeat::default(), false).spacing(bus.config(), present)
    }

    /// Sends what was composed. `wait`: longest time for answers; `None`: that of the profile.
    ///
    /// # Errors
    ///
    /// The reason why it cannot be sent.
    pub fn send_composed(
        &mut self,
        bus: BusIndex,
        composition: &Composition,
        composed: &Composed,
        repeat: Repeat,
        wait: Option<Duration>,
    ) -> Result<(), String> {
        if let Some(why) = self.sending_obstacle(bus) {
            return Err(why);
        }
        let of = self.bus(bus).ok_or("the bus is not there")?;
        if composed.own.map(OwnAddress::Held) != Some(of.own_address()) {
            return Err("descan has another address now: compose it again".to_owned());
        }
        if let Some(change) = self.receiver_change(bus, composition, composed) {
            return Err(format!("not sent: {change}; compose it again"));
        }
        let state = of.controller().state;
        if repeat.copies > 1 && matches!(state, BusState::ErrorPassive | BusState::BusOff) {
            return Err(format!("the controller is {state}: nothing is repeated"));
        }
        let profile = of.config().profile.clone();
        let wait = wait.unwrap_or_else(|| profile.calls.timeout());
        let now = self.clock.now();
        let renews = composed.has_random_destination(composition);
        let sequence = sequence_of(composed, repeat, renews);
        let sequence = self.buses.send_frames(now, bus, sequence);
        let sequence = sequence.ok_or("other frames are being sent: stop them first")?;
        self.finish_sending();
        self.renew_random_destination(bus);
        if self.view.has_screen {
            self.effects.push_back(Effect::RememberFrame(composition.to_words()));
        }
        if self.sendings.list.len() == MAX_SENDINGS {
            self.sendings.list.pop_front();
        }
        self.sendings.list.push_back(SentFrames {
            bus,
            composition: composition.clone(),
            collector: AnswerCollector::new(&composed.frames, &profile, wait),
            composed: composed.clone(),
            repeat,
            asked: now,
            copies: 0,
            frames: 0,
            last_sent: None,
            answers: VecDeque::new(),
            answer_count: 0,
            errors: 0,
            answered: 0,
            latencies: None,
            end: None,
            result: None,
            receiver_change: None,
            sequence,
            wait,
        });
        self.notices.redraw.set_dirty();
        Ok(())
    }

    /// Sends no further copy. Returns false if none is being sent.
    pub fn stop_sending(&mut self) -> bool {
        let Some(bus) = self.running_sending().filter(|it| it.end.is_none()).map(|it| it.bus)
        else {
            return false;
        };
        self.buses.stop_frames(self.clock.now(), bus);
        self.take_events();
        true
    }

    /// Takes an engine event about the running sequence.
    pub(super) fn note_sending_event(&mut self, bus: BusIndex, event: &Event) {
        let Some(sending) = self.sendings.list.back_mut().filter(|it| it.bus == bus) else {
            return;
        };
        match &event.kind {
            EventKind::FrameSent { sequence, copy, frame } if *sequence == sending.sequence => {
                sending.collector.note_sent(*copy, event.time, frame);
                sending.frames += 1;
                sending.copies = sending.frames / sending.composed.frames.len().max(1) as u32;
                sending.last_sent = Some(event.time);
                self.check_receiver(bus);
            }
            EventKind::SequenceEnded { sequence, copies, why }
                if *sequence == sending.sequence && sending.end.is_none() =>
            {
                (sending.copies, sending.end) = (*copies, Some(*why));
                self.check_sending(event.time);
            }
            // A device may have moved, or joined.
            _ => return self.check_receiver(bus),
        }
        self.request_redraw();
    }

    /// Sends no further copy if the receiver is not the one that was asked for any more.
    fn check_receiver(&mut self, bus: BusIndex) {
        let is_on = |it: &&SentFrames| {
            it.bus == bus && it.end.is_none() && it.copies < it.repeat.copies && it.copies > 0
        };
        let Some(sending) = self.sendings.list.back().filter(is_on) else { return };
        let change = self.receiver_change(bus, &sending.composition, &sending.composed);
        if change.is_none() {
            return;
        }
        if let Some(sending) = self.sendings.list.back_mut() {
            sending.receiver_change = change;
        }
        self.buses.stop_frames(self.clock.now(), bus);
    }

    /// Takes a frame that may be an answer.
    pub(super) fn note_frame_for_sending(&mut self, frame: &Frame) {
        let Some(sending) = self.sendings.list.back_mut().filter(|it| it.bus == frame.bus) else {
            return;
        };
        if sending.result.is_some() && sending.closes_at().is_none_or(|at| at < frame.time) {
            return;
        }
        if let Some(answer) = sending.collector.handle_frame(frame) {
            self.add_answer(frame.time, answer);
        }
    }

    fn add_answer(&mut self, now: Instant, answer: Answer) {
        let Some(sending) = self.sendings.list.back() else { return };
        let (bus, frame) = (sending.bus, sending.composed.frames.first().copied());
        let profile = self.profile(bus);
        let device = self.bus(bus).and_then(|bus| bus.device_at(answer.from));
        let name = device.and_then(|it| it.name.as_ref()).map(ToString::to_string);
        let who = match &name {
            Some(name) => format!("{name} @{}", answer.from),
            None => format!("@{}", answer.from),
        };
        let text = answer_text(&answer, frame.as_ref(), &profile);
        if let Some(sending) = self.sendings.list.back_mut() {
            sending.add(SentAnswer { time: now, answer, who, name, text });
        }
        self.check_sending(now);
        self.request_redraw();
    }

    /// Ends the wait for answers if it is over.
    pub(super) fn step_sending(&mut self, now: Instant) {
        while let Some(answer) =
            self.sendings.list.back_mut().and_then(|it| it.collector.handle_timeout(now))
        {
            self.add_answer(now, answer);
        }
        self.check_sending(now);
    }

    /// When [`App::step_sending`] is due.
    pub(super) fn sending_timeout(&self) -> Option<Instant> {
        let sending = self.sendings.list.back()?;
        // A caller may wait for answers after the first.
        let now = self.clock.now();
        let is_due = |at: &Instant| sending.result.is_none() || *at > now;
        let closes = sending.closes_at().filter(is_due);
        let is_receiving = sending.collector.is_receiving();
        closes.filter(|_| !is_receiving).into_iter().chain(sending.collector.poll_timeout()).min()
    }

    fn check_sending(&mut self, now: Instant) {
        let Some(sending) = self.sendings.list.back_mut().filter(|it| it.result.is_none()) else {
            return;
        };
        if let Some(result) = sending.result_at(now) {
            sending.result = Some(result);
            self.report_sending(now, result);
        }
    }

    /// Ends the wait of the last sending: another one begins.
    fn finish_sending(&mut self) {
        let now = self.clock.now();
        if let Some(sending) = self.sendings.list.back_mut().filter(|it| it.result.is_none()) {
            let result = match sending.end {
                Some(end) if end != SequenceEnd::Complete => SendingResult::Ended(end),
                Some(_) if sending.errors > 0 => SendingResult::Refused,
                _ => SendingResult::Done,
            };
            sending.result = Some(result);
            self.report_sending(now, result);
        }
    }

    /// Adds the line of the timeline.
    fn report_sending(&mut self, now: Instant, result: SendingResult) {
        let Some(sending) = self.sendings.list.back() else { return };
        let kind = match result {
            SendingResult::Done if sending.answer_count > 0 => TimelineKind::Improved,
            SendingResult::Done | SendingResult::Ended(SequenceEnd::Stopped) => TimelineKind::Bus,
            _ => TimelineKind::Error,
        };
        let (bus, what) = (sending.bus, sending.outcome_text());
        let composed = &sending.composed;
        let receiver = match composed.receivers {
            Receivers::One(address) => Some(address),
            Receivers::All | Receivers::Unknown => None,
        };
        let text = format!("sent {} to {}: {what}", composed.frame_text(), composed.receiver);
        let mut line = TimelineEntry::new(now, kind, text).on(bus);
        let device = receiver.and_then(|at| self.bus(bus)?.device_at(at));
        (line.device, line.address) = (device.map(|it| it.id), receiver);
        line.name = device.and_then(|it| it.name.clone());
        self.report_line(line);
        if kind == TimelineKind::Error {
            self.show_error(what);
        } else {
            self.show_info(what);
        }
    }
}

impl SentFrames {
    /// What became of it, in words.
    pub fn outcome_text(&self) -> String {
        let copies = self.repeat.copies;
        let mut parts = Vec::new();
        if copies > 1 {
            parts.push(format!("{} of {copies} copies", self.copies));
        }
        match self.end {
            Some(SequenceEnd::Complete) | None => {}
            Some(SequenceEnd::Stopped) if self.receiver_change.is_some() => {
                let why = self.receiver_change.as_deref().unwrap_or_default();
                parts.push(format!("ended: {why}"));
            }
            Some(end) if copies > 1 => parts.push(format!("ended: {end}")),
            Some(end) => parts.push(format!("not sent: {end}")),
        }
        let only = self.answers.front().filter(|_| self.answer_count == 1 && copies == 1);
        if let Some(only) = only {
            parts.push(format!("{} after {}", only.text, format_millis(only.answer.latency)));
        } else if let Some((least, mean, most)) = self.latency() {
            parts.push(format!(
                "{} after {} to {}, mean {}",
                counted(u64::from(self.answer_count), "answer"),
                format_millis(least),
                format_millis(most),
                format_millis(mean)
            ));
            if self.errors > 0 {
                parts.push(counted(u64::from(self.errors), "error response"));
            }
        }
        let missing = self.copies.saturating_sub(self.answered);
        if self.end == Some(SequenceEnd::Complete) && missing > 0 && self.composed.may_be_answered()
        {
            let wait = match self.wait.as_millis() {
                millis @ 0..=999 => format!("{millis} ms"),
                _ => format_duration(self.wait),
            };
            match copies {
                1 => parts.push(format!("no answer within {wait}")),
                _ if self.composed.needs_answer() => {
                    parts.push(format!("{missing} without an answer within {wait}"));
                }
                _ => {}
            }
        }
        if parts.is_empty() {
            parts.push("on the bus".to_owned());
        }
        parts.join("; ")
    }
}

fn sequence_of(composed: &Composed, repeat: Repeat, renews_destination: bool) -> FrameSequence {
    FrameSequence {
        frames: composed.frames.clone(),
        copies: repeat.copies,
        interval: repeat.interval,
        renews_destination,
    }
}
