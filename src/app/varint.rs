//! Numbers in as few bytes as they need: seven bits a byte, the lowest first (LEB128).

/// Appends a number: one byte below 128, ten at most.
pub(super) fn write_varint(bytes: &mut impl Extend<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.extend([number as u8 | 0x80]);
        number >>= 7;
    }
    bytes.extend([number as u8]);
}

/// Reads a number; `None` if the bytes end before it does.
pub(super) fn read_varint(bytes: &mut impl Iterator<Item = u8>) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let byte = bytes.next()?;
        number |= u64::from(byte & 0x7F) << shift;
        if byte & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_as_they_were_written() {
        let numbers = [0, 1, 127, 128, 300, u64::from(u32::MAX), u64::MAX];
        let mut bytes = Vec::new();
        for number in numbers {
            write_varint(&mut bytes, number);
        }
        assert_eq!(bytes.len(), 1 + 1 + 1 + 2 + 2 + 5 + 10);
        let mut left = bytes.iter().copied();
        let read: Vec<u64> = std::iter::from_fn(|| read_varint(&mut left)).collect();
        assert_eq!(read, numbers);
        assert_eq!(read_varint(&mut [0x80; 3].into_iter()), None);
    }
}
