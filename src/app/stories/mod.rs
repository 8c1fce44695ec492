//! Stories: the events of the timeline, grouped to what has begun and may go on: a device joining,
//! a reboot, an absence, a conflict.
//!
//! Inputs: each event as a timeline entry with what it changed, in the order of their times.
//! Output: the stories with their steps, oldest first, as of any moment. Bounded: 2,048 stories
//! and 8,192 steps; of more the oldest story that is over is dropped. Does not know how stories are
//! drawn, or which of them are shown.

mod change;
mod kind;
mod story;
mod summary;

pub use change::StoryChange;
pub use kind::{HiddenKinds, StoryKind};
pub use story::{Story, StoryStep};
pub use summary::{StoryLine, StorySign};

use super::notices::TimelineEntry;
use super::problems::ProblemKey;
use super::timeline_kind::TimelineKind;
use crate::discovery::{DeviceId, Presence};
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::Mode;
use std::collections::{HashMap, VecDeque};
use story::StoryKey;

/// Largest distance of a repetition of the same text.
const REPEAT_WITHIN: Duration = Duration::from_secs(5);

/// All stories, by the time of their first step.
#[derive(Debug, Default)]
pub struct Stories {
    stories: VecDeque<Story>,
    next: u64,
    /// Number of the steps of all stories.
    steps: usize,
    /// The last story of each key.
    latest: HashMap<StoryKey, u64>,
}

/// The story that an event belongs to.
enum Route {
    Attach(u64),
    New(StoryKey),
    /// None: an event that is part of another one.
    Skip,
}

impl Stories {
    /// Largest number of stories.
    pub const MAX_STORIES: usize = 2048;
    /// Largest number of the steps of all stories.
    pub const MAX_STEPS: usize = 8192;

    /// The stories, by the time of their first step.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Story> + ExactSizeIterator {
        self.stories.iter()
    }

    /// The story with this number; `None` if it was dropped.
    pub fn get(&self, id: u64) -> Option<&Story> {
        // Most are looked up soon after they began.
        self.stories.iter().rev().find(|story| story.id == id)
    }

    /// Takes an event.
    pub(super) fn push(&mut self, entry: TimelineEntry, change: StoryChange) {
        let steps = match change {
            StoryChange::Moved(..) => self.take_appearance(&entry),
            _ => Vec::new(),
        };
        self.add(entry, change);
        for step in steps {
            self.add(step.entry, step.change);
        }
    }

    /// Removes the story that began with the first frame at another address, if that turns out to be
    /// of a device that moved; returns its further steps.
    fn take_appearance(&mut self, moved: &TimelineEntry) -> Vec<StoryStep> {
        let is_it = |story: &Story| {
            let first = &story.steps()[0];
            first.change == StoryChange::Appeared
                && (first.entry.bus, first.entry.address) == (moved.bus, moved.address)
        };
        let now = self.stories.iter().rev().take_while(|story| story.begin() == moved.time);
        let Some(id) = now.into_iter().find(|story| is_it(story)).map(|story| story.id) else {
            return Vec::new();
        };
        let at = self.stories.iter().rposition(|story| story.id == id);
        let Some(story) = at.and_then(|at| self.stories.remove(at)) else { return Vec::new() };
        self.steps -= story.step_count();
        self.latest.retain(|_, latest| *latest != id);
        story.into_steps().skip(1).collect()
    }

    fn add(&mut self, entry: TimelineEntry, change: StoryChange) {
        match self.route(&entry, &change) {
            Route::Skip => {}
            Route::New(key) => self.begin(key, entry, change),
            Route::Attach(id) => {
                if let (StoryChange::GaveUp { .. }, Some(device)) = (&change, entry.device) {
                    // Where it goes is part of the same story.
                    self.latest.insert(StoryKey::Device(device), id);
                }
                self.append(id, entry, change);
            }
        }
    }

    fn append(&mut self, id: u64, entry: TimelineEntry, change: StoryChange) {
        if let Some(story) = self.stories.iter_mut().rev().find(|story| story.id == id) {
            let before = story.step_count();
            let now = entry.time;
            story.push(entry, change);
            self.steps += story.step_count() - before;
            self.drop_surplus(now);
        }
    }

    fn begin(&mut self, key: StoryKey, entry: TimelineEntry, change: StoryChange) {
        let (id, now) = (self.next, entry.time);
        self.next += 1;
        if let (StoryChange::GaveUp { .. }, Some(device)) = (&change, entry.device) {
            self.latest.insert(StoryKey::Device(device), id);
        }
        self.latest.insert(key.clone(), id);
        // A mark may be earlier than other stories.
        let at = self.stories.partition_point(|story| story.begin() <= now);
        self.stories.insert(at, Story::new(id, key, entry, change));
        self.steps += 1;
        self.drop_surplus(now);
    }

    /// Drops the oldest stories that are over while there are too many.
    fn drop_surplus(&mut self, now: Instant) {
        while self.stories.len() > Self::MAX_STORIES || self.steps > Self::MAX_STEPS {
            let over = self.stories.iter().position(|story| !story.is_open(now));
            let Some(dropped) = self.stories.remove(over.unwrap_or(0)) else { return };
            self.steps -= dropped.step_count();
            self.latest.retain(|_, id| *id != dropped.id);
        }
    }

    fn latest(&self, key: &StoryKey) -> Option<&Story> {
        self.get(*self.latest.get(key)?)
    }

    /// The last story of a key, if it goes on or was over not long ago.
    fn live(&self, key: &StoryKey, at: Instant) -> Option<&Story> {
        self.latest(key).filter(|story| story.is_recent(at) || story.is_open(at))
    }

    fn attach_or(&self, story: Option<&Story>, key: StoryKey) -> Route {
        story.map_or(Route::New(key), |story| Route::Attach(story.id))
    }

    fn route(&self, entry: &TimelineEntry, change: &StoryChange) -> Route {
        let at = entry.time;
        let key = match (change, entry.bus, entry.device) {
            (StoryChange::Finding { key, .. }, ..) => StoryKey::Problem(ProblemKey::of(key)),
            (StoryChange::OwnAddress(_) | StoryChange::NoOwnAddress, Some(bus), _) => {
                StoryKey::Own(bus)
            }
            (StoryChange::NoAck | StoryChange::Acknowledged, Some(bus), _) => StoryKey::Ack(bus),
            (StoryChange::Text | StoryChange::Debug, ..) | (_, _, None) => {
                let key = StoryKey::Text(entry.bus, entry.device, entry.text.clone());
                let is_mark = matches!(entry.kind, TimelineKind::Mark(_));
                let is_repeated =
                    |story: &&Story| !is_mark && at.since(story.last()) <= REPEAT_WITHIN;
                return self.attach_or(self.latest(&key).filter(is_repeated), key);
            }
            (_, _, Some(device)) => return self.route_device(entry, change, device),
        };
        self.attach_or(self.live(&key, at), key)
    }

    fn route_device(&self, entry: &TimelineEntry, change: &StoryChange, id: DeviceId) -> Route {
        let at = entry.time;
        let device = StoryKey::Device(id);
        let life = self.live(&device, at);
        // A device without a row shares its number with none, but the address is known.
        let address = entry.address.map(|it| StoryKey::Problem(ProblemKey::Address(id.bus, it)));
        let at_address = address.as_ref().and_then(|key| self.live(key, at));
        match change {
            StoryChange::Appeared => Route::New(device),
            StoryChange::Claimed { holder: Some(_), .. } | StoryChange::GaveUp { .. } => {
                self.attach_or(at_address, address.unwrap_or(device))
            }
            StoryChange::OtherServices | StoryChange::Uid(..) => {
                self.attach_or(at_address.or(life), device)
            }
            StoryChange::Moved(from, _) => {
                self.attach_or(self.conflict_left_by(id, *from, at).or(life), device)
            }
            StoryChange::Presence(presence) => self.route_presence(*presence, id, at),
            StoryChange::Returned => {
                let modes = self.latest(&StoryKey::Mode(id)).filter(|story| story.is_open(at));
                let asleep = modes.filter(|story| story.is_asleep(at));
                self.attach_or(asleep.or(life), device)
            }
            StoryChange::Mode(from, to) => self.route_mode(*from, *to, id, at),
            _ => self.attach_or(life, device),
        }
    }

    /// The story of the conflict at an address that a device took part in.
    fn conflict_left_by(&self, id: DeviceId, from: Address, at: Instant) -> Option<&Story> {
        let story = self.live(&StoryKey::Problem(ProblemKey::Address(id.bus, from)), at);
        story.filter(|it| it.steps().iter().any(|step| step.entry.device == Some(id)))
    }

    fn route_presence(&self, presence: Presence, id: DeviceId, at: Instant) -> Route {
        let modes = self.latest(&StoryKey::Mode(id)).filter(|story| story.is_open(at));
        if let Some(modes) = modes.filter(|_| presence == Presence::Asleep) {
            return Route::Attach(modes.id);
        }
        let key = StoryKey::Device(id);
        // A device that joined or rebooted and is lost then begins another story.
        let own = self.live(&key, at).filter(|story| story.key == key);
        let absent = own.filter(|story| {
            story.is_absent(at) || story.kind(at) == StoryKind::Presence
        });
        self.attach_or(absent, key)
    }

    fn route_mode(&self, from: Option<Mode>, to: Mode, id: DeviceId, at: Instant) -> Route {
        let modes = self.latest(&StoryKey::Mode(id)).filter(|story| story.is_open(at));
        let life = self.live(&StoryKey::Device(id), at);
        let is_start =
            |mode: Mode| matches!(mode, Mode::Init | Mode::Arslv | Mode::Boot);
        match (modes, life, from) {
            (Some(modes), ..) => Route::Attach(modes.id),
            (None, Some(life), None) => Route::Attach(life.id),
            (None, None, None) => Route::Skip,
            (None, Some(life), Some(from)) if is_start(from) || is_start(to) => {
                Route::Attach(life.id)
            }
            // The claim is the event.
            (None, None, _) if to == Mode::Arslv => Route::Skip,
            (None, _, Some(_)) => Route::New(StoryKey::Mode(id)),
        }
    }

    /// Ends the modes of a device that is lost.
    pub(super) fn end_modes(&mut self, entry: &TimelineEntry, id: DeviceId) {
        let modes = self.latest(&StoryKey::Mode(id)).filter(|story| story.is_open(entry.time));
        if let Some(modes) = modes.map(|story| story.id) {
            self.append(modes, entry.clone(), StoryChange::Presence(Presence::Lost));
        }
    }

    /// Removes the story of the mark with this letter.
    pub(super) fn remove_mark(&mut self, letter: char) {
        let is_it = |story: &Story| story.steps()[0].entry.kind == TimelineKind::Mark(letter);
        self.stories.retain(|story| !is_it(story));
        self.steps = self.stories.iter().map(Story::step_count).sum();
        let ids: Vec<u64> = self.stories.iter().map(|story| story.id).collect();
        self.latest.retain(|_, id| ids.contains(id));
    }

    /// Assigns the events of `was`, those before `before` if given, to `device`.
    pub(super) fn reassign(&mut self, was: DeviceId, before: Option<Instant>, device: DeviceId) {
        for story in &mut self.stories {
            story.reassign(was, before, device);
        }
        if before.is_some() {
            return;
        }
        for key in [StoryKey::Device, StoryKey::Mode] {
            if let Some(id) = self.latest.remove(&key(was)) {
                self.latest.entry(key(device)).or_insert(id);
            }
        }
        let (was_keys, keys) =
            ([StoryKey::Device(was), StoryKey::Mode(was)], [StoryKey::Device(device), StoryKey::Mode(device)]);
        for story in &mut self.stories {
            if let Some(at) = was_keys.iter().position(|key| *key == story.key) {
                story.key = keys[at].clone();
            }
        }
    }
}
