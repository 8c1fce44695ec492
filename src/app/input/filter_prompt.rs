//! The prompt for the filter of a page: its check, completion with Tab, lines typed before.
//!
//! Does not know which rows match; their number is told to it.

use super::prompt_logic::{InputCheck as C, PromptContext, PromptLogic, PromptOutcome};
use crate::app::filter::{Completion, CompletionSource, Filter, FilterError, RowKind};
use crate::app::page_filters::PageFilter;
use crate::app::view::Page;
use tui_input::Input as LineInput;

/// Prompt for the filter of a page.
#[derive(Clone, Debug)]
pub struct FilterPrompt {
    /// The page.
    pub page: Page,
    /// The filter before, for Esc.
    pub(in crate::app) before: PageFilter,
    /// Candidates that Tab goes through, and the one in the line.
    cycle: Option<(Completion, usize)>,
    /// Place in the history, from its end, and the line that was typed before.
    recalled: Option<(usize, String)>,
}

impl FilterPrompt {
    /// Returns a prompt for a page with this filter.
    pub(in crate::app) fn new(page: Page, before: PageFilter) -> Self {
        Self { page, before, cycle: None, recalled: None }
    }

    /// The mistake in a line.
    pub fn error(&self, text: &str) -> Option<FilterError> {
        Filter::parse(text, RowKind::of(self.page)).err()
    }

    /// What may stand at the cursor, and which of it Tab has chosen.
    pub fn completion(
        &self,
        line: &LineInput,
        source: &CompletionSource,
    ) -> (Completion, Option<usize>) {
        if let Some((completion, at)) = &self.cycle {
            return (completion.clone(), Some(*at));
        }
        (Completion::of(before_cursor(line), RowKind::of(self.page), source), None)
    }

    /// Ends the choice of candidates and of old lines.
    pub(super) fn end_choice(&mut self) {
        self.cycle = None;
        self.recalled = None;
    }

    /// Puts the first candidate, or the next one, into the line.
    pub(in crate::app) fn complete(&mut self, line: &mut LineInput, source: &CompletionSource) {
        let (completion, chosen) = self.completion(line, source);
        let Some(next) =
            chosen.map_or(Some(0), |at| (at + 1).checked_rem(completion.candidates.len()))
        else {
            return;
        };
        let Some(candidate) = completion.candidates.get(next) else { return };
        let (text, cursor) = (line.value(), before_cursor(line).len());
        let head = format!("{}{candidate}", &text[..completion.range.start]);
        let tail = &text[cursor..];
        let at = head.chars().count();
        *line = LineInput::new(format!("{head}{tail}")).with_cursor(at);
        let is_only = completion.candidates.len() == 1;
        self.cycle = (!is_only).then_some((completion, next));
    }

    /// Puts an older line into the prompt, or with 1 a newer one.
    pub(in crate::app) fn recall(&mut self, line: &mut LineInput, by: isize, history: &[String]) {
        let (at, typed) = self.recalled.take().unwrap_or((0, line.value().to_owned()));
        let at = at.saturating_add_signed(-by).min(history.len());
        let text = match at {
            0 => &typed,
            _ => &history[history.len() - at],
        };
        *line = LineInput::new(text.clone());
        self.cycle = None;
        self.recalled = Some((at, typed));
    }
}

/// The part of a line before its cursor.
fn before_cursor(line: &LineInput) -> &str {
    let text = line.value();
    let end = text.char_indices().nth(line.cursor()).map_or(text.len(), |(at, _)| at);
    &text[..end]
}

impl PromptLogic for FilterPrompt {
    fn label(&self) -> &'static str {
        "filter"
    }

    fn validate(&self, text: &str, context: PromptContext) -> C {
        let rows = RowKind::of(self.page);
        match Filter::parse(text, rows) {
            Err(error) => C::Rejected(format!("{error}, column {}", error.column(text))),
            Ok(filter) if filter.is_empty() => C::Accepted(rows.syntax().to_owned()),
            Ok(_) => {
                let noun = context.row_noun;
                C::Accepted(match context.matches {
                    Some((hits, all)) => format!("{hits} of {all} {noun} match"),
                    None => "counting …".to_owned(),
                })
            }
        }
    }

    fn commit(&self, text: &str, _context: PromptContext) -> PromptOutcome {
        PromptOutcome::SetFilter(self.page, text.to_owned())
    }
}
