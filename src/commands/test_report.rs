//! Reports of tests for other programs: JUnit, TAP, and annotations of GitHub Actions.
//!
//! Input: tests with their outcome. Output: text. Does not know what is tested.

use crate::cli::TestReportFormat;
use crate::text::counted;
use quick_junit::{NonSuccessKind, Report, TestCase as JunitCase, TestCaseStatus, TestSuite};
use std::fmt::Write as _;

/// How a test ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaseOutcome {
    /// It passed.
    Passed,
    /// It failed.
    Failed,
    /// It was not made, or shows nothing.
    Skipped,
}

/// A test.
#[derive(Clone, Debug)]
pub struct ReportedCase {
    /// Of what: a device, a bus.
    pub suite: String,
    /// Its name; stable.
    pub name: String,
    /// How it ended.
    pub outcome: CaseOutcome,
    /// Why, in a sentence.
    pub text: String,
    /// Further lines: frames.
    pub details: Vec<String>,
}

/// Returns a report of tests.
pub fn test_report(name: &str, cases: &[ReportedCase], format: TestReportFormat) -> String {
    match format {
        TestReportFormat::Junit => junit(name, cases),
        TestReportFormat::Tap => tap(cases),
        TestReportFormat::Github => github(name, cases),
    }
}

fn junit(name: &str, cases: &[ReportedCase]) -> String {
    let mut report = Report::new(name);
    for group in cases.chunk_by(|one, two| one.suite == two.suite) {
        let mut suite = TestSuite::new(group[0].suite.as_str());
        suite.add_test_cases(group.iter().map(junit_case));
        report.add_test_suite(suite);
    }
    let text = report.to_string().unwrap_or_default();
    if text.ends_with('\n') { text } else { text + "\n" }
}

fn junit_case(case: &ReportedCase) -> JunitCase {
    let status = match case.outcome {
        CaseOutcome::Passed => TestCaseStatus::success(),
        CaseOutcome::Failed => {
            let mut status = TestCaseStatus::non_success(NonSuccessKind::Failure);
            status.set_message(case.text.as_str());
            status.set_description(case.lines().join("\n"));
            status
        }
        CaseOutcome::Skipped => {
            let mut status = TestCaseStatus::skipped();
            status.set_message(case.text.as_str());
            status
        }
    };
    let mut junit = JunitCase::new(case.name.as_str(), status);
    junit.set_classname(case.suite.as_str());
    junit
}

impl ReportedCase {
    /// The sentence and the further lines.
    fn lines(&self) -> Vec<&str> {
        std::iter::once(&self.text).chain(&self.details).map(String::as_str).collect()
    }
}

/// Version 13, which all readers take: a line for each test, and the reason of a failure in YAML.
fn tap(cases: &[ReportedCase]) -> String {
    let mut out = format!("TAP version 13\n1..{}\n", cases.len());
    for (number, case) in (1..).zip(cases) {
        let verdict = if case.outcome == CaseOutcome::Failed { "not ok" } else { "ok" };
        let name = escaped(&format!("{}: {}", case.suite, case.name), &['\\', '#']);
        let _ = write!(out, "{verdict} {number} - {name}");
        let _ = match case.outcome {
            CaseOutcome::Skipped => writeln!(out, " # SKIP {}", in_one_line(&case.text)),
            _ => writeln!(out),
        };
        if case.outcome == CaseOutcome::Failed {
            let _ = writeln!(out, "  ---\n  message: {}\n  details:", quoted(&case.text));
            for line in &case.details {
                let _ = writeln!(out, "    - {}", quoted(line));
            }
            let _ = writeln!(out, "  ...");
        }
    }
    out
}

/// Returns a string of YAML.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

fn in_one_line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

fn escaped(text: &str, special: &[char]) -> String {
    let mut out = String::with_capacity(text.len());
    for character in in_one_line(text).chars() {
        if special.contains(&character) {
            out.push('\\');
        }
        out.push(character);
    }
    out
}

/// A line for each failure, and one with the sums.
fn github(name: &str, cases: &[ReportedCase]) -> String {
    let mut out = String::new();
    for case in cases.iter().filter(|it| it.outcome == CaseOutcome::Failed) {
        let title = annotation_property(&format!("{}: {}", case.suite, case.name));
        let message = annotation_text(&case.lines().join("\n"));
        let _ = writeln!(out, "::error title={title}::{message}");
    }
    let count = |outcome| cases.iter().filter(|it| it.outcome == outcome).count() as u64;
    let tests = counted(cases.len() as u64, "test");
    let (failed, skipped) = (count(CaseOutcome::Failed), count(CaseOutcome::Skipped));
    let sums = format!("{tests}, {failed} failed, {skipped} skipped");
    let _ = writeln!(out, "::notice title={}::{sums}", annotation_property(name));
    out
}

/// Escapes the text of an annotation.
fn annotation_text(text: &str) -> String {
    text.replace('%', "%25").replace('\r', "%0D").replace('\n', "%0A")
}

/// Escapes a property of an annotation.
fn annotation_property(text: &str) -> String {
    annotation_text(text).replace(':', "%3A").replace(',', "%2C")
}
