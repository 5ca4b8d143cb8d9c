"""Long logs of every format, for what reading them takes: hovering, with a minute of motion in every five, at 1 kHz.

All have IMU and motors alone, written with NumPy a minute at a time; :data:`WRITERS` gives each by its name.
"""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

RATE_HZ = 1000.0
G = 9.80665
_AT_ONCE = 60_000


def motion(k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Microseconds, rates, specific force (z up) and commands of these samples."""
    t_s = k / RATE_HZ
    size = np.where(t_s % 300.0 < 60.0, 1.0, 0.1)[:, None]
    rng = np.random.default_rng(int(k[0]))
    turning = np.sin(t_s[:, None] * [2.0, 2.5, 1.5, 3.0])
    gyro = size * turning[:, :3] + 0.005 * rng.normal(size=(len(k), 3))
    force = 0.05 * rng.normal(size=(len(k), 3)) + [0.0, 0.0, G]
    return np.round(k * (1e6 / RATE_HZ)).astype(np.int64) + 1_000_000, gyro, force, 0.5 + 0.1 * size * turning


def _blocks(minutes: float) -> Iterator[np.ndarray]:
    count = int(minutes * 60.0 * RATE_HZ)
    for first in range(0, count, _AT_ONCE):
        yield np.arange(first, min(first + _AT_ONCE, count))


def _together(*parts: np.ndarray) -> bytes:
    """Records that are written one of each kind in turn."""
    return np.concatenate([np.ascontiguousarray(p).view(np.uint8).reshape(len(p), -1) for p in parts], axis=1).tobytes()


def write_ulog(path: Path, minutes: float) -> None:
    """PX4: sensor_combined, actuator_motors, vehicle_attitude."""
    from sim.mavlink.ulog import ULogWriter

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
    with path.open("wb") as file:
        file.write(bytes(ULogWriter(0, formats, {"sys_name": "PX4"}, parameters).data))
        for k in _blocks(minutes):
            t_us, gyro, force, u = motion(k)
            imu = _ulog(0, len(k), [("t", "<u8"), ("gyro", "<f4", 3), ("dt", "<u4"), ("acc", "<f4", 3)])
            imu["t"], imu["dt"], imu["gyro"], imu["acc"] = t_us, 0, gyro * [1, -1, -1], force * [1, -1, -1]
            motors = _ulog(1, len(k), [("t", "<u8"), ("s", "<u8"), ("u", "<f4", 12)])
            motors["t"], motors["s"], motors["u"] = t_us, t_us, np.nan
            motors["u"][:, :4] = u
            attitude = _ulog(2, len(k), [("t", "<u8"), ("s", "<u8"), ("q", "<f4", 4)])
            attitude["t"], attitude["s"], attitude["q"] = t_us, t_us, [1.0, 0.0, 0.0, 0.0]
            file.write(_together(imu, motors, attitude))


def _ulog(topic: int, count: int, fields: list) -> np.ndarray:
    kind = np.dtype([("length", "<u2"), ("kind", "u1"), ("id", "<u2"), *fields])
    records = np.zeros(count, kind)
    records["length"], records["kind"], records["id"] = kind.itemsize - 3, ord("D"), topic
    return records


def write_dataflash(path: Path, minutes: float) -> None:
    """ArduPilot: IMU of two instances and RCOU."""
    from sim.mavlink.dataflash import DataFlashWriter

    log = DataFlashWriter(
        {
            "IMU": (164, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
            "RCOU": (165, "QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8"),
            "PARM": (166, "QNff", "TimeUS,Name,Value,Default"),
        }
    )
    settings = {"FRAME_CLASS": 1, "FRAME_TYPE": 1, "MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000, "MOT_SPIN_MIN": 0.0}
    settings |= {f"SERVO{i}_FUNCTION": 32 + i for i in range(1, 5)}
    for name, value in settings.items():
        log.add("PARM", 0, name.encode(), float(value), 0.0)
    imu = np.dtype([("head", "u1", 3), ("t", "<u8"), ("i", "u1"), ("gyro", "<f4", 3), ("acc", "<f4", 3)])
    out = np.dtype([("head", "u1", 3), ("t", "<u8"), ("c", "<u2", 8)])
    with path.open("wb") as file:
        file.write(bytes(log.data))
        for k in _blocks(minutes):
            t_us, gyro, force, u = motion(k)
            rows = [np.zeros(len(k), imu), np.zeros(len(k), imu), np.zeros(len(k), out)]
            for number, (row, kind) in enumerate(zip(rows, (164, 164, 165), strict=True)):
                row["head"], row["t"] = [0xA3, 0x95, kind], t_us
                if kind == 164:
                    row["i"], row["gyro"], row["acc"] = number, gyro * [1, -1, -1], force * [1, -1, -1]
                else:
                    row["c"][:, :4] = np.round(1000.0 + 1000.0 * u)
            file.write(_together(*rows))


def write_blackbox(path: Path, minutes: float) -> None:
    """Betaflight: every frame whole (an I frame), every number in five bytes."""
    names = ["loopIteration", "time", *(f"{n}[{i}]" for n in ("gyroADC", "accSmooth") for i in range(3))]
    names += [f"motor[{i}]" for i in range(4)]
    lines = {
        "Product": "Blackbox flight data recorder by Nicholas Sherlock",
        "Firmware revision": "Betaflight 4.5.0",
        "Field I name": ",".join(names),
        "Field I signed": ",".join("0" if i < 2 else "1" for i in range(len(names))),
        **{f"Field {k} predictor": ",".join(["0"] * len(names)) for k in "IP"},
        **{f"Field {k} encoding": ",".join("1" if i < 2 else "0" for i in range(len(names))) for k in "IP"},
        **{"I interval": "1", "P interval": "1/1", "motorOutput": "48,2047", "motor_pwm_protocol": "6"},
        **{"gyro_scale": "0x" + struct.pack(">f", 0.06).hex(), "acc_1G": "2048"},
    }
    with path.open("wb") as file:
        file.write(b"".join(f"H {key}:{value}\n".encode() for key, value in lines.items()))
        for k in _blocks(minutes):
            t_us, gyro, force, u = motion(k)
            values = np.column_stack([np.degrees(gyro) / 0.06, force / G * 2048.0, 48.0 + 1999.0 * u])
            whole = np.round(values).astype(np.int64)
            numbers = np.column_stack([k, t_us, np.where(whole < 0, -2 * whole - 1, 2 * whole)])
            digits = (numbers[..., None] >> (7 * np.arange(5))) & 127 | [128, 128, 128, 128, 0]
            rows = np.column_stack([np.full(len(k), ord("I")), digits.reshape(len(k), -1)]).astype(np.uint8)
            file.write(rows.tobytes())
        file.write(b"E\xffEnd of log\0")


def write_usd(path: Path, minutes: float) -> None:
    """Crazyflie: one event with gyro, acc and motor."""
    names = [f"{stem}.{axis}" for stem in ("gyro", "acc") for axis in "xyz"] + [f"motor.m{i}" for i in range(1, 5)]
    kind = np.dtype([("id", "<u2"), ("t", "<u8"), ("v", "<f4", 6), ("m", "<u2", 4)])
    head = struct.pack("<BHHH", 0xBC, 2, 1, 0) + b"fixedFrequency\0" + struct.pack("<H", len(names))
    head += b"".join(f"{name}({'f' if i < 6 else 'H'})".encode() + b"\0" for i, name in enumerate(names))
    check = zlib.crc32(head)
    with path.open("wb") as file:
        file.write(head)
        for k in _blocks(minutes):
            t_us, gyro, force, u = motion(k)
            rows = np.zeros(len(k), kind)
            rows["t"], rows["v"], rows["m"] = t_us, np.hstack([np.degrees(gyro), force / G]), np.round(65535.0 * u)
            data = rows.tobytes()
            check = zlib.crc32(data, check)
            file.write(data)
        file.write(struct.pack("<I", check))


def _messages(minutes: float) -> Iterator[tuple[int, int, bytes]]:
    """Time of arrival, topic (1 of the IMU, 2 of the motors) and bytes of each message of a ROS 2 bag."""
    from groundstation.recording.cdr import ENCAPSULATION, imu, ros_stamp

    for k in _blocks(minutes):
        t_us, gyro, force, u = motion(k)
        for t, w, f, command in zip((1e-6 * t_us).tolist(), gyro.tolist(), force.tolist(), u.tolist(), strict=True):
            at_ns = round(t * 1e9) + 2_000_000
            yield at_ns, 1, imu(t, w, f)
            yield (
                at_ns,
                2,
                struct.pack("<4siII5s3xIII4d", ENCAPSULATION, *ros_stamp(t), 5, b"body\0", 0, 0, 4, *command),
            )


def write_bag(path: Path, minutes: float, *, ended: bool = True) -> None:
    """ROS 2: sensor_msgs/Imu and actuator_msgs/Actuators in one MCAP file."""
    from groundstation.recording.container import ContainerWriter
    from groundstation.recording.schemas import IMU

    header = IMU[IMU.index("=" * 80) :].split("MSG: geometry_msgs/Quaternion")[0].rstrip("=\n ")
    actuators = "std_msgs/Header header\nfloat64[] position\nfloat64[] velocity\nfloat64[] normalized\n" + header
    with path.open("wb", buffering=0) as file:
        writer = ContainerWriter(file, "ros2", "long_logs")
        writer.channel("/imu", "sensor_msgs/msg/Imu", IMU)
        writer.channel("/motors", "actuator_msgs/msg/Actuators", actuators)
        for at_ns, topic, data in _messages(minutes):
            writer.message(topic, at_ns, at_ns, data)
        if ended:
            writer.finish()
        else:
            writer.flush()


def write_cut_bag(path: Path, minutes: float) -> None:
    """The same without its index, as a recorder leaves it that was not ended."""
    write_bag(path, minutes, ended=False)


def write_sqlite_bag(path: Path, minutes: float) -> None:
    """The same in one sqlite file, as ROS 2 wrote bags before Iron."""
    with closing(sqlite3.connect(path)) as base, base:
        base.executescript(_ROSBAG2)
        base.executemany("INSERT INTO messages (timestamp, topic_id, data) VALUES (?, ?, ?)", _messages(minutes))


_ROSBAG2 = """
PRAGMA journal_mode = OFF;
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema VALUES (3, 'humble');
INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr', '');
INSERT INTO topics VALUES (2, '/motors', 'actuator_msgs/msg/Actuators', 'cdr', '');
"""


def write_recording(path: Path, minutes: float) -> None:
    """A recording of this program."""
    from drivers.samples import Imu, Motors
    from groundstation.recording import McapRecorder

    with McapRecorder(path) as recorder:
        for k in _blocks(minutes):
            t_us, gyro, force, u = motion(k)
            for t, w, f, command in zip((t_us / 1e6).tolist(), gyro.tolist(), force.tolist(), u.tolist(), strict=True):
                recorder.add(Imu(t, tuple(w), tuple(f)), t + 0.002)
                recorder.add(Motors(t, tuple(command), "command"), t + 0.002)


def write_bundle(path: Path, minutes: float) -> None:
    """A flight bundle: imu.csv and motors.csv."""
    from groundstation.flightdata import IMU_COLUMNS, motor_columns

    path.mkdir()
    with (path / "imu.csv").open("w") as imu, (path / "motors.csv").open("w") as motors:
        imu.write(",".join(("t_s", *IMU_COLUMNS)) + "\n")
        motors.write(",".join(("t_s", *motor_columns("command", 4))) + "\n")
        for k in _blocks(minutes):
            t_us, gyro, force, u = motion(k)
            for file, values in ((imu, np.hstack([gyro, force])), (motors, u)):
                rows = np.column_stack([1e-6 * t_us, values]).tolist()
                cells = (",".join([f"{t:.6f}", *(f"{x:.9g}" for x in row)]) for t, *row in rows)
                file.writelines(line + "\n" for line in cells)


_NAMES = ("time", *(f"gyro_{axis}" for axis in "xyz"), *(f"acc_{axis}" for axis in "xyz"), "m1", "m2", "m3", "m4")
_MAP = """
[motors]
time = "time"
time_unit = "us"
[motors.columns]
{motors}
[imu]
time = "time"
time_unit = "us"
[imu.columns]
{imu}
"""


def _with_map(path: Path) -> Path:
    motors = "\n".join(f'm{i}_command = "m{i}"' for i in range(1, 5))
    names = (("gyro", "rad_s", "gyro"), ("accel", "m_s2", "acc"))
    imu = "\n".join(f'{ours}_{axis}_{unit} = "{theirs}_{axis}"' for ours, unit, theirs in names for axis in "xyz")
    map_of(path).write_text(_MAP.format(motors=motors, imu=imu))
    return path


def map_of(path: Path) -> Path:
    """The map file of a table."""
    return path.with_suffix(".map.toml")


def write_table(path: Path, minutes: float) -> None:
    """Somebody's CSV file, with ten columns that nobody asks for beside the eleven that the map names."""
    with _with_map(path).open("w") as file:
        file.write(",".join((*_NAMES, *(f"other{i}" for i in range(_OTHERS)))) + "\n")
        rest = "," + ",".join(["0.25"] * _OTHERS) + "\n"
        for k in _blocks(minutes):
            t_us, gyro, force, u = motion(k)
            rows = np.hstack([gyro, force, u]).tolist()
            file.writelines(
                ",".join([str(t), *(f"{x:.9g}" for x in row)]) + rest
                for t, row in zip(t_us.tolist(), rows, strict=True)
            )


def write_parquet(path: Path, minutes: float) -> None:
    """The same as a Parquet file."""
    import pyarrow
    from pyarrow import parquet

    names = (*_NAMES, *(f"other{i}" for i in range(_OTHERS)))
    schema = pyarrow.schema([(name, pyarrow.float64()) for name in names])
    with parquet.ParquetWriter(_with_map(path), schema) as file:
        for k in _blocks(minutes):
            t_us, gyro, force, u = motion(k)
            others = np.random.default_rng(int(k[0])).normal(size=(len(k), _OTHERS))
            rows = np.column_stack([t_us.astype(float), gyro, force, u, others])
            file.write_table(pyarrow.table(dict(zip(names, rows.T, strict=True)), schema))


_OTHERS = 10

WRITERS: dict[str, tuple[str, Callable[[Path, float], None]]] = {
    "PX4 ULog": ("long.ulg", write_ulog),
    "ArduPilot DataFlash": ("long.bin", write_dataflash),
    "Betaflight blackbox": ("long.bbl", write_blackbox),
    "Crazyflie usd log": ("long_usd", write_usd),
    "ROS 2 bag (MCAP)": ("long.mcap", write_bag),
    "ROS 2 bag (MCAP, not ended)": ("cut.mcap", write_cut_bag),
    "ROS 2 bag (sqlite)": ("long.db3", write_sqlite_bag),
    "flight bundle (CSV)": ("long", write_bundle),
    "recording of this program": ("own.mcap", write_recording),
}
"""By format: the file's name, and what writes it."""
MAPPED: dict[str, tuple[str, Callable[[Path, float], None]]] = {
    "table by a map (CSV)": ("long.csv", write_table),
    "table by a map (Parquet)": ("long.parquet", write_parquet),
}
"""The same of tables that only a map file explains; they are converted to a recording."""
