//! Boards at a shared address: a row for each while their UIDs are known.
//!
//! Input: the row of a device in conflict, and the nodes that send heartbeats from its address.
//! Output: rows. A is the board that joined first. Does not know how a conflict is found.

use super::capture::decoded::uid_text;
use super::file_inputs::Inputs;
use super::view::{Board, FileStatus, Row, RowKey, RowState};
use crate::discovery::{AddressSender, Device};
use std::sync::Arc;

/// Boards with rows of their own at one address, at most: as many as values of an address are
/// remembered by the engine.
const MAX_BOARDS: usize = 8;

/// Returns what is known of a board at the address of a device, as a device: times, mode, services. What
/// the device had before belongs to the board that joined first.
fn device_of_board(device: &Device, board: &Board) -> Device {
    let sender = &board.sender;
    let mut own = device.clone();
    (own.uid, own.mode) = (Some(sender.uid), sender.mode);
    (own.first_seen, own.presence_since) = (sender.since, sender.since);
    // Modes of several boards in one list are those of none.
    own.mode_history.clear();
    let is_first = board.side == 'A';
    if !is_first {
        (own.rebooted_at, own.reboots, own.moved_from, own.error_code) = (None, 0, None, None);
        (own.previous_services, own.first_services) = (None, None);
    }
    for query in [&mut own.name_query, &mut own.services_query] {
        // A response before it joined is that of another board.
        if query.responded_at.is_some_and(|at| at < sender.since) {
            (query.sent_at, query.responded_at, query.response_time) = (None, None, None);
        }
    }
    // Which of the lists is whose is known only where one was received before the others joined.
    if !own.services_are_shared {
        let others = std::mem::take(&mut own.other_services);
        if !is_first {
            own.services = <[_; 1]>::try_from(others).ok().map(|[only]| only);
        }
    }
    own
}

impl Inputs<'_> {
    /// Returns a row for each board that is known at the address of a device in conflict; else its
    /// own row.
    pub(super) fn board_rows(&self, mut row: Row, device: &Device) -> Vec<Row> {
        let Some(bus) = self.buses.get(device.id.bus) else { return vec![row] };
        let mut senders = bus.senders_at(device.address);
        senders.truncate(MAX_BOARDS);
        if senders.len() < 2 || !row.redundant_ids.is_empty() {
            return vec![row];
        }
        if row.state != RowState::Conflict {
            // Mode and times are those of the board of this row; another one may have sent the last
            // heartbeat.
            let owner = senders.iter().find(|sender| sender.device == device.id);
            row.uid = owner.map(|owner| owner.uid).or(row.uid);
            return vec![row];
        }
        let is_current = bus.device_at(device.address).is_some_and(|it| it.id == device.id);
        let is_own = |sender: &AddressSender| {
            // A board without a row of its own here is known only by its heartbeats.
            let row = self.buses.device(sender.device);
            let is_rowless = row.is_none_or(|row| row.address != device.address);
            sender.device == device.id || is_current && is_rowless
        };
        let all = senders.iter().zip('A'..);
        let own: Vec<Board> = all
            .filter(|(sender, _)| is_own(sender))
            .map(|(sender, side)| Board { side, sender: *sender })
            .collect();
        // An entry belongs to the board with its UID, else to the first one.
        let alphabet = bus.config().profile.clone();
        let listed = row.entry.and_then(|place| self.documents.entry(place)?.uid.as_deref());
        let holder = own.iter().position(|board| {
            listed
                .is_some_and(|listed| uid_text(&alphabet, board.sender.uid).trim() == listed.trim())
        });
        let holder = holder.unwrap_or(0);
        let rows = own.iter().enumerate().map(|(at, board)| {
            let mut row = Row { board: Some(*board), uid: Some(board.sender.uid), ..row.clone() };
            row.board_device = Some(Arc::new(device_of_board(device, board)));
            if at > 0 {
                row.key = RowKey::Board(device.id, board.sender.uid);
            }
            if at != holder && row.entry.take().is_some() {
                row.file = if self.has_file(device.id.bus) {
                    FileStatus::New
                } else {
                    FileStatus::Nothing
                };
                (row.has_findings, row.has_other_services, row.differences) = (false, false, 0);
            }
            row
        });
        let rows: Vec<Row> = rows.collect();
        if rows.is_empty() { vec![row] } else { rows }
    }
}
