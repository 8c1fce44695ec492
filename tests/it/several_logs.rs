//! Several logs on one screen: what is shown of each is what it is alone, whichever of them grows, is
//! replaced, or has other dates.

use crate::common::pty::Pty;
use crate::replay_speed::write_log;
use flate2::Compression;
use flate2::write::GzEncoder;
use nix::sys::stat::Mode;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;

/// Words of the timeline of which none is true of the logs here.
const INVENTED: [&str; 8] =
    ["suspected", "confirmed", "rebooted", "stale", "lost", "silent", "returned", "twice"];

/// The second log is a pipe with a writer that ends.
#[test]
fn log_beside_a_pipe_is_shown_from_its_start() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("session.log");
    write_log(&log);
    let pipe = folder.path().join("pipe");
    nix::unistd::mkfifo(&pipe, Mode::S_IRWXU).unwrap();
    let arguments = ["file:session.log", "file:pipe", "--file", "des.json", "--speed", "1000"];
    let mut pty = Pty::start(&arguments, folder.path(), (100, 60));
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
    pty.wait_for("bits by device");
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
    let [lines, _] = write_two(folder.path());
    let mut pty = read_two(folder.path());
    assert_nothing_invented(&mut pty);
    // A moment before is shown of both.
    pty.send(":50%\r5");
    pty.wait_for("bits by device");
    pty.wait_for("FROZEN");
    let screen = pty.screen();
    let count = |name: &str| {
        let is_it = |line: &&str| line.starts_with(&format!(" {name} ")) && line.contains("TEC");
        let line = screen.lines().find(is_it)?;
        let (_, rest) = line.split_once("  frames ")?;
        rest.split_whitespace().next()?.replace(',', "").parse::<usize>().ok()
    };
    let (left, right) = (count("left").unwrap(), count("right").unwrap());
    let all = lines.len();
    assert!(
        left.abs_diff(right) <= 1 && left.abs_diff(all / 2) < all / 10,
        "{left} {right} of {all}"
    );
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// Writes the same frames as logs `left.log` and `right.log`; returns their lines.
fn write_two(folder: &Path) -> [Vec<String>; 2] {
    write_log(&folder.join("one.log"));
    let one = fs::read_to_string(folder.join("one.log")).unwrap();
    ["left", "right"].map(|name| {
        let log = one.replace(" can0 ", &format!(" {name} "));
        fs::write(folder.join(format!("{name}.log")), &log).unwrap();
        log.lines().map(|line| format!("{line}\n")).collect()
    })
}

/// Opens `left.log` and `right.log`, and reads both to their ends.
fn read_two(folder: &Path) -> Pty {
    let arguments = ["left.log", "right.log", "--file", "des.json"];
    let mut pty = Pty::start(&arguments, folder, (120, 60));
    pty.wait_for("N1");
    pty.send(":100%\r");
    pty.wait_for(" left  end of log");
    pty.wait_for(" right  end of log");
    pty
}

/// Shows the lines of the timeline and asserts that nothing is invented.
fn assert_nothing_invented(pty: &mut Pty) {
    pty.send("3G");
    pty.wait_for("lanes and lines");
    let screen = pty.screen();
    for word in INVENTED {
        assert!(!screen.contains(&format!(" {word}")), "{word}: {screen}");
    }
}

/// Writes one log after the other, in pieces of which each is later than the other log was read.
#[test]
fn logs_that_grow_in_turns_invent_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let logs = write_two(folder.path());
    let piece = logs[0].len() / 4;
    let path = |at: usize| folder.path().join(["left.log", "right.log"][at]);
    for (at, lines) in logs.iter().enumerate() {
        fs::write(path(at), lines[..piece].concat()).unwrap();
    }
    let mut pty = read_two(folder.path());
    let grow = |at: usize| {
        let mut log = OpenOptions::new().append(true).open(path(at)).unwrap();
        log.write_all(logs[at][piece..2 * piece].concat().as_bytes()).unwrap();
    };
    grow(0);
    pty.wait_for(" left  log 0:19");
    // An empty line, and the start of one with a frame, change nothing.
    let append = |at: usize, text: &str| {
        OpenOptions::new().append(true).open(path(at)).unwrap().write_all(text.as_bytes()).unwrap();
    };
    append(1, "\n");
    let (begin, rest) = logs[1][piece].split_at(25);
    append(1, begin);
    append(1, rest);
    append(1, &logs[1][piece + 1..2 * piece].concat());
    // The other one is late by then.
    pty.wait_for("right        its times are shown 10.");
    pty.wait_for(" left  end of log");
    pty.wait_for(" right  end of log");
    assert_nothing_invented(&mut pty);
    pty.send("1");
    pty.wait_for("left+right");
    pty.wait_for("11 present");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// Replaces a log by a longer one that begins at the same time, while the other one is at its end.
#[test]
fn log_replaced_beside_another_keeps_its_own_times() {
    let folder = tempfile::tempdir().unwrap();
    let logs = write_two(folder.path());
    fs::write(folder.path().join("left.log"), logs[0][..logs[0].len() / 4].concat()).unwrap();
    let mut pty = read_two(folder.path());
    fs::write(folder.path().join("next"), logs[0].concat()).unwrap();
    fs::rename(folder.path().join("next"), folder.path().join("left.log")).unwrap();
    // After the 40 s of the other one.
    pty.wait_for(" left  end of log 1:19");
    assert_nothing_invented(&mut pty);
    pty.send("/text:replaced\r");
    pty.wait_for("log replaced");
    pty.send("/\x15\r");
    pty.send("5");
    pty.wait_for("bits by device");
    let frames = format!("frames {},{:03}", logs[0].len() / 1000, logs[0].len() % 1000);
    assert!(pty.screen().matches(&frames).count() >= 1, "{frames}: {}", pty.screen());
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// The second log begins 20 s after the first one, the third one a day later.
#[test]
fn logs_of_one_time_keep_their_dates() {
    dates_are_kept("left.log");
}

/// The end of a compressed log is known only when all of it was read.
#[test]
fn compressed_log_of_the_same_time_keeps_its_dates() {
    dates_are_kept("left.log.gz");
}

fn dates_are_kept(left: &str) {
    let folder = tempfile::tempdir().unwrap();
    let logs = write_two(folder.path());
    let half = logs[1].len() / 2;
    fs::write(folder.path().join("right.log"), logs[1][half..].concat()).unwrap();
    let seconds = |line: &str| line[1..].split('.').next().unwrap().parse::<u64>().unwrap();
    let next_day = |line: &String| {
        let rest = line.split_once('.').unwrap().1.replace(" left ", " later ");
        format!("({}.{rest}", seconds(line) + 86_400)
    };
    let later: String = logs[0].iter().map(next_day).collect();
    fs::write(folder.path().join("later.log"), later).unwrap();
    if left != "left.log" {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(&fs::read(folder.path().join("left.log")).unwrap()).unwrap();
        fs::write(folder.path().join(left), encoder.finish().unwrap()).unwrap();
    }
    let arguments = [left, "right.log", "later.log", "--file", "des.json"];
    let mut pty = Pty::start(&arguments, folder.path(), (120, 60));
    pty.wait_for("N1");
    pty.send(":100%\r");
    for name in ["left", "right", "later"] {
        pty.wait_for(&format!(" {name}  end of log"));
    }
    assert_nothing_invented(&mut pty);
    let begin = seconds(&logs[1][half]) % 86_400;
    let clock = format!("{:02}:{:02}:{:02}", begin / 3600, begin / 60 % 60, begin % 60);
    pty.send("gg");
    pty.wait_for("its first frame is 19.");
    pty.wait_for("recorded at another time: begins with the first log");
    pty.send("/text:open\r");
    pty.wait_until("the start of the second log", |screen| {
        let screen = screen.contents();
        screen.lines().any(|line| line.contains(&clock) && line.contains("right            open"))
    });
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// The first log ends long before the other one.
#[test]
fn log_that_ends_before_others_keeps_its_last_state() {
    let folder = tempfile::tempdir().unwrap();
    let logs = write_two(folder.path());
    fs::write(folder.path().join("left.log"), logs[0][..logs[0].len() / 4].concat()).unwrap();
    let mut pty = read_two(folder.path());
    pty.wait_for(" left  end of log 0:09");
    pty.wait_for(" right  end of log 0:39");
    pty.send("1");
    pty.wait_for("11 present");
    assert!(!pty.screen().contains("lost"), "{}", pty.screen());
    assert_nothing_invented(&mut pty);
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// Nothing waits for the writer of a pipe.
#[test]
fn pipe_without_a_writer_holds_nothing_up() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("session.log"));
    nix::unistd::mkfifo(&folder.path().join("pipe"), Mode::S_IRWXU).unwrap();
    let arguments = ["session.log", "pipe", "--file", "des.json", "--speed", "1000"];
    let mut pty = Pty::start(&arguments, folder.path(), (100, 60));
    pty.wait_for(" can0  end of log");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}
