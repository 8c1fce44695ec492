//! All of a log of any format, from its bytes.

use descan::frame::Frame;
use descan::log::{LogReader, LogSummary, Unpacked};
use std::io::BufReader;

/// The frames, and what is said of the log at its end.
pub fn read_log(bytes: &[u8]) -> (Vec<Frame>, LogSummary) {
    let mut reader = LogReader::new(BufReader::new(Unpacked::new(bytes)));
    let frames = reader.by_ref().map(Result::unwrap).collect();
    (frames, reader.summary().clone())
}
