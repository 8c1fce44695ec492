//! `descan kit --lang rust`: the configuration of the node, as written and as compiled.

#[path = "../../kit/des_config.rs"]
mod written;

use super::node::start;
use super::{BoardSpec, NAME, SERVICES, des_request};
use descan::kit::{self, KitDevice};
use descan::node::{Node, NodeConfig, NodeDevice, NodeFrame, NodeSettings, Slot};
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::Address;
use descan::wire::node::Uid;
use descan::wire::profile::Profile;
use std::process::Command;

const PROFILE: &str = include_str!("../../kit/profile.toml");
const WRITTEN: &str = include_str!("../../kit/des_config.rs");

fn profile() -> Profile {
    Profile::parse(PROFILE).unwrap()
}

fn device(name: &str) -> KitDevice {
    let services = [("DES", "1.0"), ("FEED-DATA", "2.1"), ("LOG", "0.3")];
    let services = services.map(|(name, version)| (name.to_owned(), version.to_owned()));
    KitDevice { name: name.to_owned(), services: services.to_vec(), has_fd: false }
}

#[test]
fn written_configuration_is_the_compiled_one() {
    assert_eq!(kit::rust_config(&device("FEED"), &profile()).unwrap(), WRITTEN);
}

#[test]
fn compiled_configuration_has_the_values_of_the_profile() {
    assert_eq!(written::CONFIG, NodeConfig::from_profile(&profile()));
    let device = NodeDevice {
        services: &[&["DES", "1.0"], &["FEED-DATA", "2.1"], &["LOG", "0.3"]],
        ..NodeDevice::named("FEED")
    };
    assert_eq!(written::DEVICE, device);
}

#[test]
fn configuration_of_another_profile_has_its_values() {
    let profile = Profile::parse(
        "framing = \"isotp\"\n[services]\ndes = 0x123\n[descriptor]\nsn = 0x345\nbyte_order = \"big\"\n\
         [writes]\naddress = 0x016\neffect = \"restart\"\n\
         [heartbeat]\nperiod_ms = 250\nerror_offset = false\n[modes]\nWORK = 9\n",
    )
    .unwrap();
    let text = kit::rust_config(&device("котёл \"1\"\\\u{202e}"), &profile).unwrap();
    for line in [
        "    ..NodeDevice::named(\"котёл \\\"1\\\"\\\\\\u{202e}\")",
        "    heartbeat: Service::from_bits(0x001), // assumed",
        "    des: Service::from_bits(0x123),",
        "        Some(Service::from_bits(0x345)), // sn",
        "    identify: None, // not in the profile",
        "    mode: None, // not in the profile",
        "    reboot: None, // not in the profile",
        "    write_address: Some(Service::from_bits(0x016)),",
        "    write_bitrate: None, // not in the profile",
        "    write_effect: WriteEffect::Restart,",
        "    heartbeat_ms: 250,",
        "    error_offset: None,",
        "        9, // WORK",
        "        6, // IDLE, assumed",
        "    byte_order: ByteOrder::Big,",
        "    has_raw_framing: false,",
    ] {
        assert!(text.lines().any(|it| it == line), "{line}: {text}");
    }
}

#[test]
fn node_with_the_written_configuration_answers() {
    let address = AddressSetting::Fixed(Address::from_bits(12));
    let uid = Uid(BoardSpec::new(12).uid);
    let settings = NodeSettings { uid, address, autostart: true, ..NodeSettings::BLANK };
    let mut node: Node = Node::new(&written::CONFIG, &written::DEVICE, settings, 7);
    let now = start(&mut node);
    let mut answer = |data: &[u8]| {
        let request = des_request(data);
        node.handle_frame(now, &NodeFrame::classic(request.id, &request.data).unwrap());
        node.handle_timeout(now);
        let frame = node.poll_transmit(Slot::Response).unwrap();
        node.handle_transmitted(now, Slot::Response, true);
        frame.data().to_vec()
    };
    assert_eq!(answer(NAME), b"\x06\x01FEED\0");
    assert_eq!(answer(SERVICES), b"\x10\x22\x02\0DES\0");
}

#[test]
fn command_writes_the_configuration_for_rust() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("profile.toml"), PROFILE).unwrap();
    let run = |rest: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(["kit", "--name", "FEED", "--services", "FEED-DATA=2.1,LOG=0.3"]);
        command.args(["--profile", "profile.toml", "--lang", "rust"]).args(rest);
        let output = command.current_dir(folder.path()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        output
    };
    assert_eq!(run(&[]).stdout, WRITTEN.as_bytes());
    run(&["--write", "src"]);
    let files = std::fs::read_dir(folder.path().join("src")).unwrap();
    let names: Vec<_> = files.map(|it| it.unwrap().file_name()).collect();
    assert_eq!(names, ["des_config.rs"]);
    let file = std::fs::read(folder.path().join("src/des_config.rs")).unwrap();
    assert_eq!(file, WRITTEN.as_bytes());
}
