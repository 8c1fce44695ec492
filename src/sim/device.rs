//! A simulated device: modes, address resolution, heartbeat and periodic data (protocol §7).
//!
//! A state machine without a clock: input is received frames and the time; it sends through a
//! [`DeviceIo`]. Responses to requests are in [`serve`]; a device may run a [`program`] of the caller
//! instead. Knows other devices only by their frames.

pub(super) mod program;
mod serve;

use super::bus::{SimBus, StationIndex};
use super::reply::TxResponses;
use super::scenario::{DeviceAction, DeviceSpec, Fault};
use crate::frame::Frame;
use crate::time::Duration;
use crate::wire::des::Request;
use crate::wire::descriptor::{AddressSetting, BitrateSetting};
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Header};
use crate::wire::node::{Heartbeat, Mode};
use crate::wire::profile::{Profile, WriteEffect};
use program::{DeviceProgram, RunningProgram};

/// BUS_CFG_TXERR_MAX: error counter at which a device disconnects and starts again.
const MAX_ERRORS: u16 = 128;
/// Shortest period of a device's timers, in nanoseconds.
const SHORTEST_PERIOD: u64 = 100_000;
/// Longest time of a device's timers, in nanoseconds: a year.
const LONGEST_TIME: u64 = 366 * 86_400 * 1_000_000_000;

/// Access of a device to its controller and to the profile.
pub(super) struct DeviceIo<'a> {
    pub now: u64,
    pub bus: &'a mut SimBus,
    pub station: StationIndex,
    pub profile: &'a Profile,
    pub modes: &'a [u8; 7],
}

impl DeviceIo<'_> {
    fn reborrow(&mut self) -> DeviceIo<'_> {
        DeviceIo { bus: &mut *self.bus, ..*self }
    }

    fn send(&mut self, frame: Frame) -> bool {
        self.bus.transmit(self.now, self.station, frame, false)
    }

    fn send_once(&mut self, frame: Frame) -> bool {
        self.bus.transmit(self.now, self.station, frame, true)
    }

    /// Returns BUS_CFG_HR_TIME in nanoseconds.
    fn heartbeat_time(&self) -> u64 {
        u64::from(self.profile.heartbeat.period_ms.max(1)) * 1_000_000
    }
}

/// Stage of a device between power-on and its final mode (protocol §7.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DeviceStage {
    Off,
    /// INIT at a fixed bit rate that is not that of the bus: hears nothing.
    OtherBitrate,
    /// INIT: listen-only until a frame arrives or 1.5 × BUS_CFG_HR_TIME ends.
    Init {
        until: u64,
    },
    /// ARSLV: listen-only, collects the addresses in use.
    Listen {
        until: u64,
    },
    /// ARSLV: address chosen, waits a random part of BUS_CFG_HR_TIME.
    Wait {
        choice: Address,
        until: u64,
    },
    /// ARSLV: the address claim is queued.
    Claim {
        choice: Address,
    },
    /// Any other mode.
    Run,
}

pub(super) struct SimDevice {
    pub spec: DeviceSpec,
    rng: fastrand::Rng,
    stage: DeviceStage,
    mode: Mode,
    address: Option<Address>,
    /// Addresses in use, found while listening, one bit each.
    in_use: u128,
    /// Time grid of heartbeats: the next one is sent at `beat` or up to the jitter later.
    next_heartbeat: u64,
    beat_at: Option<u64>,
    chatter_at: Vec<u64>,
    chatter_count: u16,
    replies: TxResponses,
    /// Action to apply after the response with this identifier was sent.
    pending_action: Option<(u32, DeviceAction)>,
    /// Runs instead of the simulated behaviour.
    program: Option<RunningProgram>,
}

impl SimDevice {
    /// Creates a device that is off.
    pub fn new(spec: DeviceSpec, rng: fastrand::Rng) -> Self {
        let chatter_at = vec![u64::MAX; spec.periodic_messages.len()];
        Self {
            spec,
            rng,
            stage: DeviceStage::Off,
            mode: Mode::Init,
            address: None,
            in_use: 0,
            next_heartbeat: 0,
            beat_at: None,
            chatter_at,
            chatter_count: 0,
            replies: TxResponses::default(),
            pending_action: None,
            program: None,
        }
    }

    /// Gives it a program, which starts now if the device is on.
    pub fn set_program(&mut self, program: Box<dyn DeviceProgram>, port: &mut DeviceIo) {
        let is_on = self.is_on();
        if is_on {
            self.power_off(port);
        }
        let mut program = RunningProgram::new(program);
        if is_on {
            program.power_on(port);
        }
        self.program = Some(program);
    }

    pub fn is_on(&self) -> bool {
        let is_on = self.stage != DeviceStage::Off;
        self.program.as_ref().map_or(is_on, RunningProgram::is_on)
    }

    pub fn mode(&self) -> Mode {
        self.program.as_ref().map_or(self.mode, RunningProgram::mode)
    }

    /// Returns its address; `None` before the end of address resolution.
    pub fn address(&self) -> Option<Address> {
        self.program.as_ref().map_or(self.address, RunningProgram::address)
    }

    /// Returns true if it needs all frames, during address resolution.
    pub fn is_listening(&self) -> bool {
        if self.program.is_some() {
            return self.is_on();
        }
        !matches!(self.stage, DeviceStage::Off | DeviceStage::OtherBitrate | DeviceStage::Run)
    }

    fn is_working(&self) -> bool {
        self.mode.is_working() == Some(true)
    }

    fn can_give_up(&self) -> bool {
        !self.spec.faults.has(Fault::KeepsAddress)
    }

    /// Returns when to call [`SimDevice::handle_timeout`] next, in nanoseconds; `None` if off.
    pub fn poll_timeout(&self) -> Option<u64> {
        if let Some(program) = &self.program {
            return program.poll_timeout();
        }
        let stage = match self.stage {
            DeviceStage::Init { until }
            | DeviceStage::Listen { until }
            | DeviceStage::Wait { until, .. } => Some(until),
            DeviceStage::Off
            | DeviceStage::OtherBitrate
            | DeviceStage::Claim { .. }
            | DeviceStage::Run => None,
        };
        let chatter = self.chatter_at.iter().copied().min().filter(|&at| at != u64::MAX);
        [stage, self.beat_at, chatter, self.replies.next()].into_iter().flatten().min()
    }

    /// Runs all timers that are due.
    pub fn handle_timeout(&mut self, port: &mut DeviceIo) {
        if let Some(program) = &mut self.program {
            return program.handle_timeout(port);
        }
        match self.stage {
            DeviceStage::Init { until } if until <= port.now => self.listen(port),
            DeviceStage::Listen { until } if until <= port.now => self.choose(port),
            DeviceStage::Wait { choice, until } if until <= port.now => self.claim(choice, port),
            _ => {}
        }
        if self.beat_at.is_some_and(|at| at <= port.now) {
            self.send_heartbeat(port);
            self.schedule_heartbeat(port);
        }
        for at in 0..self.chatter_at.len() {
            if self.chatter_at[at] <= port.now {
                self.send_chatter(at, port);
            }
        }
        while let Some(frame) = self.replies.poll(port.now) {
            if !port.send(frame) {
                self.replies.clear();
            }
        }
    }

    /// Switches it on.
    pub fn power_on(&mut self, port: &mut DeviceIo) {
        if self.is_on() {
            return;
        }
        if std::mem::take(&mut self.spec.skips_address_resolution) {
            self.settle(port);
        } else {
            self.begin(port);
        }
    }

    /// Switches it off.
    pub fn power_off(&mut self, port: &mut DeviceIo) {
        port.bus.set_attached(port.station, false);
        self.stop();
        self.stage = DeviceStage::Off;
        self.mode = Mode::Init;
        self.address = None;
    }

    /// Enters INIT, listen-only.
    fn begin(&mut self, port: &mut DeviceIo) {
        self.stop();
        self.mode = Mode::Init;
        self.address = None;
        let rate = self.spec.descriptor.bitrate.filter(|setting| setting.is_fixed);
        let hears_nothing = rate.is_some_and(|setting| setting.rate != port.bus.bitrate());
        port.bus.set_attached(port.station, !hears_nothing);
        if hears_nothing {
            self.stage = DeviceStage::OtherBitrate;
            return;
        }
        port.bus.controller_mut(port.station).listen_only = true;
        self.stage = DeviceStage::Init { until: port.now + port.heartbeat_time() * 3 / 2 };
    }

    /// Enters its final mode at once, without address resolution.
    fn settle(&mut self, port: &mut DeviceIo) {
        let address = match self.spec.address {
            AddressSetting::Preferred(address) | AddressSetting::Fixed(address) => address,
            AddressSetting::None => Address::from_bits(self.rng.u8(1..128)),
        };
        self.settle_at(address, port);
    }

    /// Enters its final mode at `address`, with a random heartbeat phase.
    fn settle_at(&mut self, address: Address, port: &mut DeviceIo) {
        port.bus.set_attached(port.station, true);
        port.bus.controller_mut(port.station).listen_only = false;
        self.run(address, port);
        let period = self.heartbeat_period(port);
        self.next_heartbeat = port.now + self.rng.u64(0..period);
        self.beat_at = self.beat_at.map(|_| self.next_heartbeat);
    }

    fn stop(&mut self) {
        self.replies.clear();
        self.pending_action = None;
        self.beat_at = None;
        self.chatter_at.fill(u64::MAX);
    }

    /// Starts ARSLV: listen-only, no addresses in use known.
    fn listen(&mut self, port: &mut DeviceIo) {
        self.stop();
        port.bus.set_attached(port.station, true);
        port.bus.controller_mut(port.station).listen_only = true;
        self.mode = Mode::Arslv;
        self.address = None;
        self.in_use = 0;
        self.stage = DeviceStage::Listen { until: port.now + port.heartbeat_time() * 3 / 2 };
    }

    fn choose(&mut self, port: &mut DeviceIo) {
        let is_free = |address: Address| self.in_use >> address.index() & 1 == 0;
        let wanted = match self.spec.address {
            AddressSetting::None => None,
            AddressSetting::Preferred(address) | AddressSetting::Fixed(address) => Some(address),
        };
        let wanted = wanted.filter(|&address| is_free(address) || !self.can_give_up());
        let choice = if wanted.is_some() || matches!(self.spec.address, AddressSetting::Fixed(_)) {
            wanted
        } else {
            let free: Vec<Address> = Address::nodes().filter(|&at| is_free(at)).collect();
            self.rng.choice(free)
        };
        let Some(choice) = choice else { return self.listen(port) };
        let until = port.now + self.rng.u64(0..port.heartbeat_time());
        self.stage = DeviceStage::Wait { choice, until };
    }

    /// Ends listen-only and sends the address claim, without repetition by the controller.
    fn claim(&mut self, choice: Address, port: &mut DeviceIo) {
        port.bus.controller_mut(port.station).listen_only = false;
        self.stage = DeviceStage::Claim { choice };
        let frame = self.heartbeat(choice, port);
        port.send_once(frame);
    }

    /// Repeats a failed claim after another random time. The controller stays active: two devices
    /// on an empty bus need each other's acknowledgement.
    fn claim_again(&mut self, choice: Address, port: &mut DeviceIo) {
        let until = port.now + self.rng.u64(0..port.heartbeat_time());
        self.stage = DeviceStage::Wait { choice, until };
    }

    /// Enters the configured mode at its address.
    fn run(&mut self, address: Address, port: &mut DeviceIo) {
        self.address = Some(address);
        self.stage = DeviceStage::Run;
        let configured = self.spec.address != AddressSetting::None && !self.spec.uid.is_blank();
        self.mode = match self.spec.mode {
            Some(Mode::Init | Mode::Arslv) | None if self.spec.autostart && configured => {
                Mode::Work
            }
            Some(Mode::Init | Mode::Arslv) | None => Mode::Cfg,
            Some(mode) => mode,
        };
        self.next_heartbeat = port.now;
        self.schedule_heartbeat(port);
        self.schedule_chatter(port);
    }

    fn schedule_chatter(&mut self, port: &DeviceIo) {
        for (at, chatter) in self.chatter_at.iter_mut().zip(&self.spec.periodic_messages) {
            *at = port.now + self.rng.u64(0..=nanos_of(chatter.period));
        }
    }

    fn heartbeat_period(&self, port: &DeviceIo) -> u64 {
        let period = self.spec.heartbeat.map_or(port.heartbeat_time(), nanos_of);
        self.in_device_clock(period)
    }

    /// Returns a duration as measured by the device's clock.
    fn in_device_clock(&self, nanos: u64) -> u64 {
        let millionths = 1_000_000 + i64::from(self.spec.tolerance_ppm.max(-900_000));
        let own = u128::from(nanos) * millionths.unsigned_abs() as u128 / 1_000_000;
        (own as u64).max(SHORTEST_PERIOD)
    }

    fn schedule_heartbeat(&mut self, port: &DeviceIo) {
        self.next_heartbeat += self.heartbeat_period(port);
        let late = self.rng.u64(0..=nanos_of(self.spec.max_heartbeat_delay));
        let is_awake = self.mode != Mode::Idle || self.spec.idle_ends_by_command;
        let beats = !self.spec.faults.has(Fault::NoHeartbeat) && is_awake;
        self.beat_at = beats.then_some((self.next_heartbeat + late).max(port.now));
    }

    fn heartbeat(&mut self, from: Address, port: &DeviceIo) -> Frame {
        let service = port.profile.heartbeat_service();
        let header = Header::unsolicited(from, self.rng.u8(0..128), !self.is_working(), service);
        let error = u8::from(self.mode == Mode::Ufunc);
        let heartbeat =
            Heartbeat { uid: Some(self.spec.uid), mode: Some(self.mode), error: Some(error) };
        let (data, len) = heartbeat.encode(&port.profile.heartbeat, port.modes);
        self.frame(header, &data[..len], port)
    }

    fn send_heartbeat(&mut self, port: &mut DeviceIo) {
        let Some(address) = self.address else { return };
        let frame = self.heartbeat(address, port);
        port.send(frame);
        if self.spec.faults.has(Fault::SendsRequests) {
            self.send_request(address, port);
        }
    }

    /// Sends a name request to all.
    fn send_request(&mut self, address: Address, port: &mut DeviceIo) {
        let (rnd7, service) = (self.rng.u8(0..128), port.profile.des_service());
        let mut header = Header::broadcast(address, rnd7, false, service);
        header.from_non_working = !self.is_working();
        let (data, len) = Profile::request_bytes(Request::Name, Framing::Isotp);
        let frame = self.frame(header, &data[..len], port);
        port.send(frame);
    }

    /// Sends periodic data with slowly changing values, like a sensor's.
    fn send_chatter(&mut self, at: usize, port: &mut DeviceIo) {
        let chatter = self.spec.periodic_messages[at];
        let period = self.in_device_clock(nanos_of(chatter.period));
        self.chatter_at[at] = port.now + period;
        let may_send = self.is_working() || chatter.is_debug;
        let Some(address) = self.address.filter(|_| may_send) else { return };
        let rnd7 = self.rng.u8(0..128);
        let mut header = Header::unsolicited(address, rnd7, false, chatter.service);
        if chatter.is_debug {
            (header.from_non_working, header.to_non_working) = (true, true);
            header.destination = Address::from_bits(127);
        }
        self.chatter_count = self.chatter_count.wrapping_add(1);
        let mut data = [0; Frame::MAX_DATA];
        let count = self.chatter_count.to_le_bytes();
        data[..2].copy_from_slice(&count);
        data[2] = self.rng.u8(..);
        data[3] = 0x10;
        let length = usize::from(chatter.length).min(data.len());
        let frame = self.frame(header, &data[..length], port);
        port.send(frame);
    }

    fn frame(&self, header: Header, data: &[u8], port: &DeviceIo) -> Frame {
        if self.spec.fd {
            Frame::fd(header.encode(), data, port.profile.isotp.fd_padding)
        } else {
            Frame::classic(header.encode(), data)
        }
    }

    /// Handles a frame of another node.
    pub fn handle_frame(&mut self, frame: &Frame, header: Header, port: &mut DeviceIo) {
        if let Some(program) = &mut self.program {
            return program.handle_frame(frame, port);
        }
        if !header.is_conforming() {
            return;
        }
        match self.stage {
            DeviceStage::Off | DeviceStage::OtherBitrate => {}
            DeviceStage::Init { .. } => {
                self.listen(port);
                self.note_addresses(header);
            }
            DeviceStage::Listen { .. } => self.note_addresses(header),
            DeviceStage::Wait { choice, .. } | DeviceStage::Claim { choice } => {
                self.note_addresses(header);
                if header.source == choice && self.can_give_up() {
                    self.listen(port);
                    self.note_addresses(header);
                }
            }
            DeviceStage::Run => self.handle_while_running(frame, header, port),
        }
    }

    fn note_addresses(&mut self, header: Header) {
        self.in_use |= 1 << header.source.index();
        if !header.broadcast {
            self.in_use |= 1 << header.destination.index();
        }
    }

    fn handle_while_running(&mut self, frame: &Frame, header: Header, port: &mut DeviceIo) {
        let other_works = !header.from_non_working;
        // In IDLE it does not check for other users of its address (CAN platform §3.2.4.5).
        if self.can_give_up() && self.mode != Mode::Idle {
            let matters = other_works || !self.is_working();
            if Some(header.source) == self.address && matters {
                return self.listen(port);
            }
            let is_beat = header.response && header.service == port.profile.heartbeat_service();
            if is_beat && other_works && self.is_working() && !self.spec.uid.is_blank() {
                let beat = Heartbeat::decode(frame.data(), &port.profile.heartbeat, port.modes);
                if beat.uid == Some(self.spec.uid) {
                    self.mode = Mode::Cfg;
                }
            }
        }
        let for_us = header.broadcast || Some(header.destination) == self.address;
        if for_us && !header.response && !header.from_non_working {
            self.handle_request(frame, header, port);
        }
    }

    /// Handles the transmission of one of its frames.
    pub fn handle_sent(&mut self, frame: &Frame, port: &mut DeviceIo) {
        if let Some(program) = &mut self.program {
            return program.handle_transmitted(frame, true, port);
        }
        if let DeviceStage::Claim { choice } = self.stage {
            self.run(choice, port);
        } else if let Some(id) = frame.platform_id() {
            self.replies.handle_sent(port.now, id);
            if let Some((_, action)) = self.pending_action.take_if(|(response, _)| *response == id)
            {
                self.apply(action, port);
            }
        }
    }

    /// Handles a dropped frame: the address claim, the only one that is not repeated.
    pub fn handle_abandoned(&mut self, frame: &Frame, port: &mut DeviceIo) {
        if let Some(program) = &mut self.program {
            return program.handle_transmitted(frame, false, port);
        }
        if let DeviceStage::Claim { choice } = self.stage {
            self.claim_again(choice, port);
        }
    }

    /// Checks its error counters after a bus error; starts again if they are too high.
    pub fn handle_bus_error(&mut self, port: &mut DeviceIo) {
        if let Some(program) = &mut self.program {
            return program.handle_bus_error(port);
        }
        let (tec, rec) = port.bus.controller(port.station).counters();
        if self.is_on() && tec.max(rec) >= MAX_ERRORS {
            self.begin(port);
        }
    }

    /// Applies an action of the timetable or of the caller.
    pub fn apply(&mut self, action: DeviceAction, port: &mut DeviceIo) {
        if let Some(program) = &mut self.program {
            return program.apply(&action, port);
        }
        match action {
            DeviceAction::PowerOn => self.power_on(port),
            DeviceAction::PowerOff => self.power_off(port),
            DeviceAction::Reboot { services } => {
                if let Some(services) = services {
                    self.spec.services = services;
                }
                self.begin(port);
            }
            DeviceAction::WatchdogReset => {
                if let (DeviceStage::Run, Some(address)) = (self.stage, self.address) {
                    self.stop();
                    self.settle_at(address, port);
                }
            }
            DeviceAction::Move(address) => {
                self.spec.address = address;
                if self.is_on() {
                    self.listen(port);
                }
            }
            DeviceAction::StoreAddress(address) => self.spec.address = address,
            DeviceAction::StoreBitrate(setting) => self.store_bitrate(setting, port),
            DeviceAction::Firmware(version) => self.spec.descriptor.firmware = version,
            DeviceAction::Services(services) => self.spec.services = services,
            DeviceAction::Mode(mode) => self.set_mode(mode, port),
            DeviceAction::Name(name) => self.spec.name = name,
            DeviceAction::Uid(uid) => self.spec.uid = uid,
            DeviceAction::AddFault(fault) => self.set_fault(fault, true, port),
            DeviceAction::RemoveFault(fault) => self.set_fault(fault, false, port),
            DeviceAction::SetFrameErrorProbability(_) => {}
        }
    }

    /// Stores another bit rate; acts by it at once, if the profile says so.
    fn store_bitrate(&mut self, setting: BitrateSetting, port: &mut DeviceIo) {
        self.spec.descriptor.bitrate = Some(setting);
        if self.is_on() && port.profile.writes.effect == WriteEffect::Now {
            self.begin(port);
        }
    }

    fn set_fault(&mut self, fault: Fault, present: bool, port: &mut DeviceIo) {
        self.spec.faults.set(fault, present);
        if fault == Fault::NoHeartbeat && self.stage == DeviceStage::Run {
            self.next_heartbeat = port.now;
            self.schedule_heartbeat(port);
        }
    }

    /// Changes the mode. Before IDLE it sends a last heartbeat with that mode.
    fn set_mode(&mut self, mode: Mode, port: &mut DeviceIo) {
        match (self.stage, mode) {
            (DeviceStage::Off, _) => {}
            (_, Mode::Init) => self.begin(port),
            (_, Mode::Arslv) => self.listen(port),
            (DeviceStage::Run, _) => {
                let slept = self.mode == Mode::Idle;
                self.mode = mode;
                if mode == Mode::Idle {
                    self.send_heartbeat(port);
                    self.stop();
                    if self.spec.idle_ends_by_command {
                        self.next_heartbeat = port.now;
                        self.schedule_heartbeat(port);
                    }
                } else if slept {
                    self.next_heartbeat = port.now;
                    self.schedule_heartbeat(port);
                    self.schedule_chatter(port);
                }
            }
            _ => {}
        }
    }
}

fn nanos_of(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(LONGEST_TIME).min(LONGEST_TIME)
}
