//! Status of a bus: link, controller state, bit rates, and a counter for each way a frame can get
//! lost; status of playback and recording. Plain values; does not know their source.

use crate::diagnostic::Diagnostic;
use crate::time::{Duration, Instant};
use std::fmt;

/// Whether frames can be received and sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Link {
    /// Not known yet.
    #[default]
    Opening,
    /// Frames can be received and sent.
    Up,
    /// The interface exists and is down.
    Down,
    /// The interface does not exist; descan waits for it.
    Missing,
    /// The interface existed and disappeared; descan waits for its return.
    Unplugged,
    /// The interface is not a CAN interface.
    NotCan,
    /// The kernel has no CAN support.
    NoKernel,
    /// End of log.
    Ended,
    /// Reading failed; the bus is not opened again.
    Failed,
}

impl Link {
    /// Returns true if no more frames will be received, whatever the user does.
    pub fn is_final(self) -> bool {
        matches!(self, Link::Ended | Link::Failed)
    }
}

/// State of a CAN controller (ISO 11898-1 fault confinement).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum BusState {
    /// Both error counters are below 96.
    ErrorActive,
    /// An error counter is 96 or more.
    ErrorWarning,
    /// An error counter is 128 or more: the node sends passive error flags only.
    ErrorPassive,
    /// The transmit error counter exceeded 255: the controller takes no part in the bus.
    BusOff,
    /// The controller is stopped or asleep.
    Stopped,
    /// The interface is down.
    Down,
    /// Not reported, as by virtual interfaces and logs.
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

/// Whether a bit rate search is possible while the bus is open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum RateSearch {
    /// Possible, while other programs read the bus.
    #[default]
    Possible,
    /// The bus has no bit rate that this machine could set: a virtual bus, a server's, a log.
    NoRate,
    /// Only while the bus is closed: an adapter that one program opens at a time.
    WhenClosed,
}

/// Status of a bus. Counters start at 0 when the port is opened.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct BusStatus {
    /// Whether frames can be received and sent.
    pub link: Link,
    /// The controller's state.
    pub state: BusState,
    /// Bit/s, of the arbitration phase for FD; `None` if not known.
    pub bitrate: Option<u32>,
    /// Whether a bit rate search is possible.
    pub rate_search: RateSearch,
    /// Bit/s of the FD data phase; `None` without FD, or if not known.
    pub data_bitrate: Option<u32>,
    /// The transmit error counter (TEC); `None` if not reported.
    pub tec: Option<u16>,
    /// The receive error counter (REC); `None` if not reported.
    pub rec: Option<u16>,
    /// Delay of the restart after bus-off in milliseconds; 0: no automatic restart.
    pub restart_ms: Option<u32>,
    /// Whether FD frames can be sent.
    pub fd: bool,
    /// Whether the *controller* is listen-only and sends no ACK.
    pub listen_only: bool,
    /// Whether the adapter is listen-only until it has received a valid frame; then it sends.
    pub listens_first: bool,
    /// Whether nothing is sent at present, as while the user chooses buses.
    pub is_sending_paused: bool,
    /// The present name of an interface that was renamed after it was opened.
    pub renamed: Option<String>,
    /// How often the bus returned after it was down or unplugged for any time.
    pub outages: u64,
    /// How often the controller became bus-off.
    pub bus_offs: u64,
    /// Whether [`Options::only`](crate::bus::Options::only) filters frames: not all frames on the
    /// bus are received.
    pub filtered: bool,
    /// Size of the kernel's receive buffer in bytes, as the kernel counts them.
    pub receive_buffer: Option<u32>,
    /// The most frames that waited in the kernel's receive buffer at once, where that is counted.
    pub most_waiting: u32,
    /// Frames lost because the kernel's receive buffer was full.
    pub kernel_drops: u64,
    /// Overruns of the controller; each lost one frame or more.
    pub controller_overruns: u64,
    /// Frames lost because the receive queue was full.
    pub queue_drops: u64,
    /// Frames passed to the kernel or an adapter and not yet received back.
    pub unconfirmed: u64,
    /// Frames not sent: rejected, or not accepted in time.
    pub transmit_failures: u64,
    /// Whether the transmit queue has been full for so long that a frame was given up: frames of
    /// other programs do not get out either.
    pub is_transmit_queue_full: bool,
    /// Error frames that report a missing ACK.
    pub missing_acks: u64,
    /// Messages of an adapter or a server that cannot be read; entries of a log, known at its end.
    pub unreadable: u64,
    /// Whether an adapter was told to open the bus and has sent nothing readable yet: whether it
    /// is connected to a bus is not known.
    pub unanswered: bool,
    /// How much of a log is read, in percent; `None` if its size is not known.
    pub percent: Option<u8>,
    /// How often another log began: it was truncated or replaced, and is read from its start.
    pub log_changes: u64,
    /// Why the bus is not as it should be, or how a log ended; `None` without a fault.
    pub fault: Option<Diagnostic>,
    /// Information on one line that is not a fault: an adapter's name, a log that was replaced.
    pub note: Option<String>,
}

/// Bytes of the receive buffer that the kernel counts for a frame, about.
pub const KERNEL_BYTES_PER_FRAME: u32 = 800;

impl BusStatus {
    /// About how many frames the kernel's receive buffer holds; `None` if its size is not known.
    pub fn receive_buffer_frames(&self) -> Option<u32> {
        self.receive_buffer.map(|bytes| bytes / KERNEL_BYTES_PER_FRAME)
    }
}

/// Status of the playback of logs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Playback {
    /// Replay speed: 1 is as recorded, 2 twice as fast.
    pub speed: f64,
    /// Paused by the user.
    pub is_paused: bool,
    /// All logs are at their end.
    pub is_ended: bool,
    /// Time of the last frame, as far as the end of the file shows it; `None` if it is not known.
    pub end: Option<Instant>,
    /// A log is read for its last frame beside the replay: `end` is not known yet, or grows.
    pub seeks_end: bool,
    /// The moment up to which the log is read as fast as possible; `None` at the set speed.
    pub reads_to: Option<Instant>,
}

impl Default for Playback {
    /// As recorded, running.
    fn default() -> Self {
        Self {
            speed: 1.0,
            is_paused: false,
            is_ended: false,
            end: None,
            seeks_end: false,
            reads_to: None,
        }
    }
}

impl Playback {
    /// Returns true if log time does not advance.
    pub fn is_standing(&self) -> bool {
        self.is_paused || self.is_ended
    }
}

/// A command to the playback of logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlaybackCommand {
    /// Pause or resume.
    Pause,
    /// Step to the next frame and pause there.
    Step,
    /// Double the speed.
    Faster,
    /// Halve the speed.
    Slower,
    /// Pause, or resume.
    SetPaused(bool),
    /// Read as fast as possible up to this moment; with a past one, at the set speed from now on.
    ReadTo(Instant),
}

/// Status of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct RecordingStatus {
    /// The present or last file.
    pub path: String,
    /// Number of files.
    pub files: u32,
    /// Flushed frames in all files.
    pub frames: u64,
    /// Flushed bytes in all files.
    pub bytes: u64,
    /// Frames lost because the disk was too slow.
    pub lost: u64,
    /// The filter of the recorded frames; `None` if all are recorded.
    pub filter: Option<String>,
    /// Frames that do not match it.
    pub left_out: u64,
    /// Why the recording stopped early; `None` while it has not.
    pub failure: Option<String>,
}

/// `session.log: 5123 frames, 312 kB`; with a filter, `session.log: 12 of 5123 frames, 1 kB`.
impl fmt::Display for RecordingStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.frames, self.bytes) {
            (0, 0) if self.failure.is_none() && self.left_out > 0 => {
                let all = self.left_out;
                write!(f, "{}: none of {all} frames matches, no file written", self.path)?;
            }
            (0, 0) if self.failure.is_none() => {
                write!(f, "{}: no frames, no file written", self.path)?;
            }
            (frames, bytes) if self.left_out > 0 => {
                let all = frames + self.left_out;
                write!(f, "{}: {frames} of {all} frames, {}", self.path, size(bytes))?;
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

/// A length of time, or a place in a log: `0:50`, `1:02:10`.
pub fn length_text(length: Duration) -> String {
    let seconds = length.as_secs();
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    match hours {
        0 => format!("{minutes}:{seconds:02}"),
        _ => format!("{hours}:{minutes:02}:{seconds:02}"),
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
    fn state_names_are_those_of_the_json_output() {
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
