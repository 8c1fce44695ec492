//! The services of an entry compared with those of its device.

use super::entry::{Entry, ListedService};
use crate::text::{Escaped, join_first};

/// Number of differences that are listed; the others are counted.
const LISTED_DIFFERENCES: usize = 4;

/// A service that a device has.
pub trait OwnService {
    /// Returns true if it has the name of the listed one.
    fn is_named_as(&self, listed: &ListedService) -> bool;

    /// Returns true if it has the version of the listed one, which is not empty.
    fn has_version_of(&self, listed: &ListedService) -> bool;

    /// Its name, printable.
    fn shown_name(&self) -> String;

    /// Its version, printable.
    fn shown_version(&self) -> String;
}

/// Returns true if the services of an entry and of a device are equal. An entry without a version
/// matches any version; the order counts only for an entry that requires it.
pub fn same_services(entry: &Entry, own: &[impl OwnService]) -> bool {
    let listed = entry.services.as_deref().unwrap_or_default();
    if listed.len() != own.len() {
        return false;
    }
    if entry.has_ordered_services {
        return listed.iter().zip(own).all(|(listed, own)| is_same(listed, own));
    }
    // Names are unique here.
    listed.iter().all(|listed| own.iter().any(|own| is_same(listed, own)))
}

/// Differences between the services of an entry and of a device, as text.
pub fn service_differences(listed: &[ListedService], own: &[impl OwnService]) -> String {
    let show = |text: &str| Escaped(text.as_bytes()).to_string();
    let mut words = Vec::new();
    for entry in listed {
        let mut same_name = own.iter().filter(|it| it.is_named_as(entry));
        let is_there = same_name.clone().any(|it| is_same(entry, it));
        match same_name.next() {
            _ if is_there => {}
            Some(other) => words.push(format!(
                "{} is {}, not {}",
                show(&entry.name),
                other.shown_version(),
                show(&entry.version)
            )),
            None => words.push(format!("{} is missing", show(&entry.name))),
        }
    }
    for service in own {
        if !listed.iter().any(|entry| service.is_named_as(entry)) {
            let (name, version) = (service.shown_name(), service.shown_version());
            words.push(format!("{name} {version} is not listed"));
        }
    }
    if words.is_empty() {
        return "different order or duplicates".to_owned();
    }
    join_first(words, LISTED_DIFFERENCES, "; ")
}

fn is_same(listed: &ListedService, own: &impl OwnService) -> bool {
    own.is_named_as(listed) && (listed.version.is_empty() || own.has_version_of(listed))
}
