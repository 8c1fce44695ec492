//! A candump log as a port: its frames come as they were timed.
//!
//! The pace is the clock's: [`Clock::replaying`] makes it faster. Frames that were sent when
//! the log was made are still marked as ours.

use super::clock::Clock;
use super::log::LogReader;
use super::port::{Line, Port};
use crate::frame::BusIndex;
use crate::status::Link;
use crate::time::{Duration, Instant};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::os::fd::AsFd;
use std::sync::Arc;

/// How late a frame may be before the rest of the log is shifted with it. A live log
/// (`ssh board candump -L can0 | descan -`) is always a little late.
const MAX_LATENESS: Duration = Duration::from_millis(250);
/// How long to wait for the consumer when the queue is full.
const FULL_QUEUE_NAP: Duration = Duration::from_millis(5);

/// Opens a log whose first interface is bus `index`, its second the next, and so on.
pub(super) fn open(name: &str, log: File, index: BusIndex, clock: Clock) -> io::Result<Port> {
    let line = Arc::new(Line::new()?);
    line.queue.update_status(|status| {
        status.link = Link::Up;
        status.listen_only = true;
    });
    let mut port = Port::new(name, Arc::clone(&line), true);
    port.serve(move |line| {
        let source = Interruptible { log, line: Arc::clone(line) };
        let mut reader = LogReader::new(BufReader::with_capacity(1 << 16, source));
        let outcome = replay(&mut reader, line, index, clock);
        match outcome {
            Ok(()) => line.queue.finish(Link::Ended, reader.tally().to_string()),
            Err(error) => line.queue.finish(Link::Failed, format!("cannot read the log: {error}")),
        }
    })?;
    Ok(port)
}

fn replay(
    reader: &mut LogReader<BufReader<Interruptible>>,
    line: &Line,
    index: BusIndex,
    clock: Clock,
) -> io::Result<()> {
    // The moment of the session that is the log's start.
    let mut start = None;
    let mut names = 0;
    while let Some(frame) = reader.next_frame()? {
        for name in &reader.tally().interfaces[names..] {
            line.queue.add_name(name);
            names += 1;
        }
        let age = frame.time.since(Instant::ZERO);
        let now = clock.now();
        let start = start.get_or_insert(now);
        *start = (*start).max(now - clock.run_in(MAX_LATENESS) - age);
        let due = *start + age;
        loop {
            if line.is_stopped() {
                return Ok(());
            }
            let is_full = line.queue.room() == 0;
            if clock.now() >= due && !is_full {
                break;
            }
            let nap = if is_full { FULL_QUEUE_NAP } else { Duration::ZERO };
            line.wait(None, Some(clock.until(due).max(nap)))?;
        }
        let bus = BusIndex(index.0.saturating_add(frame.bus.0));
        line.queue.push(&[frame.at(due).on(bus)]);
    }
    Ok(())
}

/// A log that ends when the port is dropped, even while the next line is waited for.
struct Interruptible {
    log: File,
    line: Arc<Line>,
}

impl Read for Interruptible {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.line.wait(Some(self.log.as_fd()), None)? {
            if self.line.is_stopped() {
                return Ok(0);
            }
        }
        self.log.read(buffer)
    }
}
