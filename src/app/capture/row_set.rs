//! The rows of the table of identifiers that frames of a block have: a bit for each row. Does not know
//! frames.

/// A set of rows.
#[derive(Clone, Debug, Default)]
pub(super) struct RowSet(Vec<u64>);

impl RowSet {
    /// Adds a row.
    pub fn insert(&mut self, row: usize) {
        let word = row / 64;
        if word >= self.0.len() {
            self.0.resize(word + 1, 0);
        }
        self.0[word] |= 1 << (row % 64);
    }

    /// Returns true if a row was added.
    pub fn contains(&self, row: usize) -> bool {
        self.0.get(row / 64).is_some_and(|word| word >> (row % 64) & 1 != 0)
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Bytes of memory besides its own.
    pub fn size(&self) -> usize {
        self.0.capacity() * size_of::<u64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_has_the_rows_that_were_added() {
        let mut rows = RowSet::default();
        for row in [0, 63, 64, 4095] {
            assert!(!rows.contains(row));
            rows.insert(row);
        }
        let all: Vec<usize> = (0..5000).filter(|row| rows.contains(*row)).collect();
        assert_eq!(all, [0, 63, 64, 4095]);
        rows.clear();
        assert!(!rows.contains(64));
    }
}
