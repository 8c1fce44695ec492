//! What the signs on the screen are, and what they mean.

use crate::discovery::Confidence;
use crate::theme::Role;

/// The role, the sign as it is shown, and its meaning: for the help.
pub const SIGNS: [(Role, &str, &str); 25] = [
    (Role::Online, "● online", "its heartbeats come"),
    (Role::Stale, "◐ stale", "the last heartbeat is late"),
    (Role::Silent, "◌ silent", "frames come, but no heartbeats"),
    (Role::Asleep, "◒ asleep", "no heartbeats, and its last mode was IDLE"),
    (Role::Muted, "· unseen", "it was there when its bus went down"),
    (Role::Lost, "○ lost", "nothing for five heartbeat periods"),
    (Role::Missing, "○ missing", "listed in the file, not on the bus"),
    (Role::Muted, "· again", "listed twice: one is too many"),
    (Role::Collision, "⚠ CLASH", "a confirmed collision: see Problems"),
    (Role::Collision, "⚠ 2", "problems that are certain"),
    (Role::Suspected, "? 1", "suspicions; they may be innocent"),
    (Role::Muted, "✓ @14", "a problem that is over"),
    (Role::Match, "◆ ◇", "evidence; ◇ where the capture has forgotten the frame"),
    (Role::Text, "NAME²", "a twin: the same name at another address, which is fine"),
    (Role::FileOk, "✓ 12", "the file pins it to 12, and it is there"),
    (Role::FileDiffers, "✗ 16", "the file pins it to 16, and it is not there"),
    (Role::Muted, "  12", "listed, not pinned; last at 12"),
    (Role::FileDiffers, "4≠", "its services are not those that the file lists"),
    (Role::New, "+ new", "not in the file"),
    (Role::Warning, "  12!", "something is wrong with its entry: the details say what"),
    (
        Role::Suspected,
        "≈ assumed",
        "service numbers and layouts are assumed: no --profile is given",
    ),
    (Role::Text, "load ≈3%", "the bit rate is not known: reckoned with 125 kbit/s"),
    (Role::Warning, "listen-only, acks", "we send nothing, but the controller acknowledges frames"),
    (Role::Recording, "● rec 12 MB", "all frames are recorded: so much there is (--record)"),
    (Role::Warning, "HELD", "rows are held still, until the same key is pressed again"),
];

/// The sign and the role of a confidence.
pub fn of_confidence(confidence: Confidence) -> (&'static str, Role) {
    match confidence {
        Confidence::Confirmed => ("⚠", Role::Collision),
        Confidence::Suspected => ("?", Role::Suspected),
        Confidence::Cleared => ("✓", Role::Muted),
    }
}
