//! The search for the service number of DES: name requests to one device, one service after the
//! other, until it answers one.
//!
//! A state machine without I/O and without a clock. A request to an unknown service may be a command:
//! the caller asks the user, and begins only with a device that is not working. Each number is asked
//! once in each framing; a response with ERR = 0 says that the device does not know the service.

use crate::frame::{Frame, FrameKind};
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::{Framing, classify_response};
use crate::wire::id::{Address, Header, Service};
use crate::wire::profile::Profile;

/// Time from one request to the next. Chosen: a device responds within some milliseconds, and 2046
/// requests take two minutes.
const INTERVAL: Duration = Duration::from_millis(60);
/// Time after the last request in which its response may come.
const LAST_WAIT: Duration = Duration::from_secs(1);

/// How a search ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SearchEnd {
    /// The device answered a request to this service.
    Answered {
        /// The service.
        service: Service,
        /// The first frame of the answer is one of DES.
        is_des: bool,
    },
    /// It answered none.
    Exhausted,
    /// Something that forbids to go on.
    Stopped(SearchStop),
}

/// Why a search was stopped.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SearchStop {
    /// The device is in a working mode.
    #[error("the device began to work")]
    Working,
    /// The bus carries frames that are not of the CAN platform.
    #[error("the bus carries other traffic: {0}")]
    OtherTraffic(Frame),
    /// Requests cannot be sent: the cause.
    #[error("{0}")]
    Obstacle(String),
}

/// A search on one bus.
#[derive(Clone, Debug)]
pub struct DesSearch {
    own: Address,
    device: Address,
    interval: Duration,
    services: Vec<Service>,
    /// Number of requests sent: two for each service.
    sent: usize,
    next: Instant,
    end: Option<SearchEnd>,
}

impl DesSearch {
    /// Creates a search that begins at `now`. `share`: bits per second that the requests may take;
    /// `is_other`: services that are known to be others.
    pub fn new(
        now: Instant,
        (own, device): (Address, Address),
        share: f64,
        is_other: impl Fn(Service) -> bool,
    ) -> Self {
        let all = (0..=Service::MAX).map(Service::from_bits).filter(|service| !is_other(*service));
        // The longest request, and a response as long.
        let bits = 2.0 * f64::from(67 + 8 * 5) * 1.1;
        let least = Duration::from_micros((bits / share.max(1.0) * 1e6) as u64);
        let interval = INTERVAL.max(least);
        Self { own, device, interval, services: all.collect(), sent: 0, next: now, end: None }
    }

    /// Returns how it ended; `None` while it goes on.
    pub fn end(&self) -> Option<&SearchEnd> {
        self.end.as_ref()
    }

    /// Number of requests sent, and of all.
    pub fn progress(&self) -> (usize, usize) {
        (self.sent, 2 * self.services.len())
    }

    /// Ends it.
    pub fn stop(&mut self, why: SearchStop) {
        self.end.get_or_insert(SearchEnd::Stopped(why));
    }

    /// Takes a frame of the bus.
    pub fn handle_frame(&mut self, frame: &Frame) {
        if frame.kind == FrameKind::Error || self.end.is_some() {
            return;
        }
        let header = frame.platform_id().map(Header::decode).filter(|it| it.is_conforming());
        let Some(header) = header else {
            return self.stop(SearchStop::OtherTraffic(*frame));
        };
        if header.source != self.device || frame.is_tx {
            return;
        }
        if !header.from_non_working {
            return self.stop(SearchStop::Working);
        }
        let is_for_us = header.destination == self.own || header.destination == self.device;
        let asked = self.services.iter().take(self.sent.div_ceil(2));
        let is_answer = header.response
            && !header.broadcast
            && header.no_error
            && is_for_us
            && asked.into_iter().any(|service| *service == header.service);
        if is_answer {
            let is_des = classify_response(frame.data(), frame.is_fd, false).is_some();
            self.end = Some(SearchEnd::Answered { service: header.service, is_des });
        }
    }

    /// Returns the next request, if it is due.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        if self.end.is_some() || now < self.next {
            return None;
        }
        let Some(service) = self.services.get(self.sent / 2) else {
            self.end = Some(SearchEnd::Exhausted);
            return None;
        };
        let framing = [Framing::Isotp, Framing::Raw][self.sent % 2];
        let (data, len) = Profile::request_bytes(Request::Name, framing);
        let header = Header::request(self.own, self.device, true, *service);
        self.sent += 1;
        let is_last = self.sent == 2 * self.services.len();
        self.next = now + if is_last { LAST_WAIT } else { self.interval };
        Some(Frame::classic(header.encode(), &data[..len]))
    }

    /// Returns when to call [`DesSearch::poll_transmit`] next; `None` once it ended.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.end.is_none().then_some(self.next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: Address = Address::DEBUG;

    fn device() -> Address {
        Address::new(10).unwrap()
    }

    /// A search of services 3 and 4 that has sent so many requests.
    fn search(requests: usize) -> DesSearch {
        let only = |service: Service| !(3..5).contains(&service.number());
        let mut search = DesSearch::new(Instant::ZERO, (OWN, device()), 6_250.0, only);
        for _ in 0..requests {
            let now = search.poll_timeout().unwrap();
            search.poll_transmit(now).expect("a request");
        }
        search
    }

    fn response(service: u16, error: bool) -> Header {
        let service = Service::from_bits(service);
        let response = Header::request(OWN, device(), true, service).response(device(), true);
        Header { no_error: !error, ..response }
    }

    #[test]
    fn each_service_is_asked_once_in_each_framing() {
        let mut search = search(0);
        let mut sent = Vec::new();
        while let Some(now) = search.poll_timeout() {
            if let Some(frame) = search.poll_transmit(now) {
                let header = Header::decode(frame.platform_id().unwrap());
                assert!(header.to_non_working && !header.broadcast && !header.response);
                sent.push((header.service.number(), frame.len()));
            }
        }
        assert_eq!(sent, [(3, 5), (3, 4), (4, 5), (4, 4)]);
        assert_eq!(search.end(), Some(&SearchEnd::Exhausted));
    }

    #[test]
    fn first_answer_ends_it() {
        for (data, is_des) in [(&b"\x06\x01FEED\0"[..], true), (&[], false), (&[9], false)] {
            let mut search = search(2);
            search.handle_frame(&Frame::classic(response(3, false).encode(), data));
            let service = Service::from_bits(3);
            assert_eq!(search.end(), Some(&SearchEnd::Answered { service, is_des }));
            assert_eq!(
                (search.poll_timeout(), search.poll_transmit(Instant::LATEST)),
                (None, None)
            );
        }
    }

    #[test]
    fn refusals_and_frames_of_others_do_not_end_it() {
        let mut search = search(2);
        let other = Header { source: Address::new(11).unwrap(), ..response(3, false) };
        let beat = Header::unsolicited(device(), 9, true, Service::from_bits(1));
        // To a service that was not asked yet, and to another requester.
        let early = response(4, false);
        let foreign = Header { destination: Address::new(55).unwrap(), ..response(3, false) };
        for header in [response(3, true), other, beat, early, foreign] {
            search.handle_frame(&Frame::classic(header.encode(), &[1]));
        }
        assert_eq!(search.end(), None);
    }

    #[test]
    fn working_device_and_other_traffic_stop_it() {
        let mut working = search(1);
        let beat = Header::unsolicited(device(), 9, false, Service::from_bits(1));
        working.handle_frame(&Frame::classic(beat.encode(), &[]));
        assert_eq!(working.end(), Some(&SearchEnd::Stopped(SearchStop::Working)));
        let mut other = search(1);
        let frame = Frame::new(crate::frame::CanId::Standard(0x123), &[1]);
        other.handle_frame(&frame);
        let end = SearchEnd::Stopped(SearchStop::OtherTraffic(frame));
        assert_eq!(other.end(), Some(&end));
    }
}
