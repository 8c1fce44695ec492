//! Reading a file at an offset. Does not know what is in it.
//!
//! On Unix the position of the file does not change. Windows moves it: it is put back, and who reads
//! one file at several places at a time uses [`read_next`].

use std::fs::File;
use std::io;

/// Reads at an offset; returns the number of bytes, 0 at the end.
///
/// # Errors
///
/// Those of the file system.
#[cfg(unix)]
pub fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, offset)
}

/// Reads at an offset; returns the number of bytes, 0 at the end.
///
/// # Errors
///
/// Those of the file system.
#[cfg(windows)]
pub fn read_at(mut file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    use std::io::Seek as _;
    let position = file.stream_position()?;
    let read = std::os::windows::fs::FileExt::seek_read(file, buffer, offset);
    file.seek(io::SeekFrom::Start(position))?;
    read
}

/// Fills the buffer from an offset on.
///
/// # Errors
///
/// Those of the file system; the file ends before.
pub fn read_exact_at(file: &File, mut buffer: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !buffer.is_empty() {
        match read_at(file, buffer, offset) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => {
                buffer = &mut buffer[count..];
                offset += count as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Reads on after the first `_read` bytes, which were read before; returns 0 at the end.
///
/// # Errors
///
/// Those of the file system.
#[cfg(unix)]
pub fn read_next(mut file: &File, buffer: &mut [u8], _read: u64) -> io::Result<usize> {
    io::Read::read(&mut file, buffer)
}

/// Reads on after the first `read` bytes, which were read before; returns 0 at the end. Another
/// thread may move the position of the file meanwhile.
///
/// # Errors
///
/// Those of the file system.
#[cfg(windows)]
pub fn read_next(file: &File, buffer: &mut [u8], read: u64) -> io::Result<usize> {
    match std::os::windows::fs::FileExt::seek_read(file, buffer, read) {
        // The other end of a pipe is closed.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(0),
        read => read,
    }
}
