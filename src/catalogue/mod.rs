//! The catalogue: what is known of types of devices, as files that people write and share.
//!
//! Input: the texts of the files. Output: the type of a device, by its GID, else by its name. A file
//! with a mistake keeps what it said before. Does not know where the files are, or which devices are
//! on a bus.

mod device_type;

pub use device_type::{DebugMessage, DeviceType, TypeService};

use crate::diagnostic::Diagnostic;
use crate::wire::descriptor::Gid;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most files that are read. Chosen: far more types than a bus has addresses.
pub const MAX_FILES: usize = 1024;

/// The text of a file.
#[derive(Clone, Debug)]
pub struct CatalogueText {
    /// Its path, as it is shown.
    pub path: String,
    /// Number of its folder. Of a type that stands in several folders the first one counts.
    pub folder: usize,
    /// Its text, or why it cannot be read.
    pub text: Result<String, Diagnostic>,
}

/// A file of the catalogue.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CatalogueFile {
    /// Its path, as it is shown.
    pub path: String,
    /// What it says; with a mistake what it said before.
    pub device_type: Option<Arc<DeviceType>>,
    /// What is wrong, with its place; `None` if nothing is.
    pub fault: Option<String>,
    /// A number that a file before it has for something else, which counts; `None` if there is none.
    pub warning: Option<String>,
    folder: usize,
}

impl CatalogueFile {
    /// Says what is wrong, and what follows of it; `None` if nothing is.
    pub fn notice(&self) -> Option<String> {
        let kept = match self.device_type {
            Some(_) => "what it said before stays",
            None => "it is not used",
        };
        let fault = self.fault.as_ref().map(|why| format!("{}: {why}; {kept}", self.path));
        fault.or_else(|| Some(format!("{}: {}", self.path, self.warning.as_ref()?)))
    }
}

/// How the type of a device is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TypeBasis {
    /// By the GID of its descriptor.
    Gid,
    /// By its name alone: a device of another type may have it, too.
    Name,
}

/// All types that are known.
#[derive(Clone, Debug, Default)]
pub struct Catalogue {
    files: Vec<CatalogueFile>,
    by_gid: BTreeMap<Gid, Arc<DeviceType>>,
    /// `None` for a name of several types.
    by_name: BTreeMap<String, Option<Arc<DeviceType>>>,
    /// What all devices share.
    common: Vec<Arc<DeviceType>>,
    /// Number of times that it was read.
    revision: u64,
}

impl Catalogue {
    /// Reads the texts of all files, in the order of their folders; at most [`MAX_FILES`]. `self` is
    /// the catalogue before.
    #[must_use]
    pub fn read(&self, texts: Vec<CatalogueText>) -> Self {
        let mut catalogue = Self { revision: self.revision + 1, ..Self::default() };
        // And what each folder has to say.
        for CatalogueText { path, folder, text } in texts.into_iter().take(2 * MAX_FILES) {
            let own = format!("{path}: ");
            let said = |fault: Diagnostic| fault.to_string().replacen(&own, "", 1);
            let parsed = text
                .map_err(said)
                .and_then(|text| DeviceType::parse(&text).map_err(|error| error.with_line()));
            let file = match parsed {
                Ok(device_type) => {
                    let device_type = Some(Arc::new(device_type));
                    CatalogueFile { path, device_type, fault: None, warning: None, folder }
                }
                Err(why) => {
                    let before = self.files.iter().find(|file| file.path == path);
                    let device_type = before.and_then(|file| file.device_type.clone());
                    CatalogueFile { path, device_type, fault: Some(why), warning: None, folder }
                }
            };
            catalogue.add(file);
        }
        catalogue
    }

    fn add(&mut self, mut file: CatalogueFile) {
        if let Some(device_type) = file.device_type.clone() {
            let same = self.files.iter().find(|known| {
                let known = known.device_type.as_ref();
                known.is_some_and(|known| known.gid.is_some() && known.gid == device_type.gid)
            });
            match same {
                // That of the folder before stands for it.
                Some(same) if same.folder != file.folder => file.device_type = None,
                Some(same) => {
                    file.fault = Some(format!("the GID of {}, too; that one counts", same.path));
                    file.device_type = None;
                }
                None => {
                    file.warning = self.shared_number(&device_type, file.folder);
                    self.index(&device_type, file.folder);
                }
            }
        }
        self.files.push(file);
    }

    /// Says which number of what all devices share another file of the folder has for something else.
    fn shared_number(&self, device_type: &DeviceType, folder: usize) -> Option<String> {
        let is_like = |file: &&CatalogueFile| device_type.is_common() && file.folder == folder;
        self.files.iter().filter(is_like).find_map(|file| {
            let other = file.device_type.as_ref().filter(|other| other.is_common())?;
            let shared = device_type.shared_number(other)?;
            Some(format!("{shared} in {}, too; that one counts", file.path))
        })
    }

    fn index(&mut self, device_type: &Arc<DeviceType>, folder: usize) {
        if device_type.is_common() {
            self.common.push(Arc::clone(device_type));
        }
        if let Some(gid) = device_type.gid {
            self.by_gid.insert(gid, Arc::clone(device_type));
        }
        if let Some(name) = &device_type.name {
            let of_before = |file: &CatalogueFile| {
                file.folder < folder
                    && file.device_type.as_ref().is_some_and(|it| it.name.as_ref() == Some(name))
            };
            let is_taken = self.by_name.contains_key(name);
            if !is_taken {
                self.by_name.insert(name.clone(), Some(Arc::clone(device_type)));
            } else if !self.files.iter().any(of_before) {
                self.by_name.insert(name.clone(), None);
            }
        }
    }

    /// Number of times that it was read.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// All files, in the order in which they were read.
    pub fn files(&self) -> &[CatalogueFile] {
        &self.files
    }

    /// Number of types and of what all devices share.
    pub fn len(&self) -> usize {
        self.files.iter().filter(|file| file.device_type.is_some()).count()
    }

    /// Returns true if nothing is known of any device.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the type with a GID.
    pub fn with_gid(&self, gid: Gid) -> Option<&Arc<DeviceType>> {
        self.by_gid.get(&gid)
    }

    /// Returns the type of a device: by its GID if that is known, else by its name if that is of one
    /// type alone.
    pub fn type_of(
        &self,
        gid: Option<Gid>,
        name: Option<&[u8]>,
    ) -> Option<(&Arc<DeviceType>, TypeBasis)> {
        let gid = gid.filter(|gid| !gid.is_blank());
        if let Some(found) = gid.and_then(|gid| self.by_gid.get(&gid)) {
            return Some((found, TypeBasis::Gid));
        }
        let name = std::str::from_utf8(name?).ok()?;
        let found = self.by_name.get(name)?.as_ref()?;
        // A device with another GID is not of a type that has one.
        (gid.is_none() || found.gid.is_none()).then_some((found, TypeBasis::Name))
    }

    /// The types, each with a GID or a name.
    pub fn device_types(&self) -> impl Iterator<Item = &Arc<DeviceType>> {
        let types = self.files.iter().filter_map(|file| file.device_type.as_ref());
        types.filter(|it| !it.is_common())
    }

    /// Names that belong to one type alone, with the type.
    pub fn named_types(&self) -> impl Iterator<Item = (&str, &Arc<DeviceType>)> {
        self.by_name.iter().filter_map(|(name, of)| Some((name.as_str(), of.as_ref()?)))
    }

    /// What all devices share: from files without GID and name.
    pub fn common_types(&self) -> &[Arc<DeviceType>] {
        &self.common
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(path: &str, folder: usize, text: &str) -> CatalogueText {
        CatalogueText { path: path.to_owned(), folder, text: Ok(text.to_owned()) }
    }

    #[test]
    fn type_is_found_by_gid_else_by_a_name_of_one_type() {
        let catalogue = Catalogue::default().read(vec![
            text("a.toml", 0, "gid = '000000000001'\nname = 'A'\ntitle = 'one'"),
            text("b.toml", 0, "gid = '00 00 00 00 00 02'\nname = 'A'\ntitle = 'two'"),
            text("c.toml", 0, "name = 'C'\ntitle = 'three'"),
            text("a2.toml", 1, "gid = '000000000001'\ntitle = 'another one'"),
            text("c2.toml", 1, "name = 'C'\ntitle = 'another three'"),
            text("d.toml", 1, "gid = '000000000007'\nname = 'D'\ntitle = 'four'"),
        ]);
        let title = |gid: Option<&str>, name: &str| {
            let gid = gid.and_then(Gid::parse);
            let found = catalogue.type_of(gid, Some(name.as_bytes()));
            found.map(|(found, basis)| (found.title.clone(), basis))
        };
        assert_eq!(title(Some("000000000001"), "C"), Some(("one".into(), TypeBasis::Gid)));
        assert_eq!(title(Some("000000000003"), "D"), None, "its GID is of another type");
        assert_eq!(title(Some("000000000003"), "C"), Some(("three".into(), TypeBasis::Name)));
        assert_eq!(title(None, "C"), Some(("three".into(), TypeBasis::Name)));
        assert_eq!(title(Some("000000000000"), "C"), Some(("three".into(), TypeBasis::Name)));
        assert_eq!(title(None, "A"), None, "two types have the name");
    }

    #[test]
    fn file_with_a_mistake_keeps_what_it_said_before() {
        let before = Catalogue::default().read(vec![text("a.toml", 0, "name = 'A'")]);
        let after = before.read(vec![text("a.toml", 0, "name = 'A'\nnmae = 'B'")]);
        assert!(after.type_of(None, Some(b"A")).is_some());
        let fault = after.files()[0].fault.as_deref().unwrap();
        assert!(fault.starts_with("line 2, column 1: unknown field `nmae`"), "{fault}");
        let first = Catalogue::default().read(vec![text("a.toml", 0, "name = ''")]);
        assert!(first.is_empty());
    }
}
