//! The waker by a condition variable: the caller looks for input after each wait.

use std::io;
use std::marker::PhantomData;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Longest wait before the caller looks for input.
const LOOK_PERIOD: Duration = Duration::from_millis(4);

/// Stands for input that is looked for.
#[derive(Clone, Copy, Debug)]
pub(in crate::bus) struct WaitSource<'a>(PhantomData<&'a ()>);

impl<T: ?Sized> super::Waitable for T {
    fn wait_source(&self) -> WaitSource<'_> {
        WaitSource(PhantomData)
    }
}

/// Woken by any thread, waited for by one.
#[derive(Debug, Default)]
pub(in crate::bus) struct Waker {
    is_woken: Mutex<bool>,
    woken: Condvar,
}

impl Waker {
    pub(in crate::bus) fn new() -> io::Result<Self> {
        Ok(Self::default())
    }

    /// Ends the wait that is under way, or the next one.
    pub(in crate::bus) fn wake(&self) {
        *self.is_woken.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.woken.notify_one();
    }

    /// Waits until [`wake`](Self::wake) is called, or `timeout` (`None`: no limit) has passed; with
    /// `input`, at most a few milliseconds. Returns true if there may be input.
    ///
    /// Check the reason for a wake after this call, not before.
    ///
    /// # Errors
    ///
    /// None.
    pub(in crate::bus) fn wait(
        &self,
        input: Option<WaitSource<'_>>,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        let look = input.map(|_| LOOK_PERIOD);
        let longest = [look, timeout].into_iter().flatten().min();
        let is_woken = self.is_woken.lock().unwrap_or_else(PoisonError::into_inner);
        let mut is_woken = match longest {
            Some(longest) => {
                let woken = self.woken.wait_timeout_while(is_woken, longest, |woken| !*woken);
                woken.unwrap_or_else(PoisonError::into_inner).0
            }
            None => self
                .woken
                .wait_while(is_woken, |woken| !*woken)
                .unwrap_or_else(PoisonError::into_inner),
        };
        *is_woken = false;
        Ok(input.is_some())
    }

    /// The same for a stream.
    pub(in crate::bus) fn wait_for_stream(
        &self,
        stream: WaitSource<'_>,
        _to_write: bool,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        self.wait(Some(stream), timeout)
    }
}
