//! How long a frame is on the wire, to the bit: stuff bits, CRC, acknowledge, end of frame and
//! intermission included (ISO 11898-1).
//!
//! Allocates nothing and keeps no tables outside the program's image, so the bus load of a full
//! bus can be computed frame by frame. Does not know bit rates' history or who sends.

use super::{CanId, Frame, FrameKind};

/// Recessive bits between two frames, counted in [`FrameBits`].
pub const INTERMISSION: u32 = 3;
/// CRC delimiter, ACK slot, ACK delimiter, seven bits of end of frame, intermission.
const TAIL: u32 = 3 + 7 + INTERMISSION;
/// What follows the ACK slot: its delimiter, end of frame, intermission.
const AFTER_ACK: u32 = 1 + 7 + INTERMISSION;
/// Most bytes of a classic frame before the CRC.
const CLASSIC_BYTES: usize = (1 + 11 + 2 + 18 + 1 + 2 + 4 + 64_usize).div_ceil(8);
/// Most data bits of a frame before the CRC: FD, extended, 64 bytes.
const MAX_BYTES: usize = 72;

/// The length of a frame in bits, those of the FD data phase apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct FrameBits {
    /// Bits at the nominal rate, intermission included.
    pub nominal: u32,
    /// Bits at the data rate; 0 unless the frame is FD and switches.
    pub data: u32,
}

impl FrameBits {
    /// The length of `frame`. An error report counts as nothing: it is not on the wire itself.
    pub fn of(frame: &Frame) -> Self {
        if frame.kind == FrameKind::Error {
            return Self::default();
        }
        if frame.is_fd { Content::of(frame).fd_length(frame) } else { classic_length(frame) }
    }

    /// All bits, whatever their rate.
    pub const fn total(self) -> u32 {
        self.nominal + self.data
    }

    /// Those up to and with the ACK slot.
    #[must_use]
    pub const fn until_ack(self) -> Self {
        Self { nominal: self.nominal - AFTER_ACK, data: self.data }
    }

    /// How long they take, in nanoseconds; rates in bit/s, at least 1.
    pub const fn nanos(self, bitrate: u32, data_bitrate: u32) -> u64 {
        bit_nanos(self.nominal, bitrate) + bit_nanos(self.data, data_bitrate)
    }
}

/// How long `bits` take at `bitrate`, in nanoseconds.
pub(crate) const fn bit_nanos(bits: u32, bitrate: u32) -> u64 {
    let bitrate = if bitrate == 0 { 1 } else { bitrate };
    bits as u64 * 1_000_000_000 / bitrate as u64
}

/// Bits of a frame that take part in arbitration, most significant bit first: the lower value wins.
/// The base identifier, RTR or SRR, IDE, the identifier's extension, RTR.
pub fn arbitration_field(frame: &Frame) -> u32 {
    let remote = u32::from(frame.kind == FrameKind::Remote);
    match frame.id {
        CanId::Standard(id) => u32::from(id & 0x7FF) << 21 | remote << 20,
        CanId::Extended(id) => {
            let (base, extension) = (id >> 18 & 0x7FF, id & 0x3_FFFF);
            base << 21 | 0b11 << 19 | extension << 1 | remote
        }
    }
}

/// First bit on the wire in which two frames differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirstDifference {
    /// Bits from the start to the first different one, itself and stuff bits included.
    pub bits: u32,
    /// True if the first of the two sends the recessive bit there; its sender detects the
    /// difference.
    pub first_is_recessive: bool,
}

/// The first bit in which `first` and `second` differ on the wire; `None` when they are equal.
pub fn first_difference(first: &Frame, second: &Frame) -> Option<FirstDifference> {
    let (first, second) = (Content::of(first), Content::of(second));
    let at = first.stuffed().zip(second.stuffed()).enumerate().find(|(_, (a, b))| a != b)?;
    let (before, (first_bit, _)) = at;
    Some(FirstDifference { bits: before as u32 + 1, first_is_recessive: first_bit == 1 })
}

/// The bits of a frame from its start to the end of its data, unstuffed.
struct Content {
    bytes: [u8; MAX_BYTES],
    len: usize,
    /// How many of them precede the bit BRS.
    before_switch: usize,
}

impl Content {
    fn of(frame: &Frame) -> Self {
        let mut bits = Self { bytes: [0; MAX_BYTES], len: 0, before_switch: 0 };
        let remote = u32::from(frame.kind == FrameKind::Remote);
        bits.push(0, 1);
        match frame.id {
            CanId::Standard(id) => {
                bits.push(u32::from(id), 11);
                bits.push(remote << 1, 2);
            }
            CanId::Extended(id) => {
                bits.push(id >> 18, 11);
                bits.push(0b11, 2);
                bits.push(id, 18);
                bits.push(remote, 1);
            }
        }
        if frame.is_fd {
            bits.push(0b10, 2);
            bits.before_switch = bits.len;
            bits.push(u32::from(frame.bit_rate_switch), 1);
            bits.push(u32::from(frame.error_state), 1);
        } else {
            let reserved = if matches!(frame.id, CanId::Extended(_)) { 2 } else { 1 };
            bits.push(0, reserved);
        }
        bits.push(u32::from(frame.dlc()), 4);
        for &byte in frame.data() {
            bits.push(u32::from(byte), 8);
        }
        bits
    }

    /// Appends the low `count` bits of `value`, at most 25 of them.
    fn push(&mut self, value: u32, count: usize) {
        let (at, used) = (self.len / 8, self.len % 8);
        let value = value & ((1 << count) - 1);
        let aligned = (value << (32 - count) >> used).to_be_bytes();
        for (place, byte) in self.bytes[at..].iter_mut().zip(aligned) {
            *place |= byte;
        }
        self.len += count;
    }

    fn bit(&self, at: usize) -> u8 {
        self.bytes[at / 8] >> (7 - at % 8) & 1
    }

    fn fd_length(&self, frame: &Frame) -> FrameBits {
        // Fixed stuff bits make this part's length independent of its value: four bits of stuff
        // count and the CRC, one stuff bit before each four of them.
        let crc_field = if frame.len() <= 16 { 4 + 17 + 6 } else { 4 + 21 + 7 };
        let (mut all, stuffed_at_end) = self.stuff_bits(self.len);
        // The first fixed stuff bit stands in for one that would follow the last data bit.
        all -= u32::from(stuffed_at_end);
        let everything = self.len as u32 + all + crc_field + TAIL;
        if !frame.bit_rate_switch {
            return FrameBits { nominal: everything, data: 0 };
        }
        let (early, _) = self.stuff_bits(self.before_switch);
        let nominal = self.before_switch as u32 + 1 + early + TAIL;
        FrameBits { nominal, data: everything - nominal }
    }

    /// How many stuff bits the first `len` bits need, and whether one follows the last of them.
    fn stuff_bits(&self, len: usize) -> (u32, bool) {
        let body = len.saturating_sub(1) / 8;
        let ((mut state, mut count), mut last) = (stuff_bytes(&self.bytes[..body]), false);
        for at in body * 8..len {
            (state, last) = stuff_bit(state, self.bit(at));
            count += u32::from(last);
        }
        (count, last)
    }

    /// The bits as they go over the wire, up to the end of the data.
    fn stuffed(&self) -> impl Iterator<Item = u8> {
        let (mut at, mut state, mut pending) = (0, 0, None);
        core::iter::from_fn(move || {
            if let Some(bit) = pending.take() {
                return Some(bit);
            }
            let bit = (at < self.len).then(|| self.bit(at))?;
            at += 1;
            let (next, stuffed) = stuff_bit(state, bit);
            state = next;
            pending = stuffed.then_some(1 - bit);
            Some(bit)
        })
    }
}

/// The length of a frame that is not FD: what there is most of, so in one register.
fn classic_length(frame: &Frame) -> FrameBits {
    let arbitration = u128::from(arbitration_field(frame));
    let (header, header_len) = match frame.id {
        // Identifier, RTR, IDE, one reserved bit.
        CanId::Standard(_) => (arbitration >> 20 << 2, 1 + 11 + 3),
        // Base identifier, SRR, IDE, the rest of it, RTR, two reserved bits.
        CanId::Extended(_) => (arbitration << 2, 1 + 11 + 2 + 18 + 1 + 2),
    };
    let bytes = frame.data().len().min(Frame::MAX_CLASSIC_DATA);
    // The bytes behind the data are shifted out.
    let data = u64::from_be_bytes(frame.first_eight_bytes());
    let data = data.checked_shr(64 - 8 * bytes as u32).unwrap_or(0);
    let mut bits = header << 4 | u128::from(frame.dlc());
    bits = bits << (8 * bytes) | u128::from(data);
    let mut len: usize = header_len + 4 + 8 * bytes;
    // Leading zeros change nothing of a CRC that begins with 0, and it is that of its bytes alone,
    // added.
    let bytes: [u8; 16] = bits.to_be_bytes();
    // The first ones are 0.
    let (mut crc, mut place) = (0, bytes.len() - CLASSIC_BYTES);
    while place < bytes.len() {
        crc ^= CRC15[place][usize::from(bytes[place])];
        place += 1;
    }
    bits = bits << 15 | u128::from(crc);
    len += 15;
    // Behind the end bits that take turns: they need no stuffing.
    let behind = if bits & 1 == 0 { 0xAA } else { 0x55 };
    bits = (bits << 8 | behind) << (128 - 8 - len);
    let (_, stuffing) = stuff_bytes(&bits.to_be_bytes()[..len.div_ceil(8)]);
    FrameBits { nominal: len as u32 + stuffing + TAIL, data: 0 }
}

/// One bit of the classic CRC, polynomial 4599.
const fn crc15_bit(crc: u16, bit: u16) -> u16 {
    let feedback = (crc >> 14 ^ bit) & 1;
    let shifted = crc << 1 & 0x7FFF;
    if feedback == 1 { shifted ^ 0x4599 } else { shifted }
}

/// The classic CRC of each byte of sixteen, all others being 0; the last one at the end.
static CRC15: [[u16; 256]; 16] = {
    let mut tables = [[0; 256]; 16];
    let mut byte = 0;
    while byte < 256 {
        let mut place = 16;
        let (mut crc, mut value) = (0, byte);
        while place > 0 {
            place -= 1;
            let mut bit = 8;
            while bit > 0 {
                bit -= 1;
                crc = crc15_bit(crc, (value >> bit & 1) as u16);
            }
            tables[place][byte] = crc;
            // Zeros follow it at the place before.
            value = 0;
        }
        byte += 1;
    }
    tables
};

/// Which bits came last: 0 none, 1–4 that many zeros, 5–8 one to four ones. Returns the state
/// after `bit` and whether a stuff bit follows it.
const fn stuff_bit(state: u8, bit: u8) -> (u8, bool) {
    let run = match (state, bit) {
        (1..=4, 0) => state + 1,
        (5..=8, 1) => state - 3,
        _ => 1,
    };
    match (run, bit) {
        (5, 0) => (5, true),
        (5, _) => (1, true),
        (run, 0) => (run, false),
        (run, _) => (run + 4, false),
    }
}

/// The state after the first bytes of a frame, and how many stuff bits they need. The first bit is the
/// start of frame, 0.
fn stuff_bytes(bytes: &[u8]) -> (u8, u32) {
    let (shift, count) = bytes.iter().fold((BEFORE_START, 0), |(shift, count), &byte| {
        let next = STUFFING[usize::from(byte)] >> shift;
        (next & STATE, count + (next & COUNT) as u32)
    });
    ((shift / BITS_OF_STATE) as u8 + 1, count)
}

/// Bits in [`STUFFING`] for each of the states 1 to 8: the shift to the place of the next state, and how
/// many stuff bits came, at most two.
const BITS_OF_STATE: u64 = 8;
const STATE: u64 = 0b11_1000;
const COUNT: u64 = 0b00_0111;
/// The shift for a state before the start of frame: after a one, a zero begins a run as after nothing.
const BEFORE_START: u64 = 4 * BITS_OF_STATE;

/// [`stuff_bit`] eight bits at a time, for all states in one number: the load does not wait for the state.
static STUFFING: [u64; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut state = 1;
        while state <= 8 {
            let (mut now, mut count, mut bit) = (state as u8, 0, 8);
            while bit > 0 {
                bit -= 1;
                let (next, stuffed) = stuff_bit(now, (byte >> bit & 1) as u8);
                now = next;
                count += stuffed as u64;
            }
            let next = ((now as u64 - 1) * BITS_OF_STATE) | count;
            table[byte] |= next << ((state - 1) * BITS_OF_STATE);
            state += 1;
        }
        byte += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;

    fn total(frame: &Frame) -> u32 {
        FrameBits::of(frame).total()
    }

    /// The same by another road: text of zeros and ones.
    fn naive(frame: &Frame) -> u32 {
        let remote = u8::from(frame.kind == FrameKind::Remote);
        let (mut bits, id_end) = match frame.id {
            CanId::Standard(id) => (format!("0{id:011b}{remote}0"), "0"),
            CanId::Extended(id) => {
                (format!("0{:011b}11{:018b}{remote}", id >> 18, id & 0x3_FFFF), "00")
            }
        };
        bits += id_end;
        write!(bits, "{:04b}", frame.len()).unwrap();
        for byte in frame.data() {
            write!(bits, "{byte:08b}").unwrap();
        }
        let mut crc = 0u32;
        for bit in bits.bytes() {
            let bit = u32::from(bit == b'1');
            let next = bit ^ (crc >> 14 & 1);
            crc = crc << 1 & 0x7FFF;
            if next == 1 {
                crc ^= 0x4599;
            }
        }
        write!(bits, "{crc:015b}").unwrap();
        let (mut run, mut last, mut count) = (0, b'x', 0);
        for bit in bits.bytes() {
            run = if bit == last { run + 1 } else { 1 };
            last = bit;
            count += 1;
            if run == 5 {
                count += 1;
                last = b'0' + b'1' - bit;
                run = 1;
            }
        }
        count + 1 + 1 + 1 + 7 + 3
    }

    #[test]
    fn frame_of_zeros_has_stuff_bit_every_five_bits() {
        // 34 zeros from start to CRC: six stuff bits, 13 bits of tail.
        assert_eq!(total(&Frame::new(CanId::Standard(0), &[])), 34 + 6 + 13);
    }

    #[test]
    fn without_stuffing_a_frame_has_its_plain_length() {
        // The shortest of all identifiers is the one that needs no stuff bit: 47 and 67 bits
        // plus eight per byte, intermission included.
        let data = [0x55; 8];
        let extended = (0..0x2000).map(|id| total(&Frame::classic(0x0AAA_A555 ^ id, &data)));
        let standard = (0..0x800).map(|id| total(&Frame::new(CanId::Standard(id), &data)));
        assert_eq!((standard.min(), extended.min()), (Some(47 + 64), Some(67 + 64)));
    }

    #[test]
    fn lengths_agree_with_a_bit_by_bit_count() {
        let mut rng = fastrand::Rng::with_seed(1);
        for round in 0..20_000 {
            let len = rng.usize(0..=8);
            // Mostly zeros and ones in runs, where stuffing happens.
            let data: [u8; 8] = std::array::from_fn(|_| rng.choice([0, 0xFF, 0x0F, 0xF8]).unwrap());
            let id = if round % 2 == 0 {
                CanId::Standard(rng.u16(0..0x800) & rng.u16(..))
            } else {
                CanId::Extended(rng.u32(0..0x2000_0000) & rng.u32(..))
            };
            let frame = Frame::new(id, &data[..len]);
            assert_eq!(total(&frame), naive(&frame), "{frame}");
            let remote = Frame::remote(id, len);
            assert_eq!(total(&remote), naive(&remote), "{remote}");
        }
    }

    /// Nothing keeps a frame from having more bytes than its kind can.
    #[test]
    fn impossible_frame_still_has_a_length() {
        for id in [CanId::Standard(0x7FF), CanId::Extended(0x1FFF_FFFF)] {
            // The plain length of eight bytes, and no more than it can grow by stuffing.
            let length = total(&Frame::new(id, &[0; 64]));
            assert!((47 + 64..=160).contains(&length), "{length}");
        }
    }

    #[test]
    fn fd_frames_have_two_rates() {
        // Extended, no bytes, id that needs no stuffing before the switch: 35 bits and BRS, tail
        // 13; then ESI, DLC (its four zeros and ESI's: one stuff bit would follow, the fixed one
        // stands in for it), stuff count and CRC 27.
        let mut frame = Frame::fd(0x0AAA_A555, &[], 0xCC);
        assert_eq!(FrameBits::of(&frame), FrameBits { nominal: 36 + 13, data: 5 + 27 });
        frame.bit_rate_switch = false;
        // BRS is one zero more: five of them with ESI and three of DLC, one stuff bit.
        assert_eq!(FrameBits::of(&frame), FrameBits { nominal: 36 + 13 + 5 + 1 + 27, data: 0 });
        let long = Frame::fd(0x0AAA_A555, &[0x55; 64], 0xCC);
        assert_eq!(FrameBits::of(&long).data, 5 + 512 + 32);
        let nanos = FrameBits { nominal: 10, data: 10 }.nanos(125_000, 5_000_000);
        assert_eq!(nanos, 80_000 + 2_000);
    }

    #[test]
    fn frames_differ_at_their_first_different_bit() {
        let one = Frame::classic(0x0518_0002, &[0xAA, 0x80]);
        let two = Frame::classic(0x0518_0002, &[0xAA, 0x00]);
        assert_eq!(first_difference(&one, &one), None);
        let difference = first_difference(&one, &two).unwrap();
        assert!(difference.first_is_recessive);
        assert_eq!(first_difference(&two, &one).map(|d| d.bits), Some(difference.bits));
        assert!(difference.bits > 39 + 8, "{difference:?}");
        let standard = Frame::new(CanId::Standard(0x7FF), &[]);
        assert!(arbitration_field(&one) < arbitration_field(&two) | 1);
        assert!(arbitration_field(&one) < arbitration_field(&standard));
    }

    #[test]
    fn standard_beats_extended_of_the_same_base() {
        let standard = Frame::new(CanId::Standard(0x123), &[]);
        let extended = Frame::classic(0x123 << 18, &[]);
        assert!(arbitration_field(&standard) < arbitration_field(&extended));
        let remote = Frame::remote(CanId::Extended(0x123 << 18), 0);
        assert!(arbitration_field(&extended) < arbitration_field(&remote));
    }
}
