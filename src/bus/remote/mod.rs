//! What buses share that no kernel driver stands behind: adapters and servers that are spoken to
//! in messages.
//!
//! * `stream`: the thread of a bus at the other end of a byte stream: opens it, moves bytes,
//!   waits for it to come back.
//! * `own_frames`: frames of ours until they are put back among those heard, as SocketCAN's echo
//!   does.
//! * `stamps`: the other end's time stamps on our clock.
//! * `delivery`: frames and status into the queue.
//! * `backoff`: how long to wait before the next attempt.
//!
//! Does not know what the messages are.

mod backoff;
mod delivery;
mod remote_clock;
pub(super) mod stream;
pub(super) mod tx_echo;

pub(super) use backoff::Backoff;
pub(super) use delivery::Delivery;
pub(super) use remote_clock::RemoteClock;
pub(super) use tx_echo::TxEchoTracker;
