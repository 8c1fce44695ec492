//! What is said to an slcan adapter, and what its answers mean.
//!
//! A state machine without I/O or clock. Adapters differ: some answer every command and every
//! frame, some only with their version, some nothing at all (python-can at the other end of a
//! pty, another descan). All of them are used; what an adapter does not say is not waited for
//! for long:
//!
//! ```text
//! waking    C and V until something answers: a board that our opening has reset takes its time
//! settling  until all that was asked has been answered, so that answers are told apart
//! setting   N, S, Y, then O or L, each after the answer to the one before
//! open      frames; F each second
//! ```

use super::line::{
    AdapterReply, Flags, LinePiece, LineSplitter, data_rate_code, encode, name, parse, rate_code,
};
use crate::bus::remote::stream::{Protocol, ProtocolIo};
use crate::bus::remote::tx_echo::Confirmation;
use crate::bus::remote::{RemoteClock, TxEchoTracker};
use crate::frame::Frame;
use crate::status::{BusState, Link};
use crate::time::{Duration, Instant};

/// How often an adapter is asked to wake up, and for how long it may say nothing.
const WAKE_RETRY: Duration = Duration::from_millis(200);
const WAKE_WITHIN: Duration = Duration::from_millis(1_200);
/// What is heard after this, while nothing answers, comes from one who answers nothing.
const CHATTER_AFTER: Duration = Duration::from_millis(300);
/// How long the last answers to the knocking may take.
const SETTLE_WITHIN: Duration = Duration::from_millis(250);
/// How long a command may be unanswered. Lawicel's adapters answer within milliseconds.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(1);
/// The same for the serial number, which many do not know.
const SERIAL_WITHIN: Duration = Duration::from_millis(300);
/// How long the first frame may be unanswered before we believe that frames are not answered.
const FIRST_FRAME: Duration = Duration::from_millis(250);
/// How often the status flags are asked for.
const FLAGS_EVERY: Duration = Duration::from_secs(1);
/// The same of an adapter that has answered nothing: a slow one may have woken up.
const PROBE_EVERY: Duration = Duration::from_secs(5);
/// Times that the flags may stay unanswered before the adapter counts as gone, or as one that
/// has none.
const FLAGS_MISSING: u32 = 3;
/// Lines that cannot be read, and none that can, before it is said that this is no slcan.
const NO_SLCAN_AFTER: u64 = 10;
/// The longest text of an adapter about itself that is shown.
const MAX_NAME: usize = 60;

/// How the adapter is to be opened.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SlcanSettings {
    /// Bit/s; without it the adapter's present one is kept.
    pub bitrate: Option<u32>,
    /// Bit/s of the FD data phase.
    pub data_bitrate: Option<u32>,
    /// `L` instead of `O`.
    pub listen_only: bool,
}

/// The dialogue with one adapter.
#[derive(Debug)]
pub(super) struct Slcan {
    device: String,
    settings: SlcanSettings,
    stage: SlcanStage,
    splitter: LineSplitter,
    own: TxEchoTracker,
    flags: FlagPoll,
    stamps: Stamps,
    /// It answers commands.
    responses: bool,
    /// It was already opened anew because an answer came after all.
    reopened: bool,
    /// It tells its controller's state by itself, and better than by flags.
    reports_state: bool,
    /// Its controller is error-warning, error-passive or bus-off.
    is_troubled: bool,
    takes_fd: bool,
    version: Option<String>,
    serial: Option<String>,
    readable: u64,
    unreadable: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SlcanStage {
    Waking { since: Instant, knocked: Instant, knocks: u32 },
    Settling { until: Instant, missing: u32 },
    Setting { command: SetupCommand, until: Instant },
    Open,
}

/// The commands of the setting, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SetupCommand {
    Serial,
    Rate(u8),
    DataRate(u8),
    Open,
}

/// The asking for status flags.
#[derive(Clone, Copy, Debug, Default)]
struct FlagPoll {
    /// Not refused.
    wanted: bool,
    /// When to ask next.
    next: Instant,
    /// Since when an answer is missing.
    asked: Option<Instant>,
    /// How many are missing in a row.
    missing: u32,
    /// The last answer.
    last: Option<Flags>,
}

impl Slcan {
    pub fn new(device: &str, settings: SlcanSettings) -> Self {
        Self {
            device: device.to_owned(),
            settings,
            stage: SlcanStage::Open,
            splitter: LineSplitter::default(),
            own: TxEchoTracker::new(Confirmation::Never, FIRST_FRAME),
            flags: FlagPoll::default(),
            stamps: Stamps::default(),
            responses: false,
            reopened: false,
            reports_state: false,
            is_troubled: false,
            takes_fd: false,
            version: None,
            serial: None,
            readable: 0,
            unreadable: 0,
        }
    }

    // --- opening -----------------------------------------------------------------------------

    fn wake(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        self.responses = false;
        self.stage = SlcanStage::Waking { since: now, knocked: now, knocks: 1 };
        exchange.write(b"C\rV\r");
    }

    /// Something came while waking or settling.
    fn process_while_waking(&mut self, now: Instant, word: Option<&AdapterReply>, is_no: bool) {
        let is_response = is_no
            || matches!(
                word,
                Some(AdapterReply::Yes | AdapterReply::Flags(_) | AdapterReply::Name(_))
            );
        match &mut self.stage {
            SlcanStage::Waking { knocks, .. } if is_response => {
                let missing = (2 * *knocks).saturating_sub(1);
                self.stage = SlcanStage::Settling { until: now + SETTLE_WITHIN, missing };
            }
            SlcanStage::Waking { since, .. } if now.since(*since) >= CHATTER_AFTER => {
                // It has something to say, and no answer.
                *since = now - WAKE_WITHIN;
            }
            SlcanStage::Settling { until, missing } if is_response => {
                *missing = missing.saturating_sub(1);
                *until = if *missing == 0 { now } else { now + SETTLE_WITHIN };
            }
            _ => {}
        }
        self.responses |= is_no || word == Some(&AdapterReply::Yes);
    }

    /// The next command after `done`, of those that are wanted.
    fn next_command(&self, done: Option<SetupCommand>) -> SetupCommand {
        let rate = self.settings.bitrate.and_then(rate_code).map(SetupCommand::Rate);
        let data_rate =
            self.settings.data_bitrate.and_then(data_rate_code).map(SetupCommand::DataRate);
        // One who says nothing needs no name asked for.
        let serial = self.responses.then_some(SetupCommand::Serial);
        let rank = |command: SetupCommand| match command {
            SetupCommand::Serial => 1,
            SetupCommand::Rate(_) => 2,
            SetupCommand::DataRate(_) => 3,
            SetupCommand::Open => 4,
        };
        let done = done.map_or(0, rank);
        let wanted = [serial, rate, data_rate].into_iter().flatten();
        wanted.into_iter().find(|command| rank(*command) > done).unwrap_or(SetupCommand::Open)
    }

    fn text(&self, command: SetupCommand) -> String {
        match command {
            SetupCommand::Serial => "N".to_owned(),
            SetupCommand::Rate(code) => format!("S{code}"),
            SetupCommand::DataRate(code) => format!("Y{code}"),
            SetupCommand::Open if self.settings.listen_only => "L".to_owned(),
            SetupCommand::Open => "O".to_owned(),
        }
    }

    fn set(&mut self, now: Instant, done: Option<SetupCommand>, exchange: &mut ProtocolIo) {
        let mut done = done;
        loop {
            if done == Some(SetupCommand::Open) {
                return self.enter_open(now, exchange);
            }
            let command = self.next_command(done);
            exchange.write(format!("{}\r", self.text(command)).as_bytes());
            if self.responses {
                let wait =
                    if command == SetupCommand::Serial { SERIAL_WITHIN } else { RESPONSE_TIMEOUT };
                self.stage = SlcanStage::Setting { command, until: now + wait };
                return;
            }
            done = Some(command);
        }
    }

    fn refused(&mut self, now: Instant, command: SetupCommand, exchange: &mut ProtocolIo) {
        let text = self.text(command);
        let why = match command {
            SetupCommand::Serial => return self.set(now, Some(command), exchange),
            SetupCommand::DataRate(_) => {
                self.takes_fd = false;
                return self.set(now, Some(command), exchange);
            }
            SetupCommand::Rate(_) => {
                let rate = self.settings.bitrate.unwrap_or_default();
                format!(
                    "rejects {rate} bit/s ({text}); use another rate, or none to keep the adapter's"
                )
            }
            SetupCommand::Open if self.settings.listen_only => {
                format!("rejects listen-only ({text})")
            }
            SetupCommand::Open => format!("does not open ({text}); set a bit rate: @500000"),
        };
        exchange.disconnect(Link::Down, format!("the adapter at {} {why}", self.device));
    }

    fn enter_open(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        self.stage = SlcanStage::Open;
        let confirmation = if self.responses { Confirmation::Unknown } else { Confirmation::Never };
        self.own.set_confirmation(confirmation);
        let next = if self.responses { now } else { now + FLAGS_EVERY };
        self.flags = FlagPoll { wanted: true, next, ..FlagPoll::default() };
        self.is_troubled = false;
        let status = &mut exchange.status;
        status.link = Link::Up;
        status.state = BusState::Unknown;
        status.message = None;
        status.bitrate = self.settings.bitrate;
        status.fd = self.takes_fd;
        status.data_bitrate = self.settings.data_bitrate.filter(|_| self.takes_fd);
        status.listen_only = self.settings.listen_only;
        status.unanswered = self.readable == 0;
        status.note = Some(self.describe_adapter());
    }

    /// What is known of the adapter, and what is not.
    fn describe_adapter(&self) -> String {
        let names = [self.version.as_deref(), self.serial.as_deref()];
        let names: Vec<&str> = names.into_iter().flatten().collect();
        let mut parts = Vec::new();
        if !names.is_empty() {
            parts.push(format!("adapter: {}", names.join(" ")));
        }
        if !self.responses {
            parts.push("adapter confirms no frames: written counts as sent".to_owned());
        }
        if self.settings.bitrate.is_none() {
            parts.push("adapter's bit rate kept (unknown)".to_owned());
        }
        if self.settings.data_bitrate.is_some() && !self.takes_fd {
            parts.push("adapter does not support FD frames".to_owned());
        }
        parts.join("; ")
    }

    // --- listening ---------------------------------------------------------------------------

    fn hear(&mut self, now: Instant, word: AdapterReply, exchange: &mut ProtocolIo) {
        self.readable += 1;
        exchange.status.unanswered = false;
        match word {
            AdapterReply::Frame(frame, stamp) => {
                let time = stamp.map_or(now, |stamp| self.stamps.date(stamp, now));
                exchange.status.fd |= frame.fd;
                self.takes_fd |= frame.fd;
                exchange.frames.push(frame.with_time(time));
            }
            AdapterReply::State { state, tec, rec } => {
                self.reports_state = true;
                exchange.status.tec = Some(tec);
                exchange.status.rec = Some(rec);
                self.set_state(state, exchange);
            }
            AdapterReply::Flags(flags) => self.take_flags(flags, exchange),
            AdapterReply::Name(name) => {
                let place =
                    if name.starts_with('N') { &mut self.serial } else { &mut self.version };
                *place = Some(name.chars().take(MAX_NAME).collect());
            }
            AdapterReply::Yes | AdapterReply::Command => {}
        }
    }

    fn take_flags(&mut self, flags: Flags, exchange: &mut ProtocolIo) {
        let was_overrun = self.flags.last.is_some_and(Flags::is_overrun);
        self.flags.asked = None;
        self.flags.missing = 0;
        self.flags.last = Some(flags);
        // Asking clears the flags in Lawicel's adapters and not in all others: a flag that
        // stays is one event.
        if flags.is_overrun() && !was_overrun {
            exchange.status.controller_overruns += 1;
        }
        if !self.reports_state {
            self.set_state(flags.state(), exchange);
        }
    }

    fn set_state(&mut self, state: BusState, exchange: &mut ProtocolIo) {
        if self.stage != SlcanStage::Open {
            return;
        }
        self.is_troubled = !matches!(state, BusState::ErrorActive | BusState::Unknown);
        let status = &mut exchange.status;
        status.state = state;
        let what = match state {
            BusState::BusOff => {
                "is bus-off: check wiring and bit rate, then restart descan or the adapter"
            }
            BusState::ErrorPassive => {
                "is error-passive: check bit rate, wiring, termination and that another \
                 node is on"
            }
            _ => {
                status.message = None;
                return;
            }
        };
        status.message = Some(format!("the adapter at {} {what}", self.device));
    }

    fn cannot_read(&mut self, exchange: &mut ProtocolIo) {
        exchange.status.unreadable += 1;
        self.unreadable += 1;
        if self.readable == 0 && self.unreadable == NO_SLCAN_AFTER {
            exchange.status.note =
                Some(format!("{} does not speak slcan; check adapter and baud rate", self.device));
        }
    }

    fn handle_ack(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        exchange.frames.extend(self.own.confirm_oldest(now));
        self.count_own(exchange);
    }

    fn handle_nack(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        let oldest = self.own.oldest_written();
        let is_of_flags = self.flags.asked.is_some_and(|at| oldest.is_none_or(|own| at <= own));
        if !is_of_flags {
            if self.own.refuse_oldest() || self.own.confirmation() == Confirmation::Never {
                exchange.status.transmit_failures += 1;
                self.own.set_confirmation(Confirmation::Given);
            }
            self.count_own(exchange);
        } else if self.flags.last.is_some() {
            // It had them before: it was switched off and on, and its channel is closed.
            self.open_again(now, exchange);
        } else {
            self.flags.wanted = false;
            self.flags.asked = None;
        }
    }

    /// One who said nothing answers after all.
    fn wakes_late(&mut self, now: Instant, exchange: &mut ProtocolIo) -> bool {
        if self.responses || self.reopened || self.stage != SlcanStage::Open {
            return false;
        }
        self.reopened = true;
        self.open_again(now, exchange);
        true
    }

    /// The same stream, from the beginning. The link stays as it is: it takes an instant.
    fn open_again(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        exchange.status.transmit_failures += self.own.clear();
        self.count_own(exchange);
        self.wake(now, exchange);
    }

    fn ask_for_flags(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        if self.flags.asked.is_some() {
            self.flags.missing += 1;
            if self.flags.missing == FLAGS_MISSING && self.responses {
                if self.flags.last.is_some() {
                    return exchange
                        .disconnect(Link::Down, format!("no response from {}", self.device));
                }
                self.flags.wanted = false;
                self.flags.asked = None;
                return;
            }
        }
        exchange.write(b"F\r");
        self.flags.asked = Some(now);
        self.flags.next = now + if self.responses { FLAGS_EVERY } else { PROBE_EVERY };
    }

    /// Returns true if no timeout applies to frames sent by descan: without an acknowledgement the
    /// controller keeps them, so elapsed time does not show that they are on the bus.
    fn holds_own(&self) -> bool {
        self.is_troubled && self.own.confirmation() == Confirmation::Unknown
    }

    fn count_own(&self, exchange: &mut ProtocolIo) {
        exchange.status.unconfirmed = self.own.in_flight();
    }
}

impl Protocol for Slcan {
    fn begin(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        let settings = self.settings;
        let device = std::mem::take(&mut self.device);
        *self = Self::new(&device, settings);
        self.takes_fd = settings.data_bitrate.is_some();
        self.wake(now, exchange);
    }

    fn handle_input(&mut self, now: Instant, bytes: &[u8], exchange: &mut ProtocolIo) {
        let mut splitter = std::mem::take(&mut self.splitter);
        splitter.feed(bytes, |piece| {
            let is_open = self.stage == SlcanStage::Open;
            let word = match piece {
                LinePiece::Line(line) => match parse(line) {
                    // Some answer V with any text.
                    None if !is_open => name(line).map(AdapterReply::Name),
                    word => word,
                },
                LinePiece::No | LinePiece::Unreadable => None,
            };
            let is_no = piece == LinePiece::No;
            if is_open
                && (is_no || matches!(word, Some(AdapterReply::Yes | AdapterReply::Flags(_))))
                && self.wakes_late(now, exchange)
            {
                return;
            }
            match self.stage {
                SlcanStage::Open if is_no => self.handle_nack(now, exchange),
                SlcanStage::Open if word == Some(AdapterReply::Yes) => {
                    self.handle_ack(now, exchange)
                }
                SlcanStage::Open => {}
                SlcanStage::Setting { command, .. } if is_no => {
                    self.refused(now, command, exchange)
                }
                SlcanStage::Setting { command, .. } => {
                    let is_name = matches!(word, Some(AdapterReply::Name(_)));
                    if word == Some(AdapterReply::Yes) || command == SetupCommand::Serial && is_name
                    {
                        self.set(now, Some(command), exchange);
                    }
                }
                _ => self.process_while_waking(now, word.as_ref(), is_no),
            }
            match word {
                Some(word) => self.hear(now, word, exchange),
                None if !is_no => self.cannot_read(exchange),
                None => {}
            }
        });
        self.splitter = splitter;
    }

    fn handle_written(&mut self, now: Instant, total: u64, exchange: &mut ProtocolIo) {
        self.own.written(now, total, &mut exchange.frames);
        self.count_own(exchange);
    }

    fn handle_timeout(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        match self.stage {
            SlcanStage::Waking { since, .. } if now.since(since) >= WAKE_WITHIN => {
                self.set(now, None, exchange);
            }
            SlcanStage::Waking { since, knocked, knocks } if now.since(knocked) >= WAKE_RETRY => {
                self.stage = SlcanStage::Waking { since, knocked: now, knocks: knocks + 1 };
                exchange.write(b"C\rV\r");
            }
            SlcanStage::Settling { until, .. } if now >= until => self.set(now, None, exchange),
            SlcanStage::Setting { command, until } if now >= until => {
                self.set(now, Some(command), exchange);
            }
            _ => {}
        }
        // Also after the change to open above: the flags are due at once.
        if self.stage == SlcanStage::Open {
            if !self.holds_own() {
                let given_up = self.own.handle_timeout(now, &mut exchange.frames);
                exchange.status.transmit_failures += given_up;
                self.count_own(exchange);
            }
            if self.flags.wanted && now >= self.flags.next {
                self.ask_for_flags(now, exchange);
            }
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        match self.stage {
            SlcanStage::Waking { since, knocked, .. } => {
                Some((since + WAKE_WITHIN).min(knocked + WAKE_RETRY))
            }
            SlcanStage::Settling { until, .. } | SlcanStage::Setting { until, .. } => Some(until),
            SlcanStage::Open => {
                let flags = self.flags.wanted.then_some(self.flags.next);
                let own = self.own.poll_timeout().filter(|_| !self.holds_own());
                [flags, own].into_iter().flatten().min()
            }
        }
    }

    fn has_room(&self) -> bool {
        self.stage == SlcanStage::Open && self.own.has_room()
    }

    fn send(&mut self, _: Instant, frame: &Frame, exchange: &mut ProtocolIo) {
        let line = encode(frame).filter(|_| self.takes_fd || !frame.fd);
        let Some(line) = line else {
            exchange.status.transmit_failures += 1;
            if frame.fd {
                exchange.status.note = Some(
                    "FD frames not sent; set a data bit rate, as in \
                     @500000/2000000"
                        .to_owned(),
                );
            }
            return;
        };
        let end = exchange.write(&line);
        self.own.push(frame, end);
        self.count_own(exchange);
    }

    fn end(&mut self, exchange: &mut ProtocolIo) {
        exchange.write(b"C\r");
    }

    fn break_off(&mut self) -> u64 {
        self.own.clear()
    }
}

/// The time stamps of frames: milliseconds that wrap.
///
/// They are not switched on (`Z1`): Lawicel's adapters keep that setting when they are switched
/// off, and other programs would meet it. Where they are on they are used: an FTDI chip holds
/// bytes back for up to 16 ms, which is more than a millisecond's rounding.
#[derive(Debug, Default)]
struct Stamps {
    clock: RemoteClock,
    last: Option<(u16, Instant)>,
    millis: i64,
    wraps_late: bool,
}

impl Stamps {
    fn date(&mut self, stamp: u16, arrival: Instant) -> Instant {
        // By the manual they wrap at a minute; some adapters let all 16 bits run.
        self.wraps_late |= stamp >= 60_000;
        let period = if self.wraps_late { 65_536 } else { 60_000 };
        if let Some((last, last_arrival)) = self.last {
            let passed = arrival.since(last_arrival).as_millis().min(1 << 40) as i64;
            let ahead = (i64::from(stamp) - i64::from(last)).rem_euclid(period);
            // As many periods more as make it fit best with what passed here.
            let periods = (passed - ahead + period / 2).div_euclid(period);
            self.millis += ahead + periods * period;
        }
        self.last = Some((stamp, arrival));
        self.clock.to_local_time(self.millis * 1000, arrival)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    #[test]
    fn stamps_are_unwrapped_over_any_silence() {
        let mut stamps = Stamps::default();
        assert_eq!(stamps.date(59_990, at(1_000)), at(1_000));
        // 20 ms later, but held back until 16 ms after that.
        assert_eq!(stamps.date(10, at(1_036)), at(1_020));
        // Two minutes and a half later.
        assert_eq!(stamps.date(30_010, at(151_020)), at(151_020));
        assert_eq!(stamps.date(30_012, at(151_032)), at(151_022));
    }

    #[test]
    fn stamps_of_all_16_bits_are_unwrapped_too() {
        let mut stamps = Stamps::default();
        assert_eq!(stamps.date(65_530, at(500)), at(500));
        assert_eq!(stamps.date(4, at(530)), at(510));
    }

    #[test]
    fn stamps_that_do_not_run_date_within_seconds_of_arrival() {
        let mut stamps = Stamps::default();
        for second in 1..300 {
            let arrival = at(second * 1_000);
            let time = stamps.date(7, arrival);
            assert!(arrival.since(time) <= Duration::from_secs(5), "{arrival} {time}");
        }
    }

    struct Talk {
        slcan: Slcan,
        exchange: ProtocolIo,
    }

    impl Talk {
        fn begin(settings: SlcanSettings) -> Self {
            let mut talk =
                Self { slcan: Slcan::new("dev", settings), exchange: ProtocolIo::default() };
            talk.slcan.begin(at(0), &mut talk.exchange);
            talk
        }

        fn hear(&mut self, millis: u64, bytes: &[u8]) -> String {
            self.slcan.handle_input(at(millis), bytes, &mut self.exchange);
            self.said()
        }

        /// Lets time pass, by the dialogue's own deadlines.
        fn pass(&mut self, until: u64) -> String {
            let mut said = String::new();
            while self.exchange.broken.is_none()
                && let Some(due) = self.slcan.poll_timeout().filter(|due| *due <= at(until))
            {
                self.slcan.handle_timeout(due, &mut self.exchange);
                said += &self.said();
                let next = self.slcan.poll_timeout();
                let is_later = next.is_none_or(|next| next > due);
                assert!(is_later || self.exchange.broken.is_some(), "{next:?} after {due:?}");
            }
            said
        }

        fn said(&mut self) -> String {
            String::from_utf8(self.exchange.take_output()).unwrap().replace('\r', ".")
        }
    }

    #[test]
    fn one_who_answers_is_asked_step_by_step() {
        let settings = SlcanSettings { bitrate: Some(500_000), ..SlcanSettings::default() };
        let mut talk = Talk::begin(settings);
        assert_eq!(talk.said(), "C.V.");
        assert_eq!(talk.hear(3, b"\x07"), "");
        assert_eq!(talk.hear(5, b"V1013\r"), "");
        assert_eq!(talk.pass(5), "N.");
        assert_eq!(talk.hear(7, b"NA123\r"), "S6.");
        assert_eq!(talk.hear(9, b"\r"), "O.");
        assert_eq!(talk.hear(11, b"\r"), "");
        assert_eq!(talk.exchange.status.link, Link::Up);
        assert_eq!(talk.exchange.status.note.as_deref(), Some("adapter: V1013 NA123"));
        assert_eq!(talk.pass(11), "F.");
        talk.hear(13, b"F20\r");
        assert_eq!(talk.exchange.status.state, BusState::ErrorPassive);
    }

    #[test]
    fn late_answers_to_the_knocking_are_not_taken_for_answers_to_what_follows() {
        let settings = SlcanSettings { bitrate: Some(500_000), ..SlcanSettings::default() };
        let mut talk = Talk::begin(settings);
        talk.said();
        assert_eq!(talk.pass(500), "C.V.C.V.");
        talk.hear(550, b"\x07V1013\r");
        assert_eq!(talk.pass(600), "");
        talk.hear(600, b"\x07V1013\r\x07");
        assert_eq!(talk.pass(700), "");
        talk.hear(700, b"V1013\r");
        assert_eq!(talk.pass(700), "N.");
        // The last of them may stay out.
        let mut talk = Talk::begin(settings);
        talk.said();
        talk.hear(5, b"\x07");
        assert_eq!(talk.pass(254), "");
        assert_eq!(talk.pass(255), "N.");
    }

    #[test]
    fn one_who_says_nothing_is_open_after_a_while() {
        let settings =
            SlcanSettings { bitrate: Some(125_000), listen_only: true, ..SlcanSettings::default() };
        let mut talk = Talk::begin(settings);
        assert_eq!(talk.said(), "C.V.");
        assert_eq!(talk.pass(1_199), "C.V.".repeat(5));
        assert_eq!(talk.pass(1_200), "S4.L.");
        assert_eq!(talk.exchange.status.link, Link::Up);
        // It is asked again now and then, and begins anew when it answers.
        assert_eq!(talk.pass(7_200), "F.F.");
        assert_eq!(talk.hear(7_300, b"\x07"), "C.V.");
        talk.hear(7_301, b"\r\r");
        assert_eq!(talk.pass(7_301), "N.");
    }

    #[test]
    fn one_who_stops_answering_is_away() {
        let mut talk = Talk::begin(SlcanSettings::default());
        talk.hear(1, b"\r\r");
        talk.pass(1);
        talk.hear(2, b"\r");
        talk.hear(3, b"\r");
        talk.pass(3);
        talk.hear(4, b"F00\r");
        assert_eq!(talk.exchange.broken, None);
        talk.pass(10_000);
        assert_eq!(talk.exchange.broken.as_ref().map(|away| away.link), Some(Link::Down));
    }

    #[test]
    fn one_that_was_switched_off_and_on_is_opened_again() {
        let mut talk = Talk::begin(SlcanSettings::default());
        talk.hear(1, b"\r\r");
        talk.pass(1);
        talk.hear(2, b"\r");
        talk.hear(3, b"\r");
        talk.pass(3);
        talk.hear(4, b"F00\r");
        assert_eq!(talk.pass(1_003), "F.");
        assert_eq!(talk.hear(1_005, b"\x07"), "C.V.");
    }

    #[test]
    fn error_passive_without_acknowledge_has_only_the_flags_due() {
        let mut talk = Talk::begin(SlcanSettings::default());
        talk.hear(1, b"\r\r");
        talk.pass(1);
        talk.hear(2, b"\r");
        talk.hear(3, b"\r");
        talk.pass(3);
        talk.hear(4, b"F20\r");
        talk.slcan.send(at(10), &Frame::classic(1, &[]), &mut talk.exchange);
        let end = talk.exchange.write(b"");
        talk.slcan.handle_written(at(10), end, &mut talk.exchange);
        talk.said();
        assert_eq!(talk.pass(1_002), "");
        assert_eq!(talk.slcan.poll_timeout(), Some(at(1_003)));
        assert_eq!((talk.exchange.frames.len(), talk.exchange.status.unconfirmed), (0, 1));
        // Error-active again: without acknowledgements the frame counts as sent.
        assert_eq!(talk.pass(1_003), "F.");
        talk.hear(1_004, b"F00\r");
        talk.pass(1_004);
        assert_eq!((talk.exchange.frames.len(), talk.exchange.status.unconfirmed), (1, 0));
    }

    #[test]
    fn any_bytes_at_any_time_are_taken() {
        for seed in 0..300 {
            let mut random = fastrand::Rng::with_seed(seed);
            let mut talk = Talk::begin(SlcanSettings::default());
            for step in 0..200 {
                let alphabet = b"\r\x07zZtTFVNs0123456789ab\xFF";
                let bytes: Vec<u8> = (0..random.usize(0..20))
                    .filter_map(|_| random.choice(alphabet).copied())
                    .collect();
                talk.hear(step * 50, &bytes);
                talk.slcan.send(at(step * 50), &Frame::classic(1, &[]), &mut talk.exchange);
                let end = talk.exchange.write(b"");
                talk.slcan.handle_written(at(step * 50), end, &mut talk.exchange);
                talk.pass(step * 50);
            }
            assert!(talk.exchange.status.unreadable > 0);
        }
    }
}
