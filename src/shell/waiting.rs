//! Waiting: a thread for a future; futures for optional sources, which without a source wait forever.

use super::catalogue_folders::CatalogueWatcher;
use super::file_watcher::{DiskContent, FileWatcher};
use crate::catalogue::CatalogueText;
use std::future::pending;
use std::pin::Pin;
use std::time::Duration;
use tokio::runtime::Runtime;

/// Runs a future to its end on this thread, behind a pointer: [`Runtime::block_on`] has the code of each type
/// of future twice.
pub fn block_on<T>(runtime: &Runtime, future: impl Future<Output = T>) -> T {
    let future: Pin<Box<dyn Future<Output = T> + '_>> = Box::pin(future);
    runtime.block_on(future)
}

/// Waits for `wait`; `None` waits forever.
pub async fn sleep_for(wait: Option<Duration>) {
    match wait {
        Some(wait) => tokio::time::sleep(wait).await,
        None => pending().await,
    }
}

/// Waits until the watched file changes; `None` waits forever.
pub async fn file_changed(watch: Option<&FileWatcher>) -> DiskContent {
    match watch {
        Some(watch) => watch.changed().await,
        None => pending().await,
    }
}

/// Waits until a file of the catalogue changes; `None` waits forever.
pub async fn catalogue_changed(watch: Option<&CatalogueWatcher>) -> Vec<CatalogueText> {
    match watch {
        Some(watch) => watch.changed().await,
        None => pending().await,
    }
}
