//! A running `descan watch` with open standard input and its output lines.

use super::program::command;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Timeout of every wait, long enough for a busy machine.
const PATIENCE: Duration = Duration::from_mins(1);

/// The running program, its open standard input, and its output lines.
pub struct Watching {
    child: Child,
    /// Dropping it closes the program's input.
    pub stdin: Option<ChildStdin>,
    lines: Receiver<String>,
}

impl Watching {
    pub fn start(arguments: &[&str], folder: &Path) -> Self {
        let mut child = command(&[&["watch"], arguments].concat(), folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (sender, lines) = channel();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self { stdin: child.stdin.take(), child, lines }
    }

    pub fn write(&mut self, lines: &str) {
        self.stdin.as_mut().unwrap().write_all(lines.as_bytes()).unwrap();
    }

    pub fn line(&self) -> String {
        self.lines.recv_timeout(PATIENCE).expect("a line comes")
    }

    /// Returns the next value of that event.
    pub fn event(&self, event: &str) -> Value {
        self.event_that(event, |_| true)
    }

    /// Returns the next value of that event that meets the condition.
    pub fn event_that(&self, event: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let mut seen = String::new();
        loop {
            let Ok(line) = self.lines.recv_timeout(PATIENCE) else {
                panic!("no such {event} comes; what came:\n{seen}");
            };
            let value: Value = serde_json::from_str(&line).unwrap();
            if value["event"] == event && wanted(&value) {
                return value;
            }
            seen = seen + &line + "\n";
        }
    }

    pub fn rest(&self) -> String {
        self.lines.iter().map(|line| line + "\n").collect()
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id().cast_signed()), signal).unwrap();
    }

    pub fn exit_code(&mut self) -> i32 {
        self.child.wait().unwrap().code().expect("it ends by itself")
    }
}

impl Drop for Watching {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
