//! Folders of other machines: their changes cause no events here.

use std::path::Path;

/// Returns true if the folder is on a file system whose changes by other machines cause no events.
#[cfg(target_os = "linux")]
pub(super) fn is_remote(folder: &Path) -> bool {
    use nix::sys::statfs::{self, FsType, statfs};
    const REMOTE: [FsType; 7] = [
        statfs::NFS_SUPER_MAGIC,
        statfs::SMB_SUPER_MAGIC,
        statfs::FUSE_SUPER_MAGIC,
        statfs::AFS_SUPER_MAGIC,
        statfs::CODA_SUPER_MAGIC,
        statfs::NCP_SUPER_MAGIC,
        statfs::OCFS2_SUPER_MAGIC,
    ];
    /// Not in nix: CIFS, SMB2, 9P, Ceph, GFS2.
    const MORE: [u32; 5] = [0xFF53_4D42, 0xFE53_4D42, 0x0102_1997, 0x00C3_6400, 0x0116_1970];
    let Ok(found) = statfs(folder) else { return false };
    let found = found.filesystem_type();
    REMOTE.contains(&found) || MORE.contains(&(found.0 as u32))
}

/// Returns true if the folder is on a file system whose changes by other machines cause no events.
#[cfg(target_os = "macos")]
pub(super) fn is_remote(folder: &Path) -> bool {
    const REMOTE: [&str; 6] = ["nfs", "smbfs", "afpfs", "webdav", "ftp", "macfuse"];
    nix::sys::statfs::statfs(folder)
        .is_ok_and(|found| REMOTE.contains(&found.filesystem_type_name()))
}

/// Returns true if the folder is a share of another machine; a drive letter for one is resolved.
#[cfg(windows)]
pub(super) fn is_remote(folder: &Path) -> bool {
    use std::path::{Component, Prefix};
    let whole = std::fs::canonicalize(folder);
    whole.is_ok_and(|path| match path.components().next() {
        Some(Component::Prefix(prefix)) => {
            matches!(prefix.kind(), Prefix::UNC(..) | Prefix::VerbatimUNC(..))
        }
        _ => false,
    })
}
