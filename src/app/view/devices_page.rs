//! The page Devices: its views, and where the details and the heartbeat history are.
//!
//! Inputs: keys, the size of the screen. Does not know the content of rows.

use crate::time::Instant;

/// What the rows of the Devices page show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum DeviceView {
    /// The columns of each device.
    #[default]
    List,
    /// The version of each service.
    Services,
    /// The heartbeats of each device.
    Heartbeats,
}

impl DeviceView {
    /// All views, in the order of the key.
    pub const ALL: [DeviceView; 3] = [Self::List, Self::Services, Self::Heartbeats];

    /// Name in the page rule.
    pub const fn title(self) -> &'static str {
        match self {
            Self::List => "list",
            Self::Services => "services",
            Self::Heartbeats => "heartbeats",
        }
    }

    /// The next view.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            Self::List => Self::Services,
            Self::Services => Self::Heartbeats,
            Self::Heartbeats => Self::List,
        }
    }
}

/// Where the details of a device are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DetailsPlace {
    /// At the right of the list, this many columns wide.
    Beside(u16),
    /// Below the list, this many lines high.
    Below(u16),
    /// In the place of the list, once they have the focus.
    Instead,
}

/// State of the Devices page besides its selection.
#[derive(Clone, Copy, Debug, Default)]
pub struct DevicesPage {
    /// What the rows show.
    pub view: DeviceView,
    /// The heartbeat history of the selected device is open.
    pub shows_history: bool,
    /// Time of the heartbeat, or of the miss, that is chosen in the history; `None`: the newest.
    pub beat: Option<Instant>,
    /// Number of services that are scrolled out at the left of the view of services.
    pub first_service: usize,
}

/// Least width with details beside the list, in columns.
const SPLIT_WIDTH: u16 = super::SPLIT_WIDTH;
/// Least size with details below the list: three columns of fields of 38 cells.
const BELOW: (u16, u16) = (120, 30);
/// Least width with details beside a list that has all its columns.
const WIDE: u16 = 180;

impl DevicesPage {
    /// Returns where the details are on a screen of this size.
    pub fn details_place(&self, (columns, rows): (u16, u16)) -> DetailsPlace {
        let is_large = columns >= BELOW.0 && rows >= BELOW.1;
        match columns {
            // Sixty beats a line, their time and their statistics.
            _ if self.shows_history && is_large => DetailsPlace::Below((rows / 3).clamp(8, 16)),
            _ if self.shows_history => DetailsPlace::Instead,
            0..SPLIT_WIDTH => DetailsPlace::Instead,
            WIDE.. => DetailsPlace::Beside(55),
            _ if is_large => DetailsPlace::Below((rows / 4).clamp(7, 14)),
            // A list of 51 columns has ADDR to FILE; the rest is shared.
            _ => DetailsPlace::Beside((28 + columns.saturating_sub(80) / 2).min(40)),
        }
    }
}
