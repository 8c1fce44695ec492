//! The dialog in which a frame is composed: its fields as they are typed, the questions before it is sent,
//! the way back through what was sent.
//!
//! It keeps its content while it is closed. In a log, at a past moment and with `--listen-only` it only
//! shows the frame. Does not know how it is drawn.

use super::input::{Overlay, Question, line_request};
use super::{App, Effect, Page};
use crate::composer::{
    Composed, Composition, CompositionField, MessageKind, Mistake, Repeat, ServiceWord,
};
use crate::discovery::SequenceEnd;
use crate::frame::BusIndex;
use crate::keymap::{Action, Key, KeyCode};
use crate::time::{Duration, Instant};
use crate::wire::framing::Framing;
use tui_input::{Input as LineInput, InputRequest};

/// Longest text of a field, in bytes.
const MAX_FIELD: usize = 400;
/// Largest number of templates.
pub const MAX_TEMPLATES: usize = 99;
/// Time after the first question in which a key does not answer the second: it was meant for the first.
const SECOND_QUESTION_DELAY: Duration = Duration::from_millis(500);

/// A field of the dialog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DialogField {
    /// Kind of frame.
    Kind,
    /// Receiver.
    To,
    /// Service.
    Service,
    /// Data, or the whole raw frame.
    Data,
    /// Framing.
    Framing,
    /// Sender.
    From,
    /// CAN FD.
    Fd,
    /// Error response.
    Error,
    /// Number of copies.
    Copies,
    /// Milliseconds between two.
    Every,
}

impl DialogField {
    /// All fields, in the order of Tab.
    pub const ALL: [Self; 10] = [
        Self::Kind,
        Self::To,
        Self::Service,
        Self::Data,
        Self::Framing,
        Self::From,
        Self::Fd,
        Self::Error,
        Self::Copies,
        Self::Every,
    ];

    /// The field of the composition; `None`: it says how often it is sent.
    pub const fn of_composition(self) -> Option<CompositionField> {
        Some(match self {
            Self::Kind => CompositionField::Kind,
            Self::To => CompositionField::To,
            Self::Service => CompositionField::Service,
            Self::Data => CompositionField::Data,
            Self::Framing => CompositionField::Framing,
            Self::From => CompositionField::From,
            Self::Fd => CompositionField::Fd,
            Self::Error => CompositionField::Error,
            Self::Copies | Self::Every => return None,
        })
    }
}

/// The content of the dialog.
#[derive(Clone, Debug)]
pub struct ComposerDialog {
    /// Bus on which it is sent.
    pub bus: BusIndex,
    /// Kind of frame.
    pub kind: MessageKind,
    /// Framing; `None`: that of the receiver.
    pub framing: Option<Framing>,
    /// CAN FD.
    pub is_fd: bool,
    /// ERR = 0.
    pub is_error: bool,
    /// The field that keys change.
    pub focus: DialogField,
    to: LineInput,
    service: LineInput,
    data: LineInput,
    from: LineInput,
    copies: LineInput,
    every: LineInput,
    /// Place in the history, from the newest.
    recalled: Option<usize>,
    /// Place of the template that was opened.
    template: Option<usize>,
    pending: Option<PendingFrames>,
}

/// What the user is asked about.
#[derive(Clone, Debug)]
struct PendingFrames {
    composition: Composition,
    composed: Composed,
    repeat: Repeat,
    /// Time of the present question.
    asked: Instant,
}

impl ComposerDialog {
    fn new(bus: BusIndex, composition: &Composition) -> Self {
        let mut dialog = Self {
            bus,
            kind: MessageKind::Request,
            framing: None,
            is_fd: false,
            is_error: false,
            focus: DialogField::To,
            to: LineInput::default(),
            service: LineInput::default(),
            data: LineInput::default(),
            from: LineInput::default(),
            copies: LineInput::new("1".to_owned()),
            every: LineInput::new("1000".to_owned()),
            recalled: None,
            template: None,
            pending: None,
        };
        dialog.fill(composition);
        dialog
    }

    fn fill(&mut self, from: &Composition) {
        let line = |text: &str| LineInput::new(text.to_owned());
        (self.kind, self.framing) = (from.kind, from.framing);
        (self.is_fd, self.is_error) = (from.is_fd, from.is_error);
        (self.to, self.service) = (line(&from.to), line(&from.service));
        (self.data, self.from) = (line(&from.data), line(&from.from));
        if !self.has(self.focus) {
            self.focus = DialogField::Data;
        }
    }

    /// What is typed.
    pub fn composition(&self) -> Composition {
        let text = |line: &LineInput| line.value().trim_end().to_owned();
        Composition {
            kind: self.kind,
            to: text(&self.to),
            service: text(&self.service),
            data: text(&self.data),
            framing: self.framing,
            from: text(&self.from),
            is_error: self.is_error,
            is_fd: self.is_fd,
        }
    }

    /// How often it is sent.
    ///
    /// # Errors
    ///
    /// What is wrong with the numbers.
    pub fn repeat(&self) -> Result<Repeat, String> {
        Repeat::parse(self.copies.value(), self.every.value())
    }

    /// Returns true if frames of the kind are made from the field.
    pub fn has(&self, field: DialogField) -> bool {
        field.of_composition().is_none_or(|field| self.kind.has(field))
    }

    /// The line of a field; `None` for a choice.
    pub fn line(&self, field: DialogField) -> Option<&LineInput> {
        Some(match field {
            DialogField::To => &self.to,
            DialogField::Service => &self.service,
            DialogField::Data => &self.data,
            DialogField::From => &self.from,
            DialogField::Copies => &self.copies,
            DialogField::Every => &self.every,
            _ => return None,
        })
    }

    fn line_mut(&mut self, field: DialogField) -> Option<&mut LineInput> {
        Some(match field {
            DialogField::To => &mut self.to,
            DialogField::Service => &mut self.service,
            DialogField::Data => &mut self.data,
            DialogField::From => &mut self.from,
            DialogField::Copies => &mut self.copies,
            DialogField::Every => &mut self.every,
            _ => return None,
        })
    }

    /// Goes to the next field of the kind, or the one before.
    fn move_focus(&mut self, by: isize) {
        let all: Vec<DialogField> =
            DialogField::ALL.into_iter().filter(|field| self.has(*field)).collect();
        let at = all.iter().position(|field| *field == self.focus).unwrap_or(0);
        let next = (at.cast_signed() + by).rem_euclid(all.len().cast_signed());
        self.focus = all[next.cast_unsigned()];
    }

    /// Takes a key that is not bound: it is typed, or changes a choice.
    fn handle_key(&mut self, key: Key) {
        (self.recalled, self.template) = (None, None);
        let focus = self.focus;
        if let Some(line) = self.line_mut(focus) {
            let is_number = matches!(focus, DialogField::Copies | DialogField::Every);
            match line_request(key) {
                Some(InputRequest::InsertChar(c))
                    if line.value().len() >= MAX_FIELD || is_number && !c.is_ascii_digit() => {}
                Some(request) => {
                    line.handle(request);
                }
                None => {}
            }
            return;
        }
        let by = match key.code {
            KeyCode::Left => -1,
            KeyCode::Right | KeyCode::Char(' ') => 1,
            _ => return,
        };
        match focus {
            DialogField::Kind => {
                let at = MessageKind::ALL.iter().position(|kind| *kind == self.kind).unwrap_or(0);
                let count = MessageKind::ALL.len().cast_signed();
                let next = (at.cast_signed() + by).rem_euclid(count);
                self.kind = MessageKind::ALL[next.cast_unsigned()];
            }
            DialogField::Framing => {
                const ALL: [Option<Framing>; 3] = [None, Some(Framing::Isotp), Some(Framing::Raw)];
                let at = ALL.iter().position(|framing| *framing == self.framing).unwrap_or(0);
                self.framing = ALL[(at.cast_signed() + by).rem_euclid(3).cast_unsigned()];
            }
            DialogField::Fd => self.is_fd = !self.is_fd,
            DialogField::Error => self.is_error = !self.is_error,
            _ => {}
        }
    }
}

impl App {
    /// The dialog; `None` unless it is open, or a question about what it sends.
    pub fn composer_dialog(&self) -> Option<&ComposerDialog> {
        let is_open = matches!(
            self.overlay(),
            Overlay::Compose | Overlay::Question(Question::SendFrames { .. })
        );
        self.composer.as_deref().filter(|_| is_open)
    }

    /// The frames of the dialog.
    ///
    /// # Errors
    ///
    /// What is wrong with them.
    pub fn dialog_frames(&self, dialog: &ComposerDialog) -> Result<Composed, Mistake> {
        self.compose(dialog.bus, &dialog.composition())
    }

    /// Why the dialog only shows the frame; `None` if it can be sent.
    pub fn dialog_obstacle(&self, dialog: &ComposerDialog) -> Option<String> {
        if self.view.frozen.is_some() {
            let key = self.key_of_present();
            return Some(format!("frozen: {key} shows the present first"));
        }
        self.sending_obstacle(dialog.bus)
    }

    /// Opens the dialog: on Traffic with the selected frame, else as it was left; the first time with a
    /// request to the selected device.
    pub(super) fn open_composer(&mut self) {
        let frame = self.selected_frame().filter(|_| self.view.page == Page::Traffic);
        let row = self.selected_row().filter(|_| self.view.page == Page::Devices);
        let device = row.and_then(|row| self.device_of(row)).map(|it| (it.id.bus, it.address));
        let bus = frame.map(|it| it.bus).or(device.map(|(bus, _)| bus));
        let kept = self.composer.as_ref().map(|dialog| dialog.bus);
        let bus = bus.or(kept).unwrap_or(BusIndex(0));
        self.renew_random_destination(bus);
        let filled = frame.map(|frame| {
            self.with_surroundings(bus, |around| Composition::of_frame(&frame, around))
        });
        let mut dialog = match (filled, self.composer.take()) {
            (Some(Some(composition)), _) => ComposerDialog::new(bus, &composition),
            (Some(None), kept) => {
                self.composer = kept;
                return self.show_error("remote and error frames are not sent");
            }
            (None, Some(kept)) => *kept,
            (None, None) => ComposerDialog::new(
                bus,
                &Composition {
                    service: "des".to_owned(),
                    data: "name".to_owned(),
                    to: device.map(|(_, address)| format!("@{address}")).unwrap_or_default(),
                    ..Composition::default()
                },
            ),
        };
        dialog.bus = bus;
        self.composer = Some(Box::new(dialog));
        self.input.open(Overlay::Compose);
    }

    /// Takes a key in the dialog. Returns false if it is not open.
    pub(super) fn type_in_composer(&mut self, key: Key) -> bool {
        if !matches!(self.overlay(), Overlay::Compose) {
            return false;
        }
        if let Some(action) = self.input.lookup(key) {
            self.run(action);
        } else if let Some(dialog) = &mut self.composer {
            dialog.handle_key(key);
        }
        true
    }

    /// Takes pasted text in the dialog: its first line goes to the field.
    pub(super) fn paste_in_composer(&mut self, text: &str) {
        let Some(dialog) = self.composer.as_mut().filter(|_| self.input.is_composing()) else {
            return;
        };
        let line = text.trim().lines().next().unwrap_or_default();
        line.chars().for_each(|c| dialog.handle_key(Key::char(c)));
        self.notices.redraw.set_dirty();
    }

    /// Goes to another field.
    pub(super) fn move_in_composer(&mut self, by: isize) {
        if let Some(dialog) = &mut self.composer {
            dialog.move_focus(by);
        }
    }

    /// In the fields of the receiver and the service chooses another one that is known; in the others goes
    /// through what was sent.
    pub(super) fn recall_in_composer(&mut self, by: isize) {
        let Some(dialog) = &self.composer else { return };
        let (focus, bus, kind) = (dialog.focus, dialog.bus, dialog.kind);
        let words: Vec<String> = match focus {
            DialogField::To => {
                let all = ["all", "all working", "all not-working"].map(str::to_owned);
                let nodes = self.known_nodes(bus);
                let nodes = nodes.iter().map(|node| format!("@{}", node.address));
                nodes.chain(all.into_iter().filter(|_| kind == MessageKind::Request)).collect()
            }
            DialogField::Service => {
                let profile = self.shown_buses().profile(bus);
                ServiceWord::all(&profile, kind).into_iter().map(|it| it.word).collect()
            }
            _ => return self.recall_sent(by),
        };
        let Some(dialog) = &mut self.composer else { return };
        let Some(line) = dialog.line_mut(focus).filter(|_| !words.is_empty()) else { return };
        let at = words.iter().position(|word| word.eq_ignore_ascii_case(line.value().trim()));
        let next = match at {
            Some(at) => (at.cast_signed() + by).rem_euclid(words.len().cast_signed()),
            None if by > 0 => 0,
            None => words.len().cast_signed() - 1,
        };
        *line = LineInput::new(words[next.cast_unsigned()].clone());
    }

    fn recall_sent(&mut self, by: isize) {
        let all = self.sent_compositions();
        let Some(dialog) = &mut self.composer else { return };
        let last = all.len().cast_signed() - 1;
        // Up is older.
        let at = dialog.recalled.map_or(-1, usize::cast_signed) - by;
        if let Some(composition) = all.get(at.clamp(0, last.max(0)).cast_unsigned()) {
            dialog.fill(composition);
            dialog.recalled = Some(at.clamp(0, last).cast_unsigned());
        }
    }

    /// Saves what is composed as a template, unless its text has a mistake.
    pub(super) fn save_template(&mut self) {
        let Some(dialog) = &self.composer else { return };
        let (composition, bus) = (dialog.composition(), dialog.bus);
        if let Err(mistake) = self.compose(bus, &composition)
            && !mistake.is_of_bus
        {
            return self.show_error(mistake.text);
        }
        let words = composition.to_words();
        let key = self.key_of(Action::ComposeOpen);
        if self.templates.contains(&words) {
            return self.show_info(format!("template is saved already; {key} opens it"));
        }
        if self.templates.len() >= MAX_TEMPLATES {
            return self.show_error(format!("all {MAX_TEMPLATES} templates are saved"));
        }
        self.templates.push(words.clone());
        self.show_info(format!("template saved; {key} opens it"));
        self.effects.push_back(Effect::KeepTemplate(words));
    }

    /// Fills the dialog from the next template.
    pub(super) fn open_template(&mut self) {
        let all: Vec<Composition> =
            self.templates.iter().filter_map(|it| Composition::parse(it).ok()).collect();
        if all.is_empty() {
            let key = self.key_of(Action::ComposeSave);
            return self.show_error(format!("no template; {key} saves one"));
        }
        let Some(dialog) = &mut self.composer else { return };
        let next = dialog.template.map_or(0, |at| at + 1) % all.len();
        dialog.fill(&all[next]);
        dialog.template = Some(next);
        self.show_info(format!("template {} of {}", next + 1, all.len()));
    }

    /// Takes why a template was not stored by [`Effect::KeepTemplate`].
    pub fn handle_lost_template(&mut self, now: Instant, words: &str, why: &str) {
        self.clock.set(now);
        self.templates.retain(|it| it != words);
        self.show_error(format!("template not saved: {why}"));
    }

    /// Asks whether to send what is composed.
    pub(super) fn ask_to_send_frames(&mut self) {
        let Some(dialog) = &self.composer else { return };
        if let Some(why) = self.dialog_obstacle(dialog) {
            return self.show_error(why);
        }
        let (composition, repeat) = (dialog.composition(), dialog.repeat());
        let composed = self.compose(dialog.bus, &composition);
        let asked = self.clock.now();
        match (composed, repeat) {
            (Ok(composed), Ok(repeat)) => {
                if let Some(dialog) = &mut self.composer {
                    dialog.pending = Some(PendingFrames { composition, composed, repeat, asked });
                }
                self.input.ask(Question::SendFrames { is_about_source: false });
            }
            (Err(mistake), _) => {
                let of = |field: &DialogField| field.of_composition() == Some(mistake.field);
                let field = DialogField::ALL.into_iter().find(of);
                if let (Some(dialog), Some(field)) = (&mut self.composer, field) {
                    dialog.focus = field;
                }
                self.show_error(mistake.text);
            }
            (_, Err(why)) => self.show_error(why),
        }
    }

    /// The question about the frames.
    pub(super) fn frames_question(&self, is_about_source: bool) -> String {
        let pending = self.composer.as_ref().and_then(|it| Some((it.bus, it.pending.as_ref()?)));
        let Some((bus, pending)) = pending else { return String::new() };
        if is_about_source {
            return format!("{}. Send it?", pending.composed.source_warning);
        }
        let (sent, effect) = self.sending_sentences(bus, &pending.composed, pending.repeat);
        format!("{sent}? {effect}")
    }

    /// Takes the answer to a question about the frames, and returns to the dialog.
    pub(super) fn confirm_frames(&mut self, is_about_source: bool, yes: bool) {
        self.input.open(Overlay::Compose);
        let now = self.clock.now();
        let Some(dialog) = &mut self.composer else { return };
        let Some(mut pending) = dialog.pending.take().filter(|_| yes) else { return };
        let is_foreign = pending.composed.foreign_source.is_some();
        let is_early = is_about_source && now.since(pending.asked) < SECOND_QUESTION_DELAY;
        if is_foreign && (!is_about_source || is_early) {
            if !is_about_source {
                pending.asked = now;
            }
            dialog.pending = Some(pending);
            return self.input.ask(Question::SendFrames { is_about_source: true });
        }
        let (bus, PendingFrames { composition, composed, repeat, .. }) = (dialog.bus, pending);
        if let Err(why) = self.send_composed(bus, &composition, &composed, repeat, None) {
            self.show_error(why);
        }
    }

    /// Stops sending, or closes the dialog.
    pub(super) fn close_composer(&mut self) {
        if self.stop_sending() {
            let end = SequenceEnd::Stopped;
            return self.show_info(format!("sending {end}"));
        }
        self.input.close();
    }
}
