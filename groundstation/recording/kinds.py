"""What kind of file this is, where it is none that can be read: named for what it is, with what to do."""

from __future__ import annotations

from groundstation.recording.tablefile import decoded

READABLE = (
    "an MCAP recording, a flight bundle (folder), a PX4 ULog, an ArduPilot DataFlash log, a Betaflight or INAV "
    "blackbox log, a ROS 2 bag or a Crazyflie usd log"
)
_PACKED = {
    b"\x1f\x8b": "is compressed with gzip",
    b"PK\x03\x04": "is a zip archive",
    b"7z\xbc\xaf\x27\x1c": "is a 7z archive",
    b"BZh": "is compressed with bzip2",
    b"\xfd7zXZ": "is compressed with xz",
    b"\x28\xb5\x2f\xfd": "is compressed with zstd",
    b"\x04\x22\x4d\x18": "is compressed with lz4",
}
_NAMED = {
    b"ULogEnc": "is an encrypted PX4 log (.ulge); decrypt it with PX4's decrypt_ulog.py and give the .ulg",
    b"\x89HDF": "is an HDF5 or MATLAB file; save it as CSV and read it with `groundstation convert --map`",
    b"MATLAB 5.0": "is a MATLAB file; save it as CSV and read it with `groundstation convert --map`",
    b"#ROSBAG V2.0": "is a ROS 1 bag; convert it with `rosbags-convert` and give the ROS 2 bag",
    b"PAR1": "is a Parquet file; say what its columns are with `groundstation convert --map FILE.toml`",
    b"<!DOCTYPE html": "is a web page: the download of a log failed; log in and fetch it again",
    b"<html": "is a web page: the download of a log failed; log in and fetch it again",
    b"%PDF": "is a PDF document",
}


def described(head: bytes, size: int) -> str:
    """A clause on a file that none of the readers takes, by its first bytes."""
    if not size:
        return "is empty: nothing was written into it; copy or download it again"
    if not head.strip(b"\0"):
        return "holds zeros alone: the card was not written, or the copy failed; copy it again"
    for magic, what in _PACKED.items():
        if head.startswith(magic):
            return f"{what}; unpack it and give the log inside"
    for magic, what in _NAMED.items():
        if head.startswith(magic):
            return what
    if len(head) > 8 and head[8] in (0xFD, 0xFE):
        return (
            "is a telemetry log of MAVLink (.tlog): it holds what came over the radio, too slow for inertias; give the "
            "log of the vehicle's own memory (.ulg, .bin)"
        )
    return _text(head)


def _text(head: bytes) -> str:
    text = decoded(head)
    if any(ord(c) < 9 or 13 < ord(c) < 32 or c == "\ufffd" for c in text[:-4]):  # a character may be cut at the end
        return f"is of no known format; give {READABLE}"
    lines = text.splitlines() or [""]
    if lines[0].startswith("FMT, ") or "\nFMT, " in text:
        return "is an ArduPilot log that was turned into text (.log); give the .bin it was made from"
    if any(line.count(separator) >= 2 for line in lines for separator in ",;\t"):
        return (
            "is a table in one file; a flight bundle is a folder of such tables (docs/formats.md), or say what its "
            "columns are with `groundstation convert --map FILE.toml` (--map-template fills in what their names tell)"
        )
    return f"is a text file; give {READABLE}"
