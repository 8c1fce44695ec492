//! Inventories of many gateways over an MQTT broker.
//!
//! A gateway is a descan that publishes what it knows of its buses ([`Publication`]): retained
//! documents for the state of gateway, buses, devices and findings, and messages for events. A viewer
//! ([`Fleet`]) reads the documents of all gateways, and compares each with its des.json. [`FleetTopic`] has the topics of both. Pure: does
//! not know the connection, TLS or a clock. Nothing here is ever sent to a bus.

mod expected;
mod publication;
mod rejects;
mod topic;
mod view;

pub use expected::{ExpectedDevices, ExpectedGateway, FleetDifference};
pub use publication::{
    FleetDocument, FleetMessage, FleetMessageId, MAX_QUEUED_EVENTS, MessageLength, OtherRun,
    Publication,
};
pub use rejects::FleetRejects;
pub use topic::{FleetTopic, GatewayName, GatewayNameError, TopicPath};
pub use view::{
    EventCounts, Fleet, FleetGateway, GatewayState, GatewayStatus, MAX_DOCUMENT_BYTES,
    MAX_GATEWAY_DOCUMENTS, MAX_GATEWAYS, ServiceVersion,
};
