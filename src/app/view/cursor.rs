//! Selection in a list.
//!
//! Stores the key of the selected row, not its number, so the selected row keeps its line on the
//! screen while rows appear and disappear.

/// Selected row of a list and its line on the screen.
#[derive(Clone, Debug)]
pub struct Selection<K> {
    selected: Option<K>,
    line: usize,
    /// Last index of the selected row; used when the row disappears.
    last: usize,
    /// The user moved the selection; until then the first row is selected.
    moved: bool,
}

impl<K> Default for Selection<K> {
    fn default() -> Self {
        Self { selected: None, line: 0, last: 0, moved: false }
    }
}

impl<K: Clone + PartialEq> Selection<K> {
    /// Key of the selected row.
    pub fn selected(&self) -> Option<&K> {
        self.selected.as_ref()
    }

    /// Index of the selected row among `keys`.
    pub fn index<'k>(&self, mut keys: impl Iterator<Item = &'k K>) -> Option<usize>
    where
        K: 'k,
    {
        let selected = self.selected.as_ref()?;
        keys.position(|key| key == selected)
    }

    /// Index of the first row on the screen, where `height` of `count` rows fit.
    pub fn top(&self, index: Option<usize>, count: usize, height: usize) -> usize {
        let line = self.line.min(height.saturating_sub(1));
        index.unwrap_or(0).saturating_sub(line).min(count.saturating_sub(height))
    }

    /// Clears the selection: the list follows its newest row.
    pub fn follow_newest(&mut self) {
        self.selected = None;
    }

    /// Selects a row, on the screen or not.
    pub fn select(&mut self, key: K) {
        self.selected = Some(key);
        self.moved = true;
    }

    /// Replaces the key of the selected row.
    pub fn replace(&mut self, key: K) {
        self.selected = Some(key);
    }

    /// Updates the selection after the rows changed: a row that disappeared is replaced by its
    /// neighbour; without a selection by the user the first row is selected.
    pub fn update(&mut self, keys: &[K], height: usize) {
        if self.moved {
            self.update_keeping(keys, height);
        } else {
            self.place(keys, 0, height);
        }
    }

    /// Does the same as [`Self::update`], but keeps a selection that the user did not make.
    pub fn update_keeping(&mut self, keys: &[K], height: usize) {
        let index = self.index(keys.iter()).unwrap_or(self.last);
        self.place(keys, index, height);
    }

    /// Moves the selection by `delta` rows.
    pub fn move_by(&mut self, keys: &[K], delta: isize, height: usize) {
        let index = self.index(keys.iter()).unwrap_or(self.last);
        let top = self.top(Some(index), keys.len(), height);
        let target = index.saturating_add_signed(delta).min(keys.len().saturating_sub(1));
        self.line = (index - top.min(index)).saturating_add_signed(delta);
        self.move_to(keys, target, height);
    }

    /// Selects the row at this index.
    pub fn move_to(&mut self, keys: &[K], index: usize, height: usize) {
        self.moved = true;
        self.place(keys, index, height);
    }

    fn place(&mut self, keys: &[K], index: usize, height: usize) {
        let index = index.min(keys.len().saturating_sub(1));
        self.selected = keys.get(index).cloned();
        self.last = index;
        self.line = self.line.min(height.saturating_sub(1)).min(index);
    }

    /// Moves the selected row up on the screen, so that so many rows below it are on it, too.
    pub fn make_room(&mut self, rows: usize, height: usize) {
        self.line = self.line.min(height.saturating_sub(rows + 1));
    }

    /// Selects the row on this line of the screen.
    pub fn click(&mut self, keys: &[K], line: usize, height: usize) {
        let top = self.top(self.index(keys.iter()), keys.len(), height);
        if top + line < keys.len() {
            self.line = line;
            self.move_to(keys, top + line, height);
        }
    }
}
