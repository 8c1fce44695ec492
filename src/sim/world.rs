//! The running simulation: bus, devices, attached stations and timetable, one event at a time.

use super::bus::{BusErrorCause, BusOutcome, SimBus, StationIndex, Statistics};
use super::device::program::DeviceProgram;
use super::device::{DeviceIo, SimDevice};
use super::inspector::Inspector;
use super::scenario::{DeviceAction, DeviceSpec, Scenario};
use super::view::{DeviceState, SimDeviceId, SimStation, StationStatus};
use crate::frame::Frame;
use crate::frame::bits::FrameBits;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use crate::wire::profile::Profile;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Capacity of a device's transmit queue, in frames.
const DEVICE_QUEUE: usize = 32;
/// Capacity of an attached station's transmit queue, in frames.
const STATION_QUEUE: usize = 1024;
/// Most devices in a simulation.
const MAX_DEVICES: usize = 1024;
/// Most attached stations.
const MAX_STATIONS: usize = 1024;

/// A running simulation of one bus with its devices.
///
/// [`advance`](Self::advance) it, then [`poll_frame`](Self::poll_frame) each station; a transmitted
/// frame goes onto the bus with the next advance. Accepts any scenario without a panic. All queues
/// are bounded.
///
/// ```
/// use descan::frame::Frame;
/// use descan::sim::{DeviceSpec, Scenario, Sim};
/// use descan::time::Instant;
///
/// let feed = DeviceSpec::new("FEED").fixed(12).skips_address_resolution();
/// let scenario = Scenario::new(125_000).with(feed);
/// let mut sim = Sim::from_scenario(&scenario);
/// let station = sim.attach();
/// // A broadcast name request from address 0, as an ISO-TP single frame.
/// sim.transmit(station, Frame::classic(0x0200_0002, b"\x04DES\x01"));
/// sim.advance(Instant::from_micros(100_000));
/// let mut frames = std::iter::from_fn(|| sim.poll_frame(station));
/// assert!(frames.any(|frame| frame.data() == b"\x06\x01FEED\0"));
/// ```
pub struct Sim {
    now: u64,
    bus: SimBus,
    devices: Vec<SimDevice>,
    /// Station of each device; device or inspector of each station.
    stations: Vec<StationIndex>,
    owners: Vec<Owner>,
    inspectors: Vec<Inspector>,
    /// Devices by address.
    by_address: [Vec<u16>; Address::COUNT],
    /// Devices without an address; they receive all frames.
    listening: Vec<u16>,
    /// Next call of each device, in nanoseconds; other entries of the queue are outdated.
    calls: Vec<u64>,
    call_queue: BinaryHeap<Reverse<(u64, u16)>>,
    timetable: Vec<TimetableSlot>,
    timetable_queue: BinaryHeap<Reverse<(u64, usize)>>,
    profile: Profile,
    modes: [u8; 7],
    rx_loss: f64,
    rng: fastrand::Rng,
}

#[derive(Clone, Copy)]
enum Owner {
    Device(u16),
    Inspector(u16),
}

struct TimetableSlot {
    device: Option<u16>,
    every: Option<u64>,
    action: DeviceAction,
}

impl Sim {
    /// Creates a simulation of `scenario` with its profile.
    pub fn new(scenario: &Scenario, seed: u64) -> Self {
        Self::with_profile(scenario, seed, scenario.profile.clone())
    }

    /// Creates a simulation with the scenario's own profile and seed.
    pub fn from_scenario(scenario: &Scenario) -> Self {
        Self::new(scenario, scenario.seed)
    }

    /// Creates a simulation whose devices use another profile than that of the scenario.
    pub fn with_profile(scenario: &Scenario, seed: u64, profile: Profile) -> Self {
        let mut rng = fastrand::Rng::with_seed(seed);
        let bus = SimBus::new(
            scenario.bitrate,
            scenario.data_bitrate,
            scenario.frame_error_probability,
            rng.fork(),
        );
        let mut sim = Self {
            now: 0,
            bus,
            devices: Vec::new(),
            stations: Vec::new(),
            owners: Vec::new(),
            inspectors: Vec::new(),
            by_address: std::array::from_fn(|_| Vec::new()),
            listening: Vec::new(),
            calls: Vec::new(),
            call_queue: BinaryHeap::new(),
            timetable: Vec::new(),
            timetable_queue: BinaryHeap::new(),
            modes: profile.modes.codes(),
            profile,
            rx_loss: scenario.rx_loss,
            rng,
        };
        for device in &scenario.devices {
            sim.add_device(device.clone());
        }
        for event in &scenario.timetable {
            let device = sim.device(&event.device).map(|SimDeviceId(index)| index);
            let every = event.every.map(|every| (every.as_nanos() as u64).max(1_000_000));
            sim.schedule(super::nanos(event.time), device, every, event.action.clone());
        }
        sim
    }

    /// Returns the virtual time.
    pub fn now(&self) -> Instant {
        super::instant(self.now)
    }

    /// Returns the time of the next event, at least `now()`, provided that nothing is transmitted
    /// before; `None` if there is none.
    pub fn next_event(&self) -> Option<Instant> {
        self.next_nanos().map(|at| Instant::from_micros(at.max(self.now).div_ceil(1000)))
    }

    /// Runs bus and devices up to and including `until`; no effect if that is in the past.
    pub fn advance(&mut self, until: Instant) {
        let until = super::nanos(until);
        while let Some(at) = self.next_nanos().filter(|&at| at <= until) {
            self.now = self.now.max(at);
            self.step();
        }
        self.now = self.now.max(until);
    }

    /// Attaches a station with its link up. At most 1,024; further calls return the last one.
    pub fn attach(&mut self) -> SimStation {
        if self.inspectors.len() < MAX_STATIONS {
            let station = self.bus.add(STATION_QUEUE);
            self.owners.push(Owner::Inspector(self.inspectors.len() as u16));
            self.inspectors.push(Inspector::new(station));
            self.bus.set_attached(station, true);
            return SimStation(station);
        }
        let last = self.owners.iter().rposition(|owner| matches!(owner, Owner::Inspector(_)));
        SimStation(last.unwrap_or(0) as u16)
    }

    /// Queues a frame at `now()`. Returns false if it is rejected: the queue (1,024 frames) is
    /// full, or the station is down or bus-off. The station receives its own frame, with `is_tx`,
    /// when it was acknowledged.
    pub fn transmit(&mut self, station: SimStation, frame: Frame) -> bool {
        self.bus.transmit(self.now, station.0, frame, false)
    }

    /// Forwards a frame that `station` received on another bus: all stations here receive it at
    /// once, without arbitration, since it won arbitration there. The station receives its own
    /// frame with `is_tx`.
    pub fn forward(&mut self, station: SimStation, frame: Frame) {
        self.deliver(&frame.with_time(self.now()), &[station.0]);
    }

    /// Returns the next frame that this station received, with its time, oldest first: frames of
    /// other stations, its own (`is_tx`) and error frames; `None` if there is none.
    pub fn poll_frame(&mut self, station: SimStation) -> Option<Frame> {
        self.inspector_mut(station.0)?.poll()
    }

    /// Returns the status of a station's controller.
    pub fn status(&self, station: SimStation) -> StationStatus {
        let controller = self.bus.controller(station.0);
        let (tec, rec) = controller.counters();
        let (missed, overflowed) = match self.owners[usize::from(station.0)] {
            Owner::Inspector(at) => {
                let inspector = &self.inspectors[usize::from(at)];
                (inspector.rx_lost, inspector.rx_overflow)
            }
            Owner::Device(_) => (0, 0),
        };
        StationStatus {
            state: controller.state(),
            tec,
            rec,
            bitrate: self.bus.bitrate(),
            queued: controller.queued(),
            tx_rejected: controller.dropped,
            rx_lost: missed,
            rx_overflow: overflowed,
        }
    }

    /// Sets a station's link down, which drops its queue, or up, which also ends bus-off.
    pub fn set_link(&mut self, station: SimStation, up: bool) {
        self.bus.set_attached(station.0, up);
        self.report_states();
    }

    /// Sets a station listen-only: no frames, no acknowledgement, no error flags.
    pub fn set_listen_only(&mut self, station: SimStation, listen_only: bool) {
        self.bus.controller_mut(station.0).listen_only = listen_only;
        self.bus.wake(self.now, station.0);
    }

    /// Sets a station's bit rate, in bit/s, 10,000 to 1,000,000. It receives the frames of stations
    /// with this rate only and, unless listen-only, destroys those of others.
    pub fn set_bitrate(&mut self, station: SimStation, bitrate: u32) {
        self.bus.set_bitrate(station.0, bitrate);
    }

    /// Adds a device, switched on at its `power_on`, or now if that has passed. At most 1,024;
    /// further calls return the last one.
    pub fn add_device(&mut self, spec: DeviceSpec) -> SimDeviceId {
        if self.devices.len() >= MAX_DEVICES {
            return SimDeviceId((self.devices.len() - 1) as u16);
        }
        let index = self.devices.len() as u16;
        let power_on = spec.power_on.map(|at| super::nanos(Instant::ZERO + at).max(self.now));
        self.stations.push(self.bus.add(DEVICE_QUEUE));
        self.owners.push(Owner::Device(index));
        self.devices.push(SimDevice::new(spec, self.rng.fork()));
        self.calls.push(u64::MAX);
        match power_on {
            Some(at) if at > self.now => {
                self.schedule(at, Some(index), None, DeviceAction::PowerOn);
            }
            Some(_) => self.apply(SimDeviceId(index), DeviceAction::PowerOn),
            None => {}
        }
        SimDeviceId(index)
    }

    /// Lets a device run a program instead of the simulated behaviour. It starts now if the device is
    /// on, otherwise with the device's power.
    pub fn set_program(&mut self, device: SimDeviceId, program: Box<dyn DeviceProgram>) {
        self.with_device(device.0, |device, port| device.set_program(program, port));
    }

    /// Returns the device with this label; `None` if there is none.
    pub fn device(&self, label: &str) -> Option<SimDeviceId> {
        let at = self.devices.iter().position(|device| device.spec.label == label)?;
        Some(SimDeviceId(at as u16))
    }

    /// Yields all devices, including those that are off.
    pub fn devices(&self) -> impl Iterator<Item = SimDeviceId> + use<> {
        (0..self.devices.len() as u16).map(SimDeviceId)
    }

    /// Returns the true state of a device.
    pub fn device_state(&self, device: SimDeviceId) -> DeviceState<'_> {
        let index = usize::from(device.0);
        let it = &self.devices[index];
        let controller = self.bus.controller(self.stations[index]);
        DeviceState {
            label: &it.spec.label,
            name: &it.spec.name,
            uid: it.spec.uid,
            mode: it.is_on().then(|| it.mode()),
            address: it.address(),
            setting: it.spec.address,
            services: &it.spec.services,
            counters: controller.counters(),
            active_bitrate: controller.is_active().then_some(controller.bitrate),
        }
    }

    /// Applies an action to a device now.
    pub fn apply(&mut self, device: SimDeviceId, action: DeviceAction) {
        if let DeviceAction::SetFrameErrorProbability(rate) = action {
            self.bus.frame_error_probability = rate;
        } else {
            self.with_device(device.0, |device, port| device.apply(action, port));
        }
    }

    /// Sets the share of frames destroyed on the wire, 0 to 1.
    pub fn set_frame_error_probability(&mut self, rate: f64) {
        self.bus.frame_error_probability = rate;
    }

    /// Returns the totals of the bus since the start.
    pub fn statistics(&self) -> Statistics {
        self.bus.statistics()
    }

    /// Returns the time that `frame` takes on this bus, including stuff bits and intermission.
    pub fn frame_duration(&self, frame: &Frame) -> Duration {
        let bits = FrameBits::of(frame);
        Duration::from_nanos(bits.nanos(self.bus.bitrate(), self.bus.data_bitrate()))
    }

    fn next_nanos(&self) -> Option<u64> {
        let call = self.call_queue.peek().map(|Reverse((at, _))| *at);
        let entry = self.timetable_queue.peek().map(|Reverse((at, _))| *at);
        [self.bus.next_event(), call, entry].into_iter().flatten().min()
    }

    /// Processes one event: of the timetable first, then of the bus, then of devices.
    fn step(&mut self) {
        if let Some(&Reverse((at, entry))) = self.timetable_queue.peek()
            && at <= self.now
        {
            self.timetable_queue.pop();
            self.follow_timetable(at, entry);
        } else if self.bus.next_event().is_some_and(|at| at <= self.now) {
            self.step_bus();
        } else if let Some(&Reverse((at, device))) = self.call_queue.peek()
            && at <= self.now
        {
            self.call_queue.pop();
            if self.calls[usize::from(device)] == at {
                self.calls[usize::from(device)] = u64::MAX;
                self.with_device(device, SimDevice::handle_timeout);
            }
        }
    }

    fn schedule(&mut self, at: u64, device: Option<u16>, every: Option<u64>, action: DeviceAction) {
        self.timetable_queue.push(Reverse((at, self.timetable.len())));
        self.timetable.push(TimetableSlot { device, every, action });
    }

    fn follow_timetable(&mut self, at: u64, index: usize) {
        let entry = &self.timetable[index];
        let action = entry.action.clone();
        if let Some(every) = entry.every {
            self.timetable_queue.push(Reverse((at.saturating_add(every), index)));
        }
        match (entry.device, action) {
            (_, DeviceAction::SetFrameErrorProbability(rate)) => {
                self.bus.frame_error_probability = rate;
            }
            (Some(device), action) => self.apply(SimDeviceId(device), action),
            (None, _) => {}
        }
    }

    fn step_bus(&mut self) {
        match self.bus.step() {
            None => {}
            Some(BusOutcome::Frame(frame)) => {
                let senders = self.bus.senders().to_vec();
                self.deliver(&frame, &senders);
            }
            Some(BusOutcome::BusError(error)) => {
                let senders = self.bus.senders().to_vec();
                self.report_error(error, &senders, false);
            }
            Some(BusOutcome::Unacknowledged(frame)) => {
                let senders = self.bus.senders().to_vec();
                self.report_error(BusErrorCause::NoAck, &senders, true);
                self.deliver_to_stations(&frame, &senders, true);
                if let Some(id) = frame.platform_id() {
                    self.deliver_to_devices(&frame, Header::decode(id), &senders);
                }
            }
            Some(BusOutcome::PassiveError) => {
                let losers = self.bus.passive_error_stations().to_vec();
                self.report_error(BusErrorCause::Collision, &losers, true);
            }
        }
    }

    fn deliver(&mut self, frame: &Frame, senders: &[StationIndex]) {
        self.deliver_to_stations(frame, senders, false);
        for &sender in senders {
            if let Owner::Device(device) = self.owners[usize::from(sender)] {
                self.with_device(device, |device, port| device.handle_sent(frame, port));
            }
        }
        if let Some(id) = frame.platform_id() {
            self.deliver_to_devices(frame, Header::decode(id), senders);
        }
        self.report_abandoned();
    }

    /// Delivers a frame to the devices that may react to it.
    fn deliver_to_devices(&mut self, frame: &Frame, header: Header, senders: &[StationIndex]) {
        let is_heartbeat = header.response && header.service == self.profile.heartbeat_service();
        let to_all = is_heartbeat || header.broadcast && !header.response;
        let mut receivers: Vec<u16> = if to_all {
            (0..self.devices.len() as u16).collect()
        } else {
            let mut some = self.listening.clone();
            some.extend_from_slice(&self.by_address[header.source.index()]);
            if header.destination != header.source && !header.broadcast {
                some.extend_from_slice(&self.by_address[header.destination.index()]);
            }
            some
        };
        receivers.retain(|&device| !senders.contains(&self.stations[usize::from(device)]));
        for &device in &receivers {
            self.with_device(device, |device, port| device.handle_frame(frame, header, port));
        }
    }

    /// Delivers a frame to the attached stations; one that was not acknowledged not to its senders.
    fn deliver_to_stations(
        &mut self,
        frame: &Frame,
        senders: &[StationIndex],
        is_unacknowledged: bool,
    ) {
        for inspector in &mut self.inspectors {
            let controller = self.bus.controller(inspector.station);
            let is_lost = is_unacknowledged && senders.contains(&inspector.station);
            if is_lost || !controller.is_receiving() {
                continue;
            }
            let counters = controller.counters();
            if controller.bitrate != self.bus.frame_bitrate() {
                inspector.push_error(frame.time, BusErrorCause::Disturbance, false, counters);
            } else if senders.contains(&inspector.station) {
                inspector.push(frame.with_tx());
            } else if self.rx_loss > 0.0 && self.rng.f64() < self.rx_loss {
                inspector.rx_lost += 1;
            } else {
                inspector.push(*frame);
            }
            inspector.push_state(frame.time, controller.state(), counters);
        }
    }

    /// Reports a bus error to all stations or, with `privately`, to its senders only.
    fn report_error(&mut self, error: BusErrorCause, senders: &[StationIndex], senders_only: bool) {
        let at = super::instant(self.now);
        for inspector in &mut self.inspectors {
            let controller = self.bus.controller(inspector.station);
            let sent = senders.contains(&inspector.station);
            if controller.attached && (sent || !senders_only) {
                inspector.push_error(at, error, sent, controller.counters());
            }
        }
        self.report_states();
        for device in 0..self.devices.len() as u16 {
            if !senders_only || senders.contains(&self.stations[usize::from(device)]) {
                self.with_device(device, SimDevice::handle_bus_error);
            }
        }
        self.report_abandoned();
    }

    /// Reports frames that are not repeated to the devices that sent them.
    fn report_abandoned(&mut self) {
        for (station, frame) in self.bus.take_abandoned() {
            if let Owner::Device(device) = self.owners[usize::from(station)] {
                self.with_device(device, |device, port| device.handle_abandoned(&frame, port));
            }
        }
    }

    fn report_states(&mut self) {
        let at = super::instant(self.now);
        for inspector in &mut self.inspectors {
            let controller = self.bus.controller(inspector.station);
            inspector.push_state(at, controller.state(), controller.counters());
        }
    }

    fn inspector_mut(&mut self, station: StationIndex) -> Option<&mut Inspector> {
        match self.owners.get(usize::from(station))? {
            Owner::Inspector(index) => self.inspectors.get_mut(usize::from(*index)),
            Owner::Device(_) => None,
        }
    }

    /// Runs `act` on a device, then updates its address, whether it receives all frames, and its
    /// next call.
    fn with_device(&mut self, index: u16, act: impl FnOnce(&mut SimDevice, &mut DeviceIo)) {
        let at = usize::from(index);
        let Some(device) = self.devices.get_mut(at) else { return };
        // One that receives all frames needs no entry by its address.
        let routing = |device: &SimDevice| {
            let is_listening = device.is_listening();
            (device.address().filter(|_| !is_listening), is_listening)
        };
        let before = routing(device);
        let mut port = DeviceIo {
            now: self.now,
            bus: &mut self.bus,
            station: self.stations[at],
            profile: &self.profile,
            modes: &self.modes,
        };
        act(device, &mut port);
        let (address, listening) = routing(device);
        if before.0 != address {
            if let Some(old) = before.0 {
                self.by_address[old.index()].retain(|&other| other != index);
            }
            if let Some(new) = address {
                self.by_address[new.index()].push(index);
            }
        }
        if before.1 != listening {
            self.listening.retain(|&other| other != index);
            if listening {
                self.listening.push(index);
            }
        }
        let call = device.poll_timeout().map_or(u64::MAX, |call| call.max(self.now));
        if call != self.calls[at] {
            self.calls[at] = call;
            if call != u64::MAX {
                self.call_queue.push(Reverse((call, index)));
            }
        }
    }
}
