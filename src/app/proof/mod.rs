//! The proof of a problem, for the author of a firmware: a report in Markdown and the frames around the
//! evidence as pcapng. Both are readable without descan.
//!
//! Input: the problem and the captured frames of the moment that is shown. Output: two new files; the
//! report is written when the frames are. Bounded: [`MAX_FRAMES`] frames. Does not know where files are
//! stored.

mod frames;
pub(crate) mod markdown;
mod report;

use super::input::ProofPathPrompt;
use super::problems::{Problem, ProblemKey};
use super::{App, Effect, PromptKind};
use crate::diagnostic::Diagnostic;
use crate::text::{printable, printable_path};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Most frames in a proof: two megabytes, as an e-mail takes them.
pub const MAX_FRAMES: usize = 20_000;
/// Longest part of a bus's name in the name of the files, in bytes.
const MAX_BUS_NAME: usize = 24;

/// The report of a proof whose frames are being written.
#[derive(Debug)]
pub(super) struct PendingProof {
    frames: PathBuf,
    report: PathBuf,
    /// The report; `None` while it is being written.
    text: Option<String>,
}

impl App {
    /// Opens the prompt for the path of the proof of the selected problem.
    pub(super) fn ask_proof_path(&mut self) {
        if self.view.page != super::Page::Problems {
            return self.show_error("a proof is written on the Problems page");
        }
        let Some(problem) = self.selected_problem() else {
            return self.show_error("no problem is selected");
        };
        let place = self.proof_place(&problem);
        let path = format!("proof-{place}-{}.md", self.clock.stamp());
        self.open_prompt(PromptKind::ProofPath(ProofPathPrompt { problem: problem.key }), path);
    }

    /// The problem in the name of a file: its address, or `bus` or `file`; with several buses the bus
    /// before it.
    fn proof_place(&self, problem: &Problem) -> String {
        let bus = problem.bus().filter(|_| self.buses().len() > 1).and_then(|bus| self.bus(bus));
        let bus = bus.map_or(String::new(), |bus| {
            let is_plain = |c: &char| c.is_ascii_alphanumeric() || *c == '_';
            let name: String = bus.name.chars().filter(is_plain).take(MAX_BUS_NAME).collect();
            format!("{name}-")
        });
        let place = match (problem.head().key.address, problem.bus()) {
            (Some(address), _) => address.to_string(),
            (None, Some(_)) => "bus".to_owned(),
            (None, None) => "file".to_owned(),
        };
        format!("{bus}{place}")
    }

    /// Writes the proof of a problem to a path with the ending `.md`, and its frames beside it.
    pub(super) fn write_proof(&mut self, key: &ProblemKey, path: PathBuf) {
        let frames = frames_path(&path);
        let Some(problem) = self.problems().iter().find(|problem| problem.key == *key) else {
            return self.show_error("the problem is no longer known");
        };
        let proof = frames::of_problem(self, &problem);
        let name = frames.file_name().unwrap_or_default();
        let text = report::of_problem(self, &problem, &proof, &printable(name.as_encoded_bytes()));
        let bytes = frames::as_pcapng(self, &problem, &proof);
        self.effects.push_back(Effect::WriteFile { path: frames.clone(), bytes });
        self.proof = Some(PendingProof { frames, report: path, text: Some(text) });
    }

    /// Takes the result of writing one of the two files; the report is written after the frames. Returns
    /// false if `path` is another file.
    pub(super) fn handle_written_proof(
        &mut self,
        path: &Path,
        result: &Result<(), Diagnostic>,
    ) -> bool {
        let Some(proof) = &mut self.proof else { return false };
        let is_of_frames = proof.text.is_some() && path == proof.frames;
        if !is_of_frames && path != proof.report {
            return false;
        }
        match (result, proof.text.take()) {
            (Ok(()), Some(text)) => {
                let (path, bytes) = (proof.report.clone(), text.into_bytes());
                self.effects.push_back(Effect::WriteFile { path, bytes });
                return true;
            }
            (Ok(()), None) => {
                let report = printable_path(&proof.report);
                self.show_info(format!("saved: {report} and its .pcapng"));
            }
            (Err(why), text) => {
                let (path, frames) = (proof.report.clone(), printable_path(&proof.frames));
                let cause = match text {
                    Some(_) => format!("proof not saved: {why}"),
                    None => format!("report not saved: {why}; frames saved: {frames}"),
                };
                if !self.reopen_prompt(&path, &cause) {
                    self.show_error(cause);
                }
            }
        }
        self.proof = None;
        true
    }
}

/// Path of the frames of a report.
fn frames_path(report: &Path) -> PathBuf {
    report.with_extension("pcapng")
}

/// Returns true if the path is that of a report.
pub(super) fn is_report(path: &Path) -> bool {
    path.extension() == Some(OsStr::new("md"))
}
