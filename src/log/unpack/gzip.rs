//! gzip: members and the zeros between them.

use flate2::bufread::GzDecoder;
use std::io::{self, BufRead, BufReader, Read};

/// First byte of a member.
const MAGIC: u8 = 0x1F;

/// The members of a gzip file, one after the other. Zeros may stand behind them, as tapes have them.
pub(super) struct GzipReader<R> {
    /// `None` at the end of the file.
    member: Option<GzDecoder<BufReader<R>>>,
}

impl<R: Read> GzipReader<R> {
    pub fn new(source: R) -> Self {
        Self { member: Some(GzDecoder::new(BufReader::new(source))) }
    }
}

impl<R: Read> Read for GzipReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let Some(member) = &mut self.member else { return Ok(0) };
            let count = member.read(buffer)?;
            if count > 0 || buffer.is_empty() {
                return Ok(count);
            }
            let Some(mut source) = self.member.take().map(GzDecoder::into_inner) else { continue };
            loop {
                let bytes = source.fill_buf()?;
                let zeros = bytes.iter().take_while(|&&byte| byte == 0).count();
                if bytes.is_empty() {
                    break;
                }
                if let Some(&next) = bytes.get(zeros) {
                    if next != MAGIC {
                        return Err(io::ErrorKind::InvalidData.into());
                    }
                    source.consume(zeros);
                    self.member = Some(GzDecoder::new(source));
                    break;
                }
                source.consume(zeros);
            }
        }
    }
}
