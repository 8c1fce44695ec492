//! The newest frames on the Traffic page while they are followed: a sample that stands from one draw to
//! the next, since more frames are received than can be read, and the number of frames between two.
//!
//! Does not know how often is drawn.

use super::App;
use super::view::Page;

/// The sample that is shown while the newest frames are followed.
#[derive(Clone, Copy, Debug)]
pub(super) struct FollowedFrames {
    /// Number behind the last frame of the sample before; `None` for the first one.
    before: Option<u64>,
    /// Number behind the last frame.
    pub end: u64,
}

impl App {
    /// Takes the newest frames for the next draw, if they are followed.
    pub(super) fn renew_followed(&mut self) {
        let view = &mut self.view;
        let follows = view.page == Page::Traffic
            && view.traffic.is_none()
            && view.frozen.is_none()
            && view.evidence.is_none();
        if !follows {
            view.followed = None;
            return;
        }
        let end = self.traffic.capture.end();
        view.followed = match view.followed {
            Some(followed) if followed.end == end => Some(followed),
            followed => Some(FollowedFrames { before: followed.map(|it| it.end), end }),
        };
    }

    /// Number of frames that match the filter between those shown before and `first`, the first one
    /// shown now.
    pub fn left_out(&self, first: u64) -> u64 {
        let before = self.view.followed.and_then(|followed| followed.before);
        before.map_or(0, |before| self.traffic.count_between(&self.view, before..first))
    }
}
