//! Columns of the list of devices: which of them fit, and their widths.
//!
//! Input: the width of the list, and the widest texts. Columns give way in this order: SERVICES,
//! SEEN, VERSIONS, jitter, period, miss, the text of FILE, HEARTBEAT, MODE, UID, BUS; without
//! HEARTBEAT the text of FILE is back as long as it fits.

use crate::app::SortBy;

/// A column of the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    Bus,
    Address,
    Name,
    Uid,
    State,
    Mode,
    Strip,
    Period,
    Jitter,
    Missed,
    Versions,
    File,
    Seen,
    Services,
}

use Column as C;

/// Cells in front of the first column: selection, state sign, blank.
pub const SIGNS: usize = 3;
/// Cells of FILE, and of its short form: sign and address.
const FILE: usize = 8;
const SHORT_FILE: usize = 5;
/// Cells of NAME: as many as are left, within this range; of more than the second only where all
/// other columns have theirs.
const NAME: [usize; 3] = [8, 9, 20];
/// Least and most cells of VERSIONS and of SERVICES.
const VERSIONS: [usize; 2] = [12, 40];
const SERVICES: [usize; 2] = [12, 40];
/// Cells of VERSIONS from which other columns get what is left.
const GOOD_VERSIONS: usize = 20;

impl Column {
    const ALL: [Column; 14] = [
        C::Bus,
        C::Address,
        C::Name,
        C::Uid,
        C::State,
        C::Mode,
        C::Strip,
        C::Period,
        C::Jitter,
        C::Missed,
        C::Versions,
        C::File,
        C::Seen,
        C::Services,
    ];

    /// Heading. Those of statistics are small, as they are in the details.
    pub const fn title(self) -> &'static str {
        match self {
            C::Bus => "BUS",
            C::Address => "ADDR",
            C::Name => "NAME",
            C::Uid => "UID",
            C::State => "STATE",
            C::Mode => "MODE",
            C::Strip => "HEARTBEAT",
            C::Period => "period",
            C::Jitter => "jitter",
            C::Missed => "miss",
            C::Versions => "VERSIONS",
            C::File => "FILE",
            C::Seen => "SEEN",
            C::Services => "SERVICES",
        }
    }

    /// Returns true if the column is aligned to the right.
    pub const fn is_number(self) -> bool {
        matches!(self, C::Address | C::Period | C::Missed)
    }

    /// The sort order that marks this column; `None`: rows cannot be sorted by it.
    pub const fn sorted_by(self) -> Option<SortBy> {
        match self {
            C::Address => Some(SortBy::Address),
            C::Name => Some(SortBy::Name),
            C::Uid => Some(SortBy::Uid),
            C::State => Some(SortBy::State),
            C::Mode => Some(SortBy::Mode),
            C::Period => Some(SortBy::Period),
            C::Jitter => Some(SortBy::Jitter),
            C::Missed => Some(SortBy::Missed),
            C::Versions => Some(SortBy::Versions),
            C::File => Some(SortBy::File),
            C::Seen => Some(SortBy::Seen),
            C::Services => Some(SortBy::Services),
            C::Bus | C::Strip => None,
        }
    }
}

/// The widest texts of columns that take what they need.
#[derive(Clone, Copy, Debug, Default)]
pub struct Widest {
    /// Label of a bus; 0 with a single bus: no column.
    pub bus: usize,
    /// Address.
    pub address: usize,
    /// Name, with the sign of a twin.
    pub name: usize,
}

/// The columns that fit, and their widths. One blank is between two columns.
#[derive(Clone, Debug)]
pub struct Columns {
    /// The columns from left to right.
    pub shown: Vec<(Column, usize)>,
}

impl Columns {
    /// Fits the columns into `width` cells.
    pub fn new(width: usize, widest: Widest) -> Self {
        let least = |column: Column| match column {
            C::Bus => widest.bus.max(3),
            C::Address => widest.address.max(4),
            C::Name => NAME[0].max(widest.name.min(NAME[1])),
            C::Uid | C::State => 8,
            C::Mode | C::Missed => 5,
            C::Strip => 10,
            C::Period | C::Jitter => 7,
            C::Versions => VERSIONS[0],
            C::File => FILE,
            C::Seen => 15,
            C::Services => SERVICES[0],
        };
        let mut columns: Vec<(Column, usize)> = Column::ALL
            .into_iter()
            .filter(|column| *column != C::Bus || widest.bus > 0)
            .map(|column| (column, least(column)))
            .collect();
        let used = |columns: &[(Column, usize)]| {
            let cells: usize = columns.iter().map(|(_, width)| width + 1).sum();
            SIGNS + cells.saturating_sub(1)
        };
        let set = |columns: &mut Vec<(Column, usize)>, column: Column, width: usize| {
            if let Some(it) = columns.iter_mut().find(|(other, _)| *other == column) {
                it.1 = width;
            }
        };
        let drops = [C::Services, C::Seen, C::Versions, C::Jitter, C::Period, C::Missed];
        for column in drops {
            if used(&columns) > width {
                columns.retain(|(other, _)| *other != column);
            }
        }
        if used(&columns) > width {
            set(&mut columns, C::File, SHORT_FILE);
        }
        if used(&columns) > width {
            columns.retain(|(other, _)| *other != C::Strip);
            set(&mut columns, C::File, FILE);
        }
        for column in [C::Mode, C::Uid] {
            if used(&columns) > width {
                columns.retain(|(other, _)| *other != column);
            }
        }
        if used(&columns) > width {
            set(&mut columns, C::File, SHORT_FILE);
        }
        if used(&columns) > width {
            set(&mut columns, C::Name, NAME[0]);
        }
        if used(&columns) > width {
            columns.retain(|(other, _)| *other != C::Bus);
        }
        let mut left = width.saturating_sub(used(&columns));
        let mut grow = |column: Column, most: usize| {
            if let Some(it) = columns.iter_mut().find(|(other, _)| *other == column) {
                let more = most.saturating_sub(it.1).min(left);
                it.1 += more;
                left -= more;
            }
        };
        grow(C::Name, widest.name.min(NAME[1]));
        grow(C::Versions, GOOD_VERSIONS);
        grow(C::Name, widest.name.min(NAME[2]));
        grow(C::Services, SERVICES[1]);
        grow(C::Versions, VERSIONS[1]);
        Self { shown: columns }
    }

    /// First cell of a column, counted from the left of the list.
    pub fn start(&self, column: Column) -> usize {
        let before = self.shown.iter().take_while(|(other, _)| *other != column);
        SIGNS + before.map(|(_, width)| width + 1).sum::<usize>()
    }

    /// Returns true if a column is shown.
    pub fn has(&self, column: Column) -> bool {
        self.shown.iter().any(|(other, _)| *other == column)
    }

    /// Returns true if FILE has its text, not only sign and address.
    pub fn has_file_text(&self) -> bool {
        self.shown.iter().any(|(column, width)| *column == C::File && *width > SHORT_FILE)
    }

    /// Cells of all columns.
    #[cfg(test)]
    fn width(&self) -> usize {
        SIGNS + self.shown.iter().map(|(_, width)| width + 1).sum::<usize>() - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn titles(width: usize) -> Vec<&'static str> {
        let widest = Widest { bus: 0, address: 3, name: 9 };
        Columns::new(width, widest).shown.iter().map(|(column, _)| column.title()).collect()
    }

    #[test]
    fn columns_give_way_in_order() {
        let mut before = titles(220);
        assert_eq!(before.len(), 13);
        let mut order = Vec::new();
        for width in (31..220).rev() {
            let shown = titles(width);
            order.extend(before.iter().filter(|title| !shown.contains(title)).copied());
            assert!(shown.iter().all(|title| before.contains(title)), "{width}");
            before = shown;
        }
        assert_eq!(
            order,
            [
                "SERVICES",
                "SEEN",
                "VERSIONS",
                "jitter",
                "period",
                "miss",
                "HEARTBEAT",
                "MODE",
                "UID"
            ]
        );
        assert_eq!(before, ["ADDR", "NAME", "STATE", "FILE"]);
    }

    #[test]
    fn columns_fit_each_width() {
        for bus in [0, 6, 14] {
            for name in [1, 9, 40] {
                for width in 31..=220 {
                    let widest = Widest { bus, address: 3, name };
                    let columns = Columns::new(width, widest);
                    assert!(columns.width() <= width, "{width}: {columns:?}");
                }
            }
        }
    }

    #[test]
    fn file_is_short_before_the_strip_gives_way() {
        let columns = |width| Columns::new(width, Widest { bus: 0, address: 3, name: 9 });
        let narrowest = (31..=220).find(|width| columns(*width).has(Column::Strip)).unwrap();
        assert!(!columns(narrowest).has_file_text());
        assert!(columns(narrowest - 1).has_file_text());
        assert!(columns(40).has_file_text() && !columns(31).has_file_text());
    }
}
