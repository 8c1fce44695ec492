//! The fuzz targets without cargo-fuzz: their committed inputs (`tests/corpus`), then mutations of
//! these.
//!
//! `SWEEP=50 cargo test --test it replay` tries fifty times as many mutations. They depend on their
//! number only. An input that breaks a rule is written to a file, whose path is printed.

use crate::checks::{TARGETS, Target};
use crate::common::sweep;
use fastrand::Rng;
use std::collections::BTreeSet;
use std::fs;
use std::panic::{catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};

/// Longest mutation in bytes.
const MAX_INPUT: usize = 4_096;

fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the paths in a folder of the repository, in order.
fn paths_in(folder: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(repository().join(folder)).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

/// Runs the committed inputs of a target, then `mutations` times SWEEP mutations of them.
fn replay(name: &str, mutations: u32) {
    let target = TARGETS.iter().find(|target| target.name == name).unwrap();
    let paths = paths_in(&format!("tests/corpus/{name}"));
    let corpus: Vec<Vec<u8>> = paths.iter().map(|path| fs::read(path).unwrap()).collect();
    for (input, path) in corpus.iter().zip(&paths) {
        check(target, input, &path.display().to_string());
    }
    for number in 0..sweep::cases(mutations) {
        let input = mutation(&mut Rng::with_seed(u64::from(number)), &corpus, target.words);
        check(target, &input, &format!("mutation {number}"));
    }
}

fn check(target: &Target, input: &[u8], origin: &str) {
    if let Err(panic) = catch_unwind(|| (target.check)(input)) {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-input", target.name));
        fs::write(&path, input).unwrap();
        eprintln!("{} with {origin}: {} bytes in {}", target.name, input.len(), path.display());
        resume_unwind(panic);
    }
}

/// Returns an input after some random mutations.
fn mutation(rng: &mut Rng, corpus: &[Vec<u8>], words: &[&[u8]]) -> Vec<u8> {
    let mut input = rng.choice(corpus).cloned().unwrap_or_default();
    for _ in 0..rng.u32(1..=8) {
        let at = rng.usize(..=input.len());
        let end = input.len().min(at + rng.usize(..16));
        match rng.u8(..9) {
            0 if at < input.len() => input[at] = rng.u8(..),
            1 if at < input.len() => input[at] ^= 1 << rng.u8(..8),
            2 => drop(input.drain(at..end)),
            3 => {
                let piece = input[at..end].to_vec();
                let to = rng.usize(..=input.len());
                input.splice(to..to, piece);
            }
            4 => {
                let other = rng.choice(corpus).unwrap();
                let start = rng.usize(..=other.len());
                let end = other.len().min(start + rng.usize(..64));
                input.splice(at..at, other[start..end].iter().copied());
            }
            5 => {
                let number = rng.choice([0, 1, 4, 0x7F, 0xFF, 0x7FFF_FFFF, u32::MAX]).unwrap();
                let end = input.len().min(at + 4);
                input.splice(at..end, number.to_le_bytes());
            }
            6 => drop(input.splice(at..at, std::iter::repeat_with(|| rng.u8(..)).take(3))),
            _ => drop(input.splice(at..at, rng.choice(words).unwrap().iter().copied())),
        }
    }
    input.truncate(MAX_INPUT);
    input
}

/// Names of the files in a folder, without their endings.
fn stems_in(folder: &str) -> BTreeSet<String> {
    let stem = |path: &PathBuf| path.file_stem().unwrap().to_str().unwrap().to_owned();
    paths_in(folder).iter().map(stem).collect()
}

#[test]
fn fuzz_target_has_files_and_inputs() {
    let names: BTreeSet<String> = TARGETS.iter().map(|target| target.name.to_owned()).collect();
    assert_eq!(names.len(), TARGETS.len());
    assert_eq!(stems_in("tests/corpus"), names);
    if !repository().join("tests/fuzz").exists() {
        // In the published crate: cargo leaves packages within a package out.
        return;
    }
    assert_eq!(stems_in("tests/fuzz/targets"), names);
    let manifest = fs::read_to_string(repository().join("tests/fuzz/Cargo.toml")).unwrap();
    let own = fs::read_to_string(repository().join("tests/it/replay.rs")).unwrap();
    for name in names {
        assert!(manifest.contains(&format!("path = \"targets/{name}.rs\"")), "{name}");
        assert!(own.contains(&format!("replay(\"{name}\"")), "{name}");
    }
}

// A test for each target, so that they run in parallel. The number of mutations takes about 1 s.

#[test]
fn slcan_mutations_break_no_rule() {
    replay("slcan", 25_000);
}

#[test]
fn socketcand_mutations_break_no_rule() {
    replay("socketcand", 35_000);
}

#[test]
fn udp_mutations_break_no_rule() {
    replay("udp", 240_000);
}

#[test]
fn candump_mutations_break_no_rule() {
    replay("candump", 8_000);
}

#[test]
fn pcapng_mutations_break_no_rule() {
    replay("pcapng", 12_000);
}

#[test]
fn asc_mutations_break_no_rule() {
    replay("asc", 3_000);
}

#[test]
fn trc_mutations_break_no_rule() {
    replay("trc", 3_000);
}

#[test]
fn csv_mutations_break_no_rule() {
    replay("csv", 3_000);
}

#[test]
fn pcap_mutations_break_no_rule() {
    replay("pcap", 6_000);
}

#[test]
fn packed_log_mutations_break_no_rule() {
    replay("packed", 2_000);
}

#[test]
fn sqlite_mutations_break_no_rule() {
    replay("sqlite", 2_000);
}

#[test]
fn mdf_mutations_break_no_rule() {
    replay("mdf", 2_000);
}

#[test]
fn dbc_mutations_break_no_rule() {
    replay("dbc", 20_000);
}

#[test]
fn document_mutations_break_no_rule() {
    replay("document", 1_300);
}

#[test]
fn profile_mutations_break_no_rule() {
    replay("profile", 30_000);
}

#[test]
fn theme_mutations_break_no_rule() {
    replay("theme", 60_000);
}

#[test]
fn filter_mutations_break_no_rule() {
    replay("filter", 20_000);
}

#[test]
fn keys_mutations_break_no_rule() {
    replay("keys", 100_000);
}

#[test]
fn config_mutations_break_no_rule() {
    replay("config", 130_000);
}

#[test]
fn scenario_mutations_break_no_rule() {
    replay("scenario", 20_000);
}

#[test]
fn engine_mutations_break_no_rule() {
    replay("engine", 4_000);
}

#[test]
fn node_mutations_break_no_rule() {
    replay("node", 100_000);
}
