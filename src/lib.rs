//! descan.
pub mod document;
pub mod shell;
