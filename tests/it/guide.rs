//! The guide is complete, its references resolve, and its examples work.

use descan::app::{FILTER_FIELDS, FILTER_WORDS};
use descan::catalogue::DeviceType;
use descan::cli;
use descan::document::Document;
use descan::finding::FindingKind;
use descan::guide::markdown::{GuideBlock, plain};
use descan::guide::render::{TextLayout, render};
use descan::guide::{self, TOPICS, Topic};
use descan::keymap::{ACTIONS, Keymap};
use descan::project::Project;
use descan::sim::Scenario;
use descan::theme::{Role, Theme};
use descan::ui::SYMBOLS;
use descan::wire::profile::{Profile, ProfileKey};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use unicode_width::UnicodeWidthStr;

fn descan(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .expect("the program starts")
}

fn stdout(arguments: &[&str]) -> String {
    let output = descan(arguments);
    assert!(output.status.success(), "{arguments:?}: {output:?}");
    String::from_utf8(output.stdout).expect("output is UTF-8")
}

fn topic(name: &str) -> &'static Topic {
    guide::topic(name).unwrap_or_else(|| panic!("no topic {name}"))
}

fn command_names() -> BTreeSet<String> {
    cli::program().get_subcommands().map(|command| command.get_name().to_owned()).collect()
}

/// Returns every topic with its text in 80 columns.
fn all_help() -> Vec<(String, String)> {
    let topics = TOPICS.iter().map(|topic| topic.name.to_owned());
    topics
        .chain(command_names())
        .map(|name| {
            let text = guide::help(cli::program(), &name, TextLayout::PLAIN).unwrap();
            (name, text)
        })
        .collect()
}

/// Returns the code blocks of all topics: topic, words after the fence, text.
fn code_blocks() -> Vec<(&'static str, String, String)> {
    let blocks =
        TOPICS.iter().flat_map(|topic| topic.blocks().into_iter().map(|it| (topic.name, it)));
    blocks
        .filter_map(|(name, block)| match block {
            GuideBlock::Code { info, text } => Some((name, info, text)),
            _ => None,
        })
        .collect()
}

/// Returns the text of a file with every run of white space as one blank.
fn in_one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns the characters at the beginning of `text` that a name of this kind may have.
fn word(text: &str, belongs: impl Fn(char) -> bool) -> &str {
    let end = text.find(|c: char| !belongs(c)).unwrap_or(text.len());
    text[..end].trim_end_matches(['.', '-'])
}

#[test]
fn every_topic_is_listed_and_has_text() {
    let overview = stdout(&["help"]);
    for topic in TOPICS {
        assert!(overview.contains(&format!("  {:<11}", topic.name)), "{}", topic.name);
        let text = stdout(&["help", topic.name]);
        assert!(text.lines().count() > 20, "{}", topic.name);
        assert!(!text.contains('\x1b'), "{}: styles without a terminal", topic.name);
        assert!(!topic.markdown().contains("<!--"), "{}: a table without a name", topic.name);
        assert!(matches!(topic.blocks()[0], GuideBlock::Heading(1, _)), "{}", topic.name);
    }
    for name in command_names() {
        assert!(overview.contains(&format!("  {name:<11}")), "{name}");
    }
}

#[test]
fn every_table_of_the_code_has_a_place() {
    for name in ["keys", "symbols", "findings", "filter", "roles"] {
        let text = guide::tables::expand(&format!("<!-- table: {name} -->"));
        assert!(text.lines().count() > 5, "{name}");
    }
}

#[test]
fn command_help_is_its_usage_then_its_topic() {
    let text = stdout(&["help", "check"]);
    let (usage, chapter) = (text.find("Usage: descan check"), text.find("SCRIPTING"));
    assert!(usage.is_some() && usage < chapter, "{text}");
    assert!(stdout(&["help", "completions"]).contains("Usage: descan completions"));
    let commands = command_names();
    for command in TOPICS.iter().flat_map(|topic| topic.commands) {
        assert!(commands.contains(*command), "{command}");
    }
}

#[test]
fn unknown_topic_names_what_there_is() {
    for arguments in [["help", "bus"], ["man", "bus"]] {
        let output = descan(&arguments);
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.starts_with("descan: topic \"bus\" not found; "), "{text}");
        assert!(text.contains("scan") && text.contains("buses, keys"), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
    }
}

#[test]
fn shells_complete_topics() {
    for shell in ["bash", "zsh"] {
        let text = stdout(&["completions", shell]);
        for topic in TOPICS {
            assert!(text.contains(topic.name), "{shell}: {}", topic.name);
        }
    }
}

#[test]
fn help_lines_fit_the_terminal() {
    for (name, text) in all_help() {
        for line in text.lines() {
            assert!(line.width() <= 80, "{name}: {line}");
        }
    }
    for line in guide::overview(&cli::program(), TextLayout::PLAIN).lines() {
        assert!(line.width() <= 80, "{line}");
    }
    // Narrow and wide terminals: no panic, and text within the width.
    for topic in TOPICS {
        for columns in [1, 20, 40, 100, 400] {
            let layout = TextLayout { has_styles: false, ..TextLayout::for_terminal(columns) };
            assert!(!render(&topic.blocks(), layout).is_empty());
        }
    }
}

#[test]
fn links_lead_to_topics() {
    for topic in TOPICS {
        for link in guide::links(&topic.blocks()) {
            if link.starts_with("https://") {
                continue;
            }
            let slug = link.strip_suffix(".md").unwrap_or_else(|| panic!("{}: {link}", topic.name));
            assert!(TOPICS.iter().any(|other| other.slug == slug), "{}: {link}", topic.name);
        }
    }
}

#[test]
fn named_topics_commands_and_options_exist() {
    let commands = command_names();
    // The last one is of mosquitto's programs.
    let mut options = BTreeSet::from(["help", "version", "cafile"].map(str::to_owned));
    let program = cli::program();
    let inner = program.get_subcommands().flat_map(clap::Command::get_subcommands);
    for command in std::iter::once(&program).chain(program.get_subcommands()).chain(inner) {
        options.extend(command.get_arguments().filter_map(|it| it.get_long()).map(str::to_owned));
    }
    for topic in TOPICS {
        let text = in_one_line(&topic.markdown());
        for (at, found) in text.match_indices("descan help ") {
            let name =
                word(&text[at + found.len()..], |c| c.is_ascii_alphanumeric() || "-.".contains(c));
            let is_known = guide::topic(name).is_some() || commands.contains(name);
            assert!(is_known, "{}: descan help {name}", topic.name);
        }
        for (at, _) in text.match_indices("--") {
            let starts = at == 0 || matches!(text.as_bytes()[at - 1], b' ' | b'`' | b'\'');
            let option = word(&text[at + 2..], |c| c.is_ascii_lowercase() || c == '-');
            if starts && !option.is_empty() {
                assert!(options.contains(option), "{}: --{option}", topic.name);
            }
        }
    }
}

/// Returns the section numbers of the protocol: `3`, `3.2`.
fn sections() -> BTreeSet<String> {
    let headings = topic("protocol").blocks().into_iter().filter_map(|block| match block {
        GuideBlock::Heading(2 | 3, line) => plain(&line).split(' ').next().map(str::to_owned),
        _ => None,
    });
    headings.collect()
}

fn section_at(text: &str) -> &str {
    word(text, |c| c.is_ascii_digit() || c == '.')
}

#[test]
fn sections_of_the_protocol_are_numbered_in_order() {
    let mut last = (0, 0);
    for section in topic("protocol").blocks() {
        let GuideBlock::Heading(level @ 2..=3, line) = section else { continue };
        let title = plain(&line);
        let number = title.split(' ').next().unwrap();
        let (major, minor) = number.split_once('.').unwrap_or((number, "0"));
        let number: (u32, u32) = (major.parse().unwrap(), minor.parse().unwrap());
        let next = if level == 2 { (last.0 + 1, 0) } else { (last.0, last.1 + 1) };
        assert_eq!(number, next, "{title}");
        last = number;
    }
}

#[test]
fn cited_sections_exist() {
    let sections = sections();
    for topic in TOPICS {
        let text = in_one_line(&topic.markdown());
        for (at, sign) in text.match_indices('§') {
            let before: String = text[..at].chars().rev().take(60).collect();
            if before.contains("mroftalp NAC") {
                continue;
            }
            let number = section_at(&text[at + sign.len()..]);
            assert!(sections.contains(number), "{}: §{number}", topic.name);
        }
    }
    let mut files = Vec::new();
    find_sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut files);
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        for cite in ["protocol §", "protocol.md §"] {
            for (at, found) in text.match_indices(cite) {
                let number = section_at(&text[at + found.len()..]);
                assert!(sections.contains(number), "{}: {cite}{number}", path.display());
            }
        }
    }
}

fn find_sources(folder: &Path, files: &mut Vec<std::path::PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            find_sources(&path, files);
        } else if path.extension().is_some_and(|it| it == "rs") {
            files.push(path);
        }
    }
}

#[test]
fn examples_are_accepted() {
    let mut count = 0;
    for (name, info, text) in code_blocks() {
        count += 1;
        match info.as_str() {
            "sh" | "sh run" => {
                for line in text.lines() {
                    // Splits at pipes and the other operators of the shell.
                    for command in line.split(['|', ';', '>']) {
                        accept_command(name, line, &shell_words(command));
                    }
                }
            }
            "json des.json" => {
                let document = Document::parse(text.as_bytes()).unwrap();
                assert!(!document.entries().is_empty(), "{name}: {text}");
                assert!(document.findings().is_empty(), "{name}: {:?}", document.findings());
            }
            "json event" => {
                for line in text.lines() {
                    let event: serde_json::Value = serde_json::from_str(line).unwrap();
                    assert!(event["event"].is_string(), "{name}: {line}");
                }
            }
            "toml profile" => drop(Profile::parse(&text).unwrap()),
            "toml keys.toml" => drop(Keymap::parse(&text).unwrap()),
            "toml scenario" => drop(Scenario::parse(&text).unwrap()),
            "toml config.toml" => {
                let folder = tempfile::tempdir().unwrap();
                std::fs::write(folder.path().join("config.toml"), &text).unwrap();
                let folder = descan::shell::config::ConfigFolder::at(folder.path());
                let settings = folder.settings().unwrap();
                assert!(settings.theme.is_some() && settings.steady_share.is_some());
            }
            "toml device type" => drop(DeviceType::parse(&text).unwrap()),
            "toml descan.toml" => drop(Project::parse(&text, Path::new("")).unwrap()),
            "toml theme" => drop(Theme::parse("own", &text, |_| None).unwrap()),
            // Compiled by tests/it/kit.
            "text" | "c" => {}
            other => panic!("{name}: a block is marked \"{other}\""),
        }
    }
    assert!(count > 20, "{count}");
}

/// Returns the words of a command; text in single quotes is one word.
fn shell_words(command: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut is_quoted = false;
    for c in command.chars() {
        match c {
            '\'' => is_quoted = !is_quoted,
            ' ' if !is_quoted => words.push(String::new()),
            c => words.last_mut().unwrap().push(c),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Parses the arguments of `descan`, if it is the command.
fn accept_command(name: &str, line: &str, words: &[String]) {
    let words = if words.first().is_some_and(|word| word == "sudo") { &words[1..] } else { words };
    if words.first().is_some_and(|word| word == "descan") {
        cli::parse(words).unwrap_or_else(|exit| panic!("{name}: {line}: {exit:?}"));
    }
}

#[test]
fn marked_examples_run() {
    let program = Path::new(env!("CARGO_BIN_EXE_descan")).parent().unwrap();
    let path = std::env::var("PATH").unwrap_or_default();
    let blocks: Vec<_> =
        code_blocks().into_iter().filter(|(_, info, _)| info == "sh run").collect();
    assert!(blocks.len() >= 4, "{}", blocks.len());
    let run = |(name, _, text): &(&str, String, String)| {
        let folder = tempfile::tempdir().unwrap();
        let output = Command::new("sh")
            .args(["-e", "-c", text])
            .current_dir(folder.path())
            .env("PATH", format!("{}:{path}", program.display()))
            .env("XDG_CONFIG_HOME", folder.path())
            .stdin(Stdio::null())
            .output()
            .expect("a shell");
        assert!(output.status.success() && !output.stdout.is_empty(), "{name}: {output:?}");
    };
    std::thread::scope(|scope| {
        for block in &blocks {
            scope.spawn(move || run(block));
        }
    });
}

#[test]
fn tables_of_the_code_are_complete() {
    let keys = topic("keys").markdown();
    for action in ACTIONS {
        assert!(keys.contains(&format!("| `{}` |", action.name)), "{}", action.name);
        for key in action.keys {
            assert!(keys.contains(&format!("`{key}`")), "{key}");
        }
    }
    for (_, sign, _) in SYMBOLS {
        assert!(keys.contains(&format!("`{}`", sign.trim())), "{sign}");
    }
    let findings = topic("findings").markdown();
    let names: BTreeSet<&str> = FindingKind::ALL.iter().map(|kind| kind.name()).collect();
    assert_eq!(names.len(), FindingKind::ALL.len(), "each kind once");
    for name in names {
        assert!(findings.contains(&format!("| `{name}` |")), "{name}");
        assert!(findings.contains(&format!("### {name}\n")), "{name} has no section");
    }
    let filter = topic("filter").markdown();
    for word in FILTER_FIELDS.iter().flat_map(|field| field.words) {
        assert!(filter.contains(&format!("`{word}:`")), "{word}");
    }
    for (word, _) in FILTER_WORDS {
        assert!(filter.contains(&format!("| `{word}` |")), "{word}");
    }
    let settings = topic("settings").markdown();
    for role in Role::ALL {
        assert!(settings.contains(&format!("| `{}` |", role.name())), "{}", role.name());
    }
}

#[test]
fn all_profile_keys_are_described() {
    let text = topic("profiles").markdown();
    let complete = code_blocks().into_iter().rfind(|(_, info, _)| info == "toml profile");
    let (_, _, complete) = complete.expect("a profile with every key");
    let parsed = Profile::parse(&complete).unwrap();
    let built_in = Profile::default();
    for key in ProfileKey::ALL {
        let (written, meant) = (parsed.value(*key), built_in.value(*key));
        assert_eq!(written, meant, "{}: what is written out is what is built in", key.name());
    }
    let mut table = String::new();
    for line in complete.lines() {
        if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            table = format!("{name}.");
        } else if let Some((key, _)) = line.split_once(" = ")
            && table != "modes."
        {
            assert!(text.contains(&format!("| `{table}{key}` |")), "{table}{key}");
        }
    }
}

#[test]
fn topics_are_plain_english() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/guide");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|it| it != "md") {
            continue;
        }
        count += 1;
        let slug = path.file_stem().unwrap().to_str().unwrap();
        assert!(TOPICS.iter().any(|topic| topic.slug == slug), "{slug} is not a topic");
        let text = std::fs::read_to_string(&path).unwrap();
        for word in text.split(|c: char| !c.is_alphabetic() && c != '_').map(str::to_lowercase) {
            let is_person = ["we", "us", "our", "somebody", "nobody", "whoever"];
            assert!(!is_person.contains(&word.as_str()), "{slug}: {word}");
        }
        for line in text.lines().filter(|line| !line.starts_with('|')) {
            assert!(line.width() <= 80, "{slug}: {line}");
        }
    }
    assert_eq!(count, TOPICS.len());
}

/// Returns the pages that a page in roff refers to: `\fBdescan\-keys\fR(7)`.
fn references(roff: &str) -> Vec<(String, u8)> {
    let roff = roff.replace("\\-", "-");
    let parts: Vec<&str> = roff.split("\\fBdescan").skip(1).collect();
    let reference = |part: &&str| {
        let (name, rest) = part.split_once("\\fR(")?;
        let section = rest.split(')').next()?.parse().ok()?;
        (!name.contains([' ', '\n'])).then(|| (format!("descan{name}"), section))
    };
    let mut found: Vec<(String, u8)> = parts.iter().filter_map(reference).collect();
    // clap_mangen's list of commands.
    let listed = roff.lines().filter_map(|line| {
        let (name, section) = line.strip_suffix(')')?.split_once('(')?;
        name.starts_with("descan-").then(|| Some((name.to_owned(), section.parse().ok()?)))?
    });
    found.extend(listed);
    found
}

#[test]
fn manual_pages_are_complete() {
    let pages = guide::pages(&cli::program());
    let inner = pages.iter().filter(|(page, _)| page.starts_with("descan-profile-")).count();
    assert_eq!(pages.len(), 1 + command_names().len() + inner + TOPICS.len());
    let mut referred = BTreeSet::new();
    for (page, section) in &pages {
        let name = page.strip_prefix("descan-").unwrap_or(page);
        let text = guide::manual(cli::program(), Some(name)).unwrap();
        assert!(text.is_ascii(), "{page}");
        let title = format!(".TH \"{}\" \"{section}\"", page.to_uppercase().replace('-', "\\-"));
        assert!(text.starts_with(&title), "{page}: {}", text.lines().next().unwrap());
        let mut wanted = vec!["NAME", "SEE ALSO"];
        if *section == 1 {
            wanted.extend(["SYNOPSIS", "DESCRIPTION", "OPTIONS", "EXIT STATUS", "FILES"]);
        }
        if page == "descan" || page == "descan-demo" {
            wanted.push("KEYS");
        }
        for heading in wanted {
            let at = text.lines().position(|line| {
                line == format!(".SH {heading}") || line == format!(".SH \"{heading}\"")
            });
            let at = at.unwrap_or_else(|| panic!("{page} has no {heading}"));
            let next = text.lines().nth(at + 1).unwrap_or_default();
            assert!(!next.is_empty() && !next.starts_with(".SH"), "{page}: {heading} is empty");
        }
        for reference in references(&text) {
            assert!(pages.contains(&reference), "{page}: {reference:?}");
            referred.insert(reference);
        }
    }
    for page in &pages {
        assert!(referred.contains(page), "{page:?} is not referred to");
    }
}

#[test]
fn manual_pages_have_no_warnings() {
    for (page, _) in guide::pages(&cli::program()) {
        let name = page.strip_prefix("descan-").unwrap_or(&page);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page");
        std::fs::write(&path, guide::manual(cli::program(), Some(name)).unwrap()).unwrap();
        let groff = Command::new("groff").args(["-ww", "-man", "-Tutf8"]).arg(&path).output();
        let Ok(output) = groff else {
            eprintln!("skipped: groff is not installed");
            return;
        };
        let warnings = String::from_utf8_lossy(&output.stderr);
        assert!(warnings.is_empty() && !output.stdout.is_empty(), "{page}: {warnings}");
    }
}
