//! Bus outages: frames sent and messages reported during and after the outage.

use descan::app::{App, AppOptions, FileIndex, FileReading};
use descan::diagnostic::Diagnostic;
use descan::discovery::{Config, OwnAddress};
use descan::frame::{BusIndex, CanId, Frame, FrameKind};
use descan::keymap::Key;
use descan::sim::{DeviceSpec, Scenario, Sim, SimStation};
use descan::status::{BusState, BusStatus, Link};
use descan::time::{Duration, Instant};
use descan::wire::id::{Address, Header};

const CAN0: BusIndex = BusIndex(0);

/// The app on a simulated bus with two devices, and all frames that it sent.
struct Stage {
    app: App,
    sim: Sim,
    station: SimStation,
    status: BusStatus,
    sent: Vec<Frame>,
    /// Frames that the driver reported as sent but still holds, because the adapter rejects them.
    queue: Option<Vec<Frame>>,
}

impl Stage {
    /// Starts the app and waits until discovery has found both devices.
    fn settled() -> Self {
        let scenario = Scenario::new(250_000)
            .with(DeviceSpec::new("FEED").fixed(12).skips_address_resolution())
            .with(DeviceSpec::new("SENS").fixed(13).skips_address_resolution());
        let mut sim = Sim::new(&scenario, 1);
        let station = sim.attach();
        let options = AppOptions {
            buses: vec![("can0".to_owned(), Config::default())],
            file_path: Some("des.json".into()),
            ..AppOptions::default()
        };
        let app = App::new(Instant::ZERO, options);
        let status = BusStatus {
            link: Link::Up,
            state: BusState::ErrorActive,
            bitrate: Some(250_000),
            ..BusStatus::default()
        };
        let mut stage = Self { app, sim, station, status, sent: Vec::new(), queue: None };
        stage.becomes(|_| {});
        stage.run(8.0);
        assert!(stage.app.buses()[0].progress().is_complete);
        stage.sent.clear();
        stage
    }

    /// Runs for so many seconds.
    fn run(&mut self, seconds: f64) {
        let end = self.app.now() + Duration::from_secs_f64(seconds);
        while self.app.now() < end {
            let now = self.app.now() + Duration::from_millis(1);
            self.sim.advance(now);
            while let Some(frame) = self.sim.poll_frame(self.station) {
                self.app.handle_frames(now, &[frame]);
            }
            self.app.handle_timeout(now);
            self.app.renew_rows();
            while let Some(frame) = self.app.poll_transmit(now) {
                self.sent.push(frame.with_time(now));
                if let Some(queue) = &mut self.queue {
                    queue.push(frame);
                    self.app.handle_frames(now, &[frame.with_time(now).with_tx()]);
                } else {
                    self.sim.transmit(self.station, frame);
                }
            }
        }
    }

    /// Stops the app for so many seconds; frames received meanwhile are not read yet.
    fn hold_up(&mut self, seconds: u64) -> Instant {
        let since = self.app.now();
        let now = since + Duration::from_secs(seconds);
        self.sim.advance(now);
        self.app.handle_stall(since, now);
        now
    }

    /// Makes the adapter accept frames again, and sends all queued ones at once.
    fn empty_queue(&mut self) {
        for frame in self.queue.take().into_iter().flatten() {
            self.sim.forward(self.station, frame);
            let told = self.sim.poll_frame(self.station).filter(|frame| frame.is_tx);
            assert!(told.is_some(), "it was told before");
        }
    }

    /// Changes the status that the adapter reports.
    fn becomes(&mut self, change: impl FnOnce(&mut BusStatus)) {
        change(&mut self.status);
        let hears = self.status.link == Link::Up && self.status.state != BusState::BusOff;
        self.sim.set_link(self.station, hears);
        self.app.handle_bus(self.app.now(), CAN0, self.status.clone());
    }

    fn own_address(&self) -> OwnAddress {
        self.app.buses()[0].own_address()
    }

    /// Returns true if a broadcast name request was sent.
    fn has_asked_everybody(&self) -> bool {
        let asks = |frame: &Frame| {
            let header = frame.platform_id().map(Header::decode);
            header.is_some_and(|header| header.broadcast && !header.response)
                && frame.data().ends_with(b"DES\x01")
        };
        self.sent.iter().any(asks)
    }

    fn is_told(&self, text: &str) -> bool {
        self.app.timeline().entries().any(|line| line.text.starts_with(text))
    }

    /// Asserts that descan listens before it claims its address again, and sends a broadcast at
    /// once, not when the next round is due.
    fn begins_anew(&mut self) {
        assert_eq!(self.own_address(), OwnAddress::Listening);
        let back = self.app.now();
        self.run(4.0);
        assert_eq!(self.own_address(), OwnAddress::Held(Address::DEBUG));
        assert!(self.has_asked_everybody(), "{:?}", self.sent);
        let first = self.sent[0].time;
        assert!(first.since(back) > Duration::from_millis(500), "{first} is too soon after {back}");
        let here = self.app.buses()[0].devices().iter().filter(|it| it.is_present()).count();
        assert_eq!(here, 2);
    }
}

#[test]
fn bus_off_restarts_discovery() {
    let mut stage = Stage::settled();
    stage.becomes(|status| (status.state, status.bus_offs) = (BusState::BusOff, 1));
    stage.run(15.0);
    assert_eq!(stage.sent, [], "nothing can be sent");
    assert!(stage.is_told("bus-off"));
    stage.becomes(|status| status.state = BusState::ErrorActive);
    stage.begins_anew();
    assert!(stage.is_told("error-active"));
    assert!(!stage.is_told("was briefly bus-off"));
}

#[test]
fn bus_off_reported_after_its_end_restarts_discovery() {
    let mut stage = Stage::settled();
    stage.becomes(|status| status.bus_offs += 1);
    stage.begins_anew();
    assert!(stage.is_told("was briefly bus-off"));
}

#[test]
fn bus_down_or_unplugged_restarts_discovery() {
    for (link, told) in [(Link::Down, "can0 is away"), (Link::Unplugged, "can0 is away")] {
        let mut stage = Stage::settled();
        stage.becomes(|status| {
            (status.link, status.state) = (link, BusState::Down);
            status.fault = Some(Diagnostic::new("can0 is away"));
        });
        stage.run(15.0);
        assert_eq!(stage.sent, [], "nothing can be sent");
        assert!(stage.is_told(told));
        stage.becomes(|status| {
            (status.link, status.state) = (Link::Up, BusState::ErrorActive);
            (status.fault, status.outages) = (None, 1);
        });
        stage.begins_anew();
        assert!(stage.is_told("open") && !stage.is_told("was briefly down"));
    }
}

#[test]
fn outage_reported_after_its_end_restarts_discovery() {
    let mut stage = Stage::settled();
    stage.becomes(|status| status.outages += 1);
    stage.begins_anew();
    assert!(stage.is_told("was briefly down"));
}

#[test]
fn outage_reported_late_counts_no_missed_heartbeats() {
    let mut stage = Stage::settled();
    stage.becomes(|status| (status.link, status.state) = (Link::Down, BusState::Down));
    stage.run(4.0);
    // Frames are received at once; an adapter polled each second reports its state later.
    stage.sim.set_link(stage.station, true);
    stage.run(1.5);
    stage.becomes(|status| (status.link, status.state) = (Link::Up, BusState::ErrorActive));
    stage.begins_anew();
    for device in stage.app.buses()[0].devices() {
        assert_eq!(device.heartbeat.missed, 0, "{:?}", device.name);
        assert!(device.is_present() && device.heartbeat.count > 10);
    }
}

#[test]
fn second_outage_loses_no_device() {
    let mut stage = Stage::settled();
    stage.becomes(|status| (status.state, status.bus_offs) = (BusState::BusOff, 1));
    stage.run(3.0);
    stage.sim.set_link(stage.station, true);
    stage.run(1.5);
    stage.becomes(|status| status.bus_offs = 2);
    stage.run(20.0);
    stage.becomes(|status| (status.link, status.state) = (Link::Down, BusState::Down));
    stage.run(20.0);
    stage.becomes(|status| (status.link, status.state) = (Link::Up, BusState::ErrorActive));
    stage.begins_anew();
    for device in stage.app.buses()[0].devices() {
        assert_eq!(device.heartbeat.missed, 0, "{:?}", device.name);
    }
    assert!(!stage.is_told("lost") && !stage.is_told("stale"));
}

#[test]
fn other_status_changes_do_not_restart_discovery() {
    let mut stage = Stage::settled();
    let before = stage.own_address();
    stage.becomes(|status| status.state = BusState::ErrorWarning);
    stage.becomes(|status| status.renamed = Some("front".to_owned()));
    assert!(stage.is_told("interface renamed to front"));
    stage.becomes(|status| status.renamed = None);
    assert!(stage.is_told("interface has its old name again"));
    stage.becomes(|status| status.note = Some("worth knowing".to_owned()));
    assert!(stage.is_told("worth knowing"));
    assert_eq!(stage.own_address(), before);
    for (what, told) in [
        (0, "frames lost: the kernel's receive buffer was full"),
        (1, "frames lost: descan's receive queue was full"),
        (2, "frames lost: controller overrun"),
    ] {
        assert!(!stage.is_told(told));
        stage.becomes(|status| {
            let counters = [
                &mut status.kernel_drops,
                &mut status.queue_drops,
                &mut status.controller_overruns,
            ];
            *counters.into_iter().nth(what).unwrap() += 3;
        });
        assert!(stage.is_told(told));
    }
    assert_eq!(stage.app.buses()[0].lost(), 9);
}

/// Tests a stop and resume, as by Ctrl-Z and fg: all frames received meanwhile are read at once.
#[test]
fn stall_does_not_change_presence() {
    let mut stage = Stage::settled();
    let counted = |stage: &Stage| stage.app.buses()[0].counters();
    let before = counted(&stage);
    let now = stage.hold_up(7);
    let mut count = 0;
    while let Some(frame) = stage.sim.poll_frame(stage.station) {
        stage.app.handle_frames(now, &[frame.with_time(now + Duration::from_micros(count))]);
        count += 1;
    }
    assert!(count > 10, "{count}");
    let mut error = Frame::new(CanId::Extended(0x88), &[0; 8]).with_time(now);
    error.kind = FrameKind::Error;
    let standard = Frame::new(CanId::Standard(5), &[]).with_time(now);
    stage.app.handle_frames(now, &[error, standard]);
    let after = counted(&stage);
    assert_eq!(after.frames - before.frames, count + 2, "each of them is counted");
    assert_eq!((after.errors, after.non_platform), (before.errors + 1, before.non_platform + 1));
    stage.run(0.3);
    stage.begins_anew();
    stage.run(20.0);
    assert!(stage.is_told("stopped for 7.0 s"));
    for word in ["suspected", "confirmed", "lost", "silent", "stale", "returned", "rebooted"] {
        assert!(!stage.is_told(word), "{word}");
    }
    for device in stage.app.buses()[0].devices() {
        assert_eq!(device.heartbeat.missed, 0, "{:?}", device.name);
        assert!(device.is_present());
    }
}

#[test]
fn bus_down_during_queued_frames_is_down() {
    let mut stage = Stage::settled();
    stage.hold_up(7);
    while stage.sim.poll_frame(stage.station).is_some() {}
    stage.becomes(|status| (status.link, status.state) = (Link::Down, BusState::Down));
    stage.run(20.0);
    assert_eq!(stage.sent, [], "nothing can be sent");
    stage.becomes(|status| (status.link, status.state) = (Link::Up, BusState::ErrorActive));
    stage.begins_anew();
    assert!(!stage.is_told("lost") && !stage.is_told("stale"));
}

#[test]
fn requests_delayed_in_full_queue_raise_no_finding() {
    for seconds in [3, 8] {
        let mut stage = Stage::settled();
        stage.queue = Some(Vec::new());
        for _ in 0..seconds {
            stage.app.handle_key(stage.app.now(), Key::parse("r").unwrap());
            stage.run(1.0);
            stage.becomes(|status| status.is_transmit_queue_full = true);
        }
        stage.empty_queue();
        stage.becomes(|status| status.is_transmit_queue_full = false);
        stage.run(20.0);
        for word in ["suspected", "confirmed", "lost", "returned", "rebooted"] {
            assert!(!stage.is_told(word), "{word} after {seconds} s");
        }
    }
}

#[test]
fn bus_that_is_opened_again_restarts_discovery() {
    let mut stage = Stage::settled();
    stage.becomes(|status| status.link = Link::Unplugged);
    stage.run(3.0);
    stage.becomes(|status| status.link = Link::Opening);
    stage.run(1.0);
    stage.becomes(|status| status.link = Link::Up);
    stage.begins_anew();
}

/// The controller reports bus-off by an error frame, and its port no state.
#[test]
fn error_frame_of_bus_off_restarts_nothing_at_the_next_status() {
    let mut stage = Stage::settled();
    let now = stage.app.now();
    let mut bus_off = Frame::classic(0x40, &[0; 8]).with_time(now);
    bus_off.id = CanId::Extended(0x40);
    bus_off.kind = FrameKind::Error;
    stage.app.handle_frames(now, &[bus_off]);
    stage.becomes(|status| status.kernel_drops = 1);
    assert_eq!(stage.own_address(), OwnAddress::Held(Address::DEBUG));
    stage.run(2.0);
    assert!(!stage.has_asked_everybody(), "{:?}", stage.sent);
}

/// A time limit that had passed before would be taken for a program that was stopped.
#[test]
fn file_that_appears_late_makes_nothing_overdue() {
    let mut stage = Stage::settled();
    stage.run(5.0);
    let now = stage.app.now();
    let content = FileReading::Content(Some(r#"[{"name": "PUMP", "address": 40}]"#.into()));
    stage.app.handle_file(now, FileIndex::default(), content);
    assert!(
        stage.app.poll_timeout().is_some_and(|due| due >= now),
        "{:?}",
        stage.app.poll_timeout()
    );
}
