//! Gateways with many devices each, as `publish` has them, and their connections to a broker.

use super::mosquitto::GuardedBroker;
use descan::fleet::{FleetDocument, Publication, TopicPath};
use descan::shell::broker::{BrokerAccess, BrokerPublisher, BrokerSettings};
use descan::time::{Duration, Instant};
use serde_json::{Value, json};
use std::time::{SystemTime, UNIX_EPOCH};

/// Devices of each gateway.
pub const DEVICES: usize = 127;

/// The name of a gateway.
pub fn name(gateway: usize) -> String {
    format!("g{gateway}")
}

/// The documents of a gateway in a round; a few change from one round to the next.
fn documents(gateway: usize, round: usize) -> impl Iterator<Item = FleetDocument> {
    let document = |path: TopicPath, value: Value| FleetDocument {
        path,
        value,
        counters: &[],
        counter_period: Duration::from_secs(30),
    };
    let can0 = || "can0".to_owned();
    let bus = json!({
        "name": "can0", "bitrate": 125_000, "state": "error-active", "load": 0.4, "frames": 9 + round,
    });
    let device = move |address: usize| {
        let presence = if address.is_multiple_of(20) { "lost" } else { "online" };
        let mode = if address == 1 + round % DEVICES { "INIT" } else { "WORK" };
        let service = |name: &str, version: &str| json!({"name": name, "version": version});
        let value = json!({
            "bus": "can0", "address": address, "name": format!("DEV{address}"),
            "uid": format!("G{gateway}D{address}"), "presence": presence, "mode": mode,
            "services_known": true, "services": [
                service("DES", "1.0"), service("CFG", "1.3"),
                service("AUGER", &format!("2.{}", (gateway + address) % 3)),
                service("MOTOR", "1.4"), service("JAM", "1.0"),
            ],
            "heartbeat": {"period_ms": 1000.5},
        });
        document(TopicPath::Device(can0(), address as u8), value)
    };
    let finding = move |number: usize| {
        let value = json!({
            "kind": "same-name-same-address", "confidence": "confirmed", "bus": "can0",
            "address": number, "addresses": [number], "text": "Two devices answer.",
            "remedy": "Switch one off.",
        });
        document(TopicPath::Finding(can0(), format!("c{number}")), value)
    };
    std::iter::once(document(TopicPath::Bus(can0()), bus))
        .chain((1..=DEVICES).map(device))
        .chain((0..gateway % 4).map(finding))
}

/// This time, in Unix seconds.
pub fn unix_time() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Gives a gateway its documents of a round, and its status.
pub fn update(publication: &mut Publication, gateway: usize, round: usize) {
    let now = Instant::ZERO + Duration::from_secs(round as u64);
    publication.handle_documents(now, 0.0, documents(gateway, round));
    let summary =
        json!({"descan": "0.1.0", "devices": {"present": 121, "lost": 6}, "round": round});
    publication.handle_status(unix_time(), summary);
}

/// Gateways that are connected to a broker.
pub struct Sites {
    publishers: Vec<BrokerPublisher>,
    round: usize,
}

impl Sites {
    /// Connects one gateway for each user of the broker but the viewer, and waits until it has all
    /// documents.
    pub fn start(broker: &GuardedBroker, gateways: usize) -> Self {
        let publishers: Vec<BrokerPublisher> = (0..gateways)
            .map(|gateway| {
                let name = name(gateway);
                let access = BrokerAccess {
                    address: broker.url().parse().unwrap(),
                    ca: Some(broker.folder().join("ca.pem")),
                    identity: None,
                    credentials: Some(broker.credentials(&name)),
                };
                let settings = BrokerSettings::read(&access).unwrap();
                let mut publication = Publication::new(name.parse().unwrap(), 1_795_763_731_000);
                update(&mut publication, gateway, 0);
                BrokerPublisher::spawn(&settings, publication).unwrap()
            })
            .collect();
        let sites = Self { publishers, round: 0 };
        sites.wait_delivered();
        sites
    }

    fn wait_delivered(&self) {
        let begin = std::time::Instant::now();
        for (gateway, publisher) in self.publishers.iter().enumerate() {
            while !publisher.update(|publication| publication.is_delivered()) {
                assert!(begin.elapsed().as_secs() < 120, "g{gateway} has not delivered");
                std::thread::park_timeout(std::time::Duration::from_millis(10));
            }
        }
    }

    /// The next round of each of these gateways: two devices, the bus and the status of each change.
    pub fn change(&mut self, gateways: impl IntoIterator<Item = usize>) {
        self.round += 1;
        for gateway in gateways {
            let round = self.round;
            self.publishers[gateway].update(|publication| update(publication, gateway, round));
        }
    }
}
