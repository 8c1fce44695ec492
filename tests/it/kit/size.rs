//! How large the node in Rust is in a firmware for RV32IMAC: tests/kit/firmware.rs, which is compiled as
//! a package of its own. Beside it the size of the kit in C: see the tests of `build`.

use super::build::{is_there, output_of, root};
use std::path::{Path, PathBuf};
use std::process::Command;

const TARGET: &str = "riscv32imac-unknown-none-elf";
/// Functions that the firmware calls, and data that it reads: the linker takes any place for them.
const BOARD: [&str; 12] = [
    "device",
    "now",
    "entropy",
    "errors",
    "take",
    "application",
    "set_up",
    "event",
    "load",
    "store",
    "transmit",
    "transmitted",
];

/// Measured with Rust 1.95 and LTO: 10,334 bytes with "s", 11,402 bytes with "z"; 5 % more.
const LIMITS: [(&str, u32); 2] = [("s", 10_850), ("z", 11_970)];

fn has_target() -> bool {
    let sysroot = Command::new("rustc").args(["--print", "sysroot"]).output().unwrap();
    let sysroot = String::from_utf8(sysroot.stdout).unwrap();
    let has_target = Path::new(sysroot.trim()).join("lib/rustlib").join(TARGET).exists();
    if !has_target {
        assert!(std::env::var_os("CI").is_none(), "{TARGET} is not installed");
        eprintln!("skipped: rustup target add {TARGET}");
    }
    has_target
}

/// Compiles the firmware; returns its image.
fn firmware(level: &str) -> PathBuf {
    let folder =
        Path::new(env!("CARGO_TARGET_TMPDIR")).join("kit").join(format!("firmware-{level}"));
    std::fs::create_dir_all(&folder).unwrap();
    let manifest = format!(
        "[package]\nname = \"firmware\"\nversion = \"0.0.0\"\nedition = \"2024\"\n\n[workspace]\n\n\
         [[bin]]\nname = \"firmware\"\npath = {:?}\n\n\
         [dependencies]\n\
         descan = {{ path = {:?}, default-features = false, features = [\"node\"] }}\n\n\
         [profile.release]\nopt-level = {level:?}\nlto = true\ncodegen-units = 1\npanic = \"abort\"\n",
        root().join("tests/kit/firmware.rs").display().to_string(),
        root().display().to_string(),
    );
    std::fs::write(folder.join("Cargo.toml"), manifest).unwrap();
    // The versions of the program: nothing is fetched.
    std::fs::copy(root().join("Cargo.lock"), folder.join("Cargo.lock")).unwrap();
    let symbols = BOARD.map(|name| format!("-Clink-arg=--defsym={name}=0x14000"));
    let output = Command::new(env!("CARGO"))
        .args(["build", "--release", "--offline", "--quiet", "--target", TARGET, "--target-dir"])
        .arg(folder.join("target"))
        .env("RUSTFLAGS", symbols.join(" "))
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .current_dir(&folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    folder.join("target").join(TARGET).join("release/firmware")
}

/// Bytes of code and constants.
fn size_of(image: &Path) -> u32 {
    let sizes = output_of("riscv64-unknown-elf-size", "-A", image);
    let words = sizes.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let parts = words.filter(|words| words.len() > 1 && [".text", ".rodata"].contains(&words[0]));
    parts.map(|words| words[1].parse::<u32>().unwrap()).sum()
}

#[test]
fn node_fits_its_limits_of_size() {
    if !is_there("riscv64-unknown-elf-size") || !has_target() {
        return;
    }
    for (level, limit) in LIMITS {
        let size = size_of(&firmware(level));
        assert!(size <= limit && size > limit / 2, "opt-level {level}: {size} of {limit} bytes");
    }
}
