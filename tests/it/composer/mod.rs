//! The composer: frames by fields and in words, what it says of them, and sending them.

mod dialog;
mod headless;
mod sending;
mod words;
