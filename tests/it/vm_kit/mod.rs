//! Devices on a CAN bus of a real kernel, found, commanded and proved by descan: the kit in C
//! (tests/kit/socketcan.c) and the node in Rust (tests/kit/socketcan.rs).
//!
//! Without CAN in the kernel these tests print the reason and do not run.

mod prove;

use crate::common::can::{PATIENCE, Vcan, controllers, run};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Instant;

const PROFILE: &str = include_str!("../../kit/profile.toml");

/// Added to an address in DEV_CFG_ADDR: it is preferred, not fixed.
const PREFERRED: u8 = 0x80;

/// What a device runs.
#[derive(Clone, Copy)]
enum NodeLanguage {
    C,
    Rust,
}

/// A process that is killed at the end of the test.
struct KitProcess(Child);

impl Drop for KitProcess {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn descan(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command.args(arguments).args(["--profile", "profile.toml"]).current_dir(folder);
    command.stdin(Stdio::null()).output().unwrap()
}

/// A folder with the profile.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("profile.toml"), PROFILE).unwrap();
    folder
}

/// Compiles a device with a name, with the files that `descan kit` writes; returns the program.
fn built(folder: &Path, name: &str) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/kit/socketcan.c");
    let services = format!("{name}-DATA=2.1,LOG=0.3");
    let written =
        descan(folder, &["kit", "--name", name, "--services", &services, "--write", name]);
    assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
    let (kit, program) = (folder.join(name), folder.join(name).join("device"));
    let mut command = Command::new("cc");
    command.args(["-std=c99", "-O1", "-I"]).arg(&kit).arg(source).arg(kit.join("des.c"));
    assert!(command.arg("-o").arg(&program).status().unwrap().success());
    program
}

/// The program of the node in Rust, beside that of descan.
fn example() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_descan")).with_file_name("examples");
    let program = program.join("socketcan_node");
    assert!(program.exists(), "build it: cargo build --locked --example socketcan_node");
    program
}

/// A device of a test.
struct KitDevice<'a> {
    language: NodeLanguage,
    name: &'a str,
    /// Where it is built and has its settings.
    folder: &'a Path,
    program: PathBuf,
}

impl<'a> KitDevice<'a> {
    /// A device that prefers address 12; `autostart`: it works by itself.
    fn new(language: NodeLanguage, folder: &'a Path, name: &'a str, autostart: bool) -> Self {
        std::fs::create_dir_all(folder.join(name)).unwrap();
        let program = match language {
            NodeLanguage::C => built(folder, name),
            NodeLanguage::Rust => example(),
        };
        let device = Self { language, name, folder, program };
        let uid = format!("{name:_<6}");
        let settings = [uid.as_bytes(), &[PREFERRED + 12, 0x80, u8::from(autostart)]].concat();
        std::fs::write(device.settings(), settings).unwrap();
        device
    }

    fn settings(&self) -> PathBuf {
        self.folder.join(self.name).join("settings")
    }

    fn start(&self, bus: &str, options: &[&str]) -> KitProcess {
        let mut command = Command::new(&self.program);
        command.arg(bus).arg(self.settings()).args(options).stdout(Stdio::null());
        if matches!(self.language, NodeLanguage::Rust) {
            command.args(["--name", self.name]);
        }
        KitProcess(command.spawn().unwrap())
    }
}

/// Starts a device that prefers address 12, and works by itself.
fn started(
    language: NodeLanguage,
    folder: &Path,
    name: &str,
    bus: &str,
    options: &[&str],
) -> KitProcess {
    KitDevice::new(language, folder, name, true).start(bus, options)
}

/// Scans until both devices are in mode WORK; returns their addresses.
fn working(folder: &Path, bus: &str) -> [u64; 2] {
    let start = Instant::now();
    loop {
        let output = descan(folder, &["scan", bus, "--json", "--time", "20"]);
        let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        let address = |name: &str| {
            let devices = report["devices"].as_array()?;
            let device = devices.iter().find(|it| it["name"] == name && it["mode"] == "WORK")?;
            let service = &device["services"][1];
            assert_eq!(service["name"], format!("{name}-DATA"), "{report:#}");
            device["address"].as_u64()
        };
        if let (Some(feed), Some(sens)) = (address("FEED"), address("SENS")) {
            return [feed, sens];
        }
        assert!(start.elapsed() < 2 * PATIENCE, "{report:#}");
    }
}

fn devices_are_found_and_take_commands(language: NodeLanguage, bus: &str) {
    let Some(vcan) = Vcan::new(bus) else { return };
    let folder = folder();
    let folder = folder.path();
    let _feed = started(language, folder, "FEED", vcan.name(), &[]);
    let _sens = started(language, folder, "SENS", vcan.name(), &[]);
    let [feed, sens] = working(folder, vcan.name());
    assert!(feed != sens && (feed == 12 || sens == 12), "{feed}, {sens}");
    let moved = descan(folder, &["address", vcan.name(), "FEED", "33", "--yes"]);
    assert_eq!(moved.status.code(), Some(0), "{}", String::from_utf8_lossy(&moved.stderr));
    assert_eq!(working(folder, vcan.name())[0], 33);
    assert_eq!(std::fs::read(folder.join("FEED/settings")).unwrap()[6], 33, "stored");
    let refused = descan(folder, &["address", vcan.name(), "FEED", "preferred", "200", "--yes"]);
    assert_eq!(refused.status.code(), Some(2));
    let stopped = descan(folder, &["mode", vcan.name(), "SENS", "CFG", "--yes"]);
    assert_eq!(stopped.status.code(), Some(0), "{}", String::from_utf8_lossy(&stopped.stderr));
    let output = descan(folder, &["scan", vcan.name(), "--json", "--time", "20"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let devices = report["devices"].as_array().unwrap();
    let sens = devices.iter().find(|it| it["name"] == "SENS").unwrap();
    assert_eq!(sens["mode"], "CFG", "{report:#}");
}

#[test]
fn kit_devices_are_found_and_take_commands() {
    devices_are_found_and_take_commands(NodeLanguage::C, "dsp-kit");
}

#[test]
fn node_devices_are_found_and_take_commands() {
    devices_are_found_and_take_commands(NodeLanguage::Rust, "dsp-node");
}

/// FEED and SENS, each on its controller, the bit rate and silent mode of which they set.
fn devices_share_two_real_controllers(languages: [NodeLanguage; 2]) {
    let Some(_taken) = controllers() else { return };
    let folder = folder();
    let folder = folder.path();
    let feed = started(languages[0], folder, "FEED", "can0", &["--configure"]);
    let sens = started(languages[1], folder, "SENS", "can1", &["--configure"]);
    let [one, two] = working(folder, "can0");
    assert!(one != two && (one == 12 || two == 12), "{one}, {two}");
    drop((feed, sens));
    for bus in ["can0", "can1"] {
        run("ip", &["link", "set", bus, "down"]);
        let setting = ["bitrate", "125000", "listen-only", "off", "berr-reporting", "off"];
        run("ip", &[&["link", "set", bus, "up", "type", "can"], &setting[..]].concat());
    }
}

#[test]
fn kit_devices_share_two_real_controllers() {
    devices_share_two_real_controllers([NodeLanguage::C; 2]);
}

#[test]
fn node_and_kit_share_two_real_controllers() {
    devices_share_two_real_controllers([NodeLanguage::Rust, NodeLanguage::C]);
}

#[test]
fn node_devices_share_two_real_controllers() {
    devices_share_two_real_controllers([NodeLanguage::Rust; 2]);
}
