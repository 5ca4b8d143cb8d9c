"""Tables as strangers export them, by the map that their names fill in: the right value, or a sentence that asks."""

from __future__ import annotations

import random
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.errors import BadInput
from groundstation.frames import quat_from_euler
from groundstation.recording import read_recording, sources, tablefile
from groundstation.recording.mapping import load_map, read_mapped, template
from groundstation.recording.tablefile import read_table
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from sim.mavlink.dataflash import DataFlashWriter
from sim.mavlink.ulog import ULogWriter
from tests.recording_flight import flight
from tests.test_recording_settings import QUAD

K = 8
T = 2.0 + 0.004 * np.arange(K)
GYRO = np.column_stack([0.1 * np.arange(K), np.full(K, -0.2), np.full(K, 0.3)])
FORCE = np.column_stack([np.full(K, 0.5), np.full(K, -0.4), np.full(K, 9.80665)])
SPEED = 400.0 + np.arange(4 * K).reshape(K, 4)
DEG, RPM, G = 180.0 / np.pi, 30.0 / np.pi, 9.80665


def vehicle(kind="rotor_speed"):
    document = vehicle_to_dict(flight(0.1).vehicle)
    document["rotors"]["input"] = kind
    return vehicle_from_dict(document)


def write(path, names, columns, form="{:.12g}", separator=",", line=None, encoding="utf-8"):
    rows = [
        separator.join(form.format(x) if isinstance(x, float) else str(x) for x in row)
        for row in zip(*columns, strict=True)
    ]
    path.write_bytes("\n".join([separator.join(names), *([line] if line else []), *rows, ""]).encode(encoding))
    return path


def by_its_names(path, kind="rotor_speed"):
    """The log through the map that ``--map-template`` writes, unchanged; block by block it is the same."""
    (path.parent / "map.toml").write_text(template(path, vehicle(kind)), encoding="utf-8")
    wanted = load_map(path.parent / "map.toml")
    whole = read_mapped(path, wanted, vehicle(kind)).streams
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tablefile, "_LARGE_BYTES", 0)
        patch.setattr(tablefile, "_BLOCK", 600)
        patch.setattr(sources, "_ROWS", 3)
        blocks = read_mapped(path, wanted, vehicle(kind)).streams
    assert blocks.keys() == whole.keys()
    for name, stream in whole.items():
        assert np.array_equal(blocks[name].values, stream.values, equal_nan=True), name
    return whole


def check(streams, *, speed=SPEED, t=T):
    assert np.allclose(streams["imu"].values, np.hstack([GYRO, FORCE]), atol=1e-6)
    assert np.allclose(streams["motors"].values, speed, atol=1e-6)
    for name in ("imu", "motors"):
        assert np.allclose(streams[name].t_s - streams[name].t_s[0], t - t[0], atol=1e-9)


NUMBERS = [*(GYRO * DEG).T, *(FORCE / G).T, *(SPEED * RPM).T]
BRACKETS = [
    "Time [ms]",
    *(f"Gyro {a} [deg/s]" for a in "XYZ"),
    *(f"Acc {a} (g)" for a in "XYZ"),
    *(f"Motor {i} [rpm]" for i in range(1, 5)),
]
SUFFIXES = [
    "timestamp_us",
    *(f"gyro_{a}_dps" for a in "xyz"),
    *(f"accel_{a}_g" for a in "xyz"),
    *(f"rpm{i}" for i in range(4)),
]


def test_degrees_g_and_rpm_by_the_units_in_the_names(tmp_path):
    check(by_its_names(write(tmp_path / "a.csv", BRACKETS, [1e3 * T, *NUMBERS])))
    check(by_its_names(write(tmp_path / "b.csv", SUFFIXES, [1e6 * T, *NUMBERS])))


RATES = {"rad/s": 1.0, "deg/s": DEG, "dps": DEG, "mrad/s": 1e3}
FORCES = {"m/s^2": 1.0, "m/s2": 1.0, "g": 1.0 / G, "mg": 1e3 / G}
TURNS = {"rad/s": 1.0, "rpm": RPM, "Hz": 0.5 / np.pi}
TIMES = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
FORMS = ("{name} [{unit}]", "{name} ({unit})", "{name}[{unit}]")


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_any_order_units_names_and_separators_give_the_same_streams(tmp_path_factory, seed):
    rng = random.Random(seed)
    gyro, accel, motor = (
        rng.choice(["gyro_", "Gyro ", "omega."]),
        rng.choice(["acc_", "Accel ", "a."]),
        rng.choice("mrR"),
    )
    first, cells = rng.choice([0, 1]), []
    for i, axis in enumerate(rng.choice(("xyz", "XYZ"))):
        cells += [(f"{gyro}{axis}", rng.choice(list(RATES)), RATES, GYRO[:, i])]
        cells += [(f"{accel}{axis}", rng.choice(list(FORCES)), FORCES, FORCE[:, i])]
    names = {"m": "motor", "r": "rotor_", "R": "RPM"}
    for i in range(4):
        unit = "rpm" if motor == "R" else rng.choice(list(TURNS))
        cells += [(f"{names[motor]}{i + first}", unit, TURNS, SPEED[:, i])]
    cells += [("time", rng.choice(list(TIMES)), TIMES, T), ("note", "V", {"V": 1.0}, T)]
    rng.shuffle(cells)
    form = rng.choice(FORMS)
    header = [form.format(name=name, unit=unit) for name, unit, _, _ in cells]
    path = tmp_path_factory.mktemp("table") / "a.csv"
    separator = rng.choice(",;\t")
    write(path, header, [table[unit] * column for _, unit, table, column in cells], "{:.17g}", separator)
    if separator == ";" and rng.random() < 0.5:
        path.write_text(path.read_text().replace(".", ",") if "." not in "".join(header) else path.read_text())
    check(by_its_names(path))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
def test_a_line_of_units_below_the_names_and_other_encodings(tmp_path, encoding):
    names = ["t", *(f"omega_{a}" for a in "xyz"), *(f"a_{a}" for a in "xyz"), *(f"rotor{i}" for i in range(1, 5))]
    units = ",".join(["s", *["°/s"] * 3, *["g"] * 3, *["rpm"] * 4])
    check(by_its_names(write(tmp_path / "a.csv", names, [T, *NUMBERS], line=units, encoding=encoding)))


def test_semicolons_and_decimal_commas(tmp_path):
    path = write(tmp_path / "a.csv", BRACKETS, [1e3 * T, *NUMBERS], separator=";")
    path.write_text(path.read_text().replace(".", ","))
    check(by_its_names(path))


def test_names_in_a_comment_above_numbers_apart_by_tabs(tmp_path):
    path = write(tmp_path / "a.txt", ["# " + SUFFIXES[0], *SUFFIXES[1:]], [1e6 * T, *NUMBERS], separator="\t")
    path.write_text("# flown on Sunday\n" + path.read_text())
    check(by_its_names(path))


@pytest.mark.parametrize("missing", ["", "NaN", "N/A", "null", "-"])
def test_rows_of_other_series_are_no_samples_of_this_one(tmp_path, missing):
    """As PlotJuggler exports: one column of time for all, cells empty where a series has no sample."""
    names = [
        "__time",
        *(f"/imu/angular_velocity/{a}" for a in "xyz"),
        *(f"/imu/linear_acceleration/{a}" for a in "xyz"),
    ]
    names += [f"/motors/rpm[{i}]" for i in range(4)]
    imu = [
        f"{t:.6f}," + ",".join(f"{x:.9g}" for x in row) + ("," + missing) * 4
        for t, row in zip(T, np.hstack([GYRO, FORCE]), strict=True)
    ]
    motors = [
        f"{t + 0.001:.6f}" + ("," + missing) * 6 + "," + ",".join(f"{x:.9g}" for x in row)
        for t, row in zip(T, SPEED * RPM, strict=True)
    ]
    rows = [row for pair in zip(imu, motors, strict=True) for row in pair]
    (tmp_path / "a.csv").write_text("\n".join([",".join(names), *rows, ""]))
    check(by_its_names(tmp_path / "a.csv"))


def clock(seconds, form):
    hours, rest = divmod(seconds, 3600.0)
    minutes, s = divmod(rest, 60.0)
    half = "PM" if hours % 24 >= 12 else "AM"
    twelve = int(hours) % 12 or 12
    return form.format(h=int(hours) % 24, twelve=twelve, m=int(minutes), s=s, half=half)


@pytest.mark.parametrize(
    "form",
    [
        *("{h:02d}:{m:02d}:{s:06.3f}", "2026-11-29T{h:02d}:{m:02d}:{s:06.3f}Z", "2026-11-29 {h:02d}:{m:02d}:{s:06.3f}"),
        *(
            "{twelve}:{m:02d}:{s:06.3f} {half}",
            "11/29/2026 {twelve}:{m:02d}:{s:06.3f} {half}",
            "{twelve}:{m:02d}:{s:06.3f}",
        ),
    ],
)
@pytest.mark.parametrize("start", [12 * 3600.0 + 3599.99, 24 * 3600.0 - 0.01, 3600.0 * 13 - 0.01])
def test_times_of_day_over_noon_and_midnight(tmp_path, form, start):
    times = [clock(start + x, form) for x in T - T[0]]
    check(by_its_names(write(tmp_path / "a.csv", ["time", *BRACKETS[1:]], [times, *NUMBERS])))


def test_a_timetable_of_matlab(tmp_path):
    times = [f"{x:.3f} sec" for x in T]
    check(by_its_names(write(tmp_path / "a.csv", ["Time", *BRACKETS[1:]], [times, *NUMBERS])))


def test_euler_angles_stand_for_a_quaternion(tmp_path):
    angles = np.column_stack([0.01 * np.arange(K), np.full(K, -0.1), np.full(K, 2.0)])
    places = np.column_stack([T, -T, 0.1 * T])
    names = [
        "t_s",
        *(f"pos_{a}_mm" for a in "xyz"),
        *(f"{a} (deg)" for a in ("Roll", "Pitch", "Yaw")),
        *(f"rpm{i}" for i in range(1, 5)),
    ]
    streams = by_its_names(
        write(tmp_path / "a.csv", names, [T, *(1e3 * places).T, *(angles * DEG).T, *(SPEED * RPM).T])
    )
    assert np.allclose(streams["mocap"].values[:, :3], places)
    assert np.allclose(streams["mocap"].values[:, 3:], quat_from_euler(*angles.T))


def test_a_quaternion_goes_by_its_letters_whatever_their_order(tmp_path):
    q = quat_from_euler(0.1, -0.2, np.linspace(0.0, 1.0, K))
    names = ["t_s", *"xyz", *(f"orientation.{a}" for a in "xyzw"), *(f"m{i}" for i in range(1, 5))]
    streams = by_its_names(write(tmp_path / "a.csv", names, [T, T, T, T, *q[:, [1, 2, 3, 0]].T, *SPEED.T]))
    assert np.allclose(streams["mocap"].values[:, 3:], q)


def test_what_the_names_do_not_tell_is_left_to_whoever_knows(tmp_path):
    """Numbered elements of a quaternion, and gyro columns in a unit that no gyro has."""
    names = [
        "t_s",
        *"xyz",
        *(f"q[{i}]" for i in range(4)),
        *(f"gyro_{a} [V]" for a in "xyz"),
        *(f"rpm{i}" for i in range(1, 5)),
    ]
    text = template(write(tmp_path / "a.csv", names, [T, *[T] * 10, *SPEED.T]), vehicle())
    assert "# [mocap]" in text
    assert "# [imu]" in text
    assert "\n[motors]" in text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1.0,2.0,3.0\n2.0,3.0,4.0\n", "line 1 holds numbers; its first line must name the columns"),
        ("t,gyro,gyro\n1.0,2.0,3.0\n", "column gyro stands twice in line 1; rename or remove one"),
        ("t,a,b\n1.0,2.0\n1,2,3\n", "line 2 has 2 cells where line 1 names 3 columns"),
        ("time,what\nnoon,hover\nlater,land\n", "has no columns of numbers"),
        ("t;a\n1.234,5;2\n1.235,5;2\n", "may be thousands or decimals"),
    ],
)
def test_what_cannot_be_read_is_asked_for(text, said):
    with pytest.raises(BadInput, match=said):
        read_table(text.encode(), "a.csv")


def test_parquet_with_records_lists_and_times_of_its_own(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    vectors = {
        name: [dict(zip("xyz", row, strict=True)) for row in rows]
        for name, rows in (("angular_velocity", GYRO), ("linear_acceleration", FORCE))
    }
    times = pyarrow.array(np.round(T * 1e9).astype("int64"), pyarrow.int64()).cast(pyarrow.timestamp("ns"))
    table = pyarrow.table(
        {
            "time": times,
            "imu": [dict(zip(vectors, pair, strict=True)) for pair in zip(*vectors.values(), strict=True)],
            "rpm": (SPEED * RPM).tolist(),
        }
    )
    parquet.write_table(table, tmp_path / "a.parquet")
    check(by_its_names(tmp_path / "a.parquet"))


def test_the_state_is_that_of_the_core_that_flew_the_vehicle(tmp_path):
    """Core 0 of the filter drifts off by 100 m, and the vehicle changes to core 1."""
    log = DataFlashWriter(
        {
            "PARM": (32, "QNf", "TimeUS,Name,Value"),
            "RCOU": (62, "QHHHH", "TimeUS,C1,C2,C3,C4"),
            "IMU": (164, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
            "XKF1": (80, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
            "XKQ": (81, "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
            "XKF4": (82, "QBb", "TimeUS,C,PI"),
            "BAT": (83, "QBff", "TimeUS,Inst,Volt,Curr"),
        }
    )
    settings = {"FRAME_CLASS": 1, "FRAME_TYPE": 1, "MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000}
    for name, value in (settings | {f"SERVO{i}_FUNCTION": 32 + i for i in range(1, 5)}).items():
        log.add("PARM", 0, name.encode(), float(value))
    for k in range(100):
        log.add("RCOU", 10_000 * k, *([1500] * 4))
        log.add("IMU", 10_000 * k, 0, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
        for core in (0, 1):
            log.add("XKF1", 10_000 * k, core, 0.0, 0.0, 0.0, 100.0 * (core == 0), 0.0, 0.0)
            log.add("XKQ", 10_000 * k, core, 1.0, 0.0, 0.0, 0.0)
            log.add("XKF4", 10_000 * k, core, int(k > 20))
            log.add("BAT", 10_000 * k, core, 16.0 * core, 2.0)
    (tmp_path / "a.bin").write_bytes(bytes(log.data))
    recording = read_recording(tmp_path / "a.bin", QUAD)
    assert np.all(recording.streams["state"].values[:, :3] == 0.0)
    assert any(
        "changed its primary core 1 times; core 1 is read, which it was for 79%" in note for note in recording.notes
    )
    assert np.all(recording.streams["battery"].values[:, 0] == 16.0)


def test_the_battery_is_the_one_that_is_connected(tmp_path):
    """PX4 logs each battery that it is set up for as an instance of battery_status."""
    log = ULogWriter(
        0,
        {
            "actuator_motors": "uint64_t timestamp;uint64_t timestamp_sample;float[12] control;",
            "battery_status": "uint64_t timestamp;float voltage_v;float current_a;",
            "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t "
            "gyro_integral_dt;float[3] accelerometer_m_s2;",
        },
        {"sys_name": "PX4"},
        [],
    )
    data = bytearray(log.data)
    data += struct.pack("<HBBH14s", 17, ord("A"), 1, 9, b"battery_status")
    for k in range(10):
        now = 10_000 * k
        data += struct.pack("<HBHQQ12f", 2 + 64, ord("D"), 0, now, now, *[0.5] * 4, *[np.nan] * 8)
        data += struct.pack("<HBHQff", 2 + 16, ord("D"), 1, now, 0.0, 0.0)
        data += struct.pack("<HBHQff", 2 + 16, ord("D"), 9, now, 15.5, 3.0)
    (tmp_path / "a.ulg").write_bytes(bytes(data))
    battery = read_recording(tmp_path / "a.ulg", QUAD).streams["battery"]
    assert battery.values[0].tolist() == [15.5, 3.0]
