//! Shared parts of buses without a kernel driver: adapters and servers with a message protocol.
//!
//! * `stream`: the thread of a bus behind a byte stream: opens it, moves bytes, reconnects.
//! * `tx_echo`: sent frames until they are received back, as SocketCAN's loopback does it.
//! * `remote_clock`: timestamps of the adapter or server on descan's clock.
//! * `delivery`: frames and status into the receive queue.
//! * `splitter`: lines or messages of a byte stream.
//! * `backoff`: pauses between attempts.
//!
//! Does not know the messages.

mod backoff;
mod delivery;
mod remote_clock;
mod splitter;
pub(super) mod stream;
pub(super) mod tx_echo;

pub(super) use backoff::Backoff;
pub(super) use delivery::Delivery;
pub(super) use remote_clock::RemoteClock;
pub(super) use splitter::Splitter;
pub(super) use tx_echo::TxEchoTracker;
