//! The real binary in a pseudo-terminal: screen content, effect of keys, and restoring of the
//! terminal on every way out.

use crate::common::hostile;
use crate::common::pty;
use crate::common::pty::{ClosablePty, PATIENCE, Pty};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use portable_pty::{CommandBuilder, PtySize, native_pty_system};
use rustix::termios::tcgetattr;
use std::fmt::Write;
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

const SMALL: (u16, u16) = (80, 24);

fn demo(folder: &Path) -> Pty {
    let mut pty = Pty::start(&["sim:boiler", "--file", "des.json"], folder, SMALL);
    pty.wait_for("FEED");
    pty
}

#[test]
fn q_quits_and_restores_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = demo(folder.path());
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
}

#[test]
fn invalid_settings_are_shown_and_do_not_stop_start() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("config/descan");
    std::fs::create_dir_all(&config).unwrap();
    std::fs::write(config.join("config.toml"), "theme = \"mine\"").unwrap();
    std::fs::write(config.join("keys.toml"), "rescan = 5").unwrap();
    let mut pty = demo(folder.path());
    pty.send("3");
    pty.wait_for("settings");
    let screen = pty.screen();
    assert!(screen.contains("theme mine: not found"), "{screen}");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn demo_keeps_des_json_only_if_edited() {
    for edit in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let mut pty = Pty::start(&["demo"], folder.path(), (120, 40));
        pty.wait_for("FEED");
        pty.wait_for("descan-demo-");
        let screen = pty.screen();
        let place = screen.split_whitespace().find(|word| word.contains("descan-demo-")).unwrap();
        let path = std::path::PathBuf::from(place);
        assert!(path.exists(), "{place}");
        if edit {
            pty.wait_for("PSU");
            pty.send("Ge44\r");
            pty.wait_for("44");
            pty.wait_until("the edit in the file", |_| {
                std::fs::read_to_string(&path).is_ok_and(|text| text.contains("44"))
            });
        }
        pty.send("q");
        assert_eq!(pty.wait(), 0);
        pty.assert_given_back();
        assert_eq!(path.exists(), edit);
        if edit {
            assert!(pty.screen().contains("is kept"), "{}", pty.screen());
            std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
        }
    }
}

#[test]
fn ctrl_c_and_signals_restore_the_terminal() {
    for (way, code) in [(None, 0), (Some(Signal::SIGTERM), 130), (Some(Signal::SIGINT), 130)] {
        let folder = tempfile::tempdir().unwrap();
        let mut pty = demo(folder.path());
        match way {
            None => pty.send("\x03"),
            Some(signal) => pty.signal(signal),
        }
        assert_eq!(pty.wait(), code, "{way:?}");
        pty.assert_given_back();
    }
}

/// Longest time from a key to its effect on a line of 9,600 baud.
const SLOW_ANSWER: Duration = Duration::from_secs(2);

/// A screen has three or four seconds of bytes: they are sent in parts, so that a key does not wait for
/// what was drawn before it.
#[test]
fn keys_act_within_two_seconds_on_a_line_of_9600_baud() {
    let folder = tempfile::tempdir().unwrap();
    let command = format!("stty 9600; exec {} sim:boiler", env!("CARGO_BIN_EXE_descan"));
    let arguments = ["-c", &command];
    let mut pty = Pty::run_on_line("/bin/sh", &arguments, folder.path(), SMALL, Some(960));
    pty.wait_for("q quit");
    pty.wait_for("PSU");
    // Twice: nothing piles up. Each key but the first comes while a screen is being sent.
    for (key, effect) in [
        ("2", "FROM"),
        ("1", "STATE"),
        ("?", "Keys of"),
        ("?", "STATE"),
        ("j", "▸●   12"),
        ("k", "▸●   10"),
        ("4", "PROBLEM"),
        ("2", "FROM"),
    ]
    .repeat(2)
    {
        let start = Instant::now();
        pty.send(key);
        pty.wait_until(key, |screen| screen.contents().contains(effect));
        let took = start.elapsed();
        assert!(took < SLOW_ANSWER, "{key}: {effect} after {took:?}\n{}", pty.screen());
    }
    let start = Instant::now();
    pty.send("q");
    // The line has the last bytes when the program has already ended.
    pty.wait_until("the screen before", |screen| !screen.alternate_screen());
    assert_eq!(pty.wait(), 0);
    assert!(start.elapsed() < SLOW_ANSWER, "{:?}", start.elapsed());
    pty.assert_given_back();
}

#[test]
fn lost_connection_ends_descan() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = demo(folder.path());
    pty.hang_up();
    pty.wait();
    pty.assert_given_back();
}

#[test]
fn unsaved_edits_are_kept_in_a_recovery_copy() {
    for way in ["Ctrl-C", "SIGTERM", "SIGHUP", "given up"] {
        let folder = tempfile::tempdir().unwrap();
        // The folder does not exist, so saving fails.
        let arguments = ["sim:boiler", "--file", "gone/des.json"];
        let mut pty = Pty::start(&arguments, folder.path(), (120, 40));
        pty.wait_for("FEED");
        pty.send("e77\r");
        pty.wait_for("not saved");
        match way {
            "Ctrl-C" => pty.send("\x03"),
            "SIGTERM" => pty.signal(Signal::SIGTERM),
            "SIGHUP" => pty.hang_up(),
            _ => {
                pty.send("q");
                pty.wait_for("uit");
                pty.send("y");
            }
        }
        let given_up = way == "given up";
        let code = pty.wait();
        assert_ne!(code == 0, !given_up, "{way}: {code}");
        let kept = folder.path().join("state/descan");
        let copies: Vec<_> = std::fs::read_dir(kept).into_iter().flatten().flatten().collect();
        assert_eq!(copies.len(), usize::from(!given_up), "{way}: {copies:?}");
        for copy in copies {
            let text = std::fs::read_to_string(copy.path()).unwrap();
            assert!(text.contains("77"), "{way}: {text}");
            let name = copy.file_name().into_string().unwrap();
            if way != "SIGHUP" {
                assert!(pty.screen().replace('\n', "").contains(&name), "{}", pty.screen());
            }
        }
    }
}

#[test]
fn terminal_closed_with_unsaved_edit_saves_recovery_copy() {
    for is_leader in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        // The folder does not exist, so saving fails.
        let arguments = ["sim:boiler", "--file", "gone/des.json"];
        let mut terminal = ClosablePty::start(&arguments, folder.path(), is_leader);
        terminal.wait_for("FEED");
        terminal.send("e77\r");
        terminal.wait_for("not saved");
        assert_eq!(terminal.close(), Some(130), "leader of its session: {is_leader}");
        let kept = folder.path().join("state/descan");
        let copies: Vec<_> = std::fs::read_dir(kept).into_iter().flatten().flatten().collect();
        assert_eq!(copies.len(), 1, "leader of its session: {is_leader}");
        let text = std::fs::read_to_string(copies[0].path()).unwrap();
        assert!(text.contains("77"), "{text}");
    }
}

#[test]
fn terminal_closed_while_idle_ends_the_program() {
    for is_leader in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let mut terminal = ClosablePty::start(&["nocan7"], folder.path(), is_leader);
        terminal.wait_for("nocan7");
        assert_eq!(terminal.close(), Some(130), "leader of its session: {is_leader}");
    }
}

#[test]
fn ctrl_z_restores_the_terminal_until_resumed() {
    for key in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let mut pty = demo(folder.path());
        if key {
            pty.send("\x1a");
        } else {
            pty.signal(Signal::SIGTSTP);
        }
        pty.wait_for_state('T');
        pty.assert_given_back();
        pty.signal(Signal::SIGCONT);
        pty.wait_until("screen again", |screen| {
            screen.alternate_screen() && screen.contents().contains("FEED")
        });
        pty.send("q");
        assert_eq!(pty.wait(), 0);
        pty.assert_given_back();
    }
}

#[test]
fn stop_signal_changes_no_presence() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = demo(folder.path());
    pty.signal(Signal::SIGSTOP);
    pty.wait_for_state('T');
    // Nothing is drawn while stopped; heartbeats become overdue.
    assert_eq!(pty.count_for(Duration::from_secs(4)), 0);
    pty.signal(Signal::SIGCONT);
    pty.wait_for("descan       stopped for");
    // Discovery starts again.
    pty.wait_for("using address 0");
    pty.send("3");
    pty.wait_for("▸");
    let screen = pty.screen();
    for word in [" suspected:", " lost\n", " silent:", " stale:", " returned"] {
        assert!(!screen.contains(word), "{word}: {screen}");
    }
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// A helper, not a test: `panic_restores_the_terminal` runs it in a terminal.
#[test]
#[ignore = "run by another test"]
fn panic_with_the_terminal_open() {
    descan::shell::terminal::restore_on_panic();
    let _terminal = descan::shell::terminal::Terminal::enter().expect("a terminal");
    panic!("on purpose");
}

#[test]
fn panic_restores_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let own = std::env::current_exe().unwrap();
    let arguments = [
        "--exact",
        "terminal::panic_with_the_terminal_open",
        "--ignored",
        "--nocapture",
        "--test-threads=1",
    ];
    let mut pty = Pty::run(own.to_str().unwrap(), &arguments, folder.path(), SMALL);
    assert_ne!(pty.wait(), 0);
    let taken = pty.bytes.windows(8).any(|bytes| bytes == b"\x1b[?1049h");
    assert!(taken, "the terminal was taken");
    pty.assert_given_back();
    assert!(pty.screen().contains("on purpose"), "{}", pty.screen());
}

#[test]
fn address_is_pinned_in_its_row_and_undone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("des.json");
    let before = "{ \"devices\": [\n    {\"name\": \"FEED\", \"address\": 9, \"note\": 1e3}\n] }\n";
    std::fs::write(&path, before).unwrap();
    let mut pty = demo(folder.path());
    pty.wait_for("SENS");
    pty.send("gg");
    pty.send("e");
    pty.send("\x7f\x7f\x7f");
    pty.send("12\r");
    let pinned = before.replace("\"address\": 9", "\"address\": 12, \"static\": true");
    wait_for_content(&mut pty, &path, &pinned);
    pty.send("u");
    wait_for_content(&mut pty, &path, before);
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

fn wait_for_content(pty: &mut Pty, path: &Path, wanted: &str) {
    let deadline = std::time::Instant::now() + pty::PATIENCE;
    loop {
        let content = std::fs::read_to_string(path).unwrap();
        if content == wanted {
            return;
        }
        assert!(std::time::Instant::now() < deadline, "{content}\n{}", pty.screen());
        pty.count_for(std::time::Duration::from_millis(10));
    }
}

#[test]
fn file_change_is_seen_while_typing_an_address() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("des.json");
    std::fs::write(&path, r#"{"devices":[{"name":"FEED","address":10}]}"#).unwrap();
    let mut pty = demo(folder.path());
    pty.wait_for("SENS");
    pty.send("gge");
    pty.send("\x7f\x7f\x7f44");
    pty.wait_for("44");
    // Another program pins another device to the same address, with an atomic save.
    let other =
        r#"{"devices":[{"name":"FEED","address":10},{"name":"VALVE","address":44,"static":true}]}"#;
    std::fs::write(folder.path().join("new"), other).unwrap();
    std::fs::rename(folder.path().join("new"), &path).unwrap();
    pty.wait_for("VALVE");
    // The input line is still open, and rejects the address that was free before.
    pty.send("\r");
    pty.count_for(std::time::Duration::from_millis(100));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), other, "{}", pty.screen());
    pty.send("\x7f5\r");
    let pinned = other
        .replace(r#""name":"FEED","address":10"#, r#""name":"FEED","address":45,"static":true"#);
    wait_for_content(&mut pty, &path, &pinned);
}

#[test]
fn broken_file_is_shown_and_never_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("des.json");
    std::fs::write(&path, "{\"devices\": [\n  oops\n]}").unwrap();
    let mut pty = demo(folder.path());
    pty.wait_for("line 2");
    pty.send("gga");
    pty.send("e11\r");
    pty.count_for(std::time::Duration::from_millis(100));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "{\"devices\": [\n  oops\n]}");
}

#[test]
fn user_theme_is_reloaded_when_saved() {
    let folder = tempfile::tempdir().unwrap();
    let themes = folder.path().join("config/descan/themes");
    std::fs::create_dir_all(&themes).unwrap();
    let write = |colour: &str| {
        let text = format!("inherits = \"dark\"\n[roles]\nselected = {{ bg = \"{colour}\" }}\n");
        std::fs::write(themes.join("own.toml"), text).unwrap();
    };
    // The nearest of 256 colours: the colour cube contains both.
    write("#5f00af");
    let mut pty = Pty::start(&["sim:boiler", "--theme", "own"], folder.path(), SMALL);
    let has = |screen: &vt100::Screen, index: u8| {
        (0..24).any(|row| {
            screen.cell(row, 2).is_some_and(|cell| cell.bgcolor() == vt100::Color::Idx(index))
        })
    };
    pty.wait_until("the first colour", |screen| has(screen, 55));
    write("#00875f");
    pty.wait_until("the other colour", |screen| has(screen, 29));
    write("#nonsense");
    pty.wait_for("theme own");
    pty.wait_until("still the other colour", |screen| has(screen, 29));
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn missing_interface_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = Pty::start(&["nocan7"], folder.path(), SMALL);
    pty.wait_for("nocan7");
    pty.wait_until("the cause", |screen| {
        let text = screen.contents();
        text.contains("nocan7 not found") || text.contains("kernel")
    });
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
}

#[test]
fn every_terminal_size_shows_devices() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = demo(folder.path());
    for (columns, rows) in [(40, 10), (120, 40), (200, 60), (20, 5), (1, 1), (80, 24)] {
        pty.resize(columns, rows);
        if columns >= 40 {
            pty.wait_for("FEED");
        }
    }
    pty.wait_for("FEED");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn each_update_is_synchronized_output() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = demo(folder.path());
    pty.send("q");
    pty.wait();
    let count = |needle: &[u8]| pty.bytes.windows(needle.len()).filter(|it| *it == needle).count();
    assert!(count(b"\x1b[?2026h") > 0);
    assert!(count(b"\x1b[?2026l") >= count(b"\x1b[?2026h"));
    assert_eq!(count(b"\x1b[?1003h"), 0, "no any-motion reports");
}

#[test]
fn log_of_two_interfaces_is_two_buses() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = String::new();
    for beat in 0..3 {
        let second = 1_436_509_052 + beat;
        writeln!(log, "({second}.100000) can7 07183C01#8AFA6C9724110400").unwrap();
        writeln!(log, "({second}.200000) can8 07283C01#8AFA6C9724120400").unwrap();
    }
    std::fs::write(folder.path().join("session.log"), log).unwrap();
    let mut pty = Pty::start(&["file:session.log", "--speed", "20"], folder.path(), (100, 30));
    pty.wait_until("both buses and a node on each", |screen| {
        let text = screen.contents();
        ["can7", "can8", " 12 ?", " 20 ?"].iter().all(|wanted| text.contains(wanted))
    });
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn log_plays_as_timed_and_stays_open_at_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = String::new();
    for beat in 0..5 {
        let second = 1_436_509_052 + beat;
        writeln!(log, "({second}.100000) can7 07183C01#8AFA6C9724110400").unwrap();
    }
    std::fs::write(folder.path().join("session.log"), log).unwrap();
    let mut pty = Pty::start(&["file:session.log", "--speed", "20"], folder.path(), SMALL);
    pty.wait_for("BOILER01");
    pty.wait_until("the end", |screen| screen.contents().to_lowercase().contains("end"));
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn frozen_moment_of_a_log_plays_from_where_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = String::new();
    for beat in 0..300 {
        let second = 1_436_509_052 + beat;
        writeln!(log, "({second}.100000) can7 07183C01#8AFA6C9724110400").unwrap();
    }
    std::fs::write(folder.path().join("session.log"), log).unwrap();
    let mut pty = Pty::start(&["file:session.log", "--speed", "1000"], folder.path(), SMALL);
    pty.wait_for("end of log");
    pty.send("g2:00\r");
    pty.wait_for("FROZEN 06:19:32");
    // While the user reads the screen, nothing moves.
    pty.count_for(Duration::from_secs(4));
    pty.send(")");
    pty.wait_until("another second", |screen| {
        let screen = screen.contents();
        screen.contains("PLAY ×1") && !screen.contains("06:19:32")
    });
    let screen = pty.screen();
    assert!(screen.contains("PLAY ×1 06:19:33"), "{screen}");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn difference_from_file_ends_at_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = String::new();
    for beat in 0..300 {
        let second = 1_436_509_052 + beat;
        writeln!(log, "({second}.100000) can7 073C3C01#8AFA6C9724110400").unwrap();
        if beat >= 25 {
            writeln!(log, "({second}.200000) can7 07183C01#9338E1BB0AD90400").unwrap();
        }
        if beat == 25 {
            writeln!(log, "({second}.300000) can7 05180002#0601464545440000").unwrap();
        }
    }
    std::fs::write(folder.path().join("session.log"), log).unwrap();
    let file = r#"{"devices": [{"name": "FEED", "address": 12, "static": true}]}"#;
    std::fs::write(folder.path().join("des.json"), file).unwrap();
    let mut pty = Pty::start(&["file:session.log"], folder.path(), (120, 40));
    pty.wait_for("missing");
    pty.send("g100%\r");
    pty.wait_for("end of log");
    pty.wait_for("over: FEED (at 12) is listed but not on the bus");
    let screen = pty.screen();
    let line = screen.lines().find(|line| line.contains("over: FEED")).unwrap();
    assert!(line.contains(" 06:17:57"), "{line}");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn log_is_paused_stepped_and_resumed_by_keys() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.log");
    let mut log = String::new();
    for beat in 0..100 {
        let second = 1_436_509_052 + beat * 60;
        writeln!(log, "({second}.100000) can7 07183C01#8AFA6C9724110400").unwrap();
    }
    std::fs::write(&path, &log).unwrap();
    let mut pty = Pty::start(&["file:session.log"], folder.path(), SMALL);
    pty.wait_for("can7  log 0:0");
    pty.send("P");
    pty.wait_for("PAUSED 0:0");
    pty.send(">");
    pty.wait_for("PAUSED 1:00");
    pty.send(">");
    pty.wait_for("PAUSED 2:00 3%");
    // Deadlines between two frames passed at their own time.
    pty.wait_for("● ? @12        lost, returned");
    pty.send("3Go");
    pty.wait_for("│ 06:18:37");
    pty.send("o1");
    pty.wait_for("─ latest ");
    pty.send("))))))))))))");
    pty.wait_for("PAUSED 2:00 3% ×4096");
    pty.send("(P");
    pty.wait_for("end of log 1:39:00 ×2048");
    // At the end of the log descan keeps running and reads new lines.
    let mut file = std::fs::File::options().append(true).open(&path).unwrap();
    let second = 1_436_509_052 + 100 * 60;
    let line = format!("({second}.100000) can7 07283C01#8AFA6C9724120400\n");
    std::io::Write::write_all(&mut file, line.as_bytes()).unwrap();
    pty.wait_for("can7  log 1:40:0");
    pty.wait_for("20 ?");
    pty.send("?");
    pty.wait_for("Keys of");
    pty.send("q");
    pty.wait_for("1 Devices");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// Tests a terminal that is not read, as over a stalled SSH line: the thread that draws is blocked
/// in a write.
#[test]
fn signal_ends_descan_on_a_blocked_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let size = |cols| PtySize { rows: 100, cols, pixel_width: 0, pixel_height: 0 };
    let pair = native_pty_system().openpty(size(300)).unwrap();
    let mut options = std::fs::File::options();
    let flags = nix::fcntl::OFlag::O_NOCTTY.bits();
    let terminal = pair.master.tty_name().unwrap();
    let terminal = options.read(true).write(true).custom_flags(flags).open(terminal).unwrap();
    let settings = || tcgetattr(&terminal).unwrap().local_modes;
    let before = settings();
    let mut command = CommandBuilder::new(env!("CARGO_BIN_EXE_descan"));
    command.arg("demo");
    command.env("TERM", "xterm-256color");
    command.env("XDG_CONFIG_HOME", folder.path());
    let mut child = pair.slave.spawn_command(command).unwrap();
    let pid = Pid::from_raw(child.process_id().unwrap().cast_signed());
    // Each change of the size draws the whole screen, until the buffer of the terminal is full.
    let is_writable = || {
        let mut watched = [PollFd::new(terminal.as_fd(), PollFlags::POLLOUT)];
        poll(&mut watched, PollTimeout::ZERO).unwrap() > 0
    };
    let deadline = Instant::now() + PATIENCE;
    for columns in (200..300).cycle() {
        if !is_writable() {
            break;
        }
        assert!(Instant::now() < deadline, "the terminal takes everything");
        pair.master.resize(size(columns)).unwrap();
        std::thread::yield_now();
    }
    assert_ne!(settings(), before);
    kill(pid, Signal::SIGTERM).unwrap();
    let signalled = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if signalled.elapsed() > Duration::from_secs(5) {
            child.kill().unwrap();
            panic!("it does not end");
        }
        std::thread::yield_now();
    }
    assert_eq!(child.wait().unwrap().exit_code(), 130);
    assert_eq!(settings(), before);
}

#[test]
fn full_speed_log_leaves_keys_and_signals_working() {
    for way in ["q", "SIGTERM"] {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        let writer = hostile::feed(&pipe, false);
        let command = format!("exec {} - --speed 100000 < pipe", env!("CARGO_BIN_EXE_descan"));
        let mut pty = Pty::run("/bin/sh", &["-c", &command], folder.path(), SMALL);
        // Problems are counted: the frames are handled. Which rows are on the screen is by chance.
        pty.wait_for("present  ⚠ ");
        pty.send("3");
        pty.wait_for("WHO");
        pty.send("4");
        pty.wait_for("PROBLEM");
        match way {
            "q" => pty.send("q"),
            _ => pty.signal(Signal::SIGTERM),
        }
        assert_eq!(pty.wait(), if way == "q" { 0 } else { 130 });
        pty.assert_given_back();
        writer.join().unwrap();
    }
}

#[test]
fn long_file_name_leaves_room_for_the_state_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let name = format!("{}.json", "f".repeat(90));
    std::fs::write(folder.path().join(&name), "{\"devices\":[]}").unwrap();
    let mut pty = Pty::start(&["sim:boiler", "--file", &name], folder.path(), SMALL);
    pty.wait_for("✓ 0 entries");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn unreadable_input_is_shown_before_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let command = format!("exec {} - < pipe", env!("CARGO_BIN_EXE_descan"));
    let mut pty = Pty::run("/bin/sh", &["-c", &command], folder.path(), (160, 40));
    let mut input = std::fs::OpenOptions::new().write(true).open(&pipe).unwrap();
    std::io::Write::write_all(&mut input, "what?\n".repeat(9).as_bytes()).unwrap();
    pty.wait_for("8 lines cannot be read, the first is line 1");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn picked_theme_is_kept_and_faulty_one_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("config/descan");
    std::fs::create_dir_all(config.join("themes")).unwrap();
    std::fs::write(config.join("themes/own.toml"), "[roles]\nerorr = \"red\"\n").unwrap();
    std::fs::write(config.join("config.toml"), "# mine\ntheme = \"light\"\n").unwrap();
    let mut pty = demo(folder.path());
    pty.wait_for("FEED");
    pty.send("t");
    pty.wait_for("✗ line 2: unknown");
    // The whole mistake, once it is selected.
    pty.send("jjj");
    pty.wait_for("theme own: line 2: unknown role \"erorr\"");
    pty.send("kkkk\r");
    pty.wait_for("theme dark kept in config.toml");
    let kept = std::fs::read_to_string(config.join("config.toml")).unwrap();
    assert_eq!(kept, "# mine\ntheme = \"dark\"\n");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    // The title of the window was set, and is given back.
    let has = |needle: &[u8]| pty.bytes.windows(needle.len()).any(|it| it == needle);
    assert!(has(b"\x1b]2;descan ") && has(b"\x1b[23;2t"));
}

#[test]
fn buses_are_offered_where_none_is_named_or_up() {
    if descan::bus::interfaces().iter().filter(|it| it.up).count() == 1 {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut pty = Pty::start(&[], folder.path(), SMALL);
    pty.wait_for("descan: which bus?");
    pty.wait_for("sim:boiler");
    // The last line but one.
    pty.send("\x1b[Fk\r");
    pty.wait_for("FEED");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    let mut pty = Pty::start(&[], folder.path(), SMALL);
    pty.wait_for("descan: which bus?");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
}

/// Returns the lines of the screen with a background of their own in the first column.
fn tinted_rows(screen: &vt100::Screen) -> Vec<(u16, u8)> {
    let colour = |row| match screen.cell(row, 0)?.bgcolor() {
        vt100::Color::Idx(index) => Some((row, index)),
        _ => None,
    };
    (3..20).filter_map(colour).collect()
}

fn asks_for_background(pty: &Pty) -> bool {
    pty.bytes.windows(6).any(|bytes| bytes == b"\x1b]11;?")
}

#[test]
fn selected_row_is_tinted_by_the_told_background() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = demo(folder.path());
    pty.wait_for("DISP");
    assert!(asks_for_background(&pty));
    assert_eq!(tinted_rows(pty.vt()), []);
    // Between keys, in two parts.
    pty.send("j\x1b]11;rgb:1c1c/1f1f");
    pty.send("/2424\x1b\\j");
    pty.wait_until(
        "the tint",
        |screen| matches!(tinted_rows(screen)[..], [(_, index)] if index >= 232),
    );
    let (row, _) = tinted_rows(pty.vt())[0];
    assert_eq!(row, 6, "two rows down: {}", pty.screen());
    assert!(pty.screen().contains("1 Devices"), "no key was made up: {}", pty.screen());
    // A theme that paints itself, and back.
    pty.send("t");
    pty.wait_for("high-contrast");
    pty.send("\x1b");
    pty.wait_until("the list", |screen| !screen.contents().contains("high-contrast"));
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
}

#[test]
fn late_answer_of_the_terminal_makes_no_keys() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = demo(folder.path());
    // One that was not asked for, or twice.
    for _ in 0..2 {
        pty.send("\x1b]11;rgb:ffff/ffff/ffff\x07");
    }
    pty.wait_until("the tint", |screen| !tinted_rows(screen).is_empty());
    assert!(pty.screen().contains("1 Devices"), "{}", pty.screen());
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn terminal_is_not_asked_where_no_tint_is_shown() {
    for (variable, value) in [("TERM", "linux"), ("TERM", "xterm"), ("NO_COLOR", "1")] {
        let folder = tempfile::tempdir().unwrap();
        let program = env!("CARGO_BIN_EXE_descan");
        let command = format!("{variable}={value} exec {program} sim:boiler");
        let mut pty = Pty::run("/bin/sh", &["-c", &command], folder.path(), SMALL);
        pty.wait_for("FEED");
        assert!(!asks_for_background(&pty), "{variable}={value}");
        pty.send("q");
        assert_eq!(pty.wait(), 0);
    }
}

#[test]
fn screen_budget_bounds_what_the_bus_changes() {
    let count = |budget: u32| {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("config/descan");
        std::fs::create_dir_all(&config).unwrap();
        std::fs::write(config.join("config.toml"), format!("screen_budget = {budget}")).unwrap();
        let mut pty = Pty::start(&["sim:drone"], folder.path(), SMALL);
        pty.wait_for("IMU");
        pty.send("2");
        pty.wait_for("FROM");
        // What the key asked for is not counted.
        pty.count_for(Duration::from_secs(1));
        let bytes = pty.count_for(Duration::from_secs(4));
        pty.send("q");
        assert_eq!(pty.wait(), 0);
        bytes
    };
    let (low, high) = (count(300), count(20_000));
    assert!(low < 300 * 4 + 1500, "{low}");
    assert!(high > low * 3, "{high} {low}");
}

/// A connection that is slow, without a speed that is set: late answers show it.
#[test]
fn keys_act_on_a_line_that_is_found_slow_by_its_answers() {
    let folder = tempfile::tempdir().unwrap();
    let program = env!("CARGO_BIN_EXE_descan");
    let mut pty = Pty::run_on_line(program, &["sim:drone"], folder.path(), (120, 40), Some(2000));
    pty.answers = true;
    pty.wait_for("q quit");
    pty.wait_for("MOT4");
    // Screens until the speed is known.
    for key in ["2", "3", "5"] {
        pty.send(key);
        pty.count_for(Duration::from_secs(4));
    }
    for (key, effect) in [("2", "FROM"), ("1", "STATE"), ("?", "Keys of"), ("?", "STATE")] {
        let start = Instant::now();
        pty.send(key);
        pty.wait_until(key, |screen| screen.contents().contains(effect));
        let took = start.elapsed();
        assert!(took < SLOW_ANSWER * 2, "{key}: {effect} after {took:?}\n{}", pty.screen());
    }
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn list_of_buses_adds_a_bus_and_replaces_all() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = demo(folder.path());
    pty.send("B");
    pty.wait_for("which bus?");
    pty.wait_for("sim:drone");
    pty.send("/drone\r");
    pty.wait_until("one line", |screen| !screen.contents().contains("sim:boiler  "));
    pty.send("\r");
    pty.wait_for("opened sim:drone");
    pty.wait_for("IMU");
    assert!(pty.screen().contains("FEED"), "{}", pty.screen());
    pty.send("B");
    // A row: the title names the open buses before the list is there.
    pty.wait_for("● sim:drone");
    pty.send("Gi\r");
    pty.wait_for("Close sim:boiler, sim:drone and drop its frames?");
    pty.send("y");
    pty.wait_until("the drone alone", |screen| {
        let text = screen.contents();
        text.contains("IMU") && !text.contains("FEED")
    });
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
}

#[test]
fn interface_that_is_missing_is_shown_above_the_list_of_buses() {
    let folder = tempfile::tempdir().unwrap();
    let mut pty = Pty::start(&["nocan7"], folder.path(), SMALL);
    pty.wait_for("waiting for it");
    pty.wait_for("sim:boiler");
    pty.send("/boiler\r\r");
    pty.wait_for("FEED");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
}

#[test]
fn open_log_is_marked_in_the_list_of_buses() {
    let folder = tempfile::tempdir().unwrap();
    let logs = ["one.log", "two.log"];
    for log in logs {
        let line = "(1436509052.100000) can0 07180001#8AFA6C9724110400\n";
        std::fs::write(folder.path().join(log), line).unwrap();
        let mut pty = Pty::start(&[&format!("file:{log}")], folder.path(), SMALL);
        pty.wait_for("END");
        if log == "two.log" {
            pty.send("B");
            pty.wait_until("both logs", |screen| {
                let text = screen.contents();
                let line = |name| text.lines().find(|line| line.contains(name)).unwrap_or_default();
                line("two.log").contains('●') && !line("one.log").is_empty()
            });
            let text = pty.screen();
            assert!(!text.lines().any(|it| it.contains("one.log") && it.contains('●')), "{text}");
            pty.send("\x1b");
            pty.wait_until("closed", |screen| !screen.contents().contains("which bus?"));
        }
        pty.send("q");
        assert_eq!(pty.wait(), 0);
    }
}
