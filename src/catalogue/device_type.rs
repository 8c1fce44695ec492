//! A type of device, as its file describes it.

use crate::discovery::DeviceService;
use crate::text::{Quoted, join_first, printable};
use crate::toml_error::{TomlError, ValuePlaces};
use crate::wire::data_layout::{DataFieldValue, DataLayout, check_name};
use crate::wire::descriptor::{ByteOrder, Gid};
use crate::wire::id::{Header, Service};
use crate::wire::profile;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

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
    byte_order: ByteOrder,
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
    request: DataLayout,
    response: DataLayout,
    data: DataLayout,
}

/// A DEBUG message of a type of device.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DebugMessage {
    /// Its name.
    pub name: String,
    parameters: DataLayout,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DeviceTypeEntry {
    gid: Option<String>,
    name: Option<String>,
    title: Option<String>,
    documentation: Option<String>,
    #[serde(default, deserialize_with = "profile::byte_order")]
    byte_order: ByteOrder,
    #[serde(default)]
    services: Vec<TypeServiceEntry>,
    #[serde(default)]
    debug: Vec<DebugMessageEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TypeServiceEntry {
    name: String,
    version: Option<String>,
    number: Option<u16>,
    #[serde(default)]
    optional: bool,
    summary: Option<String>,
    #[serde(default)]
    request: DataLayout,
    #[serde(default)]
    response: DataLayout,
    #[serde(default)]
    data: DataLayout,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DebugMessageEntry {
    code: u16,
    name: String,
    #[serde(default)]
    parameters: DataLayout,
}

/// A mistake in a file: the name of the value, and what is wrong about it.
struct TypeFault {
    key: &'static str,
    message: String,
}

fn fault(key: &'static str, message: impl Into<String>) -> TypeFault {
    TypeFault { key, message: message.into() }
}

fn line_of(key: &'static str, text: Option<String>) -> Result<String, TypeFault> {
    let text = text.unwrap_or_default();
    if text.chars().count() > MAX_LINE || text.chars().any(|c| !crate::text::is_printable(c)) {
        let message = format!("at most {MAX_LINE} printable characters on one line");
        return Err(fault(key, format!("{key}: {message}")));
    }
    Ok(text)
}

fn number_of(number: u16, what: &str) -> Result<Service, String> {
    Service::new(number).ok_or_else(|| format!("{what} is 0 to 0x3FF, not {number}"))
}

impl DeviceTypeEntry {
    fn checked(self) -> Result<DeviceType, TypeFault> {
        let gid = self.gid.map(|text| {
            let digits = text.replace([' ', ':'], "");
            Gid::parse(&digits).filter(|gid| !gid.is_blank()).ok_or_else(|| {
                let text = printable(text.as_bytes());
                fault(
                    "gid",
                    format!("gid: \"{text}\" is not 12 hexadecimal digits, not all 0 or F"),
                )
            })
        });
        if let Some(name) = &self.name {
            check_name(name, "name").map_err(|why| fault("name", why))?;
        }
        if self.services.len() > MAX_SERVICES || self.debug.len() > MAX_SERVICES {
            return Err(fault("services", format!("at most {MAX_SERVICES} services and messages")));
        }
        let mut services: Vec<TypeService> = Vec::with_capacity(self.services.len());
        for entry in self.services {
            let service = entry.checked().map_err(|why| fault("services", why))?;
            if services.iter().any(|known| known.name == service.name) {
                return Err(fault("services", format!("two services are called {}", service.name)));
            }
            let same =
                services.iter().find(|it| it.number.is_some() && it.number == service.number);
            if let Some(same) = same {
                let message = format!("{} and {} have one number", same.name, service.name);
                return Err(fault("services", message));
            }
            services.push(service);
        }
        let mut debug_messages = BTreeMap::new();
        for DebugMessageEntry { code, name, parameters } in self.debug {
            check_name(&name, "the name of a message").map_err(|why| fault("debug", why))?;
            number_of(code, "the code of a DEBUG message").map_err(|why| fault("debug", why))?;
            if debug_messages.insert(code, DebugMessage { name, parameters }).is_some() {
                return Err(fault("debug", format!("code {code} stands twice")));
            }
        }
        let documentation = line_of("documentation", self.documentation)?;
        Ok(DeviceType {
            gid: gid.transpose()?,
            name: self.name,
            title: line_of("title", self.title)?,
            documentation: Some(documentation).filter(|link| !link.is_empty()),
            services,
            debug_messages,
            byte_order: self.byte_order,
        })
    }
}

impl TypeServiceEntry {
    fn checked(self) -> Result<TypeService, String> {
        let Self { name, version, number, optional, summary, request, response, data } = self;
        check_name(&name, "the name of a service")?;
        if let Some(version) = &version {
            check_name(version, &format!("{name}: a version"))?;
        }
        let number = number.map(|number| number_of(number, &format!("{name}: a service number")));
        let number = number.transpose()?;
        let has_layout = [&request, &response, &data].into_iter().any(|it| !it.is_empty());
        if has_layout && number.is_none() {
            return Err(format!("{name}: its fields need a number, by which frames are found"));
        }
        let summary = line_of("summary", summary).map_err(|fault| fault.message)?;
        let is_optional = optional;
        Ok(TypeService { name, version, number, is_optional, summary, request, response, data })
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
        entry.checked().map_err(|TypeFault { key, message }| {
            TomlError::new(text, ValuePlaces::of(text).get(key), message)
        })
    }

    /// Returns true if it holds for all devices.
    pub fn is_common(&self) -> bool {
        self.gid.is_none() && self.name.is_none()
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
