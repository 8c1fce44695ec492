//! The 29-bit identifier of the CAN platform (section 4.1) and its nine message types (4.3).
//!
//! Does not know what a service number or the data mean.

use crate::frame::IdPattern;
use std::fmt;

/// A node's address, 0–127. 0 is reserved for a debug device; nodes use 1–127.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Address(u8);

impl Address {
    /// The debug device's address.
    pub const DEBUG: Address = Address(0);
    /// The highest address; DST of a DEBUG message.
    pub const MAX: Address = Address(127);
    /// How many addresses there are.
    pub const COUNT: usize = 128;

    /// The address `number`, if it is one (0–127).
    pub const fn new(number: u8) -> Option<Self> {
        if number < 128 { Some(Self(number)) } else { None }
    }

    /// The low seven bits of `bits` as an address.
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits & 0x7F)
    }

    /// Its number, 0–127.
    pub const fn number(self) -> u8 {
        self.0
    }

    /// Its number as an index into a table of 128.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// All of them, 0 first.
    pub fn all() -> impl DoubleEndedIterator<Item = Address> {
        (0..128).map(Address)
    }

    /// Those a node may hold: 1–127.
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

/// A 10-bit service number; in a DEBUG message the message code.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Service(u16);

impl Service {
    /// The service `number`, if it is one (0–1023).
    pub const fn new(number: u16) -> Option<Self> {
        if number < 1024 { Some(Self(number)) } else { None }
    }

    /// The low ten bits of `bits` as a service number.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits & 0x3FF)
    }

    /// Its number, 0–1023.
    pub const fn number(self) -> u16 {
        self.0
    }
}

impl fmt::Debug for Service {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// Three hexadecimal digits.
impl fmt::Display for Service {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:03X}", self.0)
    }
}

/// The fields of an identifier (4.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Header {
    /// U: the sender is in none of the working modes.
    pub sender_not_working: bool,
    /// D: addressed to nodes that are in none of the working modes.
    pub to_not_working: bool,
    /// R: an answer, not a request.
    pub response: bool,
    /// B: to all, not to one.
    pub broadcast: bool,
    /// ERR: on an answer, *no* error. Means nothing on a request.
    pub no_error: bool,
    /// SRC: who sends.
    pub source: Address,
    /// DST: to whom; in a broadcast a fresh random number.
    pub destination: Address,
    /// SRV: the service.
    pub service: Service,
}

impl Header {
    /// The fields of a 29-bit identifier. Every identifier has them.
    pub const fn decode(id: u32) -> Self {
        Self {
            sender_not_working: id >> 28 & 1 == 1,
            to_not_working: id >> 27 & 1 == 1,
            response: id >> 26 & 1 == 1,
            broadcast: id >> 25 & 1 == 1,
            no_error: id >> 24 & 1 == 1,
            source: Address::from_bits((id >> 17) as u8),
            destination: Address::from_bits((id >> 10) as u8),
            service: Service::from_bits(id as u16),
        }
    }

    /// The 29-bit identifier of these fields.
    pub const fn encode(self) -> u32 {
        (self.sender_not_working as u32) << 28
            | (self.to_not_working as u32) << 27
            | (self.response as u32) << 26
            | (self.broadcast as u32) << 25
            | (self.no_error as u32) << 24
            | (self.source.0 as u32) << 17
            | (self.destination.0 as u32) << 10
            | self.service.0 as u32
    }

    /// The identifiers of all that concerns one address: what it sends, what is sent to it, and the
    /// requests of this service to all, which it answers like everybody.
    pub const fn patterns_of(address: Address, service: Service) -> [IdPattern; 3] {
        let (broadcast, response) = (1 << 25, 1 << 26);
        let (source, destination) = (0x7F << 17, 0x7F << 10);
        let address = address.0 as u32;
        [
            IdPattern { id: address << 17, mask: source },
            IdPattern { id: address << 10, mask: destination | broadcast },
            IdPattern { id: broadcast | service.0 as u32, mask: broadcast | response | 0x3FF },
        ]
    }

    /// A request of a working node to one node; `to_not_working` chooses REQ_CU.
    pub const fn request(
        from: Address,
        to: Address,
        to_not_working: bool,
        service: Service,
    ) -> Self {
        Self {
            sender_not_working: false,
            to_not_working,
            response: false,
            broadcast: false,
            no_error: false,
            source: from,
            destination: to,
            service,
        }
    }

    /// A request of a working node to all nodes, with a fresh RND7 as DST.
    pub const fn broadcast(
        from: Address,
        rnd7: u8,
        to_not_working: bool,
        service: Service,
    ) -> Self {
        let mut header = Self::request(from, Address::from_bits(rnd7), to_not_working, service);
        header.broadcast = true;
        header
    }

    /// The answer (no error) of the node `from` to the request `self`: DST is the asker, D the
    /// asker's U (4.3 as resolved: its text says DST = the request's DST, which is the
    /// answerer itself).
    #[must_use]
    pub const fn response(self, from: Address, not_working: bool) -> Self {
        Self {
            sender_not_working: not_working,
            to_not_working: self.sender_not_working,
            response: true,
            broadcast: false,
            no_error: true,
            source: from,
            destination: self.source,
            service: self.service,
        }
    }

    /// Data sent unasked to all, with a fresh RND7 as DST (a heartbeat, say).
    pub const fn unsolicited(from: Address, rnd7: u8, not_working: bool, service: Service) -> Self {
        Self {
            sender_not_working: not_working,
            to_not_working: false,
            response: true,
            broadcast: true,
            no_error: true,
            source: from,
            destination: Address::from_bits(rnd7),
            service,
        }
    }

    /// Which of the nine types this is. Depends on the flags alone.
    pub const fn message_type(self) -> MessageType {
        use MessageType as T;
        match (
            self.sender_not_working,
            self.to_not_working,
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

    /// Whether the sender keeps to the platform: one of the nine types, and a DEBUG message has
    /// DST 127.
    pub const fn is_conforming(self) -> bool {
        match self.message_type() {
            MessageType::NonConforming => false,
            MessageType::Debug => self.destination.0 == 127,
            _ => true,
        }
    }
}

/// The message types of 4.3, highest priority first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MessageType {
    /// Working → working, answer required.
    ReqCcTgt,
    /// Working → all working.
    ReqCcBcst,
    /// Answer of a working node.
    RspCcTgt,
    /// Answer of a working node to many, or data without a request.
    RspCcUnsc,
    /// Working → one that is not working.
    ReqCuTgt,
    /// Working → all that are not working.
    ReqCuBcst,
    /// Answer of a node that is not working.
    RspCuTgt,
    /// The same, to many or unasked.
    RspCuUnsc,
    /// Debug message: SRV is its code, the data its parameters.
    Debug,
    /// Any other combination of flags.
    NonConforming,
}

impl MessageType {
    /// The name in 4.3 without `MSG_TYPE_`.
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
    fn the_patterns_of_an_address_are_all_that_concerns_it() {
        let (us, other, third) =
            (Address::from_bits(12), Address::from_bits(14), Address::from_bits(99));
        let (des, data) = (Service::from_bits(2), Service::from_bits(0x155));
        let patterns = Header::patterns_of(us, des);
        let fits = |header: Header| patterns.iter().any(|it| it.fits(header.encode()));
        let request = Header::request(other, us, true, data);
        assert!(fits(request) && fits(request.response(us, false)));
        assert!(fits(Header::request(us, other, false, des)));
        assert!(fits(Header::broadcast(us, 5, false, data)));
        assert!(fits(Header::unsolicited(us, 5, true, data)));
        // Everybody answers a question to all.
        assert!(fits(Header::broadcast(other, 5, true, des)));
        // Others among each other, also where the random DST of a broadcast is the address.
        assert!(!fits(Header::request(other, third, false, des)));
        assert!(!fits(Header::request(other, third, false, des).response(third, false)));
        assert!(!fits(Header::broadcast(other, 12, false, data)));
        assert!(!fits(Header::unsolicited(other, 12, false, des)));
    }
}
