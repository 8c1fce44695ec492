//! Byte spans in well-formed JSON, one list or object at a time, without recursion and without
//! building values.

use std::ops::Range;

/// A range of bytes of the text.
pub(super) type Span = Range<usize>;

/// A list or an object.
pub(super) struct Container {
    /// Span between the brackets.
    pub inside: Span,
    pub items: Vec<Item>,
}

/// An element of a list, or a member of an object.
pub(super) struct Item {
    /// Key with its quotes; in a list empty, at the start of the value.
    pub key: Span,
    pub value: Span,
}

impl Item {
    /// Returns the span of key, colon and value.
    pub fn span(&self) -> Span {
        self.key.start..self.value.end
    }
}

/// Returns the list or object at `span`; `None` for a scalar.
pub(super) fn container(text: &str, span: &Span) -> Option<Container> {
    let inside = span.start + 1..span.end - 1;
    let items = items_at(text, span)?.collect();
    Some(Container { inside, items })
}

/// Yields the items of the list or object at `span`, of which there may be millions; `None` for a
/// scalar.
pub(super) fn items_at(text: &str, span: &Span) -> Option<impl Iterator<Item = Item>> {
    let is_object = match text.as_bytes()[span.start] {
        b'{' => true,
        b'[' => false,
        _ => return None,
    };
    Some(items(text, span.start + 1..span.end - 1, is_object))
}

/// Yields the elements of the list at `span`.
pub(super) fn elements(text: &str, span: &Span) -> impl Iterator<Item = Span> {
    items(text, span.start + 1..span.end - 1, false).map(|item| item.value)
}

/// Yields the items between the brackets of a list or object.
fn items(text: &str, inside: Span, is_object: bool) -> impl Iterator<Item = Item> {
    let bytes = text.as_bytes();
    let mut at = skip_blank(bytes, inside.start);
    std::iter::from_fn(move || {
        if at >= inside.end {
            return None;
        }
        let key_start = at;
        let key_end = if is_object { skip_string(bytes, at) } else { at };
        if is_object {
            // Past the colon.
            at = skip_blank(bytes, skip_blank(bytes, key_end) + 1);
        }
        let end = skip_value(bytes, at);
        let item = Item { key: key_start..key_end, value: at..end };
        at = skip_blank(bytes, end);
        if bytes[at] == b',' {
            at = skip_blank(bytes, at + 1);
        }
        Some(item)
    })
}

/// Returns the span of the text's only value, without white space; `None` if the text is blank.
pub(super) fn root(text: &str) -> Option<Span> {
    let start = skip_blank(text.as_bytes(), 0);
    (start < text.len()).then(|| start..text.trim_end_matches(BLANKS).len())
}

/// Returns the first offset at which brackets nest deeper than `limit`; `None` if nowhere.
pub(super) fn deeper_than(text: &str, limit: usize) -> Option<usize> {
    let bytes = text.as_bytes();
    let (mut at, mut depth) = (0, 0);
    while at < bytes.len() {
        match bytes[at] {
            b'"' => {
                at = skip_string(bytes, at);
                continue;
            }
            b'{' | b'[' => depth += 1,
            b'}' | b']' => depth -= 1,
            _ => {}
        }
        if depth > limit {
            return Some(at);
        }
        at += 1;
    }
    None
}

/// White space of JSON.
pub(super) const BLANKS: [char; 4] = [' ', '\t', '\n', '\r'];

fn skip_blank(bytes: &[u8], mut at: usize) -> usize {
    while at < bytes.len() && matches!(bytes[at], b' ' | b'\t' | b'\n' | b'\r') {
        at += 1;
    }
    at
}

/// Returns the offset behind the string whose opening quote is at `at`.
fn skip_string(bytes: &[u8], mut at: usize) -> usize {
    at += 1;
    while let Some(found) = memchr::memchr2(b'"', b'\\', &bytes[at..]) {
        at += found;
        if bytes[at] == b'"' {
            return at + 1;
        }
        at += 2;
    }
    bytes.len()
}

fn skip_value(bytes: &[u8], mut at: usize) -> usize {
    match bytes[at] {
        b'"' => skip_string(bytes, at),
        b'{' | b'[' => {
            let mut depth = 0;
            loop {
                match bytes[at] {
                    b'"' => {
                        at = skip_string(bytes, at);
                        continue;
                    }
                    b'{' | b'[' => depth += 1,
                    b'}' | b']' => depth -= 1,
                    _ => {}
                }
                at += 1;
                if depth == 0 {
                    return at;
                }
            }
        }
        _ => {
            while at < bytes.len()
                && !matches!(bytes[at], b',' | b']' | b'}' | b' ' | b'\t' | b'\n' | b'\r')
            {
                at += 1;
            }
            at
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn items(text: &str) -> Vec<(&str, &str)> {
        let found = container(text, &root(text).unwrap()).unwrap();
        found
            .items
            .iter()
            .map(|item| (&text[item.key.clone()], &text[item.value.clone()]))
            .collect()
    }

    #[test]
    fn items_have_exact_spans() {
        assert_eq!(items(" [ ] "), []);
        assert_eq!(
            items("[1 ,\"a,]\\\"\", {\"b\":[2]}\t]"),
            [("", "1"), ("", "\"a,]\\\"\""), ("", "{\"b\":[2]}")]
        );
        assert_eq!(
            items("{ \"a\\\\\" : -1e3,\r\n\"\":null}"),
            [("\"a\\\\\"", "-1e3"), ("\"\"", "null")]
        );
    }

    #[test]
    fn depth_is_counted_outside_strings() {
        assert_eq!(deeper_than("[[\"[[[\"]]", 2), None);
        assert_eq!(deeper_than("[[[]]]", 2), Some(2));
    }
}
