//! CAN frames in the packets of pcap and pcapng files, by their link type.
//!
//! Source: LINKTYPE_CAN_SOCKETCAN (227), LINKTYPE_LINUX_SLL (113) and LINKTYPE_LINUX_SLL2 (276) of the
//! tcpdump group. Does not know times or interfaces.

use super::pcapng::PacketFault;
use crate::frame::socketcan::{self as fields, ERROR_FLAG, EXTENDED_FLAG, FD_FORMAT};
use crate::frame::{CanId, Frame};

/// A packet is a CAN frame.
pub(super) const SOCKETCAN: u16 = 227;
/// A packet of any interface of a Linux machine.
const COOKED: u16 = 113;
/// The same with the number of the interface.
const COOKED_V2: u16 = 276;

/// Bytes before a frame's data: identifier word, length, FD flags, a reserved byte, raw DLC.
pub(super) const CAN_HEAD: usize = 8;
/// Flag in the length byte of a CAN XL frame.
const XL_FORMAT: u8 = 0x80;
/// Bytes of the heads of cooked packets.
const COOKED_HEAD: usize = 16;
const COOKED_V2_HEAD: usize = 20;
/// Protocols of cooked packets.
const CAN: u16 = 0x000C;
const CAN_FD: u16 = 0x000D;
const CAN_XL: u16 = 0x000E;
/// Type of a cooked packet that the machine sent.
const OUTGOING: u16 = 4;

/// The byte order of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FileOrder {
    Big,
    Little,
}

/// A packet that is a CAN frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct CanPacket {
    /// The frame; `is_tx` is set if the packet says so.
    pub frame: Frame,
    /// Number of the interface on its machine, if the packet has it.
    pub interface: Option<u32>,
}

/// Returns true if packets of a link type may be CAN frames.
pub(super) fn is_known(link_type: u16) -> bool {
    matches!(link_type, SOCKETCAN | COOKED | COOKED_V2)
}

/// Decodes a packet; `None` for one of another protocol than CAN.
pub(super) fn decode(
    link_type: u16,
    packet: &[u8],
    order: FileOrder,
) -> Result<Option<CanPacket>, PacketFault> {
    let word = |at: usize| u16::from_be_bytes([packet[at], packet[at + 1]]);
    let (protocol, kind, interface, head) = match link_type {
        SOCKETCAN => {
            let frame = decode_frame(packet, FileOrder::Big, false)?;
            return Ok(Some(CanPacket { frame, interface: None }));
        }
        COOKED if packet.len() >= COOKED_HEAD => (word(14), word(0), None, COOKED_HEAD),
        COOKED_V2 if packet.len() >= COOKED_V2_HEAD => {
            let interface = u32::from_be_bytes([packet[4], packet[5], packet[6], packet[7]]);
            (word(0), u16::from(packet[10]), Some(interface), COOKED_V2_HEAD)
        }
        COOKED | COOKED_V2 => return Err(PacketFault::Short),
        other => return Err(PacketFault::LinkType(other)),
    };
    let mut frame = match protocol {
        // The identifier is in the byte order of the machine that captured it, as the file is.
        CAN | CAN_FD => decode_frame(&packet[head..], order, protocol == CAN_FD)?,
        CAN_XL => return Err(PacketFault::Xl),
        _ => return Ok(None),
    };
    frame.is_tx = kind == OUTGOING;
    Ok(Some(CanPacket { frame, interface }))
}

/// Decodes identifier, length, FD flags and data of a frame that is in FD format in any case, or where its
/// flags or its length say so.
fn decode_frame(packet: &[u8], order: FileOrder, is_fd: bool) -> Result<Frame, PacketFault> {
    let (head, data) = packet.split_at_checked(CAN_HEAD).ok_or(PacketFault::NoFrame)?;
    let word = [head[0], head[1], head[2], head[3]];
    let raw = match order {
        FileOrder::Big => u32::from_be_bytes(word),
        FileOrder::Little => u32::from_le_bytes(word),
    };
    let (len, flags) = (usize::from(head[4]), head[5]);
    if head[4] & XL_FORMAT != 0 {
        return Err(PacketFault::Xl);
    }
    let has_id = raw & (EXTENDED_FLAG | ERROR_FLAG) != 0;
    if !has_id && raw & CanId::MAX_EXTENDED > u32::from(CanId::MAX_STANDARD) {
        return Err(PacketFault::NoFrame);
    }
    // Writers without the FDF flag mark FD frames only by their length.
    let fd = is_fd || flags & FD_FORMAT != 0 || len > Frame::MAX_CLASSIC_DATA;
    let frame = fields::decode(raw, len, fd.then_some(flags), data);
    frame.map(|frame| frame.with_raw_dlc(head[7])).ok_or(PacketFault::NoFrame)
}
