//! `descan send`: one composed frame or request. Waits until the receiver is known, says what is sent,
//! asks, sends, and prints the answers as they come.

use super::headless::warn_foreign;
use super::one_bus::{self, CommandRun};
use super::open::{self, Setup};
use super::output::{self, answer, ask, may_ask, say};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure};
use crate::app::{App, SendingResult, SentAnswer, SentFrames, format_millis};
use crate::cli::SendArgs;
use crate::composer::{Composed, Composition, CompositionField, Mistake, Repeat, Surroundings};
use crate::discovery::{OwnAddress, SequenceEnd};
use crate::frame::BusIndex;
use crate::text::hex;
use crate::time::Instant;
use crate::wire::id::{Address, Header};
use serde::Serialize;
use std::sync::mpsc::{Receiver, TryRecvError};

/// The bus; there is one.
const BUS: BusIndex = BusIndex(0);

/// How far it is.
enum SendStage {
    /// The receiver, or descan's own address, is not known yet.
    Searching,
    /// The user is asked; the second question is that about the source.
    Asking { composed: Box<Composed>, is_about_source: bool, answer: Receiver<bool> },
    /// Frames are sent, answers awaited.
    Sending,
    /// The user said no.
    Declined,
    /// It is done.
    Done,
}

/// Runs it.
pub fn run(args: &SendArgs) -> Result<u8, Failure> {
    let words = Composition::join_arguments(&args.words);
    let composition = Composition::parse(&words).map_err(|why| usage(&words, &why, true))?;
    let repeat = Repeat::new(args.repeat, args.every).map_err(Failure::Usage)?;
    let buses = std::slice::from_ref(&args.bus);
    if open::log(buses, "send", None)?.is_some() {
        return Err(Failure::Usage("a log has no bus to send to".to_owned()));
    }
    let setup = Setup::for_buses(&args.common, buses)?;
    // Mistakes of the text, before the bus is opened.
    let around = Surroundings { profile: &setup.config.profile, own: None, nodes: &[], rnd7: 0 };
    let needs_devices = match composition.compose(around) {
        Ok(composed) => composed.may_be_answered(),
        // The device may be found.
        Err(why) if why.is_of_bus => true,
        Err(why) => return Err(usage(&words, &why, false)),
    };
    if args.common.listen_only {
        return Err(Failure::Unusable("listen-only: no frames are sent".to_owned()));
    }
    if !args.yes && !may_ask() {
        let text = "it asks before it sends, and there is no terminal: give --yes";
        return Err(Failure::Usage(text.to_owned()));
    }
    let mut sender = FrameSender {
        args,
        composition,
        repeat,
        needs_devices,
        stage: SendStage::Searching,
        printed: Printed::default(),
    };
    let CommandRun { app, is_interrupted } =
        one_bus::run(&args.bus, setup, args.time, |app, now, end| {
            sender.advance(app, now >= end, now)?;
            Ok(matches!(sender.stage, SendStage::Done | SendStage::Declined))
        })?;
    if is_interrupted {
        sender.print_interrupted(&app)?;
        return Ok(EXIT_INTERRUPTED);
    }
    if matches!(sender.stage, SendStage::Done) {
        return sender.finish(&app);
    }
    say("nothing was sent");
    Ok(EXIT_FINDINGS)
}

/// A mistake in the words; `is_of_words`: its column is that in the words.
fn usage(words: &str, why: &Mistake, is_of_words: bool) -> Failure {
    let place = match why.field {
        CompositionField::Kind if is_of_words && why.column > 0 => {
            format!(" (column {} of \"{words}\")", why.column + 1)
        }
        _ => String::new(),
    };
    Failure::Usage(format!("{why}{place}"))
}

/// How much of a sending is printed.
#[derive(Default)]
struct Printed {
    is_begun: bool,
    answers: u32,
}

struct FrameSender<'a> {
    args: &'a SendArgs,
    composition: Composition,
    repeat: Repeat,
    needs_devices: bool,
    stage: SendStage,
    printed: Printed,
}

impl FrameSender<'_> {
    /// Takes the next step, if it is time for it.
    fn advance(&mut self, app: &mut App, is_last: bool, now: Instant) -> Result<(), Failure> {
        let next = match &mut self.stage {
            SendStage::Searching => match self.composed(app, is_last)? {
                Some(composed) => self.begin(app, composed)?,
                None => return Ok(()),
            },
            SendStage::Asking { composed, is_about_source, answer } => match answer.try_recv() {
                Ok(true) if !*is_about_source && composed.foreign_source.is_some() => {
                    let composed = composed.clone();
                    ask(format!("{}. Send it? [y/N]", composed.source_warning));
                    SendStage::Asking { composed, is_about_source: true, answer: self::answer() }
                }
                Ok(true) => {
                    let composed = composed.clone();
                    self.start(app, &composed)?
                }
                Ok(false) | Err(TryRecvError::Disconnected) => SendStage::Declined,
                Err(TryRecvError::Empty) => return Ok(()),
            },
            SendStage::Sending => {
                let Some(sending) = app.sent_frames().next_back() else { return Ok(()) };
                print_answers(sending, app, self.args.json, &mut self.printed)?;
                if !self.is_over(sending, now) {
                    return Ok(());
                }
                SendStage::Done
            }
            SendStage::Declined | SendStage::Done => return Ok(()),
        };
        self.stage = next;
        Ok(())
    }

    /// Makes the frames, once the receiver and descan's own address are known; `is_last`: as far as they
    /// are.
    fn composed(&self, app: &mut App, is_last: bool) -> Result<Option<Composed>, Failure> {
        let Some(bus) = app.bus(BUS) else { return Ok(None) };
        let is_held = matches!(bus.own_address(), OwnAddress::Held(_));
        // Framing and mode of the receiver are known then, and no round mixes with the answers.
        let is_ready = is_held && (bus.progress().is_complete || !self.needs_devices);
        if !is_ready && !is_last {
            return Ok(None);
        }
        if let Some(why) = app.sending_obstacle(BUS) {
            warn_foreign(app, &mut Vec::new());
            return Err(Failure::Unusable(why));
        }
        app.renew_random_destination(BUS);
        let composed = app.compose(BUS, &self.composition);
        // A receiver that is not there is a fact of the bus; the rest is wrong in any world.
        composed.map(Some).map_err(|why| match why.field {
            CompositionField::To if !why.text.starts_with("several") => Failure::Unusable(why.text),
            _ => Failure::Usage(why.text),
        })
    }

    /// Asks, or sends at once.
    fn begin(&self, app: &mut App, composed: Composed) -> Result<SendStage, Failure> {
        let (sent, effect) = app.sending_sentences(BUS, &composed, self.repeat);
        let effect = if effect.is_empty() { effect } else { format!(" {effect}") };
        let meaning = &composed.meaning;
        if self.args.yes {
            let source = &composed.source_warning;
            let source = if source.is_empty() { String::new() } else { format!(" {source}.") };
            say(format!("{sent}: {meaning}.{effect}{source}"));
            return self.start(app, &composed);
        }
        ask(format!("{sent}? {meaning}.{effect} [y/N]"));
        let composed = Box::new(composed);
        Ok(SendStage::Asking { composed, is_about_source: false, answer: answer() })
    }

    fn start(&self, app: &mut App, composed: &Composed) -> Result<SendStage, Failure> {
        let wait = self.args.wait;
        app.send_composed(BUS, &self.composition, composed, self.repeat, wait)
            .map_err(Failure::Unusable)?;
        Ok(SendStage::Sending)
    }

    /// Returns true if nothing more is to be printed.
    fn is_over(&self, sending: &SentFrames, now: Instant) -> bool {
        let Some(wait) = self.args.wait else { return sending.result.is_some() };
        let is_failed = sending.end.is_some_and(|end| end != SequenceEnd::Complete);
        let is_waited = sending.last_sent.is_some_and(|at| now >= at + wait);
        sending.result.is_some() && (is_failed || is_waited)
    }

    fn print_interrupted(&self, app: &App) -> Result<(), Failure> {
        let Some(sending) = app.sent_frames().next_back() else { return Ok(()) };
        if self.args.json {
            return print_line(&end_json(sending, "interrupted"));
        }
        say(format!("interrupted: {}", sending.outcome_text()));
        Ok(())
    }

    /// Prints what became of it.
    fn finish(&mut self, app: &App) -> Result<u8, Failure> {
        let Some(sending) = app.sent_frames().next_back() else { return Ok(EXIT_FINDINGS) };
        print_answers(sending, app, self.args.json, &mut self.printed)?;
        let result = sending.result.unwrap_or(SendingResult::NoAnswer);
        let outcome = match result {
            SendingResult::Done if sending.answer_count > 0 => "answered",
            SendingResult::Refused => "error-response",
            SendingResult::NoAnswer => "no-answer",
            SendingResult::Done | SendingResult::Ended(SequenceEnd::Complete) => "sent",
            SendingResult::Ended(_) if sending.copies > 0 => "stopped",
            SendingResult::Ended(_) => "not-sent",
        };
        if self.args.json {
            print_line(&end_json(sending, outcome))?;
        } else if self.repeat.copies > 1 || sending.answer_count != 1 {
            output::print(&format!("{}\n", sending.outcome_text()))?;
        }
        match result {
            SendingResult::Done => Ok(EXIT_OK),
            SendingResult::Refused | SendingResult::NoAnswer => Ok(EXIT_FINDINGS),
            SendingResult::Ended(_) => Err(Failure::Unusable(sending.outcome_text())),
        }
    }
}

/// Prints what is new: the frame, then its answers.
fn print_answers(
    sending: &SentFrames,
    app: &App,
    is_json: bool,
    printed: &mut Printed,
) -> Result<(), Failure> {
    if sending.last_sent.is_some() && !std::mem::replace(&mut printed.is_begun, true) {
        print_sent(sending, app, is_json)?;
    }
    let new = (sending.answer_count - printed.answers) as usize;
    let skipped = sending.answers.len().saturating_sub(new);
    for answer in sending.answers.iter().skip(skipped) {
        if is_json {
            print_line(&answer_json(sending, answer, app))?;
        } else {
            let copy = if sending.repeat.copies > 1 {
                format!("{:4}  ", answer.answer.copy)
            } else {
                String::new()
            };
            let latency = format_millis(answer.answer.latency);
            output::print(&format!("{copy}{}  {latency}  {}\n", answer.who, answer.text))?;
        }
    }
    printed.answers = sending.answer_count;
    Ok(())
}

fn print_sent(sending: &SentFrames, app: &App, is_json: bool) -> Result<(), Failure> {
    let composed = &sending.composed;
    if !is_json {
        return output::print(&format!("sent {}\n", composed.frame_text()));
    }
    print_line(&SentJson {
        event: "sent",
        time: app.epoch().unix_secs(sending.last_sent.unwrap_or(sending.asked)),
        descan: env!("CARGO_PKG_VERSION"),
        bus: app.bus(sending.bus).map_or("", |bus| &bus.name),
        words: sending.composition.to_words(),
        frames: composed.frames.iter().map(ToString::to_string).collect(),
        meaning: &composed.meaning,
        change: composed.change.as_deref(),
        warnings: &composed.warnings,
        foreign_source: composed.foreign_source.map(Address::number),
        repeat: sending.repeat.copies,
    })
}

fn answer_json<'a>(sending: &SentFrames, answer: &'a SentAnswer, app: &App) -> AnswerJson<'a> {
    let request = sending.composed.frames.first().and_then(crate::frame::Frame::platform_id);
    let it = &answer.answer;
    AnswerJson {
        event: "answer",
        time: app.epoch().unix_secs(answer.time),
        copy: it.copy,
        address: it.from.number(),
        name: answer.name.as_deref(),
        service: request.map(|id| Header::decode(id).service.number()),
        latency_ms: (it.latency.as_secs_f64() * 1e6).round() / 1e3,
        error: it.is_error,
        complete: !it.is_incomplete,
        framing: it.framing.map(|framing| framing.to_string()),
        data: hex(&it.message, ""),
        text: &answer.text,
    }
}

fn end_json(sending: &SentFrames, outcome: &'static str) -> EndJson {
    let latency = sending.latency().map(|(least, mean, most)| {
        [least, mean, most].map(|it| (it.as_secs_f64() * 1e6).round() / 1e3)
    });
    EndJson {
        event: "end",
        outcome,
        sent: sending.copies,
        answers: sending.answer_count,
        errors: sending.errors,
        unanswered: sending
            .composed
            .needs_answer()
            .then(|| sending.copies.saturating_sub(sending.answered)),
        latency_ms: latency,
        text: sending.outcome_text(),
    }
}

fn print_line(object: &impl Serialize) -> Result<(), Failure> {
    let line = serde_json::to_string(object).map_err(anyhow::Error::from)?;
    output::print_json(&(line + "\n"))
}

/// What was sent, as JSON.
#[derive(Serialize)]
struct SentJson<'a> {
    event: &'static str,
    time: f64,
    descan: &'static str,
    bus: &'a str,
    words: String,
    frames: Vec<String>,
    meaning: &'a str,
    change: Option<&'a str>,
    warnings: &'a [String],
    foreign_source: Option<u8>,
    repeat: u32,
}

/// An answer, as JSON.
#[derive(Serialize)]
struct AnswerJson<'a> {
    event: &'static str,
    time: f64,
    copy: u32,
    address: u8,
    name: Option<&'a str>,
    service: Option<u16>,
    latency_ms: f64,
    error: bool,
    complete: bool,
    framing: Option<String>,
    data: String,
    text: &'a str,
}

/// The end of a sending, as JSON.
#[derive(Serialize)]
struct EndJson {
    event: &'static str,
    /// `answered`, `sent`, `error-response`, `no-answer`, `stopped`, `not-sent` or `interrupted`.
    outcome: &'static str,
    sent: u32,
    answers: u32,
    errors: u32,
    /// Copies to one device without an answer; `null` for other frames.
    unanswered: Option<u32>,
    /// Shortest, mean, longest.
    latency_ms: Option<[f64; 3]>,
    text: String,
}
