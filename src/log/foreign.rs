//! Logs of formats that are not read: recognised by their first bytes or lines, and named with the
//! command that converts them. Does not read them.

use super::FormatMatch;
use std::fmt;

/// A log format that is not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ForeignFormat {
    /// Compressed with bzip2.
    Bzip2,
    /// An archive of files.
    Zip,
    /// An archive of files, not compressed.
    Tar,
    /// Text of two bytes per character.
    Utf16,
    /// Measurement data of ASAM, version 3 or older.
    Mdf,
    /// Text log of BUSMASTER.
    Busmaster,
}

/// What is known of a format.
struct Facts {
    /// What the log is, as in `FILE: NAME`.
    name: &'static str,
    /// The way to a log that is read.
    remedy: &'static str,
    /// First bytes of a binary log.
    magics: &'static [&'static [u8]],
    /// First line of a text log.
    is_first_line: fn(&[u8]) -> bool,
    /// Usual ending of its files, without the dot.
    extension: Option<&'static str>,
}

/// Mark in the head of a tar archive, and its place: behind the name of the first file.
const TAR_MARK: &[u8] = b"ustar";
const TAR_MARK_AT: usize = 257;

/// No line of a binary log.
const NO_LINE: fn(&[u8]) -> bool = |_| false;

impl ForeignFormat {
    const ALL: [Self; 6] =
        [Self::Bzip2, Self::Zip, Self::Tar, Self::Utf16, Self::Mdf, Self::Busmaster];

    const fn facts(self) -> Facts {
        match self {
            Self::Bzip2 => Facts {
                name: "compressed with bzip2",
                remedy: "decompress it: bunzip2 -c LOG.bz2 | descan -",
                magics: &[b"BZh"],
                is_first_line: NO_LINE,
                extension: Some("bz2"),
            },
            Self::Zip => Facts {
                name: "a zip archive",
                remedy: "unpack it: unzip -p LOG.zip | descan -",
                magics: &[b"PK\x03\x04"],
                is_first_line: NO_LINE,
                extension: Some("zip"),
            },
            Self::Tar => Facts {
                name: "a tar archive",
                remedy: "unpack it: tar -xOf LOG.tar | descan -",
                magics: &[],
                is_first_line: NO_LINE,
                extension: Some("tar"),
            },
            Self::Utf16 => Facts {
                name: "UTF-16 text",
                remedy: "convert it: iconv -f UTF-16 -t UTF-8 LOG | descan -",
                magics: &[b"\xff\xfe", b"\xfe\xff"],
                is_first_line: NO_LINE,
                extension: None,
            },
            Self::Mdf => Facts {
                name: "an ASAM MDF log of version 3 or older",
                remedy: "convert it with asammdf: asammdf.MDF(OLD).convert('4.10').save(NEW)",
                magics: &[b"MDF     2", b"MDF     3"],
                is_first_line: NO_LINE,
                extension: Some("mdf"),
            },
            Self::Busmaster => Facts {
                name: "a BUSMASTER log",
                remedy: "export it from BUSMASTER as ASC",
                magics: &[],
                is_first_line: |line| line.starts_with(b"***BUSMASTER"),
                extension: None,
            },
        }
    }

    /// Returns true if a file name ending, in lower case, is that of a format that is not read.
    pub(super) fn has_extension(ending: &str) -> bool {
        Self::ALL.iter().any(|format| format.facts().extension == Some(ending))
    }

    /// Matches the first bytes of a log with the binary formats.
    pub(super) fn of_head(head: &[u8]) -> (Option<Self>, FormatMatch) {
        let mut result = (None, FormatMatch::No);
        match head.get(TAR_MARK_AT..TAR_MARK_AT + TAR_MARK.len()) {
            Some(mark) if mark == TAR_MARK => return (Some(Self::Tar), FormatMatch::Yes),
            // Behind the name of the first file are zeros, and no line ends there.
            None if head.contains(&0) && !head.contains(&b'\n') => {
                result.1 = FormatMatch::Undecided;
            }
            _ => {}
        }
        for format in Self::ALL {
            for magic in format.facts().magics {
                match FormatMatch::of_magic(magic, head) {
                    FormatMatch::Yes => return (Some(format), FormatMatch::Yes),
                    FormatMatch::Undecided => result.1 = FormatMatch::Undecided,
                    FormatMatch::No => {}
                }
            }
        }
        result
    }

    /// Returns the format of a log with this unreadable line, before which there was no frame.
    pub(super) fn of_line(line: &[u8]) -> Option<Self> {
        Self::ALL.into_iter().find(|format| (format.facts().is_first_line)(line))
    }
}

/// Formats what the log is and the way out: `a Vector ASC log; convert it with …`.
impl fmt::Display for ForeignFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Facts { name, remedy, .. } = self.facts();
        write!(f, "{name}; {remedy}")
    }
}
