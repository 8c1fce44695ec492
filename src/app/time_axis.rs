//! The time axis in cells, of the time bar and of the lanes.
//!
//! Pure: a beginning, a span and a number of cells in; the cell of a moment, and the moments of a
//! cell out. Does not know what the cells show.

use crate::time::{Duration, Instant};

/// A span of time in equal cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeAxis {
    /// Begin of the first cell.
    pub begin: Instant,
    /// Length of all cells in microseconds; at least one for each cell.
    span: u64,
    /// Number of cells.
    pub cells: usize,
}

impl TimeAxis {
    /// Returns the axis of a span, in this number of cells.
    pub fn new(begin: Instant, span: Duration, cells: usize) -> Self {
        let micros = u64::try_from(span.as_micros()).unwrap_or(u64::MAX);
        Self { begin, span: micros.max(cells.max(1) as u64), cells }
    }

    /// The cell of a moment: the first one for those before the axis, the last one for those behind.
    pub fn cell(&self, at: Instant) -> usize {
        let offset = at.since(self.begin).as_micros();
        let cell = offset * self.cells as u128 / u128::from(self.span);
        usize::try_from(cell).unwrap_or(usize::MAX).min(self.cells.saturating_sub(1))
    }

    /// Begin of a cell; of the cell behind the last one, the end of the axis.
    pub fn start(&self, cell: usize) -> Instant {
        // The first microsecond whose cell it is.
        let cells = self.cells.max(1) as u128;
        let offset = (u128::from(self.span) * cell as u128).div_ceil(cells);
        self.begin + Duration::from_micros(offset as u64)
    }

    /// The moment in the middle of a cell.
    pub fn middle(&self, cell: usize) -> Instant {
        let cells = self.cells.max(1) as u128;
        let offset = u128::from(self.span) * (2 * cell as u128 + 1) / (2 * cells);
        self.begin + Duration::from_micros(offset as u64)
    }

    /// Length of a cell, rounded down.
    pub fn step(&self) -> Duration {
        Duration::from_micros(self.span / self.cells.max(1) as u64)
    }

    /// End of the axis.
    pub fn end(&self) -> Instant {
        self.begin + Duration::from_micros(self.span)
    }

    /// Returns true if a moment is on the axis.
    pub fn contains(&self, at: Instant) -> bool {
        self.begin <= at && at < self.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_of_a_cell_are_in_it() {
        let begin = Instant::from_micros(7);
        for (span, cells) in [(100, 7), (0, 5), (3, 10), (1_000_003, 89), (u64::MAX / 4, 60)] {
            let axis = TimeAxis::new(begin, Duration::from_micros(span), cells);
            for cell in 0..cells {
                assert_eq!(axis.cell(axis.start(cell)), cell, "{axis:?}");
                assert_eq!(axis.cell(axis.middle(cell)), cell, "{axis:?}");
                let last = axis.start(cell + 1) - Duration::from_micros(1);
                assert_eq!(axis.cell(last), cell, "{axis:?}");
            }
            assert_eq!(axis.cell(Instant::ZERO), 0);
            assert_eq!(axis.cell(Instant::LATEST + Duration::MAX), cells - 1);
            assert!(!axis.contains(axis.end()) && axis.contains(begin));
        }
        let none = TimeAxis::new(begin, Duration::ZERO, 0);
        assert_eq!((none.cell(Instant::LATEST), none.cells), (0, 0));
    }
}
