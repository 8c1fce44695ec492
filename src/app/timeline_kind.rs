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
    /// A moment marked by the user, with its letter.
    Mark(char),
}

impl TimelineKind {
    /// Word for the filter of a line that is not of an engine event.
    pub(super) const fn event_word(self) -> &'static str {
        match self {
            Self::Improved | Self::Change | Self::Overdue | Self::Lost => "device",
            Self::Suspected | Self::Confirmed | Self::Cleared => "finding",
            Self::Bus => "bus",
            Self::File => "file",
            Self::Error => "error",
            Self::Mark(_) => "mark",
        }
    }

    /// Returns true if a line reports a finding.
    pub(super) const fn is_of_problem(self) -> bool {
        matches!(self, Self::Suspected | Self::Confirmed | Self::Cleared)
    }

    /// State of a finding that the line reports; `error` for an operation that failed.
    pub(super) const fn state_word(self) -> Option<&'static str> {
        match self {
            Self::Suspected => Some("suspected"),
            Self::Confirmed => Some("confirmed"),
            Self::Cleared => Some("cleared"),
            Self::Error => Some("error"),
            _ => None,
        }
    }
}
