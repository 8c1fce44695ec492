//! The proof of a problem. (stub)
use super::App;
impl App {
    pub(super) fn ask_proof_path(&mut self) {}
}
