"""Logs of the Crazyflie, its own and of the room it flew in: planted flights come back, measured ones obey physics."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.errors import BadInput
from groundstation.frames import quat_rotate, slerp
from groundstation.paths import configs_dir
from groundstation.recording import load_flight, read_recording
from groundstation.recording.derive import body_rates
from groundstation.vehicle import load_vehicle
from tests.recording_flight import changes_agree, flight
from tests.test_recording_autopilots import same_attitude

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not at {DATA}")


def usd(rows, variables, version=2, event=b"fixedFrequency"):
    """A usd log from rows of (time in its unit, values...)."""
    out = bytearray(struct.pack("<BHHH", 0xBC, version, 2, 0xFFFF) + event + b"\0" + struct.pack("<H", len(variables)))
    out += b"".join(f"{name}({kind})".encode() + b"\0" for name, kind in variables)
    out += struct.pack("<H", 12) + b"modeChanged\0" + struct.pack("<H", 1) + b"mode(B)\0"
    packer = struct.Struct("<H" + ("I" if version == 1 else "Q") + "".join(kind for _, kind in variables))
    for k, row in enumerate(rows):
        out += packer.pack(0xFFFF, *row)
        if k % 7 == 3:  # events of another kind lie between
            out += struct.pack("<H" + ("I" if version == 1 else "Q") + "B", 12, row[0], 1)
    return bytes(out) + struct.pack("<I", zlib.crc32(bytes(out)))


IMU_VARIABLES = [
    *((f"acc.{axis}", "f") for axis in "xyz"),
    *((f"gyro.{axis}", "f") for axis in "xyz"),
    *((f"motor.m{i}", "H") for i in range(1, 5)),
]


@pytest.fixture(scope="module")
def crazyflie():
    return load_vehicle(configs_dir() / "vehicles" / "crazyflie21.toml")


@pytest.mark.parametrize(("version", "per_second"), [(1, 1e3), (2, 1e6)])
def test_a_usd_log_is_decoded_by_its_own_header(tmp_path, crazyflie, version, per_second):
    rng = np.random.default_rng(0)
    t = (5.0 + np.arange(200) / 500.0) * per_second
    values = rng.normal(size=(200, 6)) * 0.01 + [0.0, 0.0, 1.0, 5.0, -7.0, 11.0]
    motors = rng.integers(20000, 40000, (200, 4))
    rows = [(int(t[k]), *values[k], *motors[k].tolist()) for k in range(200)]
    path = tmp_path / "log00"
    path.write_bytes(usd(rows, IMU_VARIABLES, version))
    loaded = load_flight(path, vehicle=crazyflie)
    assert loaded.notes == ()
    assert np.array_equal(loaded.imu.t_s, t.astype(np.int64) / per_second)
    assert np.allclose(loaded.imu.values[:, 3:], values[:, :3] * 9.80665, atol=1e-5)
    assert np.allclose(loaded.imu.values[:, :3], np.radians(values[:, 3:]), atol=1e-6)
    assert np.allclose(loaded.motors.values, motors / 65535.0)
    assert np.allclose(loaded.extras["usd_fixedFrequency"].column("gyro.y"), values[:, 4], atol=1e-5)


def test_commands_of_a_firmware_that_compensates_the_battery_are_the_voltage_its_motors_got(tmp_path, crazyflie):
    """motor.* asks for thrust, and pwm.* is what makes it: the same request at half the voltage is the same command."""
    widths = [f"pwm.m{i}_pwm" for i in range(1, 5)]
    variables = [*IMU_VARIABLES, *((name, "H") for name in widths), ("pm.vbatMV", "H")]
    still, asked = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [30000, 31000, 32000, 33000]
    rows = [
        (2000 * k, *still, *asked, *(v * (2 if k >= 50 else 1) for v in (10000, 11000, 12000, 13000)), volts)
        for k in range(100)
        for volts in [2000 if k >= 50 else 4000]
    ]
    path = tmp_path / "log00"
    path.write_bytes(usd(rows, variables))
    loaded = load_flight(path, vehicle=crazyflie)
    expected = np.array([10000, 11000, 12000, 13000]) / 65535.0 * 4.0 / crazyflie.battery.full_v
    assert np.allclose(loaded.motors.values, expected)
    assert any("voltage applied" in note for note in loaded.notes)
    unknown = crazyflie.model_copy(update={"battery": crazyflie.battery.model_copy(update={"full_v": None})})
    assert np.allclose(load_flight(path, vehicle=unknown).motors.values, np.array(asked) / 65535.0)


def test_a_usd_log_cut_off_is_read_up_to_the_cut(tmp_path, crazyflie):
    rows = [(1000 * k, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1, 2, 3, 4) for k in range(300)]
    data = usd(rows, IMU_VARIABLES)
    path = tmp_path / "log00"
    path.write_bytes(data[: len(data) // 2])
    recording = read_recording(path, crazyflie)
    assert 100 < len(recording.streams["imu"]) < 160
    assert any("cut off" in note for note in recording.notes)


def test_a_usd_log_without_motors_or_with_a_broken_header_is_refused(tmp_path, crazyflie):
    path = tmp_path / "log00"
    path.write_bytes(usd([(1, 1.0)], [("acc.x", "f")]))
    with pytest.raises(BadInput, match=r"no motor values.*acc\.x"):
        load_flight(path, vehicle=crazyflie)
    path.write_bytes(struct.pack("<BHH", 0xBC, 2, 9) + b"\xff" * 30)
    with pytest.raises(BadInput, match="header is damaged"):
        load_flight(path, vehicle=crazyflie)


def test_a_usd_log_asks_for_the_vehicle_it_does_not_carry(tmp_path):
    path = tmp_path / "log00"
    path.write_bytes(usd([(1, *[0.0] * 6, 1, 2, 3, 4)], IMU_VARIABLES))
    with pytest.raises(BadInput, match="--vehicle"):
        load_flight(path)


def test_pitch_is_found_again_from_acceleration_and_yaw(tmp_path, crazyflie):
    """A planted flight whose thrust is the only force besides gravity: the derived pitch is the true one."""
    made = flight(4.0)
    q = made.state.values[:, 6:10]
    from groundstation.frames import euler_from_quat

    roll, pitch, yaw = euler_from_quat(q).T
    direction = quat_rotate(q, np.broadcast_to([0.0, 0.0, 1.0], (len(q), 3)))
    thrust = 1.0 + 0.1 * np.sin(np.arange(len(q)) / 9.0)
    acceleration = direction * thrust[:, None] - [0.0, 0.0, 1.0]  # in g, gravity removed
    names = ["x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "roll", "yaw"]
    columns = np.column_stack([made.state.values[:, :6], acceleration, np.degrees(roll), np.degrees(yaw)])
    rows = [(10_000 * k, *columns[k], 1, 2, 3, 4) for k in range(len(q))]
    variables = [*((f"stateEstimate.{name}", "f") for name in names), *IMU_VARIABLES[6:]]
    path = tmp_path / "log00"
    path.write_bytes(usd(rows, variables))
    loaded = load_flight(path, vehicle=crazyflie)
    derived = euler_from_quat(loaded.state.values[:, 6:10])
    assert np.allclose(derived[:, 1], pitch, atol=2e-4)
    assert np.allclose(derived[:, 0], roll, atol=1e-5)
    assert any("pitch was not logged" in note for note in loaded.notes)
    assert any("misses the logged roll by 0.0 degrees" in note for note in loaded.notes)


def test_rates_from_attitude_are_exact_for_a_constant_rate():
    rate = np.array([0.7, -1.3, 2.1])
    t = np.sort(np.random.default_rng(1).uniform(0.0, 2.0, 50))
    angle = np.linalg.norm(rate) * t
    q = np.column_stack([np.cos(angle / 2), np.sin(angle / 2)[:, None] * rate / np.linalg.norm(rate)])
    assert np.allclose(body_rates(t, q), rate, atol=1e-9)
    at = np.linspace(t[0], t[-1], 33)
    angle = np.linalg.norm(rate) * at
    truth = np.column_stack([np.cos(angle / 2), np.sin(angle / 2)[:, None] * rate / np.linalg.norm(rate)])
    assert same_attitude(slerp(at, t, q), truth, 1e-6)


@needs_data
def test_the_measured_crazyflie_turns_the_way_its_rotors_push(crazyflie):
    flown = load_flight(DATA / "crazyflie-1khz" / "log15", vehicle=crazyflie, start_s=55.0, end_s=90.0)
    assert flown.imu.rate_hz() == pytest.approx(1000.0, rel=0.02)
    assert np.median(flown.imu.column("accel_z_m_s2")) == pytest.approx(9.8, abs=1.0)
    assert min(changes_agree(flown, crazyflie, 0.04, (0, 1))) > 0.6
    yaw = load_flight(DATA / "crazyflie-1khz" / "log16", vehicle=crazyflie, start_s=32.0, end_s=38.0)
    assert changes_agree(yaw, crazyflie, 0.04, (2,))[0] > 0.6


@needs_data
@pytest.mark.parametrize("name", ["normal_flight/E9_log00", "cut_propeller_M3_4mm_4mm_39mm/E8_log01"])
def test_the_measured_crazypad_flights_are_read(crazyflie, name):
    flown = load_flight(DATA / "crazypad" / name, vehicle=crazyflie)
    assert flown.imu is None
    assert 3.0 < np.median(flown.battery.column("voltage_v")) < 4.3
    moving = flown.state.column("z_m") > 0.2
    velocity = np.gradient(flown.state.column("x_m"), flown.state.t_s)
    assert np.corrcoef(velocity[moving], flown.state.column("vx_m_s")[moving])[0, 1] > 0.9
    assert any("pitch was not logged" in note for note in flown.notes)


def usd_events(events, version=2):
    """A usd log of several events: name to (variables, rows of (time, values...)), written in order of time."""
    out = bytearray(struct.pack("<BHH", 0xBC, version, len(events)))
    records = []
    for number, (name, (variables, rows)) in enumerate(events.items(), start=1):
        out += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        out += b"".join(f"{variable}({kind})".encode() + b"\0" for variable, kind in variables)
        packer = struct.Struct("<HQ" + "".join(kind for _, kind in variables))
        records += [(row[0], packer.pack(number, *row)) for row in rows]
    out += b"".join(record for _, record in sorted(records, key=lambda item: item[0]))
    return bytes(out) + struct.pack("<I", zlib.crc32(bytes(out)))


@pytest.mark.parametrize(("name", "kind", "volts"), [("pm.vbat", "f", 3.6), ("pm.vbatMV", "H", 3600)])
@pytest.mark.parametrize("apart", [False, True])
def test_the_batterys_voltage_counts_by_name_and_unit_in_whichever_event(tmp_path, crazyflie, name, kind, volts, apart):
    widths = [(f"pwm.m{i}_pwm", "H") for i in range(1, 5)]
    still, sent = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [10000, 11000, 12000, 13000]
    own = [] if apart else [(name, kind)]
    rows = [(1000 * k, *still, 30000, 31000, 32000, 33000, *sent, *([] if apart else [volts])) for k in range(200)]
    events = {"fixedFrequency": ([*IMU_VARIABLES, *widths, *own], rows)}
    if apart:
        events["battery"] = ([(name, kind)], [(100_000 * k, volts) for k in range(3)])
    path = tmp_path / "log00"
    path.write_bytes(usd_events(events))
    recording = read_recording(path, crazyflie)
    expected = np.array(sent) / 65535.0 * 3.6 / crazyflie.battery.full_v
    assert np.allclose(recording.streams["motors"].values, expected, rtol=1e-6)
    assert recording.streams["battery"].values[:, 0] == pytest.approx(3.6)
    assert any("voltage applied" in note and name in note for note in recording.notes)


def test_pwm_without_a_voltage_is_told_not_dropped(tmp_path, crazyflie):
    widths = [(f"pwm.m{i}_pwm", "H") for i in range(1, 5)]
    rows = [(1000 * k, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, *[30000] * 4, *[20000] * 4) for k in range(50)]
    path = tmp_path / "log00"
    path.write_bytes(usd_events({"fixedFrequency": ([*IMU_VARIABLES, *widths], rows)}))
    assert any("not used: no voltage is logged" in note for note in read_recording(path, crazyflie).notes)


def test_a_field_that_a_usd_log_lacks_is_named_and_events_apart_are_joined(tmp_path, crazyflie):
    motors = [(1000 * k, 1, 2, 3, 4) for k in range(100)]
    gyro = [(1000 * k + 300, 5.0, 6.0, 7.0) for k in range(100)]
    events = {
        "motors": ([(f"motor.m{i}", "H") for i in range(1, 5)], motors),
        "gyro": ([(f"gyro.{axis}", "f") for axis in "xyz"], gyro),
    }
    path = tmp_path / "log00"
    path.write_bytes(usd_events(events))
    recording = read_recording(path, crazyflie)
    assert "imu" not in recording.streams
    assert any("imu: left out: the configuration of this log has no field acc.x" in n for n in recording.notes)
    events["acc"] = ([(f"acc.{axis}", "f") for axis in "xyz"], [(2000 * k, 0.0, 0.0, 1.0) for k in range(60)])
    path.write_bytes(usd_events(events))
    recording = read_recording(path, crazyflie)
    assert len(recording.streams["imu"]) == 100
    assert np.allclose(recording.streams["imu"].values[:, 5], 9.80665)


WAVES = {f"{stem}.{axis}": 3 * i + j for i, stem in enumerate(("gyro", "acc")) for j, axis in enumerate("xyz")}


def in_events(path, crazyflie, *events):
    """A log of ten seconds of waves: each event has its variables, its rate and its start; the recording."""
    made = {}
    for number, (names, rate_hz, start_s) in enumerate(events):
        t = np.arange(start_s, 10.0, 1.0 / rate_hz)
        columns = [
            (40000 + 9000 * np.sin(t + k)).astype(int) if name.startswith("motor") else np.sin(t + WAVES[name])
            for k, name in enumerate(names)
        ]
        rows = [(round(1e6 * x), *(c[i].item() for c in columns)) for i, x in enumerate(t)]
        made[f"event{number}"] = ([(n, "H" if n.startswith("motor") else "f") for n in names], rows)
    path.write_bytes(usd_events(made))
    return read_recording(path, crazyflie)


GYRO, ACC, MOTOR = list(WAVES)[:3], list(WAVES)[3:], [f"motor.m{i}" for i in range(1, 5)]


def test_nothing_is_made_up_where_an_event_has_not_begun_or_is_slower(tmp_path, crazyflie):
    path = tmp_path / "log00"
    imu = in_events(path, crazyflie, (GYRO, 500, 0.0), (ACC, 500, 5.0), (MOTOR, 500, 0.0)).streams["imu"]
    assert imu.t_s[0] == 5.0
    assert np.allclose(imu.values[:, 3], 9.80665 * np.sin(imu.t_s + 3), atol=1e-4)
    slow = in_events(path, crazyflie, (GYRO, 500, 0.0), (ACC, 5, 0.0), (MOTOR, 5, 0.0))
    assert slow.streams["imu"].rate_hz() == pytest.approx(5.0)
    for name in ("imu", "motors"):
        assert any(note.startswith(f"{name}: 5 Hz is too slow") for note in slow.notes), slow.notes
    split = in_events(path, crazyflie, ([*GYRO, *ACC, MOTOR[0]], 500, 0.0), (MOTOR[1:], 5, 0.0))
    assert split.streams["motors"].rate_hz() == pytest.approx(5.0)
    apart = in_events(path, crazyflie, (GYRO, 500, 0.0), (MOTOR, 500, 0.0), (ACC, 500, 9.999))
    assert len(apart.streams.get("imu", ())) == 0
    assert any("no field acc.z at the time of gyro.x" in note for note in apart.notes)


def test_a_usd_log_of_a_version_to_come_is_named(tmp_path, crazyflie):
    path = tmp_path / "log00"
    path.write_bytes(struct.pack("<BHH", 0xBC, 3, 1) + bytes(40))
    with pytest.raises(BadInput, match="usd log of version 3"):
        read_recording(path, crazyflie)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    split=st.lists(st.integers(0, 2), min_size=10, max_size=10),
    order=st.permutations(range(10)),
    millivolts=st.booleans(),
    version=st.just(2),
)
def test_any_split_of_the_variables_into_events_gives_the_same_streams(
    tmp_path_factory, crazyflie, split, order, millivolts, version
):
    """IMU, motors and pwm in up to three events of one clock, the variables in any order, the voltage in either
    unit.
    """
    t = np.arange(0, 200_000, 1000)
    wave = np.sin(np.arange(10)[:, None] + t / 3e4)
    names = [*(f"acc.{a}" for a in "xyz"), *(f"gyro.{a}" for a in "xyz"), *(f"motor.m{i}" for i in range(1, 5))]
    columns = {name: (30000 + 9000 * w).round() if "motor" in name else w for name, w in zip(names, wave, strict=True)}
    columns |= {f"pwm.m{i}_pwm": np.full(len(t), 20000.0 + i) for i in range(1, 5)}
    columns |= {"pm.vbatMV": np.full(len(t), 3700.0)} if millivolts else {"pm.vbat": np.full(len(t), 3.7)}
    events = {}
    for number in range(3):
        mine = [names[i] for i in order if split[i] == number]
        mine += [name for name in columns if name not in names] if number == 0 else []
        if mine:
            kinds = [(name, "f" if name.startswith(("acc", "gyro")) or name == "pm.vbat" else "H") for name in mine]
            cast = {"f": float, "H": int}
            rows = [(int(x), *(cast[k](columns[n][i]) for n, k in kinds)) for i, x in enumerate(t)]
            events[f"event{number}"] = (kinds, rows)
    path = tmp_path_factory.mktemp("usd") / "log00"
    path.write_bytes(usd_events(events, version))
    streams = read_recording(path, crazyflie).streams
    applied = (20000.0 + np.arange(1, 5)) / 65535.0 * 3.7 / crazyflie.battery.full_v
    assert np.allclose(streams["motors"].values, applied, rtol=1e-6)
    assert np.allclose(streams["imu"].values[:, 3:], wave[:3].T * 9.80665, atol=1e-5)
    assert np.allclose(streams["imu"].values[:, :3], np.radians(wave[3:6].T), atol=1e-6)
