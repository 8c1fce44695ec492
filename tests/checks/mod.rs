//! Checks of the parsers, the adapter and server protocols and the engine with one input each.
//!
//! A check panics if the program breaks a rule with its input: no panic, deadlines later than the
//! time that was handled, bounded output, no control characters in texts for the terminal, values
//! that come back when they are written and read again. The fuzz targets in `tests/fuzz` and the
//! replay in `tests/it/replay.rs` call them, each with its own inputs.

pub mod choices;
pub mod config;
pub mod dbc;
pub mod document;
pub mod engine;
pub mod filter;
pub mod keys;
pub mod log;
pub mod node;
pub mod profile;
pub mod protocol;
pub mod scenario;
pub mod theme;
pub mod udp;

/// A fuzz target.
#[derive(Debug)]
pub struct Target {
    /// Name of the target and of its folder in `tests/corpus`.
    pub name: &'static str,
    /// Panics if the program breaks a rule with this input.
    pub check: fn(&[u8]),
    /// Parts of inputs that random bytes seldom contain.
    pub words: &'static [&'static [u8]],
}

/// All targets.
pub const TARGETS: [Target; 22] = [
    protocol::SLCAN,
    protocol::SOCKETCAND,
    udp::UDP,
    log::CANDUMP,
    log::ASC,
    log::TRC,
    log::CSV,
    log::PCAP,
    log::PACKED,
    log::PCAPNG,
    log::SQLITE,
    log::MDF,
    dbc::DBC,
    document::DOCUMENT,
    profile::PROFILE,
    theme::THEME,
    filter::FILTER,
    keys::KEYS,
    config::CONFIG,
    scenario::SCENARIO,
    engine::ENGINE,
    node::NODE,
];

/// Asserts that a text contains only printable characters.
///
/// # Panics
///
/// If it contains others.
pub fn assert_printable(text: &str) {
    assert!(text.chars().all(descan::text::is_printable), "not printable: {text:?}");
}

/// Asserts that an error names a line of the text.
///
/// # Panics
///
/// If it names another one.
pub fn assert_line(text: &str, line: usize) {
    assert!((1..=text.split('\n').count()).contains(&line), "line {line} of {text:?}");
}
