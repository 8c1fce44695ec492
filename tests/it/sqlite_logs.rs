//! Databases of SQLite as python-can writes them: what is read, and from damaged ones.

use crate::common::program::{run_with_input, text};
use crate::common::read_log::read_log;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fs;
use std::io::Write;

// The databases are those of the sqlite3 module of Python, with pages of 512 bytes.
const KINDS: &[u8] = include_bytes!("../corpus/sqlite/kinds_of_rows");
const OTHER_COLUMNS: &[u8] = include_bytes!("../corpus/sqlite/other_columns");
const THREE_LEVELS: &[u8] = include_bytes!("../corpus/sqlite/three_levels");
const PAGE: usize = 512;

#[test]
fn rows_of_every_kind_are_read_or_counted() {
    let (frames, summary) = read_log(KINDS);
    let printed: Vec<_> = frames.iter().map(ToString::to_string).collect();
    assert_eq!(
        printed,
        [
            "00010001#07",
            "00020002#0E0F",
            "003#151617",
            "00040004#1C1D1E1F",
            "00050005#R4",
            "20000080#0000000000000000",
            "20000088#0000000000000000",
            "00080008##0000102030405060708090A0B",
            "000D000D#74657874",
            "000E000E#",
        ]
    );
    let first = summary.epoch.unwrap();
    let micros: Vec<_> = frames.iter().map(|frame| first.unix_micros(frame.time)).collect();
    // The fourth one has a whole number of seconds, which the database stores as an integer.
    assert_eq!(
        micros[..4],
        [
            1_700_000_000_133_456,
            1_700_000_000_143_456,
            1_700_000_000_153_456,
            1_700_000_001_000_000
        ]
    );
    assert_eq!(*summary.interfaces, ["bus0"]);
    let said = summary.to_string();
    assert!(
        said.starts_with(
            "10 frames; 6 rows cannot be read, the first is row 9: the date cannot be read"
        ),
        "{said}"
    );
}

#[test]
fn columns_are_found_by_their_names() {
    let (frames, summary) = read_log(OTHER_COLUMNS);
    let printed: Vec<_> = frames.iter().map(ToString::to_string).collect();
    assert_eq!(
        printed,
        [
            "000#",
            "00010001#07",
            "00020002#0E0F",
            "003#151617",
            "00040004#1C1D1E1F",
            "00050005#2324252627"
        ]
    );
    assert_eq!(summary.lost_entries(), 0);
}

#[test]
fn rows_of_many_pages_are_in_order() {
    let (frames, summary) = read_log(THREE_LEVELS);
    assert_eq!((frames.len(), summary.lost_entries(), summary.clock_steps_back), (900, 0, 0));
    assert_eq!(summary.last.as_micros(), 8_990_000);
}

#[test]
fn damaged_database_is_read_up_to_the_named_page() {
    let pages = THREE_LEVELS.len() / PAGE;
    let mut named = 0;
    for page in 1..pages {
        let mut bytes = THREE_LEVELS.to_vec();
        bytes[page * PAGE..][..PAGE].fill(0x5A);
        let (frames, summary) = read_log(&bytes);
        let said = summary.to_string();
        if said.ends_with(&format!(
            "page {} of the database is damaged: the rest cannot be read",
            page + 1
        )) {
            named += 1;
        }
        assert!(frames.len() < 900, "page {}: {said}", page + 1);
    }
    assert_eq!(named, pages - 1);
    let (frames, summary) = read_log(&THREE_LEVELS[..20 * PAGE + 100]);
    assert!((100..900).contains(&frames.len()), "{summary}");
    assert!(
        summary
            .to_string()
            .ends_with("page 21 of the database is missing: the rest cannot be read"),
        "{summary}"
    );
}

#[test]
fn pages_in_a_loop_end_the_log() {
    let root = 2;
    let head = &THREE_LEVELS[(root - 1) * PAGE..][..12];
    assert_eq!(head[0], 5, "an inner page");
    let (last, first_child) = ((root - 1) * PAGE + 8, (root - 1) * PAGE + 12);
    let cell =
        usize::from(u16::from_be_bytes([THREE_LEVELS[first_child], THREE_LEVELS[first_child + 1]]));
    let first_page = THREE_LEVELS[(root - 1) * PAGE + cell..][..4].to_vec();
    // The last child is the root, or the first child again.
    for child in [vec![0, 0, 0, root as u8], first_page] {
        let mut bytes = THREE_LEVELS.to_vec();
        bytes[last..last + 4].copy_from_slice(&child);
        let (frames, summary) = read_log(&bytes);
        assert!((1..900).contains(&frames.len()), "{summary}");
        assert!(summary.to_string().contains("of the database is damaged"), "{summary}");
    }
}

#[test]
fn database_of_another_program_says_what_it_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let other = include_bytes!("../corpus/sqlite/without_table");
    fs::write(folder.path().join("other.db"), other).unwrap();
    let output = run_with_input(&["convert", "other.db", "out.log"], folder.path(), b"");
    assert_eq!(output.status.code(), Some(3));
    let said = text(&output.stderr);
    assert!(said.contains("other.db: 0 frames; the database has no table messages"), "{said}");
    let mut utf16 = KINDS.to_vec();
    utf16[56..60].copy_from_slice(&2_u32.to_be_bytes());
    fs::write(folder.path().join("utf16.db"), utf16).unwrap();
    let output = run_with_input(&["convert", "utf16.db", "out.log"], folder.path(), b"");
    assert_eq!(output.status.code(), Some(3));
    let said = text(&output.stderr);
    assert!(said.contains("utf16.db: 0 frames; its text is UTF-16"), "{said}");
}

#[test]
fn files_pipes_and_packed_databases_are_read_alike() {
    let folder = tempfile::tempdir().unwrap();
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(THREE_LEVELS).unwrap();
    let packed = encoder.finish().unwrap();
    fs::write(folder.path().join("log.db"), THREE_LEVELS).unwrap();
    fs::write(folder.path().join("log.db.gz"), &packed).unwrap();
    let convert = |from: &str, input: &[u8]| {
        let output =
            run_with_input(&["convert", from, "-", "--format", "candump"], folder.path(), input);
        assert_eq!(output.status.code(), Some(0), "{from}: {}", text(&output.stderr));
        text(&output.stdout)
    };
    let plain = convert("log.db", b"");
    assert_eq!(plain.lines().count(), 900);
    assert_eq!(convert("log.db.gz", b""), plain);
    assert_eq!(convert("-", THREE_LEVELS), plain);
    assert_eq!(convert("-", &packed), plain);
    let output = run_with_input(&["log", "log.db", "--json"], folder.path(), b"");
    assert_eq!(text(&output.stdout).lines().count(), 900, "{}", text(&output.stderr));
}

#[test]
fn write_ahead_log_beside_a_database_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut with_wal = THREE_LEVELS.to_vec();
    with_wal[18..20].fill(2);
    for (database, wal, code) in [
        (with_wal.as_slice(), &[7; 4152][..], 1),
        (with_wal.as_slice(), b"", 0),
        // The head of the log alone.
        (with_wal.as_slice(), &[7; 32], 0),
        // Of another database that had the same name: SQLite does not read it either.
        (THREE_LEVELS, &[7; 4152], 0),
    ] {
        fs::write(folder.path().join("log.db"), database).unwrap();
        fs::write(folder.path().join("log.db-wal"), wal).unwrap();
        let output =
            run_with_input(&["convert", "log.db", "out.log", "--force"], folder.path(), b"");
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{said}");
        let is_said = |said: &str| said.contains("what is in the file -wal beside it is not read");
        assert_eq!(is_said(&said), code == 1, "{said}");
        for command in [&["log", "log.db"][..], &["scan", "file:log.db"], &["watch", "file:log.db"]]
        {
            let output = run_with_input(command, folder.path(), b"");
            let said = text(&output.stderr);
            assert_eq!(is_said(&said), code == 1, "{command:?}: {said}");
        }
    }
}

/// Tests that a file beside a database counts that may not be read; root may read any.
#[cfg(unix)]
#[test]
fn unreadable_file_beside_a_database_is_named() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let mut with_wal = THREE_LEVELS.to_vec();
    with_wal[18..20].fill(2);
    for (database, ending) in [(with_wal.as_slice(), "wal"), (THREE_LEVELS, "journal")] {
        fs::write(folder.path().join("log.db"), database).unwrap();
        let beside = folder.path().join(format!("log.db-{ending}"));
        fs::write(&beside, journal(1, true)).unwrap();
        fs::set_permissions(&beside, fs::Permissions::from_mode(0o000)).unwrap();
        let output =
            run_with_input(&["convert", "log.db", "out.log", "--force"], folder.path(), b"");
        let said = text(&output.stderr);
        assert!(said.contains(&format!("-{ending} beside it is not read")), "{said}");
        assert_eq!(output.status.code(), Some(1), "{said}");
    }
}

/// Returns a rollback journal with this number of pages in its head, and perhaps with a page.
fn journal(pages: u32, has_page: bool) -> Vec<u8> {
    let mut journal = vec![0xD9, 0xD5, 0x05, 0xF9, 0x20, 0xA1, 0x63, 0xD7];
    for field in [pages, 0x1234_5678, 40, 512, 4096] {
        journal.extend(field.to_be_bytes());
    }
    journal.resize(512 + if has_page { 4 + 4096 + 4 } else { 0 }, 0);
    journal
}

/// What a program leaves that was killed inside a transaction, and one that has ended it.
#[test]
fn open_transaction_of_a_database_is_named() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("log.db"), THREE_LEVELS).unwrap();
    // A write-ahead log of another database that had the same name hides nothing.
    fs::write(folder.path().join("log.db-wal"), [7; 4152]).unwrap();
    let ended = [&[0; 28], &journal(1, true)[28..]].concat();
    for (journal, code) in [
        (journal(1, true), 1),
        (journal(u32::MAX, true), 1),
        (ended, 0),
        // Nothing of the database was overwritten yet.
        (journal(0, true), 0),
        (journal(1, false), 0),
        (journal(1, true)[..8].to_vec(), 0),
        (journal(1, true)[..7].to_vec(), 0),
        (Vec::new(), 0),
    ] {
        fs::write(folder.path().join("log.db-journal"), journal).unwrap();
        let output =
            run_with_input(&["convert", "log.db", "out.log", "--force"], folder.path(), b"");
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{said}");
        let cause = "it is inside a transaction, and the file -journal beside it is not read";
        assert_eq!(said.contains(cause), code == 1, "{said}");
    }
}
