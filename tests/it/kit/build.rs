//! How the kit compiles: without warnings, within its limits of size, and under the sanitizers.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

const WARNINGS: [&str; 11] = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wshadow",
    "-Wcast-qual",
    "-Wundef",
    "-Wstrict-prototypes",
    "-Wmissing-prototypes",
    "-Werror",
];

/// A des_config.h with all service numbers.
const ALL_NUMBERS: &str = "\
#define DES_SRV_IDENTIFY 0x018u
#define DES_SRV_MODE 0x019u
#define DES_SRV_REBOOT 0x01Au
#define DES_SRV_WRITE_UID 0x011u
#define DES_SRV_WRITE_ADDRESS 0x016u
#define DES_SRV_WRITE_BITRATE 0x015u
";

/// The smallest configuration: ISO-TP on classic CAN, nothing can be changed from the bus.
const SMALL: &str = "\
#define DES_WITH_FD 0
#define DES_WITH_RAW 0
#define DES_WITH_WRITES 0
#define DES_WITH_COMMANDS 0
";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A folder for what is compiled, with a des_config.h.
fn folder(name: &str, config: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("kit").join(name);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("des_config.h"), config).unwrap();
    folder
}

fn run(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{command:?}: {text}");
    output
}

/// Compiles a program of tests/kit with the kit.
fn compile(program: &str, folder: &Path, options: &[&str]) -> PathBuf {
    let path = folder.join(program);
    let mut command = Command::new("cc");
    command.args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror", "-O1"]);
    command.args(options).arg("-I").arg(root().join("src/kit")).arg("-I").arg(folder);
    command.arg(root().join("tests/kit").join(program).with_extension("c"));
    run(command.arg(root().join("src/kit/des.c")).arg("-o").arg(&path));
    path
}

/// Returns the path of a program of tests/kit, compiled once.
pub(super) fn compiled(program: &str) -> &'static Path {
    static DRIVER: OnceLock<PathBuf> = OnceLock::new();
    DRIVER.get_or_init(|| compile(program, &folder("driver", ALL_NUMBERS), &[]))
}

fn is_there(program: &str) -> bool {
    let is_there = Command::new(program).arg("--version").output().is_ok();
    if !is_there {
        assert!(std::env::var_os("CI").is_none(), "{program} is not installed");
        eprintln!("skipped: {program} is not installed");
    }
    is_there
}

/// Compiles the kit for RV32IMAC; returns the bytes of code and constants, and the stack that each
/// function needs.
fn measured(name: &str, config: &str) -> (u32, Vec<(String, u32)>) {
    let folder = folder(name, config);
    let object = folder.join("des.o");
    let mut command = Command::new("riscv64-unknown-elf-gcc");
    command.args(["-march=rv32imac", "-mabi=ilp32", "-Os", "-ffreestanding", "-fstack-usage"]);
    command.args(WARNINGS).arg("-I").arg(&folder).arg("-c");
    run(command.arg(root().join("src/kit/des.c")).arg("-o").arg(&object));
    let sizes = run(Command::new("riscv64-unknown-elf-size").arg("-A").arg(&object));
    let sizes = String::from_utf8(sizes.stdout).unwrap();
    let size = |section: &str| -> u32 {
        let is_part = |line: &&str| line.split_whitespace().next().is_some_and(|it| it == section);
        let lines = sizes.lines().filter(is_part);
        lines.map(|line| line.split_whitespace().nth(1).unwrap().parse::<u32>().unwrap()).sum()
    };
    assert_eq!(size(".data") + size(".bss") + size(".sbss") + size(".sdata"), 0, "{sizes}");
    let undefined = run(Command::new("riscv64-unknown-elf-nm").arg("-u").arg(&object));
    assert!(undefined.stdout.is_empty(), "{}", String::from_utf8_lossy(&undefined.stdout));
    let usage = std::fs::read_to_string(folder.join("des.su")).unwrap();
    let stacks = usage.lines().map(|line| {
        let words: Vec<&str> = line.split('\t').collect();
        assert_eq!(words[2], "static", "{line}");
        (words[0].rsplit(':').next().unwrap().to_owned(), words[1].parse().unwrap())
    });
    (size(".text") + size(".rodata") + size(".srodata"), stacks.collect())
}

/// Size of a type of the kit, on RV32.
fn size_of(type_name: &str) -> usize {
    let folder = folder("sizes", ALL_NUMBERS);
    let source = folder.join("size.c");
    let text = format!("#include \"des.h\"\nunsigned char size[sizeof({type_name})] = {{1}};\n");
    std::fs::write(&source, text).unwrap();
    let object = source.with_extension("o");
    let mut command = Command::new("riscv64-unknown-elf-gcc");
    command.args(["-march=rv32imac", "-mabi=ilp32", "-ffreestanding", "-I"]).arg(&folder);
    command.arg("-I").arg(root().join("src/kit")).arg("-c").arg(&source).arg("-o").arg(&object);
    run(&mut command);
    let symbols = run(Command::new("riscv64-unknown-elf-nm").arg("-S").arg(&object)).stdout;
    let symbols = String::from_utf8(symbols).unwrap();
    usize::from_str_radix(symbols.split_whitespace().nth(1).unwrap(), 16).unwrap()
}

#[test]
fn kit_has_no_warnings_in_any_configuration() {
    let switches = ["FD", "RAW", "DESCRIPTOR", "WRITES", "COMMANDS"];
    let odd = "#define DES_HEARTBEAT_UID_AT -1\n#define DES_HEARTBEAT_MODE_AT 0\n\
               #define DES_HEARTBEAT_ERROR_AT -1\n#define DES_BIG_ENDIAN 1\n#define DES_ASKERS 1\n\
               #define DES_WRITES_AT_RESTART 1\n";
    for chosen in 0..32 {
        let mut config = String::from(if chosen % 3 == 0 { ALL_NUMBERS } else { "" });
        for (at, switch) in switches.iter().enumerate() {
            config += &format!("#define DES_WITH_{switch} {}\n", chosen >> at & 1);
        }
        if chosen % 5 == 0 {
            config += odd;
        }
        let folder = folder("warnings", &config);
        for level in ["-Os", "-O2"] {
            let mut command = Command::new("cc");
            command.args(WARNINGS).args(["-ffreestanding", level, "-I"]).arg(&folder);
            command.arg("-c").arg(root().join("src/kit/des.c"));
            run(command.arg("-o").arg(folder.join("des.o")));
        }
    }
}

#[test]
fn kit_fits_its_limits_of_size_and_stack() {
    if !is_there("riscv64-unknown-elf-gcc") {
        return;
    }
    let (all, stacks) = measured("all", ALL_NUMBERS);
    assert!(all <= 4096, "{all} bytes of code and constants");
    let (small, _) = measured("small", &format!("{ALL_NUMBERS}{SMALL}"));
    assert!(small <= 3000, "{small} bytes of code and constants");
    assert!(size_of("des_node") <= 160);
    // The deepest calls: des_poll or des_receive, then at most four functions.
    let mut usage: Vec<u32> = stacks.iter().map(|(_, bytes)| *bytes).collect();
    usage.sort_unstable_by(|one, other| other.cmp(one));
    let entries = |name: &str| stacks.iter().find(|(it, _)| it == name).unwrap().1;
    let deepest = entries("des_poll").max(entries("des_receive"));
    let others: u32 = (stacks.iter())
        .filter(|(name, _)| !name.starts_with("des_poll") && !name.starts_with("des_receive"))
        .map(|(_, bytes)| *bytes)
        .sum();
    assert!(deepest + others.min(112) <= 256, "{stacks:?}");
}

#[test]
fn random_calls_violate_nothing_under_sanitizers() {
    let options = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"];
    for (name, config) in [("fuzz", ALL_NUMBERS.to_owned()), ("fuzz-small", SMALL.to_owned())] {
        let program = compile("fuzz", &folder(name, &config), &options);
        let output = run(Command::new(program).args(["300000", "7"]));
        let text = String::from_utf8(output.stdout).unwrap();
        let sent = text.split_whitespace().nth(2).unwrap().parse::<u32>().unwrap();
        assert!(sent > 1000, "{text}");
    }
}
