//! The views of the Traffic page and the orders of their rows.

/// What a row of the Traffic page is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrafficView {
    /// A frame.
    #[default]
    Frames,
    /// An identifier.
    Identifiers,
    /// Who calls whom: client, server, service.
    Calls,
}

impl TrafficView {
    /// All views.
    pub const ALL: [Self; 3] = [Self::Frames, Self::Identifiers, Self::Calls];

    /// Name in the page rule.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Identifiers => "identifiers",
            Self::Calls => "calls",
        }
    }

    /// The next view.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            Self::Frames => Self::Identifiers,
            Self::Identifiers => Self::Calls,
            Self::Calls => Self::Frames,
        }
    }
}

/// What the times of frames are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeFormat {
    /// Time of day; beside it the time since the row above.
    #[default]
    Clock,
    /// Time since the row above.
    SinceAbove,
    /// Time since the frame before with the same identifier.
    SinceSameId,
    /// Time since the first frame that is kept.
    SinceStart,
}

impl TimeFormat {
    /// The next format.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            Self::Clock => Self::SinceAbove,
            Self::SinceAbove => Self::SinceSameId,
            Self::SinceSameId => Self::SinceStart,
            Self::SinceStart => Self::Clock,
        }
    }

    /// Text for the message.
    pub const fn describe(self) -> &'static str {
        match self {
            Self::Clock => "time of day",
            Self::SinceAbove => "time since the row above",
            Self::SinceSameId => "time since the same identifier before",
            Self::SinceStart => "time since the first frame that is kept",
        }
    }
}

/// Order of the identifiers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum IdentifierOrder {
    /// By bus and identifier.
    #[default]
    Id,
    /// Most frames first.
    Count,
    /// Most frames a second first.
    Rate,
    /// Shortest mean interval first.
    Period,
    /// Largest jitter first.
    Jitter,
    /// Newest first.
    Newest,
}

impl IdentifierOrder {
    /// The next order.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            Self::Id => Self::Count,
            Self::Count => Self::Rate,
            Self::Rate => Self::Period,
            Self::Period => Self::Jitter,
            Self::Jitter => Self::Newest,
            Self::Newest => Self::Id,
        }
    }

    /// Text for the message.
    pub const fn describe(self) -> &'static str {
        match self {
            Self::Id => "by identifier",
            Self::Count => "most frames first",
            Self::Rate => "highest rate first",
            Self::Period => "shortest period first",
            Self::Jitter => "largest jitter first",
            Self::Newest => "newest first",
        }
    }
}

/// Order of the calls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CallOrder {
    /// By bus, client, server and service.
    #[default]
    Client,
    /// Most calls first.
    Count,
    /// Slowest first, by the 99th percentile.
    Latency,
    /// Most unanswered ones first.
    Unanswered,
    /// Most failed ones first.
    Failed,
    /// Newest first.
    Newest,
}

impl CallOrder {
    /// The next order.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            Self::Client => Self::Count,
            Self::Count => Self::Latency,
            Self::Latency => Self::Unanswered,
            Self::Unanswered => Self::Failed,
            Self::Failed => Self::Newest,
            Self::Newest => Self::Client,
        }
    }

    /// Text for the message.
    pub const fn describe(self) -> &'static str {
        match self {
            Self::Client => "by client",
            Self::Count => "most calls first",
            Self::Latency => "slowest first",
            Self::Unanswered => "most unanswered first",
            Self::Failed => "most failed first",
            Self::Newest => "newest first",
        }
    }
}
