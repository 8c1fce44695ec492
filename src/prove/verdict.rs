//! Verdicts: what the samples of each rule add up to.
//!
//! A sample is one test or one observation of a rule. Does not know how samples are taken.

use super::rule::ConformanceRule;
use crate::frame::Frame;
use crate::wire::profile::{Profile, ProfileKey, ValueOrigin};

/// Most frames that a verdict shows.
pub const MAX_PROOF_FRAMES: usize = 16;

/// Whether a device keeps a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Conformance {
    /// Seen to be kept, and never to be broken.
    Kept,
    /// Seen to be broken.
    Broken,
    /// Not surely seen.
    NotSeen,
}

impl Conformance {
    /// The word in JSON.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Kept => "kept",
            Self::Broken => "broken",
            Self::NotSeen => "not-seen",
        }
    }

    /// The word in text.
    pub const fn label(self) -> &'static str {
        match self {
            Self::NotSeen => "not seen",
            _ => self.word(),
        }
    }
}

/// Verdict on one rule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RuleVerdict {
    /// The rule.
    pub rule: ConformanceRule,
    /// Whether it is kept.
    pub conformance: Conformance,
    /// What was seen, or why nothing was.
    pub text: String,
    /// Number of samples that it is about.
    pub samples: u32,
    /// Frames that prove it, with their times; at most [`MAX_PROOF_FRAMES`].
    pub frames: Vec<Frame>,
    /// Keys of the profile with assumed values on which it depends.
    pub assumed: Vec<ProfileKey>,
}

/// What the device did in one sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sample {
    /// It kept the rule.
    Kept,
    /// It broke the rule.
    Broken,
    /// Not sure: why.
    Unsure,
}

/// Samples of one rule.
#[derive(Clone, Debug, Default)]
struct RuleRecord {
    kept: u32,
    broken: u32,
    kept_text: String,
    broken_text: String,
    unsure_text: String,
    kept_frames: Vec<Frame>,
    broken_frames: Vec<Frame>,
    assumed: Vec<ProfileKey>,
}

/// Samples of all rules.
#[derive(Clone, Debug)]
pub(super) struct Records {
    records: Vec<RuleRecord>,
}

impl Records {
    pub fn new() -> Self {
        Self { records: vec![RuleRecord::default(); ConformanceRule::ALL.len()] }
    }

    fn of(&mut self, rule: ConformanceRule) -> &mut RuleRecord {
        &mut self.records[rule as usize]
    }

    /// Adds a sample: `text` is what was seen, or why nothing was.
    pub fn add(
        &mut self,
        rule: ConformanceRule,
        sample: Sample,
        text: impl Into<String>,
        frames: &[Frame],
    ) {
        let record = self.of(rule);
        let (count, known, kept_frames) = match sample {
            Sample::Kept => (&mut record.kept, &mut record.kept_text, &mut record.kept_frames),
            Sample::Broken => {
                (&mut record.broken, &mut record.broken_text, &mut record.broken_frames)
            }
            Sample::Unsure => {
                record.unsure_text = text.into();
                return;
            }
        };
        *count += 1;
        // The first is shown: later ones may follow from it.
        if *count == 1 {
            *known = text.into();
            kept_frames.extend(frames.iter().take(MAX_PROOF_FRAMES));
        }
    }

    /// Says what was seen of a rule that is kept.
    pub fn describe(&mut self, rule: ConformanceRule, text: String) {
        self.of(rule).kept_text = text;
    }

    /// Forgets the samples of a rule.
    pub fn clear(&mut self, rule: ConformanceRule) {
        *self.of(rule) = RuleRecord::default();
    }

    /// Takes what follows from another rule that is broken for not seen: the device could not keep it.
    pub fn excuse(&mut self, rules: &[ConformanceRule], why: &str) {
        for rule in rules {
            let record = self.of(*rule);
            if record.broken > 0 {
                *record = RuleRecord { unsure_text: why.to_owned(), ..RuleRecord::default() };
            }
        }
    }

    /// Returns true if there are enough samples for a rule to be broken.
    pub fn is_broken(&self, rule: ConformanceRule) -> bool {
        let record = &self.records[rule as usize];
        record.broken >= rule.broken_samples() && record.assumed.is_empty()
    }

    /// Number of samples in which a rule was kept, and broken.
    pub fn counts(&self, rule: ConformanceRule) -> (u32, u32) {
        let record = &self.records[rule as usize];
        (record.kept, record.broken)
    }

    /// Notes that a rule depends on values of the profile.
    pub fn depends_on(&mut self, rule: ConformanceRule, keys: &[ProfileKey], profile: &Profile) {
        let record = self.of(rule);
        for key in keys {
            if profile.origin(*key) == ValueOrigin::Assumed && !record.assumed.contains(key) {
                record.assumed.push(*key);
            }
        }
    }

    /// Returns the verdict on a rule. `doubt`: why nothing that a device did is sure; `reason`: why
    /// a rule without a sample has none.
    pub fn verdict(&self, rule: ConformanceRule, doubt: Option<&str>, reason: &str) -> RuleVerdict {
        let record = &self.records[rule as usize];
        let is_broken = record.broken >= rule.broken_samples();
        let conformance = match (is_broken, doubt) {
            (true, None) if record.assumed.is_empty() => Conformance::Broken,
            (false, None) if record.kept > 0 && record.broken == 0 => Conformance::Kept,
            _ => Conformance::NotSeen,
        };
        let (text, samples, frames) = match conformance {
            Conformance::Broken => {
                (record.broken_text.clone(), record.broken, record.broken_frames.clone())
            }
            Conformance::Kept => {
                (record.kept_text.clone(), record.kept, record.kept_frames.clone())
            }
            Conformance::NotSeen => {
                (record.not_seen_text(doubt, reason), record.broken, record.broken_frames.clone())
            }
        };
        RuleVerdict { rule, conformance, text, samples, frames, assumed: record.assumed.clone() }
    }
}

impl RuleRecord {
    fn not_seen_text(&self, doubt: Option<&str>, reason: &str) -> String {
        match doubt {
            Some(doubt) if self.kept + self.broken > 0 => doubt.to_owned(),
            None if self.broken > 0 && !self.assumed.is_empty() => {
                let keys: Vec<&str> = self.assumed.iter().map(|key| key.name()).collect();
                format!("{}, if the profile is right: give {}", self.broken_text, keys.join(", "))
            }
            None if self.broken > 0 => format!("{}, once only", self.broken_text),
            _ if !self.unsure_text.is_empty() => self.unsure_text.clone(),
            Some(doubt) => doubt.to_owned(),
            None => reason.to_owned(),
        }
    }
}

impl ConformanceRule {
    /// Number of samples that break a rule: a single one may be of another node.
    const fn broken_samples(self) -> u32 {
        match self {
            Self::OwnDFlag
            | Self::OnlyOwnRequests
            | Self::ReservedNotAnswered
            | Self::ReservedRefused
            | Self::OneAnswer
            | Self::TransferFraming
            | Self::ErrorFlag
            | Self::ModeFlag
            | Self::NameFormat
            | Self::ServicesFormat
            | Self::AnswerHeader
            | Self::FlowControlAwaited
            | Self::BlockSizeKept
            | Self::StMinKept
            | Self::FlowWaitKept
            | Self::OverflowKept
            | Self::FlowTimeoutKept
            | Self::GivesWayConfiguring
            | Self::GivesWayWorking
            | Self::KeepsAddressWorking
            | Self::ResolvesAnew => 2,
            _ => 1,
        }
    }
}
