//! Bit rate search on a bus: sets one rate after the other and receives. Alone, or beside a
//! session.
//!
//! A search that is dropped restores the previous setting. Does not evaluate what is received: see
//! [`crate::bitrate`].

use crate::bitrate::{ListenMode, RATES, RateResult, Search, SearchOutcome, SearchProgress};
use crate::bus::{self, BitRateSetter, BusSpec, Clock, Options, TuneError};
use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, Frame};
use crate::status::Link;
use crate::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::sleep;

/// Longest time from setting a rate until the bus is open.
const OPENING: Duration = Duration::from_secs(3);

/// Capacity of the channel: two messages for each rate, and the result.
const MAX_NEWS: usize = 16;

/// Result of a search.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SearchReport {
    /// How it ended.
    pub outcome: SearchOutcome,
    /// The rates tried, in bit/s, with what was received at each.
    pub tried: Vec<(u32, RateResult)>,
}

/// How a search is done.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// The rate to begin with, in bit/s; otherwise the one that is set, or the lowest.
    pub first: Option<u32>,
    /// Listen-only or active.
    pub manner: ListenMode,
    /// Heartbeat period (BUS_CFG_HR_TIME).
    pub period: Duration,
}

/// Searches the bit rate. The bus keeps a rate that is found; otherwise the previous setting is
/// restored. May be dropped while waiting.
///
/// # Errors
/// The rate cannot be set, or the bus cannot be opened.
pub async fn find(
    bus: &BusSpec,
    plan: Plan,
    mut told: impl FnMut(SearchProgress),
) -> Result<SearchReport, TuneError> {
    let mut tuner = BitRateSetter::of(bus)?;
    let first = plan.first.or(tuner.found_at()).unwrap_or(RATES[0]);
    let mut search = Search::new(first, plan.period);
    let clock = Clock::start();
    let mut heard: Vec<Frame> = Vec::new();
    while search.outcome().is_none() {
        let rate = search.rate();
        let bus = match tuner.set(rate, plan.manner) {
            Ok(bus) => bus,
            Err(TuneError::NotThisRate(_)) => {
                told(SearchProgress::Skipped(rate));
                search.skip();
                continue;
            }
            Err(error) => return Err(error),
        };
        told(SearchProgress::Trying(rate));
        let options =
            Options { listen_only: plan.manner == ListenMode::ListenOnly, ..Options::default() };
        let port = bus::open(&bus, BusIndex(0), clock.clone(), options)?;
        let opened = clock.now();
        loop {
            let (now, status) = (clock.now(), port.queue().status());
            port.queue().take_status();
            if search.wants_rate() && status.link == Link::Up {
                search.begin(now);
            } else if search.wants_rate() && now.since(opened) > OPENING {
                let unknown = || Diagnostic::new(format!("{bus} cannot be opened"));
                return Err(status.fault.unwrap_or_else(unknown).into());
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
        if search.outcome() != Some(SearchOutcome::Found(rate))
            && let Some((_, heard)) = search.tried().iter().find(|(tried, _)| *tried == rate)
        {
            told(SearchProgress::NothingValid(rate, *heard));
        }
    }
    let outcome = search.outcome().unwrap_or(SearchOutcome::NoTraffic);
    match outcome {
        SearchOutcome::Found(rate) => tuner.keep(rate)?,
        SearchOutcome::OnlyBusErrors | SearchOutcome::NoTraffic => tuner.restore()?,
    }
    Ok(SearchReport { outcome, tried: search.tried().to_vec() })
}

/// Message of a search beside a session.
#[derive(Debug)]
pub enum SearchNews {
    /// A step.
    Progress(SearchProgress),
    /// The result.
    Over(Result<SearchOutcome, String>),
}

/// A search beside a session. Dropping it stops the search.
#[derive(Debug)]
pub struct RunningSearch {
    /// Index of the bus in the session.
    pub bus: BusIndex,
    news: mpsc::Receiver<SearchNews>,
    task: JoinHandle<()>,
}

impl RunningSearch {
    /// Starts a search on the session's runtime.
    pub fn begin(bus: BusIndex, name: &str, period: Duration) -> Self {
        let (told, news) = mpsc::channel(MAX_NEWS);
        let spec = name.parse::<BusSpec>();
        let task = tokio::spawn(async move {
            let result = match spec {
                Ok(bus) => {
                    let plan = Plan { first: None, manner: ListenMode::ListenOnly, period };
                    let report = find(&bus, plan, |progress| {
                        // The channel has room for all rates.
                        let _ = told.try_send(SearchNews::Progress(progress));
                    });
                    report.await.map(|report| report.outcome).map_err(|error| error.to_string())
                }
                Err(error) => Err(error.to_string()),
            };
            let _ = told.send(SearchNews::Over(result)).await;
        });
        Self { bus, news, task }
    }

    /// Waits for the next message. May be dropped while waiting.
    pub async fn next(&mut self) -> SearchNews {
        let broken = || SearchNews::Over(Err("the bit rate search stopped".to_owned()));
        self.news.recv().await.unwrap_or_else(broken)
    }
}

impl Drop for RunningSearch {
    fn drop(&mut self) {
        self.task.abort();
    }
}
