//! The des.json files of a session: one for all buses, or several in a project whose buses have their
//! own.
//!
//! Input: paths, and which bus has which. Output: the editor of each file, and the contents of all at
//! one moment. Does not read or write files.

use super::{FileContent, FileEditor, FileError, FileState};
use crate::app::buses::{Bus, Buses};
use crate::document::{Document, Entry};
use crate::frame::BusIndex;
use std::path::{Component, Path, PathBuf};

/// A des.json, by its place among those that are open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FileIndex(pub u8);

/// An entry of one of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EntryPlace {
    /// The file.
    pub file: FileIndex,
    /// Place of the entry in it.
    pub index: usize,
}

/// The files, with the work around saving them. There is at least one, which may have no path.
#[derive(Debug)]
pub(in crate::app) struct FileEditors {
    editors: Vec<FileEditor>,
    /// The file of each bus; a bus behind the last one has the first file.
    of_buses: Vec<FileIndex>,
    /// Number of times that an editor was lent to be changed: orders the edits of all files.
    turns: u64,
}

impl FileEditors {
    /// Returns the editors of a file, and of the files that single buses have in its place.
    pub fn new(path: Option<PathBuf>, of_buses: Vec<Option<PathBuf>>) -> Self {
        let first = FileEditor::new(path);
        let mut all = Self { editors: vec![first], of_buses: Vec::new(), turns: 0 };
        for (at, path) in (0..=u8::MAX).zip(of_buses) {
            all.set_file_of(BusIndex(at), path);
        }
        all
    }

    /// Sets the file of a bus: `None` is the first one. Returns the file, and true if it is a new one.
    pub fn set_file_of(&mut self, bus: BusIndex, path: Option<PathBuf>) -> (FileIndex, bool) {
        let known = match &path {
            None => Some(0),
            Some(path) => self.editors.iter().position(|it| it.file.path() == Some(path)),
        };
        let place = known.unwrap_or(self.editors.len());
        if known.is_none() {
            self.editors.push(FileEditor::new(path));
            self.name_files();
        }
        let file = FileIndex(u8::try_from(place).unwrap_or_default());
        let at = usize::from(bus.0);
        if self.of_buses.len() <= at {
            self.of_buses.resize(at + 1, FileIndex::default());
        }
        self.of_buses[at] = file;
        (file, known.is_none())
    }

    /// Gives each file a name: the shortest end of its path, below the folder that all are in, that no
    /// other file has.
    fn name_files(&mut self) {
        let paths: Vec<PathBuf> =
            self.editors.iter().map(|it| it.file.path().unwrap_or(Path::new("")).into()).collect();
        let folder = common_folder(&paths);
        let below = |path: &PathBuf| path.strip_prefix(&folder).unwrap_or(path).to_owned();
        let paths: Vec<PathBuf> = paths.iter().map(below).collect();
        for (at, editor) in self.editors.iter_mut().enumerate() {
            let is_own_end = |parts: usize| {
                let own = end_of(&paths[at], parts);
                let others = paths.iter().enumerate().filter(|(other, _)| *other != at);
                others.map(|(_, path)| end_of(path, parts)).all(|other| other != own)
            };
            let most = paths[at].components().count();
            let parts = (1..=most).find(|parts| is_own_end(*parts)).unwrap_or(most);
            editor.file.set_shown_path(end_of(&paths[at], parts));
        }
    }

    /// The file of a bus.
    pub fn of_bus(&self, bus: BusIndex) -> FileIndex {
        self.of_buses.get(usize::from(bus.0)).copied().unwrap_or_default()
    }

    /// The editor of a file.
    pub fn get(&self, file: FileIndex) -> &FileEditor {
        self.editors.get(usize::from(file.0)).unwrap_or(&self.editors[0])
    }

    /// The editor of a file, to be changed.
    pub fn get_mut(&mut self, file: FileIndex) -> &mut FileEditor {
        self.turns += 1;
        let at = usize::from(file.0);
        let at = if at < self.editors.len() { at } else { 0 };
        let editor = &mut self.editors[at];
        editor.file.set_turn(self.turns);
        editor
    }

    /// The editors in the order of their files.
    pub fn iter(&self) -> impl Iterator<Item = &FileEditor> + Clone {
        self.editors.iter()
    }

    /// The files in their order.
    pub fn indices(&self) -> impl Iterator<Item = FileIndex> + use<> {
        (0..self.editors.len()).filter_map(|at| u8::try_from(at).ok()).map(FileIndex)
    }

    /// The states of the files.
    pub fn states(&self) -> impl Iterator<Item = (FileIndex, &FileState)> + Clone {
        (0..).map(FileIndex).zip(self.editors.iter().map(|editor| &editor.file))
    }

    /// The first file of this kind.
    pub fn find(&self, is_it: impl Fn(&FileState) -> bool) -> Option<FileIndex> {
        self.states().find(|(_, state)| is_it(state)).map(|(file, _)| file)
    }

    /// The file with the last edit of all; the first one without any.
    pub fn last_edited(&self) -> FileIndex {
        self.latest(FileState::undo_turn)
    }

    /// The file in which an edit was undone last; the first one without any.
    pub fn last_undone(&self) -> FileIndex {
        self.latest(FileState::redo_turn)
    }

    fn latest(&self, turn: impl Fn(&FileState) -> Option<u64>) -> FileIndex {
        let turns = self.states().filter_map(|(file, state)| Some((turn(state)?, file)));
        turns.max().map(|(_, file)| file).unwrap_or_default()
    }

    /// Forgets the undone edits of all other files: this one was edited.
    pub fn forget_undone_but(&mut self, edited: FileIndex) {
        for (file, editor) in (0..).map(FileIndex).zip(&mut self.editors) {
            if file != edited {
                editor.file.forget_undone();
            }
        }
    }

    /// Returns true if there is one of the files, or edits that make one.
    pub fn are_any_there(&self) -> bool {
        self.states().any(|(_, file)| file.is_there())
    }

    /// Number of unsaved edits of all files.
    pub fn unsaved(&self) -> usize {
        self.editors.iter().map(|editor| editor.file.unsaved()).sum()
    }

    /// The contents at this moment.
    pub fn contents(&self) -> Vec<FileContent> {
        self.editors.iter().map(|editor| editor.file.content()).collect()
    }

    /// The contents of all files now.
    pub fn documents(&self) -> Documents<'_> {
        Documents { editors: self, past: None }
    }

    /// These contents, which the files had at another moment.
    pub fn documents_of<'a>(&'a self, contents: &'a [FileContent]) -> Documents<'a> {
        Documents { editors: self, past: Some(contents) }
    }
}

/// The innermost folder that all files are in.
fn common_folder(paths: &[PathBuf]) -> PathBuf {
    let mut folders = paths.iter().map(|path| path.parent().unwrap_or(Path::new("")));
    let first = folders.next().unwrap_or(Path::new("")).to_owned();
    folders.fold(first, |common, folder| {
        let both = common.components().zip(folder.components());
        both.take_while(|(one, other)| one == other).map(|(part, _)| part).collect()
    })
}

/// The last parts of a path.
fn end_of(path: &Path, parts: usize) -> PathBuf {
    let all: Vec<Component> = path.components().collect();
    all[all.len().saturating_sub(parts)..].iter().collect()
}

/// The contents of all files at one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Documents<'a> {
    editors: &'a FileEditors,
    /// The contents at a past moment; files that were opened since have none.
    past: Option<&'a [FileContent]>,
}

impl<'a> Documents<'a> {
    /// The files in their order.
    pub fn files(&self) -> impl Iterator<Item = FileIndex> + use<> {
        self.editors.indices()
    }

    /// Returns true if there is more than one file.
    pub fn are_several(&self) -> bool {
        self.editors.editors.len() > 1
    }

    /// The name of a file for texts.
    pub fn name(&self, file: FileIndex) -> String {
        self.editors.get(file).file.name()
    }

    /// The file of a bus.
    pub fn of_bus(&self, bus: BusIndex) -> FileIndex {
        self.editors.of_bus(bus)
    }

    /// The buses that have a file.
    pub fn buses_of(
        self,
        file: FileIndex,
        buses: &'a Buses,
    ) -> impl Iterator<Item = (BusIndex, &'a Bus)> + Clone {
        buses.indexed().filter(move |(index, _)| self.of_bus(*index) == file)
    }

    /// The content of a file; `None` if it was not open at that moment.
    pub fn get(&self, file: FileIndex) -> Option<&'a Document> {
        match self.past {
            Some(contents) => Some(&contents.get(usize::from(file.0))?.document),
            None => Some(self.editors.get(file).file.document()),
        }
    }

    /// Returns true if there was the file, or edits that make one.
    pub fn is_there(&self, file: FileIndex) -> bool {
        match self.past {
            Some(contents) => contents.get(usize::from(file.0)).is_some_and(|it| it.is_there),
            None => self.editors.get(file).file.is_there(),
        }
    }

    /// Why a file could not be read or saved; `None` for a usable one.
    pub fn problem(&self, file: FileIndex) -> Option<&'a FileError> {
        match self.past {
            Some(contents) => contents.get(usize::from(file.0))?.problem.as_ref(),
            None => self.editors.get(file).file.problem(),
        }
    }

    /// The entries of a file.
    pub fn entries(&self, file: FileIndex) -> &'a [Entry] {
        self.get(file).map_or(&[], Document::entries)
    }

    /// The entry at a place.
    pub fn entry(&self, place: EntryPlace) -> Option<&'a Entry> {
        self.entries(place.file).get(place.index)
    }
}
