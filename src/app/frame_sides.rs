//! The boards at shared addresses that sent the frames of a list.
//!
//! Inputs: frames, the confirmed conflicts of the moment that is shown. Output: the side of each
//! heartbeat, A for the board that joined first. Other frames do not show which board sent them. Bounded:
//! eight addresses. Does not know what distinguishes sides, nor how they are drawn.

use super::problems::{ConflictSides, SideBasis};
use super::{App, ProblemKey};
use crate::finding::FindingState;
use crate::frame::{BusIndex, Frame};
use crate::wire::id::{Address, Header};

/// Most addresses whose boards are distinguished for one list: more conflicts are hardly shown at
/// once, and each costs a walk through its heartbeats.
const MAX_ADDRESSES: usize = 8;

/// The boards at the shared addresses of a list of frames.
#[derive(Debug, Default)]
pub struct FrameSides {
    addresses: Vec<(BusIndex, Address, ConflictSides)>,
}

impl FrameSides {
    /// The board that sent a frame; `None` where nothing shows it.
    pub fn side_of(&self, app: &App, frame: &Frame) -> Option<usize> {
        let source = source_of(frame)?;
        let is_it = |(bus, address, _): &&(BusIndex, Address, ConflictSides)| {
            *bus == frame.bus && *address == source
        };
        let (.., sides) = self.addresses.iter().find(is_it)?;
        app.side_of_frame(sides, frame)
    }
}

fn source_of(frame: &Frame) -> Option<Address> {
    frame.platform_id().map(|id| Header::decode(id).source)
}

impl App {
    /// The boards at those addresses with a confirmed conflict that sent some of these frames.
    pub fn frame_sides(&self, frames: &[Frame]) -> FrameSides {
        let mut addresses: Vec<(BusIndex, Address, ConflictSides)> = Vec::new();
        for problem in self.problems().iter() {
            if problem.state() != FindingState::Confirmed {
                continue;
            }
            let ProblemKey::Address(bus, address) = problem.key else { continue };
            let is_shown = frames.iter().any(|it| it.bus == bus && source_of(it) == Some(address));
            let sides = is_shown.then(|| self.conflict_sides(&problem)).flatten();
            if let Some(sides) = sides.filter(|sides| sides.basis != SideBasis::None) {
                addresses.push((bus, address, sides));
            }
            if addresses.len() == MAX_ADDRESSES {
                break;
            }
        }
        FrameSides { addresses }
    }
}
