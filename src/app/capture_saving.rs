//! Commands that save the captured frames: all, or those that the filter of Traffic shows.
//!
//! Does not know how a log is written.

use super::capture::WrittenFrames;
use super::filter::Filter;
use super::input::{CapturePathPrompt, PromptKind, SavedFrames};
use super::view::Page;
use super::{App, Effect};
use crate::diagnostic::Diagnostic;
use crate::log::LogFormat;
use crate::time::Instant;
use std::path::{Path, PathBuf};

impl App {
    /// Asks for the path of a log of the captured frames.
    pub(super) fn ask_capture_path(&mut self) {
        if self.traffic.capture.end() == 0 {
            return self.show_error("no frames captured yet");
        }
        let path = format!("descan-{}.log", self.clock.stamp());
        self.open_prompt(PromptKind::CapturePath(CapturePathPrompt), path);
    }

    /// Saves the captured frames; those that match, while the filter of Traffic hides others.
    pub(super) fn save_capture(&mut self, path: PathBuf) {
        match LogFormat::of(&path) {
            Ok(format) => {
                let (buses, filter) = (self.shown_buses(), self.saved_frames_filter());
                let log = self.traffic.log(buses, self.clock.epoch(), format, filter);
                self.effects.push_back(Effect::WriteLog { path, log });
            }
            Err(error) => self.show_error(format!("not saved: {error}")),
        }
    }

    /// The filter that selects the frames to be saved; `None` for all, as around evidence.
    pub(super) fn saved_frames_filter(&self) -> Option<&Filter> {
        let filter = self.filters.of(Page::Traffic).active();
        filter.filter(|_| self.view.evidence.is_none())
    }

    /// Which captured frames would be saved.
    pub(super) fn saved_frames(&self) -> SavedFrames {
        if self.saved_frames_filter().is_none() {
            return SavedFrames::All;
        }
        let ranges = self.traffic.capture.ranges();
        let all: u64 = ranges.map(|range| range.end - range.start).sum();
        match self.hidden_frames() {
            Some(hidden) => SavedFrames::Counted(all.saturating_sub(hidden)),
            None => SavedFrames::Matching,
        }
    }

    /// Opens the prompt of a path again that was not written, with the cause; returns false if it cannot
    /// be opened.
    pub(super) fn reopen_prompt(&mut self, path: &Path, cause: &str) -> bool {
        self.notices.redraw.set_dirty();
        self.input.reopen_prompt(path, cause)
    }

    /// Takes the result of an [`Effect::WriteLog`]; `Err` with the cause.
    pub fn handle_written_log(
        &mut self,
        now: Instant,
        path: &Path,
        result: Result<WrittenFrames, Diagnostic>,
    ) {
        match result {
            Ok(WrittenFrames { written, captured, is_selection: true }) => {
                self.clock.set(now);
                let path = crate::text::printable_path(path);
                self.show_info(format!("saved {written} of {captured} frames (filter): {path}"));
                self.notices.redraw.set_dirty();
            }
            result => self.handle_written(now, path, result.map(|_| ())),
        }
    }
}
