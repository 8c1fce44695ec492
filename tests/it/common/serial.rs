//! Serial ports for tests: ptys that can be unplugged and plugged in again under one name, and a
//! cable between two of them.

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::openpty;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd::ttyname;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_mins(1);

/// The adapter's end of a serial line whose other end has a name in the file system.
pub struct Pty {
    folder: tempfile::TempDir,
    ends: Option<Ends>,
    partial: Vec<u8>,
}

struct Ends {
    ours: File,
    /// Kept open, so that the line does not hang up when the program closes its end.
    _theirs: OwnedFd,
}

impl Pty {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut pty = Self { folder, ends: None, partial: Vec::new() };
        pty.plug_in();
        pty
    }

    /// Returns the path that the program opens.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("tty")
    }

    pub fn unplug(&mut self) {
        std::fs::remove_file(self.path()).unwrap();
        self.ends = None;
        self.partial.clear();
    }

    pub fn plug_in(&mut self) {
        let pty = openpty(None, None).expect("a pty");
        let mut settings = tcgetattr(&pty.slave).unwrap();
        cfmakeraw(&mut settings);
        tcsetattr(&pty.slave, SetArg::TCSANOW, &settings).unwrap();
        fcntl(&pty.master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
        let name = ttyname(&pty.slave).unwrap();
        let fresh: &Path = &self.folder.path().join("fresh");
        symlink(name, fresh).unwrap();
        std::fs::rename(fresh, self.path()).unwrap();
        self.ends = Some(Ends { ours: File::from(pty.master), _theirs: pty.slave });
    }

    fn ours(&self) -> &File {
        &self.ends.as_ref().expect("it is plugged in").ours
    }

    /// Returns the next line, without its terminator.
    pub fn read_line(&mut self) -> Option<String> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            if let Some(end) = self.partial.iter().position(|byte| *byte == b'\r') {
                let line: Vec<u8> = self.partial.drain(..=end).collect();
                return Some(String::from_utf8_lossy(&line[..end]).into_owned());
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            wait(self.ours(), PollFlags::POLLIN, left);
            let mut buffer = [0; 4096];
            match self.ours().read(&mut buffer) {
                Ok(count) => self.partial.extend_from_slice(&buffer[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => panic!("{error}"),
            }
        }
    }

    pub fn write(&mut self, bytes: &[u8]) {
        write_all(self.ours(), bytes, || false);
    }
}

fn wait(file: &File, events: PollFlags, time: Duration) {
    let timeout = PollTimeout::try_from(time.min(Duration::from_secs(10))).unwrap();
    let _ = poll(&mut [PollFd::new(file.as_fd(), events)], timeout);
}

fn write_all(mut file: &File, mut bytes: &[u8], is_over: impl Fn() -> bool) {
    while !bytes.is_empty() && !is_over() {
        match file.write(bytes) {
            Ok(count) => bytes = &bytes[count..],
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                wait(file, PollFlags::POLLOUT, Duration::from_millis(100));
            }
            Err(error) => panic!("{error}"),
        }
    }
}

/// A cable between two ports: forwards bytes in both directions.
pub struct Bridge {
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Bridge {
    pub fn between(one: &Pty, other: &Pty) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let way = |from: &Pty, to: &Pty| {
            let (mut from, to) = (from.ours().try_clone().unwrap(), to.ours().try_clone().unwrap());
            let is_over = Arc::clone(&is_over);
            std::thread::spawn(move || {
                let is_over = || is_over.load(Ordering::Acquire);
                let mut buffer = [0; 4096];
                while !is_over() {
                    match from.read(&mut buffer) {
                        Ok(count) => write_all(&to, &buffer[..count], is_over),
                        Err(error) if error.kind() == ErrorKind::WouldBlock => {
                            wait(&from, PollFlags::POLLIN, Duration::from_millis(100));
                        }
                        Err(error) => panic!("{error}"),
                    }
                }
            })
        };
        let threads = vec![way(one, other), way(other, one)];
        Self { is_over, threads }
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}
