//! What can be opened, as it changes: interfaces that are up are listened to.
//!
//! A thread looks once a second, and counts the frames of each interface that is up. It sends nothing
//! and changes no setting. Bounded: 16 interfaces are listened to. Does not know how the list is shown.

use super::bus_offers::{of_interface, others};
use super::recent_logs::LogLengths;
use crate::app::BusOffer;
use crate::bus::{self, BusSpec, CanInterface, Clock, Options, Port};
use crate::discovery::{Config, Engine};
use crate::frame::{BusIndex, Frame, FrameKind};
use crate::wire::profile::Profile;
use std::collections::BTreeMap;
use std::future::pending;
use std::io;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant as Monotonic};
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Time between two looks.
const PERIOD: Duration = Duration::from_secs(1);
/// Time between two reads of the frames: less than the receive queue takes of a full bus.
const STEP: Duration = Duration::from_millis(100);
/// Most interfaces that are listened to.
const MAX_LISTENED: usize = 16;
/// Names of devices in a line; the others are counted.
const NAMED: usize = 4;

/// The looks of a thread, which ends when this is dropped.
#[derive(Debug)]
pub struct BusScout {
    offers: Receiver<Vec<BusOffer>>,
}

impl BusScout {
    /// Starts to look. Interfaces in `open` are not listened to.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn spawn(profile: Arc<Profile>, open: Vec<String>) -> io::Result<Self> {
        let (to, offers) = channel(1);
        let look = move || look(profile, &open, &to);
        thread::Builder::new().name("buses".into()).spawn(look)?;
        Ok(Self { offers })
    }

    /// Waits for the next look. May be dropped while waiting.
    pub async fn next(&mut self) -> Vec<BusOffer> {
        match self.offers.recv().await {
            Some(offers) => offers,
            // The thread ended, which is a bug: the list stays as it is.
            None => pending().await,
        }
    }
}

fn look(profile: Arc<Profile>, open: &[String], to: &Sender<Vec<BusOffer>>) {
    let config = Config { listen_only: true, profile, ..Config::default() };
    let clock = Clock::start();
    let mut heard: BTreeMap<String, Listener> = BTreeMap::new();
    let mut lengths = LogLengths::default();
    while !to.is_closed() {
        let interfaces = bus::interfaces();
        let is_up = |name: &String| interfaces.iter().any(|it| it.up && it.name == *name);
        heard.retain(|name, _| is_up(name));
        for interface in interfaces.iter().filter(|it| it.up && !open.contains(&it.name)) {
            if heard.len() < MAX_LISTENED && !heard.contains_key(&interface.name) {
                let listener = Listener::open(interface, clock.clone(), config.clone());
                heard.extend(listener.map(|it| (interface.name.clone(), it)));
            }
        }
        let offers = interfaces.iter().map(|interface| {
            let facts = heard.get(&interface.name).map(Listener::facts);
            of_interface(interface, facts.as_deref().unwrap_or_default())
        });
        let mut offers: Vec<BusOffer> = offers.collect();
        offers.extend(others(&mut lengths));
        if to.blocking_send(offers).is_err() {
            return;
        }
        heard.values_mut().for_each(Listener::begin);
        let until = Monotonic::now() + PERIOD;
        while Monotonic::now() < until && !to.is_closed() {
            thread::sleep(STEP);
            for listener in heard.values_mut() {
                listener.read(&clock);
            }
        }
        heard.values_mut().for_each(Listener::end);
    }
}

/// An interface that is listened to, and what was received.
struct Listener {
    port: Port,
    engine: Engine,
    batch: Vec<Frame>,
    frames: u64,
    errors: u64,
    /// Frames and error frames of the last second; `None` in the first one.
    last: Option<(u64, u64)>,
}

impl Listener {
    fn open(interface: &CanInterface, clock: Clock, config: Config) -> Option<Self> {
        let spec = BusSpec::SocketCan(interface.name.clone());
        Self::of(&spec, clock, config)
    }

    fn of(spec: &BusSpec, clock: Clock, config: Config) -> Option<Self> {
        let engine = Engine::new(clock.now(), config);
        let options = Options { listen_only: true, ..Options::default() };
        let port = bus::open(spec, BusIndex(0), clock, options).ok()?;
        Some(Self { port, engine, batch: Vec::new(), frames: 0, errors: 0, last: None })
    }

    fn begin(&mut self) {
        (self.frames, self.errors) = (0, 0);
    }

    fn end(&mut self) {
        self.last = Some((self.frames, self.errors));
    }

    fn read(&mut self, clock: &Clock) {
        self.batch.clear();
        self.port.queue().drain(&mut self.batch, usize::MAX);
        for frame in &self.batch {
            let is_error = frame.kind == FrameKind::Error;
            self.errors += u64::from(is_error);
            self.frames += u64::from(!is_error);
            self.engine.handle_frame(frame);
        }
        let now = clock.now();
        if self.engine.poll_timeout().is_some_and(|due| due <= now) {
            self.engine.handle_timeout(now);
        }
        // Nothing reads them.
        while self.engine.poll_event().is_some() {}
    }

    /// What was received: `412 f/s  FEED SENS @12 +6`.
    fn facts(&self) -> String {
        let devices = self.engine.devices().iter().filter(|device| device.is_present());
        let names: Vec<String> = devices
            .map(|device| match &device.name {
                Some(name) => name.to_string(),
                None => format!("@{}", device.address),
            })
            .collect();
        heard_text(self.last, &names)
    }
}

fn heard_text(last: Option<(u64, u64)>, names: &[String]) -> String {
    let rate = match last {
        None => return "listening…".to_owned(),
        Some((0, 0)) => "quiet".to_owned(),
        Some((0, _)) => "only bus errors: wrong bit rate?".to_owned(),
        Some((frames, _)) => format!("{frames} f/s"),
    };
    let more = names.len().saturating_sub(NAMED);
    let more = if more > 0 { format!(" +{more}") } else { String::new() };
    let names = names.iter().take(NAMED).map(String::as_str).collect::<Vec<_>>().join(" ");
    format!("{rate}  {names}{more}").trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heard_devices_are_named_and_counted() {
        let names = ["FEED", "@12", "ACT", "DISP", "PSU", "DIN"].map(str::to_owned);
        assert_eq!(heard_text(Some((412, 0)), &names), "412 f/s  FEED @12 ACT DISP +2");
        assert_eq!(heard_text(Some((3, 9)), &[]), "3 f/s");
        assert_eq!(heard_text(Some((0, 9)), &[]), "only bus errors: wrong bit rate?");
        assert_eq!(heard_text(Some((0, 0)), &[]), "quiet");
        assert_eq!(heard_text(None, &names), "listening…");
    }

    #[test]
    fn devices_are_heard_without_sending() {
        let clock = Clock::start();
        let config = Config { listen_only: true, ..Config::default() };
        let spec = BusSpec::Sim("boiler".to_owned());
        let mut listener = Listener::of(&spec, clock.clone(), config).unwrap();
        let deadline = Monotonic::now() + Duration::from_mins(1);
        while !listener.facts().contains('@') {
            assert!(Monotonic::now() < deadline, "{}", listener.facts());
            thread::sleep(STEP);
            listener.read(&clock);
            listener.end();
        }
        assert_eq!(listener.engine.counters().sent, 0);
    }
}
