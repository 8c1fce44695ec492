//! The screen of `descan fleet` with 200 gateways of 127 devices: time to take all documents and to make
//! the first screen, time from a key to the drawn screen, and resident memory.
//!
//! Times are of this machine.

use descan::app::{FleetScreen, FleetScreenOptions};
use descan::keymap::Key;
use descan::theme::Theme;
use descan::time::{Duration, Instant};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use std::time::Instant as Clock;

const GATEWAYS: usize = 200;
const DEVICES: usize = 127;

fn main() {
    let documents = documents();
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
    screen.handle_connected(Instant::ZERO, false);
    for (at, (topic, payload)) in documents.iter().enumerate() {
        screen.handle_message(Instant::ZERO, topic.as_bytes(), payload.as_bytes(), true);
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
            screen.handle_message(now, topic.as_bytes(), payload.as_bytes(), false);
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

fn documents() -> Vec<(String, String)> {
    let mut all = Vec::new();
    for gateway in 0..GATEWAYS {
        let root = format!("descan/v1/g{gateway}");
        let status =
            r#"{"online":true,"started_ms":1795763731000,"descan":"0.1.0","events":{"last":9}}"#;
        all.push((format!("{root}/status"), status.to_owned()));
        let bus =
            r#"{"name":"can0","bitrate":125000,"state":"error-active","load":0.4,"frames":9}"#;
        all.push((format!("{root}/bus/can0"), bus.to_owned()));
        for device in 1..=DEVICES {
            let version = (gateway + device) % 3;
            let presence = if device % 20 == 0 { "lost" } else { "online" };
            let document = format!(
                r#"{{"bus":"can0","address":{device},"name":"DEV{device}","uid":"G{gateway}D{device}",
                "presence":"{presence}","mode":"WORK","services_known":true,"services":[
                {{"name":"DES","version":"1.0"}},{{"name":"CFG","version":"1.3"}},
                {{"name":"AUGER","version":"2.{version}"}},{{"name":"MOTOR","version":"1.4"}},
                {{"name":"JAM","version":"1.0"}}],"heartbeat":{{"period_ms":1000.5}}}}"#
            );
            all.push((format!("{root}/device/can0/{device}"), document));
        }
        for finding in 0..gateway % 4 {
            let document = format!(
                r#"{{"kind":"same-name-same-address","confidence":"confirmed","bus":"can0",
                "address":{finding},"addresses":[{finding}],"text":"Two devices answer.","remedy":"Switch one off."}}"#
            );
            all.push((format!("{root}/finding/can0/c{finding}"), document));
        }
    }
    all
}
