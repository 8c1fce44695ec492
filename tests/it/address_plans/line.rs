//! A bus of simulated devices that are to move, with descan on it and a disk for its plans.

use descan::address_plan::{PlanRecord, RunState};
use descan::app::{App, AppOptions, Effect, FileIndex, FileReading, PlanStart, PlanTask};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::sim::{DeviceAction, DeviceSpec, Scenario, Sim, SimDeviceId, SimStation};
use descan::status::{BusState, BusStatus, Link};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::{Address, Header};
use descan::wire::node::Uid;
use descan::wire::profile::{Profile, UidProfile};
use std::fmt::Write as _;

pub const BUS: BusIndex = BusIndex(0);

/// When writes act, and who restarts the devices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Writes {
    Now,
    Restart,
    /// The user restarts all at once.
    Later,
}

impl Writes {
    pub const ALL: [Self; 3] = [Self::Now, Self::Restart, Self::Later];

    /// With or without a number that reads what is stored.
    pub fn profile(self, is_readable: bool) -> Profile {
        let effect = if self == Self::Now { "now" } else { "restart" };
        let read = if is_readable { "[descriptor]\naddr = 0x016\n" } else { "" };
        let text = format!(
            "{read}[commands]\nreboot = 0x01A\n[writes]\naddress = 0x016\neffect = \"{effect}\"\n"
        );
        Profile::parse(&text).unwrap()
    }
}

pub fn address(number: u8) -> Address {
    Address::new(number).unwrap()
}

pub fn label(at: usize) -> String {
    format!("N{at:03}")
}

/// A device that works at this address.
pub fn device(at: usize, number: u8) -> DeviceSpec {
    let uid = Uid::parse(&format!("PLAN{at:03}"), &UidProfile::default()).unwrap();
    let mut spec = DeviceSpec::new(&label(at)).fixed(number).uid(uid);
    spec.skips_address_resolution = true;
    spec
}

/// descan on a bus of devices, with a disk for the plan's file.
pub struct Line {
    pub sim: Sim,
    pub station: SimStation,
    pub app: App,
    pub writes: Writes,
    pub profile: Profile,
    pub devices: Vec<SimDeviceId>,
    pub file: String,
    /// The file of the plan, as it is on disk.
    pub disk: Option<(String, Vec<u8>)>,
    /// It is being written.
    pub writing: Option<(String, Vec<u8>)>,
    /// Frames that descan sent to the write service.
    pub sent: Vec<Frame>,
    /// Requests to it without data: reads.
    pub reads: Vec<Frame>,
    /// Addresses are checked.
    pub is_checked: bool,
}

impl Line {
    /// Devices at these addresses, which are to have those.
    pub fn new(addresses: &[u8], wanted: &[u8], writes: Writes, seed: u64) -> Self {
        let specs = addresses.iter().enumerate().map(|(at, number)| device(at, *number)).collect();
        let mut file = r#"{"devices":["#.to_owned();
        for (at, number) in wanted.iter().enumerate() {
            let comma = if at == 0 { "" } else { "," };
            let _ = write!(
                file,
                r#"{comma}{{"name":"{}","address":{number},"static":true}}"#,
                label(at)
            );
        }
        Self::of(specs, file + "]}", writes, writes.profile(true), seed)
    }

    pub fn of(
        specs: Vec<DeviceSpec>,
        file: String,
        writes: Writes,
        profile: Profile,
        seed: u64,
    ) -> Self {
        let scenario = specs.into_iter().fold(Scenario::new(500_000), Scenario::with);
        let mut sim = Sim::with_profile(&scenario, seed, profile.clone());
        let station = sim.attach();
        let app = Self::start(Instant::ZERO, &file, &profile, seed);
        let devices = sim.devices().collect();
        Self {
            sim,
            station,
            app,
            writes,
            profile,
            devices,
            file,
            disk: None,
            writing: None,
            sent: Vec::new(),
            reads: Vec::new(),
            is_checked: true,
        }
    }

    pub fn start(now: Instant, file: &str, profile: &Profile, seed: u64) -> App {
        let profile = profile.clone().into();
        let config = Config { profile, bitrate: Some(500_000), seed, ..Config::default() };
        let options = AppOptions {
            buses: vec![("can0".to_owned(), config)],
            file_path: Some("des.json".into()),
            capture_room: Some(0),
            without_capture: true,
            ..AppOptions::default()
        };
        let mut app = App::new(now, options);
        let status = BusStatus {
            link: Link::Up,
            state: BusState::ErrorActive,
            bitrate: Some(500_000),
            ..BusStatus::default()
        };
        app.handle_bus(now, BUS, status);
        app.handle_file(
            now,
            FileIndex::default(),
            FileReading::Content(Some(file.as_bytes().to_vec())),
        );
        app
    }

    /// Runs until it is enough, at most so many seconds; returns whether it is.
    pub fn run(&mut self, seconds: f64, mut enough: impl FnMut(&Self) -> bool) -> bool {
        let end = self.sim.now() + Duration::from_secs_f64(seconds);
        while self.sim.now() < end {
            let now = self.sim.now();
            while let Some(frame) = self.sim.poll_frame(self.station) {
                if let Some(id) = frame.platform_id().filter(|_| frame.is_tx) {
                    let is_write = Header::decode(id).service.number() == 0x016;
                    match is_write {
                        true if frame.is_empty() => self.reads.push(frame),
                        true => self.sent.push(frame),
                        false => {}
                    }
                }
                self.app.handle_frames(now, &[frame]);
            }
            if let Some(written) = self.writing.take() {
                self.disk = Some(written);
                self.app.handle_plan_written(now, Ok(()));
            }
            if self.app.poll_timeout().is_some_and(|due| due <= now) {
                self.app.handle_timeout(now);
            }
            while let Some(frame) = self.app.poll_transmit(now) {
                self.sim.transmit(self.station, frame);
            }
            while let Some(effect) = self.app.poll_effect() {
                match effect {
                    Effect::WritePlan { name, bytes, .. } => self.writing = Some((name, bytes)),
                    Effect::ReadLastPlan { bus } => {
                        let last = self
                            .disk
                            .as_ref()
                            .map(|(name, bytes)| (name.clone(), PlanRecord::parse(bytes).unwrap()));
                        self.app.handle_last_plan(now, &bus, Ok(last.map(Box::new)));
                    }
                    _ => {}
                }
            }
            if enough(self) {
                return true;
            }
            let due = [self.app.poll_timeout(), self.sim.next_event(), Some(end)];
            let next = due.into_iter().flatten().min().unwrap_or(end);
            self.sim.advance(next.max(now));
            self.check();
        }
        false
    }

    /// No two devices have one address, live or stored.
    pub fn check(&self) {
        if !self.is_checked {
            return;
        }
        let (mut live, mut stored) = (0u128, 0u128);
        for device in &self.devices {
            let state = self.sim.device_state(*device);
            if let Some(address) = state.address {
                let bit = 1 << address.index();
                assert_eq!(live & bit, 0, "two live at {address}, {}", self.sim.now());
                live |= bit;
            }
            if let AddressSetting::Fixed(address) = state.setting {
                let bit = 1 << address.index();
                assert_eq!(stored & bit, 0, "two stored {address}, {}", self.sim.now());
                stored |= bit;
            }
        }
    }

    pub fn is_complete(&self) -> bool {
        let bus = &self.app.buses()[0];
        let named = bus.devices().iter().filter(|it| it.is_present() && it.name.is_some());
        bus.progress().is_complete && named.count() >= self.devices.len()
    }

    /// Waits for all devices, makes a plan and returns when it is made.
    pub fn plan(&mut self, task: PlanTask) {
        self.run(40.0, Self::is_complete);
        self.app.prepare_plan(BUS, task, self.writes == Writes::Restart).unwrap();
        let is_read = |line: &Self| !line.app.address_plan().unwrap().is_reading();
        assert!(self.run(60.0, is_read), "the settings are read");
    }

    pub fn state(&self) -> Option<RunState> {
        Some(self.app.address_plan()?.run()?.state().clone())
    }

    /// Starts the plan and runs it to its end, or until it is enough.
    pub fn apply(&mut self, mut enough: impl FnMut(&Self) -> bool) {
        assert_eq!(self.app.start_plan(), Ok(PlanStart::Started));
        let ends = |line: &Self| {
            let session = line.app.address_plan().unwrap();
            !session.is_running() && session.is_stored()
        };
        assert!(self.run(3000.0, |line| ends(line) || enough(line)), "the plan ends");
    }

    /// Runs the plan to its end. Where settings act later, all devices are switched off and on.
    pub fn finish(&mut self) {
        self.apply(|_| false);
        if self.writes == Writes::Later && self.state() == Some(RunState::Stored) {
            self.switch_off_and_on();
            assert!(self.run(60.0, |line| line.state() == Some(RunState::Done)));
        }
        assert_eq!(self.state(), Some(RunState::Done), "{}", self.plan_text());
    }

    pub fn switch_off_and_on(&mut self) {
        for device in self.devices.clone() {
            self.sim.apply(device, DeviceAction::PowerOff);
        }
        self.run(0.5, |_| false);
        for device in self.devices.clone() {
            self.sim.apply(device, DeviceAction::PowerOn);
        }
    }

    /// The power fails for devices and descan: what was not written is lost.
    pub fn cut_power(&mut self, seed: u64) {
        for device in self.devices.clone() {
            self.sim.apply(device, DeviceAction::PowerOff);
        }
        self.writing = None;
        let later = self.sim.now() + Duration::from_secs(2);
        self.sim.advance(later);
        while self.sim.poll_frame(self.station).is_some() {}
        self.app = Self::start(later, &self.file, &self.profile, seed);
        for device in self.devices.clone() {
            self.sim.apply(device, DeviceAction::PowerOn);
        }
    }

    /// The file of the plan, as it is on disk.
    pub fn record(&self) -> (String, PlanRecord) {
        let (name, bytes) = self.disk.clone().expect("a file");
        (name, PlanRecord::parse(&bytes).unwrap())
    }

    pub fn addresses(&self) -> Vec<Option<u8>> {
        let states = self.devices.iter().map(|it| self.sim.device_state(*it));
        states.map(|state| state.address.map(Address::number)).collect()
    }

    pub fn plan_text(&self) -> String {
        let session = self.app.address_plan().unwrap();
        let mut text = format!("{:?}\n", self.state());
        for (at, step) in session.plan().steps.iter().enumerate() {
            let (state, why) = (session.step_state(at), step.why());
            let name = step.device.label();
            let _ = writeln!(text, "{name} {} → {} {why}: {state}", step.from, step.to);
        }
        for left in &session.plan().left_out {
            let _ = writeln!(text, "{} – {}: {}", left.device.label(), left.to, left.reason);
        }
        text
    }
}
