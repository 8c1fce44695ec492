//! Sending what is composed: answers, copies within the share of the bus, and what stops them.

use crate::common::harness::Stage;
use descan::app::{SendingResult, SentFrames};
use descan::composer::{Composition, Repeat};
use descan::discovery::{Config, SequenceEnd};
use descan::frame::{BusIndex, Frame};
use descan::sim::{DeviceAction, Scenario};
use descan::status::{BusState, BusStatus, Link};
use descan::time::Duration;
use descan::wire::id::{Address, Header, Service};

const BUS: BusIndex = BusIndex(0);

fn send(stage: &mut Stage, words: &str, repeat: Repeat) -> Result<(), String> {
    let composition = Composition::parse(words).unwrap();
    stage.app.renew_random_destination(BUS);
    let composed = stage.app.compose(BUS, &composition).map_err(|why| why.text)?;
    let sent = stage.app.send_composed(BUS, &composition, &composed, repeat, None);
    stage.drain(stage.app.now());
    sent
}

fn once(stage: &mut Stage, words: &str) -> SentFrames {
    send(stage, words, Repeat::default()).unwrap();
    let now = stage.app.now().as_micros() as f64 / 1e6;
    stage.until(now + 3.0);
    last(stage)
}

fn last(stage: &Stage) -> SentFrames {
    stage.app.sent_frames().next_back().unwrap().clone()
}

fn boiler() -> Stage {
    let mut stage = Stage::boiler();
    stage.until(10.0);
    stage
}

/// Times of captured frames of descan to a service that nothing else uses.
fn own_frames(stage: &Stage, service: u16) -> Vec<Frame> {
    let is_it = |frame: &&Frame| {
        let service = Service::new(service).unwrap();
        frame.is_tx && frame.platform_id().is_some_and(|id| Header::decode(id).service == service)
    };
    let capture = stage.app.capture();
    let frames: Vec<Frame> = capture.frames_from(capture.first()).map(|(_, it)| it).collect();
    frames.iter().filter(is_it).copied().collect()
}

#[test]
fn answers_are_matched_and_decoded_with_latency() {
    let mut stage = boiler();
    let sent = once(&mut stage, "request des name to FEED");
    assert_eq!(sent.result, Some(SendingResult::Done));
    let answer = &sent.answers[0];
    assert_eq!((answer.who.as_str(), answer.text.as_str()), ("FEED @10", "name FEED"));
    assert!(answer.answer.latency > Duration::from_micros(100), "{:?}", answer.answer);
    assert!(answer.answer.latency < Duration::from_millis(50), "{:?}", answer.answer);
    // An answer of several frames: descan sends flow control for it.
    let sent = once(&mut stage, "request des services to FEED");
    let text = &sent.answers[0].text;
    assert!(text.starts_with("5 services: DES 1.0, CFG 1.3, AUGER 2.1, "), "{text}");
    assert!(!sent.answers[0].answer.is_incomplete);
    // To all: from each device that knows its name, also in several frames.
    let sent = once(&mut stage, "request des name to all");
    let named = stage.app.buses()[0].devices().iter().filter(|it| it.name.is_some()).count();
    let (answers, frames) = (sent.answer_count as usize, sent.frames_made());
    assert!(answers >= 4 && answers <= named && frames == 2, "{answers} of {named}, {frames}");
    assert!(sent.answers.iter().all(|it| !it.answer.is_incomplete), "{:?}", sent.answers);
    // A service that no device has.
    let sent = once(&mut stage, "request 0x123 01 to FEED");
    assert_eq!(sent.result, Some(SendingResult::NoAnswer));
    let line = stage.app.timeline().entries().find(|it| it.text.contains("#01 to FEED")).unwrap();
    assert_eq!(line.text, "sent 00002923#01 to FEED @10: no answer within 1s");
    let line = stage.app.timeline().entries().find(|it| it.text.contains("name FEED after"));
    assert!(line.unwrap().text.starts_with("sent 00002802#0444455301 to FEED @10: name FEED"));
    let frames = own_frames(&stage, 0x123);
    assert_eq!(frames.len(), 1, "it is an own frame of Traffic");
}

#[test]
fn device_that_moved_since_the_question_gets_no_frame() {
    let mut stage = boiler();
    stage.until(70.0);
    let composed = |stage: &Stage, words: &str| {
        let composition = Composition::parse(words).unwrap();
        let composed = stage.app.compose(BUS, &composition).unwrap();
        (composition, composed)
    };
    let asked = ["request 0x123 01 to DISP", "request 0x123 01 to @20", "request 0x123 01 to FEED"];
    let asked = asked.map(|words| composed(&stage, words));
    // DISP moves to 40.
    stage.until(85.0);
    let sent = asked.map(|(composition, composed)| {
        let repeat = Repeat::default();
        let sent = stage.app.send_composed(BUS, &composition, &composed, repeat, None);
        stage.drain(stage.app.now());
        sent
    });
    let moved = "not sent: it was asked for DISP @20, now it is 0000A123#01 to DISP @40; \
                 compose it again";
    assert_eq!(sent[0].as_ref().unwrap_err(), moved);
    assert!(sent[1].as_ref().unwrap_err().contains("asked for DISP @20, now it is"), "{sent:?}");
    assert_eq!(sent[2], Ok(()));
}

#[test]
fn copies_stop_when_the_receiver_moves() {
    let mut stage = boiler();
    stage.until(70.0);
    let composition = Composition::parse("request 0x123 01 to DISP").unwrap();
    let composed = stage.app.compose(BUS, &composition).unwrap();
    let repeat = Repeat { copies: 300, interval: Duration::from_millis(100) };
    stage.app.send_composed(BUS, &composition, &composed, repeat, None).unwrap();
    // DISP moves to 40 at 75 s.
    stage.until(110.0);
    let sent = stage.app.sent_frames().next_back().unwrap();
    let text = sent.outcome_text();
    assert!(text.contains("ended: it was asked for DISP @20, now it is"), "{text}");
    assert!(sent.copies < 100, "{text}");
}

#[test]
fn answer_to_a_round_is_not_one_to_the_request() {
    let mut stage = boiler();
    // A round begins every 10 s; the answers are to descan, too.
    stage.keys("r").until(11.0);
    for words in ["request des name to FEED", "request des name to all working"] {
        for delay in 0..4 {
            send(&mut stage, words, Repeat::default()).unwrap();
            let now = stage.app.now().as_micros() as f64 / 1e6;
            stage.until(now + 0.1 + 0.05 * f64::from(delay)).keys("r").until(now + 3.0);
            let sent = last(&stage);
            let of_feed = sent.answers.iter().filter(|it| it.who == "FEED @10").count();
            assert_eq!(of_feed, 1, "{words}: {:?}", sent.answers);
        }
    }
}

#[test]
fn two_boards_at_an_address_are_warned_of_and_both_answer() {
    let mut stage = Stage::boiler();
    stage.until(50.0);
    let sent = once(&mut stage, "request des name to @14");
    assert_eq!(sent.composed.warnings, ["two boards have address 14: all of them will answer"]);
    assert_eq!((sent.answer_count, sent.copies, sent.answered), (2, 1, 1), "{:?}", sent.answers);
    assert!(sent.outcome_text().starts_with("2 answers after "), "{}", sent.outcome_text());
}

#[test]
fn request_to_all_has_its_two_frames_together() {
    let mut stage = Stage::boiler();
    stage.until(60.0);
    send(&mut stage, "request 0x123 to all", Repeat::default()).unwrap();
    stage.until(62.0);
    let frames = own_frames(&stage, 0x123);
    let gap = frames[1].time.since(frames[0].time);
    assert!(frames.len() == 2 && gap < Duration::from_millis(20), "{frames:?}");
}

trait FramesMade {
    fn frames_made(&self) -> usize;
}

impl FramesMade for SentFrames {
    fn frames_made(&self) -> usize {
        self.composed.frames.len()
    }
}

#[test]
fn eleven_bit_frame_is_sent_and_acknowledged() {
    let mut stage = boiler();
    let sent = once(&mut stage, "123#0102");
    assert_eq!(sent.result, Some(SendingResult::Done));
    assert_eq!(sent.outcome_text(), "on the bus");
    assert_eq!(stage.app.buses()[0].tx_blocked(), None, "it counts as acknowledged");
}

#[test]
fn copies_stay_within_the_steady_share() {
    let mut stage = boiler();
    let words = "request 0x123 01 02 03 04 05 06 07 08 to FEED";
    send(&mut stage, words, Repeat::new(200, 1).unwrap()).unwrap();
    let began = stage.app.now();
    stage.until(40.0);
    let sent = last(&stage);
    let frames = own_frames(&stage, 0x123);
    assert_eq!((sent.copies, frames.len()), (200, 200));
    assert_eq!(sent.end, Some(SequenceEnd::Complete));
    let took = frames.last().unwrap().time.since(began).as_secs_f64();
    // 144 bits each, and as many for an answer, of 5 % of 125 kbit/s.
    let least = 199.0 * 2.0 * 144.1 / (0.05 * 125_000.0);
    assert!(took >= least && took < least * 1.2, "{took} s, at least {least} s");
    // Slower than the share allows: the interval holds.
    send(&mut stage, words, Repeat::new(5, 500).unwrap()).unwrap();
    stage.until(45.0);
    let frames = own_frames(&stage, 0x123);
    for pair in frames[200..].windows(2) {
        let gap = pair[1].time.since(pair[0].time).as_millis();
        assert!((495..=520).contains(&gap), "{gap} ms");
    }
}

#[test]
fn copies_of_broadcasts_have_new_random_numbers() {
    let mut stage = boiler();
    send(&mut stage, "unsolicited 0x123 01", Repeat::new(20, 10).unwrap()).unwrap();
    stage.until(20.0);
    let frames = own_frames(&stage, 0x123);
    let number = |frame: &Frame| Header::decode(frame.platform_id().unwrap()).destination;
    let mut numbers: Vec<Address> = frames.iter().map(number).collect();
    assert_eq!(numbers.len(), 20);
    assert_eq!(number(&frames[0]), number(&last(&stage).composed.frames[0]), "as it was shown");
    numbers.sort();
    numbers.dedup();
    assert!(numbers.len() > 10, "{numbers:?}");
}

#[test]
fn copies_stop_without_acknowledgement() {
    let mut stage = boiler();
    send(&mut stage, "request 0x123 01 to FEED", Repeat::new(100, 200).unwrap()).unwrap();
    stage.until(12.0);
    let devices: Vec<_> = stage.sim.devices().collect();
    for device in devices {
        stage.sim.apply(device, DeviceAction::PowerOff);
    }
    stage.until(13.5);
    let sent = last(&stage);
    assert!((9..=11).contains(&sent.copies), "{}", sent.copies);
    assert!(sent.outcome_text().contains("ended: no node acknowledges"), "{}", sent.outcome_text());
    let refused = send(&mut stage, "123#00", Repeat::default()).unwrap_err();
    assert!(refused.contains("no ACK on can0"), "{refused}");
    let line = stage.app.timeline().entries().find(|it| it.text.contains("of 100 copies"));
    assert!(line.is_some());
}

#[test]
fn copies_stop_at_error_passive_and_on_demand() {
    let status =
        |state| BusStatus { link: Link::Up, state, bitrate: Some(125_000), ..BusStatus::default() };
    let mut stage = boiler();
    let many = Repeat::new(100, 100).unwrap();
    send(&mut stage, "debug 0x005 01", many).unwrap();
    stage.until(10.55);
    let now = stage.app.now();
    stage.app.handle_bus(now, BUS, status(BusState::ErrorPassive));
    stage.until(12.0);
    let sent = last(&stage);
    assert_eq!((sent.copies, sent.end), (6, Some(SequenceEnd::ControllerErrors)));
    assert!(send(&mut stage, "debug 0x005 01", many).unwrap_err().contains("error-passive"));
    let now = stage.app.now();
    stage.app.handle_bus(now, BUS, status(BusState::ErrorActive));
    send(&mut stage, "debug 0x005 01", many).unwrap();
    assert!(send(&mut stage, "debug 0x005 02", many).unwrap_err().contains("stop them first"));
    stage.until(12.25);
    assert!(stage.app.stop_sending());
    stage.until(14.0);
    let sent = last(&stage);
    assert_eq!((sent.copies, sent.end), (3, Some(SequenceEnd::Stopped)));
    assert!(sent.outcome_text().contains("3 of 100 copies; ended: stopped"));
}

#[test]
fn copies_stop_when_the_own_address_is_lost() {
    let mut stage = boiler();
    send(&mut stage, "request 0x123 to FEED", Repeat::new(100, 100).unwrap()).unwrap();
    stage.until(10.5);
    let now = stage.app.now();
    let own = Address::DEBUG;
    let heartbeat = Header::unsolicited(own, 3, false, Service::new(1).unwrap());
    let frame = Frame::classic(heartbeat.encode(), &[1, 2, 3, 4, 5, 6, 4, 0]).with_time(now);
    stage.app.handle_frames(now, &[frame]);
    stage.until(14.0);
    assert_eq!(last(&stage).end, Some(SequenceEnd::AddressLost));
}

#[test]
fn past_moment_shows_the_bus_with_what_was_sent() {
    let mut stage = boiler();
    let before = stage.app.buses()[0].counters().sent;
    send(&mut stage, "request 0x123 to FEED", Repeat::new(10, 100).unwrap()).unwrap();
    stage.until(14.0);
    stage.keys("g").text("-1s").keys("Enter").until(15.0);
    let past = stage.app.past_moment().expect("it is frozen");
    assert!(past.time < stage.app.now());
    let sent = stage.app.bus(BUS).unwrap().counters().sent;
    assert!(sent >= before + 10, "{sent} {before}");
}

#[test]
fn listening_bus_and_foreign_address_send_nothing() {
    let config = Config { listen_only: true, seed: 7, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
    stage.until(5.0);
    let why = send(&mut stage, "123#00", Repeat::default()).unwrap_err();
    assert_eq!(why, "listen-only: no requests are sent");
}
