//! Number of cases in the tests with random cases.

/// Returns `usual` times the environment variable SWEEP, a positive integer (1 if it is not set):
/// `SWEEP=20 cargo test --test it random` tries twenty times as many cases.
pub fn cases(usual: u32) -> u32 {
    let factor = std::env::var("SWEEP").ok().and_then(|text| text.parse().ok()).unwrap_or(1);
    usual.saturating_mul(factor)
}
