//! Replay: a log as a port. Its frames are delivered at their times.
//!
//! The clock sets the speed: see [`Clock::replaying`]. Frames marked as sent in the log have `is_tx`.
//!
//! The end of a file may be temporary: if the file grows, new frames are delivered as they are
//! written; if it is truncated or replaced, it is read from its start. Does not know log formats.

pub(super) mod dates;
pub(super) mod file;
mod index;
pub(super) mod stdin;
pub(super) mod unpacking;

use super::clock::{Clock, wall_micros};
use super::faults::cannot_open;
use super::kind::OpenRequest;
use super::port::{Port, PortShared};
use super::waker::Waitable;
use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, Frame};
use crate::log::{DecodeStep, LogReader, Packing, READABLE_LOGS, RandomAccess, Unpacked};
use crate::open_file::is_at;
use crate::positioned_read::{read_at, read_next};
use crate::status::{Link, RateSearch};
use crate::time::{Duration, Instant};
use dates::last_time;
use index::{FilePart, LogIndex};
use std::fs::{self, File};
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant as Monotonic;
use unpacking::{UnpackedFile, unpacked_with};

/// Lateness of a frame beyond which the rest of the log is shifted with it. A live log
/// (`ssh board candump -L can0 | descan -`) is always a little late.
const MAX_LATENESS: Duration = Duration::from_millis(250);
/// Of a log that is not shown at its own dates.
const OTHER_DATES: &str = "recorded at another time: begins with the first log";
/// Smallest difference of the times shown and those of the log that is reported.
const MIN_MOVE: Duration = Duration::from_millis(100);
/// How long to wait for the consumer when the queue is full.
const FULL_QUEUE_NAP: Duration = Duration::from_millis(5);
/// Most frames that are delivered together while a log is read as fast as possible.
const AT_ONCE: usize = 1024;
/// How often to check whether a file that was read to its end has grown.
const LOOK_EVERY: Duration = Duration::from_millis(300);
/// How long a file that grew may rest before its end is reported again: writers with a buffer write
/// in intervals.
const IDLE_BEFORE_END: Duration = Duration::from_secs(5);
/// Age of a file after which a last line without an end counts as complete.
const UNFINISHED: Duration = Duration::from_secs(10);

/// Opens a log whose first interface is bus `index` of the request, its second the next, and so on.
/// At its end more of it is looked for at `path`, if there is one.
fn open(log: File, path: Option<&Path>, request: OpenRequest) -> Result<Port, Diagnostic> {
    let name = request.name.clone();
    start(log, path, request).map_err(|error| cannot_open(name, &error))
}

fn start(log: File, path: Option<&Path>, request: OpenRequest) -> io::Result<Port> {
    let OpenRequest { name, index: bus, clock, .. } = request;
    let shared = Arc::new(PortShared::new()?);
    shared.queue.update_status(|status| {
        status.link = Link::Up;
        status.rate_search = RateSearch::NoRate;
        status.listen_only = true;
    });
    let log = OpenLog::new(log)?;
    let is_file = log.is_file;
    clock.log_opens(bus, !is_file);
    let later = clock.start_of(bus).map_or(Duration::ZERO, |start| start.since(clock.now()));
    if !later.is_zero() {
        let note = format!("its first frame is {:.1} s after the start", later.as_secs_f64());
        shared.queue.update_status(|status| {
            (status.link, status.note) = (Link::Opening, Some(note));
        });
    }
    let mut port = Port::new(&name, Arc::clone(&shared), true);
    let path = path.filter(|_| is_file).map(Path::to_owned);
    let (source, unpacked) = log.source(&shared)?;
    let mut reader = LogReader::new(source);
    if !is_file {
        reader.date_arrivals(wall_micros);
    }
    let index = if is_file {
        let index = LogIndex::new(unpacked, bus, reader.position());
        port.set_frame_source(Box::new(index.clone()));
        Some(index)
    } else {
        None
    };
    port.serve(move |shared| {
        let mut replay = Replay {
            reader,
            log,
            index,
            shared: Arc::clone(shared),
            path,
            bus,
            clock,
            start: None,
            anchor: None,
            last: Instant::ZERO,
            awaits_start: true,
            is_resuming: false,
            is_another: false,
            reads_to: Instant::ZERO,
            waiting: Vec::with_capacity(AT_ONCE),
            named: 0,
            follows: false,
            percent: None,
            unreadable: 0,
            is_doubted: false,
        };
        if let Err(error) = replay.run() {
            shared.queue.finish(Link::Failed, Diagnostic::unreadable(name, &error));
        }
    })?;
    Ok(port)
}

struct Replay {
    reader: LogReader<BufReader<Unpacked<'static>>>,
    log: OpenLog,
    /// Where its frames can be read again; `None` if they cannot.
    index: Option<LogIndex>,
    shared: Arc<PortShared>,
    /// The path to watch for more of the log; `None` if it cannot grow.
    path: Option<PathBuf>,
    /// Bus of its first interface.
    bus: BusIndex,
    clock: Clock,
    /// Moment of its first frame in the log, and in the session.
    start: Option<(Instant, Instant)>,
    /// Moment of a frame in the log, and in the session, from which on it is shown: that of its start,
    /// unless it is late since.
    anchor: Option<(Instant, Instant)>,
    /// Time of its last frame that was delivered.
    last: Instant,
    /// Its first frame was not delivered yet.
    awaits_start: bool,
    /// The next frame is the first one after its end.
    is_resuming: bool,
    /// The next frame is the first one of another log.
    is_another: bool,
    /// Moment up to which frames are delivered as fast as possible, as it was last looked at.
    reads_to: Instant,
    /// Frames that are delivered together.
    waiting: Vec<Frame>,
    /// How many interface names were reported.
    named: usize,
    /// It has continued after its end: frames are delivered as they are written.
    follows: bool,
    percent: Option<u8>,
    /// Number of unreadable entries that was reported.
    unreadable: u64,
    /// It was reported that this is probably not a log.
    is_doubted: bool,
}

/// How a log continues after its end.
enum Continuation {
    /// It grew.
    Grown,
    /// Another log begins; the text says why.
    Anew(&'static str),
}

impl Replay {
    fn run(&mut self) -> io::Result<()> {
        if self.path.is_some() {
            self.reader.hold_partial_entry();
        }
        loop {
            while let Some(frame) = self.next_frame()? {
                self.note_frame();
                if !self.play(frame)? {
                    return Ok(());
                }
            }
            if !self.flush()? {
                return Ok(());
            }
            let Some(more) = self.wait_for_more()? else { return Ok(()) };
            self.follows = true;
            if let Continuation::Anew(why) = more {
                self.begin_another_log(why)?;
            }
        }
    }

    /// Reads another log from its start. Its frames follow after what reads the queue has taken those
    /// before, and knows of the change.
    fn begin_another_log(&mut self, why: &str) -> io::Result<()> {
        let (source, unpacked) = self.log.source(&self.shared)?;
        self.reader.restart(source);
        if let Some(index) = &self.index {
            index.restart(unpacked, self.reader.position());
        }
        let queue = &self.shared.queue;
        while queue.has_frames() && !self.shared.is_stopped() {
            self.shared.wait(None, Some(FULL_QUEUE_NAP))?;
        }
        queue.update_status(|status| {
            (status.link, status.fault, status.note) = (Link::Up, None, Some(why.to_owned()));
            status.log_changes += 1;
        });
        while queue.has_new_status() && !self.shared.is_stopped() {
            self.shared.wait(None, Some(FULL_QUEUE_NAP))?;
        }
        Ok(())
    }

    fn next_frame(&mut self) -> io::Result<Option<Frame>> {
        let frame = loop {
            // A pipe may not have more for long.
            if self.path.is_none() && !self.reader.has_buffered() {
                if !self.flush()? {
                    break None;
                }
                if !self.awaits_start {
                    self.clock.log_awaits_writer(self.bus, self.last);
                }
            }
            match self.reader.step()? {
                DecodeStep::Frame(frame) => break Some(frame),
                DecodeStep::End => break None,
                DecodeStep::Nothing => self.report_doubt(),
            }
        };
        if frame.is_some() || self.path.is_none() {
            return Ok(frame);
        }
        // The last line may have no end because it is just being written.
        let written = self.log.file.metadata()?.modified()?;
        let is_left = written.elapsed().is_ok_and(|age| age >= UNFINISHED);
        Ok(if is_left { self.reader.read_partial_entry() } else { None })
    }

    /// Notes in the index that a frame was read.
    fn note_frame(&self) {
        let Some(index) = &self.index else { return };
        let place = || {
            let source = self.reader.source();
            let offset = source.get_ref().count() - source.buffer().len() as u64;
            (self.reader.position(), offset)
        };
        index.note_frame(self.reader.summary().frames, place);
    }

    /// Delivers a frame when it is due, or, after the end, at once. Returns false if the port was
    /// dropped.
    fn play(&mut self, frame: Frame) -> io::Result<bool> {
        for name in &self.reader.summary().interfaces[self.named..] {
            self.shared.queue.add_name(name);
            self.named += 1;
        }
        let (from, to) = self.anchor.unwrap_or_else(|| self.begin_at(&frame));
        let mut due = to + frame.time.since(from);
        // Of a pipe, only what is not late.
        let is_in_time = || self.path.is_some() || due >= self.clock.now();
        if due <= self.reads_to && !self.follows && is_in_time() {
            return self.play_at_once(frame.with_time(due));
        }
        if !self.flush()? {
            return Ok(false);
        }
        let planned = due;
        if std::mem::take(&mut self.is_resuming) {
            let (from, to) = self.start.unwrap_or((from, to));
            let dated = to + frame.time.since(from);
            due = self.clock.log_resumes(self.bus, dated);
            self.report_resumed(dated, due);
        }
        self.clock.log_waits(self.bus, due);
        due = due.max(self.clock.now() - self.clock.run_in(MAX_LATENESS));
        if due != planned {
            self.anchor = Some((frame.time, due));
            self.clock.log_waits(self.bus, due);
        }
        loop {
            if self.shared.is_stopped() {
                return Ok(false);
            }
            let is_full = self.shared.queue.room() == 0;
            self.reads_to = self.clock.reads_to();
            let is_read_ahead = due <= self.reads_to;
            if (is_read_ahead || self.clock.is_due(due)) && !is_full {
                break;
            }
            let nap = if is_full { FULL_QUEUE_NAP } else { self.clock.until_due(due) };
            self.shared.wait(None, Some(nap))?;
        }
        self.report_position();
        let bus = BusIndex(self.bus.0.saturating_add(frame.bus.0));
        self.push(&[frame.with_time(due).with_bus(bus)]);
        self.last = due;
        Ok(true)
    }

    /// Returns the time of the first frame in the log, and in the session.
    fn begin_at(&mut self, frame: &Frame) -> (Instant, Instant) {
        // The session begins with the log, if its dates are the log's.
        let epoch = self.reader.summary().epoch;
        let own = Some(Instant::ZERO).filter(|_| epoch == Some(self.clock.epoch()));
        let start = self.clock.start_of(self.bus).or(own);
        let to = start.unwrap_or_else(|| self.clock.now());
        self.start = Some((frame.time, to));
        self.anchor = self.start;
        // Of a packed log only the beginning is unpacked.
        let index = self.index.as_ref().filter(|_| !self.log.is_packed);
        let last = index.and_then(|index| index.last_time(&self.reader.position()));
        match last {
            Some(last) => self.clock.set_log_end(self.bus, to + last.since(frame.time)),
            None => self.look_for_end(to - frame.time.since(Instant::ZERO)),
        }
        (frame.time, to)
    }

    /// Reads the file to its end beside the replay, to know how long the log is; `start` is the time in the
    /// session of the start of the log.
    fn look_for_end(&self, start: Instant) {
        if self.path.is_none() {
            return;
        }
        let file = FilePart::new(Arc::clone(&self.log.file));
        let (clock, bus, shared) = (self.clock.clone(), self.bus, Arc::clone(&self.shared));
        self.clock.set_seeks_end(bus, true);
        let seek = move || {
            if let Ok(Some(last)) = last_time(file, || shared.is_stopped()) {
                clock.set_log_end(bus, start + last.since(Instant::ZERO));
            }
            clock.set_seeks_end(bus, false);
            // The clock may stand, so that nothing else reports it.
            shared.queue.repeat_status();
        };
        // Without a thread, or with a fault, its length is that of what was read.
        if std::thread::Builder::new().name("log end".into()).spawn(seek).is_err() {
            self.clock.set_seeks_end(bus, false);
        }
    }

    /// Delivers a frame that is due, together with others. Returns false if the port was dropped.
    fn play_at_once(&mut self, frame: Frame) -> io::Result<bool> {
        if self.waiting.is_empty() {
            // The clock does not pass it before it is delivered.
            self.clock.log_waits(self.bus, frame.time);
        }
        self.last = frame.time;
        let bus = BusIndex(self.bus.0.saturating_add(frame.bus.0));
        self.waiting.push(frame.with_bus(bus));
        if self.waiting.len() < AT_ONCE { Ok(true) } else { self.flush() }
    }

    /// Delivers the frames that wait to be delivered together. Returns false if the port was dropped.
    fn flush(&mut self) -> io::Result<bool> {
        if self.waiting.is_empty() {
            return Ok(true);
        }
        while self.shared.queue.room() < self.waiting.len() {
            if self.shared.is_stopped() {
                return Ok(false);
            }
            self.shared.wait(None, Some(FULL_QUEUE_NAP))?;
        }
        let mut waiting = std::mem::take(&mut self.waiting);
        self.push(&waiting);
        waiting.clear();
        self.waiting = waiting;
        self.reads_to = self.clock.reads_to();
        self.report_position();
        Ok(!self.shared.is_stopped())
    }

    /// Reports that it is probably not a log: a pipe may not end.
    fn report_doubt(&mut self) {
        let summary = self.reader.summary();
        let is_all = self.reader.source().buffer().is_empty();
        if self.is_doubted || !summary.is_doubtful(is_all) {
            return;
        }
        self.is_doubted = true;
        let note = format!("{}; {READABLE_LOGS}", summary.unreadable_entries());
        self.shared.queue.update_status(|status| status.note = Some(note));
        self.report_position();
    }

    /// Delivers frames; with the first one the log is open.
    fn push(&mut self, frames: &[Frame]) {
        if !std::mem::take(&mut self.awaits_start) {
            return self.shared.queue.push(frames);
        }
        let other_dates = || {
            let (from, to) = self.start?;
            let own = self.reader.summary().epoch?.unix_micros(from);
            self.clock.start_of(self.bus)?;
            (self.clock.epoch().unix_micros(to) != own).then_some(OTHER_DATES.to_owned())
        };
        let note = other_dates();
        self.shared.queue.push_first(frames, |status| {
            (status.link, status.note) = (Link::Up, note);
        });
    }

    /// Reports that frames follow after the end of the log, and whether they are shown at other times
    /// than they are dated. The dates of another log are not compared with those of the one before.
    fn report_resumed(&mut self, dated: Instant, due: Instant) {
        if std::mem::take(&mut self.is_another) {
            return;
        }
        let (by, way) =
            if due >= dated { (due.since(dated), "later") } else { (dated.since(due), "earlier") };
        let seconds = by.as_secs_f64();
        let note = format!("its times are shown {seconds:.1} s {way} than in the log");
        let note = Some(note).filter(|_| by >= MIN_MOVE);
        self.shared.queue.update_status(|status| {
            (status.link, status.fault, status.note) = (Link::Up, None, note);
        });
    }

    /// Reports how much is read, if the size is known.
    fn report_position(&mut self) {
        let percent = self.log.percent(self.reader.source().buffer().len());
        let unreadable = self.reader.summary().lost_entries();
        if (percent, unreadable) != (self.percent, self.unreadable) {
            (self.percent, self.unreadable) = (percent, unreadable);
            self.shared.queue.update_status(|status| {
                (status.percent, status.unreadable) = (percent, unreadable);
            });
        }
    }

    /// Waits at the end until there is more; `None` if there will be none.
    fn wait_for_more(&mut self) -> io::Result<Option<Continuation>> {
        let Some(path) = self.path.clone() else {
            self.end();
            return Ok(None);
        };
        let since = Monotonic::now();
        let mut is_told = false;
        // What was written after its end had no frame: it is still at its end.
        let is_at_end = !self.follows || self.is_resuming;
        if !is_at_end {
            self.clock.log_awaits_more(self.bus, self.last);
        }
        while !self.shared.is_stopped() {
            // Before the file has grown once, its end counts as the end of the log.
            if !is_told && (is_at_end || since.elapsed() >= IDLE_BEFORE_END) {
                self.end();
                is_told = true;
            }
            let is_damaged = self.reader.is_damaged();
            if let Some(more) = self.log.check_file(&path, is_damaged)? {
                self.is_resuming |= is_told || matches!(more, Continuation::Anew(_));
                self.is_another |= matches!(more, Continuation::Anew(_));
                return Ok(Some(more));
            }
            self.shared.wait(None, Some(LOOK_EVERY))?;
        }
        Ok(None)
    }

    /// Reports the end of the log, which may be temporary.
    fn end(&mut self) {
        self.report_position();
        let mut summary = self.reader.summary().to_string();
        if self.reader.has_partial_entry() && self.reader.summary().damage.is_none() {
            summary.push_str("; last line incomplete");
        }
        let fault = Diagnostic::new(summary);
        let fault = match self.reader.summary() {
            summary if summary.own_frames() > 0 => fault,
            summary if summary.lost_entries() > 0 => fault.with_remedy(READABLE_LOGS),
            _ => fault.with_remedy("check that it is the right log"),
        };
        // In this order: what reads the queue knows of the end before the clock goes on without it.
        self.shared.queue.update_status(|status| {
            (status.link, status.fault) = (Link::Ended, Some(fault));
        });
        self.clock.log_ends(self.bus, self.last);
    }
}

impl Drop for Replay {
    /// The clock does not wait for it any more, also after a panic.
    fn drop(&mut self) {
        self.clock.log_ends(self.bus, self.last);
    }
}

/// Returns how a log file is packed; `None` if it is not.
fn packing(log: &File) -> io::Result<Option<Packing>> {
    let mut head = [0; Packing::HEAD];
    let len = read_at(log, &mut head, 0)?;
    Ok(Packing::of_head(&head[..len]))
}

/// The file of a log.
struct OpenLog {
    file: Arc<File>,
    is_file: bool,
    /// Bytes read.
    read: Arc<AtomicU64>,
    /// Its size in bytes when it was last checked.
    size: u64,
    is_packed: bool,
}

impl OpenLog {
    fn new(file: File) -> io::Result<Self> {
        let metadata = file.metadata()?;
        let is_file = metadata.is_file();
        let is_packed = is_file && packing(&file)?.is_some();
        let (file, size) = (Arc::new(file), metadata.len());
        Ok(Self { file, is_file, read: Arc::default(), size, is_packed })
    }

    /// Returns the bytes of the log from the start of the file, and the file in which they lie unpacked.
    fn source(&self, shared: &Arc<PortShared>) -> io::Result<(BufReader<Unpacked<'static>>, File)> {
        let (file, read) = (Arc::clone(&self.file), Arc::clone(&self.read));
        let source = LogSource { file, shared: Arc::clone(shared), read };
        let pages = self.is_file.then(|| source.clone());
        let mut source = unpacked_with(source, pages, &self.file);
        let unpacked = if self.is_packed {
            let copy = UnpackedFile::new()?;
            let unpacked = copy.reader()?;
            source = source.with_copy(copy);
            unpacked
        } else {
            self.file.try_clone()?
        };
        Ok((BufReader::with_capacity(1 << 16, source), unpacked))
    }

    /// How much is decoded, in percent; `buffered` bytes are not. `None` if the size is not known.
    fn percent(&self, buffered: usize) -> Option<u8> {
        let (all, buffered) = (self.read(), if self.is_packed { 0 } else { buffered as u64 });
        let percent = (all.saturating_sub(buffered) * 100).checked_div(self.size.max(all))?;
        self.is_file.then(|| percent.min(100) as u8)
    }

    fn read(&self) -> u64 {
        self.read.load(Ordering::Relaxed)
    }

    /// Checks whether there is more than was read. A packed log that grew is not read on.
    fn check_file(&mut self, path: &Path, is_damaged: bool) -> io::Result<Option<Continuation>> {
        let own = self.file.metadata()?;
        let is_shorter = own.len() < self.read().min(self.size);
        self.size = own.len();
        if is_shorter {
            (&*self.file).seek(SeekFrom::Start(0))?;
            *self = Self::new(self.file.try_clone()?)?;
            return Ok(Some(Continuation::Anew(
                "log truncated: read from its start, devices start over",
            )));
        }
        if own.len() > self.read() {
            if !is_damaged && !self.is_packed {
                return Ok(Some(Continuation::Grown));
            }
            // It cannot be read; but the file may still be truncated.
            self.read.store(own.len(), Ordering::Relaxed);
        }
        let is_other = || is_at(&self.file, path).is_ok_and(|is_at| !is_at);
        if fs::metadata(path).is_ok_and(|there| there.is_file())
            && is_other()
            && let Ok(log) = File::open(path)
        {
            *self = Self::new(log)?;
            return Ok(Some(Continuation::Anew(
                "log replaced: new one is read, devices start over",
            )));
        }
        Ok(None)
    }
}

/// The bytes of a log, which ends when the port is dropped, also while waiting for input.
#[derive(Clone)]
struct LogSource {
    file: Arc<File>,
    shared: Arc<PortShared>,
    read: Arc<AtomicU64>,
}

impl Read for LogSource {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        // It may be read on after the end that it says.
        while !self.shared.is_stopped() {
            if self.shared.wait(Some(self.file.wait_source()), None)? {
                match read_next(&self.file, buffer, self.read.load(Ordering::Relaxed)) {
                    // A pipe that another reader was quicker at.
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                    read => {
                        let read = read?;
                        self.read.fetch_add(read as u64, Ordering::Relaxed);
                        return Ok(read);
                    }
                }
            }
        }
        Ok(0)
    }
}

impl RandomAccess for LogSource {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
        if self.shared.is_stopped() {
            return Ok(0);
        }
        let read = read_at(&self.file, buffer, offset)?;
        self.read.fetch_add(read as u64, Ordering::Relaxed);
        Ok(read)
    }
}
