//! Edits that can be taken back, or made again.

use crate::document::{Document, EditError, Operation};

/// How many edits can be taken back.
const MOST: usize = 200;

/// An edit that can be taken back (or made again).
#[derive(Clone, Debug)]
pub(super) struct UndoStep {
    /// The document that the operations are for; none where it is what the step above comes to: a
    /// document may be megabytes, and there may be many steps.
    pub(super) on: Option<Document>,
    pub(super) operations: Vec<Operation>,
    /// The edit's name, and how many operations it has as a whole: what somebody else changed since
    /// is left out where it is taken back or made again.
    pub(super) name: String,
    pub(super) whole: usize,
    /// Whether there was a file when the edit was made.
    pub(super) had_file: bool,
}

impl UndoStep {
    /// A whole edit's.
    pub(super) fn new(
        on: Document,
        operations: Vec<Operation>,
        name: String,
        had_file: bool,
    ) -> Self {
        let whole = operations.len();
        Self { on: Some(on), operations, name, whole, had_file }
    }

    pub(super) fn shown(&self) -> String {
        match self.whole.saturating_sub(self.operations.len()) {
            0 => self.name.clone(),
            left => format!("{}, all but {left}", self.name),
        }
    }
}

/// The steps that lead back, or forth again.
#[derive(Debug, Default)]
pub(super) struct UndoStack(Vec<UndoStep>);

impl UndoStack {
    /// Puts a step on top, which leads back to `before`.
    pub(super) fn push(&mut self, step: UndoStep, before: &Document) {
        if self.0.len() == MOST {
            self.0.remove(0);
        }
        if let Some(below) = self.0.last_mut()
            && below.on.as_ref() == Some(before)
        {
            below.on = None;
        }
        self.0.push(step);
    }

    /// Takes the step on top off.
    pub(super) fn pop(&mut self) -> Option<UndoStep> {
        let step = self.0.pop()?;
        let on = step.on.as_ref()?;
        if self.0.last().is_some_and(|below| below.on.is_none()) {
            let back = step.operations.iter().try_fold(on.clone(), |on, it| on.apply(it));
            match (back, self.0.last_mut()) {
                (Ok(back), Some(below)) => below.on = Some(back),
                // They cannot be told what they are for any more.
                _ => self.0.clear(),
            }
        }
        Some(step)
    }

    /// Forgets them all.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// How many documents they hold on to.
    #[cfg(test)]
    pub(super) fn kept(&self) -> usize {
        self.0.iter().filter(|step| step.on.is_some()).count()
    }
}

/// The document with all operations made; and what takes them back, in order.
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

/// Several operations that are one edit, in words.
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
