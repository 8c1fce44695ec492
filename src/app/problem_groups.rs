//! Problems: the findings as people read them, one row per thing that is wrong.
//!
//! Two devices at one address show themselves in several ways, and each way is a finding of its
//! own; here they are one problem. A problem can be muted: it stays in the list and does not
//! count. What is found, and how sure that is, stays with the findings.

use super::App;
use crate::finding::{Confidence, Finding, FindingKey, Grouping};
use crate::frame::{BusIndex, Frame};
use crate::keymap::Action;
use crate::text::Name;
use crate::time::Instant;
use crate::wire::id::Address;
use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Which problem: the selection and the muting hold on to this while findings come and go.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ProblemKey {
    /// Two devices at one address of a bus, whatever shows it.
    Shared(BusIndex, Address),
    /// Anything else is a problem by itself.
    Finding(FindingKey),
}

impl ProblemKey {
    /// The problem that a finding belongs to.
    pub fn of(key: &FindingKey) -> Self {
        let shared = key.kind.facts().grouping == Grouping::Address;
        match (key.bus, key.address) {
            (Some(bus), Some(address)) if shared => Self::Shared(bus, address),
            _ => Self::Finding(key.clone()),
        }
    }
}

/// One thing that is wrong, or was.
#[derive(Clone, Debug)]
pub struct Problem<'a> {
    /// Which.
    pub key: ProblemKey,
    /// What shows it, at least one: the most certain first, among these what matters most.
    pub findings: Vec<&'a Finding>,
    /// The user does not want it to count.
    pub is_muted: bool,
}

/// A piece of a problem's evidence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EvidenceItem {
    /// When it was seen.
    pub time: Instant,
    /// What it shows, in words.
    pub what: String,
    /// The frame that shows it.
    pub frame: Option<Frame>,
}

impl<'a> Problem<'a> {
    /// The finding that says most of it.
    pub fn head(&self) -> &'a Finding {
        self.findings[0]
    }

    /// How sure it is.
    pub fn confidence(&self) -> Confidence {
        self.head().confidence
    }

    /// Since when it is as sure as it is.
    pub fn since(&self) -> Instant {
        let confidence = self.confidence();
        let moments = self.findings.iter().filter(|it| it.confidence == confidence);
        let moments = moments.map(|finding| finding.changed);
        // It is over when all of it is over.
        let since = if confidence == Confidence::Cleared { moments.max() } else { moments.min() };
        since.unwrap_or(self.head().changed)
    }

    /// Whether it is to be counted: it is not over, and not muted.
    pub fn counts(&self) -> bool {
        !self.is_muted && self.confidence() != Confidence::Cleared
    }

    /// Its bus; none where it is about des.json alone.
    pub fn bus(&self) -> Option<BusIndex> {
        self.head().key.bus
    }

    /// All addresses concerned, ascending.
    pub fn addresses(&self) -> Vec<Address> {
        let all = self.findings.iter().flat_map(|finding| &finding.addresses);
        let mut addresses: Vec<Address> = all.copied().collect();
        addresses.sort_unstable();
        addresses.dedup();
        addresses
    }

    /// All names concerned.
    pub fn names(&self) -> Vec<&'a Name> {
        let mut names = Vec::new();
        for name in self.findings.iter().flat_map(|finding| &finding.names) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// Whether it is about what is at that address, or has that name where no address is known.
    pub fn is_about(
        &self,
        bus: Option<BusIndex>,
        address: Option<Address>,
        name: Option<&Name>,
    ) -> bool {
        self.findings.iter().any(|finding| {
            let on_bus = finding.key.bus.is_none() || bus.is_none() || finding.key.bus == bus;
            let there = address.is_some_and(|it| finding.addresses.contains(&it));
            let named =
                name.is_none_or(|it| finding.names.is_empty() || finding.names.contains(it));
            let nowhere = finding.addresses.is_empty() || address.is_none();
            let so_named = name.is_some_and(|it| finding.names.contains(it));
            on_bus && (there && named || nowhere && so_named)
        })
    }

    /// When the first evidence was seen.
    pub fn first(&self) -> Instant {
        self.findings.iter().map(|it| it.first).min().unwrap_or(Instant::ZERO)
    }

    /// When the last evidence was seen.
    pub fn last(&self) -> Instant {
        self.findings.iter().map(|it| it.last).max().unwrap_or(Instant::ZERO)
    }

    /// Whether anything was seen of it at some moment: what comes from comparing with the file was
    /// not.
    pub fn was_seen(&self) -> bool {
        self.findings.iter().any(|finding| !finding.evidence.is_empty())
    }

    /// How many pieces of evidence there were; [`Self::evidence`] has the first and the last of
    /// each finding.
    pub fn count(&self) -> u64 {
        self.findings.iter().map(|finding| finding.count).sum()
    }

    /// The evidence that is kept, oldest first; a frame that shows two things is there once.
    pub fn evidence(&self) -> Vec<EvidenceItem> {
        let mut pieces: Vec<EvidenceItem> = Vec::new();
        for evidence in self.findings.iter().flat_map(|finding| &finding.evidence) {
            let same = pieces.iter_mut().find(|piece| {
                piece.frame.is_some()
                    && piece.frame == evidence.frame
                    && piece.time == evidence.time
            });
            match same {
                Some(piece) if piece.what.contains(&*evidence.what) => {}
                Some(piece) => piece.what = format!("{}; {}", piece.what, evidence.what),
                None => pieces.push(EvidenceItem {
                    time: evidence.time,
                    what: evidence.what.to_string(),
                    frame: evidence.frame,
                }),
            }
        }
        pieces.sort_by_key(|piece| piece.time);
        pieces
    }

    /// What is wrong, in as few words as say it.
    pub fn headline(&self) -> Cow<'static, str> {
        let head = self.head();
        if let (Some((line, _)), Some(part)) = (head.place, &head.key.part) {
            return format!("line {line}: {part}").into();
        }
        head.key.wording().headline.into()
    }

    /// The same with the address.
    pub fn title(&self) -> String {
        let words = std::iter::once(self.headline().into_owned());
        let places = self.addresses().into_iter().map(|address| format!("@{address}"));
        words.chain(places).collect::<Vec<String>>().join(" ")
    }

    /// What is still to be seen before a suspicion is sure.
    pub fn confirmation_hint(&self) -> Option<&'static str> {
        let is_suspected = self.confidence() == Confidence::Suspected;
        self.head().key.wording().confirmation.filter(|_| is_suspected)
    }

    /// Where it stands in the list: open ones, then suspicions, then what is over, then what is
    /// muted; among these what matters most first.
    fn rank(&self) -> impl Ord + use<> {
        let head = self.head();
        let severity = Reverse(head.key.kind.severity());
        (self.is_muted, Reverse(head.confidence), severity, head.place, head.key.clone())
    }
}

impl App {
    /// All that is wrong or was, what matters most first, cleared things last, and behind them
    /// what is muted. While the screen is held, rows stay where they are and new ones come last.
    pub fn problems(&self) -> Vec<Problem<'_>> {
        let mut problems = self.problems_unsorted();
        problems.sort_by_cached_key(Problem::rank);
        if self.view.frozen.is_some() {
            problems.sort_by_cached_key(|problem| {
                let place = self.problem_order.iter().position(|key| *key == problem.key);
                place.unwrap_or(usize::MAX)
            });
        }
        problems
    }

    /// The same in any order.
    pub(super) fn problems_unsorted(&self) -> Vec<Problem<'_>> {
        let mut groups: BTreeMap<ProblemKey, Vec<&Finding>> = BTreeMap::new();
        for finding in self.findings() {
            groups.entry(ProblemKey::of(&finding.key)).or_default().push(finding);
        }
        let mut problems: Vec<Problem> = Vec::with_capacity(groups.len());
        for (key, mut findings) in groups {
            findings.sort_by_key(|it| {
                (Reverse(it.confidence), Reverse(it.key.kind.severity()), it.key.kind)
            });
            problems.push(Problem { is_muted: self.muted.contains(&key), key, findings });
        }
        problems
    }

    /// Those that the filter lets through.
    pub fn problems_shown(&self) -> Vec<Problem<'_>> {
        self.filtered(self.problems())
    }

    fn filtered<'a>(&'a self, mut problems: Vec<Problem<'a>>) -> Vec<Problem<'a>> {
        let filter = super::Filter::parse(self.view.filter(super::Page::Problems));
        problems.retain(|problem| filter.matches_problem(self, problem));
        problems
    }

    /// The selected one.
    pub fn selected_problem(&self) -> Option<Problem<'_>> {
        let mut shown = self.problems_shown();
        let index = self.view.problems.index(shown.iter().map(|problem| &problem.key))?;
        Some(shown.swap_remove(index))
    }

    pub(super) fn problem_keys(&self) -> Vec<ProblemKey> {
        self.problems_shown().into_iter().map(|problem| problem.key).collect()
    }

    /// After findings changed: the rows anew, the selection on its problem.
    pub(super) fn settle_problems(&mut self) {
        let keys = |problems: &[Problem]| -> Vec<ProblemKey> {
            problems.iter().map(|problem| problem.key.clone()).collect()
        };
        let problems = self.problems();
        let order = keys(&problems);
        let shown = keys(&self.filtered(problems));
        self.problem_order = order;
        let height = self.screen().list_rows();
        if self.view.page == super::Page::Problems {
            // What comes on top while it is read must not take its place under a key.
            self.view.problems.keep(&shown, height);
        } else {
            self.view.problems.settle(&shown, height);
        }
    }

    /// Command: the selected problem does not count any more, or counts again.
    pub(super) fn toggle_muted(&mut self) {
        if self.view.page != super::Page::Problems {
            return self.show_error("mute works on the Problems page");
        }
        let Some(problem) = self.selected_problem() else {
            return self.show_error("no problem is selected");
        };
        let (key, title) = (problem.key.clone(), problem.title());
        let undo = self.key_of(Action::Mute);
        // The same key undoes it: from here on the selection stays with this one.
        self.view.problems.select(key.clone());
        if self.muted.remove(&key) {
            self.show_info(format!("unmuted: {title}"));
        } else {
            self.muted.insert(key);
            self.show_info(format!("muted until descan quits ({undo} unmutes): {title}"));
        }
        self.refresh();
    }
}
