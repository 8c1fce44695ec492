//! The guide: topics of `descan help` and manual pages of `descan man`.
//!
//! Inputs: the Markdown files of this folder, compiled in; the tables of [`tables`], for the places
//! where a topic names one; the command tree of clap, for pages about commands. Output: text for a
//! terminal, or roff. Pure: opens nothing, prints nothing. Does not know what the commands do.

pub mod markdown;
pub mod render;
mod roff;
pub mod tables;

use crate::diagnostic::nearest_word;
use clap::Command;
use clap_mangen::Man;
use markdown::{GuideBlock, GuideSpan, plain};
use render::TextLayout;
use std::collections::BTreeSet;
use std::io;

/// A chapter of the guide.
#[derive(Debug)]
pub struct Topic {
    /// Name on the command line.
    pub name: &'static str,
    /// Name of its file without `.md`: the name with a dash for a dot.
    pub slug: &'static str,
    /// Subject in a few words, for the list of topics and the section NAME.
    pub summary: &'static str,
    /// Commands whose help is followed by the topic.
    pub commands: &'static [&'static str],
    /// Markdown, with a comment line for each table of the code.
    text: &'static str,
}

macro_rules! topics {
    ($($name:literal $slug:literal [$($command:literal)*] $summary:literal;)*) => {
        /// All topics, in the order in which they are listed.
        pub static TOPICS: &[Topic] = &[$(Topic {
            name: $name,
            slug: $slug,
            summary: $summary,
            commands: &[$($command),*],
            text: include_str!(concat!($slug, ".md")),
        }),*];
    };
}

topics! {
    "buses" "buses" ["speed"] "CAN interfaces, adapters, servers, logs, and their bit rate";
    "keys" "keys" [] "keys, mouse and symbols of the screen";
    "filter" "filter" [] "the filter line and --filter";
    "findings" "findings" [] "what descan finds, how it is proven, what to do";
    "des.json" "des-json" ["schema"] "the list of devices and static addresses";
    "scripting" "scripting" ["scan" "check" "watch" "diff" "log"] "scan, check, watch, diff and log: JSON, exit codes, CI";
    "gateways" "gateways" ["publish" "fleet"] "the inventories of many gateways, over an MQTT broker";
    "recording" "recording" [] "recording to a file, logs and their replay";
    "logs" "logs" ["convert"] "the formats of logs, and their conversion";
    "profiles" "profiles" ["profile"] "values that the protocol leaves open";
    "project" "project" ["init"] "descan.toml: the buses and files of a system";
    "device-types" "device-types" ["catalogue"] "the catalogue: names and data of services by type";
    "commands" "commands" ["identify" "mode" "restart" "address" "bitrate" "descriptor"] "commands to one device, and its descriptor";
    "plans" "plans" ["apply"] "addresses of des.json for all devices of a bus";
    "conformance" "conformance" ["prove"] "the rules that descan prove tests a device by";
    "composer" "composer" ["send"] "any frame or request, composed by fields and sent";
    "settings" "settings" [] "config.toml, keys.toml, themes, and all files used";
    "scenarios" "scenarios" ["demo" "sim"] "the demo, and simulated devices of your own";
    "firmware" "firmware" ["kit"] "the kit for firmware: your device in an hour";
    "wireshark" "wireshark" [] "a dissector for Wireshark, and DBC files";
    "protocol" "protocol" [] "the protocol on the bus, numbered for reference";
}

/// Returns the topic of a name (in any case) or slug; `None` if there is none.
pub fn topic(name: &str) -> Option<&'static Topic> {
    TOPICS.iter().find(|topic| topic.name.eq_ignore_ascii_case(name) || topic.slug == name)
}

impl Topic {
    /// Returns the text as Markdown, with the tables made from the code.
    pub fn markdown(&self) -> String {
        tables::expand(self.text)
    }

    /// Returns the text as blocks.
    pub fn blocks(&self) -> Vec<GuideBlock> {
        markdown::parse(&self.markdown())
    }

    /// Returns the name of the manual page, in section 7.
    fn page(&self) -> String {
        format!("descan-{}", self.slug)
    }
}

/// A name that is neither a command nor a topic.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("topic {name:?} not found; {suggestion}commands: {commands}; topics: {topics}")]
pub struct UnknownTopic {
    name: String,
    suggestion: String,
    commands: String,
    topics: String,
}

impl UnknownTopic {
    fn new(name: &str, program: &Command) -> Self {
        let commands: Vec<&str> = program.get_subcommands().map(Command::get_name).collect();
        let topics: Vec<&str> = TOPICS.iter().map(|topic| topic.name).collect();
        let nearest = nearest_word(name, commands.iter().chain(&topics).copied());
        let suggestion = nearest.map(|near| format!("did you mean {near}? ")).unwrap_or_default();
        let (commands, topics) = (commands.join(", "), topics.join(", "));
        Self { name: name.to_owned(), suggestion, commands, topics }
    }
}

/// Returns the text of `descan help`: usage, commands, topics.
pub fn overview(program: &Command, layout: TextLayout) -> String {
    let about = program.get_about().map(ToString::to_string).unwrap_or_default();
    let commands = program.get_subcommands().map(|command| {
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        (command.get_name().to_owned(), about)
    });
    let topics = TOPICS.iter().map(|topic| (topic.name.to_owned(), topic.summary.to_owned()));
    let span = |text: &str| vec![GuideSpan::plain(text)];
    let table = |rows: Vec<(String, String)>| GuideBlock::Table {
        header: vec![Vec::new(), Vec::new()],
        rows: rows
            .into_iter()
            .map(|(name, about)| vec![vec![GuideSpan::code(&format!("{name:<11}"))], span(&about)])
            .collect(),
    };
    let heading = |text: &str| GuideBlock::Heading(2, span(text));
    let code = |text: &str| GuideBlock::Code { info: String::new(), text: text.to_owned() };
    let blocks = [
        GuideBlock::Paragraph(span(&about)),
        heading("Usage"),
        code(
            "descan [OPTIONS] [BUS...]    the screen\ndescan COMMAND ...           a command\ndescan help NAME             a command or a topic\ndescan man NAME | man -l -   the same as a manual page",
        ),
        heading("Commands"),
        table(commands.collect()),
        heading("Topics"),
        table(topics.collect()),
    ];
    render::render(&blocks, layout)
}

/// Returns the text of `descan help NAME`: a topic, or the usage of a command and its topic.
///
/// # Errors
///
/// `name` is neither a command nor a topic.
pub fn help(program: Command, name: &str, layout: TextLayout) -> Result<String, UnknownTopic> {
    let mut program = program.term_width(layout.width);
    program.build();
    if let Some(command) = program.find_subcommand_mut(name) {
        let usage = command.render_help();
        let mut text = if layout.has_styles { usage.ansi().to_string() } else { usage.to_string() };
        if let Some(topic) = TOPICS.iter().find(|topic| topic.commands.contains(&name)) {
            text = format!("{}\n\n{}", text.trim_end(), render::render(&topic.blocks(), layout));
        }
        return Ok(text);
    }
    let topic = topic(name).ok_or_else(|| UnknownTopic::new(name, &program))?;
    Ok(render::render(&topic.blocks(), layout))
}

/// Returns the roff of `descan man [NAME]`: the page of the program, of a command (section 1), or
/// of a topic (section 7).
///
/// # Errors
///
/// `name` is neither a command nor a topic.
pub fn manual(mut program: Command, name: Option<&str>) -> Result<String, UnknownTopic> {
    program.build();
    let Some(name) = name.filter(|name| *name != "descan") else {
        return Ok(command_page(&program, None));
    };
    if let Some(command) = command_of_page(&program, name) {
        return Ok(command_page(command, Some(name)));
    }
    let topic = topic(name).ok_or_else(|| UnknownTopic::new(name, &program))?;
    Ok(topic_page(topic))
}

/// Returns the command of a name, or of two with a dash between them: `profile-check`.
fn command_of_page<'c>(program: &'c Command, name: &str) -> Option<&'c Command> {
    program.find_subcommand(name).or_else(|| {
        program.get_subcommands().find_map(|command| {
            let inner = name.strip_prefix(command.get_name())?.strip_prefix('-')?;
            command.find_subcommand(inner)
        })
    })
}

/// Returns the name and the section of every manual page.
pub fn pages(program: &Command) -> Vec<(String, u8)> {
    let commands = program.get_subcommands().flat_map(|command| {
        let outer = format!("descan-{}", command.get_name());
        let inner = command.get_subcommands().filter(|inner| inner.get_name() != "help");
        let inner = inner.map(|inner| format!("{outer}-{}", inner.get_name()));
        std::iter::once(outer.clone()).chain(inner.collect::<Vec<_>>())
    });
    let topics = TOPICS.iter().map(|topic| (topic.page(), 7));
    let commands = std::iter::once("descan".to_owned()).chain(commands).map(|name| (name, 1));
    commands.chain(topics).collect()
}

/// Returns the manual page of a topic.
fn topic_page(topic: &Topic) -> String {
    let blocks = topic.blocks();
    let mut text = roff::title(&topic.page(), 7, env!("CARGO_PKG_VERSION"));
    text += &roff::name(&topic.page(), topic.summary);
    // Text between the title and the first heading.
    if !matches!(blocks.get(1), Some(GuideBlock::Heading(..))) {
        text += &roff::section("Description");
    }
    text += &roff::body(&blocks, &page_of_link);
    let linked: BTreeSet<String> = links(&blocks)
        .into_iter()
        .filter_map(|link| page_of_link(&link))
        .map(|(name, _)| name)
        .filter(|name| *name != topic.page())
        .collect();
    let mut others = vec![("descan".to_owned(), 1)];
    others.extend(topic.commands.iter().map(|name| (format!("descan-{name}"), 1)));
    others.extend(linked.into_iter().map(|name| (name, 7)));
    text + &see_also(&others)
}

/// Returns the manual page of the program (`name` is `None`) or of a command.
fn command_page(command: &Command, name: Option<&str>) -> String {
    let page = name.map_or_else(|| "descan".to_owned(), |name| format!("descan-{name}"));
    let notes = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let mut text = roff::title(&page, 1, env!("CARGO_PKG_VERSION"));
    text += &generated(command);
    let [examples, exit, other] = sorted_notes(&notes);
    if !other.is_empty() {
        text += &roff::section("Notes");
        text.extend(other.iter().map(|note| roff::paragraph(note)));
    }
    if matches!(name, None | Some("demo")) {
        text += &roff::section("Keys");
        text += &roff::body(&markdown::parse(&tables::keys()), &page_of_link);
    }
    text += &roff::section("Exit status");
    if exit.is_empty() {
        text += &roff::body(&part("scripting", "Exit codes"), &page_of_link);
    } else {
        text.extend(exit.iter().map(|note| roff::paragraph(note)));
    }
    text += &roff::section("Files");
    text += &roff::body(&part("settings", "Files"), &page_of_link);
    if !examples.is_empty() {
        text += &roff::section("Examples");
        text.extend(examples.iter().map(|lines| roff::literal(lines)));
    }
    let mut others = Vec::new();
    if let Some(name) = name {
        others.push(("descan".to_owned(), 1));
        let of_command = TOPICS.iter().filter(|topic| topic.commands.contains(&name));
        others.extend(of_command.map(|topic| (topic.page(), 7)));
    } else {
        others.extend(TOPICS.iter().map(|topic| (topic.page(), 7)));
    }
    text + &see_also(&others)
}

/// Returns the sections that clap_mangen generates: NAME, SYNOPSIS, DESCRIPTION, OPTIONS,
/// SUBCOMMANDS.
fn generated(command: &Command) -> String {
    let man = Man::new(command.clone());
    let mut text = Vec::new();
    let has_commands = command.get_subcommands().next().is_some();
    let made = man
        .render_name_section(&mut text)
        .and_then(|()| man.render_synopsis_section(&mut text))
        .and_then(|()| man.render_description_section(&mut text))
        .and_then(|()| man.render_options_section(&mut text))
        .and_then(|()| {
            if has_commands {
                man.render_subcommands_section(&mut text)
            } else {
                io::Result::Ok(())
            }
        });
    // Writing to memory does not fail.
    debug_assert!(made.is_ok());
    roff::ascii(&String::from_utf8_lossy(&text))
}

/// Sorts the paragraphs behind the options: examples, exit codes, others.
fn sorted_notes(notes: &str) -> [Vec<String>; 3] {
    let mut sorted = [const { Vec::new() }; 3];
    for note in notes.split("\n\n").filter(|note| !note.trim().is_empty()) {
        let (at, text) = match note.strip_prefix("Examples:\n") {
            Some(lines) => {
                let lines = lines.lines().map(|line| line.strip_prefix("  ").unwrap_or(line));
                (0, lines.collect::<Vec<_>>().join("\n"))
            }
            None if note.starts_with("Exit code") => (1, note.to_owned()),
            None => (2, note.to_owned()),
        };
        sorted[at].push(text);
    }
    sorted
}

/// Returns the blocks of the topic `name` under the heading `title`, up to the next heading of
/// level 1 or 2.
fn part(name: &str, title: &str) -> Vec<GuideBlock> {
    let blocks = topic(name).map(Topic::blocks).unwrap_or_default();
    let is_heading = |block: &GuideBlock| matches!(block, GuideBlock::Heading(1 | 2, _));
    let is_title =
        |block: &GuideBlock| matches!(block, GuideBlock::Heading(_, line) if plain(line) == title);
    let behind = blocks.into_iter().skip_while(|block| !is_title(block)).skip(1);
    behind.take_while(|block| !is_heading(block)).collect()
}

/// Returns the section SEE ALSO.
fn see_also(pages: &[(String, u8)]) -> String {
    let pages: Vec<String> =
        pages.iter().map(|(name, section)| roff::reference(name, *section)).collect();
    format!("{}{}\n", roff::section("See also"), pages.join(",\n"))
}

/// Returns the manual page of a link between topics (`buses.md#...`); `None` for other links.
fn page_of_link(link: &str) -> Option<(String, u8)> {
    let slug = link.split('#').next()?.strip_suffix(".md")?;
    let topic = TOPICS.iter().find(|topic| topic.slug == slug)?;
    Some((topic.page(), 7))
}

/// Returns the targets of all links in the blocks.
pub fn links(blocks: &[GuideBlock]) -> Vec<String> {
    let mut found = Vec::new();
    for block in blocks {
        match block {
            GuideBlock::Heading(_, line) | GuideBlock::Paragraph(line) => {
                found.extend(line.iter().filter_map(|span| span.link.clone()));
            }
            GuideBlock::List { items, .. } => {
                found.extend(items.iter().flat_map(|item| links(item)));
            }
            GuideBlock::Table { header, rows } => {
                let cells = header.iter().chain(rows.iter().flatten()).flatten();
                found.extend(cells.filter_map(|span| span.link.clone()));
            }
            GuideBlock::Code { .. } => {}
        }
    }
    found
}
