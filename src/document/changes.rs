//! Differences between two versions of the file, in words.

use super::Document;
use super::entry::{Entry, Member};
use super::merge::counterparts;
use super::operation::EntryKey;
use super::text::brief;

/// Returns the differences between two versions, entry by entry: "SENS: 13 → 15", "DISP at 20
/// removed", "new ACT at 14". Safe on a terminal.
///
/// Empty if no entry differs in a known member, or if more than `most` do.
pub fn changes(before: &Document, after: &Document, most: usize) -> Vec<String> {
    let pairs = counterparts(before, after);
    let mut is_new = vec![true; after.entries().len()];
    let mut words = Vec::new();
    for (entry, counterpart) in before.entries().iter().zip(pairs) {
        match counterpart {
            Some(at) => {
                is_new[at] = false;
                words.extend(change(entry, &after.entries()[at]));
            }
            None => words.push(format!("{:#} removed", EntryKey::of(entry))),
        }
    }
    let new = after.entries().iter().filter(|entry| is_new[entry.index]);
    words.extend(new.map(|entry| format!("new {:#}", EntryKey::of(entry))));
    if words.len() > most { Vec::new() } else { words }
}

/// Describes the difference of one entry; `None` if its known members are equal.
fn change(before: &Entry, after: &Entry) -> Option<String> {
    let address =
        |entry: &Entry| entry.address.map_or_else(|| "none".to_owned(), |it| it.to_string());
    let differs = |member: Member| !member.agrees(before, after);
    let mut words = Vec::new();
    if differs(Member::Name) {
        words.push(format!("renamed to {}", brief(&after.name)));
    }
    if differs(Member::Address) {
        words.push(format!("{} → {}", address(before), address(after)));
    }
    if differs(Member::Static) {
        words.push(if after.is_static { "static" } else { "not static" }.to_owned());
    }
    // Not the bus: an entry for another bus is another entry.
    for (member, word) in [(Member::Services, "services"), (Member::Uid, "UID")] {
        if differs(member) {
            words.push(format!("{word} changed"));
        }
    }
    (!words.is_empty()).then(|| format!("{}: {}", brief(&before.name), words.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn described(before: &str, after: &str) -> String {
        let parse = |text: &str| Document::parse(text.as_bytes()).unwrap();
        changes(&parse(before), &parse(after), 3).join("; ")
    }

    #[test]
    fn changes_name_each_entry_with_its_difference() {
        let sens = r#"[{"name":"SENS","address":13,"static":true,"note":1}]"#;
        let described = |after: &str| described(sens, after);
        assert_eq!(described(sens), "");
        assert_eq!(described(&sens.replace(":1}", ":2}")), "");
        assert_eq!(described(&sens.replace("13", "15")), "SENS: 13 → 15");
        assert_eq!(described(&sens.replace("true", "false")), "SENS: not static");
        let both = sens.replace("13", "15").replace("true", "false");
        assert_eq!(described(&both), "SENS: 13 → 15, not static");
        assert_eq!(described(&sens.replace("SENS", "S\\u001b")), "SENS: renamed to S\\x1B");
        assert_eq!(described(&sens.replace("\"address\":13,", "")), "SENS: 13 → none");
        let more = sens.replace("note\":1", r#"uid":"U","services":[{"name":"DES"}]"#);
        assert_eq!(described(&more), "SENS: services changed, UID changed");
        let elsewhere = sens.replace("note\":1", "bus\":\"can1\"");
        assert_eq!(described(&elsewhere), "SENS at 13 removed; new SENS at 13");
        assert_eq!(described("[]"), "SENS at 13 removed");
        let new = sens.replace("}]", r#"},{"name":"DISP","address":20}]"#);
        assert_eq!(described(&new), "new DISP at 20");
        let swapped = r#"[{"name":"ACT"}]"#;
        assert_eq!(described(swapped), "SENS at 13 removed; new ACT");
    }

    #[test]
    fn changes_beyond_the_limit_are_not_named() {
        let list = |addresses: &[u8]| {
            let entry = |(at, address)| format!(r#"{{"name":"N{at}","address":{address}}}"#);
            let entries: Vec<String> = addresses.iter().enumerate().map(entry).collect();
            format!("[{}]", entries.join(","))
        };
        let before = list(&[1, 2, 3, 4]);
        let three = "N0: 1 → 11; N1: 2 → 12; N2: 3 → 13";
        assert_eq!(described(&before, &list(&[11, 12, 13, 4])), three);
        assert_eq!(described(&before, &list(&[11, 12, 13, 14])), "");
    }
}
