//! How the kit compiles: without warnings, within its limits of size, and under the sanitizers.

use std::fmt::Write as _;
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

/// The configuration for a small processor: ISO-TP on classic CAN, no settings are written.
const SMALL: &str = "\
#define DES_WITH_FD 0
#define DES_WITH_RAW 0
#define DES_WITH_WRITES 0
";

/// Without what the others have: commands, and raw framing beside CAN FD.
const FD_WITHOUT_RAW: &str = "\
#define DES_WITH_RAW 0
#define DES_WITH_COMMANDS 0
";

/// Registers and functions that the example in the guide uses.
const REGISTERS: &str = "\
#include \"des.h\"
typedef struct { volatile uint32_t TIR, TDTR, TDLR, TDHR; } can_mailbox;
typedef struct { volatile uint32_t FR1, FR2; } can_filter;
typedef struct {
    volatile uint32_t MCR, MSR, TSR, IER, ESR, BTR, FMR, FS1R, FA1R;
    can_mailbox TX[3];
    can_filter FILTER[28];
} can_registers;
typedef struct { volatile uint32_t APB1RSTR; } rcc_registers;
extern can_registers can_1;
extern rcc_registers rcc;
extern const uint32_t CHIP_UID[3];
#define CAN1 (&can_1)
#define RCC (&rcc)
enum {
    CAN_MCR_INRQ = 1, CAN_MCR_NART = 16, CAN_MCR_ABOM = 64, CAN_MSR_INAK = 1, CAN_TI_TXRQ = 1,
    CAN_TI_IDE = 4, CAN_TSR_RQCP0 = 1, CAN_TSR_TXOK0 = 2, CAN_ESR_BOFF = 4, CAN_ESR_LEC = 0x70,
    CAN_FMR_FINIT = 1, CAN_IER_FMPIE0 = 2, RCC_CAN1 = 1 << 25
};
#define CAN_BTR_SILM 0x80000000u
uint32_t now_us(void);
bool flash_read(void *to, unsigned size);
bool flash_write(const void *from, unsigned size);
void blink(void);
void system_reset(void);
void stop_motor(void);
bool queue_take(des_frame *frame);
void application_receive(des_node *own, const des_frame *frame);
";

pub(super) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A folder for what is compiled, with a des_config.h.
pub(super) fn folder(name: &str, config: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("kit").join(name);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("des_config.h"), config).unwrap();
    folder
}

pub(super) fn run(command: &mut Command) -> Output {
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

pub(super) fn is_there(program: &str) -> bool {
    let is_there = Command::new(program).arg("--version").output().is_ok();
    if !is_there {
        assert!(std::env::var_os("CI").is_none(), "{program} is not installed");
        eprintln!("skipped: {program} is not installed");
    }
    is_there
}

/// Compiles for RV32IMAC, in a folder.
fn cross_compile(folder: &Path, options: &[&str], source: &Path) -> PathBuf {
    let object = folder.join(source.file_name().unwrap()).with_extension("o");
    let mut command = Command::new("riscv64-unknown-elf-gcc");
    command.args(["-march=rv32imac", "-mabi=ilp32", "-Os", "-ffreestanding"]);
    command.args(options).args(WARNINGS).current_dir(folder);
    command.arg("-I").arg(folder).arg("-I").arg(root().join("src/kit"));
    run(command.arg("-c").arg(source).arg("-o").arg(&object));
    object
}

pub(super) fn output_of(program: &str, option: &str, file: &Path) -> String {
    String::from_utf8(run(Command::new(program).arg(option).arg(file)).stdout).unwrap()
}

/// What the kit takes on RV32IMAC, in bytes.
#[derive(Debug)]
struct Footprint {
    /// Code and constants of the object file.
    object: u32,
    /// Code and constants in a linked firmware that calls des_init, des_receive and des_poll.
    linked: u32,
    /// Stack of the deepest call, without the functions of des_port.
    stack: u32,
}

/// Measures the kit. It has no variables and calls no functions but those of des_port.
fn measured(name: &str, config: &str) -> Footprint {
    let folder = folder(name, config);
    let source = root().join("src/kit/des.c");
    let object = cross_compile(&folder, &["-fcallgraph-info=su"], &source);
    let sizes = output_of("riscv64-unknown-elf-size", "-A", &object);
    let size = |sections: &[&str]| -> u32 {
        let words = sizes.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
        let parts = words.filter(|words| words.len() > 1 && sections.contains(&words[0]));
        parts.map(|words| words[1].parse::<u32>().unwrap()).sum()
    };
    assert_eq!(size(&[".data", ".bss", ".sdata", ".sbss"]), 0, "{sizes}");
    assert_eq!(output_of("riscv64-unknown-elf-nm", "-u", &object), "");
    let object = size(&[".text", ".rodata", ".srodata"]);
    let stack = deepest_stack(&std::fs::read_to_string(folder.join("des.ci")).unwrap());
    Footprint { object, linked: linked_size(&folder), stack }
}

/// Bytes of code and constants of the kit in a linked firmware.
fn linked_size(folder: &Path) -> u32 {
    let firmware = folder.join("firmware.c");
    let text = "\
        #include \"des.h\"\n\
        extern const des_port port;\nextern const des_device device;\n\
        extern bool take(des_frame *frame);\nextern uint32_t now(void);\n\
        extern void application(des_frame *frame);\n\
        des_node node;\nvoid _start(void);\nvoid _start(void)\n{\n\
        des_frame frame;\ndes_init(&node, &port, &device, 0);\nfor (;;) {\n\
        while (take(&frame)) {\nif (des_receive(&node, &frame, now())) {\n\
        application(&frame);\n}\n}\n(void)des_poll(&node, now());\n}\n}\n";
    std::fs::write(&firmware, text).unwrap();
    let sections = ["-ffunction-sections", "-fdata-sections"];
    let objects = [
        cross_compile(folder, &sections, &root().join("src/kit/des.c")),
        cross_compile(folder, &sections, &firmware),
    ];
    let image = folder.join("firmware.elf");
    let mut command = Command::new("riscv64-unknown-elf-gcc");
    command.args(["-march=rv32imac", "-mabi=ilp32", "-nostdlib", "-Wl,--gc-sections"]);
    for symbol in ["port", "device", "take", "now", "application"] {
        command.arg(format!("-Wl,--defsym={symbol}=0x14000"));
    }
    run(command.args(objects).arg("-o").arg(&image));
    let symbols = output_of("riscv64-unknown-elf-nm", "-S", &image);
    let words = symbols.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    words
        .filter(|words| words.len() == 4 && words[3] != "_start" && "tTrR".contains(words[2]))
        .map(|words| u32::from_str_radix(words[1], 16).unwrap())
        .sum()
}

/// Stack of the deepest call in a call graph of GCC, in bytes. No function calls itself.
fn deepest_stack(graph: &str) -> u32 {
    let quoted = |line: &str, at: usize| line.split('"').nth(at).unwrap_or_default().to_owned();
    let mut frames: Vec<(String, u32)> = Vec::new();
    let mut calls: Vec<(String, String)> = Vec::new();
    for line in graph.lines() {
        if line.starts_with("edge:") {
            calls.push((quoted(line, 1), quoted(line, 3)));
        } else if let Some(usage) = line.strip_suffix(" bytes (static)\" }") {
            let bytes = usage.rsplit("\\n").next().unwrap().parse().unwrap();
            frames.push((quoted(line, 1), bytes));
        } else {
            assert!(!line.contains(" bytes ("), "not static: {line}");
        }
    }
    assert!(frames.len() > 5, "{graph}");
    let depth = |name: &String| depth_below(name, &frames, &calls, 0);
    frames.iter().map(|(name, _)| depth(name)).max().unwrap()
}

fn depth_below(
    name: &str,
    frames: &[(String, u32)],
    calls: &[(String, String)],
    level: usize,
) -> u32 {
    assert!(level <= frames.len(), "{name} calls itself");
    let own = frames.iter().find(|(it, _)| it == name).map_or(0, |(_, bytes)| *bytes);
    let called = calls.iter().filter(|(from, _)| from == name);
    own + called.map(|(_, to)| depth_below(to, frames, calls, level + 1)).max().unwrap_or(0)
}

/// Size of a type of the kit, on RV32.
fn size_of(type_name: &str) -> usize {
    let folder = folder("sizes", ALL_NUMBERS);
    let source = folder.join("size.c");
    let text = format!("#include \"des.h\"\nunsigned char size[sizeof({type_name})] = {{1}};\n");
    std::fs::write(&source, text).unwrap();
    let symbols = output_of("riscv64-unknown-elf-nm", "-S", &cross_compile(&folder, &[], &source));
    usize::from_str_radix(symbols.split_whitespace().nth(1).unwrap(), 16).unwrap()
}

#[test]
fn kit_has_no_warnings_in_any_configuration() {
    let switches = ["FD", "RAW", "DESCRIPTOR", "WRITES", "COMMANDS"];
    let odd = "#define DES_HEARTBEAT_UID_AT -1\n#define DES_HEARTBEAT_MODE_AT 0\n\
               #define DES_HEARTBEAT_ERROR_AT -1\n#define DES_BIG_ENDIAN 1\n#define DES_REQUESTERS 1\n\
               #define DES_WRITES_AT_RESTART 1\n";
    for chosen in 0..32 {
        let mut config = String::from(if chosen % 3 == 0 { ALL_NUMBERS } else { "" });
        for (at, switch) in switches.iter().enumerate() {
            let _ = writeln!(config, "#define DES_WITH_{switch} {}", chosen >> at & 1);
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
    let all = measured("all", ALL_NUMBERS);
    assert!(all.object <= 4096 && all.stack <= 256, "{all:?}");
    let small = measured("small", &format!("{ALL_NUMBERS}{SMALL}"));
    assert!(small.object <= 2560 && small.linked <= 2560 && small.stack <= 256, "{small:?}");
    assert!(size_of("des_node") <= 160);
}

#[test]
fn guide_example_compiles() {
    let text = include_str!("../../../src/guide/firmware.md");
    let blocks = text.split("```c\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    let source = std::iter::once(REGISTERS).chain(blocks).collect::<String>();
    let config = "#define DES_NAME \"PUMP\"\n#define DES_SERVICES \"\"\n";
    let folder = folder("guide", config);
    let path = folder.join("firmware.c");
    std::fs::write(&path, source).unwrap();
    let mut command = Command::new("cc");
    command.args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-ffreestanding", "-I"]).arg(&folder);
    run(command.arg("-I").arg(root().join("src/kit")).arg("-fsyntax-only").arg(&path));
}

#[test]
fn socketcan_example_compiles() {
    compile("socketcan", &folder("socketcan", ALL_NUMBERS), &["-Wconversion"]);
}

#[test]
fn random_calls_violate_nothing_under_sanitizers() {
    let options = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"];
    for (name, config) in [("fuzz", ""), ("fuzz-small", SMALL), ("fuzz-fd", FD_WITHOUT_RAW)] {
        let config = format!("{ALL_NUMBERS}{config}");
        let program = compile("fuzz", &folder(name, &config), &options);
        let output = run(Command::new(program).args(["10000000", "7"]));
        let text = String::from_utf8(output.stdout).unwrap();
        let sent = text.split_whitespace().nth(2).unwrap().parse::<u32>().unwrap();
        assert!(sent > 1000, "{text}");
    }
}
