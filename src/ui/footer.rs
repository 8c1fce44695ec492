//! The last line of the screen, in this order of precedence: a prompt, a confirmation, a message,
//! the keys of the open page. A message or a rejected input that needs more room takes up to three
//! lines.

use super::brush::{DrawContext, fit};
use super::chart::grouped;
use super::status::WIDE;
use crate::app::{
    BarKey, FileError, FileStatus, Focus, InputCheck, Page, PlanSession, Prompt, PromptKind,
    addition_refusal, format_duration, is_about,
};
use crate::cell_text::{cut, wrap};
use crate::discovery::Config;
use crate::keymap::{Action, KeyCode, KeyMode};
use crate::text::Escaped;
use crate::theme::Role;
use crate::time::Duration;
use ratatui::layout::{Position, Rect};
use ratatui::style::Modifier;
use ratatui::text::{Line, Span};
use std::ops::Range;
use unicode_width::UnicodeWidthStr;

/// Draws the footer.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.footer;
    if area.height == 0 {
        return;
    }
    if brush.app.prompt().is_some() {
        return draw_prompt(brush, area);
    }
    if let Some(question) = brush.app.question() {
        return draw_question(brush, area, &question);
    }
    let mode = brush.app.mode();
    let shows_message = !matches!(mode, KeyMode::Help | KeyMode::Confirm | KeyMode::Conflict);
    if let Some(message) = brush.app.message().filter(|_| shows_message) {
        let role = if message.is_error { Role::Error } else { Role::Text };
        return draw_wrapped(brush, area, role, &message.text);
    }
    let search = &brush.app.help().search;
    if mode == KeyMode::Help && (brush.app.help().is_typing || !search.is_empty()) {
        return draw_help_search(brush, area);
    }
    let line = Line::from(hint_line(brush, mode, usize::from(area.width)));
    brush.line(area, 0, &line);
}

/// Draws the words that the lines of the help must have, and how many lines have them.
fn draw_help_search(brush: &mut DrawContext, area: Rect) {
    let view = brush.app.help();
    let (search, is_typing) = (view.search.clone(), view.is_typing);
    let found = match super::help::found(brush) {
        Some(1) => "1 line with it   ".to_owned(),
        Some(count) => format!("{count} lines with it   "),
        None => String::new(),
    };
    let keys = if is_typing { "Enter keep   Esc all lines again " } else { "Esc all lines again " };
    let text = Escaped(search.as_bytes()).to_string();
    let line = Line::from(vec![
        brush.span(Role::Title, " / "),
        brush.span(Role::Input, format!("{text} ")),
    ]);
    brush.line(area, 0, &line);
    if is_typing {
        let x = area.x + (3 + text.width() as u16).min(area.width.saturating_sub(1));
        brush.cursor = Some(Position::new(x, area.y));
    }
    let end = Line::from(brush.span(Role::Muted, format!("{found}{keys}")));
    let width = end.width() as u16;
    if line.width() as u16 + width < area.width {
        brush.line(Rect { x: area.right() - width, width, ..area }, 0, &end);
    }
}

/// Most lines of a text; the rest is cut with `…`.
const LINES: usize = 3;

/// Draws a question with its keys behind it, on several lines if one is too short.
fn draw_question(brush: &mut DrawContext, last: Rect, question: &str) {
    let width = usize::from(last.width);
    let mut lines = wrap(question, width.saturating_sub(2));
    let keys = Line::from(hints(brush, &[Action::Yes, Action::No], usize::MAX));
    let is_behind = lines.last().is_some_and(|it| it.width() + 3 + keys.width() <= width);
    let text = if is_behind { lines.pop().unwrap_or_default() + "  " } else { String::new() };
    let above = Rect { y: last.y.saturating_sub(1), ..last };
    if !lines.is_empty() && last.y > 0 {
        draw_wrapped(brush, above, Role::Warning, &lines.join(" "));
    }
    let mut line = Line::from(brush.span(Role::Warning, format!(" {text}")));
    line.spans.extend(keys.spans);
    brush.line(last, 0, &line);
}

/// Draws the prompt: its label, the text typed so far, and the check of that text. On Devices the
/// address is typed in the row (`brush.cursor` is set), and the footer has only the check.
fn draw_prompt(brush: &mut DrawContext, area: Rect) {
    let app = brush.app;
    let (Some(prompt), Some(check)) = (app.prompt(), app.prompt_check()) else { return };
    let text = prompt.input.value();
    // An entry that is not begun is not wrong.
    let is_begun = !(matches!(prompt.kind, PromptKind::NewEntry(_)) && text.is_empty());
    let (role, note) = match check {
        InputCheck::Accepted(text) => (Role::Muted, text),
        InputCheck::Rejected(text) if !is_begun && !app.counts().is_file_broken => {
            (Role::Muted, text)
        }
        InputCheck::Warning(text) => (Role::Warning, format!("! {text}")),
        InputCheck::Rejected(text) => (Role::Error, format!("✗ {text}")),
    };
    let completion = completion_line(brush, usize::from(area.width));
    let columns = usize::from(area.width);
    let label = app.prompt_label().filter(|_| columns >= 60 || brush.cursor.is_some());
    let label = format!(" {}: ", label.unwrap_or_else(|| prompt.kind.short_label().to_owned()));
    let first = note.split_once(';').map_or(&*note, |(first, _)| first);
    if let Some(row) = brush.cursor {
        // Lines above the footer may hide the row in which the address is typed.
        let height = wrap(&note, columns.saturating_sub(1)).len().min(LINES) as u16;
        let note = if row.y + height > area.y { first } else { &note };
        if label.width() + note.width() > columns {
            return draw_wrapped(brush, area, role, note);
        }
        let label = brush.span(Role::Title, label);
        let line = Line::from(vec![label, brush.span(role, note)]);
        return brush.line(area, 0, &line);
    }
    let left = columns.saturating_sub(label.width());
    // Two cells more than the text: the cursor stands behind it without scrolling.
    let needed = (text.width() + 2).min(left);
    let room = left - needed;
    // The hint yields to the line; a warning or a rejection goes above it.
    let note = match role {
        _ if note.width() + 2 <= room => note,
        Role::Muted if matches!(prompt.kind, PromptKind::Filter(_)) => {
            let room = left.saturating_sub(needed.max(24) + 2);
            if room < 8 { String::new() } else { fit(&note, room) }
        }
        Role::Muted if first.width() + 2 <= room => first.to_owned(),
        Role::Muted => String::new(),
        _ => {
            if area.y > 0 && completion.is_none() {
                draw_wrapped(brush, Rect { y: area.y - 1, ..area }, role, &note);
            }
            String::new()
        }
    };
    if let Some(line) = completion.filter(|_| area.y > 0) {
        brush.line(Rect { y: area.y - 1, ..area }, 0, &line);
    }
    let width = match note.width() {
        0 => left,
        note => needed.max(24).min(left - note - 2),
    } as u16;
    let label_width = label.width() as u16;
    let line = Line::from(brush.span(Role::Title, label));
    brush.line(area, 0, &line);
    let at = Rect { x: area.x + label_width, width, ..area };
    let scroll = prompt.input.visual_scroll(usize::from(width.saturating_sub(1)));
    let mut text: String = text.chars().skip(scroll).collect();
    if scroll > 0 {
        text = format!("…{}", text.chars().skip(1).collect::<String>());
    }
    let style = brush.style(Role::Input);
    brush.buffer.set_string(at.x, at.y, " ".repeat(usize::from(width)), style);
    brush.buffer.set_string(at.x, at.y, cut(&text, usize::from(width)), style);
    if let Some(place) = mistake(prompt) {
        let cell = |column: usize| (column.saturating_sub(scroll) as u16).min(width);
        let (from, to) = (cell(place.start), cell(place.end));
        let wrong = Rect { x: at.x + from, width: to - from, ..at };
        brush.buffer.set_style(wrong, brush.style(Role::Error));
        brush.buffer.set_style(wrong, Modifier::UNDERLINED);
    }
    let cursor = prompt.input.visual_cursor().saturating_sub(scroll) as u16;
    brush.cursor = Some(Position::new(at.x + cursor.min(width.saturating_sub(1)), at.y));
    let behind = Rect { x: at.right(), width: (left as u16).saturating_sub(width), ..area };
    let line = Line::from(brush.span(role, format!("  {note}")));
    brush.line(behind, 0, &line);
}

/// The columns of the mistake in a filter that is typed.
fn mistake(prompt: &Prompt) -> Option<Range<usize>> {
    let PromptKind::Filter(filter) = &prompt.kind else { return None };
    let line = prompt.input.value();
    let bytes = filter.error(line)?.range();
    let column = |byte: usize| line.get(..byte).map_or(0, UnicodeWidthStr::width);
    Some(column(bytes.start)..column(bytes.end))
}

/// What may stand at the cursor of a filter that is typed, as many as fit `width` cells; the one that
/// Tab has chosen is marked.
fn completion_line(brush: &DrawContext, width: usize) -> Option<Line<'static>> {
    let app = brush.app;
    let (completion, chosen) = app.filter_completion()?;
    let line = app.prompt()?.input.value();
    let typed = line.get(completion.range.clone()).unwrap_or_default();
    let is_at_field = line.get(..completion.range.start).is_some_and(|it| it.ends_with(':'));
    if chosen.is_none() && typed.is_empty() && !is_at_field {
        return None;
    }
    let is_new = |candidate: &String| chosen.is_some() || candidate != typed;
    let candidates: Vec<&String> = completion.candidates.iter().filter(|it| is_new(it)).collect();
    if candidates.is_empty() {
        return None;
    }
    let mut spans = vec![brush.span(Role::HintKey, " Tab"), brush.span(Role::Muted, " completes")];
    let mut left = width.saturating_sub(14);
    // The chosen one is among those that fit.
    let first = chosen.map_or(0, |at| at.saturating_sub(3));
    for (at, candidate) in candidates.iter().enumerate().skip(first) {
        let count = app.candidate_count(candidate);
        let is_none = count == Some(0);
        let count = count.map(|count| format!(" {}", grouped(count))).unwrap_or_default();
        let needed = candidate.width() + count.width() + 2;
        if needed + 2 > left {
            spans.push(brush.span(Role::Muted, " …"));
            break;
        }
        left -= needed;
        let (sign, role) = match chosen == Some(at) {
            true => (" ▸", Role::Match),
            false if is_none => ("  ", Role::Muted),
            false => ("  ", Role::Text),
        };
        spans.push(brush.span(role, format!("{sign}{candidate}")));
        spans.push(brush.span(Role::Muted, count));
    }
    let used: usize = spans.iter().map(Span::width).sum();
    spans.push(brush.span(Role::Text, " ".repeat(width.saturating_sub(used))));
    Some(Line::from(spans))
}

/// Draws a text that ends in the line `last` and takes up to two lines above it.
fn draw_wrapped(brush: &mut DrawContext, last: Rect, role: Role, text: &str) {
    let width = usize::from(last.width);
    let parts = wrap(text, width.saturating_sub(1));
    let shown = parts.len().min(LINES).min(usize::from(last.y) + 1);
    for (above, part) in parts[..shown].iter().rev().enumerate() {
        let dots = if above == 0 && parts.len() > shown { " …" } else { "" };
        let line = Line::from(brush.span(role, fit(&format!(" {part}{dots}"), width)));
        brush.line(Rect { y: last.y - above as u16, ..last }, 0, &line);
    }
}

/// Returns the keys of the open page, most important first, as many as fit `width` cells.
fn hint_line(brush: &DrawContext, mode: KeyMode, width: usize) -> Vec<Span<'static>> {
    use Action as A;
    let app = brush.app;
    let view = app.view();
    let actions: &[Action] = match (mode, view.page, view.focus) {
        (KeyMode::Help, ..) => &[A::HelpClose, A::HelpDown, A::HelpSearch, A::HelpPage],
        (KeyMode::Confirm, ..) => &[A::Yes, A::No],
        (KeyMode::Conflict, ..) => &[A::Ours, A::Theirs, A::Later],
        (KeyMode::Filters, ..) => &[A::FilterUse, A::FilterRemove, A::FiltersClose],
        (KeyMode::Kinds, ..) => &[A::KindToggle, A::KindOnly, A::KindsClose],
        (KeyMode::Profile, ..) => {
            &[A::ProfileTick, A::ProfileUse, A::ProfileFrames, A::ProfileDismiss, A::ProfileClose]
        }
        (KeyMode::Plan, ..) => &[
            A::PlanStart,
            A::PlanLeaveOut,
            A::PlanEarlier,
            A::PlanLater,
            A::PlanStop,
            A::PlanUndo,
            A::PlanClose,
        ],
        (KeyMode::Compose, ..) => &[
            A::ComposeSend,
            A::ComposeNext,
            A::ComposeOlder,
            A::ComposeOpen,
            A::ComposeSave,
            A::ComposeClose,
        ],
        // It is drawn with its keys.
        (KeyMode::Choice, ..) => &[],
        (KeyMode::Themes, ..) => &[A::ThemeUp, A::ThemeDown, A::ThemeKeep, A::ThemesClose],
        (KeyMode::Marks, ..) => &[A::MarkGo, A::MarkRemove, A::MarksClose],
        (KeyMode::Compare, ..) => {
            &[A::CompareSide, A::CompareEarlier, A::CompareLater, A::CompareSelect, A::CompareClose]
        }
        (KeyMode::Browse, Page::Devices, _) => &[
            A::EditAddress,
            A::Add,
            A::Filter,
            A::Freeze,
            A::Rescan,
            A::Undo,
            A::Details,
            A::Frames,
            A::Sort,
            A::Problem,
            A::ClearLost,
            A::Identify,
            A::ReadDescriptor,
            A::Command,
        ],
        (KeyMode::Browse, Page::Traffic, _) => &[
            A::Details,
            A::Frames,
            A::Filter,
            A::Freeze,
            A::Identifiers,
            A::TimeFormat,
            A::SaveCapture,
            A::Rescan,
        ],
        (KeyMode::Browse, Page::Timeline, _) => &[
            A::Details,
            A::Frames,
            A::Kinds,
            A::Identifiers,
            A::Freeze,
            A::ZoomOut,
            A::Problem,
            A::OpenParts,
            A::Filter,
            A::Mark,
            A::Compare,
            A::SaveCapture,
        ],
        (KeyMode::Browse, Page::Bus, _) => &[
            A::Details,
            A::Frames,
            A::ZoomOut,
            A::Identifiers,
            A::Freeze,
            A::BitRate,
            A::SaveCapture,
        ],
        (KeyMode::Browse, Page::Problems, _) => &[
            A::Details,
            A::Frames,
            A::Problem,
            A::WriteProof,
            A::Mute,
            A::EditAddress,
            A::Identifiers,
            A::Filter,
            A::Rescan,
        ],
    };
    let mut problems = app.files().filter_map(|(_, file)| file.problem());
    let is_not_saved = problems.any(FileError::is_not_saved);
    let first: &[Action] = match mode {
        KeyMode::Browse if is_not_saved => &[A::Save, A::SaveCopy, A::Help, A::Quit],
        KeyMode::Browse => &[A::Help, A::Quit],
        _ => &[],
    };
    // Where Esc leads back, that comes first; the keys of a moment and of a log before those of the
    // page.
    let is_browsing = mode == KeyMode::Browse;
    let is_frozen = app.past_moment().is_some();
    let pairs = match app.playback() {
        _ if !is_browsing => Vec::new(),
        _ if app.shows_beat_history() => vec![
            one(brush, A::Cancel, "close"),
            pair(brush, A::Back, A::Into, "heartbeat"),
            one(brush, A::Details, "frames"),
        ],
        _ if is_frozen => frozen_hints(brush),
        Some(playback) if !playback.is_ended => log_hints(brush),
        _ => Vec::new(),
    };
    let back: &[Action] = if is_browsing { &[A::Cancel] } else { &[] };
    let mut actions = if is_frozen && is_browsing && says_present(brush) {
        [back, &[A::Frames], actions].concat()
    } else if is_frozen || !pairs.is_empty() {
        [back, actions].concat()
    } else {
        [first, back, actions].concat()
    };
    let mut seen = vec![A::Freeze; usize::from(!pairs.is_empty())];
    actions.retain(|action| {
        let is_new = !seen.contains(action);
        seen.push(*action);
        is_new && applies(brush, *action)
    });
    let mut all = pairs;
    if !all.is_empty() {
        // The help is the way to all other keys.
        let at = usize::from(!is_frozen || !says_present(brush));
        all.insert(at, first.iter().find_map(|action| hint(brush, *action)));
    }
    all.extend(actions.iter().map(|action| hint(brush, *action)));
    if is_frozen && is_browsing {
        let last = [&[A::Mark], first.get(1..).unwrap_or_default()].concat();
        all.extend(last.iter().map(|action| hint(brush, *action)));
    }
    let mut keys = Vec::new();
    let all = all.into_iter().flatten().filter(|(key, _)| {
        let is_new = !keys.contains(key);
        keys.push(key.clone());
        is_new
    });
    let all: Vec<Hint> = all.collect();
    let mut spans = vec![Span::raw(" ")];
    spans.extend(fitting(brush, all.into_iter(), width.saturating_sub(1)));
    spans
}

/// Keys of a moment that is shown: to the present, and from moment to moment.
fn frozen_hints(brush: &DrawContext) -> Vec<Option<Hint>> {
    use Action as A;
    let app = brush.app;
    let bar = app.time_bar();
    let cell = cell_text(bar.cell_duration());
    let far = cell_text(bar.cell_duration() * FAR_CELLS);
    let has_bar = !bar.cells.is_empty();
    let live = match app.playback() {
        _ if app.play_pace().is_some() => "stop",
        Some(_) => "play",
        None => "live",
    };
    let proof = || one(brush, A::WriteProof, "proof").filter(|_| app.view().page == Page::Problems);
    let step = || pair(brush, A::Back, A::Into, &cell).filter(|_| has_bar);
    let frame = pair(brush, A::PreviousFrame, A::NextFrame, "frame");
    let event = pair(brush, A::PreviousEvent, A::NextEvent, "event");
    let problem = pair(brush, A::PreviousProblem, A::NextProblem, "problem");
    if says_present(brush) {
        // What does not fit is less important.
        let diff = one(brush, A::Compare, "diff");
        let time = one(brush, A::GoTo, "time");
        let pace = pair(brush, A::Slower, A::Faster, "play").filter(|_| app.play_pace().is_some());
        return vec![proof(), pace, step(), event, problem, time, diff, frame];
    }
    vec![
        one(brush, A::Freeze, live),
        proof(),
        step(),
        shift(brush, &far).filter(|_| has_bar),
        frame,
        event,
        problem,
        pair(brush, A::Slower, A::Faster, "play"),
        one(brush, A::GoTo, "time"),
        one(brush, A::Mark, "mark"),
        one(brush, A::Compare, "diff"),
        pair(brush, A::ZoomOut, A::ZoomIn, "zoom").filter(|_| has_bar),
    ]
}

/// Returns true if the key of the present stands in the first line only: the footer has no room for both.
fn says_present(brush: &DrawContext) -> bool {
    (WIDE..BOTH).contains(&brush.screen.whole.width) && brush.screen.status.height > 0
}

/// Keys of a log that is played.
fn log_hints(brush: &DrawContext) -> Vec<Option<Hint>> {
    use Action as A;
    let is_paused = brush.app.playback().is_some_and(|it| it.is_paused);
    vec![
        one(brush, A::Freeze, if is_paused { "play" } else { "pause" }),
        pair(brush, A::Slower, A::Faster, "pace"),
        pair(brush, A::PreviousFrame, A::NextFrame, "frame"),
        pair(brush, A::PreviousEvent, A::NextEvent, "event"),
        pair(brush, A::PreviousProblem, A::NextProblem, "problem"),
        one(brush, A::GoTo, "time"),
    ]
}

/// Width from which the footer of a past moment has the key of the present, too, in columns.
const BOTH: u16 = 100;

/// Cells of the time bar that the keys of a long step move.
const FAR_CELLS: u32 = 10;

/// The duration of a step: `2 s`, `0.4 s`, `1m20s`.
fn cell_text(duration: Duration) -> String {
    let millis = duration.as_millis();
    match millis {
        0..10 => format!("{:.1} ms", duration.as_micros() as f64 / 1000.0),
        10..100 => format!("{millis} ms"),
        100..10_000 if !millis.is_multiple_of(1000) => format!("{:.1} s", millis as f64 / 1000.0),
        _ if millis < 60_000 => format!("{} s", millis / 1000),
        _ => format_duration(duration),
    }
}

/// A key and what it does; `None` if it has no key.
fn one(brush: &DrawContext, action: Action, does: &str) -> Option<Hint> {
    let key = brush.app.keymap().keys_of(action).next()?;
    Some((key.to_string(), does.to_owned()))
}

/// The keys of two opposite actions, and what they move by.
fn pair(brush: &DrawContext, back: Action, forward: Action, does: &str) -> Option<Hint> {
    let key = |action| brush.app.keymap().keys_of(action).next();
    let (back, forward) = (key(back)?, key(forward)?);
    let keys = match (back.code, forward.code) {
        (KeyCode::Left, KeyCode::Right) if !back.shift && !forward.shift => "← →".to_owned(),
        _ => format!("{back} {forward}"),
    };
    Some((keys, does.to_owned()))
}

/// The modifier of the arrows for long steps, if their keys are those of the short ones.
fn shift(brush: &DrawContext, does: &str) -> Option<Hint> {
    let key = |action| brush.app.keymap().keys_of(action).next();
    let (near, far) = (key(Action::Back)?, key(Action::ScrubBack)?);
    let is_shifted = far.shift && !near.shift && far.code == near.code;
    is_shifted.then(|| ("Shift".to_owned(), does.to_owned()))
}

/// Returns true if an action has an effect in the present state of the open page.
fn applies(brush: &DrawContext, action: Action) -> bool {
    use Action as A;
    let (app, view) = (brush.app, brush.app.view());
    let row = app.selected_row();
    let is_leaving = view.focus == Focus::Details
        || view.page == Page::Traffic
            && (view.evidence.is_some()
                || view.call_list().is_some()
                || view.frame_details
                || view.from_timeline);
    let on_any = |can: fn(&Config) -> bool| {
        let mut buses = app.buses().iter().filter(|bus| bus.is_up() && !bus.config().listen_only);
        buses.any(|bus| can(bus.config()))
    };
    let device = || row.and_then(|row| app.device_of(row));
    match (action, view.page) {
        _ if view.frozen.is_some() && action.edits_or_sends() => false,
        (A::Cancel, _) => is_leaving,
        (A::Details, Page::Devices) => row.is_some() && !is_leaving,
        (A::Details, Page::Traffic) if view.evidence.is_none() => {
            app.capture().end() > 0 && !view.frame_details
        }
        (A::TimeFormat, Page::Traffic) => {
            view.evidence.is_none() && (view.shows_identifiers() || view.shows_calls())
        }
        (A::Frames, Page::Traffic) => view.shows_calls() && view.call_list().is_none(),
        (A::OpenParts | A::Kinds, Page::Timeline) if brush.screen.list.height == 0 => false,
        (A::ZoomOut, Page::Timeline) => brush.screen.lanes.height > 1,
        (A::Details | A::Frames | A::OpenParts, Page::Timeline) => !app.lines_shown().is_empty(),
        (A::Filter | A::Identifiers | A::Rescan, Page::Traffic) if view.evidence.is_some() => false,
        (A::Details | A::Frames, Page::Bus) => app.selected_bar().is_some(),
        (A::SaveCapture, _) => app.capture().end() > 0,
        (A::Details | A::Mute | A::Problem | A::EditAddress | A::WriteProof, Page::Problems) => {
            app.selected_problem().is_some()
        }
        (A::Frames, Page::Problems) => {
            app.selected_problem().is_some_and(|problem| problem.has_evidence())
        }
        (A::EditAddress, Page::Devices) => row.is_some_and(|row| {
            device()
                .map_or(app.entry_of(row).is_some(), |device| addition_refusal(device).is_none())
        }),
        (A::Sort, Page::Devices) => row.is_some(),
        (A::Add, Page::Devices) => row.is_some_and(|row| {
            device().is_some() && (row.file == FileStatus::New || row.has_other_services)
        }),
        (A::Problem, Page::Devices) => row.is_some_and(|row| {
            app.has_finding(|it| is_about(it, row.bus, row.address, row.name.as_ref()))
        }),
        (A::Problem, Page::Timeline) => app.has_finding(|_| true),
        (A::Undo, _) => app.files().any(|(_, file)| file.can_undo()),
        (A::ClearLost, _) => app.counts().lost > 0,
        (A::Identify | A::ReadDescriptor | A::Command, _) => {
            app.has_command(action) && device().is_some()
        }
        (A::PlanStop, _) => app.address_plan().is_some_and(PlanSession::is_running),
        (A::PlanStart | A::PlanLeaveOut | A::PlanEarlier | A::PlanLater, _) => {
            app.address_plan().is_some_and(|plan| plan.can_start(action == A::PlanStart))
        }
        (A::PlanUndo, _) => {
            app.address_plan().is_some_and(|plan| plan.record().is_some() && !plan.is_running())
        }
        (A::Rescan, _) => on_any(|config| config.send_requests),
        (A::ComposeSend, _) => {
            app.composer_dialog().is_some_and(|dialog| app.dialog_obstacle(dialog).is_none())
        }
        _ => true,
    }
}

/// Keys, and what they do.
type Hint = (String, String);

/// Returns the first key of an action and what it does on the open page; `None` if it has no key.
fn hint(brush: &DrawContext, action: Action) -> Option<Hint> {
    use Action as A;
    match action {
        A::ZoomOut => return pair(brush, A::ZoomOut, A::ZoomIn, "zoom"),
        A::ThemeUp => return pair(brush, A::ThemeUp, A::ThemeDown, "choose"),
        _ => {}
    }
    let (key, word) = brush.app.keymap().hint(action)?;
    let view = brush.app.view();
    let here = match (action, view.page, &view.evidence) {
        (A::Details, Page::Timeline, _) if brush.screen.list.height == 0 => "go to device",
        (A::Details, Page::Timeline, _) => "show moment",
        (A::Details, Page::Problems, _) if brush.screen.details.height > 0 => {
            let is_seen = brush.app.selected_problem().is_none_or(|problem| problem.has_evidence());
            match view.focus {
                _ if !is_seen => "go to row",
                Focus::List => "evidence",
                Focus::Details => "frame",
            }
        }
        (A::Details, Page::Traffic, Some(evidence)) if evidence.shows_context => "only evidence",
        (A::Details, Page::Traffic, Some(_)) => "all frames",
        (A::Problem, Page::Problems, _) => "go to device",
        (A::Details, Page::Bus, _) => match brush.app.selected_bar() {
            Some(BarKey::Service(..)) => "frames",
            _ => "go to device",
        },
        (A::Identifiers, Page::Bus, _) => brush.app.chart_span().next().title(),
        (A::TimeFormat, ..) if view.counts_base().is_some() => "count all",
        (A::TimeFormat, ..) => "count anew",
        (A::Details, Page::Traffic, None) if view.call_list().is_some() => "frame",
        (A::Details, Page::Traffic, None) if view.shows_calls() => "its calls",
        (A::Details, Page::Traffic, None) if view.shows_identifiers() => "frames",
        (A::Identifiers, Page::Problems, _) => view.problems_view.next().title(),
        (A::Identifiers, Page::Timeline, _) => {
            view.timeline_shown().next(brush.screen.whole.width).title()
        }
        (A::Identifiers, ..) => view.traffic_view.next().title(),
        (A::Cancel, ..) => "back",
        (A::Add, Page::Devices, _)
            if brush.app.selected_row().is_some_and(|row| row.has_other_services) =>
        {
            "update file"
        }
        (A::Mute, ..) if brush.app.selected_problem().is_some_and(|it| it.is_muted) => "unmute",
        _ => word,
    };
    // An action without a word stands beside its opposite.
    (!here.is_empty()).then(|| (key.to_string(), here.to_owned()))
}

/// Returns keys with their hints, without those that do not fit `width` cells.
fn hints(brush: &DrawContext, actions: &[Action], width: usize) -> Vec<Span<'static>> {
    fitting(brush, actions.iter().filter_map(|action| hint(brush, *action)), width)
}

/// Returns hints without those that do not fit `width` cells.
fn fitting(
    brush: &DrawContext,
    hints: impl Iterator<Item = Hint>,
    width: usize,
) -> Vec<Span<'static>> {
    let mut spans = Vec::new();
    let mut used = 0;
    for (key, hint) in hints {
        let gap = if used == 0 { "" } else { "  " };
        let own = gap.len() + key.width() + 1 + hint.width();
        if used + own > width {
            continue;
        }
        used += own;
        spans.push(Span::raw(gap));
        spans.push(brush.span(Role::HintKey, key));
        spans.push(brush.span(Role::Muted, format!(" {hint}")));
    }
    spans
}
