//! Profiles that are learnt from the frames of a bus: random profiles and devices, with losses.
//!
//! `SEEDS=10000 cargo test --release --test it learning` runs more seeds, `FIRST=…` others; `SEED=17`
//! runs one and prints its proposals.

use descan::frame::Frame;
use descan::learning::{Certainty, ProfileLearner, ProfileProposal};
use descan::sim::{DeviceAction, DeviceFraming, DeviceSpec, Scenario, Sim};
use descan::time::{Duration, Instant};
use descan::wire::des::Request;
use descan::wire::descriptor::AddressSetting;
use descan::wire::framing::Framing;
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::{Mode, Uid};
use descan::wire::profile::{Profile, ProfileKey, ProfileValue};
use std::collections::{BTreeMap, BTreeSet};

/// Deviation of a right period: clocks of 100 ppm, and what a delay of heartbeats hides in a short
/// time.
const PERIOD_DEVIATION: f64 = 0.02;

/// A random profile, and a bus with devices that use it.
struct World {
    profile: Profile,
    frames: Vec<Frame>,
    /// `isotp`, `raw`.
    framings: BTreeSet<&'static str>,
    uids: UidKind,
}

/// What UIDs of a bus have in common.
#[derive(Clone, Copy)]
enum UidKind {
    /// They are text that differs in its end.
    Text,
    /// Three bytes are the same. Which six bytes they belong to is not known before a mode changes.
    SharedBeginning,
    Random,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut rng = fastrand::Rng::with_seed(seed);
        let profile = random_profile(&mut rng);
        let period = profile.heartbeat.period();
        let mut framings = BTreeSet::new();
        let kinds = [UidKind::Text, UidKind::SharedBeginning, UidKind::Random];
        let uids = kinds[rng.usize(0..3)];
        let scenario = random_scenario(&mut rng, &profile, &mut framings, uids);
        let mut sim = Sim::with_profile(&scenario, rng.u64(..), profile.clone());
        let tool = sim.attach();
        let end = Instant::ZERO + Duration::from_millis(10_500).max(period * 16);
        let asks = rng.bool();
        let is_lossy = rng.bool();
        let loss = if is_lossy { rng.f64() * 0.3 } else { 0.0 };
        let constant = constant_data(&mut rng, &scenario);
        let mut frames = Vec::new();
        let mut next_request = Instant::ZERO + Duration::from_millis(rng.u64(100..3000));
        while sim.now() < end {
            let until = end.min(next_request);
            sim.advance(until);
            while let Some(frame) = sim.poll_frame(tool) {
                if rng.f64() >= loss {
                    frames.push(frame);
                }
            }
            if asks && sim.now() == next_request {
                let rnd7 = rng.u8(0..128);
                for to_non_working in [false, true] {
                    for framing in [Framing::Isotp, Framing::Raw] {
                        let header = Header::broadcast(
                            Address::DEBUG,
                            rnd7,
                            to_non_working,
                            profile.des_service(),
                        );
                        let (data, len) = Profile::request_bytes(Request::Name, framing);
                        sim.transmit(tool, Frame::classic(header.encode(), &data[..len]));
                    }
                }
            }
            if sim.now() >= next_request {
                next_request += Duration::from_millis(rng.u64(1000..5000));
            }
        }
        frames.extend(constant.into_iter().filter(|frame| frame.time <= end && rng.f64() >= loss));
        frames.sort_by_key(|frame| frame.time);
        Self { profile, frames, framings, uids }
    }

    /// Addresses with their heartbeats: data and U bit of each.
    fn heartbeats(&self) -> BTreeMap<Address, Vec<(bool, &[u8])>> {
        let mut all = BTreeMap::<_, Vec<_>>::new();
        for frame in &self.frames {
            let header = Header::decode(frame.platform_id().unwrap_or_default());
            let is_one = header.response
                && header.broadcast
                && header.service == self.profile.heartbeat_service()
                && !frame.is_tx;
            if is_one {
                let beats = all.entry(header.source).or_default();
                beats.push((header.from_non_working, frame.data()));
            }
        }
        all
    }

    /// Why a proposal is wrong; `None` if it is right.
    fn fault_of(&self, proposal: &ProfileProposal) -> Option<String> {
        let is_right = match (proposal.key, &proposal.value) {
            (ProfileKey::PeriodMs, ProfileValue::Number(millis)) => {
                let truth = f64::from(self.profile.heartbeat.period_ms);
                (f64::from(*millis) - truth).abs() <= PERIOD_DEVIATION * truth
            }
            (ProfileKey::Framing, ProfileValue::Text(word)) => self.framings.iter().eq([word]),
            (key, value) => self.profile.value(key) == *value,
        };
        let truth = self.profile.value(proposal.key);
        (!is_right).then(|| format!("{} {}, not {truth}", proposal.key.name(), proposal.value))
    }
}

fn random_profile(rng: &mut fastrand::Rng) -> Profile {
    let mut profile = Profile::default();
    profile.services.heartbeat = rng.u16(0..0x400);
    profile.services.des = (profile.services.heartbeat + rng.u16(1..0x400)) & 0x3FF;
    profile.heartbeat.period_ms = match rng.u8(0..10) {
        0 => rng.u32(10..100),
        1 => rng.u32(100..1000),
        2 => rng.u32(1000..5000),
        3 => 200,
        4 => 500,
        5 => 2000,
        _ => 1000,
    };
    let mut parts = ['u', 'm', 'e', '.'];
    rng.shuffle(&mut parts);
    let heartbeat = &mut profile.heartbeat;
    (heartbeat.uid_offset, heartbeat.mode_offset, heartbeat.error_offset) = (None, None, None);
    let mut at = 0;
    for part in parts {
        let (offset, length, probability) = match part {
            'u' => (&mut heartbeat.uid_offset, 6, 0.9),
            'm' => (&mut heartbeat.mode_offset, 1, 0.9),
            'e' => (&mut heartbeat.error_offset, 1, 0.7),
            // A byte that has no meaning.
            _ => {
                at += u8::from(at == 0 && rng.u8(0..8) == 0);
                continue;
            }
        };
        if rng.f64() < probability && at + length <= 8 {
            *offset = Some(at);
            at += length;
        }
    }
    let mut codes: Vec<u8> = (0..=255).collect();
    if rng.bool() {
        rng.shuffle(&mut codes);
    }
    let modes = &mut profile.modes;
    let all = [
        &mut modes.init,
        &mut modes.arslv,
        &mut modes.cfg,
        &mut modes.boot,
        &mut modes.work,
        &mut modes.ufunc,
        &mut modes.idle,
    ];
    for (code, number) in all.into_iter().zip(codes) {
        *code = number;
    }
    profile
}

fn random_scenario(
    rng: &mut fastrand::Rng,
    profile: &Profile,
    framings: &mut BTreeSet<&'static str>,
    uids: UidKind,
) -> Scenario {
    let mut scenario = Scenario::new([250_000, 500_000, 1_000_000][rng.usize(0..3)]);
    let count = if rng.bool() { 2 } else { rng.usize(2..12) };
    let mut addresses: Vec<u8> = (1..128).collect();
    rng.shuffle(&mut addresses);
    let period = profile.heartbeat.period();
    let free = || -> Vec<u16> {
        (0..0x400)
            .filter(|it| ![profile.services.heartbeat, profile.services.des].contains(it))
            .filter(|it| !(0x010..=0x019).contains(it))
            .collect()
    };
    let mut services = free();
    rng.shuffle(&mut services);
    let framing = match rng.u8(0..3) {
        0 => Some(DeviceFraming::Raw),
        1 => Some(DeviceFraming::Isotp),
        _ => None,
    };
    let prefix: [u8; 5] = std::array::from_fn(|_| rng.u8(..));
    let is_shared = rng.bool();
    for (at, address) in addresses.into_iter().take(count).enumerate() {
        let uid = match uids {
            UidKind::Text => Uid::parse(&format!("BOARD{at:03}"), &profile.uid).unwrap(),
            UidKind::SharedBeginning => {
                let [a, b, c, ..] = prefix;
                Uid([a, b, c, rng.u8(..), rng.u8(..), rng.u8(..)])
            }
            UidKind::Random => Uid(std::array::from_fn(|_| rng.u8(..))),
        };
        let own_framing = framing
            .unwrap_or_else(|| if rng.bool() { DeviceFraming::Raw } else { DeviceFraming::Isotp });
        framings.insert(match own_framing {
            DeviceFraming::Raw => "raw",
            _ => "isotp",
        });
        let mut device = DeviceSpec::new(&format!("DEV{at}"))
            .label(&format!("D{at}"))
            .uid(uid)
            .address(AddressSetting::Preferred(Address::from_bits(address)))
            .framing(own_framing);
        device.tolerance_ppm = rng.i32(-100..=100);
        if rng.u8(0..3) == 0 {
            device.max_heartbeat_delay = period.mul_f64(rng.f64() * 0.04);
        }
        if rng.u8(0..3) > 0 {
            device = device.skips_address_resolution();
            if rng.u8(0..5) == 0 {
                device.mode = Some(Mode::Cfg);
            }
        }
        for _ in 0..rng.usize(0..3) {
            let service = services[if is_shared { 0 } else { rng.usize(0..4) }];
            let period = Duration::from_millis(rng.u64(20..1500));
            device = device.periodic_message(service, period, rng.u8(1..=8));
        }
        scenario = scenario.with(device);
        let label = format!("D{at}");
        match rng.u8(0..8) {
            0 => {
                let time = period.mul_f64(3.0 + rng.f64() * 6.0);
                scenario = scenario.at(time, &label, DeviceAction::Mode(Mode::Ufunc));
                scenario = scenario.at(time + period * 3, &label, DeviceAction::Mode(Mode::Work));
            }
            1 => {
                let time = period.mul_f64(3.0 + rng.f64() * 6.0);
                scenario = scenario.at(time, &label, DeviceAction::Mode(Mode::Cfg));
            }
            2 => {
                let time = period.mul_f64(4.0 + rng.f64() * 4.0);
                scenario = scenario.at(time, &label, DeviceAction::Reboot { services: None });
            }
            _ => {}
        }
    }
    scenario
}

/// Frames with constant data and a constant period, of all devices while they work: like those of
/// heartbeats, but without a UID.
fn constant_data(rng: &mut fastrand::Rng, scenario: &Scenario) -> Vec<Frame> {
    let mut frames = Vec::new();
    if rng.u8(0..4) > 0 {
        return frames;
    }
    let service = Service::from_bits(0x3F0 + rng.u16(0..8));
    let period = Duration::from_millis(rng.u64(50..2000));
    let data: [u8; 5] = std::array::from_fn(|_| rng.u8(..));
    let length = rng.usize(1..=5);
    for device in &scenario.devices {
        let AddressSetting::Preferred(address) = device.address else { continue };
        if !device.skips_address_resolution || device.mode.is_some() {
            continue;
        }
        let mut time = Instant::ZERO + period.mul_f64(rng.f64());
        while time < Instant::ZERO + Duration::from_secs(30) {
            let header = Header::unsolicited(address, rng.u8(0..128), false, service);
            frames.push(Frame::classic(header.encode(), &data[..length]).with_time(time));
            time += period;
        }
    }
    frames
}

/// Worlds in which a value had to be known, and in which it was.
#[derive(Default)]
struct Share {
    known: u32,
    all: u32,
}

impl Share {
    fn count(&mut self, has_to_be: bool, proposals: &[ProfileProposal], key: ProfileKey) {
        if has_to_be {
            self.all += 1;
            self.known += u32::from(proposals.iter().any(|it| it.key == key));
        }
    }

    fn percent(&self) -> f64 {
        f64::from(self.known) * 100.0 / f64::from(self.all.max(1))
    }
}

#[test]
fn random_profiles_are_learnt_and_never_wrong() {
    let number = |name: &str| std::env::var(name).ok().and_then(|it| it.parse::<u64>().ok());
    let first = number("FIRST").unwrap_or(0);
    let seeds = match number("SEED") {
        Some(seed) => seed..seed + 1,
        None => first..first + number("SEEDS").unwrap_or(300),
    };
    let mut shares = BTreeMap::<&str, Share>::new();
    let mut faults = Vec::new();
    for seed in seeds {
        let world = World::new(seed);
        let mut learner = ProfileLearner::default();
        let mut checked = Instant::ZERO;
        for frame in &world.frames {
            learner.handle_frame(frame);
            if frame.time.since(checked) >= Duration::from_millis(700) {
                checked = frame.time;
                let proposals = learner.proposals();
                let sure = proposals.iter().filter(|it| it.certainty > Certainty::Guess);
                for fault in sure.filter_map(|it| world.fault_of(it)) {
                    faults.push(format!("seed {seed} at {:?}: {fault}", frame.time));
                }
            }
        }
        let mut proposals = learner.proposals();
        let mut learnt = Profile::default();
        for proposal in &proposals {
            assert!(learnt.learn(proposal.key, &proposal.value), "seed {seed}: {proposal:?}");
        }
        let text = learnt.to_file(|_| None);
        let read = Profile::parse(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
        for proposal in &proposals {
            assert_eq!(read.value(proposal.key), proposal.value, "seed {seed}: {text}");
        }
        if number("SEED").is_some() {
            println!("{:#?} {:?}", world.profile.heartbeat, world.profile.services);
            for proposal in &proposals {
                println!("{} {} {}", proposal.key.name(), proposal.value, proposal.evidence);
            }
        }
        proposals.retain(|it| it.certainty > Certainty::Guess);
        faults.extend(
            proposals.iter().filter_map(|it| world.fault_of(it)).map(|it| format!("{seed}: {it}")),
        );
        let heartbeats = world.heartbeats();
        let heard = heartbeats.values().filter(|beats| beats.len() >= 10);
        let is_heard = heard.count() >= 2 && heartbeats.values().all(|beats| beats.len() >= 10);
        let mut share = |name, has_to_be, key| {
            shares.entry(name).or_default().count(has_to_be, &proposals, key);
        };
        share("heartbeat", is_heard, ProfileKey::Heartbeat);
        share("period", is_heard, ProfileKey::PeriodMs);
        let layout = &world.profile.heartbeat;
        let uids: BTreeSet<&[u8]> = heartbeats
            .values()
            .filter_map(|beats| {
                let at = usize::from(layout.uid_offset?);
                beats.first()?.1.get(at..at + 6)
            })
            .collect();
        let name = match world.uids {
            UidKind::SharedBeginning => "uid with a common beginning",
            _ => "uid",
        };
        share(name, is_heard && uids.len() >= 3, ProfileKey::UidOffset);
        let changes = |beats: &Vec<(bool, &[u8])>| {
            beats.iter().any(|(u, _)| *u) && beats.iter().any(|(u, _)| !*u)
        };
        let has_changed = layout.mode_offset.is_some() && heartbeats.values().any(changes);
        share("mode", is_heard && has_changed, ProfileKey::ModeOffset);
    }
    for (name, share) in &shares {
        println!("{name}: {} of {}, {:.1} %", share.known, share.all, share.percent());
    }
    assert!(
        faults.is_empty(),
        "{} wrong:\n{}",
        faults.len(),
        faults[..faults.len().min(20)].join("\n")
    );
    for (name, least) in [("heartbeat", 99.0), ("period", 99.0), ("uid", 95.0), ("mode", 90.0)] {
        let share = &shares[name];
        assert!(share.all < 20 || share.percent() >= least, "{name}: {:.1} %", share.percent());
    }
}

// ---- buses that show less than they seem to ------------------------------------------------

/// Frames of a bus whose heartbeats have number 0x001, as they are built.
#[derive(Default)]
struct Frames(Vec<Frame>);

/// UID that ends with a node's address, in bytes 0 to 5; mode and error code.
fn heartbeat_of(address: u8) -> [u8; 8] {
    [0x8A, 0xFA, 0x6C, address, 0x24, address, 4, 0]
}

impl Frames {
    /// Adds a broadcast of `address` every `period` seconds for a minute, from `start` on; `data` has the
    /// number of the frame.
    fn add(
        &mut self,
        (address, service): (u8, u16),
        (start, period): (f64, f64),
        data: impl Fn(u32) -> Vec<u8>,
    ) -> &mut Self {
        let mut count = 0;
        while start + f64::from(count) * period < 60.0 {
            let time = Duration::from_secs_f64(start + f64::from(count) * period);
            let rnd7 = (count * 37 + u32::from(address)) as u8 % 128;
            let header = Header::unsolicited(
                Address::from_bits(address),
                rnd7,
                false,
                Service::from_bits(service),
            );
            let frame = Frame::classic(header.encode(), &data(count));
            self.0.push(frame.with_time(Instant::ZERO + time));
            count += 1;
        }
        self
    }

    /// Adds heartbeats of nodes 10, 11, 12, … every second.
    fn with_heartbeats(nodes: u8) -> Self {
        let mut frames = Self::default();
        for node in 0..nodes {
            let address = 10 + node;
            let start = f64::from(node) * 0.11;
            frames.add((address, 0x001), (start, 1.0), |_| heartbeat_of(address).to_vec());
        }
        frames
    }

    /// What is learnt of a key, guesses left out.
    fn learnt(&mut self, key: ProfileKey) -> Option<String> {
        self.0.sort_by_key(|frame| frame.time);
        let mut learner = ProfileLearner::default();
        self.0.iter().for_each(|frame| learner.handle_frame(frame));
        let mut proposals = learner.proposals().into_iter();
        let found = proposals.find(|it| it.key == key && it.certainty > Certainty::Guess);
        found.map(|proposal| proposal.value.to_string())
    }
}

#[test]
fn sensor_of_all_nodes_beside_blank_heartbeats_is_unknown() {
    for (heartbeat, period) in
        [(vec![0; 8], 1.0), (vec![0; 8], 10.0), (vec![4, 0, 0, 0, 0, 0, 0, 0], 1.0)]
    {
        let mut frames = Frames::default();
        for address in 10..15 {
            frames.add((address, 0x001), (0.1, period), |_| heartbeat.clone());
            frames.add((address, 0x055), (0.2, 1.0), |_| vec![address, 7, 7, 7, 7, 7, 7, address]);
        }
        assert_eq!(frames.learnt(ProfileKey::Heartbeat), None, "{heartbeat:?} {period}");
    }
}

#[test]
fn sensor_beside_heartbeats_with_a_counter_is_unknown() {
    let mut frames = Frames::default();
    for address in 10..15 {
        let heartbeat = |count: u32| {
            let mut data = heartbeat_of(address).to_vec();
            data[7] = count as u8;
            data
        };
        frames.add((address, 0x001), (0.1, 1.0), heartbeat);
        frames.add((address, 0x055), (0.2, 5.0), |_| vec![address; 8]);
    }
    assert_eq!(frames.learnt(ProfileKey::Heartbeat), None);
}

#[test]
fn code_of_a_debug_message_is_not_a_service() {
    let mut frames = Frames::with_heartbeats(5);
    for address in 10..15 {
        frames.add((address, 0x055), (0.2, 1.0), |_| vec![address; 8]);
    }
    let before = frames.learnt(ProfileKey::Heartbeat);
    let debug = 0x1F00_0000 | 10 << 17 | 127 << 10 | 0x055;
    frames.0.push(Frame::classic(debug, &[1]).with_time(Instant::ZERO + Duration::from_secs(5)));
    assert_eq!(frames.learnt(ProfileKey::Heartbeat), before);
    assert_ne!(before.as_deref(), Some("0x055"));
}

#[test]
fn copies_of_a_bridge_do_not_shorten_the_period() {
    let mut frames = Frames::with_heartbeats(5);
    let late = Duration::from_millis(200);
    let copies: Vec<Frame> =
        frames.0.iter().map(|frame| frame.with_time(frame.time + late)).collect();
    frames.0.extend(copies);
    assert_eq!(frames.learnt(ProfileKey::PeriodMs).as_deref(), Some("1000"));
}

#[test]
fn two_boards_at_an_address_do_not_shorten_the_period() {
    for phase in [0.125, 0.25, 0.333, 0.5] {
        let mut frames = Frames::with_heartbeats(2);
        frames.add((10, 0x001), (phase, 1.0), |_| heartbeat_of(99).to_vec());
        let period = frames.learnt(ProfileKey::PeriodMs);
        assert!(period.as_deref().is_none_or(|it| it == "1000"), "{phase}: {period:?}");
    }
}

#[test]
fn heartbeats_that_come_at_random_have_no_period() {
    for seed in 0..40 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut frames = Frames::default();
        for address in [10, 11] {
            let mut time = 0.1;
            while time < 20.0 {
                frames.add((address, 0x001), (time, 100.0), |_| heartbeat_of(address).to_vec());
                time += 2.0 + (rng.f64() - 0.5) * 0.6;
            }
        }
        let period = frames.learnt(ProfileKey::PeriodMs);
        let is_near = |it: &str| (it.parse::<f64>().unwrap() - 2000.0).abs() <= 40.0;
        assert!(period.as_deref().is_none_or(is_near), "seed {seed}: {period:?}");
    }
}

#[test]
fn response_that_resembles_a_name_does_not_show_des() {
    let changing: Vec<Vec<u8>> = (0..20).map(|it| vec![1, 0x41 + it, 0x42, 0x43, 0]).collect();
    for (responses, what) in [
        (vec![vec![1, 0x42, 0]], "a status and its value"),
        (changing, "a value that changes"),
        (vec![b"\x01ERR\0".to_vec()], "one text of all nodes"),
    ] {
        let mut frames = Frames::with_heartbeats(4);
        for count in 0..20 {
            for address in 10..14 {
                let at = |millis: u64| Instant::ZERO + Duration::from_millis(count * 1000 + millis);
                let request = Header::request(
                    Address::DEBUG,
                    Address::from_bits(address),
                    false,
                    Service::from_bits(0x123),
                );
                let answer = request.response(Address::from_bits(address), false);
                let data = &responses[count as usize % responses.len()];
                let request = Frame::classic(request.encode(), b"DES\x01");
                frames.0.push(request.with_time(at(500)));
                frames.0.push(Frame::classic(answer.encode(), data).with_time(at(510)));
            }
        }
        assert_eq!(frames.learnt(ProfileKey::Des), None, "{what}");
    }
}
