//! Detection of changes to a file by other programs.
//!
//! Editors replace files, so folders are watched: the one the file is in, those of the symbolic
//! links that lead to it, and, while its folder is missing, the one that it will appear in. An
//! event is only a reason to read: a change is content that differs from the last known one.
//! Without events (network file systems, no inotify left) the file is read once a second. Does not
//! know what is in the file, or who saves it.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use notify::event::{AccessKind, AccessMode, EventKind, ModifyKind};
use notify::{RecommendedWatcher, RecursiveMode, Watcher as _};
use tokio::sync::Notify;

use super::remote_folder::is_remote;
use super::store::{Places, Store};
use crate::diagnostic::Diagnostic;

/// Content of a file; `None` if there is no file, an error if it cannot be read.
pub type DiskContent = Result<Option<Vec<u8>>, Diagnostic>;

/// Time without events before the file is read: editors write in several steps.
pub(super) const QUIET: Duration = Duration::from_millis(100);

/// Longest wait for such a time.
pub(super) const QUIET_TIMEOUT: Duration = Duration::from_millis(300);

/// Time between reads without events.
const POLL_PERIOD: Duration = Duration::from_secs(1);

/// Watches a file on a separate thread, until dropped.
///
/// There is no queue: [`FileWatcher::changed`] returns the newest content.
#[derive(Debug)]
pub struct FileWatcher {
    shared: Arc<WatchShared>,
    wake: SyncSender<()>,
}

impl FileWatcher {
    /// Watches the file of the store. `known` is the content last read; a change since then is
    /// reported, too.
    pub fn spawn(store: Store, known: DiskContent) -> Self {
        Self::start(store, known, POLL_PERIOD, |wake| Some(Folders::new(wake)))
    }

    /// Watches by reading the file once per `period`, without events.
    pub fn polling(store: Store, known: DiskContent, period: Duration) -> Self {
        Self::start(store, known, period, |_| None)
    }

    /// Waits until the file's content differs from what was last known, and returns it. What is
    /// returned counts as known from then on.
    ///
    /// May be dropped while waiting; no content is lost.
    pub async fn changed(&self) -> DiskContent {
        loop {
            if let Some(reading) = self.shared.take() {
                return reading;
            }
            self.shared.changed.notified().await;
        }
    }

    /// Call after [`Store::save`] has saved `content`: it counts as known and is not reported.
    /// Content that waits may be older or newer: the file is read again.
    pub fn set_known(&self, content: Vec<u8>) {
        self.look_from(Some(Ok(Some(content))));
    }

    /// Call if the content is uncertain, as when another program wrote during a save: the file is
    /// read again and reported in any case.
    pub fn reread(&self) {
        self.look_from(None);
    }

    fn look_from(&self, known: Option<DiskContent>) {
        let mut state = self.shared.lock();
        state.known = known;
        state.is_news = false;
        state.saves += 1;
        drop(state);
        let _ = self.wake.try_send(());
    }

    fn start(
        store: Store,
        known: DiskContent,
        period: Duration,
        folders: impl FnOnce(SyncSender<()>) -> Option<Folders>,
    ) -> Self {
        let state = WatchState { known: Some(known), is_news: false, saves: 0, is_over: false };
        let shared = Arc::new(WatchShared { state: Mutex::new(state), changed: Notify::new() });
        // One waiting wake-up is enough.
        let (wake, woken) = sync_channel(1);
        let watcher = WatchThread {
            store,
            shared: shared.clone(),
            folders: folders(wake.clone()),
            woken,
            period,
        };
        // Without a thread no change is noticed, but `Store` overwrites none either.
        let _ = thread::Builder::new().name("watch".into()).spawn(move || watcher.run());
        Self { shared, wake }
    }
}

impl Drop for FileWatcher {
    fn drop(&mut self) {
        self.shared.lock().is_over = true;
        let _ = self.wake.try_send(());
    }
}

#[derive(Debug)]
struct WatchShared {
    state: Mutex<WatchState>,
    changed: Notify,
}

#[derive(Debug)]
struct WatchState {
    /// `None` if uncertain.
    known: Option<DiskContent>,
    /// `known` was not returned yet.
    is_news: bool,
    /// Number of saves by descan: content read before one is out of date.
    saves: u64,
    is_over: bool,
}

impl WatchShared {
    fn lock(&self) -> MutexGuard<'_, WatchState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self) -> Option<DiskContent> {
        let mut state = self.lock();
        if std::mem::take(&mut state.is_news) { state.known.clone() } else { None }
    }

    /// Reports content whose reading began after `saves` saves. Returns false if there was another
    /// save since.
    fn report(&self, reading: DiskContent, saves: u64) -> bool {
        let mut state = self.lock();
        if state.saves != saves {
            return false;
        }
        if state.known.as_ref() != Some(&reading) {
            state.known = Some(reading);
            state.is_news = true;
            self.changed.notify_one();
        }
        true
    }
}

/// State of the thread.
struct WatchThread {
    store: Store,
    shared: Arc<WatchShared>,
    /// `None` without events.
    folders: Option<Folders>,
    woken: Receiver<()>,
    /// Time between reads without events.
    period: Duration,
}

impl WatchThread {
    fn run(mut self) {
        loop {
            // Before reading, so that no change is missed in between.
            let is_told = self.folders.as_mut().is_some_and(|it| it.follow(self.store.path()));
            self.look();
            let woken = if is_told {
                self.woken.recv().map_err(RecvTimeoutError::from)
            } else {
                self.woken.recv_timeout(self.period)
            };
            match woken {
                Ok(()) => self.wait_for_quiet(),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if self.shared.lock().is_over {
                return;
            }
        }
    }

    fn look(&self) {
        loop {
            let saves = self.shared.lock().saves;
            let reading = self.store.read();
            if self.shared.report(reading, saves) {
                return;
            }
        }
    }

    fn wait_for_quiet(&self) {
        let deadline = Instant::now() + QUIET_TIMEOUT;
        while !self.shared.lock().is_over
            && Instant::now() < deadline
            && self.woken.recv_timeout(QUIET).is_ok()
        {}
    }
}

/// The folders whose changes can affect the file.
struct Folders {
    watcher: Option<RecommendedWatcher>,
    watched: HashSet<PathBuf>,
    wake: SyncSender<()>,
    of_interest: Arc<Mutex<Paths>>,
}

/// The paths that events are compared with.
#[derive(Default)]
struct Paths {
    /// The file and the links that lead to it.
    files: HashSet<PathBuf>,
    folders: HashSet<PathBuf>,
    /// A folder was moved or deleted: its path now stands for another one, which is not watched.
    is_stale: bool,
}

impl Folders {
    fn new(wake: SyncSender<()>) -> Self {
        Self { watcher: None, watched: HashSet::new(), wake, of_interest: Arc::default() }
    }

    /// Watches the folders that determine which file `path` is. Returns false if some changes cause
    /// no events.
    fn follow(&mut self, path: &Path) -> bool {
        /// Changes of the path that are tolerated during it.
        const ATTEMPTS: usize = 8;
        let mut places = Places::of(path);
        for _ in 0..ATTEMPTS {
            let Ok(found) = &places else { return false };
            let is_told = self.watch(found);
            // Between finding a folder and watching it, it may have come or gone unnoticed.
            let again = Places::of(path);
            if again.as_ref().is_ok_and(|again| again == found) {
                return is_told;
            }
            places = again;
        }
        false
    }

    fn watch(&mut self, places: &Places) -> bool {
        let folders = places.watched.iter().map(|(folder, _)| folder.clone());
        let wanted: HashSet<PathBuf> = folders.collect();
        let is_stale = {
            let mut paths = lock(&self.of_interest);
            paths.files = places.watched.iter().map(|(folder, name)| folder.join(name)).collect();
            paths.folders.clone_from(&wanted);
            std::mem::take(&mut paths.is_stale)
        };
        // Without the lock: the watcher's own thread may wait for it.
        let mut before = std::mem::take(&mut self.watched);
        if is_stale {
            self.watcher = None;
            before.clear();
        }
        let Some(watcher) = self.watcher() else { return false };
        for folder in before.difference(&wanted) {
            let _ = watcher.unwatch(folder);
        }
        let mut now = wanted.clone();
        now.retain(|folder| {
            before.contains(folder) || watcher.watch(folder, RecursiveMode::NonRecursive).is_ok()
        });
        self.watched = now;
        self.watched == wanted && !wanted.iter().any(|folder| is_remote(folder))
    }

    fn watcher(&mut self) -> Option<&mut RecommendedWatcher> {
        if self.watcher.is_none() {
            let (wake, paths) = (self.wake.clone(), self.of_interest.clone());
            let told = move |event: notify::Result<notify::Event>| {
                if lock(&paths).concerns(&event) {
                    let _ = wake.try_send(());
                }
            };
            self.watcher = notify::recommended_watcher(told).ok();
        }
        self.watcher.as_mut()
    }
}

impl Paths {
    /// Returns true if the event may have changed the file; reading it has not.
    fn concerns(&mut self, event: &notify::Result<notify::Event>) -> bool {
        let Ok(event) = event else {
            self.is_stale = true;
            return true;
        };
        if let EventKind::Access(access) = event.kind
            && access != AccessKind::Close(AccessMode::Write)
        {
            return false;
        }
        let is_folder = event.paths.iter().any(|path| self.folders.contains(path));
        let is_gone =
            matches!(event.kind, EventKind::Remove(_) | EventKind::Modify(ModifyKind::Name(_)));
        self.is_stale |= is_folder && is_gone;
        is_folder || event.need_rescan() || event.paths.iter().any(|it| self.files.contains(it))
    }
}

fn lock(paths: &Mutex<Paths>) -> MutexGuard<'_, Paths> {
    paths.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn watcher_dropped_ends_its_thread() {
        for period in [None, Some(Duration::from_hours(1))] {
            let folder = tempfile::tempdir().unwrap();
            let store = Store::new(folder.path().join("des.json"));
            let watch = match period {
                None => FileWatcher::spawn(store, Ok(None)),
                Some(period) => FileWatcher::polling(store, Ok(None), period),
            };
            let shared = Arc::downgrade(&watch.shared);
            drop(watch);
            let deadline = Instant::now() + Duration::from_secs(20);
            while shared.strong_count() > 0 {
                assert!(Instant::now() < deadline, "the thread is still there");
                thread::yield_now();
            }
        }
    }
}
