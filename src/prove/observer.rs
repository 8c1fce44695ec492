//! What a device and the other nodes send by themselves, and what makes it doubtful.
//!
//! Input: all frames of the bus in the order of their times. Output: samples of the rules that need no
//! request. Does not know requests and their answers.

use super::rule::ConformanceRule as Rule;
use super::verdict::{Records, Sample};
use crate::frame::{Frame, FrameKind};
use crate::text::counted;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header, MessageType};
use crate::wire::node::{Mode, Uid};
use crate::wire::profile::{Profile, ProfileKey};
use std::collections::VecDeque;
use std::sync::Arc;

/// Most heartbeats that are compared: 4 minutes.
const MAX_HEARTBEATS: usize = 240;
/// Deviation of a device's clock that is not judged. Chosen: an RC oscillator has up to 3 %.
const CLOCK_TOLERANCE: f64 = 0.04;
/// Mean interval of heartbeats, in periods, from which too few are not lost ones. Chosen: half are
/// missing.
const SLOW_PERIODS: f64 = 2.0;
/// Intervals of which all must be too long, or the mean.
const SLOW_INTERVALS: usize = 6;
/// Periods within which a heartbeat that is equal on the wire is a repeated one.
const REPEATED_WITHIN: f64 = 0.3;
/// Heartbeats after which a DST that never changes is not random: one in 128⁷.
const RANDOM_HEARTBEATS: usize = 8;
/// Periods without a frame of the device after which it is away.
const AWAY_PERIODS: f64 = 2.5;
/// Bits without a frame after which no frame waits: three frames.
const IDLE_BITS: u64 = 3 * 130;
/// Changes of the UID at one address that show two nodes: A, B, A.
const UID_CHANGES: u32 = 2;
/// Mismatches of U that are no change of the mode.
const FLAG_CHANGES: u32 = 4;
/// Frames that are kept of one misbehaviour.
const MAX_FRAMES: usize = 16;

/// A heartbeat of the device.
#[derive(Clone, Copy, Debug)]
pub(super) struct SeenHeartbeat {
    /// It was sent between `from` and the time of the frame: since the bus was idle.
    from: Instant,
    pub frame: Frame,
    pub uid: Option<Uid>,
    pub mode: Option<Mode>,
}

/// Another node.
#[derive(Clone, Copy, Debug, Default)]
struct OtherNode {
    last_seen: Option<Instant>,
    uid: Option<Uid>,
    heartbeats: u32,
    /// Its heartbeats with the UID of the device, and the last of them.
    same_uid: u32,
    last_heartbeat: Option<Frame>,
    is_requester: bool,
}

/// What the frames of a bus show of one device.
#[derive(Clone, Debug)]
pub(super) struct Observer {
    own: Address,
    device: Address,
    profile: Arc<Profile>,
    idle_time: Duration,
    last_frame: Instant,
    idle_at: Instant,
    pub heartbeats: VecDeque<SeenHeartbeat>,
    /// Heartbeats before this number do not count for the interval: the bus was not observed, or the
    /// device was disturbed.
    counted_from: usize,
    /// When frames were lost last.
    lost_at: Option<Instant>,
    lost_frames: u64,
    others: Vec<OtherNode>,
    uid_changes: u32,
    is_foreign: bool,
    non_conforming: Vec<Frame>,
    device_frames: u64,
    requests_in_configuration: Vec<Frame>,
    last_device_frame: Option<Frame>,
    /// The first frame of the device since it was away.
    present_since: Option<Instant>,
    /// U of the last heartbeat, and the frames that differ from it and from the next one.
    beat_flag: Option<bool>,
    differing: Vec<Frame>,
    flag_mismatches: Vec<Frame>,
    mode_mismatches: Vec<Frame>,
    error_flags: Vec<Frame>,
    unsolicited: u32,
    blank_in_work: Vec<Frame>,
    uid_heartbeats: u32,
    is_excluded: bool,
}

impl Observer {
    pub fn new(
        now: Instant,
        own: Address,
        device: Address,
        profile: Arc<Profile>,
        bits: u32,
    ) -> Self {
        let idle_micros = IDLE_BITS * 1_000_000 / u64::from(bits.max(1));
        Self {
            own,
            device,
            profile,
            idle_time: Duration::from_micros(idle_micros),
            last_frame: now,
            idle_at: now,
            heartbeats: VecDeque::new(),
            counted_from: 0,
            lost_at: None,
            lost_frames: 0,
            others: vec![OtherNode::default(); Address::COUNT],
            uid_changes: 0,
            is_foreign: false,
            non_conforming: Vec::new(),
            device_frames: 0,
            requests_in_configuration: Vec::new(),
            last_device_frame: None,
            present_since: None,
            beat_flag: None,
            differing: Vec::new(),
            flag_mismatches: Vec::new(),
            mode_mismatches: Vec::new(),
            error_flags: Vec::new(),
            unsolicited: 0,
            blank_in_work: Vec::new(),
            uid_heartbeats: 0,
            is_excluded: false,
        }
    }

    /// Notes that frames were lost, or that the bus was down.
    pub fn note_gap(&mut self, now: Instant, frames: u64) {
        self.lost_frames += frames;
        self.lost_at = Some(now);
        self.restart_count();
    }

    /// Begins to count heartbeats anew.
    fn restart_count(&mut self) {
        self.counted_from = self.heartbeats.len();
    }

    /// Frames of the device do not count while `is_excluded`: what descan sends changes its mode.
    pub fn exclude(&mut self, is_excluded: bool) {
        self.is_excluded = is_excluded;
        self.beat_flag = None;
        self.differing.clear();
        self.restart_count();
    }

    /// Time of the device's last frame.
    pub fn silent_since(&self) -> Option<Instant> {
        self.last_device_frame.map(|frame| frame.time)
    }

    /// Returns true if the device has sent frames for `time`, the last one after `since`.
    pub fn is_present_for(&self, now: Instant, time: Duration, since: Instant) -> bool {
        self.silent_since().is_some_and(|last| last > since)
            && self.present_since.is_some_and(|first| now.since(first) >= time)
    }

    /// Notes when the device is heard again, before its frame is noted.
    fn note_return(&mut self, now: Instant) {
        let away = self.profile.heartbeat.period().mul_f64(AWAY_PERIODS);
        if self.silent_since().is_none_or(|last| now.since(last) > away) {
            self.present_since = Some(now);
        }
    }

    /// Returns true if the device sent no heartbeat since `since`.
    pub fn has_no_heartbeat_since(&self, since: Instant) -> bool {
        self.heartbeats.back().is_none_or(|beat| beat.frame.time < since)
    }

    /// The device has another address.
    pub fn set_device(&mut self, address: Address) {
        self.device = address;
        let node = std::mem::take(&mut self.others[address.index()]);
        self.last_device_frame = node.last_heartbeat;
        self.present_since = self.silent_since();
        self.restart_count();
    }

    /// The address at which a node has had the UID of the device since this has been silent.
    pub fn moved_to(&self) -> Option<Address> {
        let (silent, uid) = (self.silent_since()?, self.uid()?.not_blank()?);
        Address::nodes().find(|it| {
            let other = &self.others[it.index()];
            // The first one is a claim, with the U of another mode.
            other.uid == Some(uid)
                && other.heartbeats > 1
                && other.last_seen.is_some_and(|at| at > silent)
        })
    }

    /// Returns true if no frame was lost since `since`.
    pub fn is_sure_since(&self, since: Instant) -> bool {
        self.lost_at.is_none_or(|lost| lost < since)
    }

    /// Number of frames that were lost.
    pub fn lost_frames(&self) -> u64 {
        self.lost_frames
    }

    /// Returns true if no frame waited for the bus at some time since `since`.
    pub fn was_idle_since(&self, now: Instant, since: Instant) -> bool {
        let idle_at = if now.since(self.last_frame) >= self.idle_time { now } else { self.idle_at };
        idle_at > since
    }

    /// U of the device's last frame, inverted; `None` before the first.
    pub fn is_working(&self) -> Option<bool> {
        let id = self.last_device_frame.as_ref()?.platform_id()?;
        Some(!Header::decode(id).from_non_working)
    }

    /// Mode of the last heartbeat.
    pub fn mode(&self) -> Option<Mode> {
        self.heartbeats.back().and_then(|it| it.mode)
    }

    /// UID of the last heartbeat that has one.
    pub fn uid(&self) -> Option<Uid> {
        self.heartbeats.iter().rev().find_map(|it| it.uid)
    }

    /// An address that another node was heard from, a device rather than a requester.
    pub fn other_address(&self, now: Instant, window: Duration) -> Option<Address> {
        Address::nodes().find(|it| {
            let other = &self.others[it.index()];
            other.last_seen.is_some_and(|at| now.since(at) <= window) && !other.is_requester
        })
    }

    /// An address that no node was heard from.
    pub fn unused_address(&self) -> Option<Address> {
        Address::nodes().rev().find(|it| {
            self.others[it.index()].last_seen.is_none() && *it != self.own && *it != self.device
        })
    }

    /// Why nothing that was seen is surely of the device; `None` if it is.
    pub fn doubt(&self) -> Option<String> {
        let address = self.device;
        if self.uid_changes >= UID_CHANGES {
            return Some(format!("two nodes use the address {address}: their UIDs alternate"));
        }
        let period = self.profile.heartbeat.period().as_secs_f64();
        has_two_phases(&self.counted(), period).then(|| {
            format!(
                "heartbeats from {address} in two phases: two devices, or one device with two timers"
            )
        })
    }

    pub fn handle_frame(&mut self, frame: &Frame) {
        let now = frame.time;
        if frame.kind == FrameKind::Error {
            return;
        }
        if now.since(self.last_frame) >= self.idle_time {
            self.idle_at = now;
        }
        self.last_frame = self.last_frame.max(now);
        let crate::frame::CanId::Extended(id) = frame.id else {
            self.is_foreign |= !frame.is_tx;
            return;
        };
        let header = Header::decode(id);
        if frame.is_tx {
            return;
        }
        if header.source == self.device {
            self.note_return(now);
            if self.is_excluded {
                self.note_excluded(frame, header);
            } else {
                self.note_device_frame(frame, header);
            }
        } else {
            self.note_other_frame(frame, header);
        }
    }

    fn note_other_frame(&mut self, frame: &Frame, header: Header) {
        if frame.kind == FrameKind::Remote || !header.is_conforming() {
            self.is_foreign = true;
            return;
        }
        if header.source == self.own {
            return;
        }
        let is_heartbeat = self.is_heartbeat(header);
        let uid = self.uid();
        let other = &mut self.others[header.source.index()];
        other.last_seen = Some(frame.time);
        other.is_requester |= !header.response;
        if is_heartbeat {
            other.uid = self.profile.heartbeat_of(frame.data()).uid;
            other.last_heartbeat = Some(*frame);
            other.heartbeats += 1;
            let is_same = other.uid.and_then(Uid::not_blank).is_some() && other.uid == uid;
            other.same_uid = if is_same { other.same_uid + 1 } else { 0 };
        }
    }

    fn is_heartbeat(&self, header: Header) -> bool {
        header.response
            && header.service == self.profile.heartbeat_service()
            && header.message_type() != MessageType::Debug
    }

    fn note_device_frame(&mut self, frame: &Frame, header: Header) {
        self.device_frames += 1;
        let is_request_in_configuration = header.from_non_working && !header.response;
        if is_request_in_configuration {
            push(&mut self.requests_in_configuration, frame);
            return;
        }
        if frame.kind == FrameKind::Remote || !header.is_conforming() {
            push(&mut self.non_conforming, frame);
            return;
        }
        self.last_device_frame = Some(*frame);
        if header.message_type() == MessageType::Debug {
            return;
        }
        if header.response && header.broadcast {
            self.unsolicited += 1;
            if !header.no_error {
                push(&mut self.error_flags, frame);
            }
        }
        if self.is_heartbeat(header) {
            self.note_heartbeat(frame, header);
        } else if self.beat_flag.is_some_and(|flag| flag != header.from_non_working) {
            push(&mut self.differing, frame);
        }
    }

    /// Notes the mode of a device that is being disrupted.
    fn note_excluded(&mut self, frame: &Frame, header: Header) {
        if header.is_conforming() {
            self.last_device_frame = Some(*frame);
            if self.is_heartbeat(header) {
                self.push_heartbeat(frame);
            }
        }
    }

    /// Returns true for a copy of the last heartbeat, as a bridge makes them.
    fn is_repeated(&self, frame: &Frame) -> bool {
        let within = self.profile.heartbeat.period().mul_f64(REPEATED_WITHIN);
        self.heartbeats.back().is_some_and(|last| {
            last.frame.same_on_wire(frame) && frame.time.since(last.frame.time) < within
        })
    }

    fn push_heartbeat(&mut self, frame: &Frame) -> SeenHeartbeat {
        let content = self.profile.heartbeat_of(frame.data());
        let from = self.idle_at.min(frame.time);
        let beat = SeenHeartbeat { from, frame: *frame, uid: content.uid, mode: content.mode };
        if self.heartbeats.len() == MAX_HEARTBEATS {
            self.heartbeats.pop_front();
            self.counted_from = self.counted_from.saturating_sub(1);
        }
        self.heartbeats.push_back(beat);
        beat
    }

    fn note_heartbeat(&mut self, frame: &Frame, header: Header) {
        let before = self.uid();
        if self.is_repeated(frame) {
            return;
        }
        let beat = self.push_heartbeat(frame);
        if before.is_some() && beat.uid.is_some() && beat.uid != before {
            self.uid_changes += 1;
        }
        // Frames that differ from the heartbeats before and after them are no change of the mode.
        if self.beat_flag == Some(header.from_non_working) {
            self.flag_mismatches.append(&mut self.differing);
            self.flag_mismatches.truncate(MAX_FRAMES);
        }
        self.differing.clear();
        self.beat_flag = Some(header.from_non_working);
        let flag = beat.mode.and_then(Mode::is_working).map(|is_working| !is_working);
        if flag.is_some_and(|flag| flag != header.from_non_working) {
            push(&mut self.mode_mismatches, frame);
        }
        if let Some(uid) = beat.uid {
            self.uid_heartbeats += 1;
            if uid.is_blank() && !header.from_non_working {
                push(&mut self.blank_in_work, frame);
            }
        }
    }

    /// Adds the samples of the rules that need no request.
    pub fn judge(&self, now: Instant, records: &mut Records) {
        self.judge_interval(Rule::HeartbeatInterval, records);
        self.judge_types(records);
        self.judge_mode_flag(records);
        self.judge_error_flag(records);
        self.judge_destination(records);
        self.judge_uid(now, records);
    }

    /// The heartbeats that count for the interval.
    fn counted(&self) -> Vec<&SeenHeartbeat> {
        self.heartbeats.iter().skip(self.counted_from).collect()
    }

    /// Shortest, mean and longest interval between heartbeats, in seconds; `None` for less than three.
    pub fn intervals(&self) -> Option<(f64, f64, f64)> {
        let beats = self.counted();
        let gaps = beats.windows(2).map(|two| two[1].frame.time.since(two[0].frame.time));
        let gaps: Vec<f64> = gaps.map(|gap| gap.as_secs_f64()).collect();
        if gaps.len() < 2 {
            return None;
        }
        let least = gaps.iter().copied().fold(f64::INFINITY, f64::min);
        let most = gaps.iter().copied().fold(0.0, f64::max);
        Some((least, gaps.iter().sum::<f64>() / gaps.len() as f64, most))
    }

    /// One heartbeat in each interval: some phase and a clock within the tolerance put exactly one into
    /// each. Each lies between the last idle time of the bus before it and its own.
    pub fn judge_interval(&self, rule: Rule, records: &mut Records) {
        records.depends_on(rule, &[ProfileKey::Heartbeat], &self.profile);
        let period = self.profile.heartbeat.period().as_secs_f64();
        let beats = self.counted();
        if let Some(IntervalFault { is_too_few, text, frames, end }) =
            interval_fault(&beats, period)
        {
            // A restart is one irregularity.
            let is_again = interval_fault(&beats[end..], period).is_some();
            let is_sure = !is_too_few || self.lost_frames == 0 && is_slow(&beats, period);
            if !is_again {
                records.add(rule, Sample::Unsure, format!("{text}, once: a restart?"), &frames);
            } else if is_sure {
                records.add(rule, Sample::Broken, text, &frames);
            } else {
                let text = format!("{text}: some may not have been received");
                records.add(rule, Sample::Unsure, text, &frames);
            }
        } else if beats.len() >= 4 {
            let text = self.intervals().map(|(least, mean, most)| {
                let (jitter, count) = (1e3 * (most - least), beats.len() as u64);
                let count = counted(count, "heartbeat");
                format!("{count}, {mean:.4} s apart, jitter {jitter:.1} ms")
            });
            records.add(rule, Sample::Kept, text.unwrap_or_default(), &[]);
        } else {
            let count = counted(beats.len() as u64, "heartbeat");
            records.add(rule, Sample::Unsure, format!("{count} only"), &[]);
        }
    }

    /// The device sent nothing but answers: there is no heartbeat.
    pub fn judge_silence(&self, observed: Duration, records: &mut Records) {
        let period = self.profile.heartbeat.period();
        if self.heartbeats.is_empty() && observed > period * 5 && self.lost_frames == 0 {
            let text = format!("no heartbeat for {:.1} s", observed.as_secs_f64());
            records.add(Rule::HeartbeatInterval, Sample::Broken, text, &[]);
        }
    }

    fn judge_types(&self, records: &mut Records) {
        if self.is_foreign && !self.non_conforming.is_empty() {
            let text = "the bus carries frames that are not of the CAN platform";
            records.add(Rule::MessageTypes, Sample::Unsure, text, &[]);
        } else if let Some(frame) = self.non_conforming.first() {
            let text = format!("sent {frame}, none of the nine types");
            records.add(Rule::MessageTypes, Sample::Broken, text, &self.non_conforming);
        } else if self.device_frames > 0 {
            let text = counted(self.device_frames, "frame");
            records.add(Rule::MessageTypes, Sample::Kept, text, &[]);
        }
        let rule = Rule::NoRequestsUnlessWorking;
        let is_configuring = self.heartbeats.iter().any(|it| is_from_non_working(&it.frame));
        if let Some(frame) = self.requests_in_configuration.first() {
            let sample = if self.is_foreign { Sample::Unsure } else { Sample::Broken };
            let text = format!("sent the request {frame} with U = 1");
            records.add(rule, sample, text, &self.requests_in_configuration);
        } else if is_configuring {
            records.add(rule, Sample::Kept, "no request with U = 1", &[]);
        } else {
            records.add(rule, Sample::Unsure, "was not seen in such a mode", &[]);
        }
    }

    fn judge_mode_flag(&self, records: &mut Records) {
        let rule = Rule::ModeFlag;
        if self.flag_mismatches.len() as u32 >= FLAG_CHANGES {
            let text = "sent frames whose U differs from that of the heartbeats around them";
            records.add(rule, Sample::Broken, text, &self.flag_mismatches);
            records.add(rule, Sample::Broken, text, &[]);
        } else if self.mode_mismatches.len() as u32 >= FLAG_CHANGES {
            use ProfileKey::{Cfg, ModeOffset, Ufunc, Work};
            let keys = [ProfileKey::Heartbeat, ModeOffset, Work, Cfg, Ufunc];
            records.depends_on(rule, &keys, &self.profile);
            let mode = self.mode().map_or("another mode", Mode::name);
            let text = format!("sent heartbeats in {mode} with the U of another mode");
            records.add(rule, Sample::Broken, text.clone(), &self.mode_mismatches);
            records.add(rule, Sample::Broken, text, &[]);
        } else if self.heartbeats.len() >= 2 {
            let flag = u8::from(self.beat_flag == Some(true));
            records.add(rule, Sample::Kept, format!("U = {flag} in all frames"), &[]);
        }
    }

    fn judge_error_flag(&self, records: &mut Records) {
        let rule = Rule::ErrorFlag;
        if self.error_flags.len() >= 2 {
            for _ in 0..2 {
                let text = "sent unsolicited frames with ERR = 0";
                records.add(rule, Sample::Broken, text, &self.error_flags);
            }
        } else if self.unsolicited > 0 {
            let text = format!("ERR = 1 in {}", counted(u64::from(self.unsolicited), "frame"));
            records.add(rule, Sample::Kept, text, &[]);
        }
    }

    fn judge_destination(&self, records: &mut Records) {
        let destinations = self.heartbeats.iter().filter_map(|it| it.frame.platform_id());
        let headers = destinations.map(Header::decode).filter(|it| it.broadcast);
        let all: Vec<Address> = headers.map(|it| it.destination).collect();
        let Some(first) = all.first() else { return };
        let frames: Vec<Frame> = self.heartbeats.iter().map(|it| it.frame).take(4).collect();
        if all.len() < RANDOM_HEARTBEATS {
            let count = counted(all.len() as u64, "heartbeat");
            records.add(Rule::RandomDestination, Sample::Unsure, format!("{count} only"), &[]);
        } else if all.iter().all(|it| it == first) {
            let text = format!("DST {first} in all {} heartbeats", all.len());
            records.add(Rule::RandomDestination, Sample::Broken, text, &frames);
        } else {
            let mut distinct = all.clone();
            distinct.sort_unstable();
            distinct.dedup();
            let text = format!("{} values in {} heartbeats", distinct.len(), all.len());
            records.add(Rule::RandomDestination, Sample::Kept, text, &[]);
        }
    }

    fn judge_uid(&self, now: Instant, records: &mut Records) {
        let Some(uid) = self.uid().filter(|_| self.uid_heartbeats > 2) else { return };
        let keys = [ProfileKey::Heartbeat, ProfileKey::UidOffset];
        records.depends_on(Rule::UidUnique, &keys, &self.profile);
        records.depends_on(Rule::UidSetInWork, &keys, &self.profile);
        let last = self.heartbeats.back().map(|it| it.frame);
        let window = self.profile.heartbeat.period() * 5 / 2;
        let is_present = last.is_some_and(|it| now.since(it.time) < window);
        let twin = self.others.iter().enumerate().find(|(_, it)| {
            it.same_uid >= 3 && it.last_seen.is_some_and(|at| now.since(at) < window)
        });
        let text = uid.text(&self.profile.uid);
        if uid.is_blank() {
            records.add(Rule::UidUnique, Sample::Unsure, "no UID is set", &[]);
        } else if let Some((address, twin)) = twin.filter(|_| is_present) {
            let frames: Vec<Frame> = last.into_iter().chain(twin.last_heartbeat).collect();
            let text = format!("the device at {address} has the UID {text}, too");
            records.add(Rule::UidUnique, Sample::Broken, text, &frames);
        } else {
            records.add(Rule::UidUnique, Sample::Kept, format!("UID {text}"), &[]);
        }
        let was_working = self.heartbeats.iter().any(|it| !is_from_non_working(&it.frame));
        if self.blank_in_work.len() >= 2 {
            let text = "works without a UID";
            records.add(Rule::UidSetInWork, Sample::Broken, text, &self.blank_in_work);
        } else if was_working {
            records.add(Rule::UidSetInWork, Sample::Kept, format!("UID {text}"), &[]);
        } else {
            let text = "was not seen in a working mode";
            records.add(Rule::UidSetInWork, Sample::Unsure, text, &[]);
        }
    }
}

/// Heartbeats that are not one in each interval.
struct IntervalFault {
    is_too_few: bool,
    text: String,
    frames: Vec<Frame>,
    /// Place of the last of them.
    end: usize,
}

/// Time between two moments, in seconds.
fn seconds(later: Instant, earlier: Instant) -> f64 {
    later.since(earlier).as_secs_f64()
}

fn interval_fault(beats: &[&SeenHeartbeat], period: f64) -> Option<IntervalFault> {
    for first in 0..beats.len() {
        for second in first + 1..beats.len() {
            let count = (second - first) as f64;
            let (one, two) = (beats[first], beats[second]);
            let longest = seconds(two.frame.time, one.from);
            let shortest = seconds(two.from, one.frame.time);
            let is_too_few = shortest > (count + 1.0) * period * (1.0 + CLOCK_TOLERANCE);
            if is_too_few || longest < (count - 1.0) * period * (1.0 - CLOCK_TOLERANCE) {
                let beats = &beats[first..=second];
                let number = counted(beats.len() as u64, "heartbeat");
                let text = if is_too_few {
                    format!("only {number} in {shortest:.3} s")
                } else {
                    format!("{number} in {longest:.3} s")
                };
                let frames = beats.iter().map(|beat| beat.frame).take(MAX_FRAMES).collect();
                return Some(IntervalFault { is_too_few, text, frames, end: second });
            }
        }
    }
    None
}

/// Returns true if heartbeats are so few that it is not because some were not received.
fn is_slow(beats: &[&SeenHeartbeat], period: f64) -> bool {
    let gaps = beats.windows(2).map(|two| seconds(two[1].from, two[0].frame.time));
    let gaps: Vec<f64> = gaps.collect();
    let is_regular = gaps.iter().all(|gap| *gap > period * (1.0 + CLOCK_TOLERANCE));
    let mean = gaps.iter().sum::<f64>() / gaps.len().max(1) as f64;
    gaps.len() >= SLOW_INTERVALS && (is_regular || mean > period * SLOW_PERIODS)
}

/// Returns true if heartbeats come in two phases: two devices, or one with two timers.
fn has_two_phases(beats: &[&SeenHeartbeat], period: f64) -> bool {
    let gaps: Vec<f64> =
        beats.windows(2).map(|two| seconds(two[1].frame.time, two[0].frame.time)).collect();
    let is_pair = |two: &&[f64]| {
        (two[0] + two[1] - period).abs() < 0.1 * period && (two[0] - two[1]).abs() > 0.1 * period
    };
    let pairs = gaps.windows(2).filter(is_pair).count();
    gaps.len() >= 6 && pairs * 10 >= gaps.len() * 7
}

fn is_from_non_working(frame: &Frame) -> bool {
    frame.platform_id().is_some_and(|id| Header::decode(id).from_non_working)
}

/// Adds a frame, unless there are enough.
fn push(frames: &mut Vec<Frame>, frame: &Frame) {
    if frames.len() < MAX_FRAMES {
        frames.push(*frame);
    }
}
