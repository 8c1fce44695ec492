//! A broker for tests: mosquitto on a port of loopback, in a folder of its own, ended with the value.

use std::fs;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longest time to start or to stop.
const PATIENCE: Duration = Duration::from_secs(20);

/// A running broker.
pub struct Mosquitto {
    folder: TempDir,
    port: u16,
    process: Option<Child>,
}

impl Mosquitto {
    /// Starts one that lets everyone in; `None` if mosquitto is missing and may be.
    pub fn start() -> Option<Self> {
        Self::with_settings(|_| "allow_anonymous true\n".to_owned())
    }

    /// Starts one with these lines of its configuration, made for its folder. Its state survives
    /// [`Self::stop`].
    pub fn with_settings(settings: impl FnOnce(&Path) -> String) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let path = folder.path();
        let lines = settings(path);
        let text = format!(
            "listener {port} 127.0.0.1\npersistence true\npersistence_location {}/\n\
             autosave_interval 0\nmax_queued_messages 100000\nuser root\n{lines}",
            path.display()
        );
        fs::write(path.join("mosquitto.conf"), text).unwrap();
        let mut broker = Self { folder, port, process: None };
        broker.launch().then_some(broker)
    }

    /// Folder of its files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Its port on loopback.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Its address, without TLS.
    pub fn url(&self) -> String {
        format!("mqtt://127.0.0.1:{}", self.port)
    }

    /// Publishes a retained message, by mosquitto's own program.
    pub fn publish(&self, topic: &str, payload: &[u8]) {
        let path = self.folder.path().join("payload");
        fs::write(&path, payload).unwrap();
        let output = Command::new("mosquitto_pub")
            .args(["-h", "127.0.0.1", "-p", &self.port.to_string(), "-r", "-q", "1", "-t", topic])
            .arg("-f")
            .arg(path)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    /// Publishes further messages that are not retained, one for each line.
    pub fn publish_lines(&self, topic: &str, lines: &str) {
        let path = self.folder.path().join("payload");
        fs::write(&path, lines).unwrap();
        let status = Command::new("mosquitto_pub")
            .args(["-h", "127.0.0.1", "-p", &self.port.to_string(), "-q", "1", "-t", topic, "-l"])
            .stdin(fs::File::open(path).unwrap())
            .status()
            .unwrap();
        assert!(status.success());
    }

    /// Stops it as a system does, which saves its state.
    pub fn stop(&mut self) {
        let Some(mut process) = self.process.take() else { return };
        let id = nix::unistd::Pid::from_raw(process.id().try_into().unwrap());
        nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGTERM).unwrap();
        process.wait().unwrap();
    }

    /// Kills it: what it knows is what [`Self::save`] wrote.
    pub fn kill(&mut self) {
        let Some(mut process) = self.process.take() else { return };
        process.kill().unwrap();
        process.wait().unwrap();
    }

    /// Makes it write its state, as it does twice an hour by default, and waits until it has.
    pub fn save(&mut self) {
        let state = self.folder.path().join("mosquitto.db");
        let _ = fs::remove_file(&state);
        let process = self.process.as_ref().unwrap();
        let id = nix::unistd::Pid::from_raw(process.id().try_into().unwrap());
        nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGUSR1).unwrap();
        let begin = Instant::now();
        // It writes another file, and renames it.
        while !state.exists() {
            assert!(begin.elapsed() < PATIENCE, "mosquitto does not write {}", state.display());
            std::thread::park_timeout(Duration::from_millis(10));
        }
    }

    /// Starts it, and waits until it listens. Returns false if it is missing and may be.
    pub fn launch(&mut self) -> bool {
        let log = fs::File::create(self.folder.path().join("log")).unwrap();
        let config: PathBuf = self.folder.path().join("mosquitto.conf");
        let started = Command::new("mosquitto")
            .arg("-c")
            .arg(config)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn();
        match started {
            Ok(process) => self.process = Some(process),
            Err(missing) => {
                assert!(std::env::var_os("CI").is_none(), "mosquitto: {missing}");
                eprintln!("skipped: mosquitto: {missing}");
                return false;
            }
        }
        let begin = Instant::now();
        while TcpStream::connect(("127.0.0.1", self.port)).is_err() {
            let log = || fs::read_to_string(self.folder.path().join("log")).unwrap_or_default();
            let ended = self.process.as_mut().and_then(|it| it.try_wait().unwrap());
            assert!(ended.is_none() && begin.elapsed() < PATIENCE, "mosquitto: {}", log());
            std::thread::park_timeout(Duration::from_millis(10));
        }
        true
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        if let Some(process) = &mut self.process {
            let _ = process.kill();
            let _ = process.wait();
        }
    }
}
