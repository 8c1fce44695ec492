//! Which user a file belongs to. Windows files are not examined: all count as the user's.

use std::fs::Metadata;

/// The users whose files are read: the one who runs descan, also through sudo.
#[cfg(unix)]
pub(super) fn readers() -> Vec<u32> {
    let user = nix::unistd::Uid::effective();
    let sudo = std::env::var("SUDO_UID").ok().filter(|_| user.is_root());
    [Some(user.as_raw()), sudo.and_then(|id| id.parse().ok())].into_iter().flatten().collect()
}

/// The users whose files are read.
#[cfg(windows)]
pub(super) fn readers() -> Vec<u32> {
    vec![0]
}

/// The number of the user a file belongs to.
#[cfg(unix)]
pub(super) fn owner_of(file: &Metadata) -> u32 {
    std::os::unix::fs::MetadataExt::uid(file)
}

/// The number of the user a file belongs to.
#[cfg(windows)]
pub(super) fn owner_of(_: &Metadata) -> u32 {
    0
}

/// The number of the file system a file is on.
#[cfg(unix)]
pub(super) fn device_of(file: &Metadata) -> u64 {
    std::os::unix::fs::MetadataExt::dev(file)
}

/// The number of the file system a file is on: folders above one are on the same drive.
#[cfg(windows)]
pub(super) fn device_of(_: &Metadata) -> u64 {
    0
}

/// The name of a user.
#[cfg(unix)]
pub(super) fn user_name(user: u32) -> String {
    let known = nix::unistd::User::from_uid(nix::unistd::Uid::from_raw(user)).ok().flatten();
    known.map_or_else(|| format!("user {user}"), |known| known.name)
}

/// The name of a user.
#[cfg(windows)]
pub(super) fn user_name(user: u32) -> String {
    format!("user {user}")
}
