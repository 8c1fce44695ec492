//! The search for the service number of DES on a bus (see [`DesSearch`]): what forbids it, and its
//! requests.

use super::App;
use crate::discovery::{BusVerdict, OwnAddress};
use crate::frame::BusIndex;
use crate::learning::{DesSearch, SearchStop};
use crate::status::BusState;
use crate::time::Instant;
use crate::wire::id::{Address, Service};

/// A search on one of the buses.
#[derive(Debug)]
pub(super) struct BusSearch {
    bus: BusIndex,
    search: DesSearch,
}

impl App {
    /// The search that was started last.
    pub fn des_search(&self) -> Option<&DesSearch> {
        self.search.as_ref().map(|it| &it.search)
    }

    /// Why the service number of DES cannot be searched with this device; `None` if it can.
    pub fn search_obstacle(&self, bus: BusIndex, device: Address) -> Option<String> {
        let why = self.bus_forbids_search(bus);
        why.or_else(|| match self.profile_learner(bus)?.is_working(device) {
            None => Some(format!("no frame of a device at {device} was received")),
            Some(true) => {
                Some(format!("the device at {device} is working: set it to CFG or BOOT first"))
            }
            Some(false) => None,
        })
    }

    fn bus_forbids_search(&self, index: BusIndex) -> Option<String> {
        let bus = self.bus(index)?;
        if let Some(obstacle) = self.tx_obstacle(index, bus) {
            return Some(obstacle);
        }
        let Some(learner) = self.profile_learner(index) else {
            return Some("no frame was received".to_owned());
        };
        let others = learner.other_frames();
        if bus.traffic().verdict() == BusVerdict::Foreign || learner.is_foreign() {
            return Some("the bus speaks another protocol".to_owned());
        }
        if others > 0 {
            let frames = crate::text::counted(others, "frame");
            return Some(format!(
                "the bus carries other traffic: {frames} not of the CAN platform"
            ));
        }
        match (bus.own_address(), bus.controller().state) {
            (_, state @ (BusState::ErrorWarning | BusState::ErrorPassive)) => {
                Some(format!("the controller is {state}"))
            }
            (OwnAddress::Held(_), _) => None,
            _ => Some("descan has no address on this bus yet".to_owned()),
        }
    }

    /// Starts to search the service number of DES with this device, which may be in no working mode, from
    /// a service on.
    ///
    /// # Errors
    ///
    /// What forbids it.
    pub fn start_des_search(
        &mut self,
        bus: BusIndex,
        device: Address,
        from: Service,
    ) -> Result<(), String> {
        if let Some(why) = self.search_obstacle(bus, device) {
            return Err(why);
        }
        let is_ready = |index| {
            let (bus, learner) = (self.bus(index)?, self.profile_learner(index)?);
            let OwnAddress::Held(own) = bus.own_address() else { return None };
            let config = bus.config();
            let share = config.steady_budget * f64::from(config.bits_per_second());
            let now = self.clock.now();
            let is_other = |service| service < from || learner.is_unsolicited_service(service);
            Some(DesSearch::new(now, (own, device), share, is_other))
        };
        let search = is_ready(bus).ok_or("descan has no address on this bus")?;
        self.search = Some(Box::new(BusSearch { bus, search }));
        Ok(())
    }

    /// Sends what is due, and stops if something forbids to go on.
    pub(super) fn step_des_search(&mut self, now: Instant) {
        let Some(mut it) = self.search.take() else { return };
        if it.search.end().is_none() {
            if let Some(why) = self.bus_forbids_search(it.bus) {
                it.search.stop(SearchStop::Obstacle(why));
            } else if let Some(frame) = it.search.poll_transmit(now) {
                self.buses.send(now, frame.with_bus(it.bus));
            }
        }
        self.search = Some(it);
    }

    /// Passes a frame to the search on its bus.
    pub(super) fn note_for_search(&mut self, frame: &crate::frame::Frame) {
        if let Some(it) = self.search.as_mut().filter(|it| it.bus == frame.bus) {
            it.search.handle_frame(frame);
        }
    }

    /// Returns when the search is due.
    pub(super) fn search_timeout(&self) -> Option<Instant> {
        self.search.as_ref()?.search.poll_timeout()
    }
}
