//! The loop of the terminal UI: keys, signals, drawing, and the session below.
//!
//! Wakes up only for an input or a deadline; draws only changes, at the pace of [`PaintPace`].

use super::config::ConfigFolder;
use super::file_watcher::{DiskContent, FileWatcher};
use super::paint_pace::{PaintPace, SCREEN_BUDGET};
use super::session::Session;
use super::stop::output_closed;
use super::store::Store;
use super::terminal::{self, Terminal};
use crate::app::{Effect, Mouse, MouseKind, SavedFilter, SavedFilterChange};
use crate::keymap::{Key, KeyCode};
use crate::regular_file::{MAX_TEXT_BYTES, read_text, text_of};
use crate::theme::{Colours, Theme};
use crossterm::event::{
    self, Event, EventStream, KeyEvent, KeyEventKind, KeyModifiers, MouseButton, MouseEventKind,
};
use futures_util::StreamExt;
use std::future::{pending, poll_fn};
use std::io;
use std::sync::Arc;
use std::task::Poll;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};

/// How the UI ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TuiExit {
    /// The user quit.
    Quit,
    /// SIGTERM or SIGINT.
    Terminated,
    /// The terminal is gone.
    Hangup,
}

/// Runs the UI until it ends. The terminal is restored on every way out. A closed terminal is
/// [`TuiExit::Hangup`], not an error.
pub async fn run(session: &mut Session, themes: &mut ThemeLoader) -> io::Result<TuiExit> {
    match run_on_terminal(session, themes).await {
        Err(_) if terminal::is_lost() => Ok(TuiExit::Hangup),
        exit => exit,
    }
}

async fn run_on_terminal(session: &mut Session, themes: &mut ThemeLoader) -> io::Result<TuiExit> {
    let mut signals = Signals::new()?;
    let mut terminal = Terminal::enter()?;
    let mut input = EventStream::new();
    let (columns, rows) = terminal.size()?;
    session.app.handle_resize(columns, rows);
    let start = Instant::now();
    let elapsed = || crate::time::Instant::ZERO + start.elapsed();
    let mut pace = PaintPace::new(SCREEN_BUDGET, terminal::line_rate());
    loop {
        for effect in session.flush_effects() {
            match effect {
                Effect::Quit => return Ok(TuiExit::Quit),
                Effect::Suspend => {
                    drop(input);
                    terminal.suspend()?;
                    input = EventStream::new();
                    resized(session, &terminal)?;
                }
                Effect::Redraw => terminal.redraw()?,
                Effect::Bell => terminal.write(b"\x07")?,
                Effect::Copy(text) => terminal.copy(&text)?,
                Effect::UseTheme(name) => {
                    let result = themes.choose(&name);
                    session.app.handle_theme(session.now(), result);
                }
                Effect::KeepTheme(name) => {
                    let result = themes.keep(&name);
                    session.app.handle_kept_theme(session.now(), result);
                }
                Effect::ChangeFilters(change) => {
                    session.app.handle_saved_filters(themes.change_filters(&change));
                }
                Effect::Save { .. }
                | Effect::ReadFile
                | Effect::WriteFile { .. }
                | Effect::WriteLog { .. }
                | Effect::Playback(_)
                | Effect::FindBitrate(_) => {}
            }
        }
        let draw_at = start + pace.due().since(crate::time::Instant::ZERO);
        tokio::select! {
            biased;
            signal = signals.next() => match signal {
                TuiWake::Terminate => return Ok(TuiExit::Terminated),
                TuiWake::Hangup => return Ok(TuiExit::Hangup),
                TuiWake::Stop => {
                    terminal.suspend()?;
                    resized(session, &terminal)?;
                }
            },
            event = next_event(&mut input) => match event {
                Some(Ok(event)) => {
                    pace.note_key(elapsed());
                    if matches!(event, Event::Resize(..)) {
                        // The terminal may have changed the old content.
                        terminal.redraw()?;
                    }
                    handle_input(session, &event);
                }
                Some(Err(_)) | None => return Ok(TuiExit::Hangup),
            },
            () = sleep_until(draw_at), if session.app.is_dirty() || pace.is_partial() => {
                if pace.is_renewed() {
                    session.app.take_dirty();
                }
                let part = terminal.draw(&mut session.app, &themes.current, pace.most_bytes())?;
                terminal.set_title(session.app.terminal_title())?;
                pace.drawn(elapsed(), part.bytes, part.took, part.is_complete);
            }
            reading = themes.changed() => {
                let result = themes.reload(reading);
                session.app.handle_theme(session.now(), result);
            }
            wake = session.next() => session.handle_wake(wake),
        }
    }
}

/// Returns the next input event, `None` once the terminal is closed: crossterm would then read
/// end of file in an endless loop.
pub(super) async fn next_event(input: &mut EventStream) -> Option<io::Result<Event>> {
    poll_fn(
        |context| {
            if terminal::is_lost() { Poll::Ready(None) } else { input.poll_next_unpin(context) }
        },
    )
    .await
}

fn resized(session: &mut Session, terminal: &Terminal) -> io::Result<()> {
    let (columns, rows) = terminal.size()?;
    session.app.handle_resize(columns, rows);
    Ok(())
}

fn handle_input(session: &mut Session, event: &Event) {
    let now = session.now();
    match event {
        Event::Key(key) if key.kind != KeyEventKind::Release => {
            if let Some(key) = key_of(*key) {
                session.app.handle_key(now, key);
            }
        }
        Event::Paste(text) => session.app.handle_paste(now, text),
        Event::Resize(columns, rows) => session.app.handle_resize(*columns, *rows),
        Event::Mouse(mouse) => {
            let kind = match mouse.kind {
                MouseEventKind::Down(MouseButton::Left) => MouseKind::Press,
                MouseEventKind::Drag(MouseButton::Left) => MouseKind::Drag,
                MouseEventKind::ScrollUp => MouseKind::WheelUp,
                MouseEventKind::ScrollDown => MouseKind::WheelDown,
                _ => return,
            };
            session.app.handle_mouse(now, Mouse { kind, column: mouse.column, row: mouse.row });
        }
        _ => {}
    }
}

pub(super) fn key_of(event: KeyEvent) -> Option<Key> {
    let code = match event.code {
        event::KeyCode::Char(c) => KeyCode::Char(c),
        event::KeyCode::Enter => KeyCode::Enter,
        event::KeyCode::Esc => KeyCode::Esc,
        event::KeyCode::Tab | event::KeyCode::BackTab => KeyCode::Tab,
        event::KeyCode::Backspace => KeyCode::Backspace,
        event::KeyCode::Delete => KeyCode::Delete,
        event::KeyCode::Insert => KeyCode::Insert,
        event::KeyCode::Up => KeyCode::Up,
        event::KeyCode::Down => KeyCode::Down,
        event::KeyCode::Left => KeyCode::Left,
        event::KeyCode::Right => KeyCode::Right,
        event::KeyCode::Home => KeyCode::Home,
        event::KeyCode::End => KeyCode::End,
        event::KeyCode::PageUp => KeyCode::PageUp,
        event::KeyCode::PageDown => KeyCode::PageDown,
        event::KeyCode::F(number) => KeyCode::F(number),
        _ => return None,
    };
    let held = |modifier| event.modifiers.contains(modifier);
    let shift = held(KeyModifiers::SHIFT) || event.code == event::KeyCode::BackTab;
    let key = Key { code, ctrl: held(KeyModifiers::CONTROL), alt: held(KeyModifiers::ALT), shift };
    Some(key.normal())
}

/// The current theme, and the file that it was read from.
pub struct ThemeLoader {
    /// The current theme.
    pub current: Theme,
    colours: Colours,
    folder: Option<ConfigFolder>,
    watch: Option<FileWatcher>,
}

impl ThemeLoader {
    /// Starts with the theme `name`: the user's own, or a built-in one.
    ///
    /// # Errors
    /// No such theme, or it is invalid.
    pub fn new(folder: Option<ConfigFolder>, name: &str) -> Result<Self, String> {
        let (built_in, text) = crate::theme::BUILT_IN[0];
        let first = Theme::parse(built_in, text, |_| None).map_err(|error| error.to_string())?;
        let mut themes = Self { current: first, colours: colours(), folder, watch: None };
        themes.choose(name)?;
        Ok(themes)
    }

    /// Switches to the theme `name`: the user's own, or a built-in one.
    ///
    /// # Errors
    /// No such theme, or it is invalid.
    pub fn choose(&mut self, name: &str) -> Result<(), String> {
        let text = self.text_of(name)?;
        self.current = match &text {
            Some(text) => self.parse(name, text)?,
            None => Theme::built_in(name)
                .map(|theme| theme.limited(self.colours))
                .ok_or_else(|| format!("not found; available: {}", self.names().join(", ")))?,
        };
        self.watch = match (&self.folder, text) {
            (Some(folder), Some(text)) => {
                let store = Store::new(folder.theme_path(name)).with_max_bytes(MAX_TEXT_BYTES);
                Some(FileWatcher::spawn(store, Ok(Some(text.into_bytes()))))
            }
            _ => None,
        };
        Ok(())
    }

    /// Changes the filters that are stored; returns all of them.
    ///
    /// # Errors
    /// There is no folder for settings, or it cannot be read or written.
    pub fn change_filters(&self, change: &SavedFilterChange) -> Result<Vec<SavedFilter>, String> {
        match &self.folder {
            Some(folder) => folder.change_filters(change),
            None => Err("no home folder; set XDG_CONFIG_HOME".to_owned()),
        }
    }

    /// The names of all themes: the built-in ones, then the user's.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> =
            crate::theme::BUILT_IN.iter().map(|(name, _)| (*name).to_owned()).collect();
        let own = self.folder.as_ref().map(ConfigFolder::theme_names).unwrap_or_default();
        names.extend(
            own.into_iter().filter(|name| crate::theme::BUILT_IN.iter().all(|b| b.0 != name)),
        );
        names
    }

    /// Makes the theme `name` that of the settings.
    ///
    /// # Errors
    /// There is no folder for settings, or `config.toml` cannot be read or written.
    pub fn keep(&self, name: &str) -> Result<(), String> {
        match &self.folder {
            Some(folder) => folder.keep_theme(name),
            None => Err("no home folder; set XDG_CONFIG_HOME".to_owned()),
        }
    }

    /// The user's themes that cannot be used, with the first mistake in each.
    pub fn faults(&self) -> Vec<(String, String)> {
        let own = self.folder.as_ref().map(ConfigFolder::theme_names).unwrap_or_default();
        let fault = |name: String| {
            let text = self.text_of(&name);
            let parsed = text.and_then(|text| self.parse(&name, &text.unwrap_or_default()));
            parsed.err().map(|why| (name, crate::text::on_one_line(&why)))
        };
        own.into_iter().filter_map(fault).collect()
    }

    fn text_of(&self, name: &str) -> Result<Option<String>, String> {
        match &self.folder {
            Some(folder) if !name.contains('/') => {
                let path = folder.theme_path(name);
                read_text(&path).map_err(|fault| fault.to_string())
            }
            _ => Ok(None),
        }
    }

    fn parse(&self, name: &str, text: &str) -> Result<Theme, String> {
        let find = |parent: &str| self.text_of(parent).ok().flatten();
        let theme = Theme::parse(name, text, find).map_err(|error| error.to_string())?;
        Ok(theme.limited(self.colours))
    }

    /// Waits until the file of the current theme changes.
    async fn changed(&self) -> DiskContent {
        match &self.watch {
            Some(watch) => watch.changed().await,
            None => pending().await,
        }
    }

    fn reload(&mut self, reading: DiskContent) -> Result<(), String> {
        let Some(bytes) = reading.map_err(|fault| fault.to_string())? else { return Ok(()) };
        let text = text_of(bytes).map_err(|fault| fault.to_string())?;
        let name = self.current.name.clone();
        self.current = self.parse(&name, &text)?;
        Ok(())
    }
}

/// Number of colours of the terminal, by its environment variables.
fn colours() -> Colours {
    let variable = |name| std::env::var(name).unwrap_or_default();
    let full = ["truecolor", "24bit"].contains(&variable("COLORTERM").as_str());
    let terminal = variable("TERM");
    if full || terminal.ends_with("-direct") {
        Colours::Full
    } else if terminal.contains("256") {
        Colours::Indexed
    } else {
        Colours::Sixteen
    }
}

pub(super) enum TuiWake {
    Terminate,
    Hangup,
    Stop,
}

pub(super) struct Signals {
    terminate: Signal,
    interrupt: Signal,
    hangup: Signal,
    stop: Signal,
    /// Closed terminal. SIGHUP reports it to a session leader only.
    lost: Arc<Notify>,
}

impl Signals {
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            hangup: signal(SignalKind::hangup())?,
            stop: signal(SignalKind::from_raw(nix::libc::SIGTSTP))?,
            lost: output_closed(),
        })
    }

    pub(super) async fn next(&mut self) -> TuiWake {
        tokio::select! {
            _ = self.terminate.recv() => TuiWake::Terminate,
            _ = self.interrupt.recv() => TuiWake::Terminate,
            _ = self.hangup.recv() => TuiWake::Hangup,
            () = self.lost.notified() => TuiWake::Hangup,
            _ = self.stop.recv() => TuiWake::Stop,
        }
    }
}
