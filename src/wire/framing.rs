//! The two ways a DES message is laid into frames: as it stands (raw) or by ISO 15765-2
//! (isotp), and how to tell them apart.
//!
//! The DES description does not name a framing; its advice of five characters "so that the
//! answer fits one frame" fits ISO 15765-2 single frames. Does not keep transfers in progress.

use super::des::{ServicesResponse, TYPE_NAME, TYPE_SERVICES};
use super::isotp::Pci;
use serde::{Deserialize, Serialize};
use std::fmt;

/// How a device lays its messages into frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Framing {
    /// ISO 15765-2, normal addressing.
    Isotp,
    /// The message is the frame's data.
    Raw,
}

impl fmt::Display for Framing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Framing::Isotp => "isotp",
            Framing::Raw => "raw",
        })
    }
}

/// Which framing the frame of an answer has; `None` is neither, a finding.
///
/// isotp: byte 0 is 01–07 with at least that many bytes behind it and byte 1 is an answer's
/// type (on FD also `00 LL`); a first frame; or, while a transfer is open, a consecutive frame
/// or flow control. Else raw, where byte 0 is an answer's type.
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

/// Which framing the frame of a request has, and the request's message.
pub fn classify_request(data: &[u8], fd: bool) -> Option<(Framing, &[u8])> {
    if data.starts_with(b"DES") && data.len() >= 4 {
        return Some((Framing::Raw, &data[..4]));
    }
    match Pci::decode(data, fd) {
        Ok(Pci::Single(message)) if message.starts_with(b"DES") => Some((Framing::Isotp, message)),
        _ => None,
    }
}

/// The message in a raw frame, without what looks like padding: whatever follows a name's zero,
/// and after a services answer a uniform tail of 00, 55, AA, CC or FF.
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
        // Zeros end strings too: leave as many as make the answer whole.
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
    fn padding_of_raw_answers() {
        assert_eq!(strip_raw_padding(&[1, b'A', 0, 0x55, 0x12]), [1, b'A', 0]);
        assert_eq!(strip_raw_padding(&[2, 0xCC, 0xCC]), [2]);
        assert_eq!(strip_raw_padding(&[2, 0, 0, 0, 0, 0, 0, 0]), [2]);
        assert_eq!(strip_raw_padding(&[2, 0, 65, 0, 49, 0, 0, 0]), [2, 0, 65, 0, 49, 0]);
        assert_eq!(strip_raw_padding(&[2, 0, 65, 0, 49, 0, 0xAA]), [2, 0, 65, 0, 49, 0]);
    }

    #[test]
    fn requests_in_both_framings() {
        let (isotp, raw) = ([4, b'D', b'E', b'S', 2], *b"DES\x02");
        assert_eq!(classify_request(&isotp, false), Some((Framing::Isotp, &raw[..])));
        assert_eq!(classify_request(&raw, false), Some((Framing::Raw, &raw[..])));
        assert_eq!(classify_request(&[4, 1, 2, 3, 4], false), None);
    }
}
