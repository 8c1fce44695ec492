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

    /// Stops it as a system does, which saves its state.
    pub fn stop(&mut self) {
        let Some(mut process) = self.process.take() else { return };
        let id = nix::unistd::Pid::from_raw(process.id().try_into().unwrap());
        nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGTERM).unwrap();
        process.wait().unwrap();
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
