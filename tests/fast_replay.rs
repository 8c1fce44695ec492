//! A log on the screen, played faster than frames can be taken: it tells what it tells at its own
//! pace, however far the clock could have run meanwhile.

mod common;
#[path = "common/pty.rs"]
mod pty;

use descan::sim::{DeviceSpec, Scenario};
use descan::time::Duration;
use pty::Pty;

#[test]
fn however_fast_a_log_is_played_nothing_else_happens_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut scenario = Scenario::new(125_000);
    for number in 1..=9 {
        // More frames than are taken in one turn.
        let device = DeviceSpec::new(&format!("N{number}")).fixed(number).settled();
        scenario = scenario.with(device.chatter(0x100, Duration::from_millis(50), 8));
    }
    std::fs::write(folder.path().join("session.log"), common::log(&scenario, 40)).unwrap();
    for (speed, keys) in [("100000", ""), ("1000", ""), ("4", "P]]]]]]]]]]]]]]]]]]]]P")] {
        let arguments = ["file:session.log", "--file", "des.json", "--speed", speed];
        let mut pty = Pty::start(&arguments, folder.path(), (100, 40));
        pty.wait_for("N9");
        pty.send(keys);
        pty.wait_for("end of log");
        pty.send("3G");
        pty.wait_for("WHO ");
        let screen = pty.screen();
        for word in ["suspected", "rebooted", "lost", "silent", "returned"] {
            assert!(!screen.contains(&format!(" {word}")), "speed {speed}: {word}: {screen}");
        }
        assert!(screen.contains("10 here"), "and who asked: {screen}");
        pty.send("q");
        assert_eq!(pty.wait(), 0);
    }
}
