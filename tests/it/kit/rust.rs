//! The tests of a node, with that in Rust, `descan::node`.
#![allow(clippy::duplicate_mod)] // The same tests for both nodes.

use super::*;

type Driver = node_bench::NodeBench;
type Board = SingleBoard<Driver>;
/// Random buses in the suite.
const SEEDS: u64 = 20;
type TestBus = IdealBus<Driver>;

#[path = "address_resolution.rs"]
mod address_resolution;
#[path = "commands.rs"]
mod commands;
#[path = "conformance.rs"]
mod conformance;
#[path = "identifiers.rs"]
mod identifiers;
#[path = "simulation.rs"]
mod simulation;
#[path = "transfers.rs"]
mod transfers;
#[path = "vectors.rs"]
mod vectors;
