//! The loop of the screen of a fleet: keys, signals, drawing, and what the connection brings.
//!
//! Wakes up only for an input or a deadline; draws only changes, at the pace of [`PaintPace`]. Messages are
//! taken in batches, and all of them are drawn at once.

use super::background_colour::{BackgroundReply, QUESTION};
use super::broker::{BrokerReader, ReaderNotice};
use super::paint_pace::PaintPace;
use super::terminal::{self, Terminal};
use super::terminal_input::TerminalInput;
use super::tui_loop::{Signals, ThemeLoader, TuiWake, key_of, mouse_of};
use super::waiting::sleep_for;
use crate::app::{FleetEffect, FleetScreen};
use crate::diagnostic::Diagnostic;
use crossterm::event::{Event, KeyEventKind};
use std::io;
use tokio::time::{Instant, sleep_until};

/// Messages that are taken at once, at most: keys are looked for in between.
const BATCH: usize = 100;

/// How the screen ended.
#[derive(Clone, Debug, PartialEq)]
pub enum FleetExit {
    /// The user quit.
    Quit,
    /// A signal ended it, or the terminal is gone.
    Interrupted,
    /// The broker cannot be used, and will not be on another attempt.
    Unusable(Diagnostic),
}

/// Shows the screen until it ends. The terminal is restored on every way out.
///
/// # Errors
/// The terminal cannot be taken over.
pub async fn run(
    screen: &mut FleetScreen,
    reader: &mut BrokerReader,
    themes: &mut ThemeLoader,
    screen_budget: f64,
) -> io::Result<FleetExit> {
    match run_on_terminal(screen, reader, themes, screen_budget).await {
        Err(_) if terminal::is_lost() => Ok(FleetExit::Interrupted),
        exit => exit,
    }
}

async fn run_on_terminal(
    screen: &mut FleetScreen,
    reader: &mut BrokerReader,
    themes: &mut ThemeLoader,
    screen_budget: f64,
) -> io::Result<FleetExit> {
    let mut signals = Signals::new()?;
    let mut terminal = Terminal::enter()?;
    let mut input = TerminalInput::start()?;
    let start = Instant::now();
    let elapsed = || crate::time::Instant::ZERO + start.elapsed();
    let mut pace = PaintPace::new(screen_budget, terminal::line_rate());
    let mut background = BackgroundReply::default();
    if themes.can_tint() && terminal::tells_background() {
        terminal.write(QUESTION)?;
        background.note_asked(elapsed());
        pace.note_question(elapsed());
    }
    resized(screen, &terminal)?;
    loop {
        while let Some(effect) = screen.poll_effect() {
            match effect {
                FleetEffect::Quit => return Ok(FleetExit::Quit),
                FleetEffect::Suspend => {
                    terminal.suspend()?;
                    resized(screen, &terminal)?;
                }
                FleetEffect::Redraw => terminal.redraw()?,
                FleetEffect::Copy(text) => terminal.copy(&text)?,
                FleetEffect::Reconnect => reader.reconnect(),
                FleetEffect::NextTheme => {
                    let name = themes.choose_next();
                    screen.handle_theme(name.as_deref());
                }
            }
        }
        let draw_at = start + pace.due().since(crate::time::Instant::ZERO);
        let held = background.poll_timeout().map(|at| at.since(elapsed()));
        let timeout = screen.poll_timeout().map(|at| at.since(elapsed()));
        tokio::select! {
            biased;
            signal = signals.next() => match signal {
                TuiWake::Terminate | TuiWake::Hangup => return Ok(FleetExit::Interrupted),
                TuiWake::Stop => {
                    terminal.suspend()?;
                    resized(screen, &terminal)?;
                }
            },
            event = input.next() => match event {
                Some(Ok(event)) => {
                    let (events, answer) = background.take(elapsed(), event);
                    if let Some(colour) = answer {
                        pace.note_answer(elapsed());
                        themes.set_background(colour);
                    }
                    for event in events {
                        pace.note_key(elapsed());
                        if matches!(event, Event::Resize(..)) {
                            // The terminal may have changed the old content.
                            terminal.redraw()?;
                        }
                        handle_input(screen, elapsed(), &event);
                    }
                }
                Some(Err(_)) | None => return Ok(FleetExit::Interrupted),
            },
            () = sleep_until(draw_at), if screen.is_dirty() || pace.is_partial() => {
                if pace.is_renewed() {
                    screen.prepare();
                }
                let mut scrolled = None;
                let draw = |frame: &mut ratatui::Frame| {
                    scrolled = crate::ui::draw_fleet(screen, &themes.current, frame);
                };
                let part = terminal.draw_frame(draw, pace.most_bytes())?;
                screen.handle_drawn(scrolled);
                terminal.set_title("descan fleet".to_owned())?;
                pace.drawn(elapsed(), part.bytes, part.took, part.is_complete);
                if pace.wants_answer() {
                    terminal.write(QUESTION)?;
                    background.note_asked(elapsed());
                    pace.note_question(elapsed());
                }
            }
            () = sleep_for(held) => {
                for event in background.handle_timeout(elapsed()) {
                    pace.note_key(elapsed());
                    handle_input(screen, elapsed(), &event);
                }
            }
            // Before the timeouts: what waits here came before them.
            notices = reader.next_many(BATCH) => {
                for notice in notices {
                    if let Some(failure) = handle_notice(screen, elapsed(), notice) {
                        return Ok(FleetExit::Unusable(failure));
                    }
                }
            }
            () = sleep_for(timeout) => screen.handle_timeout(elapsed()),
            reading = themes.changed() => {
                let name = themes.reload(reading).ok().map(|()| themes.current.name.clone());
                screen.handle_theme(name.as_deref());
            }
        }
    }
}

fn resized(screen: &mut FleetScreen, terminal: &Terminal) -> io::Result<()> {
    let (columns, rows) = terminal.size()?;
    screen.handle_resize(columns, rows);
    Ok(())
}

/// Takes what the connection brings; returns why it is not tried again.
fn handle_notice(
    screen: &mut FleetScreen,
    now: crate::time::Instant,
    notice: ReaderNotice,
) -> Option<Diagnostic> {
    match notice {
        ReaderNotice::Message(topic, payload, is_kept) => {
            screen.handle_message(now, &topic, &payload, is_kept);
        }
        ReaderNotice::Connected => screen.handle_connected(now),
        ReaderNotice::Subscribed { refused } => screen.handle_subscribed(now, refused),
        ReaderNotice::Failed(failure, None) => return Some(failure.diagnostic),
        ReaderNotice::Failed(failure, Some(wait)) => {
            screen.handle_failed(now, failure.diagnostic.to_string(), wait);
        }
    }
    None
}

fn handle_input(screen: &mut FleetScreen, now: crate::time::Instant, event: &Event) {
    match event {
        Event::Key(key) if key.kind != KeyEventKind::Release => {
            if let Some(key) = key_of(*key) {
                screen.handle_key(now, key);
            }
        }
        Event::Paste(text) => screen.handle_paste(now, text),
        Event::Resize(columns, rows) => screen.handle_resize(*columns, *rows),
        Event::Mouse(mouse) => {
            if let Some(mouse) = mouse_of(*mouse) {
                screen.handle_mouse(now, mouse);
            }
        }
        _ => {}
    }
}
