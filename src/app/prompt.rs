//! Lines being typed: the filter, an address in its row, a name, a new entry, a path.
//!
//! What is typed is checked as it is typed ([`Verdict`]); Enter does what the prompt is for, Esc
//! leaves everything as it was. A prompt refers to what it edits by key, so that it survives a
//! change of the file under it.

use super::matching::is_for;
use super::{App, Effect, Filter, Overlay, Page, RowKey};
use crate::discovery::DeviceId;
use crate::document::{Document, Entry, EntryKey, NewEntry, Operation};
use crate::keymap::{Key, KeyCode, KeyMode};
use crate::log::LogEntry;
use crate::text::{Quoted, is_printable};
use std::fmt::Write;
use std::path::PathBuf;
use tui_input::{Input, InputRequest};

/// A line being typed.
#[derive(Clone, Debug)]
pub struct Prompt {
    /// What it is for.
    pub kind: PromptKind,
    /// The text and the cursor in it.
    pub input: Input,
    /// The text is what was there before: the first character typed takes its place.
    pub untouched: bool,
    /// The text it was opened with.
    before: String,
    /// What the file said then.
    on: Document,
    /// The place in it of the entry that is edited; none where the device was not listed.
    place: Option<usize>,
}

/// What a line is typed for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PromptKind {
    /// The filter of a page, and what it was before.
    Filter(Page, String),
    /// The static address of a device or an entry, in its row.
    Address(RowKey),
    /// Another name for an entry.
    Rename(EntryKey),
    /// Name and address of a new entry.
    NewEntry,
    /// Where to save the captured frames.
    CapturePath,
    /// Where to write a copy of des.json with all edits.
    CopyPath,
}

impl PromptKind {
    /// What stands before the line.
    pub const fn label(&self) -> &'static str {
        match self {
            PromptKind::Filter(..) => "filter",
            PromptKind::Address(_) => "static address",
            PromptKind::Rename(_) => "name",
            PromptKind::NewEntry => "new entry: name address",
            PromptKind::CapturePath => "save frames to",
            PromptKind::CopyPath => "save a copy as",
        }
    }

    /// The same in few words, for a narrow screen.
    pub const fn short_label(&self) -> &'static str {
        match self {
            PromptKind::NewEntry => "name address",
            PromptKind::CapturePath => "frames to",
            PromptKind::CopyPath => "copy as",
            _ => self.label(),
        }
    }

    /// It is a path, which differs from others at both ends.
    pub const fn is_path(&self) -> bool {
        matches!(self, PromptKind::CapturePath | PromptKind::CopyPath)
    }

    /// It edits des.json.
    const fn edits(&self) -> bool {
        matches!(self, PromptKind::Address(_) | PromptKind::Rename(_) | PromptKind::NewEntry)
    }
}

/// What Enter does where the whole file went while a line was typed.
const BEGINS: &str = "Enter creates a new file";

/// What is to be said of the text so far.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InputCheck {
    /// Nothing, or what Enter will do.
    Accepted(String),
    /// Enter works, but look at this.
    Warning(String),
    /// Enter does nothing, because of this.
    Rejected(String),
}

impl App {
    pub(super) fn open_prompt(&mut self, kind: PromptKind, text: String) {
        let untouched = matches!(kind, PromptKind::Address(_)) && !text.is_empty();
        let place = match &kind {
            PromptKind::Address(RowKey::Device(id)) => self.matching.entry_of(*id),
            PromptKind::Address(RowKey::Entry(key)) | PromptKind::Rename(key) => {
                self.file.document().find(key)
            }
            _ => None,
        };
        let (input, before, on) = (Input::new(text.clone()), text, self.file.document().clone());
        self.overlay = Overlay::Prompt(Prompt { kind, input, untouched, before, on, place });
        self.dirty = true;
    }

    /// The line being typed.
    pub fn prompt(&self) -> Option<&Prompt> {
        match &self.overlay {
            Overlay::Prompt(prompt) => Some(prompt),
            _ => None,
        }
    }

    /// What is to be said of the line being typed.
    pub fn verdict(&self) -> Option<InputCheck> {
        let prompt = self.prompt()?;
        let text = prompt.input.value().trim();
        let place = || self.edited_entry(prompt).map(|entry| entry.index);
        if prompt.kind.edits()
            && let Err(refusal) = self.file.check_edit(place())
        {
            return Some(InputCheck::Rejected(refusal.to_string()));
        }
        Some(match &prompt.kind {
            PromptKind::Filter(page, _) => {
                InputCheck::Accepted(Filter::syntax_hint(*page).to_owned())
            }
            PromptKind::Address(key) => match self.judge_address(prompt, key, text) {
                InputCheck::Rejected(why) => InputCheck::Rejected(why),
                verdict => self.check_concurrent_change(prompt, text).unwrap_or(verdict),
            },
            PromptKind::Rename(key) => self.judge_rename(prompt, key, text),
            PromptKind::NewEntry => match (self.judge_new_entry(text), self.file_gone(prompt)) {
                (InputCheck::Rejected(why), _) => InputCheck::Rejected(why),
                (_, Some(gone)) => InputCheck::Warning(format!("{gone}; {BEGINS}")),
                (verdict, None) => verdict,
            },
            PromptKind::CapturePath | PromptKind::CopyPath if text.is_empty() => {
                InputCheck::Rejected("a path is needed".to_owned())
            }
            PromptKind::CapturePath => {
                let frames = self.capture.end() - self.capture.first();
                InputCheck::Accepted(format!("{frames} frames, candump format"))
            }
            PromptKind::CopyPath => match self.file.with_all_edits().entries().len() {
                1 => InputCheck::Accepted("1 entry".to_owned()),
                entries => InputCheck::Accepted(format!("{entries} entries")),
            },
        })
    }

    /// A key while a line is typed.
    pub(super) fn type_key(&mut self, key: Key) {
        if key.ctrl
            && let Some(action) = self.keymap.lookup(KeyMode::Browse, key)
            && action.is_global()
        {
            self.run(action);
            return;
        }
        match key.code {
            KeyCode::Enter => self.finish_prompt(),
            KeyCode::Esc => self.leave_prompt(),
            KeyCode::Tab if self.is_in_name() => {
                self.change_input(&[InputRequest::InsertChar(' ')]);
            }
            KeyCode::Tab => self.edit_on_next_bus(),
            _ => {
                if let Some(request) = request(key) {
                    self.change_input(&[request]);
                }
            }
        }
    }

    /// The address on the next of a device's redundant buses is edited instead; what was typed is
    /// dropped.
    fn edit_on_next_bus(&mut self) {
        let Some(PromptKind::Address(RowKey::Device(now))) = self.prompt().map(|it| &it.kind)
        else {
            return;
        };
        let row = self.rows.iter().find(|row| row.has(*now));
        let all: Vec<DeviceId> =
            row.map(|row| self.devices_of(row).map(|it| it.id).collect()).unwrap_or_default();
        let at = all.iter().position(|id| id == now).map_or(0, |at| at + 1);
        let next = all.get(at).or(all.first()).copied().filter(|next| next != now);
        if let Some(next) = next {
            let key = RowKey::Device(next);
            let text = self.pinned_text(&key);
            self.open_prompt(PromptKind::Address(key), text);
        }
    }

    /// A new entry's name is being typed: Tab goes on to its address, as a space does.
    fn is_in_name(&self) -> bool {
        self.prompt().is_some_and(|prompt| {
            let text = prompt.input.value();
            prompt.kind == PromptKind::NewEntry && !text.is_empty() && !text.ends_with(' ')
        })
    }

    /// What stands before the line being typed.
    pub fn prompt_label(&self) -> Option<String> {
        let prompt = self.prompt()?;
        let label = prompt.kind.label();
        let PromptKind::Address(RowKey::Device(id)) = prompt.kind else {
            return Some(label.to_owned());
        };
        let joined = self.rows.iter().any(|row| row.has(id) && !row.also.is_empty());
        let bus = self.bus(id.bus).filter(|_| joined);
        Some(bus.map_or(label.to_owned(), |bus| format!("{label} on {} (Tab: next)", bus.name)))
    }

    pub(super) fn paste(&mut self, text: &str) {
        let line = text.trim().lines().next().unwrap_or_default();
        let printable = line.chars().filter(|&c| is_printable(c));
        let requests: Vec<InputRequest> = printable.map(InputRequest::InsertChar).collect();
        self.change_input(&requests);
    }

    fn change_input(&mut self, requests: &[InputRequest]) {
        const LONGEST: usize = 1000;
        let Overlay::Prompt(prompt) = &mut self.overlay else { return };
        for &request in requests {
            let grows = matches!(request, InputRequest::InsertChar(_));
            if std::mem::take(&mut prompt.untouched) && grows {
                prompt.input.reset();
            }
            if !grows || prompt.input.value().len() < LONGEST {
                prompt.input.handle(request);
            }
        }
        self.dirty = true;
        if let PromptKind::Filter(page, _) = prompt.kind {
            let text = prompt.input.value().to_owned();
            self.apply_filter(page, text);
        }
    }

    fn apply_filter(&mut self, page: Page, text: String) {
        self.view.set_filter(page, text);
        self.refresh();
        self.filter_frames();
    }

    pub(super) fn leave_prompt(&mut self) {
        if let Overlay::Prompt(Prompt { kind: PromptKind::Filter(page, before), .. }) =
            std::mem::take(&mut self.overlay)
        {
            self.apply_filter(page, before);
        }
    }

    fn finish_prompt(&mut self) {
        if let Some(InputCheck::Rejected(_)) = self.verdict() {
            self.effects.push_back(Effect::Bell);
            if self.prompt().is_some_and(|prompt| prompt.kind.edits())
                && self.file.conflict().is_some()
            {
                self.show_conflict();
            }
            return;
        }
        let Overlay::Prompt(prompt) = std::mem::take(&mut self.overlay) else { return };
        let text = prompt.input.value().trim().to_owned();
        match prompt.kind {
            PromptKind::Filter(page, _) => {
                let mistake = Filter::parse(&text).error();
                self.apply_filter(page, text);
                if let Some(mistake) = mistake {
                    self.show_error(mistake);
                }
            }
            PromptKind::Address(ref key) => self.finish_address(&prompt, key, &text),
            PromptKind::Rename(ref key) => {
                let Ok(to) = unescaped(&text) else { return };
                // Its address or its name may have been changed under us.
                let Some(entry) = self.edited_entry(&prompt) else { return };
                if entry.name != to {
                    let entry = self.file.document().key(entry.index);
                    self.edit(&[Operation::Rename { entry, to }]);
                } else if key.name != to {
                    let told = format!("already {}", renamed(entry));
                    self.say_of_file(told);
                }
            }
            PromptKind::NewEntry => {
                let Ok((name, address)) = split_new_entry(&text) else { return };
                let bus = self.bus_to_name(self.selected_row().and_then(|row| row.bus));
                let is_static = address.is_some();
                let entry = NewEntry { name, address, is_static, bus, ..NewEntry::default() };
                self.edit(&[Operation::Add { entry: entry.clone() }]);
                self.select_entry(&entry.name, entry.address);
            }
            PromptKind::CapturePath => {
                let (path, bytes) = (PathBuf::from(text), self.candump_log().into_bytes());
                self.effects.push_back(Effect::WriteFile { path, bytes });
            }
            PromptKind::CopyPath => {
                let (path, document) = (PathBuf::from(text), self.file.with_all_edits());
                let bytes = document.source().to_vec();
                self.copy_pending = Some((path.clone(), document));
                self.effects.push_back(Effect::WriteFile { path, bytes });
            }
        }
    }

    // ---- the address of a row --------------------------------------------------------------

    /// The entry of a row.
    fn entry_for(&self, key: &RowKey) -> Option<&Entry> {
        let document = self.file.document();
        let at = match key {
            RowKey::Device(id) => self.matching.entry_of(*id),
            RowKey::Entry(key) => document.find(key),
        };
        document.entries().get(at?)
    }

    /// The entry that a prompt edits, as it is now: a device's, or what the entry has become that
    /// the line was opened on.
    fn edited_entry(&self, prompt: &Prompt) -> Option<&Entry> {
        if let PromptKind::Address(key @ RowKey::Device(_)) = &prompt.kind {
            return self.entry_for(key);
        }
        self.entry_after_change(prompt)
    }

    /// What the entry has become that a line was opened on.
    fn entry_after_change(&self, prompt: &Prompt) -> Option<&Entry> {
        let document = self.file.document();
        document.entries().get(prompt.on.counterpart(prompt.place?, document)?)
    }

    /// Where there was something in the file when the line was opened, and there is not any more:
    /// what became of it.
    fn file_gone(&self, prompt: &Prompt) -> Option<String> {
        let name = self.file.name();
        if prompt.on.is_blank() {
            None
        } else if !self.file.is_there() {
            Some(format!("{name} was deleted"))
        } else {
            self.file.document().is_blank().then(|| format!("{name} is empty now"))
        }
    }

    /// What became of an entry that was there when the line was opened.
    fn entry_gone(&self, prompt: &Prompt) -> String {
        if let Some(gone) = self.file_gone(prompt) {
            return gone;
        }
        let before = prompt.place.and_then(|at| prompt.on.entries().get(at));
        match self.entry_after_change(prompt) {
            Some(entry) if before.is_some_and(|before| before.name != entry.name) => {
                format!("entry {}", renamed(entry))
            }
            // A twin may have come, or what they changed fits another device better.
            Some(_) => "entry may belong to another device now".to_owned(),
            None => "entry deleted on disk".to_owned(),
        }
    }

    /// What the file pins a row to, as the line is opened with it.
    pub(super) fn pinned_text(&self, key: &RowKey) -> String {
        pinned(self.entry_for(key))
    }

    /// Whether somebody else changed the entry while its address was typed, or the whole file.
    fn check_concurrent_change(&self, prompt: &Prompt, text: &str) -> Option<InputCheck> {
        let entry = self.edited_entry(prompt);
        let gone = self.file_gone(prompt).map(|gone| (gone, BEGINS));
        let unlisted = || (self.entry_gone(prompt), "Enter adds it again");
        let gone = gone.or_else(|| prompt.place.is_some().then(unlisted));
        if let Some((gone, what)) = gone.filter(|_| entry.is_none()) {
            let told = if text.is_empty() { gone } else { format!("{gone}; {what}") };
            return Some(InputCheck::Warning(told));
        }
        let before = prompt.place.and_then(|at| prompt.on.entries().get(at));
        if let Some((now, typed)) = entry.zip(parse_address(text))
            && before.is_some_and(|before| before.name != now.name)
        {
            // It may as well be another one that somebody put in its place.
            let told = format!("entry {}; Enter pins it to {typed}", renamed(now));
            return Some(InputCheck::Warning(told));
        }
        let theirs = self.pinned_by_others(prompt)?;
        let typed = parse_address(text).map(|it| it.to_string()).unwrap_or_default();
        Some(if typed == pinned(entry) {
            InputCheck::Accepted(format!("already {theirs}"))
        } else {
            InputCheck::Warning(format!("{theirs}; Enter overwrites it"))
        })
    }

    /// Where somebody else pinned it elsewhere while an address was typed: what they did.
    fn pinned_by_others(&self, prompt: &Prompt) -> Option<String> {
        let now = pinned(self.edited_entry(prompt));
        let theirs = match now.as_str() {
            now if now == prompt.before => return None,
            "" => "unpinned".to_owned(),
            now => format!("changed to {now}"),
        };
        Some(format!("{theirs} on disk"))
    }

    fn judge_rename(&self, prompt: &Prompt, key: &EntryKey, text: &str) -> InputCheck {
        let Some(entry) = self.edited_entry(prompt) else {
            return InputCheck::Rejected(self.entry_gone(prompt));
        };
        let verdict = judge_name(text);
        if entry.name == key.name || matches!(verdict, InputCheck::Rejected(_)) {
            return verdict;
        }
        let theirs = renamed(entry);
        if unescaped(text).as_ref() == Ok(&entry.name) {
            InputCheck::Accepted(format!("already {theirs}"))
        } else {
            InputCheck::Warning(format!("{theirs}; Enter overwrites it"))
        }
    }

    fn judge_address(&self, prompt: &Prompt, key: &RowKey, text: &str) -> InputCheck {
        let entry = self.edited_entry(prompt);
        if entry.is_none() && matches!(key, RowKey::Entry(_)) {
            return InputCheck::Rejected(self.entry_gone(prompt));
        }
        if text.is_empty() {
            return match entry {
                Some(entry) if entry.is_static => {
                    InputCheck::Accepted("empty: Enter unpins it".to_owned())
                }
                _ => InputCheck::Accepted("1 to 127, decimal or 0x…".to_owned()),
            };
        }
        let Some(address) = parse_address(text) else {
            return InputCheck::Rejected("not an address: 1 to 127, or 0x01 to 0x7F".to_owned());
        };
        let device = match key {
            RowKey::Device(id) => self.device(*id),
            RowKey::Entry(_) => None,
        };
        if device.is_some_and(|device| device.name.is_none()) {
            return InputCheck::Rejected("name not known yet".to_owned());
        }
        let bus = device.and_then(|it| self.bus(it.id.bus)).map(|bus| bus.name.as_str());
        let bus = bus.or(entry.and_then(|entry| entry.bus.as_deref()));
        let own = entry.map(|entry| entry.index);
        if let Some(blocked) = self.pinned_elsewhere(address, bus, own) {
            return blocked;
        }
        let own = |id| match key {
            RowKey::Device(own) => *own == id,
            RowKey::Entry(_) => false,
        };
        let is_pinned = entry.is_some_and(|it| it.is_static && it.address == Some(address));
        self.address_in_use(address, bus, own).unwrap_or_else(|| {
            InputCheck::Accepted(if is_pinned {
                format!("already pinned to {address}")
            } else {
                format!("Enter pins it to {address}")
            })
        })
    }

    fn pinned_elsewhere(
        &self,
        address: u8,
        bus: Option<&str>,
        own: Option<usize>,
    ) -> Option<InputCheck> {
        let other = self.file.document().entries().iter().find(|entry| {
            Some(entry.index) != own
                && entry.is_static
                && entry.address == Some(address)
                && bus.is_none_or(|bus| is_for(entry, bus))
        })?;
        let line = other.position.line;
        let name = Quoted(&other.name);
        Some(InputCheck::Rejected(format!(
            "{address} is the static address of {name} (line {line})"
        )))
    }

    fn address_in_use(
        &self,
        address: u8,
        bus: Option<&str>,
        is_own: impl Fn(crate::discovery::DeviceId) -> bool,
    ) -> Option<InputCheck> {
        let buses = self.buses.iter().filter(|it| bus.is_none_or(|bus| it.name == bus));
        let other = buses.flat_map(|bus| bus.engine.devices()).find(|device| {
            device.address.number() == address && device.is_present() && !is_own(device.id)
        })?;
        let who = other.name.as_ref().map_or("a device".to_owned(), ToString::to_string);
        Some(InputCheck::Warning(format!("{address} is used by {who}; Enter pins it anyway")))
    }

    fn finish_address(&mut self, prompt: &Prompt, key: &RowKey, text: &str) {
        let entry = self.edited_entry(prompt);
        let operation = match (parse_address(text), entry) {
            (None, Some(entry)) if entry.is_static => Some(Operation::ClearAddress {
                entry: self.file.document().key(entry.index),
                from: entry.address,
            }),
            (Some(to), Some(entry)) if !entry.is_static || entry.address != Some(to) => {
                let from = entry.address;
                let entry = self.file.document().key(entry.index);
                Some(Operation::SetAddress { entry, from, to })
            }
            (Some(to), None) => match key {
                RowKey::Device(id) => self.device(*id).and_then(|device| {
                    let mut entry = self.new_entry(device)?;
                    (entry.address, entry.is_static) = (Some(to), true);
                    Some(Operation::Add { entry })
                }),
                RowKey::Entry(_) => None,
            },
            _ => None,
        };
        match operation {
            Some(operation) => self.edit(&[operation]),
            None if entry.is_none() => {}
            None => {
                if let Some(theirs) = self.pinned_by_others(prompt) {
                    self.say_of_file(format!("already {theirs}"));
                }
            }
        }
    }

    // ---- new entries -----------------------------------------------------------------------

    /// Selects the row of an entry, if it is shown.
    fn select_entry(&mut self, name: &[u8], address: Option<u8>) {
        let entries = self.file.document().entries();
        let place = entries.iter().rposition(|it| it.name == name && it.address == address);
        let row = self.rows.iter().find(|row| place.is_some() && row.entry == place);
        if let Some(key) = row.map(|row| row.key.clone()) {
            self.view.devices.select(key);
            self.refresh_rows();
        }
    }

    fn judge_new_entry(&self, text: &str) -> InputCheck {
        let (name, address) = match split_new_entry(text) {
            Ok(split) => split,
            Err(why) => return InputCheck::Rejected(why.to_owned()),
        };
        let bus = self.bus_to_name(self.selected_row().and_then(|row| row.bus));
        let exists = |entry: &&Entry| entry.name == name && entry.address == address;
        if let Some(other) = self.file.document().entries().iter().find(exists) {
            let line = other.position.line;
            return InputCheck::Rejected(format!("entry already exists (line {line})"));
        }
        let Some(address) = address else {
            let shown = Quoted(&name);
            let last = text.rsplit(char::is_whitespace).next().unwrap_or_default();
            return if is_number(text.trim()) {
                InputCheck::Rejected(NEW_ENTRY.to_owned())
            } else if is_number(last) {
                InputCheck::Rejected(format!("{last} is not an address (1 to 127)"))
            } else if last.starts_with(|c: char| c.is_ascii_digit()) {
                InputCheck::Warning(format!("all of it is the name: {last} is not an address"))
            } else {
                InputCheck::Accepted(format!("{shown}, not pinned (space, then address)"))
            };
        };
        if let Some(blocked) = self.pinned_elsewhere(address, bus.as_deref(), None) {
            return blocked;
        }
        let named = |id| self.device(id).is_some_and(|device| device.is_named(&name));
        self.address_in_use(address, bus.as_deref(), named).unwrap_or_else(|| {
            InputCheck::Accepted(format!("{}, pinned to {address}", Quoted(&name)))
        })
    }

    // ---- the captured frames ---------------------------------------------------------------

    /// The captured frames as candump writes them.
    pub fn candump_log(&self) -> String {
        let mut log = String::new();
        for (_, frame) in self.capture.iter() {
            let unix_micros = self.epoch.unix_micros(frame.time);
            let interface = self.bus(frame.bus).map_or("can", |bus| &bus.name);
            let _ = writeln!(log, "{}", LogEntry { unix_micros, interface, frame: *frame });
        }
        log
    }
}

/// What is to be typed for a new entry.
const NEW_ENTRY: &str = "name, space, address";

/// Whether somebody who types this means a number.
fn is_number(text: &str) -> bool {
    let digits = text.trim_start_matches(['-', '+']);
    let hex = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X"));
    hex.is_some_and(|hex| hex.chars().all(|c| c.is_ascii_hexdigit()))
        || !digits.is_empty() && digits.chars().all(|c| c.is_ascii_digit())
}

/// The address that an entry is pinned to, as it is typed.
fn pinned(entry: Option<&Entry>) -> String {
    let listed = entry.filter(|entry| entry.is_static);
    listed.and_then(|entry| entry.address).map(|it| it.to_string()).unwrap_or_default()
}

fn renamed(entry: &Entry) -> String {
    format!("renamed to {} on disk", Quoted(&entry.name))
}

/// A number from 1 to 127, decimal or hexadecimal.
pub fn parse_address(text: &str) -> Option<u8> {
    let hex = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let digits = hex.unwrap_or(text);
    let number = digits
        .bytes()
        .all(|byte| byte.is_ascii_hexdigit())
        .then(|| u8::from_str_radix(digits, if hex.is_some() { 16 } else { 10 }).ok())??;
    (1..=127).contains(&number).then_some(number)
}

/// The bytes of a name as it is shown, `\xNN` and `\\` being what they stand for; or why it is none.
fn unescaped(text: &str) -> Result<Vec<u8>, &'static str> {
    const UNKNOWN: &str = "write \\\\ for a backslash, \\x1B for the byte 1B";
    let mut bytes = Vec::new();
    let mut rest = text;
    while let Some(at) = rest.find('\\') {
        bytes.extend_from_slice(&rest.as_bytes()[..at]);
        rest = &rest[at + 1..];
        if let Some(behind) = rest.strip_prefix('\\') {
            bytes.push(b'\\');
            rest = behind;
        } else {
            let digits = rest.strip_prefix('x').and_then(|rest| rest.get(..2));
            let byte = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
            match byte.ok_or(UNKNOWN)? {
                0 => return Err("a name cannot contain byte 0 (DES terminator)"),
                byte => bytes.push(byte),
            }
            rest = &rest[3..];
        }
    }
    bytes.extend_from_slice(rest.as_bytes());
    Ok(bytes)
}

fn judge_name(text: &str) -> InputCheck {
    match unescaped(text) {
        Err(why) => InputCheck::Rejected(why.to_owned()),
        Ok(name) if name.is_empty() => InputCheck::Rejected("a name is needed".to_owned()),
        Ok(name) if name.len() > 5 => {
            let bytes = name.len();
            InputCheck::Warning(format!("{bytes} bytes: over 5 needs a multi-frame response"))
        }
        Ok(_) => {
            InputCheck::Accepted("Enter renames the entry; the device keeps its name".to_owned())
        }
    }
}

/// `PUMP 12` → the name's bytes and the address; without a number at the end, the name alone.
fn split_new_entry(text: &str) -> Result<(Vec<u8>, Option<u8>), &'static str> {
    let split = text.rsplit_once(char::is_whitespace);
    let with_address = split.and_then(|(name, last)| Some((name.trim_end(), parse_address(last)?)));
    let (name, address) = match with_address {
        Some((name, address)) => (name, Some(address)),
        None => (text, None),
    };
    match unescaped(name)? {
        name if name.is_empty() => Err(NEW_ENTRY),
        name => Ok((name, address)),
    }
}

/// What a key does to the line.
fn request(key: Key) -> Option<InputRequest> {
    use InputRequest as R;
    Some(match (key.code, key.ctrl, key.alt) {
        (KeyCode::Char(c), false, false) if is_printable(c) => R::InsertChar(c),
        (KeyCode::Backspace, false, false) | (KeyCode::Char('h'), true, _) => R::DeletePrevChar,
        (KeyCode::Delete, ..) => R::DeleteNextChar,
        (KeyCode::Left, true, _) => R::GoToPrevWord,
        (KeyCode::Right, true, _) => R::GoToNextWord,
        (KeyCode::Left, ..) => R::GoToPrevChar,
        (KeyCode::Right, ..) => R::GoToNextChar,
        (KeyCode::Home, ..) | (KeyCode::Char('a'), true, _) => R::GoToStart,
        (KeyCode::End, ..) | (KeyCode::Char('e'), true, _) => R::GoToEnd,
        (KeyCode::Char('u'), true, _) => R::DeleteLine,
        (KeyCode::Char('k'), true, _) => R::DeleteTillEnd,
        (KeyCode::Char('w'), true, _) | (KeyCode::Backspace, ..) => R::DeletePrevWord,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::Escaped;

    #[test]
    fn addresses_are_decimal_or_hexadecimal() {
        for (text, address) in [("1", 1), ("127", 127), ("0x10", 16), ("0X7f", 127), ("007", 7)] {
            assert_eq!(parse_address(text), Some(address), "{text}");
        }
        for wrong in ["", "0", "128", "-1", "+5", "0x", "0x80", "12a", "1.5", "٣", "1 2"] {
            assert_eq!(parse_address(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn names_are_typed_as_they_are_shown() {
        for name in [&b"FEED"[..], b"a\\b", b"\x1b[2J", "Котёл".as_bytes(), b"\xff\xfe"] {
            let shown = Escaped(name).to_string();
            assert_eq!(unescaped(&shown).as_deref(), Ok(name), "{shown}");
        }
        for wrong in ["\\", "\\x", "\\x1", "\\xzz", "\\n", "\\x00", "\\xé"] {
            assert!(unescaped(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_new_entry_is_a_name_and_perhaps_an_address() {
        assert_eq!(split_new_entry("PUMP 12"), Ok((b"PUMP".to_vec(), Some(12))));
        assert_eq!(split_new_entry("PUMP"), Ok((b"PUMP".to_vec(), None)));
        assert_eq!(split_new_entry("BIG PUMP"), Ok((b"BIG PUMP".to_vec(), None)));
        assert_eq!(split_new_entry("12"), Ok((b"12".to_vec(), None)));
        assert!(split_new_entry("").is_err());
    }
}
