//! What the frames of each bus show of its profile (see [`crate::learning`]), the list in which the
//! user reviews it, and the line that says that the values in force are others.
//!
//! Input: frames. Output: a profile with the values that were taken over, and a file of it. It is about
//! the present alone. Does not know how the list is drawn.

use super::input::{Overlay, ProfilePathPrompt, PromptKind};
use super::{App, Effect};
use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, Frame};
use crate::learning::{Certainty, LEARNT_KEYS, ProfileLearner, ProfileProposal};
use crate::text::printable_path;
use crate::time::{Duration, Instant};
use crate::wire::profile::{Profile, ProfileKey, ProfileValue, ValueOrigin};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Time between two looks for values that differ from those in force: a look takes a millisecond.
const LOOK_INTERVAL: Duration = Duration::from_secs(3);
/// Path of the file, unless the user types another one.
const USUAL_PATH: &str = "learned.toml";

/// The learners of all buses.
#[derive(Debug, Default)]
pub(super) struct ProfileLearners {
    is_on: bool,
    /// The values in force.
    profile: Arc<Profile>,
    list: Vec<ProfileLearner>,
    looked_at: Option<Instant>,
    /// What differs; empty if nothing does.
    difference: String,
    /// The user does not want to know.
    is_dismissed: bool,
    review: ProfileReview,
    /// The profile that is being written: in force once it is.
    pending: Option<(PathBuf, Arc<Profile>)>,
}

impl ProfileLearners {
    /// They take frames only if `is_on`.
    pub fn new(is_on: bool) -> Self {
        Self { is_on, ..Self::default() }
    }

    /// Takes another profile in force.
    pub fn set_profile(&mut self, profile: Arc<Profile>) {
        self.list.iter_mut().for_each(|learner| learner.set_profile(&profile));
        self.profile = profile;
    }

    pub fn handle_frame(&mut self, frame: &Frame) {
        if !self.is_on {
            return;
        }
        let at = usize::from(frame.bus.0);
        if self.list.len() <= at {
            self.list.resize_with(at + 1, || {
                let mut learner = ProfileLearner::default();
                learner.set_profile(&self.profile);
                learner
            });
        }
        self.list[at].handle_frame(frame);
    }
}

/// The values of the profile, with those that the frames show.
#[derive(Clone, Debug, Default)]
pub struct ProfileReview {
    /// A row for each key, those that can be learnt first.
    pub rows: Vec<ProfileRow>,
    /// The place of the selected row.
    pub selected: usize,
    /// Number of frames that the values are from, and their time.
    pub frames: u64,
    /// See `frames`.
    pub duration: Duration,
}

/// A value of the profile.
#[derive(Clone, Debug)]
pub struct ProfileRow {
    /// Its key.
    pub key: ProfileKey,
    /// The value in force.
    pub now: ProfileValue,
    /// Where it comes from.
    pub origin: ValueOrigin,
    /// What the frames show, and the bus; `None` if it is not known.
    pub proposal: Option<(BusIndex, ProfileProposal)>,
    /// Why it is not known; empty for a value that cannot be learnt.
    pub reason: String,
    /// It is taken over.
    pub is_ticked: bool,
}

impl ProfileRow {
    /// Returns true if the frames show another value than the one in force.
    pub fn differs(&self) -> bool {
        self.proposal.as_ref().is_some_and(|(_, proposal)| proposal.value != self.now)
    }
}

impl App {
    /// What the frames of a bus showed of its profile; `None` without frames, or if nothing is learnt.
    pub fn profile_learner(&self, bus: BusIndex) -> Option<&ProfileLearner> {
        self.learners.list.get(usize::from(bus.0))
    }

    /// What the devices send otherwise than the profile in force says; `None` if nothing, or the user
    /// does not want to know.
    pub fn profile_difference(&self) -> Option<&str> {
        let text = &self.learners.difference;
        (!text.is_empty() && !self.learners.is_dismissed).then_some(text)
    }

    /// The list of the profile's values that is open.
    pub fn profile_review(&self) -> &ProfileReview {
        &self.learners.review
    }

    /// Looks for values that differ from those in force, now and then.
    pub(super) fn renew_profile_difference(&mut self) {
        let now = self.clock.now();
        let is_due = self.learners.looked_at.is_none_or(|at| now.since(at) >= LOOK_INTERVAL);
        if !self.learners.is_on || !is_due {
            return;
        }
        self.learners.looked_at = Some(now);
        let differs = |(bus, proposal): &(BusIndex, ProfileProposal)| {
            proposal.certainty > Certainty::Guess
                && self.profile(*bus).value(proposal.key) != proposal.value
        };
        let all: Vec<String> = self
            .all_proposals()
            .iter()
            .filter(|it| differs(it))
            .map(|(bus, proposal)| {
                let now = self.profile(*bus).value(proposal.key);
                format!("{} {}, not {now}", proposal.key.name(), proposal.value)
            })
            .collect();
        let text = all.join("; ");
        if text != self.learners.difference {
            self.learners.difference = text;
            self.renew_banner();
            self.notices.redraw.set_dirty();
        }
    }

    /// Proposals of all buses, by key.
    fn all_proposals(&self) -> Vec<(BusIndex, ProfileProposal)> {
        let buses = (0..=u8::MAX).map(BusIndex).zip(&self.learners.list);
        let all = buses.flat_map(|(bus, learner)| {
            learner.proposals().into_iter().map(move |proposal| (bus, proposal))
        });
        all.collect()
    }

    /// Opens the list of the profile's values.
    pub(super) fn review_profile(&mut self) {
        self.open_review();
        self.input.open(Overlay::Profile);
    }

    fn open_review(&mut self) {
        let proposals = self.all_proposals();
        let others = ProfileKey::ALL.iter().filter(|key| !LEARNT_KEYS.contains(key));
        let rows = LEARNT_KEYS.iter().chain(others).map(|key| self.profile_row(*key, &proposals));
        let learners = &self.learners.list;
        self.learners.review = ProfileReview {
            rows: rows.collect(),
            selected: 0,
            frames: learners.iter().map(ProfileLearner::frames).sum(),
            duration: learners.iter().map(ProfileLearner::duration).max().unwrap_or_default(),
        };
    }

    fn profile_row(
        &self,
        key: ProfileKey,
        proposals: &[(BusIndex, ProfileProposal)],
    ) -> ProfileRow {
        let profile = self.profile(BusIndex(0));
        let mut all = proposals.iter().filter(|(_, proposal)| proposal.key == key);
        let first = all.next();
        let is_disputed =
            first.is_some_and(|first| all.any(|other| other.1.value != first.1.value));
        let proposal = first.cloned().map(|(bus, mut proposal)| {
            if is_disputed {
                proposal.certainty = Certainty::Guess;
                proposal.evidence = format!("the buses differ; {}", proposal.evidence);
            }
            (bus, proposal)
        });
        let is_ticked = proposal.as_ref().is_some_and(|(_, proposal)| {
            proposal.certainty > Certainty::Guess && profile.origin(key) == ValueOrigin::Assumed
        });
        let learner = self.learners.list.first().filter(|_| LEARNT_KEYS.contains(&key));
        let reason = match (&proposal, learner) {
            (None, Some(learner)) => learner.why_unknown(key),
            _ => String::new(),
        };
        let (now, origin) = (profile.value(key), profile.origin(key));
        ProfileRow { key, now, origin, proposal, reason, is_ticked }
    }

    /// Selects another row of the list.
    pub(super) fn move_in_profile(&mut self, by: isize) {
        let review = &mut self.learners.review;
        let last = review.rows.len().saturating_sub(1);
        review.selected = review.selected.saturating_add_signed(by).min(last);
    }

    /// Ticks the selected value, or takes its tick away.
    pub(super) fn tick_profile_value(&mut self) {
        let review = &mut self.learners.review;
        let Some(row) = review.rows.get_mut(review.selected) else { return };
        if row.proposal.is_none() {
            let text = format!("{} is not known from frames", row.key.name());
            return self.show_error(text);
        }
        row.is_ticked = !row.is_ticked;
    }

    /// Shows the frames behind the selected value.
    pub(super) fn go_to_frames_of_profile(&mut self) {
        let review = &self.learners.review;
        let row = review.rows.get(review.selected);
        let Some((bus, proposal)) = row.and_then(|row| row.proposal.as_ref()) else {
            return self.show_error("no frames: the value is not known from frames");
        };
        let frame = proposal.frames.first().and_then(Frame::platform_id);
        let Some(id) = frame else { return };
        let service = crate::wire::id::Header::decode(id).service;
        let (bus, term) = (*bus, format!("srv:0x{:03X}", service.number()));
        self.input.close();
        self.show_page(super::Page::Traffic);
        self.show_frames_with(bus, &term);
    }

    /// Closes the list, and does not show the line again.
    pub(super) fn dismiss_profile(&mut self) {
        self.learners.is_dismissed = true;
        self.renew_banner();
        self.input.close();
        let key = self.key_of(crate::keymap::Action::ReviewProfile);
        self.show_info(format!("not shown again until descan ends; {key} opens the list"));
    }

    /// The profile with the ticked values; `None` if none is ticked.
    fn ticked_profile(&self) -> Option<(Profile, usize)> {
        let mut profile = (*self.profile(BusIndex(0))).clone();
        let ticked = self.learners.review.rows.iter().filter(|row| row.is_ticked);
        let values = ticked.filter_map(|row| row.proposal.as_ref());
        let count = values.filter(|(_, it)| profile.learn(it.key, &it.value)).count();
        (count > 0).then_some((profile, count))
    }

    /// Asks for the path of a file with the ticked values.
    pub(super) fn ask_profile_path(&mut self) {
        let Some((_, count)) = self.ticked_profile() else {
            let key = self.key_of(crate::keymap::Action::ProfileTick);
            return self.show_error(format!("no value is chosen; {key} chooses one"));
        };
        let prompt = ProfilePathPrompt { values: count, is_of_log: self.is_of_logs() };
        self.open_prompt(PromptKind::ProfilePath(prompt), USUAL_PATH.to_owned());
    }

    /// Takes the ticked values over, and writes them to a new file; without a path they are in force
    /// until descan ends.
    pub(super) fn use_learnt_profile(&mut self, path: Option<PathBuf>) {
        let Some((profile, _)) = self.ticked_profile() else { return };
        let profile = Arc::new(profile);
        let Some(path) = path else { return self.take_learnt_profile(&profile) };
        let rows = &self.learners.review.rows;
        let comment = |key| {
            let row = rows.iter().find(|row| row.key == key && row.is_ticked)?;
            let (_, proposal) = row.proposal.as_ref()?;
            Some(format!("learnt, {}: {}", proposal.certainty.word(), proposal.evidence))
        };
        let bytes = profile.to_file(comment).into_bytes();
        self.learners.pending = Some((path.clone(), profile));
        self.effects.push_back(Effect::WriteFile { path, bytes });
    }

    /// Takes the result of writing the file. Returns false if `path` is another file.
    pub(super) fn handle_written_profile(
        &mut self,
        path: &Path,
        result: &Result<(), Diagnostic>,
    ) -> bool {
        let Some((_, profile)) = self.learners.pending.take_if(|(of, _)| of == path) else {
            return false;
        };
        match result {
            Ok(()) if self.is_of_logs() && !self.logs.is_empty() => {
                self.reopen_logs(Some(path.to_owned()));
            }
            Ok(()) => {
                let path = printable_path(path);
                if self.is_of_logs() {
                    // Frames from a pipe cannot be read again.
                    self.show_info(format!("saved; read the frames again: --profile {path}"));
                } else {
                    self.take_learnt_profile(&profile);
                    self.show_info(format!("in force, and saved; next time: --profile {path}"));
                }
            }
            Err(why) => {
                let cause = format!("not saved: {why}");
                if !self.reopen_prompt(path, &cause) {
                    self.show_error(cause);
                }
            }
        }
        true
    }

    fn take_learnt_profile(&mut self, profile: &Arc<Profile>) {
        self.profile_changed("learnt", profile);
        self.learners.looked_at = None;
        self.renew_profile_difference();
    }
}
