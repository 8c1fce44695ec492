//! Meaning of the bytes on the bus: identifiers of the CAN platform, messages of DES, their two
//! framings, the heartbeat, and the descriptor.
//!
//! Sources: the DES service document and CAN platform §3.1 to §4.3, as collected in protocol §1 to
//! §3 and §7. Numbers that the sources leave open are fields of [`profile::Profile`], not
//! constants.
//!
//! Without I/O and without a clock: time is passed in. Without the feature `std` it builds
//! `no_std` and without an allocator; buffers are the caller's. Only [`profile::Profile::parse`]
//! needs `std`.

#[cfg(feature = "std")]
pub mod data_layout;
pub mod des;
pub mod descriptor;
pub mod framing;
pub mod id;
pub mod isotp;
pub mod node;
pub mod profile;
