//! Pages, filters, orders and selections: one set for all gateways, one for the opened one.
//!
//! Does not know rows, but by their keys.

use super::rows::FleetRowKey;
use crate::app::filter::{Filter, FilterError, RowKind};

/// A page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FleetPage {
    /// The gateways; of an opened gateway its devices.
    #[default]
    Main,
    /// Versions of services in use.
    Versions,
    /// Problems.
    Problems,
}

impl FleetPage {
    /// All pages, in their order.
    pub const ALL: [FleetPage; 3] = [Self::Main, Self::Versions, Self::Problems];

    /// Name of the page.
    pub const fn title(self, is_opened: bool) -> &'static str {
        match (self, is_opened) {
            (Self::Main, false) => "Gateways",
            (Self::Main, true) => "Devices",
            (Self::Versions, _) => "Versions",
            (Self::Problems, _) => "Problems",
        }
    }

    /// What its rows are.
    pub const fn row_kind(self, is_opened: bool) -> RowKind {
        match (self, is_opened) {
            (Self::Main, false) => RowKind::Gateway,
            (Self::Main, true) => RowKind::Device,
            (Self::Versions, _) => RowKind::Version,
            (Self::Problems, _) => RowKind::Finding,
        }
    }

    /// Orders of its rows, the usual one first.
    pub const fn sorts(self, is_opened: bool) -> &'static [FleetSort] {
        use FleetSort as S;
        match (self, is_opened) {
            (Self::Main, false) => {
                &[S::Severity, S::Name, S::Devices, S::Lost, S::Problems, S::Version]
            }
            (Self::Main, true) => &[S::Severity, S::Address, S::Name],
            (Self::Versions, false) => &[S::Severity, S::Devices, S::Gateways],
            (Self::Versions, true) => &[S::Severity, S::Devices],
            (Self::Problems, _) => &[S::Severity, S::Name],
        }
    }
}

/// Order of rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FleetSort {
    /// The worst first, then by name; versions by service and version.
    #[default]
    Severity,
    /// By name of the gateway or device.
    Name,
    /// By bus and address.
    Address,
    /// By number of present devices, most first.
    Devices,
    /// By number of lost devices, most first.
    Lost,
    /// By number of findings, most first.
    Problems,
    /// By version of descan, the oldest first.
    Version,
    /// By number of gateways, fewest first.
    Gateways,
}

impl FleetSort {
    /// Words for a message.
    pub const fn words(self, page: FleetPage) -> &'static str {
        match self {
            Self::Severity if matches!(page, FleetPage::Versions) => "by service",
            Self::Severity => "by severity",
            Self::Name => "by name",
            Self::Address => "by address",
            Self::Devices => "by present devices",
            Self::Lost => "by lost devices",
            Self::Problems => "by problems",
            Self::Version => "by version of descan",
            Self::Gateways => "by gateways, fewest first",
        }
    }
}

/// The filter of a page.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FleetFilter {
    /// The line.
    pub text: String,
    /// It is not switched off.
    pub is_on: bool,
    filter: Filter,
    /// Changes with the filter.
    pub(super) revision: u64,
}

impl FleetFilter {
    /// Sets the line.
    ///
    /// # Errors
    /// The first mistake; all rows are shown then.
    pub(super) fn set(&mut self, text: &str, rows: RowKind) -> Result<(), FilterError> {
        let parsed = Filter::parse(text, rows);
        self.revision += 1;
        match parsed {
            Ok(filter) => {
                self.is_on = !filter.is_empty();
                self.filter = filter;
                text.clone_into(&mut self.text);
                Ok(())
            }
            Err(error) => {
                self.is_on = false;
                Err(error)
            }
        }
    }

    /// Switches it off, or on again; returns false without a filter.
    pub(super) fn toggle(&mut self) -> bool {
        if self.filter.is_empty() {
            return false;
        }
        self.is_on = !self.is_on;
        self.revision += 1;
        true
    }

    /// The filter, while it is on.
    pub fn active(&self) -> Option<&Filter> {
        self.is_on.then_some(&self.filter)
    }
}

/// The list of a page.
#[derive(Clone, Debug, Default)]
pub(super) struct FleetList {
    /// The selected row, and its place.
    pub key: Option<FleetRowKey>,
    pub at: usize,
    /// First row on the screen, as of the last move.
    pub first: usize,
    pub filter: FleetFilter,
    pub sort: FleetSort,
    pub is_reversed: bool,
}

impl FleetList {
    /// First row on a screen of `height` rows that has the selected one.
    pub fn top(&self, count: usize, height: usize) -> usize {
        let most = count.saturating_sub(height);
        let lowest = (self.at + 1).saturating_sub(height);
        self.first.clamp(lowest.min(most), self.at.max(lowest)).min(most)
    }
}

/// The pages of all gateways, or of the opened one.
#[derive(Clone, Debug, Default)]
pub(super) struct FleetScope {
    pub page: FleetPage,
    lists: [FleetList; 3],
    /// The details take the place of the list.
    pub has_details_alone: bool,
    pub details_scroll: u16,
}

impl FleetScope {
    /// The list of the open page.
    pub fn list(&self) -> &FleetList {
        &self.lists[self.page as usize]
    }

    pub fn list_mut(&mut self) -> &mut FleetList {
        &mut self.lists[self.page as usize]
    }

    /// The list of a page.
    pub fn list_of_mut(&mut self, page: FleetPage) -> &mut FleetList {
        &mut self.lists[page as usize]
    }
}
