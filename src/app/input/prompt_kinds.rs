//! Kinds of prompts: validation and outcome of each.
//!
//! A prompt that edits des.json refers to its entry by key, and to the content of the file when it
//! was opened: the file may change on disk while the user types.

use super::moment_text::{FORMS, MomentTarget};
use super::prompt_logic::{
    EditTarget, InputCheck as C, PromptContext, PromptLogic, PromptOutcome, SavedFrames,
};
use crate::app::device_command::{COMMAND_FORMS, DeviceCommand};
use crate::app::file::{Documents, FileIndex};
use crate::app::history::Moment;
use crate::app::listing::{entry_bus, new_entry};
use crate::app::problems::ProblemKey;
use crate::app::view::RowKey;
use crate::discovery::{Device, DeviceId};
use crate::document::{Document, Entry, EntryKey, NewEntry, Operation};
use crate::log::LogFormat;
use crate::text::Quoted;
use crate::wire::profile::Profile;
use std::path::{Path, PathBuf};

/// Effect of Enter after the file was deleted or emptied while the user typed.
const CREATES_FILE: &str = "Enter creates a new file";

// ---- the entry that a prompt edits ---------------------------------------------------------

/// The entry that a prompt edits, and the content of the file when the prompt was opened.
#[derive(Clone, Debug)]
struct EntryTarget {
    /// Content of the file when the prompt was opened.
    base: Document,
    /// Place of the entry in it; `None` for a device that was not listed.
    place: Option<usize>,
    /// Device of the entry; by now another entry may be assigned to it.
    device: Option<DeviceId>,
}

impl EntryTarget {
    fn new(key: &RowKey, context: PromptContext) -> Self {
        let on = context.file.document().clone();
        let place = place_of(key, context);
        let device = match key {
            RowKey::Device(id) => Some(*id),
            RowKey::Entry(..) | RowKey::Board(..) => None,
        };
        Self { base: on, place, device }
    }

    /// The entry in its present form; `None` if it was deleted.
    fn entry<'a>(&self, context: PromptContext<'a>) -> Option<&'a Entry> {
        match self.device {
            Some(id) => entry_of(&RowKey::Device(id), context),
            None => self.counterpart(context),
        }
    }

    /// Present form of the entry for which the prompt was opened; `None` if it was deleted.
    fn counterpart<'a>(&self, context: PromptContext<'a>) -> Option<&'a Entry> {
        let document = context.file.document();
        document.entries().get(self.base.counterpart(self.place?, document)?)
    }

    /// The entry when the prompt was opened.
    fn before(&self) -> Option<&Entry> {
        self.base.entries().get(self.place?)
    }

    /// Text about the change after which the entry cannot be edited any more.
    fn deleted_text(&self, context: PromptContext) -> String {
        if let Some(gone) = file_gone(&self.base, context) {
            return gone;
        }
        match self.counterpart(context) {
            Some(entry) if self.before().is_some_and(|before| before.name != entry.name) => {
                format!("entry {}", renamed(entry))
            }
            // A twin may have appeared, or the changed entry matches another device better.
            Some(_) => "entry may belong to another device now".to_owned(),
            None => "entry deleted on disk".to_owned(),
        }
    }
}

fn place_of(key: &RowKey, context: PromptContext) -> Option<usize> {
    match key {
        RowKey::Device(id) => {
            let place = context.matching.entry_of(*id);
            place.filter(|place| place.file == context.index).map(|place| place.index)
        }
        RowKey::Board(..) => None,
        RowKey::Entry(_, key) => context.file.document().find(key),
    }
}

fn entry_of<'a>(key: &RowKey, context: PromptContext<'a>) -> Option<&'a Entry> {
    context.file.document().entries().get(place_of(key, context)?)
}

/// Text about a file that had content, when the prompt was opened or before, and has none now; `None` for
/// any other file.
fn file_gone(on: &Document, context: PromptContext) -> Option<String> {
    let name = context.file.name();
    let deleted = context.file.deleted_entries();
    if deleted > 0 {
        let entries = if deleted == 1 { "entry".to_owned() } else { format!("{deleted} entries") };
        Some(format!("{name} was deleted with its {entries}"))
    } else if on.is_blank() {
        None
    } else if !context.file.is_there() {
        Some(format!("{name} was deleted"))
    } else {
        context.file.document().is_blank().then(|| format!("{name} is empty now"))
    }
}

// ---- static address ------------------------------------------------------------------------

/// Prompt for the static address of a device or an entry, in its row.
#[derive(Clone, Debug)]
pub struct AddressPrompt {
    /// The row.
    pub key: RowKey,
    /// Static address when the prompt was opened, as text.
    before: String,
    target: EntryTarget,
}

impl AddressPrompt {
    /// Returns the prompt for a row, and its first text: the static address; for a device that is
    /// listed and not pinned, its address on the bus.
    pub(in crate::app) fn new(key: RowKey, context: PromptContext) -> (Self, String) {
        let entry = entry_of(&key, context);
        let before = pinned(entry);
        let on_bus = match &key {
            RowKey::Device(id) => context.buses.device(*id).map(|device| device.address),
            RowKey::Entry(..) | RowKey::Board(..) => None,
        };
        let is_unpinned = entry.is_some_and(|entry| !entry.is_static);
        let offered = on_bus.filter(|address| is_unpinned && address.number() > 0);
        let text = offered.map_or_else(|| before.clone(), |address| address.to_string());
        let target = EntryTarget::new(&key, context);
        (Self { key, before, target }, text)
    }

    /// Result if the entry, its address or the whole file changed on disk while the user typed.
    fn check_concurrent_change(&self, text: &str, context: PromptContext) -> Option<C> {
        let entry = self.target.entry(context);
        let gone = file_gone(&self.target.base, context).map(|gone| (gone, CREATES_FILE));
        let unlisted = || (self.target.deleted_text(context), "Enter adds it again");
        let gone = gone.or_else(|| self.target.place.is_some().then(unlisted));
        if let Some((gone, what)) = gone.filter(|_| entry.is_none()) {
            return Some(C::Warning(if text.is_empty() {
                gone
            } else {
                format!("{gone}; {what}")
            }));
        }
        if let Some((now, typed)) = entry.zip(parse_address(text))
            && self.target.before().is_some_and(|before| before.name != now.name)
        {
            // A renamed entry cannot be distinguished from another one in its place.
            return Some(C::Warning(format!("entry {}; Enter pins it to {typed}", renamed(now))));
        }
        let theirs = self.changed_on_disk(parse_address(text), context)?;
        let typed = parse_address(text).map(|it| it.to_string()).unwrap_or_default();
        Some(if typed == pinned(entry) {
            C::Accepted(format!("already {theirs}"))
        } else {
            C::Warning(format!("{theirs}; Enter overwrites it"))
        })
    }

    /// Text about a change of the address on disk while the user typed; `None` without one that `typed`
    /// would overwrite.
    fn changed_on_disk(&self, typed: Option<u8>, context: PromptContext) -> Option<String> {
        let entry = self.target.entry(context);
        let now = pinned(entry);
        let theirs = match now.as_str() {
            "" if self.before.is_empty() => {
                // Not pinned, before and now.
                let (before, now) = (self.target.before()?.address, entry?.address?);
                if before == Some(now) || typed.is_none_or(|typed| typed == now) {
                    return None;
                }
                format!("address changed to {now}")
            }
            now if now == self.before => return None,
            "" => "unpinned".to_owned(),
            now => format!("changed to {now}"),
        };
        Some(format!("{theirs} on disk"))
    }

    fn check_address(&self, text: &str, context: PromptContext) -> C {
        let entry = self.target.entry(context);
        if entry.is_none() && matches!(self.key, RowKey::Entry(..)) {
            return C::Rejected(self.target.deleted_text(context));
        }
        if text.is_empty() {
            return match entry {
                Some(entry) if entry.is_static => C::Accepted("empty: Enter unpins it".to_owned()),
                _ => C::Accepted("1 to 127, decimal or 0x…".to_owned()),
            };
        }
        let Some(address) = parse_address(text) else {
            return C::Rejected("not an address: 1 to 127, or 0x01 to 0x7F".to_owned());
        };
        let device = match &self.key {
            RowKey::Device(id) => context.buses.device(*id),
            RowKey::Entry(..) | RowKey::Board(..) => None,
        };
        if device.is_some_and(|device| device.name.is_none()) {
            return C::Rejected("name not known yet".to_owned());
        }
        let bus = device.and_then(|it| context.buses.get(it.id.bus)).map(|bus| bus.name.as_str());
        let bus = bus.or(entry.and_then(|entry| entry.bus.as_deref()));
        let own = entry.map(|entry| entry.index);
        if let Some(blocked) = pinned_elsewhere(context, address, bus, own) {
            return blocked;
        }
        let own = |id| match &self.key {
            RowKey::Device(own) => *own == id,
            RowKey::Entry(..) | RowKey::Board(..) => false,
        };
        let is_pinned = entry.is_some_and(|it| it.is_static && it.address == Some(address));
        if let Some(used) = address_in_use(context, address, bus, own) {
            return used;
        }
        if is_pinned {
            return C::Accepted(format!("already pinned to {address}"));
        }
        if let Some(device) = device
            && let Some(unclear) = unclear_device(context, device, entry)
        {
            return unclear;
        }
        let at = device.map(|it| it.address.number()).filter(|at| *at != address);
        C::Accepted(match at {
            _ if entry.is_none() => format!("Enter adds an entry with address {address}"),
            Some(at) => {
                format!("Enter pins it to {address} in the file; the device stays at {at}")
            }
            None => format!("Enter pins it to {address}"),
        })
    }
}

/// Warns where several devices on the bus have the name of this one, and its entry, or one that may be its,
/// has no UID to tell them apart.
fn unclear_device(context: PromptContext, device: &Device, entry: Option<&Entry>) -> Option<C> {
    let bus = context.buses.get(device.id.bus)?;
    let named = || bus.devices().iter().filter(|it| it.is_present() && it.name == device.name);
    if named().count() < 2 {
        return None;
    }
    let name = device.name.as_ref()?;
    if let Some(entry) = entry {
        let has_uid = entry.uid.as_ref().is_some_and(|uid| !uid.trim().is_empty());
        let text =
            format!("{} devices {name}, and no uid in the entry; Enter pins it", named().count());
        return (!has_uid).then_some(C::Warning(text));
    }
    // An entry of this name that none of them matches.
    let other = context.file.document().entries().iter().find(|entry| {
        entry.name == name.as_bytes()
            && entry.uid.as_ref().is_none_or(|uid| uid.trim().is_empty())
            && entry.is_for_bus(&bus.name)
            && named().all(|it| Some(it.address.number()) != entry.address)
    })?;
    let line = other.position.line;
    Some(C::Warning(format!("line {line} may be this {name}; Enter adds another entry")))
}

impl PromptLogic for AddressPrompt {
    fn label(&self) -> &'static str {
        "static address"
    }

    fn file(&self, documents: Documents) -> Option<FileIndex> {
        Some(self.key.file(documents))
    }

    fn edit_target(&self, context: PromptContext) -> EditTarget {
        self.target.entry(context).map_or(EditTarget::New, |entry| EditTarget::Entry(entry.index))
    }

    fn validate(&self, text: &str, context: PromptContext) -> C {
        match self.check_address(text, context) {
            C::Rejected(why) => C::Rejected(why),
            C::Warning(own) => match self.check_concurrent_change(text, context) {
                // Both hold of an entry that is there; the second one says what Enter does.
                Some(C::Warning(theirs)) if self.target.entry(context).is_some() => {
                    let own = own.split_once("; Enter").map_or(&*own, |(own, _)| own);
                    C::Warning(format!("{own}; {theirs}"))
                }
                theirs => theirs.unwrap_or(C::Warning(own)),
            },
            check @ C::Accepted(_) => self.check_concurrent_change(text, context).unwrap_or(check),
        }
    }

    fn commit(&self, text: &str, context: PromptContext) -> PromptOutcome {
        let entry = self.target.entry(context);
        let key = |entry: &Entry| context.file.document().key(entry.index);
        let operation = match (parse_address(text), entry) {
            (None, Some(entry)) if entry.is_static => {
                Some(Operation::UnpinAddress { entry: key(entry), from: entry.address })
            }
            (Some(to), Some(entry)) if !entry.is_static || entry.address != Some(to) => {
                let from = entry.address;
                Some(Operation::PinAddress { entry: key(entry), from, to })
            }
            (Some(to), None) => match self.key {
                RowKey::Device(id) => context.buses.device(id).and_then(|device| {
                    let mut entry = new_entry(context.buses, context.documents, device)?;
                    (entry.address, entry.is_static) = (Some(to), true);
                    Some(Operation::Add { entry })
                }),
                RowKey::Entry(..) | RowKey::Board(..) => None,
            },
            _ => None,
        };
        match (operation, entry.and_then(|_| self.changed_on_disk(parse_address(text), context))) {
            (Some(operation), _) => PromptOutcome::Edit(vec![operation]),
            (None, Some(theirs)) => PromptOutcome::FileInfo(format!("already {theirs}")),
            (None, None) => PromptOutcome::Nothing,
        }
    }
}

/// Rejects an address that another entry pins on the bus, or on any.
fn pinned_elsewhere(
    context: PromptContext,
    address: u8,
    bus: Option<&str>,
    own: Option<usize>,
) -> Option<C> {
    let other = context.file.document().entries().iter().find(|entry| {
        Some(entry.index) != own
            && entry.is_static
            && entry.address == Some(address)
            && bus.is_none_or(|bus| entry.is_for_bus(bus))
    })?;
    let line = other.position.line;
    let name = Quoted(&other.name);
    Some(C::Rejected(format!(
        "{address} is the static address of {name} (line {line}); change that first"
    )))
}

/// Warns of an address that another present device uses.
fn address_in_use(
    context: PromptContext,
    address: u8,
    bus: Option<&str>,
    is_own: impl Fn(crate::discovery::DeviceId) -> bool,
) -> Option<C> {
    let buses = context.documents.buses_of(context.index, context.buses);
    let buses = buses.filter(|(_, it)| bus.is_none_or(|bus| it.name == bus));
    let other = buses.flat_map(|(_, bus)| bus.devices()).find(|device| {
        device.address.number() == address && device.is_present() && !is_own(device.id)
    })?;
    let who = other.name.as_ref().map_or("a device".to_owned(), ToString::to_string);
    Some(C::Warning(format!("{address} is used by {who}; Enter pins it anyway")))
}

// ---- another name --------------------------------------------------------------------------

/// Prompt for the new name of an entry.
#[derive(Clone, Debug)]
pub struct RenamePrompt {
    file: FileIndex,
    /// The entry when the prompt was opened.
    key: EntryKey,
    target: EntryTarget,
}

impl RenamePrompt {
    /// Returns the prompt for an entry.
    pub(in crate::app) fn new(file: FileIndex, key: EntryKey, context: PromptContext) -> Self {
        let target = EntryTarget::new(&RowKey::Entry(file, key.clone()), context);
        Self { file, key, target }
    }
}

impl PromptLogic for RenamePrompt {
    fn label(&self) -> &'static str {
        "name"
    }

    fn file(&self, _documents: Documents) -> Option<FileIndex> {
        Some(self.file)
    }

    fn edit_target(&self, context: PromptContext) -> EditTarget {
        self.target.entry(context).map_or(EditTarget::New, |entry| EditTarget::Entry(entry.index))
    }

    fn validate(&self, text: &str, context: PromptContext) -> C {
        let Some(entry) = self.target.entry(context) else {
            return C::Rejected(self.target.deleted_text(context));
        };
        let check = check_name(text);
        if entry.name == self.key.name || matches!(check, C::Rejected(_)) {
            return check;
        }
        let theirs = renamed(entry);
        if unescaped(text).as_ref() == Ok(&entry.name) {
            C::Accepted(format!("already {theirs}"))
        } else {
            C::Warning(format!("{theirs}; Enter overwrites it"))
        }
    }

    fn commit(&self, text: &str, context: PromptContext) -> PromptOutcome {
        let (Ok(to), Some(entry)) = (unescaped(text), self.target.entry(context)) else {
            return PromptOutcome::Nothing;
        };
        if entry.name != to {
            let entry = context.file.document().key(entry.index);
            PromptOutcome::Edit(vec![Operation::Rename { entry, to }])
        } else if self.key.name != to {
            PromptOutcome::FileInfo(format!("already {}", renamed(entry)))
        } else {
            PromptOutcome::Nothing
        }
    }
}

// ---- new entry -----------------------------------------------------------------------------

/// Prompt for name and address of a new entry.
#[derive(Clone, Debug)]
pub struct NewEntryPrompt {
    file: FileIndex,
    /// Content of the file when the prompt was opened.
    base: Document,
}

impl Default for NewEntryPrompt {
    fn default() -> Self {
        Self { file: FileIndex::default(), base: Document::empty() }
    }
}

impl NewEntryPrompt {
    /// Returns the prompt for this content of the file.
    pub(in crate::app) fn new(file: FileIndex, on: Document) -> Self {
        Self { file, base: on }
    }

    fn check_entry(text: &str, context: PromptContext) -> C {
        let (name, address) = match split_new_entry(text) {
            Ok(split) => split,
            Err(why) => return C::Rejected(why.to_owned()),
        };
        let bus = entry_bus(context.buses, context.documents, context.selected_bus);
        let exists = |entry: &&Entry| entry.name == name && entry.address == address;
        if let Some(other) = context.file.document().entries().iter().find(exists) {
            let line = other.position.line;
            return C::Rejected(format!("entry already exists (line {line})"));
        }
        let Some(address) = address else {
            let shown = Quoted(&name);
            let last = text.rsplit(char::is_whitespace).next().unwrap_or_default();
            return if is_number(text.trim()) {
                C::Rejected(NEW_ENTRY_SYNTAX.to_owned())
            } else if is_number(last) {
                C::Rejected(format!("{last} is not an address (1 to 127)"))
            } else if last.starts_with(|c: char| c.is_ascii_digit()) {
                C::Warning(format!("all of it is the name: {last} is not an address"))
            } else {
                C::Accepted(format!("{shown}, not pinned (space, then address)"))
            };
        };
        if let Some(blocked) = pinned_elsewhere(context, address, bus.as_deref(), None) {
            return blocked;
        }
        let named = |id| context.buses.device(id).is_some_and(|device| device.is_named(&name));
        address_in_use(context, address, bus.as_deref(), named)
            .unwrap_or_else(|| C::Accepted(format!("{}, pinned to {address}", Quoted(&name))))
    }
}

impl PromptLogic for NewEntryPrompt {
    fn label(&self) -> &'static str {
        "new entry"
    }

    fn file(&self, _documents: Documents) -> Option<FileIndex> {
        Some(self.file)
    }

    fn edit_target(&self, _context: PromptContext) -> EditTarget {
        EditTarget::New
    }

    fn validate(&self, text: &str, context: PromptContext) -> C {
        match (Self::check_entry(text, context), file_gone(&self.base, context)) {
            (C::Rejected(why), _) => C::Rejected(why),
            (_, Some(gone)) => C::Warning(format!("{gone}; {CREATES_FILE}")),
            (check, None) => check,
        }
    }

    fn commit(&self, text: &str, context: PromptContext) -> PromptOutcome {
        let Ok((name, address)) = split_new_entry(text) else { return PromptOutcome::Nothing };
        let bus = entry_bus(context.buses, context.documents, context.selected_bus);
        let is_static = address.is_some();
        let entry = NewEntry { name, address, is_static, bus, ..NewEntry::default() };
        PromptOutcome::AddEntry(entry)
    }
}

// ---- paths ---------------------------------------------------------------------------------

const NO_PATH: &str = "a path is needed";

/// Prompt for the path of a log of the captured frames.
#[derive(Clone, Copy, Debug)]
pub struct CapturePathPrompt;

impl PromptLogic for CapturePathPrompt {
    fn label(&self) -> &'static str {
        "save frames to"
    }

    fn short_label(&self) -> &'static str {
        "frames to"
    }

    fn validate(&self, text: &str, context: PromptContext) -> C {
        match LogFormat::of(Path::new(text)) {
            _ if text.is_empty() => C::Rejected(NO_PATH.to_owned()),
            Ok(format) => {
                let (all, format) = (context.frames, format.description);
                C::Accepted(match context.saved_frames {
                    SavedFrames::All => format!("{all} frames, {format}"),
                    SavedFrames::Matching => {
                        format!("those of {all} frames that match the filter, {format}")
                    }
                    SavedFrames::Counted(count) => {
                        format!("{count} of {all} frames (filter), {format}")
                    }
                })
            }
            Err(_) => C::Rejected(format!("use the ending {}", LogFormat::usual_endings())),
        }
    }

    fn commit(&self, text: &str, _context: PromptContext) -> PromptOutcome {
        PromptOutcome::SaveCapture(PathBuf::from(text))
    }
}

/// Prompt for the path of the proof of a problem.
#[derive(Clone, Debug)]
pub struct ProofPathPrompt {
    /// The problem: that of the key, even if another one is selected meanwhile.
    pub problem: ProblemKey,
}

impl PromptLogic for ProofPathPrompt {
    fn label(&self) -> &'static str {
        "write the proof to"
    }

    fn short_label(&self) -> &'static str {
        "proof to"
    }

    fn validate(&self, text: &str, _context: PromptContext) -> C {
        match crate::app::proof::is_report(Path::new(text)) {
            _ if text.is_empty() => C::Rejected(NO_PATH.to_owned()),
            true => C::Accepted("report, and its frames as .pcapng".to_owned()),
            false => C::Rejected("use the ending .md".to_owned()),
        }
    }

    fn commit(&self, text: &str, _context: PromptContext) -> PromptOutcome {
        PromptOutcome::WriteProof(self.problem.clone(), PathBuf::from(text))
    }
}

/// Prompt for the path of a profile with learnt values.
#[derive(Clone, Copy, Debug)]
pub struct ProfilePathPrompt {
    /// Number of values.
    pub values: usize,
    /// Frames of logs are read again, which takes a file.
    pub is_of_log: bool,
}

impl PromptLogic for ProfilePathPrompt {
    fn label(&self) -> &'static str {
        "use the values, and save them to"
    }

    fn short_label(&self) -> &'static str {
        "save to"
    }

    fn validate(&self, text: &str, _context: PromptContext) -> C {
        let values = match self.values {
            1 => "1 value".to_owned(),
            count => format!("{count} values"),
        };
        match text {
            "" if self.is_of_log => C::Rejected(NO_PATH.to_owned()),
            "" => C::Accepted(format!("{values}, until descan ends")),
            _ if self.is_of_log => C::Accepted(format!("{values}; the log is read again")),
            _ => C::Accepted(values),
        }
    }

    fn commit(&self, text: &str, _context: PromptContext) -> PromptOutcome {
        PromptOutcome::UseLearnt((!text.is_empty()).then(|| PathBuf::from(text)))
    }
}

// ---- moments -------------------------------------------------------------------------------

/// Prompt for the moment to go to.
#[derive(Clone, Copy, Debug)]
pub struct MomentPrompt;

impl PromptLogic for MomentPrompt {
    fn label(&self) -> &'static str {
        "go to"
    }

    fn validate(&self, text: &str, context: PromptContext) -> C {
        if text.is_empty() {
            return C::Accepted(FORMS.to_owned());
        }
        match MomentTarget::parse(text, &context.moments) {
            Ok(MomentTarget::Time(time)) => C::Accepted(context.moments.time_of_day(time)),
            Ok(MomentTarget::Frame(number)) if number >= context.moments.frames => {
                C::Accepted("after this frame: the log is read up to it".to_owned())
            }
            Ok(MomentTarget::Frame(_)) => C::Accepted("after this frame".to_owned()),
            Ok(MomentTarget::Mark(letter)) => C::Accepted(format!("mark {letter}")),
            Err(fault) => C::Rejected(fault),
        }
    }

    fn commit(&self, text: &str, context: PromptContext) -> PromptOutcome {
        MomentTarget::parse(text, &context.moments)
            .map_or(PromptOutcome::Nothing, PromptOutcome::GoTo)
    }
}

/// Prompt for the text of a mark.
#[derive(Clone, Copy, Debug)]
pub struct MarkPrompt {
    /// Letter of the mark.
    pub letter: char,
    /// The moment: that of the key, however long the text takes.
    pub moment: Moment,
}

impl PromptLogic for MarkPrompt {
    fn label(&self) -> &'static str {
        "mark"
    }

    fn validate(&self, _text: &str, context: PromptContext) -> C {
        let (letter, at) = (self.letter, context.moments.time_of_day(self.moment.time));
        C::Accepted(format!("Enter sets mark {letter} at {at}, with or without a text"))
    }

    fn commit(&self, text: &str, _context: PromptContext) -> PromptOutcome {
        PromptOutcome::SetMark(self.moment, text.to_owned())
    }
}

// ---- a command to a device -----------------------------------------------------------------

/// Prompt for a command to a device, in words.
#[derive(Clone, Copy, Debug)]
pub struct CommandPrompt {
    /// The device.
    pub device: DeviceId,
}

impl CommandPrompt {
    fn profile(self, context: PromptContext<'_>) -> Option<&Profile> {
        context.buses.get(self.device.bus).map(|bus| &*bus.config().profile)
    }
}

impl PromptLogic for CommandPrompt {
    fn label(&self) -> &'static str {
        "command"
    }

    fn validate(&self, text: &str, context: PromptContext) -> C {
        if text.is_empty() {
            return C::Accepted(COMMAND_FORMS.to_owned());
        }
        match DeviceCommand::parse(text) {
            Err(why) => C::Rejected(why),
            Ok(command) => {
                match self.profile(context).and_then(|profile| command.request(profile)) {
                    None => C::Rejected(format!("needs {} in a profile", command.key().name())),
                    Some((service, data)) => {
                        let data = crate::text::hex(&data, " ");
                        C::Accepted(format!("Enter asks: service {service} {data}"))
                    }
                }
            }
        }
    }

    fn commit(&self, text: &str, _context: PromptContext) -> PromptOutcome {
        match DeviceCommand::parse(text) {
            Ok(command) => PromptOutcome::Command(self.device, command),
            Err(_) => PromptOutcome::Nothing,
        }
    }
}

// ---- the copy ------------------------------------------------------------------------------

/// Prompt for the path of a copy of des.json with all edits.
#[derive(Clone, Copy, Debug, Default)]
pub struct CopyPathPrompt {
    /// The file that is copied.
    pub(in crate::app) file: FileIndex,
}

impl PromptLogic for CopyPathPrompt {
    fn label(&self) -> &'static str {
        "save a copy as"
    }

    fn short_label(&self) -> &'static str {
        "copy as"
    }

    fn file(&self, _documents: Documents) -> Option<FileIndex> {
        Some(self.file)
    }

    fn validate(&self, text: &str, context: PromptContext) -> C {
        match context.file.with_all_edits().entries().len() {
            _ if text.is_empty() => C::Rejected(NO_PATH.to_owned()),
            1 => C::Accepted("1 entry".to_owned()),
            entries => C::Accepted(format!("{entries} entries")),
        }
    }

    fn commit(&self, text: &str, _context: PromptContext) -> PromptOutcome {
        PromptOutcome::SaveCopy(PathBuf::from(text))
    }
}

// ---- parsing -------------------------------------------------------------------------------

/// Syntax of a new entry.
const NEW_ENTRY_SYNTAX: &str = "name, space, address";

/// Returns true if the text has the form of a number.
fn is_number(text: &str) -> bool {
    let digits = text.trim_start_matches(['-', '+']);
    let hex = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X"));
    hex.is_some_and(|hex| hex.chars().all(|c| c.is_ascii_hexdigit()))
        || !digits.is_empty() && digits.chars().all(|c| c.is_ascii_digit())
}

/// The static address of an entry as text; empty for none.
fn pinned(entry: Option<&Entry>) -> String {
    let listed = entry.filter(|entry| entry.is_static);
    listed.and_then(|entry| entry.address).map(|it| it.to_string()).unwrap_or_default()
}

/// Text about an entry whose name changed on disk.
fn renamed(entry: &Entry) -> String {
    format!("renamed to {} on disk", Quoted(&entry.name))
}

/// Parses an address, 1 to 127, decimal or hexadecimal (`0x10`); `None` for any other text.
pub fn parse_address(text: &str) -> Option<u8> {
    let hex = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let digits = hex.unwrap_or(text);
    let number = digits
        .bytes()
        .all(|byte| byte.is_ascii_hexdigit())
        .then(|| u8::from_str_radix(digits, if hex.is_some() { 16 } else { 10 }).ok())??;
    (1..=127).contains(&number).then_some(number)
}

/// Decodes `\xNN` and `\\` in a name, the escapes with which names are shown.
///
/// # Errors
///
/// An unknown escape, or byte 0.
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

/// Validates a new name.
fn check_name(text: &str) -> C {
    match unescaped(text) {
        Err(why) => C::Rejected(why.to_owned()),
        Ok(name) if name.is_empty() => C::Rejected("a name is needed".to_owned()),
        Ok(name) if name.len() > 5 => {
            let bytes = name.len();
            C::Warning(format!("{bytes} bytes: over 5 needs a multi-frame response"))
        }
        Ok(_) => C::Accepted("Enter renames the entry; the device keeps its name".to_owned()),
    }
}

/// Splits `PUMP 12` into name and address; without an address at the end, the whole text is the
/// name.
///
/// # Errors
///
/// The name is empty or has an unknown escape.
fn split_new_entry(text: &str) -> Result<(Vec<u8>, Option<u8>), &'static str> {
    let split = text.rsplit_once(char::is_whitespace);
    let with_address = split.and_then(|(name, last)| Some((name.trim_end(), parse_address(last)?)));
    let (name, address) = match with_address {
        Some((name, address)) => (name, Some(address)),
        None => (text, None),
    };
    match unescaped(name)? {
        name if name.is_empty() => Err(NEW_ENTRY_SYNTAX),
        name => Ok((name, address)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::Escaped;

    #[test]
    fn address_is_decimal_or_hexadecimal() {
        for (text, address) in [("1", 1), ("127", 127), ("0x10", 16), ("0X7f", 127), ("007", 7)] {
            assert_eq!(parse_address(text), Some(address), "{text}");
        }
        for wrong in ["", "0", "128", "-1", "+5", "0x", "0x80", "12a", "1.5", "٣", "1 2"] {
            assert_eq!(parse_address(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn name_escapes_round_trip() {
        for name in [&b"FEED"[..], b"a\\b", b"\x1b[2J", "Котёл".as_bytes(), b"\xff\xfe"] {
            let shown = Escaped(name).to_string();
            assert_eq!(unescaped(&shown).as_deref(), Ok(name), "{shown}");
        }
        for wrong in ["\\", "\\x", "\\x1", "\\xzz", "\\n", "\\x00", "\\xé"] {
            assert!(unescaped(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn new_entry_has_name_and_optional_address() {
        assert_eq!(split_new_entry("PUMP 12"), Ok((b"PUMP".to_vec(), Some(12))));
        assert_eq!(split_new_entry("PUMP"), Ok((b"PUMP".to_vec(), None)));
        assert_eq!(split_new_entry("BIG PUMP"), Ok((b"BIG PUMP".to_vec(), None)));
        assert_eq!(split_new_entry("12"), Ok((b"12".to_vec(), None)));
        assert!(split_new_entry("").is_err());
    }
}
