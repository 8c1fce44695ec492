//! The table of actions: variant, name in `keys.toml`, doc, footer hint, default keys, key mode and
//! help group.
//!
//! Source of the default keymap, of the names in `keys.toml`, of the help and of the footer hints.
//! Does not know what an action does: `App::run` executes it.

use std::fmt;

/// Properties of an action: one row of [`ACTIONS`].
#[derive(Clone, Debug)]
pub struct ActionInfo {
    /// The action.
    pub action: Action,
    /// Name in `keys.toml`; unique.
    pub name: &'static str,
    /// Effect in one line, imperative, for the help.
    pub doc: &'static str,
    /// Word for the footer; empty for an action that the footer does not show.
    pub hint: &'static str,
    /// Mode in which its keys apply.
    pub mode: KeyMode,
    /// Section of the help.
    pub group: ActionGroup,
    /// Default keys, in the notation of [`super::Key::parse`]; at least one.
    pub keys: &'static [&'static str],
}

/// State of the screen that selects the meaning of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KeyMode {
    /// A page without an overlay.
    Browse,
    /// A yes-or-no question is open.
    Confirm,
    /// An edit conflict of des.json is open.
    Conflict,
    /// The help is open.
    Help,
    /// The list of marks is open.
    Marks,
    /// The list of saved filters is open.
    Filters,
    /// The comparison of two moments is open.
    Compare,
    /// The list of the kinds of stories is open.
    Kinds,
    /// The list of the profile's values is open.
    Profile,
    /// The plan of addresses is open.
    Plan,
    /// The composer is open; keys without an action are typed.
    Compose,
    /// The theme picker is open.
    Themes,
    /// The list of buses is open.
    Choice,
}

/// Sections of the help.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionGroup {
    /// Pages, selection and filters.
    Look,
    /// Requests and the bit rate.
    Bus,
    /// Playback of a log.
    Log,
    /// Moments.
    Time,
    /// Edits of des.json.
    File,
    /// Help, theme, quit.
    Program,
    /// Prompts and questions.
    Answer,
}

impl ActionGroup {
    /// All sections, in the order of the help.
    pub const ALL: [ActionGroup; 7] = [
        ActionGroup::Look,
        ActionGroup::Bus,
        ActionGroup::Log,
        ActionGroup::Time,
        ActionGroup::File,
        ActionGroup::Program,
        ActionGroup::Answer,
    ];

    /// Heading of the section.
    pub const fn title(self) -> &'static str {
        match self {
            ActionGroup::Look => "View",
            ActionGroup::Bus => "The bus",
            ActionGroup::Log => "The log",
            ActionGroup::Time => "Time",
            ActionGroup::File => "des.json",
            ActionGroup::Program => "The program",
            ActionGroup::Answer => "Prompts",
        }
    }
}

impl Action {
    /// Row of the table.
    pub fn info(self) -> &'static ActionInfo {
        // The table has one row per variant, in the order of the variants.
        &ACTIONS[self as usize]
    }

    /// Name in `keys.toml`.
    pub fn name(self) -> &'static str {
        self.info().name
    }

    /// Mode in which the keys of the action apply.
    pub fn mode(self) -> KeyMode {
        self.info().mode
    }

    /// Action with this name in `keys.toml`; `None` for an unknown name.
    pub fn from_name(name: &str) -> Option<Self> {
        ACTIONS.iter().find(|info| info.name == name).map(|info| info.action)
    }

    /// Returns true if the action opens a prompt that edits des.json.
    pub fn is_line_edit(self) -> bool {
        matches!(self, Action::EditAddress | Action::NewEntry | Action::Rename)
    }

    /// Returns true if the action edits des.json, sends frames or changes the buses: not while a past
    /// moment is shown.
    pub fn edits_or_sends(self) -> bool {
        use Action::{Add, AddAll, DeleteEntry, EditAddress, NewEntry, Redo, Rename, Undo};
        matches!(self, EditAddress | Add | AddAll | NewEntry | Rename | DeleteEntry | Undo | Redo)
            || matches!(self, Action::Rescan | Action::Identify | Action::ReadDescriptor)
            || matches!(self, Action::Command)
            || matches!(self, Action::ClearLost | Action::BitRate | Action::Buses | Action::Save)
    }

    /// Returns true if the action types, switches or follows the filter of a page.
    pub fn is_of_filter(self) -> bool {
        use Action::{Filter, FilterToggle, HideLike, NextMatch, OnlyLike, PreviousMatch};
        matches!(self, Filter | FilterToggle | OnlyLike | HideLike | NextMatch | PreviousMatch)
    }

    /// Returns true if the keys of the action also apply while a prompt is open.
    pub fn is_global(self) -> bool {
        matches!(self, Action::QuitNow | Action::Suspend | Action::Redraw)
    }
}

/// Writes the name in `keys.toml`.
impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Declares [`Action`] and [`ACTIONS`] from rows `Variant "name" "doc" "hint" [keys];`, grouped by
/// key mode and help section.
macro_rules! actions {
    ($($mode:ident $group:ident: {
        $($action:ident $name:literal $doc:literal $hint:literal [$($key:literal)*];)*
    })*) => {
        /// A user command that can be bound to keys.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Action {
            $($(#[doc = $doc] $action,)*)*
        }

        /// All actions, in the order of the help.
        pub static ACTIONS: &[ActionInfo] = &[$($(ActionInfo {
            action: Action::$action,
            name: $name,
            doc: $doc,
            hint: $hint,
            mode: KeyMode::$mode,
            group: ActionGroup::$group,
            keys: &[$($key),*],
        },)*)*];
    };
}

actions! {
    Browse Look: {
        Up "up" "Up a row" "" ["Up" "k"];
        Down "down" "Down a row" "" ["Down" "j"];
        PageUp "page-up" "Up a screenful" "" ["PgUp" "Ctrl-b"];
        PageDown "page-down" "Down a screenful" "" ["PgDn" "Ctrl-f"];
        First "first" "First row" "" ["Home"];
        Last "last" "Last row; follow in Traffic and Timeline" "" ["G" "End"];
        Details "details" "Open details, the evidence of a problem, the moment of an event" "details" ["Enter"];
        Frames "frames" "Frames of the device, problem or event" "frames" ["f"];
        Into "into" "Focus the details; frozen: a cell of the time bar later" "" ["Right"];
        Back "back" "Focus the list; frozen: a cell of the time bar earlier" "scrub" ["Left"];
        Events "events" "Events of the device or problem, on the timeline" "events" ["l"];
        Heartbeats "heartbeats" "Heartbeats of the device, each with its time" "heartbeats" ["h"];
        Return "return" "Back to where you came from" "" ["Backspace"];
        NextPage "next-page" "Next page" "" ["Tab"];
        PreviousPage "previous-page" "Previous page" "" ["Shift-Tab"];
        Devices "devices" "Page 1: devices" "" ["1"];
        Traffic "traffic" "Page 2: traffic" "" ["2"];
        Timeline "timeline" "Page 3: timeline" "" ["3"];
        Problems "problems" "Page 4: problems" "" ["4"];
        Bus "bus" "Page 5: load and state of the buses" "" ["5"];
        Filter "filter" "Filter rows" "filter" ["/"];
        FilterToggle "filter-toggle" "Filter off, or on again" "" ["\\"];
        Filters "filters" "Saved filters of the page: a digit sets one" "" ["F"];
        OnlyLike "only-like" "Only rows like the selected one" "" ["="];
        HideLike "hide-like" "Hide rows like the selected one" "" ["!"];
        NextMatch "next-match" "Next row that matches the filter, on or off" "" ["J"];
        PreviousMatch "previous-match" "The one before" "" ["K"];
        Sort "sort" "Sort by next column" "sort" ["s"];
        OpenParts "open-parts" "Steps of a timeline line, frames of a transfer" "steps" ["o"];
        Kinds "kinds" "Timeline: kinds of lines to show" "kinds" ["x"];
        TimeFormat "time-format" "Traffic: other times of frames; identifiers and calls: count from now" "" ["z"];
        SortReverse "sort-reverse" "Reverse the order" "" ["S"];
        Identifiers "identifiers" "Next view of the page" "view" ["v"];
        Problem "problem" "Jump between device and problem" "problem" ["p"];
        Mute "mute" "Mute or unmute a problem until descan quits" "mute" ["m"];
        WriteProof "write-proof" "Write the proof of a problem: report and frames" "proof" ["X"];
        Copy "copy" "Copy the selected row to the clipboard" "" ["y"];
        Cancel "cancel" "Close or leave; filter off" "" ["Esc"];
    }
    Browse Bus: {
        Rescan "rescan" "Restart the enumeration" "rescan" ["r"];
        ClearLost "clear-lost" "Remove lost devices; confirm changed versions" "clear lost" ["c"];
        Identify "identify" "Send identify: blink or beep (confirms; needs a profile)" "identify" ["i"];
        ReadDescriptor "descriptor" "Read the descriptor: type, firmware, settings (confirms; needs a profile)" "descriptor" ["I"];
        Command "command" "Command to the device: mode, restart, settings (confirms; needs a profile)" "command" ["E"];
        Compose "compose" "Compose a frame or a request, and send it (confirms)" "compose" ["C"];
        BitRate "bit-rate" "Search the bit rate, listen-only (confirms; needs root)" "bit rate" ["b"];
        Buses "buses" "Open buses beside or in place of these" "buses" ["B"];
        ReviewProfile "learn" "Values of the profile, and what the frames show of them" "profile" ["L"];
        Plan "plan" "Plan of addresses: reads what is stored, confirms writes; a log: pause" "plan" ["P"];
        SaveCapture "save-capture" "Save the captured frames (.log or .pcapng)" "save log" ["w"];
    }
    Browse Log: {
        Pause "pause" "Pause or resume the log" "pause" ["Ctrl-p"];
        Slower "slower" "Halve the replay speed" "slower" ["("];
        Faster "faster" "Double the replay speed" "faster" [")"];
    }
    Browse Time: {
        Freeze "freeze" "Freeze this moment on all pages, or show the present; of a log: pause, or play" "freeze" ["Space"];
        PreviousEvent "previous-event" "Freeze at the event before" "event" ["["];
        NextEvent "next-event" "At the next event" "" ["]"];
        PreviousProblem "previous-problem" "Freeze where a finding changed before" "problem" ["{"];
        NextProblem "next-problem" "Where one changed next" "" ["}"];
        GoTo "go-to" "Go to a time, -2m, +10s, 50%, a frame; gg: first row" "go to" ["g" ":"];
        PreviousFrame "previous-frame" "Freeze at the frame before" "frame" ["<"];
        NextFrame "step" "At the next frame; of a paused log the next frame" "step" [">"];
        ScrubBack "scrub-back" "Frozen: ten cells of the time bar earlier" "" ["Shift-Left"];
        ScrubForward "scrub-forward" "Frozen: ten cells later" "" ["Shift-Right"];
        TimeBar "time-bar" "Show or hide the time bar on a small screen" "" ["T"];
        ZoomOut "zoom-out" "Time bar, lanes, charts, panel: more time" "zoom" ["-"];
        ZoomIn "zoom-in" "The same: less time" "" ["+"];
        Mark "mark" "Mark the moment that is shown (a, b, c …)" "mark" ["M"];
        Marks "marks" "List the marks: go to one, remove one" "marks" ["'"];
        Compare "compare" "Compare with the last mark, or the start" "diff" ["d"];
    }
    Browse File: {
        EditAddress "edit-address" "Edit the static address in the row" "edit address" ["e"];
        Add "add" "Add device to file; of a listed one its services" "add to file" ["a"];
        AddAll "add-all" "Add all devices to file" "" ["A"];
        NewEntry "new-entry" "New entry: name and address" "new" ["n"];
        Rename "rename" "Rename the entry" "" ["R"];
        DeleteEntry "delete-entry" "Delete the entry (confirms)" "" ["D"];
        Undo "undo" "Undo" "undo" ["u"];
        Redo "redo" "Redo" "" ["Ctrl-r"];
        Save "save" "Retry saving; restore overwritten pins" "save again" ["Ctrl-s"];
        SaveCopy "save-copy" "Save a copy of des.json, with all edits" "save a copy" ["W"];
    }
    Browse Program: {
        Help "help" "Keys of the page, all keys, symbols, counters" "help" ["?" "F1"];
        Theme "theme" "Choose a theme" "theme" ["t"];
        Redraw "redraw" "Redraw the screen" "" ["Ctrl-l"];
        Suspend "suspend" "Suspend to the shell (fg returns)" "" ["Ctrl-z"];
        Quit "quit" "Quit; confirms if edits are unsaved" "quit" ["q"];
        QuitNow "quit-now" "Quit immediately" "" ["Ctrl-c"];
    }
    Help Answer: {
        HelpUp "help-up" "Scroll the help up" "" ["Up" "k"];
        HelpDown "help-down" "Scroll the help down" "scroll" ["Down" "j"];
        HelpPageUp "help-page-up" "A screenful up" "" ["PgUp" "Ctrl-b"];
        HelpPageDown "help-page-down" "A screenful down" "" ["PgDn" "Ctrl-f" "Space"];
        HelpFirst "help-first" "First line" "" ["g" "Home"];
        HelpLast "help-last" "Last line" "" ["G" "End"];
        HelpSearch "help-search" "Only lines with the words that are typed" "search" ["/"];
        HelpPage "help-page" "Keys of the next page" "keys of next page" ["Tab"];
        HelpClose "help-close" "All lines again, or close the help" "close" ["Esc" "?" "q" "Enter" "F1"];
    }
    Filters Answer: {
        FilterUp "saved-filter-up" "Saved filters: the one before" "" ["Up" "k"];
        FilterDown "saved-filter-down" "Saved filters: the next one" "" ["Down" "j"];
        FilterUse "saved-filter-use" "Saved filters: set it" "set" ["Enter"];
        FilterRemove "saved-filter-remove" "Saved filters: remove it" "remove" ["D" "Delete"];
        FiltersClose "saved-filters-close" "Saved filters: close the list" "close" ["Esc" "F" "q"];
    }
    Kinds Answer: {
        KindUp "kind-up" "Kinds: the one before" "" ["Up" "k"];
        KindDown "kind-down" "Kinds: the next one" "" ["Down" "j"];
        KindToggle "kind-toggle" "Kinds: show or hide it" "show or hide" ["Space" "Enter"];
        KindOnly "kind-only" "Kinds: show only it, or all" "only it" ["="];
        KindsClose "kinds-close" "Kinds: close the list" "close" ["Esc" "x" "q"];
    }
    Marks Answer: {
        MarkUp "mark-up" "Marks: the mark before" "" ["Up"];
        MarkDown "mark-down" "Marks: the next mark" "" ["Down"];
        MarkGo "mark-go" "Marks: show its moment" "show moment" ["Enter"];
        MarkRemove "mark-remove" "Marks: remove it" "remove" ["D" "Delete"];
        MarksClose "marks-close" "Marks: close the list" "close" ["Esc" "'"];
    }
    Compare Answer: {
        CompareUp "compare-up" "Comparison: up a row" "" ["Up" "k"];
        CompareDown "compare-down" "Comparison: down a row" "" ["Down" "j"];
        ComparePageUp "compare-page-up" "Comparison: a screenful up" "" ["PgUp" "Ctrl-b"];
        ComparePageDown "compare-page-down" "Comparison: a screenful down" "" ["PgDn" "Ctrl-f"];
        CompareSide "compare-side" "Comparison: choose the moment A or B" "A or B" ["Tab"];
        CompareEarlier "compare-earlier" "Comparison: move it to the event before" "event before" ["Left" "["];
        CompareLater "compare-later" "Comparison: move it to the next event" "next event" ["Right" "]"];
        CompareSelect "compare-select" "Comparison: go to the device of the row" "go to device" ["Enter"];
        CompareClose "compare-close" "Comparison: close it" "close" ["Esc" "d" "q"];
    }
    Profile Answer: {
        ProfileUp "profile-up" "Profile: the value before" "" ["Up" "k"];
        ProfileDown "profile-down" "Profile: the next value" "" ["Down" "j"];
        ProfileTick "profile-choose" "Profile: choose a learnt value, or not" "choose" ["Space"];
        ProfileUse "profile-use" "Profile: use the chosen values and save them" "use and save" ["Enter"];
        ProfileFrames "profile-frames" "Profile: frames behind the value" "frames" ["f"];
        ProfileDismiss "profile-dismiss" "Profile: close, no line about it any more" "not again" ["n"];
        ProfileClose "profile-close" "Profile: close the list" "close" ["Esc" "L" "q"];
    }
    Plan Answer: {
        PlanUp "plan-up" "Plan: the row before" "" ["Up" "k"];
        PlanDown "plan-down" "Plan: the next row" "" ["Down" "j"];
        PlanStart "plan-start" "Plan: start it, or what is left (confirms)" "start" ["Enter"];
        PlanLeaveOut "plan-leave-out" "Plan: leave the device out, or not" "leave out" ["Space"];
        PlanEarlier "plan-earlier" "Plan: the device earlier" "earlier" ["K"];
        PlanLater "plan-later" "Plan: the device later" "later" ["J"];
        PlanStop "plan-stop" "Plan: stop after this step, or go on" "stop after this" ["s"];
        PlanUndo "plan-undo" "Plan: the way back to the former addresses" "way back" ["u"];
        PlanFixed "plan-fixed" "Plan: fixed or preferred addresses" "" ["x"];
        PlanRestart "plan-restart" "Plan: restart each device after its write" "restart each" ["r"];
        PlanClose "plan-close" "Plan: close it; a run goes on" "close" ["Esc" "P" "q"];
    }
    Compose Answer: {
        ComposeNext "compose-next" "Composer: the next field" "field" ["Tab"];
        ComposePrevious "compose-previous" "Composer: the field before" "" ["Shift-Tab"];
        ComposeOlder "compose-older" "Composer: sent before; a device or service before" "sent before" ["Up"];
        ComposeNewer "compose-newer" "Composer: sent after it; the next device or service" "" ["Down"];
        ComposeSend "compose-send" "Composer: send it (confirms)" "send" ["Enter"];
        ComposeSave "compose-save" "Composer: save it as a template" "save" ["Ctrl-s"];
        ComposeOpen "compose-open" "Composer: the next template" "template" ["Ctrl-o"];
        ComposeClose "compose-close" "Composer: stop sending, or close" "close" ["Esc"];
    }
    Themes Answer: {
        ThemeUp "theme-up" "Themes: show the one before" "" ["Up" "k"];
        ThemeDown "theme-down" "Themes: show the next one" "" ["Down" "j"];
        ThemeKeep "theme-keep" "Themes: keep it in config.toml" "keep" ["Enter"];
        ThemesClose "themes-close" "Themes: back to the one before" "close" ["Esc" "t" "q"];
    }
    Choice Answer: {
        ChoiceUp "choice-up" "Buses: the line before" "" ["Up" "k"];
        ChoiceDown "choice-down" "Buses: the next line" "" ["Down" "j"];
        ChoiceFirst "choice-first" "Buses: the first line" "" ["Home"];
        ChoiceLast "choice-last" "Buses: the last line" "" ["End" "G"];
        ChoiceOpen "choice-open" "Buses: open the chosen ones, or this one" "open" ["Enter"];
        ChoiceToggle "choice-toggle" "Buses: choose several" "several" ["Space"];
        ChoiceBitrate "choice-bitrate" "Buses: next bit rate of an adapter" "bit rate" ["e"];
        ChoiceSearch "choice-search" "Buses: only lines with words" "search" ["/"];
        ChoiceCopy "choice-copy" "Buses: copy the command of the line" "copy" ["y"];
        ChoiceListenOnly "choice-listen-only" "Buses: listen only" "" ["l"];
        ChoiceNoNames "choice-no-names" "Buses: ask no names" "" ["n"];
        ChoiceRecord "choice-record" "Buses: record to a file" "" ["r"];
        ChoiceInPlace "choice-in-place" "Buses: in place of the open ones" "" ["i"];
        ChoiceTheme "choice-theme" "Buses: next theme" "theme" ["t"];
        ChoiceClose "choice-close" "Buses: close the list" "close" ["q" "Esc"];
    }
    Confirm Answer: {
        Yes "yes" "Yes" "yes" ["y"];
        No "no" "No" "no" ["n" "Esc" "q"];
    }
    Conflict Answer: {
        Ours "ours" "Edit conflict: keep ours" "keep ours" ["o"];
        Theirs "theirs" "Edit conflict: keep theirs (file)" "keep theirs" ["t"];
        Later "later" "Edit conflict: decide later; edit stays unsaved" "later" ["Esc"];
    }
}
