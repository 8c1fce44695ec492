//! The waker by poll(2) and a pipe that holds at most one byte, so `wake` never blocks.

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::io::{self, PipeReader, PipeWriter, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// What a thread waits for: a file descriptor.
pub(in crate::bus) type WaitSource<'a> = BorrowedFd<'a>;

impl<T: AsFd + ?Sized> super::Waitable for T {
    fn wait_source(&self) -> WaitSource<'_> {
        self.as_fd()
    }
}

/// Woken by any thread, waited for by one.
#[derive(Debug)]
pub(in crate::bus) struct Waker {
    is_woken: AtomicBool,
    reader: PipeReader,
    writer: PipeWriter,
}

impl Waker {
    pub(in crate::bus) fn new() -> io::Result<Self> {
        let (reader, writer) = io::pipe()?;
        Ok(Self { is_woken: AtomicBool::new(false), reader, writer })
    }

    /// Ends the wait that is under way, or the next one.
    pub(in crate::bus) fn wake(&self) {
        if !self.is_woken.swap(true, Ordering::AcqRel) {
            // Both ends live as long as `self`, so the pipe cannot be closed or full.
            let _ = (&self.writer).write(&[0]);
        }
    }

    /// Waits until [`wake`](Self::wake) is called, `timeout` (rounded up to milliseconds; `None`:
    /// no limit) has passed, or `input` has data or an error. Returns true if `input` has.
    ///
    /// Check the reason for a wake after this call, not before.
    ///
    /// # Errors
    ///
    /// Those of poll(2).
    pub(in crate::bus) fn wait(
        &self,
        input: Option<WaitSource<'_>>,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        self.wait_for(input.map(|input| (input, PollFlags::POLLIN)), timeout)
    }

    /// The same for a stream; waits for room to write as well, if `to_write`.
    pub(in crate::bus) fn wait_for_stream(
        &self,
        stream: WaitSource<'_>,
        to_write: bool,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        let room = if to_write { PollFlags::POLLOUT } else { PollFlags::empty() };
        self.wait_for(Some((stream, PollFlags::POLLIN | room)), timeout)
    }

    fn wait_for(
        &self,
        events: Option<(BorrowedFd<'_>, PollFlags)>,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        let timeout = timeout.map_or(PollTimeout::NONE, |timeout| {
            let millis = timeout.as_nanos().div_ceil(1_000_000);
            PollTimeout::try_from(millis).unwrap_or(PollTimeout::MAX)
        });
        let wakeups = PollFd::new(self.reader.as_fd(), PollFlags::POLLIN);
        let mut watched = Vec::from([wakeups]);
        watched.extend(events.map(|(source, events)| PollFd::new(source, events)));
        match poll(&mut watched, timeout) {
            Ok(_) | Err(Errno::EINTR) => {}
            Err(error) => return Err(error.into()),
        }
        let has_event = |at: usize| watched.get(at).and_then(PollFd::any) == Some(true);
        let (was_woken, is_ready) = (has_event(0), has_event(1));
        if was_woken {
            (&self.reader).read_exact(&mut [0])?;
            self.is_woken.store(false, Ordering::Release);
        }
        Ok(is_ready)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_wakes_end_one_wait() {
        let waker = Waker::new().unwrap();
        for _ in 0..100_000 {
            waker.wake();
        }
        waker.wait(None, None).unwrap();
        assert!(!waker.is_woken.load(Ordering::Acquire));
        waker.wake();
        waker.wait(None, None).unwrap();
    }

    #[test]
    fn input_ends_the_wait() {
        let waker = Waker::new().unwrap();
        let (reader, mut writer) = io::pipe().unwrap();
        assert!(!waker.wait(Some(reader.as_fd()), Some(Duration::ZERO)).unwrap());
        writer.write_all(b"x").unwrap();
        assert!(waker.wait(Some(reader.as_fd()), None).unwrap());
    }
}
