//! A device that runs a program of the caller instead of the simulated behaviour, behind a CAN
//! controller with transmit mailboxes.
//!
//! Input: frames with 29-bit identifiers, ends of transmissions, bus errors, power. Output: frames,
//! setups of the controller. Does not know what the program does, nor its profile: the scenario's
//! one counts for the other devices only.

use super::DeviceIo;
use crate::frame::Frame;
use crate::sim::scenario::DeviceAction;
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::Mode;
use std::collections::VecDeque;

/// Received frames that wait for the program; further ones are dropped, and counted.
const RECEIVE_QUEUE: usize = 64;

/// The program of a device on the simulated bus: firmware under test, or a device of its own.
///
/// [`Sim::set_program`](crate::sim::Sim::set_program) gives it to a device of the scenario, which
/// still has the name, the services and the UID that an observer is to find. Power and restarts come
/// from the timetable; actions that change other parts of a device have no effect on a program.
///
/// ```
/// use descan::frame::Frame;
/// use descan::sim::{DeviceController, DeviceProgram, DeviceSpec, Scenario, Sim};
/// use descan::time::{Duration, Instant};
/// use descan::wire::id::Address;
/// use descan::wire::node::Mode;
///
/// /// Sends a heartbeat each second from address 12, and does nothing else.
/// #[derive(Default)]
/// struct Beacon {
///     due: Instant,
/// }
///
/// impl DeviceProgram for Beacon {
///     fn start(&mut self, controller: &mut DeviceController<'_>) {
///         controller.set_up(125_000, false);
///         self.due = controller.now();
///     }
///
///     fn run(&mut self, controller: &mut DeviceController<'_>) -> Option<Instant> {
///         while controller.receive().is_some() {}
///         controller.transmitted(0);
///         if self.due <= controller.now() {
///             controller.transmit(0, Frame::classic(0x0718_0001, b"BEACON\x04\0"), false);
///             self.due = controller.now() + Duration::from_secs(1);
///         }
///         Some(self.due)
///     }
///
///     fn mode(&self) -> Mode {
///         Mode::Work
///     }
///
///     fn address(&self) -> Option<Address> {
///         Address::new(12)
///     }
/// }
///
/// let mut sim = Sim::from_scenario(&Scenario::new(125_000).with(DeviceSpec::new("BEACON")));
/// let device = sim.device("BEACON").unwrap();
/// sim.set_program(device, Box::new(Beacon::default()));
/// let station = sim.attach();
/// sim.advance(Instant::from_micros(2_500_000));
/// assert_eq!(std::iter::from_fn(|| sim.poll_frame(station)).count(), 3);
/// ```
pub trait DeviceProgram: Send {
    /// Starts after power-on, and after a restart: memory is lost. The controller is off.
    fn start(&mut self, controller: &mut DeviceController<'_>);

    /// Runs once, as a main loop does: after [`Self::start`], after each event of the controller (a
    /// received frame, the end of a transmission, an error on the bus), and at the time that it
    /// returned the last time. `None`: it waits for an event.
    fn run(&mut self, controller: &mut DeviceController<'_>) -> Option<Instant>;

    /// Returns the mode, for the ground truth of a test.
    fn mode(&self) -> Mode;

    /// Returns the address, for the ground truth of a test; `None` before the end of address
    /// resolution.
    fn address(&self) -> Option<Address>;
}

/// A frame in a mailbox, or what became of it.
#[derive(Clone, Copy, Default)]
enum Mailbox {
    #[default]
    Empty,
    Pending(Frame),
    Ended {
        is_sent: bool,
    },
}

/// What a controller remembers for its program.
#[derive(Default)]
struct Mailboxes {
    transmit: [Mailbox; DeviceController::MAILBOXES],
    receive: VecDeque<Frame>,
    overruns: u64,
    has_error: bool,
}

impl Mailboxes {
    fn end(&mut self, frame: &Frame, is_sent: bool) {
        let is_it = |it: &&mut Mailbox| {
            matches!(it, Mailbox::Pending(own)
                if own.id == frame.id && own.is_fd == frame.is_fd && own.data() == frame.data())
        };
        if let Some(mailbox) = self.transmit.iter_mut().find(is_it) {
            *mailbox = Mailbox::Ended { is_sent };
        }
    }

    fn fail_all(&mut self) {
        for mailbox in &mut self.transmit {
            if let Mailbox::Pending(_) = mailbox {
                *mailbox = Mailbox::Ended { is_sent: false };
            }
        }
    }
}

/// The CAN controller of a [`DeviceProgram`].
///
/// As bxCAN: the mailbox with the lowest identifier is sent first. It receives all frames with 29-bit
/// identifiers, without filters.
pub struct DeviceController<'a> {
    io: DeviceIo<'a>,
    mailboxes: &'a mut Mailboxes,
}

impl DeviceController<'_> {
    /// Transmit mailboxes, numbered from 0.
    pub const MAILBOXES: usize = 3;

    /// Returns the present time.
    pub fn now(&self) -> Instant {
        crate::sim::instant(self.io.now)
    }

    /// Switches the controller on: empties mailboxes and receive queue, resets the error counters,
    /// bus-off and the memory of errors. `bitrate` in bit/s; with `is_listen_only` it neither
    /// acknowledges nor sends.
    pub fn set_up(&mut self, bitrate: u32, is_listen_only: bool) {
        *self.mailboxes = Mailboxes::default();
        self.io.bus.set_attached(self.io.station, true);
        self.io.bus.set_bitrate(self.io.station, bitrate);
        self.io.bus.controller_mut(self.io.station).listen_only = is_listen_only;
    }

    /// Puts a frame into a mailbox. Returns false if it has one that is not taken with
    /// [`Self::transmitted`], or the controller is off or bus-off. `is_single_shot`: without
    /// repetition after an error or a lost arbitration.
    pub fn transmit(&mut self, mailbox: usize, frame: Frame, is_single_shot: bool) -> bool {
        let Some(place) = self.mailboxes.transmit.get_mut(mailbox) else { return false };
        let is_free = matches!(place, Mailbox::Empty);
        let (now, station) = (self.io.now, self.io.station);
        if !is_free || !self.io.bus.transmit(now, station, frame, is_single_shot) {
            return false;
        }
        *place = Mailbox::Pending(frame);
        true
    }

    /// Takes what became of the frame in a mailbox: true if it was sent and acknowledged, false if it
    /// was given up; `None` if it waits, or there is none.
    pub fn transmitted(&mut self, mailbox: usize) -> Option<bool> {
        let place = self.mailboxes.transmit.get_mut(mailbox)?;
        let Mailbox::Ended { is_sent } = *place else { return None };
        *place = Mailbox::Empty;
        Some(is_sent)
    }

    /// Takes the next received frame, in the order of reception.
    pub fn receive(&mut self) -> Option<Frame> {
        self.mailboxes.receive.pop_front()
    }

    /// Returns the frames that were dropped, because 64 waited.
    pub fn overruns(&self) -> u64 {
        self.mailboxes.overruns
    }

    /// Returns the greater of the error counters, above 255 in bus-off.
    pub fn error_counter(&self) -> u16 {
        let (tec, rec) = self.io.bus.controller(self.io.station).counters();
        tec.max(rec)
    }

    /// Returns true if it detected an error on the bus since the last call, in listen-only too.
    pub fn take_error(&mut self) -> bool {
        std::mem::take(&mut self.mailboxes.has_error)
    }
}

/// A program with its controller.
pub(super) struct RunningProgram {
    program: Box<dyn DeviceProgram>,
    mailboxes: Mailboxes,
    is_on: bool,
    call: Option<u64>,
}

impl RunningProgram {
    pub fn new(program: Box<dyn DeviceProgram>) -> Self {
        Self { program, mailboxes: Mailboxes::default(), is_on: false, call: None }
    }

    pub fn is_on(&self) -> bool {
        self.is_on
    }

    pub fn mode(&self) -> Mode {
        self.program.mode()
    }

    pub fn address(&self) -> Option<Address> {
        self.program.address().filter(|_| self.is_on)
    }

    pub fn poll_timeout(&self) -> Option<u64> {
        self.call
    }

    fn run(&mut self, io: &mut DeviceIo) {
        let mut controller = DeviceController { io: io.reborrow(), mailboxes: &mut self.mailboxes };
        self.call = self.program.run(&mut controller).map(super::super::nanos);
    }

    /// Switches it on; one that is on restarts.
    pub fn power_on(&mut self, io: &mut DeviceIo) {
        self.power_off(io);
        self.is_on = true;
        let mut controller = DeviceController { io: io.reborrow(), mailboxes: &mut self.mailboxes };
        self.program.start(&mut controller);
        self.run(io);
    }

    pub fn power_off(&mut self, io: &mut DeviceIo) {
        io.bus.set_attached(io.station, false);
        self.mailboxes = Mailboxes::default();
        (self.is_on, self.call) = (false, None);
    }

    /// Applies an action of the timetable or of the caller: power and restarts; others have no
    /// effect.
    pub fn apply(&mut self, action: &DeviceAction, io: &mut DeviceIo) {
        match action {
            DeviceAction::PowerOn if self.is_on => {}
            DeviceAction::PowerOn | DeviceAction::Reboot { .. } => self.power_on(io),
            DeviceAction::PowerOff => self.power_off(io),
            _ => {}
        }
    }

    pub fn handle_timeout(&mut self, io: &mut DeviceIo) {
        if self.call.is_some_and(|call| call <= io.now) {
            self.run(io);
        }
    }

    /// Takes a frame of another station.
    pub fn handle_frame(&mut self, frame: &Frame, io: &mut DeviceIo) {
        let controller = io.bus.controller(io.station);
        if !self.is_on || !controller.is_receiving() {
            return;
        }
        if controller.bitrate != io.bus.frame_bitrate() {
            self.mailboxes.has_error = true;
        } else if self.mailboxes.receive.len() < RECEIVE_QUEUE {
            self.mailboxes.receive.push_back(*frame);
        } else {
            self.mailboxes.overruns += 1;
        }
        self.run(io);
    }

    /// Takes the end of the transmission of one of its frames.
    pub fn handle_transmitted(&mut self, frame: &Frame, is_sent: bool, io: &mut DeviceIo) {
        self.mailboxes.end(frame, is_sent);
        self.run(io);
    }

    /// Takes an error on the bus.
    pub fn handle_bus_error(&mut self, io: &mut DeviceIo) {
        if !self.is_on {
            return;
        }
        self.mailboxes.has_error = true;
        if !io.bus.controller(io.station).is_receiving() {
            self.mailboxes.fail_all();
        }
        self.run(io);
    }
}
