//! The proof of a problem: the report in Markdown and the frames as pcapng, both readable without
//! descan.

use crate::common::harness::Stage;
use descan::app::Effect;
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::frame::{CanId, Frame};
use descan::log::LogReader;
use descan::sim::{DeviceSpec, Fault, Scenario};
use descan::time::{Duration, Instant};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Room for captured frames with their past.
const ROOM: usize = 16 << 20;

fn boiler() -> Stage {
    let config = Config { seed: 7, ..Config::default() };
    Stage::with_room(&Scenario::builtin("boiler").unwrap(), None, config, ROOM)
}

/// A board with this name at address 14 that keeps it.
fn board(name: &[u8], label: &str, uid: [u8; 6], seconds: u64) -> DeviceSpec {
    let mut device = DeviceSpec::new("ACT").label(label).name(name).fixed(14);
    device.power_on = Some(Duration::from_secs(seconds));
    device.uid = descan::wire::node::Uid(uid);
    device.skips_address_resolution().fault(Fault::KeepsAddress)
}

/// The file that is being written, and its content.
fn written(stage: &mut Stage) -> (PathBuf, Vec<u8>) {
    let effects = std::mem::take(&mut stage.effects);
    let mut files = effects.into_iter().filter_map(|effect| match effect {
        Effect::WriteFile { path, bytes } => Some((path, bytes)),
        _ => None,
    });
    let file = files.next().expect("no file is written");
    assert!(files.next().is_none(), "one file after the other");
    file
}

fn report(stage: &mut Stage, path: &Path, result: Result<(), Diagnostic>) {
    let now = stage.app.now();
    stage.app.handle_written(now, path, result);
    stage.drain(now);
}

/// Writes the proof of the selected problem: report and frames.
fn proof(stage: &mut Stage) -> (String, Vec<u8>) {
    stage.effects.clear();
    stage.keys("X Enter");
    let (frames_path, frames) = written(stage);
    assert_eq!(frames_path.extension().unwrap(), "pcapng");
    report(stage, &frames_path, Ok(()));
    let (path, text) = written(stage);
    assert_eq!(path, frames_path.with_extension("md"));
    report(stage, &path, Ok(()));
    assert!(stage.screen().contains("and its .pcapng"), "{}", stage.screen());
    (String::from_utf8(text).unwrap(), frames)
}

fn frames_of(file: &[u8]) -> Vec<Frame> {
    LogReader::new(std::io::BufReader::new(file)).collect::<Result<_, _>>().unwrap()
}

/// Returns true if the bytes are in the file.
fn contains(file: &[u8], text: &str) -> bool {
    file.windows(text.len()).any(|part| part == text.as_bytes())
}

#[test]
fn proof_of_a_conflict_names_boards_frames_and_rules() {
    let mut stage = boiler();
    stage.until(45.0).keys("4");
    let problem = stage.app.selected_problem().unwrap();
    let (pieces, title) = (problem.evidence(), stage.app.headline(&problem).full);
    let (text, frames) = proof(&mut stage);
    assert!(text.starts_with(&format!("# {title}\n")), "{text}");
    for words in [
        "since:** 2026-11-21 12:00:26.824",
        "Two devices answer as ACT at address 14.",
        "| A BOILER03 · ACT | B SPARE01 · ACT |",
        "| joined | 12:00:05.796, claimed 14 in ARSLV | 12:00:26.824, 2nd, claimed 14 in ARSLV |",
        "18 of 79 events",
        "| 1 | 2026-11-21 12:00:26.824 | B | UID SPARE01 | 171D2801 | RSP_CU_UNSC U=1 D=0 R=1 B=1 ERR=1 \
         SRC=14 DST=74 SRV=0x001 | CF 08 72 95 04 40 01 00 | heartbeat ARSLV SPARE01 |",
        "second response to one request",
        "CAN platform §4.1",
        "CAN platform §3.2.4.2",
        "DES service document",
        "| bus | can0, 125000 bit/s |",
        "| profile | assumed",
        "| frames lost | 0 |",
        concat!("descan ", env!("CARGO_PKG_VERSION")),
        "## What to do",
    ] {
        assert!(text.contains(words), "{words}\n{text}");
    }
    assert!(!text.contains("answers-doubled"), "a finding that another one explains\n{text}");
    // Each piece is in the frames, with a comment; a second around each is, too.
    let stored = frames_of(&frames);
    for (place, piece) in pieces.iter().enumerate() {
        let frame = piece.frame.unwrap();
        assert!(stored.iter().any(|it| it.same_on_wire(&frame)), "{piece:?}");
        assert!(contains(&frames, &format!("evidence {}: {}", place + 1, piece.what)));
    }
    assert!(contains(&frames, &title));
    assert!(stored.len() > 4 * pieces.len(), "{} frames", stored.len());
    assert!(
        text.contains(&format!("{} frames up to a second before", stored.len() - pieces.len())),
        "{text}"
    );
}

#[test]
fn proof_is_asked_for_and_never_overwrites() {
    let mut stage = boiler();
    stage.until(45.0).keys("1 X");
    assert!(stage.screen().contains("a proof is written on the Problems page"));
    stage.keys("4 X");
    let screen = stage.screen();
    assert!(screen.contains("write the proof to: proof-14-20261121-120045.md"), "{screen}");
    stage.keys("Ctrl-u").text("x.txt");
    assert!(stage.screen().contains("use the ending .md"), "{}", stage.screen());
    stage.effects.clear();
    stage.keys("Enter");
    assert!(stage.effects.iter().all(|effect| !matches!(effect, Effect::WriteFile { .. })));
    stage.keys("Esc X Ctrl-u").text("a/b.md").keys("Enter");
    let (path, _) = written(&mut stage);
    assert_eq!(path, Path::new("a/b.pcapng"));
    // The shell refuses a file that exists: the report is not written then.
    report(&mut stage, &path, Err(Diagnostic::new("a/b.pcapng already exists")));
    let screen = stage.screen();
    assert!(screen.contains("proof not saved: a/b.pcapng already exists"), "{screen}");
    assert!(stage.effects.iter().all(|effect| !matches!(effect, Effect::WriteFile { .. })));
    // The path can be corrected, or tried again.
    assert_eq!(stage.app.prompt().unwrap().input.value(), "a/b.md");
    stage.keys("Enter");
    assert_eq!(written(&mut stage).0, Path::new("a/b.pcapng"));
    report(&mut stage, &path, Err(Diagnostic::new("a/b.pcapng already exists")));
    stage.keys("2");
    let screen = stage.screen();
    assert!(screen.contains("a/b.md2") && !screen.contains("already exists"), "{screen}");
    // One of the two is written.
    stage.keys("Esc X Enter");
    let (path, _) = written(&mut stage);
    report(&mut stage, &path, Ok(()));
    let (path, _) = written(&mut stage);
    stage.size(120, 24);
    report(&mut stage, &path, Err(Diagnostic::new("disk full")));
    let screen = stage.screen();
    assert!(screen.contains("report not saved: disk full; frames saved: proof-14-"), "{screen}");
}

#[test]
fn proof_of_a_past_moment_is_that_of_a_run_until_then() {
    let mut past = boiler();
    past.until(50.0);
    past.app.go_to_time(Instant::ZERO + Duration::from_secs(35));
    for _ in 0..1000 {
        if past.app.past_moment().is_some() {
            break;
        }
        let at = past.app.poll_timeout().unwrap();
        past.pass(at);
    }
    let mut then = boiler();
    then.until(35.0).keys("Space");
    let (text, frames) = proof(past.keys("4"));
    let (expected, expected_frames) = proof(then.keys("4"));
    // Only the time of writing, and the name of the file with it, differ.
    let lines = |text: &str| -> Vec<String> {
        let is_same =
            |line: &&str| !line.contains("| written |") && !line.contains("The file proof");
        text.lines().filter(is_same).map(str::to_owned).collect()
    };
    assert_eq!(lines(&text), lines(&expected));
    assert!(text.contains("| moment shown | 2026-11-21 12:00:35"), "{text}");
    assert_eq!(frames, expected_frames);
}

#[test]
fn evidence_without_frames_in_the_capture_is_in_the_proof() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    let pieces = stage.app.selected_problem().unwrap().evidence();
    let flood = |stage: &mut Stage, time: Instant| {
        let frame = Frame::new(CanId::Standard(0x123), &[]).with_time(time);
        let count = 2 * stage.app.capture().capacity() as usize;
        stage.app.handle_frames(stage.app.now(), &vec![frame; count]);
    };
    // Frames around evidence are kept longer, but bounded.
    let evidence = pieces[0].time;
    let later = stage.app.now() + Duration::from_secs(10);
    flood(&mut stage, later);
    flood(&mut stage, evidence);
    let (text, frames) = proof(&mut stage);
    let stored = frames_of(&frames);
    assert!(stored.len() <= 20_000 + pieces.len(), "{} frames", stored.len());
    assert!(stored.is_sorted_by_key(|frame| frame.time));
    for piece in &pieces {
        let frame = piece.frame.unwrap();
        assert!(stored.iter().any(|it| it.same_on_wire(&frame)), "{piece:?}");
    }
    assert!(text.contains("of the events, frames are missing"), "{text}");
}

#[test]
fn hostile_names_stay_text_in_the_report() {
    let name = b"|`<b>\n# x|[a](b)";
    let scenario = Scenario::new(125_000)
        .with(board(name, "one", [0x11; 6], 0))
        .with(board(name, "two", [0x22; 6], 12))
        .with(DeviceSpec::new("FEED").fixed(10).skips_address_resolution());
    let mut stage = Stage::new(&scenario, None);
    stage.until(40.0).keys("4");
    let (text, _) = proof(&mut stage);
    assert!(text.contains("\\|\\`&lt;b&gt;\\\\x0A\\# x\\|\\[a\\](b)"), "{text}");
    assert!(!text.contains("<b>") && !text.contains("[a](b)"), "{text}");
    // All rows of a table have the same number of cells, and no heading is added.
    let cells = |line: &str| line.replace("\\\\", "").replace("\\|", "").matches('|').count();
    for table in text.split("\n\n").filter(|part| part.starts_with('|')) {
        let counts: Vec<usize> = table.lines().map(cells).collect();
        assert!(counts.iter().all(|count| *count == counts[0]), "{table}");
    }
    let headings = text.lines().filter(|line| line.starts_with('#')).count();
    assert_eq!(headings, 7, "{text}");
}

#[test]
fn proof_of_a_missing_device_says_that_there_are_no_frames() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 G");
    let (text, frames) = proof(&mut stage);
    assert!(text.starts_with("# PUMP at 44 is missing: listed in des.json"), "{text}");
    assert!(text.contains("There are no frames"), "{text}");
    assert!(frames_of(&frames).is_empty());
}

#[test]
fn tshark_reads_the_frames_with_their_comments() {
    let mut stage = boiler();
    stage.until(45.0).keys("4");
    let (_, frames) = proof(&mut stage);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("proof.pcapng");
    std::fs::write(&path, &frames).unwrap();
    let mut tshark = Command::new("tshark");
    tshark.arg("-r").arg(&path).args(["-T", "fields", "-e", "can.id", "-e", "frame.comment"]);
    let output = match tshark.output() {
        Ok(output) => output,
        Err(missing) => {
            assert!(std::env::var_os("CI").is_none(), "tshark: {missing}");
            eprintln!("skipped: tshark: {missing}");
            return;
        }
    };
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(text.lines().count(), frames_of(&frames).len());
    assert!(text.contains("evidence 1: UID SPARE01"), "{text}");
}
