"""Speed and memory of the log readers: a long log, and our decoders against the libraries that others keep.

``python -m benchmarks.logs [--minutes 30] [--formats NAME ...] [--out]``; ``make bench`` prints it. ``--out`` keeps the
rows as they come, in place of those of the same format, each with when its run began. Ratios are of the same run. The
limit of memory is six times the samples that are used, as doubles, beside the base: the peak of a process that reads
six seconds of the same format by the same way. That is Python with NumPy, pydantic and this program (60 MB), and what
the format needs: numba's compiler for the scans of PX4, ArduPilot and Betaflight logs (140 MB more), pyarrow for
Parquet. A bag is read by ``rosbags`` in a process of its own, and the larger of the two counts.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from groundstation.writing import write_whole
from studies.log_memory import FACTOR, measured
from studies.long_logs import MAPPED, WRITERS

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results" / "long_logs.json"


def against_libraries(ulog: Path) -> None:
    """The same log by pyulog; ratios of one run."""
    from pyulog import ULog

    from groundstation.recording.ulogfile import decode_ulog

    decode_ulog(np.memmap(ulog, np.uint8, mode="r"))
    begun = time.monotonic()
    log = decode_ulog(np.memmap(ulog, np.uint8, mode="r"))
    for topic in log.topics.values():
        for name in topic.fields:
            topic.raw(name)
    ours = time.monotonic() - begun
    begun = time.monotonic()
    ULog(str(ulog))
    theirs = time.monotonic() - begun
    print(
        f"ULog of {ulog.stat().st_size / 1e6:.0f} MB, every column: ours {ours:.2f} s, pyulog {theirs:.2f} s, "
        f"{theirs / ours:.1f} times"
    )


def dataflash_against_library() -> None:
    """A made log of 400 Hz by pymavlink's DFReader."""
    from pymavlink.DFReader import DFReader_binary

    from groundstation.recording.dataflashfile import decode_dataflash
    from sim.mavlink.dataflash import DataFlashWriter

    log = DataFlashWriter({"IMU": (164, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")})
    for k in range(60_000):
        log.add("IMU", 2500 * k, 0, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
    data = bytes(log.data)
    decode_dataflash(np.frombuffer(data, np.uint8))
    begun = time.monotonic()
    table = decode_dataflash(np.frombuffer(data, np.uint8)).tables["IMU"]
    for name in table.fields:
        table.raw(name)
    ours = time.monotonic() - begun
    with tempfile.NamedTemporaryFile(suffix=".bin") as file:
        Path(file.name).write_bytes(data)
        begun = time.monotonic()
        reader = DFReader_binary(file.name)
        while (message := reader.recv_match(type=["IMU"])) is not None:
            _ = message.GyrX
        theirs = time.monotonic() - begun
    print(f"DataFlash of {len(table)} records: ours {ours:.3f} s, DFReader {theirs:.2f} s, {theirs / ours:.0f} times")


def rows_of(name: str, folder: Path, minutes: float) -> list[dict[str, object]]:
    """A long log of a format, thinned and whole; the base is what six seconds of the same format take."""
    file, write = (WRITERS | MAPPED)[name]
    (folder / "short").mkdir()
    write(folder / "short" / file, 0.1)
    write(folder / file, minutes)
    base, rows = measured(folder / "short" / file, False)["peak_mb"], []
    for everything in (False, True) if name in WRITERS else (True,):
        found = measured(folder / file, everything)
        beyond = found["peak_mb"] - base
        rows.append(
            {
                "format": name,
                "minutes": minutes,
                "mb": round(size_of(folder / file) / 1e6),
                "read": ("all" if name in WRITERS else "converted") if everything else "thinned",
                "used_mb": round(found["used_mb"], 1),
                "base_mb": round(base),
                "peak_mb": round(found["peak_mb"]),
                "times": round(beyond / found["used_mb"], 1),
                "s": round(found["s"], 1),
                "within": beyond <= FACTOR * found["used_mb"],
            }
        )
        print(line(rows[-1]), flush=True)
    return rows


def keep(rows: list[dict[str, object]], out: Path) -> None:
    """Write rows into the file, in the formats' order, in place of those it had of the same formats."""
    before = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else []
    anew = {row["format"] for row in rows}
    order = [*WRITERS, *MAPPED]
    kept = [row for row in before if row["format"] not in anew] + rows
    kept.sort(key=lambda row: order.index(str(row["format"])))
    write_whole(out, json.dumps(kept, indent=1) + "\n")


def size_of(path: Path) -> int:
    """Bytes of a file, or of a folder's files."""
    return path.stat().st_size if path.is_file() else sum(f.stat().st_size for f in path.rglob("*") if f.is_file())


def line(row: dict[str, object]) -> str:
    """A row of the table in docs/logs.md."""
    keys = ("format", "mb", "read", "used_mb", "base_mb", "peak_mb", "times", "s")
    return "| " + " | ".join(str(row[key]) for key in keys) + " |"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--formats", nargs="*", default=[*WRITERS, *MAPPED], choices=[*WRITERS, *MAPPED])
    parser.add_argument("--out", type=Path, nargs="?", const=RESULTS, help="keep the rows as JSON")
    options = parser.parse_args()
    print(f"Logs of {options.minutes:g} min at 1 kHz; the limit is {FACTOR:g} times the samples used, beside the base.")
    print(
        "| format | MB | read | samples used, MB | base, MB | peak, MB | (peak - base) / used | s |\n"
        + "| --- " * 8
        + "|"
    )
    rows: list[dict[str, object]] = []
    begun = time.strftime("%Y-%m-%d %H:%M", time.gmtime())
    for name in options.formats:
        with tempfile.TemporaryDirectory() as folder:
            rows += [{**row, "run": begun} for row in rows_of(name, Path(folder), options.minutes)]
        if options.out is not None:
            keep(rows, options.out)
    with tempfile.TemporaryDirectory() as folder:
        WRITERS["PX4 ULog"][1](Path(folder) / "short.ulg", 1.0)
        against_libraries(Path(folder) / "short.ulg")
    dataflash_against_library()
    over = [f"{row['format']} ({row['read']})" for row in rows if not row["within"]]
    if over:
        raise SystemExit(f"more than {FACTOR:g} times the samples used: {', '.join(over)}")


if __name__ == "__main__":
    main()
