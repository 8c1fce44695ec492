//! `descan::prove` on simulated devices: good ones break no rule, and of each mutant the right rule is
//! named and none else.

mod bench;
mod command;
mod good;
mod mutants;
mod power;
