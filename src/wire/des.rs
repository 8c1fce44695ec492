//! DES messages: requests, name responses and services responses.
//!
//! Source: protocol §2 (the DES service document). Input and output are whole messages; decoding
//! borrows from them, encoding yields bytes, and neither allocates. Does not know how a message is
//! split into frames: see [`super::framing`] and [`super::isotp`].

use core::iter;

/// Longest message, in bytes: the largest length in an ISO 15765-2 first frame without escape.
pub const MAX_MESSAGE: usize = 4095;
/// Most services in one response: their index is one byte.
pub const MAX_SERVICES: usize = 256;
/// Type byte of a name request and of a name response.
pub const TYPE_NAME: u8 = 0x01;
/// Type byte of a services request and of a services response.
pub const TYPE_SERVICES: u8 = 0x02;

/// A request that DES defines (protocol §2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Request {
    /// The response carries the device's name.
    Name,
    /// The response carries the device's services with their versions.
    Services,
}

impl Request {
    /// Returns the four bytes of the request: `DES` and the type byte.
    pub const fn encode(self) -> [u8; 4] {
        [b'D', b'E', b'S', self.type_byte()]
    }

    /// Returns the type byte, which is also the first byte of the response.
    pub const fn type_byte(self) -> u8 {
        match self {
            Request::Name => TYPE_NAME,
            Request::Services => TYPE_SERVICES,
        }
    }

    /// Reads a message as a request; `None` if it is not one.
    pub fn decode(message: &[u8]) -> Option<ReceivedRequest> {
        match message {
            [b'D', b'E', b'S', TYPE_NAME] => Some(ReceivedRequest::Known(Request::Name)),
            [b'D', b'E', b'S', TYPE_SERVICES] => Some(ReceivedRequest::Known(Request::Services)),
            [b'D', b'E', b'S', reserved] => Some(ReceivedRequest::Reserved(*reserved)),
            _ => None,
        }
    }
}

/// A request as received (protocol §2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReceivedRequest {
    /// Name or services.
    Known(Request),
    /// A reserved type byte, 00 or 03 to FF. Requires no response.
    Reserved(u8),
}

/// Why a response is malformed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[non_exhaustive]
pub enum ResponseFault {
    /// The first byte of a name response is not [`TYPE_NAME`].
    #[error("not a name response")]
    NotAName,
    /// The first byte of a services response is not [`TYPE_SERVICES`].
    #[error("not a services response")]
    NotServices,
    /// The message ends inside a string or before a service's version.
    #[error("truncated")]
    Truncated,
    /// The index of the first service is not 0.
    #[error("service index out of order")]
    BadIndex,
    /// More than [`MAX_SERVICES`] services.
    #[error("more than 256 services")]
    TooManyServices,
    /// More than [`MAX_MESSAGE`] bytes.
    #[error("more than 4095 bytes")]
    TooLong,
    /// Bytes follow the terminating zero of the name.
    #[error("bytes after the name")]
    BytesAfterName,
}

/// Reads a name response: `01`, the bytes of the name, `00` (protocol §2.2).
///
/// Returns the name without its terminating zero, as far as it can be read, and what is wrong with
/// the message. Both can be present: a name without a terminating zero counts as a name.
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

/// Yields the bytes of a name response. `name` must not contain a zero byte.
///
/// ```
/// use descan::wire::des;
///
/// assert!(des::encode_name(b"FEED").eq(*b"\x01FEED\0"));
/// assert_eq!(des::decode_name(b"\x01FEED\0"), (Some(&b"FEED"[..]), None));
/// ```
pub fn encode_name(name: &[u8]) -> impl Iterator<Item = u8> {
    iter::once(TYPE_NAME).chain(name.iter().copied()).chain(iter::once(0))
}

/// One service in a services response.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct ServiceInfo<'a> {
    /// Index in the response, 0 to 255.
    pub index: u8,
    strings: &'a [u8],
}

impl<'a> ServiceInfo<'a> {
    /// Yields the strings without their terminating zeros: name, version, possibly more.
    pub fn strings(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        let text = self.strings.strip_suffix(&[0]).unwrap_or(self.strings);
        let mut parts = (!self.strings.is_empty()).then(|| text.split(|&byte| byte == 0));
        iter::from_fn(move || parts.as_mut()?.next())
    }

    /// Returns the first string, the service's name; empty if it is missing.
    pub fn name(&self) -> &'a [u8] {
        self.strings().next().unwrap_or_default()
    }

    /// Returns the second string, the service's version; empty if it is missing.
    pub fn version(&self) -> &'a [u8] {
        self.strings().nth(1).unwrap_or_default()
    }
}

/// How the strings of a response are assigned to its services.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Division {
    /// The same number of strings for each service.
    Fixed(usize),
    /// Byte by byte: no fixed number fits.
    Linear,
}

/// A services response: `02`, then for each service its index and its strings, each ended by `00`
/// (protocol §2.3).
///
/// The number of strings per service is not fixed. The smallest number from 2 to 8 wins with which
/// the indices of at least two services run exactly to the end. If none does, a byte equal to the
/// next index begins the next service if at least two terminated strings follow it.
#[derive(Clone, Copy)]
pub struct ServicesResponse<'a> {
    body: &'a [u8],
    division: Division,
    fault: Option<ResponseFault>,
}

impl<'a> ServicesResponse<'a> {
    /// Reads a response. A malformed one has a [`fault`](Self::fault) and the services before it.
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

    /// Returns what is wrong with the response; `None` if it is well-formed.
    pub fn fault(&self) -> Option<ResponseFault> {
        self.fault
    }

    /// Yields the services in the order of the response.
    pub fn services(&self) -> impl Iterator<Item = ServiceInfo<'a>> + use<'a> {
        let division = self.division;
        let mut rest = self.body;
        let mut index = 0u8;
        iter::from_fn(move || {
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

/// Returns the length of `count` terminated strings at the start of `bytes`, zeros included;
/// `None` if there are fewer.
fn after_strings(bytes: &[u8], count: usize) -> Option<usize> {
    if count == 0 {
        return Some(0);
    }
    bytes.iter().enumerate().filter(|&(_, &byte)| byte == 0).nth(count - 1).map(|(at, _)| at + 1)
}

/// Returns true if at least two services of `strings` strings each run exactly to the end.
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

/// Returns how many bytes of `strings` belong to the service at their start: name and version, then
/// further strings up to a byte equal to `next` that two terminated strings follow.
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

/// Yields the bytes of a services response. Each service is its list of strings: name, version,
/// possibly more; at most [`MAX_SERVICES`] services.
///
/// ```
/// use descan::wire::des::{self, ServicesResponse};
///
/// let message: Vec<u8> = des::encode_services(&[["DES", "1.0"], ["AUGER", "2.1"]]).collect();
/// let response = ServicesResponse::decode(&message);
/// assert_eq!(response.services().nth(1).unwrap().name(), b"AUGER");
/// ```
pub fn encode_services<'a, L, S>(services: &'a [L]) -> impl Iterator<Item = u8>
where
    L: AsRef<[S]>,
    S: AsRef<[u8]> + 'a,
{
    iter::once(TYPE_SERVICES).chain(
        services
            .iter()
            .enumerate()
            .flat_map(|(index, list)| iter::once(index as u8).chain(terminated(list.as_ref()))),
    )
}

/// Yields the bytes of strings, each followed by a zero.
fn terminated<S: AsRef<[u8]>>(strings: &[S]) -> impl Iterator<Item = u8> {
    strings.iter().flat_map(|string| string.as_ref().iter().copied().chain(iter::once(0)))
}
