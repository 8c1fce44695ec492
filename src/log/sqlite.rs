//! Databases of SQLite with the frames that python-can's `SqliteWriter` stores: its table `messages`.
//!
//! Source: "Database File Format" of sqlite.org. Read is what one table in the order of its row numbers
//! needs: the head of the file, the table of tables, pages of tables, and the rest of long rows in overflow
//! pages. The write-ahead log beside a database is not read; that is noted. The memory is bounded by one page
//! and one row. In a table the row numbers rise and each page but the root has rows, so that pages in a loop
//! are found at once. Does not know moments or bus numbers.

use super::Damage;
use super::bus_errors::bus_error;
use super::entry_stream::EntryWriter;
use super::fields::{FieldFault, can_id, data_frame};
use super::random_access::{RandomAccess, RandomFormat, read_full_at};
use super::summary::UnreadChanges;
use crate::frame::{CanId, Frame};
use std::io;

/// First bytes of a database.
pub(super) const MAGIC: &[u8] = b"SQLite format 3\0";
/// Bytes of the head of a file.
const FILE_HEAD: usize = 100;
/// Table of python-can.
const TABLE: &str = "messages";
/// Its columns, in the order of [`MessageColumns`].
const COLUMNS: [&str; 7] = ["ts", "arbitration_id", "extended", "remote", "error", "dlc", "data"];
/// The number of its only channel.
const CHANNEL: u8 = 0;
/// Types of pages.
const INTERIOR: u8 = 5;
const LEAF: u8 = 13;
/// Most pages between the root of a table and a row: with two rows each it would have a million of them.
const MAX_DEPTH: usize = 20;
/// Longest row that is read, in bytes.
const MAX_ROW: u64 = 1 << 16;
/// Most columns that are looked at.
const MAX_COLUMNS: usize = 64;

/// Reads a database.
#[derive(Debug)]
pub(super) struct SqliteTable {
    /// What the file beside it has, which is not read.
    unread: Option<UnreadChanges>,
    stage: SqliteStage,
}

#[derive(Debug)]
enum SqliteStage {
    /// Nothing was read.
    Start,
    Rows {
        walk: TableWalk,
        columns: [usize; COLUMNS.len()],
    },
    End,
}

/// Why a row or the rest of a table is not read.
enum RowFault {
    Damage(Damage),
    File(io::Error),
}

impl From<io::Error> for RowFault {
    fn from(error: io::Error) -> Self {
        Self::File(error)
    }
}

impl From<Damage> for RowFault {
    fn from(damage: Damage) -> Self {
        Self::Damage(damage)
    }
}

impl SqliteTable {
    pub fn new(unread: Option<UnreadChanges>) -> Self {
        Self { unread, stage: SqliteStage::Start }
    }

    /// Reads the head of the file and finds the table.
    fn begin(
        &self,
        bytes: &dyn RandomAccess,
        out: &mut EntryWriter,
    ) -> Result<SqliteStage, RowFault> {
        let mut head = [0; FILE_HEAD];
        if read_full_at(bytes, &mut head, 0)? < FILE_HEAD {
            return Err(Damage::PageMissing(1).into());
        }
        if let Some(unread) = self.unread {
            out.unread_changes(unread);
        }
        let sizes = PageSizes::of_head(&head).ok_or(Damage::Page(1))?;
        if matches!(head[56..60], [0, 0, 0, 2 | 3]) {
            return Err(Damage::Utf16.into());
        }
        let mut tables = TableWalk::new(sizes, 1);
        loop {
            match tables.next_row(bytes)? {
                Some(Ok(row)) => {
                    if let Some((root, columns)) = table_of(row) {
                        let walk = TableWalk::new(sizes, root);
                        return Ok(SqliteStage::Rows { walk, columns });
                    }
                }
                Some(Err(_)) => {}
                None => return Err(Damage::NoTable.into()),
            }
        }
    }

    fn step(&mut self, bytes: &dyn RandomAccess, out: &mut EntryWriter) -> Result<bool, RowFault> {
        /// Bytes of entries that are given at once.
        const PART: usize = 1 << 14;
        match &mut self.stage {
            SqliteStage::Start => self.stage = self.begin(bytes, out)?,
            SqliteStage::Rows { walk, columns } => {
                while out.bytes().len() < PART {
                    let Some(row) = walk.next_row(bytes)? else { return Ok(false) };
                    match row.and_then(|row| message(row, columns)) {
                        Ok((unix_micros, frame)) => out.frame(unix_micros, CHANNEL, &frame),
                        Err(fault) => out.fault(fault),
                    }
                }
            }
            SqliteStage::End => return Ok(false),
        }
        Ok(true)
    }
}

impl RandomFormat for SqliteTable {
    fn read_on(&mut self, bytes: &dyn RandomAccess, out: &mut EntryWriter) -> io::Result<bool> {
        let has_more = match self.step(bytes, out) {
            Ok(has_more) => has_more,
            Err(RowFault::File(error)) => return Err(error),
            Err(RowFault::Damage(damage)) => {
                out.damage(damage);
                false
            }
        };
        if !has_more {
            self.stage = SqliteStage::End;
        }
        Ok(has_more)
    }
}

/// Returns the root page and the places of the columns, if a row of the table of tables is that of
/// [`TABLE`]; a column that is missing is a fault of each row.
fn table_of(row: &[u8]) -> Option<(u32, [usize; COLUMNS.len()])> {
    let mut values = [SqliteValue::Null; 5];
    read_record(row, &mut values).ok()?;
    let [kind, name, _, root, text] = values;
    if kind != SqliteValue::Bytes(b"table")
        || !matches!(name, SqliteValue::Bytes(name) if name.eq_ignore_ascii_case(TABLE.as_bytes()))
    {
        return None;
    }
    let (SqliteValue::Int(root), SqliteValue::Bytes(text)) = (root, text) else { return None };
    let names = column_names(text);
    let place =
        |column: &str| names.iter().position(|name| name.eq_ignore_ascii_case(column.as_bytes()));
    Some((u32::try_from(root).ok()?, COLUMNS.map(|column| place(column).unwrap_or(MAX_COLUMNS))))
}

/// Returns the names of the columns of `CREATE TABLE name(column TYPE, …)`.
fn column_names(text: &[u8]) -> Vec<&[u8]> {
    let start = text.iter().position(|byte| *byte == b'(').map_or(text.len(), |at| at + 1);
    let (mut depth, mut names, mut is_first) = (0_usize, Vec::new(), true);
    let mut rest = &text[start..];
    while let Some((&byte, after)) = rest.split_first() {
        match byte {
            b'(' => depth += 1,
            b')' if depth == 0 => break,
            b')' => depth -= 1,
            b',' if depth == 0 => is_first = true,
            _ if is_first && !byte.is_ascii_whitespace() => {
                is_first = false;
                let quote = matches!(byte, b'"' | b'`' | b'\'' | b'[');
                let word = if quote { after } else { rest };
                let is_end = |byte: &u8| {
                    if quote {
                        matches!(byte, b'"' | b'`' | b'\'' | b']')
                    } else {
                        byte.is_ascii_whitespace() || b",()".contains(byte)
                    }
                };
                let end = word.iter().position(is_end).unwrap_or(word.len());
                names.push(&word[..end]);
                rest = &word[end..];
                if quote {
                    rest = rest.get(1..).unwrap_or_default();
                }
                if names.len() == MAX_COLUMNS {
                    break;
                }
                continue;
            }
            _ => {}
        }
        rest = after;
    }
    names
}

/// Returns the time, in microseconds since 1970, and the frame of a row.
fn message(row: &[u8], columns: &[usize; COLUMNS.len()]) -> Result<(u64, Frame), FieldFault> {
    let mut all = [SqliteValue::Null; MAX_COLUMNS];
    read_record(row, &mut all)?;
    let [ts, id, extended, remote, error, dlc, data] =
        columns.map(|at| all.get(at).copied().unwrap_or(SqliteValue::Null));
    let seconds = match ts {
        SqliteValue::Real(seconds) => seconds,
        // A column of real numbers stores whole ones as integers.
        SqliteValue::Int(seconds) => seconds as f64,
        _ => return Err(FieldFault::Date),
    };
    let micros = (seconds * 1e6).round();
    if !(0.0..=1e18).contains(&micros) {
        return Err(FieldFault::TimeRange);
    }
    let flag = |value| match value {
        SqliteValue::Int(0) => Ok(false),
        SqliteValue::Int(1) => Ok(true),
        _ => Err(FieldFault::Column),
    };
    let SqliteValue::Int(id) = id else { return Err(FieldFault::Id) };
    let id = u32::try_from(id).map_err(|_| FieldFault::Id)?;
    let SqliteValue::Int(len) = dlc else { return Err(FieldFault::Length) };
    let len = usize::try_from(len).map_err(|_| FieldFault::Length)?;
    let (is_extended, is_remote, is_error) = (flag(extended)?, flag(remote)?, flag(error)?);
    if is_remote && !is_error {
        let len = Some(len).filter(|len| *len <= Frame::MAX_CLASSIC_DATA);
        let frame = Frame::remote(can_id(Some(id), is_extended)?, len.ok_or(FieldFault::Length)?);
        return Ok((micros as u64, frame));
    }
    let data = match data {
        SqliteValue::Bytes(data) => data,
        SqliteValue::Null => &[],
        _ => return Err(FieldFault::Data),
    };
    if data.len() != len {
        return Err(FieldFault::Data);
    }
    let frame = if is_error {
        error_frame(id, data)?
    } else {
        let is_fd = len > Frame::MAX_CLASSIC_DATA;
        data_frame(can_id(Some(id), is_extended)?, data, is_fd.then_some(0))?
    };
    Ok((micros as u64, frame))
}

/// Returns an error frame with its class and details; one without them is an error frame on the bus.
fn error_frame(class: u32, data: &[u8]) -> Result<Frame, FieldFault> {
    match data.len() {
        _ if class > CanId::MAX_EXTENDED => Err(FieldFault::Id),
        0 if class == 0 => Ok(bus_error()),
        0..=Frame::MAX_CLASSIC_DATA => Ok(Frame::error(class, data)),
        _ => Err(FieldFault::Length),
    }
}

// --- records ------------------------------------------------------------------------------

/// A value of a row. Text is bytes, too.
#[derive(Clone, Copy, Debug, PartialEq)]
enum SqliteValue<'b> {
    Null,
    Int(i64),
    Real(f64),
    Bytes(&'b [u8]),
}

/// Reads the first values of a row; those that it lacks stay as they are.
fn read_record<'b>(row: &'b [u8], values: &mut [SqliteValue<'b>]) -> Result<(), FieldFault> {
    let (head_len, start) = varint(row).ok_or(FieldFault::Column)?;
    let head_len = usize::try_from(head_len).unwrap_or(usize::MAX);
    let mut types = row.get(start..head_len).ok_or(FieldFault::Column)?;
    let mut body = &row[head_len..];
    for value in values {
        if types.is_empty() {
            break;
        }
        let (kind, len) = varint(types).ok_or(FieldFault::Column)?;
        types = &types[len..];
        let size = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind,
            5 => 6,
            6 | 7 => 8,
            10 | 11 => return Err(FieldFault::Column),
            _ => (kind - 12) / 2,
        };
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let (bytes, rest) = body.split_at_checked(size).ok_or(FieldFault::Column)?;
        body = rest;
        *value = match kind {
            0 => SqliteValue::Null,
            8 => SqliteValue::Int(0),
            9 => SqliteValue::Int(1),
            1..=6 => SqliteValue::Int(signed(bytes)),
            7 => SqliteValue::Real(f64::from_bits(signed(bytes).cast_unsigned())),
            _ => SqliteValue::Bytes(bytes),
        };
    }
    Ok(())
}

/// Returns the signed number of at most eight big-endian bytes.
fn signed(bytes: &[u8]) -> i64 {
    let start = if bytes.first().is_some_and(|byte| *byte >= 0x80) { -1 } else { 0 };
    bytes.iter().fold(start, |number, byte| number << 8 | i64::from(*byte))
}

/// Returns a number of variable length, and its bytes; `None` if it is cut off.
fn varint(bytes: &[u8]) -> Option<(u64, usize)> {
    let mut number = 0;
    for (at, byte) in bytes.iter().take(8).enumerate() {
        number = number << 7 | u64::from(byte & 0x7F);
        if byte & 0x80 == 0 {
            return Some((number, at + 1));
        }
    }
    // The ninth byte has eight bits.
    bytes.get(8).map(|byte| (number << 8 | u64::from(*byte), 9))
}

// --- pages --------------------------------------------------------------------------------

/// The size of the pages of a database.
#[derive(Clone, Copy, Debug)]
struct PageSizes {
    page: usize,
    /// Without the bytes at its end that are reserved.
    usable: usize,
}

impl PageSizes {
    fn of_head(head: &[u8; FILE_HEAD]) -> Option<Self> {
        let page = match u16::from_be_bytes([head[16], head[17]]) {
            1 => 1 << 16,
            size => usize::from(size),
        };
        let usable = page.checked_sub(usize::from(head[20]))?;
        (page.is_power_of_two() && page >= 512 && usable >= 480).then_some(Self { page, usable })
    }

    /// Returns how many bytes of a row of `len` bytes are in the page of the row.
    fn local_len(self, len: u64) -> usize {
        let usable = self.usable as u64;
        if len <= usable - 35 {
            return len as usize;
        }
        let least = (usable - 12) * 32 / 255 - 23;
        let wanted = least + (len - least) % (usable - 4);
        (if wanted <= usable - 35 { wanted } else { least }) as usize
    }
}

/// A page that is an inner node of a table, and the next of its children.
#[derive(Debug)]
struct InteriorPage {
    page: u32,
    child: usize,
}

/// The rows of a table in the order of their numbers.
#[derive(Debug)]
struct TableWalk {
    sizes: PageSizes,
    root: u32,
    has_begun: bool,
    above: Vec<InteriorPage>,
    /// The page that was read last; its number is 0 before the first one.
    page: Vec<u8>,
    page_number: u32,
    /// The next row of `page`, if that is a leaf, and the number of its rows.
    cell: usize,
    cells: usize,
    last_row: Option<i64>,
    row: Vec<u8>,
}

impl TableWalk {
    fn new(sizes: PageSizes, root: u32) -> Self {
        Self {
            sizes,
            root,
            has_begun: false,
            above: Vec::new(),
            page: Vec::new(),
            page_number: 0,
            cell: 0,
            cells: 0,
            last_row: None,
            row: Vec::new(),
        }
    }

    fn damage(&self) -> RowFault {
        Damage::Page(self.page_number).into()
    }

    /// Returns the next row; `None` at the end of the table.
    fn next_row(
        &mut self,
        bytes: &dyn RandomAccess,
    ) -> Result<Option<Result<&[u8], FieldFault>>, RowFault> {
        while self.cell == self.cells {
            if !self.next_leaf(bytes)? {
                return Ok(None);
            }
        }
        let at = self.cell_start(self.cell).ok_or_else(|| self.damage())?;
        self.cell += 1;
        let cell = &self.page[at..self.sizes.usable];
        let (len, used) = varint(cell).ok_or_else(|| self.damage())?;
        let (number, more) = varint(&cell[used..]).ok_or_else(|| self.damage())?;
        let number = number.cast_signed();
        if self.last_row.is_some_and(|last| last >= number) {
            return Err(self.damage());
        }
        self.last_row = Some(number);
        let payload = &cell[used + more..];
        let local = self.sizes.local_len(len);
        let here = payload.get(..local).ok_or_else(|| self.damage())?;
        self.row.clear();
        self.row.extend_from_slice(here);
        if local as u64 == len {
            return Ok(Some(Ok(&self.row)));
        }
        let next = payload[local..].first_chunk().ok_or_else(|| self.damage())?;
        let next = u32::from_be_bytes(*next);
        if len > MAX_ROW {
            return Ok(Some(Err(FieldFault::Length)));
        }
        self.read_overflow(bytes, next, len as usize)?;
        Ok(Some(Ok(&self.row)))
    }

    /// Appends the pages from `next` on to the row, until it has `len` bytes.
    fn read_overflow(
        &mut self,
        bytes: &dyn RandomAccess,
        mut next: u32,
        len: usize,
    ) -> Result<(), RowFault> {
        let mut page = Vec::new();
        while self.row.len() < len {
            if next == 0 {
                return Err(self.damage());
            }
            read_page(bytes, self.sizes, next, &mut page)?;
            let [a, b, c, d, rest @ ..] = &page[..self.sizes.usable] else { return Ok(()) };
            let count = rest.len().min(len - self.row.len());
            self.row.extend_from_slice(&rest[..count]);
            next = u32::from_be_bytes([*a, *b, *c, *d]);
        }
        Ok(())
    }

    /// Reads the next page with rows; returns false at the end of the table.
    fn next_leaf(&mut self, bytes: &dyn RandomAccess) -> Result<bool, RowFault> {
        if !std::mem::replace(&mut self.has_begun, true) {
            return self.descend(bytes, self.root);
        }
        while let Some(above) = self.above.last_mut() {
            let (page, child) = (above.page, above.child);
            above.child += 1;
            self.load(bytes, page)?;
            let start = self.head_start();
            let cells = self.cell_count();
            let pointer = match child {
                child if child < cells => self.cell_start(child),
                // The last child stands in the head of the page.
                child if child == cells => Some(start + 8),
                _ => {
                    self.above.pop();
                    continue;
                }
            };
            let pointer = pointer.and_then(|at| self.page.get(at..)?.first_chunk::<4>());
            let next = u32::from_be_bytes(*pointer.ok_or_else(|| self.damage())?);
            return self.descend(bytes, next);
        }
        Ok(false)
    }

    /// Reads a page and its first children down to one with rows. Returns false if a table is empty.
    fn descend(&mut self, bytes: &dyn RandomAccess, page: u32) -> Result<bool, RowFault> {
        self.load(bytes, page)?;
        match self.page[self.head_start()] {
            INTERIOR if self.above.len() < MAX_DEPTH => {
                self.above.push(InteriorPage { page, child: 0 });
                (self.cell, self.cells) = (0, 0);
                self.next_leaf(bytes)
            }
            LEAF => {
                (self.cell, self.cells) = (0, self.cell_count());
                if self.cells == 0 && !self.above.is_empty() {
                    return Err(self.damage());
                }
                Ok(self.cells > 0)
            }
            _ => Err(self.damage()),
        }
    }

    fn load(&mut self, bytes: &dyn RandomAccess, page: u32) -> Result<(), RowFault> {
        self.page_number = page;
        read_page(bytes, self.sizes, page, &mut self.page)
    }

    /// Returns where the head of the page starts: the first one has the head of the file before it.
    fn head_start(&self) -> usize {
        if self.page_number == 1 { FILE_HEAD } else { 0 }
    }

    fn cell_count(&self) -> usize {
        let start = self.head_start();
        usize::from(u16::from_be_bytes([self.page[start + 3], self.page[start + 4]]))
    }

    /// Returns where a cell of the page starts; `None` outside the page.
    fn cell_start(&self, cell: usize) -> Option<usize> {
        let start = self.head_start();
        let head = if self.page[start] == INTERIOR { 12 } else { 8 };
        let pointer = self.page.get(start + head + 2 * cell..)?.first_chunk()?;
        let at = usize::from(u16::from_be_bytes(*pointer));
        (at < self.sizes.usable).then_some(at)
    }
}

/// Reads a page by its number, which counts from 1.
fn read_page(
    bytes: &dyn RandomAccess,
    sizes: PageSizes,
    number: u32,
    page: &mut Vec<u8>,
) -> Result<(), RowFault> {
    let before = number.checked_sub(1).ok_or(Damage::Page(0))?;
    page.resize(sizes.page, 0);
    let count = read_full_at(bytes, page, u64::from(before) * sizes.page as u64)?;
    if count < sizes.page { Err(Damage::PageMissing(number).into()) } else { Ok(()) }
}
