//! zstd: frames, skippable ones and their check sums.

use super::MAX_WINDOW;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};
use std::error::Error;
use std::io::{self, BufRead, BufReader, Read};

/// The frames of a zstd file, one after the other.
pub(super) struct ZstdReader<R> {
    source: BufReader<R>,
    decoder: FrameDecoder,
    is_inside: bool,
    /// Why a frame cannot be read to its end: the decoder gives what it has read of it.
    end: Option<io::ErrorKind>,
}

impl<R: Read> ZstdReader<R> {
    pub fn new(source: R) -> Self {
        let mut decoder = FrameDecoder::new();
        decoder.set_max_window_size(u64::from(MAX_WINDOW));
        Self { source: BufReader::new(source), decoder, is_inside: false, end: None }
    }

    /// Begins the next frame; false at the end of the file.
    fn begin_frame(&mut self) -> io::Result<bool> {
        loop {
            if self.source.fill_buf()?.is_empty() {
                return Ok(false);
            }
            match self.decoder.reset(&mut self.source) {
                Ok(()) => return Ok(true),
                Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame {
                    length,
                    ..
                })) => {
                    let mut skipped = (&mut self.source).take(u64::from(length));
                    io::copy(&mut skipped, &mut io::sink())?;
                }
                Err(FrameDecoderError::WindowSizeTooBig { .. }) => {
                    return Err(io::ErrorKind::OutOfMemory.into());
                }
                Err(error) => return Err(of_zstd(&error)),
            }
        }
    }
}

/// Returns an error of the decompressor; one of the file, or of its end, if that is its cause.
fn of_zstd(error: &(dyn Error + 'static)) -> io::Error {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(error) = error.downcast_ref::<io::Error>() {
            return match error.raw_os_error() {
                Some(code) => io::Error::from_raw_os_error(code),
                None => error.kind().into(),
            };
        }
        cause = error.source();
    }
    io::ErrorKind::InvalidData.into()
}

impl<R: Read> Read for ZstdReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            if !self.is_inside {
                if !self.begin_frame()? {
                    return Ok(0);
                }
                self.is_inside = true;
            }
            let count = self.decoder.read(buffer)?;
            if count > 0 {
                return Ok(count);
            }
            if let Some(end) = self.end {
                return Err(end.into());
            }
            if self.decoder.is_finished() {
                let written = self.decoder.get_checksum_from_data();
                let is_other = |sum: &u32| self.decoder.get_calculated_checksum() != Some(*sum);
                if written.as_ref().is_some_and(is_other) {
                    return Err(io::ErrorKind::InvalidData.into());
                }
                self.is_inside = false;
                continue;
            }
            let one = || BlockDecodingStrategy::UptoBlocks(1);
            if let Err(error) = self.decoder.decode_blocks(&mut self.source, one()) {
                let error = of_zstd(&error);
                // An empty last block, and a check sum: the decoder gives what it holds back.
                self.end = Some(error.kind());
                let last = [1, 0, 0, 0, 0, 0, 0];
                if self.decoder.decode_blocks(&last[..], one()).is_err() {
                    return Err(error);
                }
            }
        }
    }
}
