//! Inventories over an MQTT broker: what is published, what a viewer makes of it, and both at a real
//! broker.

mod broker;
mod expected;
mod publication;
mod published;
mod topics;
mod view;
