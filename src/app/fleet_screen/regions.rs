//! The regions of the screen of a fleet, for drawing and for the mouse.
//!
//! ```text
//!  mqtts://broker  connected                    status
//!  12 gateways  ● 10 online  ○ 1 lost
//!  ! connection refused; next attempt in 4 s    banners
//!  1 Gateways  2 Versions  3 Problems ───       tabs
//!    GATEWAY  STATE  FOR  BUSES …               header
//! ▸● north    online 3d   can0 125k             list
//! ─ north ───────────────────────────           details
//! ─ latest ──────────────────────────           latest
//!  ? help  Enter open                           footer
//! ```
//!
//! Input: the size, the number of banners, whether the details take the place of the list. Does not know
//! the content.

use ratatui::layout::Rect;

/// Height from which the status has two lines.
const TWO_STATUS_LINES: u16 = 12;
/// Height from which details and events are below the list.
pub(super) const HIGH: u16 = 20;
/// Height from which they have more lines.
const VERY_HIGH: u16 = 34;

/// Regions of the screen; one that is not shown is empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FleetRegions {
    /// The whole screen.
    pub whole: Rect,
    /// Broker, connection, sums.
    pub status: Rect,
    /// What is wrong with the connection or the documents.
    pub banners: Rect,
    /// Names of the pages.
    pub tabs: Rect,
    /// Headings of the columns.
    pub header: Rect,
    /// The rows.
    pub list: Rect,
    /// Details of the selected row, with their title.
    pub details: Rect,
    /// The last events, with their title.
    pub latest: Rect,
    /// Keys, prompt or message.
    pub footer: Rect,
}

impl FleetRegions {
    /// Divides a screen; `has_details_alone` shows the details in place of the list.
    pub fn new(columns: u16, rows: u16, banners: u16, has_details_alone: bool) -> Self {
        let whole = Rect::new(0, 0, columns, rows);
        let mut top = 0;
        let mut take = |height: u16| {
            let height = height.min(rows - top);
            let area = Rect { y: top, height, ..whole };
            top += height;
            area
        };
        let footer_height = 1.min(rows);
        let status = take(if rows < TWO_STATUS_LINES { 1 } else { 2 });
        let banners = take(if rows < TWO_STATUS_LINES { banners.min(1) } else { banners });
        let tabs = take(1);
        let (details, latest) = match rows {
            _ if has_details_alone => (0, 0),
            0..HIGH => (0, 0),
            HIGH..VERY_HIGH => (5, 4),
            _ => (9, 6),
        };
        let header = take(u16::from(!has_details_alone));
        let used = status.height + banners.height + tabs.height + header.height + footer_height;
        let rest = rows.saturating_sub(used);
        let below = details + latest;
        let list = take(rest.saturating_sub(below));
        let details = if has_details_alone { list } else { take(details) };
        let list = if has_details_alone { Rect { height: 0, ..list } } else { list };
        let latest = take(latest);
        let footer = take(footer_height);
        Self { whole, status, banners, tabs, header, list, details, latest, footer }
    }
}
