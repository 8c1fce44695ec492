//! Helpers of the tests on a real CAN kernel: virtual interfaces, peers from can-utils, and waits
//! for conditions.
//!
//! Each test creates its own interfaces, which needs root and the vcan module. Without them a test
//! prints the reason and passes. The virtual machine of tests/vm has both.

use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Timeout of every wait; long enough for an emulated machine.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// A virtual CAN interface, up, with FD; removed when dropped.
pub struct Vcan {
    name: String,
}

impl Vcan {
    /// Creates the interface. Where that is not possible, prints the reason and returns `None`.
    pub fn new(name: &str) -> Option<Self> {
        let vcan = Self { name: name.to_owned() };
        // A killed test may have left one behind.
        let _ = ip(&["link", "del", name]);
        match vcan.create() {
            Ok(()) => Some(vcan),
            Err(reason) => {
                skip(&reason);
                None
            }
        }
    }

    /// Reserves the name of an interface that does not exist yet; it is removed when dropped.
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

    /// Creates the interface with this index.
    pub fn create_with_index(&self, index: u32) {
        let index = index.to_string();
        let created = ip(&["link", "add", &self.name, "index", &index, "type", "vcan"]);
        created.expect("the index is free");
        ip(&["link", "set", &self.name, "up", "mtu", "72"]).expect("the interface is there");
    }

    pub fn remove(&self) {
        ip(&["link", "del", &self.name]).expect("the interface was there");
    }

    /// Renames the interface, which must be down.
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

/// Returns the two wired controllers of the virtual machine, can0 and can1, for one test at a time.
/// `None` elsewhere: tests never send on a real bus.
pub fn controllers() -> Option<MutexGuard<'static, ()>> {
    static TAKEN: Mutex<()> = Mutex::new(());
    if std::env::var_os("DESCAN_VM").is_none() {
        skip("only in the virtual machine of tests/vm are can0 and can1 ours");
        return None;
    }
    Some(TAKEN.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Prints why a test did not run. In the virtual machine it must run.
pub fn skip(reason: &str) {
    assert!(std::env::var_os("DESCAN_VM").is_none(), "cannot run in the VM: {reason}");
    // Not by println: the test harness would capture it.
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

/// Runs a program to its end, expects success, and returns its output.
pub fn run(program: &str, arguments: &[&str]) -> String {
    Peer::start(program, arguments).finish()
}

/// A program that runs beside the test; killed when dropped.
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

    /// Waits for the exit, expects success, and returns the output.
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
/// from then on the started peers receive frames.
pub fn wait_for_listeners(interface: &str, kind: &str, count: usize) {
    wait_until(&format!("{count} {kind} listeners on {interface}"), || {
        listeners(interface, kind) >= count
    });
}

/// Returns the number of subscriptions of `kind` that the kernel has on an interface.
pub fn listeners(interface: &str, kind: &str) -> usize {
    let lists = ["all", "fil", "inv", "sff", "eff"];
    lists.iter().map(|list| subscriptions(list, interface, kind)).sum()
}

/// Starts candump with two receive filters, standard and extended frames, and waits until it
/// receives. A list of buses that another test has open also listens on the interface, but without
/// filters: only those of candump are counted.
pub fn start_candump(interface: &str, arguments: &[&str]) -> Peer {
    let filters = format!("{interface},0:80000000,80000000:80000000");
    let candump = Peer::start("candump", &[arguments, &[&filters]].concat());
    wait_until(&format!("candump on {interface}"), || subscriptions("fil", interface, "raw") == 2);
    candump
}

/// Returns the number of subscriptions of `kind` in one of the kernel's receive lists.
fn subscriptions(list: &str, interface: &str, kind: &str) -> usize {
    let text = std::fs::read_to_string(format!("/proc/net/can/rcvlist_{list}"));
    let is_one = |line: &&str| {
        let words: Vec<_> = line.split_whitespace().collect();
        words.first() == Some(&interface) && words.last() == Some(&kind)
    };
    text.unwrap_or_default().lines().filter(is_one).count()
}

/// Polls for a condition that produces no event.
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !condition() {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        thread::sleep(Duration::from_millis(2));
    }
}
