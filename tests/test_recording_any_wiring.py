"""One truth flight as usd logs, ROS 2 bags, blackbox logs and tables of any wiring: the same identification, or a
refusal with the cause.
"""

from __future__ import annotations

import random
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation import api
from groundstation.errors import Refused
from groundstation.flightdata import Stream, motor_columns
from groundstation.identification.declarations import check_declarations, go_on
from groundstation.recording import load_flight, read_recording
from groundstation.recording.airframes import BETAFLIGHT_QUAD_X
from groundstation.recording.mapping import load_map, read_mapped
from groundstation.recording.mcapfile import write_recording_as_mcap
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from tests.recording_flight import flight
from tests.test_recording_blackbox import log as blackbox
from tests.test_recording_blackbox import signed
from tests.test_recording_crazyflie import usd_events

rosbag = pytest.importorskip("tests.test_recording_rosbag")

RPM = 30.0 / np.pi
PLACES = 0.2 * BETAFLIGHT_QUAD_X.position


@pytest.fixture(scope="module")
def made():
    """Ten seconds of a quadrotor in X, declared 6 % too heavy, by its own sensors alone on one clock."""
    whole = flight(10.0, scale=1.5)
    document = vehicle_to_dict(whole.vehicle)
    document["rotors"] |= {
        "position_m": np.column_stack([PLACES, np.zeros(4)]).tolist(),
        "spin": list(BETAFLIGHT_QUAD_X.spin),
    }
    vehicle = vehicle_from_dict(document)
    wrench = whole.vehicle.thrust(whole.motors.values) @ whole.vehicle.allocation().T
    speed = np.sqrt(np.maximum(wrench @ vehicle.mixing().T, 0.01) / vehicle.rotors.thrust_coefficient_n_s2)
    document["vehicle"]["mass_kg"] *= 1.06
    alone = dict.fromkeys(("mocap", "battery", "setpoint", "state", "plan", "window_s", "truth"))
    motors = Stream(whole.motors.t_s, speed, motor_columns("rotor_speed", 4))
    return replace(
        whole,
        vehicle=vehicle_from_dict(document),
        motors=motors,
        imu=replace(whole.streams()["imu"], received_s=None),
        **alone,
    )


@pytest.fixture(scope="module")
def known(made):
    return api.identify([made]).methods["OE"].parameters


def agree(flown, known):
    found = api.identify([flown]).methods["OE"].parameters
    for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        assert abs(found[name].value - known[name].value) < known[name].std, name


def rewired(vehicle, order):
    """The same vehicle, its file listing the rotors in another order."""
    document = vehicle_to_dict(vehicle)
    for key in ("position_m", "spin"):
        document["rotors"][key] = [document["rotors"][key][i] for i in order]
    return vehicle_from_dict(document)


def write_usd(path, made, rng):
    """Variables in any order, each in one of three events, as floats of either size; motors as rpm."""
    t = np.round(1e6 * made.imu.t_s).astype(int)
    imu = made.imu.values * [*[180.0 / np.pi] * 3, *[1.0 / 9.80665] * 3]
    columns = {
        f"{stem}.{axis}": imu[:, 3 * i + j] for i, stem in enumerate(("gyro", "acc")) for j, axis in enumerate("xyz")
    }
    columns |= {f"rpm.m{i + 1}": column * RPM for i, column in enumerate(made.motors.values.T)}
    names = rng.sample(sorted(columns), len(columns))
    events = {}
    for number in range(3):
        mine = [(name, rng.choice("fd")) for name in names[number::3]]
        events[f"event{number}"] = (mine, [(int(x), *(float(columns[n][k]) for n, _ in mine)) for k, x in enumerate(t)])
    path.write_bytes(usd_events(events))
    return path


def write_bag(path, made, rng):
    """Either store, topics of any name and order; motors as rotor speeds."""

    def imu(row):
        def message(s, time):
            v, q, cov = s.types["geometry_msgs/msg/Vector3"], s.types["geometry_msgs/msg/Quaternion"], np.zeros(9)
            turn, force = v(*row[:3]), v(*row[3:])
            return s.types["sensor_msgs/msg/Imu"](
                rosbag.header(s, time), q(0.0, 0.0, 0.0, 1.0), cov, turn, cov, force, cov
            )

        return message

    def speeds(row):
        return lambda s, time: s.types["actuator_msgs/msg/Actuators"](
            rosbag.header(s, time), rosbag.NONE, row, rosbag.NONE
        )

    rows = zip(made.imu.t_s, made.imu.values, strict=True)
    turned = zip(made.motors.t_s, made.motors.values, strict=True)
    topics = [
        (f"/a{rng.randrange(99)}/imu", ("sensor_msgs/msg/Imu", [(x, imu(r)) for x, r in rows])),
        (f"/b{rng.randrange(99)}/x", ("actuator_msgs/msg/Actuators", [(x, speeds(r)) for x, r in turned])),
    ]
    rng.shuffle(topics)
    return rosbag.bag(path, rng.choice([rosbag.StoragePlugin.MCAP, rosbag.StoragePlugin.SQLITE3]), dict(topics))


def write_blackbox(path, made, rng, motors=None):
    """Fields in any order, any scale of gyro and accelerometer, any number of poles; pulses beside the electrical
    speeds.
    """
    poles, g, scale = (
        rng.choice((12, 14, 22, 28)),
        rng.choice((512, 2048, 4096)),
        rng.choice((1.0 / 16.4, 0.0305, 0.01)),
    )
    turning = np.round(np.degrees(made.imu.values[:, :3]) / scale)
    force = np.round(made.imu.values[:, 3:] / 9.80665 * g)
    electrical = np.round(made.motors.values * RPM * 0.5 * poles / 100.0)
    columns = {f"gyroADC[{i}]": turning[:, i] for i in range(3)} | {f"accSmooth[{i}]": force[:, i] for i in range(3)}
    columns |= {f"eRPM[{i}]": electrical[:, i] for i in range(4)}
    columns |= {f"motor[{i}]": np.full(len(force), 700.0) for i in range(4)} if motors is None else motors
    names = ["loopIteration", "time", *rng.sample(sorted(columns), len(columns))]
    columns |= {"loopIteration": np.arange(len(force)), "time": np.round(1e6 * made.imu.t_s)}
    table = np.column_stack([columns[name] for name in names]).astype(np.int64)
    every = rng.choice((16, 32, 128))
    frames = [
        ("I", b"".join(map(signed, row.tolist())))
        if k % every == 0
        else ("P", b"".join(map(signed, (row - table[k - 1]).tolist())))
        for k, row in enumerate(table)
    ]
    headers = {
        **{"Firmware revision": rng.choice(("Betaflight 4.5.0", "INAV 7.1.0")), "I interval": str(every)},
        "gyro_scale": "0x" + struct.pack(">f", scale).hex(),
        **{"acc_1G": str(g), "motor_poles": str(poles), "motorOutput": "48,2047", "motor_pwm_protocol": "6"},
    }
    path.write_bytes(blackbox(frames, names, headers=headers))
    return path


TIMES = {"s": 1.0, "ms": 1e3, "us": 1e6}


def write_table(path, made, rng):
    """Columns of any names, order, factor, offset and frame, with others between; beside it the map that says so."""
    unit, frame, separator = rng.choice(list(TIMES)), rng.choice(["FLU", "FRD"]), rng.choice(",;\t")
    turned = 1.0 if frame == "FLU" else np.array([1.0, -1.0, -1.0])
    columns, sections = {}, {"motors": {}, "imu": {}}
    names = [f"c{i}" for i in rng.sample(range(99), 14)]

    def put(section, column, values):
        name, factor, offset = names.pop(), rng.choice([1.0, 0.5, 1e-3, 9.80665]), rng.choice([0.0, -1000.0, 7.0])
        columns[name] = values / factor - offset
        sections[section][column] = f'{{ column = "{name}", factor = {factor!r}, offset = {offset!r} }}'

    for i, values in enumerate(made.motors.values.T):
        put("motors", made.motors.columns[i], values)
    vectors = np.hstack([made.imu.values[:, :3] * turned, made.imu.values[:, 3:] * turned])
    for column, values in zip(made.imu.columns, vectors.T, strict=True):
        put("imu", column, values)
    time, *others = names
    columns |= {time: made.imu.t_s * TIMES[unit], **{name: np.full(len(made.imu), 3.0) for name in others}}
    order = rng.sample(sorted(columns), len(columns))
    rows = zip(*(map(repr, columns[name].tolist()) for name in order), strict=True)
    path.write_text("\n".join(map(separator.join, [order, *rows])) + "\n")
    path.with_suffix(".toml").write_text(
        "\n".join(
            f'[{section}]\ntime = "{time}"\ntime_unit = "{unit}"\nframe = "{frame}"\n[{section}.columns]\n'
            + "\n".join(f"{column} = {where}" for column, where in found.items())
            for section, found in sections.items()
        )
    )
    return path


WRITERS = {"log00": write_usd, "bag": write_bag, "a.bbl": write_blackbox, "a.csv": write_table}


def read(path, vehicle):
    """A log, or a table by its map."""
    if path.suffix != ".csv":
        return read_recording(path, vehicle)
    return read_mapped(path, load_map(path.with_suffix(".toml")), vehicle)


def loaded(path, vehicle):
    if path.suffix != ".csv":
        return load_flight(path, vehicle=vehicle)
    return load_flight(write_recording_as_mcap(read(path, vehicle), path.with_suffix(".mcap")), vehicle=vehicle)


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=8, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), order=st.permutations(range(4)))
def test_any_wiring_scale_and_order_gives_the_same_streams(tmp_path_factory, made, name, seed, order):
    """A usd log, a bag and a map say nothing of places: their motor i is rotor i.

    Betaflight's order is known, whatever the file's is.
    """
    short = replace(made, imu=made.imu.select(slice(0, 60)), motors=made.motors.select(slice(0, 60)))
    vehicle = rewired(made.vehicle, order) if name == "a.bbl" else made.vehicle
    path = WRITERS[name](tmp_path_factory.mktemp("log") / name, short, random.Random(seed))
    streams = read(path, vehicle).streams
    expected = short.motors.values[:, order] if name == "a.bbl" else short.motors.values
    step = 100.0 / 6.0 / RPM if name == "a.bbl" else 1e-3
    assert np.abs(streams["motors"].values - expected).max() <= 0.51 * step
    assert np.abs(streams["imu"].values - short.imu.values).max(axis=0) == pytest.approx(0.0, abs=0.011)
    assert np.allclose(streams["imu"].t_s, short.imu.t_s, atol=1e-6)


@pytest.mark.parametrize("name", WRITERS)
def test_the_same_flight_is_identified_alike_from_each_log(tmp_path, made, known, name):
    order = (2, 0, 3, 1) if name == "a.bbl" else (0, 1, 2, 3)
    path = WRITERS[name](tmp_path / name, made, random.Random(7))
    agree(loaded(path, rewired(made.vehicle, order)), known)


@pytest.mark.parametrize("name", ["log00", "bag", "a.csv"])
def test_motors_wired_otherwise_than_declared_are_refused_by_name_where_the_log_cannot_tell(tmp_path, made, name):
    path = WRITERS[name](tmp_path / name, made, random.Random(8))
    with pytest.raises(Refused, match="in another order"):
        go_on(check_declarations(loaded(path, rewired(made.vehicle, (2, 0, 3, 1)))))
