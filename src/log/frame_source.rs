//! The frames of a log by their numbers, to read some of them again. Does not know files.

use crate::frame::Frame;
use std::fmt;
use std::io;
use std::ops::Range;

/// A log whose frames can be read again.
pub trait FrameSource: fmt::Debug + Send {
    /// Numbers of the frames that can be read, counted from the first frame of the session.
    fn numbers(&self) -> Range<u64>;

    /// Passes the frames with these numbers to `take`, in this order. Their times count from the start
    /// of the log.
    ///
    /// # Errors
    ///
    /// Those of the file; with fewer frames it ends early.
    fn read(&mut self, numbers: Range<u64>, take: &mut dyn FnMut(Frame)) -> io::Result<()>;
}
