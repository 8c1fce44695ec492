//! slcan protocol with one adapter: a state machine without I/O or clock.
//!
//! Some adapters respond to every command and frame, some only with their version, some not at all
//! (python-can at the other end of a pty, another descan). All are supported, with short timeouts:
//!
//! ```text
//! waking    C and V until a response: opening the port resets some boards
//! settling  until all responses to C and V arrived, so that later ones can be assigned
//! setting   N, S, Y, then O or L, each after the response to the one before
//! open      frames; F each second
//! ```
//!
//! With a bit rate that may be wrong it is opened by L, and by O after the first valid frame.

use super::line::{
    AdapterReply, Flags, LinePiece, LineSplitter, data_rate_code, encode, name, parse, rate_code,
};
use crate::bus::faults::{bus_off, no_response};
use crate::bus::remote::stream::{Protocol, ProtocolIo};
use crate::bus::remote::tx_echo::Confirmation;
use crate::bus::remote::{RemoteClock, TxEchoTracker};
use crate::diagnostic::Diagnostic;
use crate::frame::Frame;
use crate::status::{BusState, Link};
use crate::time::{Duration, Instant};

/// Period and end of the wake-up commands to an adapter that does not respond.
const WAKE_RETRY: Duration = Duration::from_millis(200);
const WAKE_TIMEOUT: Duration = Duration::from_millis(1_200);
/// Lines received after this time, without a response, come from an adapter that does not respond.
const UNSOLICITED_AFTER: Duration = Duration::from_millis(300);
/// How long the last responses to the wake-up commands may take.
const SETTLE_TIMEOUT: Duration = Duration::from_millis(250);
/// Timeout of a response. Lawicel's adapters respond within milliseconds.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(1);
/// The same for the serial number, which many adapters do not support.
const SERIAL_TIMEOUT: Duration = Duration::from_millis(300);
/// Timeout of the response to the first frame; without it, frames count as not confirmed.
const FIRST_ACK_TIMEOUT: Duration = Duration::from_millis(250);
/// Period of the requests for status flags.
const FLAGS_PERIOD: Duration = Duration::from_secs(1);
/// The same for an adapter that did not respond: it may have been slow to start.
const PROBE_PERIOD: Duration = Duration::from_secs(5);
/// Number of missing responses to `F` after which the adapter counts as disconnected, or as one
/// without status flags.
const MAX_MISSING_FLAGS: u32 = 3;
/// Number of malformed lines, without a readable one, after which the device is reported as not slcan.
const MAX_UNREADABLE_LINES: u64 = 10;
/// Longest version or serial number shown, in characters.
const MAX_NAME: usize = 60;

/// Settings with which the adapter is opened.
#[derive(Clone, Copy, Debug, Default)]
pub struct SlcanSettings {
    /// Bit/s; `None` keeps the adapter's present one.
    pub bitrate: Option<u32>,
    /// Bit/s of the FD data phase.
    pub data_bitrate: Option<u32>,
    /// `L` instead of `O`.
    pub listen_only: bool,
    /// `L` until a valid frame is received: the bit rate may be wrong.
    pub listens_first: bool,
}

/// State of the protocol with one adapter.
#[derive(Debug)]
pub struct Slcan {
    device: String,
    settings: SlcanSettings,
    stage: SlcanStage,
    splitter: LineSplitter,
    own: TxEchoTracker,
    flags: FlagPoll,
    stamps: Stamps,
    /// It responds to commands.
    responses: bool,
    /// It was already opened again because of a late response.
    reopened: bool,
    /// It reports the controller's state unsolicited, in more detail than by flags.
    reports_state: bool,
    /// Its controller is error-warning, error-passive or bus-off.
    is_troubled: bool,
    takes_fd: bool,
    /// It is listen-only until it receives a valid frame.
    is_listening: bool,
    version: Option<String>,
    serial: Option<String>,
    readable: u64,
    unreadable: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SlcanStage {
    Waking { since: Instant, last_attempt: Instant, attempts: u32 },
    Settling { until: Instant, missing: u32 },
    Setting { command: SetupCommand, until: Instant },
    Open,
}

/// The setup commands, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SetupCommand {
    Serial,
    Rate(u8),
    DataRate(u8),
    Open,
}

/// Requests for status flags.
#[derive(Clone, Copy, Debug, Default)]
struct FlagPoll {
    /// Not rejected.
    wanted: bool,
    /// Time of the next request.
    next: Instant,
    /// Time of the request without a response.
    requested: Option<Instant>,
    /// Number of missing responses in a row.
    missing: u32,
    /// The last response.
    last: Option<Flags>,
}

impl Slcan {
    /// Creates the protocol with the adapter at the serial port `device`.
    pub fn new(device: &str, settings: SlcanSettings) -> Self {
        Self {
            device: device.to_owned(),
            settings,
            stage: SlcanStage::Open,
            splitter: LineSplitter::default(),
            own: TxEchoTracker::new(Confirmation::Never, FIRST_ACK_TIMEOUT),
            flags: FlagPoll::default(),
            stamps: Stamps::default(),
            responses: false,
            reopened: false,
            reports_state: false,
            is_troubled: false,
            takes_fd: false,
            is_listening: settings.listens_first && !settings.listen_only,
            version: None,
            serial: None,
            readable: 0,
            unreadable: 0,
        }
    }

    // --- opening -----------------------------------------------------------------------------

    fn wake(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        self.responses = false;
        self.stage = SlcanStage::Waking { since: now, last_attempt: now, attempts: 1 };
        exchange.write(b"C\rV\r");
    }

    /// Handles input while waking or settling.
    fn process_while_waking(&mut self, now: Instant, reply: Option<&AdapterReply>, is_nack: bool) {
        let is_response = is_nack
            || matches!(
                reply,
                Some(AdapterReply::Ack | AdapterReply::Flags(_) | AdapterReply::Name(_))
            );
        match &mut self.stage {
            SlcanStage::Waking { attempts, .. } if is_response => {
                let missing = (2 * *attempts).saturating_sub(1);
                self.stage = SlcanStage::Settling { until: now + SETTLE_TIMEOUT, missing };
            }
            SlcanStage::Waking { since, .. } if now.since(*since) >= UNSOLICITED_AFTER => {
                // It sends lines, but does not respond.
                *since = now - WAKE_TIMEOUT;
            }
            SlcanStage::Settling { until, missing } if is_response => {
                *missing = missing.saturating_sub(1);
                *until = if *missing == 0 { now } else { now + SETTLE_TIMEOUT };
            }
            _ => {}
        }
        self.responses |= is_nack || reply == Some(&AdapterReply::Ack);
    }

    /// The next command after `done`, of those that are wanted.
    fn next_command(&self, done: Option<SetupCommand>) -> SetupCommand {
        let rate = self.settings.bitrate.and_then(rate_code).map(SetupCommand::Rate);
        let data_rate =
            self.settings.data_bitrate.and_then(data_rate_code).map(SetupCommand::DataRate);
        // An adapter that does not respond has no serial number to read.
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

    fn is_listen_only(&self) -> bool {
        self.settings.listen_only || self.is_listening
    }

    fn text(&self, command: SetupCommand) -> String {
        match command {
            SetupCommand::Serial => "N".to_owned(),
            SetupCommand::Rate(code) => format!("S{code}"),
            SetupCommand::DataRate(code) => format!("Y{code}"),
            SetupCommand::Open if self.is_listen_only() => "L".to_owned(),
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
                    if command == SetupCommand::Serial { SERIAL_TIMEOUT } else { RESPONSE_TIMEOUT };
                self.stage = SlcanStage::Setting { command, until: now + wait };
                return;
            }
            done = Some(command);
        }
    }

    fn handle_rejection(&mut self, now: Instant, command: SetupCommand, exchange: &mut ProtocolIo) {
        let text = self.text(command);
        let device = &self.device;
        let fault = match command {
            SetupCommand::Serial => return self.set(now, Some(command), exchange),
            SetupCommand::DataRate(_) => {
                self.takes_fd = false;
                return self.set(now, Some(command), exchange);
            }
            SetupCommand::Rate(_) => {
                let rate = self.settings.bitrate.unwrap_or_default();
                Diagnostic::new(format!("{device} rejects {rate} bit/s ({text})"))
                    .with_remedy("use another rate, or none to keep the adapter's")
            }
            SetupCommand::Open if self.is_listening => {
                Diagnostic::new(format!("{device} rejects listen-only ({text})"))
                    .with_remedy(format!("name its bit rate: descan slcan:{device}@500000"))
            }
            SetupCommand::Open if self.settings.listen_only => {
                Diagnostic::new(format!("{device} rejects listen-only ({text})"))
            }
            SetupCommand::Open => {
                Diagnostic::new(format!("{device} does not open the bus ({text})"))
                    .with_remedy("set a bit rate: @500000")
            }
        };
        exchange.disconnect(Link::Down, fault);
    }

    fn enter_open(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        self.stage = SlcanStage::Open;
        let confirmation = if self.responses { Confirmation::Unknown } else { Confirmation::Never };
        self.own.set_confirmation(confirmation);
        let next = if self.responses { now } else { now + FLAGS_PERIOD };
        self.flags = FlagPoll { wanted: true, next, ..FlagPoll::default() };
        self.is_troubled = false;
        let status = &mut exchange.status;
        status.link = Link::Up;
        status.state = BusState::Unknown;
        status.fault = None;
        status.bitrate = self.settings.bitrate;
        status.fd = self.takes_fd;
        status.data_bitrate = self.settings.data_bitrate.filter(|_| self.takes_fd);
        status.listen_only = self.is_listen_only();
        status.listens_first = self.is_listening;
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
        if self.is_listening {
            let rate = self.settings.bitrate.map_or("RATE".to_owned(), |rate| rate.to_string());
            let device = &self.device;
            parts.push(format!(
                "a device that is alone gets no ACK; for it: descan slcan:{device}@{rate}"
            ));
        }
        if self.settings.data_bitrate.is_some() && !self.takes_fd {
            parts.push("adapter does not support FD frames".to_owned());
        }
        parts.join("; ")
    }

    // --- receiving ---------------------------------------------------------------------------

    fn handle_reply(&mut self, now: Instant, reply: AdapterReply, exchange: &mut ProtocolIo) {
        self.readable += 1;
        exchange.status.unanswered = false;
        match reply {
            AdapterReply::Frame(frame, stamp) => {
                let time = stamp.map_or(now, |stamp| self.stamps.date(stamp, now));
                exchange.status.fd |= frame.is_fd;
                self.takes_fd |= frame.is_fd;
                exchange.frames.push(frame.with_time(time));
                if self.is_listening && self.stage == SlcanStage::Open {
                    self.open_to_send(now, exchange);
                }
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
            AdapterReply::Ack | AdapterReply::Command => {}
        }
    }

    fn take_flags(&mut self, flags: Flags, exchange: &mut ProtocolIo) {
        let was_overrun = self.flags.last.is_some_and(Flags::is_overrun);
        self.flags.requested = None;
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
        status.fault = match state {
            BusState::BusOff => Some(bus_off(
                &self.device,
                "check wiring and bit rate, then restart descan or the adapter",
            )),
            BusState::ErrorPassive => Some(
                Diagnostic::new(format!("{} is error-passive", self.device))
                    .with_remedy("check bit rate, wiring, termination and that another node is on"),
            ),
            _ => None,
        };
    }

    fn count_unreadable(&mut self, exchange: &mut ProtocolIo) {
        exchange.status.unreadable += 1;
        self.unreadable += 1;
        if self.readable == 0 && self.unreadable == MAX_UNREADABLE_LINES {
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
        let is_of_flags = self.flags.requested.is_some_and(|at| oldest.is_none_or(|own| at <= own));
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
            self.flags.requested = None;
        }
    }

    /// Opens the channel again to send: a valid frame shows that the bit rate is right.
    fn open_to_send(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        self.is_listening = false;
        if self.responses {
            return self.open_again(now, exchange);
        }
        // Its responses need not be waited for.
        exchange.write(b"C\r");
        self.set(now, None, exchange);
    }

    /// Opens the channel again at the first, late response of an adapter. Returns true if it does.
    fn restart_on_late_response(&mut self, now: Instant, exchange: &mut ProtocolIo) -> bool {
        if self.responses || self.reopened || self.stage != SlcanStage::Open {
            return false;
        }
        self.reopened = true;
        self.open_again(now, exchange);
        true
    }

    /// Starts again on the same stream. The link does not change, because it takes milliseconds.
    fn open_again(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        exchange.status.transmit_failures += self.own.clear();
        self.count_own(exchange);
        self.wake(now, exchange);
    }

    fn request_flags(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        if self.flags.requested.is_some() {
            self.flags.missing += 1;
            if self.flags.missing == MAX_MISSING_FLAGS && self.responses {
                if self.flags.last.is_some() {
                    return exchange.disconnect(Link::Down, no_response(&self.device));
                }
                self.flags.wanted = false;
                self.flags.requested = None;
                return;
            }
        }
        exchange.write(b"F\r");
        self.flags.requested = Some(now);
        self.flags.next = now + if self.responses { FLAGS_PERIOD } else { PROBE_PERIOD };
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
            let reply = match piece {
                LinePiece::Line(line) => match parse(line) {
                    // Some adapters respond to V with any text.
                    None if !is_open => name(line).map(AdapterReply::Name),
                    reply => reply,
                },
                LinePiece::Nack | LinePiece::Unreadable => None,
            };
            let is_nack = piece == LinePiece::Nack;
            if is_open
                && (is_nack || matches!(reply, Some(AdapterReply::Ack | AdapterReply::Flags(_))))
                && self.restart_on_late_response(now, exchange)
            {
                return;
            }
            match self.stage {
                SlcanStage::Open if is_nack => self.handle_nack(now, exchange),
                SlcanStage::Open if reply == Some(AdapterReply::Ack) => {
                    self.handle_ack(now, exchange);
                }
                SlcanStage::Open => {}
                SlcanStage::Setting { command, .. } if is_nack => {
                    self.handle_rejection(now, command, exchange);
                }
                SlcanStage::Setting { command, .. } => {
                    let is_name = matches!(reply, Some(AdapterReply::Name(_)));
                    if reply == Some(AdapterReply::Ack)
                        || command == SetupCommand::Serial && is_name
                    {
                        self.set(now, Some(command), exchange);
                    }
                }
                _ => self.process_while_waking(now, reply.as_ref(), is_nack),
            }
            match reply {
                Some(reply) => self.handle_reply(now, reply, exchange),
                None if !is_nack => self.count_unreadable(exchange),
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
            SlcanStage::Waking { since, .. } if now.since(since) >= WAKE_TIMEOUT => {
                self.set(now, None, exchange);
            }
            SlcanStage::Waking { since, last_attempt, attempts }
                if now.since(last_attempt) >= WAKE_RETRY =>
            {
                self.stage =
                    SlcanStage::Waking { since, last_attempt: now, attempts: attempts + 1 };
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
                self.request_flags(now, exchange);
            }
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        match self.stage {
            SlcanStage::Waking { since, last_attempt, .. } => {
                Some((since + WAKE_TIMEOUT).min(last_attempt + WAKE_RETRY))
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
        self.stage == SlcanStage::Open && !self.is_listening && self.own.has_room()
    }

    fn send(&mut self, _: Instant, frame: &Frame, exchange: &mut ProtocolIo) {
        let line = encode(frame).filter(|_| self.takes_fd || !frame.is_fd);
        let Some(line) = line else {
            exchange.status.transmit_failures += 1;
            if frame.is_fd {
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
        self.clock.local_time(self.millis * 1000, arrival)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::remote::stream::bench;

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

    struct SlcanTest {
        slcan: Slcan,
        exchange: ProtocolIo,
    }

    impl SlcanTest {
        fn begin(settings: SlcanSettings) -> Self {
            let mut test =
                Self { slcan: Slcan::new("dev", settings), exchange: ProtocolIo::default() };
            test.slcan.begin(at(0), &mut test.exchange);
            test
        }

        /// An adapter that responded to everything up to its status flags at 4 ms.
        fn opened() -> Self {
            let mut test = Self::begin(SlcanSettings::default());
            test.handle_reply(1, b"\r\r");
            test.pass(1);
            test.handle_reply(2, b"\r");
            test.handle_reply(3, b"\r");
            test.pass(3);
            test.handle_reply(4, b"F00\r");
            test
        }

        fn handle_reply(&mut self, millis: u64, bytes: &[u8]) -> String {
            self.slcan.handle_input(at(millis), bytes, &mut self.exchange);
            self.sent()
        }

        /// Lets time pass, by the dialogue's own deadlines.
        fn pass(&mut self, until: u64) -> String {
            bench::pass(&mut self.slcan, &mut self.exchange, at(until));
            self.sent()
        }

        fn sent(&mut self) -> String {
            String::from_utf8(self.exchange.take_output()).unwrap().replace('\r', ".")
        }
    }

    #[test]
    fn responding_adapter_is_set_up_step_by_step() {
        let settings = SlcanSettings { bitrate: Some(500_000), ..SlcanSettings::default() };
        let mut test = SlcanTest::begin(settings);
        assert_eq!(test.sent(), "C.V.");
        assert_eq!(test.handle_reply(3, b"\x07"), "");
        assert_eq!(test.handle_reply(5, b"V1013\r"), "");
        assert_eq!(test.pass(5), "N.");
        assert_eq!(test.handle_reply(7, b"NA123\r"), "S6.");
        assert_eq!(test.handle_reply(9, b"\r"), "O.");
        assert_eq!(test.handle_reply(11, b"\r"), "");
        assert_eq!(test.exchange.status.link, Link::Up);
        assert_eq!(test.exchange.status.note.as_deref(), Some("adapter: V1013 NA123"));
        assert_eq!(test.pass(11), "F.");
        test.handle_reply(13, b"F20\r");
        assert_eq!(test.exchange.status.state, BusState::ErrorPassive);
    }

    const LISTENS_FIRST: SlcanSettings = SlcanSettings {
        bitrate: Some(500_000),
        data_bitrate: None,
        listen_only: false,
        listens_first: true,
    };

    #[test]
    fn adapter_listens_until_a_valid_frame_and_is_opened_to_send() {
        let mut test = SlcanTest::begin(LISTENS_FIRST);
        test.handle_reply(1, b"\r\r");
        test.pass(1);
        test.handle_reply(2, b"\r");
        assert_eq!(test.handle_reply(3, b"\r"), "L.");
        test.handle_reply(4, b"\r");
        let status = &test.exchange.status;
        assert_eq!((status.link, status.listens_first, status.listen_only), (Link::Up, true, true));
        assert!(status.note.as_ref().is_some_and(|note| note.contains("@500000")), "{status:?}");
        assert!(!test.slcan.has_room());
        test.pass(4);
        // Neither flags nor what cannot be read are a frame.
        test.handle_reply(5, b"F00\rnonsense\r");
        assert!(test.exchange.status.listens_first);
        assert_eq!(test.handle_reply(6, b"T123456780\r"), "C.V.");
        assert_eq!(test.exchange.frames.len(), 1);
        assert_eq!(test.exchange.status.link, Link::Up, "the link stays");
        test.handle_reply(7, b"\r\r");
        assert_eq!(test.pass(7), "N.");
        test.handle_reply(8, b"\r");
        assert_eq!(test.handle_reply(9, b"\r"), "O.");
        test.handle_reply(10, b"\r");
        let status = &test.exchange.status;
        assert_eq!((status.listens_first, status.listen_only), (false, false));
        assert!(test.slcan.has_room());
    }

    #[test]
    fn adapter_without_responses_is_opened_to_send_at_once() {
        let mut test = SlcanTest::begin(LISTENS_FIRST);
        test.sent();
        assert!(test.pass(1_200).ends_with("S6.L."));
        assert_eq!(test.handle_reply(1_300, b"T123456780\r"), "C.S6.O.");
        assert!(!test.exchange.status.listens_first);
        assert_eq!(test.handle_reply(1_400, b"T123456780\r"), "");
    }

    #[test]
    fn adapter_without_listen_only_names_the_way_out() {
        let mut test = SlcanTest::begin(LISTENS_FIRST);
        test.handle_reply(1, b"\r\r");
        test.pass(1);
        test.handle_reply(2, b"\r");
        test.handle_reply(3, b"\r");
        test.handle_reply(4, b"\x07");
        let broken = test.exchange.broken.as_ref().map(|it| it.fault.to_string());
        let fault = "dev rejects listen-only (L); name its bit rate: descan slcan:dev@500000";
        assert_eq!(broken.as_deref(), Some(fault));
    }

    #[test]
    fn late_wake_responses_do_not_acknowledge_later_commands() {
        let settings = SlcanSettings { bitrate: Some(500_000), ..SlcanSettings::default() };
        let mut test = SlcanTest::begin(settings);
        test.sent();
        assert_eq!(test.pass(500), "C.V.C.V.");
        test.handle_reply(550, b"\x07V1013\r");
        assert_eq!(test.pass(600), "");
        test.handle_reply(600, b"\x07V1013\r\x07");
        assert_eq!(test.pass(700), "");
        test.handle_reply(700, b"V1013\r");
        assert_eq!(test.pass(700), "N.");
        // The last of them may stay out.
        let mut test = SlcanTest::begin(settings);
        test.sent();
        test.handle_reply(5, b"\x07");
        assert_eq!(test.pass(254), "");
        assert_eq!(test.pass(255), "N.");
    }

    #[test]
    fn silent_adapter_counts_as_open_after_timeout() {
        let settings =
            SlcanSettings { bitrate: Some(125_000), listen_only: true, ..SlcanSettings::default() };
        let mut test = SlcanTest::begin(settings);
        assert_eq!(test.sent(), "C.V.");
        assert_eq!(test.pass(1_199), "C.V.".repeat(5));
        assert_eq!(test.pass(1_200), "S4.L.");
        assert_eq!(test.exchange.status.link, Link::Up);
        // It is polled; a response restarts the dialogue.
        assert_eq!(test.pass(7_200), "F.F.");
        assert_eq!(test.handle_reply(7_300, b"\x07"), "C.V.");
        test.handle_reply(7_301, b"\r\r");
        assert_eq!(test.pass(7_301), "N.");
    }

    #[test]
    fn adapter_without_responses_is_unavailable() {
        let mut test = SlcanTest::opened();
        assert_eq!(test.exchange.broken, None);
        test.pass(10_000);
        assert_eq!(test.exchange.broken.as_ref().map(|away| away.link), Some(Link::Down));
    }

    #[test]
    fn restarted_adapter_is_opened_again() {
        let mut test = SlcanTest::opened();
        assert_eq!(test.pass(1_003), "F.");
        assert_eq!(test.handle_reply(1_005, b"\x07"), "C.V.");
    }

    #[test]
    fn error_passive_without_acknowledge_has_only_the_flags_due() {
        let mut test = SlcanTest::begin(SlcanSettings::default());
        test.handle_reply(1, b"\r\r");
        test.pass(1);
        test.handle_reply(2, b"\r");
        test.handle_reply(3, b"\r");
        test.pass(3);
        test.handle_reply(4, b"F20\r");
        test.slcan.send(at(10), &Frame::classic(1, &[]), &mut test.exchange);
        let end = test.exchange.write(b"");
        test.slcan.handle_written(at(10), end, &mut test.exchange);
        test.sent();
        assert_eq!(test.pass(1_002), "");
        assert_eq!(test.slcan.poll_timeout(), Some(at(1_003)));
        assert_eq!((test.exchange.frames.len(), test.exchange.status.unconfirmed), (0, 1));
        // Error-active again: without acknowledgements the frame counts as sent.
        assert_eq!(test.pass(1_003), "F.");
        test.handle_reply(1_004, b"F00\r");
        test.pass(1_004);
        assert_eq!((test.exchange.frames.len(), test.exchange.status.unconfirmed), (1, 0));
    }
}
