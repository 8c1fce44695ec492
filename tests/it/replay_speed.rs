//! Replay faster than frames can be processed: the screen reports the same events as at normal
//! speed, however far the clock runs ahead.

use crate::common::inspection;
use crate::common::pty;
use crate::common::pty::Pty;
use descan::sim::{DeviceSpec, Scenario};
use descan::time::Duration;
use nix::sys::stat::Mode;
use std::fs::{self, OpenOptions};
use std::path::Path;
use std::time::Instant;

/// Returns a log of nine devices and a requester, with more frames than one turn processes.
fn write_log(path: &Path) {
    let mut scenario = Scenario::new(125_000);
    for number in 1..=9 {
        let device =
            DeviceSpec::new(&format!("N{number}")).fixed(number).skips_address_resolution();
        scenario = scenario.with(device.periodic_message(0x100, Duration::from_millis(50), 8));
    }
    fs::write(path, inspection::log(&scenario, 40)).unwrap();
}

#[test]
fn playback_speed_does_not_change_events() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("session.log"));
    for (speed, keys) in [("100000", ""), ("1000", ""), ("4", "P))))))))))))))))))))P")] {
        let arguments = ["file:session.log", "--file", "des.json", "--speed", speed];
        let mut pty = Pty::start(&arguments, folder.path(), (100, 40));
        pty.wait_for("N9");
        pty.send(keys);
        pty.wait_for("end of log");
        pty.send("3G");
        pty.wait_for("06:18:12 · can0         end of log");
        let screen = pty.screen();
        for word in ["suspected", "rebooted", "lost", "silent", "returned"] {
            assert!(!screen.contains(&format!(" {word}")), "speed {speed}: {word}: {screen}");
        }
        assert!(screen.contains("10 present"), "and who asked: {screen}");
        pty.send("q");
        assert_eq!(pty.wait(), 0);
    }
}

/// The second log is a pipe, which opens when a writer opens it; the first has run for long then.
#[test]
fn log_started_early_is_shown_from_its_start() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("session.log");
    write_log(&log);
    let pipe = folder.path().join("pipe");
    nix::unistd::mkfifo(&pipe, Mode::S_IRWXU).unwrap();
    let arguments = ["file:session.log", "file:pipe", "--file", "des.json", "--speed", "1000"];
    let mut pty = Pty::start(&arguments, folder.path(), (100, 60));
    wait_until_read(pty.pid().as_raw(), &log);
    OpenOptions::new().write(true).open(&pipe).unwrap();
    pty.wait_for(" can0  end of log");
    pty.send("3gg");
    pty.wait_for(" can0     9 N9           appeared at 9, WORK, 1 service");
    let screen = pty.screen();
    assert!(!screen.contains("suspected"), "{screen}");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// The first log has two interfaces, in turns; the second one has the same frames on one.
#[test]
fn interfaces_of_several_logs_are_buses_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("one.log"));
    let one = fs::read_to_string(folder.path().join("one.log")).unwrap();
    let line = |(at, line): (usize, &str)| {
        let name = ["left", "right"][at % 2];
        line.replace(" can0 ", &format!(" {name} ")) + "\n"
    };
    let two: String = one.lines().enumerate().map(line).collect();
    fs::write(folder.path().join("two.log"), two).unwrap();
    let count = one.lines().count();
    let arguments = ["two.log", "one.log", "--file", "des.json", "--speed", "1000"];
    let mut pty = Pty::start(&arguments, folder.path(), (120, 60));
    pty.wait_for(" can0  end of log");
    pty.send("5");
    pty.wait_for("frames by device");
    let frames = |name: &str, count: usize| {
        let thousands = format!("frames {},{:03}", count / 1000, count % 1000);
        let screen = pty.screen();
        let line = screen
            .lines()
            .find(|line| line.starts_with(&format!(" {name} ")) && line.contains("TEC"));
        assert!(line.is_some_and(|line| line.contains(&thousands)), "{name} {thousands}: {screen}");
    };
    frames("left", count.div_ceil(2));
    frames("right", count / 2);
    frames("can0", count);
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// Tests that no log is read further than the others, in whatever time each is.
#[test]
fn several_logs_are_read_ahead_together() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("one.log"));
    let one = fs::read_to_string(folder.path().join("one.log")).unwrap();
    for name in ["left", "right"] {
        let log = folder.path().join(format!("{name}.log"));
        fs::write(log, one.replace(" can0 ", &format!(" {name} "))).unwrap();
    }
    let arguments = ["left.log", "right.log", "--file", "des.json"];
    let mut pty = Pty::start(&arguments, folder.path(), (120, 60));
    pty.wait_for("N1");
    pty.send(":100%\r");
    pty.wait_for(" left  end of log");
    pty.wait_for(" right  end of log");
    pty.send("3G");
    pty.wait_for("lanes and lines");
    let screen = pty.screen();
    for word in ["suspected", "rebooted", "stale", "lost", "silent", "returned"] {
        assert!(!screen.contains(&format!(" {word}")), "{word}: {screen}");
    }
    // A moment before is shown of both.
    pty.send(":50%\r5");
    pty.wait_for("frames by device");
    pty.wait_for("FROZEN");
    let screen = pty.screen();
    let count = |name: &str| {
        let is_it = |line: &&str| line.starts_with(&format!(" {name} ")) && line.contains("TEC");
        let line = screen.lines().find(is_it)?;
        let (_, rest) = line.split_once("  frames ")?;
        rest.split_whitespace().next()?.replace(',', "").parse::<usize>().ok()
    };
    let (left, right) = (count("left").unwrap(), count("right").unwrap());
    let all = one.lines().count();
    assert!(
        left.abs_diff(right) <= 1 && left.abs_diff(all / 2) < all / 10,
        "{left} {right} of {all}"
    );
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// Waits until a process is at the end of a file that it reads.
fn wait_until_read(pid: i32, path: &Path) {
    let size = fs::metadata(path).unwrap().len();
    let place = || -> Option<u64> {
        for file in fs::read_dir(format!("/proc/{pid}/fd")).ok()?.flatten() {
            if fs::read_link(file.path()).is_ok_and(|target| target == path) {
                let name = file.file_name().into_string().ok()?;
                let info = fs::read_to_string(format!("/proc/{pid}/fdinfo/{name}")).ok()?;
                return info.lines().next()?.strip_prefix("pos:")?.trim().parse().ok();
            }
        }
        None
    };
    let since = Instant::now();
    while place() != Some(size) {
        assert!(since.elapsed() < pty::PATIENCE, "the log is not read: {:?} of {size}", place());
        std::thread::yield_now();
    }
}
