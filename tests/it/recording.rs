//! `--record`, from outside: content of the files, how they end, and the messages.

use crate::common::frames::any_frame;
use crate::common::program::command;
use crate::common::pty::{PATIENCE, Pty};
use descan::frame::{BusIndex, Frame};
use descan::log::{LogReader, LogSummary};
use descan::shell::recorder::{Recorder, Target};
use descan::time::{Duration, Epoch, Instant};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use proptest::prelude::*;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

const EPOCH: Epoch = Epoch::from_unix_micros(1_436_509_052_249_713);

fn read(path: &Path) -> (Vec<Frame>, LogSummary) {
    let file = File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut reader = LogReader::new(BufReader::new(file));
    let frames = reader.by_ref().collect::<Result<_, _>>().unwrap();
    (frames, reader.summary().clone())
}

fn create(path: &Path, max_bytes: Option<u64>) -> Recorder {
    let recorder = Recorder::create(&Target { path: path.to_owned(), max_bytes }).unwrap();
    recorder.set_epoch(EPOCH);
    recorder.name_bus(BusIndex(0), "can0");
    recorder.name_bus(BusIndex(1), "can1");
    recorder
}

/// Frames of two buses, a millisecond apart, each with its number.
fn numbered(count: u32) -> Vec<Frame> {
    let frame = |number: u32| {
        let frame = Frame::classic(0x0719_A510, &number.to_be_bytes());
        let time = Instant::from_micros(u64::from(number) * 1000);
        frame.with_time(time).with_bus(BusIndex((number % 2) as u8))
    };
    (0..count).map(frame).collect()
}

/// Returns the blocks of a pcapng file written by descan: kind and body.
fn blocks(path: &Path) -> Vec<(u32, Vec<u8>)> {
    let file = fs::read(path).unwrap();
    let number = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap());
    let mut blocks = Vec::new();
    let mut at = 0;
    while at < file.len() {
        let len = number(at + 4) as usize;
        blocks.push((number(at), file[at + 8..at + len - 4].to_vec()));
        at += len;
    }
    blocks
}

/// Returns interface, frames and lost frames from the statistics at the end of a file.
fn statistics(path: &Path) -> Vec<(u32, u64, u64)> {
    let of = |body: &[u8]| {
        // Two options of eight bytes follow the interface and its time.
        let number = |at: usize| u64::from_le_bytes(body[at..at + 8].try_into().unwrap());
        assert_eq!((&body[12..16], &body[24..28]), (&[4, 0, 8, 0][..], &[5, 0, 8, 0][..]));
        (u32::from_le_bytes(body[..4].try_into().unwrap()), number(16), number(28))
    };
    blocks(path).iter().filter(|(kind, _)| *kind == 5).map(|(_, body)| of(body)).collect()
}

// --- the files ------------------------------------------------------------------------------

#[test]
fn frames_of_two_buses_are_recorded_in_time_order() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.log", "a.pcapng"] {
        let path = folder.path().join(name);
        let recorder = create(&path, None);
        let frames = numbered(40_000);
        // A tenth of a second of frames of one bus, then of the other; at first there is only one.
        let of = |bus: u8| move |frame: &&Frame| frame.bus == BusIndex(bus);
        recorder.record(&frames[..1]);
        for batch in frames[1..].chunks(100) {
            recorder.record(&batch.iter().filter(of(1)).copied().collect::<Vec<_>>());
            recorder.record(&batch.iter().filter(of(0)).copied().collect::<Vec<_>>());
        }
        assert_eq!(recorder.finish().frames, 40_000);
        let (there, tally) = read(&path);
        assert_eq!(tally.clock_steps_back, 0);
        assert!(there == frames, "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn recorded_frames_are_read_back(
        frames in proptest::collection::vec((any_frame(), 0_u64..5_000_000, 0_u8..2), 1..60),
        pcapng in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(if pcapng { "a.pcapng" } else { "a.log" });
        let mut moment = Instant::ZERO;
        let frames: Vec<Frame> = frames
            .into_iter()
            .enumerate()
            .map(|(at, (frame, gap, bus))| {
                let (gap, bus) = if at == 0 { (0, 0) } else { (gap, bus) };
                moment += Duration::from_micros(gap);
                frame.with_time(moment).with_bus(BusIndex(bus))
            })
            .collect();
        let recorder = create(&path, None);
        recorder.record(&frames);
        let status = recorder.finish();
        prop_assert_eq!((status.frames, status.lost, status.failure), (frames.len() as u64, 0, None));
        prop_assert_eq!(status.bytes, fs::metadata(&path).unwrap().len());
        let (there, tally) = read(&path);
        prop_assert_eq!(tally.epoch, Some(EPOCH));
        prop_assert_eq!((tally.unreadable, tally.damage, tally.clock_steps_back), (0, None, 0));
        prop_assert_eq!(there, frames);
        prop_assert!(["can0", "can1"].starts_with(&tally.interfaces.iter().map(String::as_str).collect::<Vec<_>>()));
    }
}

#[test]
fn file_rotation_keeps_size_limit_and_every_frame() {
    for extension in ["log", "pcapng"] {
        let folder = tempfile::tempdir().unwrap();
        let first = folder.path().join(format!("a.{extension}"));
        let recorder = create(&first, Some(20_000));
        // Created by another program after the recording began.
        let taken = folder.path().join(format!("a_00003.{extension}"));
        fs::write(&taken, "mine").unwrap();
        let frames = numbered(2_000);
        recorder.record_all(&frames);
        let status = recorder.finish();
        assert_eq!(fs::read(&taken).unwrap(), b"mine");
        fs::remove_file(&taken).unwrap();
        let mut paths: Vec<PathBuf> =
            fs::read_dir(folder.path()).unwrap().map(|it| it.unwrap().path()).collect();
        paths.sort();
        assert!(paths.len() > 4, "{paths:?}");
        assert_eq!(paths[0], first, "the first sorts first");
        assert_eq!(paths[1], folder.path().join(format!("a_00002.{extension}")));
        assert_eq!(status.path, paths.last().unwrap().to_str().unwrap());
        assert_eq!((status.files as usize, status.frames), (paths.len(), 2_000));
        let mut all = Vec::new();
        for path in &paths {
            assert!(fs::metadata(path).unwrap().len() <= 20_000 + 200, "{path:?}");
            let (frames, tally) = read(path);
            assert_eq!((tally.damage, tally.interfaces.len()), (None, 2), "each can be read alone");
            let epoch = tally.epoch.unwrap();
            all.extend(frames.iter().map(|it| (epoch.unix_micros(it.time), it.data().to_vec())));
        }
        let told = |it: &Frame| (EPOCH.unix_micros(it.time), it.data().to_vec());
        assert_eq!(all, frames.iter().map(told).collect::<Vec<_>>());
    }
}

#[test]
fn pcapng_files_state_their_lost_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pcapng");
    let recorder = create(&path, None);
    recorder.note_lost(BusIndex(1), 17);
    // More at once than the queue holds: 65,536.
    recorder.record(&numbered(70_000));
    let status = recorder.finish();
    assert_eq!((status.frames, status.lost), (65_536, 4_464));
    assert_eq!(statistics(&path), [(0, 32_768, 2_232), (1, 32_768, 2_232 + 17)]);
    assert_eq!(read(&path).0.len(), 65_536);

    // Each of the two files reports its own losses.
    let path = folder.path().join("b.pcapng");
    let recorder = create(&path, Some(20_000));
    recorder.note_lost(BusIndex(0), 5);
    recorder.record_all(&numbered(500));
    recorder.finish();
    let second = folder.path().join("b_00002.pcapng");
    assert_eq!(statistics(&path)[0].2 + statistics(&second)[0].2, 5);
}

#[test]
fn existing_files_are_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.log");
    fs::write(&path, "mine").unwrap();
    let refused = |max_bytes| {
        Recorder::create(&Target { path: path.clone(), max_bytes }).unwrap_err().to_string()
    };
    assert_eq!(refused(None), format!("{}: already exists; name another file", path.display()));
    assert_eq!(fs::read(&path).unwrap(), b"mine");
    // A file of an earlier recording with a number that this one would reach.
    fs::rename(&path, folder.path().join("a_00007.log")).unwrap();
    assert!(refused(Some(10_000)).contains("a_00007.log: already exists"));
    assert!(!path.exists());
    create(&path, None).finish();
    assert!(!path.exists(), "nothing came, so there is no file in the way of the next try");
}

// --- the program ----------------------------------------------------------------------------

fn descan(arguments: &[&str], folder: &Path) -> Output {
    command(arguments, folder).output().expect("the program starts")
}

fn words(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Writes a log of FEED's heartbeats on two interfaces, and of frames of every kind.
fn write_log(path: &Path) {
    let mut log = String::new();
    for beat in 0..300 {
        let (second, micros) = (1_436_509_052 + beat / 10, beat % 10 * 100_000 + 17);
        let bus = if beat % 3 == 0 { "can8" } else { "can7" };
        let own = if beat % 5 == 0 { " T" } else { "" };
        let frame = match beat {
            1 => "123#R4",
            2 => "20000024#0001020304050607",
            3 => "00000123##30102030405060708",
            4 => "123##0",
            _ => "07183C01#8AFA6C9724110400",
        };
        writeln!(log, "({second}.{micros:06}) {bus} {frame}{own}").unwrap();
    }
    fs::write(path, log).unwrap();
}

#[test]
fn log_to_pcapng_and_back_is_identical() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("a.log"));
    let output = descan(&["scan", "file:a.log", "--record", "b.pcapng"], folder.path());
    assert!(words(&output).contains("descan: recorded b.pcapng: 300 frames, 18 kB"), "{output:?}");
    let output = descan(&["watch", "file:b.pcapng", "--record", "c.log"], folder.path());
    assert!(words(&output).contains("recorded c.log: 300 frames"), "{output:?}");
    let text = |name| fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!(text("c.log"), text("a.log"));
    // A third of it, by the clock of the log.
    let arguments = ["watch", "file:a.log", "--time", "10", "--record", "d.log"];
    descan(&arguments, folder.path());
    assert_eq!(text("d.log").lines().count(), 101);
}

#[test]
fn damaged_file_is_read_up_to_the_damage() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("a.log"));
    descan(&["scan", "file:a.log", "--record", "b.pcapng"], folder.path());
    let path = folder.path().join("b.pcapng");
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let output = descan(&["scan", "file:b.pcapng"], folder.path());
    assert!(
        words(&output).contains("frames of 2 interfaces; truncated inside a block"),
        "{output:?}"
    );
    assert_eq!(output.status.code(), Some(0));
    fs::write(&path, [b"\n\r\r\n", &[7; 40][..]].concat()).unwrap();
    let output = descan(&["scan", "file:b.pcapng"], folder.path());
    assert_eq!(output.status.code(), Some(3), "{output:?}");
}

#[test]
fn invalid_record_arguments_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("a.log"));
    for (arguments, code, hint) in [
        (&["--record", "b.pcap"][..], 2, ".pcapng"),
        (&["--record", "b"], 2, ".log"),
        (&["--record-size", "1M"], 2, "--record <FILE>"),
        (&["--record", "b.log", "--record-size", "1"], 2, "100M"),
        (&["--record", "a.log"], 3, "a.log: already exists"),
        (&["--record", "nowhere/b.log"], 3, "nowhere/b.log: no such folder; mkdir -p nowhere"),
    ] {
        let output = descan(&[&["scan", "file:a.log"], arguments].concat(), folder.path());
        assert!(words(&output).contains(hint), "{output:?}");
        assert_eq!(output.status.code(), Some(code), "{output:?}");
        assert_eq!(words(&output).lines().count(), 1, "{output:?}");
    }
}

/// `descan watch` on a simulated bus that is recorded.
struct Recording {
    child: Child,
    path: PathBuf,
}

impl Recording {
    fn start(command: &mut Command, path: PathBuf) -> Self {
        let child = command
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        Self { child, path }
    }

    fn boiler(folder: &Path, name: &str) -> Self {
        // The tests may run with SIGHUP ignored, as under nohup; children would inherit that.
        let mut command = Command::new("env");
        command.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_descan")]);
        command.args(["watch", "sim:boiler", "--record", name]).current_dir(folder);
        Self::start(command.stdin(Stdio::null()), folder.join(name))
    }

    /// Waits until the file has this many bytes.
    fn wait_for_bytes(&mut self, bytes: u64) {
        let deadline = std::time::Instant::now() + PATIENCE;
        while !fs::metadata(&self.path).is_ok_and(|it| it.len() >= bytes) {
            assert!(std::time::Instant::now() < deadline, "the file does not grow");
            assert!(self.child.try_wait().unwrap().is_none(), "it runs");
            std::thread::yield_now();
        }
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id().cast_signed()), signal).unwrap();
    }

    fn end(mut self) -> (Option<i32>, String) {
        let mut words = String::new();
        std::io::Read::read_to_string(&mut self.child.stderr.take().unwrap(), &mut words).unwrap();
        (self.child.wait().unwrap().code(), words)
    }
}

#[test]
fn recording_is_complete_after_a_signal() {
    for signal in [Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP] {
        let folder = tempfile::tempdir().unwrap();
        let mut recording = Recording::boiler(folder.path(), "a.pcapng");
        // By then descan has sent requests.
        recording.wait_for_bytes(12_000);
        recording.signal(signal);
        let path = recording.path.clone();
        let (code, words) = recording.end();
        assert_eq!(code, Some(0), "{signal}: {words}");
        let (frames, tally) = read(&path);
        assert_eq!((tally.damage, tally.unreadable), (None, 0));
        assert_eq!(*tally.interfaces, ["sim:boiler"]);
        assert!(frames.iter().any(|it| it.is_tx) && frames.iter().any(|it| !it.is_tx));
        // Present only if the file was finished properly.
        assert_eq!(statistics(&path), [(0, frames.len() as u64, 0)]);
        assert!(words.contains(&format!("recorded a.pcapng: {} frames", frames.len())), "{words}");
        let age = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
        let first = tally.epoch.unwrap().unix_secs(Instant::ZERO);
        assert!((age.as_secs_f64() - first).abs() < 120.0, "dated by the wall clock");
    }
}

#[test]
fn recording_under_nohup_survives_sighup() {
    let folder = tempfile::tempdir().unwrap();
    let script = format!(
        "trap '' HUP; exec {} watch sim:boiler --record a.log",
        env!("CARGO_BIN_EXE_descan")
    );
    let mut command = Command::new("sh");
    command.args(["-c", &script]).current_dir(folder.path()).stdin(Stdio::null());
    let mut recording = Recording::start(&mut command, folder.path().join("a.log"));
    recording.wait_for_bytes(1_000);
    recording.signal(Signal::SIGHUP);
    let there = fs::metadata(&recording.path).unwrap().len();
    recording.wait_for_bytes(there + 1_000);
    recording.signal(Signal::SIGTERM);
    assert_eq!(recording.end().0, Some(0));
}

#[test]
fn killed_recording_loses_at_most_one_second() {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = Recording::boiler(folder.path(), "a.pcapng");
    // Not the first flush.
    recording.wait_for_bytes(200);
    let there = fs::metadata(&recording.path).unwrap().len();
    recording.wait_for_bytes(there + 1_000);
    recording.signal(Signal::SIGKILL);
    let path = recording.path.clone();
    let _ = recording.end();
    let (frames, tally) = read(&path);
    assert!(frames.len() > 20 && tally.damage.is_none(), "{tally:?}");
    // About 45 f/s: written without waiting for a full buffer.
    assert!(frames.len() < 600, "{}", frames.len());
}

#[test]
fn full_disk_stops_recording_but_not_descan() {
    let folder = tempfile::tempdir().unwrap();
    // No file may grow beyond 8 blocks of 512 bytes.
    let script = format!(
        "ulimit -f 8; exec {} watch sim:boiler --record a.log --time 8",
        env!("CARGO_BIN_EXE_descan")
    );
    let mut command = Command::new("sh");
    command.args(["-c", &script]).current_dir(folder.path()).stdin(Stdio::null());
    let recording = Recording::start(&mut command, folder.path().join("a.log"));
    let path = recording.path.clone();
    let (code, words) = recording.end();
    assert_eq!(code, Some(0), "{words}");
    let over = "descan: recording to a.log stopped: file size limit reached";
    assert_eq!(words.matches(over).count(), 1, "{words}");
    assert!(words.contains("incomplete: "), "{words}");
    let (frames, tally) = read(&path);
    assert!(frames.len() > 10 && tally.unreadable == 0, "no half line stays behind: {tally:?}");
    assert!(words.contains(&format!("recorded a.log: {} frames, ", frames.len())), "{words}");
}

#[test]
fn full_disk_counts_only_written_frames() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("long.log"));
    for (name, told) in [("a.pcapng", "0 frames, 48 B"), ("a.log", "0 frames, 0 B")] {
        // A block of 512 bytes holds the head of the file, but not all that is flushed at once.
        let script = format!(
            "ulimit -f 1; exec {} scan file:long.log --record {name}",
            env!("CARGO_BIN_EXE_descan")
        );
        let mut command = Command::new("sh");
        command.args(["-c", &script]).current_dir(folder.path()).stdin(Stdio::null());
        let output = command.output().unwrap();
        // A script that converts logs must not treat it as complete.
        assert_eq!(output.status.code(), Some(3));
        let tables = String::from_utf8_lossy(&output.stdout);
        assert!(tables.contains("frames, "), "the scan itself succeeded: {tables}");
        let words = words(&output);
        let told = format!("recorded {name}: {told}; incomplete: file size limit reached");
        assert!(words.contains(&told), "{words}");
        assert_eq!(read(&folder.path().join(name)).0, []);
    }
}

#[test]
fn deleted_recording_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = Recording::boiler(folder.path(), "a.log");
    recording.wait_for_bytes(100);
    fs::remove_file(&recording.path).unwrap();
    let mut reader = BufReader::new(recording.child.stderr.take().unwrap());
    let mut line = String::new();
    std::io::BufRead::read_line(&mut reader, &mut line).unwrap();
    assert_eq!(line, "descan: recording to a.log stopped: the file was deleted\n");
    recording.signal(Signal::SIGTERM);
    assert_eq!(recording.child.wait().unwrap().code(), Some(0));
}

fn wait_for_recording(pty: &mut Pty) {
    pty.wait_until("the size", |screen| {
        let text = screen.contents();
        let size = text.split("● rec ").nth(1).and_then(|it| it.split_once(" kB"));
        size.is_some_and(|(count, _)| count.parse::<u32>().is_ok())
    });
}

#[test]
fn screen_and_exit_message_show_the_recording() {
    for hangs_up in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let arguments = ["sim:boiler", "--record", "a.pcapng"];
        let mut pty = Pty::start(&arguments, folder.path(), (80, 24));
        wait_for_recording(&mut pty);
        if hangs_up {
            pty.hang_up();
            pty.wait();
        } else {
            pty.send("q");
            assert_eq!(pty.wait(), 0);
            assert!(pty.screen().contains("descan: recorded a.pcapng: "), "{}", pty.screen());
        }
        let path = folder.path().join("a.pcapng");
        let (frames, _) = read(&path);
        assert_eq!(statistics(&path), [(0, frames.len() as u64, 0)], "it ended well");
    }
}

#[test]
fn screen_shows_stopped_recording() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["sim:boiler", "--record", "a.log"];
    let mut pty = Pty::start(&arguments, folder.path(), (80, 24));
    wait_for_recording(&mut pty);
    fs::remove_file(folder.path().join("a.log")).unwrap();
    pty.wait_for("recording to a.log stopped: the file was deleted");
    pty.wait_for("✗ rec stopped");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}
