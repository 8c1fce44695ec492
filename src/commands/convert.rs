//! `descan convert`: a log in another format.
//!
//! Reads frame by frame, in constant memory, and writes a file beside OUT, which takes its place at the
//! end. A signal ends a pipe, whose frames so far are written, and discards the file of another log.
//! Does not know formats.

use super::diff::spec_of;
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, output};
use crate::bus::{self, BusSpec, unpacked_log, wall_micros};
use crate::cli::ConvertArgs;
use crate::diagnostic::Diagnostic;
use crate::log::{FORMATS, LogEncoder, LogEntry, LogFormat, LogReader, LogSummary, READABLE_LOGS};
use crate::open_file::{is_at, stdin_file};
use crate::regular_file;
use crate::shell::pipe_input::PipeInput;
use crate::shell::stop;
use crate::shell::store::StagedFile;
use crate::text::printable_path;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes that are written at once.
const PART: usize = 1 << 16;

/// Writes the log.
pub fn run(args: &ConvertArgs) -> Result<u8, Failure> {
    let format = format_of(args)?;
    let spec = spec_of(&args.input);
    let unusable = |error: io::Error| Failure::from(Diagnostic::unreadable(&spec, &error));
    let file = match &spec {
        BusSpec::File(path) => bus::open_log(path)?,
        _ => stdin_file().map_err(unusable)?,
    };
    let is_file = file.metadata().map_err(unusable)?.is_file();
    let file = Arc::new(file);
    let temporary = Arc::default();
    let is_stopped = stop_on_signal(&temporary)?;
    let source = if is_file {
        unpacked_log(Arc::clone(&file), &file)
    } else {
        // What a signal ends is complete up to there.
        PipeInput::spawn(Arc::clone(&file), Arc::clone(&is_stopped))
            .and_then(|pipe| unpacked_log(pipe, &file))
    };
    let source = source.map_err(unusable)?;
    let mut reader = LogReader::new(BufReader::with_capacity(PART, source));
    if !is_file {
        reader.date_arrivals(wall_micros);
        reader.hold_partial_entry();
    }
    let is_own = is_same_file(&file, &args.output);
    let mut target = ConvertedLog::create(&args.output, args.force, &temporary)?;
    let mut encoder = format.encoder();
    let mut part = Vec::with_capacity(PART + 1024);
    encoder.begin(&mut part).map_err(|error| target.not_written(&error))?;
    while !is_file || !is_stopped.load(Ordering::Relaxed) {
        let mut next = reader.next_frame().map_err(unusable)?;
        if next.is_none() && !is_file {
            // The line that a signal cut is not a frame.
            let is_cut = is_stopped.load(Ordering::Relaxed);
            next = if is_cut { reader.read_held_entry() } else { reader.read_partial_entry() };
        }
        let Some(frame) = next else { break };
        let summary = reader.summary();
        let interface = summary.interfaces.get(usize::from(frame.bus.0));
        let interface = interface.map_or("", String::as_str);
        let entry = LogEntry { time: summary.written, interface, frame };
        let written = encoder.write(entry, u64::MAX, &mut part);
        written.map_err(|error| target.not_written(&error))?;
        // What a pipe has for now is written at once.
        if part.len() >= PART || (!is_file && !reader.has_buffered()) {
            target.write(&part)?;
            part.clear();
        }
    }
    let is_stopped = is_stopped.load(Ordering::Relaxed);
    let summary = reader.summary();
    if is_stopped && (is_file || summary.own_frames() == 0) {
        return Ok(EXIT_INTERRUPTED);
    }
    if summary.own_frames() == 0 {
        let fault = Diagnostic::new(summary.to_string());
        let fault = if summary.lost_entries() > 0 {
            fault.with_remedy(READABLE_LOGS)
        } else {
            fault.with_remedy("check that it is the right log")
        };
        return Err(fault.of(&spec).into());
    }
    if is_own && (summary.lost_entries() > 0 || summary.ends_inside_entry) {
        let fault =
            Diagnostic::new(format!("not replaced, as not all of it can be read: {summary}"));
        let fault = fault.with_remedy("write to another file");
        return Err(fault.of(printable_path(&args.output)).into());
    }
    let names = summary.interfaces.to_vec();
    encoder.end(&names, &[], &mut part).map_err(|error| target.not_written(&error))?;
    target.write(&part)?;
    target.finish(encoder.head())?;
    report(summary, encoder.as_ref(), &spec, &args.output);
    if is_stopped {
        return Ok(EXIT_INTERRUPTED);
    }
    Ok(if summary.lost_entries() > 0 { EXIT_FINDINGS } else { EXIT_OK })
}

/// Returns true if the output is the log that is read.
fn is_same_file(file: &File, output: &Path) -> bool {
    output != Path::new("-") && is_at(file, output).unwrap_or(false)
}

fn format_of(args: &ConvertArgs) -> Result<&'static LogFormat, Failure> {
    if LogFormat::has_packed_ending(&args.output) {
        let cause = "convert does not compress";
        let remedy = "write it without this ending, then use gzip, zstd or xz";
        return Err(Failure::Usage(format!("{}: {cause}; {remedy}", printable_path(&args.output))));
    }
    if let Some(name) = &args.format {
        // The command line has checked the name.
        return FORMATS
            .iter()
            .find(|format| format.name == name)
            .ok_or_else(|| Failure::Usage(format!("no format {name}")));
    }
    LogFormat::of_written(&args.output).ok_or_else(|| {
        let names: Vec<_> = FORMATS.iter().map(|format| format.name).collect();
        let out = printable_path(&args.output);
        let cause = "the name says no format";
        Failure::Usage(format!("{out}: {cause}; --format names one: {}", names.join(", ")))
    })
}

/// Prints on standard error what was written, and what was not.
fn report(summary: &LogSummary, encoder: &dyn LogEncoder, spec: &BusSpec, out: &Path) {
    output::warn(format_args!("{spec}: {summary}"));
    let loss = encoder.loss();
    if !loss.is_empty() {
        output::warn(format_args!("{}: not in this format: {loss}", printable_path(out)));
    }
}

/// Returns what is set on the first signal. A program that is still waiting for input 0.9 s later exits
/// without the temporary file.
fn stop_on_signal(temporary: &Arc<Mutex<Option<PathBuf>>>) -> Result<Arc<AtomicBool>, Failure> {
    let is_stopped = Arc::new(AtomicBool::new(false));
    let (flag, temporary) = (Arc::clone(&is_stopped), Arc::clone(temporary));
    let discard = move || {
        let path = temporary.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(path) = path {
            // It may be gone.
            let _ = std::fs::remove_file(path);
        }
    };
    stop::on_signal(EXIT_INTERRUPTED, move || flag.store(true, Ordering::Relaxed), discard)
        .map_err(|error| Failure::System(error.into()))?;
    Ok(is_stopped)
}

/// Where the log is written.
struct ConvertedLog {
    path: PathBuf,
    /// The file until it takes its place; `None` for standard output.
    file: Option<StagedFile>,
}

impl ConvertedLog {
    /// Creates a file, whose path is `temporary`, beside `path`.
    fn create(
        path: &Path,
        force: bool,
        temporary: &Mutex<Option<PathBuf>>,
    ) -> Result<Self, Failure> {
        let path = path.to_owned();
        if path == Path::new("-") {
            return Ok(Self { path, file: None });
        }
        if path.to_string_lossy().ends_with(std::path::is_separator) {
            let fault = Diagnostic::new("names a folder").with_remedy("name a file in it");
            return Err(fault.of(printable_path(&path)).into());
        }
        // A device such as /dev/full, a pipe and a folder are not replaced.
        let metadata = std::fs::metadata(&path).ok();
        if metadata.as_ref().is_some_and(|it| !it.is_file()) {
            return Err(Diagnostic::new("not a file").of(printable_path(&path)).into());
        }
        if metadata.is_some() && !force {
            let fault = Diagnostic::new("already exists").with_remedy("--force replaces it");
            return Err(fault.of(printable_path(&path)).into());
        }
        let file =
            StagedFile::create(&path, force).map_err(|fault| fault.of(printable_path(&path)))?;
        *temporary.lock().unwrap_or_else(PoisonError::into_inner) = Some(file.path().to_owned());
        Ok(Self { path, file: Some(file) })
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        match &mut self.file {
            Some(file) => {
                Ok(file.append(bytes).map_err(|fault| fault.of(printable_path(&self.path)))?)
            }
            None => output::print_own(bytes),
        }
    }

    /// Replaces the first bytes of the file with `head`, and puts it in its place.
    fn finish(self, head: Option<Vec<u8>>) -> Result<(), Failure> {
        let Some(mut file) = self.file else {
            if head.is_some() {
                output::warn("standard output: the head of the log has no end time and no size");
            }
            return Ok(());
        };
        let with_head = head.map_or(Ok(()), |head| file.replace_start(&head));
        let finished = with_head.and_then(|()| file.finish());
        Ok(finished.map_err(|fault| fault.of(printable_path(&self.path)))?)
    }

    /// Returns the fault of an entry that the format does not take.
    fn not_written(&self, error: &io::Error) -> Failure {
        regular_file::of_system(error, "not written").of(printable_path(&self.path)).into()
    }
}
