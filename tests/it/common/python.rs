//! Peers in Python, with packages from the package index, in a virtual environment under the target
//! folder.
//!
//! Without python3, venv or package index, tests print the reason and pass; in CI they must run.

use nix::fcntl::{Flock, FlockArg};
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// A Python interpreter with the requested packages.
pub struct Python {
    program: PathBuf,
}

impl Python {
    /// Creates the environment with these packages unless it exists; if it cannot, prints the
    /// reason.
    pub fn with(packages: &[&str]) -> Option<Self> {
        let name: String = packages.join("-").replace(|c: char| !c.is_ascii_alphanumeric(), "-");
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        // Test programs that run at the same time create it once.
        let lock = File::create(folder.with_extension("lock")).unwrap();
        let _lock = Flock::lock(lock, FlockArg::LockExclusive).expect("a lock");
        match make(&folder, packages) {
            Ok(()) => Some(Self { program: folder.join("bin/python") }),
            Err(reason) => {
                let must_run = std::env::var("CI").is_ok_and(|ci| ci == "true");
                assert!(!must_run, "cannot run: {reason}");
                let test = std::thread::current().name().unwrap_or("test").to_owned();
                // Not by println: the test harness would capture it.
                let _ = writeln!(std::io::stderr(), "skipped {test}: {reason}");
                None
            }
        }
    }

    /// Runs a script to its end; returns what it prints.
    pub fn run(&self, script: &str, arguments: &[&str], variables: &[(&str, &str)]) -> String {
        let mut command = Command::new(&self.program);
        command.arg("-c").arg(script).args(arguments).envs(variables.iter().copied());
        let output = command.output().expect("Python starts");
        let said = String::from_utf8_lossy(&output.stderr);
        let printed = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        assert!(output.status.success(), "{printed}\n{said}");
        printed
    }

    /// Starts a script.
    pub fn start(&self, script: &str, arguments: &[&str]) -> Peer {
        let mut child = Command::new(&self.program)
            .arg("-c")
            .arg(script)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("Python starts");
        let input = child.stdin.take().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        Peer { child, input, output }
    }
}

fn make(folder: &Path, packages: &[&str]) -> Result<(), String> {
    let complete = folder.join("complete");
    if complete.exists() {
        return Ok(());
    }
    let _ = fs::remove_dir_all(folder);
    run(Command::new("python3").args(["-m", "venv"]).arg(folder))?;
    let pip = folder.join("bin/pip");
    run(Command::new(pip)
        .args(["install", "--quiet", "--disable-pip-version-check"])
        .args(packages))?;
    fs::write(complete, "").map_err(|error| error.to_string())
}

fn run(command: &mut Command) -> Result<(), String> {
    let output = command.output().map_err(|error| format!("{command:?}: {error}"))?;
    if output.status.success() {
        return Ok(());
    }
    let cause = String::from_utf8_lossy(&output.stderr);
    Err(format!("{command:?}: {}", cause.trim().lines().last().unwrap_or("failed")))
}

/// A running script, killed when dropped.
pub struct Peer {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Peer {
    /// Returns the next line of its output.
    pub fn read_line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).expect("text");
        assert!(!line.is_empty(), "the script has ended: {:?}", self.child.try_wait());
        line.trim_end().to_owned()
    }

    pub fn write_line(&mut self, line: &str) {
        writeln!(self.input, "{line}").expect("the script reads");
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
