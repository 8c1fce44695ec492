//! The past of the buses: any moment since which all frames are still captured, as it was.
//!
//! The buses are deterministic, so their state is that of the nearest snapshot before the moment and
//! what they took since: the frames, which the capture has, and the other inputs, which are kept
//! here with the number of frames before each. Snapshots and inputs are bounded in bytes. Does not
//! know des.json, the timeline or the screen.

use super::buses::{Buses, Redundancy, StatusChange};
use super::capture::{BYTES_PER_FRAME, FrameStore};
use super::journal::{BusesInput, InputJournal, InputsFrom, JournalPlace, PastInput};
use super::pinned_moments::{PinnedMoments, PinnedRange};
use super::project_facts::ProjectFacts;
use crate::catalogue::Catalogue;
use crate::dbc::MessageDatabase;
use crate::discovery::{
    Config, DeviceId, DeviceRequest, Event, FrameSequence, RequestId, SequenceId,
};
use crate::frame::{BusIndex, Frame};
use crate::status::{BusState, BusStatus};
use crate::time::Instant;
use crate::wire::descriptor::DescriptorField;
use crate::wire::profile::Profile;
use std::collections::VecDeque;
use std::ops::{Deref, Range};
use std::sync::Arc;

/// Room for captured frames, as a multiple of that for the past in a large capture.
const FRAMES_PER_ROOM: usize = 3;
/// Room for the past in a small capture, in bytes: some snapshots of a bus full of devices.
const PAST_ROOM: usize = 2 << 20;
/// Snapshots of a full capture. Those that others are near to are dropped when they take too much room.
const SNAPSHOTS: usize = 64;
/// Bounds of the work between two snapshots: about 10 ms of replay, and 3 % of it for the
/// copy.
const SNAPSHOT_WORK: Range<usize> = 256..65_536;
/// Work of an input in frames: what becomes due costs more than a frame.
const INPUT_WORK: u64 = 8;
/// Part of the room for the moments around evidence.
const PINNED_PART: usize = 2;
/// Fewer snapshots than these are not thinned out: the history becomes shorter.
const MIN_SNAPSHOTS: usize = 4;

/// Bytes of a capture of `room` bytes that are for the past: what the frames were is of little use
/// without the state of the buses, so a small capture gives most of its room to it.
pub(super) fn past_room(room: usize) -> usize {
    (room / (FRAMES_PER_ROOM + 1)).max(PAST_ROOM.min(room / 4 * 3))
}

/// The buses after so many frames and inputs.
#[derive(Clone, Debug)]
struct BusesSnapshot {
    frames: u64,
    place: JournalPlace,
    /// Work of all frames and inputs before it.
    work: u64,
    time: Instant,
    buses: Arc<Buses>,
    size: usize,
}

/// A place in the order of frames and inputs, and its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Number of frames before it.
    pub frames: u64,
    /// Number of inputs before it.
    pub(super) inputs: u64,
    /// Time that is shown.
    pub time: Instant,
}

/// The buses as they are, and what leads to them. Reads like [`Buses`].
#[derive(Debug)]
pub struct RecordedBuses {
    now: Buses,
    /// Number of frames that the buses took.
    frames: u64,
    journal: InputJournal,
    snapshots: VecDeque<BusesSnapshot>,
    /// Moments before the snapshots whose frames are pinned.
    pinned: PinnedMoments,
    /// Work of all frames and inputs, and of those before the last snapshot that was taken.
    work: u64,
    last_work: u64,
    /// Work from one snapshot to the next.
    snapshot_work: u64,
    /// Bytes that snapshots and inputs may take.
    room: usize,
}

impl Deref for RecordedBuses {
    type Target = Buses;

    fn deref(&self) -> &Buses {
        &self.now
    }
}

impl RecordedBuses {
    /// Returns buses that start at `now`, with snapshots and inputs of at most `room` bytes; with 0 there
    /// is no past.
    pub(super) fn new(now: Instant, buses: Buses, room: usize) -> Self {
        let work = FRAMES_PER_ROOM * room / BYTES_PER_FRAME / SNAPSHOTS;
        let mut all = Self {
            now: buses,
            frames: 0,
            journal: InputJournal::new(now),
            snapshots: VecDeque::new(),
            pinned: PinnedMoments::default(),
            work: 0,
            last_work: 0,
            snapshot_work: work.clamp(SNAPSHOT_WORK.start, SNAPSHOT_WORK.end) as u64,
            room,
        };
        if all.room > 0 {
            all.take_snapshot(now);
        }
        all
    }

    // ---- what the buses take ---------------------------------------------------------------

    /// Appends a bus that starts at `now`; returns false at 256 buses, the most there can be.
    pub(super) fn add(&mut self, now: Instant, name: String, config: Config) -> bool {
        self.note(now, BusesInput::Add(name.clone(), Arc::new(config.clone())));
        self.now.add(now, name, config)
    }

    /// Renames a bus; returns false for an unknown index.
    pub(super) fn rename(&mut self, now: Instant, index: BusIndex, name: String) -> bool {
        self.note(now, BusesInput::Rename(index, name.clone()));
        self.now.rename(index, name)
    }

    /// Passes a frame to its bus; returns false for an unknown bus.
    pub(super) fn receive(&mut self, frame: &Frame) -> bool {
        let is_known = self.now.receive(frame);
        if is_known {
            self.frames += 1;
            self.work += 1;
        }
        is_known
    }

    /// Runs the timers that are due at `now`.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.now.poll_timeout().is_some_and(|due| due <= now) {
            self.note(now, BusesInput::Timeout);
            self.now.handle_timeout(now);
        }
    }

    /// Quarantines the buses after a stall from `since` to `now`.
    pub(super) fn handle_stall(&mut self, since: Instant, now: Instant) {
        self.note(now, BusesInput::Stall(since));
        self.now.handle_stall(since, now);
    }

    /// State of the controller of a bus before the last frame, if that reported another one.
    pub(super) fn poll_state_change(&mut self, index: BusIndex) -> Option<BusState> {
        self.now.poll_state_change(index)
    }

    /// Updates the bus status of a bus; returns what changed.
    pub(super) fn update_status(
        &mut self,
        now: Instant,
        index: BusIndex,
        status: BusStatus,
    ) -> Option<StatusChange> {
        if self.now.get(index).is_some_and(|bus| bus.status != status) {
            self.note(now, BusesInput::Status(index, Arc::new(status.clone())));
        }
        self.now.update_status(now, index, status)
    }

    /// The next engine event of a bus.
    pub(super) fn poll_event(&mut self, index: BusIndex) -> Option<Event> {
        self.now.poll_event(index)
    }

    /// The next frame to transmit; `frame.bus` is the bus to transmit on.
    pub(super) fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let is_cut_off = self.now.iter().any(|bus| bus.must_discard_frames(now));
        let frame = self.now.poll_transmit(now);
        // An engine that cannot send starts to listen again.
        if frame.is_some() || is_cut_off {
            self.note(now, BusesInput::Transmit);
        }
        frame
    }

    /// Restarts the enumeration on all buses.
    pub(super) fn rescan(&mut self, now: Instant) {
        self.note(now, BusesInput::Rescan);
        self.now.rescan(now);
    }

    /// Sends a frame as it stands.
    pub(super) fn send(&mut self, now: Instant, frame: Frame) {
        self.note(now, BusesInput::Send(frame));
        self.now.send(now, frame);
    }

    /// Sends frames as they are; returns `None` if others are being sent.
    pub(super) fn send_frames(
        &mut self,
        now: Instant,
        index: BusIndex,
        sequence: FrameSequence,
    ) -> Option<SequenceId> {
        self.note(now, BusesInput::SendFrames(index, Arc::new(sequence.clone())));
        self.now.send_frames(now, index, sequence)
    }

    /// Sends no further frame of the sequence of a bus.
    pub(super) fn stop_frames(&mut self, now: Instant, index: BusIndex) {
        self.note(now, BusesInput::StopFrames(index));
        self.now.stop_frames(now, index);
    }

    /// Sends no more requests and flow control by itself on a bus.
    pub(super) fn yield_requests(&mut self, now: Instant, index: BusIndex) {
        self.note(now, BusesInput::Yield(index));
        self.now.yield_requests(now, index);
    }

    /// Sends a request to a device, once; returns `None` if it cannot be sent.
    pub(super) fn request(&mut self, now: Instant, request: DeviceRequest) -> Option<RequestId> {
        self.note(now, BusesInput::Request(request.clone()));
        self.now.request(now, request)
    }

    /// Reads a field of the descriptor of a device, or all; returns the number of fields.
    pub(super) fn read_descriptor(
        &mut self,
        now: Instant,
        device: DeviceId,
        field: Option<DescriptorField>,
    ) -> usize {
        self.note(now, BusesInput::ReadDescriptor(device, field));
        self.now.read_descriptor(now, device, field)
    }

    /// Removes the lost devices of all buses.
    pub(super) fn remove_lost_devices(&mut self, now: Instant) {
        self.note(now, BusesInput::RemoveLost);
        self.now.remove_lost_devices();
    }

    /// Closes the load seconds that are over.
    pub(super) fn tick(&mut self, now: Instant) {
        self.note(now, BusesInput::Tick);
        self.now.tick(now);
    }

    /// Reads the frames of all buses by another profile from now on; returns the buses whose devices
    /// start over.
    pub(super) fn set_profile(&mut self, now: Instant, profile: &Arc<Profile>) -> Vec<BusIndex> {
        self.note(now, BusesInput::Profile(profile.clone()));
        self.now.set_profile(now, profile)
    }

    /// Sets what is known of types of devices; it is not a part of the past.
    pub(super) fn set_catalogue(&mut self, catalogue: Arc<Catalogue>) {
        self.now.set_catalogue(catalogue);
    }

    /// Sets the messages of DBC files; they are not a part of the past.
    pub(super) fn set_messages(&mut self, messages: Arc<MessageDatabase>) {
        self.now.set_messages(messages);
    }

    /// Sets what the project says about the buses; it is not a part of the past.
    pub(super) fn set_project(&mut self, project: Arc<ProjectFacts>) {
        self.now.set_project(project);
    }

    /// Starts or ends a bit rate search.
    pub(super) fn set_searched(&mut self, now: Instant, bus: Option<BusIndex>) {
        self.note(now, BusesInput::Searched(bus));
        self.now.set_searched(bus);
    }

    /// Updates which devices are on several buses; returns the pairs whose redundancy changed.
    pub(super) fn refresh_redundancy(&mut self) -> Vec<(DeviceId, DeviceId, Redundancy)> {
        self.now.refresh_redundancy()
    }

    fn note(&mut self, time: Instant, input: BusesInput) {
        if self.room == 0 {
            return;
        }
        self.journal.push(self.frames, time, input);
        self.work += INPUT_WORK;
    }

    // ---- the past --------------------------------------------------------------------------

    /// Gives snapshots and inputs more room, in bytes.
    pub(super) fn add_room(&mut self, more: usize) {
        self.room += more;
    }

    /// Takes a snapshot, if it is time for one: call when all events are taken. Drops what is older
    /// than the captured frames. Of a log whose frames can be read again the first moment is kept as
    /// long as there is room.
    pub(super) fn keep_history(&mut self, now: Instant, store: &FrameStore) {
        if self.room == 0 || self.work < self.last_work + self.snapshot_work {
            return;
        }
        if self.snapshots.back().is_some_and(|it| self.frames - it.frames < self.spacing(store)) {
            return;
        }
        let (first, keeps_first) = (store.first(), store.has_source());
        self.pinned.drop_before(store.oldest());
        // A moment needs a snapshot before it and all frames since.
        while self.snapshots.len() > 1 && self.snapshots[0].frames < first {
            self.snapshots.pop_front();
        }
        self.take_snapshot(now);
        while self.snapshots.len() > 1 && self.size() > self.room {
            if self.snapshots.len() > MIN_SNAPSHOTS || first == 0 || keeps_first {
                self.thin_out();
            } else {
                self.snapshots.pop_front();
            }
        }
        if self.size() > self.room && keeps_first {
            // The inputs since the first moment need all the room.
            self.snapshots.clear();
            self.take_snapshot(now);
        }
        let needed = self.snapshots.front().map_or(self.journal.end(), |oldest| oldest.place);
        self.journal.drop_before(needed);
    }

    /// Least number of frames between two snapshots: that of the captured frames divided among as many
    /// snapshots as there is room for, if these are few.
    fn spacing(&self, store: &FrameStore) -> u64 {
        let size = self.snapshots.back().map_or(0, |snapshot| snapshot.size);
        let room = self.room.saturating_sub(self.journal.size() + self.pinned.size());
        let snapshots = (room / size.max(1)).max(1);
        if snapshots > SNAPSHOTS || store.has_source() {
            return 0;
        }
        (store.end() - store.first()) / snapshots as u64
    }

    /// Keeps what is needed to replay the frames around evidence that only a snapshot between the frames
    /// with these numbers leads to: call before they are dropped. `pins` are the times around the
    /// evidence of buses in a range.
    pub(super) fn pin(
        &mut self,
        store: &FrameStore,
        dropped: Range<u64>,
        pins: impl Fn(&Buses, Range<Instant>) -> Vec<Range<Instant>>,
    ) {
        let frames: Vec<u64> = self.snapshots.iter().map(|snapshot| snapshot.frames).collect();
        for (at, first) in frames.iter().enumerate().filter(|(_, it)| dropped.contains(it)) {
            let end = frames.get(at + 1).copied().unwrap_or(store.end());
            let times = store.time_of(*first).zip(store.time_of(end.saturating_sub(1)));
            let Some((begin, last)) = times else { continue };
            let times = pins(&self.now, begin..last);
            if times.is_empty() {
                continue;
            }
            let is_pinned = |frame: &(u64, Frame)| {
                frame.0 < end && times.iter().any(|range| range.contains(&frame.1.time))
            };
            let mut next = *first;
            while let Some((first, _)) =
                store.frames_from(next).take_while(|it| it.0 < end).find(is_pinned)
            {
                let pinned = store.frames_from(first).take_while(is_pinned).count() as u64;
                next = first + pinned;
                self.pin_range(store, first..next);
            }
        }
    }

    fn pin_range(&mut self, store: &FrameStore, frames: Range<u64>) {
        let (Some(time), Some(last)) = (store.time_of(frames.start), store.time_of(frames.end - 1))
        else {
            return;
        };
        let inputs = self.inputs_before(frames.start, |it| it.frames < frames.start);
        let Some(mut replay) = self.replay(store, Moment { frames: frames.start, inputs, time })
        else {
            return;
        };
        let room = self.room / PINNED_PART;
        let from = replay.place;
        let between = self.journal.inputs_from(from);
        let between = between.skip_while(|it| it.frames < frames.start);
        let between = between.take_while(|it| it.frames < frames.end);
        if let Some(before) = self.pinned.before(frames.start) {
            before.extend(frames.end, last, between);
            return self.pinned.drop_surplus(room);
        }
        while !replay.run(self, store, u64::MAX) {}
        let mut range = PinnedRange::new(frames.start, time, inputs, replay.into_buses());
        range.extend(frames.end, last, between);
        self.pinned.push(range);
        self.pinned.drop_surplus(room);
    }

    /// Bytes of snapshots and inputs.
    fn size(&self) -> usize {
        let snapshots: usize = self.snapshots.iter().map(|snapshot| snapshot.size).sum();
        snapshots + self.journal.size() + self.pinned.size()
    }

    fn take_snapshot(&mut self, time: Instant) {
        self.last_work = self.work;
        self.snapshots.push_back(BusesSnapshot {
            frames: self.frames,
            work: self.work,
            place: self.journal.end(),
            time,
            size: self.now.size(),
            buses: Arc::new(self.now.clone()),
        });
    }

    /// Drops the snapshot whose neighbours are nearest to each other.
    fn thin_out(&mut self) {
        if let Some(at) = most_redundant(self.snapshots.iter().map(|snapshot| snapshot.work)) {
            self.snapshots.remove(at);
        } else {
            self.snapshots.pop_back();
        }
    }

    /// Time since when every moment can be shown, with the captured frames `store`.
    pub fn begin(&self, store: &FrameStore) -> Instant {
        let reachable = self.snapshots.iter().find(|it| it.frames >= store.first());
        reachable.map_or(Instant::LATEST, |snapshot| snapshot.time)
    }

    /// The present moment.
    pub fn present(&self, time: Instant) -> Moment {
        Moment { frames: self.frames, inputs: self.journal.end().inputs, time }
    }

    /// The moment at a time: after all frames and inputs until then.
    pub fn moment(&self, store: &FrameStore, time: Instant) -> Moment {
        let frames = store.at_time(Instant::from_micros(time.as_micros().saturating_add(1)));
        let is_before =
            |it: &PastInput| it.frames < frames || it.frames == frames && it.time <= time;
        Moment { frames, inputs: self.inputs_before(frames, is_before), time }
    }

    /// The moment after the frame with this number; `None` if it is not stored.
    pub fn moment_after(&self, store: &FrameStore, number: u64) -> Option<Moment> {
        let time = store.get(number)?.time;
        let frames = number + 1;
        Some(Moment { frames, inputs: self.inputs_before(frames, |it| it.frames < frames), time })
    }

    /// Number of inputs before a moment that is not before so many frames. `is_before` is true for
    /// those inputs, and false for all later ones.
    fn inputs_before(&self, frames: u64, is_before: impl Fn(&PastInput) -> bool) -> u64 {
        if let Some(pinned) = self.pinned.inputs_before(frames, &is_before) {
            return pinned;
        }
        let before = self.snapshots.partition_point(|snapshot| snapshot.frames < frames);
        let snapshot = before.checked_sub(1).and_then(|at| self.snapshots.get(at));
        let Some(snapshot) = snapshot.or(self.snapshots.front()) else { return 0 };
        let from = self.journal.inputs_from(snapshot.place);
        snapshot.place.inputs + from.take_while(is_before).count() as u64
    }

    /// Begins to replay the buses as they were at a moment; `None` if frames before it are no longer
    /// stored.
    pub fn replay(&self, store: &FrameStore, moment: Moment) -> Option<BusesReplay> {
        if let Some(range) = self.pinned.range_of(&moment) {
            let mut place = self.journal.end();
            place.inputs = range.inputs_before;
            return Some(BusesReplay {
                buses: Buses::clone(&range.buses),
                frames: range.frames.start,
                place,
                pinned: Some(range.clone()),
                moment,
            });
        }
        let is_usable = |snapshot: &&BusesSnapshot| {
            snapshot.frames >= store.first()
                && snapshot.frames <= moment.frames
                && snapshot.place.inputs <= moment.inputs
        };
        let snapshot = self.snapshots.iter().rev().find(is_usable)?;
        Some(BusesReplay {
            buses: Buses::clone(&snapshot.buses),
            frames: snapshot.frames,
            place: snapshot.place,
            pinned: None,
            moment,
        })
    }
}

/// Returns which of these places, in order, has the nearest neighbours: without it the longest way from
/// one to the next is the shortest. `None` of fewer than three.
pub(super) fn most_redundant(places: impl Iterator<Item = u64>) -> Option<usize> {
    let places: Vec<u64> = places.collect();
    let between = places.windows(3).enumerate().map(|(at, it)| (it[2] - it[0], at + 1));
    between.min().map(|(_, at)| at)
}

/// A replay of the buses up to a moment.
#[derive(Debug)]
pub struct BusesReplay {
    buses: Buses,
    /// Number of the next frame, and the place of the next input.
    frames: u64,
    place: JournalPlace,
    /// The range of pinned frames that is replayed, if it is one.
    pinned: Option<PinnedRange>,
    moment: Moment,
}

impl BusesReplay {
    /// The moment that is replayed.
    pub fn moment(&self) -> Moment {
        self.moment
    }

    /// Returns true if all that it needs is still kept.
    pub(super) fn is_kept(&self, history: &RecordedBuses, store: &FrameStore) -> bool {
        match self.pinned {
            Some(_) => self.frames >= store.oldest(),
            None => history.journal.is_kept(self.place) && self.frames >= store.first(),
        }
    }

    /// Replays at most about `work` frames. Returns true when the moment is reached.
    pub fn run(&mut self, history: &RecordedBuses, store: &FrameStore, work: u64) -> bool {
        let mut left = work;
        let pinned = self.pinned.take();
        let mut inputs = match &pinned {
            Some(range) => {
                let applied = (self.place.inputs - range.inputs_before) as usize;
                InputsToReplay::Pinned(range.inputs.get(applied..).unwrap_or_default().iter())
            }
            None => InputsToReplay::Journal(history.journal.inputs_from(self.place)),
        };
        let mut input = inputs.next();
        let mut frames = store.frames_from(self.frames);
        let is_reached = loop {
            if left == 0 {
                break false;
            }
            let due = input.as_ref().filter(|it| it.frames <= self.frames);
            if let Some(due) = due.filter(|_| self.place.inputs < self.moment.inputs) {
                self.buses.apply(due);
                match &inputs {
                    InputsToReplay::Pinned(_) => self.place.inputs += 1,
                    InputsToReplay::Journal(inputs) => self.place = inputs.place(),
                }
                input = inputs.next();
                left = left.saturating_sub(INPUT_WORK);
            } else if self.frames < self.moment.frames
                && let Some((_, frame)) = frames.next()
            {
                self.buses.receive(&frame);
                self.frames += 1;
                left -= 1;
            } else {
                break true;
            }
            self.buses.drop_events();
        };
        self.buses.drop_events();
        self.pinned = pinned;
        is_reached
    }

    /// The buses as far as they were replayed.
    pub fn into_buses(self) -> Buses {
        self.buses
    }
}

/// The inputs of a replay.
enum InputsToReplay<'a> {
    Journal(InputsFrom<'a>),
    Pinned(std::slice::Iter<'a, PastInput>),
}

impl InputsToReplay<'_> {
    fn next(&mut self) -> Option<PastInput> {
        match self {
            Self::Journal(inputs) => inputs.next(),
            Self::Pinned(inputs) => inputs.next().cloned(),
        }
    }
}

impl Buses {
    fn apply(&mut self, past: &PastInput) {
        let now = past.time;
        match &past.input {
            BusesInput::Timeout => self.handle_timeout(now),
            BusesInput::Transmit => {
                self.poll_transmit(now);
            }
            BusesInput::Tick => self.tick(now),
            BusesInput::Stall(since) => self.handle_stall(*since, now),
            BusesInput::Status(index, status) => {
                self.update_status(now, *index, BusStatus::clone(status));
            }
            BusesInput::Searched(bus) => self.set_searched(*bus),
            BusesInput::Rescan => self.rescan(now),
            BusesInput::Send(frame) => self.send(now, *frame),
            BusesInput::SendFrames(index, sequence) => {
                self.send_frames(now, *index, FrameSequence::clone(sequence));
            }
            BusesInput::StopFrames(index) => self.stop_frames(now, *index),
            BusesInput::Yield(index) => self.yield_requests(now, *index),
            BusesInput::Request(request) => {
                self.request(now, request.clone());
            }
            BusesInput::ReadDescriptor(device, field) => {
                self.read_descriptor(now, *device, *field);
            }
            BusesInput::RemoveLost => self.remove_lost_devices(),
            BusesInput::Rename(index, name) => {
                self.rename(*index, name.clone());
            }
            BusesInput::Profile(profile) => {
                self.set_profile(now, profile);
            }
            BusesInput::Add(name, config) => {
                self.add(now, name.clone(), Config::clone(config));
            }
        }
    }

    /// Drops the events of all buses.
    fn drop_events(&mut self) {
        for index in 0..self.len() {
            while self.poll_event(BusIndex(index as u8)).is_some() {}
        }
    }
}
