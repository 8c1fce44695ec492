//! Why the rest of a log cannot be read. Plain values; does not know how formats find it.

/// Bytes without a frame, or without a line end, after which input does not count as a log. Chosen: no
/// line is as long, nor is what a server says before its first frame, and input that never ends has as
/// much within a second.
pub const MAX_WITHOUT_FRAME: u64 = 16 << 20;

/// Damage after which nothing of a log can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Damage {
    /// The file ends inside a block.
    #[error("truncated inside a block")]
    Truncated,
    /// A block has an impossible length, so the start of the next one is unknown.
    #[error("invalid block length of {0} bytes: the rest cannot be read")]
    Length(u32),
    /// The two lengths of a block, at its start and its end, differ.
    #[error("the two lengths of a block differ: the rest cannot be read")]
    Lengths,
    /// A section has no known byte order.
    #[error("section without byte-order magic: the rest cannot be read")]
    ByteOrder,
    /// A BLF log has something else where an object begins.
    #[error("no object where one begins: the rest cannot be read")]
    Object,
    /// The compressed data is damaged.
    #[error("damaged compression: the rest cannot be read")]
    Compression,
    /// Decompression needs more memory than descan uses for it.
    #[error("its compression needs over 128 MB of memory; pack it again, with a smaller window")]
    Window,
    /// The compressed data is of a kind that is not read.
    #[error("compressed with a filter that descan does not have; unpack it with xz -d")]
    Filter,
    /// A page of a database, by its number, is not what it must be.
    #[error("page {0} of the database is damaged: the rest cannot be read")]
    Page(u32),
    /// A page of a database is behind the end of the file.
    #[error("page {0} of the database is missing: the rest cannot be read")]
    PageMissing(u32),
    /// A block of a measurement is missing or not what it must be.
    #[error("damaged block: the rest of its data cannot be read")]
    Block,
    /// A measurement has no group of frames.
    #[error(
        "the measurement has no frames as ASAM bus logging has them; export them as ASC or BLF"
    )]
    NoBusLog,
    /// A measurement has more groups of frames than are read.
    #[error("over 64 groups of frames: those behind them are not read; export it as ASC or BLF")]
    TooManyGroups,
    /// The times of a measurement have a conversion that is not read.
    #[error(
        "the conversion of its times is not read: only linear ones are; export it as ASC or BLF"
    )]
    Conversion,
    /// A measurement has data in blocks that are not read: stored by columns, compressed to over 8 MB or not
    /// with deflate, or over 65,536 in one list.
    #[error(
        "data stored by columns, compressed blocks over 8 MB or not of deflate, and lists of over 65,536 blocks \
         are not read; export it as ASC or BLF"
    )]
    UnreadBlock,
    /// Groups of a measurement have so many records fewer than their cycle counts.
    #[error("{0} records are missing: the cycle counts of its groups are higher")]
    RecordsMissing(u32),
    /// The text of a database is not UTF-8.
    #[error("its text is UTF-16, not UTF-8 as python-can writes it")]
    Utf16,
    /// A database has not the table of python-can.
    #[error("the database has no table messages, as python-can writes it")]
    NoTable,
    /// A text of [`MAX_WITHOUT_FRAME`] bytes without a line end.
    #[error("no line end in 16 MB: the rest is not read")]
    NoLineEnd,
    /// Lines of [`MAX_WITHOUT_FRAME`] bytes, none of which is a frame.
    #[error("no frame in the first 16 MB: the rest is not read")]
    NoFrame,
}

impl Damage {
    /// Returns true if the rest becomes readable when the file grows.
    pub fn is_truncated(self) -> bool {
        self == Damage::Truncated
    }

    /// Returns true if its text says where it is.
    pub(super) fn has_place(self) -> bool {
        matches!(
            self,
            Self::Page(_)
                | Self::PageMissing(_)
                | Self::NoTable
                | Self::NoBusLog
                | Self::TooManyGroups
                | Self::Conversion
                | Self::UnreadBlock
                | Self::RecordsMissing(_)
                | Self::Utf16
        )
    }
}
