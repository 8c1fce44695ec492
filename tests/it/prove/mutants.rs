//! Devices that break one rule each: the right rule is named, and none else.

use super::bench::{Extra, Filter, NoFilter, ProofBench, broken, given_profile};
use descan::frame::{CanId, Frame};
use descan::prove::ConformanceRule as Rule;
use descan::sim::{DeviceSpec, Fault, Scenario};
use descan::time::{Duration, Instant};
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::{Mode, Uid};
use descan::wire::profile::{Profile, ProfileKey, ValueOrigin};

const DEVICE: u8 = 12;

fn header(frame: &Frame) -> Header {
    Header::decode(frame.platform_id().expect("an extended data frame"))
}

fn with_header(frame: Frame, change: impl Fn(&mut Header)) -> Frame {
    let mut header = header(&frame);
    change(&mut header);
    let mut frame = frame;
    frame.id = CanId::Extended(header.encode());
    frame
}

fn with_data(frame: &Frame, data: &[u8]) -> Frame {
    Frame::new(frame.id, data).with_time(frame.time)
}

fn is_heartbeat(frame: &Frame) -> bool {
    header(frame).service.number() == 1
}

fn is_from_device(frame: &Frame) -> bool {
    frame.platform_id().is_some() && header(frame).source.number() == DEVICE
}

/// A DES response of the device, but for a refusal.
fn is_answer(frame: &Frame) -> bool {
    is_from_device(frame) && is_des_response(frame) && header(frame).no_error
}

fn is_des_response(frame: &Frame) -> bool {
    header(frame).service.number() == 2 && header(frame).response
}

/// A name answer in a single frame.
fn is_name(frame: &Frame) -> bool {
    is_answer(frame) && frame.data().get(1) == Some(&1)
}

/// Changes frames of the device.
struct FromDevice(fn(Frame) -> Vec<Frame>);

impl Filter for FromDevice {
    fn received(&mut self, frame: Frame) -> Vec<Frame> {
        if is_from_device(&frame) { (self.0)(frame) } else { vec![frame] }
    }
}

/// Changes frames to the device.
struct ToDevice(fn(Frame) -> Vec<Frame>);

impl Filter for ToDevice {
    fn transmitted(&mut self, _now: Instant, frame: Frame) -> Vec<Frame> {
        (self.0)(frame)
    }
}

fn from_device(change: fn(Frame) -> Vec<Frame>) -> Box<dyn Filter> {
    Box::new(FromDevice(change))
}

fn to_device(change: fn(Frame) -> Vec<Frame>) -> Box<dyn Filter> {
    Box::new(ToDevice(change))
}

/// A good device, with answers of several frames.
fn good() -> DeviceSpec {
    let device = DeviceSpec::new("FEED").fixed(DEVICE).skips_address_resolution();
    let services = ["AUGER", "MOTOR", "LOG", "TIME"];
    services.iter().fold(device, |it, name| it.service(name, "1.0"))
}

/// Checks that exactly this rule is broken, of a device among others.
#[track_caller]
fn check_with(rule: Rule, device: DeviceSpec, others: Vec<DeviceSpec>, filter: Box<dyn Filter>) {
    let mut scenario = Scenario::new(125_000).with(device);
    scenario.devices.extend(others);
    let mut bench = ProofBench::new(&scenario, DEVICE, given_profile(), filter);
    let verdicts = bench.run();
    let named: Vec<Rule> = broken(&verdicts).iter().map(|(rule, _)| *rule).collect();
    assert_eq!(named, [rule], "{:?}", broken(&verdicts));
    let broken = super::bench::verdict(&verdicts, rule);
    let needs_no_frame = rule == Rule::HeartbeatInterval;
    assert!(!broken.frames.is_empty() || needs_no_frame, "no frames prove it");
    assert!(!broken.text.is_empty());
}

#[track_caller]
fn check(rule: Rule, device: DeviceSpec, filter: Box<dyn Filter>) {
    let psu = DeviceSpec::new("PSU").fixed(40).skips_address_resolution();
    check_with(rule, device, vec![psu], filter);
}

// ---- what it sends by itself -------------------------------------------------------------

#[test]
fn missing_heartbeat_is_named() {
    check(Rule::HeartbeatInterval, good().fault(Fault::NoHeartbeat), Box::new(NoFilter));
}

#[test]
fn heartbeat_with_the_other_u_flag_is_named_alone() {
    let change = |frame| {
        let is_beat = header(&frame).service.number() == 1;
        vec![with_header(frame, |it| it.from_non_working |= is_beat)]
    };
    check(Rule::ModeFlag, good(), from_device(change));
}

#[test]
fn fast_heartbeat_is_named() {
    let mut device = good();
    device.heartbeat = Some(Duration::from_millis(500));
    check(Rule::HeartbeatInterval, device, Box::new(NoFilter));
}

#[test]
fn slow_heartbeat_is_named() {
    let mut device = good();
    device.heartbeat = Some(Duration::from_millis(1500));
    check(Rule::HeartbeatInterval, device, Box::new(NoFilter));
}

#[test]
fn heartbeat_with_cleared_err_is_named() {
    let change = |frame| {
        let is_beat = is_heartbeat(&frame);
        vec![with_header(frame, |it| it.no_error &= !is_beat)]
    };
    check(Rule::ErrorFlag, good(), from_device(change));
}

#[test]
fn heartbeat_with_constant_dst_is_named() {
    let change = |frame| {
        let is_beat = is_heartbeat(&frame);
        let constant = Address::from_bits(5);
        vec![with_header(frame, |it| {
            if is_beat {
                it.destination = constant;
            }
        })]
    };
    check(Rule::RandomDestination, good(), from_device(change));
}

#[test]
fn message_type_that_does_not_exist_is_named() {
    let device = good().periodic_message(0x155, Duration::from_millis(400), 4);
    let change = |frame| {
        let is_data = header(&frame).service.number() == 0x155;
        vec![with_header(frame, |it| it.to_non_working |= is_data)]
    };
    check(Rule::MessageTypes, device, from_device(change));
}

#[test]
fn remote_frame_of_the_device_is_named() {
    let device = good().periodic_message(0x155, Duration::from_millis(400), 4);
    let change = |frame: Frame| {
        let is_data = header(&frame).service.number() == 0x155;
        let remote = Frame::remote(frame.id, 4).with_time(frame.time);
        vec![if is_data { remote } else { frame }]
    };
    check(Rule::MessageTypes, device, from_device(change));
}

#[test]
fn request_while_configuring_is_named() {
    let mut device = good().fault(Fault::SendsRequests);
    device.mode = Some(Mode::Cfg);
    check(Rule::NoRequestsUnlessWorking, device, Box::new(NoFilter));
}

#[test]
fn answer_with_u_of_another_mode_is_named() {
    let change = |frame| {
        let is_answer = is_answer(&frame);
        vec![with_header(frame, |it| it.from_non_working |= is_answer)]
    };
    check(Rule::ModeFlag, good(), from_device(change));
}

#[test]
fn heartbeat_with_u_of_another_mode_is_named() {
    let change = |frame: Frame| {
        let mut data = frame.data().to_vec();
        if is_heartbeat(&frame) {
            data[6] = 2;
        }
        vec![with_data(&frame, &data)]
    };
    check(Rule::ModeFlag, good(), from_device(change));
}

#[test]
fn uid_of_another_device_is_named() {
    let uid = Uid([1, 2, 3, 4, 5, 6]);
    let twin = DeviceSpec::new("PSU").fixed(40).skips_address_resolution().uid(uid);
    let twin = twin.fault(Fault::KeepsAddress);
    let device = good().uid(uid).fault(Fault::KeepsAddress);
    check_with(Rule::UidUnique, device, vec![twin], Box::new(NoFilter));
}

#[test]
fn blank_uid_in_work_is_named() {
    let mut device = good().uid(Uid::BLANK);
    device.mode = Some(Mode::Work);
    check(Rule::UidSetInWork, device, Box::new(NoFilter));
}

// ---- requests and answers ----------------------------------------------------------------

#[test]
fn silence_to_requests_is_named() {
    check(Rule::AnswersName, good().fault(Fault::NoDes), Box::new(NoFilter));
}

#[test]
fn silence_to_broadcasts_is_named() {
    let change = |frame| if header(&frame).broadcast { Vec::new() } else { vec![frame] };
    check(Rule::AnswersBroadcast, good(), to_device(change));
}

#[test]
fn silence_to_services_requests_is_named() {
    check(Rule::AnswersServices, good().fault(Fault::NoServices), Box::new(NoFilter));
}

#[test]
fn silence_shows_the_requests_of_all_attempts() {
    for (rule, fault, text) in [
        (Rule::AnswersServices, Fault::NoServices, "no answer to 4 requests"),
        (Rule::AnswersName, Fault::NoDes, "no answer to 10 name requests"),
    ] {
        let psu = DeviceSpec::new("PSU").fixed(40).skips_address_resolution();
        let scenario = Scenario::new(125_000).with(good().fault(fault)).with(psu);
        let filter = Box::new(NoFilter);
        let verdicts = ProofBench::new(&scenario, DEVICE, given_profile(), filter).run();
        let verdict = super::bench::verdict(&verdicts, rule);
        assert_eq!(verdict.text, text);
        let sent = verdict.frames.iter().filter(|frame| frame.is_tx).count();
        let wanted = text.split(' ').nth(3).unwrap().parse::<usize>().unwrap();
        assert_eq!(sent, wanted, "{:?}", verdict.frames);
    }
}

#[test]
fn services_request_refused_is_named() {
    let change = |frame: Frame| {
        let is_list = is_answer(&frame) && frame.data()[0] == 0x10;
        let refusal = with_header(with_data(&frame, &[]), |it| it.no_error = false);
        vec![if is_list { refusal } else { frame }]
    };
    check(Rule::AnswersServices, good(), from_device(change));
}

#[test]
fn second_answer_to_a_request_is_named() {
    check(Rule::OneAnswer, good().fault(Fault::RespondsTwice), Box::new(NoFilter));
}

#[test]
fn name_without_its_zero_is_named() {
    let change = |frame: Frame| {
        vec![if is_name(&frame) { with_data(&frame, b"\x05\x01FEED") } else { frame }]
    };
    check(Rule::NameFormat, good(), from_device(change));
}

#[test]
fn name_with_another_type_is_named() {
    let change = |frame: Frame| {
        vec![if is_name(&frame) { with_data(&frame, b"\x06\x05FEED\0") } else { frame }]
    };
    check(Rule::NameFormat, good(), from_device(change));
}

#[test]
fn bytes_behind_the_name_are_named() {
    let change = |frame: Frame| {
        vec![if is_name(&frame) { with_data(&frame, b"\x07\x01FEED\0A") } else { frame }]
    };
    check(Rule::NameFormat, good(), from_device(change));
}

#[test]
fn index_of_a_service_out_of_order_is_named() {
    // "\x02" \x00 "DES" \0 | "1.0" \0 \x01 "AU" : the index of the second service.
    let change = |frame: Frame| {
        let mut data = frame.data().to_vec();
        if is_answer(&frame) && data[0] == 0x21 && data.contains(&1) {
            data.iter_mut().skip(1).filter(|it| **it == 1).for_each(|it| *it = 2);
        }
        vec![with_data(&frame, &data)]
    };
    check(Rule::ServicesFormat, good(), from_device(change));
}

#[test]
fn list_that_ends_within_a_service_is_named() {
    check(Rule::ServicesFormat, good().fault(Fault::TruncatedServices), Box::new(NoFilter));
}

#[test]
fn answer_to_another_address_is_named() {
    let change = |frame| {
        let (is_answer, other) = (is_answer(&frame), Address::from_bits(77));
        vec![with_header(frame, |it| {
            if is_answer {
                it.destination = other;
            }
        })]
    };
    check(Rule::AnswerHeader, good(), from_device(change));
}

#[test]
fn answer_sent_as_broadcast_is_named() {
    let change = |frame| {
        let is_answer = is_answer(&frame);
        vec![with_header(frame, |it| it.broadcast |= is_answer)]
    };
    check(Rule::AnswerHeader, good(), from_device(change));
}

#[test]
fn answer_with_cleared_err_is_named() {
    let change = |frame| {
        let is_answer = is_answer(&frame);
        vec![with_header(frame, |it| it.no_error &= !is_answer)]
    };
    check(Rule::ErrorFlag, good(), from_device(change));
}

#[test]
fn answer_to_the_other_d_flag_is_named() {
    let change = |frame| vec![with_header(frame, |it| it.to_non_working = false)];
    check(Rule::OwnDFlag, good(), to_device(change));
}

#[test]
fn answer_only_to_the_other_d_flag_is_named() {
    let change = |frame| vec![with_header(frame, |it| it.to_non_working ^= true)];
    check(Rule::OwnDFlag, good(), to_device(change));
}

#[test]
fn answer_to_requests_to_others_is_named() {
    let change = |frame| {
        let device = Address::from_bits(DEVICE);
        vec![with_header(frame, |it| {
            if !it.broadcast {
                it.destination = device;
            }
        })]
    };
    check_with(Rule::OnlyOwnRequests, good(), Vec::new(), to_device(change));
}

/// Does not take a request that follows one to another device.
struct Distracted(Instant);

impl Filter for Distracted {
    fn transmitted(&mut self, now: Instant, frame: Frame) -> Vec<Frame> {
        let to = header(&frame).destination;
        if to.number() != DEVICE && !header(&frame).broadcast {
            self.0 = now;
        } else if now.since(self.0) < Duration::from_millis(5) && now > Instant::ZERO {
            return Vec::new();
        }
        vec![frame]
    }
}

#[test]
fn silence_while_others_are_asked_is_named() {
    check(Rule::AnswersWhileOthersAsked, good(), Box::new(Distracted(Instant::ZERO)));
}

#[test]
fn reserved_type_answered_as_name_is_named() {
    let change = |frame: Frame| {
        let is_reserved = frame.data().starts_with(b"\x04DES") && !matches!(frame.data()[4], 1 | 2);
        vec![if is_reserved { with_data(&frame, b"\x04DES\x01") } else { frame }]
    };
    check(Rule::ReservedNotAnswered, good(), to_device(change));
}

/// Answers reserved types with other bytes and ERR = 1, 5 ms later.
#[derive(Default)]
struct Parrot(Vec<(Instant, Frame)>);

impl Filter for Parrot {
    fn received(&mut self, frame: Frame) -> Vec<Frame> {
        let is_refusal = is_des_response(&frame) && !header(&frame).no_error;
        if is_refusal { Vec::new() } else { vec![frame] }
    }

    fn transmitted(&mut self, now: Instant, frame: Frame) -> Vec<Frame> {
        let is_des = frame.data().starts_with(b"\x04DES") && !header(&frame).broadcast;
        if is_des && !matches!(frame.data()[4], 1 | 2) {
            let answer = header(&frame).response(Address::from_bits(DEVICE), false);
            let answer = Frame::classic(answer.encode(), &[4, 9, 9, 9, 9]);
            self.0.push((now + Duration::from_millis(5), answer));
        }
        vec![frame]
    }

    fn inject(&mut self, now: Instant) -> Vec<Frame> {
        let (due, waiting): (Vec<_>, Vec<_>) = self.0.drain(..).partition(|(at, _)| *at <= now);
        self.0 = waiting;
        due.into_iter().map(|(_, frame)| frame).collect()
    }
}

#[test]
fn reserved_type_answered_otherwise_is_named() {
    check(Rule::ReservedRefused, good(), Box::<Parrot>::default());
}

// ---- segmented answers -------------------------------------------------------------------

#[test]
fn missing_consecutive_frame_is_named() {
    check(Rule::TransferFraming, good().fault(Fault::DropFrame), Box::new(NoFilter));
}

#[test]
fn wrong_sequence_number_is_named() {
    check(Rule::TransferFraming, good().fault(Fault::WrongSequence), Box::new(NoFilter));
}

#[test]
fn endless_transfer_is_named() {
    check(Rule::TransferFraming, good().fault(Fault::Endless), Box::new(NoFilter));
}

/// Asks for the services before the prover does, and lets the device send: an enumeration before the tests.
struct EarlyRequest(Vec<(Instant, &'static [u8])>);

impl Filter for EarlyRequest {
    fn hidden(&mut self, now: Instant) -> Vec<Frame> {
        let device = Address::from_bits(DEVICE);
        let des = Service::from_bits(2);
        let id = Header::request(Address::DEBUG, device, false, des).encode();
        let due = self.0.extract_if(.., |(at, _)| *at <= now);
        due.map(|(_, data)| Frame::classic(id, data)).collect()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.0.iter().map(|(at, _)| *at).min()
    }
}

fn early_request() -> Box<dyn Filter> {
    let at = |millis| Instant::ZERO + Duration::from_millis(millis);
    Box::new(EarlyRequest(vec![(at(1100), b"\x04DES\x02"), (at(1200), b"\x30\0\0")]))
}

#[test]
fn endless_transfer_that_began_before_the_tests_is_named() {
    check(Rule::TransferFraming, good().fault(Fault::Endless), early_request());
}

#[test]
fn whole_transfer_that_began_before_the_tests_breaks_no_rule() {
    let scenario = Scenario::new(125_000).with(good());
    let mut bench = ProofBench::new(&scenario, DEVICE, given_profile(), early_request());
    let verdicts = bench.run();
    assert!(broken(&verdicts).is_empty(), "{:?}", broken(&verdicts));
    assert!(bench.seen.iter().any(|frame| frame.time.as_micros() < 1_500_000 && is_answer(frame)));
}

#[test]
fn first_frame_of_a_huge_length_is_named() {
    check(Rule::TransferFraming, good().fault(Fault::HugeLength), Box::new(NoFilter));
}

fn is_flow(frame: &Frame) -> bool {
    header(frame).service.number() == 2 && frame.data().len() == 3 && frame.data()[0] >> 4 == 3
}

#[test]
fn block_size_ignored_is_named() {
    let change = |frame: Frame| {
        vec![if is_flow(&frame) {
            with_data(&frame, &[frame.data()[0], 0, frame.data()[2]])
        } else {
            frame
        }]
    };
    check(Rule::BlockSizeKept, good(), to_device(change));
}

#[test]
fn st_min_ignored_is_named() {
    let change = |frame: Frame| {
        vec![if is_flow(&frame) {
            with_data(&frame, &[frame.data()[0], frame.data()[1], 0])
        } else {
            frame
        }]
    };
    check(Rule::StMinKept, good(), to_device(change));
}

#[test]
fn wait_ignored_is_named() {
    let change = |frame: Frame| {
        let is_wait = is_flow(&frame) && frame.data()[0] == 0x31;
        vec![if is_wait { with_data(&frame, &[0x30, 0, 0]) } else { frame }]
    };
    check(Rule::FlowWaitKept, good(), to_device(change));
}

#[test]
fn transfer_that_ends_after_wait_is_named() {
    let change = |frame: Frame| {
        let is_wait = is_flow(&frame) && frame.data()[0] == 0x31;
        vec![if is_wait { with_data(&frame, &[0x32, 0, 0]) } else { frame }]
    };
    check(Rule::FlowWaitKept, good(), to_device(change));
}

#[test]
fn overflow_ignored_is_named() {
    let change = |frame: Frame| {
        let is_overflow = is_flow(&frame) && frame.data()[0] == 0x32;
        vec![if is_overflow { with_data(&frame, &[0x30, 0, 0]) } else { frame }]
    };
    check(Rule::OverflowKept, good(), to_device(change));
}

/// Gives the device flow control that the prover does not send: so the device does not wait for it, or
/// not for N_Bs only.
struct ForeignFlow {
    /// Flow control for a first frame, and the time after it.
    flow: &'static [u8],
    after: Duration,
    again: bool,
    due: Option<Instant>,
    flows: Vec<Frame>,
}

impl ForeignFlow {
    fn new(flow: &'static [u8], after: u64, again: bool) -> Self {
        let after = Duration::from_millis(after);
        Self { flow, after, again, due: None, flows: Vec::new() }
    }
}

impl Filter for ForeignFlow {
    fn transmitted(&mut self, _now: Instant, frame: Frame) -> Vec<Frame> {
        if is_flow(&frame) {
            self.due = None;
        }
        vec![frame]
    }

    fn received(&mut self, frame: Frame) -> Vec<Frame> {
        if is_answer(&frame) && frame.data().first() == Some(&0x10) {
            self.due = Some(frame.time + self.after);
        }
        vec![frame]
    }

    fn hidden(&mut self, now: Instant) -> Vec<Frame> {
        if self.due.is_some_and(|due| due <= now) {
            self.due = self.again.then(|| now + self.after);
            let id = Header::request(
                Address::DEBUG,
                Address::from_bits(DEVICE),
                false,
                descan::wire::id::Service::from_bits(2),
            );
            self.flows.push(Frame::classic(id.encode(), self.flow));
        }
        std::mem::take(&mut self.flows)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.due
    }
}

#[test]
fn consecutive_frames_before_flow_control_are_named() {
    check(Rule::FlowControlAwaited, good(), Box::new(ForeignFlow::new(&[0x30, 0, 0], 10, false)));
}

#[test]
fn transfer_that_waits_for_ever_is_named() {
    check(Rule::FlowTimeoutKept, good(), Box::new(ForeignFlow::new(&[0x31, 0, 0], 500, true)));
}

// ---- what throws it out of its work ------------------------------------------------------

/// Values of the profile without the number of the mode command: modes do not change.
fn profile_without_modes() -> Profile {
    let mut profile = given_profile();
    profile.set_origin(ProfileKey::Mode, ValueOrigin::Assumed);
    profile
}

#[track_caller]
fn check_disrupted(rule: Rule, device: DeviceSpec, profile: Profile, filter: Box<dyn Filter>) {
    let psu = DeviceSpec::new("PSU").fixed(40).skips_address_resolution();
    let scenario = Scenario::new(125_000).with(device).with(psu);
    let mut bench = ProofBench::with(&scenario, DEVICE, profile, filter, Extra::Disruption);
    let verdicts = bench.run();
    let named: Vec<Rule> = broken(&verdicts).iter().map(|(rule, _)| *rule).collect();
    assert_eq!(named, [rule], "{:?}", broken(&verdicts));
}

#[test]
fn working_device_that_keeps_its_address_is_named() {
    let device = good().fault(Fault::KeepsAddress);
    check_disrupted(Rule::GivesWayWorking, device, profile_without_modes(), Box::new(NoFilter));
}

#[test]
fn configuring_device_that_keeps_its_address_is_named() {
    let mut device = good().fault(Fault::KeepsAddress);
    device.mode = Some(Mode::Cfg);
    let profile = profile_without_modes();
    check_disrupted(Rule::GivesWayConfiguring, device, profile, Box::new(NoFilter));
}

#[test]
fn working_device_that_gives_way_to_a_claim_is_named() {
    let change = |frame| {
        let is_own = header(&frame).source.number() == DEVICE;
        vec![with_header(frame, |it| it.from_non_working &= !is_own)]
    };
    let profile = profile_without_modes();
    check_disrupted(Rule::KeepsAddressWorking, good(), profile, to_device(change));
}

/// Hears only the first of several frames from its address.
struct HardOfHearing(Option<Instant>);

impl Filter for HardOfHearing {
    fn transmitted(&mut self, now: Instant, frame: Frame) -> Vec<Frame> {
        if header(&frame).source.number() != DEVICE {
            return vec![frame];
        }
        let before = self.0.replace(now);
        let is_again = before.is_some_and(|at| now.since(at) < Duration::from_millis(600));
        if is_again { Vec::new() } else { vec![frame] }
    }
}

#[test]
fn use_of_an_address_that_is_used_is_named() {
    let filter = Box::new(HardOfHearing(None));
    check_disrupted(Rule::ResolvesAnew, good(), profile_without_modes(), filter);
}

#[test]
fn mode_that_does_not_change_is_named() {
    let change = |frame: Frame| {
        let is_command = header(&frame).service.number() == 0x019;
        vec![if is_command { with_data(&frame, &[4]) } else { frame }]
    };
    check_disrupted(Rule::ModeChanges, good(), given_profile(), to_device(change));
}

// ---- on a loaded bus ---------------------------------------------------------------------

/// What a device does not do once the bus is loaded.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Overload {
    /// Take requests.
    Requests,
    /// Send the second one of two heartbeats.
    SomeHeartbeats,
    /// Send heartbeats.
    Heartbeats,
}

/// A device that a loaded bus is too much for.
struct Overloaded {
    lacks: Overload,
    is_loaded: bool,
    heartbeats: u32,
}

impl Filter for Overloaded {
    fn transmitted(&mut self, _now: Instant, frame: Frame) -> Vec<Frame> {
        self.is_loaded |= header(&frame).service == Service::from_bits(Service::MAX);
        let is_request = header(&frame).service.number() == 2;
        let is_lost = self.is_loaded && self.lacks == Overload::Requests && is_request;
        if is_lost { Vec::new() } else { vec![frame] }
    }

    fn received(&mut self, frame: Frame) -> Vec<Frame> {
        if !self.is_loaded || !is_from_device(&frame) || !is_heartbeat(&frame) {
            return vec![frame];
        }
        self.heartbeats += 1;
        let is_sent = match self.lacks {
            Overload::Requests => true,
            Overload::SomeHeartbeats => self.heartbeats.is_multiple_of(2),
            Overload::Heartbeats => false,
        };
        if is_sent { vec![frame] } else { Vec::new() }
    }
}

#[track_caller]
fn check_loaded(rule: Rule, lacks: Overload) {
    let scenario = Scenario::new(125_000).with(good());
    let filter = Box::new(Overloaded { lacks, is_loaded: false, heartbeats: 0 });
    let mut bench = ProofBench::with(&scenario, DEVICE, given_profile(), filter, Extra::Load);
    let verdicts = bench.run();
    let named: Vec<Rule> = broken(&verdicts).iter().map(|(rule, _)| *rule).collect();
    assert_eq!(named, [rule], "{:?}", broken(&verdicts));
}

#[test]
fn silence_on_a_loaded_bus_is_named() {
    check_loaded(Rule::AnswersUnderLoad, Overload::Requests);
}

#[test]
fn missing_heartbeats_on_a_loaded_bus_are_named() {
    check_loaded(Rule::HeartbeatUnderLoad, Overload::SomeHeartbeats);
    check_loaded(Rule::HeartbeatUnderLoad, Overload::Heartbeats);
}

// ---- malformed and endless requests ------------------------------------------------------

/// Takes nothing for a time after a request.
struct Hanging {
    trigger: fn(&Frame) -> bool,
    time: Duration,
    until: Instant,
}

impl Filter for Hanging {
    fn transmitted(&mut self, now: Instant, frame: Frame) -> Vec<Frame> {
        if now < self.until {
            return Vec::new();
        }
        if (self.trigger)(&frame) {
            self.until = now + self.time;
        }
        vec![frame]
    }
}

fn hanging(seconds: u64, trigger: fn(&Frame) -> bool) -> Box<dyn Filter> {
    let time = Duration::from_secs(seconds);
    Box::new(Hanging { trigger, time, until: Instant::ZERO })
}

#[test]
fn hang_after_an_empty_frame_is_named() {
    check(Rule::SurvivesMalformed, good(), hanging(3600, |frame| frame.data().is_empty()));
}

#[test]
fn restart_after_a_malformed_frame_is_named() {
    let trigger = |frame: &Frame| frame.data() == b"\x04DEX\x01";
    check(Rule::SurvivesMalformed, good(), hanging(6, trigger));
}

#[test]
fn hang_after_an_endless_request_is_named() {
    let trigger = |frame: &Frame| frame.data().starts_with(&[0x1F, 0xFF]);
    check(Rule::SurvivesEndless, good(), hanging(3600, trigger));
}
