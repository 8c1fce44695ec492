//! The engine: an input is frames at any time, pauses and commands.

use super::choices::Choices;
use super::{Target, assert_printable};
use descan::discovery::{Config, Engine};
use descan::frame::{CanId, Frame};
use descan::time::{Duration, Instant};
use descan::wire::id::{Address, Header, Service};

/// An input of target `engine` begins with four bytes of settings.
pub const ENGINE: Target = Target {
    name: "engine",
    check: |input| {
        let mut choices = Choices::new(input);
        let is_confirmed = choices.flag();
        let config = Config {
            listen_only: choices.byte().is_multiple_of(4),
            has_loopback: choices.byte().is_multiple_of(4) || is_confirmed,
            address: Address::new(choices.byte()),
            ..Config::default()
        };
        run(config, is_confirmed, std::iter::from_fn(|| step(&mut choices)));
    },
    words: &[
        b"\x06\x01FEED\0",
        b"\x04DES\x01",
        b"\x04DES\x02",
        b"DES\x01",
        b"\x10\x40\x02\x03DES\0",
        b"\x21",
        b"\x30\0\0",
        b"\x10\0\xFF\xFF\xFF\xFF\x02\0",
        b"\x12\x34\x56\x78\x9A\xBC\x04\0",
        b"\x07\x01FE\x1b[\0",
    ],
};

/// An input of the engine.
#[derive(Clone, Copy, Debug)]
pub enum EngineStep {
    /// A frame that is received now.
    Frame(Frame),
    /// A frame with a time so many microseconds before or after the present one.
    FrameAt(Frame, i64),
    /// Time passes, in microseconds.
    Pause(u64),
    /// One of the commands, by its number.
    Command(u8),
}

/// Longest pause with a call at each deadline, in microseconds; after a longer one, as in a log with
/// a gap, the engine gets one call.
const MAX_STEPPED_PAUSE: u64 = 120_000_000;
/// Bounds of what the engine stores.
const MAX_ROWS: usize = 512;
const MAX_EVENTS: usize = 4_096;
/// Turns with frames to send at one moment.
const MAX_TURNS: u32 = 4;
/// Frames sent in one turn.
const MAX_SENT: u32 = 200;
/// Microseconds that the steps of an input choose from.
const PAUSES: [u64; 15] = [
    0,
    1,
    200,
    1_000,
    5_000,
    20_000,
    100_000,
    400_000,
    999_000,
    1_000_000,
    2_500_000,
    10_000_000,
    60_000_000,
    600_000_000,
    86_400_000_000,
];

fn step(choices: &mut Choices<'_>) -> Option<EngineStep> {
    if choices.is_over() {
        return None;
    }
    let kind = choices.byte();
    Some(match kind % 8 {
        0 | 1 => EngineStep::Frame(platform_frame(choices)),
        2 => EngineStep::Frame(any_frame(choices)),
        3 | 4 => EngineStep::Pause(PAUSES[usize::from(kind / 8) % PAUSES.len()]),
        5 => EngineStep::FrameAt(platform_frame(choices), i64::from(choices.u32().cast_signed())),
        6 if kind < 0xF0 => EngineStep::Command(kind / 8),
        6 => EngineStep::Pause(choices.u64()),
        _ => {
            let late_by = if kind < 0xF0 { i64::from(kind) * 1000 } else { i64::MAX };
            EngineStep::FrameAt(any_frame(choices), late_by)
        }
    })
}

/// Returns a frame that resembles those of the platform.
fn platform_frame(choices: &mut Choices<'_>) -> Frame {
    let (flags, parties, service) = (choices.byte(), choices.byte(), choices.byte());
    let header = Header {
        from_non_working: flags & 1 != 0,
        to_non_working: flags & 2 != 0,
        response: flags & 4 == 0,
        broadcast: flags & 8 != 0,
        no_error: flags & 16 == 0,
        source: Address::from_bits(parties & 15),
        destination: Address::from_bits(parties >> 4),
        service: Service::from_bits(
            [1, 2, 2, 2, 0x10, 0x3FF, 0x3F0, 0x18][usize::from(service % 8)],
        ),
    };
    let len = if service < 0xF0 { usize::from(service >> 4) % 9 } else { 64 };
    let mut frame = Frame::new(CanId::Extended(header.encode()), choices.bytes(len));
    frame.is_fd = frame.len() > Frame::MAX_CLASSIC_DATA;
    frame.is_tx = flags & 0xC0 == 0xC0;
    frame
}

fn any_frame(choices: &mut Choices<'_>) -> Frame {
    let (kind, id) = (choices.byte(), choices.u32());
    let len = usize::from(kind >> 4) % 9;
    match kind % 4 {
        0 => Frame::classic(id & CanId::MAX_EXTENDED, choices.bytes(len)),
        1 => Frame::new(CanId::Standard(id as u16 & CanId::MAX_STANDARD), choices.bytes(len)),
        2 => Frame::remote(CanId::Standard(id as u16 & CanId::MAX_STANDARD), len),
        _ => Frame::error(id & 0x3FF, choices.bytes(len)),
    }
}

/// Runs an engine through these steps. With `is_confirmed`, every frame that it sends is received
/// back at once.
///
/// # Panics
///
/// If a rule of the engine is broken.
pub fn run(config: Config, is_confirmed: bool, steps: impl IntoIterator<Item = EngineStep>) {
    let listen_only = config.listen_only;
    let mut run = EngineRun {
        engine: Engine::new(Instant::ZERO, config),
        now: Instant::ZERO,
        is_confirmed,
        listen_only,
        frames: 0,
    };
    for step in steps {
        run.take(step);
        run.handle_timeouts();
    }
    run.check_results();
}

struct EngineRun {
    engine: Engine,
    now: Instant,
    is_confirmed: bool,
    listen_only: bool,
    /// Frames passed to the engine.
    frames: u64,
}

impl EngineRun {
    fn take(&mut self, step: EngineStep) {
        match step {
            EngineStep::Frame(frame) => self.receive(&frame.with_time(self.now)),
            EngineStep::FrameAt(frame, offset) => {
                let at = self.now.as_micros().saturating_add_signed(offset);
                let at = Instant::from_micros(at).min(Instant::LATEST);
                self.receive(&frame.with_time(at));
                // The engine has no other clock than its inputs.
                self.now = self.now.max(at);
            }
            EngineStep::Pause(micros) => {
                self.now = Instant::LATEST.min(self.now + Duration::from_micros(micros));
                if micros > MAX_STEPPED_PAUSE {
                    self.handle_timeout(self.now);
                    self.engine.remove_lost_devices();
                }
            }
            EngineStep::Command(number) => self.command(number),
        }
    }

    fn receive(&mut self, frame: &Frame) {
        self.engine.handle_frame(frame);
        self.frames += 1;
    }

    fn command(&mut self, number: u8) {
        let (engine, now) = (&mut self.engine, self.now);
        match number % 9 {
            0 => engine.rescan(now),
            1 => engine.suspend(now),
            2 => engine.restart(now),
            3 => engine.remove_lost_devices(),
            4 => engine.handle_delayed_requests(now),
            5 => engine.handle_lost_frames(now, 7),
            6 => engine.handle_bus_unavailable(now),
            7 => engine.set_bitrate(None),
            _ => engine.set_bitrate(Some(1_000_000)),
        }
    }

    /// Handles all deadlines up to the present.
    fn handle_timeouts(&mut self) {
        self.drain(self.now);
        let (mut last, mut turns) = (Instant::ZERO, 0);
        while let Some(due) = self.engine.poll_timeout().filter(|due| *due <= self.now) {
            turns = if due == last { turns + 1 } else { 0 };
            last = due;
            assert!(turns < MAX_TURNS, "a deadline at {due} that never passes");
            self.handle_timeout(due);
            self.drain(due);
        }
    }

    /// Handles a deadline; the next one is later.
    fn handle_timeout(&mut self, now: Instant) {
        self.engine.handle_timeout(now);
        let next = self.engine.poll_timeout();
        assert!(next.is_none_or(|next| next > now), "due at {next:?}, handled until {now:?}");
    }

    /// Takes the frames to send and the events.
    fn drain(&mut self, now: Instant) {
        let mut sent = 0;
        while let Some(frame) = self.engine.poll_transmit(now) {
            sent += 1;
            assert!(!self.listen_only, "listen-only sends {frame:?}");
            assert!(sent < MAX_SENT, "it never stops sending");
            if self.is_confirmed {
                self.receive(&frame.with_time(now).with_tx());
            }
        }
        let events = std::iter::from_fn(|| self.engine.poll_event()).count();
        assert!(events <= MAX_EVENTS, "{events} events");
    }

    fn check_results(&self) {
        let engine = &self.engine;
        assert_eq!(engine.counters().frames, self.frames);
        assert!(engine.devices().len() <= MAX_ROWS && engine.findings().len() <= MAX_ROWS);
        check_rows(engine);
        for device in engine.devices() {
            device.name.iter().for_each(|name| assert_printable(&name.to_string()));
        }
        for finding in engine.findings() {
            assert_printable(&finding.text);
            assert!(!finding.text.is_empty(), "{:?}", finding.key);
        }
    }
}

/// Asserts that each row is found by its id, and that the current row of an address is a row there.
///
/// # Panics
///
/// If one is not.
pub fn check_rows(engine: &Engine) {
    let is_found = |id| engine.device(id).is_some_and(|device| device.id == id);
    assert!(engine.devices().iter().all(|device| is_found(device.id)));
    for address in Address::all() {
        if let Some(device) = engine.device_at(address) {
            assert!(device.address == address && is_found(device.id), "{address:?}");
        }
    }
}
