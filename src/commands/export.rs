//! `descan profile export`: the profile and the catalogue for other programs.

use super::catalogue::folders_of;
use super::generated_files::write_generated;
use super::{EXIT_OK, Failure, output, profile};
use crate::catalogue::{Catalogue, CatalogueFile};
use crate::cli::{CommonArgs, ExportArgs};
use crate::diagnostic::Diagnostic;
use crate::export::{ExportFacts, dbc, dissector};
use crate::shell::catalogue_folders::CatalogueFolders;
use crate::text::printable_path;
use crate::wire::profile::Profile;
use std::path::Path;

/// Prints the file, or writes it.
pub fn run(args: &ExportArgs) -> Result<u8, Failure> {
    let project = super::project::of(&CommonArgs::listen_only(None))?.map(|(_, project)| project);
    let of_project = project.as_ref().and_then(|project| project.profile.as_deref());
    let path = args.profile.as_deref().or(of_project);
    let profile = path.map_or(Ok(Profile::default()), profile::read)?;
    let folders = if args.catalogue.is_empty() {
        folders_of(project)
    } else {
        CatalogueFolders::of(args.catalogue.clone())
    };
    if let Some(folder) = args.catalogue.iter().find(|folder| !folder.is_dir()) {
        return Err(Diagnostic::new("not a folder").of(printable_path(folder)).into());
    }
    let catalogue = Catalogue::default().read(folders.read());
    for notice in catalogue.files().iter().filter_map(CatalogueFile::notice) {
        output::warn(notice);
    }
    let facts = ExportFacts { profile: &profile, catalogue: &catalogue };
    let text = if args.dbc { dbc(facts) } else { dissector(facts) };
    let Some(path) = &args.write else {
        return output::print(&text).map(|()| EXIT_OK);
    };
    let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
        return Err(Diagnostic::new("not the name of a file").of(printable_path(path)).into());
    };
    let folder = path.parent().filter(|it| !it.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Err(Diagnostic::new("folder not found").of(printable_path(folder)).into());
    }
    write_generated(folder, &[(name, &text)], args.force)?;
    Ok(EXIT_OK)
}
