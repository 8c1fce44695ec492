//! The command `descan`.

fn main() {}
