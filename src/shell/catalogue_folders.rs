//! The folders of the catalogue: reading their files, and noticing when one is saved.
//!
//! Two folders: `devices` beside des.json, and `descan/devices` in the user's data folder. Events are
//! only a reason to read: a change is text that differs. Does not know what is in the files.

use super::file_watcher::{QUIET, QUIET_TIMEOUT};
use super::remote_folder::is_remote;
use crate::catalogue::{CatalogueText, MAX_FILES};
use crate::diagnostic::Diagnostic;
use crate::regular_file::{not_read, required_text};
use crate::text::printable_path;
use etcetera::{BaseStrategy, choose_base_strategy};
use notify::event::{AccessKind, AccessMode, EventKind};
use notify::{RecommendedWatcher, RecursiveMode, Watcher as _};
use std::collections::BTreeSet;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Name of the folder beside des.json.
const FOLDER: &str = "devices";
/// Time between reads where changes cause no events.
const POLL_PERIOD: Duration = Duration::from_secs(2);

/// The folders, first those that count first.
#[derive(Clone, Debug, Default)]
pub struct CatalogueFolders {
    folders: Vec<PathBuf>,
}

impl CatalogueFolders {
    /// The folders beside the des.json files, where there is that file or `is_expected`, and the user's
    /// own.
    pub fn beside(files: &[&Path], is_expected: bool) -> Self {
        let mut folders = Vec::new();
        for file in files.iter().filter(|file| is_expected || file.exists()) {
            let folder = file.parent().unwrap_or(Path::new("")).join(FOLDER);
            if !folders.contains(&folder) {
                folders.push(folder);
            }
        }
        Self { folders }.with_user_folder()
    }

    /// One folder alone.
    pub fn only(folder: &Path) -> Self {
        Self { folders: vec![folder.to_owned()] }
    }

    /// These folders, and the user's own.
    pub fn of(folders: Vec<PathBuf>) -> Self {
        Self { folders }.with_user_folder()
    }

    fn with_user_folder(mut self) -> Self {
        if let Ok(base) = choose_base_strategy() {
            self.folders.push(base.data_dir().join("descan").join(FOLDER));
        }
        self
    }

    /// The paths, first those that count first.
    pub fn paths(&self) -> &[PathBuf] {
        &self.folders
    }

    /// Reads all files `*.toml`, sorted by name within each folder; a folder that does not exist has
    /// none.
    pub fn read(&self) -> Vec<CatalogueText> {
        let mut texts = Vec::new();
        for (folder, path) in self.folders.iter().enumerate() {
            match files_of(path) {
                Ok(files) => {
                    let room = MAX_FILES.saturating_sub(texts.len());
                    if files.len() > room {
                        let why = format!(
                            "has more than {MAX_FILES} files with the others; these are not read"
                        );
                        let text = Err(Diagnostic::new(why));
                        texts.push(CatalogueText { path: printable_path(path), folder, text });
                    }
                    texts.extend(files.into_iter().take(room).map(|file| {
                        let text = required_text(&file);
                        CatalogueText { path: printable_path(&file), folder, text }
                    }));
                }
                Err(fault) => {
                    texts.push(CatalogueText {
                        path: printable_path(path),
                        folder,
                        text: Err(fault),
                    });
                }
            }
        }
        texts
    }
}

fn files_of(folder: &Path) -> Result<BTreeSet<PathBuf>, Diagnostic> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            return Ok(BTreeSet::new());
        }
        Err(error) => return Err(not_read(&error)),
    };
    let is_file = |path: &PathBuf| {
        let is_hidden = path.file_name().is_none_or(|name| name.as_encoded_bytes()[0] == b'.');
        !is_hidden && path.extension().is_some_and(|end| end == "toml")
    };
    // Bounded before it is sorted.
    Ok(entries.flatten().map(|entry| entry.path()).filter(is_file).take(4 * MAX_FILES).collect())
}

/// Returns true if an event may be of a file in these folders; reading them changes none.
fn concerns(event: &notify::Event, folders: &[PathBuf]) -> bool {
    if let EventKind::Access(access) = event.kind
        && access != AccessKind::Close(AccessMode::Write)
    {
        return false;
    }
    let is_near = |path: &PathBuf| {
        folders.iter().any(|folder| path.starts_with(folder) || folder.starts_with(path))
    };
    event.need_rescan() || event.paths.iter().any(is_near)
}

/// The folders whose changes can affect these: those that exist and the one above, else the nearest one
/// above that exists.
fn watched_for(folders: &[PathBuf]) -> BTreeSet<PathBuf> {
    let mut watched = BTreeSet::new();
    for folder in folders {
        if let Some(there) = folder.ancestors().find(|path| path.is_dir()) {
            watched.insert(there.to_owned());
            // The folder itself may be moved away.
            watched
                .extend(folder.parent().filter(|_| there == folder.as_path()).map(Path::to_owned));
        }
    }
    watched
}

/// Watches the folders on a separate thread, until dropped. There is no queue:
/// [`CatalogueWatcher::changed`] returns the newest texts.
#[derive(Debug)]
pub struct CatalogueWatcher {
    shared: Arc<CatalogueShared>,
    wake: SyncSender<()>,
}

#[derive(Debug, Default)]
struct CatalogueShared {
    state: Mutex<CatalogueState>,
    changed: Notify,
}

#[derive(Debug, Default)]
struct CatalogueState {
    news: Option<Vec<CatalogueText>>,
    is_over: bool,
}

impl CatalogueShared {
    fn lock(&self) -> MutexGuard<'_, CatalogueState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CatalogueWatcher {
    /// Watches the folders; `known` is what was read last.
    pub fn spawn(folders: CatalogueFolders, known: Vec<CatalogueText>) -> Self {
        let shared = Arc::new(CatalogueShared::default());
        // One waiting wake-up is enough.
        let (wake, woken) = sync_channel(1);
        let mut thread = CatalogueThread {
            folders,
            known,
            shared: Arc::clone(&shared),
            wake: wake.clone(),
            watcher: None,
        };
        // Without a thread no change is noticed.
        let name = "catalogue".to_owned();
        let _ = thread::Builder::new().name(name).spawn(move || thread.run(&woken));
        Self { shared, wake }
    }

    /// Waits until a file changes, comes or goes, and returns the texts of all.
    ///
    /// May be dropped while waiting; nothing is lost.
    pub async fn changed(&self) -> Vec<CatalogueText> {
        loop {
            if let Some(texts) = self.shared.lock().news.take() {
                return texts;
            }
            self.shared.changed.notified().await;
        }
    }
}

impl Drop for CatalogueWatcher {
    fn drop(&mut self) {
        self.shared.lock().is_over = true;
        let _ = self.wake.try_send(());
    }
}

struct CatalogueThread {
    folders: CatalogueFolders,
    known: Vec<CatalogueText>,
    shared: Arc<CatalogueShared>,
    wake: SyncSender<()>,
    watcher: Option<RecommendedWatcher>,
}

impl CatalogueThread {
    fn run(&mut self, woken: &Receiver<()>) {
        loop {
            // Before reading, so that no change is missed in between.
            let is_told = self.watch();
            self.look();
            let wake = if is_told {
                woken.recv().map_err(RecvTimeoutError::from)
            } else {
                woken.recv_timeout(POLL_PERIOD)
            };
            if wake == Ok(()) {
                let deadline = Instant::now() + QUIET_TIMEOUT;
                while !self.shared.lock().is_over
                    && Instant::now() < deadline
                    && woken.recv_timeout(QUIET).is_ok()
                {}
            }
            if self.shared.lock().is_over || wake == Err(RecvTimeoutError::Disconnected) {
                return;
            }
        }
    }

    fn look(&mut self) {
        let texts = self.folders.read();
        let is_same = |(one, other): (&CatalogueText, &CatalogueText)| {
            one.path == other.path && one.text == other.text
        };
        if texts.len() == self.known.len() && texts.iter().zip(&self.known).all(is_same) {
            return;
        }
        self.known.clone_from(&texts);
        self.shared.lock().news = Some(texts);
        self.shared.changed.notify_one();
    }

    /// Watches each folder, or the nearest one above it that exists. Returns false if some changes
    /// cause no events.
    fn watch(&mut self) -> bool {
        /// Changes of the folders that are tolerated during it.
        const ATTEMPTS: usize = 8;
        let absolute = |path: &PathBuf| std::path::absolute(path).unwrap_or_else(|_| path.clone());
        let folders: Vec<PathBuf> = self.folders.folders.iter().map(absolute).collect();
        let (wake, concerned) = (self.wake.clone(), folders.clone());
        let told = move |event: notify::Result<notify::Event>| {
            if event.as_ref().map_or(true, |event| concerns(event, &concerned)) {
                let _ = wake.try_send(());
            }
        };
        // A new one each time: a folder that was replaced has another identity.
        let Ok(mut watcher) = notify::recommended_watcher(told) else { return false };
        let (mut is_told, mut is_settled) = (true, false);
        let mut wanted = watched_for(&folders);
        for _ in 0..ATTEMPTS {
            for folder in &wanted {
                is_told &= watcher.watch(folder, RecursiveMode::NonRecursive).is_ok();
                is_told &= !is_remote(folder);
            }
            // Between finding a folder and watching it, it may have come or gone unnoticed.
            let again = watched_for(&folders);
            is_settled = again == wanted;
            if is_settled {
                break;
            }
            wanted = again;
        }
        is_told &= is_settled;
        self.watcher = Some(watcher);
        is_told
    }
}
