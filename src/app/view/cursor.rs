//! The selection of a list.
//!
//! It holds on to what is selected, not to a row number, and the selected row stays on its line of
//! the screen while others come and go.

/// Which row of a list is selected, and on which line of the screen it is.
#[derive(Clone, Debug)]
pub struct Cursor<K> {
    selected: Option<K>,
    line: usize,
    /// Where it was last: the place to go to when it is gone.
    last: usize,
    /// The user moved it; until then it is the first row, whichever that is.
    moved: bool,
}

impl<K> Default for Cursor<K> {
    fn default() -> Self {
        Self { selected: None, line: 0, last: 0, moved: false }
    }
}

impl<K: Clone + PartialEq> Cursor<K> {
    /// What is selected.
    pub fn selected(&self) -> Option<&K> {
        self.selected.as_ref()
    }

    /// The place of the selected row among `keys`.
    pub fn index<'k>(&self, mut keys: impl Iterator<Item = &'k K>) -> Option<usize>
    where
        K: 'k,
    {
        let selected = self.selected.as_ref()?;
        keys.position(|key| key == selected)
    }

    /// The first row on the screen, where `height` rows of `count` fit.
    pub fn top(&self, index: Option<usize>, count: usize, height: usize) -> usize {
        let line = self.line.min(height.saturating_sub(1));
        index.unwrap_or(0).saturating_sub(line).min(count.saturating_sub(height))
    }

    /// Selects nothing: the list follows its newest row.
    pub fn release(&mut self) {
        self.selected = None;
    }

    /// Selects a row, wherever it is.
    pub fn select(&mut self, key: K) {
        self.selected = Some(key);
        self.moved = true;
    }

    /// The selected row goes on under another key.
    pub fn replace(&mut self, key: K) {
        self.selected = Some(key);
    }

    /// After the rows changed: what is gone gives its place to its neighbour, and where nothing
    /// was selected the first row is.
    pub fn settle(&mut self, keys: &[K], height: usize) {
        if self.moved {
            self.keep(keys, height);
        } else {
            self.place(keys, 0, height);
        }
    }

    /// The same, but what is selected stays so, whether or not the user moved it: it is looked at.
    pub fn keep(&mut self, keys: &[K], height: usize) {
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

    /// Selects the row at that place.
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

    /// Selects the row on that line of the screen.
    pub fn click(&mut self, keys: &[K], line: usize, height: usize) {
        let top = self.top(self.index(keys.iter()), keys.len(), height);
        if top + line < keys.len() {
            self.line = line;
            self.move_to(keys, top + line, height);
        }
    }
}
