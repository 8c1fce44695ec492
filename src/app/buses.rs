//! One bus as the program sees it: its engine, what its adapter says of it, and how busy it is.
//!
//! Does not know how frames come in; the adapter's words arrive as a [`BusView`].

use crate::discovery::{Config, Engine};
use crate::frame::{Frame, FrameKind};
use crate::time::Instant;
use std::collections::VecDeque;

/// What an adapter says of its bus, in plain values.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct BusView {
    /// Whether frames can come in at all.
    pub link: Link,
    /// Bits per second.
    pub bitrate: Option<u32>,
    /// Bits per second of the FD data phase.
    pub data_bitrate: Option<u32>,
    /// The controller's state.
    pub state: ControllerState,
    /// The controller's transmit error counter.
    pub tec: Option<u16>,
    /// The controller's receive error counter.
    pub rec: Option<u16>,
    /// The controller itself is in listen-only mode: it does not even acknowledge.
    pub controller_listen_only: bool,
    /// Frames that the kernel or the adapter dropped.
    pub kernel_drops: u64,
    /// Frames that our own queue dropped.
    pub queue_drops: u64,
    /// What is wrong, and the way out, in a sentence.
    pub message: Option<String>,
}

/// Whether a bus can be heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Link {
    /// Being opened.
    #[default]
    Opening,
    /// Open.
    Up,
    /// The interface is down, unplugged, or the connection broke; the message says which.
    Down,
    /// A log that has been read to its end.
    Ended,
}

/// A CAN controller's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[allow(missing_docs)]
pub enum ControllerState {
    #[default]
    Unknown,
    Active,
    Warning,
    Passive,
    BusOff,
    Stopped,
}

impl BusView {
    /// The word for the bus's state, as in JSON.
    pub const fn state_name(&self) -> &'static str {
        match (self.link, self.state) {
            (Link::Down, _) => "down",
            (_, ControllerState::Unknown) => "unknown",
            (_, ControllerState::Active) => "error-active",
            (_, ControllerState::Warning) => "error-warning",
            (_, ControllerState::Passive) => "error-passive",
            (_, ControllerState::BusOff) => "bus-off",
            (_, ControllerState::Stopped) => "stopped",
        }
    }

    /// Whether frames can come in and go out.
    pub const fn is_up(&self) -> bool {
        matches!(self.link, Link::Up)
            && !matches!(self.state, ControllerState::BusOff | ControllerState::Stopped)
    }

    /// Frames that were lost on the way to us.
    pub const fn lost(&self) -> u64 {
        self.kernel_drops + self.queue_drops
    }
}

/// A bus.
#[derive(Debug)]
pub struct Bus {
    /// Its name: `can0`.
    pub name: String,
    /// Finds its devices.
    pub engine: Engine,
    /// What its adapter says.
    pub view: BusView,
    /// How busy it is.
    pub meter: Meter,
    /// Nobody acknowledges what we send.
    pub nobody_acknowledges: bool,
}

impl Bus {
    /// A bus that starts now.
    pub fn new(now: Instant, name: String, config: Config) -> Self {
        let view = BusView { bitrate: config.bitrate, ..BusView::default() };
        Self {
            name,
            engine: Engine::new(now, config),
            view,
            meter: Meter::new(now),
            nobody_acknowledges: false,
        }
    }

    /// The bit rate to reckon with.
    pub fn bits_per_second(&self) -> u32 {
        self.view.bitrate.unwrap_or_else(|| self.engine.config().bits_per_second())
    }
}

/// Frames and bus time in each of the last seconds.
#[derive(Debug)]
pub struct Meter {
    second: u64,
    current: Second,
    past: VecDeque<Second>,
}

/// What passed in one second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Second {
    /// Frames.
    pub frames: u32,
    /// Error frames among them.
    pub errors: u32,
    /// Bit times at the nominal rate that the bus was taken.
    pub bits: u64,
}

impl Meter {
    /// How many seconds are kept.
    pub const SECONDS: usize = 30;

    fn new(now: Instant) -> Self {
        let second = now.as_micros() / 1_000_000;
        let past = VecDeque::with_capacity(Self::SECONDS);
        Self { second, current: Second::default(), past }
    }

    /// Counts a frame.
    pub fn add(&mut self, frame: &Frame, bitrate: u32, data_bitrate: Option<u32>) {
        self.current.frames += 1;
        self.current.errors += u32::from(frame.kind == FrameKind::Error);
        self.current.bits += bit_times(frame, bitrate, data_bitrate);
    }

    /// Closes the seconds that are over; whether there were any.
    pub fn advance(&mut self, now: Instant) -> bool {
        let second = now.as_micros() / 1_000_000;
        if second <= self.second {
            return false;
        }
        let over = (second - self.second).min(Self::SECONDS as u64 + 1);
        self.second = second;
        for _ in 0..over {
            if self.past.len() == Self::SECONDS {
                self.past.pop_front();
            }
            self.past.push_back(std::mem::take(&mut self.current));
        }
        true
    }

    /// The last whole second.
    pub fn last(&self) -> Second {
        self.past.back().copied().unwrap_or_default()
    }

    /// The last seconds, oldest first.
    pub fn seconds(&self) -> impl DoubleEndedIterator<Item = &Second> + ExactSizeIterator {
        self.past.iter()
    }

    /// Whether nothing passed for as long as is shown.
    pub fn is_idle(&self) -> bool {
        self.current.frames == 0 && self.past.iter().all(|second| second.frames == 0)
    }
}

impl Second {
    /// The share of the bus that was taken, 0–1.
    pub fn load(self, bitrate: u32) -> f64 {
        (self.bits as f64 / f64::from(bitrate.max(1))).min(1.0)
    }
}

/// About how many bit times at the nominal rate a frame takes of the bus: its fields, the three
/// bits between frames, and a tenth of what can be stuffed.
fn bit_times(frame: &Frame, bitrate: u32, data_bitrate: Option<u32>) -> u64 {
    use crate::frame::CanId;
    let (arbitration, rest) = match frame.id {
        CanId::Standard(_) => (19, 28),
        CanId::Extended(_) => (39, 28),
    };
    let data = 8 * frame.data().len() as u64;
    match frame.kind {
        FrameKind::Error => 20,
        FrameKind::Data if frame.fd && frame.bit_rate_switch => {
            let faster = u64::from(data_bitrate.unwrap_or(bitrate) / bitrate.max(1)).max(1);
            arbitration + rest + (data + 30) / faster
        }
        _ => arbitration + rest + data + (arbitration + data) / 10,
    }
}
