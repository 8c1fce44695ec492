//! The 29-bit identifier of the CAN platform and its nine message types.
//!
//! Source: protocol §1 (CAN platform §4.1 and §4.3). Does not know the meaning of service numbers
//! and data.

use crate::frame::IdFilter;
use core::fmt;

/// A node's address, 0 to 127. 0 belongs to the debug device; other nodes use 1 to 127.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Address(u8);

impl Address {
    /// Address of the debug device, 0.
    pub const DEBUG: Address = Address(0);
    /// Highest address, 127; DST of a DEBUG message.
    pub const MAX: Address = Address(127);
    /// Number of addresses, that of the debug device included.
    pub const COUNT: usize = 128;

    /// Returns the address `number`; `None` above 127.
    pub const fn new(number: u8) -> Option<Self> {
        if number < 128 { Some(Self(number)) } else { None }
    }

    /// Returns the low seven bits of `bits` as an address.
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits & 0x7F)
    }

    /// Returns the number, 0 to 127.
    pub const fn number(self) -> u8 {
        self.0
    }

    /// Returns the number as an index into a table of [`Address::COUNT`] elements.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Yields all addresses, 0 first.
    pub fn all() -> impl DoubleEndedIterator<Item = Address> {
        (0..128).map(Address)
    }

    /// Yields the addresses of nodes, 1 to 127.
    pub fn nodes() -> impl DoubleEndedIterator<Item = Address> {
        (1..128).map(Address)
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "@{}", self.0)
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A service number of 10 bits (SRV); in a DEBUG message the message code.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Service(u16);

impl Service {
    /// Highest number.
    pub const MAX: u16 = 0x3FF;

    /// Returns the service `number`; `None` above 1023.
    pub const fn new(number: u16) -> Option<Self> {
        if number < 1024 { Some(Self(number)) } else { None }
    }

    /// Returns the low ten bits of `bits` as a service number.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits & 0x3FF)
    }

    /// Returns the number, 0 to 1023.
    pub const fn number(self) -> u16 {
        self.0
    }
}

impl fmt::Debug for Service {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// Three hexadecimal digits: `0x002`.
impl fmt::Display for Service {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#05X}", self.0)
    }
}

/// The fields of an identifier (protocol §1.1). All 2^29 identifiers have them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Header {
    /// U: the sender is not in a working mode (protocol §7.1).
    pub from_non_working: bool,
    /// D: addressed to nodes that are not in a working mode.
    pub to_non_working: bool,
    /// R: a response, not a request.
    pub response: bool,
    /// B: broadcast, not targeted.
    pub broadcast: bool,
    /// ERR: set in a response means no error. Has no meaning in a request.
    pub no_error: bool,
    /// SRC: the sender.
    pub source: Address,
    /// DST: the receiver; in a broadcast a new random number each time (RND7).
    pub destination: Address,
    /// SRV: the service number.
    pub service: Service,
}

impl Header {
    /// Returns the fields of a 29-bit identifier; higher bits of `id` are ignored.
    ///
    /// ```
    /// use descan::wire::id::{Header, MessageType};
    ///
    /// let header = Header::decode(0x0201_5402);
    /// assert_eq!((header.source.number(), header.service.number()), (0, 2));
    /// assert_eq!(header.message_type(), MessageType::ReqCcBcst);
    /// assert_eq!(header.encode(), 0x0201_5402);
    /// ```
    pub const fn decode(id: u32) -> Self {
        Self {
            from_non_working: id >> 28 & 1 == 1,
            to_non_working: id >> 27 & 1 == 1,
            response: id >> 26 & 1 == 1,
            broadcast: id >> 25 & 1 == 1,
            no_error: id >> 24 & 1 == 1,
            source: Address::from_bits((id >> 17) as u8),
            destination: Address::from_bits((id >> 10) as u8),
            service: Service::from_bits(id as u16),
        }
    }

    /// Returns the 29-bit identifier of these fields.
    pub const fn encode(self) -> u32 {
        (self.from_non_working as u32) << 28
            | (self.to_non_working as u32) << 27
            | (self.response as u32) << 26
            | (self.broadcast as u32) << 25
            | (self.no_error as u32) << 24
            | (self.source.0 as u32) << 17
            | (self.destination.0 as u32) << 10
            | self.service.0 as u32
    }

    /// Returns filters for all frames that concern one address: those it sends, those targeted at
    /// it, and broadcast requests of `service`, to which it responds.
    pub const fn filters_of(address: Address, service: Service) -> [IdFilter; 3] {
        let (broadcast, response) = (1 << 25, 1 << 26);
        let (source, destination) = (0x7F << 17, 0x7F << 10);
        let address = address.0 as u32;
        [
            IdFilter { id: address << 17, mask: source },
            IdFilter { id: address << 10, mask: destination | broadcast },
            IdFilter { id: broadcast | service.0 as u32, mask: broadcast | response | 0x3FF },
        ]
    }

    /// Returns a targeted request of a working node: REQ_CU_TGT with `to_non_working`, else
    /// REQ_CC_TGT.
    pub const fn request(
        from: Address,
        to: Address,
        to_non_working: bool,
        service: Service,
    ) -> Self {
        Self {
            from_non_working: false,
            to_non_working,
            response: false,
            broadcast: false,
            no_error: false,
            source: from,
            destination: to,
            service,
        }
    }

    /// Returns a broadcast request of a working node: REQ_CU_BCST with `to_non_working`, else
    /// REQ_CC_BCST. `rnd7`: a new random number, 0 to 127, as DST.
    pub const fn broadcast(
        from: Address,
        rnd7: u8,
        to_non_working: bool,
        service: Service,
    ) -> Self {
        let mut header = Self::request(from, Address::from_bits(rnd7), to_non_working, service);
        header.broadcast = true;
        header
    }

    /// Returns the response (no error) of the node `from` to the request `self`: DST is the
    /// requester, D the requester's U. CAN platform §4.3 contradicts itself here: see protocol
    /// §1.3.
    #[must_use]
    pub const fn response(self, from: Address, non_working: bool) -> Self {
        Self {
            from_non_working: non_working,
            to_non_working: self.from_non_working,
            response: true,
            broadcast: false,
            no_error: true,
            source: from,
            destination: self.source,
            service: self.service,
        }
    }

    /// Returns unsolicited broadcast data, such as a heartbeat. `rnd7`: a new random number, 0 to
    /// 127, as DST.
    pub const fn unsolicited(from: Address, rnd7: u8, non_working: bool, service: Service) -> Self {
        Self {
            from_non_working: non_working,
            to_non_working: false,
            response: true,
            broadcast: true,
            no_error: true,
            source: from,
            destination: Address::from_bits(rnd7),
            service,
        }
    }

    /// Returns the message type, which depends on the flags alone (protocol §1.2).
    pub const fn message_type(self) -> MessageType {
        use MessageType as T;
        match (
            self.from_non_working,
            self.to_non_working,
            self.response,
            self.broadcast,
            self.no_error,
        ) {
            (false, false, false, false, _) => T::ReqCcTgt,
            (false, false, false, true, _) => T::ReqCcBcst,
            (false, false, true, false, _) => T::RspCcTgt,
            (false, false, true, true, _) => T::RspCcUnsc,
            (false, true, false, false, _) => T::ReqCuTgt,
            (false, true, false, true, _) => T::ReqCuBcst,
            (true, false, true, false, _) => T::RspCuTgt,
            (true, false, true, true, _) => T::RspCuUnsc,
            (true, true, true, true, true) => T::Debug,
            _ => T::NonConforming,
        }
    }

    /// Returns true if this is one of the nine message types and, for DEBUG, DST is 127.
    pub const fn is_conforming(self) -> bool {
        match self.message_type() {
            MessageType::NonConforming => false,
            MessageType::Debug => self.destination.0 == 127,
            _ => true,
        }
    }
}

/// The message types (protocol §1.2), highest priority first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MessageType {
    /// Request to one working node.
    ReqCcTgt,
    /// Request to all working nodes.
    ReqCcBcst,
    /// Response of a working node.
    RspCcTgt,
    /// Unsolicited data of a working node.
    RspCcUnsc,
    /// Request to one non-working node.
    ReqCuTgt,
    /// Request to all non-working nodes.
    ReqCuBcst,
    /// Response of a non-working node.
    RspCuTgt,
    /// Unsolicited data of a non-working node.
    RspCuUnsc,
    /// Debug message: SRV is its code, the data are its parameters.
    Debug,
    /// Any other combination of flags.
    NonConforming,
}

impl MessageType {
    /// All types, those that conform highest priority first.
    pub const ALL: [Self; 10] = [
        Self::ReqCcTgt,
        Self::ReqCcBcst,
        Self::RspCcTgt,
        Self::RspCcUnsc,
        Self::ReqCuTgt,
        Self::ReqCuBcst,
        Self::RspCuTgt,
        Self::RspCuUnsc,
        Self::Debug,
        Self::NonConforming,
    ];

    /// Returns the name in CAN platform §4.3 without `MSG_TYPE_`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ReqCcTgt => "REQ_CC_TGT",
            Self::ReqCcBcst => "REQ_CC_BCST",
            Self::RspCcTgt => "RSP_CC_TGT",
            Self::RspCcUnsc => "RSP_CC_UNSC",
            Self::ReqCuTgt => "REQ_CU_TGT",
            Self::ReqCuBcst => "REQ_CU_BCST",
            Self::RspCuTgt => "RSP_CU_TGT",
            Self::RspCuUnsc => "RSP_CU_UNSC",
            Self::Debug => "DEBUG",
            Self::NonConforming => "NONCONFORMING",
        }
    }
}

impl fmt::Display for MessageType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_patterns_match_all_frames_of_the_address() {
        let (own, other, third) =
            (Address::from_bits(12), Address::from_bits(14), Address::from_bits(99));
        let (des, data) = (Service::from_bits(2), Service::from_bits(0x155));
        let patterns = Header::filters_of(own, des);
        let fits = |header: Header| patterns.iter().any(|it| it.matches(header.encode()));
        let request = Header::request(other, own, true, data);
        assert!(fits(request) && fits(request.response(own, false)));
        assert!(fits(Header::request(own, other, false, des)));
        assert!(fits(Header::broadcast(own, 5, false, data)));
        assert!(fits(Header::unsolicited(own, 5, true, data)));
        // Each node responds to a broadcast request.
        assert!(fits(Header::broadcast(other, 5, true, des)));
        // Traffic between others, even if the random DST of a broadcast equals the address.
        assert!(!fits(Header::request(other, third, false, des)));
        assert!(!fits(Header::request(other, third, false, des).response(third, false)));
        assert!(!fits(Header::broadcast(other, 12, false, data)));
        assert!(!fits(Header::unsolicited(other, 12, false, des)));
    }
}
