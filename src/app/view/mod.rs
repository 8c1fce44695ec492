//! The view: page, selection and scroll position of each list, filters, freezing, the regions of
//! the screen.
//!
//! Inputs: keys of rows, the size of the screen. Does not know the content of rows, or how they
//! are drawn.

mod bus_page;
mod call_list;
mod counts;
mod cursor;
mod devices_page;
mod evidence;
mod page;
mod problems_view;
mod rows;
mod screen;
mod timeline_view;
mod traffic_view;

pub use bus_page::{BarKey, BusPageLayout, BusRegions, ChartSpan};
pub use call_list::CallList;
pub use cursor::Selection;
pub use devices_page::{DeviceView, DevicesPage};
pub use evidence::EvidenceView;
pub use page::{Focus, Frozen, Page};
pub(in crate::app) use problems_view::ProblemRoom;
pub use problems_view::{ConflictAxis, ProblemsView};
pub use rows::{Board, Counts, FileStatus, Row, RowKey, RowState, Sort, SortBy};
pub use screen::{SPLIT_WIDTH, Screen};
pub use timeline_view::TimelineView;
pub use traffic_view::{CallOrder, IdentifierOrder, TimeFormat, TrafficView};

use super::capture::CountsBase;
use super::capture::calls::CallKey;
use super::capture::identifiers::IdentifierKey;
use super::followed_frames::FollowedFrames;
use super::problems::{EvidenceItem, ProblemKey};
use super::stories::HiddenKinds;
use super::story_lines::LineKey;
use crate::discovery::DeviceId;
use std::collections::BTreeSet;

/// State of the view.
#[derive(Debug, Default)]
pub struct View {
    /// Open page.
    pub page: Page,
    /// Part of the page that takes the keys.
    pub focus: Focus,
    /// The details of a frame are open.
    pub frame_details: bool,
    /// Traffic was opened from a line of the timeline; Esc returns there.
    pub from_timeline: bool,
    /// First line of the details that is shown.
    pub details_scroll: u16,
    /// Sort order of the Devices page.
    pub device_sort: Sort<SortBy>,
    /// End of a frozen view; `None` while it is live.
    pub frozen: Option<Frozen>,
    /// A line announces a confirmed conflict.
    pub has_alarm: bool,
    /// A line says that the profile in force is not that of the devices.
    pub has_banner: bool,
    /// The time bar is shown on a small screen, too.
    pub has_time_bar: bool,
    /// Halvings of the time in the time bar; 0 shows all.
    pub(in crate::app) bar_zoom: u32,
    /// What a row of the Traffic page is.
    pub traffic_view: TrafficView,
    /// First frames of the transfers whose frames have rows of their own.
    pub(in crate::app) open_transfers: BTreeSet<u64>,
    /// What the times of frames are.
    pub time_format: TimeFormat,
    /// Order of the identifiers.
    pub identifier_sort: Sort<IdentifierOrder>,
    /// Order of the calls.
    pub call_sort: Sort<CallOrder>,
    /// Size of the screen: columns, rows.
    pub size: (u16, u16),
    /// Selection of the Devices page.
    pub devices: Selection<RowKey>,
    /// Views of the Devices page, and its heartbeat history.
    pub devices_page: DevicesPage,
    /// Selection of the Problems page.
    pub problems: Selection<ProblemKey>,
    /// Which problems are listed.
    pub problems_view: ProblemsView,
    /// Room that the list of problems wants.
    pub(in crate::app) problem_room: ProblemRoom,
    /// Place of the selected piece of evidence in the focused details of a problem.
    pub piece: usize,
    /// Time axis of the conflict panel.
    pub conflict_axis: ConflictAxis,
    /// Selected line of the timeline; none while the newest are followed.
    pub timeline: Selection<LineKey>,
    /// Stories whose steps have lines of their own.
    pub(in crate::app) open_stories: BTreeSet<u64>,
    /// What the Timeline page shows.
    pub timeline_view: TimelineView,
    /// Length of a cell of the lanes, by its place in the list of them; `None`: all that is kept fits.
    pub(in crate::app) lane_zoom: Option<usize>,
    /// Device of the selected lane, where lanes are shown alone.
    pub(in crate::app) lane: Selection<DeviceId>,
    /// Number of the lanes of devices.
    pub(in crate::app) lane_count: usize,
    /// Kinds of stories that have no lines.
    pub hidden_kinds: HiddenKinds,
    /// Selected bar of the Bus page.
    pub bars: Selection<BarKey>,
    /// Time that the charts of the Bus page show.
    pub chart_span: ChartSpan,
    /// Selection of the view of identifiers.
    pub identifiers: Selection<IdentifierKey>,
    /// Selection of the view of calls.
    pub calls: Selection<CallKey>,
    /// The calls of one row, one by one; behind other views it stays open.
    pub(in crate::app) call_list: Option<CallList>,
    /// Where the counts of identifiers and calls begin; `None`: at the start.
    pub(in crate::app) counts_base: Option<Box<CountsBase>>,
    /// Number of the selected frame; `None` while the newest are followed.
    pub traffic: Option<u64>,
    /// Frames that are shown while the newest are followed, from one draw to the next.
    pub(in crate::app) followed: Option<FollowedFrames>,
    /// Line of the list on which it is shown.
    pub traffic_line: usize,
    /// Evidence that Traffic shows.
    pub evidence: Option<EvidenceView>,
    /// The size of the screen is known; without a screen nothing waits for drawing.
    pub(in crate::app) has_screen: bool,
}

impl View {
    /// Returns true if the page has details beside, below or in place of its list.
    pub fn has_details(&self) -> bool {
        match self.page {
            Page::Devices => true,
            Page::Problems => self.problem_room.rows > 0,
            Page::Traffic if self.evidence.is_some() => true,
            Page::Traffic => self.frame_details && self.traffic_view == TrafficView::Frames,
            Page::Timeline | Page::Bus => false,
        }
    }

    /// Returns true if Traffic shows one row per identifier; evidence is always shown as frames.
    pub fn shows_identifiers(&self) -> bool {
        self.traffic_view == TrafficView::Identifiers && self.evidence.is_none()
    }

    /// Returns true if Traffic shows one row per client, server and service.
    pub fn shows_calls(&self) -> bool {
        self.traffic_view == TrafficView::Calls && self.evidence.is_none()
    }

    /// Regions of the screen, for this many buses.
    pub fn screen(&self, buses: usize) -> Screen {
        Screen::new(self, buses)
    }

    /// Opens a page with its list in focus; evidence is closed.
    pub(in crate::app) fn open_page(&mut self, page: Page) {
        self.close_evidence();
        self.from_timeline = false;
        self.page = page;
        self.focus_list();
    }

    fn focus_list(&mut self) {
        self.focus = Focus::List;
        self.piece = 0;
        self.details_scroll = 0;
    }

    /// Moves the focus to the details, if there are any, or to the list. On Traffic, leaving the
    /// details closes them.
    pub(in crate::app) fn focus_details(&mut self, details: bool) {
        let has = self.has_details();
        if !details && self.page == Page::Traffic {
            self.frame_details = false;
        }
        self.focus = if details && has { Focus::Details } else { Focus::List };
        self.details_scroll = 0;
        self.piece = 0;
    }

    /// Scrolls the details by lines; the end is known when they are drawn.
    pub(in crate::app) fn scroll_details(&mut self, delta: isize) {
        let scroll = usize::from(self.details_scroll).saturating_add_signed(delta);
        self.details_scroll = u16::try_from(scroll).unwrap_or(u16::MAX);
    }

    /// Selects the newest line of the timeline, if its newest lines are followed.
    pub(in crate::app) fn hold_timeline(&mut self, keys: &[LineKey], height: usize) {
        if self.timeline.selected().is_none() {
            self.timeline.move_to(keys, keys.len(), height);
            let line = keys.len().min(height).saturating_sub(1);
            self.timeline.click(keys, line, height);
        }
    }

    /// Shows this frame in the middle of a list of `height` lines.
    pub(in crate::app) fn select_frame(&mut self, number: u64, height: usize) {
        self.traffic = Some(number);
        self.traffic_line = height / 2;
    }

    // ---- evidence --------------------------------------------------------------------------

    /// The evidence, if only its own frames are shown.
    pub fn evidence_alone(&self) -> Option<&EvidenceView> {
        self.evidence.as_ref().filter(|evidence| !evidence.shows_context)
    }

    /// Opens evidence on Traffic, with the piece at `first` selected.
    pub(in crate::app) fn open_evidence(
        &mut self,
        problem: ProblemKey,
        title: String,
        pieces: Vec<EvidenceItem>,
        count: u64,
        first: usize,
    ) {
        let before = (self.traffic, self.traffic_line, self.focus);
        let mut cursor = Selection::default();
        cursor.select(first);
        self.open_page(Page::Traffic);
        let around = false;
        self.evidence = Some(EvidenceView {
            problem,
            title,
            pieces,
            count,
            cursor,
            shows_context: around,
            before,
            led_to: None,
        });
    }

    /// Shows only the evidence, or all frames around it.
    pub(in crate::app) fn set_around(&mut self, around: bool) {
        self.focus_list();
        if let Some(evidence) = &mut self.evidence {
            evidence.shows_context = around;
        }
    }

    /// Closes the evidence; Traffic is again as before.
    pub(in crate::app) fn close_evidence(&mut self) {
        if let Some(evidence) = self.evidence.take() {
            (self.traffic, self.traffic_line, _) = evidence.before;
        }
    }

    /// Moves the selection of the evidence by `delta` pieces.
    pub(in crate::app) fn move_in_evidence(&mut self, delta: isize, height: usize) {
        if let Some(evidence) = &mut self.evidence {
            let places = evidence.places();
            evidence.cursor.move_by(&places, delta, height);
        }
    }

    /// Selects the piece of evidence on a line of the list.
    pub(in crate::app) fn click_evidence(&mut self, line: usize, height: usize) {
        if let Some(evidence) = &mut self.evidence {
            let places = evidence.places();
            evidence.cursor.click(&places, line, height);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::BusIndex;
    use crate::time::Instant;
    use crate::wire::id::Address;

    #[test]
    fn selection_stays_on_its_row_and_line() {
        let mut cursor = Selection::default();
        let mut keys: Vec<u32> = (10..30).collect();
        cursor.update(&keys, 5);
        cursor.move_by(&keys, 8, 5);
        assert_eq!(cursor.selected(), Some(&18));
        let top = |cursor: &Selection<u32>, keys: &[u32]| {
            cursor.top(cursor.index(keys.iter()), keys.len(), 5)
        };
        assert_eq!(top(&cursor, &keys), 4);
        keys.insert(0, 1);
        cursor.update(&keys, 5);
        assert_eq!((cursor.selected(), top(&cursor, &keys)), (Some(&18), 5));
        keys.retain(|key| *key != 18);
        cursor.update(&keys, 5);
        assert_eq!(cursor.selected(), Some(&19));
        cursor.move_by(&keys, -2, 5);
        assert_eq!((cursor.selected(), top(&cursor, &keys)), (Some(&16), 5));
        cursor.update(&[], 5);
        assert_eq!(cursor.selected(), None);
    }

    #[test]
    fn closed_evidence_restores_traffic() {
        let mut view = View { traffic: Some(7), traffic_line: 3, ..View::default() };
        let piece = EvidenceItem { time: Instant::ZERO, what: String::new(), frame: None };
        let key = ProblemKey::Address(BusIndex(0), Address::from_bits(12));
        view.open_evidence(key, "conflict".to_owned(), vec![piece; 3], 3, 1);
        view.move_in_evidence(1, 10);
        let selected = view.evidence_alone().and_then(EvidenceView::selected);
        assert_eq!(selected.map(|(place, _)| place), Some(2));
        view.select_frame(9, 10);
        view.set_around(true);
        assert!(view.evidence_alone().is_none());
        view.open_page(Page::Devices);
        assert_eq!((view.traffic, view.traffic_line), (Some(7), 3));
    }
}
