//! `descan log`: the frames of a log, decoded, one per line as text or JSON, or their statistics, or
//! some of them as another log.
//!
//! Input: a log. A file is read twice: for the state with its names, then for the frames, so that a
//! name holds for the frames before it, too. Standard input and pipes are read once, with the names
//! received so far. Output: the frames that match a filter. Memory does not depend on the size of the
//! log. Does not know how frames are decoded.

mod frame_json;
mod frame_log;
mod frame_text;
mod known_names;
mod stats;
mod stats_report;

pub(super) use frame_json::field_json;

use super::headless::{self, Limits, RunInput};
use super::open::{self, Setup};
use super::output::LineOutput;
use super::{EXIT_INTERRUPTED, EXIT_OK, Failure, diff};
use crate::app::{App, AppOptions, CallPart, Calls, Filter, FrameSelector, RowKind};
use crate::bus::BusSpec;
use crate::cli::{CommonArgs, LogArgs};
use crate::frame::Frame;
use crate::shell::stop::StopReason;
use anyhow::Context;
use frame_json::FrameJson;
use frame_log::FrameLog;
use frame_text::FrameText;
use jiff::tz::TimeZone;
use stats::LogStats;
use std::fs::File;
use std::ops::ControlFlow;

/// Runs it.
pub fn run(log: &LogArgs) -> Result<u8, Failure> {
    let spec = diff::spec_of(&log.log);
    let filter = open::filter("--filter", log.filter.as_deref(), RowKind::Frame)?;
    let setup = Setup::new(&CommonArgs {
        catalogue: log.catalogue.clone(),
        dbc: log.dbc.clone(),
        project: log.project.clone(),
        no_project: log.no_project,
        ..CommonArgs::listen_only(log.profile.clone())
    })?;
    let options = AppOptions { time_zone: Some(TimeZone::system()), ..AppOptions::default() };
    let file = headless::log_file(&spec)?;
    // Anything else than a file cannot be read again.
    let is_file = matches!(spec, BusSpec::File(_)) && file.metadata().is_ok_and(|it| it.is_file());
    let range = Limits {
        time: log.time,
        from: log.from,
        while_read: true,
        needs_frames: !is_file,
        stuck: EXIT_INTERRUPTED,
        ..Limits::default()
    };
    let mut printer = FramePrinter::new(log, filter)?;
    let ending = if is_file {
        print_file(&spec, &file, &setup, options, range, &mut printer)?
    } else {
        print_once(&spec, &file, &setup, options, range, &mut printer)?
    };
    Ok(if ending == Some(StopReason::Interrupted) { EXIT_INTERRUPTED } else { EXIT_OK })
}

/// Reads a file twice.
fn print_file(
    spec: &BusSpec,
    file: &File,
    setup: &Setup,
    options: AppOptions,
    range: Limits,
    printer: &mut FramePrinter,
) -> Result<Option<StopReason>, Failure> {
    let whole = Limits { time: None, from: None, ..range };
    let input = RunInput::OpenLog(spec, file);
    let known = headless::run(input, setup, options, whole, |_| Ok(ControlFlow::Continue(())))?;
    if known.ending.is_some() {
        return Ok(known.ending);
    }
    let app = &known.app;
    if !app.buses().is_empty() {
        headless::check_from(spec, range.from, known.now)?;
    }
    headless::warn_foreign(app, &mut Vec::new());
    printer.renew(app);
    let ending = headless::reread(spec, range, |frames| {
        for frame in frames {
            if printer.handle_frame(app, frame)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok(ControlFlow::Continue(()))
    })?;
    if ending.is_none() {
        printer.finish(app)?;
    }
    Ok(ending)
}

/// Reads a log once, and prints the frames as they arrive.
fn print_once(
    spec: &BusSpec,
    file: &File,
    setup: &Setup,
    options: AppOptions,
    range: Limits,
    printer: &mut FramePrinter,
) -> Result<Option<StopReason>, Failure> {
    let (mut next, mut reported) = (0, Vec::new());
    let input = RunInput::OpenLog(spec, file);
    let run = headless::run(input, setup, options, range, |session| {
        let app = &session.app;
        headless::warn_foreign(app, &mut reported);
        printer.renew(app);
        // A batch of frames is much smaller than the smallest capture.
        for (number, frame) in app.capture().frames_from(next) {
            next = number + 1;
            if printer.handle_frame(app, &frame)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        printer.output.flush()?;
        Ok(ControlFlow::Continue(()))
    })?;
    // After a signal too: it is how a pipe that does not end is stopped.
    printer.finish(&run.app)?;
    Ok(run.ending)
}

/// What is printed of the frames.
#[derive(Debug)]
enum FrameOutput {
    Text(FrameText),
    Json(FrameJson),
    Stats(Box<LogStats>),
    Log(FrameLog),
}

/// Prints the frames that match.
#[derive(Debug)]
struct FramePrinter {
    selector: FrameSelector,
    kind: FrameOutput,
    is_json: bool,
    /// Frames that are still to be printed; `None` for all.
    left: Option<u64>,
    calls: Calls,
    /// Number of frames that were looked at.
    number: u64,
    /// True if one of them matched.
    has_printed: bool,
    line: String,
    output: LineOutput,
}

impl FramePrinter {
    fn new(log: &LogArgs, filter: Filter) -> Result<Self, Failure> {
        let kind = if let Some(path) = &log.write {
            FrameOutput::Log(FrameLog::create(path)?)
        } else if log.stats {
            FrameOutput::Stats(Box::default())
        } else if log.json {
            FrameOutput::Json(FrameJson::default())
        } else {
            FrameOutput::Text(FrameText::default())
        };
        Ok(Self {
            selector: FrameSelector::new(filter),
            kind,
            is_json: log.json,
            left: log.limit,
            calls: Calls::default(),
            number: 0,
            has_printed: false,
            line: String::new(),
            output: LineOutput::default(),
        })
    }

    /// Prepares the filter for what is known now. Call before the frames, and when more is known.
    fn renew(&mut self, app: &App) {
        self.selector.renew(app);
    }

    /// Prints a frame if it matches. Breaks when enough are printed.
    fn handle_frame(&mut self, app: &App, frame: &Frame) -> Result<ControlFlow<()>, Failure> {
        let number = self.number;
        self.number += 1;
        let part = match (&self.kind, app.bus(frame.bus)) {
            (FrameOutput::Stats(_) | FrameOutput::Log(_), _) | (_, None) => None,
            (_, Some(bus)) => self.calls.add(frame, number, &bus.config().profile),
        };
        if !self.selector.is_match(frame) {
            if let FrameOutput::Log(log) = &mut self.kind {
                log.note_left_out();
            }
            return Ok(ControlFlow::Continue(()));
        }
        self.has_printed = true;
        self.print(app, frame, part)?;
        if let Some(left) = &mut self.left {
            *left -= 1;
            if *left == 0 {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    fn print(&mut self, app: &App, frame: &Frame, part: Option<CallPart>) -> Result<(), Failure> {
        match &mut self.kind {
            FrameOutput::Text(text) => {
                self.line.clear();
                text.write(&mut self.line, app, frame, part);
                self.output.print(&self.line)
            }
            FrameOutput::Json(json) => {
                self.line.clear();
                json.write(&mut self.line, app, frame, part);
                self.output.print_json(&self.line)
            }
            FrameOutput::Stats(stats) => {
                stats.add(app, frame);
                Ok(())
            }
            FrameOutput::Log(log) => log.write(app, frame),
        }
    }

    /// Prints the statistics, and what waits.
    fn finish(&mut self, app: &App) -> Result<(), Failure> {
        if let FrameOutput::Log(log) = &mut self.kind {
            return log.finish(app);
        }
        if let FrameOutput::Stats(stats) = &mut self.kind {
            stats.end(app);
            if self.is_json {
                let report = stats_report::StatsReport::new(app, stats);
                let json = serde_json::to_string_pretty(&report).context("JSON")?;
                self.output.print_json(&json)?;
                self.output.print_json("\n")?;
            } else {
                self.output.print(&stats_report::text(app, stats))?;
            }
        }
        // A script sees it by the number of objects.
        if matches!(self.kind, FrameOutput::Text(_)) && !self.has_printed && self.number > 0 {
            super::output::warn(format_args!("none of {} frames match the filter", self.number));
        }
        self.output.flush()
    }
}
