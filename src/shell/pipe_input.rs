//! A pipe that is read until the program is told to stop.
//!
//! A thread reads the pipe, which may be silent forever. Told to stop, as by Ctrl-C, which ends the program
//! at the other end, too, the reader takes what is still on its way, then ends. Does not know what is read.

use std::io::{self, Cursor, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Bytes that are read at once at most.
const PIECE: usize = 1 << 16;
/// Pieces that wait at most.
const PIECES: usize = 8;
/// How often it is looked whether to stop.
const LOOK: Duration = Duration::from_millis(50);
/// Time in which the rest is read after the stop.
const REST: Duration = Duration::from_millis(300);

/// See the module's documentation.
pub struct PipeInput {
    pieces: Receiver<io::Result<Vec<u8>>>,
    piece: Cursor<Vec<u8>>,
    is_stopped: Arc<AtomicBool>,
    /// When it ends after the stop.
    end: Option<Instant>,
}

impl PipeInput {
    /// Starts to read `pipe`, until `is_stopped` is set.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn spawn(
        mut pipe: impl Read + Send + 'static,
        is_stopped: Arc<AtomicBool>,
    ) -> io::Result<Self> {
        let (sender, pieces) = sync_channel(PIECES);
        // Detached: it may wait for the pipe forever.
        thread::Builder::new().name("pipe".into()).spawn(move || {
            loop {
                let mut piece = vec![0; PIECE];
                let read = match pipe.read(&mut piece) {
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                    read => read,
                };
                let is_last = !matches!(read, Ok(1..));
                let piece = read.map(|count| {
                    piece.truncate(count);
                    piece
                });
                if sender.send(piece).is_err() || is_last {
                    return;
                }
            }
        })?;
        Ok(Self { pieces, piece: Cursor::default(), is_stopped, end: None })
    }
}

impl Read for PipeInput {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let count = self.piece.read(buffer)?;
            if count > 0 || buffer.is_empty() {
                return Ok(count);
            }
            if self.end.is_none() && self.is_stopped.load(Ordering::Relaxed) {
                self.end = Some(Instant::now() + REST);
            }
            if self.end.is_some_and(|end| Instant::now() >= end) {
                return Ok(0);
            }
            match self.pieces.recv_timeout(LOOK) {
                Ok(piece) => {
                    let piece = piece?;
                    if piece.is_empty() {
                        return Ok(0);
                    }
                    self.piece = Cursor::new(piece);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(0),
            }
        }
    }
}
