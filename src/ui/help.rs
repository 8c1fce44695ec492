//! The help: keys of the open page first, then all others, signs, filter terms, and the counters of
//! each bus; with words only the lines that have them. Takes the place of the page, in two columns
//! from 80 on, in three from 160.

use super::brush::{DrawContext, fit};
use super::symbols::SYMBOLS;
use crate::app::{FILTER_FIELDS, FILTER_WORDS, Page, clock_millis, format_duration};
use crate::cell_text::wrap;
use crate::keymap::{ACTIONS, Action, ActionGroup, ActionInfo};
use crate::status::size;
use crate::theme::Role;
use crate::time::Duration;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Width from which the help has two columns, and three.
const TWO_COLUMNS: u16 = 80;
const THREE_COLUMNS: u16 = 160;

/// Cells between two columns.
const GAP: u16 = 2;

/// A section: its heading, and its entries with their lines.
struct HelpSection {
    title: String,
    entries: Vec<Vec<Line<'static>>>,
}

/// Draws the help without its first `scroll` lines.
pub fn draw(brush: &mut DrawContext, scroll: u16) {
    let page = brush.app.help().page;
    let title = match next_page_key(brush) {
        Some(next) if brush.screen.whole.width >= TWO_COLUMNS => {
            format!(" Keys of {} ─ {next} ", page.title())
        }
        _ => format!(" Keys of {} ", page.title()),
    };
    let below = brush.panel(&title);
    let area = Rect { x: 1, width: below.width.saturating_sub(2), ..below };
    let columns = match below.width {
        0..TWO_COLUMNS => 1,
        TWO_COLUMNS..THREE_COLUMNS => 2,
        _ => 3,
    };
    let width = (area.width + GAP) / columns - GAP;
    let words = words_of(&brush.app.help().search);
    let mut lines: Vec<Vec<Line>> = vec![Vec::new(); usize::from(columns)];
    for section in sections(brush, width) {
        let found = found_lines(brush, section, &words);
        // Each section goes below the shortest column.
        if let Some(shortest) = lines.iter_mut().min_by_key(|column| column.len())
            && !found.is_empty()
        {
            if !shortest.is_empty() {
                shortest.push(Line::default());
            }
            shortest.extend(found);
        }
    }
    if lines.iter().all(Vec::is_empty) {
        let line = Line::from(brush.span(Role::Muted, "no line has these words"));
        return brush.line(area, 1, &line);
    }
    let longest = lines.iter().map(Vec::len).max().unwrap_or_default();
    for (at, mut column) in lines.into_iter().enumerate() {
        // All columns are scrolled together.
        column.resize(longest, Line::default());
        let x = area.x + at as u16 * (width + GAP);
        brush.lines(Rect { x, width, ..area }, &column, scroll);
    }
}

/// The key that shows the keys of the next page; `None` if it has none.
fn next_page_key(brush: &DrawContext) -> Option<String> {
    let key = brush.app.keymap().keys_of(Action::HelpPage).next()?;
    let next = Page::ALL[(brush.app.help().page as usize + 1) % Page::ALL.len()];
    Some(format!("{key} keys of {}", next.title()))
}

/// Number of entries that have the words; `None` without words.
pub fn found(brush: &DrawContext) -> Option<usize> {
    let words = words_of(&brush.app.help().search);
    let sections = sections(brush, brush.screen.whole.width);
    let entries = sections.iter().flat_map(|section| &section.entries);
    (!words.is_empty()).then(|| entries.filter(|entry| has_words(entry, &words)).count())
}

fn words_of(search: &str) -> Vec<String> {
    search.split_whitespace().map(str::to_lowercase).collect()
}

fn has_words(entry: &[Line], words: &[String]) -> bool {
    let parts = entry.iter().flat_map(|line| &line.spans).map(|span| span.content.trim());
    let text = parts.collect::<Vec<_>>().join(" ").to_lowercase();
    words.iter().all(|word| text.contains(word))
}

/// The lines of a section with the words, which are marked, below its heading.
fn found_lines(brush: &DrawContext, section: HelpSection, words: &[String]) -> Vec<Line<'static>> {
    let entries = section.entries.into_iter().filter(|entry| has_words(entry, words));
    let lines: Vec<Line> = entries.flatten().map(|line| marked(brush, line, words)).collect();
    if lines.is_empty() {
        return lines;
    }
    let title = Line::from(brush.span(Role::Title, section.title));
    std::iter::once(title).chain(lines).collect()
}

/// A line in which the words have the style of matches.
fn marked(brush: &DrawContext, line: Line<'static>, words: &[String]) -> Line<'static> {
    if words.is_empty() {
        return line;
    }
    let style = brush.style(Role::Match).underlined();
    let mut spans = Vec::new();
    for span in line.spans {
        let text = span.content.into_owned();
        // Lower case changes the length of few characters only: such a span stays as it is.
        let lower = text.to_lowercase();
        let mut is_match = vec![false; text.len()];
        if lower.len() == text.len() {
            for word in words {
                for (at, _) in lower.match_indices(word.as_str()) {
                    is_match[at..at + word.len()].fill(true);
                }
            }
        }
        let mut rest = text.as_str();
        while !rest.is_empty() {
            let at = text.len() - rest.len();
            let now = is_match[at];
            let end = is_match[at..].iter().position(|it| *it != now).unwrap_or(rest.len());
            let end = (end..=rest.len()).find(|end| rest.is_char_boundary(*end));
            let (part, after) = rest.split_at(end.unwrap_or(rest.len()));
            spans.push(Span::styled(part.to_owned(), if now { style } else { span.style }));
            rest = after;
        }
    }
    Line::from(spans)
}

/// All sections: the keys of the page, those of all pages, signs, filter, capture, counters.
fn sections(brush: &DrawContext, width: u16) -> Vec<HelpSection> {
    let page = brush.app.help().page;
    let own = keys_of(page);
    let mut sections = vec![HelpSection {
        title: page.title().to_owned(),
        entries: own.iter().map(|it| action_lines(brush, it.info(), width)).collect(),
    }];
    // The keys of a log do nothing on a live bus.
    let is_used =
        |group: &ActionGroup| *group != ActionGroup::Log || brush.app.playback().is_some();
    for group in ActionGroup::ALL.into_iter().filter(is_used) {
        let others = ACTIONS.iter().filter(|it| it.group == group && !own.contains(&it.action));
        sections.push(HelpSection {
            title: group.title().to_owned(),
            entries: others.map(|action| action_lines(brush, action, width)).collect(),
        });
    }
    let sign = |&(role, sign, meaning): &(Role, &str, &str)| {
        two_columns(brush, (role, sign), 18, meaning, width)
    };
    sections.push(HelpSection {
        title: "Signs".to_owned(),
        entries: SYMBOLS.iter().map(sign).collect(),
    });
    sections.push(filter_section(brush, width));
    sections.push(capture(brush, width));
    sections.extend(counters(brush, width));
    sections
}

/// Actions that belong to a page; they come first in its help.
fn keys_of(page: Page) -> &'static [Action] {
    use Action as A;
    match page {
        Page::Devices => &[
            A::Details,
            A::Identifiers,
            A::Into,
            A::Back,
            A::Frames,
            A::Problem,
            A::Sort,
            A::SortReverse,
            A::Identify,
            A::ReadDescriptor,
            A::Command,
            A::ClearLost,
            A::EditAddress,
            A::Add,
            A::AddAll,
            A::NewEntry,
            A::Rename,
            A::DeleteEntry,
        ],
        Page::Traffic => &[
            A::Details,
            A::Identifiers,
            A::OpenParts,
            A::TimeFormat,
            A::OnlyLike,
            A::HideLike,
            A::NextMatch,
            A::PreviousMatch,
            A::Sort,
            A::SortReverse,
            A::SaveCapture,
        ],
        Page::Timeline => &[
            A::Details,
            A::Identifiers,
            A::Kinds,
            A::OpenParts,
            A::ZoomOut,
            A::ZoomIn,
            A::Frames,
            A::Problem,
            A::Mark,
            A::Compare,
        ],
        Page::Problems => &[
            A::Details,
            A::Identifiers,
            A::Frames,
            A::Problem,
            A::WriteProof,
            A::Mute,
            A::EditAddress,
        ],
        Page::Bus => &[A::Details, A::Frames, A::Identifiers, A::BitRate, A::SaveCapture],
    }
}

/// An action: its keys (`–`: none) and what it does.
fn action_lines(brush: &DrawContext, action: &ActionInfo, width: u16) -> Vec<Line<'static>> {
    let keys: Vec<String> =
        brush.app.keymap().keys_of(action.action).map(|key| key.to_string()).collect();
    let keys = if keys.is_empty() { "–".to_owned() } else { keys.join(" ") };
    let key_width = if width < 50 { 11 } else { 15 };
    two_columns(brush, (Role::HintKey, &keys), key_width, action.doc, width)
}

/// Filter terms.
fn filter_section(brush: &DrawContext, width: u16) -> HelpSection {
    let fields = FILTER_FIELDS.iter().map(|field| {
        let words: Vec<String> = field.words.iter().map(|word| format!("{word}:")).collect();
        (words.join(" "), field.doc)
    });
    let words = FILTER_WORDS.iter().map(|&(word, doc)| (word.to_owned(), doc));
    let any = ("feed".to_owned(), "rows that contain the word; several terms: all must match");
    let terms = std::iter::once(any).chain(fields).chain(words);
    let entry =
        |(term, doc): (String, &str)| two_columns(brush, (Role::HintKey, &term), 18, doc, width);
    HelpSection { title: "Filter".to_owned(), entries: terms.map(entry).collect() }
}

/// The captured frames: since when, and how long they are kept at the present load.
fn capture(brush: &DrawContext, width: u16) -> HelpSection {
    let (app, capture) = (brush.app, brush.app.capture());
    let mut entries = Vec::new();
    let stored = capture.end() - capture.first();
    let since = capture.get(capture.first()).map(|first| clock_millis(app, first.time));
    let since = since.map_or_else(|| "no frames yet".to_owned(), |at| format!("since {at}"));
    let rate: u32 = app.buses().iter().map(|bus| bus.meter.last().frames).sum();
    let length = match u64::from(rate) {
        0 => "–".to_owned(),
        rate => format_duration(Duration::from_secs(capture.capacity() / rate)),
    };
    let room = format!("of {} frames in {}", capture.capacity(), size(capture.room() as u64));
    for (name, value, meaning) in [
        ("frames", stored.to_string(), format!("{since}, {room}")),
        ("kept for", length, format!("at {rate} frames/s; longer with --capture SIZE")),
        ("dropped", capture.first().to_string(), "the oldest; those near evidence stay".into()),
    ] {
        let left = format!("{name:<12}{value:>11}");
        entries.push(two_columns(brush, (Role::Text, &left), 24, &meaning, width));
    }
    HelpSection { title: "Capture".to_owned(), entries }
}

/// The counters of each bus and the size of the kernel's receive buffer. All places where frames
/// can be lost are listed, also while their counters are 0.
fn counters(brush: &DrawContext, width: u16) -> Vec<HelpSection> {
    let mut sections = Vec::new();
    for bus in brush.app.buses() {
        let (engine, status) = (bus.counters(), &bus.status);
        let mut entries = Vec::new();
        for (name, count, meaning) in [
            ("frames", engine.frames, "received, own frames included"),
            ("sent", engine.sent, "own frames confirmed on the bus"),
            ("errors", engine.errors, "error frames"),
            ("non-platform", engine.non_platform, "11-bit and remote frames, not decoded"),
            ("non-conforming", engine.non_conforming, "unknown message type"),
            ("malformed", engine.malformed, "responses unusable or only partly usable"),
            ("aborted", engine.transfers_failed, "multi-frame responses not completed"),
            ("not stored", engine.over_limit, "rows and findings over the limit"),
            ("lost: kernel", status.kernel_drops, "kernel receive buffer full"),
            ("lost: adapter", status.controller_overruns, "controller overrun"),
            ("lost: queue", status.queue_drops, "receive queue full"),
            ("not sent", status.transmit_failures, "rejected or timed out"),
            ("unreadable", status.unreadable, "messages of the adapter or server"),
        ] {
            // Only adapters and servers send messages; a CAN interface never has any.
            if name == "unreadable" && count == 0 {
                continue;
            }
            let left = format!("{name:<14}{count:>9}");
            entries.push(two_columns(brush, (Role::Text, &left), 24, meaning, width));
        }
        let buffer = status.receive_buffer.zip(status.receive_buffer_frames());
        let buffer = buffer.map(|(bytes, held)| {
            format!("receive buffer {}, about {held} frames", size(u64::from(bytes)))
        });
        for text in buffer.into_iter().chain(status.note.clone()) {
            let text = crate::text::Escaped(text.as_bytes()).to_string();
            let room = usize::from(width).saturating_sub(4);
            let parts = wrap(&text, room).into_iter();
            let line = |part| Line::from(vec![Span::raw("  "), brush.span(Role::Muted, part)]);
            entries.push(parts.map(line).collect());
        }
        let name = crate::text::Escaped(bus.name.as_bytes());
        sections.push(HelpSection { title: format!("Counters of {name}"), entries });
    }
    sections
}

/// Two columns, both wrapped: `left_width` cells, and the rest of `width`.
fn two_columns(
    brush: &DrawContext,
    (role, left): (Role, &str),
    left_width: usize,
    right: &str,
    width: u16,
) -> Vec<Line<'static>> {
    let room = usize::from(width).saturating_sub(left_width + 3);
    let fits = left.width() <= left_width;
    let left = if fits { vec![left.to_owned()] } else { wrap(left, left_width) };
    let right = wrap(right, room);
    (0..left.len().max(right.len()))
        .map(|at| {
            let part = |parts: &[String]| parts.get(at).cloned().unwrap_or_default();
            let left = brush.span(role, fit(&part(&left), left_width));
            let right = brush.span(Role::Text, format!(" {}", part(&right)));
            Line::from(vec![Span::raw("  "), left, right])
        })
        .collect()
}
