//! What the conflict panel of the Problems page shows: the boards of an address side by side.
//!
//! Input: a problem, and the captured heartbeats, devices and entries of the moment that is shown.
//! Output: a column of text for each board, and the heartbeats on one time axis. Says where boards
//! cannot be distinguished. Does not know how it is drawn.

use super::problems::{ConflictSides, Problem, ProblemKey, SideBasis, and_list, label_of};
use super::{App, CallPart, CapturedHeartbeat, Row, clock_millis, format_time_of_day};
use crate::app::file::EntryPlace;
use crate::discovery::{Device, DeviceService};
use crate::document::Entry;
use crate::finding::SeenUid;
use crate::frame::{BusIndex, CanId, Frame};
use crate::keymap::Action;
use crate::text::{Escaped, Name};
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use crate::wire::node::{Mode, Uid};
use std::fmt::Write;

/// Most boards that have columns: the newest ones.
pub const MAX_COLUMNS: usize = 3;
/// Heartbeats that the columns are made of: of two boards for a quarter of an hour.
const MAX_BEATS: usize = 2048;
/// Heartbeats on the axis at most: more have no room on any screen.
const MAX_AXIS_BEATS: usize = 4096;
/// Frames on the axis up to which responses are counted: 10 s of a full bus at 1 Mbit/s.
const MAX_COUNTED_FRAMES: u64 = 100_000;
/// Periods after the last evidence that still belong to a conflict that is over.
const AFTER_PERIODS: u32 = 10;
/// Deviation from a second up to which the phase in the second stays the same.
const SECOND_TOLERANCE: f64 = 0.005;
/// Heartbeats that the phase of a board is the median of.
const PHASE_BEATS: usize = 31;
/// Services that most devices have, which stand behind the others.
const COMMON_SERVICES: [&[u8]; 2] = [b"DES", b"CFG"];

/// The boards of a conflict, a column each.
#[derive(Clone, Debug)]
pub struct ConflictPanel {
    /// The boards.
    pub sides: ConflictSides,
    /// Place of the first board that has a column; the others joined before it.
    pub first: usize,
    /// Headings of the columns: UID and name.
    pub titles: Vec<String>,
    /// Label, and a text for each column, or one text across all.
    pub rows: Vec<(&'static str, Vec<String>)>,
    /// What to do.
    pub remedy: String,
}

/// The heartbeats of a conflict on a time axis, a cell each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BeatsOnAxis {
    /// Seconds.
    pub ruler: String,
    /// Heartbeats and missed ones.
    pub beats: Vec<Option<BeatCell>>,
    /// Responses to one request, where there are two or more.
    pub answers: Vec<Option<u32>>,
}

/// A cell with a heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BeatCell {
    /// `A`, small unless in WORK or UFUNC; `×` a missed one; `?` of an unknown board; `*` several.
    pub sign: char,
    /// The board.
    pub side: Option<usize>,
}

/// Letter of a board, by its place in the order of joining.
pub fn side_letter(side: usize) -> char {
    u8::try_from(side).ok().filter(|side| *side < 26).map_or('#', |side| char::from(b'A' + side))
}

/// The moment up to which heartbeats belong to a conflict that is over; `None` while it is open.
pub(super) fn end_of_conflict(problem: &Problem, period: Duration) -> Option<Instant> {
    problem.ended().map(|ended| ended + period * AFTER_PERIODS)
}

/// Returns true if heartbeats of a board are no longer captured, or not looked for.
fn is_cut(panel: &ConflictPanel, at: usize) -> bool {
    let joined = panel.sides.sides[at].joined;
    panel.sides.complete_from.is_some_and(|from| joined.is_none_or(|joined| joined < from))
}

/// Place of a board in the order of joining, which begins with 0: `2nd`, beside times no word for one.
pub fn ordinal(place: usize) -> String {
    let number = place + 1;
    let ending = match (number % 10, number % 100) {
        (_, 11..=13) => "th",
        (1, _) => "st",
        (2, _) => "nd",
        (3, _) => "rd",
        _ => "th",
    };
    format!("{number}{ending}")
}

impl App {
    /// The boards of a conflict; `None` for any other problem. `is_wide`: with more in each row.
    pub fn conflict_panel(&self, problem: &Problem, is_wide: bool) -> Option<ConflictPanel> {
        let (bus, address) = conflict_address(problem)?;
        let sides = self.conflict_sides(problem)?;
        let first = sides.sides.len().saturating_sub(MAX_COLUMNS);
        let devices = self.devices_at(bus, address);
        let mut panel = ConflictPanel {
            titles: Vec::new(),
            rows: Vec::new(),
            remedy: String::new(),
            sides,
            first,
        };
        panel.titles = self.side_titles(bus, problem, &panel, &devices);
        let places = panel.first..panel.sides.sides.len();
        let column = |text: &dyn Fn(usize) -> String| places.clone().map(text).collect();
        if panel.sides.basis == SideBasis::None {
            let why = "? UIDs blank or equal, heartbeat phases unclear";
            panel.rows.push(("boards", vec![why.to_owned()]));
        } else {
            if panel.sides.basis == SideBasis::Phases {
                let why = "distinguished by the phase of their heartbeats";
                panel.rows.push(("boards", vec![why.to_owned()]));
            }
            panel
                .rows
                .push(("joined", column(&|at| self.joined_text(&panel, at, address, is_wide))));
            let beats = column(&|at| self.heartbeat_text(problem, &panel, at, is_wide));
            panel.rows.push(("heartbeat", beats));
            if is_wide {
                let counts = column(&|at| self.beat_counts_text(problem, &panel, at));
                panel.rows.push(("received", counts));
            }
            panel.rows.push(("mode", column(&|at| self.mode_text(&panel, at, is_wide))));
        }
        let away = self.sides_away(bus, &panel, &devices);
        panel.rows.push(("services", services_texts(&panel, &devices, &away, is_wide)));
        if self.has_shown_file(bus) {
            panel.rows.push(("des.json", self.entry_texts(bus, &panel, &devices, is_wide)));
        }
        let listed = self.listed_uid(bus, address, &devices);
        panel.remedy = self.conflict_remedy(problem, &panel, address, listed);
        Some(panel)
    }

    /// The boards of a conflict and their heartbeats; `None` for any other problem.
    pub fn conflict_sides(&self, problem: &Problem) -> Option<ConflictSides> {
        let (bus, address) = conflict_address(problem)?;
        let period = self.period_at(bus, address);
        let until = end_of_conflict(problem, period);
        let mut beats: Vec<CapturedHeartbeat> =
            self.heartbeats_until(bus, address, until).take(MAX_BEATS).collect();
        beats.reverse();
        let kept_from = self.traffic.heartbeats_found_from(self.end_of_beats(until));
        let looked_from = beats.first().filter(|_| beats.len() == MAX_BEATS).map(|beat| beat.time);
        let complete_from = kept_from.into_iter().chain(looked_from).max();
        let during = problem.first()..problem.last();
        let mut sides = ConflictSides::new(&beats, &problem.boards(), during, period);
        sides.complete_from = complete_from;
        Some(sides)
    }

    /// The modes of the board of a row, with the times of their first heartbeats, oldest first.
    pub fn board_modes(&self, row: &Row) -> Vec<(Instant, Mode)> {
        let place = row.board.zip(row.bus).zip(row.address);
        let Some(((board, bus), address)) = place else { return Vec::new() };
        let key = ProblemKey::Address(bus, address);
        let problems = self.problems();
        let problem = problems.iter().find(|problem| problem.key == key);
        let sides = problem.and_then(|problem| self.conflict_sides(&problem));
        let sides = sides.map_or_else(Vec::new, |sides| sides.sides);
        let own = sides.into_iter().find(|side| board.sender.has_uid(side.uid));
        own.map_or_else(Vec::new, |side| side.modes)
    }

    /// Heartbeat period of an address: measured, else that of the profile.
    fn period_at(&self, bus: BusIndex, address: Address) -> Duration {
        let usual = || self.profile(bus).heartbeat.period();
        self.bus(bus).map_or_else(usual, |bus| bus.heartbeat_period(address))
    }

    /// The same of the address of a conflict.
    pub(super) fn period_of(&self, problem: &Problem) -> Duration {
        let bus = problem.bus().unwrap_or_default();
        let usual = || self.profile(bus).heartbeat.period();
        problem.head().key.address.map_or_else(usual, |address| self.period_at(bus, address))
    }

    /// Heartbeats of an address at the moment that is shown, until a time, newest first.
    fn heartbeats_until(
        &self,
        bus: BusIndex,
        address: Address,
        until: Option<Instant>,
    ) -> super::CapturedHeartbeats<'_> {
        self.traffic.heartbeats(self.profile(bus), bus, address, self.end_of_beats(until))
    }

    /// Number of the frame before which heartbeats are looked for.
    fn end_of_beats(&self, until: Option<Instant>) -> u64 {
        let end = self.traffic.end(&self.view);
        until.map_or(end, |until| end.min(self.traffic.capture.at_time(until)))
    }

    /// The board that a piece of evidence is of; `None` for other frames than heartbeats, and where it
    /// is not known.
    pub fn side_of_frame(&self, sides: &ConflictSides, frame: &Frame) -> Option<usize> {
        let profile = self.profile(frame.bus);
        let header = Header::decode(frame.platform_id()?);
        let is_beat = header.response && header.service == profile.heartbeat_service();
        is_beat.then(|| sides.side_of(frame.time, profile.heartbeat_of(frame.data()).uid)).flatten()
    }

    /// Text of a UID in the alphabet of a bus, escaped; `blank` if it is.
    pub fn uid_text(&self, bus: BusIndex, uid: Uid) -> String {
        if uid.is_blank() {
            return "blank".to_owned();
        }
        super::capture::decoded::uid_text(&self.profile(bus), uid)
    }

    fn devices_at(&self, bus: BusIndex, address: Address) -> Vec<&Device> {
        let all = self.bus(bus).map_or(&[][..], |bus| bus.devices());
        all.iter().filter(|device| device.address == address).collect()
    }

    fn has_shown_file(&self, bus: BusIndex) -> bool {
        let documents = self.shown_documents();
        documents.is_there(documents.of_bus(bus))
    }

    // ---- columns ---------------------------------------------------------------------------

    fn side_titles(
        &self,
        bus: BusIndex,
        problem: &Problem,
        panel: &ConflictPanel,
        devices: &[&Device],
    ) -> Vec<String> {
        let profile = self.profile(bus);
        let sides = panel.sides.sides.iter().enumerate().skip(panel.first);
        let away = self.sides_away(bus, panel, devices);
        let title = |(at, side): (usize, &super::ConflictSide)| {
            let moved = away.get(at - panel.first).copied().flatten();
            let own = moved.and_then(|device| device.name.as_ref());
            let of_board = || self.name_of_board(problem, side.uid);
            let name = own.map(|name| name.quoted().to_string()).or_else(of_board);
            let name = name.map(|name| format!(" · {name}")).unwrap_or_default();
            let uid = side.uid.map_or("no UID".to_owned(), |uid| {
                label_of(super::capture::decoded::uid_text(&profile, uid))
            });
            format!("{} {uid}{name}", side_letter(at))
        };
        sides.map(title).collect()
    }

    /// The name of a board of an address conflict, by its UID, or those that it may have: `ACT or PUMP`;
    /// `None` if none is known.
    pub(super) fn name_of_board(&self, problem: &Problem, uid: Option<Uid>) -> Option<String> {
        let names = self.names_of_board(problem, uid);
        let quoted: Vec<String> = names.iter().map(|name| name.quoted().to_string()).collect();
        (!quoted.is_empty()).then(|| quoted.join(" or "))
    }

    fn names_of_board<'a>(&'a self, problem: &Problem<'a>, uid: Option<Uid>) -> Vec<&'a Name> {
        let ProblemKey::Address(bus, address) = problem.key else { return Vec::new() };
        let devices = self.devices_at(bus, address);
        let mut names: Vec<&Name> = Vec::new();
        for name in devices.iter().filter_map(|device| device.name.as_ref()) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        // The row of a board may have been removed.
        let mut removed = problem.names();
        removed.retain(|name| !names.contains(name));
        if names.len() + removed.len() > 1 {
            // While both send heartbeats, each may have a row of its own.
            let senders = self.bus(bus).map_or_else(Vec::new, |bus| bus.senders_at(address));
            let sender = senders.iter().find(|sender| sender.has_uid(uid));
            let own = sender.and_then(|it| devices.iter().find(|device| device.id == it.device));
            if let Some(name) = own.and_then(|device| device.name.as_ref()) {
                return vec![name];
            }
        }
        if removed.is_empty() { names } else { removed }
    }

    /// For each board that has a column, its device if that has another address now.
    fn sides_away(
        &self,
        bus: BusIndex,
        panel: &ConflictPanel,
        devices: &[&Device],
    ) -> Vec<Option<&Device>> {
        let all = self.bus(bus).map_or(&[][..], |bus| bus.devices());
        let is_here = |device: &Device| devices.iter().any(|here| here.id == device.id);
        let sides = panel.sides.sides.iter().skip(panel.first);
        sides
            .map(|side| {
                let uid = side.uid.filter(|uid| !uid.is_blank())?;
                all.iter().find(|device| device.uid == Some(uid) && !is_here(device))
            })
            .collect()
    }

    fn joined_text(
        &self,
        panel: &ConflictPanel,
        at: usize,
        address: Address,
        wide: bool,
    ) -> String {
        let side = &panel.sides.sides[at];
        let Some(joined) = side.joined else { return "–".to_owned() };
        let time = clock_millis(self, joined);
        let oldest = panel.sides.beats().next().map(|(beat, _)| beat);
        // Heartbeats before it are no longer captured, or not looked for.
        let capture = &self.traffic.capture;
        let has_earlier = |number| capture.first() > 0 || capture.previous(number).is_some();
        let is_older = panel.sides.basis == SideBasis::Phases
            && oldest
                .is_some_and(|it| it.time == joined && it.number > 0 && has_earlier(it.number));
        let before = if is_older { "before " } else { "" };
        let place = if at > 0 { format!(", {}", ordinal(at)) } else { String::new() };
        if let Some(first) = side.first.filter(|first| *first < joined) {
            let first = format_time_of_day(self, first);
            return format!("{first}{place}, back {time}");
        }
        let is_told = side.has_claimed && wide;
        let claim = if is_told { format!(", claimed {address} in ARSLV") } else { String::new() };
        format!("{before}{time}{place}{claim}")
    }

    fn heartbeat_text(
        &self,
        problem: &Problem,
        panel: &ConflictPanel,
        at: usize,
        wide: bool,
    ) -> String {
        let sides = &panel.sides;
        let side = &sides.sides[at];
        let Some(last) = side.last else { return "no longer in the capture".to_owned() };
        let usual = self.period_of(problem);
        let now = self.display_time();
        let end = end_of_conflict(problem, usual).map_or(now, |end| end.min(now));
        let left = sides.has_left(at, end, side.period.unwrap_or(usual));
        let is_cut = sides.complete_from.is_some_and(|from| from > last);
        let later = sides.beats().rev().take_while(|(beat, _)| beat.time > last);
        let is_unclear = later.map(|(_, side)| side).any(|side| side.is_none());
        let left = match (left, is_unclear) {
            (false, _) => String::new(),
            _ if is_cut => format!("last kept {}", clock_millis(self, last)),
            (true, true) => format!("unclear since {}", clock_millis(self, last)),
            (true, false) => format!("left: last {}", clock_millis(self, last)),
        };
        if !left.is_empty() && !wide {
            return left;
        }
        let mut parts = Vec::new();
        if !left.is_empty() {
            parts.push(left);
        }
        if let Some(period) = side.period {
            let jitter = side.jitter.filter(|_| wide).map_or(String::new(), |jitter| {
                format!(" ±{:.0} ms", jitter.as_secs_f64() * 1000.0)
            });
            let mut text = format!("{:.2} s{jitter}", period.as_secs_f64());
            // Of three boards the columns are narrow.
            let has_room = wide || panel.sides.sides.len() < MAX_COLUMNS || at == 0;
            if let Some(phase) = self.phase_in_second(sides, at).filter(|_| has_room) {
                let _ = write!(text, ", at .{phase:03}");
            }
            if !wide && at > 0 {
                let first = &sides.sides[0];
                let both = self.phase_in_second(sides, at).zip(self.phase_in_second(sides, 0));
                let later = match both {
                    Some((own, other)) => Some((1000 + own - other) % 1000),
                    None => side.offset_to(first).map(|it| (it.as_micros() / 1000) as u32),
                };
                if let Some(later) = later {
                    let colon = if has_room { ":" } else { "," };
                    let _ = write!(text, "{colon} {later} ms later");
                }
            }
            parts.push(text);
        }
        if !wide && side.period.is_none() {
            parts.push(format!("received {}", self.beat_counts_text(problem, panel, at)));
        }
        parts.join(", ")
    }

    /// How many heartbeats of a board were received and missed, until when.
    fn beat_counts_text(&self, problem: &Problem, panel: &ConflictPanel, at: usize) -> String {
        let side = &panel.sides.sides[at];
        let count = side.beats;
        if is_cut(panel, at) {
            return format!("{count} kept, not all");
        }
        let absences = match side.absences {
            0 => String::new(),
            1 => ", away once".to_owned(),
            more => format!(", away {more}×"),
        };
        let usual = self.period_of(problem);
        let until = end_of_conflict(problem, usual).filter(|until| *until < self.display_time());
        let until =
            until.map_or(String::new(), |at| format!(" to {}", format_time_of_day(self, at)));
        format!("{count}{until}, {} missed{absences}", side.missed)
    }

    /// Place of the heartbeats of a board in the second, in milliseconds; `None` unless the period is one
    /// second.
    fn phase_in_second(&self, sides: &ConflictSides, at: usize) -> Option<u32> {
        let period = sides.sides[at].period?.as_secs_f64();
        if (period - 1.0).abs() > SECOND_TOLERANCE {
            return None;
        }
        let joined = sides.sides[at].joined;
        let is_own = |(beat, side): &(&CapturedHeartbeat, Option<usize>)| {
            *side == Some(at) && Some(beat.time) >= joined
        };
        let own = sides.beats().rev().filter(is_own).take(PHASE_BEATS);
        let millis = |at: Instant| (self.epoch().unix_micros(at) / 1000 % 1000) as i32;
        let phases: Vec<i32> = own.map(|(beat, _)| millis(beat.time)).collect();
        let newest = *phases.first()?;
        let mut around: Vec<i32> =
            phases.iter().map(|phase| (phase - newest + 1500).rem_euclid(1000) - 500).collect();
        around.sort_unstable();
        Some((newest + around[around.len() / 2]).rem_euclid(1000).unsigned_abs())
    }

    fn mode_text(&self, panel: &ConflictPanel, at: usize, wide: bool) -> String {
        /// Modes that a column has room for.
        const SHOWN: usize = 3;
        let modes = &panel.sides.sides[at].modes;
        let skipped = modes.len().saturating_sub(SHOWN);
        let names: Vec<&str> = modes[skipped..].iter().map(|(_, mode)| mode.name()).collect();
        match (&modes[..], names.join(" → ")) {
            ([], _) => "–".to_owned(),
            ([(_, mode)], _) if !wide => mode.name().to_owned(),
            ([(since, mode)], _) if is_cut(panel, at) => {
                format!("{mode} since {} or before", clock_millis(self, *since))
            }
            ([(since, mode)], _) => format!("{mode} since {}", clock_millis(self, *since)),
            ([.., (since, _)], chain) => format!("{chain} {}", clock_millis(self, *since)),
        }
    }

    /// Entries of des.json: one with a UID is of that board, another one of the first.
    fn entry_texts(
        &self,
        bus: BusIndex,
        panel: &ConflictPanel,
        devices: &[&Device],
        wide: bool,
    ) -> Vec<String> {
        let matching = self.matching();
        let mut entries: Vec<EntryPlace> =
            devices.iter().filter_map(|device| matching.entry_of(device.id)).collect();
        entries.dedup();
        let alphabet = &self.profile(bus).uid;
        let text = |at: EntryPlace| {
            let entry = self.shown_documents().entry(at)?;
            let verb = if entry.is_static { "pinned" } else { "listed" };
            let address = entry.address.map_or(String::new(), |address| format!(" {address}"));
            let column =
                if wide { format!(", column {}", entry.position.column) } else { String::new() };
            Some(format!("{verb}{address}, line {}{column}", entry.position.line))
        };
        let owner = |at: EntryPlace| {
            let entry = self.shown_documents().entry(at)?;
            let uid = entry.uid.as_ref().and_then(|uid| Uid::parse(uid, alphabet));
            let by_uid = |uid: Uid| panel.sides.sides.iter().position(|it| it.uid == Some(uid));
            Some(uid.and_then(by_uid).unwrap_or(0))
        };
        if panel.titles.is_empty() {
            let texts: Vec<String> = entries.iter().filter_map(|at| text(*at)).collect();
            return vec![if texts.is_empty() { "no entry".to_owned() } else { texts.join("; ") }];
        }
        let places = panel.first..panel.sides.sides.len();
        let cell = |place: usize| {
            let own = entries.iter().filter(|at| owner(**at) == Some(place));
            let own: Vec<String> = own.filter_map(|at| text(*at)).collect();
            if own.is_empty() { "no entry".to_owned() } else { own.join("; ") }
        };
        places.map(cell).collect()
    }

    /// UID of a static entry with this address that is of one of the devices, if it has a UID.
    fn listed_uid(&self, bus: BusIndex, address: Address, devices: &[&Device]) -> Option<Uid> {
        let matching = self.matching();
        let alphabet = &self.profile(bus).uid;
        let entries = devices.iter().filter_map(|device| matching.entry_of(device.id));
        let entries = entries.filter_map(|at| self.shown_documents().entry(at));
        let uid_of = |entry: &Entry| Uid::parse(entry.uid.as_ref()?, alphabet);
        let is_there = |entry: &&Entry| {
            entry.is_static && entry.address.and_then(Address::new) == Some(address)
        };
        entries.filter(is_there).find_map(uid_of)
    }

    fn conflict_remedy(
        &self,
        problem: &Problem,
        panel: &ConflictPanel,
        address: Address,
        listed: Option<Uid>,
    ) -> String {
        if let Some(instead) = problem.instead_of_remedy() {
            return instead.to_owned();
        }
        let boards = problem.boards();
        // The entry of des.json says whose the address is, else who was there first.
        let is_listed = |board: &&SeenUid| Some(board.uid) == listed;
        let owner = boards.iter().find(is_listed).or(boards.first());
        let is_other = |board: &&SeenUid| Some(board.uid) != owner.map(|it| it.uid);
        let others: Vec<&SeenUid> = boards.iter().filter(is_other).collect();
        let (Some(owner), [.., other]) = (owner, &others[..]) else {
            return problem.head().remedy.clone();
        };
        let is_in_file = Some(owner.uid) == listed;
        if !is_in_file && other.first <= owner.first || address == Address::DEBUG {
            return problem.head().remedy.clone();
        }
        let label = |board: &SeenUid| label_of(board.label());
        let owner_label = label(owner);
        let why = if is_in_file {
            format!("{owner_label} is in {}", self.name_of_file(problem.bus()))
        } else if others.len() > 1 {
            format!("{owner_label} was first")
        } else {
            let sides = &panel.sides.sides;
            let side = sides.iter().position(|side| side.uid == Some(other.uid));
            let place = ordinal(side.unwrap_or(sides.len().max(boards.len()) - 1));
            if owner.has_returned() {
                let since = format_time_of_day(self, owner.first);
                format!("{place}: {owner_label} was there from {since} on")
            } else {
                place
            }
        };
        let key = self.key_of(Action::EditAddress);
        let (all, them) = if others.len() > 1 { ("all", "them") } else { ("both", "it") };
        let others = and_list(others.into_iter().map(label).collect());
        format!(
            "Unplug {others} ({why}); a write to {address} would reach {all}. Then pin {them}: {key}"
        )
    }

    // ---- the axis --------------------------------------------------------------------------

    /// The heartbeats of a conflict on `cells` cells around the joining of its newest board.
    pub fn beats_on_axis(
        &self,
        problem: &Problem,
        sides: &ConflictSides,
        cells: usize,
    ) -> Option<BeatsOnAxis> {
        let (bus, address) = conflict_address(problem)?;
        let cell = u64::from(self.view.conflict_axis.cell_millis()) * 1000;
        let epoch = self.epoch();
        let middle = epoch.unix_micros(problem.newest_joined()) / cell;
        let shift = self.view.conflict_axis.shift(&problem.key);
        let first = middle.saturating_sub(cells as u64 * 9 / 20).saturating_add_signed(shift);
        let start = i128::from(first * cell) - i128::from(epoch.unix_micros(Instant::ZERO));
        let start = u64::try_from(start.max(0)).unwrap_or(u64::MAX);
        // Cells before the start of descan.
        let skipped = (epoch.unix_micros(Instant::ZERO) + start).saturating_sub(first * cell);
        let start_time = Instant::from_micros(start);
        let length = Duration::from_micros((cells as u64 * cell).saturating_sub(skipped));
        let place = |time: Instant| {
            let at = (time.as_micros().checked_sub(start)? + skipped) / cell;
            usize::try_from(at).ok().filter(|at| *at < cells)
        };
        let shown = epoch.unix_micros(self.shown_time()) / cell;
        let until = usize::try_from((shown + 1).saturating_sub(first)).unwrap_or(usize::MAX);
        let ruler = self.ruler(first, cell, cells, until);
        let mut axis = BeatsOnAxis { ruler, beats: vec![None; cells], answers: vec![None; cells] };
        let end = start_time + length;
        let period = self.period_at(bus, address);
        let walk = self.heartbeats_until(bus, address, Some(end)).take(MAX_AXIS_BEATS);
        let mut beats: Vec<CapturedHeartbeat> =
            walk.take_while(|beat| beat.time + period * 10 > start_time).collect();
        beats.reverse();
        for beat in &beats {
            let Some(at) = place(beat.time) else { continue };
            let side = sides.side_of(beat.time, beat.uid);
            let works = match beat.mode {
                Some(mode) => matches!(mode, Mode::Work | Mode::Ufunc),
                None => beat.is_working,
            };
            let letter = side.map_or('?', side_letter);
            let sign = if works { letter } else { letter.to_ascii_lowercase() };
            let free = [at, at + 1].into_iter().find(|at| axis.beats.get(*at) == Some(&None));
            match free {
                Some(free) => axis.beats[free] = Some(BeatCell { sign, side }),
                None => axis.beats[at] = Some(BeatCell { sign: '*', side: None }),
            }
        }
        for side in 0..sides.sides.len() {
            let own = |beat: &&CapturedHeartbeat| sides.side_of(beat.time, beat.uid) == Some(side);
            let own: Vec<&CapturedHeartbeat> = beats.iter().filter(own).collect();
            let period = sides.sides[side].period.unwrap_or(period);
            for two in own.windows(2) {
                let gap = two[1].time.since(two[0].time).as_secs_f64() / period.as_secs_f64();
                // A long absence is not a row of misses.
                let missed = super::problems::missed_in(gap);
                for number in (1..=missed).filter(|_| missed <= 5) {
                    let at = place(two[0].time + period * u32::try_from(number).unwrap_or(1));
                    if let Some(cell) = at.and_then(|at| axis.beats.get_mut(at))
                        && cell.is_none()
                    {
                        *cell = Some(BeatCell { sign: '×', side: Some(side) });
                    }
                }
            }
        }
        for (time, count) in self.responses_counted(bus, address, start_time..end) {
            if let Some(at) = place(time) {
                axis.answers[at] = Some(count);
            }
        }
        Some(axis)
    }

    /// Seconds on an axis that begins with the cell `first` since 1970; blank from the cell `until` on,
    /// which is behind the shown moment.
    fn ruler(&self, first: u64, cell: u64, cells: usize, until: usize) -> String {
        let second = 1_000_000 / cell;
        // With wide cells two seconds have room for a time.
        let step = if second < 8 { 2 * second } else { second };
        let mut ruler: Vec<char> = vec!['·'; until.min(cells)];
        ruler.resize(cells, ' ');
        let mut is_first = true;
        for at in 0..until.min(cells) {
            let number = first + at as u64;
            if !number.is_multiple_of(step) {
                if is_first {
                    ruler[at] = ' ';
                }
                continue;
            }
            let since = number * cell;
            let time = since.saturating_sub(self.epoch().unix_micros(Instant::ZERO));
            let clock = format_time_of_day(self, Instant::from_micros(time));
            let is_minute = clock.ends_with(":00");
            let text = if is_first || is_minute { &clock[..] } else { &clock[clock.len() - 2..] };
            is_first = false;
            ruler[at] = '╷';
            // A part of a time is another one.
            if let Some(places) = ruler.get_mut(at + 1..=at + text.len()) {
                for (place, c) in places.iter_mut().zip(text.chars()) {
                    *place = c;
                }
            }
        }
        ruler.into_iter().collect()
    }

    /// Requests to which an address responded more than once: time of the last response, number.
    fn responses_counted(
        &self,
        bus: BusIndex,
        address: Address,
        during: std::ops::Range<Instant>,
    ) -> Vec<(Instant, u32)> {
        let capture = &self.traffic.capture;
        let end = self.traffic.end(&self.view);
        let (first, last) = (capture.at_time(during.start), capture.at_time(during.end).min(end));
        if last <= first || last - first > MAX_COUNTED_FRAMES {
            return Vec::new();
        }
        let parts = self.traffic.call_parts(self.shown_buses(), first, last - 1, end);
        let mut counts = std::collections::BTreeMap::new();
        for (number, part) in parts {
            let CallPart::Response { request, .. } = part else { continue };
            let Some(frame) = capture.get(number) else { continue };
            let CanId::Extended(id) = frame.id else { continue };
            if frame.bus == bus && Header::decode(id).source == address {
                let (time, count) = counts.entry(request).or_insert((frame.time, 0));
                (*time, *count) = (frame.time, *count + 1);
            }
        }
        counts.into_values().filter(|(_, count)| *count > 1).collect()
    }
}

/// Bus and address of a conflict; `None` for any other problem.
fn conflict_address(problem: &Problem) -> Option<(BusIndex, Address)> {
    match problem.key {
        ProblemKey::Address(bus, address) if problem.is_address_conflict() => Some((bus, address)),
        _ => None,
    }
}

/// Services with their versions; narrow: their number, and those that not all devices have first.
fn services_text(services: &[DeviceService], wide: bool) -> String {
    let text = |service: &DeviceService| {
        format!("{} {}", Escaped(service.name.as_bytes()), Escaped(service.version.as_bytes()))
    };
    if wide {
        return services.iter().map(text).collect::<Vec<_>>().join("  ");
    }
    let is_common = |it: &&DeviceService| COMMON_SERVICES.contains(&it.name.as_bytes());
    let (common, own): (Vec<_>, Vec<_>) = services.iter().partition(is_common);
    let names: Vec<String> = own.into_iter().chain(common).map(text).collect();
    format!("{}: {}", services.len(), names.join(", "))
}

/// Lists of services. Responses do not show which of the boards sent them.
fn services_texts(
    panel: &ConflictPanel,
    devices: &[&Device],
    away: &[Option<&Device>],
    wide: bool,
) -> Vec<String> {
    let count = panel.titles.len();
    if let ([device], true) = (devices, away.iter().any(Option::is_some)) {
        // Those that have another address now have their lists there.
        let own = away.iter().map(|away| {
            let services = away.unwrap_or(device).services.as_ref();
            services.map_or("not read".to_owned(), |own| services_text(own, wide))
        });
        return own.collect();
    }
    if let [device] = devices {
        let Some(own) = &device.services else { return vec!["not read".to_owned()] };
        let own = services_text(own, wide);
        if count != 2 || panel.first > 0 {
            let more = match device.other_services.len() {
                0 => String::new(),
                1 => "; another list".to_owned(),
                more => format!("; {more} other lists"),
            };
            return vec![format!("{own}{more}")];
        }
        let other = match &device.other_services[..] {
            [] if device.has_colliding_services() => "not read: responses collide".to_owned(),
            [] => "no other list received".to_owned(),
            [other] => services_text(other, wide),
            all => format!("{} other lists", all.len()),
        };
        let is_one_of_two = device.services_are_shared && !device.other_services.is_empty();
        let unsure = if is_one_of_two { "? " } else { "" };
        return vec![format!("{unsure}{own}"), format!("{unsure}{other}")];
    }
    let lists = devices.iter().map(|device| {
        let name = device.name.as_ref().map_or("?".to_owned(), |name| name.quoted().to_string());
        let services = device.services.as_ref();
        let list = services.map_or("not read".to_owned(), |list| services_text(list, false));
        format!("{name} {list}")
    });
    let lists: Vec<String> = lists.collect();
    vec![if lists.is_empty() { "–".to_owned() } else { lists.join("; ") }]
}
