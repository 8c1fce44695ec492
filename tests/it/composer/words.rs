//! Compositions in words: the frames that they make, round trips, mistakes.

use descan::composer::{
    Composition, CompositionField, KnownNode, MAX_REPEATS, MessageKind, Receivers, Repeat,
    Surroundings,
};
use descan::frame::{CanId, Frame};
use descan::wire::framing::Framing;
use descan::wire::id::{Address, Header};
use descan::wire::profile::Profile;
use proptest::prelude::*;

const PROFILE: &str = "[descriptor]\naddr = 0x016\n[commands]\nmode = 0x019\nreboot = 0x01A\n\
    [writes]\naddress = 0x016\n[service_names]\n0x155 = \"AUGER\"\n[debug_names]\n0x005 = \"LOG\"\n";

fn address(number: u8) -> Address {
    Address::new(number).unwrap()
}

fn node(name: &str, number: u8) -> KnownNode {
    KnownNode {
        address: address(number),
        name: Some(name.to_owned()),
        uid: None,
        is_working: true,
        framing: None,
        boards: 1,
    }
}

fn nodes() -> Vec<KnownNode> {
    let feed = KnownNode { uid: Some("BOILER01".to_owned()), ..node("FEED", 10) };
    let raw = KnownNode { framing: Some(Framing::Raw), is_working: false, ..node("DIN raw", 30) };
    let act = KnownNode { boards: 2, ..node("ACT", 14) };
    vec![feed, node("SENS", 12), node("SENS", 13), act, raw]
}

fn with_bus<T>(run: impl FnOnce(Surroundings<'_>) -> T) -> T {
    let (profile, nodes) = (Profile::parse(PROFILE).unwrap(), nodes());
    run(Surroundings { profile: &profile, own: Some(address(0)), nodes: &nodes, rnd7: 0x55 })
}

fn frames(words: &str) -> Result<Vec<String>, String> {
    let composition = Composition::parse(words).map_err(|it| it.to_string())?;
    let composed = with_bus(|around| composition.compose(around)).map_err(|it| it.to_string())?;
    Ok(composed.frames.iter().map(ToString::to_string).collect())
}

#[test]
fn words_make_the_frames_of_the_protocol() {
    let cases: [(&str, &[&str]); 27] = [
        // The identifiers of the vectors, with the requests of DES in both framings.
        ("request des name to all working", &["02015402#0444455301"]),
        ("request des name to all working raw", &["02015402#44455301"]),
        ("request des services to all not-working rnd 42", &["0A00A802#0444455302"]),
        ("request des name to all", &["02015402#0444455301", "0A015402#0444455301"]),
        ("request des name to FEED", &["00002802#0444455301"]),
        ("request des services to BOILER01", &["00002802#0444455302"]),
        ("REQUEST DES SERVICES TO @12", &["00003002#0444455302"]),
        ("request des name to \"DIN raw\"", &["08007802#44455301"]),
        ("request des name to \"DIN raw\" isotp", &["08007802#0444455301"]),
        ("request des name to \"DIN raw\" working", &["00007802#44455301"]),
        ("request des name to 0x14 not-working", &["08005002#0444455301"]),
        ("request 2 44 45 53 01 to 12 isotp", &["00003002#0444455301"]),
        ("request des \"DES\" 01 to 12", &["00003002#0444455301"]),
        ("request 0x123 01 02 to FEED", &["00002923#0102"]),
        ("request 0x123 0102 0x0304 to FEED from 14", &["001C2923#01020304"]),
        ("request auger to FEED", &["00002955#"]),
        ("request mode idle to FEED", &["00002819#06"]),
        ("request 0x123 01 to FEED isotp", &["00002923#0101"]),
        ("response 0x123 data 01 to 5", &["05001523#01"]),
        ("response 0x123 to 5 data 01 error", &["04001523#01"]),
        ("response des \"\u{1}FEED\" 00 to 0 from 12", &["05180002#06014645454400"]),
        ("response des 01 41 00 to 0 from 99 not-working", &["15C60002#03014100"]),
        ("unsolicited 0x001 from 127 rnd 3", &[]),
        ("debug 0x005 01 02", &["1F01FC05#0102"]),
        ("debug log", &["1F01FC05#"]),
        ("051C0002#0444455301", &["051C0002#0444455301"]),
        ("raw 123##1AABB", &["123##1AABB"]),
    ];
    for (words, expected) in cases {
        let made = frames(words);
        if expected.is_empty() {
            assert!(made.is_err(), "{words}: {made:?}");
        } else {
            assert_eq!(made.as_deref(), Ok(&expected.map_strings()[..]), "{words}");
        }
    }
    assert_eq!(frames("unsolicited 0x001 04 to rnd 3").unwrap(), ["07000C01#04"]);
    assert_eq!(
        frames("request 0x123 00 11 22 33 44 55 66 77 88 to 12 canfd").unwrap(),
        ["00003123##1001122334455667788CCCCCC"]
    );
}

trait MapStrings {
    fn map_strings(&self) -> Vec<String>;
}

impl MapStrings for &[&str] {
    fn map_strings(&self) -> Vec<String> {
        self.iter().map(|it| (*it).to_owned()).collect()
    }
}

#[test]
fn mistakes_name_the_word_and_what_would_be_right() {
    let cases = [
        ("", "what is to be sent? For example request des name to FEED"),
        (
            "requst des name",
            "requst is not a kind of frame: request, response, unsolicited, debug, raw, or a frame as 051C0002#0102; did you mean request?",
        ),
        ("request", "after request the service is needed: des or 0x123"),
        ("debug", "after debug the code is needed: 0x005"),
        ("request to FEED", "after request the service is needed: des or 0x123"),
        (
            "request dse name to FEED",
            "dse is not a service: a number as 0x123, or a name; did you mean des?",
        ),
        ("request 0x400 to 12", "0x400 is too large: 0x000 to 0x3FF"),
        (
            "request des nmae to FEED",
            "nmae is not data: bytes as 01 FF, \"text\", name, services; did you mean name?",
        ),
        ("request des name", "a receiver is needed: a name, UID or address"),
        (
            "request des name to FEAD",
            "FEAD was not found; there are FEED @10, SENS @12, SENS @13, ACT @14, DIN raw @30; did you mean FEED?",
        ),
        (
            "request des name to SENS",
            "several devices are SENS, at 12 and at 13: give the address of one, as @12",
        ),
        ("request des name to 128", "128 is not an address: 0 to 127"),
        ("request des name to @x", "@x is not an address: @0 to @127"),
        (
            "request des name to FEED wroking",
            "wroking is not understood after the receiver: working or not-working; data there begins with data; did you mean working?",
        ),
        (
            "request des name to FEED 01",
            "01 is not understood after the receiver: working or not-working; data there begins with data",
        ),
        (
            "response 0x123 01 to FEED not-working",
            "a response has D = 0 whatever the receiver is: not-working is for requests",
        ),
        ("request des name to FEED working not-working", "one of working and not-working, once"),
        (
            "request des name to not-working",
            "not-working needs a receiver: FEED not-working, or all not-working",
        ),
        ("request des name to FEED rnd 5", "rnd is the DST of a broadcast: to all rnd 85"),
        (
            "request des name to all rnd 5 rnd 6",
            "rnd is not understood after the receiver: working, not-working or rnd; data there begins with data; did you mean rnd?",
        ),
        ("response 0x123 to 5 from working not-working", "one of working and not-working, once"),
        ("request des name to FEED isotp raw", "one of isotp and raw, not both"),
        ("request des name to all rnd 128", "rnd needs a number, 0 to 127"),
        ("request 0x123 1 to 12", "1: a byte has two digits, as 01"),
        ("request 0x123 0G to 12", "0G is not data: bytes as 01 FF, \"text\""),
        ("request 0x123 \"no end to 12", "a quote has no end: \"text\""),
        (
            "request 0x123 00 11 22 33 44 55 66 77 88 to 12",
            "9 bytes: a frame holds 8; with canfd 64",
        ),
        (
            "request des 00 11 22 33 44 55 66 77 to 12",
            "8 bytes: one ISO-TP frame holds 7; transfers of several frames are not sent",
        ),
        ("request des to 12", "no data: ISO-TP needs at least one byte"),
        ("request 0x123 to 12 from x", "x is not a sender: an address 0 to 127, not-working"),
        (
            "request 0x123 to 12 from 14 not-working",
            "a request is sent by a working node: not-working is for responses and unsolicited data",
        ),
        ("request 0x123 to 12 error", "request has no error: a response reports an error"),
        ("response 0x123 to all", "a response goes to one node: a name, UID or address"),
        ("unsolicited 0x123 to FEED", "unsolicited data goes to all: leave it empty, or rnd 85"),
        ("debug 5 to FEED", "debug has no to: it goes to all"),
        ("debug nope", "nope is not a code: a number as 0x123, or a name"),
        ("12#R", "12#R: the identifier is not 3 or 8 hexadecimal digits in range"),
        ("123#R", "a remote frame: the platform has none, it is not sent"),
        ("20000004#00", "an error frame is a report of a controller: it is not sent"),
        ("051C0002#123", "051C0002#123: the data is not whole hexadecimal bytes"),
        ("051C0002#01 to FEED", "a raw frame is one word, identifier and data: 051C0002#0102"),
        ("raw", "after raw the frame is needed: 051C0002#0102"),
    ];
    for (words, text) in cases {
        assert_eq!(frames(words), Err(text.to_owned()), "{words}");
    }
}

#[test]
fn words_of_a_receiver_and_a_sender_stand_in_any_order() {
    for (one, other) in [
        ("request des name to not-working 12", "request des name to 12 not-working"),
        ("request des name to working all", "request des name to all working"),
        ("request des name to rnd 3 not-working all", "request des name to all not-working rnd 3"),
        ("response 0x123 to 5 from not-working 14", "response 0x123 to 5 from 14 not-working"),
        ("response 0x123 to working 5", "response 0x123 to 5"),
        ("request 0x123 isotp to 12 data 01", "request 0x123 01 to 12 isotp"),
    ] {
        let made = frames(one);
        assert!(made.is_ok(), "{one}: {made:?}");
        assert_eq!(made, frames(other), "{one}");
    }
    let good = Composition::parse("response 0x123 to FEED not-working").unwrap();
    let wrong = with_bus(|around| good.compose(around)).unwrap_err();
    assert_eq!((wrong.field, wrong.column), (CompositionField::To, 5));
}

#[test]
fn name_with_a_backslash_is_typed_as_it_is_printed_or_is() {
    let profile = Profile::default();
    // As descan prints them.
    let nodes = [node("A\\\\B", 20), node("C \\\\D", 21), node("E \\x1BF", 22), node("\"Q\"", 23)];
    let around = Surroundings { profile: &profile, own: None, nodes: &nodes, rnd7: 0 };
    for (typed, at) in [
        (r"A\\B", 20),
        (r"A\B", 20),
        (r#""A\\B""#, 20),
        (r#""A\\\\B""#, 20),
        (r#""C \\D""#, 21),
        (r#""C \D""#, 21),
        (r#""E \x1BF""#, 22),
        (r#""\"Q\"""#, 23),
    ] {
        let composition = Composition::parse(&format!("request 0x123 to {typed}")).unwrap();
        let composed = composition.compose(around).unwrap();
        assert_eq!(composed.receivers, Receivers::One(address(at)), "{typed}");
    }
}

#[test]
fn mistake_has_its_field_and_column() {
    let of = |composition: Composition| with_bus(|around| composition.compose(around)).unwrap_err();
    let good = Composition::parse("request des name to FEED").unwrap();
    let wrong = of(Composition { to: "FEED  wroking".into(), ..good.clone() });
    assert_eq!((wrong.field, wrong.column), (CompositionField::To, 6));
    let wrong = of(Composition { data: "44 4 ".into(), ..good.clone() });
    assert_eq!((wrong.field, wrong.column), (CompositionField::Data, 3));
    let wrong = of(Composition { to: "NOPE".into(), ..good });
    assert!(wrong.is_of_bus, "the device may come");
    assert_eq!(Composition::parse("request des to").unwrap().to, "");
    assert_eq!(Composition::parse(" requst").unwrap_err().column, 1);
}

#[test]
fn meaning_and_warnings_say_what_will_be_sent() {
    let composed = |words: &str| {
        with_bus(|around| Composition::parse(words).unwrap().compose(around).unwrap())
    };
    let name = composed("request des name to ACT");
    assert_eq!(
        name.meaning,
        "REQ_CC_TGT from own address 0 to ACT @14, service 0x002 (des), name request, isotp"
    );
    assert_eq!(name.warnings, ["two boards have address 14: all of them will answer"]);
    assert!(name.needs_answer() && name.foreign_source.is_none() && name.change.is_none());
    assert_eq!(name.receivers, Receivers::One(address(14)));
    let other = composed("request 0x155 01 to FEED from 14");
    assert_eq!(other.foreign_source, Some(address(14)));
    assert!(other.meaning.contains("from @14 to FEED @10, service 0x155 (AUGER), data 01"));
    let cases = [
        (
            "request mode idle to FEED",
            Some("sets the mode to IDLE, which may end only by switching the power off and on"),
        ),
        ("request restart to FEED", Some("restarts it")),
        (
            "request address 0C to FEED",
            Some("sets its address to fixed 12, where it stays mute if that is used"),
        ),
        ("request addr to FEED", None),
        (
            "request identify to FEED",
            Some("makes it blink or beep (if the assumed number is right)"),
        ),
        (
            "request bspd 81 to FEED",
            Some(
                "sets its bit rate to preferred 250 kbit/s, and may leave this bus (if the assumed \
                 number is right)",
            ),
        ),
        (
            "request 0x01F 01 to FEED",
            Some("may change its configuration (service 0x01F) (if the assumed number is right)"),
        ),
        ("request 0x123 01 to FEED", None),
    ];
    for (words, change) in cases {
        assert_eq!(composed(words).change.as_deref(), change, "{words}");
    }
    let warned = [
        ("request des name to 99", "no device is known at 99"),
        ("request des name to 0", "0 is descan's own address: no device is there"),
        (
            "request des name to FEED not-working",
            "FEED @10 works: it may ignore a request to not working nodes",
        ),
        (
            "request des \"DES\" 07 to FEED",
            "type 07 of DES is reserved: a device need not answer, or with an error",
        ),
        ("request des name to all", "devices that read another framing than isotp do not answer"),
        ("unsolicited heartbeat 00", "nodes read it as a heartbeat of 0 (number assumed)"),
        (
            "10000002#",
            "non-conforming: its flags are those of no message type; descan and devices may not read it",
        ),
        (
            "1F000005#",
            "non-conforming: a debug message has DST 127; descan and devices may not read it",
        ),
        ("123#00", "not of the platform: it has 29-bit identifiers only"),
    ];
    for (words, warning) in warned {
        assert_eq!(composed(words).warnings, [warning], "{words}");
    }
    assert_eq!(composed("123#00").foreign_source, None);
}

#[test]
fn repeat_is_bounded() {
    assert!(Repeat::new(MAX_REPEATS, 0).is_ok());
    assert_eq!(Repeat::parse("", " "), Ok(Repeat::default()));
    assert_eq!(Repeat::parse("1001", "1").unwrap_err(), "repeat is 1 to 1000, not 1001");
    assert_eq!(Repeat::parse("0", "1").unwrap_err(), "repeat is 1 to 1000, not 0");
    assert_eq!(Repeat::parse("1", "60001").unwrap_err(), "every is 0 to 60000 ms, not 60001");
    assert_eq!(Repeat::parse("x", "1").unwrap_err(), "repeat is a number");
}

#[test]
fn arguments_of_a_command_line_are_joined_to_words() {
    let join = |all: &[&str]| {
        Composition::join_arguments(&all.iter().map(|it| (*it).to_owned()).collect::<Vec<_>>())
    };
    assert_eq!(
        join(&["request", "des", "name", "to", "DIN raw"]),
        "request des name to \"DIN raw\""
    );
    assert_eq!(join(&["request des name to FEED"]), "request des name to FEED");
    assert_eq!(
        join(&["request", "des", "name", "to", "all working"]),
        "request des name to all working"
    );
}

fn any_words() -> impl Strategy<Value = String> {
    let word = prop_oneof![
        prop::sample::select(vec![
            "request",
            "response",
            "unsolicited",
            "debug",
            "raw",
            "des",
            "mode",
            "0x123",
            "name",
            "services",
            "to",
            "from",
            "data",
            "all",
            "working",
            "not-working",
            "rnd",
            "12",
            "@14",
            "FEED",
            "isotp",
            "canfd",
            "error",
            "01",
            "FF",
            "0x0102",
            "\"",
            "\"a b\"",
            "\\",
            "idle",
            "051C0002#01",
            "123##1",
            "\u{1b}[2J",
            "\u{202e}",
            "ACT",
            "999999999999",
            "-1",
            "+1",
        ])
        .prop_map(str::to_owned),
        "\\PC{0,6}",
    ];
    prop::collection::vec(word, 0..9).prop_map(|words| words.join(" "))
}

fn any_frame() -> impl Strategy<Value = Frame> {
    let des = prop::bool::ANY
        .prop_map(|is_name| if is_name { b"\x04DES\x01".to_vec() } else { b"DES\x02".to_vec() });
    let data = prop_oneof![4 => prop::collection::vec(any::<u8>(), 0..=8), 1 => des];
    let id = prop_oneof![0..=CanId::MAX_EXTENDED, (0..1_u32 << 19).prop_map(|it| it << 10 | 2)];
    (id, data, prop::bool::ANY).prop_map(|(id, data, is_fd)| {
        if is_fd { Frame::fd(id, &data, 0xCC) } else { Frame::classic(id, &data) }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn any_words_never_panic_and_round_trip(words in any_words()) {
        let Ok(composition) = Composition::parse(&words) else { return Ok(()) };
        let again = Composition::parse(&composition.to_words());
        prop_assert_eq!(again.as_ref(), Ok(&composition), "{}", composition.to_words());
        with_bus(|around| {
            match composition.compose(around) {
                Ok(composed) => {
                    prop_assert!(!composed.frames.is_empty() && composed.frames.len() <= 2);
                    prop_assert!(!composed.meaning.chars().any(char::is_control));
                }
                Err(mistake) => prop_assert!(!mistake.text.chars().any(char::is_control)),
            }
            Ok(())
        })?;
    }

    #[test]
    fn any_text_in_the_fields_never_panics(text in "\\PC{0,20}", which in 0..4) {
        let mut composition = Composition { kind: MessageKind::Request, ..Composition::default() };
        composition.service = "des".into();
        match which {
            0 => composition.to = text,
            1 => composition.service = text,
            2 => composition.data = text,
            _ => composition.from = text,
        }
        with_bus(|around| { let _ = composition.compose(around); });
    }

    #[test]
    fn frame_fills_fields_that_make_it_again(frame in any_frame()) {
        with_bus(|around| {
            let composition = Composition::of_frame(&frame, around).unwrap();
            let composed = composition.compose(around).unwrap();
            prop_assert_eq!(&composed.frames, &[frame], "{}", composition.to_words());
            let header = Header::decode(frame.platform_id().unwrap());
            // Requests with ERR = 1 are not those of this profile.
            let by_fields = header.is_conforming() && (header.response || !header.no_error);
            if by_fields && !frame.is_fd {
                prop_assert!(composition.kind != MessageKind::Raw, "{}", composition.to_words());
            }
            let again = Composition::parse(&composition.to_words()).unwrap();
            prop_assert_eq!(again, composition);
            Ok(())
        })?;
    }
}
