//! Decisions of a check, read from the bytes of its input.

/// Reads decisions from bytes; after their end every decision is 0.
pub struct Choices<'i> {
    bytes: &'i [u8],
}

impl<'i> Choices<'i> {
    /// Starts at the first of `bytes`.
    pub fn new(bytes: &'i [u8]) -> Self {
        Self { bytes }
    }

    /// Returns true if all bytes were used.
    pub fn is_over(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Returns the next byte.
    pub fn byte(&mut self) -> u8 {
        self.array::<1>()[0]
    }

    /// Returns a number below `end`, which is 1 to 256.
    pub fn below(&mut self, end: usize) -> usize {
        usize::from(self.byte()) % end
    }

    /// Returns true for every second value of the next byte.
    pub fn flag(&mut self) -> bool {
        self.below(2) == 1
    }

    /// Returns one of `options`, of which there are 1 to 256.
    pub fn one_of<T: Copy>(&mut self, options: &[T]) -> T {
        options[self.below(options.len())]
    }

    /// Returns the next four bytes as a number.
    pub fn u32(&mut self) -> u32 {
        u32::from_be_bytes(self.array())
    }

    /// Returns the next eight bytes as a number.
    pub fn u64(&mut self) -> u64 {
        u64::from_be_bytes(self.array())
    }

    /// Returns the next bytes, at most `len`.
    pub fn bytes(&mut self, len: usize) -> &'i [u8] {
        let (taken, rest) = self.bytes.split_at(len.min(self.bytes.len()));
        self.bytes = rest;
        taken
    }

    fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut array = [0; N];
        let taken = self.bytes(N);
        array[..taken.len()].copy_from_slice(taken);
        array
    }
}
