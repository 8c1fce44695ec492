//! Application of edits: splices values into the text, parses the result and compares it with the
//! intended content.

use super::entry::{Entry, Member, ServiceFaults, read_service_noting};
use super::layout::{self, EntryStyle, Layout, Members, ServicesStyle, newline, spliced};
use super::operation::{NewEntry, Operation, RemovedEntry};
use super::position::{Position, Positions};
use super::scan::{self, Container, Item, Span};
use super::syntax::{BOM, JsonKind};
use super::text::{from_json, to_hex, to_json};
use super::{Document, MAX_BYTES, MAX_ENTRIES, Root};
use crate::text::printable;

/// Why an edit was rejected. The document is unchanged.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EditError {
    /// The entry is not in the file, or no longer.
    #[error("entry no longer in the file: {entry}")]
    NotFound {
        /// Its name and address.
        entry: String,
    },
    /// The address is out of range.
    #[error("{address} is not an address (1 to 127)")]
    AddressRange {
        /// The requested address.
        address: u8,
    },
    /// Two members with the same key on the path to the value; readers differ in which they use.
    #[error("{position}: duplicate `{key}`: remove one of them first")]
    DuplicateMember {
        /// Key of both members.
        key: String,
        /// Position of the second one.
        position: Position,
    },
    /// The file has another value where the list of devices belongs.
    #[error("{position}: expected a list of devices, found {found}")]
    NotDevices {
        /// Position of the value.
        position: Position,
        /// Kind of the value, with its article.
        found: String,
    },
    /// An element of `services` is not a service; setting the services would remove it.
    #[error("{position}: expected a service, found {found}: fix it first")]
    NotService {
        /// Position of the value.
        position: Position,
        /// Kind of the value, with its article.
        found: String,
    },
    /// The file has [`MAX_ENTRIES`] elements already.
    #[error("no room for another entry: the file has {MAX_ENTRIES}; delete one first")]
    Full,
    /// The file would be longer than [`MAX_BYTES`].
    #[error("no room: the file would exceed 16 MiB; shorten it first")]
    TooLong,
    /// The edited text does not have the intended content: a fault in descan. The file is not
    /// written.
    #[error("edit rejected: the result would not read back as intended: {reason}")]
    VerificationFailed {
        /// The difference.
        reason: String,
    },
}

impl Document {
    /// Returns the document with one edit applied. Only the bytes of the values concerned change.
    ///
    /// # Errors
    /// [`EditError`]; no edit is applied in part.
    pub fn apply(&self, operation: &Operation) -> Result<Self, EditError> {
        self.check_path()?;
        if let Operation::RemoveFirstEntry { former, .. } = operation
            && let Some(before) = former.before(self)
        {
            return Ok(before.clone());
        }
        let mut meant: Vec<&Entry> = self.entries().iter().collect();
        let changed;
        let edited = match operation {
            Operation::Add { entry } => {
                check_address(entry.address)?;
                self.check_count()?;
                changed = entry.expected();
                meant.push(&changed);
                self.with_new(entry)
            }
            Operation::RestoreEntry { removed } => {
                self.check_count()?;
                meant.insert(self.entries_before(removed.entry.element), &removed.entry);
                self.with_removed(removed)
            }
            Operation::Remove { entry } | Operation::RemoveFirstEntry { entry, .. } => {
                let index = self.require(entry)?;
                meant.remove(index);
                self.without_element(self.entries()[index].element)
            }
            Operation::PinAddress { entry, .. }
            | Operation::UnpinAddress { entry, .. }
            | Operation::Rename { entry, .. }
            | Operation::SetServices { entry, .. }
            | Operation::RestoreMembers { entry, .. } => {
                if let Operation::PinAddress { to, .. } = operation {
                    check_address(Some(*to))?;
                }
                let index = self.require(entry)?;
                let mut entry = self.entries()[index].clone();
                operation.change(&mut entry);
                changed = entry;
                meant[index] = &changed;
                self.with_changed(index, operation)?
            }
        };
        self.verified(&edited, &meant)
    }

    /// Parses the edited body and compares the meaning of each entry with what was intended.
    fn verified(&self, body: &str, meant: &[&Entry]) -> Result<Self, EditError> {
        let unfaithful = |reason: String| EditError::VerificationFailed { reason };
        let source = [if self.has_bom() { BOM } else { "" }, body].concat();
        if source.len() > MAX_BYTES.max(self.source().len()) {
            return Err(EditError::TooLong);
        }
        let edited = Self::parse(source.as_bytes()).map_err(|it| unfaithful(it.to_string()))?;
        if edited.entries().len() != meant.len() {
            return Err(unfaithful(format!("{} entries", edited.entries().len())));
        }
        for (is, meant) in edited.entries().iter().zip(meant) {
            if is.content() != meant.content() {
                return Err(unfaithful(format!("{}: {}", is.position, is.name_text)));
            }
        }
        Ok(edited)
    }

    // ---- members of an entry ----

    fn with_changed(&self, index: usize, operation: &Operation) -> Result<String, EditError> {
        let span = self.entry_span(index);
        self.check_entry(index, operation)?;
        let mut text = self.body()[span.clone()].to_owned();
        for (member, value) in self.member_texts(index, operation) {
            let Some(members) = Members::of(&text) else { continue };
            text = match value {
                Some(value) => {
                    let before = self.members_before(member);
                    members.with(member.key(), &value, &before)
                }
                None => members.without(member.key()),
            };
        }
        Ok(spliced(self.body(), span, &text))
    }

    /// Returns the members to write with their text; `None`: remove the member.
    fn member_texts(&self, index: usize, operation: &Operation) -> Vec<(Member, Option<String>)> {
        let entry = &self.entries()[index];
        let mut texts = Vec::new();
        match operation {
            Operation::PinAddress { to, .. } => {
                if entry.address != Some(*to) {
                    texts.push((Member::Address, Some(to.to_string())));
                }
                if !entry.is_static {
                    texts.push((Member::Static, Some("true".to_owned())));
                }
            }
            Operation::UnpinAddress { .. } if entry.is_static => {
                texts.push((Member::Static, Some("false".to_owned())));
            }
            Operation::Rename { to, .. } if *to != entry.name => {
                let (name, hex) = name_texts(to);
                texts.push((Member::Name, Some(name)));
                let had_hex = self.member(index, Member::NameHex).is_some();
                if hex.is_some() || had_hex {
                    texts.push((Member::NameHex, Some(hex.unwrap_or_else(|| quoted_hex(to)))));
                }
            }
            Operation::SetServices { services, .. } => {
                let layout = EntryStyle::of(self.entry_text(index));
                let text = match (self.member(index, Member::Services), layout) {
                    (Some(old), Some(style)) => style.services().edited(old, services),
                    (_, style) => self.services_style(style).services(services),
                };
                texts.push((Member::Services, Some(text)));
            }
            Operation::RestoreMembers { former, .. } => texts.clone_from(&former.members),
            _ => {}
        }
        texts
    }

    /// Returns the layout of `services` in other entries, or else one that suits this entry.
    fn services_style(&self, own: Option<EntryStyle>) -> ServicesStyle {
        let own_layout = own.map_or_else(Layout::spaced, EntryStyle::into_layout);
        match self.sample(Some(Member::Services)) {
            Some(sample) => match self.member(sample, Member::Services) {
                Some(services) => ServicesStyle::of(services, &own_layout),
                None => ServicesStyle::within(&own_layout),
            },
            None => ServicesStyle::within(&own_layout),
        }
    }

    /// Returns the members that come before `member` in the file's entries, or else in the order of
    /// [`Member::ALL`].
    fn members_before(&self, member: Member) -> Vec<&'static str> {
        let sample =
            self.sample(Some(member)).and_then(|index| Members::of(self.entry_text(index)));
        let order = sample.map_or(Member::ALL.to_vec(), |sample| sample.known());
        order.into_iter().take_while(|other| *other != member).map(Member::key).collect()
    }

    /// Returns the last entry, or the last with a member: the model for new text.
    fn sample(&self, with: Option<Member>) -> Option<usize> {
        let has = |entry: &Entry| with.is_none_or(|member| entry.present.has(member));
        self.entries().iter().rposition(has)
    }

    /// Returns the last of the entries that have most of the new entry's members.
    fn sample_of(&self, entry: &NewEntry) -> Option<usize> {
        let wanted = [
            (!entry.services.is_empty(), Member::Services),
            (entry.is_static, Member::Static),
            (entry.uid.is_some(), Member::Uid),
            (entry.bus.is_some(), Member::Bus),
        ];
        let shows = |entry: &Entry| {
            let shown =
                |&(is_wanted, member): &(bool, Member)| is_wanted && entry.present.has(member);
            // Services first: they have a layout of their own.
            (shown(&wanted[0]), wanted.iter().filter(|it| shown(it)).count())
        };
        let entries = self.entries().iter().enumerate();
        entries.max_by_key(|(_, entry)| shows(entry)).map(|(index, _)| index)
    }

    fn member(&self, index: usize, member: Member) -> Option<&str> {
        Members::of(self.entry_text(index))?.value(member.key())
    }

    // ---- elements of the list ----

    fn with_new(&self, entry: &NewEntry) -> String {
        let sample = self.sample_of(entry);
        let style = sample.and_then(|index| EntryStyle::of(self.entry_text(index)));
        let style = style
            .unwrap_or_else(|| EntryStyle::begun(newline(self.body()), &self.element_indent()));
        let text = entry_text(entry, &style);
        let end = self.elements().len();
        let gap = match self.elements() {
            [.., before, last] => Some(&self.body()[before.end..last.start]),
            _ => None,
        };
        self.with_element(end, &text, gap, None)
    }

    fn with_removed(&self, removed: &RemovedEntry) -> String {
        let index = removed.entry.element.min(self.elements().len());
        self.with_element(index, &removed.text, Some(&removed.before), Some(&removed.after))
    }

    /// Returns the body with an element inserted at `index` of the list. `before` and `after`: the
    /// preferred text around it, used if it has the required comma.
    fn with_element(
        &self,
        index: usize,
        text: &str,
        before: Option<&str>,
        after: Option<&str>,
    ) -> String {
        let body = self.body();
        let separator = |wish: Option<&str>| match wish {
            Some(wish) if wish.contains(',') => wish.to_owned(),
            _ => self.separator(),
        };
        match (self.elements(), index) {
            ([], _) => match before.zip(after) {
                Some((before, after)) if !before.contains(',') && !after.contains(',') => {
                    self.with_only_element(before, text, after)
                }
                _ => {
                    let newline = newline(body);
                    let indent = self.element_indent();
                    let outer = &indent[..self.list_indent().len()];
                    let before = format!("{newline}{indent}");
                    let after = format!("{newline}{outer}");
                    self.with_only_element(&before, text, &after)
                }
            },
            ([first, ..], 0) => {
                spliced(body, first.start..first.start, &format!("{text}{}", separator(after)))
            }
            (elements, index) => {
                let at = elements[index - 1].end;
                spliced(body, at..at, &(separator(before) + text))
            }
        }
    }

    /// Returns the body with the first element of the list; creates the list if it is missing.
    fn with_only_element(&self, before: &str, text: &str, after: &str) -> String {
        let body = self.body();
        let list = format!("[{before}{text}{after}]");
        match self.root() {
            Root::List(span) | Root::Object { devices: Some(span), .. } => {
                spliced(body, span.clone(), &list)
            }
            Root::Object { span, devices: None, .. } => {
                let members = Members::of(&body[span.clone()]);
                let object = match members.as_ref().and_then(|it| it.last_key().zip(Some(it))) {
                    Some((last_key, members)) => members.with("devices", &list, &[&last_key]),
                    None => begun_object(&list, newline(body)),
                };
                spliced(body, span.clone(), &object)
            }
            Root::Blank | Root::Other(_) => {
                let newline = newline(body);
                begun_object(&list, newline) + newline
            }
        }
    }

    fn without_element(&self, element: usize) -> String {
        let cut = match self.list() {
            Some((inside, items)) => layout::cut(&Container { inside, items }, element),
            None => self.elements()[element].clone(),
        };
        spliced(self.body(), cut, "")
    }

    /// Returns what [`Operation::RestoreEntry`] needs to restore an entry.
    pub(super) fn removed(&self, index: usize) -> RemovedEntry {
        let entry = &self.entries()[index];
        let elements = self.elements();
        let span = &elements[entry.element];
        let inside = self.list().map_or(span.clone(), |(inside, _)| inside);
        let start = entry.element.checked_sub(1).map_or(inside.start, |it| elements[it].end);
        let end = elements.get(entry.element + 1).map_or(inside.end, |next| next.start);
        RemovedEntry {
            entry: Box::new(entry.clone()),
            text: self.body()[span.clone()].to_owned(),
            before: self.body()[start..span.start].to_owned(),
            after: self.body()[span.end..end].to_owned(),
        }
    }

    /// Returns the text between two elements, as between the last two or after the bracket.
    fn separator(&self) -> String {
        let body = self.body();
        match (self.elements(), self.list()) {
            ([.., before, last], _) => body[before.end..last.start].to_owned(),
            ([only], Some((inside, _))) => match &body[inside.start..only.start] {
                "" if self.is_compact(only) => ",".to_owned(),
                open if open.contains('\n') => format!(",{open}"),
                _ => ", ".to_owned(),
            },
            _ => ", ".to_owned(),
        }
    }

    /// Returns true if the element is an object without white space between its members.
    fn is_compact(&self, element: &Span) -> bool {
        let text = &self.body()[element.clone()];
        let container = scan::container(text, &(0..text.len()));
        container.and_then(|it| Layout::of(text, &it)).is_some_and(|layout| layout.gap == ",")
    }

    fn list(&self) -> Option<(Span, Vec<Item>)> {
        let span = self.root().list()?;
        let item = |value: &Span| Item { key: value.start..value.start, value: value.clone() };
        let items = self.elements().iter().map(item).collect();
        Some((span.start + 1..span.end - 1, items))
    }

    /// Returns the indent of the line on which the list begins, or would begin.
    fn list_indent(&self) -> String {
        let body = self.body();
        let at = match self.root() {
            Root::List(span) | Root::Object { devices: Some(span), .. } => span.start,
            Root::Object { span, devices: None, .. } => {
                let first =
                    scan::container(body, span).and_then(|it| Some(it.items.first()?.key.start));
                match first {
                    Some(first) => first,
                    None => return "  ".to_owned(),
                }
            }
            Root::Blank | Root::Other(_) => return "  ".to_owned(),
        };
        let line = &body[body[..at].rfind('\n').map_or(0, |newline| newline + 1)..at];
        line[..line.len() - line.trim_start_matches([' ', '\t']).len()].to_owned()
    }

    /// Returns the indent of elements for an empty list.
    fn element_indent(&self) -> String {
        let outer = self.list_indent();
        let unit = if outer.is_empty() { "  " } else { &outer };
        format!("{outer}{unit}")
    }

    // ---- checks ----

    /// Checks whether entries can be added, and whether `entry`, if given, can be edited. Fast
    /// enough to call before a prompt opens.
    ///
    /// # Errors
    /// [`EditError`], as from [`Document::apply`].
    pub fn check_edit(&self, entry: Option<usize>) -> Result<(), EditError> {
        self.check_path()?;
        entry.map_or(Ok(()), |index| self.check_members(index))
    }

    /// Checks whether the present content prevents an edit. Fast.
    ///
    /// # Errors
    /// [`EditError`], as from [`Document::apply`].
    pub fn check_operation(&self, operation: &Operation) -> Result<(), EditError> {
        self.check_path()?;
        match operation {
            Operation::PinAddress { entry, .. }
            | Operation::UnpinAddress { entry, .. }
            | Operation::Rename { entry, .. }
            | Operation::SetServices { entry, .. }
            | Operation::RestoreMembers { entry, .. } => {
                self.check_entry(self.require(entry)?, operation)
            }
            _ => Ok(()),
        }
    }

    /// Fails if the list has [`MAX_ENTRIES`] elements.
    fn check_count(&self) -> Result<(), EditError> {
        if self.elements().len() < MAX_ENTRIES { Ok(()) } else { Err(EditError::Full) }
    }

    /// Fails if the list of devices is ambiguous or another value is in its place.
    fn check_path(&self) -> Result<(), EditError> {
        match self.root() {
            Root::Other(span) => Err(self.not_devices(span)),
            Root::Object { again: Some(again), .. } => Err(self.duplicate("devices", *again)),
            Root::Object { devices: Some(devices), .. }
                if !self.body()[devices.clone()].starts_with('[') =>
            {
                Err(self.not_devices(devices))
            }
            Root::Object { .. } | Root::Blank | Root::List(_) => Ok(()),
        }
    }

    /// Fails if a member of the entry occurs twice.
    fn check_members(&self, index: usize) -> Result<(), EditError> {
        let span = self.entry_span(index);
        let Some(members) = Members::of(self.entry_text(index)) else { return Ok(()) };
        for member in Member::ALL {
            if let Some(at) = members.duplicate(member.key()) {
                return Err(self.duplicate(member.key(), span.start + at));
            }
        }
        Ok(())
    }

    fn check_entry(&self, index: usize, operation: &Operation) -> Result<(), EditError> {
        self.check_members(index)?;
        if let Operation::SetServices { .. } = operation
            && let Some(services) = self.services_span(index)
        {
            self.check_services(&services)?;
        }
        Ok(())
    }

    fn check_services(&self, services: &Span) -> Result<(), EditError> {
        let mut keys = std::collections::HashSet::new();
        let items = scan::container(self.body(), services).map(|it| it.items).unwrap_or_default();
        for item in items {
            let key = from_json(&self.body()[item.key.clone()]).unwrap_or_default();
            if !item.key.is_empty() && !keys.insert(key.clone()) {
                return Err(self.duplicate(&key, item.key.start));
            }
            let mut faults = ServiceFaults::default();
            let service = read_service_noting(self.body(), &item, &mut faults);
            if let Some((key, at)) = faults.again.first() {
                return Err(self.duplicate(key, *at));
            }
            if service.is_none() {
                return Err(self.not_service(&item.value));
            }
        }
        Ok(())
    }

    fn not_service(&self, span: &Span) -> EditError {
        let found = JsonKind(&self.body()[span.clone()]).to_string();
        EditError::NotService { position: Positions::new(self.body()).at(span.start), found }
    }

    fn services_span(&self, index: usize) -> Option<Span> {
        let container = scan::container(self.body(), &self.entry_span(index))?;
        let is_services =
            |item: &Item| Member::of(&self.body()[item.key.clone()]) == Some(Member::Services);
        container.items.into_iter().find(is_services).map(|item| item.value)
    }

    fn duplicate(&self, key: &str, at: usize) -> EditError {
        let position = Positions::new(self.body()).at(at);
        EditError::DuplicateMember { key: printable(key.as_bytes()), position }
    }

    fn not_devices(&self, span: &Span) -> EditError {
        let found = JsonKind(&self.body()[span.clone()]).to_string();
        EditError::NotDevices { position: Positions::new(self.body()).at(span.start), found }
    }
}

fn check_address(address: Option<u8>) -> Result<(), EditError> {
    match address {
        Some(address) if !(1..=127).contains(&address) => Err(EditError::AddressRange { address }),
        _ => Ok(()),
    }
}

/// Returns a new top-level object with the list.
fn begun_object(list: &str, newline: &str) -> String {
    format!("{{{newline}  \"devices\": {list}{newline}}}")
}

fn entry_text(entry: &NewEntry, style: &EntryStyle) -> String {
    let (name, hex) = name_texts(&entry.name);
    let mut members = vec![(Member::Name, name)];
    members.extend(hex.map(|hex| (Member::NameHex, hex)));
    members.extend(entry.address.map(|address| (Member::Address, address.to_string())));
    if entry.is_static || style.writes(Member::Static) {
        members.push((Member::Static, entry.is_static.to_string()));
    }
    if !entry.services.is_empty() {
        members.push((Member::Services, style.services().services(&entry.services)));
    }
    members.extend(entry.bus.as_ref().map(|bus| (Member::Bus, to_json(bus))));
    members.extend(entry.uid.as_ref().map(|uid| (Member::Uid, to_json(uid))));
    style.entry(&members)
}

/// Returns the text of `name` and, for a name that is not UTF-8, of `name_hex`.
fn name_texts(name: &[u8]) -> (String, Option<String>) {
    match str::from_utf8(name) {
        Ok(text) => (to_json(text), None),
        Err(_) => (to_json(&printable(name)), Some(quoted_hex(name))),
    }
}

fn quoted_hex(name: &[u8]) -> String {
    format!("\"{}\"", to_hex(name))
}
