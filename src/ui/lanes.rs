//! Lanes of the Timeline page.

use super::brush::DrawContext;

/// Draws the lanes.
pub fn draw(_brush: &mut DrawContext) {}
