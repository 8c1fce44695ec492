//! `-`: a log from standard input as a bus.

use super::super::kind::{BusKind, OpenError, OpenRequest};
use super::super::port::Port;
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

pub(in crate::bus) fn open(request: OpenRequest) -> Result<Port, OpenError> {
    match io::stdin().as_fd().try_clone_to_owned() {
        Ok(log) => super::open(File::from(log), None, request),
        Err(cause) => Err(OpenError::Resources { name: request.name, cause }),
    }
}
