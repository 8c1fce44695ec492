//! `descan kit`: the responder for firmware, with the numbers of a profile.

use super::generated_files::write_generated;
use super::{EXIT_OK, Failure, output, profile};
use crate::cli::{KitArgs, KitLanguage};
use crate::kit::{self, KitDevice, KitFault};
use crate::wire::profile::Profile;

/// Prints des_config.h or des_config.rs, or writes it to a folder, the header with des.h and des.c.
pub fn run(args: &KitArgs) -> Result<u8, Failure> {
    let profile = args.profile.as_deref().map_or(Ok(Profile::default()), profile::read)?;
    let own = args.services.iter().map(|(name, version)| (name.as_str(), version.as_str()));
    let services = std::iter::once(("DES", "1.0")).chain(own);
    let device = KitDevice {
        name: args.name.clone(),
        services: services.map(|(name, version)| (name.to_owned(), version.to_owned())).collect(),
        has_fd: args.fd,
    };
    let config = match args.lang {
        KitLanguage::C => kit::config(&device, &profile),
        KitLanguage::Rust => kit::rust_config(&device, &profile),
    };
    let config = config.map_err(|fault| match fault {
        KitFault::ListedTwice(name) if name == "DES" => {
            Failure::Usage(format!("service {name}: leave it out; every device has it"))
        }
        fault => Failure::Usage(fault.to_string()),
    })?;
    let Some(folder) = &args.write else {
        return output::print(&config).map(|()| EXIT_OK);
    };
    let files: &[(&str, &str)] = match args.lang {
        KitLanguage::C => {
            &[("des.h", kit::HEADER), ("des.c", kit::SOURCE), ("des_config.h", &config)]
        }
        KitLanguage::Rust => &[("des_config.rs", &config)],
    };
    write_generated(folder, files, args.force)?;
    Ok(EXIT_OK)
}
