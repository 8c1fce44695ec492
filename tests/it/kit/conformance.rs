//! The node keeps the rules that `descan prove` tests devices by.

use super::{Act, Board, BoardSpec, KitFrame, PERIOD};
use descan::frame::Frame;
use descan::prove::{Conformance, ProofSwitches, Prover, ProverSetup, RuleNeed, RuleVerdict};
use descan::time::Instant;
use descan::wire::id::Address;
use descan::wire::profile::{Profile, ProfileKey, ValueOrigin};
use std::sync::Arc;

/// Longest time between two looks at the node, in microseconds.
const STEP: u32 = 2000;
/// Longest time of the tests, in periods.
const LIMIT: u32 = 300;

fn at(micros: u32) -> Instant {
    Instant::from_micros(micros.into())
}

fn given_profile() -> Profile {
    let mut profile = Profile::default();
    for key in ProfileKey::ALL {
        profile.set_origin(*key, ValueOrigin::Given);
    }
    profile
}

fn pass_on(prover: &mut Prover, acts: &[(u32, Act)]) {
    for (time, act) in acts {
        if let Act::Send { frame, .. } = act {
            prover.handle_frame(&Frame::classic(frame.id, &frame.data).with_time(at(*time)));
        }
    }
}

/// Tests a node at address 12.
fn prove(spec: &BoardSpec, switches: ProofSwitches) -> Vec<RuleVerdict> {
    let mut board = Board::running(spec);
    let end = board.now + LIMIT * PERIOD;
    let setup = ProverSetup {
        own: Address::DEBUG,
        device: Address::from_bits(12),
        profile: Arc::new(given_profile()),
        bits_per_second: 125_000,
        budget: 0.05,
        is_listen_only: false,
        switches,
        seed: 7,
    };
    let mut prover = Prover::new(at(board.now), setup);
    while let Some(due) = prover.poll_timeout() {
        assert!(board.now < end, "not over: {:?}", prover.progress());
        let wait = due.since(at(board.now)).as_micros().clamp(1, STEP.into()) as u32;
        let acts = board.pass_timed(wait);
        pass_on(&mut prover, &acts);
        prover.handle_timeout(at(board.now));
        while let Some(frame) = prover.poll_transmit() {
            let id = frame.platform_id().unwrap();
            prover.handle_frame(&frame.with_time(at(board.now)).with_tx());
            let acts = board.receive(&KitFrame::classic(id, frame.data()));
            let acts: Vec<(u32, Act)> = acts.into_iter().map(|act| (board.now, act)).collect();
            pass_on(&mut prover, &acts);
        }
    }
    prover.verdicts()
}

fn spec() -> BoardSpec {
    let services = (0..6u8).flat_map(|at| {
        let mut service = vec![at];
        service.extend(b"SRVX\x001.0\x00");
        service
    });
    BoardSpec { services: services.collect(), ..BoardSpec::new(12) }
}

#[test]
fn node_keeps_every_rule_that_can_be_seen() {
    let switches = ProofSwitches { disrupts: true, ..ProofSwitches::default() };
    let verdicts = prove(&spec(), switches);
    let of = |conformance: Conformance| {
        let is_made = |it: &&RuleVerdict| {
            let need = it.rule.need();
            it.conformance == conformance && !matches!(need, RuleNeed::Load | RuleNeed::Reboot)
        };
        let texts = verdicts.iter().filter(is_made);
        texts.map(|it| (it.rule.id(), it.text.clone())).collect::<Vec<_>>()
    };
    assert_eq!(of(Conformance::Broken), []);
    // It works from the start, and was not observed before.
    let unseen: Vec<&str> = of(Conformance::NotSeen).iter().map(|(id, _)| *id).collect();
    assert_eq!(unseen, ["no-requests-unless-working"], "{:?}", of(Conformance::NotSeen));
}
