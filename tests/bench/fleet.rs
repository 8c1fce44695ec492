//! The screen of `descan fleet` with 200 gateways of 127 devices: time to take all documents and to make
//! the first screen, time from a key to the drawn screen, and resident memory. First with the documents in
//! memory; then the real binary in a pseudo-terminal at a mosquitto with TLS and rights, whose gateways are
//! connected: time from its start to the complete view, and from a key to its effect on the terminal.
//!
//! Times are of this machine. With `memory` or `broker` only the first or the second of both.

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/mosquitto.rs"]
mod mosquitto;

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/pty.rs"]
mod pty;

#[path = "../it/common/sites.rs"]
mod sites;

use descan::app::{FleetScreen, FleetScreenOptions};
use descan::fleet::Publication;
use descan::keymap::Key;
use descan::theme::Theme;
use descan::time::{Duration, Instant};
use mosquitto::GuardedBroker;
use pty::Pty;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use sites::Sites;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Instant as Clock;

const GATEWAYS: usize = 200;

fn main() {
    let is_asked = |part: &str| std::env::args().any(|it| it == part);
    if !is_asked("broker") {
        in_memory();
    }
    if !is_asked("memory") {
        at_a_broker();
    }
}

/// The real binary at a real broker, with and without changes: 200 gateways with one of two devices, bus
/// and status each second.
fn at_a_broker() {
    let names: Vec<String> = (0..GATEWAYS).map(sites::name).collect();
    let Some(broker) = GuardedBroker::start(&names) else { return };
    let begin = Clock::now();
    let mut sites = Sites::start(&broker, GATEWAYS);
    println!("all gateways are connected and have delivered: {:.0} ms", millis(begin));
    let url = broker.url();
    let arguments = ["fleet", "--broker", &url, "--ca", "ca.pem", "--credentials", "viewer.toml"];
    let complete = |screen: &vt100::Screen| {
        let text = screen.contents();
        text.contains("● 200 online") && text.contains("● 24,200 present")
    };
    let mut opened = Vec::new();
    for _ in 0..5 {
        let begin = Clock::now();
        let mut pty = Pty::start(&arguments, broker.folder(), (120, 40));
        pty.wait_until("complete view", complete);
        opened.push(millis(begin));
        pty.send("q");
        pty.wait();
    }
    opened.sort_by(f64::total_cmp);
    println!("start to complete view: median {:.0}, most {:.0} ms", opened[2], opened[4]);
    let mut pty = Pty::start(&arguments, broker.folder(), (120, 40));
    // As terminals do: while an answer is awaited, Esc waits for what may follow it.
    pty.answers = true;
    pty.wait_until("complete view", complete);
    pages(&mut pty, "nothing changes");
    let stop = Arc::new(AtomicBool::new(false));
    let is_stopped = Arc::clone(&stop);
    let load = thread::spawn(move || {
        let mut next = 0;
        while !is_stopped.load(Ordering::Relaxed) {
            sites.change((0..20).map(|gateway| (next + gateway) % GATEWAYS));
            next += 20;
            thread::park_timeout(std::time::Duration::from_millis(100));
        }
    });
    pages(&mut pty, "200 gateways change each second");
    stop.store(true, Ordering::Relaxed);
    load.join().expect("the gateways");
    let status = std::fs::read_to_string(format!("/proc/{}/status", pty.pid())).unwrap_or_default();
    let most = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or_default();
    println!("{most}");
    pty.send("q");
    pty.wait();
}

/// Prints the time from keys to their effect on the terminal.
fn pages(pty: &mut Pty, what: &str) {
    let mut took = Vec::new();
    let keys = [
        ("2", "SERVICE↓"),
        ("3", "PROBLEM↓"),
        ("1", "BUSES"),
        ("\r", "HEARTBEAT"),
        ("\x1b", "BUSES"),
    ];
    for (key, effect) in keys.repeat(60) {
        let begin = Clock::now();
        pty.send(key);
        pty.wait_until(effect, |screen| screen.contents().contains(effect));
        took.push(millis(begin));
        // As fast as a person types.
        pty.count_for(std::time::Duration::from_millis(35));
    }
    report(&format!("on the terminal, {what}"), &mut took);
}

/// The screen and its documents in this process.
fn in_memory() {
    let documents = messages(GATEWAYS);
    let bytes: usize = documents.iter().map(|(topic, payload)| topic.len() + payload.len()).sum();
    println!("{} documents, {} kB", documents.len(), bytes / 1000);
    let mut screen = FleetScreen::new(FleetScreenOptions::default());
    screen.handle_resize(120, 40);
    let mut terminal = Terminal::new(TestBackend::new(120, 40)).expect("a screen");
    let theme = Theme::built_in("dark").expect("a theme");
    let mut draw = |screen: &mut FleetScreen| {
        screen.prepare();
        terminal
            .draw(|frame| {
                descan::ui::draw_fleet(screen, &theme, frame);
            })
            .expect("a draw");
    };
    let begin = Clock::now();
    screen.handle_connected(Instant::ZERO);
    for (at, (topic, payload)) in documents.iter().enumerate() {
        screen.handle_message(Instant::ZERO, topic.as_bytes(), payload, true);
        if at % 1000 == 0 {
            draw(&mut screen);
        }
    }
    draw(&mut screen);
    println!("all documents, a draw for each 1000: {:.0} ms", millis(begin));
    keys(&mut screen, &mut draw, "moves", "Down Down PgDn PgUp End Home");
    keys(&mut screen, &mut draw, "pages, an opened gateway", "2 3 1 Enter 2 3 1 Esc");
    keys(&mut screen, &mut draw, "orders", "s s s S s s s");
    keys(&mut screen, &mut draw, "a filter", "/ s r v : a u g e r @ 2 . 1 Esc");
    keys(&mut screen, &mut draw, "a filter by UID", "/ u i d : g 1 7 d 9 Esc");
    let mut took = Vec::new();
    for round in 0..500 {
        let now = Instant::ZERO + Duration::from_millis(round * 33);
        for (topic, payload) in documents.iter().skip(round as usize * 37 % 20_000).take(30) {
            screen.handle_message(now, topic.as_bytes(), payload, false);
        }
        let begin = Clock::now();
        screen.handle_key(now, Key::parse("Down").expect("a key"));
        draw(&mut screen);
        took.push(millis(begin));
    }
    report("a key while 900 documents a second come", &mut took);
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let resident = status.lines().find(|line| line.starts_with("VmRSS")).unwrap_or_default();
    println!("{resident} with the documents themselves");
}

fn millis(begin: Clock) -> f64 {
    begin.elapsed().as_secs_f64() * 1000.0
}

fn keys(screen: &mut FleetScreen, draw: &mut impl FnMut(&mut FleetScreen), what: &str, keys: &str) {
    let mut took = Vec::new();
    for _ in 0..50 {
        for key in keys.split(' ') {
            let begin = Clock::now();
            screen.handle_key(Instant::ZERO, Key::parse(key).expect("a key"));
            draw(screen);
            took.push(millis(begin));
        }
    }
    report(what, &mut took);
}

fn report(what: &str, took: &mut [f64]) {
    took.sort_by(f64::total_cmp);
    let at = |share: f64| took[(share * (took.len() - 1) as f64) as usize];
    let (median, late, most) = (at(0.5), at(0.99), at(1.0));
    println!("key to drawn screen, {what}: median {median:.2}, p99 {late:.2}, most {most:.2} ms");
}

/// Topics and payloads of the first documents of so many gateways.
fn messages(gateways: usize) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for gateway in 0..gateways {
        let mut publication =
            Publication::new(sites::name(gateway).parse().expect("a name"), 1_795_763_731_000);
        publication.handle_connected(false);
        sites::update(&mut publication, gateway, 0);
        while let Some(message) = publication.poll_message() {
            publication.handle_delivered(&message.id);
            all.push((message.topic, message.payload.to_vec()));
        }
    }
    all
}
