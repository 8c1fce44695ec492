//! Topics: written and read back, also with names that have the characters of topics.

use descan::fleet::{FleetTopic, GatewayName, TopicPath};

fn name(text: &str) -> GatewayName {
    text.parse().unwrap()
}

#[test]
fn topics_are_read_back_as_they_were_written() {
    let gateway = name("boiler-17");
    for path in [
        TopicPath::Status,
        TopicPath::Event,
        TopicPath::Bus("can0".to_owned()),
        TopicPath::Bus("slcan:/dev/ttyACM0".to_owned()),
        TopicPath::Bus("100 % + # é".to_owned()),
        TopicPath::Device("udp:239.74.163.1".to_owned(), 127),
        TopicPath::Finding("-".to_owned(), "file-shape.12.a/b".to_owned()),
    ] {
        let topic = path.of(&gateway);
        assert!(topic.is_ascii() && !topic.contains(['+', '#', ' ']), "{topic}");
        let parsed = FleetTopic::parse(topic.as_bytes()).unwrap();
        assert_eq!((parsed.gateway, parsed.path), (gateway.clone(), path), "{topic}");
    }
    assert_eq!(
        TopicPath::Device("can0".to_owned(), 12).of(&gateway),
        "descan/v1/boiler-17/device/can0/12"
    );
}

#[test]
fn topics_of_other_programs_are_none() {
    for topic in [
        "",
        "descan",
        "descan/v1",
        "descan/v1/x",
        "descan/v1/x/",
        "descan/v2/x/status",
        "descan/v1//status",
        "descan/v1/../status",
        "descan/v1/x/status/more",
        "descan/v1/x/device/can0/256",
        "descan/v1/x/device/can0/012",
        "descan/v1/x/device/can0/+1",
        "descan/v1/x/device//12",
        "descan/v1/x/bus/%",
        "descan/v1/x/bus/%zz",
        "descan/v1/a b/status",
        "homeassistant/sensor/x/config",
    ] {
        let parsed = FleetTopic::parse(topic.as_bytes());
        assert_eq!(parsed, None, "{topic}");
    }
    assert_eq!(FleetTopic::parse(b"descan/v1/\xFF/status"), None);
    let long = format!("descan/v1/x/bus/{}", "b".repeat(5000));
    assert_eq!(FleetTopic::parse(long.as_bytes()), None);
}

#[test]
fn topic_levels_have_no_control_characters_when_shown() {
    let parsed = FleetTopic::parse(b"descan/v1/x/bus/%1B%5B31m").unwrap();
    assert_eq!(parsed.path, TopicPath::Bus("\\x1B[31m".to_owned()));
}

#[test]
fn gateway_names_are_short_and_plain() {
    for good in ["a", "boiler-17", "SITE_2.north", &"x".repeat(64)] {
        assert_eq!(name(good).as_str(), good);
    }
    for bad in ["", ".", "..", "a/b", "a b", "+", "#", "é", "$SYS", &"x".repeat(65)] {
        assert!(bad.parse::<GatewayName>().is_err(), "{bad:?}");
    }
}
