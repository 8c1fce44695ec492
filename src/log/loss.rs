//! What a written log does not hold, by the limits of its format.

use std::fmt;

/// Most interfaces that are named with their numbers.
const NAMED: usize = 16;

/// What an encoder has left out, or written as something less.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogLoss {
    /// Remote frames that are not in the log.
    pub remote_frames: u64,
    /// Error frames that are not in the log.
    pub error_frames: u64,
    /// Error frames without their details.
    pub error_details: u64,
    /// FD frames that are read as classic ones, or without BRS or ESI.
    pub fd_flags: u64,
    /// Classic frames whose DLC above 8 is read as 8.
    pub raw_dlcs: u64,
    /// Frames whose time the format does not have: before the first one, or centuries after it.
    pub other_times: u64,
    /// Frames whose time is cut to the microsecond.
    pub finer_times: u64,
    /// The local date of the first frame is one of the hour that is repeated when summer time ends, and
    /// is read as the first of both.
    pub is_in_repeated_hour: bool,
    /// Interfaces with the number of another one, because the log has no more numbers.
    pub shared_numbers: u64,
    /// Interfaces with the numbers that the log has in place of their names.
    pub numbers: Vec<(String, u8)>,
}

impl LogLoss {
    /// Returns true if the log holds all that was written.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Writes each count that is not 0, of what, and how that is in the log: `2 frames with another time`. Begins with
/// the separator, and leaves the one of what follows.
pub(super) fn write_counts(
    f: &mut fmt::Formatter<'_>,
    counts: &[(u64, &str, &str)],
    separator: &mut &str,
) -> fmt::Result {
    for (count, what, how) in counts.iter().filter(|(count, ..)| *count > 0) {
        let plural = if *count == 1 { "" } else { "s" };
        write!(f, "{separator}{count} {what}{plural} {how}")?;
        *separator = "; ";
    }
    Ok(())
}

/// Formats what is lost: `1 remote frame left out; the names of interfaces: can0 is number 1`.
impl fmt::Display for LogLoss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        let counts = [
            (self.remote_frames, "remote frame", "left out"),
            (self.error_frames, "error frame", "left out"),
            (self.error_details, "error frame", "without details"),
            (self.fd_flags, "FD frame", "without FDF, BRS or ESI"),
            (self.raw_dlcs, "classic frame", "with a DLC of 8 in place of one above"),
            (self.other_times, "frame", "with another time"),
            (self.finer_times, "time", "cut to the microsecond"),
            (self.shared_numbers, "interface", "with the number of another, as there are no more"),
        ];
        write_counts(f, &counts, &mut separator)?;
        if self.is_in_repeated_hour {
            write!(f, "{separator}all times too early, as clocks were set back then")?;
            separator = "; ";
        }
        for (at, (name, number)) in self.numbers.iter().take(NAMED).enumerate() {
            let lost = if at == 0 { "the names of interfaces: " } else { "" };
            write!(f, "{separator}{lost}{name} is number {number}")?;
            separator = ", ";
        }
        match self.numbers.len().saturating_sub(NAMED) {
            0 => Ok(()),
            more => write!(f, ", and {more} more"),
        }
    }
}
