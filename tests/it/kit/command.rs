//! `descan kit`: des_config.h from a profile, and the files of the kit.

use super::build::{folder, root, run};
use descan::kit::{self, KitDevice, KitFault};
use descan::wire::des;
use descan::wire::profile::Profile;
use std::path::Path;
use std::process::{Command, Output};

fn descan(arguments: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command.args(arguments).current_dir(folder).output().unwrap()
}

fn text_of(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn device(name: &str, services: &[(&str, &str)]) -> KitDevice {
    let owned = |text: &&str| (*text).to_owned();
    let services = services.iter().map(|(name, version)| (owned(name), owned(version)));
    KitDevice { name: name.to_owned(), services: services.collect(), has_fd: false }
}

/// Compiles a program with a des_config.h, runs it, and returns what it prints.
fn printed(name: &str, config: &str, program: &str) -> Vec<u8> {
    let folder = folder(name, config);
    let source = folder.join("print.c");
    std::fs::write(&source, format!("#include \"des.h\"\n#include <stdio.h>\n{program}")).unwrap();
    let path = source.with_extension("");
    let mut command = Command::new("cc");
    command.args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wno-trigraphs"]);
    command.arg("-I").arg(root().join("src/kit")).arg("-I").arg(&folder);
    run(command.arg(&source).arg("-o").arg(&path));
    run(&mut Command::new(path)).stdout
}

const PRINT_TEXTS: &str = "\
static const des_text texts[] = {DES_NAME_TEXT(DES_NAME), DES_SERVICES_TEXT(DES_SERVICES)};
int main(void)
{
    fwrite(texts[0].bytes, 1, texts[0].size, stdout);
    fwrite(texts[1].bytes, 1, texts[1].size, stdout);
    return 0;
}
";

#[test]
fn names_of_any_bytes_survive_the_header() {
    let names = ["PUMP", "\"\\", "??/?", "1", "котёл", "\u{1b}[2J\u{7f}", "a\tb"];
    for (at, name) in names.into_iter().enumerate() {
        let services = [("DES", "1.0"), (name, "2.10"), ("0", name)];
        let config = kit::config(&device(name, &services), &Profile::default()).unwrap();
        let strings = services.map(|(name, version)| [name, version]);
        let expected: Vec<u8> =
            des::encode_name(name.as_bytes()).chain(des::encode_services(&strings)).collect();
        assert_eq!(printed(&format!("name-{at}"), &config, PRINT_TEXTS), expected, "{name:?}");
    }
}

#[test]
fn header_of_many_services_has_all_indices() {
    let names: Vec<String> = (0..256).map(|at| format!("S{at}")).collect();
    let services: Vec<(&str, &str)> = names.iter().map(|name| (name.as_str(), "1")).collect();
    let config = kit::config(&device("MANY", &services), &Profile::default()).unwrap();
    let strings: Vec<[&str; 2]> =
        services.iter().map(|(name, version)| [*name, *version]).collect();
    let expected: Vec<u8> =
        des::encode_name(b"MANY").chain(des::encode_services(&strings)).collect();
    assert_eq!(printed("many", &config, PRINT_TEXTS), expected);
}

#[test]
fn header_has_the_values_of_the_profile() {
    let profile = Profile::parse(
        "request_err = 0\nframing = \"isotp\"\n[services]\ndes = 0x123\n[descriptor]\nsn = 0x345\n\
         byte_order = \"big\"\n[commands]\nmode = 0x019\nreboot = 0x01B\n[writes]\naddress = 0x016\n\
         effect = \"restart\"\n[heartbeat]\nperiod_ms = 250\nerror_offset = false\n[modes]\nWORK = 9\n",
    )
    .unwrap();
    let config = kit::config(&device("PUMP", &[]), &profile).unwrap();
    for line in [
        "#define DES_NAME \"PUMP\"",
        "#define DES_SERVICES \"\"",
        "#define DES_WITH_FD 0",
        "#define DES_WITH_RAW 0",
        "#define DES_WITH_WRITES 1",
        "#define DES_WITH_COMMANDS 1",
        "#define DES_SRV_HEARTBEAT 0x001u /* assumed */",
        "#define DES_SRV_DES 0x123u",
        "#define DES_SRV_SN 0x345u",
        "#define DES_SRV_IDENTIFY DES_NONE /* not in the profile */",
        "#define DES_SRV_MODE 0x019u",
        "#define DES_SRV_REBOOT 0x01Bu",
        "#define DES_SRV_WRITE_ADDRESS 0x016u",
        "#define DES_SRV_WRITE_BITRATE DES_NONE /* not in the profile */",
        "#define DES_WRITES_AT_RESTART 1",
        "#define DES_BIG_ENDIAN 1",
        "#define DES_HEARTBEAT_MS 250u",
        "#define DES_HEARTBEAT_UID_AT 0 /* assumed */",
        "#define DES_HEARTBEAT_ERROR_AT -1",
        "#define DES_CODE_WORK 9",
        "#define DES_CODE_IDLE 6 /* assumed */",
    ] {
        assert!(config.lines().any(|it| it == line), "{line}: {config}");
    }
    let print = "static const des_device d = {DES_NAME_TEXT(\"\"), DES_SERVICES_TEXT(\"\"),\n\
                 DES_INFO((1, 2, 3, 4, 5, 6), 0x11223344, 1, 2, 3, 4, 5)};\n\
                 int main(void) { fwrite(d.info, 1, sizeof(d.info), stdout); return 0; }\n";
    let expected = [1, 2, 3, 4, 5, 6, 0x11, 0x22, 0x33, 0x44, 0, 1, 0, 2, 3, 0, 4, 0, 5];
    assert_eq!(printed("big", &config, print), expected);
}

#[test]
fn header_is_refused_for_impossible_devices() {
    let profile = Profile::default();
    let long = "x".repeat(4094);
    assert_eq!(kit::config(&device(&long, &[]), &profile), Err(KitFault::TooLong("name", 4096)));
    let services = [(long.as_str(), "1")];
    assert_eq!(
        kit::config(&device("A", &services), &profile),
        Err(KitFault::TooLong("services", 4099))
    );
    let services = [("DES", "1.0"), ("FLOW", "1.0"), ("FLOW", "1.1")];
    let twice = Err(KitFault::ListedTwice("FLOW".to_owned()));
    assert_eq!(kit::config(&device("A", &services), &profile), twice);
    assert_eq!(kit::rust_config(&device("A", &services), &profile), twice);
    let output = descan(&["kit", "--name", "A", "--services", "DES=1.0"], Path::new("."));
    assert_eq!(
        (output.status.code(), text_of(&output.stderr).trim_end()),
        (Some(2), "descan: service DES: leave it out; every device has it")
    );
}

#[test]
fn command_writes_files_and_keeps_changed_ones() {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["kit", "--name", "PUMP", "--services", "FLOW=1.0,LOG=0.2", "--write", "firmware/des"];
    let output = descan(&arguments, folder.path());
    assert!(output.status.success(), "{}", text_of(&output.stderr));
    assert_eq!(text_of(&output.stderr).lines().count(), 3);
    let path = |name: &str| folder.path().join("firmware/des").join(name);
    assert_eq!(std::fs::read_to_string(path("des.h")).unwrap(), kit::HEADER);
    assert_eq!(std::fs::read_to_string(path("des.c")).unwrap(), kit::SOURCE);
    let config = std::fs::read_to_string(path("des_config.h")).unwrap();
    assert!(config.contains("DES_SERVICE(\"\\002\", \"LOG\", \"0.2\")"), "{config}");
    let output =
        descan(&["kit", "--name", "PUMP", "--services", "FLOW=1.0,LOG=0.2"], folder.path());
    assert_eq!(text_of(&output.stdout), config, "without --write it is printed");
    // Nothing has changed: nothing is written.
    let output = descan(&arguments, folder.path());
    assert!(output.status.success() && output.stderr.is_empty());
    std::fs::write(path("des.c"), "changed").unwrap();
    let output = descan(&arguments, folder.path());
    assert_eq!(output.status.code(), Some(3));
    assert!(text_of(&output.stderr).contains("--force replaces it"));
    assert_eq!(std::fs::read_to_string(path("des.c")).unwrap(), "changed");
    let output = descan(&[&arguments[..], &["--force"]].concat(), folder.path());
    assert!(output.status.success());
    assert_eq!(std::fs::read_to_string(path("des.c")).unwrap(), kit::SOURCE);
}
