//! What descan knows of a bus, for other programs: a dissector for Wireshark, and a DBC file.
//!
//! Input: a profile and the catalogue. Output: the text of a file. Pure: opens and writes no files.

mod dbc;
mod wireshark;

pub use dbc::dbc;
pub use wireshark::dissector;

use crate::catalogue::Catalogue;
use crate::wire::profile::Profile;

/// What is exported.
#[derive(Clone, Copy, Debug)]
pub struct ExportFacts<'a> {
    /// The numbers and names of the platform.
    pub profile: &'a Profile,
    /// The types of devices.
    pub catalogue: &'a Catalogue,
}
