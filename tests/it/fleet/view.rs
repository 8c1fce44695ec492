//! What a viewer makes of messages: gateways, states, versions; hostile content is counted.

use descan::fleet::{Fleet, GatewayName, GatewayState, MAX_DOCUMENT_BYTES, MAX_GATEWAYS};
use descan::time::{Duration, Instant};

const NOW: Instant = Instant::ZERO;

fn fleet(messages: &[(&str, &str)]) -> Fleet {
    let mut fleet = Fleet::default();
    for (topic, payload) in messages {
        fleet.handle_message(
            NOW,
            format!("descan/v1/{topic}").as_bytes(),
            payload.as_bytes(),
            true,
        );
    }
    fleet
}

fn name(text: &str) -> GatewayName {
    text.parse().unwrap()
}

fn state(fleet: &Fleet, gateway: &str, now: Instant) -> GatewayState {
    fleet.gateway(&name(gateway)).unwrap().state(now)
}

const FEED: &str = r#"{"bus":"can0","address":10,"name":"FEED","presence":"online","services_known":true,
    "services":[{"name":"AUGER","version":"2.1","extra":["x"]}]}"#;

#[test]
fn gateways_have_the_state_that_their_status_says() {
    use GatewayState::{Lost, Online, Silent, Stopped, Unknown};
    let fleet = fleet(&[
        ("a/status", r#"{"online":true}"#),
        ("b/status", r#"{"online":false,"reason":"lost"}"#),
        ("c/status", r#"{"online":false,"reason":"stopped"}"#),
        ("d/bus/can0", r#"{"name":"can0"}"#),
    ]);
    let states = |now| ["a", "b", "c", "d"].map(|gateway| state(&fleet, gateway, now));
    assert_eq!(states(NOW), [Online, Lost, Stopped, Unknown]);
    assert_eq!(states(NOW + Duration::from_secs(75)), [Online, Lost, Stopped, Unknown]);
    assert_eq!(states(NOW + Duration::from_secs(76)), [Silent, Lost, Stopped, Unknown]);
}

#[test]
fn documents_are_replaced_and_cleared() {
    let mut fleet = fleet(&[("a/device/can0/10", FEED), ("a/device/can0/10", FEED)]);
    let devices = |fleet: &Fleet| fleet.gateway(&name("a")).map(|it| it.devices().count());
    assert_eq!(devices(&fleet), Some(1));
    fleet.handle_message(NOW, b"descan/v1/a/device/can0/10", b"", true);
    assert_eq!(devices(&fleet), None, "a gateway without documents is none");
    fleet.handle_message(NOW, b"descan/v1/a/device/can0/10", b"", true);
    assert_eq!(fleet.gateways().len(), 0);
}

#[test]
fn topic_decides_bus_and_address() {
    let fleet = fleet(&[("a/device/can7/99", FEED)]);
    let device = fleet.gateway(&name("a")).unwrap().devices().next().unwrap().clone();
    assert_eq!((device.bus.as_str(), device.address), ("can7", 99));
}

#[test]
fn document_that_is_not_used_is_of_its_gateway() {
    let long = "x".repeat(MAX_DOCUMENT_BYTES + 1);
    for topic in ["b/device/can0/50", "b/bus/can0", "b/status", "b/device/can0/300"] {
        let mut fleet =
            fleet(&[("a/device/can0/10", FEED), ("b/device/can0/10", FEED), (topic, &long)]);
        let of =
            |fleet: &Fleet, gateway| fleet.rejects().of_gateway(&name(gateway)).map(str::to_owned);
        assert!(of(&fleet, "b").unwrap().starts_with(&format!("descan/v1/{topic}: ")), "{topic}");
        for other in ["a", "B", "bb", "c"] {
            assert_eq!(of(&fleet, other), None, "{topic} {other}");
        }
        fleet.handle_message(NOW, format!("descan/v1/{topic}").as_bytes(), b"", true);
        assert_eq!(of(&fleet, "b"), None, "cleared");
    }
    // However many one gateway has, of others nothing is doubtful.
    let mut fleet = Fleet::default();
    for number in 0..5000 {
        let topic = format!("descan/v1/evil/bus/{number}");
        fleet.handle_message(NOW, topic.as_bytes(), b"[]", true);
    }
    fleet.handle_message(NOW, b"descan/v1/b/bus/can0", b"[]", true);
    let rejects = fleet.rejects();
    assert_eq!(rejects.of_gateway(&name("a")), None);
    assert!(
        rejects.of_gateway(&name("b")).is_some() && rejects.of_gateway(&name("evil")).is_some()
    );
    assert_eq!(rejects.open_count(), 5001);
    // More gateways than are remembered: it may be any one.
    for number in 0..1001 {
        let topic = format!("descan/v1/evil{number}/bus/can0");
        fleet.handle_message(NOW, topic.as_bytes(), b"[]", true);
    }
    assert!(fleet.rejects().of_gateway(&name("a")).is_some());
}

/// Of other programs than descan.
#[test]
fn status_with_wrong_files_is_a_status() {
    for files in [r#""file":"des.json""#, r#""files":null"#, r#""file":{"path":null,"ok":true}"#] {
        let status = format!(r#"{{"online":true,"time":5,{files}}}"#);
        let fleet = fleet(&[("a/status", &status)]);
        let known = fleet.gateway(&name("a")).and_then(|gateway| gateway.status());
        assert_eq!(known.map(|status| status.file_errors().count()), Some(0), "{files}");
    }
}

#[test]
fn all_devices_of_an_address_count() {
    let second = r#"{"bus":"can0","address":10,"name":"ACT","presence":"online","services_known":true,
        "services":[{"name":"AUGER","version":"2.2"}]}"#;
    let both = FEED.trim_end_matches('}').to_owned() + &format!(r#","others":[{second}]}}"#);
    let mut fleet = fleet(&[("a/device/can0/10", &both)]);
    let names = |fleet: &Fleet| -> Vec<Option<String>> {
        let gateway = fleet.gateway(&name("a")).unwrap();
        assert!(
            gateway.devices().all(|device| (device.bus.as_str(), device.address) == ("can0", 10))
        );
        gateway.devices().map(|device| device.name.clone()).collect()
    };
    assert_eq!(names(&fleet), [Some("FEED".to_owned()), Some("ACT".to_owned())]);
    let versions: Vec<String> = fleet.versions().into_iter().map(|it| it.version).collect();
    assert_eq!(versions, ["2.1 x", "2.2"]);
    fleet.handle_message(NOW, b"descan/v1/a/device/can0/10", FEED.as_bytes(), true);
    assert_eq!(names(&fleet), [Some("FEED".to_owned())]);
}

#[test]
fn status_names_the_files_that_cannot_be_used() {
    for (files, expected) in [
        (r#""file":{"path":"des.json","ok":true,"entries":3,"error":null}"#, vec![]),
        (
            r#""file":{"path":"a\u001b[2J","ok":false,"error":"line 3: x"}"#,
            vec![("a\\x1B[2J", "line 3: x")],
        ),
        (
            r#""file":{"path":"a","error":"x"},"files":[{"path":"a","error":"x"},{"path":"b"},
               {"path":"c","error":"y"}]"#,
            vec![("a", "x"), ("c", "y")],
        ),
        (r#""period_s":30"#, vec![]),
    ] {
        let fleet = fleet(&[("a/status", &format!(r#"{{"online":true,{files}}}"#))]);
        let status = fleet.gateway(&name("a")).unwrap().status().unwrap();
        assert_eq!(status.file_errors().collect::<Vec<_>>(), expected, "{files}");
    }
}

#[test]
fn versions_count_gateways_and_present_devices() {
    let lost = FEED.replace("online", "lost");
    let fleet = fleet(&[
        ("a/device/can0/10", FEED),
        ("a/device/can0/11", FEED),
        ("b/device/can0/10", FEED),
        ("c/device/can0/10", &lost),
    ]);
    let versions = fleet.versions();
    assert_eq!(versions.len(), 1);
    let only = &versions[0];
    assert_eq!((only.service.as_str(), only.version.as_str()), ("AUGER", "2.1 x"));
    assert_eq!(only.devices, 3);
    assert_eq!(only.gateways, [name("a"), name("b")].into());
}

#[test]
fn hostile_documents_are_counted_and_change_nothing() {
    let deep = "[".repeat(60_000);
    let long = format!("{{\"name\":\"{}\"}}", "x".repeat(MAX_DOCUMENT_BYTES));
    let fleet = fleet(&[
        ("a/device/can0/10", FEED),
        ("a/device/can0/10", "not json"),
        ("a/device/can0/10", "[1,2]"),
        ("a/device/can0/10", r#"{"address":300}"#),
        ("a/device/can0/11", &deep),
        ("a/device/can0/12", &long),
        ("a/status", "\u{1b}[2J"),
        ("a/status", r#"{"online":"yes"}"#),
        ("b/bus/can0", "null"),
        ("b/bus/can0", "{}"),
        ("a/unknown/can0", "{}"),
        ("c/status", "[]"),
        ("c/status", "[true]"),
        ("c/status", "{}"),
        ("a b/status", "{}"),
    ]);
    assert_eq!(fleet.gateways().len(), 1);
    let gateway = fleet.gateway(&name("a")).unwrap();
    assert_eq!(gateway.devices().count(), 1);
    assert_eq!(gateway.devices().next().unwrap().name.as_deref(), Some("FEED"));
    let rejects = fleet.rejects();
    assert_eq!((rejects.malformed, rejects.oversized, rejects.foreign), (11, 1, 2));
    let last = rejects.last().unwrap();
    assert!(
        last.starts_with("descan/v1/a b/status: no topic") && !last.contains('\u{1b}'),
        "{last}"
    );
}

#[test]
fn causes_of_rejects_name_topic_and_fault() {
    for (topic, payload, cause) in [
        ("a/status", "[true]", "descan/v1/a/status: no JSON object"),
        ("a/status", "{}", "descan/v1/a/status: missing field `online`"),
        ("a/bus/can%1b%5b2J", "{\"name\"", "descan/v1/a/bus/can%1b%5b2J: wrong JSON: line 1"),
        (
            "a/device/can0/1",
            "{\"address\":\"x\"}",
            "descan/v1/a/device/can0/1: line 1, column 14: invalid type",
        ),
    ] {
        let fleet = fleet(&[(topic, payload)]);
        let last = fleet.rejects().last().unwrap();
        assert!(last.starts_with(cause), "{last}");
    }
}

#[test]
fn rejects_are_open_until_each_topic_is_replaced_or_cleared() {
    let mut fleet = fleet(&[
        ("a/device/can0/10", "{"),
        ("a/device/can0/10", "["),
        ("a/device/can0/11", "{"),
        ("a/nothing", "{}"),
        ("a/status", r#"{"online":true}"#),
    ]);
    let mut send = |topic: &str, payload: &str| {
        fleet.handle_message(
            NOW,
            format!("descan/v1/{topic}").as_bytes(),
            payload.as_bytes(),
            true,
        );
        let rejects = fleet.rejects();
        (rejects.open_count(), rejects.last().map(|it| it[..it.find(':').unwrap()].to_owned()))
    };
    assert_eq!(send("a/device/can0/12", FEED), (3, Some("descan/v1/a/nothing".to_owned())));
    assert_eq!(send("a/nothing", ""), (2, Some("descan/v1/a/device/can0/11".to_owned())));
    assert_eq!(send("a/device/can0/11", ""), (1, Some("descan/v1/a/device/can0/10".to_owned())));
    assert_eq!(send("a/device/can0/10", FEED), (0, None));
    assert_eq!(send("a/device/can0/10", "{"), (1, Some("descan/v1/a/device/can0/10".to_owned())));
    assert_eq!(fleet.rejects().count(), 5, "all of them");
    // Cleared while there was no connection.
    fleet.handle_connected();
    fleet.handle_message(NOW, b"descan/v1/a/status", br#"{"online":true}"#, true);
    fleet.handle_complete();
    assert_eq!(fleet.rejects().last(), None);
}

#[test]
fn rejects_of_any_number_of_topics_are_counted() {
    let mut fleet = Fleet::default();
    for number in 0..5000 {
        let topic = format!("descan/v1/{}/{number}", "x".repeat(2000));
        fleet.handle_message(NOW, topic.as_bytes(), b"{}", true);
        fleet.handle_message(NOW, format!("foreign/{number}").as_bytes(), b"{}", true);
    }
    // Topics of which the first thousand bytes are the same are one.
    assert_eq!((fleet.rejects().count(), fleet.rejects().open_count()), (10_000, 5001));
    assert_eq!(fleet.rejects().last(), Some("foreign/4999: no topic of a gateway"));
    fleet.handle_connected();
    fleet.handle_complete();
    assert_eq!((fleet.rejects().open_count(), fleet.rejects().last()), (0, None));
}

#[test]
fn causes_of_rejects_are_short() {
    let mut fleet = Fleet::default();
    let status = format!(r#"{{"online":"{}"}}"#, "\u{7f}".repeat(MAX_DOCUMENT_BYTES - 20));
    fleet.handle_message(NOW, b"descan/v1/a/status", status.as_bytes(), true);
    let last = fleet.rejects().last().unwrap();
    assert!(last.starts_with("descan/v1/a/status: ") && last.len() < 300, "{}", last.len());
}

/// Lists of empty members take twenty times the memory of their text.
#[test]
fn memory_of_one_gateway_and_of_all_is_bounded() {
    let members = vec!["{}"; MAX_DOCUMENT_BYTES / 3 - 50].join(",");
    let large = format!(r#"{{"address":1,"services_known":true,"services":[{members}]}}"#);
    let mut fleet = Fleet::default();
    let mut send = |gateway: &str, address: u8| {
        let topic = format!("descan/v1/{gateway}/device/can0/{address}");
        fleet.handle_message(NOW, topic.as_bytes(), large.as_bytes(), true);
        fleet.gateway(&name(gateway)).map_or(0, |it| it.devices().count())
    };
    let most = (1..=127).map(|address| send("evil", address)).max().unwrap();
    assert!((5..30).contains(&most), "{most}");
    // Others are not shut out, until all have too much.
    let counts: Vec<usize> = (0..40)
        .map(|number| (1..=most as u8).map(|at| send(&format!("g{number}"), at)).max().unwrap())
        .collect();
    assert_eq!(counts[0], most, "{counts:?}");
    assert_eq!(counts[39], 0, "{counts:?}");
    assert!(counts.iter().sum::<usize>() < 20 * most, "{counts:?}");
    assert!(fleet.rejects().oversized > 0);
}

#[test]
fn texts_have_no_control_characters() {
    let fleet = fleet(&[
        (
            "a/device/can0/10",
            r#"{"address":10,"name":"\u001b[31mX","mode":"\u0007","uid":"\u202e"}"#,
        ),
        (
            "a/finding/can0/x",
            r#"{"kind":"\u001b","confidence":"confirmed","text":"a\u001b]0;b\u0007","remedy":"\n"}"#,
        ),
        ("a/bus/can0", r#"{"name":"\u001b","state":"\u009b"}"#),
        ("a/status", r#"{"online":false,"descan":"\u001b[0m","reason":"\u001b"}"#),
    ]);
    let gateway = fleet.gateway(&name("a")).unwrap();
    let device = gateway.devices().next().unwrap();
    let finding = gateway.findings().next().unwrap();
    let bus = gateway.buses().next().unwrap();
    let texts = [
        device.name.as_deref().unwrap(),
        device.mode.as_deref().unwrap(),
        device.uid.as_deref().unwrap(),
        &finding.kind,
        &finding.text,
        &finding.remedy,
        &bus.name,
        bus.state.as_deref().unwrap(),
        &gateway.status().unwrap().descan,
    ];
    for text in texts {
        assert!(text.chars().all(descan::text::is_printable), "{text:?}");
    }
    assert_eq!(gateway.state(NOW), GatewayState::Lost);
}

#[test]
fn number_of_gateways_is_bounded() {
    let mut fleet = Fleet::default();
    for number in 0..MAX_GATEWAYS + 3 {
        let topic = format!("descan/v1/g{number}/status");
        fleet.handle_message(NOW, topic.as_bytes(), br#"{"online":true}"#, true);
    }
    assert_eq!(fleet.gateways().len(), MAX_GATEWAYS);
    assert_eq!(fleet.rejects().oversized, 3);
    // Known ones are still read.
    fleet.handle_message(
        NOW,
        b"descan/v1/g0/status",
        br#"{"online":false,"reason":"stopped"}"#,
        true,
    );
    assert_eq!(state(&fleet, "g0", NOW), GatewayState::Stopped);
}

#[test]
fn impossible_documents_are_not_used() {
    let fleet = fleet(&[
        ("a/finding/can0/none", "{}"),
        ("a/finding/can0/kind", r#"{"kind":"same-name-same-address"}"#),
        ("a/finding/can0/word", r#"{"kind":"missing","confidence":"CERTAIN"}"#),
        ("a/finding/can0/over", r#"{"kind":"missing","confidence":"cleared"}"#),
        ("a/finding/can0/open", r#"{"kind":"missing","confidence":"confirmed"}"#),
        ("a/device/can0/128", r#"{"address":128,"name":"X"}"#),
        ("a/device/can0/126", r#"{"address":126,"name":"X"}"#),
    ]);
    let gateway = fleet.gateway(&name("a")).unwrap();
    assert_eq!((gateway.findings().count(), gateway.devices().count()), (1, 1));
    assert_eq!((fleet.rejects().malformed, fleet.rejects().foreign), (4, 1));
}

#[test]
fn length_of_all_documents_is_bounded() {
    let mut fleet = Fleet::default();
    let text = format!(r#"{{"kind":"{}","confidence":"suspected"}}"#, "k".repeat(60_000));
    for number in 0..4000 {
        let topic = format!("descan/v1/g{}/finding/can0/{number}", number % 50);
        fleet.handle_message(NOW, topic.as_bytes(), text.as_bytes(), true);
    }
    let kept: usize = fleet.gateways().map(|(_, gateway)| gateway.findings().count()).sum();
    assert!((3200..3400).contains(&kept), "{kept}");
    assert_eq!(fleet.rejects().oversized, 4000 - kept as u64);
    // What is cleared makes room.
    fleet.handle_message(NOW, b"descan/v1/g0/finding/can0/0", b"", true);
    fleet.handle_message(NOW, b"descan/v1/g0/finding/can0/new", text.as_bytes(), true);
    assert_eq!(fleet.rejects().oversized, 4000 - kept as u64);
}

#[test]
fn documents_cleared_while_away_are_gone_afterwards() {
    let mut fleet = fleet(&[
        ("a/status", r#"{"online":true}"#),
        ("a/device/can0/10", FEED),
        ("a/device/can0/11", FEED),
        ("b/status", r#"{"online":true}"#),
    ]);
    fleet.handle_connected();
    assert_eq!(fleet.gateways().len(), 2, "kept until all is there");
    fleet.handle_message(NOW, b"descan/v1/a/status", br#"{"online":true}"#, true);
    fleet.handle_message(NOW, b"descan/v1/a/device/can0/11", FEED.as_bytes(), true);
    fleet.handle_complete();
    assert_eq!(fleet.gateways().len(), 1);
    let left: Vec<u8> = fleet.gateway(&name("a")).unwrap().devices().map(|it| it.address).collect();
    assert_eq!(left, [11]);
}

/// A status that was published meanwhile shows that the gateway is connected, whatever its clock says.
#[test]
fn kept_status_from_long_ago_or_the_future_is_old() {
    let mut fleet = Fleet::default();
    let mut send = |gateway: &str, time: f64, is_kept: bool| {
        let topic = format!("descan/v1/{gateway}/status");
        let payload = format!(r#"{{"online":true,"time":{time}}}"#);
        fleet.handle_message(NOW, topic.as_bytes(), payload.as_bytes(), is_kept);
    };
    // The document may arrive at any time: also before and after all are there.
    for (gateway, time, is_kept) in [
        ("past", 900.0, true),
        ("recent", 930.0, true),
        ("ahead", 1009.0, true),
        ("future", 1011.0, true),
        ("live-past", 0.0, false),
        ("live-future", 9000.0, false),
        ("renewed", 0.0, true),
        ("renewed", 0.0, false),
    ] {
        send(gateway, time, is_kept);
    }
    let old = |fleet: &Fleet| fleet.with_old_status(1000.0).map(ToString::to_string).collect();
    let names: Vec<String> = old(&fleet);
    assert_eq!(names, ["future", "past"]);
    fleet.handle_complete();
    fleet.handle_message(NOW, b"descan/v1/slow/status", br#"{"online":true,"time":1}"#, true);
    let names: Vec<String> = old(&fleet);
    assert_eq!(names, ["future", "past", "slow"]);
}
