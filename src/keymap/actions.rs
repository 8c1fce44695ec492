//! The table of actions: name, what it does in a line, its usual keys, its function.
//!
//! Keys, `keys.toml`, the help and the hints in the last line all come from here. What an action
//! does is [`App`]'s; nothing that transmits beyond discovery happens without a confirmation.

use crate::app::{App, Page};
use crate::status::PlaybackCommand;
use crate::time::Instant;
use std::fmt;

/// Something the user can do.
pub struct Action {
    /// Its name in `keys.toml`.
    pub name: &'static str,
    /// What it does, in a line.
    pub doc: &'static str,
    /// The word for it in the last line of the screen; empty where it is not shown there.
    pub hint: &'static str,
    /// Where its keys count.
    pub mode: KeyMode,
    /// Its place in the help.
    pub group: ActionGroup,
    /// Its usual keys, as [`super::Key::parse`] reads them.
    pub keys: &'static [&'static str],
    /// Does it.
    pub run: fn(&mut App, Instant),
}

/// What the keys mean at the moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KeyMode {
    /// Looking at a page.
    Browse,
    /// A question waits for yes or no.
    Confirm,
    /// Another program changed the same value of des.json.
    Conflict,
    /// The help is open.
    Help,
}

/// The parts of the help.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum ActionGroup {
    Look,
    Bus,
    Log,
    File,
    Program,
    Answer,
}

impl ActionGroup {
    /// In the order of the help.
    pub const ALL: [ActionGroup; 6] = [
        ActionGroup::Look,
        ActionGroup::Bus,
        ActionGroup::Log,
        ActionGroup::File,
        ActionGroup::Program,
        ActionGroup::Answer,
    ];

    /// Its heading.
    pub const fn title(self) -> &'static str {
        match self {
            ActionGroup::Look => "View",
            ActionGroup::Bus => "The bus",
            ActionGroup::Log => "The log",
            ActionGroup::File => "des.json",
            ActionGroup::Program => "The program",
            ActionGroup::Answer => "Prompts",
        }
    }
}

impl fmt::Debug for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// Writes the table: `mode group: name "doc" "hint" [keys] => function;`.
macro_rules! actions {
    ($($mode:ident $group:ident: {
        $($name:literal $doc:literal $hint:literal [$($key:literal)*] => $run:expr;)*
    })*) => {
        /// All actions, in the order of the help.
        pub static ACTIONS: &[Action] = &[$($(Action {
            name: $name,
            doc: $doc,
            hint: $hint,
            mode: KeyMode::$mode,
            group: ActionGroup::$group,
            keys: &[$($key),*],
            run: $run,
        },)*)*];
    };
}

actions! {
    Browse Look: {
        "up" "Up a row" "" ["Up" "k"] => |app, _| app.move_by(-1);
        "down" "Down a row" "" ["Down" "j"] => |app, _| app.move_by(1);
        "page-up" "Up a screenful" "" ["PgUp" "Ctrl-b"] => |app, _| app.move_pages(-1);
        "page-down" "Down a screenful" "" ["PgDn" "Ctrl-f"] => |app, _| app.move_pages(1);
        "first" "First row" "" ["g" "Home"] => |app, _| app.move_to_end(false);
        "last" "Last row; follow in Traffic and Timeline" "" ["G" "End"]
            => |app, _| app.move_to_end(true);
        "details" "Open details, or the frames of a problem or event" "details" ["Enter"]
            => |app, _| app.open_details();
        "into" "Focus the details" "" ["Right" "l"] => |app, _| app.focus_details(true);
        "back" "Focus the list" "" ["Left" "h"] => |app, _| app.focus_details(false);
        "next-page" "Next page" "" ["Tab"] => |app, _| app.turn_page(1);
        "previous-page" "Previous page" "" ["Shift-Tab"] => |app, _| app.turn_page(-1);
        "devices" "Page 1: devices" "" ["1"] => |app, _| app.show_page(Page::Devices);
        "traffic" "Page 2: traffic" "" ["2"] => |app, _| app.show_page(Page::Traffic);
        "timeline" "Page 3: timeline" "" ["3"] => |app, _| app.show_page(Page::Timeline);
        "problems" "Page 4: problems" "" ["4"] => |app, _| app.show_page(Page::Problems);
        "filter" "Filter rows" "filter" ["/"] => |app, _| app.ask_filter();
        "sort" "Sort by next column" "sort" ["s"] => |app, _| app.sort_by_next();
        "freeze" "Freeze the view; capture continues" "freeze" ["Space"]
            => |app, now| app.toggle_freeze(now);
        "identifiers" "Traffic: frames, or one row per identifier" "identifiers" ["v"]
            => |app, _| app.toggle_identifiers();
        "problem" "Jump between device and problem" "problem" ["p"]
            => |app, _| app.go_to_problem();
        "mute" "Mute or unmute a problem until descan quits" "mute" ["m"]
            => |app, _| app.toggle_muted();
        "copy" "Copy the selected row to the clipboard" "" ["y"] => |app, now| app.copy_row(now);
        "cancel" "Close or leave; clear the filter" "" ["Esc"] => |app, _| app.cancel();
    }
    Browse Bus: {
        "rescan" "Restart the enumeration" "rescan" ["r"] => |app, now| app.rescan(now);
        "clear-lost" "Remove lost devices from the list" "clear lost" ["c"]
            => |app, now| app.clear_lost(now);
        "identify" "Send identify: blink or beep (confirms; needs a profile)" "identify" ["i"]
            => |app, now| app.ask_identify(now);
        "bit-rate" "Search the bit rate, listen-only (confirms; needs root)" "bit rate" ["b"]
            => |app, _| app.ask_bitrate();
        "save-capture" "Save the captured frames as a candump log" "save log" ["w"]
            => |app, now| app.ask_capture_path(now);
    }
    Browse Log: {
        "pause" "Pause or resume the log" "" ["P"]
            => |app, _| app.control_playback(PlaybackCommand::Pause);
        "step" "Step to the next frame" "" [">"]
            => |app, _| app.control_playback(PlaybackCommand::Step);
        "slower" "Halve the replay speed" "" ["["] => |app, _| app.control_playback(PlaybackCommand::Slower);
        "faster" "Double the replay speed" "" ["]"] => |app, _| app.control_playback(PlaybackCommand::Faster);
    }
    Browse File: {
        "edit-address" "Edit the static address in the row" "edit address" ["e"]
            => |app, now| app.edit_address(now);
        "add" "Add device to file" "add to file" ["a"] => |app, now| app.add_device(now);
        "add-all" "Add all devices to file" "" ["A"] => |app, now| app.add_all(now);
        "new-entry" "New entry: name and address" "new" ["n"] => |app, now| app.ask_new_entry(now);
        "rename" "Rename the entry" "" ["R"] => |app, now| app.ask_rename(now);
        "delete-entry" "Delete the entry (confirms)" "" ["D"] => |app, now| app.ask_delete(now);
        "undo" "Undo" "undo" ["u"] => |app, now| app.undo(now);
        "redo" "Redo" "" ["Ctrl-r"] => |app, now| app.redo(now);
        "save" "Retry saving" "save again" ["Ctrl-s"]
            => |app, now| app.save(now);
        "save-copy" "Save a copy of des.json, with all edits" "save a copy" ["W"]
            => |app, now| app.ask_copy_path(now);
    }
    Browse Program: {
        "help" "Keys, symbols and counters" "help" ["?" "F1"] => |app, _| app.show_help();
        "theme" "Next theme" "" ["t"] => |app, now| app.next_theme(now);
        "redraw" "Redraw the screen" "" ["Ctrl-l"] => |app, _| app.redraw();
        "suspend" "Suspend to the shell (fg returns)" "" ["Ctrl-z"] => |app, _| app.suspend();
        "quit" "Quit; confirms if edits are unsaved" "quit" ["q"] => |app, now| app.ask_quit(now);
        "quit-now" "Quit immediately" "" ["Ctrl-c"] => |app, _| app.quit();
    }
    Help Answer: {
        "help-up" "Scroll the help up" "" ["Up" "k"] => |app, _| app.scroll_help(-1);
        "help-down" "Scroll the help down" "scroll" ["Down" "j"]
            => |app, _| app.scroll_help(1);
        "help-page-up" "A screenful up" "" ["PgUp" "Ctrl-b"] => |app, _| app.page_help(-1);
        "help-page-down" "A screenful down" "" ["PgDn" "Ctrl-f" "Space"]
            => |app, _| app.page_help(1);
        "help-first" "First line" "" ["g" "Home"] => |app, _| app.scroll_help(i16::MIN);
        "help-last" "Last line" "" ["G" "End"] => |app, _| app.scroll_help(i16::MAX);
        "help-close" "Close the help" "close" ["Esc" "?" "q" "Enter" "F1"]
            => |app, _| app.cancel();
    }
    Confirm Answer: {
        "yes" "Yes" "yes" ["y"] => |app, now| app.answer(now, true);
        "no" "No" "no" ["n" "Esc" "q"] => |app, now| app.answer(now, false);
    }
    Conflict Answer: {
        "ours" "Edit conflict: keep ours" "ours" ["o"] => |app, now| app.resolve(now, true);
        "theirs" "Edit conflict: keep theirs (file)" "theirs" ["t"]
            => |app, now| app.resolve(now, false);
        "later" "Edit conflict: decide later; edit stays unsaved" "later" ["Esc"]
            => |app, now| app.resolve_later(now);
    }
}

/// The action of that name.
pub fn action(name: &str) -> Option<&'static Action> {
    ACTIONS.iter().find(|action| action.name == name)
}
