//! DBC files: messages and signals of frames that are not of DES.

use crate::common::harness::Stage;
use crate::common::python::Python;
use descan::app::{App, AppOptions};
use descan::dbc::MessageDatabase;
use descan::discovery::Config;
use descan::frame::{CanId, Frame};
use descan::sim::Scenario;
use descan::text::hex;
use descan::time::Duration;
use descan::wire::data_layout::DataValue;
use fastrand::Rng;
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::Arc;

const CAR: &str = include_str!("../corpus/dbc/kinds_of_signals");
const DEEP: &str = include_str!("../corpus/dbc/multiplexors_of_multiplexors");
const LATIN: &[u8] = include_bytes!("../corpus/dbc/latin_1");

fn database(text: impl AsRef<[u8]>) -> MessageDatabase {
    let mut database = MessageDatabase::default();
    database.add(text.as_ref()).unwrap();
    database
}

/// Returns the words of a frame; empty if no message has its identifier.
fn words(database: &MessageDatabase, id: u32, data: &[u8]) -> String {
    let id = if id >> 31 == 1 {
        CanId::Extended(id & CanId::MAX_EXTENDED)
    } else {
        CanId::Standard(id as u16)
    };
    let message = database.message(&Frame::new(id, data));
    message.map_or(String::new(), |message| message.in_words(data))
}

#[test]
fn signals_of_every_kind_are_decoded() {
    let car = database(CAR);
    for (id, data, expected) in [
        (
            0x100,
            &b"\x40\x0D\x5A\x01\xFF\xF0\0\0"[..],
            "Engine: Speed 848.00 rpm, Temperature 50 °C, Fan slow, Torque -0.5 Nm",
        ),
        (
            0x100,
            b"\0\0\x80\x02\x00\x10\0\0",
            "Engine: Speed 0.00 rpm, Temperature -168 °C, Fan 2, Torque 0.5 Nm",
        ),
        (0x100, b"\x40\x0D", "Engine: Speed 848.00 rpm, Temperature –, Fan –, Torque –"),
        (0x98FE_F1FE, b"\0\xE8\x03\0\0\0\0\0", "Pedal: Mode 0, Position 100.0 %"),
        (0x98FE_F1FE, b"\x01\0\0\xC0\xBF\0\0\0", "Pedal: Mode 1, Force -1.5 N"),
        (0x98FE_F1FE, b"\x02\0\0\xC0\xBF\0\0\0", "Pedal: Mode 2"),
        // The comment of the file has a line that begins as a message does.
        (0x001, b"\0\0\0\0\0\0\0\0", ""),
    ] {
        assert_eq!(words(&car, id, data), expected);
    }
    // A message of 29 bits is none of 11 bits; a remote frame has no signals.
    assert_eq!(words(&car, 0x8000_0100, &[0; 8]), "");
    assert_eq!(car.message(&Frame::remote(CanId::Standard(0x100), 8)), None);
}

#[test]
fn multiplexed_multiplexors_are_followed() {
    let deep = database(DEEP);
    let id = 0x8000_0101;
    assert_eq!(words(&deep, id, &[0x21, 0, 0x80]), "Deep: Outer 1, Inner 2, Leaf 0");
    assert_eq!(words(&deep, id, &[0x21, 0xFE, 0]), "Deep: Outer 1, Inner 2, Leaf -2");
    assert_eq!(words(&deep, id, &[0x11, 0xFE, 0]), "Deep: Outer 1, Inner 1");
    assert_eq!(words(&deep, id, &[0x24, 0xFE, 0]), "Deep: Outer 4, Inner 2, Leaf -2");
    assert_eq!(words(&deep, id, &[0x22, 0xFE, 0]), "Deep: Outer 2");
    let double = [&[0; 8][..], &2.5_f64.to_le_bytes()].concat();
    assert_eq!(words(&deep, id, &double), "Deep: Outer 0, Double 2.5");
    // In a circle, no signal is ever there.
    let circle =
        DEEP.replace("Outer M :", "Outer m0M :") + "SG_MUL_VAL_ 2147483905 Outer Inner 0-15;\n";
    assert_eq!(words(&database(circle), id, &[0x21, 0, 0]), "Deep");
}

#[test]
fn floats_of_32_bits_keep_their_precision() {
    let shown = |factor: &str, number: f32| {
        let text = format!(
            "BO_ 291 M: 8 A\n SG_ X : 0|32@1- {factor} [0|0] \"\" B\n\nSIG_VALTYPE_ 291 X : 1;\n"
        );
        words(&database(text), 291, &number.to_le_bytes())
    };
    assert_eq!(shown("(1,0)", 69_608_816.0), "M: X 69608816");
    assert_eq!(shown("(1,0)", 0.1), "M: X 0.1");
    assert_eq!(shown("(0.1,0)", 10_705_061.0), "M: X 1070506.1");
    assert_eq!(shown("(1,-40)", -233_493_568.0), "M: X -233493608");
    assert_eq!(shown("(1,16777216.25)", 0.5), "M: X 16777216.75");
}

/// Returns the words of an 11-bit frame 291 whose message has the signal `X` of a file.
fn shown(signal: &str, rest: &str, data: &[u8]) -> String {
    let text = format!("BO_ 291 M: 8 A\n SG_ X : {signal} A\n\n{rest}\n");
    words(&database(text), 291, data)
}

#[test]
fn values_of_64_bits_have_all_their_digits() {
    let values = "VAL_ 291 X 9007199254740993 \"odd\" 18446744073709551615 \"SNA\" ;";
    let named = |number: u64| shown("0|64@1+ (1,0) [0|0] \"\"", values, &number.to_le_bytes());
    assert_eq!(named(u64::MAX), "M: X SNA");
    assert_eq!(named((1 << 53) + 1), "M: X odd");
    assert_eq!(named(1 << 53), "M: X 9007199254740992");
    let least = "VAL_ 291 X -9223372036854775808 \"least\" ;";
    assert_eq!(shown("0|64@1- (1,0) [0|0] \"\"", least, &i64::MIN.to_le_bytes()), "M: X least");
    for (signal, number, expected) in [
        ("0|64@1- (1,5) [0|0] \"\"", 578_437_695_752_307_201, "578437695752307206"),
        ("0|64@1- (-1,0) [0|0] \"\"", 9_007_199_254_740_993, "-9007199254740993"),
        ("0|64@1+ (1000,-1) [0|0] \"\"", u64::MAX, "18446744073709551614999"),
        ("0|53@1+ (0.001,0) [0|0] \"s\"", (1 << 53) - 1, "9007199254740.991 s"),
        ("0|64@1+ (1e-6,0) [0|0] \"s\"", 1_700_000_000_123_456, "1700000000.123456 s"),
        ("0|8@1- (0.5,-0.25) [0|0] \"\"", 0xFF, "-0.75"),
        ("0|64@1+ (0.3333333333333333,0) [0|0] \"\"", u64::MAX, "6.14891469123652e18"),
    ] {
        assert_eq!(shown(signal, "", &number.to_le_bytes()), format!("M: X {expected}"));
    }
}

#[test]
fn statements_are_read_in_any_order_and_place() {
    let float = "SIG_VALTYPE_ 291 X : 1;";
    let (signal, one) = ("0|32@1- (1,0) [0|0] \"\"", 1_f32.to_le_bytes());
    assert_eq!(shown(signal, float, &one), "M: X 1");
    assert_eq!(shown(signal, &format!("CM_ SG_ 291 X \"x\"; {float}"), &one), "M: X 1");
    let text = format!("{float}\nVAL_ 291 X 1 \"on\";\nBO_ 291 M: 8 A\n SG_ X : {signal} A\n");
    assert_eq!(words(&database(&text), 291, &one), "M: X on");
    for text in [
        text.replace('\n', "\r"),
        text.replace('\n', " "),
        format!("VERSION \"\" NS_ : NS_DESC_ CM_ VAL_ BS_: BU_: A {}", text.replace('\n', " ")),
        format!("NS_ :\nCM_\nVAL_\nBS_:\nBU_: A\n{text}"),
        text.replace("BO_ 291", "BA_DEF_ SG_ \"a\" INT 0 10; BA_ \"a\" SG_ 291 X 3; BO_ 291"),
        text.replace("0|32@1- (", "0 | 32 @ 1 - ( "),
        // A comment without its semicolon.
        text.replace("BO_ 291", "CM_ \"text\"\nBO_ 291"),
        text.replace("BO_ 291", "BO_ 290 N: 8 A SG_ A : 0|8@1+ (1,0) [0|0] \"\" A BO_ 291"),
    ] {
        assert_eq!(words(&database(&text), 291, &one), "M: X on", "{text}");
    }
    let two = "0|8@1+ (1,0) [0|0] \"\" A SG_ Y : 8|8@1+ (1,0) [0|0] \"\"";
    let values = "VAL_ 291 X 1 \"one\"; VAL_ 291 Y 2 \"two\" ;";
    assert_eq!(shown(two, values, &[1, 2]), "M: X one, Y two");
    // More than 64 bits are no number.
    assert_eq!(shown("7|72@0+ (1,0) [0|0] \"\"", "", &[0; 16]), "M");
    // An object kind at the start of a line does not begin a statement.
    for attribute in
        ["BA_ \"a\"\nBO_ 291 5;\n", "BA_ \"a\"\nBU_ A 5;\n", "CM_\nBO_ 291\n\"text\";\n"]
    {
        let text = format!("{attribute}{text}");
        assert_eq!(words(&database(&text), 291, &one), "M: X on", "{text}");
        let text = text.replace("VAL_", &format!("{attribute}VAL_"));
        assert_eq!(words(&database(&text), 291, &one), "M: X on", "{text}");
    }
}

#[test]
fn signals_of_a_multiplexor_above_64_bits_are_left_out() {
    let wide = "BO_ 291 M: 64 A\n SG_ W M : 0|72@1+ (1,0) [0|0] \"\" A\n \
                SG_ A m1 : 72|8@1+ (1,0) [0|0] \"\" A\n SG_ B : 80|8@1+ (1,0) [0|0] \"\" A\n";
    for text in [wide.to_owned(), format!("{wide}SG_MUL_VAL_ 291 A W 1-3;\n")] {
        assert_eq!(words(&database(&text), 291, &[1; 64]), "M: B 1", "{text}");
    }
}

#[test]
fn long_names_are_those_of_the_attributes() {
    let signals = "0|8@1+ (1,0) [0|0] \"\" A SG_ Y : 8|8@1+ (1,0) [0|0] \"\"";
    let of = |attributes: &str| shown(signals, attributes, &[1, 2]);
    let message = "BA_ \"SystemMessageLongSymbol\" BO_ 291 \"MessageOfALongName\";";
    let signal = "BA_ \"SystemSignalLongSymbol\" SG_ 291 X \"SignalOfALongName\";";
    assert_eq!(of(message), "MessageOfALongName: X 1, Y 2");
    assert_eq!(of(&format!("{signal}\n{message}")), "MessageOfALongName: SignalOfALongName 1, Y 2");
    // Statements have the short name.
    assert_eq!(of(&format!("{signal} VAL_ 291 X 1 \"on\";")), "M: SignalOfALongName on, Y 2");
    assert_eq!(of(&format!("VAL_ 291 X 1 \"on\"; {signal}")), "M: SignalOfALongName on, Y 2");
    for (from, to) in [
        ("SG_ 291 X", "SG_ 292 X"),
        ("SG_ 291 X", "SG_ 291 Z"),
        ("SG_ 291 X", "SG_ X"),
        ("SG_ 291 X", "BU_ A"),
        ("\"SignalOfALongName\"", "\"\""),
        ("\"SignalOfALongName\"", "\"with blanks\""),
        ("\"SignalOfALongName\"", "\"Y\""),
        ("\"SignalOfALongName\"", "5"),
        ("SystemSignalLongSymbol", "SystemNodeLongSymbol"),
    ] {
        let other = signal.replace(from, to);
        assert_ne!(other, signal);
        assert_eq!(of(&format!("{other} VAL_ 291 Y 2 \"on\";")), "M: X 1, Y on", "{other}");
    }
    assert_eq!(
        of(&format!("{message} {}", "BA_ \"SystemMessageLongSymbol\" BO_ 292 \"N\";")),
        "MessageOfALongName: X 1, Y 2"
    );
}

#[test]
fn utf_16_is_read() {
    let text = "BO_ 291 M: 8 A\n SG_ X : 0|8@1+ (1,0) [0|0] \"°C\" A\n";
    let units = || "\u{FEFF}".encode_utf16().chain(text.encode_utf16());
    let little: Vec<u8> = units().flat_map(u16::to_le_bytes).collect();
    let big: Vec<u8> = units().flat_map(u16::to_be_bytes).collect();
    for bytes in [little, big] {
        assert_eq!(words(&database(&bytes), 291, &[7]), "M: X 7 °C");
        // Cut in the middle of a character.
        assert!(MessageDatabase::default().add(&bytes[..bytes.len() - 1]).is_ok());
    }
}

#[test]
fn quotes_and_backslashes_of_a_text_are_those_of_the_file() {
    let signal = r#"0|8@1+ (1,0) [0|0] "m\s \"x\"""#;
    assert_eq!(shown(signal, "", &[7]), r#"M: X 7 m\s "x""#);
    assert_eq!(shown(signal, r#"VAL_ 291 X 7 "say \"hi\"" ;"#, &[7]), r#"M: X say "hi""#);
}

#[test]
fn mistakes_of_a_file_have_their_line() {
    let line = |number: usize, text: &str| {
        let mut lines: Vec<_> = CAR.lines().collect();
        lines[number - 1] = text;
        MessageDatabase::default().add(lines.join("\n").as_bytes()).unwrap_err().to_string()
    };
    for (number, text, cause) in [
        (14, "BO_ x Engine: 8 ECM", "line 14: expected an identifier"),
        (14, "BO_ 2048 Engine: 8 ECM", "line 14: Engine: no identifier of 11 or 29 bits: 2048"),
        (14, "BO_ 256 Engine 8 ECM", "line 14: expected \":\""),
        (
            15,
            " SG_ Speed : 0|16@2+ (1,0) [0|0] \"rpm\" TCM",
            "line 15: expected 0+, 0-, 1+ or 1- behind @",
        ),
        (
            15,
            " SG_ Speed : 0|14281@1+ (1,0) [0|0] \"rpm\" TCM",
            "line 15: Speed: the number of bits is 1 to 14280",
        ),
        (
            15,
            " SG_ Speed : 14280|8@1+ (1,0) [0|0] \"rpm\" TCM",
            "line 15: Speed: the first bit is 0 to 14279",
        ),
        (
            15,
            " SG_ Speed : 0|16@1+ (nan,0) [0|0] \"rpm\" TCM",
            "line 15: Speed: the factor and the offset are numbers",
        ),
        (
            15,
            " SG_ Speed mX : 0|16@1+ (1,0) [0|0] \"rpm\" TCM",
            "line 15: Speed: no multiplexor: mX",
        ),
        (
            15,
            " SG_ Speed m1 : 0|16@1+ (1,0) [0|0] \"rpm\" TCM",
            "line 15: Speed: the message has no multiplexor (M)",
        ),
        (15, " SG_ Speed : 0|16@1+ (1,0) [0|0] rpm TCM", "line 15: expected the unit in quotes"),
        (30, "VAL_ 256 Fan 0 off ;", "line 30: expected the name of the value in quotes"),
        (31, "SIG_VALTYPE_ 256 Fan : 1;", "line 31: Fan: a number of this type has 32 bits"),
        (32, "CM_ \"a comment", "line 32: the quoted text does not end"),
    ] {
        assert_eq!(line(number, text), cause, "{text}");
    }
    let error = MessageDatabase::default().add(b"not a DBC file\n").unwrap_err();
    assert_eq!(error.to_string(), "line 2: no message (BO_) in the file");
}

#[test]
fn signals_that_public_files_have_wrong_do_not_refuse_the_file() {
    let text = "BO_ 256 Msg: 8 X\n SG_ A : 0|8@1+ (1,0) [0|0] \"\" X\n \
        SG_ A : 8|8@1+ (1,0) [0|0] \"\" X\n SG_ B m : 16|8@1+ (1,0) [0|0] \"\" X\n \
        SG_ C : 24|8@1+ (1,0) [0|0] \"\" X\nVAL_ 256 C 1 \"\" 2 \"on\" ;\n";
    let mut database = MessageDatabase::default();
    database.add(text.as_bytes()).unwrap();
    let words = |data: [u8; 4]| {
        let frame = Frame::new(CanId::standard(256).unwrap(), &data);
        database.message(&frame).unwrap().in_words(&data)
    };
    assert_eq!(words([7, 8, 9, 2]), "Msg: A 7, C on");
    assert_eq!(words([7, 8, 9, 1]), "Msg: A 7, C 1", "a name without letters");
}

#[test]
fn parameter_group_of_several_senders_is_that_of_the_sender() {
    let group = |name: &str, source: u32| format!("BO_ {} {name}: 8 X\n", 0x98F0_0400_u32 | source);
    let kinds = "BA_DEF_ BO_ \"VFrameFormat\" ENUM \"StandardCAN\",\"J1939PG\";\nBA_DEF_DEF_ \"VFrameFormat\" \"J1939PG\";\n";
    let (any, engine, brakes) = (group("Any", 0xFE), group("Engine", 0), group("Brakes", 0x0B));
    for text in
        [[&any, &engine, &brakes].map(String::as_str), [&brakes, &any, &engine].map(String::as_str)]
    {
        let mut database = MessageDatabase::default();
        database.add((text.concat() + kinds).as_bytes()).unwrap();
        for (id, name) in [
            (0x18F0_0400, "Engine"),
            (0x0CF0_0400, "Engine"),
            (0x0CF0_040B, "Brakes"),
            (0x18F0_0421, "Any"),
            (0x18F0_04FE, "Any"),
        ] {
            let frame = Frame::classic(id, &[]);
            assert_eq!(database.message(&frame).unwrap().name(), name, "{id:X}");
        }
    }
}

/// Vehicle speed from 0xFE, and torque control from 0xFE to 0.
const GROUPS: &str = "\
BO_ 2566844926 CCVS: 8 X
 SG_ Speed : 8|16@1+ (0.00390625,0) [0|250] \"km/h\" X
BO_ 2348810494 TSC1: 8 X
BO_ 2566844672 OfGateway: 8 X
";

#[test]
fn parameter_groups_have_any_sender_receiver_and_priority() {
    let words_of = "BA_DEF_ BO_ \"VFrameFormat\" ENUM \"StandardCAN\",\"ExtendedCAN\",\"reserved\",\"J1939PG\";\n";
    let other_words = "BA_DEF_ BO_ \"VFrameFormat\" ENUM \"J1939PG\", \"StandardCAN\";\n";
    let default = "BA_DEF_DEF_ \"VFrameFormat\" \"J1939PG\";\n";
    let value = |id: u32, value: &str| format!("BA_ \"VFrameFormat\" BO_ {id} {value};\n");
    let both = |it: &str| value(2_566_844_926, it) + &value(2_348_810_494, it);
    for text in [
        words_of.to_owned() + &both("3") + GROUPS,
        GROUPS.to_owned() + &both("3") + words_of,
        // Without a definition; with the word; in another order.
        both("3") + GROUPS,
        both("\"J1939PG\"") + GROUPS,
        other_words.to_owned() + &both("0") + GROUPS,
        words_of.to_owned() + default + &value(2_566_844_672, "1") + GROUPS,
    ] {
        let database = database(&text);
        let data = &[0, 0, 0x32, 0, 0, 0, 0, 0];
        for (id, expected) in [
            (0x98FE_F1FE, "CCVS: Speed 50.000 km/h"),
            (0x98FE_F117, "CCVS: Speed 50.000 km/h"),
            (0x8CFE_F121, "CCVS: Speed 50.000 km/h"),
            (0x8C00_0003, "TSC1"),
            (0x8C00_2117, "TSC1"),
            // The whole identifier of another message, another page, another group, 11 bits.
            (0x98FE_F100, "OfGateway"),
            (0x99FE_F117, ""),
            (0x9AFE_F117, ""),
            (0x98FE_F217, ""),
            (0x8C01_2117, ""),
            (0x0000_0117, ""),
        ] {
            assert_eq!(words(&database, id, data), expected, "{id:x} of {text}");
        }
    }
    for text in
        [GROUPS.to_owned(), both("1") + GROUPS, other_words.to_owned() + &both("3") + GROUPS]
    {
        assert_eq!(words(&database(&text), 0x8C00_0003, &[0; 8]), "", "{text}");
    }
}

#[test]
fn statements_of_groups_without_an_end_do_not_take_others() {
    let value = "BA_ \"VFrameFormat\" BO_ 2348810494 3;\n";
    for text in [
        "BA_DEF_ BO_ \"VFrameFormat\" ENUM \"StandardCAN\",\"ExtendedCAN\",\"reserved\",\"J1939PG\"\n",
        "BA_DEF_ BO_ \"VFrameFormat\"\n",
        "BA_DEF_ BO_\n",
        "BA_DEF_DEF_ \"VFrameFormat\"\n",
        "BA_ \"VFrameFormat\" BO_ 2348810494\n",
        "BA_ \"VFrameFormat\"\n",
    ] {
        let database = database(text.to_owned() + GROUPS + value);
        assert_eq!(words(&database, 0x8C00_2117, &[]), "TSC1", "{text}");
        assert_eq!(words(&database, 0x98FE_F1FE, &[]), "CCVS: Speed –", "{text}");
    }
}

#[test]
fn groups_are_those_of_the_messages_that_count() {
    let of_group = |words: &str| GROUPS.to_owned() + words;
    let group = of_group("BA_ \"VFrameFormat\" BO_ 2348810494 3;\n");
    // The first file has the identifier, and no group.
    let mut both = database("BO_ 2348810494 Other: 8 X\n");
    both.add(group.as_bytes()).unwrap();
    assert_eq!(words(&both, 0x8C00_00FE, &[]), "Other");
    assert_eq!(words(&both, 0x8C00_2117, &[]), "");
    // The words are defined without it, or the default is a number.
    let without = "BA_DEF_ BO_ \"VFrameFormat\" ENUM \"StandardCAN\",\"a\",\"b\",\"reserved\";\n";
    assert_eq!(words(&database(without.to_owned() + &group), 0x8C00_2117, &[]), "");
    let default = database(of_group("BA_DEF_DEF_ \"VFrameFormat\" 3;\n"));
    assert_eq!(words(&default, 0x8C00_2117, &[]), "TSC1");
}

#[test]
fn signals_after_the_64th_byte_are_left_out() {
    let text = "BO_ 2566844926 Long: 200 X
 SG_ A : 0|8@1+ (1,0) [0|0] \"\" X
 SG_ Text : 0|1600@1+ (1,0) [0|0] \"\" X
 SG_ B : 512|8@1+ (1,0) [0|0] \"\" X\n";
    assert_eq!(words(&database(text), 2_566_844_926, &[5; 8]), "Long: A 5");
}

#[test]
fn texts_of_a_file_are_printable() {
    let latin = database(LATIN);
    assert_eq!(words(&latin, 5, &[4]), "Latin: T 2.0 °C");
    assert_eq!(words(&latin, 5, &[3]), "Latin: T \\x1B[2J");
}

#[test]
fn first_of_several_files_counts() {
    let mut both = database(CAR);
    both.add(b"BO_ 256 Other: 8 X\nBO_ 257 More: 8 X\n").unwrap();
    assert!(words(&both, 0x100, &[0; 8]).starts_with("Engine: "));
    assert_eq!(words(&both, 0x101, &[]), "More");
}

// --- the program --------------------------------------------------------------------------

/// A device with a name and a heartbeat, a frame to it and from it, and frames of other protocols. Of the
/// last two, one has the identifier of a platform message between addresses without names.
const MIXED: &str = "\
(100.000000) can0 05140002#0601464545440000
(100.100000) can0 07140001#8A
(100.150000) can0 00002820#0102
(100.200000) can0 100#400D5A01FFF00000
(100.300000) can0 18FEF1FE#00E8030000000000
(100.400000) can0 00C02C20#0102
(100.500000) can0 100#R8
";

/// Names each identifier of [`MIXED`].
fn mixed_dbc() -> String {
    let mut text = CAR.to_owned();
    for id in [0x0514_0002_u32, 0x0714_0001, 0x0000_2820, 0x00C0_2C20] {
        write!(text, "BO_ {} Wrong{id:X}: 8 X\n SG_ A : 0|8@1+ (1,0) [0|0] \"\" X\n", id | 1 << 31)
            .unwrap();
    }
    text
}

fn log(arguments: &[&str]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("mixed.log"), MIXED).unwrap();
    fs::write(folder.path().join("mixed.dbc"), mixed_dbc()).unwrap();
    fs::write(
        folder.path().join("wrong.dbc"),
        "BO_ 1 A: 8 X\n SG_ B : 0|0@1+ (1,0) [0|0] \"\" X\n",
    )
    .unwrap();
    Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(["log", "mixed.log"])
        .args(arguments)
        .current_dir(folder.path())
        .env("XDG_CONFIG_HOME", folder.path().join("config"))
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

#[test]
fn log_names_messages_but_never_those_of_des() {
    let output = log(&["--dbc", "mixed.dbc", "--json"]);
    let out = String::from_utf8(output.stdout).unwrap();
    let frames: Vec<Value> = out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let names: Vec<_> = frames.iter().map(|frame| frame["message"].as_str()).collect();
    assert_eq!(names, [None, None, None, Some("Engine"), Some("Pedal"), Some("WrongC02C20"), None]);
    assert_eq!(
        frames[3]["signals"],
        serde_json::json!({"Speed": 848.0, "Temperature": 50, "Fan": "slow", "Torque": -0.5})
    );
    assert_eq!(frames[4]["signals"], serde_json::json!({"Mode": 0, "Position": 100.0}));
    assert_eq!(frames[4]["error"], false);
    assert!(frames[0]["signals"].is_null());
    let output = log(&["--dbc", "mixed.dbc", "--filter", "Position"]);
    let out = String::from_utf8(output.stdout).unwrap();
    assert_eq!(out.lines().count(), 1, "{out}");
    assert!(out.ends_with("Pedal: Mode 0, Position 100.0 %\n"), "{out}");
}

/// A bus of DES (heartbeats of a device at 10, whose name is not known) with two messages of another protocol
/// that differ in RND7 only.
fn log_of_two_protocols() -> String {
    let mut log = String::new();
    for at in 0_u32..40 {
        let (time, rnd7) = (at * 50, at * 37 % 128);
        let second = |millis: u32| format!("{}.{:03}000", 100 + millis / 1000, millis % 1000);
        writeln!(log, "({}) can0 07FE0010#{at:02X}", second(time)).unwrap();
        writeln!(log, "({}) can0 07FE1410#{at:02X}", second(time + 10)).unwrap();
        let (heartbeat, data) = (0x0714_0001 | rnd7 << 10, 0x0714_0110 | rnd7 << 10);
        writeln!(log, "({}) can0 {heartbeat:08X}#8A", second(time + 20)).unwrap();
        writeln!(log, "({}) can0 {data:08X}#{at:02X}", second(time + 30)).unwrap();
    }
    log
}

#[test]
fn messages_that_differ_in_rnd7_only_have_rows_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("one.log"), log_of_two_protocols()).unwrap();
    let ids = [0x07FE_0010_u32, 0x07FE_1410, 0x0714_0110];
    let message = |id: u32| format!("BO_ {} M{id:X}: 1 X\n", id | 1 << 31);
    fs::write(folder.path().join("two.dbc"), ids.map(message).concat()).unwrap();
    let rows = |arguments: &[&str]| {
        let (code, out, said) = log_one(folder.path(), arguments);
        assert_eq!((code, &*said), (Some(0), ""));
        let report: Value = serde_json::from_str(&out).unwrap();
        let rows = report["identifiers"].as_array().unwrap().iter();
        let mean = |row: &Value| row["period_ms"]["mean"].as_f64().unwrap();
        let cells = rows.map(|row| {
            (row["id"].as_str().unwrap().to_owned(), row["count"].as_u64().unwrap(), mean(row))
        });
        cells.collect::<Vec<_>>()
    };
    let row = |id: &str, count, mean| (id.to_owned(), count, mean);
    let of_device = [row("07140001", 40, 50.0), row("07140110", 40, 50.0)];
    assert_eq!(rows(&["--stats"])[..2], of_device, "without names no bits are fixed");
    assert_eq!(rows(&["--stats"]).len(), 3);
    let described = rows(&["--stats", "--dbc", "two.dbc"]);
    assert_eq!(described[..2], of_device, "the device takes part in DES: its data are not named");
    assert_eq!(described[2..], [row("07FE0010", 40, 50.0), row("07FE1410", 40, 50.0)]);
    // Times since the frame before are those of the identifier, and a filter is of one alone.
    let count = |filter: &str| {
        let (_, out, _) = log_one(folder.path(), &["--dbc", "two.dbc", "--filter", filter]);
        out.lines().count()
    };
    assert_eq!((count("id:07FE0010"), count("id:07FE0010 dt:50ms..50ms")), (40, 39));
    assert_eq!(count("M7140110"), 0);
}

/// Runs `log one.log --json` in a folder; returns the exit code, the output and the errors.
fn log_one(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    let command = command.args(["log", "one.log", "--json"]).args(arguments);
    let command = command.current_dir(folder).env("XDG_CONFIG_HOME", folder);
    let output = command.stdin(Stdio::null()).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// They are numbers of 32 bits, too, which have fewer digits.
#[test]
fn doubles_keep_their_digits_in_json() {
    let folder = tempfile::tempdir().unwrap();
    let double = "BO_ 5 M: 8 A\n SG_ D : 0|64@1- (1,0) [0|0] \"\" A\nSIG_VALTYPE_ 5 D : 2;\n";
    fs::write(folder.path().join("double.dbc"), double).unwrap();
    for number in
        [4_294_967_296.0_f64, 2_147_483_648.0, 123_456_792.0, 0.0625, 0.1 + 0.2, 1.0 / 3.0]
    {
        let data = hex(&number.to_le_bytes(), "");
        fs::write(folder.path().join("one.log"), format!("(1.000000) can0 005#{data}\n")).unwrap();
        let (_, out, said) = log_one(folder.path(), &["--dbc", "double.dbc"]);
        let json: Value = serde_json::from_str(&out).expect(&said);
        assert_eq!(json["signals"]["D"], serde_json::json!(number));
    }
}

#[test]
fn files_that_are_too_large_together_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let padding = format!("BO_ 5 M: 8 A\nCM_ \"{}\";\n", " ".repeat(9 << 20));
    fs::write(folder.path().join("large.dbc"), padding).unwrap();
    fs::write(folder.path().join("one.log"), "(100.000000) can0 005#01\n").unwrap();
    let (code, out, said) = log_one(folder.path(), &["--dbc", "large.dbc"]);
    assert_eq!(code, Some(0), "{said}");
    assert!(out.contains("\"message\":\"M\",\"signals\":{}"), "no signals are no fault: {out}");
    let (code, _, said) = log_one(folder.path(), &["--dbc", "large.dbc", "--dbc", "large.dbc"]);
    assert_eq!(code, Some(3));
    assert!(said.contains("the DBC files have over 16 MiB together"), "{said}");
}

#[test]
fn file_that_cannot_be_read_is_named_with_the_way_out() {
    for (file, cause) in [
        (
            "wrong.dbc",
            "wrong.dbc: line 2: B: the number of bits is 1 to 14280; correct it, or leave --dbc out",
        ),
        ("missing.dbc", "missing.dbc: not found; check the name"),
        (".", "is a folder; name a file in it"),
    ] {
        let output = log(&["--dbc", "mixed.dbc", "--dbc", file]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(3), "{said}");
        assert!(said.contains(cause), "{said}");
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn screen_shows_message_and_signals_of_a_frame() {
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    let options = AppOptions {
        buses: vec![("can0".to_owned(), Config::default())],
        messages: Arc::new(database(CAR)),
        ..AppOptions::default()
    };
    let now = stage.app.now();
    stage.app = App::new(now, options);
    let end = now + Duration::from_secs(1);
    let frame = Frame::new(CanId::Standard(0x100), b"\x40\x0D\x5A\x01\xFF\xF0\0\0").with_time(end);
    stage.size(140, 40);
    stage.app.handle_frames(end, &[frame]);
    stage.app.handle_timeout(end);
    let screen = stage.keys("2").screen();
    let row = screen.lines().find(|line| line.contains("Speed 848.00 rpm")).unwrap();
    assert!(row.contains("std  Engine "), "{screen}");
    let screen = stage.keys("Enter").screen();
    for line in ["message   Engine", "signals   Speed 848.00 rpm", "Torque -0.5 Nm"] {
        let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words(&screen).contains(&words(line)), "{line}\n{screen}");
    }
}

// --- cantools -----------------------------------------------------------------------------

/// Decodes lines of an identifier and data; prints numbers, and the names of values.
const DECODER: &str = r#"
import json, sys
import cantools
base = cantools.database.load_file(sys.argv[1])
for line in sys.stdin:
    id, data = line.split(":")
    data = bytes.fromhex(data)
    message = base.get_message_by_frame_id(int(id, 16))
    numbers = message.decode(data, decode_choices=False)
    named = {key: str(value) for key, value in message.decode(data).items()}
    print(json.dumps({"message": message.name, "numbers": numbers, "named": named}), flush=True)
"#;

/// Returns a file of random messages, and their identifiers with the number of their bytes.
fn random_file(rng: &mut Rng) -> (String, Vec<(u32, usize)>) {
    let (mut text, mut end) =
        ("VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: X\n\n".to_owned(), String::new());
    let mut messages = Vec::new();
    for number in 0..60_u32 {
        let id = if rng.bool() { 1 << 31 | rng.u32(..1 << 24) << 5 | number } else { number * 8 };
        let len = *rng.choice(&[1, 2, 4, 8, 8, 8, 12, 64]).unwrap();
        writeln!(text, "BO_ {id} Message{number}: {len} X").unwrap();
        messages.push((id, len));
        // cantools takes only known values of a multiplexor: each of its four has a signal.
        let is_multiplexed = len >= 8 && rng.bool();
        if is_multiplexed {
            text += " SG_ Switch M : 0|2@1+ (1,0) [0|0] \"\" X\n";
        }
        // Each signal has a part of the data for itself: cantools takes no overlaps.
        let parts = if is_multiplexed { 4 } else { rng.usize(1..=4.min(len)) };
        let mut free = if is_multiplexed { 8 } else { 0 };
        for part in 0..parts {
            // Whole bytes: the bits of a byte are numbered otherwise in big-endian order.
            let room = (len - free / 8) / (parts - part) * 8;
            if room == 0 {
                break;
            }
            let size = rng.usize(1..=room.min(64));
            let (mut size, is_float) =
                if size >= 32 && rng.bool() { (32, true) } else { (size, false) };
            let is_little = rng.bool();
            let start = free + rng.usize(0..=room - size);
            // In big-endian order the number begins with the highest bit of its first byte.
            let (start, order) =
                if is_little { (start, 1) } else { (start / 8 * 8 + 7 - start % 8, 0) };
            let is_signed = rng.bool() || is_float;
            let factor = *rng.choice(&["1", "0.5", "0.01", "-2", "3"]).unwrap();
            let offset = *rng.choice(&["0", "-40", "0.25", "1000"]).unwrap();
            let switch = if is_multiplexed { format!(" m{part}") } else { String::new() };
            let sign = if is_signed { '-' } else { '+' };
            if is_float {
                writeln!(end, "SIG_VALTYPE_ {id} Signal{part} : 1;").unwrap();
            } else if size <= 8 && rng.bool() {
                writeln!(end, "VAL_ {id} Signal{part} 0 \"zero\" 1 \"one\" ;").unwrap();
            }
            size = size.max(1);
            writeln!(
                text,
                " SG_ Signal{part}{switch} : {start}|{size}@{order}{sign} ({factor},{offset}) [0|0] \"\" X"
            )
            .unwrap();
            free += room;
        }
        text.push('\n');
    }
    (text + &end, messages)
}

#[test]
fn random_messages_are_decoded_as_cantools_does() {
    let Some(python) = Python::with(&["cantools==40.2.1"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("random.dbc");
    let mut compared = 0;
    for seed in 1..=3 {
        let rng = &mut Rng::with_seed(seed);
        let (text, messages) = random_file(rng);
        fs::write(&file, &text).unwrap();
        let own = database(&text);
        let mut peer = python.start(DECODER, &[file.to_str().unwrap()]);
        for (id, len) in messages.repeat(5) {
            let mut data: Vec<u8> = std::iter::repeat_with(|| rng.u8(..)).take(len).collect();
            if rng.bool() {
                data.fill(rng.u8(..2));
            }
            let can_id = if id >> 31 == 1 {
                CanId::Extended(id & CanId::MAX_EXTENDED)
            } else {
                CanId::Standard(id as u16)
            };
            let message = own.message(&Frame::new(can_id, &[])).unwrap();
            peer.write_line(&format!("{:X}:{}", id & CanId::MAX_EXTENDED, hex(&data, "")));
            let theirs: Value = serde_json::from_str(
                &peer
                    .read_line()
                    .replace("NaN", "null")
                    .replace("Infinity", "null")
                    .replace("-null", "null"),
            )
            .unwrap();
            assert_eq!(theirs["message"], message.name());
            let values = message.values(&data);
            assert_eq!(
                theirs["numbers"].as_object().unwrap().len(),
                values.len(),
                "{text}\n{theirs}"
            );
            for field in values {
                let value = field.value.unwrap();
                let number = &theirs["numbers"][field.name];
                let same = match value {
                    DataValue::Named(name) => theirs["named"][field.name] == name,
                    DataValue::Integer(own) => {
                        let signed = number.as_i64().map(i128::from);
                        let whole = signed.or(number.as_u64().map(i128::from));
                        // What is above 64 bits, and a number with ".0", is one of floating point here.
                        whole.map_or(number.as_f64() == Some(own as f64), |number| number == own)
                    }
                    DataValue::Decimal(..) | DataValue::Float(..) => {
                        let own: f64 = value.to_string().parse().unwrap();
                        let number = number.as_f64();
                        // One of 32 bits is shown with as few digits as it needs.
                        let is_float = matches!(value, DataValue::Float(..));
                        let within = if is_float { 6e-8 } else { 1e-9 };
                        let near =
                            |number: f64| (number - own).abs() <= number.abs() * within + within;
                        number.map_or(!own.is_finite(), near)
                    }
                    _ => false,
                };
                assert!(
                    same,
                    "{}: {value} is not {number} ({}):\n{text}",
                    field.name,
                    hex(&data, " ")
                );
                compared += 1;
            }
        }
    }
    assert!(compared > 500, "{compared}");
}
