//! What tests with a real CAN kernel share: interfaces of their own, peers from can-utils, and
//! waiting for conditions.
//!
//! Each test makes interfaces of its own, which takes root and the vcan module: where that is
//! not to be had, it says why and passes. The virtual machine of tests/vm has both.

use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Longer than anything takes, even in an emulated machine.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// A virtual CAN interface, up, with FD; removed when dropped.
pub struct Vcan {
    name: String,
}

impl Vcan {
    /// Makes it; where that is not possible, says why and gives `None`.
    pub fn new(name: &str) -> Option<Self> {
        let vcan = Self { name: name.to_owned() };
        // One may be left from a test that was killed.
        let _ = ip(&["link", "del", name]);
        match vcan.create() {
            Ok(()) => Some(vcan),
            Err(reason) => {
                skip(&reason);
                None
            }
        }
    }

    /// The name of an interface that is not there yet; it is removed when dropped all the same.
    pub fn later(name: &str) -> Option<Self> {
        let vcan = Self::new(name)?;
        vcan.remove();
        Some(vcan)
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn create(&self) -> Result<(), String> {
        ip(&["link", "add", &self.name, "type", "vcan"])?;
        ip(&["link", "set", &self.name, "up", "mtu", "72"])
    }

    pub fn remove(&self) {
        ip(&["link", "del", &self.name]).expect("the interface was there");
    }

    /// Gives it another name; it must be down.
    pub fn rename(&self, name: &str) {
        ip(&["link", "set", &self.name, "name", name]).expect("the interface is there");
    }

    pub fn up(&self) {
        ip(&["link", "set", &self.name, "up"]).expect("the interface is there");
    }

    pub fn down(&self) {
        ip(&["link", "set", &self.name, "down"]).expect("the interface is there");
    }
}

impl Drop for Vcan {
    fn drop(&mut self) {
        let _ = ip(&["link", "del", &self.name]);
    }
}

/// The two wired controllers of the virtual machine, can0 and can1, for one test at a time;
/// elsewhere `None`: nothing is sent on a bus that belongs to somebody.
pub fn controllers() -> Option<MutexGuard<'static, ()>> {
    static TAKEN: Mutex<()> = Mutex::new(());
    if std::env::var_os("DESCAN_VM").is_none() {
        skip("only in the virtual machine of tests/vm are can0 and can1 ours");
        return None;
    }
    Some(TAKEN.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Says why a test did not run. In the virtual machine it must.
pub fn skip(reason: &str) {
    assert!(std::env::var_os("DESCAN_VM").is_none(), "cannot run in the VM: {reason}");
    // Not by println: the test harness would keep it to itself.
    let test = thread::current().name().unwrap_or("test").to_owned();
    let _ = writeln!(std::io::stderr(), "skipped {test}: {reason}");
}

fn ip(arguments: &[&str]) -> Result<(), String> {
    let output = Command::new("ip").args(arguments).output().map_err(|e| format!("no ip: {e}"))?;
    if output.status.success() {
        return Ok(());
    }
    let cause = String::from_utf8_lossy(&output.stderr).trim().to_owned();
    Err(format!("ip {}: {cause}", arguments.join(" ")))
}

/// Runs a program to its end, which must be a good one; gives what it printed.
pub fn run(program: &str, arguments: &[&str]) -> String {
    Peer::start(program, arguments).finish()
}

/// A program that runs beside the test; ended when dropped.
pub struct Peer {
    child: Child,
    what: String,
}

impl Peer {
    pub fn start(program: &str, arguments: &[&str]) -> Self {
        Self::start_with_input(program, arguments, "")
    }

    pub fn start_with_input(program: &str, arguments: &[&str], input: &str) -> Self {
        let what = format!("{program} {}", arguments.join(" "));
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{what}: {error}"));
        child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
        Self { child, what }
    }

    /// Waits for its good end; gives what it printed.
    pub fn finish(mut self) -> String {
        let mut text = String::new();
        self.child.stdout.take().unwrap().read_to_string(&mut text).unwrap();
        let status = self.child.wait().unwrap();
        assert!(status.success(), "{}: {status}", self.what);
        text
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits until the kernel has `count` subscriptions of `kind` (`raw`, `isotp`) on an interface:
/// then peers that were started are listening.
pub fn wait_for_listeners(interface: &str, kind: &str, count: usize) {
    wait_until(&format!("{count} {kind} listeners on {interface}"), || {
        listeners(interface, kind) >= count
    });
}

/// How many subscriptions of `kind` the kernel has on an interface.
pub fn listeners(interface: &str, kind: &str) -> usize {
    let lists = ["all", "fil", "inv", "sff", "eff"].map(|list| {
        std::fs::read_to_string(format!("/proc/net/can/rcvlist_{list}")).unwrap_or_default()
    });
    let is_one = |line: &&str| {
        let words: Vec<_> = line.split_whitespace().collect();
        words.first() == Some(&interface) && words.last() == Some(&kind)
    };
    lists.iter().flat_map(|list| list.lines()).filter(is_one).count()
}

/// Waits for what gives no sign when it happens.
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !condition() {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        thread::sleep(Duration::from_millis(2));
    }
}
