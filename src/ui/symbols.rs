//! Symbols and state words of the screen with their meanings, for the help and the guide.

use crate::finding::FindingState;
use crate::theme::Role;

/// Each symbol: its role, the text as shown on the screen, and its meaning.
pub const SYMBOLS: [(Role, &str, &str); 37] = [
    (Role::Online, "● online", "heartbeats arrive"),
    (Role::Stale, "◐ stale", "heartbeat overdue"),
    (Role::Silent, "◌ silent", "frames but no heartbeats"),
    (Role::Asleep, "◒ asleep", "no heartbeats; last mode was IDLE"),
    (Role::Muted, "· unknown", "was online when its bus went down"),
    (Role::Stale, "◑ partial", "lost on one of its redundant buses"),
    (Role::Lost, "○ lost", "no frame for five heartbeat periods"),
    (Role::Missing, "○ missing", "listed in the file, not on the bus"),
    (Role::Muted, "· pending", "listed; too early to be missing"),
    (Role::Muted, "· dup", "duplicate entry"),
    (Role::Confirmed, "⚠ CONFLICT", "confirmed address conflict: see Problems"),
    (Role::Confirmed, "⚠ 2", "confirmed problems"),
    (Role::Suspected, "? 1", "suspected problems"),
    (Role::Muted, "✓ @14", "cleared problem"),
    (Role::Match, "◆ ◇", "evidence; ◇ = frame no longer in the capture"),
    (Role::Text, "NAME²", "same name at another address (allowed)"),
    (Role::FileOk, "✓ 12", "static address 12, matches"),
    (Role::FileDiffers, "✗ 16", "static address 16, differs"),
    (Role::FileDiffers, "✗ absent", "listed, not on the bus"),
    (Role::FileDiffers, "≠ 3 svc", "3 services differ from the file"),
    (Role::Muted, "… 12", "static address 12, device pending"),
    (Role::Muted, "· 12", "listed, not pinned; last at 12"),
    (Role::New, "+ new", "not in the file"),
    (Role::Warning, "! entry", "invalid entry: see the details"),
    (Role::SideA, "14A 14B", "boards at a shared address; A joined first"),
    (Role::Beat, "▂", "heartbeat on time; a cell is one period"),
    (Role::BeatBad, "▅ █ ×", "heartbeat late or early, two in one period, missed"),
    (Role::Changed, "2.1→2.2", "version changed since the device was first heard"),
    (Role::Suspected, "≈ assumed", "service numbers and layouts are assumed (no --profile)"),
    (Role::Text, "load ≈3%", "bit rate unknown: 125 kbit/s assumed"),
    (Role::Bar, "⣶⣾⣿ 5–8%", "load, 2 s a cell; least and most of the last minute"),
    (Role::Text, "load –", "a log or a virtual bus without a bit rate"),
    (Role::Warning, "listen-only, acks", "descan does not transmit; the controller still ACKs"),
    (Role::Recording, "● rec 12 MB", "recording, size written so far (--record)"),
    (Role::Online, "━ ─ ╌ ·", "lanes: in WORK, another mode, stale, lost"),
    (Role::Confirmed, "▓ ▒ ↻ !", "lanes: conflict, suspected one; reboot; bus errors"),
    (Role::Warning, "FROZEN", "a past moment on all pages; Space or Esc: the present"),
];

/// Returns the sign of a state and its role.
pub fn of_finding_state(state: FindingState) -> (&'static str, Role) {
    match state {
        FindingState::Confirmed => ("⚠", Role::Confirmed),
        FindingState::Suspected => ("?", Role::Suspected),
        FindingState::Cleared => ("✓", Role::Muted),
    }
}
