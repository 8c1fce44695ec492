//! Execution of the actions of [`crate::keymap`].
//!
//! Each action is one command of [`App`]; nothing is transmitted beyond discovery without a
//! confirmation.

use super::timeline_kind::TimelineKind;
use super::{App, BEATS_PER_LINE, Effect, Page};
use crate::keymap::Action;
use crate::status::PlaybackCommand;

impl App {
    /// Executes an action.
    pub(super) fn run(&mut self, action: Action) {
        if self.view.frozen.is_some() && action.edits_or_sends() {
            let key = self.key_of_present();
            return self.show_error(format!("frozen: {key} shows the present first"));
        }
        if !self.view.page.has_rows() && action.is_of_filter() {
            return self.show_error("filter: the Bus page has no rows to filter");
        }
        match action {
            Action::Up => self.move_by(-1),
            Action::Down => self.move_by(1),
            Action::PageUp if self.shows_beat_history() => {
                self.choose_beat(-(BEATS_PER_LINE.cast_signed()));
            }
            Action::PageDown if self.shows_beat_history() => {
                self.choose_beat(BEATS_PER_LINE.cast_signed());
            }
            Action::PageUp => self.move_pages(-1),
            Action::PageDown => self.move_pages(1),
            Action::First => self.move_to_end(false),
            Action::Last => self.move_to_end(true),
            Action::Details if self.shows_beat_history() => self.go_to_beat(),
            Action::Details => self.go_from_here(Self::open_details),
            Action::Into if self.move_along_devices(1) => {}
            Action::Back if self.move_along_devices(-1) => {}
            Action::Into if self.moves_conflict_axis() => self.move_conflict_axis(1),
            Action::Back if self.moves_conflict_axis() => self.move_conflict_axis(-1),
            Action::ZoomOut if self.view.page == Page::Timeline => self.zoom_lanes(1),
            Action::ZoomIn if self.view.page == Page::Timeline => self.zoom_lanes(-1),
            Action::ZoomOut if self.view.page == Page::Bus => self.zoom_charts(1),
            Action::ZoomIn if self.view.page == Page::Bus => self.zoom_charts(-1),
            Action::ZoomOut => self.zoom_conflict_axis(-1),
            Action::ZoomIn => self.zoom_conflict_axis(1),
            Action::WriteProof => self.ask_proof_path(),
            Action::Into if self.past.is_some() => self.scrub(1),
            Action::Back if self.past.is_some() => self.scrub(-1),
            Action::Back if self.shows_lanes() => self.scrub(-1),
            Action::Into if self.shows_lanes() => self.scrub(1),
            Action::Into => self.go_into(),
            Action::Back => self.go_back(),
            Action::NextPage => self.turn_page(1),
            Action::PreviousPage => self.turn_page(-1),
            Action::Devices => self.show_page(Page::Devices),
            Action::Traffic => self.show_page(Page::Traffic),
            Action::Timeline => self.show_page(Page::Timeline),
            Action::Problems => self.show_page(Page::Problems),
            Action::Bus => self.show_page(Page::Bus),
            Action::Frames => self.go_from_here(Self::go_to_frames_of_selection),
            Action::Events => self.go_from_here(Self::go_to_events),
            Action::Heartbeats => self.go_from_here(Self::toggle_beat_history),
            Action::Return => self.go_to_last_place(),
            Action::Filter => self.ask_filter(),
            Action::FilterToggle => self.toggle_filter(),
            Action::OnlyLike => self.filter_like(false),
            Action::HideLike => self.filter_like(true),
            Action::NextMatch => self.go_to_match(1),
            Action::PreviousMatch => self.go_to_match(-1),
            Action::Sort => self.sort_by_next(),
            Action::Freeze => self.toggle_freeze(),
            Action::Identifiers => self.next_view(),
            Action::SortReverse => self.reverse_order(),
            Action::OpenParts => self.toggle_transfer(),
            Action::Kinds => self.list_kinds(),
            Action::KindUp => self.move_in_kinds(-1),
            Action::KindDown => self.move_in_kinds(1),
            Action::KindToggle => self.toggle_kind(false),
            Action::KindOnly => self.toggle_kind(true),
            Action::TimeFormat => self.next_time_format(),
            Action::Problem => self.go_from_here(Self::go_to_problem),
            Action::Mute => self.toggle_muted(),
            Action::Copy => self.copy_row(),
            Action::HelpSearch => self.type_help_search(),
            Action::HelpPage => self.next_help_page(),
            Action::HelpClose => self.close_help(),
            Action::Cancel
            | Action::MarksClose
            | Action::FiltersClose
            | Action::KindsClose
            | Action::ProfileClose
            | Action::PlanClose => {
                self.cancel();
            }
            Action::Rescan => self.rescan(),
            Action::ClearLost => self.remove_lost_devices(),
            Action::Identify => self.ask_identify(),
            Action::ReadDescriptor => self.ask_to_read_descriptor(),
            Action::Command => self.ask_for_command(),
            Action::Compose => self.open_composer(),
            Action::ComposeNext => self.move_in_composer(1),
            Action::ComposePrevious => self.move_in_composer(-1),
            Action::ComposeOlder => self.recall_in_composer(-1),
            Action::ComposeNewer => self.recall_in_composer(1),
            Action::ComposeSend => self.ask_to_send_frames(),
            Action::ComposeSave => self.save_template(),
            Action::ComposeOpen => self.open_template(),
            Action::ComposeClose => self.close_composer(),
            Action::BitRate => self.ask_bitrate(),
            Action::Buses => self.list_buses(),
            Action::SaveCapture => self.ask_capture_path(),
            Action::ReviewProfile => self.review_profile(),
            Action::ProfileUp => self.move_in_profile(-1),
            Action::ProfileDown => self.move_in_profile(1),
            Action::ProfileTick => self.tick_profile_value(),
            Action::ProfileUse => self.ask_profile_path(),
            Action::ProfileFrames => self.go_from_here(Self::go_to_frames_of_profile),
            Action::ProfileDismiss => self.dismiss_profile(),
            Action::Plan => self.open_plan(),
            Action::PlanUp => self.move_in_plan(-1),
            Action::PlanDown => self.move_in_plan(1),
            Action::PlanStart => self.ask_to_start_plan(),
            Action::PlanLeaveOut => self.leave_out_of_plan(),
            Action::PlanEarlier => self.reorder_plan(false),
            Action::PlanLater => self.reorder_plan(true),
            Action::PlanStop => self.stop_plan(),
            Action::PlanUndo => self.take_plan_back(),
            Action::PlanFixed => self.toggle_plan_setting(),
            Action::PlanRestart => self.toggle_plan_restarts(),
            Action::Pause => self.control_playback(PlaybackCommand::Pause),
            Action::PreviousEvent => self.go_to_event(-1, |_| true),
            Action::NextEvent => self.go_to_event(1, |_| true),
            Action::PreviousProblem => self.go_to_event(-1, TimelineKind::is_of_problem),
            Action::NextProblem => self.go_to_event(1, TimelineKind::is_of_problem),
            Action::GoTo => self.ask_moment(),
            Action::PreviousFrame => self.go_to_frame(-1),
            Action::NextFrame => self.next_frame(),
            Action::Mark => self.ask_mark(),
            Action::Marks => self.list_marks(),
            Action::Compare => self.compare_moments(),
            Action::Filters => self.list_filters(),
            Action::FilterUp => self.move_in_filters(-1),
            Action::FilterDown => self.move_in_filters(1),
            Action::FilterUse => self.use_filter(),
            Action::FilterRemove => self.remove_filter(),
            Action::MarkUp => self.move_in_marks(-1),
            Action::MarkDown => self.move_in_marks(1),
            Action::MarkGo => self.go_to_selected_mark(),
            Action::MarkRemove => self.remove_selected_mark(),
            Action::CompareUp => self.move_in_comparison(-1),
            Action::CompareDown => self.move_in_comparison(1),
            Action::ComparePageUp => self.page_comparison(-1),
            Action::ComparePageDown => self.page_comparison(1),
            Action::CompareSide => self.choose_compared_side(),
            Action::CompareEarlier => self.move_compared_moment(-1),
            Action::CompareLater => self.move_compared_moment(1),
            Action::CompareSelect => self.go_from_here(Self::go_to_compared_device),
            Action::CompareClose => self.close_comparison(),
            Action::ScrubBack => self.scrub_far(-1),
            Action::ScrubForward => self.scrub_far(1),
            Action::TimeBar => self.toggle_time_bar(),
            Action::Slower => self.change_pace(-1),
            Action::Faster => self.change_pace(1),
            Action::EditAddress => self.edit_address(),
            Action::Add => self.add_device(),
            Action::AddAll => self.add_all(),
            Action::NewEntry => self.ask_new_entry(),
            Action::Rename => self.ask_rename(),
            Action::DeleteEntry => self.ask_delete(),
            Action::Undo => self.undo(),
            Action::Redo => self.redo(),
            Action::Save => self.save(),
            Action::SaveCopy => self.ask_copy_path(),
            Action::Help => self.open_help(),
            Action::Theme => self.pick_theme(),
            Action::ThemeUp => self.move_in_themes(-1),
            Action::ThemeDown => self.move_in_themes(1),
            Action::ThemeKeep => self.keep_theme(),
            Action::ThemesClose => self.leave_themes(),
            Action::Redraw => self.effects.push_back(Effect::Redraw),
            Action::Suspend => self.effects.push_back(Effect::Suspend),
            Action::Quit => self.ask_quit(),
            Action::QuitNow => self.quit(),
            Action::HelpUp => self.input.scroll_help(-1),
            Action::HelpDown => self.input.scroll_help(1),
            Action::HelpPageUp => self.page_help(-1),
            Action::HelpPageDown => self.page_help(1),
            Action::HelpFirst => self.input.scroll_help(i16::MIN),
            Action::HelpLast => self.input.scroll_help(i16::MAX),
            // The list executes these itself: there may be no session.
            Action::ChoiceUp
            | Action::ChoiceDown
            | Action::ChoiceFirst
            | Action::ChoiceLast
            | Action::ChoiceOpen
            | Action::ChoiceToggle
            | Action::ChoiceBitrate
            | Action::ChoiceSearch
            | Action::ChoiceCopy
            | Action::ChoiceListenOnly
            | Action::ChoiceNoNames
            | Action::ChoiceRecord
            | Action::ChoiceInPlace
            | Action::ChoiceTheme
            | Action::ChoiceClose => {}
            Action::Yes => self.confirm(true),
            Action::No => self.confirm(false),
            Action::Ours => self.resolve(true),
            Action::Theirs => self.resolve(false),
            Action::Later => self.resolve_later(),
        }
    }
}
