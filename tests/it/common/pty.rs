//! The real binary in a pseudo-terminal, read through a terminal emulator.
//!
//! Waits for screen content, never for a fixed time.

use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, poll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use portable_pty::{Child, CommandBuilder, MasterPty, PtySize, native_pty_system};
use rustix::termios::{Winsize, tcsetwinsize};
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Timeout of every wait, long enough for a busy machine.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// A slow line makes up for so much time in which a busy machine did not run it.
const LATE: Duration = Duration::from_millis(300);

/// Asks the terminal for its background colour.
const QUESTION: &[u8] = b"\x1b]11;?\x1b\\";

pub struct Pty {
    child: Box<dyn Child + Send + Sync>,
    master: Box<dyn MasterPty + Send>,
    writer: Option<Box<dyn Write + Send>>,
    output: Receiver<Vec<u8>>,
    parser: vt100::Parser,
    /// All bytes written to the terminal.
    pub bytes: Vec<u8>,
    /// It answers what its background colour is.
    pub answers: bool,
    settings: String,
}

impl Pty {
    /// Starts the program in `folder` with these arguments, on `columns` × `rows` cells.
    pub fn start(arguments: &[&str], folder: &Path, (columns, rows): (u16, u16)) -> Self {
        Self::run(env!("CARGO_BIN_EXE_descan"), arguments, folder, (columns, rows))
    }

    pub fn run(program: &str, arguments: &[&str], folder: &Path, size: (u16, u16)) -> Self {
        Self::run_on_line(program, arguments, folder, size, None)
    }

    /// Runs a program on a line that takes so many bytes per second, if that is given; what it has not
    /// taken is in the buffer of the kernel, until that is full.
    pub fn run_on_line(
        program: &str,
        arguments: &[&str],
        folder: &Path,
        (columns, rows): (u16, u16),
        line: Option<usize>,
    ) -> Self {
        let size = PtySize { rows, cols: columns, pixel_width: 0, pixel_height: 0 };
        let pair = native_pty_system().openpty(size).expect("a pseudo-terminal");
        let settings = settings(&*pair.master);
        let mut command = CommandBuilder::new(program);
        command.args(arguments);
        command.cwd(folder);
        command.env("TERM", "xterm-256color");
        command.env("XDG_CONFIG_HOME", folder.join("config"));
        command.env("XDG_STATE_HOME", folder.join("state"));
        command.env("TZ", "UTC");
        command.env("RUST_BACKTRACE", "0");
        command.env_remove("NO_COLOR");
        command.env_remove("COLORTERM");
        let child = pair.slave.spawn_command(command).expect("the program starts");
        drop(pair.slave);
        let mut reader = pair.master.try_clone_reader().unwrap();
        let (sender, output) = channel();
        std::thread::spawn(move || {
            // A slow line takes a tenth of its bytes every tenth of a second, also on a busy machine.
            let mut free_at = Instant::now();
            let mut buffer = vec![0; line.map_or(65_536, |line| line / 10)];
            while let Ok(count @ 1..) = reader.read(&mut buffer) {
                if sender.send(buffer[..count].to_vec()).is_err() {
                    return;
                }
                if let Some(line) = line {
                    if Instant::now().saturating_duration_since(free_at) > LATE {
                        free_at = Instant::now();
                    }
                    free_at += Duration::from_secs(count as u64) / line as u32;
                    std::thread::sleep(free_at.saturating_duration_since(Instant::now()));
                }
            }
        });
        let writer = Some(pair.master.take_writer().unwrap());
        let parser = vt100::Parser::new(cells(rows), cells(columns), 0);
        let (master, bytes, answers) = (pair.master, Vec::new(), false);
        Self { child, master, writer, output, parser, bytes, answers, settings }
    }

    /// Types keys.
    pub fn send(&mut self, keys: &str) {
        let writer = self.writer.as_mut().expect("the terminal is open");
        writer.write_all(keys.as_bytes()).unwrap();
        writer.flush().unwrap();
    }

    /// Waits until the screen meets the condition.
    pub fn wait_until(&mut self, what: &str, wanted: impl Fn(&vt100::Screen) -> bool) {
        let deadline = Instant::now() + PATIENCE;
        while !wanted(self.parser.screen()) {
            let left = deadline.saturating_duration_since(Instant::now());
            let Ok(bytes) = self.output.recv_timeout(left) else {
                panic!("no {what}; the screen is\n{}", self.screen());
            };
            self.take(&bytes);
        }
    }

    /// Waits until this text is on the screen.
    pub fn wait_for(&mut self, text: &str) {
        self.wait_until(text, |screen| screen.contents().contains(text));
    }

    fn take(&mut self, bytes: &[u8]) {
        self.parser.process(bytes);
        // A question may be in two pieces.
        let from = self.bytes.len().saturating_sub(QUESTION.len() - 1);
        self.bytes.extend_from_slice(bytes);
        let pieces = self.bytes[from..].windows(QUESTION.len());
        let questions = pieces.filter(|piece| *piece == QUESTION).count();
        for _ in 0..if self.answers { questions } else { 0 } {
            self.send("\x1b]11;rgb:1c1c/1f1f/2424\x1b\\");
        }
    }

    /// Reads the output for this long and returns its length in bytes.
    pub fn count_for(&mut self, time: Duration) -> usize {
        let before = self.bytes.len();
        let deadline = Instant::now() + time;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.output.recv_timeout(left) {
                Ok(bytes) => self.take(&bytes),
                Err(_) => return self.bytes.len() - before,
            }
        }
    }

    pub fn screen(&self) -> String {
        self.parser.screen().contents()
    }

    /// The screen with its colours.
    pub fn vt(&self) -> &vt100::Screen {
        self.parser.screen()
    }

    pub fn pid(&self) -> Pid {
        Pid::from_raw(self.child.process_id().expect("it runs").cast_signed())
    }

    pub fn signal(&self, signal: Signal) {
        kill(self.pid(), signal).unwrap();
    }

    pub fn resize(&mut self, columns: u16, rows: u16) {
        let size = PtySize { rows, cols: columns, pixel_width: 0, pixel_height: 0 };
        self.master.resize(size).unwrap();
        self.parser.screen_mut().set_size(cells(rows), cells(columns));
    }

    /// Waits for the program to exit; returns the exit code.
    pub fn wait(&mut self) -> u32 {
        let deadline = Instant::now() + PATIENCE;
        loop {
            while let Ok(bytes) = self.output.recv_timeout(Duration::from_millis(10)) {
                self.take(&bytes);
            }
            if let Some(status) = self.child.try_wait().unwrap() {
                // A slow line still carries the last bytes; it ends when it has carried all.
                while let Ok(bytes) = self.output.recv_timeout(PATIENCE) {
                    self.take(&bytes);
                }
                return status.exit_code();
            }
            assert!(Instant::now() < deadline, "it does not end; the screen is\n{}", self.screen());
        }
    }

    /// Asserts that the terminal is as before the program ran.
    pub fn assert_given_back(&self) {
        let screen = self.parser.screen();
        assert!(!screen.alternate_screen(), "the alternate screen is left");
        assert!(!screen.hide_cursor(), "the cursor is shown");
        assert!(!screen.bracketed_paste(), "paste reports are off");
        assert_eq!(
            screen.mouse_protocol_mode(),
            vt100::MouseProtocolMode::None,
            "mouse reports are off"
        );
        assert_eq!(settings(&*self.master), self.settings, "echo and line mode are back");
    }

    /// Returns the state of the process: R, S, T (stopped), Z.
    pub fn state(&self) -> char {
        let stat =
            std::fs::read_to_string(format!("/proc/{}/stat", self.pid())).unwrap_or_default();
        stat.rsplit(')').next().and_then(|rest| rest.trim().chars().next()).unwrap_or('?')
    }

    /// Waits until the process is in this state.
    pub fn wait_for_state(&mut self, state: char) {
        let deadline = Instant::now() + PATIENCE;
        while self.state() != state {
            assert!(Instant::now() < deadline, "it is {}, not {state}", self.state());
            if let Ok(bytes) = self.output.recv_timeout(Duration::from_millis(5)) {
                self.take(&bytes);
            }
        }
        while let Ok(bytes) = self.output.recv_timeout(Duration::from_millis(20)) {
            self.take(&bytes);
        }
    }

    /// Closes the terminal, as a lost connection would.
    pub fn hang_up(&mut self) {
        self.writer = None;
        self.signal(Signal::SIGHUP);
    }
}

fn cells(count: u16) -> std::num::NonZero<u16> {
    count.try_into().expect("a terminal has at least one cell")
}

/// Returns echo, line mode and the other terminal settings in comparable form.
fn settings(master: &dyn MasterPty) -> String {
    let settings = master.get_termios().expect("a terminal's settings");
    format!("{:?} {:?} {:?}", settings.input_flags, settings.output_flags, settings.local_flags)
}

impl Drop for Pty {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

/// The real binary in a pseudo-terminal whose only master is held here; closing it acts like a
/// lost connection.
pub struct ClosablePty {
    child: std::process::Child,
    master: Option<PtyMaster>,
    parser: vt100::Parser,
}

impl ClosablePty {
    /// Starts the program in `folder` on 120 × 40 cells. A session leader receives SIGHUP when the
    /// terminal is closed; otherwise only reads and writes fail.
    pub fn start(arguments: &[&str], folder: &Path, is_leader: bool) -> Self {
        // Closed on exec: a child that inherits it would keep the terminal open.
        let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let mut slave = File::options();
        slave.read(true).write(true).custom_flags(OFlag::O_NOCTTY.bits());
        let slave = slave.open(ptsname_r(&master).unwrap()).unwrap();
        let size = Winsize { ws_row: 40, ws_col: 120, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&slave, size).unwrap();
        let program = env!("CARGO_BIN_EXE_descan");
        let mut command = Command::new(if is_leader { "setsid" } else { program });
        if is_leader {
            command.args(["--ctty", program]);
        }
        let child = command
            .args(arguments)
            .current_dir(folder)
            .env("TERM", "xterm-256color")
            .env("XDG_CONFIG_HOME", folder.join("config"))
            .env("XDG_STATE_HOME", folder.join("state"))
            .env("RUST_BACKTRACE", "0")
            .env_remove("NO_COLOR")
            .stdin(slave.try_clone().unwrap())
            .stdout(slave.try_clone().unwrap())
            .stderr(slave)
            .spawn()
            .expect("the program starts");
        // Closes the remaining copies of the slave.
        drop(command);
        let parser = vt100::Parser::new(cells(40), cells(120), 0);
        Self { child, master: Some(master), parser }
    }

    /// Types keys.
    pub fn send(&mut self, keys: &str) {
        let master = self.master.as_mut().expect("the terminal is open");
        master.write_all(keys.as_bytes()).unwrap();
    }

    /// Waits until this text is on the screen.
    pub fn wait_for(&mut self, text: &str) {
        let deadline = Instant::now() + PATIENCE;
        let master = self.master.as_mut().expect("the terminal is open");
        let mut buffer = vec![0; 65_536];
        while !self.parser.screen().contents().contains(text) {
            let screen = self.parser.screen().contents();
            assert!(Instant::now() < deadline, "no {text}; the screen is\n{screen}");
            let mut watched = [PollFd::new(master.as_fd(), PollFlags::POLLIN)];
            if poll(&mut watched, 1000_u16).unwrap() > 0 {
                let count = master.read(&mut buffer).expect("the program writes");
                self.parser.process(&buffer[..count]);
            }
        }
    }

    /// Closes the terminal and waits for the program to exit; returns the exit code.
    pub fn close(&mut self) -> Option<i32> {
        self.master = None;
        let deadline = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            assert!(Instant::now() < deadline, "the program does not exit");
            let _ = poll(&mut [], 10_u16);
        }
    }
}

impl Drop for ClosablePty {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
