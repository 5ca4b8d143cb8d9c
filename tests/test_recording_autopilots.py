"""Logs of PX4 and ArduPilot: planted flights come back in this program's frames, order and units; measured ones obey
physics.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.flightdata import resampled
from groundstation.frames import matrix_from_quat, quat_rotate
from groundstation.paths import configs_dir
from groundstation.recording import convert, load_flight
from groundstation.recording.derive import body_rates
from groundstation.recording.recorded import vehicle_file
from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.mavlink.dataflash import DataFlashWriter
from sim.mavlink.ulog import ULogWriter
from tests.recording_flight import changes_agree, flight

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not at {DATA}")

# A quadrotor whose file lists its rotors in another order than the autopilot: rear left, front right, front left, rear
# right.
POSITIONS = [[-0.17, 0.17, 0.0], [0.17, -0.17, 0.0], [0.17, 0.17, 0.0], [-0.17, -0.17, 0.0]]
MOTOR_OF_ROTOR = [1, 0, 2, 3]


def quad(kind="command", **rotors):
    document = vehicle_to_dict(flight().vehicle)
    document["rotors"] |= {"position_m": POSITIONS, "spin": [1, 1, -1, -1], "input": kind, **rotors}
    return vehicle_from_dict(document)


def to_ned(vector):
    return vector @ np.diag([1.0, -1.0, -1.0])


def ned_quaternion(quaternion):
    """Through matrices, as an independent route: R_ned_frd = F R F with F = diag(1, -1, -1)."""
    from groundstation.frames import quat_from_matrix

    flip = np.diag([1.0, -1.0, -1.0])
    return quat_from_matrix(flip @ matrix_from_quat(quaternion) @ flip)


def same_attitude(one, other, tolerance):
    return np.all(np.abs(np.sum(one * other, axis=1)) > math.cos(0.5 * tolerance))


ULOG_FORMATS = {
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] accelerometer_m_s2;",
    "actuator_motors": "uint64_t timestamp;uint64_t timestamp_sample;float[12] control;",
    "vehicle_attitude_groundtruth": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;",
    "vehicle_local_position_groundtruth": "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;",
    "battery_status": "uint64_t timestamp;float voltage_v;float current_a;",
    "trajectory_setpoint": "uint64_t timestamp;float[3] position;float yaw;",
}
QUAD_X_PARAMETERS = [
    ("CA_ROTOR_COUNT", False, 4),
    *((f"CA_ROTOR{i}_PX", True, x) for i, x in enumerate((1.0, -1.0, 1.0, -1.0))),
    *((f"CA_ROTOR{i}_PY", True, y) for i, y in enumerate((1.0, -1.0, -1.0, 1.0))),  # FRD: y to the right
    *((f"CA_ROTOR{i}_KM", True, k) for i, k in enumerate((0.05, 0.05, -0.05, -0.05))),
    ("SIH_MASS", True, 1.2345),
]


def microseconds(t_s):
    return [round(t * 1e6) for t in t_s]


def write_ulog(path, made, *, motor_step=1, parameters=QUAD_X_PARAMETERS, thrust=None):
    log = ULogWriter(0, ULOG_FORMATS, {"sys_name": "PX4"}, list(parameters))
    imu = np.hstack([to_ned(made.imu.values[:, :3]), to_ned(made.imu.values[:, 3:])])
    for t, row in zip(microseconds(made.imu.t_s + 0.002), imu, strict=True):
        log.add("sensor_combined", t, *row[:3], 4000, *row[3:])
    command = motor_commands(made) if thrust is None else thrust
    for t, row in zip(microseconds(made.motors.t_s)[::motor_step], command[::motor_step], strict=True):
        log.add("actuator_motors", t, t, *row, *[math.nan] * 8)
    position, q = to_ned(made.mocap.values[:, :3]), ned_quaternion(made.mocap.values[:, 3:])
    for k, t in enumerate(microseconds(made.mocap.t_s + 10.0)):
        log.add("vehicle_attitude_groundtruth", t, t, *q[k])
        if k % 2 == 0:
            log.add("vehicle_local_position_groundtruth", t, t, *position[k])
    for t, row in zip(microseconds(made.battery.t_s), made.battery.values, strict=True):
        log.add("battery_status", t, row[0], -1.0)
    for t, row in zip(microseconds(made.setpoint.t_s), made.setpoint.values, strict=True):
        log.add("trajectory_setpoint", t, *to_ned(row[:3]), -row[3])
    path.write_bytes(bytes(log.data))
    return path


def motor_commands(made):
    """The autopilot's own order, each motor with a level of its own."""
    return 0.3 + 0.1 * np.arange(4) + 0.02 * np.sin(made.motors.t_s)[:, None]


@pytest.fixture(scope="module")
def made():
    return flight(3.0)


def test_a_px4_log_comes_back_in_our_frames_order_and_units(tmp_path, made):
    loaded = load_flight(write_ulog(tmp_path / "a.ulg", made), vehicle=quad())
    assert np.allclose(loaded.imu.values, made.imu.values, atol=1e-5)
    assert np.allclose(loaded.imu.t_s, made.imu.t_s, atol=2e-6)  # the middle of each 4 ms interval
    assert np.allclose(loaded.motors.values, motor_commands(made)[:, MOTOR_OF_ROTOR], atol=1e-6)
    assert loaded.motors.columns == ("m1_command", "m2_command", "m3_command", "m4_command")
    assert np.allclose(loaded.mocap.values[:, :3], made.mocap.values[::2, :3], atol=1e-5)
    assert same_attitude(loaded.mocap.values[:, 3:], made.mocap.values[::2, 3:], 1e-4)
    assert np.allclose(loaded.setpoint.values, made.setpoint.values, atol=1e-5)
    assert np.allclose(loaded.battery.values[:, 0], made.battery.values[:, 0], atol=1e-5)
    assert np.isnan(loaded.battery.values[:, 1]).all()  # -1 A: nobody measures it
    assert any("rotor 1 is motor 2" in note for note in loaded.notes)


def test_the_simulators_own_parameters_stay_out_of_what_is_declared(tmp_path, made):
    loaded = load_flight(write_ulog(tmp_path / "a.ulg", made), vehicle=quad())
    assert loaded.vehicle == quad()
    assert loaded.truth is None
    assert [key for key, value in loaded.metadata.items() if "1.234" in value] == ["simulator_parameters"]


def test_slow_motor_outputs_of_px4_are_told_with_the_setting(tmp_path, made):
    loaded = load_flight(write_ulog(tmp_path / "a.ulg", made, motor_step=25), vehicle=quad())
    assert any("motors: 10 Hz is too slow" in note and "SDLOG_PROFILE" in note for note in loaded.notes)


def test_disarmed_motors_stand_still_rather_than_count_as_missing(tmp_path, made):
    command = motor_commands(made)
    command[:100] = math.nan
    loaded = load_flight(write_ulog(tmp_path / "a.ulg", made, thrust=command), vehicle=quad())
    assert np.all(loaded.motors.values[:100] == 0.0)
    assert not any("not numbers" in note for note in loaded.notes)


@pytest.mark.parametrize("factor", [0.3, 1.0])
def test_the_thrust_curve_of_px4_is_undone(tmp_path, made, factor):
    """actuator_motors is a thrust; what reaches the ESC solves f u^2 + (1 - f) u = thrust."""
    parameters = [*QUAD_X_PARAMETERS, ("THR_MDL_FAC", True, factor)]
    loaded = load_flight(write_ulog(tmp_path / "a.ulg", made, parameters=parameters), vehicle=quad())
    u = loaded.motors.values
    assert np.allclose(factor * u**2 + (1.0 - factor) * u, motor_commands(made)[:, MOTOR_OF_ROTOR], atol=1e-6)


def test_a_px4_log_cut_in_a_message_is_read_and_said(tmp_path, made):
    path = write_ulog(tmp_path / "a.ulg", made)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3 + 1])
    loaded = load_flight(path, vehicle=quad())
    assert any("cut off" in note for note in loaded.notes)
    assert 0 < len(loaded.imu) <= len(made.imu)
    path.write_bytes(data)
    assert not any("cut off" in note for note in load_flight(path, vehicle=quad()).notes)


def test_commands_stand_in_for_speeds_that_nobody_measured(tmp_path, made):
    """What the contract says of a command without a curve: a fraction of top speed at the full battery's voltage."""
    path = write_ulog(tmp_path / "a.ulg", made)
    loaded = load_flight(path, vehicle=quad("rotor_speed", speed_max_rad_s=900.0))
    assert loaded.vehicle.rotors.input == "command"
    assert np.allclose(loaded.motors.values, motor_commands(made)[:, MOTOR_OF_ROTOR], atol=1e-6)
    assert any("rotor speeds are not recorded" in note for note in loaded.notes)
    speed_max_unknown = vehicle_to_dict(quad("rotor_speed"))
    del speed_max_unknown["rotors"]["speed_max_rad_s"]
    with pytest.raises(BadInput, match='input = "command"'):
        load_flight(path, vehicle=vehicle_from_dict(speed_max_unknown))


def test_such_a_log_converts_to_a_bundle_that_is_consistent(tmp_path, made):
    path = write_ulog(tmp_path / "a.ulg", made)
    (tmp_path / "quad.toml").write_bytes(vehicle_file(quad("rotor_speed")))
    convert(path, tmp_path / "b", vehicle=tmp_path / "quad.toml")
    assert load_flight(tmp_path / "b").vehicle.rotors.input == "command"


def test_another_number_of_motors_is_refused(tmp_path, made):
    hexa = quad(position_m=[*POSITIONS, [0.0, 0.2, 0.0], [0.0, -0.2, 0.0]], spin=[1, 1, -1, -1, 1, -1])
    with pytest.raises(BadInput, match=r"4 motors.*'qball2' has 6 rotors"):
        load_flight(write_ulog(tmp_path / "a.ulg", made), vehicle=hexa)


def test_turning_directions_that_disagree_are_told(tmp_path, made):
    loaded = load_flight(write_ulog(tmp_path / "a.ulg", made), vehicle=quad(spin=[-1, -1, 1, 1]))
    assert any("turn the other way" in note for note in loaded.notes)


DATAFLASH_FORMATS = {
    "PARM": (32, "QNff", "TimeUS,Name,Value,Default"),
    "IMU": (164, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "GYR": (165, "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ"),
    "ACC": (166, "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ"),
    "RCOU": (62, "QHHHHHHHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8,C9,C10,C11,C12,C13,C14"),
    "ESC": (86, "QBf", "TimeUS,Instance,RPM"),
    "BAT": (88, "QBff", "TimeUS,Inst,Volt,Curr"),
    "XKF1": (44, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
    "XKQ": (54, "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
    "VISP": (169, "QQIffffff", "TimeUS,RTimeUS,CTimeMS,PX,PY,PZ,R,P,Y"),
}


class _InOrder:
    """Collects records and writes them in order of time, as a vehicle does."""

    def __init__(self):
        self.records = []

    def add(self, name, t, *values):
        self.records.append((t, name, values))

    def file(self):
        log = DataFlashWriter(DATAFLASH_FORMATS)
        for t, name, values in sorted(self.records, key=lambda record: record[0]):
            log.add(name, t, *values)
        return bytes(log.data)


def write_dataflash(path, made, *, raw=False, first_output=1):
    log = _InOrder()
    for motor in range(4):
        log.add("PARM", 1, f"SERVO{first_output + motor}_FUNCTION".encode(), 33.0 + motor, 0.0)
    for name, value in (("MOT_PWM_MIN", 1000.0), ("MOT_PWM_MAX", 2000.0)):
        log.add("PARM", 1, name.encode(), value, 0.0)
    imu = np.hstack([to_ned(made.imu.values[:, :3]), to_ned(made.imu.values[:, 3:])])
    times = microseconds(made.imu.t_s)
    for k, (t, row) in enumerate(zip(times, imu, strict=True)):
        if raw:
            log.add("GYR", t + 300, 0, t, *row[:3])
            log.add("ACC", t + 400, 0, t, *row[3:])
        if not raw or k % 10 == 0:
            log.add("IMU", t, 0, *row)
            log.add("IMU", t, 1, *(row + 5.0))  # a second instance, to be left alone
    for k in range(0, len(times), 25):
        pulses = np.round(1000.0 + 1000.0 * motor_commands(made)[k]).astype(int).tolist()
        log.add("RCOU", times[k], *[1500] * (first_output - 1), *pulses, *[0] * (11 - first_output))
    for k in range(0, len(times), 3):
        for motor in range(4):
            log.add("ESC", times[k] + 50 * motor, motor, 1000.0 * (motor + 1))
    state = made.state.values
    for k in range(0, len(state), 10):
        t = microseconds(made.state.t_s[k : k + 1])[0]
        log.add("XKF1", t, 0, *to_ned(state[k, 3:6]), *to_ned(state[k, :3]))
        log.add("XKQ", t, 0, *ned_quaternion(state[k : k + 1, 6:10])[0])
    delays = np.random.default_rng(7).integers(4000, 12000, len(made.mocap))
    for k, t in enumerate(microseconds(made.mocap.t_s + 10.0)):
        roll, pitch, yaw = ned_euler_deg(made.mocap.values[k, 3:])
        position = to_ned(made.mocap.values[k, :3])
        log.add("VISP", t + int(delays[k]), t + 77_000_000, t // 1000, *position, roll, pitch, yaw)
    for t, row in zip(microseconds(made.battery.t_s), made.battery.values, strict=True):
        log.add("BAT", t, 0, *row)
    path.write_bytes(log.file())
    return path


def ned_euler_deg(quaternion):
    r = np.diag([1.0, -1.0, -1.0]) @ matrix_from_quat(quaternion) @ np.diag([1.0, -1.0, -1.0])
    angles = math.atan2(r[2, 1], r[2, 2]), -math.asin(r[2, 0]), math.atan2(r[1, 0], r[0, 0])
    return tuple(map(math.degrees, angles))


@pytest.mark.parametrize("first_output", [1, 5])
def test_an_ardupilot_log_comes_back_in_our_frames_order_and_units(tmp_path, made, first_output):
    path = write_dataflash(tmp_path / "a.bin", made, first_output=first_output)
    loaded = load_flight(path, vehicle=quad())
    assert np.allclose(loaded.imu.values, made.imu.values, atol=1e-5)
    assert np.allclose(loaded.motors.values, motor_commands(made)[::25, MOTOR_OF_ROTOR], atol=6e-4)
    assert np.allclose(loaded.mocap.values[:, :3], made.mocap.values[:, :3], atol=1e-5)
    assert same_attitude(loaded.mocap.values[:, 3:], made.mocap.values[:, 3:], 1e-4)
    # Stamps are spaced as the exposures were, whatever the delay of each pose on its way.
    assert np.allclose(np.diff(loaded.mocap.t_s), np.diff(made.mocap.t_s), atol=2e-6)
    assert np.allclose(loaded.state.values[:, :6], made.state.values[::10, :6][: len(loaded.state)], atol=1e-4)
    assert np.allclose(loaded.battery.values, made.battery.values, atol=1e-4)
    assert any("motors: 10 Hz is too slow" in note and "SERVO_OUTPUT_RAW" in note for note in loaded.notes)


def test_raw_imu_records_are_preferred_with_their_own_stamps(tmp_path, made):
    loaded = load_flight(write_dataflash(tmp_path / "a.bin", made, raw=True), vehicle=quad())
    assert len(loaded.imu) == len(made.imu)
    assert np.allclose(loaded.imu.t_s, made.imu.t_s, atol=2e-6)
    assert np.allclose(loaded.imu.values, made.imu.values, atol=1e-5)


def test_esc_telemetry_gives_rotor_speeds_in_the_files_order(tmp_path, made):
    vehicle = quad("rotor_speed")
    loaded = load_flight(write_dataflash(tmp_path / "a.bin", made), vehicle=vehicle)
    rpm = loaded.motors.values * 60.0 / (2.0 * np.pi)
    assert np.allclose(rpm, [2000.0, 1000.0, 3000.0, 4000.0])
    assert loaded.motors.rate_hz() == pytest.approx(83.3, abs=1.0)


def test_a_damaged_ardupilot_log_is_read_to_the_cut_or_refused(tmp_path, made):
    path = write_dataflash(tmp_path / "a.bin", made)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2 + 7])
    assert 0 < len(load_flight(path, vehicle=quad()).imu) < len(made.imu)
    path.write_bytes(data[:300])
    with pytest.raises(BadInput, match=r"a\.bin"):
        load_flight(path, vehicle=quad())


@pytest.mark.parametrize("name", ["a.ulg", "a.bin"])
def test_a_log_that_carries_no_vehicle_asks_for_one(tmp_path, made, name):
    path = tmp_path / name
    if name == "a.ulg":
        write_ulog(path, made)
    else:
        write_dataflash(path, made)
    with pytest.raises(BadInput, match="--vehicle"):
        load_flight(path)


def sih():
    document = vehicle_to_dict(load_vehicle(configs_dir() / "vehicles" / "x500.toml"))
    document["vehicle"] |= {"mass_kg": 1.0, "inertia_kg_m2": {"xx": 0.025, "yy": 0.025, "zz": 0.03}}
    document["rotors"] |= {"input": "command", "thrust_curve": [0.0, 5.0, 0.0], "torque_to_thrust_m": 0.02}
    document["rotors"]["position_m"] = [[0.2, -0.2, 0.0], [-0.2, 0.2, 0.0], [0.2, 0.2, 0.0], [-0.2, -0.2, 0.0]]
    return vehicle_from_dict(document)


@needs_data
def test_the_px4_flight_obeys_newton_in_our_frames():
    """Frames, signs, motor order and stamps at once: gravity and acceleration, attitude and gyro, rotors and
    rotation.
    """
    vehicle = sih()
    flown = load_flight(DATA / "px4-sih" / "excitation.ulg", vehicle=vehicle, start_s=25.0, end_s=58.0)
    pose, imu = flown.mocap, flown.imu
    # Specific force in the world is the second derivative of position plus gravity, both over 0.2 s.
    force = resampled(pose.t_s, imu.t_s, _smooth(imu.values[:, 3:], 50))
    world = quat_rotate(pose.values[:, 3:], force) - [0.0, 0.0, 9.80665]
    step = 5
    second = (pose.values[2 * step :, :3] - 2 * pose.values[step:-step, :3] + pose.values[: -2 * step, :3]) / 0.1**2
    middle = world[step:-step]
    for axis in range(3):
        assert np.corrcoef(second[:, axis], middle[:, axis])[0, 1] > 0.9, axis
        slope = np.sum(second[:, axis] * middle[:, axis]) / np.sum(middle[:, axis] ** 2)
        assert slope == pytest.approx(1.0, abs=0.15), axis
    turned = body_rates(pose.t_s, pose.values[:, 3:])
    gyro = resampled(pose.t_s, imu.t_s, _smooth(imu.values[:, :3], 10))
    for axis in range(3):
        assert np.corrcoef(turned[:, axis], gyro[:, axis])[0, 1] > 0.9, axis
    assert min(changes_agree(flown, vehicle, 0.04, (0, 1, 2))) > 0.6
    lift = np.interp(pose.t_s, flown.motors.t_s, np.sum(vehicle.thrust(flown.motors.values), axis=1))
    upright = matrix_from_quat(pose.values[:, 3:])[:, 2, 2]
    assert np.mean(lift * upright) == pytest.approx(9.80665, rel=0.03)  # 1 kg, on average neither rising nor falling


def _smooth(values, width):
    kernel = np.ones(width) / width
    return np.column_stack([np.convolve(column, kernel, mode="same") for column in values.T])


@needs_data
def test_the_default_ardupilot_log_says_what_is_too_slow_and_what_to_set():
    document = vehicle_to_dict(sih())
    document["rotors"]["position_m"] = [[0.0, -0.2, 0.0], [0.0, 0.2, 0.0], [0.2, 0.0, 0.0], [-0.2, 0.0, 0.0]]
    with pytest.raises(BadInput, match="frame is quad plus, and the rotors of 'x500' do not stand like that"):
        load_flight(DATA / "arducopter" / "circle-gps.bin", vehicle=sih())
    flown = load_flight(DATA / "arducopter" / "circle-gps.bin", vehicle=vehicle_from_dict(document))
    said = " ".join(flown.notes)
    assert "motors: 10 Hz is too slow" in said
    assert "imu: 25 Hz is too slow" in said
    assert "LOG_BITMASK" in said
    assert "SERVO_OUTPUT_RAW" in said
    assert np.median(flown.imu.column("accel_z_m_s2")) == pytest.approx(9.8, abs=0.2)
    circle = flown.state.values[flown.state.column("z_m") > 1.0, :2]
    assert np.ptp(circle, axis=0).max() == pytest.approx(1.4, abs=0.4)
