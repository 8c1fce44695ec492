//! What a gateway sends, and when: changes only, documents before the status, events in order and none
//! twice unless the connection was lost.

use descan::fleet::{
    FleetDocument, FleetMessage, FleetMessageId, MAX_QUEUED_EVENTS, MessageLength, OtherRun,
    Publication, TopicPath,
};
use descan::time::{Duration, Instant};
use serde_json::{Value, json};

const COUNTERS: &[&str] = &["frames", "heartbeat.count"];

fn publication() -> Publication {
    Publication::new("boiler-17".parse().unwrap(), 1000)
}

fn at(seconds: u64) -> Instant {
    Instant::ZERO + Duration::from_secs(seconds)
}

fn document(bus: &str, value: Value) -> FleetDocument {
    FleetDocument {
        path: TopicPath::Bus(bus.to_owned()),
        value,
        counters: COUNTERS,
        counter_period: Duration::from_secs(30),
    }
}

/// Everything that is sent now, without acknowledging it.
fn sent(publication: &mut Publication) -> Vec<FleetMessage> {
    std::iter::from_fn(|| publication.poll_message()).collect()
}

/// Topics after the name of the gateway, with the content; everything is acknowledged.
fn delivered(publication: &mut Publication) -> Vec<(String, Value)> {
    let mut all = Vec::new();
    loop {
        let messages = sent(publication);
        if messages.is_empty() {
            return all;
        }
        for message in messages {
            publication.handle_delivered(&message.id);
            let topic = message.topic.strip_prefix("descan/v1/boiler-17/").unwrap().to_owned();
            all.push((topic, serde_json::from_slice(&message.payload).unwrap_or(Value::Null)));
        }
    }
}

fn topics(messages: &[(String, Value)]) -> Vec<&str> {
    messages.iter().map(|(topic, _)| topic.as_str()).collect()
}

/// A connected publication whose only document, that of `can0`, the broker has.
fn publication_of_can0() -> Publication {
    let mut publication = publication();
    publication.handle_connected(false);
    publication.handle_documents(at(0), 0.0, [document("can0", json!({}))]);
    delivered(&mut publication);
    publication
}

#[test]
fn nothing_is_sent_before_the_broker_is_connected() {
    let mut publication = publication();
    publication.handle_documents(at(0), 1.0, [document("can0", json!({"state": "up"}))]);
    publication.handle_event(json!({"event": "named"}));
    assert_eq!(sent(&mut publication), []);
    publication.handle_connected(false);
    assert_eq!(topics(&delivered(&mut publication)), ["bus/can0", "event"]);
}

#[test]
fn status_follows_the_documents() {
    let mut publication = publication();
    publication.handle_status(1.0, json!({"devices": 3}));
    publication.handle_documents(
        at(0),
        1.0,
        [document("zz", json!({})), document("aa", json!({}))],
    );
    publication.handle_connected(false);
    let messages = delivered(&mut publication);
    assert_eq!(topics(&messages), ["bus/aa", "bus/zz", "status"]);
    let status = &messages[2].1;
    assert_eq!(status["online"], true);
    assert_eq!((&status["devices"], &status["started_ms"]), (&json!(3), &json!(1000)));
}

#[test]
fn only_changes_are_sent_and_counters_once_a_period() {
    let mut publication = publication();
    publication.handle_connected(false);
    let mut at_second = |second: u64, value: Value| {
        publication.handle_documents(at(second), second as f64, [document("can0", value)]);
        delivered(&mut publication).len()
    };
    let value = |state: &str, frames: u64, count: Option<u64>| json!({"state": state, "frames": frames, "heartbeat": {"count": count}});
    assert_eq!(at_second(0, value("up", 1, None)), 1);
    assert_eq!(at_second(1, value("up", 1, None)), 0);
    assert_eq!(at_second(2, value("up", 2, None)), 0, "a counter");
    assert_eq!(at_second(3, value("up", 3, Some(1))), 1, "a counter that was not known");
    assert_eq!(at_second(3, value("up", 3, None)), 0, "a counter that is not known any more");
    assert_eq!(at_second(3, value("up", 3, Some(1))), 0);
    assert_eq!(at_second(4, value("down", 4, Some(2))), 1, "no counter");
    let sent: usize = (5..35).map(|second| at_second(second, value("down", second, Some(2)))).sum();
    assert_eq!(sent, 1, "once in the period");
    let sent: usize =
        (35..95).map(|second| at_second(second, value("down", second, Some(2)))).sum();
    assert_eq!(sent, 2, "once in each period");
    let sent: usize = (95..200).map(|second| at_second(second, value("down", 95, Some(2)))).sum();
    assert!(sent <= 1, "the last one, then nothing changed");
}

#[test]
fn counters_of_many_documents_do_not_come_in_bursts() {
    let mut publication = publication();
    publication.handle_connected(false);
    let mut most = 0;
    for second in 0..120 {
        let all = (0..100).map(|bus| document(&format!("can{bus}"), json!({"frames": second})));
        publication.handle_documents(at(second), 0.0, all);
        let count = delivered(&mut publication).len();
        most = if second == 0 { 0 } else { most.max(count) };
    }
    // 100 in 30 seconds.
    assert!((1..20).contains(&most), "{most} in a second");
}

#[test]
fn what_disappears_is_cleared_once() {
    let mut publication = publication();
    publication.handle_connected(false);
    let both = || [document("can0", json!({})), document("can1", json!({}))];
    publication.handle_documents(at(0), 0.0, both());
    publication.handle_status(0.0, json!({}));
    delivered(&mut publication);
    for second in 1..4 {
        publication.handle_documents(at(second), 1.0, [document("can0", json!({}))]);
        let messages = delivered(&mut publication);
        let cleared = [("bus/can1".to_owned(), Value::Null)];
        assert_eq!(messages, if second == 1 { &cleared[..] } else { &[] }, "second {second}");
    }
    publication.handle_documents(at(5), 5.0, both());
    assert_eq!(topics(&delivered(&mut publication)), ["bus/can1"], "it came back");
}

#[test]
fn documents_of_an_earlier_run_are_cleared() {
    let mut publication = publication_of_can0();
    for topic in [
        "descan/v1/boiler-17/device/can0/9",
        "descan/v1/boiler-17/bus/can0",
        // Neither that of another gateway, nor one with a longer name.
        "descan/v1/boiler-1/bus/can0",
        "descan/v1/boiler-171/bus/can0",
    ] {
        assert_eq!(publication.handle_message(topic, b"{}", true), OtherRun::None);
    }
    // Cleared already.
    publication.handle_message("descan/v1/boiler-17/device/can0/8", b"", true);
    // Not kept: an event, or a document that was just sent.
    publication.handle_message("descan/v1/boiler-17/device/can0/7", b"{}", false);
    publication.handle_message("descan/v1/boiler-17/event", b"{}", false);
    assert_eq!(delivered(&mut publication), [("device/can0/9".to_owned(), Value::Null)]);
}

/// A status at the broker, and what it is to the publication that started at 1000; the number of messages
/// that are sent because of it.
fn other_status(publication: &mut Publication, text: &str, is_kept: bool) -> (OtherRun, usize) {
    let topic = "descan/v1/boiler-17/status";
    let other = publication.handle_message(topic, text.as_bytes(), is_kept);
    (other, delivered(publication).len())
}

fn status(online: bool, started: u64) -> String {
    json!({"online": online, "started_ms": started}).to_string()
}

#[test]
fn later_of_two_programs_with_one_name_stays() {
    let mut publication = publication_of_can0();
    for is_kept in [true, false] {
        let own = status(true, 1000);
        assert_eq!(other_status(&mut publication, &own, is_kept), (OtherRun::None, 0));
        // An earlier one may have changed documents.
        for text in [&status(true, 10), &status(false, 10), "no json", &status(true, u64::MAX)] {
            publication.handle_status(0.0, json!({}));
            delivered(&mut publication);
            let other = other_status(&mut publication, text, is_kept);
            assert_eq!(other, (OtherRun::None, 2), "{text}");
            // Many of them do not let it send all again and again.
            let other = other_status(&mut publication, text, is_kept);
            assert_eq!(other, (OtherRun::None, 0), "{text}");
        }
    }
    let later = status(true, 2000);
    assert_eq!(other_status(&mut publication, &later, false), (OtherRun::Later, 0));
    publication.handle_disconnected();
    publication.handle_connected(true);
    delivered(&mut publication);
    for text in [status(true, 1001), status(false, 1001)] {
        assert_eq!(other_status(&mut publication, &text, true), (OtherRun::Later, 0));
    }
}

/// Two programs of the same millisecond: the one with the higher number stays.
#[test]
fn later_of_two_programs_of_one_moment_is_told_by_its_number() {
    let mut publication = publication().with_instance(50);
    publication.handle_connected(false);
    publication.handle_status(0.0, json!({}));
    let sent = delivered(&mut publication);
    assert_eq!((&sent[0].1["instance"], &sent[0].1["started_ms"]), (&json!(50), &json!(1000)));
    let status = |instance: u64| json!({"online": true, "started_ms": 1000, "instance": instance});
    let of = |publication: &mut Publication, instance: u64| {
        other_status(publication, &status(instance).to_string(), false).0
    };
    assert_eq!(of(&mut publication, 50), OtherRun::None);
    assert_eq!(of(&mut publication, 49), OtherRun::None);
    assert_eq!(of(&mut publication, 51), OtherRun::Later);
}

#[test]
fn earlier_run_by_a_clock_ahead_is_no_other_program() {
    let mut publication = publication();
    publication.handle_connected(false);
    publication.handle_status(0.0, json!({"devices": 3}));
    delivered(&mut publication);
    let kept = status(true, 5000);
    assert_eq!(other_status(&mut publication, &kept, true), (OtherRun::None, 1));
    // From now on it is the later one.
    let will: Value = serde_json::from_slice(&publication.last_will().payload).unwrap();
    assert_eq!(will["started_ms"], 5001);
    assert_eq!(other_status(&mut publication, &status(true, 5000), false), (OtherRun::None, 1));
    publication.handle_event(json!({}));
    assert_eq!(delivered(&mut publication)[0].1["started_ms"], 5001);
}

#[test]
fn documents_of_an_absent_broker_that_are_gone_are_never_sent() {
    let mut publication = publication_of_can0();
    publication.handle_disconnected();
    for number in 0..1000 {
        let documents = [document(&format!("bus{number}"), json!({}))];
        publication.handle_documents(at(number), 0.0, documents);
    }
    publication.handle_connected(true);
    let sent = delivered(&mut publication);
    assert_eq!(topics(&sent), ["bus/bus999", "bus/can0"]);
    assert_eq!(sent[1].1, Value::Null, "gone");
}

#[test]
fn later_run_after_lost_connections_is_noticed() {
    let mut publication = publication();
    for _ in 0..3 {
        publication.handle_connected(false);
        publication.handle_disconnected();
    }
    publication.handle_connected(false);
    publication.handle_status(0.0, json!({}));
    delivered(&mut publication);
    // By a clock that was ahead.
    assert_eq!(other_status(&mut publication, &status(false, 5000), true).0, OtherRun::None);
    assert_eq!(other_status(&mut publication, &status(true, 6000), true).0, OtherRun::Later);
}

#[test]
fn lost_session_sends_all_documents_again() {
    let mut publication = publication();
    publication.handle_connected(false);
    publication.handle_documents(
        at(0),
        0.0,
        [document("can0", json!({})), document("can1", json!({}))],
    );
    publication.handle_status(0.0, json!({}));
    assert_eq!(delivered(&mut publication).len(), 3);
    publication.handle_disconnected();
    publication.handle_connected(true);
    // The last will replaced it.
    assert_eq!(topics(&delivered(&mut publication)), ["status"]);
    publication.handle_disconnected();
    publication.handle_connected(false);
    assert_eq!(topics(&delivered(&mut publication)), ["bus/can0", "bus/can1", "status"]);
}

/// A publication of `can0` and its status, connected again with a kept session.
fn publication_connected_again() -> Publication {
    let mut publication = publication_of_can0();
    assert!(publication.poll_reading());
    publication.handle_status(0.0, json!({}));
    delivered(&mut publication);
    publication.handle_disconnected();
    publication.handle_connected(true);
    assert_eq!(topics(&delivered(&mut publication)), ["status"]);
    publication
}

#[test]
fn kept_session_without_the_last_will_sends_all_documents_again() {
    let lost = |connection: u64| json!({"online": false, "reason": "lost", "started_ms": 1000, "connection": connection});
    let online =
        |connection: u64| json!({"online": true, "started_ms": 1000, "connection": connection});
    // The status, whether it was kept; what is sent. Numbers: this is the second connection.
    let cases = [
        (lost(1), true, false),
        // A connection whose begin this end did not see.
        (lost(2), true, false),
        (lost(0), true, true),
        (online(1), true, true),
        (json!({"online": false, "reason": "stopped", "started_ms": 1000}), true, true),
        // There was none: the own one comes first.
        (online(2), false, true),
        // They waited in the session.
        (online(1), false, false),
        (lost(1), false, false),
    ];
    for (status, is_kept, is_outdated) in cases {
        let mut publication = publication_connected_again();
        other_status_is(&mut publication, &status, is_kept);
        assert_eq!(publication.poll_reading(), is_outdated, "{status}, kept: {is_kept}");
        let sent = delivered(&mut publication);
        let expected: &[&str] = if is_outdated { &["bus/can0", "status"] } else { &[] };
        assert_eq!(topics(&sent), expected, "{status}, kept: {is_kept}");
        // Only the first one tells.
        for connection in [1, 2] {
            other_status_is(&mut publication, &online(connection), false);
            if is_kept {
                assert!(!publication.poll_reading(), "{status}");
            }
        }
    }
}

fn other_status_is(publication: &mut Publication, status: &Value, is_kept: bool) {
    let payload = status.to_string();
    let topic = "descan/v1/boiler-17/status";
    let other = publication.handle_message(topic, payload.as_bytes(), is_kept);
    assert_eq!(other, OtherRun::None);
}

#[test]
fn lost_message_is_sent_again_in_its_order() {
    let mut publication = publication();
    publication.handle_connected(false);
    for number in 1..=3 {
        publication.handle_event(json!({"number": number}));
    }
    let messages = sent(&mut publication);
    publication.handle_event(json!({"number": 4}));
    publication.handle_disconnected();
    publication.handle_delivered(&messages[0].id);
    publication.handle_undelivered(&messages[2].id);
    publication.handle_undelivered(&messages[1].id);
    publication.handle_connected(false);
    let numbers: Vec<u64> =
        delivered(&mut publication).iter().map(|(_, it)| it["seq"].as_u64().unwrap()).collect();
    assert_eq!(numbers, [2, 3, 4]);
    assert!(publication.is_delivered());
}

#[test]
fn newer_document_is_not_replaced_by_the_lost_one() {
    let mut publication = publication();
    publication.handle_connected(false);
    publication.handle_documents(at(0), 0.0, [document("can0", json!({"state": "old"}))]);
    let old = sent(&mut publication).remove(0);
    publication.handle_documents(at(1), 1.0, [document("can0", json!({"state": "new"}))]);
    publication.handle_undelivered(&old.id);
    let messages = delivered(&mut publication);
    assert_eq!(messages.len(), 1);
    assert_eq!(messages[0].1["state"], "new");
    // Cleared, and there again before that was acknowledged.
    publication.handle_documents(at(2), 2.0, []);
    let clear = sent(&mut publication).remove(0);
    publication.handle_documents(at(3), 3.0, [document("can0", json!({"state": "back"}))]);
    publication.handle_delivered(&clear.id);
    assert_eq!(delivered(&mut publication)[0].1["state"], "back");
}

#[test]
fn events_that_wait_are_bounded_and_the_drop_is_counted() {
    let mut publication = publication();
    for number in 0..MAX_QUEUED_EVENTS + 5 {
        publication.handle_event(json!({"number": number}));
    }
    assert_eq!(publication.dropped_events(), 5);
    publication.handle_status(0.0, json!({}));
    publication.handle_connected(false);
    let messages = delivered(&mut publication);
    assert_eq!(messages[0].1["events"], json!({"last": MAX_QUEUED_EVENTS + 5, "dropped": 5}));
    assert_eq!(messages[1].1["number"], 5, "the oldest are dropped");
    assert_eq!(messages.len(), MAX_QUEUED_EVENTS + 1);
    // By their length, too.
    let long = "x".repeat(1 << 20);
    (0..20).for_each(|_| publication.handle_event(json!({"text": long})));
    publication.handle_disconnected();
    assert!(publication.dropped_events() > 10, "{}", publication.dropped_events());
}

#[test]
fn few_messages_are_on_the_way_at_once() {
    let mut publication = publication();
    publication.handle_connected(false);
    (0..1000).for_each(|number| publication.handle_event(json!({"number": number})));
    let first = sent(&mut publication);
    assert_eq!(first.len(), 64);
    publication.handle_delivered(&first[0].id);
    assert_eq!(sent(&mut publication).len(), 1);
}

#[test]
fn last_will_and_farewell_are_retained_as_the_status() {
    let mut publication = publication();
    let will = publication.last_will();
    let value: Value = serde_json::from_slice(&will.payload).unwrap();
    assert_eq!(will.topic, "descan/v1/boiler-17/status");
    assert!(will.is_retained);
    assert_eq!(
        value,
        json!({
            "online": false, "reason": "lost", "descan": env!("CARGO_PKG_VERSION"), "started_ms": 1000,
            "instance": 0, "connection": 1,
        })
    );
    publication.handle_connected(false);
    publication.handle_stop(9.0);
    let (topic, value) = delivered(&mut publication).remove(0);
    assert_eq!((topic.as_str(), &value["reason"]), ("status", &json!("stopped")));
    assert_eq!(value["descan"], env!("CARGO_PKG_VERSION"));
    assert_eq!(value["online"], false);
}

#[test]
fn refused_messages_are_counted_and_not_sent_again() {
    let mut publication = publication();
    publication.handle_connected(false);
    publication.handle_documents(at(0), 0.0, [document("can0", json!({}))]);
    let message = sent(&mut publication).remove(0);
    assert!(matches!(message.id, FleetMessageId::Document(..)));
    publication.handle_refused(&message.id);
    assert_eq!((publication.refused(), publication.is_delivered()), (1, true));
    assert_eq!(sent(&mut publication), []);
}

/// The right to write them may be given later.
#[test]
fn refused_documents_are_tried_again_one_with_each_status() {
    let mut publication = publication();
    publication.handle_connected(false);
    let all = || ["can0", "can1", "can2"].map(|bus| document(bus, json!({})));
    publication.handle_documents(at(0), 0.0, all());
    for message in sent(&mut publication) {
        publication.handle_refused(&message.id);
    }
    let mut tried = Vec::new();
    for round in 1..=4 {
        publication.handle_documents(at(round), 0.0, all());
        publication.handle_status(0.0, json!({}));
        for message in sent(&mut publication) {
            if message.topic.ends_with("status") {
                publication.handle_delivered(&message.id);
            } else {
                tried.push(message.topic.clone());
                publication.handle_refused(&message.id);
            }
        }
    }
    let of = |bus: &str| format!("descan/v1/boiler-17/bus/{bus}");
    assert_eq!(tried, ["can0", "can1", "can2", "can0"].map(of));
    // The next one is taken: all are sent.
    publication.handle_status(0.0, json!({}));
    let sent = delivered(&mut publication);
    assert_eq!(topics(&sent), ["bus/can1", "status", "bus/can0", "bus/can2"]);
    publication.handle_status(0.0, json!({}));
    assert_eq!(topics(&delivered(&mut publication)), ["status"]);
}

#[test]
fn document_above_the_limit_of_the_broker_is_cleared_there() {
    let mut publication = publication();
    publication.set_max_message(200);
    publication.handle_connected(false);
    let taken = |publication: &mut Publication| {
        let messages = sent(publication);
        for message in &messages {
            publication.handle_delivered(&message.id);
        }
        messages
    };
    let change = |publication: &mut Publication, second, length: usize| {
        let content = json!({"text": "x".repeat(length)});
        publication.handle_documents(at(second), 0.0, [document("can0", content)]);
        taken(publication)
    };
    assert!(!change(&mut publication, 0, 10)[0].payload.is_empty());
    // What the broker had would be out of date.
    let sent = change(&mut publication, 5, 300);
    assert_eq!((sent[0].length, &*sent[0].payload), (MessageLength::Cleared, &b""[..]));
    assert!(sent[0].is_retained);
    assert_eq!((sent.len(), publication.refused()), (1, 1));
    // A connection to a broker that takes more.
    publication.handle_disconnected();
    publication.set_max_message(1000);
    publication.handle_connected(true);
    let sent = taken(&mut publication);
    assert!(sent.iter().any(|it| it.topic.ends_with("bus/can0") && it.payload.len() > 300));
    assert!(!change(&mut publication, 10, 20)[0].payload.is_empty());
}

#[test]
fn document_whose_topic_is_above_the_limit_is_not_sent() {
    let mut publication = publication();
    publication.set_max_message(10);
    publication.handle_connected(false);
    publication.handle_documents(at(0), 0.0, [document("can0", json!({}))]);
    let messages = sent(&mut publication);
    assert!(messages.iter().any(|it| it.topic.ends_with("bus/can0")));
    for message in &messages {
        assert_eq!(message.length, MessageLength::TooLong, "{message:?}");
        publication.handle_refused(&message.id);
    }
    assert_eq!(publication.refused(), messages.len() as u64);
    assert_eq!(publication.poll_message(), None, "the connection would end with each");
}

#[test]
fn event_above_the_limit_of_the_broker_is_known() {
    let mut publication = publication();
    publication.set_max_message(200);
    publication.handle_connected(false);
    publication.handle_event(json!({"event": "x".repeat(300)}));
    let message = sent(&mut publication).remove(0);
    assert!(message.length == MessageLength::TooLong && !message.is_retained);
}
