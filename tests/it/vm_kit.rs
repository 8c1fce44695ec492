//! Devices with the responder kit on a CAN bus of a real kernel: tests/kit/socketcan.c, found and
//! commanded by descan.
//!
//! Without CAN in the kernel these tests print the reason and do not run.

use crate::common::can::{PATIENCE, Vcan, controllers, run};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Instant;

const PROFILE: &str = "[services]\nheartbeat = 0x001\ndes = 0x002\n[commands]\nmode = 0x019\n\
                       [writes]\naddress = 0x016\n";

/// Added to an address in DEV_CFG_ADDR: it is preferred, not fixed.
const PREFERRED: u8 = 0x80;

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

/// Compiles a device with a name, with the files that `descan kit` writes.
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

/// Starts a device that prefers address 12, and works by itself.
fn started(folder: &Path, name: &str, bus: &str, options: &[&str]) -> KitProcess {
    let program = built(folder, name);
    let settings = folder.join(name).join("settings");
    let uid = format!("{name:_<6}");
    std::fs::write(&settings, [uid.as_bytes(), &[PREFERRED + 12, 0x80, 1]].concat()).unwrap();
    let mut command = Command::new(program);
    command.arg(bus).arg(settings).args(options).stdout(Stdio::null());
    KitProcess(command.spawn().unwrap())
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

#[test]
fn kit_devices_are_found_and_take_commands() {
    let Some(vcan) = Vcan::new("dsp-kit") else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("profile.toml"), PROFILE).unwrap();
    let _feed = started(folder, "FEED", vcan.name(), &[]);
    let _sens = started(folder, "SENS", vcan.name(), &[]);
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
fn kit_devices_share_two_real_controllers() {
    let Some(_taken) = controllers() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("profile.toml"), PROFILE).unwrap();
    let feed = started(folder, "FEED", "can0", &["--configure"]);
    let sens = started(folder, "SENS", "can1", &["--configure"]);
    let [one, two] = working(folder, "can0");
    assert!(one != two && (one == 12 || two == 12), "{one}, {two}");
    drop((feed, sens));
    for bus in ["can0", "can1"] {
        run("ip", &["link", "set", bus, "down"]);
        let setting = ["bitrate", "125000", "listen-only", "off", "berr-reporting", "off"];
        run("ip", &[&["link", "set", bus, "up", "type", "can"], &setting[..]].concat());
    }
}
