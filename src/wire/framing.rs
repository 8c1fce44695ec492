//! The two framings of a DES message, raw and ISO-TP, and how a received frame is classified.
//!
//! Source: protocol §3. The DES service document names no framing; its limit of five characters for
//! a name fits an ISO 15765-2 single frame. Does not hold open transfers: see [`super::isotp`].

use super::des::{ServicesResponse, TYPE_NAME, TYPE_SERVICES};
use super::isotp::Pci;
use core::fmt;

/// How a device splits its messages into frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(
    feature = "std",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "lowercase")
)]
pub enum Framing {
    /// ISO 15765-2 with normal addressing (protocol §3.1).
    Isotp,
    /// The message is the data of one frame (protocol §3.2).
    Raw,
}

/// The word in profiles and JSON: `isotp` or `raw`.
impl fmt::Display for Framing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Framing::Isotp => "isotp",
            Framing::Raw => "raw",
        })
    }
}

/// Returns the framing of a response's frame; `None` if it is neither (protocol §3.3).
///
/// ISO-TP: a single frame whose byte 1 (on FD also byte 2) is the type of a response; a first
/// frame; with `transfer_open`, a consecutive frame or flow control. Otherwise raw if byte 0 is
/// the type of a response. `transfer_open`: this identifier has a transfer in progress.
pub fn classify_response(data: &[u8], fd: bool, transfer_open: bool) -> Option<Framing> {
    let is_type = |byte: Option<&u8>| matches!(byte, Some(&(TYPE_NAME | TYPE_SERVICES)));
    let &first = data.first()?;
    let isotp = match first {
        0x00 => {
            fd && is_type(data.get(2))
                && data.get(1).is_some_and(|&length| usize::from(length) + 2 <= data.len())
        }
        0x01..=0x07 => data.len() > usize::from(first) && is_type(data.get(1)),
        0x10..=0x1F => true,
        0x20..=0x3F => transfer_open,
        _ => false,
    };
    if isotp {
        Some(Framing::Isotp)
    } else if is_type(Some(&first)) {
        Some(Framing::Raw)
    } else {
        None
    }
}

/// Returns the framing of a request's frame and the request's message; `None` if it is not a
/// DES request.
pub fn classify_request(data: &[u8], fd: bool) -> Option<(Framing, &[u8])> {
    if data.starts_with(b"DES") && data.len() >= 4 {
        return Some((Framing::Raw, &data[..4]));
    }
    match Pci::decode(data, fd) {
        Ok(Pci::Single(message)) if message.starts_with(b"DES") => Some((Framing::Isotp, message)),
        _ => None,
    }
}

/// Returns the message of a raw frame without its padding: the bytes behind the zero of a name, and
/// a uniform tail of 00, 55, AA, CC or FF behind a services response (protocol §3.2).
pub fn strip_raw_padding(data: &[u8]) -> &[u8] {
    match data {
        [TYPE_NAME, name @ ..] => match name.iter().position(|&byte| byte == 0) {
            Some(end) => &data[..end + 2],
            None => data,
        },
        [TYPE_SERVICES, .., last @ (0x55 | 0xAA | 0xCC | 0xFF)] => {
            let end = data.iter().rposition(|byte| byte != last).map_or(0, |at| at + 1);
            &data[..end.max(1)]
        }
        // Zeros also end strings: keep the fewest with which the response is well-formed.
        [TYPE_SERVICES, .., 0] => {
            let text = data.iter().rposition(|&byte| byte != 0).map_or(0, |at| at + 1);
            (text..data.len())
                .map(|end| &data[..end])
                .find(|message| ServicesResponse::decode(message).fault().is_none())
                .unwrap_or(data)
        }
        _ => data,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_response_padding_is_stripped() {
        assert_eq!(strip_raw_padding(&[1, b'A', 0, 0x55, 0x12]), [1, b'A', 0]);
        assert_eq!(strip_raw_padding(&[2, 0xCC, 0xCC]), [2]);
        assert_eq!(strip_raw_padding(&[2, 0, 0, 0, 0, 0, 0, 0]), [2]);
        assert_eq!(strip_raw_padding(&[2, 0, 65, 0, 49, 0, 0, 0]), [2, 0, 65, 0, 49, 0]);
        assert_eq!(strip_raw_padding(&[2, 0, 65, 0, 49, 0, 0xAA]), [2, 0, 65, 0, 49, 0]);
    }

    #[test]
    fn request_in_either_framing_is_recognised() {
        let (isotp, raw) = ([4, b'D', b'E', b'S', 2], *b"DES\x02");
        assert_eq!(classify_request(&isotp, false), Some((Framing::Isotp, &raw[..])));
        assert_eq!(classify_request(&raw, false), Some((Framing::Raw, &raw[..])));
        assert_eq!(classify_request(&[4, 1, 2, 3, 4], false), None);
    }
}
