//! The list of buses on the terminal, before a session.
//!
//! Inputs: keys, signals, what the machine has. Output: the buses to open. Opens no bus to send. Does
//! not know what a session is.

use super::bus_scout::BusScout;
use super::terminal::{self, Terminal};
use super::terminal_input::TerminalInput;
use super::tui_loop::{Signals, ThemeLoader, TuiWake, key_of};
use crate::app::{BusChoice, BusSelection, ChoiceOutcome, Signs};
use crossterm::event::{Event, KeyEventKind};
use std::io;

/// How the list ended.
#[derive(Debug)]
pub enum PickerExit {
    /// These buses are to be opened.
    Open(BusSelection),
    /// The user quit.
    Quit,
    /// A signal ended it, or the terminal is gone.
    Interrupted,
}

/// Shows the list until a choice is made, or until an interface that it waits for is up.
///
/// # Errors
/// The terminal cannot be taken over.
pub async fn choose(
    choice: BusChoice,
    scout: BusScout,
    themes: &mut ThemeLoader,
    signs: Signs,
) -> io::Result<PickerExit> {
    match choose_on_terminal(choice, scout, themes, signs).await {
        Err(_) if terminal::is_lost() => Ok(PickerExit::Interrupted),
        exit => exit,
    }
}

async fn choose_on_terminal(
    mut choice: BusChoice,
    mut scout: BusScout,
    themes: &mut ThemeLoader,
    signs: Signs,
) -> io::Result<PickerExit> {
    let mut signals = Signals::new()?;
    let mut terminal = Terminal::enter()?;
    let mut input = TerminalInput::start()?;
    loop {
        let theme = &themes.current;
        let draw =
            |frame: &mut ratatui::Frame| crate::ui::draw_choice(&choice, None, theme, signs, frame);
        terminal.draw_frame(draw, usize::MAX)?;
        let event = tokio::select! {
            biased;
            signal = signals.next() => match signal {
                TuiWake::Terminate | TuiWake::Hangup => return Ok(PickerExit::Interrupted),
                TuiWake::Stop => {
                    terminal.suspend()?;
                    continue;
                }
            },
            event = input.next() => event,
            offers = scout.next() => {
                choice.handle_offers(offers);
                if let Some(awaited) = choice.take_awaited() {
                    return Ok(PickerExit::Open(awaited));
                }
                continue;
            }
        };
        match event {
            Some(Ok(Event::Key(key))) if key.kind != KeyEventKind::Release => {
                match key_of(key).and_then(|key| choice.handle_key(key)) {
                    None => {}
                    Some(ChoiceOutcome::Copy(text)) => terminal.copy(&text)?,
                    Some(ChoiceOutcome::NextTheme) => {
                        if let Some(name) = themes.choose_next() {
                            choice.set_theme(name);
                        }
                    }
                    Some(ChoiceOutcome::Close) => return Ok(PickerExit::Quit),
                    Some(ChoiceOutcome::Open(wanted)) => return Ok(PickerExit::Open(wanted)),
                }
            }
            Some(Ok(_)) => {}
            Some(Err(_)) | None => return Ok(PickerExit::Interrupted),
        }
    }
}
