//! How a bus is: link, controller state, rates, and every way a frame can get lost, counted.
//!
//! Does not know where it was learnt.

use std::fmt;

/// Whether frames can come and go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Link {
    /// Not looked at yet.
    #[default]
    Opening,
    /// Frames come and go.
    Up,
    /// The interface is there and switched off.
    Down,
    /// There is no such interface; waiting for one.
    Missing,
    /// The interface was there and went away; waiting for it to come back.
    Unplugged,
    /// The interface is there, and is no CAN interface.
    NotCan,
    /// The kernel has no CAN.
    NoKernel,
    /// The log has ended.
    Ended,
    /// Reading failed for good.
    Failed,
}

impl Link {
    /// Whether nothing more will come, whatever the user does.
    pub fn is_final(self) -> bool {
        matches!(self, Link::Ended | Link::Failed)
    }
}

/// The controller's state, in the words that scripts rely on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum BusState {
    /// Both error counters are below 96.
    ErrorActive,
    /// An error counter is 96 or more.
    ErrorWarning,
    /// An error counter is 128 or more: the node still talks, but cannot flag errors.
    ErrorPassive,
    /// The controller has left the bus.
    BusOff,
    /// The controller is stopped or asleep.
    Stopped,
    /// The interface is down.
    Down,
    /// Nobody says: a virtual interface, a log.
    #[default]
    Unknown,
}

impl BusState {
    /// `error-active`, `error-warning`, `error-passive`, `bus-off`, `stopped`, `down`, `unknown`.
    pub const fn name(self) -> &'static str {
        match self {
            BusState::ErrorActive => "error-active",
            BusState::ErrorWarning => "error-warning",
            BusState::ErrorPassive => "error-passive",
            BusState::BusOff => "bus-off",
            BusState::Stopped => "stopped",
            BusState::Down => "down",
            BusState::Unknown => "unknown",
        }
    }
}

impl fmt::Display for BusState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Whether the bit rate of a bus can be looked for while it is open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum RateSearch {
    /// It can, beside whoever listens.
    #[default]
    Possible,
    /// There is none that could be set from here: a virtual bus, another host's, a log.
    NoRate,
    /// Only where it is not open: an adapter that is ours alone.
    WhenClosed,
}

/// How a bus is. Counters count from the opening of the port.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct BusStatus {
    /// Whether frames can come and go.
    pub link: Link,
    /// The controller's state.
    pub state: BusState,
    /// Bit/s; FD: of the arbitration phase.
    pub bitrate: Option<u32>,
    /// Whether another bit rate can be looked for while it is open.
    pub rate_search: RateSearch,
    /// Bit/s of the FD data phase.
    pub data_bitrate: Option<u32>,
    /// The transmit error counter.
    pub tec: Option<u16>,
    /// The receive error counter.
    pub rec: Option<u16>,
    /// After how many milliseconds the controller rejoins after bus-off; 0 = never by itself.
    pub restart_ms: Option<u32>,
    /// Whether the interface takes FD frames.
    pub fd: bool,
    /// Whether the *controller* only listens, and does not even acknowledge.
    pub listen_only: bool,
    /// What the interface is called now, where that is not what it was opened as.
    pub renamed: Option<String>,
    /// Times that the bus went away, down or unplugged, and came back, however short it was.
    pub outages: u64,
    /// Times that the controller left the bus by itself.
    pub bus_offs: u64,
    /// Whether frames that are of no interest are left out, by
    /// [`Options::only`](crate::bus::Options::only): what is heard is not all that passes.
    pub filtered: bool,
    /// Bytes of the kernel's receive buffer, as the kernel counts them.
    pub receive_buffer: Option<u32>,
    /// Frames that did not fit the kernel's receive buffer.
    pub kernel_drops: u64,
    /// Times the controller itself was overrun.
    pub controller_overruns: u64,
    /// Frames that did not fit our queue.
    pub queue_drops: u64,
    /// Frames that were handed to the kernel, or to an adapter, and have not been seen on the
    /// bus.
    pub unconfirmed: u64,
    /// Frames that the kernel or the adapter would not take, or not in time.
    pub transmit_failures: u64,
    /// Whether what is to be sent finds the way out full, and does not get room in time: what
    /// was sent before it, by whomever, does not go out either.
    pub is_transmit_queue_full: bool,
    /// Error reports that say nobody acknowledged.
    pub missing_acks: u64,
    /// Messages of an adapter or a server that could not be read.
    pub unreadable: u64,
    /// Whether an adapter has said nothing yet that could be read, though it was told to open
    /// the bus: whether there is a bus at all is not known.
    pub unanswered: bool,
    /// How much of a log is read, in percent, where its size is known.
    pub percent: Option<u8>,
    /// What is wrong and the way out, on one line.
    pub message: Option<String>,
    /// What is worth knowing while nothing is wrong, on one line: what an adapter says of itself,
    /// how a log goes on.
    pub note: Option<String>,
}

/// How logs are played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Playback {
    /// So many times as fast as they were recorded.
    pub speed: f64,
    /// Time stands still because the user wants it to.
    pub is_paused: bool,
    /// Time stands still because all logs are at their end.
    pub is_ended: bool,
}

impl Playback {
    /// Whether time stands still.
    pub fn is_standing(&self) -> bool {
        self.is_paused || self.is_ended
    }
}

/// What can be done to the playing of logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlaybackCommand {
    /// Stop the time, or let it go on.
    Pause,
    /// Stop the time at the next frame.
    Step,
    /// Twice as fast.
    Faster,
    /// Half as fast.
    Slower,
}

/// How a recording is.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct RecordingStatus {
    /// The file that is written, or was written last.
    pub path: String,
    /// How many files there are.
    pub files: u32,
    /// Frames in all of them, as far as they are flushed.
    pub frames: u64,
    /// Bytes in all of them.
    pub bytes: u64,
    /// Frames that came faster than they could be written.
    pub lost: u64,
    /// Why it is over before the session is.
    pub failure: Option<String>,
}

/// `session.log: 5123 frames, 312 kB`.
impl fmt::Display for RecordingStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.frames, self.bytes) {
            (0, 0) if self.failure.is_none() => {
                write!(f, "{}: no frames, no file written", self.path)?;
            }
            (1, bytes) => write!(f, "{}: 1 frame, {}", self.path, size(bytes))?,
            (frames, bytes) => write!(f, "{}: {frames} frames, {}", self.path, size(bytes))?,
        }
        if self.files > 1 {
            write!(f, ", in {} files of which this is the last", self.files)?;
        }
        if self.lost > 0 {
            write!(f, "; {} lost (disk too slow)", self.lost)?;
        }
        match &self.failure {
            None => Ok(()),
            Some(failure) => write!(f, "; incomplete: {failure}"),
        }
    }
}

/// A number of bytes in at most six characters: `312 kB`, `12 MB`.
pub fn size(bytes: u64) -> String {
    match bytes {
        0..1_000 => format!("{bytes} B"),
        1_000..1_000_000 => format!("{} kB", bytes / 1_000),
        1_000_000..1_000_000_000 => format!("{} MB", bytes / 1_000_000),
        _ => format!("{} GB", bytes / 1_000_000_000),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_have_the_names_scripts_rely_on() {
        let names = [
            BusState::ErrorActive,
            BusState::ErrorWarning,
            BusState::ErrorPassive,
            BusState::BusOff,
            BusState::Stopped,
            BusState::Down,
            BusState::Unknown,
        ]
        .map(|state| state.to_string());
        assert_eq!(
            names.join(" "),
            "error-active error-warning error-passive bus-off stopped down unknown"
        );
    }
}
