//! `descan fleet` on a terminal: the screen over all gateways at a broker.

use super::fleet::unix_secs;
use super::{EXIT_INTERRUPTED, EXIT_OK, Failure, headless, open, tui};
use crate::app::{FleetScreen, FleetScreenOptions, Signs};
use crate::cli::FleetArgs;
use crate::fleet::FleetTopic;
use crate::keymap::Keymap;
use crate::shell::broker::{BrokerReader, BrokerSettings};
use crate::shell::config::{ConfigFolder, UserSettings};
use crate::shell::fleet_loop::{self, FleetExit};
use crate::shell::paint_pace::SCREEN_BUDGET;
use crate::shell::waiting::block_on;
use crate::shell::{stop, terminal};
use anyhow::Context;
use jiff::tz::TimeZone;

/// Runs it.
pub fn run(args: &FleetArgs) -> Result<u8, Failure> {
    let access = args.files.access(&args.broker).map_err(Failure::Usage)?;
    let broker = BrokerSettings::read(&access)?;
    let mut warnings = broker.warnings.clone();
    let folder = ConfigFolder::of_user();
    let settings = folder.as_ref().map_or(Ok(UserSettings::default()), ConfigFolder::settings);
    let settings = settings.unwrap_or_else(|why| open::warn(&mut warnings, &why));
    let keymap = folder.as_ref().map_or(Ok(Keymap::default()), ConfigFolder::keymap);
    let keymap = keymap.unwrap_or_else(|why| open::warn(&mut warnings, &why));
    let own_theme = settings.theme.as_deref();
    let mut themes = tui::themes(folder.as_ref(), args.theme.as_deref(), own_theme, &mut warnings)?;
    let signs = settings.signs.as_deref().and_then(Signs::from_name);
    let mut screen = FleetScreen::new(FleetScreenOptions {
        broker: broker.address.to_string(),
        unix_start: unix_secs(),
        time_zone: Some(TimeZone::system()),
        keymap,
        signs: signs.unwrap_or_else(terminal::signs),
        warnings,
    });
    terminal::restore_on_panic();
    stop::exit_if_stuck(EXIT_INTERRUPTED, terminal::restore).context("no signals")?;
    let budget = settings.screen_budget.unwrap_or(SCREEN_BUDGET);
    let runtime = headless::runtime()?;
    let exit = block_on(&runtime, async {
        let mut filters = FleetTopic::DOCUMENTS.to_vec();
        filters.push(FleetTopic::EVENTS);
        let mut reader = BrokerReader::spawn(&broker, &filters)?;
        fleet_loop::run(&mut screen, &mut reader, &mut themes, budget).await
    });
    runtime.shutdown_background();
    match exit.context("the terminal")? {
        FleetExit::Quit => Ok(EXIT_OK),
        FleetExit::Interrupted => Ok(EXIT_INTERRUPTED),
        FleetExit::Unusable(why) => Err(why.into()),
    }
}
