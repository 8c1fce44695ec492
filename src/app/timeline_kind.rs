//! Kinds of timeline lines.

/// Kind of event; selects sign and colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimelineKind {
    /// A device appeared, returned, or reported more about itself.
    Improved,
    /// A device changed.
    Change,
    /// A device is stale, silent or asleep.
    Overdue,
    /// A device is lost.
    Lost,
    /// A suspected finding.
    Suspected,
    /// A confirmed finding.
    Confirmed,
    /// A cleared finding.
    Cleared,
    /// State of a bus or its adapter.
    Bus,
    /// des.json.
    File,
    /// A command or an operation that failed.
    Error,
}
