//! The loop of the terminal UI: keys, signals, drawing, and the session below.
//!
//! Wakes up only for an input or a deadline; draws only changes, at the pace of [`PaintPace`].

use super::background_colour::{BackgroundReply, QUESTION};
use super::bus_scout::BusScout;
use super::config::ConfigFolder;
use super::console::terminal_name;
use super::file_watcher::{DiskContent, FileWatcher};
use super::frame_templates::keep_template;
use super::paint_pace::PaintPace;
use super::recent_frames::remember_frame;
use super::session::Session;
use super::signals::{ScreenSignal, ScreenSignals};
use super::stop::output_closed;
use super::store::Store;
use super::terminal::{self, Terminal};
use super::terminal_input::TerminalInput;
use super::waiting::sleep_for;
use crate::app::{
    BusOffer, BusSelection, COLOURLESS_THEME, Effect, Mouse, MouseKind, SavedFilter,
    SavedFilterChange,
};
use crate::keymap::{Key, KeyCode};
use crate::regular_file::{MAX_TEXT_BYTES, read_text, text_of};
use crate::theme::{Colours, Theme};
use crate::time::Duration;
use crate::wire::profile::Profile;
use crossterm::event::{
    self, Event, KeyEvent, KeyEventKind, KeyModifiers, MouseButton, MouseEvent, MouseEventKind,
};
use std::future::pending;
use std::io;
use std::sync::Arc;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until, timeout_at};

/// Longest wait for the first answer of the terminal when the UI ends, which it does soon after the start
/// then: a round trip on a slow connection.
const FIRST_REPLY: Duration = Duration::from_millis(300);
/// The same for a later answer of a terminal that answers: it waits behind some screens on a slow line.
const LATE_REPLY: Duration = Duration::from_secs(5);

/// How the UI ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TuiExit {
    /// The user quit.
    Quit,
    /// The user chose other buses in place of those of the session.
    Reopen(BusSelection),
    /// SIGTERM or SIGINT.
    Terminated,
    /// The terminal is gone.
    Hangup,
}

/// Settings of the loop.
#[derive(Clone, Debug)]
pub struct LoopSettings {
    /// The profile of buses that can be opened.
    pub profile: Arc<Profile>,
    /// Bytes per second to the terminal for what the bus changes.
    pub screen_budget: f64,
}

/// Opens buses beside those of a session; returns their names, or the cause as a message.
pub type BusOpener<'o> = dyn Fn(&mut Session, &BusSelection) -> Result<Vec<String>, String> + 'o;

/// Runs the UI until it ends. The terminal is restored on every way out. A closed terminal is
/// [`TuiExit::Hangup`], not an error.
pub async fn run(
    session: &mut Session,
    themes: &mut ThemeLoader,
    settings: &LoopSettings,
    open: &BusOpener<'_>,
) -> io::Result<TuiExit> {
    match run_on_terminal(session, themes, settings, open).await {
        Err(_) if terminal::is_lost() => Ok(TuiExit::Hangup),
        exit => exit,
    }
}

async fn run_on_terminal(
    session: &mut Session,
    themes: &mut ThemeLoader,
    settings: &LoopSettings,
    open: &BusOpener<'_>,
) -> io::Result<TuiExit> {
    let mut signals = Signals::new()?;
    let mut terminal = Terminal::enter()?;
    let mut input = TerminalInput::start()?;
    let (columns, rows) = terminal.size()?;
    session.app.handle_resize(columns, rows);
    let start = Instant::now();
    let elapsed = || crate::time::Instant::ZERO + start.elapsed();
    let mut pace = PaintPace::new(settings.screen_budget, terminal::line_rate());
    let mut scout: Option<BusScout> = None;
    let mut background = BackgroundReply::default();
    if themes.can_tint() && terminal::tells_background() {
        terminal.write(QUESTION)?;
        background.note_asked(elapsed());
        pace.note_question(elapsed());
    }
    loop {
        for effect in session.flush_effects() {
            match effect {
                Effect::Quit => {
                    take_late_reply(&mut background, &mut input, &pace, elapsed()).await;
                    return Ok(TuiExit::Quit);
                }
                Effect::Suspend => {
                    take_late_reply(&mut background, &mut input, &pace, elapsed()).await;
                    // Its input stays: started again, crossterm may miss the first key.
                    terminal.suspend()?;
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
                Effect::RememberFrame(words) => remember_frame(&words),
                Effect::KeepTemplate(words) => {
                    if let Err(why) = keep_template(&words) {
                        let now = session.now();
                        session.app.handle_lost_template(now, &words, &why.to_string());
                    }
                }
                Effect::ChangeFilters(change) => {
                    session.app.handle_saved_filters(themes.change_filters(&change));
                }
                Effect::ListBuses => {
                    let names = session.app.buses().iter().map(|bus| bus.name.clone()).collect();
                    scout = Some(BusScout::spawn(Arc::clone(&settings.profile), names)?);
                }
                Effect::OpenBuses(wanted) if wanted.replaces => return Ok(TuiExit::Reopen(wanted)),
                Effect::OpenBuses(wanted) => {
                    let result = open(session, &wanted);
                    session.app.handle_opened(session.now(), result);
                }
                Effect::Save { .. }
                | Effect::ReadFile(_)
                | Effect::WriteFile { .. }
                | Effect::WriteLog { .. }
                | Effect::ReadLastPlan { .. }
                | Effect::WritePlan { .. }
                | Effect::Playback(_)
                | Effect::FindBitrate(_) => {}
            }
        }
        if session.app.bus_choice().is_none() {
            scout = None;
        }
        let draw_at = start + pace.due().since(crate::time::Instant::ZERO);
        let held = background.poll_timeout().map(|at| at.since(elapsed()));
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
            event = input.next() => match event {
                Some(Ok(event)) => {
                    let (events, answer) = background.take(elapsed(), event);
                    if let Some(colour) = answer {
                        pace.note_answer(elapsed());
                        if themes.set_background(colour) {
                            session.app.handle_theme(session.now(), Ok(()));
                        }
                    }
                    for event in events {
                        pace.note_key(elapsed());
                        if matches!(event, Event::Resize(..)) {
                            // The terminal may have changed the old content.
                            terminal.redraw()?;
                        }
                        handle_input(session, &event);
                    }
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
                if pace.wants_answer() {
                    terminal.write(QUESTION)?;
                    background.note_asked(elapsed());
                    pace.note_question(elapsed());
                }
            }
            offers = next_offers(&mut scout) => session.app.handle_offers(session.now(), offers),
            () = sleep_for(held) => {
                for event in background.handle_timeout(elapsed()) {
                    pace.note_key(elapsed());
                    handle_input(session, &event);
                }
            }
            reading = themes.changed() => {
                let result = themes.reload(reading);
                session.app.handle_theme(session.now(), result);
            }
            wake = session.next() => session.handle_wake(wake),
        }
    }
}

/// Waits for an answer of the terminal that may be on its way: the shell would take it as typed.
async fn take_late_reply(
    background: &mut BackgroundReply,
    input: &mut TerminalInput,
    pace: &PaintPace,
    now: crate::time::Instant,
) {
    let longest = if pace.is_answered() { LATE_REPLY } else { FIRST_REPLY };
    if !background.is_awaited(now, longest) {
        return;
    }
    let until = Instant::now() + longest;
    while let Ok(Some(Ok(event))) = timeout_at(until, input.next()).await {
        if background.take(now, event).1.is_some() {
            return;
        }
    }
}

/// Waits for the next look at what can be opened; forever without a scout.
async fn next_offers(scout: &mut Option<BusScout>) -> Vec<BusOffer> {
    match scout {
        Some(scout) => scout.next().await,
        None => pending().await,
    }
}

fn resized(session: &mut Session, terminal: &Terminal) -> io::Result<()> {
    let (columns, rows) = terminal.size()?;
    session.app.handle_resize(columns, rows);
    Ok(())
}

fn handle_input(session: &mut Session, event: &Event) {
    session.update_real_time();
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
            if let Some(mouse) = mouse_of(*mouse) {
                session.app.handle_mouse(now, mouse);
            }
        }
        _ => {}
    }
}

pub(super) fn mouse_of(event: MouseEvent) -> Option<Mouse> {
    let kind = match event.kind {
        MouseEventKind::Down(MouseButton::Left) => MouseKind::Press,
        MouseEventKind::Drag(MouseButton::Left) => MouseKind::Drag,
        MouseEventKind::ScrollUp => MouseKind::WheelUp,
        MouseEventKind::ScrollDown => MouseKind::WheelDown,
        _ => return None,
    };
    Some(Mouse { kind, column: event.column, row: event.row })
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
    /// The current theme, as the terminal can show it.
    pub current: Theme,
    /// The same without the tint beside the background of the terminal.
    untinted: Theme,
    /// The terminal's own background, where it tells it.
    background: Option<[u8; 3]>,
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
        let mut themes = Self {
            untinted: first.clone(),
            current: first,
            background: None,
            colours: colours(),
            folder,
            watch: None,
        };
        themes.choose(name)?;
        Ok(themes)
    }

    /// Switches to the theme `name`: the user's own, or a built-in one.
    ///
    /// # Errors
    /// No such theme, or it is invalid.
    pub fn choose(&mut self, name: &str) -> Result<(), String> {
        let text = self.text_of(name)?;
        let theme = match &text {
            Some(text) => self.parse(name, text)?,
            None => Theme::built_in(name)
                .map(|theme| theme.limited(self.colours))
                .ok_or_else(|| format!("not found; available: {}", self.names().join(", ")))?,
        };
        self.set(theme);
        self.watch = match (&self.folder, text) {
            (Some(folder), Some(text)) => {
                let store = Store::new(folder.theme_path(name)).with_max_bytes(MAX_TEXT_BYTES);
                Some(FileWatcher::spawn(store, Ok(Some(text.into_bytes()))))
            }
            _ => None,
        };
        Ok(())
    }

    /// Switches to the next theme that can be used; returns its name.
    pub fn choose_next(&mut self) -> Option<String> {
        let names = self.names();
        let at = names.iter().position(|name| *name == self.current.name).unwrap_or(0);
        let others = names.iter().cycle().skip(at + 1).take(names.len());
        let others: Vec<String> = others.cloned().collect();
        others.into_iter().find(|name| self.choose(name).is_ok())
    }

    fn set(&mut self, theme: Theme) {
        let tinted = self.background.map(|it| theme.clone().tinted(it, self.colours));
        self.current = tinted.unwrap_or_else(|| theme.clone());
        self.untinted = theme;
    }

    /// Returns true if the terminal has colours for a tint.
    pub(super) fn can_tint(&self) -> bool {
        let has_colour = self.untinted.name != COLOURLESS_THEME;
        has_colour && self.colours != Colours::Sixteen && !no_colour()
    }

    /// Takes the terminal's own background colour: red, green and blue. Returns true if it is another
    /// one.
    pub(super) fn set_background(&mut self, colour: [u8; 3]) -> bool {
        let is_new = self.background.replace(colour) != Some(colour);
        if is_new {
            self.set(self.untinted.clone());
        }
        is_new
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
    pub(super) async fn changed(&self) -> DiskContent {
        match &self.watch {
            Some(watch) => watch.changed().await,
            None => pending().await,
        }
    }

    pub(super) fn reload(&mut self, reading: DiskContent) -> Result<(), String> {
        let Some(bytes) = reading.map_err(|fault| fault.to_string())? else { return Ok(()) };
        let text = text_of(bytes).map_err(|fault| fault.to_string())?;
        let name = self.current.name.clone();
        let theme = self.parse(&name, &text)?;
        self.set(theme);
        Ok(())
    }
}

/// Returns true if the user wants no colours (no-color.org).
pub fn no_colour() -> bool {
    std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty())
}

/// Number of colours of the terminal, by its environment variables.
fn colours() -> Colours {
    let variable = |name| std::env::var(name).unwrap_or_default();
    let full = ["truecolor", "24bit"].contains(&variable("COLORTERM").as_str());
    let terminal = terminal_name();
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
    signals: ScreenSignals,
    /// Closed terminal. SIGHUP reports it to a session leader only.
    lost: Arc<Notify>,
}

impl Signals {
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self { signals: ScreenSignals::new()?, lost: output_closed() })
    }

    pub(super) async fn next(&mut self) -> TuiWake {
        tokio::select! {
            signal = self.signals.next() => match signal {
                ScreenSignal::Terminate => TuiWake::Terminate,
                ScreenSignal::Hangup => TuiWake::Hangup,
                ScreenSignal::Stop => TuiWake::Stop,
            },
            () = self.lost.notified() => TuiWake::Hangup,
        }
    }
}
