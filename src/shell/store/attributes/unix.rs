//! Owner, group, mode and extended attributes of Unix.

use super::AttributeError;
use crate::diagnostic::{Diagnostic, without_number};
use crate::text::printable;
use nix::unistd::{AccessFlags, Gid, Uid, access, fchown};
use rustix::fs::{XattrFlags, fgetxattr, flistxattr, fremovexattr, fsetxattr};
use rustix::io::Errno;
use std::ffi::{CStr, CString};
use std::fs::{File, Metadata, Permissions};
use std::io;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::Path;

/// The access control list, as an extended attribute. That of macOS is none, and is not kept.
const ACCESS_LIST: &CStr = c"system.posix_acl_access";

/// Attributes that describe the bytes or the inode of one file; the kernel sets those of a new one.
const OF_ONE_INODE: [&CStr; 3] = [c"security.ima", c"security.evm", c"com.apple.provenance"];

/// The error of an attribute that a file does not have.
#[cfg(not(target_os = "macos"))]
const NO_ATTRIBUTE: Errno = Errno::NODATA;
#[cfg(target_os = "macos")]
const NO_ATTRIBUTE: Errno = Errno::NOATTR;

/// Kernel limit of a list of attribute names, and of a value, in bytes.
const MAX_ATTRIBUTE_BYTES: usize = 64 << 10;

/// Gives `new`, a file of mode 0600, the attributes of `old`. Access is never wider than that of
/// `old`, not even in between.
///
/// Only root may change the owner; other users may set only groups of their own. A file whose owner
/// cannot be kept belongs to the user of descan, as with editors. If the group cannot be kept, the
/// new group and all other users get only the permissions that both had.
///
/// # Errors
/// An attribute cannot be read or set, or an access control list would apply to another group.
pub(in crate::shell::store) fn keep(
    old: &File,
    metadata: &Metadata,
    new: &File,
) -> Result<(), AttributeError> {
    let has_group = keep_owner(metadata, new)?;
    let names = names(old)?;
    if names.iter().any(|name| name.as_c_str() == ACCESS_LIST) {
        if !has_group {
            let cause = "its group cannot be kept, which its access list applies to";
            return Err(AttributeError::NotKept(save_elsewhere(cause.to_owned())));
        }
    } else {
        remove_inherited_access_list(new)?;
    }
    for name in names.iter().filter(|name| !OF_ONE_INODE.contains(&name.as_c_str())) {
        copy(old, new, name).map_err(|error| lost(name, error))?;
    }
    let mode = metadata.mode() & 0o777;
    let mode = if has_group { mode } else { without_group(mode) };
    // On FAT all files have one mode, which not every user may set.
    if new.metadata()?.mode() & 0o777 != mode {
        new.set_permissions(Permissions::from_mode(mode))?;
    }
    Ok(())
}

/// Returns true if two files give the same access, as far as owner, group and mode tell.
pub(in crate::shell::store) fn is_same_access(one: &Metadata, other: &Metadata) -> bool {
    let access = |file: &Metadata| (file.uid(), file.gid(), file.mode());
    access(one) == access(other)
}

/// Returns the fault of a file that its mode protects. A save does not write to the file itself, so
/// the system would not refuse it.
pub(in crate::shell::store) fn require_write_permission(
    target: &Path,
    metadata: &Metadata,
) -> Result<(), Diagnostic> {
    if access(target, AccessFlags::W_OK) != Err(nix::Error::EACCES) {
        return Ok(());
    }
    let is_own = metadata.uid() == Uid::effective().as_raw();
    let cause = if is_own { "write-protected" } else { "belongs to another user" };
    let remedy = if is_own { "chmod u+w, or save elsewhere" } else { "save elsewhere" };
    Err(Diagnostic::new(cause).with_remedy(remedy))
}

/// Opens what the saves to a folder are locked by: the folder.
pub(in crate::shell::store) fn open_lock(folder: &Path) -> io::Result<File> {
    File::open(folder)
}

/// Sets owner and group; returns true if the group is the old one.
fn keep_owner(old: &Metadata, new: &File) -> io::Result<bool> {
    let present = new.metadata()?;
    let (user, group) = (Uid::from_raw(old.uid()), Gid::from_raw(old.gid()));
    if present.uid() != old.uid() {
        is_permitted(fchown(new, Some(user), None))?;
    }
    Ok(present.gid() == old.gid() || is_permitted(fchown(new, None, Some(group)))?)
}

/// Returns false if the system does not permit the change: to this user, or to this file.
fn is_permitted(changed: nix::Result<()>) -> io::Result<bool> {
    match changed {
        Ok(()) => Ok(true),
        Err(nix::Error::EPERM | nix::Error::EINVAL) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// The mode of a file whose group changes: its former group belongs to all other users now, and
/// some of those to its group.
fn without_group(mode: u32) -> u32 {
    let both = (mode >> 3) & mode & 0o007;
    mode & 0o700 | both << 3 | both
}

/// Names of the extended attributes; empty if the file system has none.
fn names(file: &File) -> Result<Vec<CString>, AttributeError> {
    let mut list = vec![0; MAX_ATTRIBUTE_BYTES];
    match flistxattr(file, &mut list[..]) {
        Ok(size) => Ok(list[..size]
            .split_inclusive(|&byte| byte == 0)
            .filter_map(|name| CStr::from_bytes_with_nul(name).ok().map(CStr::to_owned))
            .collect()),
        Err(Errno::NOTSUP | Errno::NOSYS) => Ok(Vec::new()),
        Err(error) => {
            let cause = format!("its attributes cannot be read: {}", text_of(error));
            Err(AttributeError::NotKept(save_elsewhere(cause)))
        }
    }
}

/// Copies an attribute, unless `new` has it already, as a label given by the system.
fn copy(old: &File, new: &File, name: &CStr) -> Result<(), Errno> {
    let value = value(old, name)?;
    if self::value(new, name).is_ok_and(|present| present == value) {
        return Ok(());
    }
    fsetxattr(new, name, &value, XattrFlags::empty())
}

fn value(file: &File, name: &CStr) -> Result<Vec<u8>, Errno> {
    let mut value = vec![0; MAX_ATTRIBUTE_BYTES];
    let size = fgetxattr(file, name, &mut value[..])?;
    value.truncate(size);
    Ok(value)
}

/// Removes the access control list that the folder gives to new files.
fn remove_inherited_access_list(new: &File) -> Result<(), AttributeError> {
    match fremovexattr(new, ACCESS_LIST) {
        Ok(()) | Err(NO_ATTRIBUTE | Errno::NOTSUP | Errno::NOSYS) => Ok(()),
        Err(error) => {
            let cause = format!("access list of its folder cannot be removed: {}", text_of(error));
            Err(AttributeError::NotKept(save_elsewhere(cause)))
        }
    }
}

fn lost(name: &CStr, error: Errno) -> AttributeError {
    let name = printable(name.to_bytes());
    let cause = format!("attribute {name} cannot be kept: {}", text_of(error));
    AttributeError::NotKept(save_elsewhere(cause))
}

fn text_of(error: Errno) -> String {
    without_number(&error.into())
}

fn save_elsewhere(cause: String) -> Diagnostic {
    Diagnostic::new(cause).with_remedy("save elsewhere")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Which user gets which permission cannot be tested without several users.
    #[test]
    fn mode_without_its_group_widens_no_access() {
        for (mode, kept) in [
            (0o644, 0o644),
            (0o640, 0o600),
            (0o664, 0o644),
            (0o666, 0o666),
            (0o604, 0o600),
            (0o660, 0o600),
            (0o751, 0o711),
        ] {
            assert_eq!(without_group(mode), kept, "{mode:o}");
        }
    }
}
