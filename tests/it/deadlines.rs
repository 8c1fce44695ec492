//! A state machine whose timers were handled up to a moment has its next deadline later, or none.
//! The app's is checked by `random_input`, those of the engine, of adapters and servers by `replay`.

use descan::bitrate::Search;
use descan::frame::{CanId, Frame, FrameKind};
use descan::time::{Duration, Instant};
use descan::wire::isotp::{FlowControl, FlowStatus, Segmenter};
use proptest::prelude::*;

fn flow() -> impl Strategy<Value = Option<FlowControl>> {
    let status = prop::sample::select(vec![FlowStatus::Continue, FlowStatus::Wait]);
    let flow = (status, 0u8..4, any::<u8>());
    let flow =
        flow.prop_map(|(status, block_size, st_min)| FlowControl { status, block_size, st_min });
    prop::option::of(flow)
}

/// Returns the report of a bus error, as SocketCAN sends it.
fn bus_error() -> Frame {
    let mut report = Frame::new(CanId::Extended(0x88), &[0; 8]);
    report.kind = FrameKind::Error;
    report
}

proptest! {
    #[test]
    fn segmenter_deadline_is_later_than_handled_time(
        length in 1usize..300,
        steps in prop::collection::vec((0u64..400_000, flow()), 1..80),
        is_fd in any::<bool>(),
    ) {
        let mut sender = Segmenter::new(vec![0; length], is_fd);
        let mut now = Instant::ZERO;
        for (micros, flow) in steps {
            now += Duration::from_micros(micros);
            let is_over = flow.is_some_and(|flow| sender.handle_flow(now, flow).is_err());
            while sender.poll(now).is_some() {}
            if is_over || sender.handle_timeout(now).is_err() {
                break;
            }
            prop_assert!(sender.poll_timeout().is_none_or(|due| due > now));
        }
    }

    #[test]
    fn bit_rate_search_deadline_is_later_than_handled_time(
        period in 0u64..3_000,
        steps in prop::collection::vec((0u64..3_000, 0u8..4), 1..80),
    ) {
        let mut search = Search::new(125_000, Duration::from_millis(period));
        let mut now = Instant::ZERO;
        for (millis, step) in steps {
            now += Duration::from_millis(millis);
            match step {
                0 if search.wants_rate() => search.begin(now),
                1 if search.wants_rate() => search.skip(),
                2 => search.handle_frame(&bus_error()),
                _ => {}
            }
            search.handle_timeout(now);
            prop_assert!(search.poll_timeout().is_none_or(|due| due > now));
        }
    }
}
