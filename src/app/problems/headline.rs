//! The headline of a problem: one sentence with the boards and times, the same on every page.
//!
//! Input: a problem and the buses and des.json of the moment that is shown. Output: the sentence in
//! four lengths. A board is named by its UID, without one by the time since when it is there. Does not
//! know how wide the screen is.

use super::{Problem, ProblemKey, format_duration};
use crate::app::capture::decoded::uid_text;
use crate::app::{App, TimelineEntry, format_time_of_day};
use crate::discovery::Device;
use crate::finding::{Finding, FindingKind, FindingState, SeenUid};
use crate::text::join_first;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::Uid;

/// Boards or names in a sentence; the others are counted.
const LISTED: usize = 3;
/// Time without bus errors from which they are said to be over.
const WITHOUT_ERRORS: Duration = Duration::from_secs(3);
/// Heartbeat periods between the first heartbeats of two boards up to which none of them joined
/// second: one that sends since long ago is received within a period.
const TOGETHER_PERIODS: f64 = 1.5;

/// The headline of a problem, from the shortest form to the longest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProblemHeadline {
    /// Place and boards, for 40 columns: `14: SPARE01 / BOILER03`.
    pub label: String,
    /// Beside the address: `SPARE01 conflicts with BOILER03`.
    pub short: String,
    /// Beside the address, with times: `SPARE01 joined, conflicts with BOILER03 (since 13:50:34)`.
    pub long: String,
    /// Alone: `Address 14: SPARE01 joined 13:50:55, conflicts with BOILER03 (since 13:50:34)`.
    pub full: String,
}

/// The forms without the address.
struct Words {
    label: String,
    short: String,
    long: String,
    full: String,
}

impl Words {
    fn same(label: String, text: String) -> Self {
        Self { label, short: text.clone(), long: text.clone(), full: text }
    }
}

impl Problem<'_> {
    /// UIDs of the boards in a conflict, the one that was received first at the start, although it may
    /// have been absent since: those of the finding with the most.
    pub fn boards(&self) -> Vec<SeenUid> {
        let most = self.findings.iter().rev().max_by_key(|finding| finding.uids.len());
        let mut boards = most.map_or_else(Vec::new, |finding| finding.uids.clone());
        boards.sort_by_key(|board| (board.first, board.since));
        boards
    }

    /// Returns true if it is two or more boards at one address.
    pub fn is_address_conflict(&self) -> bool {
        matches!(self.key, ProblemKey::Address(..))
            && self.findings.iter().any(|finding| {
                finding.key.kind.is_conflict() || finding.key.kind == FindingKind::AddressContested
            })
    }

    /// Time since when the problem is there: of a conflict, when the second of its boards joined or came
    /// back.
    pub fn began(&self) -> Instant {
        self.joined().get(1).copied().unwrap_or_else(|| self.shown_since())
    }

    /// Time when the last of the boards of a conflict joined or came back; else when it began.
    pub fn newest_joined(&self) -> Instant {
        let newest = self.joined().get(1..).and_then(<[Instant]>::last).copied();
        newest.unwrap_or_else(|| self.shown_since())
    }

    /// Time since when its evidence shows two boards; else that of its first evidence.
    fn shown_since(&self) -> Instant {
        let findings = self.findings.iter().filter(|finding| finding.superseded_by.is_none());
        findings.filter_map(|finding| finding.began).min().unwrap_or(self.first())
    }

    /// When each of the boards of a conflict joined or came back, the first time first.
    fn joined(&self) -> Vec<Instant> {
        let boards = if self.is_address_conflict() { self.boards() } else { Vec::new() };
        let mut joined: Vec<Instant> = boards.iter().map(|board| board.since).collect();
        joined.sort_unstable();
        joined
    }

    /// Time of its end; `None` while it is open.
    pub fn ended(&self) -> Option<Instant> {
        (self.state() == FindingState::Cleared).then(|| self.last().max(self.newest_joined()))
    }
}

impl App {
    /// The headline of a problem at the moment that is shown.
    pub fn headline(&self, problem: &Problem) -> ProblemHeadline {
        let Words { label, short, long, full } = self.words_of(problem);
        let several = self.buses().len() > 1;
        let bus = problem.bus().filter(|_| several);
        let (on, of) = bus.map_or((String::new(), String::new()), |bus| {
            let name = self.shown_buses().unique_name(bus);
            (format!(" on {name}"), format!("{name} "))
        });
        match problem.key {
            ProblemKey::Address(_, address) => ProblemHeadline {
                label: format!("{of}{address}: {label}"),
                short,
                long,
                full: format!("Address {address}{on}: {full}"),
            },
            ProblemKey::Finding(_) if problem.head().key.kind.is_conflict() => {
                ProblemHeadline { label, short, long, full: format!("{full}{on}") }
            }
            ProblemKey::Finding(_) => ProblemHeadline { label, short, long, full },
        }
    }

    /// The headline of the problem that a finding belongs to; of the finding alone while the problem is
    /// in another state.
    pub fn headline_of(&self, finding: &Finding) -> ProblemHeadline {
        let problems = self.problems_with(|other| other.key == finding.key);
        let problem = problems.first().filter(|problem| problem.state() == finding.state);
        let alone = || Problem {
            key: ProblemKey::of(&finding.key),
            findings: vec![finding],
            is_muted: false,
        };
        problem.map_or_else(|| self.headline(&alone()), |problem| self.headline(problem))
    }

    /// Headline and explanation of a line of the timeline that is a finding; `None` for any other.
    pub(in crate::app) fn explained(&self, line: &TimelineEntry) -> Option<(String, String)> {
        let (kind, (state, text)) = line.finding.zip(line.text.split_once(": "))?;
        let mut findings = self.problems.findings(&self.buses);
        let finding = findings.find(|finding| {
            finding.key.kind == kind && finding.state.name() == state && finding.text == text
        })?;
        let headline = self.headline_of(finding);
        // The address stands in front.
        let words = if line.address.is_some() && !headline.long.is_empty() {
            headline.long
        } else {
            headline.full
        };
        let is_same = words == text.strip_suffix('.').unwrap_or(text);
        let explanation = if is_same { String::new() } else { text.to_owned() };
        Some((format!("{state}: {words}"), explanation))
    }

    fn words_of(&self, problem: &Problem) -> Words {
        match problem.head().key.kind {
            FindingKind::SameNameSameAddress
            | FindingKind::OneAddressTwoNames
            | FindingKind::OneAddressTwoIdentities
            | FindingKind::AnswersDoubled => self.conflict_words(problem),
            FindingKind::TwoDebugDevices => debug_words(problem),
            FindingKind::AddressContested => self.contested_words(problem),
            FindingKind::BusErrors => self.bus_errors_words(problem),
            FindingKind::OneUidTwoAddresses => one_uid_words(problem),
            FindingKind::WrongAddress => self.wrong_address_words(problem),
            FindingKind::Missing => self.missing_words(problem),
            FindingKind::FileShape if self.shown_documents().are_several() => {
                let words = sentence_words(problem);
                let file = self.name_of_file(problem.bus());
                let of_file = |text: String| format!("{file}  {text}");
                Words { short: of_file(words.short), long: of_file(words.long), ..words }
            }
            FindingKind::StaticAddressTaken => self.address_taken_words(problem),
            _ => sentence_words(problem),
        }
    }

    fn conflict_words(&self, problem: &Problem) -> Words {
        let boards = problem.boards();
        if boards.len() > 1 {
            return self.boards_words(problem, &boards);
        }
        let head = problem.head();
        let names: Vec<String> =
            problem.names().iter().map(|name| name.quoted().to_string()).collect();
        let since = format_time_of_day(self, problem.began());
        let until = self.until(problem);
        if head.key.kind == FindingKind::OneAddressTwoNames && names.len() > 1 {
            let label = join_first(names.clone(), LISTED, " / ");
            let text = match (&names[..], head.state) {
                ([one, other], FindingState::Confirmed) => {
                    format!("one board answers as {one}, the other as {other}")
                }
                ([one, other], FindingState::Cleared) => {
                    format!("one board answered as {one}, the other as {other}{until}")
                }
                (_, FindingState::Suspected) => {
                    format!("answers as {}", join_first(names, LISTED, " and as "))
                }
                (_, FindingState::Confirmed) => {
                    format!("boards answer as {}", join_first(names, LISTED, ", "))
                }
                (_, FindingState::Cleared) => {
                    format!("boards answered as {}{until}", join_first(names, LISTED, ", "))
                }
            };
            let long = format!("{text} (detected {since})");
            return Words { label, short: text, long: long.clone(), full: long };
        }
        let answering = names.first().map_or(String::new(), |name| format!(" as {name}"));
        let label = format!("two boards{answering}");
        if head.key.kind == FindingKind::AnswersDoubled {
            let verb = if head.state == FindingState::Cleared { "got" } else { "gets" };
            let short = format!("each request {verb} two responses{until}");
            let long = format!("{short}: two boards{answering}, or one that responds twice");
            return Words { label, short, full: long.clone(), long };
        }
        let note = self.uid_note(problem);
        if head.key.kind == FindingKind::OneAddressTwoIdentities {
            let text = format!("two boards{answering}, one working, one not {note}{until}");
            return Words::same(label, text);
        }
        if !head.excludes_one_device {
            let short = format!("two boards{answering} {note}, or one that sends twice{until}");
            let long = format!("{short} (detected {since})");
            return Words { label, short, full: long.clone(), long };
        }
        let verb = verb_of(problem);
        let first = self.device_of_problem(problem).map(|device| device.first_seen);
        let first = first.filter(|first| problem.first().since(*first) > self.together(problem));
        if let Some(first) = first {
            let first = format_time_of_day(self, first);
            Words {
                label,
                short: format!("a second board{answering} {verb} the first {note}{until}"),
                long: format!("a second board {note}, {verb} the one since {first}{until}"),
                full: format!(
                    "a second board detected {since} {note}, {verb} the one since {first}{until}"
                ),
            }
        } else {
            let verb = verb.strip_suffix(" with").unwrap_or(verb).replace("conflicts", "conflict");
            let short = format!("two boards{answering} {verb} {note}{until}");
            let long = format!("two boards{answering} {verb} {note}, both since {since}{until}");
            Words { label, short, full: long.clone(), long }
        }
    }

    /// A conflict of boards with UIDs.
    fn boards_words(&self, problem: &Problem, boards: &[SeenUid]) -> Words {
        let labels = |boards: &[SeenUid]| -> Vec<String> {
            boards.iter().map(|board| label_of(board.label())).collect()
        };
        let mut by_joining = boards.to_vec();
        by_joining.sort_by_key(|board| board.since);
        let (newest, before) = by_joining.split_last().expect("at least two boards");
        let mut latest_first = labels(&by_joining);
        latest_first.reverse();
        let label = join_first(latest_first, LISTED, " / ");
        let until = self.until(problem);
        let first = format_time_of_day(self, before[0].since);
        let apart = before.last().map_or(Duration::ZERO, |last| newest.since.since(last.since));
        if apart <= self.together(problem) {
            let verb = match verb_of(problem) {
                "conflicts with" => "conflict",
                verb => verb.trim_end_matches(" with"),
            };
            let all = and_list(labels(boards));
            let short = format!("{all} {verb}{until}");
            let both = if boards.len() == 2 { "both" } else { "all" };
            let long = format!("{all} {verb}, {both} since {first}{until}");
            return Words { label, short, full: long.clone(), long };
        }
        let (newest_label, others) = (label_of(newest.label()), and_list(labels(before)));
        let (verb, at) = (verb_of(problem), format_time_of_day(self, newest.since));
        let joined = if newest.has_returned() { "returned" } else { "joined" };
        Words {
            label,
            short: format!("{newest_label} {verb} {others}"),
            long: format!("{newest_label} {joined}, {verb} {others} (since {first}){until}"),
            full: format!("{newest_label} {joined} {at}, {verb} {others} (since {first}){until}"),
        }
    }

    fn contested_words(&self, problem: &Problem) -> Words {
        let boards = problem.boards();
        let length = length_text(problem.last().since(problem.first()));
        let holder = self.device_of_problem(problem).and_then(|device| device.uid);
        let (stays, left): (Vec<&SeenUid>, Vec<&SeenUid>) =
            boards.iter().partition(|board| Some(board.uid) == holder);
        if let ([stays], [_, ..]) = (&stays[..], &left[..]) {
            let stays = label_of(stays.label());
            let left = and_list(left.iter().map(|board| label_of(board.label())).collect());
            let label = format!("contested: {left} / {stays}");
            let short = format!("contested, {left} gave way to {stays}");
            let long = format!("{short} after {length}");
            Words { label, short, full: long.clone(), long }
        } else {
            let text = format!("contested, one board gave way after {length}");
            Words::same("contested".to_owned(), text)
        }
    }

    /// Bus errors. Their rate is that of the last ten seconds before the last one, and the finding
    /// outlives them: says until when there were any.
    fn bus_errors_words(&self, problem: &Problem) -> Words {
        let words = sentence_words(problem);
        let last = problem.head().last;
        let is_open = problem.ended().is_none();
        if !is_open || self.display_time().since(last) < WITHOUT_ERRORS {
            return words;
        }
        let until = format!("Bus errors until {}:", format_time_of_day(self, last));
        let text = words.full.replacen("Bus errors:", &until, 1);
        Words { label: words.label, ..Words::same(String::new(), text) }
    }

    /// A device at another address than its entry: `DISP (BOILER04) is pinned to 21 in des.json`.
    fn wrong_address_words(&self, problem: &Problem) -> Words {
        let Some(pinned) = self.listed_address(problem) else { return sentence_words(problem) };
        let device = self.listed_device(problem);
        let name = device.map_or_else(|| name_of(problem), |device| self.device_label(device));
        let at = problem.head().key.address.map_or(String::new(), |at| format!(" at {at}"));
        let file = self.name_of_file(problem.bus());
        let short = format!("{name} is pinned to {pinned} in {file}");
        Words {
            label: format!("{name}{at}, not {pinned}"),
            short: short.clone(),
            long: short,
            full: format!("{name}{at} is pinned to {pinned} in {file}"),
        }
    }

    fn missing_words(&self, problem: &Problem) -> Words {
        let name = name_of(problem);
        let file = self.name_of_file(problem.bus());
        let at = problem.head().key.address.map_or(String::new(), |at| format!(" at {at}"));
        let entry = self.shown_problems().entry_of(&problem.head().key);
        let seen = entry.map_or(&[][..], |entry| self.matching().devices_of(entry));
        let seen = seen.iter().filter_map(|id| self.device(*id)).map(|device| device.last_seen);
        let heard = seen.max().map_or("never received".to_owned(), |last| {
            format!("last received {}", format_time_of_day(self, last))
        });
        Words {
            label: format!("{name} missing"),
            short: format!("{name} is missing, {heard}"),
            long: format!("{name} is missing: listed in {file}, {heard}"),
            full: format!("{name}{at} is missing: listed in {file}, {heard}"),
        }
    }

    fn address_taken_words(&self, problem: &Problem) -> Words {
        let (Some(address), [listed, ..]) = (problem.head().key.address, &problem.names()[..])
        else {
            return sentence_words(problem);
        };
        let (listed, file) = (listed.quoted(), self.name_of_file(problem.bus()));
        let user = match self.device_of_problem(problem) {
            Some(device) => self.device_label(device),
            None => "another device".to_owned(),
        };
        Words {
            label: format!("{address}: {user}, not {listed}"),
            short: format!("{user} uses the static address of {listed}"),
            long: format!("{user} uses the static address of {listed} in {file}"),
            full: format!("{user} uses {address}, the static address of {listed} in {file}"),
        }
    }

    // ---- parts -----------------------------------------------------------------------------

    /// `" until 13:51:20"` of a problem that is over, else empty.
    fn until(&self, problem: &Problem) -> String {
        let ended = problem.ended();
        ended.map_or(String::new(), |at| format!(", until {}", format_time_of_day(self, at)))
    }

    /// Time between the first heartbeats of two boards up to which both are there since the start.
    fn together(&self, problem: &Problem) -> Duration {
        self.period_of(problem).mul_f64(TOGETHER_PERIODS)
    }

    /// The device at the address of a problem.
    fn device_of_problem(&self, problem: &Problem) -> Option<&Device> {
        let address = problem.head().key.address?;
        self.bus(problem.bus()?)?.device_at(address)
    }

    /// Why the boards of a problem have no UID in its headline.
    fn uid_note(&self, problem: &Problem) -> String {
        let uid = self.device_of_problem(problem).and_then(|device| device.uid);
        match (problem.boards().first(), uid) {
            (Some(board), _) => format!("(one UID: {})", label_of(board.label())),
            (None, Some(uid)) if !uid.is_blank() => {
                format!("(one UID: {})", self.uid_label(problem, uid))
            }
            (None, Some(_)) => "(UIDs blank)".to_owned(),
            (None, None) => "(UIDs unknown)".to_owned(),
        }
    }

    fn uid_label(&self, problem: &Problem, uid: Uid) -> String {
        label_of(uid_text(&self.profile(problem.bus().unwrap_or_default()), uid))
    }

    /// Name and UID of a device: `DISP (BOILER04)`.
    pub fn device_label(&self, device: &Device) -> String {
        let name = device
            .name
            .as_ref()
            .map_or("an unnamed device".to_owned(), |name| name.quoted().to_string());
        // In a conflict the UID is that of the last heartbeat.
        let (id, address) = (device.id, device.address);
        let findings = self.bus(id.bus).map_or(&[][..], |bus| bus.findings());
        let shared = findings.iter().find(|finding| {
            finding.key.address == Some(address)
                && finding.uids.len() > 1
                && finding.state != FindingState::Cleared
        });
        let uids = match (shared, device.uid.filter(|uid| !uid.is_blank())) {
            (Some(finding), _) => finding.uids.iter().map(|it| label_of(it.label())).collect(),
            (None, Some(uid)) => vec![label_of(uid_text(&self.profile(id.bus), uid))],
            (None, None) => return name,
        };
        format!("{name} ({})", join_first(uids, LISTED, " / "))
    }

    /// The device of the entry that a problem is about; of several at the address the one that matches.
    fn listed_device(&self, problem: &Problem) -> Option<&Device> {
        let entry = self.shown_problems().entry_of(&problem.head().key)?;
        let matching = self.matching();
        let mut devices = matching.devices_of(entry).iter().filter_map(|id| self.device(*id));
        devices.find(|device| Some(device.address) == problem.head().key.address)
    }

    /// Address of the entry that a problem is about.
    fn listed_address(&self, problem: &Problem) -> Option<Address> {
        let entry = self.shown_problems().entry_of(&problem.head().key)?;
        self.shown_documents().entry(entry)?.address.and_then(Address::new)
    }
}

fn verb_of(problem: &Problem) -> &'static str {
    match problem.state() {
        FindingState::Cleared if problem.was_only_suspected() => "may have conflicted with",
        FindingState::Cleared => "conflicted with",
        FindingState::Suspected => "may conflict with",
        FindingState::Confirmed => "conflicts with",
    }
}

/// A UID in a sentence: in quotes if it has blanks.
pub(in crate::app) fn label_of(uid: String) -> String {
    if uid.contains(char::is_whitespace) { format!("\"{uid}\"") } else { uid }
}

/// `A`, `A and B`, `A, B and C`, `A, B, C and 2 more`.
pub(in crate::app) fn and_list(mut parts: Vec<String>) -> String {
    let more = parts.len().saturating_sub(LISTED);
    if more > 0 {
        parts.truncate(LISTED);
        parts.push(format!("{more} more"));
    }
    match parts.pop() {
        Some(last) if !parts.is_empty() => format!("{} and {last}", parts.join(", ")),
        last => last.unwrap_or_default(),
    }
}

/// The length of what is over: `12 ms`, `24.2 s`, `2m05s`.
pub fn length_text(length: Duration) -> String {
    match length.as_millis() {
        0 => "0 s".to_owned(),
        millis @ 1..=999 => format!("{millis} ms"),
        1000..=59_949 => format!("{:.1} s", length.as_secs_f64()),
        _ => format_duration(length),
    }
}

/// The length of what goes on, in whole seconds: `24 s`, `2m05s`.
pub fn growing_length_text(length: Duration) -> String {
    match length.as_secs() {
        seconds @ 0..=59 => format!("{seconds} s"),
        _ => format_duration(length),
    }
}

fn debug_words(problem: &Problem) -> Words {
    let boards = problem.boards();
    let address = problem.head().key.address.map_or(0, Address::number);
    let labels: Vec<String> = boards.iter().map(|board| label_of(board.label())).collect();
    if labels.len() < 2 {
        return sentence_words(problem);
    }
    let label = join_first(labels.clone(), LISTED, " / ");
    let count = if labels.len() == 2 { "Two".to_owned() } else { labels.len().to_string() };
    let text = format!("{} debug devices: {}", count.to_lowercase(), and_list(labels));
    Words {
        label,
        short: text.clone(),
        long: text.clone(),
        full: format!("{text}, both at {address}"),
    }
}

fn one_uid_words(problem: &Problem) -> Words {
    let addresses: Vec<String> = problem.addresses().iter().map(ToString::to_string).collect();
    let boards = problem.boards();
    let uid = boards.first().map(|board| format!("UID {}", label_of(board.label())));
    let uid = uid.unwrap_or("one UID".to_owned());
    let text = format!("{uid} at {}", and_list(addresses));
    Words::same(text.clone(), text)
}

/// The sentence of the first finding, without the full stop. Of a fault in des.json its line first.
fn sentence_words(problem: &Problem) -> Words {
    let head = problem.head();
    if head.position.is_some() && head.key.fault.is_some() {
        let names = head.names.iter().map(|name| name.quoted().to_string());
        let parts: Vec<String> = names.chain([problem.headline().into_owned()]).collect();
        let short = parts.join("  ");
        let full = head.text.strip_suffix('.').unwrap_or(&head.text).to_owned();
        return Words { label: problem.title(), long: short.clone(), short, full };
    }
    let text = match head.text.strip_suffix('.').unwrap_or(&head.text) {
        "" => problem.headline().into_owned(),
        text => text.to_owned(),
    };
    Words { label: problem.title(), ..Words::same(String::new(), text) }
}

fn name_of(problem: &Problem) -> String {
    let name = problem.head().key.name.as_ref();
    name.map_or("a device".to_owned(), |name| name.quoted().to_string())
}
