//! candump's text: lines of other programs are read, lines written by descan are read back, and no
//! content of a line does harm.

use crate::common::frames::any_frame;
use descan::frame::{CanId, Frame, FrameKind};
use descan::log::LogEntry;
use descan::log::candump::{LineFault, MAX_LINE, parse_frame, parse_line, write_line};
use descan::time::Epoch;
use proptest::prelude::*;

fn read(line: &str) -> LogEntry<'_> {
    match parse_line(line.as_bytes()) {
        Ok(Some(line)) => line,
        other => panic!("{line:?}: {other:?}"),
    }
}

fn fault(line: &str) -> LineFault {
    match parse_line(line.as_bytes()) {
        Err(fault) => fault,
        other => panic!("{line:?}: {other:?}"),
    }
}

#[test]
fn manual_example_line_is_parsed() {
    let line = read("(1436509052.249713) can0 02015402#0444455301");
    assert_eq!(line.time.micros, 1_436_509_052_249_713);
    assert_eq!(line.interface, "can0");
    assert_eq!(line.frame, Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1]));
}

#[test]
fn frames_of_every_kind_are_parsed() {
    let standard = |data: &[u8]| Frame::new(CanId::Standard(0x123), data);
    let fd = |bit_rate_switch, error_state, data: &[u8]| {
        let mut frame = Frame::fd(0, data, 0);
        frame.id = CanId::Standard(0x123);
        (frame.bit_rate_switch, frame.error_state) = (bit_rate_switch, error_state);
        frame
    };
    for (text, frame) in [
        ("123#", standard(&[])),
        ("123#1122", standard(&[0x11, 0x22])),
        ("00000123#1122", Frame::classic(0x123, &[0x11, 0x22])),
        ("1FFFFFFF#ff", Frame::classic(0x1FFF_FFFF, &[0xFF])),
        ("123#11.22.33", standard(&[0x11, 0x22, 0x33])),
        (
            "123#1122334455667788_F",
            standard(&[0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88]).with_raw_dlc(15),
        ),
        ("123#R", Frame::remote(CanId::Standard(0x123), 0)),
        ("123#R4", Frame::remote(CanId::Standard(0x123), 4)),
        ("123#r8_9", Frame::remote(CanId::Standard(0x123), 8).with_raw_dlc(9)),
        ("00000123#R", Frame::remote(CanId::Extended(0x123), 0)),
        ("123##0", fd(false, false, &[])),
        ("123##1AA", fd(true, false, &[0xAA])),
        ("123##6aa.bb", fd(false, true, &[0xAA, 0xBB])),
        ("123##30102030405060708090A", fd(true, true, &[1, 2, 3, 4, 5, 6, 7, 8, 9, 10])),
        ("20000004#0001000000000000", Frame::error(4, &[0, 1, 0, 0, 0, 0, 0, 0])),
    ] {
        assert_eq!(parse_frame(text.as_bytes()), Ok(frame), "{text}");
    }
    assert_eq!(parse_frame(b"123##0010203040506070809").unwrap().len(), 12);
}

#[test]
fn unusual_lines_of_other_tools_are_accepted() {
    let plain = read("(1.500000) can0 123#AB").frame;
    for line in [
        "(1.5) can0 123#ab",
        "  (1.500000)  can0   123#AB  ",
        "\t(1.500000)\tcan0\t123#AB\r\n",
        "(1.500000) can0 123#AB R",
        "(0000000001.500000999) can0 123#AB\n",
        "(1.5000009999999999999999999999999) can0 123#AB\n",
    ] {
        let read = read(line);
        assert_eq!((read.time.micros, read.frame), (1_500_000, plain), "{line:?}");
    }
    assert_eq!(read("(7) can0 123#AB").time.micros, 7_000_000);
    assert!(read("(1.5) can0 123#AB T").frame.is_tx);
    for blank in ["", "\n", "\r\n", "   \t "] {
        assert_eq!(parse_line(blank.as_bytes()), Ok(None));
    }
}

#[test]
fn invalid_line_error_names_the_cause() {
    for (line, expected) in [
        ("can0 123#AB", LineFault::Time),
        ("(1.5 can0 123#AB", LineFault::Time),
        ("() can0 123#AB", LineFault::Time),
        ("(.5) can0 123#AB", LineFault::Time),
        ("(-1.5) can0 123#AB", LineFault::Time),
        ("(99999999999999999999.5) can0 123#AB", LineFault::Time),
        ("(1.500000x) can0 123#AB", LineFault::Time),
        ("(18446744073709551615.5) can0 123#AB", LineFault::Time),
        ("(1.5)", LineFault::Interface),
        ("(1.5) can0", LineFault::Frame),
        ("(1.5) can0 123", LineFault::Frame),
        ("(1.5)  can0  123   [2]  11 22", LineFault::Frame),
        ("(1.5) can0 #11", LineFault::Id),
        ("(1.5) can0 1234#11", LineFault::Id),
        ("(1.5) can0 800#11", LineFault::Id),
        ("(1.5) can0 80000123#11", LineFault::Id),
        ("(1.5) can0 12G#11", LineFault::Id),
        ("(1.5) can0 20000004#R", LineFault::Data),
        ("(1.5) can0 20000004##111", LineFault::Data),
        ("(1.5) can0 123#1", LineFault::Data),
        ("(1.5) can0 123#1.1", LineFault::Data),
        ("(1.5) can0 123#.11", LineFault::Data),
        ("(1.5) can0 123#11..22", LineFault::Data),
        ("(1.5) can0 123#1122x", LineFault::Data),
        ("(1.5) can0 123##", LineFault::Data),
        ("(1.5) can0 123#112233445566778899", LineFault::TooMuchData),
        ("(1.5) can0 123#11_9", LineFault::Length),
        ("(1.5) can0 123#1122334455667788_8", LineFault::Length),
        ("(1.5) can0 123#1122334455667788_", LineFault::Length),
        ("(1.5) can0 123#R9", LineFault::Data),
        ("(1.5) can0 123#81:00:12345678#112233", LineFault::Xl),
        ("(1.5) can0 123#11 X", LineFault::Trailing),
        ("(1.5) can0 123#11 R R", LineFault::Trailing),
    ] {
        assert_eq!(fault(line), expected, "{line:?}");
    }
    assert_eq!(fault(&"x".repeat(MAX_LINE + 1)), LineFault::TooLong);
    let too_much = format!("(1.5) can0 123##0{}", "11".repeat(65));
    assert_eq!(fault(&too_much), LineFault::TooMuchData);
    assert_eq!(parse_line(b"(1.5) \xFF\xFE 123#11"), Err(LineFault::Interface));
}

proptest! {
    #[test]
    fn any_frame_written_is_read_back(frame in any_frame(), epoch in 0_u64..1 << 50) {
        let epoch = Epoch::from_unix_micros(epoch);
        let mut line = Vec::new();
        write_line(&mut line, epoch, "can0", &frame).unwrap();
        let read = parse_line(&line).unwrap().expect("a frame");
        prop_assert_eq!(read.interface, "can0");
        prop_assert_eq!(read.time.micros, epoch.unix_micros(frame.time));
        prop_assert_eq!(read.frame.with_time(frame.time), frame);
    }

    #[test]
    fn arbitrary_bytes_do_not_panic(line in proptest::collection::vec(any::<u8>(), 0..700)) {
        let _ = parse_line(&line);
    }

    #[test]
    fn nearly_valid_line_does_not_panic(
        line in "[ \t]*\\(?[0-9]{0,25}\\.?[0-9]{0,25}\\)? (can0|é) [0-9A-G]{0,9}#{0,3}[R0-9A-F._:]{0,140}( [RT])?\r?"
    ) {
        if let Ok(Some(line)) = parse_line(line.as_bytes()) {
            let most = if line.frame.is_fd { 64 } else { 8 };
            prop_assert!(line.frame.len() <= most);
            prop_assert!(line.frame.kind == FrameKind::Data || !line.frame.is_fd);
        }
    }
}
