//! `-`: a log from standard input as a bus.

use super::super::faults::cannot_open;
use super::super::kind::{BusKind, OpenRequest};
use super::super::port::Port;
use crate::diagnostic::Diagnostic;
use std::fs::File;
use std::io;
use std::os::fd::AsFd;

pub(in crate::bus) const KIND: BusKind = BusKind {
    scheme: "-",
    forms: &["-"],
    example: "-",
    note: Some("a log from standard input"),
    can_send: false,
};

pub(in crate::bus) fn open(request: OpenRequest) -> Result<Port, Diagnostic> {
    match io::stdin().as_fd().try_clone_to_owned() {
        Ok(log) => super::open(File::from(log), None, request),
        Err(error) => Err(cannot_open(request.name, &error)),
    }
}
