//! The report of a proof: what was found, who the boards are, the evidence frame by frame, how to read
//! it, with the rules of the protocol, and how it was measured.

use super::frames::ProofFrames;
use super::markdown::{MarkdownTable, Plain};
use crate::app::problems::{Problem, SideBasis, length_text};
use crate::app::{App, Decoded, EvidenceItem, side_letter};
use crate::finding::{FindingKind, FindingState};
use crate::frame::Frame;
use crate::text::hex;
use crate::time::Instant;
use crate::wire::id::{Header, MessageType};
use crate::wire::profile::ProfileKey;
use std::fmt::Write;

/// Returns the report. `file`: name of the file with the frames.
pub fn of_problem(app: &App, problem: &Problem, proof: &ProofFrames, file: &str) -> String {
    let mut text = String::new();
    let _ = writeln!(text, "# {}\n", Plain(&app.headline(problem).full));
    found(&mut text, app, problem);
    boards(&mut text, app, problem);
    evidence(&mut text, app, problem, proof, file);
    reading(&mut text, problem);
    setup(&mut text, app, problem, proof);
    remedy(&mut text, problem);
    text
}

/// Date and time of day with milliseconds, on the wall clock.
fn date_time(app: &App, at: Instant) -> String {
    let micros = app.epoch().unix_micros(at);
    format!("{}.{:03}", app.date_time_text(at), micros / 1000 % 1000)
}

fn found(text: &mut String, app: &App, problem: &Problem) {
    let _ = writeln!(text, "## What was found\n");
    // A finding that another one explains is not shown on the screen, either.
    for finding in problem.findings.iter().filter(|finding| finding.superseded_by.is_none()) {
        let kind = finding.key.kind.name();
        let _ = writeln!(text, "- **{}, {kind}:** {}", finding.state, Plain(&finding.text));
    }
    let began = problem.began();
    let _ = writeln!(text, "- **since:** {}", date_time(app, began));
    if let Some(ended) = problem.ended() {
        let length = length_text(ended.since(began));
        let _ = writeln!(text, "- **until:** {} ({length})", date_time(app, ended));
    }
    if problem.state() == FindingState::Suspected {
        let why = problem.confirmation_hint().unwrap_or("Not confirmed.");
        let _ = writeln!(text, "\nThis is a suspicion. {}", Plain(why));
    }
    text.push('\n');
}

fn boards(text: &mut String, app: &App, problem: &Problem) {
    let Some(panel) = app.conflict_panel(problem, true) else { return };
    let _ = writeln!(text, "## The boards\n");
    let note = match panel.sides.basis {
        SideBasis::Uids => "Each heartbeat carries the DEV_CFG_UID of its board.",
        SideBasis::Phases => {
            "The UIDs are blank or equal. The boards are distinguished by the time of their heartbeats in \
             each period, which differs."
        }
        SideBasis::None => {
            "The UIDs are blank or equal, and the times of the heartbeats do not tell the boards apart."
        }
    };
    let _ = writeln!(text, "{note} A was received first.\n");
    let mut headings = vec![""];
    headings.extend(panel.titles.iter().map(String::as_str));
    if panel.titles.is_empty() {
        headings.push("boards");
    }
    let mut table = MarkdownTable::new(&headings);
    for (label, cells) in &panel.rows {
        let mut row = vec![(*label).to_owned()];
        row.extend(cells.iter().cloned());
        row.resize(headings.len(), String::new());
        table.row(&row);
    }
    text.push_str(&table.finish());
    text.push('\n');
}

fn evidence(text: &mut String, app: &App, problem: &Problem, proof: &ProofFrames, file: &str) {
    let _ = writeln!(text, "## Evidence\n");
    let stored = proof.pieces.len() as u64;
    if stored == 0 {
        let _ = writeln!(text, "There are no frames: this is a difference from des.json.\n");
        return;
    }
    let count = problem.count().max(stored);
    let events = if proof.earlier > 0 {
        let (first, begin) = (date_time(app, problem.first()), date_time(app, proof.begin));
        format!(
            "The {stored} stored events from {begin} on. {count} were counted since {first}, those of \
             an earlier conflict with them"
        )
    } else if stored < count {
        format!("{stored} of {count} events, the first and the last ones")
    } else {
        format!("All {count} events")
    };
    let _ = writeln!(
        text,
        "{events}. The file {} has these frames, and {} frames up to a second before and after each, \
         not all between; Wireshark and tshark open it, and its comments name the events.\n",
        Plain(file),
        proof.frames.len().saturating_sub(proof.pieces.len()),
    );
    if proof.incomplete > 0 {
        let _ = writeln!(
            text,
            "Around {} of the events, frames are missing in it: they were no longer captured, or are \
             more than fit.\n",
            proof.incomplete
        );
    }
    let sides = app.conflict_sides(problem);
    let headings =
        ["no.", "time", "board", "what it shows", "identifier", "fields", "data", "meaning"];
    let mut table = MarkdownTable::new(&headings);
    for (at, piece) in proof.pieces.iter().enumerate() {
        let side = piece.frame.zip(sides.as_ref());
        let side = side.and_then(|(frame, sides)| app.side_of_frame(sides, &frame));
        let board = side.map_or("–".to_owned(), |side| side_letter(side).to_string());
        table.row(&row_of(app, at, piece, board));
    }
    text.push_str(&table.finish());
    text.push('\n');
}

fn row_of(app: &App, at: usize, piece: &EvidenceItem, board: String) -> [String; 8] {
    let dash = "–".to_owned();
    let (id, fields, data, meaning) = match &piece.frame {
        None => (dash.clone(), dash.clone(), dash.clone(), dash),
        Some(frame) => {
            let meaning = Decoded::of(app, frame).text;
            let meaning = if meaning.is_empty() { dash } else { meaning };
            (frame.id.to_string(), fields_of(frame), hex(frame.data(), " "), meaning)
        }
    };
    let time = date_time(app, piece.time);
    [(at + 1).to_string(), time, board, piece.what.clone(), id, fields, data, meaning]
}

/// The fields of an identifier, as numbers.
fn fields_of(frame: &Frame) -> String {
    let Some(id) = frame.platform_id() else { return "not a platform frame".to_owned() };
    let header = Header::decode(id);
    let bit = u8::from;
    format!(
        "{} U={} D={} R={} B={} ERR={} SRC={} DST={} SRV={}",
        header.message_type().name(),
        bit(header.from_non_working),
        bit(header.to_non_working),
        bit(header.response),
        bit(header.broadcast),
        bit(header.no_error),
        header.source,
        header.destination,
        header.service,
    )
}

/// How to read the evidence: only what the kinds of the problem need.
fn reading(text: &mut String, problem: &Problem) {
    let _ = writeln!(text, "## How to read it\n");
    let _ = writeln!(
        text,
        "- An identifier has 29 bits: U, D, R, B, ERR (one bit each, from bit 28 on), SRC and DST \
         (7 bits each), SRV (10 bits). R=1 is a response, which with ERR=0 reports an error; B=1 is a \
         broadcast, U=1 a sender that is not in a working mode. In a broadcast DST is a random number \
         (CAN platform §4.1). U, D, R, B and ERR give the message type, here {} and the like \
         (CAN platform §4.3).",
        MessageType::RspCcTgt.name()
    );
    let has =
        |kinds: &[FindingKind]| problem.findings.iter().any(|it| kinds.contains(&it.key.kind));
    if problem.is_address_conflict() {
        let _ = writeln!(
            text,
            "- SRC is the address of the sender, and an address belongs to one node. A node claims one \
             that it found to be free (CAN platform §3.2.4.2, DEV_MODE_ARSLV). A node in \
             DEV_MODE_WORK or DEV_MODE_UFUNC gives its address up when it receives a frame with its \
             own SRC from a node in a working mode (§3.2.4.4)."
        );
    }
    if has(&[
        FindingKind::OneAddressTwoIdentities,
        FindingKind::OneUidTwoAddresses,
        FindingKind::TwoDebugDevices,
    ]) {
        let _ = writeln!(
            text,
            "- A node sends its heartbeat, MSG_SRV_HR, once a period, BUS_CFG_HR_TIME. It carries \
             DEV_CFG_UID, which is unique in a system (CAN platform §3.2, §3.2.4). Heartbeats of one \
             SRC that change between UIDs to and fro are those of several boards: a board that was \
             replaced does not come back."
        );
    }
    if has(&[
        FindingKind::SameNameSameAddress,
        FindingKind::AnswersDoubled,
        FindingKind::OneAddressTwoNames,
    ]) {
        let _ = writeln!(
            text,
            "- A name request (data 44 45 53 01) to one address is answered once, with 01, the name and \
             00 (DES service document). Two responses to one request are those of two nodes, or of one \
             that responds twice. Nodes with equal names at one address cannot be distinguished by DES."
        );
    }
    let _ = writeln!(
        text,
        "- Data of up to 8 bytes begins with a byte of ISO 15765-2 where the framing is isotp: 0x0N is a \
         message of N bytes.\n"
    );
}

fn setup(text: &mut String, app: &App, problem: &Problem, proof: &ProofFrames) {
    let _ = writeln!(text, "## How it was measured\n");
    let mut table = MarkdownTable::new(&["", ""]);
    table.row(&["program", concat!("descan ", env!("CARGO_PKG_VERSION"))]);
    for log in app.logs() {
        let name = log.file_name().unwrap_or_default().to_string_lossy();
        table.row(&["log", &crate::text::printable(name.as_bytes())]);
    }
    let buses = app.buses();
    let own = problem.bus().and_then(|bus| app.bus(bus));
    for bus in own.into_iter().chain(buses.iter().filter(|_| own.is_none())) {
        let name = crate::text::printable(bus.name.as_bytes());
        let rate = bus
            .status
            .bitrate
            .map_or("unknown bit rate".to_owned(), |rate| format!("{rate} bit/s"));
        table.row(&["bus", &format!("{name}, {rate}")]);
        let config = bus.config();
        let sent = proof.frames.iter().filter(|(frame, _)| frame.is_tx).count();
        let mode = match (app.playback().is_some(), config.listen_only) {
            (true, _) if sent > 0 => format!(
                "reads a log; {sent} of the frames below were sent by the program that recorded it"
            ),
            (true, _) => "reads a log".to_owned(),
            (false, true) => "listen-only: descan sent nothing".to_owned(),
            (false, false) => "active".to_owned(),
        };
        table.row(&["descan", &mode]);
        let assumed: Vec<&str> = config.profile.assumed().map(ProfileKey::name).collect();
        let profile = match &assumed[..] {
            [] => "given".to_owned(),
            assumed => format!("assumed, not confirmed: {}", assumed.join(", ")),
        };
        table.row(&["profile", &profile]);
        let services = format!(
            "heartbeat SRV={}, DES SRV={}",
            config.profile.heartbeat_service(),
            config.profile.des_service()
        );
        table.row(&["services", &services]);
        table.row(&["frames lost", &bus.lost().to_string()]);
        table.row(&["bus errors", &bus.counters().errors.to_string()]);
    }
    let what = if app.playback().is_some() { "log read to" } else { "written" };
    table.row(&[what, &date_time(app, app.now())]);
    if let Some(moment) = app.past_moment() {
        table.row(&["moment shown", &date_time(app, moment.time)]);
    }
    if let Some((first, last)) = proof.frames.first().zip(proof.frames.last()) {
        let times = format!("{} to {}", date_time(app, first.0.time), date_time(app, last.0.time));
        table.row(&["frames in the file", &format!("{}, {times}", proof.frames.len())]);
    }
    text.push_str(&table.finish());
    let offset = app.utc_offset_text(app.shown_time());
    let whose = match (app.playback().is_some(), app.logs().len()) {
        (true, 0) => "at which the frames were read from standard input or a pipe",
        (true, 2..) => {
            "of the computer that recorded the first log; a log of another time begins with it"
        }
        _ => "of the computer that recorded",
    };
    let _ = writeln!(text, "\nTimes are those {whose}, {offset}.\n");
}

fn remedy(text: &mut String, problem: &Problem) {
    let remedy = problem.instead_of_remedy().unwrap_or(&problem.head().remedy);
    if !remedy.is_empty() {
        let _ = writeln!(text, "## What to do\n\n{}", Plain(remedy));
    }
}
