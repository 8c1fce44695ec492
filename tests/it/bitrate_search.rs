//! The bit rate search: tries bit rates in turn, each for its time, until a frame is valid.

use descan::bitrate::{Search, SearchOutcome};
use descan::frame::Frame;
use descan::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_secs(1);

/// Returns an error frame with a stuff error, as a controller reports it.
fn broken() -> Frame {
    Frame::error(0x88, &[0, 0, 4, 0, 0, 0, 0, 0])
}

fn whole() -> Frame {
    Frame::classic(0x0718_0001, &[0; 8])
}

/// Searches from `first`; at each bit rate `heard` returns what is received, a frame each 10 ms.
/// Returns the bit rates with the time of each, and the outcome.
fn search(
    first: u32,
    mut heard: impl FnMut(u32) -> Option<Frame>,
) -> (Vec<(u32, u64)>, SearchOutcome) {
    let mut search = Search::new(first, PERIOD);
    let mut now = Instant::ZERO;
    let mut took = Vec::new();
    loop {
        let (rate, from) = (search.rate(), now);
        assert!(search.wants_rate());
        search.begin(now);
        while search.rate() == rate && search.outcome().is_none() {
            now += Duration::from_millis(10);
            if let Some(frame) = heard(rate) {
                search.handle_frame(&frame);
            }
            search.handle_timeout(now);
        }
        took.push((rate, now.since(from).as_millis() as u64));
        if let Some(outcome) = search.outcome() {
            return (took, outcome);
        }
    }
}

#[test]
fn rate_without_frames_is_left_after_1_5_periods() {
    let (took, outcome) = search(125_000, |_| None);
    assert_eq!(took, [125_000, 250_000, 500_000, 1_000_000].map(|rate| (rate, 1500)));
    assert_eq!(outcome, SearchOutcome::NoTraffic);
}

#[test]
fn search_starts_at_given_rate_and_wraps() {
    let (took, _) = search(500_000, |_| None);
    let rates: Vec<u32> = took.iter().map(|(rate, _)| *rate).collect();
    assert_eq!(rates, [500_000, 1_000_000, 125_000, 250_000]);
    let (took, _) = search(100_000, |_| None);
    let rates: Vec<u32> = took.iter().map(|(rate, _)| *rate).collect();
    assert_eq!(rates, [100_000, 125_000, 250_000, 500_000, 1_000_000]);
    let (took, _) = search(1_000_000, |_| None);
    assert_eq!(took.first().map(|(rate, _)| *rate), Some(1_000_000));
    assert_eq!(took.len(), 4);
}

#[test]
fn valid_frame_ends_search_with_its_rate() {
    let (took, outcome) =
        search(125_000, |rate| Some(if rate == 500_000 { whole() } else { broken() }));
    assert_eq!(outcome, SearchOutcome::Found(500_000));
    assert_eq!(took.last(), Some(&(500_000, 10)));
    assert!(took[0].1 < 1500, "many broken frames are enough to go on: {took:?}");
}

#[test]
fn few_bus_errors_do_not_rule_out_rate() {
    // A lone device breaks its own frames until it is error-passive; then they are valid.
    let mut count = 0;
    let (_, outcome) = search(250_000, |_| {
        count += 1;
        Some(if count <= 16 { broken() } else { whole() })
    });
    assert_eq!(outcome, SearchOutcome::Found(250_000));
}

#[test]
fn own_frames_and_state_reports_do_not_count() {
    let mut count = 0;
    let (_, outcome) = search(125_000, |_| {
        count += 1;
        let mut ours = whole();
        ours.is_tx = true;
        // Error-warning, and an ACK error.
        let state = Frame::error(0x4, &[0, 8, 0, 0, 0, 0, 0, 0]);
        let alone = Frame::error(0x20, &[0; 8]);
        Some([ours, state, alone][count % 3])
    });
    assert_eq!(outcome, SearchOutcome::NoTraffic);
    let (_, outcome) = search(125_000, |rate| (rate == 250_000).then(broken));
    assert_eq!(outcome, SearchOutcome::OnlyBusErrors);
}

#[test]
fn frames_during_rate_change_are_ignored() {
    let mut search = Search::new(125_000, PERIOD);
    search.handle_frame(&whole());
    assert_eq!(search.outcome(), None);
    search.skip();
    assert_eq!(search.rate(), 250_000);
    search.begin(Instant::ZERO);
    search.handle_frame(&whole());
    assert_eq!(search.outcome(), Some(SearchOutcome::Found(250_000)));
    assert_eq!(search.tried().len(), 2);
}
