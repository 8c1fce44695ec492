//! Names of addresses and services, as they are printed: each is made once.
//!
//! Input: the buses as they are known. Output: texts, with the names of a frame's moment. Bounded: a
//! text for each address and each service of a bus. Does not know which frames are printed.

use super::frame_json::service_name_of;
use super::frame_text::{END, SERVICE, left, right, with_address};
use crate::app::{App, Bus, FrameRole};
use crate::discovery::OwnAddress;
use crate::frame::{BusIndex, Frame};
use crate::time::Instant;
use crate::wire::id::{Address, Header};
use std::ops::Range;

/// Number of service numbers.
const SERVICES: usize = 1024;

/// The sender or the receiver of frames.
#[derive(Clone, Debug)]
pub struct EndTexts {
    /// The moments for which they hold.
    times: Range<Instant>,
    /// Name and address in their column, as the sender and as the receiver.
    pub sender: String,
    /// As the receiver.
    pub receiver: String,
    /// The name as JSON; `null` if it is not known.
    pub json_name: String,
}

impl EndTexts {
    fn new(app: &App, bus: BusIndex, address: Address, time: Instant) -> Self {
        let names = app.bus(bus).map(Bus::names);
        let holders = names.map(|names| names.holders(address)).unwrap_or_default();
        let later = holders.partition_point(|holder| holder.since <= time);
        // The first holder that is kept holds all times before, too.
        let from = if later < 2 { Instant::ZERO } else { holders[later - 1].since };
        let until = holders.get(later.max(1)).map_or(Instant::from_micros(u64::MAX), |it| it.since);
        let name = names.and_then(|names| names.at(address, time)).map(ToString::to_string);
        let shown = with_address(&app.name_at(bus, address, time), address);
        let (mut sender, mut receiver) = (String::new(), String::new());
        right(&mut sender, &shown, END);
        left(&mut receiver, &shown, END);
        let json_name = serde_json::to_string(&name).unwrap_or_default();
        Self { times: from..until, sender, receiver, json_name }
    }
}

/// A service, or the number of a debug message.
#[derive(Clone, Debug)]
pub struct ServiceTexts {
    /// The name, else the number, in its column.
    pub column: String,
    /// The name as JSON; `null` without one.
    pub json_name: String,
}

impl ServiceTexts {
    fn new(app: &App, frame: &Frame, header: Header, role: FrameRole) -> Self {
        let (bus, number) = (frame.bus, header.service);
        let name = if role == FrameRole::Debug {
            let types = app.shown_buses().frame_types(Some(header), frame);
            types.debug_name(&app.profile(bus), number)
        } else {
            let server = if header.response { header.source } else { header.destination };
            let is_one = header.response || !header.broadcast;
            service_name_of(app, bus, number, is_one.then_some((server, frame.time)))
        };
        let mut column = String::new();
        left(&mut column, name.as_ref().unwrap_or(&number.to_string()), SERVICE);
        Self { column, json_name: serde_json::to_string(&name).unwrap_or_default() }
    }
}

/// Texts of one bus.
#[derive(Debug, Default)]
struct BusTexts {
    /// What they depend on: a number that changes with every name, and descan's own address.
    known: Option<(u64, OwnAddress)>,
    ends: Vec<Option<EndTexts>>,
    /// Of services, and of debug messages.
    services: Vec<Option<ServiceTexts>>,
    debug_messages: Vec<Option<ServiceTexts>>,
}

/// See the module's documentation.
#[derive(Debug, Default)]
pub struct KnownNames {
    buses: Vec<BusTexts>,
}

impl KnownNames {
    /// The texts of an address at a moment.
    pub fn end(&mut self, app: &App, bus: BusIndex, address: Address, time: Instant) -> &EndTexts {
        let texts = self.bus(bus);
        let known = app.bus(bus).map(|bus| (bus.names().revision(), bus.own_address()));
        if texts.known != known || texts.ends.is_empty() {
            texts.known = known;
            texts.ends = vec![None; Address::COUNT];
        }
        let end = &mut texts.ends[address.index()];
        if end.as_ref().is_some_and(|texts| !texts.times.contains(&time)) {
            *end = None;
        }
        end.get_or_insert_with(|| EndTexts::new(app, bus, address, time))
    }

    /// The texts of a service, or of the number of a debug message.
    pub fn service(
        &mut self,
        app: &App,
        frame: &Frame,
        header: Header,
        role: FrameRole,
    ) -> &ServiceTexts {
        let texts = self.bus(frame.bus);
        let is_debug = role == FrameRole::Debug;
        let all = if is_debug { &mut texts.debug_messages } else { &mut texts.services };
        if all.is_empty() {
            *all = vec![None; SERVICES];
        }
        let known = &mut all[usize::from(header.service.number()) % SERVICES];
        // By the catalogue a number has another name on another device.
        if !app.shown_buses().catalogue().is_empty() {
            *known = None;
        }
        known.get_or_insert_with(|| ServiceTexts::new(app, frame, header, role))
    }

    fn bus(&mut self, bus: BusIndex) -> &mut BusTexts {
        let at = usize::from(bus.0);
        if self.buses.len() <= at {
            self.buses.resize_with(at + 1, BusTexts::default);
        }
        &mut self.buses[at]
    }
}
