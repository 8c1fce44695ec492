//! Where the user is: the page, and the part of it that has the keys.

/// The pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[allow(missing_docs)]
pub enum Page {
    #[default]
    Devices,
    Traffic,
    Timeline,
    Problems,
}

impl Page {
    /// In the order of their numbers.
    pub const ALL: [Page; 4] = [Page::Devices, Page::Traffic, Page::Timeline, Page::Problems];

    /// Its name.
    pub const fn title(self) -> &'static str {
        match self {
            Page::Devices => "Devices",
            Page::Traffic => "Traffic",
            Page::Timeline => "Timeline",
            Page::Problems => "Problems",
        }
    }

    /// Its number on the keyboard.
    pub const fn number(self) -> usize {
        self as usize + 1
    }
}

/// Which part of the screen has the keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Focus {
    /// The list.
    #[default]
    List,
    /// The details beside it (or in its place, on a narrow screen).
    Details,
}

/// Where a held page ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frozen {
    /// Behind the last frame.
    pub frames: u64,
    /// Behind the last line of the timeline.
    pub lines: u64,
}
