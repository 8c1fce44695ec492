//! The document that an edit makes: what the edit left as it was is not read again, which in a file
//! of megabytes is what an edit would cost.
//!
//! The outcome is that of reading the new text from its beginning.

use std::ops::Range;

use super::entry::{self, Entry};
use super::finding::{self, DocumentFinding, Findings};
use super::position::{Position, Positions, advance};
use super::scan::{BLANKS, Span};
use super::syntax::{self, BOM};
use super::{Document, Root};

/// One element of the list changed, put in or taken out, in spans of the body.
pub(super) struct Patch {
    /// What is replaced.
    pub cut: Span,
    /// By what.
    pub text: String,
    /// The place of the element that is changed or taken out; empty, where one is put in.
    pub elements: Range<usize>,
    /// Where in `text` the element is that is changed or put in.
    pub new: Option<Span>,
}

impl Patch {
    /// Does what stands around the new element leave the list a list?
    fn is_well_formed(&self, elements: &[Span]) -> bool {
        match &self.new {
            None => self.elements.len() == 1 && self.text.is_empty(),
            Some(new) if self.elements.is_empty() => {
                let around = [&self.text[..new.start], &self.text[new.end..]].concat();
                let is_between = |c| c == ',' || BLANKS.contains(&c);
                around.chars().all(is_between) && around.matches(',').count() == 1
            }
            Some(new) => {
                *new == (0..self.text.len()) && elements.get(self.elements.start) == Some(&self.cut)
            }
        }
    }
}

impl Document {
    /// The document with a patch; none where it has to be read as a whole.
    pub(super) fn patched(&self, patch: &Patch) -> Option<Self> {
        let Patch { cut, text, elements, new } = patch;
        let new_text = new.clone().map(|new| &text[new]);
        let is_good = |text| syntax::is_value(text, self.root().brackets());
        if !patch.is_well_formed(self.elements()) || !new_text.is_none_or(is_good) {
            return None;
        }
        let before = &self.entries()[..self.entries_before(elements.start)];
        let after = &self.entries()[self.entries_before(elements.end)..];
        let gone = self.entries().len() - before.len() - after.len();

        let body = self.body();
        let known = before.last().map_or((Position::START, 0), |last| {
            (last.position, self.elements()[last.element].start)
        });
        let start = advance(known.0, &body.as_bytes()[known.1..cut.start]);
        let shift = Shift {
            cut,
            length: text.len(),
            old_end: advance(start, &body.as_bytes()[cut.clone()]),
            new_end: advance(start, text.as_bytes()),
        };
        let new_position = new.clone().map(|new| advance(start, &text.as_bytes()[..new.start]));
        let positions = Positions::starting(
            new_text.unwrap_or_default(),
            new_position.unwrap_or(Position::START),
        );
        let mut found = Findings::new(&positions);
        let new_entry = new_text.and_then(|text| {
            entry::read(text, &(0..text.len()), before.len(), elements.start, &mut found)
        });
        if self.findings().len().max(found.found.len()) > finding::MOST / 4 {
            // Which of them are kept, only the whole can tell.
            return None;
        }
        let renumbered = |index: usize| index - gone + usize::from(new_entry.is_some());

        let mut findings = found.found;
        for finding in self.findings().iter().filter(|finding| finding.kind.is_of_one_element()) {
            if finding.position < start {
                findings.push(finding.clone());
            } else if finding.position >= shift.old_end {
                if elements.len() != new.iter().len() && finding.kind.counts_elements() {
                    return None;
                }
                findings.push(DocumentFinding {
                    position: shift.position(finding.position),
                    entries: finding.entries.iter().map(|&index| renumbered(index)).collect(),
                    ..finding.clone()
                });
            }
        }
        let later = after.iter().map(|entry| Entry {
            position: shift.position(entry.position),
            address_position: entry.address_position.map(|position| shift.position(position)),
            index: renumbered(entry.index),
            element: entry.element - elements.len() + new.iter().len(),
            ..entry.clone()
        });
        let entries = before.iter().cloned().chain(new_entry.clone()).chain(later).collect();

        let new_element = new.iter().map(|new| cut.start + new.start..cut.start + new.end);
        let later = self.elements()[elements.end..].iter().map(|span| shift.span(span));
        let earlier = self.elements()[..elements.start].iter().cloned();
        let elements = earlier.chain(new_element).chain(later).collect();

        let root = match self.root() {
            Root::List(span) => Root::List(shift.span(span)),
            Root::Object { span, devices, again: None } => Root::Object {
                span: shift.span(span),
                devices: devices.as_ref().map(|devices| shift.span(devices)),
                again: None,
            },
            Root::Object { again: Some(_), .. } | Root::Blank | Root::Other(_) => return None,
        };
        let mark = if self.has_bom() { BOM } else { "" };
        let source = [mark, &body[..cut.start], text, &body[cut.end..]].concat();
        Some(Self::of(source, root, elements, entries, findings, 0))
    }
}

/// Where things are after a patch, whose ends were not cut.
struct Shift<'p> {
    cut: &'p Span,
    /// Of what stands there now.
    length: usize,
    /// Where the cut ended, and where its text ends.
    old_end: Position,
    new_end: Position,
}

impl Shift<'_> {
    fn offset(&self, offset: usize) -> usize {
        if offset < self.cut.end { offset } else { offset - self.cut.len() + self.length }
    }

    fn span(&self, span: &Span) -> Span {
        // What begins where something is put in comes behind it.
        self.offset(span.start)..self.offset(span.end)
    }

    /// Of what stood behind the cut.
    fn position(&self, position: Position) -> Position {
        let Position { line, column } = self.new_end;
        if position.line == self.old_end.line {
            Position { line, column: position.column - self.old_end.column + column }
        } else {
            Position { line: position.line - self.old_end.line + line, ..position }
        }
    }
}
