//! What the frames of each bus show of its profile: see [`crate::learning`].
//!
//! Input: frames. Output: proposals of a bus that are not in force. It is about the present alone: the
//! past has no proposals.

use super::App;
use crate::frame::{BusIndex, Frame};
use crate::learning::{ProfileLearner, ProfileProposal};
use crate::wire::profile::{Profile, ValueOrigin};

/// The learners of all buses.
#[derive(Debug, Default)]
pub(super) struct ProfileLearners {
    is_on: bool,
    list: Vec<ProfileLearner>,
}

impl ProfileLearners {
    /// They take frames only if `is_on`.
    pub fn new(is_on: bool) -> Self {
        Self { is_on, list: Vec::new() }
    }

    pub fn handle_frame(&mut self, frame: &Frame) {
        if !self.is_on {
            return;
        }
        let at = usize::from(frame.bus.0);
        if self.list.len() <= at {
            self.list.resize_with(at + 1, ProfileLearner::default);
        }
        self.list[at].handle_frame(frame);
    }
}

impl App {
    /// What the frames of a bus showed of its profile; `None` without frames, or if nothing is learnt.
    pub fn profile_learner(&self, bus: BusIndex) -> Option<&ProfileLearner> {
        self.learners.list.get(usize::from(bus.0))
    }
}

/// Returns true if a proposal has another value than the profile, or one that is only assumed there.
pub fn adds_to(proposal: &ProfileProposal, profile: &Profile) -> bool {
    profile.value(proposal.key) != proposal.value
        || profile.origin(proposal.key) == ValueOrigin::Assumed
}
