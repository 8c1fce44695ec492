//! What `publish` sends of a bus over time: how much, and how often.

use descan::app::{App, AppOptions};
use descan::commands::published::PublicationFeed;
use descan::discovery::Config;
use descan::fleet::Publication;
use descan::frame::BusIndex;
use descan::sim::{DeviceAction, Scenario, Sim};
use descan::status::{BusState, BusStatus, Link};
use descan::time::{Duration, Instant};
use std::collections::BTreeMap;

/// A message: when, its topic, and the bytes of topic and payload.
type Sent = (Instant, String, usize);

/// Runs `publish` on a simulated bus with a broker that acknowledges at once.
fn sent(scenario: &Scenario, time: Duration) -> Vec<Sent> {
    let mut sim = Sim::new(scenario, 1);
    let station = sim.attach();
    let buses = vec![("can0".to_owned(), Config { seed: 7, ..Config::default() })];
    let options = AppOptions { buses, emit_events: true, ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    let bitrate = Some(scenario.bitrate);
    let status =
        BusStatus { link: Link::Up, state: BusState::ErrorActive, bitrate, ..BusStatus::default() };
    app.handle_bus(Instant::ZERO, BusIndex(0), status);
    let mut publication = Publication::new("boiler-17".parse().unwrap(), 1_795_763_731_126);
    publication.handle_connected(false);
    let mut feed = PublicationFeed::default();
    let mut all = Vec::new();
    let (mut now, end) = (Instant::ZERO, Instant::ZERO + time);
    while now < end {
        let next = [sim.next_event(), app.poll_timeout(), Some(end)];
        now = next.into_iter().flatten().min().unwrap().max(now + Duration::from_micros(1));
        sim.advance(now);
        while let Some(frame) = sim.poll_frame(station) {
            app.handle_frames(now, &[frame]);
        }
        if app.poll_timeout().is_some_and(|at| at <= now) {
            app.handle_timeout(now);
        }
        while let Some(frame) = app.poll_transmit(now) {
            sim.transmit(station, frame);
        }
        let unix_secs = 1_795_763_731.126 + now.as_secs_f64();
        if let Some(update) = feed.poll(&mut app, now) {
            update.give_to(&mut publication, now, unix_secs);
        }
        while let Some(message) = publication.poll_message() {
            publication.handle_delivered(&message.id);
            let bytes = message.topic.len() + message.payload.len();
            all.push((now, message.topic, bytes));
        }
    }
    all
}

#[test]
fn quiet_bus_of_127_devices_sends_less_than_1_kb_per_second() {
    /// The counters of devices are sent each half hour.
    const MINUTES: usize = 32;
    let scenario = Scenario::with_many_devices(125_000, 127, 5);
    let sent = sent(&scenario, Duration::from_mins(MINUTES as u64));
    let devices = sent.iter().filter(|(_, topic, _)| topic.contains("/device/"));
    let devices: BTreeMap<&str, usize> =
        devices.map(|(_, topic, bytes)| (topic.as_str(), *bytes)).collect();
    assert_eq!(devices.len(), 127, "all are published");
    // From the first minute on, in each minute.
    let mut minutes = [0; MINUTES];
    for (time, _, bytes) in &sent {
        minutes[time.as_secs_f64() as usize / 60] += bytes;
    }
    let most = minutes[1..].iter().max().unwrap() / 60;
    assert!(most < 1000, "{most} bytes per second; by minutes: {minutes:?}");
    assert!(minutes[1..].iter().all(|bytes| *bytes > 0), "a summary each 30 s: {minutes:?}");
}

#[test]
fn no_document_is_sent_more_than_once_a_second() {
    let mut scenario = Scenario::with_many_devices(125_000, 20, 3);
    // One change after another, of all kinds, 5 per second.
    for number in 0..300_u64 {
        let device = format!("N{:03}", 1 + number % 20);
        let action = match number % 5 {
            0 => DeviceAction::PowerOff,
            1 => DeviceAction::PowerOn,
            2 => DeviceAction::Reboot { services: None },
            3 => DeviceAction::Name(format!("M{number}").into_bytes()),
            _ => DeviceAction::WatchdogReset,
        };
        scenario = scenario.at(Duration::from_millis(5000 + number * 200), &device, action);
    }
    let mut last = BTreeMap::new();
    let mut changes = 0;
    for (time, topic, _) in sent(&scenario, Duration::from_secs(75)) {
        if topic.ends_with("/event") {
            continue;
        }
        changes += usize::from(topic.contains("/device/"));
        if let Some(before) = last.insert(topic.clone(), time) {
            let apart = time.since(before);
            assert!(apart >= Duration::from_secs(1), "{topic} again after {apart:?}");
        }
    }
    assert!(changes > 60, "only {changes} documents of devices");
}
