//! The dissector in tshark: each field is that of descan, on a simulated bus and on random frames.

use super::{descan, export};
use descan::frame::{BusIndex, CanId, Frame};
use descan::log::LogReader;
use descan::log::pcapng::{write_frame, write_interface, write_section};
use descan::time::{Duration, Instant};
use descan::wire::des::ServicesResponse;
use descan::wire::id::{Address, Header, Service};
use serde_json::Value;
use std::fmt::Write as _;
use std::io::BufReader;
use std::path::Path;
use std::process::Command;

const START: u64 = 1_436_509_052_249_713;

/// The dissector's fields that are compared, in this order.
const FIELDS: [&str; 16] = [
    "can.id",
    "candes.type",
    "candes.u",
    "candes.d",
    "candes.r",
    "candes.b",
    "candes.err",
    "candes.src",
    "candes.dst",
    "candes.srv",
    "candes.service",
    "candes.text",
    "candes.isotp.message",
    "candes.service_version",
    "candes.field",
    "candes.field_number",
];

/// What tshark shows of each frame; `None` if tshark is missing and may be.
fn tshark(folder: &Path, file: &str) -> Option<Vec<Vec<String>>> {
    let fields = FIELDS.iter().flat_map(|field| ["-e", field]);
    let output = Command::new("tshark")
        .args(["-n", "-X", "lua_script:candes.lua", "-r", file, "-T", "fields"])
        .args(["-E", "separator=/t", "-E", "occurrence=a", "-E", "aggregator=|"])
        .args(fields)
        .current_dir(folder)
        .env("HOME", folder)
        .output();
    match output {
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success() && !said.contains("Lua"), "{said}");
            let text = String::from_utf8(output.stdout).unwrap();
            let row = |line: &str| line.split('\t').map(str::to_owned).collect();
            Some(text.lines().map(row).collect())
        }
        Err(missing) => {
            assert!(std::env::var_os("CI").is_none(), "tshark: {missing}");
            eprintln!("skipped: tshark: {missing}");
            None
        }
    }
}

fn write(path: &Path, frames: &[Frame]) {
    let mut file = Vec::new();
    write_section(&mut file).unwrap();
    write_interface(&mut file, "can0").unwrap();
    for frame in frames {
        write_frame(&mut file, 0, START + frame.time.as_micros(), frame).unwrap();
    }
    std::fs::write(path, file).unwrap();
}

/// Compares what tshark and descan show of each frame of a file.
fn compare(folder: &Path, file: &str, options: &[&str]) -> Option<Vec<Vec<String>>> {
    std::fs::write(
        folder.join("candes.lua"),
        export(folder, &[&["--wireshark"], options].concat()),
    )
    .unwrap();
    let shown = tshark(folder, file)?;
    let (told, said, code) = descan(folder, &[&["log", file, "--json"], options].concat());
    assert_eq!(code, Some(0), "{said}");
    let told: Vec<Value> = told.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(shown.len(), told.len());
    for (at, (row, frame)) in shown.iter().zip(&told).enumerate() {
        let about = format!("{file}, frame {}: {row:?}\n{frame}", at + 1);
        let is_extended = frame["extended"] == true && frame["kind"] != "rtr";
        if !is_extended {
            assert_eq!(row[1], "", "{about}");
            continue;
        }
        let id = u32::from_str_radix(frame["id"].as_str().unwrap(), 16).unwrap();
        let header = Header::decode(id);
        let flag = |is_set: bool| if is_set { "1" } else { "0" }.to_owned();
        let expected = [
            id.to_string(),
            header.message_type().name().to_owned(),
            flag(header.from_non_working),
            flag(header.to_non_working),
            flag(header.response),
            flag(header.broadcast),
            flag(header.no_error),
            header.source.to_string(),
            header.destination.to_string(),
            format!("0x{:04x}", header.service.number()),
        ];
        assert_eq!(row[..expected.len()], expected, "{about}");
        assert_eq!(row[10], frame["service_name"].as_str().unwrap_or(""), "{about}");
        assert_eq!(row[11], frame["text"].as_str().unwrap_or(""), "{about}");
    }
    Some(shown)
}

#[test]
fn recorded_bus_is_dissected_as_descan_shows_it() {
    let folder = tempfile::tempdir().unwrap();
    let record = ["watch", "sim:boiler", "--time", "6", "--record", "boiler.pcapng"];
    assert_eq!(descan(folder.path(), &record).2, Some(0));
    let Some(shown) = compare(folder.path(), "boiler.pcapng", &[]) else { return };
    // The whole list, at its last frame.
    let versions: Vec<&str> = shown.iter().map(|row| row[13].as_str()).collect();
    assert!(versions.contains(&"1.0|1.3|2.1|1.4|1.0"), "{versions:?}");
}

/// Bytes that are like DES messages, heartbeats and ISO-TP frames, and unlike them.
fn data(rng: &mut fastrand::Rng) -> Vec<u8> {
    const PARTS: [&[u8]; 17] = [
        b"\x04DES\x01",
        b"DES\x02",
        b"\x04DES\x07",
        b"\x06\x01FEED\0",
        b"\x01A\0",
        b"\x02\0A\x001\0",
        b"\x30\0\0",
        b"\x31\x05\x0A",
        b"\x33\0\0",
        b"\x10\x14\x02\0DES\0",
        b"\x21B\x002\0",
        "\u{e9}\u{200b}\u{4e16}".as_bytes(),
        "\u{378}\u{5ff}\u{9af2f}".as_bytes(),
        b"\xC3\xFF\\\x1B[m",
        b"\0\x05\x01AB\0",
        b"\0\0\0\0\0\0\x04\0",
        b"\xFF\xFF\xFF\xFF\xFF\xFF",
    ];
    let mut bytes = rng.choice(PARTS).unwrap().to_vec();
    while rng.bool() {
        match rng.u8(0..3) {
            0 => bytes.extend_from_slice(rng.choice(PARTS).unwrap()),
            1 => bytes.push(rng.u8(..)),
            _ => drop(bytes.pop()),
        }
    }
    bytes
}

#[test]
fn random_frames_are_dissected_as_descan_shows_them() {
    let mut rng = fastrand::Rng::with_seed(11);
    let mut time = Instant::ZERO;
    let mut frames = Vec::new();
    for _ in 0..6000 {
        let service = *rng.choice([1, 2, 2, 2, 0x123, 0x3FF].iter()).unwrap();
        let id = rng.u32(..32) << 24 | rng.u32(..5) << 17 | rng.u32(..5) << 10 | service;
        let mut bytes = data(&mut rng);
        let mut frame = if rng.u8(..5) == 0 {
            bytes.truncate(64);
            Frame::fd(id, &bytes, 0xCC)
        } else {
            bytes.truncate(8);
            Frame::classic(id, &bytes)
        };
        if rng.u8(..50) == 0 {
            frame = Frame::remote(CanId::Extended(id), 0);
        }
        time += Duration::from_millis(5);
        frames.push(frame.with_time(time).with_bus(BusIndex(0)));
    }
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("random.pcapng"), &frames);
    let profile = "[services]\nheartbeat = 1\n[heartbeat]\nuid_offset = 1\nmode_offset = 0\n\
                   [modes]\nWORK = 6\nIDLE = 4\n[service_names]\n0x123 = \"A \\\"b\\\" \u{e9}\"\n\
                   [debug_names]\n0x3FF = \"LAST\"\n";
    std::fs::write(folder.path().join("p.toml"), profile).unwrap();
    compare(folder.path(), "random.pcapng", &["--profile", "p.toml"]);
}

/// The frames of a response in ISO-TP, from one address.
fn segmented(message: &[u8], from: Address) -> Vec<Frame> {
    let header = Header::request(Address::DEBUG, from, false, Service::from_bits(2));
    let id = header.response(from, false).encode();
    let [high, low] = (message.len() as u16).to_be_bytes();
    let first = [&[0x10 | high, low][..], &message[..6]].concat();
    let mut frames = vec![Frame::classic(id, &first)];
    for (at, part) in message[6..].chunks(7).enumerate() {
        let sequence = 0x20 | (at + 1) as u8 & 0x0F;
        frames.push(Frame::classic(id, &[&[sequence], part].concat()));
    }
    frames
}

#[test]
fn reassembled_services_are_those_of_descan() {
    let mut rng = fastrand::Rng::with_seed(5);
    let (mut frames, mut expected) = (Vec::new(), Vec::new());
    for round in 0..200 {
        let mut message = vec![2];
        for index in 0..rng.u8(1..12) {
            message.push(index);
            for _ in 0..rng.u8(2..4) {
                for _ in 0..rng.u8(..6) {
                    message.push(*rng.choice(b"A1.\x01\x02\xFF".iter()).unwrap());
                }
                message.push(0);
            }
        }
        if message.len() < 9 {
            continue;
        }
        if rng.u8(..4) == 0 {
            message.pop();
        }
        frames.extend(segmented(&message, Address::from_bits(1 + round % 100)));
        expected.push((frames.len() - 1, message));
    }
    let mut time = Instant::ZERO;
    for frame in &mut frames {
        time += Duration::from_millis(1);
        *frame = frame.with_time(time);
    }
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("long.pcapng"), &frames);
    let Some(shown) = compare(folder.path(), "long.pcapng", &[]) else { return };
    let escaped = |text: &[u8]| descan::text::Escaped(text).to_string();
    for (at, message) in expected {
        let hex = descan::text::hex(&message, "").to_lowercase();
        assert_eq!(shown[at][12], hex);
        let services = ServicesResponse::decode(&message);
        let versions = services.services().filter(|it| it.strings().count() > 1);
        let versions: Vec<String> = versions.map(|it| escaped(it.version())).collect();
        assert_eq!(shown[at][13], versions.join("|"), "{message:02X?}");
    }
}

#[test]
fn services_of_a_named_device_have_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let devices = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/project/devices");
    let record = ["watch", "sim:boiler", "--time", "6", "--record", "boiler.pcapng"];
    assert_eq!(descan(folder.path(), &record).2, Some(0));
    let file = std::fs::read(folder.path().join("boiler.pcapng")).unwrap();
    let frames: Vec<Frame> =
        LogReader::new(BufReader::new(&file[..])).collect::<Result<_, _>>().unwrap();
    let lua = export(folder.path(), &["--wireshark", "--catalogue", devices]);
    std::fs::write(folder.path().join("candes.lua"), lua).unwrap();
    let Some(shown) = tshark(folder.path(), "boiler.pcapng") else { return };
    // The last frame of the feeder's service: its name was heard before.
    let is_auger = |frame: &&Frame| match frame.id {
        CanId::Extended(id) => id & 0x3FF == 0x101 && id >> 17 & 0x7F == 10,
        CanId::Standard(_) => false,
    };
    let last = frames.iter().rposition(|frame| is_auger(&frame)).expect("a frame of the feeder");
    assert_eq!(shown[last][10], "AUGER");
}

#[test]
fn requests_to_all_have_the_name_on_which_types_agree() {
    let types = [("FEED", 0x101, "AUGER"), ("FEED", 0x105, "ONE"), ("SENS", 0x105, "OTHER")];
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("devices")).unwrap();
    for device in ["FEED", "SENS"] {
        let services = types.iter().filter(|it| it.0 == device).map(|(_, number, name)| {
            format!("[[services]]\nname = \"{name}\"\nnumber = {number}\n")
        });
        let file = format!("name = \"{device}\"\n{}", services.collect::<String>());
        std::fs::write(folder.path().join(format!("devices/{device}.toml")), file).unwrap();
    }
    let name = |from: u8, data: &'static [u8]| {
        let from = Address::from_bits(from);
        let request = Header::request(Address::DEBUG, from, false, Service::from_bits(2));
        Frame::classic(request.response(from, false).encode(), data)
    };
    let to_all = |service: u16| {
        let (from, random) = (Address::from_bits(20), Address::from_bits(99));
        let mut header = Header::request(from, random, false, Service::from_bits(service));
        header.broadcast = true;
        Frame::classic(header.encode(), &[1])
    };
    let frames = [
        name(10, b"\x06\x01FEED\0"),
        name(11, b"\x06\x01SENS\0"),
        to_all(0x101),
        to_all(0x105),
        to_all(0x106),
    ];
    let mut time = Instant::ZERO;
    let frames = frames.map(|frame| {
        time += Duration::from_millis(1);
        frame.with_time(time)
    });
    write(&folder.path().join("all.pcapng"), &frames);
    let options = ["--catalogue", "devices"];
    let Some(shown) = compare(folder.path(), "all.pcapng", &options) else { return };
    let services: Vec<&str> = shown.iter().map(|row| row[10].as_str()).collect();
    assert_eq!(services, ["DES", "DES", "AUGER", "", ""]);
}

#[test]
fn late_frames_and_other_devices_lend_no_name() {
    let at = |number: u8| Address::from_bits(number);
    let request = |to: u8, service: u16| {
        Header::request(Address::DEBUG, at(to), false, Service::from_bits(service))
    };
    let response = |from: u8, service: u16| request(from, service).response(at(from), false);
    let mut debug = Header::unsolicited(at(10), 127, true, Service::from_bits(0x021));
    debug.to_non_working = true;
    let mut to_feeder = response(12, 0x101);
    to_feeder.destination = at(10);
    let frames: [(u64, Header, &[u8]); 6] = [
        (0, response(10, 2), b"\x06\x01FEED\0"),
        (1, debug, &[1, 0, 3]),
        (2, to_feeder, &[1, 2]),
        (3, request(10, 0x101), &[1, 2]),
        (4, response(11, 2), b"\x10\x09\x01LATER"),
        (2004, response(11, 2), b"\x21XY\0"),
    ];
    let frames = frames.map(|(millis, header, data)| {
        let time = Instant::ZERO + Duration::from_millis(millis);
        Frame::classic(header.encode(), data).with_time(time)
    });
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("names.pcapng"), &frames);
    let devices = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/project/devices");
    let lua = export(folder.path(), &["--wireshark", "--catalogue", devices]);
    std::fs::write(folder.path().join("candes.lua"), lua).unwrap();
    let Some(shown) = tshark(folder.path(), "names.pcapng") else { return };
    let services: Vec<&str> = shown.iter().map(|row| row[10].as_str()).collect();
    assert_eq!(services, ["DES", "JAMMED", "", "AUGER", "DES", "DES"]);
    assert_eq!(shown[1][11], "debug message JAMMED: current 0.01 A, tries 3");
    assert_eq!(shown[5][12], "", "the transfer had ended");
}

/// A field of data, as a file of the catalogue has it.
fn field(rng: &mut fastrand::Rng, number: usize, name: &str) -> String {
    const TYPES: [&str; 15] = [
        "u8", "u16", "u24", "u32", "u64", "i8", "i16", "i24", "i32", "i64", "f32", "f64", "bool",
        "text", "bytes",
    ];
    let kind = TYPES[number % TYPES.len()];
    let at = rng.u8(..4);
    let mut text = format!("name = \"{name}\", type = \"{kind}\", at = {at}");
    let bytes: Option<u32> = kind[1..].parse().ok().map(|bits: u32| bits / 8);
    if bytes.is_some() && rng.bool() {
        const SCALES: [&str; 7] =
            ["0.1", "-0.25", "1000", "1e-20", "3.3e30", "7e-7", "0.333333333333"];
        let scale = rng.choice(SCALES).unwrap();
        let offset = rng.choice(["0", "-40", "0.005", "1e9"]).unwrap();
        let _ = write!(text, ", scale = {scale}, offset = {offset}, unit = \"°C \\\\ \\\"\"");
    }
    match bytes {
        Some(bytes) if !kind.starts_with('f') => {
            if rng.bool() {
                let bit = rng.u32(..8 * bytes);
                let bits = rng.u32(1..=8 * bytes - bit);
                let _ = write!(text, ", bit = {bit}, bits = {bits}, values = {{ 0 = \"none\" }}");
            } else if kind.starts_with('i') {
                text += ", values = { -1 = \"lost\", -128 = \"least\" }";
            }
        }
        None if kind == "bool" => drop(write!(text, ", bit = {}", rng.u8(..8))),
        None if rng.bool() => drop(write!(text, ", length = {}", rng.u8(1..5))),
        _ => {}
    }
    format!("{{ {text} }}")
}

/// Numbers that are far from the middle more often than by chance.
fn bytes_of_numbers(rng: &mut fastrand::Rng, len: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    while bytes.len() < len {
        match rng.u8(..8) {
            0 => bytes.extend([rng.u8(..), rng.u8(..)]),
            1 => bytes.extend([0; 4]),
            2 => bytes.extend([0xFF; 3]),
            3 | 4 => {
                const FLOATS: [f32; 5] = [0.1, -1e-7, f32::NAN, f32::INFINITY, 16_777_217.0];
                let number = *rng.choice(&FLOATS).unwrap();
                bytes.extend(if rng.bool() { number.to_le_bytes() } else { number.to_be_bytes() });
            }
            5 | 6 => {
                const DOUBLES: [f64; 6] =
                    [1e15, 0.1 + 0.2, -5e-324, f64::MAX, 1e-6, f64::NEG_INFINITY];
                let number = *rng.choice(&DOUBLES).unwrap();
                bytes.extend(if rng.bool() { number.to_le_bytes() } else { number.to_be_bytes() });
            }
            _ => bytes.extend(b"A\x80\0"),
        }
    }
    bytes.truncate(len);
    bytes
}

/// Services of the catalogue.
const SERVICES: u16 = 60;

#[test]
fn fields_of_the_catalogue_are_those_of_descan() {
    let mut rng = fastrand::Rng::with_seed(23);
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("devices")).unwrap();
    for (file, head, order) in
        [("all", "title = \"All\"", "little"), ("feed", "name = \"FEED\"", "big")]
    {
        let mut text = format!("{head}\nbyte_order = \"{order}\"\n");
        for number in 0..SERVICES {
            let mut fields = |number: usize| {
                format!("[{}, {}]", field(&mut rng, number, "a"), field(&mut rng, number / 2, "b"))
            };
            let number = usize::from(number);
            let _ =
                write!(text, "[[services]]\nname = \"S{number}\"\nnumber = {}\n", 0x200 + number);
            let _ =
                write!(text, "request = {}\nresponse = {}\n", fields(number), fields(number + 1));
            if file == "all" || number % 2 == 0 {
                let _ = writeln!(text, "data = {}", fields(number + 2));
            }
            let _ = write!(
                text,
                "[[debug]]\ncode = {number}\nname = 'D\\s'\nparameters = {}\n",
                fields(number)
            );
        }
        std::fs::write(folder.path().join(format!("devices/{file}.toml")), text).unwrap();
    }
    let at = |number: u8| Address::from_bits(number);
    let request = |to: u8, service: u16| {
        Header::request(Address::DEBUG, at(to), false, Service::from_bits(service))
    };
    let mut frames =
        vec![Frame::classic(request(10, 2).response(at(10), false).encode(), b"\x06\x01FEED\0")];
    for _ in 0..4000 {
        let (device, service) = (rng.u8(10..12), 0x200 + rng.u16(..SERVICES));
        let mut header = match rng.u8(..4) {
            0 => request(device, service),
            1 => request(device, service).response(at(device), false),
            2 => Header::unsolicited(at(device), 20, true, Service::from_bits(service)),
            _ => {
                let mut debug =
                    Header::unsolicited(at(device), 127, true, Service::from_bits(service - 0x200));
                debug.to_non_working = true;
                debug
            }
        };
        header.no_error &= rng.u8(..10) > 0;
        let is_fd = rng.u8(..4) == 0;
        let len = if is_fd { *rng.choice([8, 12, 24, 64].iter()).unwrap() } else { rng.usize(..9) };
        let data = bytes_of_numbers(&mut rng, len);
        let id = header.encode();
        frames.push(if is_fd { Frame::fd(id, &data, 0xCC) } else { Frame::classic(id, &data) });
    }
    let mut time = Instant::ZERO;
    for frame in &mut frames {
        time += Duration::from_millis(5);
        *frame = frame.with_time(time);
    }
    write(&folder.path().join("fields.pcapng"), &frames);
    let options = ["--catalogue", "devices"];
    let Some(shown) = compare(folder.path(), "fields.pcapng", &options) else { return };
    let mut described = 0;
    for row in &shown {
        let words = row[14].replace('|', ", ");
        assert!(row[11].contains(&words), "{row:?}");
        described += usize::from(!words.is_empty());
    }
    assert!(described > 3000, "{described}");
}
