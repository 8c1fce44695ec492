//! Logs of formats that are not read: recognised by their first bytes or lines, and named with the
//! command that converts them. Does not read them.

use super::FormatMatch;
use std::fmt;

/// A log format that is not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ForeignFormat {
    /// Compressed with gzip.
    Gzip,
    /// Binary log of Vector's tools.
    VectorBlf,
    /// Text log of Vector's tools.
    VectorAsc,
    /// Trace of PEAK's tools.
    PcanTrc,
    /// Capture of tcpdump and of older Wireshark.
    Pcap,
    /// What candump prints without `-L`.
    CandumpScreen,
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

/// No line of a binary log.
const NO_LINE: fn(&[u8]) -> bool = |_| false;

impl ForeignFormat {
    const ALL: [Self; 6] = [
        Self::Gzip,
        Self::VectorBlf,
        Self::VectorAsc,
        Self::PcanTrc,
        Self::Pcap,
        Self::CandumpScreen,
    ];

    const fn facts(self) -> Facts {
        match self {
            Self::Gzip => Facts {
                name: "compressed with gzip",
                remedy: "decompress it: gunzip -c LOG.gz | descan -",
                magics: &[&[0x1F, 0x8B]],
                is_first_line: NO_LINE,
                extension: Some("gz"),
            },
            Self::VectorBlf => Facts {
                name: "a Vector BLF log",
                remedy: "convert it with python-can: python3 -m can.logconvert OLD.blf NEW.log",
                magics: &[b"LOGG"],
                is_first_line: NO_LINE,
                extension: Some("blf"),
            },
            Self::VectorAsc => Facts {
                name: "a Vector ASC log",
                remedy: "convert it with can-utils: asc2log -I OLD.asc -O NEW.log",
                magics: &[],
                is_first_line: |line| {
                    [&b"date "[..], b"base hex", b"base dec"].iter().any(|it| line.starts_with(it))
                },
                extension: Some("asc"),
            },
            Self::PcanTrc => Facts {
                name: "a PCAN trace",
                remedy: "convert it with python-can: python3 -m can.logconvert OLD.trc NEW.log",
                magics: &[],
                is_first_line: |line| {
                    line.starts_with(b";$FILEVERSION") || line.starts_with(b";##########")
                },
                extension: Some("trc"),
            },
            Self::Pcap => Facts {
                name: "a classic pcap file",
                remedy: "convert it with Wireshark: editcap -F pcapng OLD NEW.pcapng",
                // Either byte order, with times in microseconds or nanoseconds.
                magics: &[
                    &[0xA1, 0xB2, 0xC3, 0xD4],
                    &[0xD4, 0xC3, 0xB2, 0xA1],
                    &[0xA1, 0xB2, 0x3C, 0x4D],
                    &[0x4D, 0x3C, 0xB2, 0xA1],
                ],
                is_first_line: NO_LINE,
                extension: Some("pcap"),
            },
            Self::CandumpScreen => Facts {
                name: "candump's screen output",
                remedy: "use its log format: candump -L can0",
                magics: &[],
                is_first_line: is_candump_screen,
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

/// Returns true for `  can0  123   [2]  11 22`, also with a time in parentheses before it.
fn is_candump_screen(line: &[u8]) -> bool {
    let words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    let mut words = words.skip_while(|word| word.starts_with(b"(") && word.ends_with(b")"));
    let (_, id, length) = (words.next(), words.next(), words.next());
    let is_id = |id: &[u8]| [3, 8].contains(&id.len()) && id.iter().all(u8::is_ascii_hexdigit);
    let is_length = |word: &[u8]| {
        let inner = word.strip_prefix(b"[").and_then(|word| word.strip_suffix(b"]"));
        inner.is_some_and(|it| !it.is_empty() && it.iter().all(u8::is_ascii_digit))
    };
    id.is_some_and(is_id) && length.is_some_and(is_length)
}
