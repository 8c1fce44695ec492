//! The DBC file in cantools: each value is that of descan.

use super::export;
use crate::common::python::{Peer, Python};
use descan::catalogue::DeviceType;
use descan::text::hex;
use descan::wire::data_layout::DataValue;
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::{Heartbeat, Mode, Uid};
use descan::wire::profile::Profile;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// Decodes lines of an identifier and data.
const DECODER: &str = r#"
import json, sys
import cantools
base = cantools.database.load_file(sys.argv[1], frame_id_mask=0x1F0003FF)
for line in sys.stdin:
    id, data = line.split(":")
    message = base.get_message_by_frame_id(int(id, 16))
    assert message.is_extended_frame
    values = message.decode(bytes.fromhex(data), decode_choices=False, allow_truncated=True)
    named = message.decode(bytes.fromhex(data), allow_truncated=True)
    names = {key: str(value) for key, value in named.items()}
    print(json.dumps({"message": message.name, "values": values, "names": names}), flush=True)
"#;

fn decoder(folder: &Path, options: &[&str]) -> Option<Peer> {
    let file = folder.join("bus.dbc");
    std::fs::write(&file, export(folder, &[&["--dbc"], options].concat())).unwrap();
    let python = Python::with(&["cantools==40.2.1"])?;
    Some(python.start(DECODER, &[file.to_str().unwrap()]))
}

fn decoded(peer: &mut Peer, header: Header, data: &[u8]) -> Value {
    peer.write_line(&format!("{:08X}:{}", header.encode(), hex(data, "")));
    serde_json::from_str(&peer.read_line()).unwrap()
}

fn address(number: u8) -> Address {
    Address::from_bits(number)
}

#[test]
fn platform_messages_are_decoded_by_cantools() {
    let folder = tempfile::tempdir().unwrap();
    let profile = "[commands]\nreboot = 0x020\n[writes]\naddress = 0x016\n";
    std::fs::write(folder.path().join("p.toml"), profile).unwrap();
    let Some(mut peer) = decoder(folder.path(), &["--profile", "p.toml"]) else { return };
    let profile = Profile::default();
    let service = |number: u16| Service::from_bits(number);
    let beat = Heartbeat {
        uid: Uid::parse("BOILER01", &profile.uid),
        mode: Some(Mode::Ufunc),
        error: Some(7),
    };
    let (data, len) = beat.encode(&profile.heartbeat, &profile.modes.codes());
    for is_u in [false, true] {
        let header = Header::unsolicited(address(12), 99, is_u, service(1));
        let told = decoded(&mut peer, header, &data[..len]);
        let uid = beat.uid.unwrap().0.iter().fold(0u64, |all, byte| all << 8 | u64::from(*byte));
        assert_eq!(told["values"], json!({"UID": uid, "MODE": 5, "ERROR": 7}));
        assert_eq!(told["names"]["MODE"], "UFUNC");
        let name = if is_u { "HR_RSP_CU_UNSC" } else { "HR_RSP_CC_UNSC" };
        assert_eq!(told["message"], name);
    }
    let request = |number: u16| Header::request(address(0), address(12), true, service(number));
    let response = |number: u16| request(number).response(address(12), true);
    let broadcast = Header::broadcast(address(0), 85, false, service(2));
    let cases: [(Header, &[u8], &str, Value); 8] = [
        (broadcast, b"\x04DES\x01", "DES_REQ_CC_BCST", json!({"PCI": 4, "TYPE": 1})),
        (request(2), b"\x04DES\x02", "DES_REQ_CU_TGT", json!({"PCI": 4, "TYPE": 2})),
        (response(2), b"\x06\x01FEED\0", "DES_RSP_CU_TGT", json!({"PCI": 6})),
        (response(0x13), &[1, 0, 4, 1], "FW_RSP_CU_TGT", json!({"FW_MAJ": 1, "FW_MIN": 260})),
        (
            response(0x14),
            &[2, 1, 0, 5, 1],
            "CAPS_RSP_CU_TGT",
            json!({"PROG": 0, "FPU": 1, "CPU": 1, "CPU_FLAGS": 261}),
        ),
        (response(0x16), &[0x8C], "ADDR_RSP_CU_TGT", json!({"ADDRESS": 12, "PREFERRED": 1})),
        (request(0x16), &[20], "ADDR_REQ_CU_TGT", json!({"ADDRESS": 20, "PREFERRED": 0})),
        (request(0x20), &[], "RESTART_REQ_CU_TGT", json!({})),
    ];
    for (header, data, message, values) in cases {
        let told = decoded(&mut peer, header, data);
        assert_eq!((&told["message"], &told["values"]), (&json!(message), &values));
    }
}

#[test]
fn file_is_read_whatever_names_and_places_fields_have() {
    let names =
        ["VERSION", "FILTER", "CM_", "BO_", "VAL_", "SG_MUL_VAL_", "INT", "_", "9", "\u{3a9}"];
    let fields: Vec<String> = names
        .iter()
        .chain(&["a name that is longer than 32 chars 1", "a name that is longer than 32 chars 2"])
        .map(|name| format!("{{ name = '{name}', type = 'u8' }}"))
        .collect();
    let file = format!(
        "name = 'K'\n[[services]]\nname = 'BO_'\nnumber = 0x101\ndata = [{},\n\
         {{ name = 'status', type = 'u8', at = 20 }}, {{ name = 'ok', type = 'bool', at = 20, bit = 3 }}]\n",
        fields.join(", ")
    );
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("devices")).unwrap();
    std::fs::write(folder.path().join("devices/k.toml"), file).unwrap();
    let profile = "request_err = 1\n[heartbeat]\nuid_offset = 60\n";
    std::fs::write(folder.path().join("p.toml"), profile).unwrap();
    let options = ["--catalogue", "devices", "--profile", "p.toml"];
    let Some(mut peer) = decoder(folder.path(), &options) else { return };
    let header = Header::unsolicited(address(12), 3, false, Service::from_bits(0x101));
    let data: Vec<u8> = (1..=21).collect();
    let told = decoded(&mut peer, header, &data);
    let values = told["values"].as_object().unwrap();
    assert_eq!(values.len(), 13, "ok has a bit of status: {told}");
    let mut found: Vec<u64> = values.values().map(|it| it.as_u64().unwrap()).collect();
    found.sort_unstable();
    assert_eq!(found, (1..=12).chain([21]).collect::<Vec<_>>());
    let mut request = Header::request(address(0), address(12), false, Service::from_bits(2));
    request.no_error = true;
    let told = decoded(&mut peer, request, b"\x04DES\x01");
    assert_eq!(told["values"]["TYPE"], 1, "requests have ERR set: {told}");
}

/// A type of device with a service per field, of random types, places and scales.
fn random_type(rng: &mut fastrand::Rng, order: &str) -> String {
    let mut file = format!("name = 'RAND'\nbyte_order = '{order}'\n");
    let first = if order == "little" { 0x100 } else { 0x200 };
    for at in 0..60 {
        let number = first + at;
        let _ = writeln!(file, "[[services]]\nname = \"S {number}\"\nnumber = {number}\ndata = [");
        for field in 0..rng.u8(1..4) {
            let words =
                ["u8", "u16", "u24", "u32", "i8", "i16", "i24", "i32", "f32", "bool", "i64"];
            let word = *rng.choice(words.iter()).unwrap();
            let _ = write!(file, "{{ name = \"f{field} \u{b0}\", type = \"{word}\"");
            let all: u32 = match word {
                "f32" | "bool" => 0,
                _ => word[1..].parse().unwrap(),
            };
            if all > 0 && rng.bool() {
                let bits = rng.u32(1..=all);
                let _ = write!(file, ", bit = {}, bits = {bits}", rng.u32(0..=all - bits));
            }
            if word != "bool" && rng.bool() {
                let scale = *rng.choice([0.5, 0.1, -2.0, 1e-3].iter()).unwrap();
                let _ = write!(file, ", scale = {scale}, offset = {}", rng.i8(..));
            }
            let _ = writeln!(file, ", at = {}, unit = \"\u{b0}C\" }},", 9 * field);
        }
        let _ = writeln!(file, "]");
    }
    file
}

#[test]
fn fields_of_the_catalogue_are_decoded_by_cantools() {
    for order in ["little", "big"] {
        let mut rng = fastrand::Rng::with_seed(3);
        let folder = tempfile::tempdir().unwrap();
        let file = random_type(&mut rng, order);
        std::fs::create_dir(folder.path().join("devices")).unwrap();
        std::fs::write(folder.path().join("devices/rand.toml"), &file).unwrap();
        let of = DeviceType::parse(&file).unwrap();
        let Some(mut peer) = decoder(folder.path(), &["--catalogue", "devices"]) else { return };
        for service in &of.services {
            let header = Header::unsolicited(address(12), 3, false, service.number.unwrap());
            let data: Vec<u8> = std::iter::repeat_with(|| rng.u8(..)).take(64).collect();
            let told = decoded(&mut peer, header, &data);
            let values = of.data_values(header, &data);
            assert_eq!(told["values"].as_object().unwrap().len(), values.len(), "{}", service.name);
            for field in values {
                let expected = match field.value.unwrap() {
                    DataValue::Integer(number) => number as f64,
                    DataValue::Scaled(number, _) | DataValue::Float(number, _) => number,
                    DataValue::Bool(is_set) => f64::from(u8::from(is_set)),
                    other => panic!("{other:?}"),
                };
                let name = field.name.replace(" \u{b0}", "");
                let found = told["values"][&name].as_f64();
                let is_bool = file.contains("bool") && expected <= 1.0 && found > Some(1.0);
                let is_near =
                    found.is_some_and(|it| (it - expected).abs() <= 1e-6 * expected.abs());
                assert!(is_near || is_bool || expected.is_nan(), "{name}: {found:?}, {expected}");
            }
        }
    }
}

#[test]
fn services_of_several_types_with_one_number_are_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("devices")).unwrap();
    for (file, service) in [("a", "FLOW"), ("b", "LEVEL")] {
        let text = format!(
            "name = '{file}'\n[[services]]\nname = '{service}'\nnumber = 0x100\n\
             data = [{{ name = 'x', type = 'u8' }}]\n"
        );
        std::fs::write(folder.path().join(format!("devices/{file}.toml")), text).unwrap();
    }
    let text = export(folder.path(), &["--dbc", "--catalogue", "devices"]);
    assert!(text.contains("FLOW_RSP_CC_UNSC: 8"), "{text}");
    assert!(text.contains("Of a. Also LEVEL."), "{text}");
    assert!(!text.contains("LEVEL_RSP"), "{text}");
}
