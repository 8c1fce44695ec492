//! A random bus: its devices, their faults and changes, and the links to the inspectors.

use super::link_faults::{Deafness, Gateway, Jump, Lens};
use crate::common::inspection::FAULTS;
use descan::discovery::Config;
use descan::frame::{CanId, Frame};
use descan::sim::{DeviceAction, DeviceFraming, DeviceSpec, Fault, Scenario};
use descan::time::Duration;
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::Header;
use descan::wire::node::{Mode, Uid};
use descan::wire::profile::Profile;

/// The time after which no more changes begin.
const BUSY: u64 = 22_000;
/// The observation time after that.
const CALM: u64 = 22_000;

pub struct World {
    pub seed: u64,
    pub scenario: Scenario,
    pub inspectors: Vec<Inspector>,
    /// The changes as text, for the failure report.
    pub stories: Vec<String>,
    /// Labels of devices whose presence changes visibly.
    pub touched: Vec<String>,
    /// The time span of bus errors.
    pub broken: Option<(Duration, Duration)>,
    pub foreign: Option<ForeignNodes>,
    /// The time after which nothing changes any more.
    pub calm: Duration,
    pub end: Duration,
}

/// Nodes of another protocol that send beside the devices, always.
#[derive(Clone, Debug)]
pub struct ForeignNodes {
    pub ids: Vec<CanId>,
    /// Interval of their frames.
    pub interval: Duration,
}

impl ForeignNodes {
    /// Returns the frame with that number.
    pub fn frame(&self, number: usize) -> Frame {
        let data = (number as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        Frame::new(self.ids[number % self.ids.len()], &data.to_be_bytes())
    }

    /// Returns true if frames of devices and theirs may have the same identifier.
    pub fn is_extended(&self) -> bool {
        self.ids.iter().any(|id| matches!(id, CanId::Extended(_)))
    }
}

/// An inspector on the bus.
pub struct Inspector {
    pub from: Duration,
    pub config: Config,
    pub lens: Lens,
}

struct Maker {
    rng: fastrand::Rng,
    scenario: Scenario,
    free: Vec<u8>,
    /// Devices without a planned change so far.
    quiet: Vec<usize>,
    stories: Vec<String>,
    touched: Vec<String>,
    broken: Option<(Duration, Duration)>,
    foreign: Option<ForeignNodes>,
}

fn millis(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

impl World {
    pub fn new(seed: u64) -> Self {
        let mut rng = fastrand::Rng::with_seed(seed);
        let bitrate = *rng.choice(&[125_000, 125_000, 250_000, 500_000, 1_000_000]).unwrap();
        let mut free: Vec<u8> = (1..128).collect();
        rng.shuffle(&mut free);
        let mut maker = Maker {
            scenario: Scenario::new(bitrate),
            rng,
            free,
            quiet: Vec::new(),
            stories: Vec::new(),
            touched: Vec::new(),
            broken: None,
            foreign: None,
        };
        maker.populate();
        maker.disturb();
        let mut inspectors = maker.inspectors();
        for _ in 0..maker.rng.usize(0..=4) {
            maker.story();
        }
        // Later kinds have random numbers of their own: what a seed gave before stays.
        maker.rng = fastrand::Rng::with_seed(!seed);
        if maker.one_in(6) {
            maker.gateway(&mut inspectors[0]);
        }
        if maker.one_in(6) {
            maker.responds_twice();
        }
        if maker.one_in(6) {
            maker.swaps_to_and_fro();
        }
        if maker.one_in(6) {
            maker.other_periods();
        }
        if maker.one_in(8) {
            maker.foreign_nodes();
        }
        if maker.one_in(20) {
            maker.scenario.rx_loss = 0.3;
        }
        Self {
            seed,
            scenario: maker.scenario,
            inspectors,
            stories: maker.stories,
            touched: maker.touched,
            broken: maker.broken,
            foreign: maker.foreign,
            calm: millis(BUSY),
            end: millis(BUSY + CALM),
        }
    }

    /// Returns the bus load that the devices cause by themselves, as a fraction.
    pub fn load(&self) -> f64 {
        let load: f64 = self.scenario.devices.iter().map(load).sum();
        let foreign = self.foreign.as_ref().map(|it| 150.0 / it.interval.as_secs_f64());
        (load + foreign.unwrap_or(0.0)) / f64::from(self.scenario.bitrate)
    }

    /// Returns true if the devices alone offer more frames than the bus can carry: frames of the
    /// lowest priority are never sent.
    pub fn is_overfull(&self) -> bool {
        self.load() > 0.95
    }

    /// Returns true if broadcasts and their responses keep the bus busy for seconds.
    pub fn is_crowded(&self) -> bool {
        self.scenario.devices.len() * self.inspectors.len() > 100
    }

    /// Returns true if the inspector receives all frames unchanged.
    pub fn is_clear(&self, inspector: usize) -> bool {
        // A saturated bus delays every frame.
        self.load() < 0.8
            && self.scenario.devices.len() * self.inspectors.len() < 200
            && self.scenario.rx_loss == 0.0
            && self.scenario.frame_error_probability == 0.0
            && self.scenario.timetable.iter().all(|entry| !entry.device.is_empty())
            && self.inspectors[inspector].lens.is_clear()
    }

    /// Returns true if so many frames are lost that conflicts are not certain, other than those of
    /// different UIDs.
    pub fn is_very_lossy(&self) -> bool {
        self.scenario.rx_loss > 0.1
    }
}

impl Maker {
    fn one_in(&mut self, n: u32) -> bool {
        self.rng.u32(..n) == 0
    }

    /// Returns a random time while changes happen.
    fn moment(&mut self) -> Duration {
        millis(self.rng.u64(3000..BUSY - 6000))
    }

    fn populate(&mut self) {
        let count = match self.rng.u8(..100) {
            0..60 => self.rng.usize(1..=8),
            60..92 => self.rng.usize(9..=24),
            92..99 => self.rng.usize(25..=60),
            _ => 127,
        };
        let busy = self.one_in(8);
        for number in 0..count {
            let Some(address) = self.free.pop() else { break };
            let device = self.device(number, address, busy);
            self.quiet.push(self.scenario.devices.len());
            self.scenario.devices.push(device);
        }
        let mut quiet = std::mem::take(&mut self.quiet);
        self.rng.shuffle(&mut quiet);
        self.quiet = quiet;
    }

    fn device(&mut self, number: usize, address: u8, busy: bool) -> DeviceSpec {
        let twin = self.one_in(10);
        let long = self.one_in(10);
        let name = match (twin, long) {
            (true, _) => "TWIN".to_owned(),
            (_, true) => format!("LONGNAME{number:03}"),
            _ => format!("N{number:03}"),
        };
        let uid = if self.one_in(8) { Uid([0; 6]) } else { self.uid() };
        let mut device = DeviceSpec::new(&name).label(&format!("{number}")).uid(uid).fixed(address);
        // From the start, another node must acknowledge.
        device = if number == 0 || !self.one_in(3) {
            device.skips_address_resolution()
        } else {
            device.power_on(millis(self.rng.u64(0..8000)))
        };
        if self.one_in(5) {
            device.mode = Some(Mode::Cfg);
        }
        let framings = [DeviceFraming::Isotp, DeviceFraming::Raw, DeviceFraming::Both];
        let framing = *self.rng.choice(&framings).unwrap();
        if framing == DeviceFraming::Raw {
            device.services.clear();
            if long && !twin {
                device.name = format!("L{number:03}").into_bytes();
            }
        } else {
            for service in 0..self.rng.usize(0..8) {
                device = device.service(&format!("S{service}"), "1.0");
            }
        }
        device = device.framing(framing);
        device.fd = framing != DeviceFraming::Raw && self.one_in(8);
        if self.one_in(6) {
            device.response_delay = (millis(20), millis(self.rng.u64(21..150)));
        }
        if self.one_in(8) {
            // ± 40 % of the period in the worst case.
            device.max_heartbeat_delay = millis(self.rng.u64(1..=800));
        }
        if self.one_in(8) {
            device.tolerance_ppm = self.rng.i32(-3000..3000);
        }
        if self.one_in(16) {
            let fault = *self.rng.choice(&FAULTS).unwrap();
            device = device.fault(fault);
        }
        if busy || self.one_in(8) {
            let period = 8_000_000 / u64::from(self.scenario.bitrate / 1000) * self.rng.u64(1..8);
            device = device.periodic_message(0x100, Duration::from_micros(period), 8);
        }
        device
    }

    fn uid(&mut self) -> Uid {
        Uid(std::array::from_fn(|_| self.rng.u8(1..255)))
    }

    /// Adds noise and loss for all nodes.
    fn disturb(&mut self) {
        if self.one_in(6) {
            self.scenario.frame_error_probability = self.rng.f64() * 0.03;
        }
        if self.one_in(6) {
            self.scenario.rx_loss = self.rng.f64() * 0.03;
        }
        if self.one_in(10) {
            let at = self.moment();
            let rate = 0.2 + 0.8 * self.rng.f64();
            let quiet = self.scenario.frame_error_probability;
            let lasts = millis(self.rng.u64(50..3000));
            self.tell(format!("{at:?}: {:.0} % of frames break for {lasts:?}", rate * 100.0));
            self.broken = Some((at, at + lasts));
            self.at(at, "", DeviceAction::SetFrameErrorProbability(rate));
            self.at(at + lasts, "", DeviceAction::SetFrameErrorProbability(quiet));
        }
    }

    fn inspectors(&mut self) -> Vec<Inspector> {
        let count = match self.rng.u8(..20) {
            0..17 => 1,
            17..19 => 2,
            _ => 4,
        };
        let mut inspectors: Vec<Inspector> = (0..count)
            .map(|_| {
                let late = self.one_in(4);
                let from = if late { millis(self.rng.u64(0..BUSY - 4000)) } else { millis(0) };
                let mut config = Config::default();
                if self.one_in(5) {
                    config.listen_only = true;
                } else if self.one_in(6) {
                    config.round_period = Duration::ZERO;
                }
                let lens = self.lens();
                self.tell(format!(
                    "an inspector from {from:?}, listen-only {}, {lens:?}",
                    config.listen_only
                ));
                Inspector { from, config, lens }
            })
            .collect();
        inspectors.sort_by_key(|inspector| inspector.from);
        inspectors
    }

    fn lens(&mut self) -> Lens {
        let mut lens = Lens::default();
        if self.one_in(12) {
            let from = if self.rng.bool() { millis(0) } else { self.moment() };
            let until = if self.rng.bool() { millis(BUSY + CALM) } else { from + millis(9000) };
            lens.doubled = Some((from, until, self.delay()));
        }
        if self.one_in(16) {
            lens.echo = true;
        }
        if self.one_in(12) {
            let from = self.moment();
            let until = from + millis(self.rng.u64(100..6000));
            lens.deaf = Some(Deafness { from, until, told: self.rng.bool() });
        }
        if self.one_in(16) {
            let at = self.moment();
            let by = millis(self.rng.u64(500..4_000_000));
            lens.jump = Some(Jump { at, by });
        }
        lens
    }

    /// Picks the delay of duplicate frames.
    fn delay(&mut self) -> Duration {
        let most = if self.one_in(4) { 300_000 } else { 30_000 };
        Duration::from_micros(self.rng.u64(1..most))
    }

    fn tell(&mut self, story: String) {
        self.stories.push(story);
    }

    fn at(&mut self, at: Duration, label: &str, action: DeviceAction) {
        let scenario = std::mem::take(&mut self.scenario);
        self.scenario = scenario.at(at, label, action);
    }

    /// Picks a device without a planned change, for a change that becomes visible.
    fn take(&mut self) -> Option<DeviceSpec> {
        let device = self.scenario.devices[self.quiet.pop()?].clone();
        self.touched.push(device.label.clone());
        Some(device)
    }

    fn story(&mut self) {
        match self.rng.u8(..18) {
            0..6 => self.collision(),
            16.. => self.crowd(),
            6 => self.one_uid(),
            7 => self.contest(),
            _ => self.innocence(),
        }
    }

    // --- real conflicts ------------------------------------------------------------------

    /// Adds a device at the address of another one; neither gives way.
    fn collision(&mut self) {
        let Some(at) = self.quiet.pop() else { return };
        let label = self.scenario.devices[at].label.clone();
        self.touched.push(label.clone());
        let (from, story) = self.joins(at, &format!("{label}'"));
        self.leaves_perhaps(from, &label, story);
    }

    /// Adds two to five devices at the address of another one; none gives way.
    fn crowd(&mut self) {
        let Some(at) = self.quiet.pop() else { return };
        let label = self.scenario.devices[at].label.clone();
        self.touched.push(label.clone());
        let mut last = (millis(0), String::new());
        for count in 1..=self.rng.usize(2..=5) {
            self.tell(std::mem::take(&mut last.1));
            last = self.joins(at, &format!("{label}{}", "'".repeat(count)));
        }
        self.leaves_perhaps(last.0, &label, last.1);
    }

    /// Adds a device with this label at the address of the one at `at`; neither gives way. Returns
    /// when it joins, and that as text.
    fn joins(&mut self, at: usize, joins: &str) -> (Duration, String) {
        let first = &mut self.scenario.devices[at];
        first.faults.set(Fault::KeepsAddress, true);
        let mut other = first.clone();
        joins.clone_into(&mut other.label);
        self.touched.push(other.label.clone());
        other.skips_address_resolution = self.rng.bool();
        other.power_on = None;
        let mut same = vec!["address"];
        if self.rng.bool() {
            other.name = format!("X{}", &joins[..joins.len() - 1]).into_bytes();
        } else {
            same.push("name");
        }
        if self.rng.bool() {
            other.uid = self.uid();
        } else {
            same.push("UID");
        }
        if other.framing != DeviceFraming::Raw && self.one_in(3) {
            other = other.service("OTHER", "9.9");
        }
        if self.one_in(5) {
            other.mode = Some(Mode::Cfg);
        }
        let from = millis(self.rng.u64(0..BUSY - 8000));
        let story = format!("{from:?}: {joins} joins, same {}", same.join(", "));
        self.scenario.devices.push(other);
        self.at(from, joins, DeviceAction::PowerOn);
        (from, story)
    }

    /// Switches off one of the two, or none.
    fn leaves_perhaps(&mut self, from: Duration, label: &str, story: String) {
        if self.rng.bool() {
            let until =
                from + millis(self.rng.u64(500..BUSY)).min(millis(BUSY).saturating_sub(from));
            let who = if self.rng.bool() { label.to_owned() } else { format!("{label}'") };
            self.tell(format!("{story}; {until:?}: {who} leaves"));
            self.at(until, &who, DeviceAction::PowerOff);
        } else {
            self.tell(story);
        }
    }

    /// Adds a copy of a board, with the same UID, beside the original.
    fn one_uid(&mut self) {
        let Some(mut other) = self.take() else { return };
        let Some(address) = self.free.pop() else { return };
        let label = other.label.clone();
        other.label = format!("{label}'");
        self.touched.push(other.label.clone());
        other = other.fixed(address);
        other.power_on = None;
        let from = millis(self.rng.u64(0..BUSY - 8000));
        self.scenario.devices.push(other);
        self.at(from, &format!("{label}'"), DeviceAction::PowerOn);
        let story = format!("{from:?}: {label}' joins at {address}, same UID");
        self.leaves_perhaps(from, &label, story);
    }

    /// Makes two devices claim one address; both follow §3.2.4.
    fn contest(&mut self) {
        let Some(mut other) = self.take() else { return };
        let label = other.label.clone();
        other.label = format!("{label}'");
        self.touched.push(other.label.clone());
        other.name = format!("X{label}").into_bytes();
        other.uid = self.uid();
        if let AddressSetting::Fixed(address) = other.address {
            other.address = AddressSetting::Preferred(address);
        }
        other.skips_address_resolution = true;
        other.power_on = None;
        let from = self.moment();
        self.tell(format!("{from:?}: {label}' bursts in, and they contend"));
        self.scenario.devices.push(other);
        self.at(from, &format!("{label}'"), DeviceAction::PowerOn);
    }

    // --- no conflict, but similar --------------------------------------------------------

    fn innocence(&mut self) {
        let Some(device) = self.take() else { return };
        let label = device.label.clone();
        let at = self.moment();
        match self.rng.u8(..8) {
            0 => {
                self.tell(format!("{at:?}: {label} reboots"));
                self.at(at, &label, DeviceAction::Reboot { services: None });
            }
            1 => {
                let times = self.rng.u64(1..=3);
                let apart = self.rng.u64(200..3000);
                self.tell(format!("{at:?}: {label} reboots fast, {times} times {apart} ms apart"));
                for time in 0..times {
                    self.at(at + millis(time * apart), &label, DeviceAction::WatchdogReset);
                }
            }
            2 => self.swap_boards(device, at),
            3 => self.move_away(&device, at),
            4 => self.swap_addresses(&device, at),
            5 => {
                self.tell(format!("{at:?}: {label} answers twice for a moment"));
                self.at(at, &label, DeviceAction::AddFault(Fault::RespondsTwice));
                self.at(at + millis(600), &label, DeviceAction::RemoveFault(Fault::RespondsTwice));
            }
            6 => {
                let back = at + millis(self.rng.u64(50..5000));
                self.tell(format!("{at:?}: {label} is cut off until {back:?}"));
                self.at(at, &label, DeviceAction::PowerOff);
                self.at(back, &label, DeviceAction::PowerOn);
            }
            _ => {
                self.tell(format!("{at:?}: {label} says another name and UID"));
                let uid = self.uid();
                self.at(at, &label, DeviceAction::Name(format!("Y{label}").into_bytes()));
                self.at(at, &label, DeviceAction::Uid(uid));
            }
        }
    }

    /// Lets the first inspector receive the frames of a device twice.
    fn gateway(&mut self, inspector: &mut Inspector) {
        let Some(device) = self.take() else { return };
        let AddressSetting::Fixed(address) = device.address else { return };
        let from = if self.rng.bool() { millis(0) } else { self.moment() };
        let until = if self.rng.bool() { millis(BUSY + CALM) } else { from + millis(12_000) };
        let delay = Duration::from_micros(self.rng.u64(3000..50_000));
        inspector.lens.gateway = Some(Gateway { address, from, until, delay });
        self.tell(format!("{from:?}: a gateway repeats {} {delay:?} later", device.label));
    }

    /// Makes a device respond twice to each request.
    fn responds_twice(&mut self) {
        let Some(device) = self.take() else { return };
        let at = if self.rng.bool() { millis(0) } else { self.moment() };
        self.tell(format!("{at:?}: {} responds twice from now on", device.label));
        self.at(at, &device.label, DeviceAction::AddFault(Fault::RespondsTwice));
    }

    /// Swaps two boards at one address to and fro, three to eight times.
    fn swaps_to_and_fro(&mut self) {
        let Some(device) = self.take() else { return };
        let label = device.label.clone();
        let mut other = device;
        other.label = format!("{label}*");
        self.touched.push(other.label.clone());
        if self.rng.bool() {
            other.name = format!("Z{label}").into_bytes();
        }
        other.uid = self.uid();
        other.skips_address_resolution = self.rng.bool();
        other.power_on = None;
        let mut labels = [label, other.label.clone()];
        self.scenario.devices.push(other);
        let mut at = self.moment();
        for _ in 0..self.rng.u8(3..=8) {
            self.tell(format!("{at:?}: {} replaces {}", labels[1], labels[0]));
            self.at(at, &labels[0], DeviceAction::PowerOff);
            at += millis(self.rng.u64(50..600));
            self.at(at, &labels[1], DeviceAction::PowerOn);
            at += millis(self.rng.u64(3000..5000));
            labels.swap(0, 1);
            if at > millis(BUSY) {
                break;
            }
        }
    }

    /// Gives one to three devices, to which nothing else happens, a heartbeat period of their own.
    fn other_periods(&mut self) {
        for _ in 0..self.rng.u8(1..=3) {
            let Some(at) = self.quiet.pop() else { return };
            let period = millis(self.rng.u64(3..=50) * 100);
            let device = &mut self.scenario.devices[at];
            device.heartbeat = Some(period);
            device.max_heartbeat_delay = device.max_heartbeat_delay.min(period / 10);
            let label = device.label.clone();
            self.tell(format!("{label} has a heartbeat period of {period:?}"));
        }
    }

    /// Adds nodes of another protocol, which take a tenth to a third of the bus. None of their
    /// identifiers is that of a heartbeat or a DES message, or has the address of a device as its
    /// source: the devices would not work beside it.
    fn foreign_nodes(&mut self) {
        let is_extended = self.rng.bool();
        let devices = &self.scenario.devices;
        let used: Vec<AddressSetting> = devices.iter().map(|device| device.address).collect();
        let is_disturbing = |id: &CanId| match id {
            CanId::Extended(id) => {
                let header = Header::decode(*id);
                let profile = Profile::default();
                [profile.heartbeat_service(), profile.des_service()].contains(&header.service)
                    || used.contains(&AddressSetting::Fixed(header.source))
            }
            CanId::Standard(_) => false,
        };
        let ids = (0..self.rng.usize(1..=40)).map(|_| {
            if is_extended {
                CanId::extended(self.rng.u32(..1 << 29))
            } else {
                CanId::standard(self.rng.u32(..1 << 11))
            }
        });
        let ids: Vec<CanId> = ids.flatten().filter(|id| !is_disturbing(id)).collect();
        if ids.is_empty() {
            return;
        }
        let share = 0.1 + 0.2 * self.rng.f64();
        let interval = 150.0 / (share * f64::from(self.scenario.bitrate));
        let interval = Duration::from_micros((interval * 1e6) as u64);
        self.tell(format!("{} foreign identifiers, extended {is_extended}", ids.len()));
        self.foreign = Some(ForeignNodes { ids, interval });
    }

    fn swap_boards(&mut self, device: DeviceSpec, at: Duration) {
        let label = device.label.clone();
        let mut other = device;
        other.label = format!("{label}*");
        self.touched.push(other.label.clone());
        if self.rng.bool() {
            other.name = format!("Z{label}").into_bytes();
        }
        other.uid = self.uid();
        other.skips_address_resolution = self.rng.bool();
        other.power_on = None;
        let in_between = millis(self.rng.u64(5..4000));
        self.tell(format!("{at:?}: another board for {label}, {in_between:?} later"));
        self.scenario.devices.push(other);
        self.at(at, &label, DeviceAction::PowerOff);
        self.at(at + in_between, &format!("{label}*"), DeviceAction::PowerOn);
    }

    fn move_away(&mut self, device: &DeviceSpec, at: Duration) {
        let Some(address) = self.free.pop() else { return };
        let to = DeviceSpec::new("").fixed(address).address;
        self.tell(format!("{at:?}: {} moves to {address}", device.label));
        self.at(at, &device.label, DeviceAction::Move(to));
    }

    /// Swaps two addresses at once, as a configuration tool does.
    fn swap_addresses(&mut self, device: &DeviceSpec, at: Duration) {
        let Some(other) = self.take() else { return };
        self.tell(format!("{at:?}: {} and {} swap addresses", device.label, other.label));
        let at_once = self.rng.bool();
        if !at_once {
            self.at(at, &device.label, DeviceAction::Move(other.address));
            self.at(at, &other.label, DeviceAction::Move(device.address));
            return;
        }
        for (mut one, address) in [(device.clone(), other.address), (other.clone(), device.address)]
        {
            let label = format!("{}*", one.label);
            self.at(at, &one.label, DeviceAction::PowerOff);
            one.label.clone_from(&label);
            one.address = address;
            one.skips_address_resolution = true;
            one.power_on = None;
            self.touched.push(label.clone());
            self.scenario.devices.push(one);
            self.at(at + millis(2), &label, DeviceAction::PowerOn);
        }
    }
}

/// Returns the approximate number of bits that a device sends per second.
fn load(device: &DeviceSpec) -> f64 {
    let chatter = device.periodic_messages.iter().map(|it| 150.0 / it.period.as_secs_f64());
    150.0 + chatter.sum::<f64>()
}
