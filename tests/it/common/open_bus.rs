//! An open port with everything received from it so far, and waits with a timeout.

use descan::bus::{self, BusSpec, Clock, Options, Port};
use descan::frame::{BusIndex, Frame};
use descan::status::{BusStatus, Link};
use std::time::{Duration, Instant};

/// Timeout of every wait, long enough for a busy machine.
pub const PATIENCE: Duration = Duration::from_mins(1);

pub struct OpenBus {
    pub port: Port,
    pub clock: Clock,
    pub frames: Vec<Frame>,
    runtime: tokio::runtime::Runtime,
}

impl OpenBus {
    pub fn open(spec: &str) -> Self {
        Self::open_with(spec, Options::default())
    }

    pub fn listen(spec: &str) -> Self {
        Self::open_with(spec, Options { listen_only: true, ..Options::default() })
    }

    /// Opens a bus whose bit rate is assumed.
    pub fn listen_first(spec: &str) -> Self {
        Self::open_with(spec, Options { listens_first: true, ..Options::default() })
    }

    fn open_with(spec: &str, options: Options) -> Self {
        let clock = Clock::start();
        let spec: BusSpec = spec.parse().expect("a bus");
        let port = bus::open(&spec, BusIndex(3), clock.clone(), options).expect("a port");
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        Self { port, clock, frames: Vec::new(), runtime }
    }

    pub fn status(&self) -> BusStatus {
        self.port.queue().status()
    }

    /// Receives until `condition` holds.
    pub fn wait_until(&mut self, what: &str, mut condition: impl FnMut(&mut Self) -> bool) {
        let deadline = Instant::now() + PATIENCE;
        loop {
            self.port.queue().drain(&mut self.frames, usize::MAX);
            self.port.queue().take_status();
            if condition(self) {
                return;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            assert!(!left.is_zero(), "waited in vain for {what}: {:?}", self.status());
            let ready = self.port.queue().ready();
            let _ = self.runtime.block_on(async { tokio::time::timeout(left, ready).await });
        }
    }

    pub fn wait_for_frames(&mut self, count: usize) -> &[Frame] {
        self.wait_until(&format!("{count} frames"), |bus| bus.frames.len() >= count);
        &self.frames
    }

    pub fn wait_for_link(&mut self, link: Link) -> BusStatus {
        self.wait_for_status(&format!("{link:?}"), |status| status.link == link)
    }

    pub fn wait_for_status(
        &mut self,
        what: &str,
        wanted: impl Fn(&BusStatus) -> bool,
    ) -> BusStatus {
        let mut seen = BusStatus::default();
        self.wait_until(what, |bus| {
            seen = bus.status();
            wanted(&seen)
        });
        seen
    }

    /// Sends a frame.
    pub fn send(&self, frame: &Frame) {
        self.port.transmit(frame).expect("room in the outbox");
    }
}
