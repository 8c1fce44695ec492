//! The messages of DES, the devices enumeration service: requests, name answers and services
//! answers.
//!
//! Source: the DES description, "Описание сообщений DES". Does not know how a message is cut
//! into frames: that is [`super::framing`].

/// The most bytes a message may have (what an ISO 15765-2 first frame with 12 bits can say).
pub const MAX_MESSAGE: usize = 4095;
/// The most services an answer may list: their index is one byte.
pub const MAX_SERVICES: usize = 256;
/// The type byte of a who-is-there request and of a name answer.
pub const TYPE_NAME: u8 = 0x01;
/// The type byte of a services request and of a services answer.
pub const TYPE_SERVICES: u8 = 0x02;

/// What a device is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Request {
    /// Who is there? Answered with the device's name.
    Name,
    /// Which services, in which versions?
    Services,
}

impl Request {
    /// The four bytes of the request: "DES" and the type.
    pub const fn encode(self) -> [u8; 4] {
        [b'D', b'E', b'S', self.type_byte()]
    }

    /// The type byte, repeated as the answer's first byte.
    pub const fn type_byte(self) -> u8 {
        match self {
            Request::Name => TYPE_NAME,
            Request::Services => TYPE_SERVICES,
        }
    }

    /// What the bytes of a message ask, where they are a request.
    pub fn decode(message: &[u8]) -> Option<Asked> {
        match message {
            [b'D', b'E', b'S', TYPE_NAME] => Some(Asked::Known(Request::Name)),
            [b'D', b'E', b'S', TYPE_SERVICES] => Some(Asked::Known(Request::Services)),
            [b'D', b'E', b'S', reserved] => Some(Asked::Reserved(*reserved)),
            _ => None,
        }
    }
}

/// A request as it was heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// One of the two that are defined.
    Known(Request),
    /// A reserved type, 00 or 03–FF: shown as such, never sent, never answered.
    Reserved(u8),
}

/// What is wrong with an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum ResponseFault {
    /// The first byte is not the type that was asked for.
    #[error("not a name response")]
    NotAName,
    /// The first byte is not 02.
    #[error("not a services response")]
    NotServices,
    /// The message ends inside a string or before a service's version.
    #[error("truncated")]
    Truncated,
    /// The first service's index is not 0.
    #[error("service index out of order")]
    BadIndex,
    /// More than [`MAX_SERVICES`].
    #[error("more than 256 services")]
    TooManyServices,
    /// More than [`MAX_MESSAGE`] bytes.
    #[error("more than 4095 bytes")]
    TooLong,
    /// Bytes follow the name's terminating zero.
    #[error("bytes after the name")]
    BytesAfterName,
}

/// The name in a name answer: `01`, the name's bytes, `00`.
///
/// What could be read comes even where something is wrong.
pub fn decode_name(message: &[u8]) -> (Option<&[u8]>, Option<ResponseFault>) {
    if message.len() > MAX_MESSAGE {
        return (None, Some(ResponseFault::TooLong));
    }
    let [TYPE_NAME, rest @ ..] = message else {
        return (None, Some(ResponseFault::NotAName));
    };
    match rest.iter().position(|&byte| byte == 0) {
        Some(end) if end + 1 == rest.len() => (Some(&rest[..end]), None),
        Some(end) => (Some(&rest[..end]), Some(ResponseFault::BytesAfterName)),
        None => (Some(rest), Some(ResponseFault::Truncated)),
    }
}

/// The message of a name answer.
pub fn encode_name(name: &[u8]) -> Vec<u8> {
    let mut message = Vec::with_capacity(name.len() + 2);
    message.push(TYPE_NAME);
    message.extend_from_slice(name);
    message.push(0);
    message
}

/// One service as a device lists it.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct ServiceInfo<'a> {
    /// Its index in the answer.
    pub index: u8,
    strings: &'a [u8],
}

impl<'a> ServiceInfo<'a> {
    /// Its strings, without their terminating zeros: name, version, possibly more.
    pub fn strings(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        let text = self.strings.strip_suffix(&[0]).unwrap_or(self.strings);
        let mut parts = (!self.strings.is_empty()).then(|| text.split(|&byte| byte == 0));
        std::iter::from_fn(move || parts.as_mut()?.next())
    }

    /// The first string: the service's name.
    pub fn name(&self) -> &'a [u8] {
        self.strings().next().unwrap_or_default()
    }

    /// The second string: the service's version.
    pub fn version(&self) -> &'a [u8] {
        self.strings().nth(1).unwrap_or_default()
    }
}

/// How the strings of an answer are divided among its services.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Division {
    /// The same number of strings for every service.
    Fixed(usize),
    /// Byte by byte, where no fixed number fits.
    Linear,
}

/// A services answer: `02`, then per service its index and its strings, each ended by `00`.
///
/// The description fixes two strings and leaves room for more. So first every fixed number of
/// strings from 2 to 8 is tried; the smallest with which the indices of at least two services
/// run exactly to the end is taken. Otherwise a byte equal to the next index opens the next
/// service where at least two terminated strings follow it.
#[derive(Clone, Copy)]
pub struct ServicesResponse<'a> {
    body: &'a [u8],
    division: Division,
    fault: Option<ResponseFault>,
}

impl<'a> ServicesResponse<'a> {
    /// Reads an answer. What is wrong with it is its [`fault`](Self::fault).
    pub fn decode(message: &'a [u8]) -> Self {
        let refused = |fault| Self { body: &[], division: Division::Linear, fault: Some(fault) };
        if message.len() > MAX_MESSAGE {
            return refused(ResponseFault::TooLong);
        }
        let [TYPE_SERVICES, body @ ..] = message else {
            return refused(ResponseFault::NotServices);
        };
        if let Some(&first) = body.first()
            && first != 0
        {
            return refused(ResponseFault::BadIndex);
        }
        if let Some(strings) = (2..=8).find(|&strings| fits_fixed(body, strings)) {
            return Self { body, division: Division::Fixed(strings), fault: None };
        }
        let mut response = Self { body, division: Division::Linear, fault: None };
        let mut last = None;
        let mut count = 0;
        for service in response.services() {
            count += 1;
            last = Some(service);
        }
        response.fault = match last {
            _ if count > MAX_SERVICES => return refused(ResponseFault::TooManyServices),
            Some(last) if last.strings.last() != Some(&0) || last.strings().count() < 2 => {
                Some(ResponseFault::Truncated)
            }
            _ => None,
        };
        response
    }

    /// What is wrong with the answer; the services read so far are there all the same.
    pub fn fault(&self) -> Option<ResponseFault> {
        self.fault
    }

    /// The services in the order of the answer.
    pub fn services(&self) -> impl Iterator<Item = ServiceInfo<'a>> + use<'a> {
        let division = self.division;
        let mut rest = self.body;
        let mut index = 0u8;
        std::iter::from_fn(move || {
            let (&first, strings) = rest.split_first()?;
            debug_assert_eq!(first, index);
            let length = match division {
                Division::Fixed(count) => after_strings(strings, count).unwrap_or(strings.len()),
                Division::Linear => linear_length(strings, index.wrapping_add(1)),
            };
            rest = &strings[length..];
            let service = ServiceInfo { index, strings: &strings[..length] };
            index = index.wrapping_add(1);
            Some(service)
        })
    }
}

/// The length of `count` terminated strings at the start of `bytes`, if they are there.
fn after_strings(bytes: &[u8], count: usize) -> Option<usize> {
    if count == 0 {
        return Some(0);
    }
    bytes.iter().enumerate().filter(|&(_, &byte)| byte == 0).nth(count - 1).map(|(at, _)| at + 1)
}

/// Whether services of `strings` strings each, at least two of them, run exactly to the end.
fn fits_fixed(mut body: &[u8], strings: usize) -> bool {
    let mut count = 0usize;
    while let Some((&index, rest)) = body.split_first() {
        if count >= MAX_SERVICES || usize::from(index) != count {
            return false;
        }
        let Some(length) = after_strings(rest, strings) else { return false };
        body = &rest[length..];
        count += 1;
    }
    count >= 2
}

/// How many bytes of `strings` belong to the service they begin with: name and version, then
/// further strings until a byte equal to `next` with two terminated strings behind it.
fn linear_length(strings: &[u8], next: u8) -> usize {
    let Some(mut length) = after_strings(strings, 2) else { return strings.len() };
    loop {
        match &strings[length..] {
            [] => return length,
            [byte, behind @ ..] if *byte == next && after_strings(behind, 2).is_some() => {
                return length;
            }
            further => match after_strings(further, 1) {
                Some(string) => length += string,
                None => return strings.len(),
            },
        }
    }
}

/// The message of a services answer; each service is its list of strings.
pub fn encode_services<S: AsRef<[u8]>>(services: &[Vec<S>]) -> Vec<u8> {
    let mut message = vec![TYPE_SERVICES];
    for (index, strings) in services.iter().enumerate() {
        message.push(index as u8);
        for string in strings {
            message.extend_from_slice(string.as_ref());
            message.push(0);
        }
    }
    message
}
