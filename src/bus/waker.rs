//! A bell that a thread hears while it waits in poll(2).
//!
//! A pipe with at most one byte in it, so ringing never blocks. Knows nothing of why it rings.

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::io::{self, PipeReader, PipeWriter, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Rung by anybody, heard by one.
#[derive(Debug)]
pub(super) struct Waker {
    rung: AtomicBool,
    reader: PipeReader,
    writer: PipeWriter,
}

impl Waker {
    pub(super) fn new() -> io::Result<Self> {
        let (reader, writer) = io::pipe()?;
        Ok(Self { rung: AtomicBool::new(false), reader, writer })
    }

    /// Ends the wait that is under way, or the next one.
    pub(super) fn wake(&self) {
        if !self.rung.swap(true, Ordering::AcqRel) {
            // Both ends live as long as `self`, so the pipe cannot be closed or full.
            let _ = (&self.writer).write(&[0]);
        }
    }

    /// Waits until the bell rings, `timeout` (rounded up to milliseconds) is over, or there is
    /// something to read (or an error to learn of) at `input`. Says whether there is.
    ///
    /// Look for what the bell announces after this, not before.
    pub(super) fn wait(
        &self,
        input: Option<BorrowedFd<'_>>,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        self.wait_for(input.map(|input| (input, PollFlags::POLLIN)), timeout)
    }

    /// The same, for other events than input: room to write in particular.
    pub(super) fn wait_for(
        &self,
        events: Option<(BorrowedFd<'_>, PollFlags)>,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        let timeout = timeout.map_or(PollTimeout::NONE, |timeout| {
            let millis = timeout.as_nanos().div_ceil(1_000_000);
            PollTimeout::try_from(millis).unwrap_or(PollTimeout::MAX)
        });
        let bell = PollFd::new(self.reader.as_fd(), PollFlags::POLLIN);
        let mut watched = Vec::from([bell]);
        watched.extend(events.map(|(source, events)| PollFd::new(source, events)));
        match poll(&mut watched, timeout) {
            Ok(_) | Err(Errno::EINTR) => {}
            Err(error) => return Err(error.into()),
        }
        let has_event = |at: usize| watched.get(at).and_then(PollFd::any) == Some(true);
        let (bell_heard, is_ready) = (has_event(0), has_event(1));
        if bell_heard {
            (&self.reader).read_exact(&mut [0])?;
            self.rung.store(false, Ordering::Release);
        }
        Ok(is_ready)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_once_however_often_it_is_rung() {
        let bell = Waker::new().unwrap();
        for _ in 0..100_000 {
            bell.wake();
        }
        bell.wait(None, None).unwrap();
        assert!(!bell.rung.load(Ordering::Acquire));
        bell.wake();
        bell.wait(None, None).unwrap();
    }

    #[test]
    fn hears_the_input() {
        let bell = Waker::new().unwrap();
        let (reader, mut writer) = io::pipe().unwrap();
        assert!(!bell.wait(Some(reader.as_fd()), Some(Duration::ZERO)).unwrap());
        writer.write_all(b"x").unwrap();
        assert!(bell.wait(Some(reader.as_fd()), None).unwrap());
    }
}
