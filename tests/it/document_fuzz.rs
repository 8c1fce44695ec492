//! Random unusual files and random edits of them, by [`crate::checks::document`].
//!
//! `SECONDS=600 cargo test --test it document_fuzz -- --nocapture` runs for that time, starting at
//! `SEED` if that is set; a case that fails prints its seed.

use crate::checks::document::{DOCUMENT, Tally, check_file};
use fastrand::Rng;
use std::time::{Duration, Instant};

/// Files in many shapes and styles.
const FILES: [&str; 8] = [
    r#"{
  "devices": [
    { "name": "FEED", "address": 12, "static": true,
      "services": [ { "name": "DES", "version": "1.0" }, { "name": "AUGER", "version": "2.1" } ] },
    { "name": "SENS", "address": 13 }
  ],
  "note": [1e2, -0.50, "\u0416"]
}
"#,
    r#"[{"name":"FEED","address":12,"static":true},{"name":"SENS","address":13,"services":{"DES":"1.0"}},{"name":"SENS","address":14}]"#,
    "\u{feff}[\r\n\t{\"name\":\"Насос\",\"name_hex\":\"D09D\" , \"uid\":\"X1\"},\r\n\t{\"own\":{\"a\":[[]]},\"name\":\"B\",\"bus\":\"can0\"}\r\n]\r\n",
    "{\"devices\":null}",
    "{ }",
    "",
    "[ {\"name\":\"A\",\"address\":1,\"address\":2} , 7, {\"address\":3}, {\"name\":\"A\",\"address\":2} ]",
    "{\"a\":1,\"devices\":[\n\n{\"name\":\"\\\"\\\\\",\"static\":false,\"address\":127}\n\n]}",
];

#[test]
fn random_files_keep_all_edit_invariants() {
    let number = |name| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let first = number("SEED").unwrap_or(1);
    let end = number("SECONDS").map(|seconds| Instant::now() + Duration::from_secs(seconds));
    let mut tally = Tally::default();
    let mut seed = first;
    loop {
        match std::panic::catch_unwind(|| check_random_file(seed)) {
            Ok(one) => tally += one,
            Err(panic) => {
                eprintln!("seed {seed}");
                std::panic::resume_unwind(panic);
            }
        }
        seed += 1;
        let is_over = end.map_or(seed == first + 2000, |end| Instant::now() >= end);
        if is_over {
            break;
        }
    }
    println!("seeds {first} to {}: {tally:?}", seed - 1);
    assert!(tally.edits > 0 && tally.merges > 0 && tally.broken > 0, "{tally:?}");
}

fn check_random_file(seed: u64) -> Tally {
    let mut rng = Rng::with_seed(seed);
    let (source, theirs) = (file(&mut rng), file(&mut rng));
    let choices: Vec<u8> = std::iter::repeat_with(|| rng.u8(..)).take(200).collect();
    check_file(&source, &choices, &theirs)
}

/// Returns a file after a random mutation.
fn file(rng: &mut Rng) -> Vec<u8> {
    let mut bytes = rng.choice(FILES).unwrap().as_bytes().to_vec();
    for _ in 0..rng.u32(..6) {
        let at = rng.usize(..=bytes.len());
        let end = bytes.len().min(at + rng.usize(..12));
        match rng.u8(..7) {
            0 if at < bytes.len() => bytes[at] = rng.u8(..),
            1 => drop(bytes.drain(at..end)),
            2 => {
                let piece = bytes[at..end].to_vec();
                let to = rng.usize(..=bytes.len());
                bytes.splice(to..to, piece);
            }
            3 => {
                let other = rng.choice(FILES).unwrap().as_bytes();
                let start = rng.usize(..=other.len());
                let end = other.len().min(start + rng.usize(..60));
                bytes.splice(at..at, other[start..end].iter().copied());
            }
            4 => {
                // One more element, in the list or in a list within it.
                let opening = bytes.iter().position(|byte| *byte == b'[');
                let piece = rng.choice(FILES).unwrap().trim_start_matches('\u{feff}');
                if let (Some(opening), false) = (opening, piece.is_empty()) {
                    let piece = format!("{piece},");
                    bytes.splice(opening + 1..=opening, piece.bytes());
                }
            }
            _ => {
                let piece = rng.choice(DOCUMENT.words).unwrap().iter().copied();
                bytes.splice(at..at, piece);
            }
        }
    }
    bytes
}
