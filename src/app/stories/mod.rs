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
use crate::frame::BusIndex;
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
    all: VecDeque<Story>,
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
        self.all.iter()
    }

    /// The story with this number; `None` if it was dropped.
    pub fn get(&self, id: u64) -> Option<&Story> {
        // Most are looked up soon after they began.
        self.all.iter().rev().find(|story| story.id == id)
    }

    /// Returns true if a story goes on.
    pub(super) fn has_open(&self, at: Instant) -> bool {
        self.all.iter().rev().any(|story| story.is_open(at))
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
        let now = self.all.iter().rev().take_while(|story| story.begin() == moved.time);
        let Some(id) = now.into_iter().find(|story| is_it(story)).map(|story| story.id) else {
            return Vec::new();
        };
        let at = self.all.iter().rposition(|story| story.id == id);
        let Some(story) = at.and_then(|at| self.all.remove(at)) else { return Vec::new() };
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
        if let Some(story) = self.all.iter_mut().rev().find(|story| story.id == id) {
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
        let at = self.all.partition_point(|story| story.begin() <= now);
        self.all.insert(at, Story::new(id, key, entry, change));
        self.steps += 1;
        self.drop_surplus(now);
    }

    /// Drops the oldest stories that are over while there are too many.
    fn drop_surplus(&mut self, now: Instant) {
        while self.all.len() > Self::MAX_STORIES || self.steps > Self::MAX_STEPS {
            let over = self.all.iter().position(|story| !story.is_open(now));
            let Some(dropped) = self.all.remove(over.unwrap_or(0)) else { return };
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

    fn route(&self, entry: &TimelineEntry, change: &StoryChange) -> Route {
        let at = entry.time;
        let key = match (change, entry.bus, entry.device) {
            (StoryChange::Finding { key, .. }, ..) => StoryKey::Problem(ProblemKey::of(key)),
            (StoryChange::OwnAddress(_) | StoryChange::NoOwnAddress, Some(bus), _) => {
                StoryKey::Own(bus)
            }
            (StoryChange::NoAck | StoryChange::Acknowledged, Some(bus), _) => StoryKey::Ack(bus),
            (StoryChange::Debug(code), bus, device) => {
                let key = StoryKey::Debug(bus, device, *code);
                let is_repeated = |story: &&Story| at.since(story.last()) <= REPEAT_WITHIN;
                return attach_or(self.latest(&key).filter(is_repeated), key);
            }
            (StoryChange::Text, ..) | (_, _, None) => {
                let key = StoryKey::Text(entry.bus, entry.device, entry.file, entry.text.clone());
                let is_mark = matches!(entry.kind, TimelineKind::Mark(_));
                let is_repeated =
                    |story: &&Story| !is_mark && at.since(story.last()) <= REPEAT_WITHIN;
                return attach_or(self.latest(&key).filter(is_repeated), key);
            }
            (_, _, Some(device)) => return self.route_device(entry, change, device),
        };
        attach_or(self.live(&key, at), key)
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
                attach_or(at_address, address.unwrap_or(device))
            }
            StoryChange::OtherServices | StoryChange::Uid(..) => {
                attach_or(at_address.or(life), device)
            }
            StoryChange::Moved(from, _) => {
                attach_or(self.conflict_left_by(id, *from, at).or(life), device)
            }
            StoryChange::Presence(presence) => self.route_presence(*presence, id, at),
            StoryChange::Returned => {
                let modes = self.latest(&StoryKey::Mode(id)).filter(|story| story.is_open(at));
                let asleep = modes.filter(|story| story.is_absent(at));
                attach_or(asleep.or(life), device)
            }
            StoryChange::Mode(from, to) => self.route_mode(*from, *to, id, at),
            _ => attach_or(life, device),
        }
    }

    /// The story of the conflict at an address that a device took part in.
    fn conflict_left_by(&self, id: DeviceId, from: Address, at: Instant) -> Option<&Story> {
        let story = self.live(&StoryKey::Problem(ProblemKey::Address(id.bus, from)), at);
        story.filter(|it| it.steps().iter().any(|step| step.entry.device == Some(id)))
    }

    fn route_presence(&self, presence: Presence, id: DeviceId, at: Instant) -> Route {
        let modes = self.latest(&StoryKey::Mode(id)).filter(|story| story.is_open(at));
        // In IDLE heartbeats end: that is part of the mode.
        let is_idle = |story: &&Story| story.last_mode(at) == Some(Mode::Idle);
        if let Some(modes) = modes.filter(is_idle).filter(|_| presence < Presence::Lost) {
            return Route::Attach(modes.id);
        }
        let key = StoryKey::Device(id);
        // A device that joined or rebooted and is lost then begins another story.
        let own = self.live(&key, at).filter(|story| story.key == key);
        let absent =
            own.filter(|story| story.is_absent(at) || story.kind(at) == StoryKind::Presence);
        attach_or(absent, key)
    }

    fn route_mode(&self, from: Option<Mode>, to: Mode, id: DeviceId, at: Instant) -> Route {
        let modes = self.latest(&StoryKey::Mode(id)).filter(|story| story.is_open(at));
        let life = self.live(&StoryKey::Device(id), at);
        let is_start = |mode: Mode| matches!(mode, Mode::Init | Mode::Arslv | Mode::Boot);
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

    /// Adds to the stories of a device that go on what its row shows: presence and mode.
    pub(super) fn correct(
        &mut self,
        entry: &TimelineEntry,
        presence: Presence,
        mode: Option<Mode>,
    ) {
        let (Some(device), at) = (entry.device, entry.time) else { return };
        for key in [StoryKey::Device(device), StoryKey::Mode(device)] {
            let Some(story) = self.latest(&key).filter(|story| story.is_open(at)) else { continue };
            let (id, is_absent, before) = (story.id, story.is_absent(at), story.last_mode(at));
            if is_absent && presence == Presence::Online {
                let entry = TimelineEntry { text: "returned".to_owned(), ..entry.clone() };
                self.append(id, entry, StoryChange::Returned);
            }
            if let (StoryKey::Mode(_), Some(mode)) = (key, mode.filter(|it| before != Some(*it))) {
                let entry = TimelineEntry { text: format!("mode {mode}"), ..entry.clone() };
                self.append(id, entry, StoryChange::Mode(before, mode));
            }
        }
    }

    /// Ends the modes of a device that is lost.
    pub(super) fn end_modes(&mut self, entry: &TimelineEntry, id: DeviceId) {
        let modes = self.latest(&StoryKey::Mode(id)).filter(|story| story.is_open(entry.time));
        if let Some(modes) = modes.map(|story| story.id) {
            self.append(modes, entry.clone(), StoryChange::Presence(Presence::Lost));
        }
    }

    /// Ends the stories of a bus on which another log begins: no event belongs to them any more.
    pub(super) fn end_all(&mut self, bus: BusIndex, entry: &TimelineEntry) {
        let is_of_bus = |story: &Story| story.steps()[0].entry.bus == Some(bus);
        let open = self.all.iter().filter(|story| is_of_bus(story) && story.is_open(entry.time));
        let open: Vec<u64> = open.map(|story| story.id).collect();
        for id in open {
            self.append(id, entry.clone(), StoryChange::AnotherLog);
        }
        let all = &self.all;
        self.latest.retain(|_, id| {
            all.iter().rev().find(|story| story.id == *id).is_some_and(|story| !is_of_bus(story))
        });
    }

    /// Removes the story of the mark with this letter.
    pub(super) fn remove_mark(&mut self, letter: char) {
        let is_it = |story: &Story| story.steps()[0].entry.kind == TimelineKind::Mark(letter);
        self.all.retain(|story| !is_it(story));
        self.steps = self.all.iter().map(Story::step_count).sum();
        let ids: Vec<u64> = self.all.iter().map(|story| story.id).collect();
        self.latest.retain(|_, id| ids.contains(id));
    }

    /// Assigns the events of `was`, those before `before` if given, to `device`.
    pub(super) fn reassign(&mut self, was: DeviceId, before: Option<Instant>, device: DeviceId) {
        for story in &mut self.all {
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
        let (was_keys, keys) = (
            [StoryKey::Device(was), StoryKey::Mode(was)],
            [StoryKey::Device(device), StoryKey::Mode(device)],
        );
        for story in &mut self.all {
            if let Some(at) = was_keys.iter().position(|key| *key == story.key) {
                story.key = keys[at].clone();
            }
        }
    }
}

fn attach_or(story: Option<&Story>, key: StoryKey) -> Route {
    story.map_or(Route::New(key), |story| Route::Attach(story.id))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discovery::Presence;
    use crate::finding::{FindingKey, FindingKind, FindingState};
    use crate::frame::BusIndex;
    use crate::text::Name;

    const BUS: BusIndex = BusIndex(0);

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    fn entry(millis: u64, device: u32, address: u8, text: &str) -> TimelineEntry {
        let mut entry = TimelineEntry::new(at(millis), TimelineKind::Change, text).on(BUS);
        entry.device = Some(DeviceId { bus: BUS, number: device });
        entry.address = Some(Address::from_bits(address));
        entry.name = Some(Name::new(b"FEED"));
        entry
    }

    fn finding(state: FindingState, address: u8) -> StoryChange {
        let kind = FindingKind::OneAddressTwoIdentities;
        StoryChange::Finding {
            key: FindingKey::at(kind, BUS, Some(Address::from_bits(address))),
            state,
            parties: vec!["SPARE01".to_owned(), "BOILER03".to_owned()],
            text: "Two devices share an address.".to_owned(),
            since: None,
            until: Instant::LATEST,
        }
    }

    fn lines(stories: &Stories, until: u64) -> Vec<StoryLine> {
        let clock = |time: Instant| time.to_string();
        stories.iter().filter_map(|story| story.line(at(until), clock)).collect()
    }

    fn words(stories: &Stories, until: u64) -> Vec<String> {
        let open = |line: &StoryLine| if line.to.is_none() { " …" } else { "" };
        lines(stories, until).iter().map(|line| format!("{}{}", line.what, open(line))).collect()
    }

    #[test]
    fn absence_is_one_story_with_what_changed() {
        let mut stories = Stories::default();
        let mut push = |millis, change| stories.push(entry(millis, 1, 10, "text"), change);
        push(0, StoryChange::Presence(Presence::Stale));
        push(2_500, StoryChange::Presence(Presence::Lost));
        push(30_000, StoryChange::Returned);
        push(30_000, StoryChange::Rebooted);
        push(31_000, StoryChange::Versions("AUGER 2.1→2.2".to_owned()));
        assert_eq!(words(&stories, 1_000), ["stale: heartbeat overdue …"]);
        assert_eq!(words(&stories, 29_000), ["lost …"]);
        assert_eq!(words(&stories, 40_000), ["lost, rebooted: AUGER 2.1→2.2"]);
        let line = &lines(&stories, 40_000)[0];
        assert_eq!((line.kind, line.from, line.to), (StoryKind::Reboot, at(0), Some(at(31_000))));
    }

    #[test]
    fn modes_are_one_story_until_the_device_works_again() {
        let mut stories = Stories::default();
        let mut push = |millis, change| stories.push(entry(millis, 1, 16, "text"), change);
        push(0, StoryChange::Mode(Some(Mode::Work), Mode::Idle));
        push(5_000, StoryChange::Presence(Presence::Asleep));
        push(12_000, StoryChange::Returned);
        push(12_000, StoryChange::Mode(Some(Mode::Idle), Mode::Work));
        push(90_000, StoryChange::Mode(Some(Mode::Work), Mode::Cfg));
        assert_eq!(words(&stories, 6_000), ["asleep (IDLE), WORK → IDLE …"]);
        let all = ["was asleep, WORK → IDLE → WORK", "WORK → CFG …"];
        assert_eq!(words(&stories, 100_000), all);
        // What mode a lost device is in is not known.
        let lost = entry(120_000, 1, 16, "lost");
        stories.end_modes(&lost, lost.device.unwrap());
        stories.push(lost, StoryChange::Presence(Presence::Lost));
        let expected = ["was asleep, WORK → IDLE → WORK", "WORK → CFG, then lost", "lost …"];
        assert_eq!(words(&stories, 130_000), expected);
    }

    #[test]
    fn conflict_that_comes_and_goes_is_one_bounded_story() {
        let mut stories = Stories::default();
        let claim = StoryChange::Claimed { by: Some("SPARE01".to_owned()), holder: None };
        stories.push(entry(0, 2, 14, "claims"), claim);
        for round in 0..1_000 {
            let begin = 1_000 + round * 9_000;
            stories.push(entry(begin, 1, 14, "?"), finding(FindingState::Suspected, 14));
            stories.push(entry(begin + 1_000, 1, 14, "!"), finding(FindingState::Confirmed, 14));
            stories.push(entry(begin + 2_000, 1, 14, "x"), finding(FindingState::Cleared, 14));
        }
        assert_eq!(stories.iter().len(), 2, "the claim without a holder, and the conflict");
        let story = stories.iter().last().unwrap();
        assert_eq!(story.steps().len(), Story::MAX_STEPS);
        let told = words(&stories, 10_000_000).pop().unwrap();
        assert!(told.starts_with("conflict SPARE01 / BOILER03, confirmed "), "{told}");
        assert!(told.ends_with("over, 1000 times"), "{told}");
        // It is over for longer, so the next one is another story.
        stories.push(entry(20_000_000, 1, 14, "?"), finding(FindingState::Suspected, 14));
        assert_eq!(stories.iter().len(), 3);
        let suspected = "conflict SPARE01 / BOILER03, suspected …";
        assert_eq!(words(&stories, 20_000_001).last().unwrap(), suspected);
    }

    #[test]
    fn first_frame_at_a_new_address_is_part_of_the_move() {
        let mut stories = Stories::default();
        let gave_up = StoryChange::GaveUp { by: None, to: Some("DIN".to_owned()) };
        stories.push(entry(0, 1, 16, "?"), finding(FindingState::Suspected, 16));
        stories.push(entry(1_000, 1, 16, "gave up"), gave_up);
        stories.push(entry(1_100, 2, 9, "appeared"), StoryChange::Appeared);
        let id = |number| DeviceId { bus: BUS, number };
        stories.reassign(id(2), None, id(1));
        let (from, to) = (Address::from_bits(16), Address::from_bits(9));
        stories.push(entry(1_100, 1, 9, "moved"), StoryChange::Moved(from, to));
        let told = words(&stories, 2_000);
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].starts_with("FEED gave up 16 to DIN, moved 16→9, "), "{told:?}");
    }

    #[test]
    fn repeated_text_is_counted_as_of_each_moment() {
        let mut stories = Stories::default();
        for second in 0..100 {
            let line = TimelineEntry::new(at(second * 1000), TimelineKind::File, "saved");
            stories.push(line, StoryChange::Text);
        }
        assert_eq!(words(&stories, 500), ["saved"], "the first one was there before the others");
        assert_eq!(words(&stories, 3_500), ["saved ×4"]);
        assert_eq!(words(&stories, 200_000), ["saved ×100"]);
    }

    /// Random events of devices that flap, move and fight: many ids, few addresses.
    fn random_event(rng: &mut fastrand::Rng, millis: u64) -> (TimelineEntry, StoryChange) {
        let (device, address) = (rng.u32(0..300), rng.u8(0..40));
        let modes = [Mode::Work, Mode::Cfg, Mode::Idle, Mode::Arslv, Mode::Init, Mode::Ufunc];
        let mode = |rng: &mut fastrand::Rng| modes[rng.usize(0..modes.len())];
        let states = [FindingState::Suspected, FindingState::Confirmed, FindingState::Cleared];
        let presences = [Presence::Stale, Presence::Lost, Presence::Asleep, Presence::Silent];
        let change = match rng.u8(0..14) {
            0 => StoryChange::Appeared,
            1 => StoryChange::Named,
            2 => StoryChange::Services(3),
            3 => StoryChange::Versions("AUGER 2.1→2.2".to_owned()),
            4 => StoryChange::Mode(Some(mode(rng)), mode(rng)),
            5 => StoryChange::Claimed { by: None, holder: rng.bool().then(|| "ACT".to_owned()) },
            6 => StoryChange::GaveUp { by: None, to: None },
            7 => StoryChange::Moved(Address::from_bits(address), Address::from_bits(99)),
            8 => StoryChange::Rebooted,
            9 => StoryChange::Presence(presences[rng.usize(0..presences.len())]),
            10 => StoryChange::Returned,
            11 => finding(states[rng.usize(0..states.len())], address),
            12 => StoryChange::Debug(rng.u16(0..3)),
            _ => StoryChange::Text,
        };
        (entry(millis, device, address, &format!("text {}", rng.u8(0..5))), change)
    }

    #[test]
    fn past_lines_are_those_of_a_run_until_then() {
        for seed in 0..20 {
            let mut rng = fastrand::Rng::with_seed(seed);
            let (mut whole, mut millis) = (Stories::default(), 0);
            let mut then = Vec::new();
            for _ in 0..400 {
                // Few devices, so that stories have many steps.
                let (mut entry, change) = random_event(&mut rng, millis);
                let number = rng.u32(0..4);
                entry.device = Some(DeviceId { bus: BUS, number });
                whole.push(entry, change);
                then.push((millis, lines(&whole, millis)));
                millis += rng.u64(1..4_000);
            }
            let is_whole = |story: &Story| story.steps().len() < Story::MAX_STEPS;
            let is_complete = whole.iter().all(is_whole);
            for (millis, expected) in then.iter().filter(|_| is_complete) {
                assert_eq!(lines(&whole, *millis), *expected, "seed {seed}, {millis} ms");
            }
        }
    }

    #[test]
    fn stories_and_steps_are_bounded() {
        let mut rng = fastrand::Rng::with_seed(1);
        let mut stories = Stories::default();
        for number in 0..30_000 {
            let (entry, change) = random_event(&mut rng, number * 7);
            stories.push(entry, change);
        }
        assert!(stories.iter().len() <= Stories::MAX_STORIES);
        let steps: usize = stories.iter().map(|story| story.steps().len()).sum();
        assert!(steps <= Stories::MAX_STEPS && steps == stories.steps, "{steps}");
        assert!(stories.iter().all(|story| story.steps().len() <= Story::MAX_STEPS));
        assert!(stories.iter().is_sorted_by_key(Story::begin));
        assert!(stories.latest.len() <= 3 * Stories::MAX_STORIES);
        for id in stories.latest.values() {
            assert!(stories.get(*id).is_some());
        }
    }
}
