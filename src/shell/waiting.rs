//! Futures for optional sources: without a source they wait forever.

use super::catalogue_folders::CatalogueWatcher;
use super::file_watcher::{DiskContent, FileWatcher};
use crate::catalogue::CatalogueText;
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

/// Waits until a file of the catalogue changes; `None` waits forever.
pub async fn catalogue_changed(watch: Option<&CatalogueWatcher>) -> Vec<CatalogueText> {
    match watch {
        Some(watch) => watch.changed().await,
        None => pending().await,
    }
}
