//! `descan help` and `descan man`: a part of the guide on standard output, laid out for the
//! terminal where it is one.

use super::output::print_own;
use super::{EXIT_OK, Failure};
use crate::cli;
use crate::guide::{self, UnknownTopic, render::TextLayout};
use crate::shell::console;
use std::io::{self, IsTerminal};

/// `descan help [NAME]`.
pub fn help(name: Option<&str>) -> Result<u8, Failure> {
    let layout = layout();
    let text = match name {
        None => guide::overview(&cli::program(), layout),
        Some(name) => guide::help(cli::program(), name, layout).map_err(|error| unknown(&error))?,
    };
    print_own(text.as_bytes()).map(|()| EXIT_OK)
}

/// `descan man [NAME]`.
pub fn man(name: Option<&str>) -> Result<u8, Failure> {
    let text = guide::manual(cli::program(), name).map_err(|error| unknown(&error))?;
    print_own(text.as_bytes()).map(|()| EXIT_OK)
}

fn unknown(error: &UnknownTopic) -> Failure {
    Failure::Usage(error.to_string())
}

/// As wide as the terminal; plain where there is none, or none that knows styles.
fn layout() -> TextLayout {
    let out = io::stdout();
    if !out.is_terminal() {
        return TextLayout::PLAIN;
    }
    let columns = console::columns();
    let is_dumb = matches!(console::terminal_name().as_str(), "" | "dumb");
    TextLayout { has_styles: !is_dumb, ..TextLayout::for_terminal(columns) }
}
