//! What bytes on the bus mean: the CAN platform's identifiers, the DES service, its two
//! framings, and what a node says of itself.
//!
//! Sources: the DES service description and the CAN platform description, sections 3.1–4.3.
//! What they leave open is never a constant here but a field of the [`profile::Profile`].
//!
//! Does no I/O and asks no clock; encoding and decoding do not allocate where the size is
//! bounded, so the same code could serve firmware.

pub mod des;
pub mod framing;
pub mod id;
pub mod isotp;
pub mod node;
pub mod profile;
pub use crate::text;
