//! Logs of all formats: what is read, from whole and damaged files, and `descan convert`.

use crate::common::access_list;
use crate::common::python::Python;
use descan::frame::Frame;
use descan::log::{LogReader, LogSummary, Unpacked};
use descan::time::Instant;
use flate2::write::GzEncoder;
use flate2::{Compression, Crc};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{BufReader, Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};

/// Frames of every kind, as candump writes them.
const KINDS: &str = "\
(1700000000.123456) ch1 02015402#0444455301
(1700000000.123999) ch2 123#
(1700000000.623999) ch1 7FF#R4 T
(1700000001.000000) ch1 1FFFFFFF#R
(1700000001.000001) ch2 123##0001122334455667788991011 T
(1700000001.000002) ch2 00000001##1AB
(1700000001.100000) ch2 00000001##2AB
(1700000001.200000) ch1 00000001##300
(1700000002.000000) ch1 20000080#0000000000000000
(1700000002.000000) ch1 20000088#0000040200000000
(1700000003.000000) ch1 02015402#1122334455667788 T
(1700000003.100000) ch1 02015402#1122334455667788_F
(1700000003.200000) ch2 7FF#R8_9 T
";

fn read(bytes: &[u8]) -> (Vec<Frame>, LogSummary) {
    let mut reader = LogReader::new(BufReader::new(Unpacked::new(bytes)));
    let frames = reader.by_ref().map(Result::unwrap).collect();
    (frames, reader.summary().clone())
}

/// Returns the times in microseconds since 1970 and the frames of a log.
fn dated(bytes: &[u8]) -> Vec<String> {
    let (frames, summary) = read(bytes);
    let epoch = summary.epoch.unwrap();
    let name = |frame: &Frame| summary.interfaces[usize::from(frame.bus.0)].clone();
    let line = |frame: &Frame| {
        let direction = if frame.is_tx { " T" } else { "" };
        format!("{} {} {frame}{direction}", epoch.unix_micros(frame.time), name(frame))
    };
    frames.iter().map(line).collect()
}

fn descan(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(arguments)
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", folder.join("config"))
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Converts a log; returns what is said on standard error.
fn convert(folder: &Path, from: &str, to: &str) -> String {
    let output = descan(folder, &["convert", from, to]);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{from} {to}: {said}");
    said
}

#[test]
fn lines_of_frames_with_a_broken_column_are_counted() {
    let asc = "date Tue Nov 14 10:13:20.123 pm 2023\nbase hex  timestamps absolute\n \
        0.0 1  123  Rx   d 1 01\n 0.1 1  124  Vx   d 1 02\n 0.2 1  124  TxRq d 1 02\n \
        0.3 CANFD 1 Vx 125 1 0 1 1 01\n 0.4 CAN 1 Status:chip status error active\n \
        0.5 1  Statistic: D 0 R 0\n 0.6 CANFD 1 TxRq 125 1 0 1 1 01\n";
    let trc = ";$FILEVERSION=2.1\n;$STARTTIME=44548.6\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n \
        1 1059.900 DT 1 0300 Rx - 1 00\n 2 1060.900 DT 1 0301 R8 - 1 01\n \
        3 1061.900 DT 1 ! 0302 Rx - 1 02\n 4 1062.000 EV - - - - 3 abc\n \
        5 1063.000 ST 1 - Rx - 4 00 00 00 08\n";
    let csv = "timestamp,arbitration_id,extended,remote,error,dlc,data\n\
        1.0,0x7ff,0,0,0,1,Og==\n1.1,0x7ff,0,1,0,0,1.2,0x7ff,0,0,0,1,Og==\n";
    let gvret = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n\
        1000,00000123,false,Rx,1,1,C6,\n2000,00000123,false,Rx,1,1,C6,2100,00000124,false,Rx,1,1,C6,\n";
    let commented = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,Comment\n\
        1000,00000123,false,Rx,1,1,C6,,door opened\n";
    for (name, text, expected) in [
        ("ASC", asc, (2, 2)),
        ("TRC", trc, (2, 2)),
        ("CSV", csv, (1, 1)),
        ("GVRET", gvret, (1, 1)),
        ("GVRET with a comment", commented, (1, 0)),
    ] {
        let (frames, summary) = read(text.as_bytes());
        assert_eq!((frames.len(), summary.unreadable), expected, "{name}");
    }
}

/// Format, content, error frames, and the numbers of unreadable lines and of frames in part.
type ControllerLog<'a> = (&'a str, Vec<u8>, &'a [&'a str], [u64; 2]);

#[test]
fn states_of_the_controller_are_error_frames() {
    let asc = "date Tue Nov 14 10:13:20.123 pm 2023\nbase hex  timestamps absolute\n \
        0.1 CAN 2 Status:chip status error active\n \
        0.2 CAN 1 Status: chip status warning level - TxErr: 100 RxErr: 0\n \
        0.3 CAN 1 Status:chip status warning level - TxErr: 0 RxErr: 96\n \
        0.4 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 128\n \
        0.5 CAN 1 Status:chip status busoff - TxErr: 256 RxErr: 0\n \
        0.6 CAN 1 Status:rx queue overrun\n 0.7 CAN 1 Status:chip status unknown - TxErr: 9\n \
        0.8 CAN 1 Status:chip status bus off\n \
        0.9 CAN 1 Status:chip status error passive - TxErr: 136, RxErr: 1\n \
        1.0 CAN 1 Status:chip status error passive - TxErr: 136 RxErr\n \
        1.1 CAN 1 Status:chip status error active - TxErr: 0 RxErr: 0\n";
    let trc_1 = ";$FILEVERSION=1.1\n;$STARTTIME=44548.6\n \
        1) 1.1 Warng FFFFFFFF 4 00 00 00 04 BUSLIGHT\n 2) 1.2 Warng FFFFFFFF 4 00 00 00 10 BUSOFF\n \
        3) 1.3 Warng FFFFFFFF 4 00 00 00 02 OVERRUN\n 4) 1.4 Warng FFFFFFFF 4 00\n";
    let trc_2 = ";$FILEVERSION=2.1\n;$STARTTIME=44548.6\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n \
        1 1.1 ST 2 - Rx - 4 00 00 00 00\n 2 1.2 ST 1 - - - 4 00 04 00 0C\n \
        3 1.3 ST 1 - Rx - 4 00 00 00 52\n 4 1.4 EC 1 - Rx - 2 60 02\n 5 1.5 EC 1 - Rx - 2 00 00\n";
    let blf = |counters: [u8; 2], code: u32| {
        blf(31, &[&[1, 0][..], &counters, &code.to_le_bytes()].concat())
    };
    // The numbers are those of the lines that cannot be read, and of the frames that are not all that the log
    // has of them.
    let trc_2_0 = ";$FILEVERSION=2.0\n;$STARTTIME=44548.6\n;$COLUMNS=N,O,T,I,d,l,D\n \
        1 1.1 ST          Rx    00 00 00 08\n 2 1.2 EC          Rx    60 02\n \
        3 1.3 ER          Rx    04 00 02 00 00\n 4 1.4 RR     0704 Rx 1\n";
    let logs: [ControllerLog; 7] = [
        (
            "ASC",
            asc.into(),
            &[
                "20000004#0040000000000000",
                "20000204#0008000000006400",
                "20000204#0004000000000060",
                "20000204#0030000000008480",
                "20000240#000000000000FF00",
                "20000040#0000000000000000",
                "20000204#0020000000008801",
                "20000004#0030000000000000",
                "20000204#0040000000000000",
            ],
            [1, 1],
        ),
        (
            "TRC 1",
            trc_1.into(),
            &["20000004#000C000000000000", "20000040#0000000000000000"],
            [1, 0],
        ),
        (
            "TRC 2",
            trc_2.into(),
            &[
                "20000004#0040000000000000",
                "20000004#0030000000000000",
                "20000040#0000000000000000",
                "20000200#0000000000000260",
                "20000200#0000000000000000",
            ],
            [0, 1],
        ),
        (
            "TRC 2.0",
            trc_2_0.into(),
            &[
                "20000004#000C000000000000",
                "20000200#0000000000000260",
                "20000088#0000840200000000",
                "704#R1",
            ],
            [0, 0],
        ),
        ("BLF", blf([130, 2], 0), &["20000200#0000000000008202"], [0, 0]),
        ("BLF with a code", blf([0, 3], 7), &["20000200#0000000000000003"], [0, 1]),
        ("BLF without counters", blf([0, 0], 7), &[], [0, 0]),
    ];
    for (name, log, expected, counts) in logs {
        let (frames, summary) = read(&log);
        let texts: Vec<String> = frames.iter().map(Frame::to_string).collect();
        assert_eq!(texts, expected, "{name}");
        assert_eq!([summary.unreadable, summary.changed.error_details], counts, "{name}");
    }
}

#[test]
fn states_of_the_controller_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let states = [
        "(1700000000.000000) ch1 123#11",
        "(1700000000.100000) ch1 20000004#0040000000000000",
        "(1700000000.200000) ch1 20000004#000C000000000000",
        "(1700000000.300000) ch1 20000004#0030000000000000",
        "(1700000000.400000) ch2 20000040#0000000000000000",
    ];
    // Only TRC has a line of counters alone, and only ASC one of a state and counters.
    let counters = "(1700000000.450000) ch1 20000200#0000000000000260";
    let with_counters = "(1700000000.500000) ch1 20000204#0010000000000280";
    let lines = states.into_iter().chain([counters, with_counters]);
    let lines: Vec<String> = lines.map(|line| format!("{line}\n")).collect();
    std::fs::write(folder.path().join("a.log"), lines.concat()).unwrap();
    let without = "(1700000000.500000) ch1 20000004#0030000000000000";
    for (format, last, lost) in [
        ("asc", &[with_counters][..], "1 error frame left out"),
        ("blf", &[counters, with_counters], ""),
        ("trc", &[counters, without], "1 error frame without details"),
    ] {
        let name = format!("a.{format}");
        let said = convert(folder.path(), "a.log", &name);
        assert!(said.contains(lost), "{said}");
        assert_eq!(said.contains("not in this format: 1"), format != "blf", "{said}");
        let output = descan(folder.path(), &["convert", &name, "-", "--format", "candump"]);
        let read = text(&output.stdout);
        let expected: Vec<&str> = states.iter().chain(last).copied().collect();
        assert_eq!(read.lines().collect::<Vec<_>>(), expected, "{format}");
    }
}

#[test]
fn state_that_a_format_holds_in_part_is_written_so_far() {
    let folder = tempfile::tempdir().unwrap();
    for (frame, written) in [
        ("20000040#000000000000F800", "20000040#0000000000000000"),
        ("20000044#003C00000000F800", "20000240#000000000000F800"),
        ("20000040#", "20000040#0000000000000000"),
        ("20000100#0000000000000000", "20000004#0040000000000000"),
        ("20000004#0008000000000000", "20000004#000C000000000000"),
    ] {
        std::fs::write(folder.path().join("a.log"), format!("(1.000000) ch1 {frame}\n")).unwrap();
        let said = convert(folder.path(), "a.log", "a.asc");
        assert!(said.contains("1 error frame without details"), "{frame}: {said}");
        let output = descan(folder.path(), &["convert", "a.asc", "-", "--format", "candump"]);
        let read = text(&output.stdout);
        assert!(read.trim_end().ends_with(written), "{frame}: {read}");
        std::fs::remove_file(folder.path().join("a.asc")).unwrap();
    }
}

#[test]
fn log_that_begins_in_the_repeated_hour_says_so() {
    let folder = tempfile::tempdir().unwrap();
    // 2:30 of 29 October 2023 in Berlin, for the first and for the second time.
    for (name, seconds, is_second) in
        [("first", 1_698_539_400, false), ("second", 1_698_543_000, true)]
    {
        let line = format!("({seconds}.000000) can0 123#11\n({}.5) can0 123#22\n", seconds + 1);
        std::fs::write(folder.path().join(name), line).unwrap();
        for format in ["asc", "trc", "blf"] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
            command.args(["convert", name, &format!("{name}.{format}")]);
            let output =
                command.current_dir(folder.path()).env("TZ", "Europe/Berlin").output().unwrap();
            let said = text(&output.stderr);
            let is_said = said.contains("all times too early, as clocks were set back then");
            assert_eq!(is_said, is_second && format != "blf", "{name} {format}: {said}");
        }
    }
}

#[test]
fn log_with_a_date_of_the_repeated_hour_says_so_when_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let line = " 0.5 1 123 Rx d 1 11";
    for (is_twice, hour) in [(false, 1), (true, 2), (false, 3)] {
        for log in [
            format!(
                "date Sun Oct 29 {hour}:30:00.000 2023\nbase hex  timestamps absolute\n{line}\n"
            ),
            format!(
                ";$FILEVERSION=2.0\n;$STARTTIME={}\n;$COLUMNS=N,O,T,I,d,l,D\n 1 0.5 DT 0123 Rx 1 11\n",
                45228.0 + (f64::from(hour) + 0.5) / 24.0
            ),
            format!(" (2023-10-29 0{hour}:30:00.000000)  can0  123   [1]  11\n"),
        ] {
            fs::write(folder.path().join("in"), &log).unwrap();
            let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
            command.args(["log", "in"]).current_dir(folder.path()).env("TZ", "Europe/Berlin");
            let said = text(&command.output().unwrap().stderr);
            let cause = "its date comes twice, as clocks were set back then: its times may be off by \
                         that step";
            assert_eq!(said.contains(cause), is_twice, "{log}: {said}");
        }
        // The first frame before the hour, and after it.
        for frame in ["can0 123#11", " can0  123   [1]  11"] {
            let hours = [0, hour, 4];
            let lines = hours.map(|hour| format!("(2023-10-29 0{hour}:30:00.0) {frame}\n"));
            fs::write(folder.path().join("in"), lines.concat()).unwrap();
            let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
            command.args(["log", "in"]).current_dir(folder.path()).env("TZ", "Europe/Berlin");
            let said = text(&command.output().unwrap().stderr);
            assert_eq!(said.contains("its date comes twice"), is_twice, "{lines:?}: {said}");
        }
        // A measurement whose start is given as local time.
        let mut measurement = include_bytes!("../corpus/mdf/unsorted").to_vec();
        let hours = 471_816 + i64::from(hour);
        let nanos = (hours * 3600 + 1800) * 1_000_000_000;
        // The header is behind the 64 bytes of the identification; its data behind six links.
        let start = 64 + 24 + 6 * 8;
        measurement[start..start + 8].copy_from_slice(&nanos.to_le_bytes());
        measurement[start + 12] = 1;
        fs::write(folder.path().join("in"), &measurement).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(["log", "in"]).current_dir(folder.path()).env("TZ", "Europe/Berlin");
        let said = text(&command.output().unwrap().stderr);
        assert_eq!(said.contains("its date comes twice"), is_twice, "{hour}: {said}");
    }
}

#[test]
fn second_of_two_hours_is_read_where_lines_go_back() {
    let folder = tempfile::tempdir().unwrap();
    for (frame, hours, expected, is_known) in [
        (
            "can0 123#11",
            &["01:59:50", "02:30:00", "02:59:59", "02:00:01", "02:30:00", "03:00:01"][..],
            &[0, 1810, 3609, 3611, 5410, 7211][..],
            true,
        ),
        // Silence of more than half an hour.
        (
            " can0  123   [1]  11",
            &["01:59:50", "02:50:00", "02:05:00", "02:45:00", "03:00:00"],
            &[0, 3010, 3910, 6310, 7210],
            true,
        ),
        (" can0  123   [1]  11", &["01:59:50", "02:40:00", "02:05:00"], &[0, 2410, 3910], true),
        // The second frame may be of the second hour: the last two are not in order.
        (
            "can0 123#11",
            &["01:59:50", "02:59:59", "03:00:01", "02:59:59"],
            &[0, 3609, 7211, 7209],
            false,
        ),
        // Not in order, in the first hour.
        ("can0 123#11", &["02:30:01", "02:30:00"], &[1811, 1810], false),
        // A clock that was set back by two seconds, or nearly an hour of silence.
        ("can0 123#11", &["02:30:02", "02:30:00", "02:30:10"], &[1812, 5410, 5420], false),
        // By 29 minutes, or 31 minutes of silence.
        (
            "can0 123#11",
            &["01:59:50", "02:50:00", "02:21:00", "02:59:50"],
            &[0, 3010, 4870, 7200],
            false,
        ),
        // Two steps back: one of them is none of summer time.
        (
            "can0 123#11",
            &["02:40:00", "02:10:00", "02:59:50", "02:00:00", "03:00:00"],
            &[2410, 4210, 7200, 3610, 7210],
            false,
        ),
        // Another recording behind the first one.
        (
            "can0 123#11",
            &["02:59:50", "02:00:00", "01:59:00", "02:30:00"],
            &[3600, 3610, -50, 1810],
            false,
        ),
        (
            "can0 123#11",
            &["02:30:00", "01:59:00", "02:59:50", "02:00:00"],
            &[1810, -50, 3600, 3610],
            false,
        ),
    ] {
        let lines = hours.iter().map(|hour| format!("(2023-10-29 {hour}.5) {frame}\n"));
        fs::write(folder.path().join("in"), lines.collect::<String>()).unwrap();
        let commands = [
            &["convert", "in", "-", "--format", "candump"][..],
            // Writes frames in the order of their times.
            &["log", "in", "--write", "out.log"],
        ];
        for arguments in commands.into_iter().take(1 + usize::from(is_known)) {
            let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
            command.args(arguments).current_dir(folder.path()).env("TZ", "Europe/Berlin");
            let output = command.output().unwrap();
            let written = fs::read(folder.path().join("out.log")).unwrap_or(output.stdout);
            let seconds: Vec<_> = text(&written)
                .lines()
                .map(|line| {
                    line[1..line.find('.').unwrap()].parse::<i64>().unwrap() - 1_698_537_590
                })
                .collect();
            assert_eq!(seconds, expected, "{arguments:?} {hours:?}");
            let said = text(&output.stderr);
            assert_eq!(said.contains("comes twice"), !is_known, "{arguments:?} {hours:?}: {said}");
            let _ = fs::remove_file(folder.path().join("out.log"));
        }
    }
}

/// Returns what `convert` says of lines with these dates in Berlin.
fn said_of_dates(dates: &[String]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let lines = dates.iter().map(|date| format!("({date}) can0 123#11\n"));
    fs::write(folder.path().join("in"), lines.collect::<String>()).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command.args(["convert", "in", "-", "--format", "candump"]);
    text(&command.current_dir(folder.path()).env("TZ", "Europe/Berlin").output().unwrap().stderr)
}

#[test]
fn each_repeated_hour_shows_by_itself_which_one_it_is() {
    let days = ["2024-10-27", "2025-10-26", "2026-10-25"];
    let hours: [&[&str]; 3] = [&[], &["02:59:50", "02:00:00"], &["02:20:00", "02:30:00"]];
    for kinds in 0..27 {
        let kinds = [kinds % 3, kinds / 3 % 3, kinds / 9];
        let dates = days
            .iter()
            .zip(kinds)
            .flat_map(|(day, kind)| hours[kind].iter().map(move |hour| format!("{day} {hour}.5")));
        let dates: Vec<_> = dates.collect();
        let said = said_of_dates(&dates);
        assert_eq!(said.contains("comes twice"), kinds.contains(&2), "{dates:?}: {said}");
    }
}

#[test]
fn doubtful_dates_of_a_log_that_is_read_in_part_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let dates = [
        ("2026-10-25 02:10:00.5", "comes twice"),
        ("2026-03-29 02:30:00.5", "set TZ to the zone of the log"),
    ];
    for (date, what) in dates {
        let lines = format!("({date}) can0 123#11\n").repeat(20_000);
        fs::write(folder.path().join("in"), &lines).unwrap();
        for log in ["in", "-"] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
            command.args(["log", log, "--limit", "1"]).env("TZ", "Europe/Berlin");
            command.stdin(File::open(folder.path().join("in")).unwrap());
            let output = command.current_dir(folder.path()).output().unwrap();
            assert_eq!(text(&output.stdout).lines().count(), 1, "{date} {log}");
            let said = text(&output.stderr);
            assert_eq!(said.matches(what).count(), 1, "{date} {log}: {said}");
        }
    }
}

#[test]
fn doubtful_dates_behind_the_part_that_is_read_are_not_said() {
    let folder = tempfile::tempdir().unwrap();
    for frame in [" 123#11", "  123   [1]  11"] {
        for names in [["can0", "can0"], ["can0", "can1"]] {
            let line = |time, name| format!(" (2026-10-25 {time})  {name}{frame}\n");
            let lines = line("01:59:00.500000", names[0]).repeat(4)
                + &line("02:10:00.500000", names[1]).repeat(20_000);
            fs::write(folder.path().join("in"), lines).unwrap();
            for (limit, is_said) in [("1", false), ("4", false), ("5", true), ("9", true)] {
                let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
                command.args(["log", "-", "--limit", limit]).env("TZ", "Europe/Berlin");
                command.stdin(File::open(folder.path().join("in")).unwrap());
                let output = command.output().unwrap();
                assert_eq!(text(&output.stdout).lines().count().to_string(), limit);
                let said = text(&output.stderr);
                assert_eq!(said.contains("comes twice"), is_said, "{names:?} {limit}: {said}");
            }
        }
    }
}

/// Converts a log to candump text where local time is that of Berlin.
fn convert_in_berlin(folder: &Path, log: &str) -> Output {
    fs::write(folder.join("in"), log).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command.args(["convert", "in", "-", "--format", "candump"]);
    command.current_dir(folder).env("TZ", "Europe/Berlin").output().unwrap()
}

#[test]
fn start_of_a_trc_in_utc_is_not_read_as_local_time() {
    let folder = tempfile::tempdir().unwrap();
    // In local time it would be one of the hour that comes twice.
    for (zone, expected) in [("+00:00", "1698543000.000500"), ("", "1698535800.000500")] {
        let log = format!(
            ";$FILEVERSION=2.1\n;$STARTTIME=45228.0625\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n;\n\
             ;   Start time: 2023-10-29 01:30:00{zone}\n 1 0.5 DT 1 0123 Rx - 1 11\n"
        );
        let output = convert_in_berlin(folder.path(), &log);
        assert_eq!(text(&output.stdout), format!("({expected}) ch1 123#11\n"), "{zone}");
        assert_eq!(text(&output.stderr), "descan: file:in: 1 frame\n", "{zone}");
    }
    // Version 1.0 has no other start; one just after 1970 is before it in local time.
    for (log, expected) in [
        (
            ";$FILEVERSION=1.0\n;   Start time: 2023-10-29 01:30:00.25+00:00\n 1) 0.5 0123 1 11\n",
            "1698543000.250500",
        ),
        (
            ";$FILEVERSION=2.1\n;$STARTTIME=25569.000011574074\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n\
             ;   Start time: 1970-01-01 00:00:01+00:00\n 1 0.5 DT 1 0123 Rx - 1 11\n",
            "0000000001.000500",
        ),
    ] {
        let output = convert_in_berlin(folder.path(), log);
        assert_eq!(text(&output.stdout), format!("({expected}) ch1 123#11\n"), "{log}");
        assert!(output.status.success(), "{output:?}");
    }
}

#[test]
fn files_of_blf_behind_one_another_are_one_log() {
    let folder = tempfile::tempdir().unwrap();
    for (name, second) in [("one", 100), ("two", 200)] {
        let log = format!("({second}.000000) can0 123#11\n({second}.500000) can0 123#22\n");
        fs::write(folder.path().join(name), log).unwrap();
        let output = descan(folder.path(), &["convert", name, &format!("{name}.blf")]);
        assert!(output.status.success(), "{output:?}");
    }
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    let (one, two) = (read("one.blf"), read("two.blf"));
    // Behind the only container, by its size.
    let padding = usize::from(one[144 + 8] % 4);
    for between in [0, 4].map(|count| vec![0; count]) {
        for padding in [0, padding] {
            let both = [&one[..one.len() - padding], &between, &two].concat();
            fs::write(folder.path().join("both.blf"), both).unwrap();
            check_both(folder.path());
        }
    }
}

/// Checks that `both.blf` has the frames of two files.
fn check_both(folder: &Path) {
    let output = descan(folder, &["convert", "both.blf", "-", "--format", "candump"]);
    let line = |(second, data)| format!("(0000000{second}00000) ch1 123#{data}\n");
    let expected = [("100.0", 11), ("100.5", 22), ("200.0", 11), ("200.5", 22)].map(line).concat();
    assert_eq!(text(&output.stdout), expected, "{}", text(&output.stderr));
}

#[test]
fn dates_of_a_zone_that_is_not_known_are_said_to_be_read_as_utc() {
    let folder = tempfile::tempdir().unwrap();
    let mut measurement = include_bytes!("../corpus/mdf/unsorted").to_vec();
    // The flags of the header, which is behind the 64 bytes of the identification: local time.
    measurement[64 + 24 + 6 * 8 + 12] |= 1;
    let frame = " 0.5 1 123 Rx d 1 11";
    let asc = format!("date Sun Oct 29 9:30:00.000 2023\nbase hex  timestamps absolute\n{frame}\n");
    let trc =
        ";$FILEVERSION=2.0\n;$STARTTIME=45228.5\n;$COLUMNS=N,O,T,I,d,l,D\n 1 0.5 DT 0123 Rx 1 11\n";
    for (name, is_local, log) in [
        ("candump -t A", true, b"(2026-06-25 02:10:00.5) can0 123#11\n".as_slice()),
        ("ASC", true, asc.as_bytes()),
        ("TRC", true, trc.as_bytes()),
        ("MDF", true, &measurement),
        ("candump -l", false, b"(1792888200.5) can0 123#11\n"),
        ("ASC without a date", false, b"base hex  timestamps absolute\n 0.5 1 123 Rx d 1 11\n"),
        (
            "TRC without a start",
            false,
            b";$FILEVERSION=2.0\n;$COLUMNS=N,O,T,I,d,l,D\n 1 0.5 DT 0123 Rx 1 11\n",
        ),
    ] {
        fs::write(folder.path().join("in"), log).unwrap();
        let zones = [
            ("CET-1CEST", true),
            ("Nonsense/Zone", true),
            ("Europe/Berlin", false),
            ("CET-1CEST,M3.5.0,M10.5.0/3", false),
            ("", false),
        ];
        for (zone, is_unknown) in zones {
            let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
            command.args(["convert", "in", "-", "--format", "candump"]);
            let output = command.current_dir(folder.path()).env("TZ", zone).output().unwrap();
            assert!(!output.stdout.is_empty(), "{name} {zone}");
            let said = text(&output.stderr);
            let is_said = said.contains("the time zone in TZ is not known here");
            assert_eq!(is_said, is_local && is_unknown, "{name} {zone}: {said}");
        }
    }
}

#[test]
fn lines_out_of_order_behind_the_second_hour_are_in_it() {
    let times = ["03:00:00.1", "02:59:59.9", "02:59:59.95", "03:00:00.2"];
    let dates = times.map(|time| format!("2026-10-25 {time}"));
    assert!(!said_of_dates(&dates).contains("comes twice"));
}

#[test]
fn date_that_clocks_skip_is_of_another_time_zone() {
    for (hour, is_said) in [(1, false), (2, true), (3, false)] {
        let said = said_of_dates(&[format!("2026-03-29 0{hour}:30:00.5")]);
        let expected = "set TZ to the zone of the log";
        assert_eq!(said.contains(expected), is_said, "{said}");
    }
}

#[test]
fn date_that_does_not_exist_is_said() {
    for date in ["2026-02-29 12:00:00.5", "2026-13-01 12:00:00.5", "1969-12-31 12:00:00.5"] {
        let said = said_of_dates(&["2026-02-28 12:00:00.5".to_owned(), date.to_owned()]);
        let expected = "line 2 cannot be read: the date does not exist, or is before 1970";
        assert!(said.contains(expected), "{date}: {said}");
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    compress_to_vec(bytes, CompressionLevel::Fastest)
}

// --- what candump prints ------------------------------------------------------------------

#[test]
fn screen_of_candump_is_read_in_all_its_forms() {
    for (line, frame) in [
        ("  can0  02015402   [5]  04 44 45 53 01", "1 can0 02015402#0444455301"),
        ("  can0  123   [0] ", "1 can0 123#"),
        ("  can0  123   [4]  remote request", "1 can0 123#R4"),
        ("  can0  TX - -  123   [2]  11 22", "1 can0 123#1122 T"),
        ("  can0  RX B E  123  [02]  11 22", "1 can0 123##31122"),
        (
            "  can0  123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B",
            "1 can0 123##0000102030405060708090A0B",
        ),
        ("  vcan_long0       123   [2]  11 22   '.\"'", "1 vcan_long0 123#1122"),
        ("  can0  123   [3]  33`22`11", "1 can0 123#112233"),
        ("  can0  123   {F}  11 22 33 44 55 66 77 88", "1 can0 123#1122334455667788_F"),
        (
            "  can0  20000080   [8]  00 00 0A 00 00 00 00 00   ERRORFRAME",
            "1 can0 20000080#00000A0000000000",
        ),
        (" \x1B[1m\x1B[31m  can0\x1B[0m  123   [1]  11", "1 can0 123#11"),
    ] {
        for (time, expected) in [(" (0000000000.000001)", true), ("", false)] {
            let log = format!("{time}{line}\n");
            let frames = dated(log.as_bytes());
            let expected = if expected { frame.to_owned() } else { frame.replacen('1', "0", 1) };
            assert_eq!(frames, [expected], "{log}");
        }
    }
    let (_, summary) =
        read(b"  can0  123   [1]  11\n\tprotocol-violation{{}{}}\n  can0  1234   [1]  11\n");
    assert_eq!(
        summary.to_string(),
        "1 frame; line 3 cannot be read: the identifier is not 3 or 8 hexadecimal digits in range; \
         without times"
    );
}

#[test]
fn colours_before_the_time_are_passed_over() {
    let log = b"\x1B[1m\x1B[31m (0000000001.000000)  can0  123   [1]  11\x1B[0m\n";
    assert_eq!(dated(log), ["1000000 can0 123#11"]);
}

#[test]
fn times_of_candump_are_read_in_all_their_forms() {
    let log = |times: &[&str], frame: &str| -> String {
        times.iter().fold(String::new(), |log, time| log + &format!("({time}) {frame}\n"))
    };
    let micros = |log: &str| -> Vec<u64> {
        let (frames, summary) = read(log.as_bytes());
        let epoch = summary.epoch.unwrap();
        frames.iter().map(|frame| epoch.unix_micros(frame.time)).collect()
    };
    let within = |log: &str, before: &str, after: &str| {
        log.lines().map(|line| [before, line, after, "\n"].concat()).collect::<String>()
    };
    for frame in ["can0 123#11", " can0  123   [1]  11"] {
        let since_start = ["000.000000", "000.500000", "000.900000", "001.200000"];
        assert_eq!(micros(&log(&since_start, frame)), [0, 500_000, 900_000, 1_200_000]);
        let differences = ["000.000000", "000.500000", "000.900000", "000.200000", "001.000000"];
        assert_eq!(
            micros(&log(&differences, frame)),
            [0, 500_000, 1_400_000, 1_600_000, 2_600_000]
        );
        // As candump prints them: the first lines are no others.
        let late = ["000.000000", "000.005000", "000.010000", "000.015000", "000.001000"];
        let printed = log(&late, frame);
        let mut all = vec![within(&printed, " ", "")];
        all.extend(["\n", "\r\n", "\n\n", "  \n\t\n"].map(|blank| format!("{blank}{printed}")));
        // Lines without a frame: of an editor, of `script`, of candump itself.
        let dropped = "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)\n";
        for other in [
            "\u{feff}",
            "\u{feff}\n",
            "# a\n\n# b\n# c\n",
            "Script started on 2026-11-28\n",
            "user@host:~$ candump -t d can0\n",
            dropped,
        ] {
            all.push(format!("{other}{printed}"));
        }
        all.push(printed.replacen('\n', &format!("\n{dropped}"), 1));
        if frame.contains('[') {
            all.push(within(&printed, "\x1b[1m\x1b[31m ", "\x1b[0m"));
        }
        for log in all {
            assert_eq!(micros(&log), [0, 5000, 15_000, 30_000, 31_000], "{log}");
        }
        // Equal ones are differences, too: no two frames begin at once.
        let equal = ["000.000000", "000.100000", "000.100000"];
        assert_eq!(micros(&log(&equal, frame)), [0, 100_000, 200_000]);
        let hours = ["998.000000", "999.000000", "1000.000000"];
        assert_eq!(micros(&log(&hours, frame)), [998_000_000, 999_000_000, 1_000_000_000]);
    }
    // With nanoseconds, as `candump -N` prints them.
    for frame in ["can0 123#11", " can0  123   [1]  11"] {
        let differences = ["000.000000000", "000.500000900", "000.900000200", "000.200000000"];
        assert_eq!(micros(&log(&differences, frame)), [0, 500_000, 1_400_001, 1_600_001]);
        let since_start = ["000.000000000", "000.500000900", "000.900000200"];
        assert_eq!(micros(&log(&since_start, frame)), [0, 500_000, 900_000]);
    }
    // A step back after the eighth line is one of the clock.
    let rising: Vec<_> =
        (1..=9).map(|at| format!("00{at}.000000")).chain(["002.000000".into()]).collect();
    let rising: Vec<_> = rising.iter().map(String::as_str).collect();
    let (_, summary) = read(log(&rising, "can0 123#").as_bytes());
    assert_eq!(summary.clock_steps_back, 1);
}

#[test]
fn frames_without_times_are_dated_when_they_arrive() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(["convert", "-", "-", "--format", "candump"])
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(b"  can0  123   [1]  11\n  can0  124   [0]\n").unwrap();
    let mut printed = String::new();
    child.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    child.wait().unwrap();
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs();
    for line in printed.lines() {
        let seconds: u64 = line[1..].split('.').next().unwrap().parse().unwrap();
        assert!((now - 60..=now).contains(&seconds), "{printed}");
    }
    assert_eq!(printed.lines().count(), 2);
}

/// A pipe that waits before each piece; the time at which the last one came.
struct SlowPipe(std::collections::VecDeque<&'static [u8]>);

static ARRIVED: AtomicU64 = AtomicU64::new(0);

impl Read for SlowPipe {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let Some(piece) = self.0.pop_front() else { return Ok(0) };
        ARRIVED.fetch_add(1_000_000, Ordering::Relaxed);
        buffer[..piece.len()].copy_from_slice(piece);
        Ok(piece.len())
    }
}

#[test]
fn frame_without_time_has_that_of_its_own_arrival() {
    let pieces: [&[u8]; 5] = [
        b"  can0  123  [0]\n",
        b"  can0  124  [0]\n",
        b"  can0  1",
        b"25  [0]\n",
        b"  can0  126  [0]\n",
    ];
    let mut reader = LogReader::new(BufReader::new(SlowPipe(pieces.into_iter().collect())));
    reader.date_arrivals(|| ARRIVED.load(Ordering::Relaxed));
    let mut seconds = Vec::new();
    while reader.next_frame().unwrap().is_some() {
        seconds.push(reader.summary().written.micros / 1_000_000);
    }
    assert_eq!(seconds, [1, 2, 4, 5]);
}

#[test]
fn last_line_without_end_is_said() {
    let whole = "(1.0) can0 123#11\n(2.0) can0 123#1122334455667788\n";
    assert!(!read(whole.as_bytes()).1.to_string().contains("no end"));
    for bytes in [whole.len() - 1, whole.len() - 7, whole.len() - 13] {
        let said = read(&whole.as_bytes()[..bytes]).1.to_string();
        assert!(said.contains("the last line has no end: it may be cut off"), "{bytes}: {said}");
    }
    assert!(!read(b"(1.0) can0 123#11\n  ").1.to_string().contains("no end"));
}

#[test]
fn zstd_log_that_begins_with_a_skippable_frame_is_read() {
    let log = zstd(KINDS.as_bytes());
    for magic in [0x50, 0x5F] {
        let skipped = [magic, 0x2A, 0x4D, 0x18, 4, 0, 0, 0, 1, 2, 3, 4];
        let packed = [&skipped[..], &log, &skipped, &log].concat();
        assert_eq!(read(&packed).0.len(), 2 * KINDS.lines().count());
    }
    assert_eq!(read(b"PK is no log\n").0.len(), 0);
}

// --- convert ------------------------------------------------------------------------------

#[test]
fn every_format_holds_every_kind_of_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("in.log"), KINDS).unwrap();
    for ending in ["pcapng", "asc", "blf", "trc"] {
        let log = format!("out.{ending}");
        let said = convert(path, "in.log", &log);
        assert!(!said.contains("not in this format"), "{ending}: {said}");
        convert(path, &log, &format!("{ending}.log"));
        let again = fs::read_to_string(path.join(format!("{ending}.log"))).unwrap();
        assert_eq!(again, KINDS, "{ending}");
    }
    let said = convert(path, "in.log", "out.csv");
    assert!(
        said.ends_with(
            "out.csv: not in this format: 3 remote frames left out; 2 error frames left out; 3 FD frames \
             without FDF, BRS or ESI; 1 classic frame with a DLC of 8 in place of one above; the names of interfaces: ch1 is number 0, ch2 is number 1\n"
        ),
        "{said}"
    );
    convert(path, "out.csv", "csv.log");
    let again = fs::read_to_string(path.join("csv.log")).unwrap();
    assert_eq!(again.lines().count(), KINDS.lines().count() - 5);
    assert!(again.starts_with("(1700000000.123456) bus0 02015402#0444455301\n"), "{again}");
}

/// Returns a BLF log with one object, of this type and with these bytes behind its head.
fn blf(kind: u32, body: &[u8]) -> Vec<u8> {
    let mut log = [&b"LOGG"[..], &144_u32.to_le_bytes(), &[0; 136]].concat();
    let size = 32 + body.len() as u32;
    for word in [1 << 16 | 32, size, kind, 2, 0, 0, 0] {
        if word == 1 << 16 | 32 {
            log.extend_from_slice(b"LOBJ");
        }
        log.extend_from_slice(&word.to_le_bytes());
    }
    log.extend_from_slice(body);
    log
}

/// Returns an error frame of a BLF log, with the flags of its valid fields; the identifier and data are those of
/// the frame with the error.
fn blf_error(flags: u32) -> Vec<u8> {
    let (code, position, dlc) = (0x82, 5, 2);
    let head = [&[1, 0, 0, 0][..], &flags.to_le_bytes(), &[code, position, dlc, 0]].concat();
    let rest = [&[0; 4][..], &0x123_u32.to_le_bytes(), &[0xA2, 0x20, 0, 0], &[0x55; 8]].concat();
    blf(73, &[head, rest].concat())
}

#[test]
fn details_of_error_frames_are_read_or_said_to_be_left() {
    let asc = |event: &str| {
        let head = "date Tue Nov 14 10:13:20.123 pm 2023\nbase hex  timestamps absolute\n";
        [head, " 0.0 ", event, "\n"].concat().into_bytes()
    };
    let trc = |version: &str, line: &str| {
        let head = format!(";$FILEVERSION={version}\n;$STARTTIME=44548.6\n");
        [&head, line, "\n"].concat().into_bytes()
    };
    let v2 = "2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D";
    let fd_error = [&[1, 15, 64, 0xC7, 0xFE, 0xFF, 0xCA, 0x31][..], &[0; 40]].concat();
    // A stuff error, received, behind the start; a frame without an acknowledgement, sent.
    let (stuff, no_ack) = ("20000088#0000040000000000", "200000A8#0000800000000000");
    for (name, log, frame, is_said) in [
        ("ASC", asc("1  ErrorFrame"), "20000080#0000000000000000", false),
        ("ASC", asc("1  ErrorFrame  ECC: 10100010"), "20000088#0000040200000000", false),
        (
            "ASC",
            asc(
                "2 ErrorFrame Flags = 0xe CodeExt = 0x20a2 Code = 0x82 ID = 0 DLC = 0 Position = 5",
            ),
            stuff,
            true,
        ),
        (
            "ASC",
            asc("2 ErrorFrame Flags = 0x1 CodeExt = 0 Code = 0xa2 ID = 0 DLC = 0"),
            "20000088#0000040200000000",
            true,
        ),
        (
            "ASC",
            asc(
                "CANFD   5 Tx ErrorFrame Not Acknowledge error, dominant error flag fffe c7 31ca Arb. 556 44 0 0",
            ),
            "200000A8#0000800000000000 T",
            true,
        ),
        ("ASC", asc("1 ErrorFrame Rx"), "20000080#0000000000000000", false),
        ("ASC", asc("1 ErrorFrame  ECC: 101000101"), "20000080#0000000000000000", true),
        ("ASC", asc("1 ErrorFrame some words ab cd ef"), "20000080#0000000000000000", true),
        ("BLF", blf_error(1), "20000088#0000840200000000", true),
        ("BLF", blf_error(0xE), stuff, true),
        ("BLF", blf_error(8), "20000080#0000000000000000", true),
        ("BLF of CAN FD", blf(104, &fd_error), no_ack, true),
        (
            "TRC 1.0",
            trc("1.0", "2) 1842 0008 4 ERROR 00 19 08 07"),
            "20000288#0000801900000708",
            false,
        ),
        (
            "TRC 1.1",
            trc("1.1", "2) 1842.5 Error 0004 4 01 19 00 00"),
            "20000088#0000041900000000",
            false,
        ),
        (
            "TRC 1.3",
            trc("1.3", "2) 1842.5 1 Error 0002 - 4 01 19 60 00"),
            "20000288#0000021900000060",
            false,
        ),
        ("TRC 2.1", trc(v2, "1 0.0 ER 1 - Tx - 3 04 01 19"), "20000088#0000041900000000 T", false),
    ] {
        let (_, summary) = read(&log);
        let said = summary.to_string();
        let expected = u64::from(is_said);
        assert_eq!(summary.changed.error_details, expected, "{name} {frame}: {said}");
        assert_eq!(said.contains("without all details"), is_said, "{said}");
        let read = dated(&log).remove(0);
        let (_, read) = read.split_once(' ').unwrap().1.split_once(' ').unwrap();
        assert_eq!(read, frame, "{name}");
    }
}

#[test]
fn frames_that_are_on_no_bus_are_said_to_be_changed() {
    let padded = "(1.000000) can0 123##1112233445566778899\n(2.000000) can0 123##100\n";
    let (frames, summary) = read(padded.as_bytes());
    assert_eq!(frames.iter().map(Frame::len).collect::<Vec<_>>(), [12, 1]);
    assert_eq!(summary.to_string(), "2 frames; 1 frame padded with zeros to the length of a DLC");
    let remote = "date Tue Nov 14 10:13:20.123 pm 2023\nbase hex  timestamps absolute\n \
        0.0 CANFD 1 Rx 123 0 0 8 0 0 0 1010 0 0 0 0 0\n";
    let (frames, summary) = read(remote.as_bytes());
    assert_eq!(frames[0].to_string(), "123#R8");
    assert_eq!(
        summary.to_string(),
        "1 frame; 1 remote frame of the log in FD format, which has none"
    );
}

#[test]
fn milliseconds_without_leading_zeros_are_those_of_the_date() {
    for (fraction, millis) in [("1", 1), ("50", 50), ("050", 50), ("191", 191)] {
        let date = format!("Tue Nov 14 10:13:20.{fraction} pm 2023");
        let log = format!("date {date}\nbase hex  timestamps absolute\n 0.0 1  123  Rx   d 1 11\n");
        assert_eq!(micros_of(log.as_bytes()) / 1000 % 1000, millis, "{fraction}");
    }
}

#[test]
fn times_of_python_can_are_the_nearest_microsecond() {
    let head = "timestamp,arbitration_id,extended,remote,error,dlc,data\n";
    let log = format!("{head}1700000000.0219998,0x123,0,0,0,0,\n");
    assert_eq!(micros_of(log.as_bytes()), 1_700_000_000_022_000);
}

#[test]
fn csv_of_python_can_without_a_header_is_read() {
    let rows = "1700000000.5,0x12,0,0,0,2,AQI=\n1700000001,0x1FFFFFFF,1,1,0,3,\n";
    let (frames, summary) = read(rows.as_bytes());
    let all: Vec<String> = frames.iter().map(ToString::to_string).collect();
    assert_eq!(all, ["012#0102", "1FFFFFFF#R3"]);
    assert_eq!(summary.unreadable, 0);
    // Rows of other programs are not taken for it.
    for other in ["1700000000.5,18,0,0,0,2,AQI=\n", "1700000000.5,0x12,0,0,0,2,0102\n"] {
        assert_eq!(read(other.as_bytes()).1.unreadable, 1, "{other}");
    }
}

#[test]
fn interfaces_that_share_the_last_channel_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let line = |number: u32| format!("(1.{number:06}) can{number} 001#\n");
    for (count, shared) in [(255, 0), (256, 1)] {
        let log: String = (0..count).map(line).collect();
        fs::write(folder.path().join("many.log"), log).unwrap();
        for to in ["asc", "blf"] {
            let said = convert(folder.path(), "many.log", &format!("many{count}.{to}"));
            let expected = "1 interface with the number of another, as there are no more";
            assert_eq!(said.matches(expected).count(), shared, "{to}: {said}");
        }
    }
}

#[test]
fn transmit_requests_of_blf_are_no_frames() {
    // A frame of CAN FD in the older and in the newer object, and a classic one.
    let old = |direction: u8| [&[1, 0, direction, 1, 0x23, 1, 0, 0][..], &[0; 80]].concat();
    let mut new = [&[1, 1, 1, 0, 0x23, 1, 0, 0][..], &[0; 40]].concat();
    for (log, count) in [
        (blf(1, &old(2)), 0),
        (blf(1, &old(0)), 1),
        (blf(86, &old(1)), 1),
        (blf(100, &old(2)), 0),
        (blf(101, &new), 1),
    ] {
        let (frames, summary) = read(&log);
        assert_eq!((frames.len(), summary.unreadable), (count, 0), "{summary}");
        assert_eq!(summary.transmit_requests, 1 - count as u64);
    }
    new[34] = 2;
    assert_eq!(read(&blf(101, &new)).0.len(), 0);
}

#[test]
fn transmit_requests_of_asc_are_counted() {
    let head = "date Tue Nov 14 10:13:20 pm 2023\nbase hex timestamps absolute\n";
    let requests = "0.1 1 123 TxRq d 0\n0.2 1 123 TxRq d 0\n";
    let (frames, summary) = read(format!("{head}{requests}0.3 1 123 Tx d 0\n").as_bytes());
    assert_eq!((frames.len(), summary.unreadable), (1, 0));
    assert_eq!(summary.to_string(), "1 frame; 2 transmit requests, not read");
    let (_, summary) = read(format!("{head}{requests}").as_bytes());
    assert_eq!(summary.to_string(), "0 frames; 2 transmit requests, not read");
}

#[test]
fn bytes_that_a_blf_object_lacks_are_said() {
    let mut body = [&[1, 15, 64, 0, 0x23, 1, 0, 0][..], &[0; 32], &[0x55; 48]].concat();
    body[13] = 0x10;
    let (frames, summary) = read(&blf(101, &body));
    assert_eq!(frames[0].data(), [[0x55; 48].as_slice(), &[0; 16]].concat());
    assert!(summary.to_string().contains("1 frame padded with zeros"), "{summary}");
}

/// Returns the times of the frames of a log in nanoseconds since 1970.
fn nanos_of(log: &[u8]) -> Vec<u64> {
    let mut reader = LogReader::new(BufReader::new(Unpacked::new(log)));
    let mut all = Vec::new();
    while reader.next_frame().unwrap().is_some() {
        let written = reader.summary().written;
        all.push(written.micros * 1000 + u64::from(written.nanos));
    }
    all
}

#[test]
fn nanoseconds_of_times_are_kept_where_the_format_has_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let log = "\
(1700000000.123456000) can0 123#11
(1700000000.123456789) can1 123#22
(1700000001.000000001) can0 02015402#0444455301
(1700000001.000001000) can0 02015402#0444455302
(1700000002.999999999) can1 123#33
";
    let nanos = nanos_of(log.as_bytes());
    let seconds = 1_700_000_000_000_000_000;
    let expected = [123_456_000, 123_456_789, 1_000_000_001, 1_000_001_000, 2_999_999_999];
    assert_eq!(nanos, expected.map(|it| seconds + it));
    let screen = "\
(2023-11-14 22:13:20.123456789)  can0  123   [1]  11
(2023-11-14 22:13:20.123456790)  can0  123   [1]  22
";
    let differences: Vec<_> =
        nanos_of(screen.as_bytes()).windows(2).map(|it| it[1] - it[0]).collect();
    assert_eq!(differences, [1]);
    assert_eq!(nanos_of(screen.as_bytes())[0] % 1_000_000_000, 123_456_789);
    fs::write(path.join("in.log"), log).unwrap();
    let mut last = "in.log".to_owned();
    for (number, ending) in ["pcapng", "blf", "pcapng"].into_iter().enumerate() {
        let next = format!("{number}.{ending}");
        let said = convert(path, &last, &next);
        assert!(!said.contains("cut"), "{next}: {said}");
        assert_eq!(nanos_of(&fs::read(path.join(&next)).unwrap()), nanos, "{next}");
        let (frames, summary) = read(&fs::read(path.join(&next)).unwrap());
        assert_eq!(summary.interfaces.len(), 2, "{next}: {:?}", summary.interfaces);
        assert_eq!(frames.iter().map(|frame| frame.bus.0).collect::<Vec<_>>(), [0, 1, 0, 0, 1]);
        last = next;
    }
    let date = "date Tue Nov 14 10:13:20.0000004 pm 2023";
    let sum =
        [date, "\nbase hex  timestamps absolute\n 0.000000700 1  123  Rx   d 1 11\n"].concat();
    assert_eq!(nanos_of(sum.as_bytes())[0] % 1_000_000_000, 1100);
    let (asc, relative) = (
        "date Tue Nov 14 10:13:20.000 pm 2023\nbase hex  timestamps absolute\n",
        "   0.000000600 1  123             Rx   d 1 11\n   0.000000600 1  123             Rx   d 1 11\n",
    );
    let absolute = nanos_of([asc, relative].concat().as_bytes());
    assert_eq!(absolute[1] % 1_000_000_000, 600);
    let relative = nanos_of([&asc.replace("absolute", "relative"), relative].concat().as_bytes());
    assert_eq!(relative[1] % 1_000_000_000, 1200);
    for ending in ["log", "asc", "trc", "csv"] {
        let said = convert(path, &last, &format!("cut.{ending}"));
        assert!(said.contains("3 times cut to the microsecond"), "{ending}: {said}");
        let cut: Vec<_> = nanos.iter().map(|nanos| nanos / 1000 * 1000).collect();
        assert_eq!(nanos_of(&fs::read(path.join(format!("cut.{ending}"))).unwrap()), cut);
    }
}

#[test]
fn times_after_the_last_year_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let seconds = [253_402_300_799_u64, 253_402_300_800, 253_402_300_802];
    let log = seconds.map(|seconds| format!("({seconds}.000001) can0 123#11\n"));
    fs::write(folder.path().join("in.log"), log.concat()).unwrap();
    for ending in ["asc", "trc", "blf", "pcapng"] {
        let name = format!("out.{ending}");
        let said = convert(folder.path(), "in.log", &name);
        assert!(!said.contains("another time") && !said.contains("summer time"), "{said}");
        convert(folder.path(), &name, &format!("{ending}.log"));
        let again = fs::read_to_string(folder.path().join(format!("{ending}.log"))).unwrap();
        let times: Vec<_> = again.lines().filter_map(|line| line.split(' ').next()).collect();
        assert_eq!(times, seconds.map(|it| format!("({it}.000001)")), "{ending}");
    }
}

#[test]
fn time_behind_the_last_microsecond_is_unreadable() {
    let head = "date Tue Nov 14 10:13:20.000 pm 2023\nbase hex  timestamps absolute\n";
    let trc = ";$FILEVERSION=1.1\n;$STARTTIME=45244.9\n";
    for log in [
        format!("{head}   18446744073709.551615 1  123   Rx   d 1 11\n"),
        format!("{trc}  1)  18446744073709551.615  Rx  0123  1  11\n"),
    ] {
        let (frames, summary) = read(log.as_bytes());
        assert_eq!(frames.len(), 0, "{log}");
        let said = summary.to_string();
        assert!(said.ends_with("cannot be read: the time is before 1970, or too large"), "{said}");
    }
}

#[test]
fn compressed_log_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("in.log"), KINDS).unwrap();
    for args in [&["in.log", "out.log.gz"][..], &["in.log", "out.log.xz", "--format", "candump"]] {
        let output = descan(folder.path(), &[&["convert"], args].concat());
        assert_eq!(output.status.code(), Some(2));
        let said = text(&output.stderr);
        assert!(said.contains(": convert does not compress; write it without"), "{said}");
        assert!(!folder.path().join(args[1]).exists());
    }
}

#[test]
fn file_size_limit_leaves_no_part_of_a_converted_log() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("in.log"), "(1.0) can0 123#11\n".repeat(10_000)).unwrap();
    let script =
        format!("ulimit -f 8; exec {} convert in.log out.asc", env!("CARGO_BIN_EXE_descan"));
    let mut command = Command::new("sh");
    let output = command.args(["-c", &script]).current_dir(folder.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
    assert!(text(&output.stderr).contains("out.asc: file size limit reached; raise it: ulimit -f"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn file_is_replaced_only_when_it_is_forced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("in.log"), KINDS).unwrap();
    fs::write(path.join("out.asc"), "mine").unwrap();
    let output = descan(path, &["convert", "in.log", "out.asc"]);
    assert_eq!(output.status.code(), Some(3));
    assert!(text(&output.stderr).contains("already exists; --force replaces it"));
    assert_eq!(fs::read_to_string(path.join("out.asc")).unwrap(), "mine");
    // A log in place of itself.
    let output = descan(path, &["convert", "in.log", "in.log", "--force", "--format", "asc"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(read(&fs::read(path.join("in.log")).unwrap()).0.len(), KINDS.lines().count());
    for (arguments, code, hint) in [
        (&["convert", "in.log", "out"][..], 2, "--format names one: candump, pcapng"),
        (&["convert", "nothing.log", "out.asc"], 3, "check the name"),
        (
            &["convert", "in.log", "out/", "--format", "asc"],
            3,
            "out/: names a folder; name a file in it",
        ),
        (
            &["convert", "in.log", "missing/out.asc"],
            3,
            "missing/out.asc: no such folder; mkdir -p missing",
        ),
        (&["convert", "in.log", "/dev/null", "--format", "asc", "--force"], 3, "not a file"),
        (&["convert", "words.txt", "new.asc"], 3, "cannot be read"),
    ] {
        fs::write(path.join("words.txt"), "no log\n").unwrap();
        let output = descan(path, arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(hint), "{arguments:?}: {said}");
    }
    let names: Vec<_> = fs::read_dir(path).unwrap().map(|it| it.unwrap().file_name()).collect();
    assert_eq!(names.len(), 3, "{names:?}");
}

#[test]
fn replaced_file_keeps_its_access_rights() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("in.log"), KINDS).unwrap();
    let path = folder.path().join("out.asc");
    fs::write(&path, "private").unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
    // Of another user, where this one may do that.
    let _ = std::os::unix::fs::chown(&path, Some(65534), Some(65534));
    let access = |path: &Path| {
        let metadata = fs::metadata(path).unwrap();
        (metadata.uid(), metadata.gid(), metadata.mode() & 0o777)
    };
    let before = access(&path);
    let output = descan(folder.path(), &["convert", "in.log", "out.asc", "--force"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(access(&path), before);
    assert_eq!(before.2, 0o600);
    // An access list, where the file system has them.
    let list = access_list::access_list(6, 4);
    let flags = rustix::fs::XattrFlags::empty();
    if rustix::fs::setxattr(&path, access_list::ATTRIBUTE, &list, flags).is_ok() {
        let output = descan(folder.path(), &["convert", "in.log", "out.asc", "--force"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let mut kept = [0; 64];
        assert_eq!(
            rustix::fs::getxattr(&path, access_list::ATTRIBUTE, &mut kept[..]),
            Ok(list.len())
        );
        assert_eq!(kept[..list.len()], list);
    }
}

#[test]
fn damaged_log_is_not_replaced_by_its_readable_part() {
    let folder = tempfile::tempdir().unwrap();
    let packed = gzip(long_log().as_bytes());
    let cut = &packed[..packed.len() / 2];
    fs::write(folder.path().join("a.log"), cut).unwrap();
    std::os::unix::fs::symlink("a.log", folder.path().join("b.log")).unwrap();
    for name in ["a.log", "b.log"] {
        let output = descan(folder.path(), &["convert", "a.log", name, "--force"]);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{said}");
        assert!(said.contains("not replaced") && said.contains("write to another file"), "{said}");
    }
    assert_eq!(fs::read(folder.path().join("a.log")).unwrap(), cut);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    // Cut inside its last line.
    fs::write(folder.path().join("a.log"), KINDS.trim_end()).unwrap();
    let output = descan(folder.path(), &["convert", "a.log", "a.log", "--force"]);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
}

/// Starts a conversion of standard input.
fn converting(folder: &Path, arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_descan"))
        .arg("convert")
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

#[test]
fn interrupted_conversion_of_a_pipe_has_what_was_received() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = converting(folder.path(), &["-", "out.blf"]);
    let mut input = child.stdin.take().unwrap();
    // The last line is not whole yet.
    input.write_all((KINDS.to_owned() + "(1700000004.000000) ch1 123#11").as_bytes()).unwrap();
    while fs::read_dir(folder.path()).unwrap().count() == 0 {
        std::thread::yield_now();
    }
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT).unwrap();
    // Its input does not end.
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    drop(input);
    let log = fs::read(folder.path().join("out.blf")).unwrap();
    assert_eq!(read(&log).0.len(), KINDS.lines().count());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn pipe_that_is_interrupted_early_has_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = converting(folder.path(), &["-", "out.log"]);
    let mut input = child.stdin.take().unwrap();
    // From where the times count is not known yet.
    input
        .write_all(b" (000.000000)  can0  123   [0]\n (000.500000)  can0  124   [0]\n (00")
        .unwrap();
    while fs::read_dir(folder.path()).unwrap().count() == 0 {
        std::thread::yield_now();
    }
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    drop(input);
    let log = fs::read_to_string(folder.path().join("out.log")).unwrap();
    assert_eq!(log, "(0000000000.000000) can0 123#\n(0000000000.500000) can0 124#\n");
}

#[test]
fn frames_of_a_pipe_are_written_when_they_arrive() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = converting(folder.path(), &["-", "-", "--format", "candump"]);
    let mut input = child.stdin.take().unwrap();
    let mut lines = std::io::BufRead::lines(BufReader::new(child.stdout.take().unwrap()));
    for line in KINDS.lines() {
        writeln!(input, "{line}").unwrap();
        assert_eq!(lines.next().unwrap().unwrap(), line);
    }
    drop(input);
    assert!(lines.next().is_none());
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

#[test]
fn interrupted_conversion_without_frames_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = converting(folder.path(), &["-", "out.blf"]);
    let mut input = child.stdin.take().unwrap();
    input.write_all(b"no frame\n").unwrap();
    while fs::read_dir(folder.path()).unwrap().count() == 0 {
        std::thread::yield_now();
    }
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT).unwrap();
    // Its input does not end.
    assert_eq!(child.wait().unwrap().code(), Some(130));
    drop(input);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

// --- packed and damaged logs --------------------------------------------------------------

/// Returns a log of many frames, and its text.
fn long_log() -> String {
    let mut log = String::new();
    for at in 0..20_000_u32 {
        let (seconds, micros) = (1_700_000_000 + at / 100, at % 100 * 10_000);
        let data = u64::from(at) * 0x9E37_79B9;
        writeln!(log, "({seconds}.{micros:06}) ch1 {at:08X}#{data:016X}").unwrap();
    }
    log
}

/// Writes a log in several packings; returns the file names.
fn write_packed(folder: &Path, log: &str) -> [&'static str; 4] {
    fs::write(folder.join("in.log"), log).unwrap();
    convert(folder, "in.log", "in.blf");
    fs::write(folder.join("in.log.gz"), gzip(log.as_bytes())).unwrap();
    fs::write(folder.join("in.log.zst"), zstd(log.as_bytes())).unwrap();
    let blf = fs::read(folder.join("in.blf")).unwrap();
    fs::write(folder.join("in.blf.gz"), gzip(&blf)).unwrap();
    ["in.blf", "in.log.gz", "in.log.zst", "in.blf.gz"]
}

#[test]
fn cut_and_damaged_logs_are_read_up_to_the_place() {
    let folder = tempfile::tempdir().unwrap();
    let log = long_log();
    let (plain, _) = read(log.as_bytes());
    for name in write_packed(folder.path(), &log) {
        let bytes = fs::read(folder.path().join(name)).unwrap();
        let (frames, summary) = read(&bytes[..bytes.len() / 2]);
        let expected = &plain[..frames.len()];
        assert!(frames.len() > 5_000, "{name}: {summary}");
        assert!(frames.iter().zip(expected).all(|(one, other)| one.same_on_wire(other)), "{name}");
        assert!(
            summary.to_string().contains("; truncated inside a block (byte "),
            "{name}: {summary}"
        );
        let mut damaged = bytes.clone();
        let at = bytes.len() * 3 / 4;
        damaged[at..at + 40].fill(0x5A);
        let (frames, summary) = read(&damaged);
        assert!(summary.damage.is_some(), "{name}: {summary}");
        assert!((5_000..plain.len()).contains(&frames.len()), "{name}: {summary}");
        let half = frames.len().min(plain.len() / 2);
        let mut both = frames.iter().zip(&plain[..half]);
        assert!(both.all(|(one, other)| one.same_on_wire(other)), "{name}");
        fs::write(folder.path().join("cut"), &bytes[..bytes.len() / 2]).unwrap();
        let output = descan(folder.path(), &["convert", "cut", "part.log", "--force"]);
        assert_eq!(output.status.code(), Some(1), "{name}: {}", text(&output.stderr));
    }
    let empty = gzip(b"");
    for (bytes, cause) in [
        (&empty[..10], "0 frames; truncated inside a block (byte 0)"),
        (b"\x1F\x8B\x08\x00\x00\x00", "0 frames; truncated inside a block (byte 0)"),
        (b"\x28\xB5\x2F\xFD\xFF\xFF\xFF\xFF\xFF", "0 frames; truncated inside a block (byte 0)"),
        (
            b"\xFD7zXZ\0garbage-garbage-garbage-garbage",
            "0 frames; damaged compression: the rest cannot be read (byte 0)",
        ),
        (
            b"LOGG\xFF\xFF\xFF\xFF",
            "0 frames; damaged compression: the rest cannot be read (byte 0)",
        ),
    ] {
        assert_eq!(read(bytes).1.to_string(), cause, "{bytes:?}");
    }
}

#[test]
fn changed_bytes_of_compressed_logs_are_found() {
    // The check sums are those of the Python standard library's lzma, and of zstd's own tool.
    let xz = include_bytes!("../corpus/packed/xz_text");
    let zst = zstd(long_log().as_bytes());
    for (name, bytes) in [("xz", &xz[..]), ("zstd", &zst)] {
        assert_eq!(read(bytes).1.damage, None, "{name}");
        let mut silent = Vec::new();
        for at in (0..bytes.len()).step_by(bytes.len() / 100 + 1) {
            let mut changed = bytes.to_vec();
            changed[at] ^= 0x10;
            let (frames, summary) = read(&changed);
            let is_same = frames == read(bytes).0;
            if !is_same && summary.lost_entries() == 0 {
                silent.push(at);
            }
        }
        assert!(silent.is_empty(), "{name}: {silent:?}");
    }
    // A dictionary of 512 MB.
    let said = read(&xz_with_filter([0x21, 1, 34])).1.to_string();
    assert!(said.contains("needs over 128 MB of memory; pack it again"), "{said}");
}

/// Damage in the only container of a BLF log, and in a zstd frame that is held back as a whole.
#[test]
fn damaged_log_is_read_up_to_the_damage() {
    let folder = tempfile::tempdir().unwrap();
    let log: Vec<String> = long_log().lines().take(2000).map(|line| format!("{line}\n")).collect();
    fs::write(folder.path().join("in.log"), log.concat()).unwrap();
    convert(folder.path(), "in.log", "in.blf");
    let blf = fs::read(folder.path().join("in.blf")).unwrap();
    for (name, bytes, least) in [
        ("BLF", blf, 500),
        ("gzip", gzip(log.concat().as_bytes()), 500),
        ("zstd", zstd(long_log().as_bytes()), 4000),
    ] {
        let (whole, _) = read(&bytes);
        let mut damaged = bytes.clone();
        let at = bytes.len() * 3 / 4;
        damaged[at..at + 16].fill(0xFF);
        let (frames, summary) = read(&damaged);
        // Damage is found late.
        let same = frames.iter().zip(&whole).take_while(|(one, other)| one == other).count();
        assert!(same >= least, "{name}: {same} of {}; {summary}", whole.len());
        assert!(summary.damage.is_some(), "{name}: {summary}");
    }
}

#[test]
fn xz_with_any_byte_changed_is_damaged() {
    for file in [
        &include_bytes!("../corpus/packed/xz_text")[..],
        include_bytes!("../corpus/packed/xz_two_streams"),
    ] {
        assert_eq!(read(file).1.lost_entries(), 0);
        for at in 0..file.len() {
            for mask in [0x01, 0x80] {
                let mut changed = file.to_vec();
                changed[at] ^= mask;
                let summary = read(&changed).1;
                assert_ne!(summary.lost_entries(), 0, "byte {at}: {summary}");
            }
        }
    }
}

/// Returns a log in xz whose first block has another filter: its identifier, the length of its properties,
/// and the properties.
fn xz_with_filter(filter: [u8; 3]) -> Vec<u8> {
    const HEAD: usize = 12;
    let mut log = include_bytes!("../corpus/packed/xz_text").to_vec();
    let block = &mut log[HEAD..];
    assert_eq!(block[2..4], [0x21, 0x01], "the filter LZMA2");
    block[2..5].copy_from_slice(&filter);
    let check = usize::from(block[0]) * 4;
    let mut sum = Crc::new();
    sum.update(&block[..check]);
    block[check..check + 4].copy_from_slice(&sum.sum().to_le_bytes());
    log
}

#[test]
fn xz_with_an_unknown_filter_says_how_to_unpack_it() {
    // The filter of x86 programs.
    let said = read(&xz_with_filter([0x04, 0, 0])).1.to_string();
    let cause =
        "0 frames; compressed with a filter that descan does not have; unpack it with xz -d";
    assert!(said.starts_with(cause), "{said}");
}

#[test]
fn zeros_between_and_behind_members_of_gzip_are_skipped() {
    let member = gzip(KINDS.as_bytes());
    for zeros in [0, 1, 511, 70_000] {
        let padding = vec![0; zeros];
        let (frames, summary) = read(&[&member[..], &padding, &member, &padding].concat());
        assert_eq!(summary.lost_entries(), 0, "{zeros}: {summary}");
        assert_eq!(frames.len(), 2 * KINDS.lines().count());
    }
    for behind in [&[0, 0, 7][..], b"\0JUNK", b"and more text"] {
        let (frames, summary) = read(&[&member[..], behind].concat());
        assert_eq!(frames.len(), KINDS.lines().count());
        assert!(summary.to_string().contains("damaged compression"), "{summary}");
    }
}

#[test]
fn dates_of_other_languages_and_of_old_versions_are_read() {
    let asc = |date: &[u8]| {
        [b"date ", date, b"\nbase hex  timestamps absolute\n 0.5 1 1 Rx d 0\n"].concat()
    };
    let september = micros_of(&asc(b"Sam Sep 30 15:06:13.191 2017"));
    for date in [
        &b"Sat Sep 30 03:06:13.191 pm 2017"[..],
        b"Sat Sep 30 03:06:13.191 p.m. 2017",
        "sam. sept. 30 15:06:13.191 2017".as_bytes(),
        "Сб сен 30 15:06:13.191 2017".as_bytes(),
    ] {
        assert_eq!(micros_of(&asc(date)), september, "{}", String::from_utf8_lossy(date));
    }
    let march = micros_of(&asc(b"Wed Mar 15 03:06:13.191 2017"));
    assert_eq!(micros_of(&asc(b"Mit M\xE4r 15 03:06:13.191 2017")), march);
    assert_eq!(micros_of(&asc("mer. mars 15 03:06:13.191 2017".as_bytes())), march);
    // A block without a date keeps that of the head, and its base.
    let log =
        b"date Sat Sep 30 15:06:13.191 2017\nbase dec timestamps absolute\nBegin Triggerblock\n \
        0.5 1 291 Rx d 1 17\n";
    let (frames, summary) = read(log);
    assert_eq!((frames[0].to_string(), summary.lost_entries()), ("123#11".into(), 0));
    assert_eq!(micros_of(log), september);
    let trc =
        b";##########\n;   Start time: 30.09.2017 15:06:13.191.0\n     1)       500  0001  0\n";
    assert_eq!(micros_of(trc), september);
}

/// Some writers write FD frames as classic ones.
#[test]
fn long_frames_of_asc_have_all_their_bytes() {
    let twelve = "12 34 56 78 90 AB CD EF 12 34 56 78";
    let sixteen = "00 01 02 03 04 05 06 07 08 09 0A 0B 0C 0D 0E 0F";
    let line = |rest: &str| {
        let log = format!(
            "date Sat Sep 30 15:06:13.191 2017\nbase hex  timestamps absolute\n 0.5 1 123 Rx d {rest}\n"
        );
        let (frames, summary) = read(log.as_bytes());
        frames.first().map_or_else(|| summary.to_string(), ToString::to_string)
    };
    assert_eq!(line(&format!("9 {twelve}")), "123##01234567890ABCDEF12345678");
    assert_eq!(line(&format!("A {sixteen}")), "123##0000102030405060708090A0B0C0D0E0F");
    // The number of bytes.
    let bytes: Vec<String> = (0..64).map(|byte| format!("{byte:02X}")).collect();
    let all = format!("123##0{}", bytes.concat());
    assert_eq!(line(&format!("40 {}", bytes.join(" "))), all);
    assert_eq!(line(&format!("64 {}", bytes.join(" "))), all);
    // In base 10.
    assert_eq!(line(&format!("10 {sixteen}")), "123##0000102030405060708090A0B0C0D0E0F");
    assert_eq!(
        line(&format!("9 {twelve}  Length = 0 BitCount = 0 ID = 291")),
        line(&format!("9 {twelve}"))
    );
    // A DLC above 8 with 8 bytes is a classic frame.
    assert_eq!(line("D 01 02 03 04 05 06 07 08"), "123#0102030405060708_D");
    assert_eq!(line("D 01 02 03 04 05 06 07 08  Length = 0"), "123#0102030405060708_D");
    for wrong in [
        "9 01 02 03 04 05 06 07 08 09",
        "B 12",
        &format!("9 {sixteen}"),
        "10 01 02 03 04 05 06 07 08",
    ] {
        assert!(
            line(wrong).starts_with("0 frames; line 3 cannot be read"),
            "{wrong}: {}",
            line(wrong)
        );
    }
}

#[test]
fn gvret_logs_of_other_writers_are_read() {
    let head = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n";
    let log = format!(
        "{head}-1767062175875212,5C0,false,Rx,0,1,63,\n-1767062175874870,5C1,false,Rx,0,1,00,\n-1767062174874870,5C2,false,Rx,0,1,00,\n"
    );
    let expected = ["0 bus0 5C0#63", "342 bus0 5C1#00", "1000342 bus0 5C2#00"];
    assert_eq!(dated(log.as_bytes()), expected);
    let log = format!("\u{FEFF}{head}5,5C0,false,Rx,0,1,63,\n").replace("LEN", "DLC");
    assert_eq!(dated(log.as_bytes()), ["5 bus0 5C0#63"]);
}

#[test]
fn gvret_counter_of_32_bits_goes_on_below_0() {
    let line = |time: i64| format!("{time},5C0,false,Rx,0,1,63,\n");
    let log = |times: &[i64]| {
        let lines: String = times.iter().map(|time| line(*time)).collect();
        dated(format!("Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n{lines}").as_bytes())
    };
    let max = i64::from(i32::MAX);
    let expected = |micros: [i64; 4]| micros.map(|it| format!("{it} bus0 5C0#63"));
    let is_read = |times: &[i64], micros| assert_eq!(log(times), expected(micros), "{times:?}");
    is_read(&[max - 1, max, -max - 1, -max], [max - 1, max, max + 1, max + 2]);
    let turn = 1 << 32;
    is_read(&[0, 7, max, -1], [0, 7, max, turn - 1]);
    is_read(&[max, -1, 0, 5], [max, turn - 1, turn, turn + 5]);
    is_read(&[turn - 1, 0, max, turn - 1], [turn - 1, turn, turn + max, 2 * turn - 1]);
    // One that begins below 0, and reaches it, or goes around.
    is_read(&[-500, -300, 0, 200], [0, 200, 500, 700]);
    is_read(&[-1000, max, -max - 1, -1], [0, max + 1000, max + 1001, turn + 999]);
    is_read(&[-max - 1, 0, max, -max - 1], [0, max + 1, turn - 1, turn]);
    // A frame from before the turn, or from before 0, has the moment of the one before it.
    is_read(&[turn - 9, 5, turn - 7, 6], [turn - 9, turn + 5, turn + 5, turn + 6]);
    is_read(&[5, -5, 6, 7], [5, 5, 6, 7]);
    // No counter of 32 bits: its clock was set back.
    let wide = 10 * turn;
    is_read(&[wide, -5, 6, 7], [wide, wide, wide + 6, wide + 7]);
    is_read(&[wide, wide + 1, wide - turn, wide], [wide, wide + 1, wide + 1, wide + 1]);
}

/// The protocol of a cooked packet says that it is an FD frame; the flag may be missing.
#[test]
fn short_fd_frames_of_cooked_packets_stay_fd() {
    let packet = |protocol: u8, flags: u8| {
        let mut cooked = vec![0, 1, 1, 0x18, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, protocol];
        cooked.extend([0x23, 1, 0, 0, 2, flags, 0, 0, 0x11, 0x22]);
        let mut packet = 1_700_000_000_u32.to_le_bytes().to_vec();
        packet.extend([0; 4]);
        packet.extend((cooked.len() as u32).to_le_bytes());
        packet.extend((cooked.len() as u32).to_le_bytes());
        packet.extend(cooked);
        packet
    };
    let mut log = vec![
        0xD4, 0xC3, 0xB2, 0xA1, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xFF, 0xFF, 0, 0, 113, 0, 0, 0,
    ];
    for (protocol, flags) in [(0x0C, 0), (0x0D, 0), (0x0D, 1), (0x0D, 5), (0x0C, 4)] {
        log.extend(packet(protocol, flags));
    }
    let (frames, _) = read(&log);
    let frames: Vec<String> = frames.iter().map(ToString::to_string).collect();
    assert_eq!(frames, ["123#1122", "123##01122", "123##11122", "123##11122", "123##01122"]);
}

fn micros_of(log: &[u8]) -> u64 {
    let (_, summary) = read(log);
    assert_eq!(summary.lost_entries(), 0, "{summary}");
    summary.epoch.unwrap().unix_micros(Instant::ZERO)
}

#[test]
fn missing_ack_is_no_error_frame_of_other_formats() {
    let folder = tempfile::tempdir().unwrap();
    let lines = "(1.000000) ch1 20000020#0000000000000000\n(2.000000) ch1 123#\n";
    fs::write(folder.path().join("in.log"), lines).unwrap();
    for ending in ["asc", "trc"] {
        let out = format!("out.{ending}");
        let said = convert(folder.path(), "in.log", &out);
        assert!(said.contains("1 error frame left out"), "{said}");
        let (frames, _) = read(&fs::read(folder.path().join(out)).unwrap());
        assert_eq!(frames.len(), 1, "{ending}");
    }
}

#[test]
fn commands_read_packed_logs() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("log.gz"), gzip(&gzip(KINDS.as_bytes()))).unwrap();
    let output = descan(folder.path(), &["log", "log.gz", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(text(&output.stdout).lines().count(), KINDS.lines().count());
    let mut child = Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(["watch", "-", "--json"])
        .current_dir(folder.path())
        .env("XDG_CONFIG_HOME", folder.path().join("config"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(&gzip(KINDS.as_bytes())).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("\"bus\":\"ch1\""), "{}", text(&output.stdout));
}

// --- python-can ---------------------------------------------------------------------------

#[test]
fn frames_are_those_of_python_can_both_ways() {
    let Some(python) = Python::with(&["python-can==4.6.1", "asammdf==8.8.28"]) else { return };
    let script = include_str!("../log_formats/python_can.py");
    let formats = ["asc", "blf", "trc", "csv", "log", "db", "mf4"];
    for (seed, zone) in [("1", "UTC"), ("2", "Europe/Berlin")] {
        let folder = tempfile::tempdir().unwrap();
        let program = env!("CARGO_BIN_EXE_descan");
        let arguments = [&[program, folder.path().to_str().unwrap(), seed][..], &formats].concat();
        // Its TRC has times in UTC.
        let skipped = usize::from(zone != "UTC");
        let arguments: Vec<_> =
            arguments.into_iter().filter(|it| skipped == 0 || *it != "trc").collect();
        let found = python.run(script, &arguments, &[("TZ", zone)]);
        assert!(found.parse::<u32>().is_ok_and(|frames| frames > 1_000), "{zone}: {found}");
    }
}
