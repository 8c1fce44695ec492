//! What rows, findings and texts are made from: the buses and the des.json files of one moment, and
//! which entry belongs to which device.

use super::buses::{Bus, Buses};
use super::file::{Documents, EntryPlace, FileIndex};
use super::problems::Matching;
use crate::discovery::DeviceId;
use crate::document::{Document, Entry};
use crate::frame::BusIndex;
use crate::time::Instant;

/// The parts that rows, findings and texts are made from.
#[derive(Clone, Copy)]
pub(crate) struct Inputs<'a> {
    pub now: Instant,
    pub buses: &'a Buses,
    pub documents: Documents<'a>,
    pub matching: &'a Matching,
}

impl<'a> Inputs<'a> {
    /// The files, each with what belongs to it.
    pub fn files(self) -> impl Iterator<Item = FileInputs<'a>> {
        self.documents.files().filter_map(move |file| self.file(file))
    }

    /// A file, with what belongs to it; `None` if it was not open at that moment.
    pub fn file(self, file: FileIndex) -> Option<FileInputs<'a>> {
        let document = self.documents.get(file)?;
        Some(FileInputs { all: self, file, document, is_there: self.documents.is_there(file) })
    }

    /// The entry of a device.
    pub fn entry_of(self, device: DeviceId) -> Option<&'a Entry> {
        self.documents.entry(self.matching.entry_of(device)?)
    }
}

/// One file of [`Inputs`].
#[derive(Clone, Copy)]
pub(crate) struct FileInputs<'a> {
    pub all: Inputs<'a>,
    pub file: FileIndex,
    pub document: &'a Document,
    /// True if there is the file, or edits that make one.
    pub is_there: bool,
}

impl<'a> FileInputs<'a> {
    /// The buses that have this file.
    pub fn buses(self) -> impl Iterator<Item = (BusIndex, &'a Bus)> + Clone {
        self.all.documents.buses_of(self.file, self.all.buses)
    }

    /// The buses that an entry of this file is about.
    pub fn buses_of<'e>(
        self,
        entry: &'e Entry,
    ) -> impl Iterator<Item = (BusIndex, &'a Bus)> + Clone + use<'a, 'e> {
        self.buses().filter(|(_, bus)| entry.is_for_bus(&bus.name))
    }

    /// The place of an entry of this file.
    pub fn place(self, entry: &Entry) -> EntryPlace {
        EntryPlace { file: self.file, index: entry.index }
    }

    /// The devices of an entry of this file, at most one per bus.
    pub fn devices_of(self, entry: &Entry) -> &'a [DeviceId] {
        self.all.matching.devices_of(self.place(entry))
    }
}
