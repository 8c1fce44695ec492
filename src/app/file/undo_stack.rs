//! Steps for undo and redo.
//!
//! At most 200 steps; documents that follow from the step above are not stored.

use crate::document::{Document, EditError, Operation};

/// Largest number of steps.
const MOST: usize = 200;

/// Operations that undo or redo one edit.
#[derive(Clone, Debug)]
pub(super) struct UndoStep {
    /// Document that the operations apply to; `None` if it is the result of the step above, because
    /// a document may have megabytes and there may be many steps.
    pub(super) base: Option<Document>,
    pub(super) operations: Vec<Operation>,
    /// Name of the edit. `whole` is its full number of operations: values that changed on disk
    /// since are left out of `operations`.
    pub(super) name: String,
    pub(super) whole: usize,
    /// The file existed when the edit was made.
    pub(super) had_file: bool,
    /// Orders it among the steps of all files.
    pub(super) turn: u64,
}

impl UndoStep {
    /// Returns the step of a whole edit.
    pub(super) fn new(
        on: Document,
        operations: Vec<Operation>,
        name: String,
        had_file: bool,
    ) -> Self {
        let whole = operations.len();
        Self { base: Some(on), operations, name, whole, had_file, turn: 0 }
    }

    /// Sets its place among the steps of all files.
    pub(super) fn at(self, turn: u64) -> Self {
        Self { turn, ..self }
    }

    pub(super) fn shown(&self) -> String {
        match self.whole.saturating_sub(self.operations.len()) {
            0 => self.name.clone(),
            left => format!("{}, all but {left}", self.name),
        }
    }
}

/// Stack of undo or redo steps, the next one on top.
#[derive(Debug, Default)]
pub(super) struct UndoStack(Vec<UndoStep>);

impl UndoStack {
    /// Returns true if no step is left.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The place of the next step among those of all files; `None` if no step is left.
    pub(super) fn turn(&self) -> Option<u64> {
        self.0.last().map(|step| step.turn)
    }

    /// Pushes a step whose result is `before`.
    pub(super) fn push(&mut self, step: UndoStep, before: &Document) {
        if self.0.len() == MOST {
            self.0.remove(0);
        }
        if let Some(below) = self.0.last_mut()
            && below.base.as_ref() == Some(before)
        {
            below.base = None;
        }
        self.0.push(step);
    }

    /// Removes the top step and returns it.
    pub(super) fn pop(&mut self) -> Option<UndoStep> {
        let step = self.0.pop()?;
        let on = step.base.as_ref()?;
        if self.0.last().is_some_and(|below| below.base.is_none()) {
            let back = step.operations.iter().try_fold(on.clone(), |on, it| on.apply(it));
            match (back, self.0.last_mut()) {
                (Ok(back), Some(below)) => below.base = Some(back),
                // The document that the steps below apply to is lost.
                _ => self.0.clear(),
            }
        }
        Some(step)
    }

    /// Removes all steps.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Number of stored documents.
    #[cfg(test)]
    pub(super) fn kept(&self) -> usize {
        self.0.iter().filter(|step| step.base.is_some()).count()
    }
}

/// Applies all operations. Returns the document and the operations that revert them, in order.
///
/// # Errors
///
/// An operation does not apply.
pub(super) fn apply_all(
    on: &Document,
    operations: &[Operation],
) -> Result<(Document, Vec<Operation>), EditError> {
    let mut document = on.clone();
    let mut inverses = Vec::with_capacity(operations.len());
    for operation in operations {
        inverses.push(operation.inverse(&document)?);
        document = document.apply(operation)?;
    }
    inverses.reverse();
    Ok((document, inverses))
}

/// Name of an edit of several operations.
pub(super) fn name_of(operations: &[Operation]) -> String {
    let count = |is: fn(&Operation) -> bool| operations.iter().filter(|it| is(it)).count();
    let added = count(|it| matches!(it, Operation::Add { .. }));
    let services = count(|it| matches!(it, Operation::SetServices { .. }));
    let entries = |count| if count == 1 { "entry" } else { "entries" };
    let mut words = Vec::new();
    if added > 0 {
        words.push(format!("{added} new {}", entries(added)));
    }
    if services > 0 {
        words.push(format!("services of {services} {}", entries(services)));
    }
    if added + services < operations.len() {
        words = vec![format!("{} edits", operations.len())];
    }
    words.join(", ")
}
