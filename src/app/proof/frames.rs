//! The frames of a proof: the evidence, and the frames of its bus around each piece.

use super::MAX_FRAMES;
use crate::app::capture::frame_store::FrameStore;
use crate::app::problems::{EvidenceItem, Problem};
use crate::app::{AROUND_EVIDENCE, App};
use crate::frame::Frame;
use crate::log::pcapng;
use crate::time::{Duration, Instant};
use std::collections::BTreeMap;
use std::ops::Range;

/// Kept frames around evidence begin so soon after the beginning of their time.
const BEGINS_WITHIN: Duration = Duration::from_millis(100);

/// The evidence of a problem and the frames around it.
pub struct ProofFrames {
    /// Stored pieces, oldest first.
    pub pieces: Vec<EvidenceItem>,
    /// Number of stored pieces from before the problem began, which are left out.
    pub earlier: usize,
    /// Frames in the order of time, each with the place of its piece of evidence.
    pub frames: Vec<(Frame, Option<usize>)>,
    /// The moment from which the pieces are.
    pub begin: Instant,
    /// Pieces of whose surroundings frames are missing: they are no longer captured, or too many.
    pub incomplete: usize,
}

/// Returns the evidence of a problem, with the frames of a second before and after each piece as far as
/// they are captured. If those are too many, the nearest ones.
pub fn of_problem(app: &App, problem: &Problem) -> ProofFrames {
    let mut pieces = problem.evidence();
    // The address may have been contested before, by other boards or in another state.
    let all = pieces.len();
    let boards = problem.boards();
    let second = boards.get(1).filter(|_| problem.is_address_conflict());
    let joined = second.map_or(problem.began(), |board| board.since.min(problem.began()));
    let begin = joined - AROUND_EVIDENCE;
    if pieces.iter().any(|piece| piece.time >= begin) {
        pieces.retain(|piece| piece.time >= begin);
    }
    let earlier = all - pieces.len();
    let (capture, end) = (&app.traffic.capture, app.traffic.end(&app.view));
    let each = MAX_FRAMES / (2 * pieces.len().max(1));
    let mut numbered: BTreeMap<u64, (Frame, Option<usize>)> = BTreeMap::new();
    let mut stored = Vec::new();
    let mut incomplete = 0;
    for (place, piece) in pieces.iter().enumerate() {
        let number = piece.frame.and_then(|frame| app.captured(&frame));
        let middle = number.unwrap_or_else(|| capture.at_time(piece.time));
        let time = piece.time - AROUND_EVIDENCE..piece.time + AROUND_EVIDENCE;
        let get = |number: u64| Some((number, capture.get(number)?));
        let is_near = |(_, frame): &(u64, Frame)| time.contains(&frame.time);
        let is_of_bus = |(_, frame): &(u64, Frame)| problem.bus().is_none_or(|it| it == frame.bus);
        let before = capture.numbers_before(middle).filter_map(get).take_while(is_near);
        let known = capture.numbers_from(middle).take_while(|number| *number < end);
        let after = known.filter_map(get).take_while(is_near);
        let before: Vec<_> = before.filter(is_of_bus).take(each).collect();
        let after: Vec<_> = after.filter(is_of_bus).take(each).collect();
        let is_whole = before.len() < each && after.len() < each && is_stored(capture, &time);
        incomplete += usize::from(!is_whole);
        for (number, frame) in before.into_iter().chain(after) {
            numbered.entry(number).or_insert((frame, None));
        }
        match (number, piece.frame) {
            (Some(number), Some(frame)) => {
                numbered.insert(number, (frame, Some(place)));
            }
            (None, Some(frame)) => stored.push((frame, Some(place))),
            (_, None) => {}
        }
    }
    let mut frames: Vec<(Frame, Option<usize>)> = numbered.into_values().chain(stored).collect();
    frames.sort_by_key(|(frame, _)| frame.time);
    ProofFrames { pieces, earlier, frames, begin, incomplete }
}

/// Returns true if all frames of a time are stored, as far as is known: kept frames around evidence
/// begin with the first one of their time.
fn is_stored(capture: &FrameStore, time: &Range<Instant>) -> bool {
    let (first, end) = (capture.at_time(time.start), capture.at_time(time.end));
    let begins = first.checked_sub(1).is_none_or(|before| capture.get(before).is_some())
        || capture.time_of(first).is_some_and(|at| at.since(time.start) < BEGINS_WITHIN);
    begins && capture.missing_between(first, end) == 0
}

/// Returns the frames as pcapng. A comment names the piece of evidence that a packet is.
pub fn as_pcapng(app: &App, problem: &Problem, proof: &ProofFrames) -> Vec<u8> {
    let mut out = Vec::new();
    let headline = app.headline(problem).full;
    let mut buses = Vec::new();
    // Writing to memory does not fail.
    let _ = pcapng::write_section_about(&mut out, &headline);
    for (frame, piece) in &proof.frames {
        let known = buses.iter().position(|bus| *bus == frame.bus);
        let interface = known.unwrap_or_else(|| {
            let name = app.bus(frame.bus).map_or("can", |bus| bus.name.as_str());
            let _ = pcapng::write_interface(&mut out, name);
            buses.push(frame.bus);
            buses.len() - 1
        });
        let comment = piece.and_then(|at| Some((at, proof.pieces.get(at)?)));
        let comment = comment
            .map_or(String::new(), |(at, piece)| format!("evidence {}: {}", at + 1, piece.what));
        let micros = app.epoch().unix_micros(frame.time);
        let _ = pcapng::write_frame_with(&mut out, interface as u32, micros, frame, &comment);
    }
    out
}
