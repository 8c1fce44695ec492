//! `-`: a log from standard input as a bus.

use super::super::faults::cannot_open;
use super::super::kind::{BusKind, OpenRequest};
use super::super::port::Port;
use crate::diagnostic::Diagnostic;
use crate::open_file::stdin_file;

pub(in crate::bus) const KIND: BusKind = BusKind {
    scheme: "-",
    forms: &["-"],
    example: "-",
    note: Some("a log from standard input"),
    can_send: false,
};

pub(in crate::bus) fn open(request: OpenRequest) -> Result<Port, Diagnostic> {
    match stdin_file() {
        Ok(log) => super::open(log, None, request),
        Err(error) => Err(cannot_open(request.name, &error)),
    }
}
