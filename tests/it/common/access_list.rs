//! POSIX access control lists in the kernel's format, as extended attributes have them.

/// Name of the attribute.
pub const ATTRIBUTE: &str = "system.posix_acl_access";

/// Returns an access list with the permissions of the owner and of user 4242: the group may read,
/// others nothing; the mask is read and write.
pub const fn access_list(owner: u8, user: u8) -> [u8; 44] {
    [
        2, 0, 0, 0, //
        0x01, 0, owner, 0, 0xFF, 0xFF, 0xFF, 0xFF, //
        0x02, 0, user, 0, 0x92, 0x10, 0, 0, //
        0x04, 0, 4, 0, 0xFF, 0xFF, 0xFF, 0xFF, //
        0x10, 0, 6, 0, 0xFF, 0xFF, 0xFF, 0xFF, //
        0x20, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, //
    ]
}
