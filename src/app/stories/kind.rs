//! Kinds of stories, and which of them are shown.

/// What a story is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum StoryKind {
    /// A device appeared.
    Join,
    /// A device changed its mode.
    Mode,
    /// A device claimed, gave up or changed its address.
    Move,
    /// A device rebooted.
    Reboot,
    /// A device was stale, silent, asleep or lost.
    Presence,
    /// Two devices used one address, or one UID two addresses.
    Conflict,
    /// Any other finding about a device.
    Problem,
    /// Services, versions or the UID of a device changed.
    Version,
    /// State of a bus or its adapter, findings about a bus.
    Bus,
    /// des.json.
    File,
    /// descan itself: its address, its commands, errors of the program.
    Own,
    /// DEBUG messages.
    Debug,
    /// Marks of the user.
    Mark,
}

impl StoryKind {
    /// All kinds, in the order of the list.
    pub const ALL: [Self; 13] = [
        Self::Join,
        Self::Mode,
        Self::Move,
        Self::Reboot,
        Self::Presence,
        Self::Conflict,
        Self::Problem,
        Self::Version,
        Self::Bus,
        Self::File,
        Self::Own,
        Self::Debug,
        Self::Mark,
    ];

    /// Word in the list and in the rule.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Join => "join",
            Self::Mode => "mode",
            Self::Move => "move",
            Self::Reboot => "reboot",
            Self::Presence => "presence",
            Self::Conflict => "conflict",
            Self::Problem => "problem",
            Self::Version => "version",
            Self::Bus => "bus",
            Self::File => "file",
            Self::Own => "own",
            Self::Debug => "debug",
            Self::Mark => "mark",
        }
    }

    /// Meaning, for the list.
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::Join => "devices that appeared",
            Self::Mode => "modes",
            Self::Move => "addresses claimed, given up, changed",
            Self::Reboot => "reboots",
            Self::Presence => "stale, silent, asleep, lost, returned",
            Self::Conflict => "address and UID conflicts",
            Self::Problem => "other problems of devices",
            Self::Version => "services, versions, UIDs",
            Self::Bus => "state and errors of the bus",
            Self::File => "des.json and recordings",
            Self::Own => "descan: its address, errors",
            Self::Debug => "DEBUG messages",
            Self::Mark => "marks",
        }
    }
}

/// A set of kinds that are hidden.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HiddenKinds(u16);

impl HiddenKinds {
    /// Returns true if stories of the kind are hidden.
    pub const fn contains(self, kind: StoryKind) -> bool {
        self.0 >> kind as u16 & 1 != 0
    }

    /// Returns true if all kinds are shown.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Hides the stories of a kind, or shows them again.
    pub(in crate::app) fn toggle(&mut self, kind: StoryKind) {
        self.0 ^= 1 << kind as u16;
    }

    /// Hides all kinds but one; if it is that already, shows all.
    pub(in crate::app) fn toggle_others(&mut self, kind: StoryKind) {
        let all = (1 << StoryKind::ALL.len()) - 1;
        let others = all & !(1 << kind as u16);
        self.0 = if self.0 == others { 0 } else { others };
    }
}
