//! A type of device, as its file describes it.

use crate::discovery::DeviceService;
use crate::text::{Quoted, join_first, printable};
use crate::toml_error::TomlError;
use crate::wire::data_layout::{DataFieldValue, DataLayout, DataLayoutEntry, check_name};
use crate::wire::descriptor::{ByteOrder, Gid};
use crate::wire::id::{Header, Service};
use crate::wire::profile;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use toml::Spanned;

/// Most characters of a title, a summary or a link.
const MAX_LINE: usize = 200;
/// Most services and most DEBUG messages of a type; DES has at most 256 services.
const MAX_SERVICES: usize = 256;
/// Differences that a text names; the others are counted.
const NAMED: usize = 4;

/// What is known of a type of device. Without GID and name it holds for all devices.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DeviceType {
    /// Its GID; `None` if it is recognized by its name.
    pub gid: Option<Gid>,
    /// The name that its devices respond in DES; `None` if that is of no concern.
    pub name: Option<String>,
    /// What it is, for people; empty if the file does not say so.
    pub title: String,
    /// Where its documentation is.
    pub documentation: Option<String>,
    /// The services.
    pub services: Vec<TypeService>,
    /// The DEBUG messages, by code.
    pub debug_messages: BTreeMap<u16, DebugMessage>,
    /// Order of the bytes of numbers in the data.
    pub byte_order: ByteOrder,
}

/// A service of a type of device.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TypeService {
    /// Its name in DES.
    pub name: String,
    /// Its version in DES, or the beginning of it: `2` stands for `2.1`, too. `None` for any.
    pub version: Option<String>,
    /// Its number in identifiers; `None` if it is not known.
    pub number: Option<Service>,
    /// A device of the type may be without it.
    pub is_optional: bool,
    /// What it does, for people; empty if the file does not say so.
    pub summary: String,
    /// Data of its requests.
    pub request: DataLayout,
    /// Data of the responses to them.
    pub response: DataLayout,
    /// Data that it sends unasked.
    pub data: DataLayout,
}

/// A DEBUG message of a type of device.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DebugMessage {
    /// Its name.
    pub name: String,
    /// Its parameters.
    pub parameters: DataLayout,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DeviceTypeEntry {
    gid: Option<Spanned<String>>,
    name: Option<Spanned<String>>,
    title: Option<Spanned<String>>,
    documentation: Option<Spanned<String>>,
    #[serde(default, deserialize_with = "profile::byte_order")]
    byte_order: ByteOrder,
    #[serde(default)]
    services: Vec<Spanned<TypeServiceEntry>>,
    #[serde(default)]
    debug: Vec<Spanned<DebugMessageEntry>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypeServiceEntry {
    name: Spanned<String>,
    version: Option<Spanned<String>>,
    number: Option<Spanned<u16>>,
    #[serde(default)]
    optional: bool,
    summary: Option<Spanned<String>>,
    #[serde(default)]
    request: DataLayoutEntry,
    #[serde(default)]
    response: DataLayoutEntry,
    #[serde(default)]
    data: DataLayoutEntry,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DebugMessageEntry {
    code: Spanned<u16>,
    name: Spanned<String>,
    #[serde(default)]
    parameters: DataLayoutEntry,
}

/// A mistake: its place, and what is wrong.
type TypeFault = (Range<usize>, String);

fn line_of(key: &str, text: Option<Spanned<String>>) -> Result<String, TypeFault> {
    let Some(text) = text else { return Ok(String::new()) };
    let (span, text) = (text.span(), text.into_inner());
    if text.chars().count() > MAX_LINE || text.chars().any(|c| !crate::text::is_printable(c)) {
        let message = format!("at most {MAX_LINE} printable characters on one line");
        return Err((span, format!("{key}: {message}")));
    }
    Ok(text)
}

fn number_of(number: &Spanned<u16>, what: &str) -> Result<Service, TypeFault> {
    let value = *number.get_ref();
    let wrong = || (number.span(), format!("{what} is 0 to 0x3FF, not {value}"));
    Service::new(value).ok_or_else(wrong)
}

fn name_of(name: Spanned<String>, what: &str) -> Result<String, TypeFault> {
    let (span, name) = (name.span(), name.into_inner());
    check_name(&name, what).map_err(|why| (span, why))?;
    Ok(name)
}

fn gid_of(text: &Spanned<String>) -> Result<Gid, TypeFault> {
    let digits = text.get_ref().replace([' ', ':'], "");
    Gid::parse(&digits).filter(|gid| !gid.is_blank()).ok_or_else(|| {
        let shown = printable(text.get_ref().as_bytes());
        (text.span(), format!("gid: \"{shown}\" is not 12 hexadecimal digits, not all 0 or F"))
    })
}

/// The place of the first one that is too many.
fn first_surplus<T>(all: &[Spanned<T>]) -> Option<Range<usize>> {
    all.get(MAX_SERVICES).map(Spanned::span)
}

impl DeviceTypeEntry {
    fn checked(self) -> Result<DeviceType, TypeFault> {
        let surplus = first_surplus(&self.services).or_else(|| first_surplus(&self.debug));
        if let Some(span) = surplus {
            return Err((span, format!("at most {MAX_SERVICES} services and messages")));
        }
        let documentation = line_of("documentation", self.documentation)?;
        Ok(DeviceType {
            gid: self.gid.as_ref().map(gid_of).transpose()?,
            name: self.name.map(|name| name_of(name, "name")).transpose()?,
            title: line_of("title", self.title)?,
            documentation: Some(documentation).filter(|link| !link.is_empty()),
            services: services_of(self.services)?,
            debug_messages: debug_messages_of(self.debug)?,
            byte_order: self.byte_order,
        })
    }
}

fn services_of(entries: Vec<Spanned<TypeServiceEntry>>) -> Result<Vec<TypeService>, TypeFault> {
    let mut services: Vec<TypeService> = Vec::with_capacity(entries.len());
    for entry in entries {
        let entry = entry.into_inner();
        let (name_at, number_at) = (entry.name.span(), entry.number.as_ref().map(Spanned::span));
        let service = entry.checked()?;
        if services.iter().any(|known| known.name == service.name) {
            return Err((name_at, format!("two services are called {}", service.name)));
        }
        let same = services.iter().find(|it| it.number.is_some() && it.number == service.number);
        if let Some(same) = same {
            let message = format!("{} and {} have one number", same.name, service.name);
            return Err((number_at.unwrap_or(name_at), message));
        }
        services.push(service);
    }
    Ok(services)
}

fn debug_messages_of(
    entries: Vec<Spanned<DebugMessageEntry>>,
) -> Result<BTreeMap<u16, DebugMessage>, TypeFault> {
    let mut messages = BTreeMap::new();
    for entry in entries {
        let DebugMessageEntry { code, name, parameters } = entry.into_inner();
        let name = name_of(name, "the name of a message")?;
        let number = number_of(&code, "the code of a DEBUG message")?.number();
        let message = DebugMessage { name, parameters: parameters.checked()? };
        if messages.insert(number, message).is_some() {
            return Err((code.span(), format!("code {number} stands twice")));
        }
    }
    Ok(messages)
}

impl TypeServiceEntry {
    fn checked(self) -> Result<TypeService, TypeFault> {
        let Self { name, version, number, optional, summary, request, response, data } = self;
        let name_at = name.span();
        let name = name_of(name, "the name of a service")?;
        let version = version.map(|version| name_of(version, &format!("{name}: a version")));
        let number = number.map(|number| number_of(&number, &format!("{name}: a service number")));
        let number = number.transpose()?;
        let has_layout = [&request, &response, &data].into_iter().any(|it| !it.is_empty());
        if has_layout && number.is_none() {
            let text = format!("{name}: its fields need a number, by which frames are found");
            return Err((name_at, text));
        }
        Ok(TypeService {
            name,
            version: version.transpose()?,
            number,
            is_optional: optional,
            summary: line_of("summary", summary)?,
            request: request.checked()?,
            response: response.checked()?,
            data: data.checked()?,
        })
    }
}

impl DeviceType {
    /// Reads the file of a type.
    ///
    /// ```
    /// use descan::catalogue::DeviceType;
    ///
    /// let feeder = DeviceType::parse("name = 'FEED'\ntitle = 'Pellet feeder'").unwrap();
    /// assert_eq!(feeder.title, "Pellet feeder");
    /// assert!(DeviceType::parse("gid = 'F2'").is_err());
    /// ```
    ///
    /// # Errors
    ///
    /// The first mistake, with its place: it is not TOML, has unknown names, or a value is out of range.
    pub fn parse(text: &str) -> Result<Self, TomlError> {
        let entry: DeviceTypeEntry =
            toml::from_str(text).map_err(|error| TomlError::of(text, &error))?;
        entry.checked().map_err(|(span, message)| TomlError::new(text, Some(span), message))
    }

    /// Returns true if it holds for all devices.
    pub fn is_common(&self) -> bool {
        self.gid.is_none() && self.name.is_none()
    }

    /// Says what another type of all devices has that this one has otherwise: the same DEBUG code, or the
    /// same service number; `None` if there is nothing.
    pub(super) fn shared_number(&self, other: &Self) -> Option<String> {
        let code = self.debug_messages.iter().find_map(|(code, message)| {
            let other = other.debug_messages.get(code).filter(|other| *other != message)?;
            Some(format!("DEBUG code {} is {}", Service::from_bits(*code), other.name))
        });
        code.or_else(|| {
            self.services.iter().find_map(|service| {
                let number = service.number?;
                let other = other.service(number).filter(|other| *other != service)?;
                Some(format!("service {number} is {}", other.name))
            })
        })
    }

    /// Returns what it is called: its title, else its name.
    pub fn label(&self) -> &str {
        match &self.name {
            Some(name) if self.title.is_empty() => name,
            None if self.title.is_empty() => "untitled type",
            _ => &self.title,
        }
    }

    /// Returns the service with a number.
    pub fn service(&self, number: Service) -> Option<&TypeService> {
        self.services.iter().find(|service| service.number == Some(number))
    }

    /// Returns the data of a frame of one of its services in words, escaped; `None` if the file has no
    /// fields for them.
    pub fn data_in_words(&self, header: Header, data: &[u8]) -> Option<String> {
        let layout = self.service(header.service)?.layout(header);
        (!layout.is_empty()).then(|| layout.in_words(data, self.byte_order))
    }

    /// Returns the fields of the data of a frame of one of its services.
    pub fn data_values<'a>(&'a self, header: Header, data: &'a [u8]) -> Vec<DataFieldValue<'a>> {
        let layout = self.service(header.service).map(|service| service.layout(header));
        layout.map_or_else(Vec::new, |layout| layout.values(data, self.byte_order))
    }

    /// Returns the parameters of a DEBUG message in words, escaped; empty if the file has none.
    pub fn parameters_in_words(&self, code: u16, data: &[u8]) -> String {
        let message = self.debug_messages.get(&code);
        message.map_or_else(String::new, |it| it.parameters.in_words(data, self.byte_order))
    }

    /// Returns the parameters of a DEBUG message.
    pub fn parameter_values<'a>(&'a self, code: u16, data: &'a [u8]) -> Vec<DataFieldValue<'a>> {
        let message = self.debug_messages.get(&code);
        message.map_or_else(Vec::new, |it| it.parameters.values(data, self.byte_order))
    }

    /// Returns how the services of a device differ from those of the type, in words, escaped; `None` if
    /// they do not. A type without services says nothing about them; DES itself need not be listed.
    pub fn difference(&self, services: &[DeviceService]) -> Option<String> {
        if self.services.is_empty() {
            return None;
        }
        let of = |service: &TypeService| {
            services.iter().find(|own| own.name.as_bytes() == service.name.as_bytes())
        };
        let missing = self.services.iter().filter(|it| !it.is_optional && of(it).is_none());
        let missing: Vec<String> = missing.map(|it| it.name.clone()).collect();
        let known: BTreeSet<&[u8]> =
            self.services.iter().map(|it| it.name.as_bytes()).chain([&b"DES"[..]]).collect();
        let more = services.iter().filter(|own| !known.contains(own.name.as_bytes()));
        let more: Vec<String> = more.map(|own| Quoted(own.name.as_bytes()).to_string()).collect();
        let other = self.services.iter().filter_map(|service| {
            let (own, version) = (of(service)?, service.version.as_ref()?);
            let fits = is_version(own.version.as_bytes(), version);
            let own = Quoted(own.version.as_bytes());
            (!fits).then(|| format!("has {} {own}, not {version}", service.name))
        });
        let list = |words: &str, names: Vec<String>| {
            (!names.is_empty()).then(|| format!("{words} {}", join_first(names, NAMED, ", ")))
        };
        let parts = [list("lacks", missing), list("also has", more)];
        let parts: Vec<String> = parts.into_iter().flatten().chain(other).collect();
        (!parts.is_empty()).then(|| join_first(parts, NAMED, "; "))
    }
}

/// Returns true if a version is the described one, or begins with it at a dot.
fn is_version(own: &[u8], described: &str) -> bool {
    own.strip_prefix(described.as_bytes())
        .is_some_and(|rest| rest.is_empty() || rest.starts_with(b"."))
}

impl TypeService {
    /// The layout of the data of a frame.
    fn layout(&self, header: Header) -> &DataLayout {
        match (header.response, header.broadcast) {
            (false, _) => &self.request,
            (true, false) => &self.response,
            (true, true) => &self.data,
        }
    }
}
