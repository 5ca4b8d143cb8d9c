"""One truth flight, written as three programs write it: the same identification within a standard deviation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation import api
from groundstation.recording import load_flight
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from sim.mavlink.dataflash import DataFlashWriter
from sim.mavlink.ulog import ULogWriter
from tests.recording_flight import flight
from tests.test_recording_autopilots import _InOrder, microseconds, ned_quaternion, to_ned

RPM = 30.0 / np.pi
ULOG = {
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] accelerometer_m_s2;",
    "vehicle_mocap_odometry": "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q;",
    "esc_report": "uint64_t timestamp;int32_t esc_rpm;uint8_t actuator_function;uint8_t[3] _padding0;",
    "esc_status": "uint64_t timestamp;esc_report[8] esc;",
}
DATAFLASH = {
    "PARM": (32, "QNf", "TimeUS,Name,Value"),
    "GYR": (165, "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ"),
    "ACC": (166, "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ"),
    "RCOU": (62, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "ESC": (86, "QBf", "TimeUS,Instance,RPM"),
    "SIM": (77, "Qffff", "TimeUS,Q1,Q2,Q3,Q4"),
    "SIM2": (78, "Qddd", "TimeUS,PN,PE,PD"),
}


@pytest.fixture(scope="module")
def made():
    """A flight of twelve seconds of a vehicle that is declared 6 % too heavy, its rotors as the file lists them."""
    whole = flight(12.0, scale=1.5)
    document = vehicle_to_dict(whole.vehicle)
    document["vehicle"]["mass_kg"] *= 1.06
    # One clock, as a vehicle's own log has.
    poses = replace(whole.mocap, t_s=whole.mocap.t_s / (1 + 2e-5) + 1.5 / (1 + 2e-5) + 3.25, received_s=None)
    alone = {"battery": None, "setpoint": None, "state": None, "plan": None, "window_s": None, "truth": None}
    return replace(
        whole,
        vehicle=vehicle_from_dict(document),
        mocap=poses,
        imu=replace(whole.imu, received_s=None),
        motors=replace(whole.motors, received_s=None),
        **alone,
    )


@pytest.fixture(scope="module")
def known(made):
    found = api.identify([made])
    return found.methods["OE"].parameters


def ulog(path, made, order, gaps=()):
    """A PX4 log of the flight; samples of the vehicle's own within the gaps (start, end) were never written."""

    def there(stream):
        return (
            stream.select(~np.any([(stream.t_s > a) & (stream.t_s < b) for a, b in gaps], axis=0)) if gaps else stream
        )

    made = replace(made, imu=there(made.imu), motors=there(made.motors))
    position = np.asarray(made.vehicle.rotors.position_m)[list(order)]
    spin = [made.vehicle.rotors.spin[i] for i in order]
    parameters = [("CA_ROTOR_COUNT", False, 4)]
    for i in range(4):
        parameters += [(f"CA_ROTOR{i}_PX", True, position[i, 0]), (f"CA_ROTOR{i}_PY", True, -position[i, 1])]
        parameters += [(f"CA_ROTOR{i}_KM", True, 0.05 * spin[i])]
    log = ULogWriter(0, ULOG, {"sys_name": "PX4"}, parameters)
    imu = np.hstack([to_ned(made.imu.values[:, :3]), to_ned(made.imu.values[:, 3:])])
    for t, row in zip(microseconds(made.imu.t_s), imu, strict=True):
        log.add("sensor_combined", t, *row[:3], 0, *row[3:])
    position, q = to_ned(made.mocap.values[:, :3]), ned_quaternion(made.mocap.values[:, 3:])
    for t, p, attitude in zip(microseconds(made.mocap.t_s), position, q, strict=True):
        log.add("vehicle_mocap_odometry", t, t, *p, *attitude)
    for t, row in zip(microseconds(made.motors.t_s), made.motors.values, strict=True):
        # The ESCs' places are another permutation, which their functions tell.
        reports = [(t, round(row[order[m]] * RPM), 101 + m, 0, 0, 0) for m in (2, 0, 3, 1)] + [(0, 0, 0, 0, 0, 0)] * 4
        log.add("esc_status", t, *[x for report in reports for x in report])
    path.write_bytes(bytes(log.data))


def dataflash(path, made, order):
    log = _InOrder()
    channels = (7, 5, 8, 6)
    parameters = {"FRAME_CLASS": 1, "FRAME_TYPE": 0, **{f"SERVO{c}_FUNCTION": 33 + m for m, c in enumerate(channels)}}
    for name, value in parameters.items():
        log.add("PARM", 1, name.encode(), float(value))
    imu = np.hstack([to_ned(made.imu.values[:, :3]), to_ned(made.imu.values[:, 3:])])
    for t, row in zip(microseconds(made.imu.t_s), imu, strict=True):
        log.add("GYR", t, 0, t, *row[:3])
        log.add("ACC", t, 0, t, *row[3:])
    position, q = to_ned(made.mocap.values[:, :3]), ned_quaternion(made.mocap.values[:, 3:])
    for t, p, attitude in zip(microseconds(made.mocap.t_s), position, q, strict=True):
        log.add("SIM", t, *attitude)
        log.add("SIM2", t, *p)
    for t, row in zip(microseconds(made.motors.t_s), made.motors.values, strict=True):
        for m, channel in enumerate(channels):
            log.add("ESC", t, channel - 1, row[order[m]] * RPM)
    writer = DataFlashWriter(DATAFLASH)
    for t, name, values in sorted(log.records, key=lambda record: record[0]):
        writer.add(name, t, *values)
    path.write_bytes(bytes(writer.data))


PLUS = [3, 2, 0, 1]
"""Rotors of the shipped QBall 2 (ahead, behind, left, right) as ArduPilot's motors of a quad plus: right, left, ahead,
behind.
"""


def agree(flown, known):
    found = api.identify([flown]).methods["OE"].parameters
    for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        assert abs(found[name].value - known[name].value) < known[name].std, name


def test_the_same_flight_from_a_px4_log(tmp_path, made, known):
    ulog(tmp_path / "a.ulg", made, (2, 0, 3, 1))
    agree(load_flight(tmp_path / "a.ulg", vehicle=made.vehicle), known)


def test_the_same_flight_from_an_ardupilot_log(tmp_path, made, known):
    dataflash(tmp_path / "a.bin", made, PLUS)
    agree(load_flight(tmp_path / "a.bin", vehicle=made.vehicle), known)


def test_gaps_of_a_px4_log_are_left_out_of_the_fit(tmp_path, made, known):
    """Three gaps of 0.4 to 0.6 s, in motors and IMU alike, as a slow card leaves them: told, left out, intervals
    hold.
    """
    start = made.motors.t_s[0]
    gaps = [(start + 2.0, start + 2.5), (start + 5.0, start + 5.6), (start + 8.5, start + 8.9)]
    ulog(tmp_path / "a.ulg", made, (0, 1, 2, 3), gaps)
    flown = load_flight(tmp_path / "a.ulg", vehicle=made.vehicle)
    assert any("motors: 3 gaps" in note for note in flown.notes)
    found = api.identify([flown])
    assert any("left out: 3 gaps" in note for note in found.quality)
    best = found.methods[found.best].parameters
    for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        assert abs(best[name].value - known[name].value) < 2.0 * np.hypot(best[name].std, known[name].std), name


@pytest.mark.parametrize(
    "lost",
    [
        {"imu": [(2.0, 2.5), (6.0, 6.4)]},
        {"imu": [(2.0, 2.3), (4.5, 5.3), (8.0, 8.55)]},
        {"imu": [(2.0, 2.5), (6.0, 6.4)], "motors": [(2.4, 2.9), (7.0, 7.6)], "mocap": [(4.0, 4.6)]},
    ],
)
def test_what_the_imu_did_not_see_is_not_integrated(tmp_path, made, known, lost):
    """Gaps of one stream alone, or of each at its own times: the biases that poses show are those of the whole flight.

    Integrated across its gaps, the IMU had an accelerometer bias of 1 m/s^2: mass 5 %, inertias 2 % off, 13 sigma.
    """
    start = made.motors.t_s[0]
    cut = {}
    for name, gaps in lost.items():
        stream = made.streams()[name]
        inside = np.any([(stream.t_s > start + a) & (stream.t_s < start + b) for a, b in gaps], axis=0)
        cut[name] = stream.select(~inside)
    ulog(tmp_path / "a.ulg", replace(made, **cut), (2, 0, 3, 1))
    found = api.identify([load_flight(tmp_path / "a.ulg", vehicle=made.vehicle)])
    assert any(f"{len(lost['imu'])} gaps of the motion's stream" in note for note in found.quality)
    for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        assert found.methods["OE"].parameters[name].value == pytest.approx(known[name].value, rel=0.005), name
