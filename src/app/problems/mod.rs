//! Problems: findings of the engines and of the comparison with des.json, grouped, sorted, muted.
//!
//! Inputs: the buses and the file. Outputs: the rows of page 4, the assignment of entries to
//! devices, the findings that changed. The list is kept and renewed when a bus, the file or the
//! muting changed.

mod comparison;
mod descriptors;
mod entry_mistakes;
mod group;
mod headline;
mod list;
mod matching;
mod missing_reason;
mod project;
mod sides;

pub use comparison::Scope;
pub(super) use descriptors::label_of_device;
pub(super) use entry_mistakes::{file_mistakes, mistake_of};
pub use group::{EvidenceItem, Problem, ProblemKey, is_about};
pub(super) use headline::and_list;
pub(super) use headline::label_of;
pub use headline::{ProblemHeadline, growing_length_text, length_text};
pub use list::ProblemList;
pub use matching::Matching;
pub use missing_reason::{bus_obstacle, format_duration};
pub(super) use sides::missed_in;
pub use sides::{ConflictSide, ConflictSides, SideBasis};

use super::buses::Buses;
use super::file::{Documents, EntryPlace};
use super::file_inputs::Inputs;
use crate::finding::{Finding, FindingKey, FindingState};
use crate::time::Instant;
use comparison::Comparison;
use std::cell::RefCell;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::rc::Rc;

/// Most findings of the comparison that are kept after they ended, for past moments.
const MAX_FORMER: usize = 1024;

/// Findings of the comparison with des.json, muted problems, and the list of problems.
#[derive(Debug, Default)]
pub(super) struct Problems {
    matching: Matching,
    file_findings: Vec<Finding>,
    /// Findings of the comparison before they ended or changed their state, with the time of that, oldest
    /// first; at most [`MAX_FORMER`].
    former: VecDeque<(Instant, Finding)>,
    /// From then on `former` and `file_findings` hold all that was found; `None` until a des.json is compared
    /// or a former finding is dropped.
    compared_from: Option<Instant>,
    /// Places of the entries that these findings are about, in the same order.
    finding_entries: Vec<Option<EntryPlace>>,
    /// Muted until the program ends.
    muted: BTreeSet<ProblemKey>,
    /// Incremented when the findings of the file or the muting change.
    revision: u64,
    /// The list for the revisions of the buses and of `self`.
    list: RefCell<Option<StoredList>>,
}

/// Revisions of the findings of the buses and of [`Problems`], and the list made for them.
type StoredList = (u64, u64, Rc<[StoredProblem]>);

/// A problem whose findings are stored with the buses and the file.
#[derive(Debug)]
struct StoredProblem {
    key: ProblemKey,
    findings: Vec<FindingPlace>,
    state: FindingState,
    is_muted: bool,
}

/// Where a finding is stored.
#[derive(Clone, Copy, Debug)]
enum FindingPlace {
    /// With the bus at this index.
    Bus(usize, usize),
    /// With the findings of the file.
    File(usize),
}

impl Problems {
    /// Returns the problems for a past moment: with the same ones muted, and the findings of the file then.
    pub fn for_moment(&self, time: Instant) -> Self {
        let former = self.former.iter().filter(|(until, _)| *until > time);
        let all = former.map(|(_, finding)| finding).chain(&self.file_findings);
        let mut file_findings: Vec<Finding> = Vec::new();
        for finding in all.filter(|finding| finding.changed <= time) {
            if file_findings.iter().all(|known| known.key != finding.key) {
                file_findings.push(finding.clone());
            }
        }
        Self { file_findings, muted: self.muted.clone(), ..Self::default() }
    }

    /// The assignment of entries to devices.
    pub fn matching(&self) -> &Matching {
        &self.matching
    }

    /// Compares files and buses as they were at a past moment. A difference that the `present` problems
    /// did not have at that time is not there either: it was found by the next comparison.
    pub fn refresh_for_moment(
        &mut self,
        buses: &Buses,
        documents: Documents,
        time: Instant,
        present: &Self,
    ) {
        let before = self.refresh(buses, documents, time);
        if present.compared_from.is_none_or(|from| time < from) {
            return;
        }
        let known: BTreeSet<FindingKey> = before.into_iter().map(|finding| finding.key).collect();
        let found = std::mem::take(&mut self.file_findings).into_iter();
        let found = found.zip(std::mem::take(&mut self.finding_entries));
        (self.file_findings, self.finding_entries) =
            found.filter(|(finding, _)| known.contains(&finding.key)).unzip();
    }

    /// All findings: bus by bus, then those of the comparison with the file.
    pub fn findings<'a>(&'a self, buses: &'a Buses) -> impl Iterator<Item = &'a Finding> {
        buses.findings().chain(&self.file_findings)
    }

    /// Place of the entry that a finding of the comparison is about.
    pub fn entry_of(&self, key: &FindingKey) -> Option<EntryPlace> {
        let at = self.file_findings.iter().position(|finding| finding.key == *key)?;
        self.finding_entries[at]
    }

    /// Assigns entries to devices again.
    fn assign(&mut self, buses: &Buses, documents: Documents) {
        self.matching = Matching::new(documents, buses);
    }

    /// Assigns entries to devices again, and renews the texts of the findings that are there; none is added or
    /// removed.
    pub fn renew_texts(&mut self, buses: &Buses, documents: Documents, now: Instant) {
        self.assign(buses, documents);
        let inputs = Inputs { now, buses, documents, matching: &self.matching };
        let found = self.compare(inputs, Scope::Screen).into_iter();
        let mut found: HashMap<FindingKey, Finding> =
            found.map(|finding| (finding.key.clone(), finding)).collect();
        for known in &mut self.file_findings {
            let new = found.remove(&known.key).filter(|new| new.state == known.state);
            if let Some(new) = new {
                *known = new;
            }
        }
    }

    /// Returns the differences between file and buses; a finding that persists keeps its times.
    pub fn compare(&self, inputs: Inputs, scope: Scope) -> Vec<Finding> {
        let mut found = Comparison::new(inputs, scope).found;
        self.keep_times(&mut found);
        found
    }

    /// Compares files and buses again; a finding that persists keeps its times. Returns the findings
    /// before.
    pub fn refresh(&mut self, buses: &Buses, documents: Documents, now: Instant) -> Vec<Finding> {
        self.assign(buses, documents);
        let inputs = Inputs { now, buses, documents, matching: &self.matching };
        let Comparison { mut found, entries, .. } = Comparison::new(inputs, Scope::Screen);
        self.finding_entries = entries;
        self.keep_times(&mut found);
        self.revision += 1;
        if inputs.files().any(|file| file.is_there) {
            self.compared_from.get_or_insert(now);
        }
        let before = std::mem::replace(&mut self.file_findings, found);
        let states: HashMap<&FindingKey, FindingState> =
            self.file_findings.iter().map(|finding| (&finding.key, finding.state)).collect();
        let has_changed = |old: &&Finding| states.get(&old.key) != Some(&old.state);
        for old in before.iter().filter(has_changed) {
            if self.former.len() == MAX_FORMER {
                let (until, _) = self.former.pop_front().unwrap_or((now, old.clone()));
                self.compared_from = Some(until);
            }
            self.former.push_back((now, old.clone()));
        }
        before
    }

    /// Gives the times of those that were found before to these findings.
    fn keep_times(&self, found: &mut [Finding]) {
        let known: HashMap<&FindingKey, &Finding> =
            self.file_findings.iter().map(|finding| (&finding.key, finding)).collect();
        for finding in found {
            if let Some(old) = known.get(&finding.key) {
                finding.first = old.first;
                if old.state == finding.state {
                    finding.changed = old.changed;
                    finding.last = old.last;
                }
            }
        }
    }

    /// Findings of the comparison that changed since `before`: first the cleared ones, then those
    /// that are new or have another state.
    pub fn changes_since(&self, before: &[Finding], now: Instant) -> Vec<Finding> {
        let states = |findings: &[Finding]| -> BTreeMap<FindingKey, FindingState> {
            findings.iter().map(|finding| (finding.key.clone(), finding.state)).collect()
        };
        let (was, is) = (states(before), states(&self.file_findings));
        let mut changed = Vec::new();
        for mut finding in before.iter().filter(|it| !is.contains_key(&it.key)).cloned() {
            (finding.state, finding.changed) = (FindingState::Cleared, now);
            changed.push(finding);
        }
        let is_news = |found: &&Finding| was.get(&found.key) != Some(&found.state);
        changed.extend(self.file_findings.iter().filter(is_news).cloned());
        changed
    }

    // ---- the list --------------------------------------------------------------------------

    /// All problems: confirmed, suspected, cleared, muted; by severity within each.
    pub fn list<'a>(&'a self, buses: &'a Buses) -> ProblemList<'a> {
        ProblemList::new(self, buses, self.stored(buses))
    }

    /// The problems with a finding that `is_wanted` selects.
    pub fn list_with<'a>(
        &'a self,
        buses: &'a Buses,
        is_wanted: impl Fn(&Finding) -> bool,
    ) -> Vec<Problem<'a>> {
        let stored = self.stored(buses);
        let has_wanted = |problem: &&StoredProblem| {
            let mut findings = problem.findings.iter().filter_map(|at| self.finding(buses, *at));
            findings.any(&is_wanted)
        };
        let wanted = stored.iter().filter(has_wanted);
        wanted.filter_map(|problem| self.problem(buses, problem)).collect()
    }

    fn finding<'a>(&'a self, buses: &'a Buses, place: FindingPlace) -> Option<&'a Finding> {
        match place {
            FindingPlace::Bus(bus, at) => buses.as_slice().get(bus)?.findings().get(at),
            FindingPlace::File(at) => self.file_findings.get(at),
        }
    }

    fn problem<'a>(&'a self, buses: &'a Buses, stored: &StoredProblem) -> Option<Problem<'a>> {
        let places = stored.findings.iter();
        let findings: Vec<&Finding> =
            places.filter_map(|place| self.finding(buses, *place)).collect();
        let (key, is_muted) = (stored.key.clone(), stored.is_muted);
        (!findings.is_empty()).then_some(Problem { key, findings, is_muted })
    }

    /// The list, updated if a finding of a bus, the file or the muting changed.
    fn stored(&self, buses: &Buses) -> Rc<[StoredProblem]> {
        let mut list = self.list.borrow_mut();
        match &*list {
            Some((bus, own, stored))
                if (*bus, *own) == (buses.findings_revision(), self.revision) =>
            {
                stored.clone()
            }
            _ => {
                let stored: Rc<[StoredProblem]> = self.group(buses).into();
                *list = Some((buses.findings_revision(), self.revision, stored.clone()));
                stored
            }
        }
    }

    fn group(&self, buses: &Buses) -> Vec<StoredProblem> {
        let mut groups: BTreeMap<ProblemKey, Vec<(&Finding, FindingPlace)>> = BTreeMap::new();
        let of_buses = buses.iter().enumerate().flat_map(|(bus, it)| {
            let findings = it.findings().iter().enumerate();
            findings.map(move |(at, finding)| (finding, FindingPlace::Bus(bus, at)))
        });
        let of_file = self.file_findings.iter().enumerate();
        let of_file = of_file.map(|(at, finding)| (finding, FindingPlace::File(at)));
        for (finding, place) in of_buses.chain(of_file) {
            groups.entry(ProblemKey::of(&finding.key)).or_default().push((finding, place));
        }
        let mut problems = Vec::with_capacity(groups.len());
        for (key, mut findings) in groups {
            findings.sort_by_key(|(it, _)| {
                (Reverse(it.state), Reverse(it.key.kind.severity()), it.key.kind)
            });
            let (findings, places) = findings.into_iter().unzip();
            let is_muted = self.muted.contains(&key);
            problems.push((Problem { key, findings, is_muted }, places));
        }
        problems.sort_by_cached_key(|(problem, _)| problem.rank());
        let stored = |(problem, findings): (Problem, _)| {
            let state = problem.state();
            let Problem { key, is_muted, .. } = problem;
            StoredProblem { key, findings, state, is_muted }
        };
        problems.into_iter().map(stored).collect()
    }

    /// Returns true if a problem is muted.
    pub fn is_muted(&self, key: &ProblemKey) -> bool {
        self.muted.contains(key)
    }

    /// Mutes a problem, or unmutes a muted one; returns true if it is muted now.
    pub fn toggle_muted(&mut self, key: ProblemKey) -> bool {
        self.revision += 1;
        let was_muted = self.muted.remove(&key);
        if !was_muted {
            self.muted.insert(key);
        }
        !was_muted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::FileReading;
    use crate::app::file::{FileEditors, FileIndex};
    use crate::discovery::Config;
    use crate::frame::{BusIndex, Frame};
    use crate::status::BusStatus;

    const NOW: Instant = Instant::ZERO;
    const FILE: &str = r#"{"devices":[{"name":"A","address":12,"static":true},
        {"name":"B","address":12,"static":true},{"name":5}]}"#;

    fn parts() -> (Buses, FileEditors) {
        let buses = Buses::new(NOW, vec![("can0".into(), Config::default())]);
        let mut files = FileEditors::new(Some("des.json".into()), Vec::new());
        read(&mut files, FILE);
        (buses, files)
    }

    fn read(files: &mut FileEditors, text: &str) {
        let content = FileReading::Content(Some(text.into()));
        files.get_mut(FileIndex::default()).read(NOW, content);
    }

    #[test]
    fn list_is_kept_until_something_changes() {
        let (mut buses, files) = parts();
        let mut problems = Problems::default();
        problems.refresh(&buses, files.documents(), NOW);
        let first = problems.stored(&buses);
        assert!(!first.is_empty() && Rc::ptr_eq(&first, &problems.stored(&buses)));
        // A frame alone changes no finding.
        buses.receive(&Frame::classic(1, &[]));
        assert!(Rc::ptr_eq(&first, &problems.stored(&buses)));
        let loss = BusStatus { kernel_drops: 1, ..BusStatus::default() };
        assert!(buses.update_status(NOW, BusIndex(0), loss).is_some());
        let second = problems.stored(&buses);
        assert!(!Rc::ptr_eq(&first, &second));
        problems.toggle_muted(second[0].key.clone());
        assert!(!Rc::ptr_eq(&second, &problems.stored(&buses)));
    }

    #[test]
    fn muted_problem_is_last_and_does_not_count() {
        let (buses, files) = parts();
        let mut problems = Problems::default();
        problems.refresh(&buses, files.documents(), NOW);
        let key = problems.list(&buses).get(0).unwrap().key;
        assert!(problems.toggle_muted(key.clone()) && problems.is_muted(&key));
        let list = problems.list(&buses);
        let lowest = list.get(list.len() - 1).unwrap();
        assert!(lowest.key == key && !lowest.is_open());
        assert!(!problems.toggle_muted(key));
    }

    #[test]
    fn cleared_finding_is_reported_once() {
        let (buses, mut files) = parts();
        let mut problems = Problems::default();
        let before = problems.refresh(&buses, files.documents(), NOW);
        assert!(!problems.changes_since(&before, NOW).is_empty());
        let before = problems.refresh(&buses, files.documents(), NOW);
        assert!(problems.changes_since(&before, NOW).is_empty());
        read(&mut files, r#"{"devices":[]}"#);
        let before = problems.refresh(&buses, files.documents(), NOW);
        let changes = problems.changes_since(&before, NOW);
        assert!(!changes.is_empty());
        assert!(changes.iter().all(|it| it.state == FindingState::Cleared));
    }
}
