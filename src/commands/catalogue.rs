//! `descan catalogue`: the types of devices that are known, and mistakes in their files.

use super::open::default_file;
use super::{EXIT_FINDINGS, EXIT_OK, Failure, output};
use crate::catalogue::{Catalogue, CatalogueFile, CatalogueText};
use crate::cli::{CatalogueArgs, CommonArgs};
use crate::project::Project;
use crate::regular_file::required_text;
use crate::shell::catalogue_folders::CatalogueFolders;
use crate::text::{counted, printable_path};
use serde::Serialize;
use std::fmt::Write as _;
use unicode_width::UnicodeWidthStr;

/// Prints the files, as a table or as JSON; a file with a mistake is exit code 1.
pub fn run(args: &CatalogueArgs) -> Result<u8, Failure> {
    let (texts, folders): (_, Vec<String>) = if args.paths.is_empty() {
        let folders = folders_in_use()?;
        (folders.read(), folders.paths().iter().map(|path| printable_path(path)).collect())
    } else {
        (texts_of(&args.paths)?, args.paths.iter().map(|path| printable_path(path)).collect())
    };
    let catalogue = Catalogue::default().read(texts);
    let faults = catalogue
        .files()
        .iter()
        .filter_map(|file| Some((&file.path, file.fault.as_ref().or(file.warning.as_ref())?)));
    for (path, why) in faults.clone() {
        output::warn(format_args!("{path}: {why}"));
    }
    if args.json {
        let rows: Vec<TypeReport> = catalogue.files().iter().map(TypeReport::of).collect();
        let text = serde_json::to_string_pretty(&rows).map_err(anyhow::Error::from)?;
        output::print_json(&(text + "\n"))?;
    } else if catalogue.files().is_empty() {
        output::warn(format_args!("no types of devices in {}", folders.join(" or ")));
    } else {
        output::print(&table(&catalogue))?;
    }
    Ok(if faults.count() == 0 { EXIT_OK } else { EXIT_FINDINGS })
}

/// The folders that other commands read here.
fn folders_in_use() -> Result<CatalogueFolders, Failure> {
    let project = super::project::of(&CommonArgs::listen_only(None))?;
    Ok(folders_of(project.map(|(_, project)| project)))
}

/// The folders of a project, or those of this folder.
pub(super) fn folders_of(project: Option<Project>) -> CatalogueFolders {
    let Some(project) = project else {
        return CatalogueFolders::beside(&[&default_file()], false);
    };
    let files = project.files();
    project
        .catalogue
        .clone()
        .map_or_else(|| CatalogueFolders::beside(&files, true), CatalogueFolders::of)
}

/// Reads files, and the files of folders.
fn texts_of(paths: &[std::path::PathBuf]) -> Result<Vec<CatalogueText>, Failure> {
    let mut texts = Vec::new();
    for path in paths {
        if path.is_dir() {
            texts.extend(CatalogueFolders::only(path).read());
        } else {
            texts.push(CatalogueText {
                path: printable_path(path),
                folder: 0,
                text: Ok(required_text(path)?),
            });
        }
    }
    Ok(texts)
}

/// A file, as JSON.
#[derive(Serialize)]
struct TypeReport<'a> {
    file: &'a str,
    gid: Option<String>,
    name: Option<&'a str>,
    title: Option<&'a str>,
    documentation: Option<&'a str>,
    services: usize,
    fault: Option<&'a str>,
    /// A number that another file has for something else.
    warning: Option<&'a str>,
}

impl<'a> TypeReport<'a> {
    fn of(file: &'a CatalogueFile) -> Self {
        let known = file.device_type.as_deref();
        Self {
            file: &file.path,
            gid: known.and_then(|it| it.gid).map(|gid| gid.to_string()),
            name: known.and_then(|it| it.name.as_deref()),
            title: known.map(|it| &*it.title).filter(|title| !title.is_empty()),
            documentation: known.and_then(|it| it.documentation.as_deref()),
            services: known.map_or(0, |it| it.services.len()),
            fault: file.fault.as_deref(),
            warning: file.warning.as_deref(),
        }
    }
}

fn table(catalogue: &Catalogue) -> String {
    let mut rows = vec![["GID", "NAME", "TITLE", "SERVICES", "FILE"].map(str::to_owned)];
    for file in catalogue.files() {
        let Some(known) = &file.device_type else { continue };
        let any = || if known.is_common() { "all" } else { "–" }.to_owned();
        rows.push([
            known.gid.map_or_else(any, |gid| gid.to_string()),
            known.name.clone().unwrap_or_else(any),
            known.title.clone(),
            known.services.len().to_string(),
            file.path.clone(),
        ]);
    }
    let widths: [usize; 5] =
        std::array::from_fn(|at| rows.iter().map(|row| row[at].width()).max().unwrap_or(0));
    let mut text = String::new();
    for row in &rows {
        let cells = row.iter().zip(widths).map(|(cell, width)| {
            format!("{cell}{}", " ".repeat(width.saturating_sub(cell.width())))
        });
        let _ = writeln!(text, "{}", cells.collect::<Vec<_>>().join("  ").trim_end());
    }
    let _ = writeln!(text, "{}", counted(catalogue.len() as u64, "file"));
    text
}
