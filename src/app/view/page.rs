//! Pages, and the part of the screen that has the keyboard focus.

/// The pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Page {
    /// Device rows.
    #[default]
    Devices,
    /// Captured frames.
    Traffic,
    /// Events.
    Timeline,
    /// Problems with their evidence.
    Problems,
    /// Load and state of the buses.
    Bus,
}

impl Page {
    /// All pages, by number.
    pub const ALL: [Page; 5] =
        [Page::Devices, Page::Traffic, Page::Timeline, Page::Problems, Page::Bus];

    /// Title of the page.
    pub const fn title(self) -> &'static str {
        match self {
            Page::Devices => "Devices",
            Page::Traffic => "Traffic",
            Page::Timeline => "Timeline",
            Page::Problems => "Problems",
            Page::Bus => "Bus",
        }
    }

    /// Returns true if the page has rows that a filter selects from.
    pub const fn has_rows(self) -> bool {
        !matches!(self, Page::Bus)
    }

    /// Number of the page, which is also its key.
    pub const fn number(self) -> usize {
        self as usize + 1
    }
}

/// Part of the screen with the keyboard focus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Focus {
    /// The list.
    #[default]
    List,
    /// The details beside the list, or in its place on a narrow screen.
    Details,
}

/// End of a frozen page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frozen {
    /// Number after the last frame shown.
    pub frames: u64,
}
