"""Holds the logs of descan against python-can, frame by frame, both ways.

Usage: python_can.py PROGRAM FOLDER SEED. Writes random frames with python-can in each format, lets
descan convert them to candump's text, and compares; lets descan write each format, reads it with
python-can, and compares. Prints one line per difference and exits with 1, or the number of frames.
"""

import pathlib
import random
import re
import subprocess
import sys

import can

# Microseconds since 1970 of the first frame; whole milliseconds, as ASC and BLF have dates.
START = 1_700_000_000_123_000
LENGTHS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]


def random_frames(rng, features):
    """Frames as tuples of what is compared."""
    frames, at = [], START
    for _ in range(400):
        extended = rng.random() < 0.6
        limit = 0x1FFFFFFF if extended else 0x7FF
        ident = rng.choice([0, limit, rng.randint(0, limit), rng.randint(0, limit)])
        fd = "fd" in features and rng.random() < 0.4
        kind = rng.random()
        error = "error" in features and kind < 0.05
        remote = "remote" in features and not fd and not error and kind < 0.15
        # python-can takes an FD frame without data in ASC for a remote frame.
        length = rng.choice(LENGTHS[1:]) if fd else rng.randint(0, 8)
        data = bytes(rng.randrange(256) for _ in range(0 if remote else length))
        if error:
            extended, ident, fd, remote, length, data = False, 0, False, False, 0, b""
        frames.append(
            {
                "at": at,
                "id": ident,
                "extended": extended,
                "remote": remote,
                "error": error,
                "fd": fd,
                "switch": fd and "flags" in features and rng.random() < 0.5,
                "passive": fd and "flags" in features and rng.random() < 0.5,
                "length": length,
                "data": data,
                # Error frames have no direction in most formats.
                "tx": "direction" in features and not error and rng.random() < 0.3,
                "channel": rng.randrange(3) if "channel" in features else 0,
            }
        )
        at += rng.choice([50, 1000, 1_000_000, rng.randint(1, 5_000_000)])
    return frames


def message(frame):
    return can.Message(
        timestamp=frame["at"] / 1e6,
        arbitration_id=frame["id"],
        is_extended_id=frame["extended"],
        is_remote_frame=frame["remote"],
        is_error_frame=frame["error"],
        is_fd=frame["fd"],
        bitrate_switch=frame["switch"],
        error_state_indicator=frame["passive"],
        is_rx=not frame["tx"],
        dlc=frame["length"],
        data=frame["data"],
        channel=frame["channel"],
    )


LINE = re.compile(r"\((\d+)\.(\d{6})\) (\S+) ([0-9A-F]+)#(.*?)( [RT])?$")


def candump_frames(text):
    """The frames of candump's text, read here and not by one of the two programs."""
    frames = []
    for line in text.splitlines():
        seconds, micros, name, ident, body, direction = LINE.match(line).groups()
        extended, number = len(ident) == 8, int(ident, 16)
        error = extended and number & 0x20000000 != 0
        fd, flags = body.startswith("#"), 0
        if fd:
            flags, body = int(body[1], 16), body[2:]
        remote = body.startswith("R")
        length = int(body[1:] or "0") if remote else len(body) // 2
        data = b"" if remote else bytes.fromhex(body)
        if error:
            extended, number, length, data = False, 0, 0, b""
        frames.append(
            {
                "at": int(seconds) * 1_000_000 + int(micros),
                "id": number,
                "extended": extended,
                "remote": remote,
                "error": error,
                "fd": fd,
                "switch": bool(flags & 1),
                "passive": bool(flags & 2),
                "length": length,
                "data": data,
                "tx": direction == " T",
                "channel": int(re.search(r"\d+$", name).group()) - (name.startswith("ch")),
            }
        )
    return frames


def message_frames(messages):
    """The frames of python-can's messages."""
    frames = []
    for it in messages:
        error = it.is_error_frame
        channel = it.channel if isinstance(it.channel, int) else int(re.search(r"\d+$", str(it.channel)).group()) if it.channel is not None else 0
        frames.append(
            {
                "at": round(it.timestamp * 1e6),
                "id": 0 if error else it.arbitration_id,
                "extended": it.is_extended_id and not error,
                "remote": it.is_remote_frame,
                "error": error,
                "fd": it.is_fd,
                "switch": it.bitrate_switch,
                "passive": it.error_state_indicator,
                "length": 0 if error else it.dlc,
                "data": b"" if error or it.is_remote_frame else bytes(it.data),
                "tx": not it.is_rx,
                "channel": channel,
            }
        )
    return frames


def candump_text(frames):
    lines = []
    for it in frames:
        ident = f"{it['id']:08X}" if it["extended"] else f"{it['id']:03X}"
        flags = it["switch"] | it["passive"] << 1
        body = it["data"].hex().upper()
        body = f"#{flags:X}{body}" if it["fd"] else f"R{it['length']}" if it["remote"] else body
        if it["error"]:
            ident, body = "20000080", "00" * 8
        seconds, micros = divmod(it["at"], 1_000_000)
        direction = " T" if it["tx"] else ""
        lines.append(f"({seconds:010}.{micros:06}) can{it['channel']} {ident}#{body}{direction}\n")
    return "".join(lines)


def differences(what, expected, found, shift=0):
    """One line per difference; `shift` is what python-can adds to channels. Its times are in floating
    point: 1 microsecond more or less."""
    if len(expected) != len(found):
        yield f"{what}: {len(expected)} frames, {len(found)} found"
    for number, (one, other) in enumerate(zip(expected, found)):
        for key in one:
            wanted, got = one[key], other[key]
            if key == "channel":
                got -= shift
            same = abs(wanted - got) <= 1 if key == "at" else wanted == got
            if not same:
                yield f"{what}: frame {number}: {key} is {got}, expected {wanted}"


def convert(program, source, target, *options):
    command = [program, "convert", str(source), str(target), "--force", *options]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if run.returncode != 0:
        raise SystemExit(f"{command}: {run.returncode}: {run.stderr}")


ALL = {"fd", "flags", "error", "remote", "direction", "channel"}
# Ending, and what python-can writes in the format.
WRITTEN = [
    ("asc", ALL),
    ("blf", ALL),
    ("trc", {"direction", "channel"}),
    ("csv", {"remote", "error"}),
    # It writes remote frames without their length.
    ("log", ALL - {"error", "remote"}),
    ("mf4", ALL),
    ("db", {"remote", "error"}),
]
# Ending, and what python-can reads in the format as it is written. In TRC it takes DLCs of FD frames for
# lengths, and FB and FE for other flags than PEAK's document says.
READ = [
    ("asc", ALL),
    ("blf", ALL),
    ("trc", {"remote", "direction", "channel"}),
    ("log", ALL - {"error"}),
]


def main():
    program, folder, seed = sys.argv[1], pathlib.Path(sys.argv[2]), int(sys.argv[3])
    chosen = sys.argv[4:]
    rng, found, count = random.Random(seed), [], 0
    for ending, features in WRITTEN:
        if chosen and ending not in chosen:
            continue
        frames = random_frames(rng, features)
        log, text = folder / f"written.{ending}", folder / f"{ending}.log"
        log.unlink(missing_ok=True)
        writer = can.Logger(str(log))
        for frame in frames:
            writer(message(frame))
        writer.stop()
        convert(program, log, text)
        read = candump_frames(text.read_text())
        found += differences(f"read {ending}", frames, read)
        count += len(frames)
    for ending, features in READ:
        if chosen and ending not in chosen:
            continue
        frames = random_frames(rng, features)
        text, log = folder / f"own-{ending}.txt", folder / f"own.{ending}"
        text.write_text(candump_text(frames))
        convert(program, text, log)
        options = {"relative_timestamp": False} if ending == "asc" else {}
        with can.LogReader(str(log), **options) as reader:
            read = message_frames(reader)
        found += differences(f"written {ending}", frames, read, 1 if ending == "trc" else 0)
        count += len(frames)
    for line in found[:40]:
        print(line)
    if found:
        raise SystemExit(1)
    print(count)


main()
