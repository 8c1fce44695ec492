//! Profiles: an input is the text of one. With a profile that is accepted, the engine runs.

use super::engine::{EngineStep, run};
use super::{Target, assert_printable};
use descan::discovery::Config;
use descan::frame::{CanId, Frame};
use descan::text::on_one_line;
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::Uid;
use descan::wire::profile::Profile;
use std::sync::Arc;

/// Target `profile`.
pub const PROFILE: Target = Target {
    name: "profile",
    check: |input| {
        let Ok(text) = str::from_utf8(input) else { return };
        match Profile::parse(text) {
            Ok(profile) => check_use(profile),
            Err(error) => assert_printable(&on_one_line(&error.to_string())),
        }
    },
    words: &[
        b"services.des = 0x005\n",
        b"services.heartbeat = 1\n",
        b"[heartbeat]\n",
        b"uid_offset = 58\n",
        b"uid_offset = 63\n",
        b"mode_offset = false\n",
        b"error_offset = 0\n",
        b"period_ms = 10\n",
        b"period_ms = 60000\n",
        b"announce = true\n",
        b"announce = \"auto\"\n",
        b"framing = \"raw\"\n",
        b"[isotp]\n",
        b"fd_padding = 0xCC\n",
        b"block_size = 255\n",
        b"st_min = 0xF1\n",
        b"st_min = 127\n",
        b"request_err = 1\n",
        b"[modes]\n",
        b"WORK = 255\n",
        b"[uid]\n",
        b"alphabet = \"",
        b"[service_names]\n\"0x3FF\" = \"X\"\n",
        b" !\\\"#$%&'()*+,-./0123456789:;<=>?@ABCDEFGHIJKLMNOPQRSTUVWXYZ[\\\\]^_\"\n",
    ],
};

/// Runs the engine on a bus with two nodes that use this profile.
fn check_use(profile: Profile) {
    for uid in [[0; 6], [0xFF; 6], [1, 2, 3, 4, 5, 6]] {
        assert_printable(&Uid(uid).text(&profile.uid).to_string());
    }
    let message = |address: u8, service: Service, data: &[u8]| {
        let header = Header::request(Address::DEBUG, Address::from_bits(address), false, service);
        let id = header.response(Address::from_bits(address), false).encode();
        Frame::new(CanId::Extended(id), data)
    };
    let (heartbeat, des) = (profile.heartbeat_service(), profile.des_service());
    let mut steps = Vec::new();
    for round in 0..8 {
        for address in [12, 13] {
            let long = &[address; 64][..if round % 2 == 0 { 8 } else { 64 }];
            let mut unsolicited = message(address, heartbeat, long);
            unsolicited.is_fd = long.len() > 8;
            let mut first = message(address, des, &[0x10, 20, 2, 3, b'D', b'E', b'S', 0]);
            first.is_fd = round % 2 == 1;
            for frame in [unsolicited, message(address, des, b"\x06\x01FEED\0"), first] {
                steps.push(EngineStep::Pause(300_000));
                steps.push(EngineStep::Frame(frame));
            }
        }
    }
    run(Config { profile: Arc::new(profile), ..Config::default() }, true, steps);
}
