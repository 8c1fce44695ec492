//! A node of a bench as the program of a simulated device, and random worlds for it.

use super::{Act, Bench, BoardSpec, KitFrame, hex, mode};
use descan::frame::Frame;
use descan::sim::{DeviceController, DeviceProgram, DeviceSpec};
use descan::time::{Duration, Instant};
use descan::wire::des;
use descan::wire::id::Address;
use descan::wire::node::Mode;
use std::sync::{Arc, Mutex};

/// Time until the next turn of the main loop while the node has no address and nothing happens. The
/// node would be polled each millisecond, to learn of errors; here each of them causes a turn.
const IDLE_TURN: Duration = Duration::from_millis(50);

/// One of so many heartbeats is passed to a node that has an address if it is of another address and
/// UID: they change nothing, and a process in C takes most of its time for them.
const HEARTBEATS_PER_PASSED: u8 = 8;

/// The settings and texts of a device of a scenario, as a board has them.
pub fn board_of(spec: &DeviceSpec, bitrate: u8, entropy: u32) -> BoardSpec {
    BoardSpec {
        name: spec.name.clone(),
        services: des::encode_services(&spec.services).skip(1).collect(),
        uid: spec.uid.0,
        address: spec.address.code(),
        bitrate,
        autostart: spec.autostart && spec.mode != Some(Mode::Cfg),
        entropy,
    }
}

/// A node of a bench, in a device of the simulation.
pub struct BenchProgram<B> {
    bench: Arc<Mutex<B>>,
    number: usize,
    spec: BoardSpec,
    mode: u8,
    /// Source of its last heartbeat or claim.
    source: u8,
    has_frame: [bool; 2],
    due: Instant,
    /// Share of received frames that are lost, 0 to 1.
    loss: f64,
    random: fastrand::Rng,
}

impl<B: Bench> BenchProgram<B> {
    pub fn new(bench: Arc<Mutex<B>>, number: usize, spec: BoardSpec) -> Self {
        let random = fastrand::Rng::with_seed(u64::from(spec.entropy));
        Self {
            bench,
            number,
            spec,
            mode: mode::INIT,
            source: 0,
            has_frame: [false; 2],
            due: Instant::ZERO,
            loss: 0.0,
            random,
        }
    }

    /// Lets it lose a share of the frames that it receives, as with a full receive queue.
    pub fn losing(self, loss: f64) -> Self {
        Self { loss, ..self }
    }

    /// Returns true if the acceptance filters pass a frame: those of `des_filters`, which
    /// `filters_pass_what_the_kit_needs` checks.
    fn passes(&mut self, id: u32, data: &[u8]) -> bool {
        let own = u32::from(self.source);
        let is_from_own = id >> 17 & 0x7F == own;
        let is_to_own = id >> 25 & 1 == 0 && id >> 10 & 0x7F == own;
        let is_request_to_all = id >> 25 & 3 == 1 && id & 0x3FF == 2;
        let is_heartbeat = id >> 26 & 1 == 1 && id & 0x3FF == 1;
        let has_none = [mode::INIT, mode::ARSLV].contains(&self.mode);
        let is_needed = has_none || is_from_own || is_to_own || is_request_to_all;
        is_needed
            || is_heartbeat
                && (data.starts_with(&self.spec.uid)
                    || self.random.u8(..HEARTBEATS_PER_PASSED) == 0)
    }

    fn next_frame(&mut self, controller: &mut DeviceController<'_>) -> Option<Frame> {
        while let Some(frame) = controller.receive() {
            let id = frame.platform_id();
            let passes = id.is_some_and(|id| self.passes(id, frame.data()));
            if passes && (self.loss == 0.0 || self.random.f64() >= self.loss) {
                return Some(frame);
            }
        }
        None
    }

    /// One turn of the main loop.
    fn turn(&mut self, controller: &mut DeviceController<'_>, command: &str) {
        let acts = self.bench.lock().unwrap().run(command);
        for act in acts {
            self.act(act, controller);
        }
    }

    fn act(&mut self, act: Act, controller: &mut DeviceController<'_>) {
        match act {
            Act::Send { slot, frame } => {
                self.has_frame[slot] = true;
                if slot == 0 {
                    self.source = frame.source();
                }
                let KitFrame { id, data, fd, once } = frame;
                let frame = if fd { Frame::fd(id, &data, 0) } else { Frame::classic(id, &data) };
                assert!(controller.transmit(slot, frame, once), "{}: mailbox {slot}", self.number);
            }
            Act::Bus { rate, silent } => {
                let rates = [125_000, 250_000, 500_000, 1_000_000];
                self.has_frame = [false; 2];
                controller.set_up(rates[usize::from(rate)], silent);
            }
            Act::Mode(mode) => self.mode = mode,
            Act::Store { uid, address, bitrate } => {
                let uid = uid.try_into().unwrap();
                self.spec = BoardSpec { uid, address, bitrate, ..self.spec.clone() };
            }
            Act::Wait(micros) => {
                let is_idle =
                    [mode::INIT, mode::ARSLV].contains(&self.mode) && self.has_frame == [false; 2];
                let wait = Duration::from_micros(u64::from(micros));
                self.due = controller.now() + if is_idle { wait.max(IDLE_TURN) } else { wait };
            }
            Act::Identify | Act::Reboot | Act::ForApplication => {}
            Act::Other(text) => panic!("{text}"),
        }
    }
}

impl<B: Bench + Send> DeviceProgram for BenchProgram<B> {
    fn start(&mut self, controller: &mut DeviceController<'_>) {
        (self.mode, self.has_frame) = (mode::INIT, [false; 2]);
        // The boards of a bus do not begin in the same microsecond.
        self.due = controller.now() + Duration::from_micros(self.random.u64(..50_000));
        let mut bench = self.bench.lock().unwrap();
        bench.set_up(self.number, &self.spec);
        bench.run(&format!("init {}", self.number));
    }

    fn run(&mut self, controller: &mut DeviceController<'_>) -> Option<Instant> {
        loop {
            let mut results = [0; 2];
            for (slot, result) in results.iter_mut().enumerate() {
                if let Some(is_sent) = controller.transmitted(slot) {
                    *result = if is_sent { 1 } else { 2 };
                    self.has_frame[slot] = false;
                }
            }
            let frame = self.next_frame(controller);
            let has_error = controller.take_error();
            let is_due = self.due <= controller.now();
            if frame.is_none() && results == [0; 2] && !has_error && !is_due {
                return Some(self.due);
            }
            let errors = controller.error_counter().min(256) | u16::from(has_error) << 9;
            let frame = frame.map_or(String::new(), |frame| {
                let id = frame.platform_id().unwrap_or_default();
                format!(" {id:08X} {} {}", hex(frame.data()), u8::from(frame.is_fd))
            });
            let (number, now) = (self.number, controller.now().as_micros() as u32);
            let [heartbeat, response] = results;
            let command = format!("step {number} {now} {errors} {heartbeat} {response}{frame}");
            self.turn(controller, &command);
        }
    }

    fn mode(&self) -> Mode {
        Mode::ALL[usize::from(self.mode)]
    }

    fn address(&self) -> Option<Address> {
        let has_none = [mode::INIT, mode::ARSLV].contains(&self.mode);
        if has_none { None } else { Address::new(self.source) }
    }
}
