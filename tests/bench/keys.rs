//! Time from a key to the paint of its page, with 15,000 frames a second arriving, a filter in force and a
//! million captured frames.
//!
//! A random sequence of keys on a bus with 127 devices and a conflict, at 120 × 40. The bus goes on
//! between keys. What a key starts and does not wait for, as the counts of a filter or the replay to a
//! past moment, is done in parts; a key waits for one of them at most: their times are printed, too.

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/busy.rs"]
mod busy;

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/harness.rs"]
mod harness;

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/paced.rs"]
mod paced;

use busy::Busy;
use descan::time::Duration;
use std::collections::BTreeMap;
use std::time::Instant;

const LOAD: u64 = 15_000;
const FRAMES: u64 = 1_000_000;
const KEYS: usize = 6_000;

/// Pages and views are changed more often than the rest.
const PAGES: [&str; 5] = ["1", "2", "3", "4", "5"];
const VIEW: [&str; 3] = ["v", "s", "S"];
const MOVES: [&str; 12] =
    ["j", "k", "j", "k", "PgDn", "PgUp", "Home", "G", "Left", "Right", "Enter", "Esc"];
const OTHERS: [&str; 26] = [
    "o",
    "x",
    "z",
    "-",
    "+",
    "h",
    "l",
    "f",
    "p",
    "J",
    "K",
    "\\",
    "=",
    "!",
    "m",
    "c",
    "T",
    "?",
    "'",
    "M",
    "d",
    "Tab",
    "Backspace",
    "Esc",
    "Esc",
    "Esc",
];
const TIME: [&str; 9] = ["Space", "[", "]", "{", "}", "<", ">", "(", ")"];
const FILTERS: [&str; 4] = ["src:N012", "len:8 and not type:req", "data:10", "N0 or kind:error"];

fn main() {
    let mut busy = Busy::new(LOAD, (120, 40), true);
    busy.run(Duration::from_secs(FRAMES / LOAD));
    busy.keys("2 /");
    for letter in "src:N010 or dst:N011".chars() {
        busy.key(descan::keymap::Key::char(letter));
    }
    busy.keys("Enter");
    busy.run(Duration::from_secs(2));
    println!("{} frames captured", busy.app.capture().end());

    let mut random = fastrand::Rng::with_seed(11);
    let mut times: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let (mut now, mut past_times) = (Vec::new(), Vec::new());
    let mut typed: Vec<String> = Vec::new();
    let mut parts = Vec::new();
    for _ in 0..KEYS {
        let text = typed.pop().unwrap_or_else(|| {
            let choice = match random.u8(0..100) {
                0..20 => random.choice(PAGES),
                20..30 => random.choice(VIEW),
                30..70 => random.choice(MOVES),
                70..88 => random.choice(OTHERS),
                88..96 => random.choice(TIME),
                _ => {
                    let filter = random.choice(FILTERS).unwrap_or_default();
                    typed.push("Enter".to_owned());
                    typed.extend(filter.chars().rev().map(|letter| match letter {
                        ' ' => "Space".to_owned(),
                        letter => letter.to_string(),
                    }));
                    Some("/")
                }
            };
            choice.unwrap_or("1").to_owned()
        });
        let page = format!("{:?}", busy.app.view().page);
        let was_past = busy.app.past_moment().is_some();
        let took = busy.time_of_key(&text);
        let is_past = was_past || busy.app.past_moment().is_some();
        if is_past { &mut past_times } else { &mut now }.push(took);
        let view = match page.as_str() {
            "Traffic" => format!("{:?}", busy.app.view().traffic_view),
            _ => String::new(),
        };
        let past = if is_past { " past" } else { "" };
        let to = busy.app.view().page;
        let name = format!("{text:9} {page} → {to:?} {view}{past}");
        times.entry(name).or_default().push(took);
        for _ in 0..random.u8(1..30) {
            let start = Instant::now();
            busy.run(Duration::from_millis(10));
            parts.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    print("key to paint", &mut now);
    print("key to paint, to and at past moments", &mut past_times);
    print("10 ms of bus", &mut parts);
    let mut worst: Vec<_> = times
        .into_iter()
        .map(|(name, mut times)| {
            times.sort_by(f64::total_cmp);
            (times[(times.len() - 1) * 99 / 100], times[times.len() / 2], times.len(), name)
        })
        .collect();
    worst.sort_by(|a, b| b.0.total_cmp(&a.0));
    println!("  p99 ms  median    keys  key, page before → after");
    for (p99, median, count, name) in worst.iter().take(25) {
        println!("{p99:8.1} {median:7.1} {count:7}  {name}");
    }
}

fn print(what: &str, times: &mut [f64]) {
    times.sort_by(f64::total_cmp);
    let at = |part: f64| times[((times.len() - 1) as f64 * part) as usize];
    println!(
        "{what}: median {:.2} ms, p90 {:.2} ms, p99 {:.2} ms, worst {:.1} ms of {}",
        at(0.5),
        at(0.9),
        at(0.99),
        at(1.0),
        times.len()
    );
}
