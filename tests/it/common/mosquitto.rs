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

/// Runs openssl in a folder.
pub fn openssl(folder: &Path, arguments: &str) {
    let output = Command::new("openssl")
        .args(arguments.split(' '))
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// A certificate authority, another one, a certificate of the broker, and one of a client, by openssl.
pub fn make_certificates(folder: &Path) {
    fs::write(folder.join("names"), "subjectAltName=DNS:localhost,IP:127.0.0.1").unwrap();
    for authority in ["ca", "other"] {
        let key = "-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes";
        let files = format!("-keyout {authority}.key -out {authority}.pem");
        openssl(folder, &format!("req -x509 {key} -days 2 -subj /CN={authority} {files}"));
    }
    for name in ["broker", "client"] {
        let key = "-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes";
        openssl(folder, &format!("req {key} -subj /CN={name} -keyout {name}.key -out {name}.req"));
        let signed = "-CA ca.pem -CAkey ca.key -CAcreateserial -days 2 -extfile names";
        openssl(folder, &format!("x509 -req -in {name}.req {signed} -out {name}.pem"));
    }
}

/// A broker with TLS, users and rights, as the guide has them: each user writes the topics of the gateway
/// with its name, and `viewer` reads all.
pub struct GuardedBroker(Mosquitto);

impl GuardedBroker {
    /// Starts it; `None` if mosquitto is missing and may be.
    pub fn start(gateways: &[String]) -> Option<Self> {
        let settings = |folder: &Path| {
            make_certificates(folder);
            let path = |name: &str| folder.join(name).display().to_string();
            let users: Vec<&str> = gateways.iter().map(String::as_str).chain(["viewer"]).collect();
            let line = |user: &&str| format!("{user}:secret of {user}\n");
            let passwords: String = users.iter().map(line).collect();
            fs::write(path("passwords"), passwords).unwrap();
            for user in users {
                let credentials = format!("user = \"{user}\"\npassword = \"secret of {user}\"\n");
                fs::write(folder.join(format!("{user}.toml")), credentials).unwrap();
            }
            let hashed = Command::new("mosquitto_passwd").args(["-U", &path("passwords")]).output();
            // Missing with mosquitto.
            let Ok(hashed) = hashed else { return String::new() };
            assert!(hashed.status.success(), "{}", String::from_utf8_lossy(&hashed.stderr));
            let rights = "pattern readwrite descan/v1/%u/#\n\nuser viewer\n\
                          topic read descan/v1/#\ntopic deny descan/v1/viewer/#\n";
            fs::write(folder.join("rights"), rights).unwrap();
            format!(
                "allow_anonymous false\npassword_file {}\nacl_file {}\ncafile {}\ncertfile {}\n\
                 keyfile {}\n",
                path("passwords"),
                path("rights"),
                path("ca.pem"),
                path("broker.pem"),
                path("broker.key"),
            )
        };
        Mosquitto::with_settings(settings).map(Self)
    }

    /// Its address, with TLS.
    pub fn url(&self) -> String {
        format!("mqtts://localhost:{}", self.0.port)
    }

    /// Folder of its files; `ca.pem` is to be trusted.
    pub fn folder(&self) -> &Path {
        self.0.folder()
    }

    /// The file with name and password of a user.
    pub fn credentials(&self, user: &str) -> PathBuf {
        self.folder().join(format!("{user}.toml"))
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
