//! descan.
