//! Finds a bus's bit rate: sets one after the other, and listens.
//!
//! When it is given up half-way, the bus is as it was before.

use crate::bus::{self, BusSpec, Clock, Options, TuneError, Tuner};
use crate::frame::{BusIndex, Frame};
use crate::speed::{Heard, Manner, Outcome, RATES, Search};
use crate::status::Link;
use crate::time::Duration;
use tokio::time::sleep;

/// How long a bus may take from when it was set to when it is open.
const OPENING: Duration = Duration::from_secs(3);

/// What is going on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// At this rate, in bit/s, we listen now.
    Trying(u32),
    /// This was heard there, and no frame that arrived whole.
    Heard(u32, Heard),
    /// The controller cannot have this rate.
    Skipped(u32),
}

/// What was found, and what was heard at each rate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// How it ended.
    pub outcome: Outcome,
    /// The rates that were tried, in bit/s.
    pub tried: Vec<(u32, Heard)>,
}

/// Where to begin, and how.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// The rate to begin with, in bit/s; otherwise the one that is set, or the lowest.
    pub first: Option<u32>,
    /// Whether we take part.
    pub manner: Manner,
    /// BUS_CFG_HR_TIME.
    pub period: Duration,
}

/// Looks for the rate. Where it is found the bus keeps it and takes part; otherwise it is put back
/// to how it was. May be dropped while waiting.
pub async fn find(
    bus: &BusSpec,
    plan: Plan,
    mut told: impl FnMut(Progress),
) -> Result<Report, TuneError> {
    let mut tuner = Tuner::of(bus)?;
    let first = plan.first.or(tuner.found_at()).unwrap_or(RATES[0]);
    let mut search = Search::new(first, plan.period);
    let clock = Clock::start();
    let mut heard: Vec<Frame> = Vec::new();
    while search.outcome().is_none() {
        let rate = search.rate();
        let bus = match tuner.set(rate, plan.manner) {
            Ok(bus) => bus,
            Err(TuneError::NotThisRate { .. }) => {
                told(Progress::Skipped(rate));
                search.skip();
                continue;
            }
            Err(error) => return Err(error),
        };
        told(Progress::Trying(rate));
        let options = Options { listen_only: plan.manner == Manner::Listening };
        let port = bus::open(&bus, BusIndex(0), clock.clone(), options)
            .map_err(|error| TuneError::NotThere(error.to_string()))?;
        let opened = clock.now();
        loop {
            let (now, status) = (clock.now(), port.queue().status());
            port.queue().take_status();
            if search.wants_rate() && status.link == Link::Up {
                search.begin(now);
            } else if search.wants_rate() && now.since(opened) > OPENING {
                let why = status.message.unwrap_or_else(|| format!("{bus} does not open"));
                return Err(TuneError::NotThere(why));
            }
            heard.clear();
            port.queue().drain(&mut heard, usize::MAX);
            for frame in &heard {
                search.handle_frame(frame);
            }
            search.handle_timeout(now);
            if search.rate() != rate || search.outcome().is_some() {
                break;
            }
            let due = search.poll_timeout().unwrap_or(opened + OPENING + Duration::from_millis(1));
            tokio::select! {
                () = port.queue().ready() => {}
                () = sleep(due.since(now).max(Duration::from_millis(1))) => {}
            }
        }
        if search.outcome() != Some(Outcome::Found(rate))
            && let Some((_, heard)) = search.tried().iter().find(|(tried, _)| *tried == rate)
        {
            told(Progress::Heard(rate, *heard));
        }
    }
    let outcome = search.outcome().unwrap_or(Outcome::Silence);
    match outcome {
        Outcome::Found(rate) => tuner.keep(rate)?,
        Outcome::OnlyBroken | Outcome::Silence => tuner.restore()?,
    }
    Ok(Report { outcome, tried: search.tried().to_vec() })
}
