//! A filter for frames that are not captured: of a recording, and of a log that is read.
//!
//! Inputs: a filter, what is known of the buses, frames in the order of their times. Output: whether a
//! frame matches. A filter that looks back at intervals or transfers keeps the last frames, 16 MB of
//! them. Does not know where frames come from, nor where they go.

use super::App;
use super::capture::{FrameStore, Identifiers};
use super::filter::{Filter, FrameMatcher};
use crate::frame::Frame;

/// Bytes of the frames that a filter may look back at.
const LOOK_BACK: usize = 16_000_000;

/// Selects frames one after another.
#[derive(Debug)]
pub struct FrameSelector {
    filter: Filter,
    /// Prepared for what was known.
    matcher: Option<FrameMatcher>,
    /// The last frames, where the filter needs them.
    recent: Option<RecentFrames>,
}

/// The last frames that were tested, with the places of the ones before with the same identifiers.
#[derive(Debug)]
pub(super) struct RecentFrames {
    frames: FrameStore,
    identifiers: Identifiers,
}

impl RecentFrames {
    /// Returns an empty store, if the filter looks back.
    pub fn for_filter(filter: &Filter) -> Option<Self> {
        filter
            .looks_back()
            .then(|| Self { frames: FrameStore::new(LOOK_BACK), identifiers: Identifiers::new() })
    }

    /// Stores the next frame; returns true if it matches.
    pub fn is_match(&mut self, matcher: &FrameMatcher, frame: &Frame) -> bool {
        let number = self.frames.end();
        let link = self.identifiers.add(frame, number);
        self.frames.push(frame, link);
        matcher.is_match(frame, Some((&self.frames, number)))
    }
}

impl FrameSelector {
    /// Returns the selector of a filter of frames. An empty filter selects all.
    pub fn new(filter: Filter) -> Self {
        Self { recent: RecentFrames::for_filter(&filter), filter, matcher: None }
    }

    /// Prepares the filter for what is known now. Call before the first frames, and when more may be
    /// known.
    pub fn renew(&mut self, app: &App) {
        if self.filter.is_empty() {
            return;
        }
        if self.matcher.as_ref().is_none_or(|matcher| !matcher.is_current(app.history())) {
            self.matcher = Some(app.log_matcher(&self.filter));
        }
    }

    /// Returns true if the next frame matches.
    pub fn is_match(&mut self, frame: &Frame) -> bool {
        let Some(matcher) = &self.matcher else { return true };
        match &mut self.recent {
            Some(recent) => recent.is_match(matcher, frame),
            None => matcher.is_match(frame, None),
        }
    }
}
