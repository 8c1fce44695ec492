//! `descan kit`: the responder for firmware, with the numbers of a profile.

use super::{EXIT_OK, Failure, output, profile};
use crate::cli::KitArgs;
use crate::diagnostic::Diagnostic;
use crate::kit::{self, KitDevice};
use crate::regular_file::{self, shown};
use crate::wire::profile::Profile;
use std::path::Path;

/// Prints des_config.h, or writes it to a folder with des.h and des.c.
pub fn run(args: &KitArgs) -> Result<u8, Failure> {
    let profile = args.profile.as_deref().map_or(Ok(Profile::default()), profile::read)?;
    let own = args.services.iter().map(|(name, version)| (name.as_str(), version.as_str()));
    let services = std::iter::once(("DES", "1.0")).chain(own);
    let device = KitDevice {
        name: args.name.clone(),
        services: services.map(|(name, version)| (name.to_owned(), version.to_owned())).collect(),
        has_fd: args.fd,
    };
    let config =
        kit::config(&device, &profile).map_err(|fault| Failure::Usage(fault.to_string()))?;
    let Some(folder) = &args.write else {
        return output::print(&config).map(|()| EXIT_OK);
    };
    let files = [("des.h", kit::HEADER), ("des.c", kit::SOURCE), ("des_config.h", &config)];
    write_all(folder, &files, args.force)?;
    Ok(EXIT_OK)
}

/// Writes files to a folder. One that is there with other content is replaced with `force` only,
/// and then no file is written.
fn write_all(folder: &Path, files: &[(&str, &str)], force: bool) -> Result<(), Failure> {
    let mut missing = Vec::new();
    for (name, text) in files {
        let path = folder.join(name);
        match regular_file::read_text(&path).map_err(|fault| fault.of(shown(&path)))? {
            Some(content) if content == *text => {}
            Some(_) if !force => {
                let fault = Diagnostic::new("already exists, with other content");
                return Err(fault.with_remedy("--force replaces it").of(shown(&path)).into());
            }
            _ => missing.push((path, text)),
        }
    }
    std::fs::create_dir_all(folder)
        .map_err(|error| regular_file::of_system(&error, "not created").of(shown(folder)))?;
    for (path, text) in missing {
        std::fs::write(&path, text)
            .map_err(|error| regular_file::of_system(&error, "not written").of(shown(&path)))?;
        output::warn(format_args!("wrote {}", shown(&path)));
    }
    Ok(())
}
