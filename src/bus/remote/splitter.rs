//! Splits a byte stream into lines or messages at their end bytes.
//!
//! Pure; does not know what a part means: the protocol's module does.

/// Longest part that is kept, in bytes. The longest slcan frame has 142, a socketcand frame 70;
/// responses with a version or an error can be longer.
const MAX_PART: usize = 256;

/// The part of a stream whose end has not been received yet; at most [`MAX_PART`] bytes of it.
#[derive(Debug, Default)]
pub(in crate::bus) struct Splitter {
    partial: Vec<u8>,
    is_too_long: bool,
}

impl Splitter {
    /// Passes every part that `input` completes to `take`, with its end byte, which is one of `ends`.
    /// A part longer than [`MAX_PART`] is `None`.
    pub fn feed(&mut self, input: &[u8], ends: &[u8], mut take: impl FnMut(Option<&[u8]>, u8)) {
        for chunk in input.split_inclusive(|byte| ends.contains(byte)) {
            let end = chunk.last().copied().filter(|byte| ends.contains(byte));
            let text = &chunk[..chunk.len() - usize::from(end.is_some())];
            let room = MAX_PART - self.partial.len();
            self.is_too_long |= text.len() > room;
            self.partial.extend_from_slice(&text[..text.len().min(room)]);
            if let Some(end) = end {
                let is_too_long = std::mem::take(&mut self.is_too_long);
                take((!is_too_long).then_some(&self.partial), end);
                self.partial.clear();
            }
        }
    }

    /// The part without its end; at most its first [`MAX_PART`] bytes.
    pub fn partial(&self) -> &[u8] {
        &self.partial
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parts(splitter: &mut Splitter, input: &[u8]) -> Vec<(Option<Vec<u8>>, u8)> {
        let mut seen = Vec::new();
        splitter.feed(input, b"\r>", |part, end| seen.push((part.map(<[u8]>::to_vec), end)));
        seen
    }

    #[test]
    fn endless_part_needs_bounded_memory() {
        let mut splitter = Splitter::default();
        assert_eq!(parts(&mut splitter, &vec![b'x'; 100_000]), []);
        assert!(splitter.partial.capacity() <= 2 * MAX_PART);
        assert_eq!(parts(&mut splitter, b"\rz>"), [(None, b'\r'), (Some(vec![b'z']), b'>')]);
    }

    proptest! {
        #[test]
        fn parts_do_not_depend_on_how_the_stream_is_cut(
            input in prop::collection::vec(prop::sample::select(b"ab\r>".to_vec()), 0..600),
            cuts in prop::collection::vec(1..300_usize, 0..20),
        ) {
            let whole = parts(&mut Splitter::default(), &input);
            let mut splitter = Splitter::default();
            let mut cut = Vec::new();
            let mut rest = &input[..];
            for len in cuts {
                let (head, tail) = rest.split_at(len.min(rest.len()));
                cut.extend(parts(&mut splitter, head));
                rest = tail;
            }
            cut.extend(parts(&mut splitter, rest));
            prop_assert_eq!(cut, whole);
            prop_assert!(splitter.partial().len() <= MAX_PART);
        }
    }
}
