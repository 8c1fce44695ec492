//! A frame to send, by fields with names: its fields as they are typed, the frames that they make, what
//! those mean and do, and the answers to them.
//!
//! ```text
//! words      a composition in words, as on the command line, and the inverse
//! fields     what is typed in one field
//! compose    frames, meaning, warnings
//! changes    what a request changes in a device
//! fill       a composition that makes a given frame
//! repeat     how often it is sent
//! answers    responses to what was sent
//! ```
//!
//! Inputs: text, frames, the profile, the nodes of a bus. Sends nothing. Does not know buses, time-outs of
//! sending, or how fields are drawn.

mod answers;
mod changes;
mod compose;
mod fields;
mod fill;
mod repeat;
mod words;

pub use answers::{Answer, AnswerCollector};
pub use compose::{Composed, Receivers};
pub use fields::ServiceWord;
pub use repeat::{MAX_REPEATS, Repeat};

use crate::text::printable;
use crate::wire::framing::Framing;
use crate::wire::id::Address;
use crate::wire::profile::Profile;
use std::fmt;

/// What kind of frame is composed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum MessageKind {
    /// A request to one device, or to all.
    #[default]
    Request,
    /// A response to one node.
    Response,
    /// Data to all, without a request.
    Unsolicited,
    /// A debug message.
    Debug,
    /// Any data frame: identifier and data as they stand.
    Raw,
}

impl MessageKind {
    /// All kinds, in the order of the screen.
    pub const ALL: [Self; 5] =
        [Self::Request, Self::Response, Self::Unsolicited, Self::Debug, Self::Raw];

    /// The word that a composition begins with.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Response => "response",
            Self::Unsolicited => "unsolicited",
            Self::Debug => "debug",
            Self::Raw => "raw",
        }
    }

    /// Returns true if frames of this kind are made from this field.
    pub const fn has(self, field: CompositionField) -> bool {
        use CompositionField as F;
        match field {
            F::Kind | F::Data => true,
            F::To => matches!(self, Self::Request | Self::Response | Self::Unsolicited),
            F::Service | F::From | F::Fd => !matches!(self, Self::Raw),
            F::Framing => matches!(self, Self::Request | Self::Response),
            F::Error => matches!(self, Self::Response | Self::Unsolicited),
        }
    }
}

/// A field of a composition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CompositionField {
    /// Kind of frame.
    Kind,
    /// Receiver.
    To,
    /// Service number, or code of a debug message.
    Service,
    /// Data; of a raw frame the whole frame.
    Data,
    /// Framing of the data.
    Framing,
    /// Sender.
    From,
    /// ERR = 0: the response reports an error.
    Error,
    /// CAN FD.
    Fd,
}

impl CompositionField {
    /// The word on the screen.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Kind => "kind",
            Self::To => "to",
            Self::Service => "service",
            Self::Data => "data",
            Self::Framing => "framing",
            Self::From => "from",
            Self::Error => "error",
            Self::Fd => "CAN FD",
        }
    }
}

/// The fields of a frame to send, as they are typed. Fields that its kind does not have are ignored.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Composition {
    /// Kind of frame.
    pub kind: MessageKind,
    /// `FEED`, `@12`, `12 not-working`, `all`, `all working`, `all not-working`; of broadcasts also
    /// `rnd 85`, their DST.
    pub to: String,
    /// `des`, `0x123`, `291`.
    pub service: String,
    /// `01 02`, `"text"`, `name`; of a raw frame `051C0002#0444455301`.
    pub data: String,
    /// `None`: that of the receiver.
    pub framing: Option<Framing>,
    /// Empty: descan's own address; `14`, `not-working`, `14 not-working`.
    pub from: String,
    /// ERR = 0 in a response, or in unsolicited data.
    pub is_error: bool,
    /// CAN FD.
    pub is_fd: bool,
}

/// A node of the bus, as far as a composition needs it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownNode {
    /// Its address.
    pub address: Address,
    /// Its name, printable; `None` if it is not known.
    pub name: Option<String>,
    /// Its UID, printable; `None` if it is blank or not known.
    pub uid: Option<String>,
    /// It is in a working mode.
    pub is_working: bool,
    /// The framing of its responses.
    pub framing: Option<Framing>,
    /// Number of boards that use the address: more than 1 in an address conflict.
    pub boards: usize,
}

impl KnownNode {
    /// `ACT @14`, or the address alone.
    pub fn label(&self) -> String {
        match &self.name {
            Some(name) => format!("{name} @{}", self.address),
            None => format!("@{}", self.address),
        }
    }
}

/// What a composition is made for.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// Numbers and layouts.
    pub profile: &'a Profile,
    /// descan's own address; `None` if it has none: address 0 stands for it.
    pub own: Option<Address>,
    /// The present devices.
    pub nodes: &'a [KnownNode],
    /// Random number for the DST of broadcasts, 0 to 127.
    pub rnd7: u8,
}

impl<'a> Surroundings<'a> {
    /// The node at an address.
    pub fn node(self, address: Address) -> Option<&'a KnownNode> {
        self.nodes.iter().find(|node| node.address == address)
    }

    /// The nodes with a name or UID, as it is printed; else those whose bytes are typed, of which a
    /// backslash is printed as two.
    fn named(self, typed: &str) -> Vec<&'a KnownNode> {
        let named = |text: &str| -> Vec<&'a KnownNode> {
            let has = |own: &Option<String>| own.as_deref() == Some(text);
            self.nodes.iter().filter(|node| has(&node.name) || has(&node.uid)).collect()
        };
        let found = named(typed);
        if found.is_empty() { named(&printable(typed.as_bytes())) } else { found }
    }
}

/// What is wrong in a field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mistake {
    /// The field.
    pub field: CompositionField,
    /// Number of characters before the wrong word in the field.
    pub column: usize,
    /// What is wrong, and what would be right.
    pub text: String,
    /// It is about the bus, not about the text: the device may be found later.
    pub is_of_bus: bool,
}

impl Mistake {
    fn new(field: CompositionField, column: usize, text: impl Into<String>) -> Self {
        Self { field, column, text: text.into(), is_of_bus: false }
    }
}

impl std::error::Error for Mistake {}

impl fmt::Display for Mistake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}
