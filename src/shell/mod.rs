//! The edges of the program: files, the terminal, the event loop.
//!
//! ```text
//! session         app, input, file, recording: the event loop
//! log_input       a log as the input, by its own clock
//! recorder        received frames to a file
//! bitrate_search  bit rate search beside a session, or alone
//! stop            signals, time limit, closed output: reasons to stop without a screen
//! tui_loop        keys, signals and drawing   terminal      taking it over, restoring it
//! painted_screen  what the terminal shows     paint_pace    when it is drawn
//! cell_encoder    cells as bytes
//! terminal_input  keys, read by a thread
//! store           des.json on disk            file_watcher  changes by other programs
//! recovery        copy of unsaved edits       config        the user's settings
//! bus_picker      the list of buses           bus_scout     what can be opened, as it changes
//! bus_offers      interfaces, adapters, logs  background_colour   that of the terminal
//! catalogue_folders  files of types of devices
//! project_search  descan.toml, in this folder or above
//! frame_templates templates of frames
//! recent_frames   frames composed and sent before
//! recent_logs     logs opened before, and what was found in them
//! plan_files      plans of addresses on disk
//! broker          the connection to an MQTT broker
//! fleet_loop      the screen of a fleet
//! remote_folder   whether changes of a folder cause no events
//! signals         end of the program, Ctrl-Z    console  the terminal's end, speed and name
//! state_folder    what is kept between runs     file_owner  the user of a file
//! waiting         futures for optional sources
//! ```
//!
//! Knows tokio, threads, clocks and the file system, so that nothing above has to.

pub mod background_colour;
pub mod bitrate_search;
#[cfg(feature = "fleet")]
pub mod broker;
pub mod bus_offers;
pub mod bus_picker;
pub mod bus_scout;
pub mod catalogue_folders;
mod cell_encoder;
pub mod config;
pub mod console;
mod file_owner;
pub mod file_watcher;
#[cfg(feature = "fleet")]
pub mod fleet_loop;
pub mod frame_templates;
pub mod log_input;
pub mod paint_pace;
pub mod painted_screen;
pub mod pipe_input;
pub mod plan_files;
pub mod project_search;
pub mod recent_frames;
pub mod recent_logs;
pub mod recorder;
pub mod recovery;
mod remote_folder;
pub mod session;
pub mod signals;
mod state_folder;
pub mod stop;
pub mod store;
pub mod terminal;
mod terminal_input;
pub mod tui_loop;
pub mod waiting;
