//! Bytes of the heartbeat: UID, mode and error code.
//!
//! The UID is constant in each node and another one in each; the mode differs between frames with
//! U = 0 and those with U = 1; the error code is 0 but in one mode in which a node works.

use super::heartbeat::Heartbeats;
use super::unsolicited::{SenderContent, UnsolicitedSender};
use super::{Certainty, MAX_FRAMES, ProfileProposal};
use crate::frame::Frame;
use crate::text::counted;
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};
use crate::wire::profile::{ProfileKey, ProfileValue, UidProfile};
use std::collections::BTreeSet;

/// Different UIDs that show where they are.
const MIN_UIDS: usize = 3;
/// Values of a byte that shows by itself that it belongs to the UID: more than modes of nodes with one
/// U bit may be.
const MIN_VALUES: usize = 3;
/// Modes in which a node works: WORK and UFUNC.
const WORKING_MODES: usize = 2;
/// Part of the nodes in which a byte of the UID is constant, at least: a board may have been replaced.
const MIN_CONSTANT: f64 = 0.75;

/// Returns true if no content of the first is one of the second, and both are as long as asked.
pub(super) fn has_other_content(
    one: &UnsolicitedSender,
    other: &UnsolicitedSender,
    length: usize,
) -> bool {
    one.contents
        .iter()
        .all(|a| a.data().len() >= length && other.contents.iter().all(|b| a.data() != b.data()))
}

/// Proposals of the bytes that are known.
pub(super) fn proposals(heartbeats: &Heartbeats<'_>) -> Vec<ProfileProposal> {
    let Some(bytes) = HeartbeatBytes::of(heartbeats) else { return Vec::new() };
    let mode = bytes.mode();
    let uid = bytes.uid(mode.as_ref().map(|mode| mode.at));
    // A byte of the UID is none of the mode.
    let mode = mode.filter(|mode| {
        uid.as_ref().is_none_or(|uid| !(uid.at..uid.at + Uid::LEN).contains(&mode.at))
    });
    let error = mode.as_ref().and_then(|mode| bytes.error(mode.at, uid.as_ref().map(|uid| uid.at)));
    let found = [
        (ProfileKey::UidOffset, uid),
        (ProfileKey::ModeOffset, mode),
        (ProfileKey::ErrorOffset, error),
    ];
    let proposal = |(key, found): (ProfileKey, Option<FoundByte>)| {
        let FoundByte { at, certainty, evidence, mut frames } = found?;
        frames.sort_by_key(|frame| frame.time);
        frames.truncate(MAX_FRAMES);
        let value = ProfileValue::Number(at as u32);
        Some(ProfileProposal { key, value, certainty, evidence, frames })
    };
    found.into_iter().filter_map(proposal).collect()
}

/// A byte of the heartbeat whose meaning is known.
struct FoundByte {
    at: usize,
    certainty: Certainty,
    evidence: String,
    frames: Vec<Frame>,
}

/// How well a byte fits the mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ModeLikeness {
    /// Nodes that work have the same value, the others another one.
    Like,
    /// Nodes that work and those that do not have different values.
    Unknown,
    Unlike,
}

/// Heartbeats of the usual length.
struct HeartbeatBytes<'a> {
    length: usize,
    senders: Vec<(Address, Vec<&'a SenderContent>)>,
}

impl<'a> HeartbeatBytes<'a> {
    /// Those of the length that most nodes have; `None` without data.
    fn of(heartbeats: &Heartbeats<'a>) -> Option<Self> {
        let mut lengths = [0_u32; Frame::MAX_DATA + 1];
        for (_, sender) in &heartbeats.senders {
            for content in &sender.contents {
                lengths[content.data().len()] += content.count;
            }
        }
        let length = (1..lengths.len()).max_by_key(|length| lengths[*length])?;
        let of_sender = |(source, sender): &(Address, &'a UnsolicitedSender)| {
            let contents: Vec<&SenderContent> =
                sender.contents.iter().filter(|it| it.data().len() == length).collect();
            (!contents.is_empty()).then_some((*source, contents))
        };
        let senders: Vec<_> = heartbeats.senders.iter().filter_map(of_sender).collect();
        (lengths[length] > 0).then_some(Self { length, senders })
    }

    fn contents(&self) -> impl Iterator<Item = (Address, &'a SenderContent)> {
        self.senders.iter().flat_map(|(source, all)| all.iter().map(|it| (*source, *it)))
    }

    /// Values of a byte in frames with this U bit, each with the nodes that sent it.
    fn values(&self, at: usize, is_non_working: bool) -> BTreeSet<(u8, Address)> {
        let all = self.contents().filter(|(_, it)| it.is_non_working == is_non_working);
        all.map(|(source, content)| (content.data()[at], source)).collect()
    }

    /// The byte of the mode: its values with U = 0 and with U = 1 differ.
    fn mode(&self) -> Option<FoundByte> {
        let is_mode = |at: &usize| {
            let [working, others] = [false, true].map(|u| self.values(*at, u));
            let numbers = |values: &BTreeSet<(u8, Address)>| -> BTreeSet<u8> {
                values.iter().map(|(value, _)| *value).collect()
            };
            let (a, b) = (numbers(&working), numbers(&others));
            let is_common = |of: &BTreeSet<(u8, Address)>, value: u8| {
                of.iter().filter(|(it, _)| *it == value).count() > 1
            };
            // Several nodes in WORK have the same value; one in UFUNC has an error code of its own.
            a.is_disjoint(&b)
                && a.len() + b.len() <= Mode::ALL.len()
                && a.iter().any(|it| is_common(&working, *it))
        };
        let changed = self.changed();
        let first = changed.first()?;
        let mut candidates = (0..self.length).filter(is_mode);
        let at = candidates.next()?;
        if candidates.next().is_some() {
            return None;
        }
        let values: BTreeSet<u8> = self.contents().map(|(_, it)| it.data()[at]).collect();
        let nodes = counted(changed.len() as u64, "node");
        // A flag has two values, which differ in one bit; codes of modes rarely do.
        let ends = values.first().zip(values.last());
        let is_flag = values.len() == 2 && ends.is_some_and(|(a, b)| (a ^ b).is_power_of_two());
        Some(FoundByte {
            at,
            certainty: match changed.len() {
                _ if is_flag => Certainty::Guess,
                1 => Certainty::Likely,
                _ => Certainty::Certain,
            },
            evidence: format!(
                "{}, changes with U in {nodes}",
                counted(values.len() as u64, "value")
            ),
            frames: first.iter().map(|content| content.frame).collect(),
        })
    }

    /// Contents of the nodes that were working and not working.
    fn changed(&self) -> Vec<&[&'a SenderContent]> {
        let both = |all: &[&SenderContent]| {
            all.iter().any(|it| it.is_non_working) && all.iter().any(|it| !it.is_non_working)
        };
        self.senders.iter().map(|(_, all)| &all[..]).filter(|all| both(all)).collect()
    }

    /// Where the UID begins. `mode`: the byte of the mode, if it is known.
    fn uid(&self, mode: Option<usize>) -> Option<FoundByte> {
        let may_be_uid = |at: &usize| {
            let is_constant =
                |all: &[&SenderContent]| all.iter().all(|it| it.data()[*at] == all[0].data()[*at]);
            let nodes = self.senders.iter().filter(|(_, all)| is_constant(all)).count();
            Some(*at) != mode
                && nodes as f64 >= MIN_CONSTANT * self.senders.len() as f64
                && self.likeness(*at) != ModeLikeness::Like
        };
        let bytes: Vec<usize> = (0..self.length).filter(may_be_uid).collect();
        let span = |of: &dyn Fn(usize) -> bool| {
            let mut all = bytes.iter().copied().filter(|at| of(*at));
            let first = all.next()?;
            Some((first, all.next_back().unwrap_or(first)))
        };
        let length = |(first, last): (usize, usize)| last - first + 1;
        // Bytes with few values may be those of the mode or of the error code.
        let many = |at: usize| self.count_values(at) >= MIN_VALUES;
        let own =
            |at: usize| many(at) && (mode.is_some() || self.likeness(at) == ModeLikeness::Unlike);
        let of_two_values = |at: usize| self.count_values(at) > 1;
        let (first, last) = span(&own).or_else(|| span(&many))?;
        let is_own = span(&own).is_some();
        // A byte at the end may have one value in two nodes.
        let wide = span(&of_two_values).filter(|wide| length(*wide) == Uid::LEN);
        let (first, last) = match wide {
            Some(wide) if last - first + 3 >= Uid::LEN => wide,
            _ => (first, last),
        };
        let is_whole = is_own && length((first, last)) == Uid::LEN;
        if length((first, last)) > Uid::LEN {
            return None;
        }
        let windows = (last + 1).saturating_sub(Uid::LEN)..=first;
        let mut windows: Vec<usize> =
            windows.filter(|at| (*at..at + Uid::LEN).all(|byte| bytes.contains(&byte))).collect();
        if windows.len() > 1 || !is_own || !is_whole && mode.is_none() {
            windows.retain(|at| self.is_text(*at));
        }
        let &[at] = &windows[..] else { return None };
        let uids: BTreeSet<&[u8]> =
            self.contents().map(|(_, content)| &content.data()[at..at + Uid::LEN]).collect();
        // More than one for each node, replaced boards apart: it changes.
        let most = self.senders.len() + self.senders.len() / 4;
        if !(MIN_UIDS..=most).contains(&uids.len()) {
            return None;
        }
        let is_known = is_whole && (at == 0 || mode.is_some());
        let nodes = counted(self.senders.len() as u64, "node");
        Some(FoundByte {
            at,
            certainty: if is_known { Certainty::Certain } else { Certainty::Likely },
            evidence: format!("{nodes}, {}", counted(uids.len() as u64, "value")),
            frames: self.senders.iter().map(|(_, all)| all[0].frame).collect(),
        })
    }

    fn count_values(&self, at: usize) -> usize {
        self.contents().map(|(_, content)| content.data()[at]).collect::<BTreeSet<u8>>().len()
    }

    /// How well a byte fits the mode, by the nodes that work and those that do not.
    fn likeness(&self, at: usize) -> ModeLikeness {
        let [working, others] = [false, true].map(|u| self.values(at, u));
        let differs = !working.is_empty()
            && !others.is_empty()
            && !working.iter().any(|(value, _)| others.iter().any(|(it, _)| it == value));
        let numbers: BTreeSet<u8> = working.iter().map(|(value, _)| *value).collect();
        if !differs || numbers.len() > WORKING_MODES {
            ModeLikeness::Unlike
        } else if numbers.len() < working.len() {
            ModeLikeness::Like
        } else {
            ModeLikeness::Unknown
        }
    }

    /// Returns true if six bytes are capitals and digits in all heartbeats, in the assumed alphabet;
    /// blank ones left out.
    fn is_text(&self, at: usize) -> bool {
        let alphabet = UidProfile::default();
        let is_text = |uid: Uid| {
            let text = uid.text(&alphabet).to_string();
            text.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit())
        };
        let uids = self.contents().filter_map(|(_, content)| {
            let bytes = content.data()[at..].first_chunk::<{ Uid::LEN }>()?;
            Uid(*bytes).not_blank()
        });
        let uids: BTreeSet<Uid> = uids.collect();
        uids.len() >= MIN_UIDS && uids.into_iter().all(is_text)
    }

    /// The byte of the error code: other than 0 in all frames of one mode in which nodes work, and 0 in
    /// all others.
    fn error(&self, mode: usize, uid: Option<usize>) -> Option<FoundByte> {
        let is_free =
            |at: &usize| *at != mode && uid.is_none_or(|uid| !(uid..uid + Uid::LEN).contains(at));
        let with_error = |at: usize| -> Vec<&SenderContent> {
            self.contents().map(|(_, it)| it).filter(|it| it.data()[at] != 0).collect()
        };
        let is_error = |at: &usize| {
            let faulty = with_error(*at);
            let Some(first) = faulty.first() else { return false };
            let code = first.data()[mode];
            let all = || self.contents().map(|(_, it)| it);
            let of_one_mode = all().all(|it| (it.data()[*at] != 0) == (it.data()[mode] == code));
            // A node that changes between this mode and another one in which it works.
            let changes = self.senders.iter().any(|(_, own)| {
                let works = |is_faulty| {
                    own.iter().any(|it| !it.is_non_working && (it.data()[*at] != 0) == is_faulty)
                };
                works(true) && works(false)
            });
            of_one_mode && changes && faulty.iter().all(|it| !it.is_non_working)
        };
        let mut candidates = (0..self.length).filter(is_free).filter(is_error);
        let at = candidates.next()?;
        if candidates.next().is_some() {
            return None;
        }
        let frames: Vec<Frame> = with_error(at).iter().map(|it| it.frame).collect();
        let count: u32 = with_error(at).iter().map(|it| it.count).sum();
        Some(FoundByte {
            at,
            certainty: Certainty::Likely,
            evidence: format!("not 0 in {}, in one mode", counted(count as u64, "heartbeat")),
            frames,
        })
    }
}
