//! The planner: what is known of a bus and the wanted addresses in, ordered steps out.
//!
//! A step goes only to an address that no other device uses or has stored at that time. Devices whose
//! address is free go first, then those whose address became free. Those that remain wait for each
//! other: one of each cycle makes room, at the highest free address. Pure.

use super::known_bus::{AddressSet, DeviceIdentity, KnownDevice, PlanBus};
use super::reason::{LeftOutReason, StepReason};
use crate::text::counted;
use crate::wire::descriptor::AddressSetting;
use crate::wire::id::Address;

/// An address that a device is to have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AddressGoal {
    /// Place of the device in [`PlanBus::devices`]; `None` if it was not found.
    pub device: Option<usize>,
    /// Who it is.
    pub identity: DeviceIdentity,
    /// The address.
    pub to: Address,
    /// The setting that is written; `None`: that of [`PlanOptions::setting`].
    pub setting: Option<AddressSetting>,
    /// Why the device is not to be written; `None` if nothing is known that forbids it.
    pub doubt: Option<LeftOutReason>,
    /// The user leaves it out.
    pub is_left_out: bool,
}

/// When a write acts, and who restarts the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepEffect {
    /// At once.
    AtOnce,
    /// At a restart, which descan commands after each write.
    Restart,
    /// At a restart that descan does not command: all settings are stored first.
    Deferred,
}

impl StepEffect {
    /// The word in files and JSON.
    pub const fn word(self) -> &'static str {
        match self {
            Self::AtOnce => "now",
            Self::Restart => "restart",
            Self::Deferred => "later",
        }
    }
}

/// How a plan is made.
#[derive(Clone, Copy, Debug)]
pub struct PlanOptions {
    /// When a write acts.
    pub effect: StepEffect,
    /// Settings are fixed addresses, else preferred ones.
    pub is_fixed: bool,
    /// Addresses that no device may pass through.
    pub reserved: AddressSet,
}

impl PlanOptions {
    /// Returns the setting of an address.
    pub const fn setting(&self, address: Address) -> AddressSetting {
        if self.is_fixed {
            AddressSetting::Fixed(address)
        } else {
            AddressSetting::Preferred(address)
        }
    }
}

/// A step: one device gets one address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlanStep {
    /// Place of the goal that it leads to.
    pub goal: usize,
    /// The device.
    pub device: DeviceIdentity,
    /// Where it is before the step.
    pub from: Address,
    /// Where it is afterwards.
    pub to: Address,
    /// What is written; `None` if it is stored already.
    pub setting: Option<AddressSetting>,
    /// Why it can be done.
    pub reason: StepReason,
}

impl PlanStep {
    /// Returns true if a later step gives the device its own address.
    pub const fn is_detour(&self) -> bool {
        matches!(self.reason, StepReason::Detour { .. })
    }

    /// Why it can be done, in words.
    pub fn why(&self) -> String {
        if self.device.own_uid().is_none() && matches!(self.reason, StepReason::Free(_)) {
            return "no UID: by its address".to_owned();
        }
        self.reason.to_string()
    }
}

/// A device without a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// Place of its goal.
    pub goal: usize,
    /// The device.
    pub device: DeviceIdentity,
    /// Where it is; `None` if it was not found.
    pub at: Option<Address>,
    /// The address that it is to have.
    pub to: Address,
    /// Why it has no step.
    pub reason: LeftOutReason,
}

/// Steps in their order, and the devices without one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AddressPlan {
    /// The steps.
    pub steps: Vec<PlanStep>,
    /// The devices without a step, in the order of the goals.
    pub left_out: Vec<LeftOut>,
}

impl AddressPlan {
    /// Makes a plan. The order of the goals is that of the steps, as far as addresses allow.
    pub fn new(bus: &PlanBus, goals: &[AddressGoal], options: &PlanOptions) -> Self {
        let mut planner = Planner::new(bus, goals, options);
        planner.leave_out_what_cannot_move();
        planner.leave_out_what_is_held();
        planner.order();
        planner.finish()
    }

    /// Number of devices that get another setting.
    pub fn devices(&self) -> usize {
        self.steps.iter().filter(|step| !step.is_detour()).count()
    }

    /// Number of requests that are sent.
    pub fn requests(&self, effect: StepEffect) -> usize {
        let writes = self.steps.iter().filter(|step| step.setting.is_some()).count();
        let restarts = if effect == StepEffect::Restart { self.steps.len() } else { 0 };
        writes + restarts
    }

    /// How its steps differ from those of an earlier plan; `None` if they do not.
    pub fn change_since(&self, earlier: &Self) -> Option<String> {
        // The places of the goals depend on devices without a step.
        let is_same = |(a, b): (&PlanStep, &PlanStep)| {
            let other = PlanStep { goal: a.goal, ..b.clone() };
            *a == other
        };
        let (now, before) = (self.steps.len(), earlier.steps.len());
        if now != before {
            return Some(format!("{}, before {before}", counted(now as u64, "step")));
        }
        let at = self.steps.iter().zip(&earlier.steps).position(|both| !is_same(both))?;
        Some(format!("step {} is another one", at + 1))
    }

    /// Returns true if a device has no step although it is not at its address.
    pub fn leaves_out(&self) -> bool {
        self.left_out.iter().any(|it| !it.reason.is_done())
    }
}

/// A device on its way.
struct Mover {
    /// Place of its goal, and of the device.
    goal: usize,
    device: usize,
    /// Where it is, and what it uses or has stored, after the steps so far.
    at: Address,
    taken: AddressSet,
    /// What it is known to have stored.
    setting: Option<AddressSetting>,
}

struct Planner<'a> {
    bus: &'a PlanBus,
    goals: &'a [AddressGoal],
    options: &'a PlanOptions,
    movers: Vec<Mover>,
    /// By goal.
    left_out: Vec<Option<LeftOutReason>>,
    steps: Vec<PlanStep>,
    /// By address: the step after which its device is no longer there.
    freed_by: [Option<usize>; Address::COUNT],
}

impl<'a> Planner<'a> {
    fn new(bus: &'a PlanBus, goals: &'a [AddressGoal], options: &'a PlanOptions) -> Self {
        Self {
            bus,
            goals,
            options,
            movers: Vec::new(),
            left_out: vec![None; goals.len()],
            steps: Vec::new(),
            freed_by: [None; Address::COUNT],
        }
    }

    fn leave_out_what_cannot_move(&mut self) {
        for at in 0..self.goals.len() {
            match self.obstacle(at) {
                Ok(mover) => self.movers.push(mover),
                Err(reason) => self.left_out[at] = Some(reason),
            }
        }
    }

    /// Returns the device of a goal as one that moves.
    fn obstacle(&self, at: usize) -> Result<Mover, LeftOutReason> {
        let goal = &self.goals[at];
        let missing = || goal.doubt.clone().unwrap_or(LeftOutReason::NotPresent);
        let place = goal.device.ok_or_else(missing)?;
        let device = &self.bus.devices[place];
        if let Some(obstacle) = device.obstacle() {
            return Err(obstacle);
        }
        if let Some(other) = self.same_uid(place) {
            return Err(LeftOutReason::SameUid(other));
        }
        if let Some(doubt) = &goal.doubt {
            return Err(doubt.clone());
        }
        let setting = goal.setting.unwrap_or(self.options.setting(goal.to));
        if device.setting.is_none_or(|stored| stored == setting) {
            if device.address == goal.to && !device.possible.has_other(goal.to) {
                return Err(LeftOutReason::AlreadyThere);
            }
            if device.setting.is_some() && self.options.effect == StepEffect::Deferred {
                return Err(LeftOutReason::Stored);
            }
        }
        if !device.identity.is_known() {
            return Err(LeftOutReason::NoIdentity);
        }
        if self.bus.own == Some(goal.to) {
            return Err(LeftOutReason::OwnAddress);
        }
        let mut earlier = self.goals[..at].iter().filter(|it| it.device.is_some());
        if earlier.clone().any(|it| it.device == goal.device) {
            return Err(LeftOutReason::ListedTwice);
        }
        if let Some(earlier) = earlier.find(|it| it.to == goal.to) {
            return Err(LeftOutReason::Wanted(earlier.identity.label()));
        }
        if goal.is_left_out {
            return Err(LeftOutReason::ByUser);
        }
        Ok(Mover {
            goal: at,
            device: place,
            at: device.address,
            taken: self.taken(device, true),
            setting: device.setting,
        })
    }

    /// Returns the address of another present device with the UID of this one.
    fn same_uid(&self, place: usize) -> Option<Address> {
        let device = &self.bus.devices[place];
        let uid = device.identity.own_uid()?;
        let mut others = self.bus.devices.iter().enumerate();
        let other = others.find(|(at, other)| {
            *at != place && other.is_present && other.identity.uid == Some(uid)
        });
        other.map(|(_, other)| other.address).or(device.same_uid_at)
    }

    /// Returns the addresses that a device uses or has stored. `is_leaving`: it leaves its address at
    /// its next restart, or before.
    fn taken(&self, device: &KnownDevice, is_leaving: bool) -> AddressSet {
        let stored: AddressSet = device.stored().into_iter().collect();
        let mut taken = stored.with(device.possible);
        // Of settings that act later all are stored before the first acts: what counts is where the
        // devices are after they all restart.
        let acts_later = is_leaving && self.options.effect == StepEffect::Deferred;
        let stays = if device.is_present {
            !(acts_later && device.setting.is_some())
        } else {
            // It may come back to where it was heard last.
            !self.is_heard_elsewhere(device)
        };
        if stays {
            taken.add(device.address);
        }
        taken
    }

    /// Returns true if a device that left is known by its UID to be at another address.
    fn is_heard_elsewhere(&self, device: &KnownDevice) -> bool {
        let uid = device.identity.own_uid();
        uid.is_some() && self.bus.devices.iter().any(|it| it.is_present && it.identity.uid == uid)
    }

    /// Returns the device at an address, or with it stored, that does not move.
    fn staying_holder(&self, address: Address, except: usize) -> Option<&KnownDevice> {
        let mut devices = self.bus.devices.iter().enumerate();
        let mover = &self.bus.devices[except];
        let holder = devices.find(|(place, device)| {
            *place != except
                && !mover.is_trace(device)
                && !self.movers.iter().any(|mover| mover.device == *place)
                && self.taken(device, self.is_stored(*place)).has(address)
        });
        holder.map(|(_, device)| device)
    }

    /// Returns true if a device has its setting stored, and leaves its address at its next restart.
    fn is_stored(&self, place: usize) -> bool {
        let goal = self.goals.iter().position(|goal| goal.device == Some(place));
        goal.is_some_and(|at| self.left_out[at] == Some(LeftOutReason::Stored))
    }

    /// Leaves out those whose address another device keeps, then those who want the addresses of these.
    fn leave_out_what_is_held(&mut self) {
        loop {
            let held = self.movers.iter().enumerate().find_map(|(at, mover)| {
                let to = self.goals[mover.goal].to;
                let holder = self.staying_holder(to, mover.device)?;
                let absent = if holder.is_present { "" } else { " (absent)" };
                let holder = format!("{}{absent}", holder.identity.label());
                Some((at, LeftOutReason::Held(to, holder)))
            });
            let Some((at, reason)) = held else { return };
            let mover = self.movers.remove(at);
            self.left_out[mover.goal] = Some(reason);
        }
    }

    fn order(&mut self) {
        while !self.movers.is_empty() {
            if let Some(at) = (0..self.movers.len()).find(|at| self.blocker(*at).is_none()) {
                self.go(at);
                continue;
            }
            let cycle = self.cycle();
            let Some(through) = self.free_address() else {
                for at in cycle {
                    self.left_out[self.movers[at].goal] = Some(LeftOutReason::NoFreeAddress);
                }
                let left_out = &self.left_out;
                self.movers.retain(|mover| left_out[mover.goal].is_none());
                self.leave_out_what_is_held();
                continue;
            };
            self.detour(&cycle, through);
        }
    }

    /// Returns the mover that is at the address of this one, or has it stored.
    fn blocker(&self, at: usize) -> Option<usize> {
        let to = self.goals[self.movers[at].goal].to;
        let mut others = self.movers.iter().enumerate();
        others.find(|(place, other)| *place != at && other.taken.has(to)).map(|(place, _)| place)
    }

    /// Returns movers that wait for each other, each for the next one, the last for the first. To be
    /// called when each waits for another one.
    fn cycle(&self) -> Vec<usize> {
        let mut way = Vec::new();
        let mut at = 0;
        while !way.contains(&at) {
            way.push(at);
            at = self.blocker(at).unwrap_or(at);
        }
        let start = way.iter().position(|it| *it == at).unwrap_or(0);
        // The first one in the order of the goals makes room.
        let mut cycle = way.split_off(start);
        let first = (0..cycle.len()).min_by_key(|place| cycle[*place]).unwrap_or(0);
        cycle.rotate_left(first);
        cycle
    }

    /// Returns the highest address that no device uses, has stored or is to have; where settings act
    /// later, as a last resort one that a device leaves when all restart.
    fn free_address(&self) -> Option<Address> {
        let mut used = self.options.reserved;
        // A device that left may come back to its address. One whose setting acts later leaves its
        // address when all restart.
        let mut avoided = AddressSet::default();
        for (place, device) in self.bus.devices.iter().enumerate() {
            let mover = self.movers.iter().find(|mover| mover.device == place);
            used = used.with(match mover {
                Some(mover) => mover.taken,
                None => self.taken_now(place, device),
            });
            if !device.is_present || self.options.effect == StepEffect::Deferred {
                avoided.add(device.address);
            }
        }
        self.goals.iter().for_each(|goal| used.add(goal.to));
        self.bus.own.into_iter().for_each(|own| used.add(own));
        let free = |address: &Address| !used.has(*address);
        let unused = Address::nodes().rev().filter(free).find(|address| !avoided.has(*address));
        unused.or_else(|| Address::nodes().rev().find(free))
    }

    /// Returns what a device that does not move any more takes, after the steps so far.
    fn taken_now(&self, place: usize, device: &KnownDevice) -> AddressSet {
        let is_it = |step: &&PlanStep| self.goals[step.goal].device == Some(place);
        match self.steps.iter().rfind(is_it) {
            None => self.taken(device, false),
            Some(step) => std::iter::once(step.to).collect(),
        }
    }

    /// A mover goes to its own address.
    fn go(&mut self, at: usize) {
        let mover = self.movers.remove(at);
        let to = self.goals[mover.goal].to;
        let wanted = self.goals[mover.goal].setting.unwrap_or(self.options.setting(to));
        let is_stored = mover.setting == Some(wanted) && self.options.effect == StepEffect::Restart;
        let reason = match (self.freed_by[to.index()], mover.setting) {
            _ if is_stored => StepReason::Restart,
            (_, Some(setting)) if mover.at == to => StepReason::Setting(setting),
            (_, None) if mover.at == to => StepReason::Unclear,
            (Some(step), _) => StepReason::After(step),
            (None, _) => StepReason::Free(to),
        };
        self.push_step(&mover, to, (!is_stored).then_some(wanted), reason);
    }

    /// The first of a cycle makes room.
    fn detour(&mut self, cycle: &[usize], through: Address) {
        let holder = cycle.get(1).copied().unwrap_or(cycle[0]);
        let holder = self.goals[self.movers[holder].goal].identity.label();
        let mut mover = self.movers.remove(cycle[0]);
        let reason = StepReason::Detour { through, holder, devices: cycle.len() };
        let setting = self.options.setting(through);
        self.push_step(&mover, through, Some(setting), reason);
        mover.setting = Some(setting);
        mover.taken = std::iter::once(through).collect();
        if self.options.effect != StepEffect::Deferred {
            mover.at = through;
        }
        self.movers.insert(cycle[0], mover);
    }

    fn push_step(
        &mut self,
        mover: &Mover,
        to: Address,
        setting: Option<AddressSetting>,
        reason: StepReason,
    ) {
        let step = self.steps.len();
        for address in Address::all().filter(|address| mover.taken.has(*address)) {
            self.freed_by[address.index()] = Some(step);
        }
        let device = self.goals[mover.goal].identity.clone();
        let (goal, from) = (mover.goal, mover.at);
        self.steps.push(PlanStep { goal, device, from, to, setting, reason });
    }

    fn finish(self) -> AddressPlan {
        let goals = self.goals.iter().enumerate();
        let left_out = goals.zip(self.left_out).filter_map(|((at, goal), reason)| {
            let device = goal.device.map(|place| &self.bus.devices[place]);
            let address = device.filter(|device| device.is_present).map(|device| device.address);
            let (device, to) = (goal.identity.clone(), goal.to);
            Some(LeftOut { goal: at, device, at: address, to, reason: reason? })
        });
        AddressPlan { left_out: left_out.collect(), steps: self.steps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::Name;
    use crate::time::Instant;
    use crate::wire::node::Uid;

    fn address(number: u8) -> Address {
        Address::new(number).unwrap()
    }

    /// A device at an address, which it has stored.
    fn device(name: &str, number: u8) -> KnownDevice {
        let mut uid = [0; 6];
        name.bytes().take(6).enumerate().for_each(|(at, byte)| uid[at] = byte);
        KnownDevice {
            identity: DeviceIdentity { uid: Some(Uid(uid)), name: Some(Name::from(name)) },
            address: address(number),
            setting: Some(AddressSetting::Fixed(address(number))),
            possible: AddressSet::default(),
            is_present: true,
            is_shared: false,
            other_heard: None,
            same_uid_at: None,
            is_debug: false,
            first_heard: Instant::ZERO,
            last_heard: Instant::ZERO,
        }
    }

    /// Devices with their addresses and those that they are to have; 0: none.
    fn bus(devices: &[(&str, u8, u8)]) -> (PlanBus, Vec<AddressGoal>) {
        let known: Vec<KnownDevice> = devices.iter().map(|it| device(it.0, it.1)).collect();
        let wanted = devices.iter().enumerate().filter(|(_, it)| it.2 > 0);
        let goals = wanted.map(|(at, it)| AddressGoal {
            device: Some(at),
            identity: known[at].identity.clone(),
            to: address(it.2),
            setting: None,
            doubt: None,
            is_left_out: false,
        });
        let goals = goals.collect();
        (PlanBus { devices: known, own: Some(Address::DEBUG), ..PlanBus::default() }, goals)
    }

    fn options(effect: StepEffect) -> PlanOptions {
        PlanOptions { effect, is_fixed: true, reserved: AddressSet::default() }
    }

    fn lines(plan: &AddressPlan) -> Vec<String> {
        let steps = plan
            .steps
            .iter()
            .map(|it| format!("{} {} → {}: {}", it.device.label(), it.from, it.to, it.why()));
        let left = plan
            .left_out
            .iter()
            .map(|it| format!("{} – {}: {}", it.device.label(), it.to, it.reason));
        steps.chain(left).collect()
    }

    fn plan(devices: &[(&str, u8, u8)], effect: StepEffect) -> Vec<String> {
        let (bus, goals) = bus(devices);
        lines(&AddressPlan::new(&bus, &goals, &options(effect)))
    }

    /// Checks that no step goes to an address that is used or stored at that time.
    fn check(bus: &PlanBus, plan: &AddressPlan, goals: &[AddressGoal], effect: StepEffect) {
        let mut live: Vec<Option<Address>> =
            bus.devices.iter().map(|it| it.is_present.then_some(it.address)).collect();
        let mut stored: Vec<Option<Address>> =
            bus.devices.iter().map(KnownDevice::stored).collect();
        for step in &plan.steps {
            let at = goals[step.goal].device.unwrap();
            let others = |all: &[Option<Address>]| {
                all.iter().enumerate().any(|(it, used)| it != at && *used == Some(step.to))
            };
            assert!(!others(&stored), "{step:?}");
            assert_eq!(live[at], Some(step.from));
            stored[at] = Some(step.to);
            if effect != StepEffect::Deferred {
                assert!(!others(&live), "{step:?}");
                live[at] = Some(step.to);
            }
        }
        for (at, goal) in goals.iter().enumerate() {
            if !plan.left_out.iter().any(|it| it.goal == at) {
                assert_eq!(stored[goal.device.unwrap()], Some(goal.to));
            }
        }
    }

    #[test]
    fn chain_goes_from_its_free_end() {
        assert_eq!(
            plan(
                &[("A", 12, 13), ("B", 13, 15), ("C", 20, 21), ("D", 50, 50), ("E", 60, 0)],
                StepEffect::AtOnce
            ),
            [
                "B 13 → 15: 15 is free",
                "A 12 → 13: after step 1",
                "C 20 → 21: 21 is free",
                "D – 50: already there"
            ]
        );
    }

    #[test]
    fn cycles_go_through_one_free_address_one_after_the_other() {
        let devices =
            [("A", 12, 13), ("B", 13, 12), ("C", 1, 2), ("D", 2, 3), ("E", 3, 1), ("F", 127, 126)];
        for effect in [StepEffect::AtOnce, StepEffect::Restart] {
            assert_eq!(
                plan(&devices, effect),
                [
                    "F 127 → 126: 126 is free",
                    "A 12 → 127: through free 127: swaps with B",
                    "B 13 → 12: after step 2",
                    "A 127 → 13: after step 3",
                    "C 1 → 127: through free 127: cycle of 3",
                    "E 3 → 1: after step 5",
                    "D 2 → 3: after step 6",
                    "C 127 → 2: after step 7"
                ]
            );
        }
        // All are stored before one restarts: no live address becomes free, and none is gone through.
        assert_eq!(
            plan(&devices, StepEffect::Deferred)[..4],
            [
                "F 127 → 126: 126 is free",
                "A 12 → 125: through free 125: swaps with B",
                "B 13 → 12: after step 2",
                "A 12 → 13: after step 3",
            ]
        );
    }

    #[test]
    fn cycle_without_a_free_address_is_refused_and_others_stay() {
        let names: Vec<String> = (1..128).map(|at| format!("N{at:03}")).collect();
        let all = (1..128u8).map(|at| {
            let to = match at {
                1..=3 => at % 3 + 1,
                10 => 11,
                _ => at,
            };
            (names[usize::from(at) - 1].as_str(), at, to)
        });
        let mut devices: Vec<(&str, u8, u8)> = all.collect();
        let told = plan(&devices, StepEffect::AtOnce);
        let refused: Vec<&String> = told.iter().filter(|it| it.contains("no address")).collect();
        assert_eq!(
            refused,
            [
                "N001 – 2: a cycle, and no address is free",
                "N002 – 3: a cycle, and no address is free",
                "N003 – 1: a cycle, and no address is free",
            ]
        );
        assert!(told.contains(&"N010 – 11: 11 is used by N011".to_owned()), "{told:?}");
        assert!(!told.iter().any(|it| it.contains('→')), "{told:?}");
        // One that leaves makes room, for its own step and for the cycle.
        devices.remove(10);
        let told = plan(&devices, StepEffect::AtOnce);
        assert_eq!(told[0], "N010 10 → 11: 11 is free");
        assert_eq!(told[1], "N001 1 → 10: through free 10: cycle of 3");
    }

    #[test]
    fn devices_that_cannot_move_are_left_out_and_block_others() {
        let (mut bus, mut goals) = bus(&[
            ("A", 12, 13),
            ("B", 13, 14),
            ("C", 14, 15),
            ("D", 30, 31),
            ("E", 31, 0),
            ("F", 40, 7),
            ("G", 41, 42),
            ("H", 42, 43),
            ("I", 50, 51),
        ]);
        bus.own = Some(address(7));
        bus.devices[2].is_shared = true;
        bus.devices[8].identity = DeviceIdentity::default();
        goals[8 - 1].identity = DeviceIdentity::default();
        let held = goals.iter().position(|it| it.to == address(43)).unwrap();
        goals[held].is_left_out = true;
        goals.push(AddressGoal {
            device: None,
            identity: DeviceIdentity { uid: None, name: Some("PUMP".into()) },
            to: address(44),
            setting: None,
            doubt: None,
            is_left_out: false,
        });
        let plan = AddressPlan::new(&bus, &goals, &options(StepEffect::AtOnce));
        assert_eq!(
            lines(&plan),
            [
                "A – 13: 13 is used by B",
                "B – 14: 14 is used by C",
                "C – 15: shares 14: unplug one",
                "D – 31: 31 is used by E",
                "F – 7: descan's own address",
                "G – 42: 42 is used by H",
                "H – 43: left out by you",
                "the device – 51: no UID and no name",
                "PUMP – 44: not on the bus"
            ]
        );
        assert!(plan.leaves_out());
    }

    #[test]
    fn stored_settings_are_taken_and_a_stored_one_only_restarts() {
        let (mut bus, goals) = bus(&[("A", 12, 21), ("B", 13, 0), ("C", 14, 22), ("D", 15, 15)]);
        bus.devices[1].setting = Some(AddressSetting::Fixed(address(21)));
        bus.devices[2].setting = Some(AddressSetting::Fixed(address(22)));
        bus.devices[3].setting = Some(AddressSetting::None);
        let told = |effect| lines(&AddressPlan::new(&bus, &goals, &options(effect)));
        let restart = told(StepEffect::Restart);
        assert_eq!(
            restart,
            [
                "C 14 → 22: stored already: it restarts",
                "D 15 → 15: its setting is none",
                "A – 21: 21 is used by B"
            ]
        );
        assert_eq!(told(StepEffect::Deferred)[2], "C – 22: stored: in force after its restart");
    }

    #[test]
    fn cut_cycle_makes_room_for_the_others() {
        // All but one address are used, and A is at the one that no device is to have.
        let names: Vec<String> = (1..127).map(|at| format!("N{at:03}")).collect();
        let mut devices: Vec<(&str, u8, u8)> =
            names.iter().zip(1..).map(|(name, at)| (name.as_str(), at, at)).collect();
        devices[0] = ("A", 127, 2);
        (devices[1].2, devices[3].2, devices[4].2) = (1, 5, 4);
        for effect in [StepEffect::AtOnce, StepEffect::Deferred] {
            let told = plan(&devices, effect);
            assert_eq!(
                told[..4],
                [
                    "N002 2 → 1: 1 is free",
                    "A 127 → 2: after step 1",
                    "N004 4 → 127: through free 127: swaps with N005",
                    "N005 5 → 4: after step 3"
                ]
            );
        }
    }

    #[test]
    fn random_permutations_never_meet() {
        let mut rng = fastrand::Rng::with_seed(5);
        for round in 0..300 {
            let count = 1 + rng.usize(..126);
            let mut numbers: Vec<u8> = (1..128).collect();
            rng.shuffle(&mut numbers);
            let mut wanted = numbers.clone();
            if round % 2 == 0 {
                wanted.truncate(count);
            }
            rng.shuffle(&mut wanted);
            let names: Vec<String> = (0..count).map(|at| format!("N{at:03}")).collect();
            let all = names.iter().zip(&numbers).zip(&wanted);
            let devices: Vec<(&str, u8, u8)> =
                all.map(|((name, from), to)| (name.as_str(), *from, *to)).collect();
            let (mut bus, goals) = bus(&devices);
            // The settings of some are those of an interrupted plan.
            let spare: Vec<u8> = numbers[count..].to_vec();
            for number in spare.iter().filter(|it| !wanted[..count].contains(it)).skip(1) {
                let at = rng.usize(..count);
                let is_stored = bus.devices.iter().any(|it| it.stored() == Some(address(*number)));
                if rng.bool() && !is_stored {
                    bus.devices[at].setting = Some(AddressSetting::Fixed(address(*number)));
                }
            }
            for effect in [StepEffect::AtOnce, StepEffect::Restart, StepEffect::Deferred] {
                let plan = AddressPlan::new(&bus, &goals, &options(effect));
                check(&bus, &plan, &goals, effect);
                let left = plan.left_out.iter().filter(|it| !it.reason.is_done());
                assert_eq!(left.map(|it| it.to).collect::<Vec<_>>(), [], "round {round}");
                assert!(plan.steps.len() <= count + count / 2);
            }
        }
    }
}
