//! A gateway compared with the des.json of its site.

use descan::document::Document;
use descan::finding::CheckSection;
use descan::fleet::{ExpectedDevices, Fleet};
use descan::time::Instant;

/// A device as it is published: bus, address, name, services.
type Published<'a> = (&'a str, u8, &'a str, &'a [(&'a str, &'a str)]);

fn sections(
    devices: &[Published<'_>],
    file: &str,
    buses: Option<&[&str]>,
) -> Vec<(CheckSection, String)> {
    let mut fleet = Fleet::default();
    let mut publish = |topic: String, payload: String| {
        fleet.handle_message(Instant::ZERO, topic.as_bytes(), payload.as_bytes());
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
        publish(format!("descan/v1/x/device/{bus}/{address}"), value.to_string());
    }
    let document = Document::parse(file.as_bytes()).unwrap();
    let buses = buses.map(|it| it.iter().map(|name| (*name).to_owned()).collect());
    let expected = [ExpectedDevices { document, buses }];
    let gateway = fleet.gateway(&"x".parse().unwrap()).unwrap();
    gateway.differences(&expected).into_iter().map(|it| (it.section, it.text)).collect()
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
        (&[FEED], r#"[{"name":"FEED","bus":"can1"}]"#, &[Missing, NotInFile]),
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
