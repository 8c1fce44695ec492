//! The boards of an address conflict: which heartbeat is of which board.
//!
//! Input: the heartbeats of an address, and the UIDs that the finding lists. Output: two or more sides
//! in the order of joining, and the side of each heartbeat. Boards are distinguished by their UIDs, where
//! these are blank or equal by the phase of their heartbeats; a heartbeat that fits several sides has
//! none. Does not know names, des.json or how sides are shown.

use crate::app::capture::CapturedHeartbeat;
use crate::finding::SeenUid;
use crate::time::{Duration, Instant};
use crate::wire::node::{Mode, Uid};
use std::ops::Range;

/// Most boards whose phases are distinguished.
const MAX_PHASES: usize = 4;
/// Fewest intervals that show how many boards there are: two cycles of four boards.
const MIN_INTERVALS: usize = 6;
/// Heartbeats at the end of the conflict that show the phases: three cycles of as many boards.
const PHASE_BEATS: usize = 24;
/// Largest deviation from a whole period, in periods, of a heartbeat of a board: as in discovery.
const SAME_PHASE: f64 = 0.12;
/// Periods without a heartbeat after which a phase may be that of another board, or of a reboot.
const PHASE_LOST_PERIODS: f64 = 5.5;
/// Gap between heartbeats, in periods, from which at least one is missed.
const MISSED_PERIODS: f64 = 1.4;
/// Periods without a heartbeat after which a board is away.
const AWAY_PERIODS: f64 = 5.0;
/// Intervals that the jitter is of.
const JITTER_BEATS: usize = 60;
/// Deviation from a period that is no interval of two heartbeats one after the other.
const INTERVAL_TOLERANCE: f64 = 0.25;
/// Mode changes that are kept of a side.
const MAX_MODES: usize = 8;

/// What tells the boards of a conflict apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SideBasis {
    /// Their UIDs differ.
    Uids,
    /// Their heartbeats have different phases.
    Phases,
    /// Nothing in the captured heartbeats.
    None,
}

/// One of the boards that use an address.
#[derive(Clone, Debug, PartialEq)]
pub struct ConflictSide {
    /// UID; `None` if it is blank, or that of several boards.
    pub uid: Option<Uid>,
    /// Time of its first heartbeat, after its last absence.
    pub joined: Option<Instant>,
    /// Time of its first heartbeat, before any absence.
    pub first: Option<Instant>,
    /// Its first heartbeat was a claim of the address, in INIT or ARSLV.
    pub has_claimed: bool,
    /// Its heartbeats in the capture.
    pub beats: usize,
    /// Time of the last one.
    pub last: Option<Instant>,
    /// Mean interval.
    pub period: Option<Duration>,
    /// 95 % of the last 60 intervals deviate by at most this.
    pub jitter: Option<Duration>,
    /// Heartbeats missing between the others, without its absences.
    pub missed: u64,
    /// Times without a heartbeat for more than five periods: it was unplugged, or moved.
    pub absences: usize,
    /// Modes with the time of the first heartbeat in each, oldest first, at most 8.
    pub modes: Vec<(Instant, Mode)>,
}

impl ConflictSide {
    fn new(uid: Option<Uid>, joined: Option<Instant>) -> Self {
        Self {
            uid,
            joined,
            first: joined,
            has_claimed: false,
            beats: 0,
            last: None,
            period: None,
            jitter: None,
            missed: 0,
            absences: 0,
            modes: Vec::new(),
        }
    }

    /// Time of a heartbeat within its period; `None` if there are none, or if periods are not known.
    pub fn offset_to(&self, other: &Self) -> Option<Duration> {
        let (period, own, other_last) = (self.period?, self.last?, other.last?);
        // With another period the offset changes with time.
        let drift = period.as_secs_f64() / other.period?.as_secs_f64() - 1.0;
        if drift.abs() > 0.005 {
            return None;
        }
        let (own, other) = (i128::from(own.as_micros()), i128::from(other_last.as_micros()));
        let period = i128::try_from(period.as_micros()).ok()?.max(1);
        let offset = (own - other).rem_euclid(period);
        Some(Duration::from_micros(u64::try_from(offset).ok()?))
    }
}

/// The boards of a conflict.
#[derive(Clone, Debug, PartialEq)]
pub struct ConflictSides {
    /// What tells them apart.
    pub basis: SideBasis,
    /// The one that was there first at the start.
    pub sides: Vec<ConflictSide>,
    /// The moment from which on all heartbeats are known; `None`: from the start.
    pub complete_from: Option<Instant>,
    /// The heartbeats, oldest first.
    beats: Vec<CapturedHeartbeat>,
    /// Side of each of them; `None` if it may be of several.
    of_beats: Vec<Option<usize>>,
}

/// A UID that is not blank.
fn known(uid: Option<Uid>) -> Option<Uid> {
    uid.and_then(Uid::not_blank)
}

impl ConflictSides {
    /// Tells the boards apart. `beats`: heartbeats of the address, oldest first; `boards`: UIDs of the
    /// finding; `during`: first and last evidence.
    pub fn new(
        beats: &[CapturedHeartbeat],
        boards: &[SeenUid],
        during: Range<Instant>,
        period: Duration,
    ) -> Self {
        let margin = period * 2;
        let around = during.start - margin..during.end + margin;
        let recent = beats.iter().filter(|beat| around.contains(&beat.time));
        let mut uids: Vec<Option<Uid>> = Vec::new();
        for uid in boards.iter().map(|board| Some(board.uid)).chain(recent.map(|it| known(it.uid)))
        {
            if !uids.contains(&uid) {
                uids.push(uid);
            }
        }
        if uids.len() > 1 {
            return Self::by_uid(beats, boards, &uids, period);
        }
        Self::by_phase(beats, &around, period).unwrap_or(Self {
            basis: SideBasis::None,
            sides: Vec::new(),
            complete_from: None,
            of_beats: vec![None; beats.len()],
            beats: beats.to_vec(),
        })
    }

    fn by_uid(
        beats: &[CapturedHeartbeat],
        boards: &[SeenUid],
        uids: &[Option<Uid>],
        period: Duration,
    ) -> Self {
        let new_side = |uid: &Option<Uid>| {
            let listed = boards.iter().find(|board| Some(board.uid) == *uid);
            let captured = beats.iter().find(|beat| known(beat.uid) == *uid).map(|beat| beat.time);
            let joined = listed.map(|board| board.since).or(captured);
            let first = listed.map(|board| board.first).or(captured);
            ConflictSide { first, ..ConflictSide::new(*uid, joined) }
        };
        let mut sides: Vec<ConflictSide> = uids.iter().map(new_side).collect();
        sides.sort_by_key(|side| (side.first, side.joined));
        let side_of =
            |beat: &CapturedHeartbeat| sides.iter().position(|side| side.uid == known(beat.uid));
        let of_beats: Vec<Option<usize>> = beats.iter().map(side_of).collect();
        let beats = beats.to_vec();
        let mut all = Self { basis: SideBasis::Uids, sides, complete_from: None, beats, of_beats };
        all.measure(period);
        all
    }

    /// Tells boards with blank or equal UIDs apart; `None` if their phases do not show them.
    fn by_phase(
        beats: &[CapturedHeartbeat],
        around: &Range<Instant>,
        nominal: Duration,
    ) -> Option<Self> {
        let end = beats.partition_point(|beat| beat.time < around.end);
        let begin = beats.partition_point(|beat| beat.time < around.start);
        let window = begin.max(end.saturating_sub(PHASE_BEATS))..end;
        let times: Vec<f64> =
            beats[window.clone()].iter().map(|beat| beat.time.as_secs_f64()).collect();
        let nominal = nominal.as_secs_f64();
        let (count, period, noise) = senders(&times, nominal)?;
        // One cycle in the middle of the window, in which all of them are there.
        let at = (times.len() - count) / 2;
        let cycle = &times[at..at + count];
        let gaps = cycle.windows(2).map(|two| two[1] - two[0]);
        let turn = period - (cycle[count - 1] - cycle[0]);
        let closest = gaps.chain([turn]).fold(f64::MAX, f64::min);
        if closest < 3.0 * noise || closest <= 0.0 {
            return None;
        }
        let mut of_beats = vec![None; beats.len()];
        let middle = window.start + at;
        for (side, beat) in (middle..middle + count).enumerate() {
            of_beats[beat] = Some(side);
        }
        let mut forward: Vec<f64> = cycle.to_vec();
        for (at, beat) in beats.iter().enumerate().skip(middle + count) {
            of_beats[at] = follow(&mut forward, beat.time.as_secs_f64(), period);
        }
        let mut backward: Vec<f64> = cycle.to_vec();
        for at in (0..middle).rev() {
            of_beats[at] = follow(&mut backward, beats[at].time.as_secs_f64(), period);
        }
        let first = |side: usize| of_beats.iter().position(|it| *it == Some(side));
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by_key(|side| first(*side));
        let uid = known(beats[middle].uid);
        let sides =
            order.iter().map(|side| ConflictSide::new(uid, first(*side).map(|at| beats[at].time)));
        let sides: Vec<ConflictSide> = sides.collect();
        for side in of_beats.iter_mut().flatten() {
            *side = order.iter().position(|it| it == side).unwrap_or(0);
        }
        let beats = beats.to_vec();
        let mut all =
            Self { basis: SideBasis::Phases, sides, complete_from: None, beats, of_beats };
        all.measure(Duration::from_secs_f64(period));
        Some(all)
    }

    /// Sets what the heartbeats of each side show.
    fn measure(&mut self, nominal: Duration) {
        for (place, side) in self.sides.iter_mut().enumerate() {
            let own = self.beats.iter().zip(&self.of_beats).filter(|(_, of)| **of == Some(place));
            // Those of an earlier stay are not of the board that joined then.
            let own = own.map(|(beat, _)| beat).filter(|beat| Some(beat.time) >= side.joined);
            let own: Vec<&CapturedHeartbeat> = own.collect();
            side.beats = own.len();
            side.last = own.last().map(|beat| beat.time);
            side.has_claimed = own.first().is_some_and(|beat| {
                side.joined == Some(beat.time)
                    && matches!(beat.mode, Some(Mode::Init | Mode::Arslv))
            });
            for beat in &own {
                let Some(mode) = beat.mode else { continue };
                if side.modes.last().is_none_or(|(_, last)| *last != mode) {
                    if side.modes.len() == MAX_MODES {
                        side.modes.remove(0);
                    }
                    side.modes.push((beat.time, mode));
                }
            }
            let gaps: Vec<f64> =
                own.windows(2).map(|two| two[1].time.since(two[0].time).as_secs_f64()).collect();
            let nominal = nominal.as_secs_f64();
            let is_interval = |gap: &&f64| (*gap / nominal - 1.0).abs() < INTERVAL_TOLERANCE;
            let intervals: Vec<f64> = gaps.iter().filter(is_interval).copied().collect();
            let is_absence = |gap: &f64| *gap > AWAY_PERIODS * nominal;
            side.absences = gaps.iter().filter(|gap| is_absence(gap)).count();
            let present = gaps.iter().filter(|gap| !is_absence(gap));
            side.missed = present.map(|gap| missed_in(*gap / nominal)).sum();
            if intervals.is_empty() {
                continue;
            }
            let mean = intervals.iter().sum::<f64>() / intervals.len() as f64;
            side.period = Some(Duration::from_secs_f64(mean));
            let mut deviations: Vec<f64> = intervals
                .iter()
                .rev()
                .take(JITTER_BEATS)
                .map(|interval| (interval - mean).abs())
                .collect();
            deviations.sort_by(f64::total_cmp);
            let at = (deviations.len() * 95).div_ceil(100).saturating_sub(1);
            side.jitter = Some(Duration::from_secs_f64(deviations[at]));
        }
    }

    /// The heartbeats by which the boards were distinguished, each with its side, oldest first.
    pub fn beats(&self) -> impl DoubleEndedIterator<Item = (&CapturedHeartbeat, Option<usize>)> {
        self.beats.iter().zip(self.of_beats.iter().copied())
    }

    /// Side of a heartbeat with this time and UID; `None` if it may be of several.
    pub fn side_of(&self, time: Instant, uid: Option<Uid>) -> Option<usize> {
        if self.basis == SideBasis::Uids {
            return self.sides.iter().position(|side| side.uid == known(uid));
        }
        let at = self.beats.binary_search_by_key(&time, |beat| beat.time).ok()?;
        self.of_beats[at]
    }

    /// Returns true if this side sent no heartbeat for five periods before `now`.
    pub fn has_left(&self, side: usize, now: Instant, period: Duration) -> bool {
        let last = self.sides.get(side).and_then(|side| side.last);
        last.is_some_and(|last| now.since(last) > period.mul_f64(AWAY_PERIODS))
    }
}

/// Heartbeats missed in a gap of so many periods.
pub(in crate::app) fn missed_in(periods: f64) -> u64 {
    if periods < MISSED_PERIODS { 0 } else { periods.round() as u64 - 1 }
}

/// Number of senders whose heartbeats come in turn, their period, and the deviation of their
/// intervals from it; `None` for one sender, or without a pattern.
fn senders(times: &[f64], nominal: f64) -> Option<(usize, f64, f64)> {
    let mut best: Option<(usize, usize, f64, f64)> = None;
    for count in 1..=MAX_PHASES {
        let intervals: Vec<f64> = times.windows(count + 1).map(|it| it[count] - it[0]).collect();
        if intervals.len() < MIN_INTERVALS {
            break;
        }
        let is_period = |it: &&f64| (**it / nominal - 1.0).abs() < INTERVAL_TOLERANCE;
        let mut whole: Vec<f64> = intervals.iter().filter(is_period).copied().collect();
        // Losses make some intervals longer.
        if whole.len() * 10 < intervals.len() * 6 {
            continue;
        }
        whole.sort_by(f64::total_cmp);
        let period = whole[whole.len() / 2];
        let mut deviations: Vec<f64> = whole.iter().map(|it| (it - period).abs()).collect();
        deviations.sort_by(f64::total_cmp);
        let noise = deviations[deviations.len() * 3 / 4];
        let share = whole.len() * 1000 / intervals.len();
        if best.is_none_or(|(most, ..)| share > most) {
            best = Some((share, count, period, noise));
        }
    }
    best.filter(|(_, count, ..)| *count > 1).map(|(_, count, period, noise)| (count, period, noise))
}

/// Deviation of two times from whole periods, in periods.
fn deviation(one: f64, other: f64, period: f64) -> f64 {
    let periods = (one - other) / period;
    (periods - periods.round()).abs()
}

/// The phase that a heartbeat has, if no other one fits half as well.
fn nearest(phases: &[f64], time: f64, period: f64) -> Option<usize> {
    let mut fits: Vec<(f64, usize)> =
        phases.iter().enumerate().map(|(at, it)| (deviation(time, *it, period), at)).collect();
    fits.sort_by(|one, other| one.0.total_cmp(&other.0));
    let (best, side) = *fits.first()?;
    let is_clear = fits.get(1).is_none_or(|(second, _)| best * 2.0 < *second);
    (best < SAME_PHASE && is_clear).then_some(side)
}

/// The phase that a heartbeat has, which follows it: the clocks of boards drift.
fn follow(phases: &mut [f64], time: f64, period: f64) -> Option<usize> {
    let side = nearest(phases, time, period)?;
    let is_near = (time - phases[side]).abs() < PHASE_LOST_PERIODS * period;
    is_near.then(|| {
        phases[side] = time;
        side
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::profile::Profile;

    const PERIOD: Duration = Duration::from_secs(1);

    fn beat(millis: u64, uid: u8) -> CapturedHeartbeat {
        CapturedHeartbeat {
            number: millis,
            time: Instant::from_micros(millis * 1000),
            uid: Some(Uid([uid; 6])),
            mode: Some(Mode::Work),
            is_working: true,
        }
    }

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    fn seen(uid: u8, first: u64, since: u64) -> SeenUid {
        let (uid, text) = (Uid([uid; 6]), Uid([uid; 6]).text(&Profile::default().uid));
        SeenUid { uid, text, since: at(since), first: at(first) }
    }

    #[test]
    fn boards_with_uids_are_in_the_order_of_joining() {
        let mut beats: Vec<_> = (0..20).map(|at| beat(791 + 1000 * at, 1)).collect();
        beats.extend((5..20).map(|at| beat(819 + 1000 * at, 2)));
        beats.sort_by_key(|beat| beat.time);
        let (one, two) = (Uid([1; 6]), Uid([2; 6]));
        let boards = [seen(2, 5819, 5819), seen(1, 791, 791)];
        let sides = ConflictSides::new(&beats, &boards, at(5819)..at(20_000), PERIOD);
        let uids: Vec<Option<Uid>> = sides.sides.iter().map(|side| side.uid).collect();
        assert_eq!((sides.basis, uids), (SideBasis::Uids, vec![Some(one), Some(two)]));
        assert_eq!((sides.sides[0].beats, sides.sides[1].beats), (20, 15));
        assert_eq!(sides.sides[1].offset_to(&sides.sides[0]), Some(Duration::from_millis(28)));
        assert_eq!(sides.side_of(at(30_000), Some(two)), Some(1));
        assert_eq!(sides.side_of(at(30_000), None), None);
    }

    #[test]
    fn boards_with_blank_uids_are_told_apart_by_phase() {
        let mut beats: Vec<_> = (0..40).map(|at| beat(791 + 1001 * at, 0)).collect();
        beats.extend((10..40).map(|at| beat(219 + 1000 * at, 0)));
        beats.sort_by_key(|beat| beat.time);
        let sides = ConflictSides::new(&beats, &[], at(10_219)..at(40_000), PERIOD);
        assert_eq!(sides.basis, SideBasis::Phases);
        assert_eq!(sides.sides[0].joined, Some(at(791)));
        assert_eq!(sides.sides[1].joined, Some(at(10_219)));
        assert_eq!((sides.sides[0].beats, sides.sides[1].beats), (40, 30));
        assert_eq!((sides.sides[0].missed, sides.sides[1].missed), (0, 0));
        assert_eq!(sides.side_of(at(33_219), None), Some(1));
    }

    #[test]
    fn board_that_came_back_has_only_the_heartbeats_since() {
        let mut beats: Vec<_> = (0..60).map(|at| beat(791 + 1000 * at, 1)).collect();
        beats.extend((5..12).map(|at| beat(219 + 1000 * at, 2)));
        beats.extend((40..60).map(|at| beat(555 + 1000 * at, 2)));
        beats.sort_by_key(|beat| beat.time);
        let boards = [seen(1, 791, 791), seen(2, 5219, 40_555)];
        let sides = ConflictSides::new(&beats, &boards, at(40_555)..at(59_000), PERIOD);
        let second = &sides.sides[1];
        assert_eq!((second.joined, second.beats), (Some(at(40_555)), 20));
        assert_eq!((second.missed, second.absences), (0, 0));
        assert!(second.modes.iter().all(|(since, _)| *since >= at(40_555)));
    }

    #[test]
    fn board_that_was_there_first_and_came_back_is_the_first_one() {
        let mut beats: Vec<_> = (0..10).map(|at| beat(791 + 1000 * at, 1)).collect();
        beats.extend((20..60).map(|at| beat(219 + 1000 * at, 2)));
        beats.extend((40..60).map(|at| beat(791 + 1000 * at, 1)));
        beats.sort_by_key(|beat| beat.time);
        let boards = [seen(2, 20_219, 20_219), seen(1, 791, 40_791)];
        let sides = ConflictSides::new(&beats, &boards, at(40_791)..at(59_000), PERIOD);
        let first = &sides.sides[0];
        assert_eq!((first.uid, first.first), (Some(Uid([1; 6])), Some(at(791))));
        assert_eq!((first.joined, first.beats), (Some(at(40_791)), 20));
    }

    #[test]
    fn absence_of_a_board_is_no_row_of_misses() {
        let mut beats: Vec<_> = (0..60).map(|at| beat(791 + 1000 * at, 1)).collect();
        // Two are missed; then it is away for 20 s.
        let second = (10..40).filter(|at| ![15, 17].contains(at) && !(20..30).contains(at));
        beats.extend(second.map(|at| beat(219 + 1000 * at, 2)));
        beats.sort_by_key(|beat| beat.time);
        let sides = ConflictSides::new(&beats, &[], at(10_219)..at(40_000), PERIOD);
        let counts = |at: usize| (sides.sides[at].missed, sides.sides[at].absences);
        assert_eq!((counts(0), counts(1)), ((0, 0), (2, 1)));
    }

    #[test]
    fn phases_that_cannot_be_told_apart_have_no_sides() {
        // One board at half the period, and heartbeats at random.
        let even: Vec<_> = (0..40).map(|at| beat(500 * at, 0)).collect();
        let alone: Vec<_> = (0..40).map(|at| beat(1000 * at, 0)).collect();
        let mut random = fastrand::Rng::with_seed(3);
        let mut time = 0;
        let noisy = (0..40).map(|_| {
            time += random.u64(50..900);
            beat(time, 0)
        });
        for beats in [alone, noisy.collect(), Vec::new()] {
            let sides = ConflictSides::new(&beats, &[], at(5000)..at(40_000), PERIOD);
            assert_eq!((sides.basis, sides.sides.len()), (SideBasis::None, 0));
            assert!(sides.beats().all(|(_, side)| side.is_none()));
        }
        // Half a period apart two boards look like one; the finding says that there are two.
        let sides = ConflictSides::new(&even, &[], at(5000)..at(20_000), PERIOD);
        assert_eq!(sides.sides.len(), 2);
    }
}
