//! DBC files: an input is a file. Frames of its messages are decoded.

use super::{Target, assert_line, assert_printable};
use descan::dbc::MessageDatabase;
use descan::frame::{CanId, Frame};

/// Target `dbc`.
pub const DBC: Target = Target {
    name: "dbc",
    check,
    words: &[
        b"BO_ 256 Engine: 8 ECM\n",
        b" SG_ Speed : 0|16@1+ (0.25,0) [0|16000] \"rpm\" TCM\n",
        b" SG_ A M : 7|64@0- (1,-40) [0|0] \"\" X\n",
        b" SG_ B m1 : 500|12@1+ (1e300,1e-300) [0|0] \"%\" X\n",
        b" SG_ C m0M : 0|32@1- (1,0) [0|0] \"\" X\n",
        b"VAL_ 256 Speed 0 \"off\" -1 \"on\" ;\n",
        b"SIG_VALTYPE_ 256 C : 1;\n",
        b"SG_MUL_VAL_ 256 B A 0-3, 5-5;\n",
        b"SG_MUL_VAL_ 256 A B 0-18446744073709551615;\n",
        b"NS_ :\n\tCM_\n",
        b"2147483904",
        b"99999999999999999999",
        b"\"",
        b"\\\"",
        b"\xB0\x1B[2J",
        b"nan",
    ],
};

fn check(input: &[u8]) {
    let mut database = MessageDatabase::default();
    if let Err(error) = database.add(input) {
        assert_printable(&error.to_string());
        let mut text = String::from_utf8_lossy(input).into_owned();
        if !text.contains('\n') {
            text = text.replace('\r', "\n");
        }
        assert_line(&text, error.line);
        assert!(database.is_empty(), "a file with a mistake adds nothing");
        return;
    }
    let ids = (0..0x800).map(CanId::Standard).chain((0..0x800).map(CanId::Extended));
    for id in ids {
        let frame = |data: &[u8]| Frame::new(id, data);
        let Some(message) = database.message(&frame(&[])) else { continue };
        assert_printable(message.name());
        for data in
            [&[][..], &[0; 8], &[1; 8], &[0xFF; 8], &[0x5A; 64], &input[..input.len().min(64)]]
        {
            let words = message.in_words(data);
            assert_printable(&words);
            assert!(words.starts_with(message.name()));
            for field in message.values(data) {
                assert!(words.contains(field.name));
                assert_printable(&field.to_string());
            }
        }
    }
}
