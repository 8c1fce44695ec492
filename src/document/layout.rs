//! Layout of the file: white space and commas, so that added text looks like the text around it.
//!
//! Works on the text of one list or object at a time. Each function returns the new text, in which
//! all other bytes are unchanged.

use super::entry::{ListedService, Member, read_service, version};
use super::scan::{self, Container};
use super::text::{from_json, to_json};
use std::collections::{HashMap, VecDeque};

/// Text between the parts of a list or object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// After the opening bracket.
    pub open: String,
    /// Between two items: the comma and the white space around it.
    pub gap: String,
    /// Before the closing bracket.
    pub close: String,
    /// Between a key and its value.
    pub colon: String,
}

impl Layout {
    /// All on one line, as in `{ "name": "DES", "version": "1.0" }`.
    pub fn spaced() -> Self {
        Self { open: " ".into(), gap: ", ".into(), close: " ".into(), colon: ": ".into() }
    }

    /// Returns the layout of a container; `None` if it is empty.
    pub fn of(text: &str, container: &Container) -> Option<Self> {
        let (first, last) = (container.items.first()?, container.items.last()?);
        let open = text[container.inside.start..first.span().start].to_owned();
        let colon = match &text[first.key.end..first.value.start] {
            "" => ": ",
            colon => colon,
        };
        let gap = match &container.items[..] {
            [first, second, ..] => text[first.value.end..second.span().start].to_owned(),
            _ if open.contains('\n') => format!(",{open}"),
            _ if open.is_empty() && colon.ends_with(':') => ",".to_owned(),
            _ => ", ".to_owned(),
        };
        let close = text[last.value.end..container.inside.end].to_owned();
        Some(Self { open, gap, close, colon: colon.to_owned() })
    }

    /// Returns the layout of a list inside a container of this layout.
    fn inner(&self) -> Self {
        let Some((_, line)) = self.gap.rsplit_once('\n') else {
            return self.clone();
        };
        // Some files have the comma at the start of the line.
        let indent = &line[..line.len() - line.trim_start_matches([' ', '\t']).len()];
        let newline = newline(&self.gap);
        let outer = self.close.rsplit_once('\n').map_or("", |(_, outer)| outer);
        let unit = indent.strip_prefix(outer).filter(|unit| !unit.is_empty()).unwrap_or("  ");
        Self {
            open: format!("{newline}{indent}{unit}"),
            gap: format!(",{newline}{indent}{unit}"),
            close: format!("{newline}{indent}"),
            colon: self.colon.clone(),
        }
    }

    /// Returns the same layout on one line.
    fn inline(&self) -> Self {
        if !self.gap.contains('\n') {
            return self.clone();
        }
        Self { colon: self.colon.clone(), ..Self::spaced() }
    }

    pub fn object<'i>(&self, members: impl IntoIterator<Item = (&'i str, String)>) -> String {
        let members: Vec<String> = members
            .into_iter()
            .map(|(key, value)| format!("{}{}{value}", to_json(key), self.colon))
            .collect();
        self.join("{", &members, "}")
    }

    pub fn list(&self, items: &[String]) -> String {
        self.join("[", items, "]")
    }

    fn join(&self, opening: &str, items: &[String], closing: &str) -> String {
        if items.is_empty() {
            return format!("{opening}{closing}");
        }
        format!("{opening}{}{}{}{closing}", self.open, items.join(&self.gap), self.close)
    }
}

/// Returns the line ending of a text.
pub(super) fn newline(text: &str) -> &'static str {
    if text.contains("\r\n") { "\r\n" } else { "\n" }
}

/// Returns the span to remove with an item: the item, and its comma and white space.
pub(super) fn cut(container: &Container, index: usize) -> scan::Span {
    let items = &container.items;
    if items.len() == 1 {
        container.inside.clone()
    } else if index == 0 {
        items[0].span().start..items[1].span().start
    } else {
        items[index - 1].value.end..items[index].value.end
    }
}

/// Returns the text with `span` replaced.
pub(super) fn spliced(text: &str, span: scan::Span, new: &str) -> String {
    [&text[..span.start], new, &text[span.end..]].concat()
}

/// Members of an object, with decoded keys.
pub(super) struct Members<'t> {
    text: &'t str,
    container: Container,
}

impl<'t> Members<'t> {
    /// Returns the members; `None` if the text is not an object.
    pub fn of(text: &'t str) -> Option<Self> {
        if !text.starts_with('{') {
            return None;
        }
        Some(Self { text, container: scan::container(text, &(0..text.len()))? })
    }

    fn keys(&self) -> impl Iterator<Item = String> {
        self.container
            .items
            .iter()
            .map(|item| from_json(&self.text[item.key.clone()]).unwrap_or_default().into_owned())
    }

    fn position(&self, key: &str) -> Option<usize> {
        self.keys().position(|found| found == key)
    }

    /// Returns the text of a member's value; `None` if it is missing.
    pub fn value(&self, key: &str) -> Option<&'t str> {
        Some(&self.text[self.container.items[self.position(key)?].value.clone()])
    }

    /// Returns the offset of the second member with this key; `None` if there is none.
    pub fn duplicate(&self, key: &str) -> Option<usize> {
        let second = self.keys().enumerate().filter(|(_, found)| found == key).nth(1)?.0;
        Some(self.container.items[second].key.start)
    }

    /// Returns the object with a member set. A new member is placed behind the last of `after` that
    /// is present, or at the start.
    pub fn with(&self, key: &str, value: &str, after: &[&str]) -> String {
        let items = &self.container.items;
        if let Some(index) = self.position(key) {
            return spliced(self.text, items[index].value.clone(), value);
        }
        let Some(layout) = Layout::of(self.text, &self.container) else {
            return Layout::spaced().object([(key, value.to_owned())]);
        };
        let member = format!("{}{}{value}", to_json(key), layout.colon);
        match after.iter().rev().find_map(|key| self.position(key)) {
            Some(0) => {
                let at = items[0].value.end;
                spliced(self.text, at..at, &format!("{}{member}", layout.gap))
            }
            Some(index) => {
                let gap = &self.text[items[index - 1].value.end..items[index].key.start];
                let at = items[index].value.end;
                spliced(self.text, at..at, &format!("{gap}{member}"))
            }
            None => {
                let at = items[0].key.start;
                spliced(self.text, at..at, &format!("{member}{}", layout.gap))
            }
        }
    }

    /// Returns the object without a member.
    pub fn without(&self, key: &str) -> String {
        match self.position(key) {
            Some(index) => spliced(self.text, cut(&self.container, index), ""),
            None => self.text.to_owned(),
        }
    }

    /// Returns the members that descan reads, in their order.
    pub fn known(&self) -> Vec<Member> {
        let raw = |item: &scan::Item| Member::of(&self.text[item.key.clone()]);
        self.container.items.iter().filter_map(raw).collect()
    }

    /// Returns the key of the last member; `None` if there are none.
    pub fn last_key(&self) -> Option<String> {
        self.keys().last()
    }

    /// Returns the text before a member; `None` for the first and for a missing one.
    fn gap_before(&self, key: &str) -> Option<String> {
        let index = self.position(key)?;
        let before = index.checked_sub(1)?;
        let items = &self.container.items;
        Some(self.text[items[before].value.end..items[index].key.start].to_owned())
    }

    fn layout(&self) -> Option<Layout> {
        Layout::of(self.text, &self.container)
    }
}

/// Layout of entries: that of `sample`, an entry of the file, or descan's default.
pub(super) struct EntryStyle<'t> {
    sample: Option<Members<'t>>,
    layout: Layout,
    services: ServicesStyle,
    /// Line ending and indent of lines inside an entry, used without a sample.
    line: String,
}

impl<'t> EntryStyle<'t> {
    /// Returns the layout of a sample; `None` if it is not an object or is empty.
    pub fn of(sample: &'t str) -> Option<Self> {
        let members = Members::of(sample)?;
        let layout = members.layout()?;
        let services = match members.value(Member::Services.key()) {
            Some(services) => ServicesStyle::of(services, &layout),
            None => ServicesStyle::within(&layout),
        };
        Some(Self { sample: Some(members), layout, services, line: String::new() })
    }

    /// Returns the default layout for entries on lines of their own.
    pub fn begun(newline: &str, indent: &str) -> Self {
        Self {
            sample: None,
            layout: Layout::spaced(),
            services: ServicesStyle::within(&Layout::spaced()),
            line: format!("{newline}{indent}  "),
        }
    }

    /// Returns the layout of an entry's members.
    pub fn into_layout(self) -> Layout {
        self.layout
    }

    pub fn services(&self) -> &ServicesStyle {
        &self.services
    }

    /// Returns true if the sample has this member.
    pub fn writes(&self, member: Member) -> bool {
        self.sample.as_ref().is_some_and(|sample| sample.position(member.key()).is_some())
    }

    /// Returns the text of an entry with these members, in the order of the sample.
    pub fn entry(&self, members: &[(Member, String)]) -> String {
        let present = |member| members.iter().find(|(found, _)| *found == member);
        let known = self.sample.as_ref().map(Members::known).unwrap_or_default();
        let mut order: Vec<_> = known.into_iter().filter_map(present).collect();
        for (index, added) in members.iter().enumerate() {
            if order.contains(&added) {
                continue;
            }
            let place = |earlier| order.iter().position(|present| *present == earlier);
            let mut earlier = members[..index].iter().rev().filter_map(place);
            // `static` follows the address; others follow the members that precede them elsewhere.
            let after = if added.0 == Member::Static { earlier.next() } else { earlier.max() };
            order.insert(after.map_or(0, |after| after + 1), added);
        }
        let mut out = format!("{{{}", self.layout.open);
        for (index, (member, value)) in order.into_iter().enumerate() {
            if index > 0 {
                out += &self.gap_before(*member);
            }
            out += &to_json(member.key());
            out += &self.layout.colon;
            out += value;
        }
        out + &self.layout.close + "}"
    }

    fn gap_before(&self, member: Member) -> String {
        match &self.sample {
            Some(sample) => {
                sample.gap_before(member.key()).unwrap_or_else(|| self.layout.gap.clone())
            }
            None if member == Member::Services => format!(",{}", self.line),
            None => self.layout.gap.clone(),
        }
    }
}

/// Layout of `services`: a list of objects, or an object of names and versions.
pub(super) struct ServicesStyle {
    is_object: bool,
    outer: Layout,
    /// For each service in a list.
    item: Layout,
    /// For a list that replaces an object, which cannot hold all content.
    fallback: Layout,
}

impl ServicesStyle {
    /// Returns the layout of the value `sample`; what it leaves open follows `entry`, the layout of
    /// its entry.
    pub fn of(sample: &str, entry: &Layout) -> Self {
        let default = Self::within(entry);
        let Some(container) = scan::container(sample, &(0..sample.len())) else {
            return default;
        };
        let is_object = sample.starts_with('{');
        let Some(mut outer) = Layout::of(sample, &container) else {
            return Self { is_object, ..default };
        };
        // A single item does not show the text between two.
        if container.items.len() == 1 && !outer.open.contains('\n') {
            outer.gap = entry.inline().gap;
        }
        let item = container.items[0].value.clone();
        let item = Members::of(&sample[item]).and_then(|members| members.layout());
        let item = item.unwrap_or(default.item);
        Self { is_object, outer, item, fallback: default.outer }
    }

    /// Returns the layout of a list inside an entry of layout `entry`.
    pub fn within(entry: &Layout) -> Self {
        let outer = entry.inner();
        Self { is_object: false, outer: outer.clone(), item: entry.inline(), fallback: outer }
    }

    /// Returns the text of `services`. An object becomes a list if a name occurs twice or strings
    /// follow a version.
    pub fn services(&self, services: &[ListedService]) -> String {
        if self.is_object && fits_object(services) {
            let pair = |service: &ListedService| to_json(&service.version);
            return self.outer.object(services.iter().map(|new| (&*new.name, pair(new))));
        }
        let outer = if self.is_object { &self.fallback } else { &self.outer };
        let items: Vec<String> = services.iter().map(|service| self.service(service)).collect();
        outer.list(&items)
    }

    /// Returns the value `old` changed to these services. Services that stay keep their members and
    /// their text and, while in the same order, the text between them.
    pub fn edited(&self, old: &str, services: &[ListedService]) -> String {
        let Some(container) = scan::container(old, &(0..old.len())) else {
            return self.services(services);
        };
        let items = &container.items;
        let (Some(first), Some(last)) = (items.first(), items.last()) else {
            return self.services(services);
        };
        if services.is_empty() || self.is_object && !fits_object(services) {
            return self.services(services);
        }
        let mut known: HashMap<String, VecDeque<usize>> = HashMap::new();
        for (index, item) in items.iter().enumerate() {
            if let Some(service) = read_service(old, item) {
                known.entry(service.name).or_default().push_back(index);
            }
        }
        let mut text = old[..first.span().start].to_owned();
        // Items before this one are written already, or removed.
        let mut next = 0;
        for (place, service) in services.iter().enumerate() {
            let index = known.get_mut(&service.name).and_then(VecDeque::pop_front);
            let in_order = index.filter(|index| *index >= next);
            if place > 0 {
                text += match in_order {
                    Some(index) if index > 0 => {
                        &old[items[index - 1].value.end..items[index].span().start]
                    }
                    _ => &self.outer.gap,
                };
            }
            match index {
                Some(index) => {
                    let item = &items[index];
                    text += &old[item.span().start..item.value.start];
                    text += &edited_service(&old[item.value.clone()], service);
                }
                None => text += &self.item(service),
            }
            next = in_order.map_or(next, |index| index + 1);
        }
        text + &old[last.value.end..]
    }

    /// A new item, in the shape that they have.
    fn item(&self, service: &ListedService) -> String {
        if self.is_object {
            let (name, version) = (to_json(&service.name), to_json(&service.version));
            format!("{name}{}{version}", self.outer.colon)
        } else {
            self.service(service)
        }
    }

    fn service(&self, service: &ListedService) -> String {
        let mut members =
            vec![("name", to_json(&service.name)), ("version", to_json(&service.version))];
        if !service.extra.is_empty() {
            members.push(("extra", strings(&service.extra)));
        }
        self.item.object(members)
    }
}

fn fits_object(services: &[ListedService]) -> bool {
    services.iter().enumerate().all(|(index, service)| {
        service.extra.is_empty() && services[..index].iter().all(|other| other.name != service.name)
    })
}

/// Returns the text of a service's item in `services`, or of its version in an object.
fn edited_service(old: &str, service: &ListedService) -> String {
    let Some(members) = Members::of(old) else {
        let same = version(old).is_some_and(|version| version == service.version);
        return if same { old.to_owned() } else { to_json(&service.version) };
    };
    let Some(present) = read_service(old, &scan::Item { key: 0..0, value: 0..old.len() }) else {
        return old.to_owned();
    };
    let mut text = old.to_owned();
    if present.version != service.version {
        text = members.with("version", &to_json(&service.version), &["name"]);
    }
    if present.extra != service.extra
        && let Some(members) = Members::of(&text)
    {
        text = if service.extra.is_empty() {
            members.without("extra")
        } else {
            members.with("extra", &strings(&service.extra), &["name", "version"])
        };
    }
    text
}

fn strings(strings: &[String]) -> String {
    let strings: Vec<String> = strings.iter().map(|text| to_json(text)).collect();
    format!("[{}]", strings.join(", "))
}
