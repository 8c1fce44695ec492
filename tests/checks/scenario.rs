//! Scenarios: an input is the text of one. A scenario that is accepted runs for some events.

use super::protocol::check_shape;
use super::{Target, assert_printable};
use descan::sim::{Scenario, Sim};
use descan::text::on_one_line;

/// Target `scenario`.
pub const SCENARIO: Target = Target {
    name: "scenario",
    check: |input| {
        let Ok(text) = str::from_utf8(input) else { return };
        match Scenario::parse(text) {
            Ok(scenario) => run(&scenario),
            Err(error) => assert_printable(&on_one_line(&error.to_string())),
        }
    },
    words: &[
        b"bitrate = 125000\n",
        b"[[device]]\nname = \"ACT\"\n",
        b"name_hex = \"414354\"\n",
        b"label = \"x\"\n",
        b"address = { preferred = 14 }\n",
        b"address = { fixed = 14 }\n",
        b"address = \"any\"\n",
        b"services = [[\"DES\", \"1.0\"], [\"V\", \"1.2\", \"more\"]]\n",
        b"autostart = true\n",
        b"mode = \"WORK\"\n",
        b"power_on = 0.001\n",
        b"settled = true\n",
        b"framing = \"both\"\n",
        b"fd = true\n",
        b"heartbeat_ms = 0.1\n",
        b"jitter_ms = 0.5\n",
        b"tolerance_ppm = -100000\n",
        b"delay_us = [0, 0]\n",
        b"faults = [\"drop-frame\", \"endless\", \"huge-length\", \"answers-twice\"]\n",
        b"chatter = [{ service = 0x130, period_ms = 0.1, length = 8 }]\n",
        b"error_rate = 1.0\n",
        b"[[at]]\ntime = 0.0\ndevice = \"ACT\"\ndo = \"quick-reboot\"\nevery = 0.0001\n",
        b"do = \"leave\"\n",
        b"do = \"join\"\n",
        b"do = \"move\"\n",
        b"do = \"error-rate\"\nrate = 1.0\n",
        b"uid = \"\"\n",
        b"observer_loss = 0.5\n",
        b"data_bitrate = 8000000\n",
        b"seed = 7\n",
        b"nan",
        b"inf",
        b"1e300",
    ],
};

/// The most times to which a simulation is advanced.
const MAX_EVENTS: usize = 300;
/// More frames are never waiting at a station.
const MAX_WAITING: usize = 100_000;

fn run(scenario: &Scenario) {
    let mut sim = Sim::from_scenario(scenario);
    let station = sim.attach();
    for _ in 0..MAX_EVENTS {
        let Some(next) = sim.next_event() else { break };
        sim.advance(next);
        let later = sim.next_event();
        assert!(later.is_none_or(|later| later > next), "{later:?} after {next}");
        for count in 0.. {
            let Some(frame) = sim.poll_frame(station) else { break };
            assert!(count < MAX_WAITING && frame.time <= next, "{frame:?} at {next}");
            check_shape(&frame);
        }
    }
}
