//! A gateway compared with the des.json of its site.

use descan::document::Document;
use descan::finding::CheckSection;
use descan::fleet::{ExpectedDevices, ExpectedGateway, Fleet};
use descan::time::Instant;
use std::collections::BTreeMap;

/// A device as it is published: bus, address, name, services.
type Published<'a> = (&'a str, u8, &'a str, &'a [(&'a str, &'a str)]);

fn sections(
    devices: &[Published<'_>],
    file: &str,
    buses: Option<&[&str]>,
) -> Vec<(CheckSection, String)> {
    let mut fleet = Fleet::default();
    let mut publish = |topic: String, payload: String| {
        fleet.handle_message(Instant::ZERO, topic.as_bytes(), payload.as_bytes(), true);
    };
    publish("descan/v1/x/status".to_owned(), r#"{"online":true}"#.to_owned());
    for (bus, address, name, services) in devices {
        let services: Vec<_> = services
            .iter()
            .map(|(name, version)| serde_json::json!({"name": name, "version": version}))
            .collect();
        let value = serde_json::json!({
            "bus": bus, "address": address, "name": name, "presence": "online",
            "uid": format!("UID-{name}"), "services": services, "services_known": true,
        });
        let level = bus.replace('/', "%2F");
        publish(format!("descan/v1/x/device/{level}/{address}"), value.to_string());
    }
    let document = Document::parse(file.as_bytes()).unwrap();
    let buses = buses.map(|it| it.iter().map(|name| (*name).to_owned()).collect());
    let files = vec![ExpectedDevices { document, buses }];
    let expected = ExpectedGateway { files, bitrates: BTreeMap::new() };
    let gateway = fleet.gateway(&"x".parse().unwrap()).unwrap();
    gateway.differences(&expected).into_iter().map(|it| (it.section, it.text)).collect()
}

#[test]
fn bit_rate_that_is_not_that_of_the_project_is_a_difference() {
    let mut fleet = Fleet::default();
    let buses = [("can0", 125_000), ("slcan:/dev/ttyACM0@500000", 500_000), ("can2", 250_000)];
    for (bus, rate) in buses {
        let topic = format!("descan/v1/x/bus/{}", bus.replace('/', "%2F"));
        let value = serde_json::json!({"name": bus, "bitrate": rate});
        fleet.handle_message(Instant::ZERO, topic.as_bytes(), value.to_string().as_bytes(), true);
    }
    let document = Document::parse(b"[]").unwrap();
    let files = vec![ExpectedDevices { document, buses: None }];
    let project = [("can0", 125_000), ("slcan:/dev/ttyACM0", 250_000), ("can9", 250_000)];
    let bitrates = project.map(|(bus, rate)| (bus.to_owned(), rate)).into();
    let gateway = fleet.gateway(&"x".parse().unwrap()).unwrap();
    let found = gateway.differences(&ExpectedGateway { files, bitrates });
    let [difference] = &found[..] else { panic!("{found:?}") };
    assert_eq!(difference.section, CheckSection::SettingsDiffer);
    assert_eq!(difference.bus.as_deref(), Some("slcan:/dev/ttyACM0@500000"));
    let text = "slcan:/dev/ttyACM0@500000 has 500 kbit/s; the project says 250 kbit/s.";
    assert_eq!(difference.text, text);
}

fn section(devices: &[Published<'_>], file: &str) -> Vec<CheckSection> {
    sections(devices, file, None).into_iter().map(|(section, _)| section).collect()
}

const FEED: Published<'_> = ("can0", 10, "FEED", &[("DES", "1.0"), ("AUGER", "2.1")]);

#[test]
fn equal_devices_have_no_difference() {
    for file in [
        r#"[{"name":"FEED","address":10,"static":true}]"#,
        r#"[{"name":"FEED","address":99}]"#,
        r#"[{"name":"FEED","services":[{"name":"DES","version":"1.0"},{"name":"AUGER","version":"2.1"}]}]"#,
        r#"[{"name":"FEED","bus":"can0"}]"#,
        r#"[{"name":"FEED","uid":"UID-FEED"}]"#,
    ] {
        assert_eq!(sections(&[FEED], file, None), [], "{file}");
    }
    // Debug devices are not part of the system.
    assert_eq!(section(&[FEED, ("can0", 0, "DSCAN", &[])], r#"[{"name":"FEED"}]"#), []);
}

#[test]
fn each_kind_of_difference_is_found() {
    use CheckSection::{
        Missing, NameDiffers, NotInFile, ServicesDiffer, StaticAddressTaken, WrongAddress,
    };
    let sens: Published<'_> = ("can0", 12, "SENS", &[]);
    let cases: [(&[Published<'_>], &str, &[CheckSection]); 7] = [
        (&[], r#"[{"name":"FEED","address":10}]"#, &[Missing]),
        (&[FEED], "[]", &[NotInFile]),
        (&[FEED], r#"[{"name":"FEED","address":11,"static":true}]"#, &[WrongAddress]),
        (
            &[FEED, sens],
            r#"[{"name":"FEED","address":12,"static":true},{"name":"SENS"}]"#,
            &[WrongAddress, StaticAddressTaken],
        ),
        (&[FEED], r#"[{"name":"OTHER","uid":"UID-FEED"}]"#, &[NameDiffers]),
        (
            &[FEED],
            r#"[{"name":"FEED","services":[{"name":"DES","version":"1.0"}]}]"#,
            &[ServicesDiffer],
        ),
        (
            &[FEED, ("can1", 9, "SENS", &[])],
            r#"[{"name":"FEED","bus":"can1"},{"name":"SENS"}]"#,
            &[Missing, NotInFile],
        ),
    ];
    for (devices, file, expected) in cases {
        assert_eq!(section(devices, file), expected, "{file}");
    }
}

#[test]
fn order_of_services_counts_where_the_file_has_one() {
    let list = r#"[{"name":"FEED","services":[{"name":"AUGER","version":"2.1"},{"name":"DES","version":"1.0"}]}]"#;
    assert_eq!(section(&[FEED], list), [CheckSection::ServicesDiffer]);
    let object = r#"[{"name":"FEED","services":{"AUGER":"2.1","DES":"1.0"}}]"#;
    assert_eq!(section(&[FEED], object), []);
}

#[test]
fn services_are_compared_as_check_does() {
    let device: Published<'_> = ("can0", 10, "Q", &[("DES", "1.0"), ("DOM", "3.0 x y \\x02")]);
    let file = |services: &str| format!(r#"[{{"name":"Q","services":{services}}}]"#);
    let found = |services: &str| sections(&[device], &file(services), None);
    // The strings after the version do not count, nor a version that is not listed.
    for services in [
        r#"[{"name":"DES","version":"1.0"},{"name":"DOM","version":"3.0"}]"#,
        r#"[{"name":"DES"},{"name":"DOM"}]"#,
        r#"[{"name":"DES"},{"name":"DOM","version":"3.0","extra":["z"]}]"#,
        r#"{"DOM":"3.0","DES":"1.0"}"#,
    ] {
        assert_eq!(found(services), [], "{services}");
    }
    for (services, words) in [
        (r#"[{"name":"DES","version":"1.1"},{"name":"DOM"}]"#, "DES is 1.0, not 1.1."),
        (r#"[{"name":"DOM"},{"name":"DES"}]"#, "different order or duplicates."),
        (r#"[{"name":"DES"},{"name":"DOM"},{"name":"X"}]"#, "X is missing."),
        (r#"[{"name":"DES"}]"#, "DOM 3.0 x y \\x02 is not listed."),
        (r#"[{"name":"DES"},{"name":"DOM","version":"3"}]"#, "DOM is 3.0 x y \\x02, not 3."),
    ] {
        let text = &found(services)[0].1;
        assert!(text.ends_with(words), "{services}: {text}");
    }
}

#[test]
fn entries_of_other_buses_and_doubled_ones_are_left_out() {
    assert_eq!(section(&[FEED], r#"[{"name":"FEED"},{"name":"X","bus":"can7"}]"#), []);
    let doubled = r#"[{"name":"FEED","address":10},{"name":"FEED","address":10}]"#;
    assert_eq!(section(&[FEED], doubled)[0], CheckSection::FileErrors);
    assert!(!section(&[FEED], doubled).contains(&CheckSection::Missing));
    let wrong = sections(&[FEED], r#"[{"name":"FEED","address":300}]"#, None);
    assert!(wrong[0].1.starts_with("FEED: "), "{wrong:?}");
}

#[test]
fn file_of_one_bus_is_compared_with_that_bus() {
    let other: Published<'_> = ("can1", 20, "MOTOR", &[]);
    assert_eq!(sections(&[FEED, other], r#"[{"name":"FEED"}]"#, Some(&["can0"])), []);
    let missing = sections(&[FEED, other], r#"[{"name":"MOTOR"}]"#, Some(&["can0"]));
    assert_eq!(missing.len(), 2, "{missing:?}");
}

#[test]
fn same_name_on_two_buses_is_compared_on_both() {
    let twin: Published<'_> = ("can1", 11, "FEED", FEED.3);
    let file = r#"[{"name":"FEED","address":10,"static":true}]"#;
    assert_eq!(section(&[FEED, twin], file), [CheckSection::WrongAddress]);
}

#[test]
fn entry_that_is_listed_twice_is_missing_where_its_device_is() {
    let twice = |name: &str| {
        format!(r#"[{{"name":"{name}","address":10}},{{"name":"{name}","address":10}}]"#)
    };
    assert_eq!(section(&[FEED], &twice("FEED")), [CheckSection::FileErrors]);
    let of_ghost = [
        CheckSection::FileErrors,
        CheckSection::Missing,
        CheckSection::Missing,
        CheckSection::NotInFile,
    ];
    assert_eq!(section(&[FEED], &twice("GHOST")), of_ghost);
}

#[test]
fn entry_of_another_bus_that_is_listed_twice_is_missing() {
    let devices = [FEED, ("can1", 12, "VALVE", &[] as &[_])];
    let file =
        r#"[{"name":"FEED","bus":"can1","address":10},{"name":"FEED","bus":"can1","address":10}]"#;
    let missing = section(&devices, file).iter().filter(|it| **it == CheckSection::Missing).count();
    assert_eq!(missing, 2);
}

#[test]
fn bus_with_a_bit_rate_in_its_name_is_that_of_the_project() {
    let slcan = |name| ("slcan:/dev/ttyACM0@250000", 10, name, &[] as &[_]);
    let buses: Option<&[&str]> = Some(&["slcan:/dev/ttyACM0"]);
    assert_eq!(sections(&[slcan("FEED")], r#"[{"name":"FEED","address":10}]"#, buses), []);
}

#[test]
fn suspected_conflicts_are_no_difference_and_are_listed() {
    let mut fleet = Fleet::default();
    for (id, kind, confidence) in [
        ("1", "same-name-same-address", "confirmed"),
        ("2", "same-name-same-address", "suspected"),
        ("3", "frames-repeated", "suspected"),
        ("4", "missing", "suspected"),
        ("5", "no-such-kind", "suspected"),
    ] {
        let topic = format!("descan/v1/x/finding/can0/{id}");
        let value = serde_json::json!({"kind": kind, "confidence": confidence, "text": id});
        fleet.handle_message(Instant::ZERO, topic.as_bytes(), value.to_string().as_bytes(), true);
    }
    let gateway = fleet.gateway(&"x".parse().unwrap()).unwrap();
    let expected = ExpectedGateway { files: Vec::new(), bitrates: BTreeMap::new() };
    let differences = gateway.differences(&expected);
    assert_eq!(differences.iter().map(|it| it.text.as_str()).collect::<Vec<_>>(), ["1"]);
    let suspected: Vec<&str> = gateway.suspected_conflicts().map(|it| it.text.as_str()).collect();
    assert_eq!(suspected, ["2", "3"]);
}
