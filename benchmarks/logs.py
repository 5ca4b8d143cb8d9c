"""Speed and memory of the log readers: a long log, and our decoders against the libraries that others keep.

``python -m benchmarks.logs [--minutes 30]``. Ratios are of the same run. The limit of memory is six times the samples
that are used, as doubles; ``make bench`` prints it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

RATE_HZ = 1000.0
FACTOR = 6.0


def write_long_ulog(path: Path, minutes: float) -> None:
    """IMU, motors and attitude at 1 kHz: hovering, with a minute of motion in every five."""
    from sim.mavlink.ulog import ULogWriter

    count = int(minutes * 60.0 * RATE_HZ)
    formats = {
        "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] "
        "accelerometer_m_s2;",
        "actuator_motors": "uint64_t timestamp;uint64_t timestamp_sample;float[12] control;",
        "vehicle_attitude": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;",
    }
    x, y = (1.0, -1.0, 1.0, -1.0), (1.0, -1.0, -1.0, 1.0)
    parameters: list[tuple[str, bool, float]] = [("CA_ROTOR_COUNT", False, 4)]
    parameters += [(f"CA_ROTOR{i}_P{axis}", True, v[i]) for axis, v in (("X", x), ("Y", y)) for i in range(4)]
    parameters += [(f"CA_ROTOR{i}_KM", True, 0.05 if i < 2 else -0.05) for i in range(4)]
    head = bytes(ULogWriter(0, formats, {"sys_name": "PX4"}, parameters).data)
    with path.open("wb") as file:
        file.write(head)
        for first in range(0, count, 60_000):
            file.write(_block(np.arange(first, min(first + 60_000, count))))


def _block(k: np.ndarray) -> bytes:
    t_us, t_s = (k * 1000 + 1_000_000).astype("<u8"), k / RATE_HZ
    size = np.where(t_s % 300.0 < 60.0, 1.0, 0.1)[:, None]
    rng = np.random.default_rng(int(k[0]))
    imu = _records(0, len(k), [("t", "<u8"), ("gyro", "<f4", 3), ("dt", "<u4"), ("acc", "<f4", 3)])
    imu["t"], imu["dt"] = t_us, 1000
    imu["gyro"] = size * np.sin(t_s[:, None] * [2.0, 2.5, 1.5]) + 0.005 * rng.normal(size=(len(k), 3))
    imu["acc"] = 0.05 * rng.normal(size=(len(k), 3)) - [0.0, 0.0, 9.8]
    motors = _records(1, len(k), [("t", "<u8"), ("s", "<u8"), ("u", "<f4", 12)])
    motors["t"], motors["s"], motors["u"] = t_us, t_us, np.nan
    motors["u"][:, :4] = 0.5 + 0.1 * size * np.sin(t_s[:, None] * [2.0, 2.5, 1.5, 3.0])
    attitude = _records(2, len(k), [("t", "<u8"), ("s", "<u8"), ("q", "<f4", 4)])
    attitude["t"], attitude["s"], attitude["q"] = t_us, t_us, [1.0, 0.0, 0.0, 0.0]
    rows = [np.ascontiguousarray(part).view(np.uint8).reshape(len(k), -1) for part in (imu, motors, attitude)]
    return np.concatenate(rows, axis=1).tobytes()


def _records(topic: int, count: int, fields: list) -> np.ndarray:
    kind = np.dtype([("length", "<u2"), ("kind", "u1"), ("id", "<u2"), *fields])
    records = np.zeros(count, kind)
    records["length"], records["kind"], records["id"] = kind.itemsize - 3, ord("D"), topic
    return records


def read_long(path: Path, everything: bool) -> dict[str, float]:
    """In this process: seconds, peak memory and the samples used, in MB."""
    import resource

    from groundstation.paths import find_config
    from groundstation.recording import load_flight
    from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict

    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "x500")))
    document["rotors"]["input"] = "command"
    vehicle = vehicle_from_dict(document)
    base, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    flight = load_flight(path, vehicle=vehicle, everything=everything)
    used = sum(s.values.nbytes + s.t_s.nbytes for s in flight.streams().values())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base
    return {"s": time.monotonic() - begun, "peak_mb": peak / 1024.0, "used_mb": used / 2.0**20}


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


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--one", type=Path, help="read this log in this process")
    parser.add_argument("--all", action="store_true")
    options = parser.parse_args()
    if options.one is not None:
        print(json.dumps(read_long(options.one, options.all)))
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.ulg"
        write_long_ulog(path, options.minutes)
        for extra in ((), ("--all",)):
            command = [sys.executable, "-m", "benchmarks.logs", "--one", str(path), *extra]
            found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
            whole = found["used_mb"] if extra else None
            print(
                f"log of {options.minutes:g} min at 1 kHz ({path.stat().st_size / 1e6:.0f} "
                f"MB){' --all' if extra else ''}: "
                f"{found['s']:.1f} s, peak {found['peak_mb']:.0f} MB, samples used {found['used_mb']:.0f} MB"
                + (f", {found['peak_mb'] / whole:.1f} times (limit {FACTOR:g})" if whole else "")
            )
        short = Path(folder) / "short.ulg"
        write_long_ulog(short, 1.0)
        against_libraries(short)
    dataflash_against_library()


if __name__ == "__main__":
    main()
