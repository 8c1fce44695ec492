//! Futures for optional sources: without a source they wait forever.

use super::file_watcher::{DiskContent, FileWatcher};
use std::future::pending;
use std::time::Duration;

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
