//! The receiving socket of a multicast group, and the parts of sending that differ between systems.
//!
//! Only Linux dates datagrams and counts those that it dropped; elsewhere a datagram is dated when it
//! is read, and lost ones are not known. Does not know the content of datagrams.

#[cfg(not(target_os = "linux"))]
mod elsewhere;
#[cfg(target_os = "linux")]
mod linux;

#[cfg(not(target_os = "linux"))]
use elsewhere as system;
#[cfg(target_os = "linux")]
use linux as system;

pub(super) use system::{
    INTERFACES_COMMAND, Receiver, has_no_room, interface_index, is_missing_interface, route_remedy,
    send_through,
};
