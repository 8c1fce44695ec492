//! The filter language: an input is a line.

use super::Target;
use descan::app::{App, AppOptions, Completion, CompletionSource, Filter, RowKind};
use descan::discovery::Config;
use descan::frame::{CanId, Frame};
use descan::time::Instant;

/// Target `filter`.
pub const FILTER: Target = Target {
    name: "filter",
    check: |input| {
        let Ok(line) = str::from_utf8(input) else { return };
        thread_local! {
            static HEARD: (App, Vec<Frame>) = heard();
        }
        let source = CompletionSource {
            names: vec!["FEED".to_owned(), "a \"b,c".to_owned()],
            addresses: vec![0, 127],
            ..CompletionSource::default()
        };
        for rows in [RowKind::Device, RowKind::Frame, RowKind::Event, RowKind::Problem] {
            let completion = Completion::of(line, rows, &source);
            assert!(line.get(completion.range).is_some(), "{line:?}");
            let filter = match Filter::parse(line, rows) {
                Ok(filter) => filter,
                Err(error) => {
                    assert!(line.get(error.range()).is_some(), "{line:?}: {:?}", error.range());
                    assert!((1..=line.chars().count() + 1).contains(&error.column(line)));
                    assert!(!error.text().is_empty());
                    continue;
                }
            };
            if rows != RowKind::Frame || filter.is_empty() {
                continue;
            }
            // Neither parentheses nor a second negation change what is selected.
            let selected = HEARD.with(|(app, frames)| select(app, frames, &filter));
            for (changed, is_opposite) in [
                (format!("({line})"), false),
                (format!("({line}) or ({line})"), false),
                (format!("({line}) ({line})"), false),
                (format!("not not ({line})"), false),
                (format!("!({line})"), true),
            ] {
                // It may nest too deep.
                let Ok(other) = Filter::parse(&changed, rows) else { continue };
                let other = HEARD.with(|(app, frames)| select(app, frames, &other));
                let expected: Vec<bool> = selected.iter().map(|it| it ^ is_opposite).collect();
                assert_eq!(other, expected, "{changed:?}");
            }
        }
    },
    words: &[
        b"src:FEED ",
        b"at:12,14 ",
        b"at:10..20 ",
        b"type:rsp ",
        b"srv:0x100..0x1FF ",
        b"data:\"01 ?? 0F\" ",
        b"data:^4? ",
        b"dt:>50ms ",
        b"len:<=8 ",
        b"id:07?1 ",
        b"since:-2m ",
        b"until:2026-11-24T13:51 ",
        b"uid:= ",
        b"mode:work,idle ",
        b"is:error ",
        b"kind:uid ",
        b" or ",
        b" and ",
        b"not ",
        b"!",
        b"(",
        b")",
        b"\"",
        b",",
        b"=",
        b"..",
        "ж".as_bytes(),
        "\u{202E}".as_bytes(),
    ],
};

/// An App with some frames, and these frames.
fn heard() -> (App, Vec<Frame>) {
    let config = Config { listen_only: true, bitrate: Some(125_000), ..Config::default() };
    let options = AppOptions { buses: vec![("can0".to_owned(), config)], ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    let frames = [
        Frame::classic(0x0718_E501, &[0x8A, 0xFA, 0x6C, 0x97, 0x24, 0x13, 4, 0]),
        Frame::classic(0x0000_3802, &[4, b'D', b'E', b'S', 1]).with_tx(),
        Frame::classic(0x051C_0002, &[5, 1, b'A', b'C', b'T', 0]),
        Frame::classic(0x051C_0002, &[0x10, 0x12, 2, 0, b'D', b'E', b'S', 0]),
        Frame::classic(0x051C_0002, &[0x21, b'1', b'.', b'0', 0, 1, b'P', b'U']),
        Frame::new(CanId::Standard(0x123), &[1, 2]),
        Frame::remote(CanId::Extended(0x123), 4),
        Frame::error(0x8, &[0, 0, 4, 0, 0, 0, 0, 0]),
    ];
    let dated =
        |(millis, frame): (u64, Frame)| frame.with_time(Instant::from_micros(millis * 1000));
    let frames: Vec<Frame> = (1..).zip(frames).map(dated).collect();
    app.handle_frames(Instant::from_micros(10_000), &frames);
    (app, frames)
}

fn select(app: &App, frames: &[Frame], filter: &Filter) -> Vec<bool> {
    let matcher = filter.for_frames(app.history());
    let numbered = (0..).zip(frames);
    numbered.map(|(number, frame)| matcher.is_match(frame, Some((app.capture(), number)))).collect()
}
