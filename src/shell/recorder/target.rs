//! Destination of a recording: names and sizes of its files.

use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Number of the second file of a recording; the first has none in its name.
pub const SECOND_FILE: u32 = 2;
pub const LAST_FILE: u32 = 99_999;

/// Destination of a recording and size limit of its files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// The first file.
    pub path: PathBuf,
    /// Size limit of a file in bytes; `None`: one file.
    pub max_bytes: Option<u64>,
}

/// A size in bytes, as given on the command line: `100M`, `500k`, `2G`, `65536`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size(pub u64);

impl Size {
    /// Smallest size: smaller files would consist mostly of headers.
    const LEAST: u64 = 10_000;
}

impl FromStr for Size {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        let unit = match text[digits.len()..].to_ascii_lowercase().as_str() {
            "" | "b" => 1,
            "k" | "kb" => 1_000,
            "m" | "mb" => 1_000_000,
            "g" | "gb" => 1_000_000_000,
            _ => 0,
        };
        let bytes = digits.parse().ok().and_then(|count: u64| count.checked_mul(unit));
        bytes
            .filter(|bytes| *bytes >= Self::LEAST)
            .map(Size)
            .ok_or("a size like 500k, 100M or 2G, at least 10k")
    }
}

/// Returns the path of the file with this number: `session.log`, `session_00002.log`.
pub fn numbered(path: &Path, number: u32) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("_{number:05}."));
    name.push(path.extension().unwrap_or_default());
    path.with_file_name(name)
}

/// Returns the first existing file that would follow this one; `None` if there is none.
pub fn first_numbered(path: &Path) -> Option<PathBuf> {
    let stem = path.file_stem()?.to_str()?;
    let folder = path.parent().filter(|it| !it.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut there: Vec<PathBuf> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|it| Some(it.ok()?.path()))
        .filter(|other| other.extension() == path.extension())
        .filter(|other| {
            let number = other.file_stem().and_then(|it| it.to_str()?.strip_prefix(stem));
            let digits = number.and_then(|it| it.strip_prefix('_')).unwrap_or_default();
            digits.len() == 5 && digits.bytes().all(|digit| digit.is_ascii_digit())
        })
        .collect();
    there.sort();
    there.into_iter().next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_as_they_are_written() {
        let size = |text: &str| text.parse().map(|Size(bytes)| bytes);
        assert_eq!(size("100M"), Ok(100_000_000));
        assert_eq!(size("500k"), Ok(500_000));
        assert_eq!(size("2GB"), Ok(2_000_000_000));
        assert_eq!(size("65536"), Ok(65_536));
        for wrong in ["", "M", "1k", "0", "-5M", "5x", "99999999999G", "1.5M"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn successive_files_have_numbers() {
        let second = numbered(Path::new("/tmp/a.b.log"), SECOND_FILE);
        assert_eq!(second, Path::new("/tmp/a.b_00002.log"));
    }
}
