"""What a log says is used: settings in their own time, outputs by their functions, scale by limits and protocol."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from groundstation.errors import BadInput
from groundstation.recording import read_recording
from groundstation.recording.airframes import ARDUPILOT
from groundstation.recording.px4_motors import thrust_curve
from groundstation.recording.settings import settings_of
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from tests.recording_flight import qball
from tests.written_logs import ArduLog, Px4Log, truth

STEP = 1.0 / 800.0  # a pulse is a whole microsecond, and limits lie 800 apart or more


def like(airframe, kind="command", spin=None):
    """A vehicle whose rotors stand where the airframe's motors do, in its order."""
    document = vehicle_to_dict(qball())
    position = np.column_stack([0.2 * airframe.position, np.zeros(airframe.count)])
    document["rotors"] |= {"position_m": position.tolist(), "spin": list(spin or airframe.spin), "input": kind}
    document["rotors"] |= {"speed_max_rad_s": 1000.0}
    return vehicle_from_dict(document)


QUAD = like(ARDUPILOT[1, 1])


def motors(tmp_path, log, name="a.ulg", vehicle=QUAD, made=None):
    t, u = truth(vehicle.rotors.count) if made is None else made
    (tmp_path / name).write_bytes(log.write(t, u))
    recording = read_recording(tmp_path / name, vehicle)
    return recording.streams["motors"], u, recording


def test_a_parameter_has_its_value_of_each_time():
    s = settings_of([("A", -np.inf, 1.0), ("B", 0.0, 5.0), ("A", 2.0, 1.0), ("A", 3.0, 2.0)])
    assert s.at("A", np.array([-1.0, 2.9, 3.0, 9.0])).tolist() == [1.0, 1.0, 2.0, 2.0]
    assert s.at("B", np.array([-9.0])).tolist() == [5.0]  # the first value held before it was told, too
    assert s.at("C", np.array([0.0, 1.0]), 7.0).tolist() == [7.0, 7.0]
    assert s.changes("A", 0.0, 10.0) == [(3.0, 1.0, 2.0)]
    assert s.changes("A", 3.0, 10.0) == []
    with pytest.raises(KeyError):
        s.at("C", np.array([0.0]))


def test_px4_outputs_are_scaled_by_their_own_limits(tmp_path):
    limits = {1: (1075.0, 1950.0), 2: (1075.0, 1950.0), 3: (1100.0, 1900.0), 4: (1075.0, 1950.0)}
    read, u, recording = motors(tmp_path, Px4Log(limits=limits))
    assert np.allclose(read.values, u, atol=1e-6)
    assert any("PWM_MAIN_MIN1" in note for note in recording.notes)


@pytest.mark.parametrize("names", [("PWM_MAIN_MIN", "PWM_MAIN_MAX"), ("PWM_MIN", "PWM_MAX")])
def test_px4_outputs_before_output_functions_have_common_limits(tmp_path, names):
    log = Px4Log(functions=False, parameters={names[0]: 1080, names[1]: 1920, "SYS_AUTOSTART": 4001})
    log.limits = {c: (1080.0, 1920.0) for c in log.channels}
    t, u = truth()
    data = log.write(t, u)
    for c in log.channels:  # the limits go by the old names alone
        for word in (b"MIN", b"MAX"):
            data = data.replace(b"int32_t PWM_MAIN_%b%d" % (word, c), b"int32_t XWM_MAIN_%b%d" % (word, c))
    (tmp_path / "a.ulg").write_bytes(data)
    assert np.allclose(read_recording(tmp_path / "a.ulg", QUAD).streams["motors"].values, u, atol=1e-6)


@pytest.mark.parametrize("least", [0.055, 0.1])
def test_px4_dshot_is_scaled_from_its_least_throttle(tmp_path, least):
    parameters = {"DSHOT_MIN": least, "PWM_MAIN_TIM0": -3}
    limits = dict.fromkeys((1, 2, 3, 4), (1000.0, 2000.0))
    read, u, recording = motors(tmp_path, Px4Log(dshot=True, parameters=parameters, limits=limits))
    assert np.allclose(read.values, u, atol=1e-5)
    assert any("DShot" in note for note in recording.notes)


def test_px4_oneshot_pulses_are_an_eighth_as_long(tmp_path):
    t, u = truth()
    data = Px4Log(limits=dict.fromkeys((1, 2, 3, 4), (125.0, 250.0))).write(t, u)
    for c in (1, 2, 3, 4):
        for word, value, real in ((b"MIN", 125, 1000), (b"MAX", 250, 2000)):
            key = b"int32_t PWM_MAIN_%b%d" % (word, c)
            data = data.replace(key + value.to_bytes(4, "little"), key + real.to_bytes(4, "little"))
    (tmp_path / "a.ulg").write_bytes(data)
    assert np.allclose(read_recording(tmp_path / "a.ulg", QUAD).streams["motors"].values, u, atol=1e-6)


def test_raw_commands_of_uavcan_before_it_had_limits(tmp_path):
    """As flight_review's motor_failure.ulg has them: 0 to 8191 on instance 1, nothing on 0, and no UAVCAN_EC_MAXn."""
    settings = {"UAVCAN_ENABLE": 3.0, "SYS_AUTOSTART": 4006.0}
    log = Px4Log(functions=False, parameters=settings, raw_full=8191.0, instance=1, decoys=(0,))
    read, u, recording = motors(tmp_path, log)
    assert np.allclose(read.values, u, atol=1e-6)
    assert any("raw commands of UAVCAN, from 0 to 8191" in note for note in recording.notes)


def test_px4_outputs_without_a_scale_are_refused_with_what_was_tested(tmp_path):
    with pytest.raises(BadInput, match=r"none fits.*instance 0 as PWM_MAIN.*no limits \(PWM_MAIN_MINn"):
        motors(tmp_path, Px4Log())
    wrong = dict.fromkeys((1, 2, 3, 4), (1000.0, 1200.0))
    t, u = truth()
    data = Px4Log(limits=wrong).write(t, 3.0 * u)
    (tmp_path / "a.ulg").write_bytes(data)
    with pytest.raises(BadInput, match=r"do not lie within the limits 1000 to 1200"):
        read_recording(tmp_path / "a.ulg", QUAD)


@pytest.mark.parametrize("changed_at", [7.0, 8.9])
def test_a_thrust_factor_is_used_for_its_own_time(tmp_path, changed_at):
    """THR_MDL_FAC from 0.1 to 1.0, in flight or after it: each command is what reached the ESC at that moment."""
    log = Px4Log(topic="actuator_motors", parameters={"THR_MDL_FAC": 0.1}, changes=((changed_at, "THR_MDL_FAC", 1.0),))
    read, thrust, recording = motors(tmp_path, log)
    factor = np.where(read.t_s < changed_at - 0.005, 0.1, 1.0)[:, None]
    assert np.allclose(read.values, thrust_curve(thrust, factor), atol=1e-6)
    told = [note for note in recording.notes if "THR_MDL_FAC changed from 0.1 to 1" in note]
    assert len(told) == (1 if changed_at < 8.5 else 0)


@pytest.mark.parametrize("name", ["MOT_PWM_MIN", "MOT_SPIN_MIN", "MOT_THST_EXPO"])
def test_ardupilot_settings_of_after_landing_do_not_count_in_flight(tmp_path, name):
    log = ArduLog(limits=(1100.0, 1900.0), parameters={name: 1100.0 if "PWM" in name else 0.1})
    log.changes = ((8.8, name, 1300.0 if "PWM" in name else 0.6),)
    read, u, recording = motors(tmp_path, log, "a.bin")
    assert np.allclose(read.values, u, atol=STEP)
    assert not any("changed" in note for note in recording.notes)


def test_a_hexas_log_with_a_four_rotor_file_is_refused_with_its_outputs(tmp_path):
    hexa = truth(6)
    log = ArduLog(channels=(9, 10, 11, 12, 13, 14), frame=(2, 1))
    with pytest.raises(BadInput, match=r"drives 6 motors \(hexa X; output 9, .*output 14\).*'qball2' has 4 rotors"):
        motors(tmp_path, log, "a.bin", made=hexa)
    ulog = Px4Log(channels=(1, 2, 3, 4, 5, 6), limits=dict.fromkeys(range(1, 7), (1000.0, 2000.0)))
    with pytest.raises(BadInput, match=r"drives 6 motors .*'qball2' has 4 rotors"):
        motors(tmp_path, ulog, made=hexa)
    read, u, _ = motors(tmp_path, log, "a.bin", like(ARDUPILOT[2, 1]), hexa)
    assert np.allclose(read.values, u, atol=STEP)


def test_a_planes_log_is_refused(tmp_path):
    log = ArduLog(functions=False, parameters={"SERVO1_FUNCTION": 4, "SERVO2_FUNCTION": 19, "SERVO3_FUNCTION": 70})
    with pytest.raises(BadInput, match=r"not those of a multicopter.*SERVO3_FUNCTION 70"):
        motors(tmp_path, log, "a.bin")


def test_an_ardupilot_log_without_limits_is_refused(tmp_path):
    with pytest.raises(BadInput, match=r"scale of its outputs .* tested were MOT_PWM_MIN"):
        motors(tmp_path, ArduLog(limits=(0.0, 0.0)), "a.bin")


@pytest.mark.parametrize("number", sorted(ARDUPILOT))
def test_every_frame_of_ardupilot_is_mapped_by_place_and_turning(tmp_path, number):
    """A vehicle file in ArduPilot's standard order of that class, whatever order the type has."""
    frame = ARDUPILOT[number]
    seed = frame.count + 10 * number[1]
    shuffled = np.random.default_rng(seed).permutation(frame.count)
    document = vehicle_to_dict(like(frame))
    document["rotors"]["position_m"] = [document["rotors"]["position_m"][i] for i in shuffled]
    document["rotors"]["spin"] = [frame.spin[i] for i in shuffled]
    log = ArduLog(channels=tuple(range(1, frame.count + 1)), frame=number)
    read, u, recording = motors(tmp_path, log, "a.bin", vehicle_from_dict(document), truth(frame.count))
    assert np.allclose(read.values, u[:, shuffled], atol=STEP)
    assert sum("is motor" in note for note in recording.notes) == 1
    assert not any("turn the other way" in note for note in recording.notes)


def test_rotors_that_stand_elsewhere_than_the_logs_motors_are_refused(tmp_path):
    with pytest.raises(BadInput, match=r"frame is quad plus.*do not stand like that"):
        motors(tmp_path, ArduLog(frame=(1, 0)), "a.bin")


def test_a_frame_that_is_not_known_is_refused_by_name(tmp_path):
    with pytest.raises(BadInput, match=r"class 1 \(quad\) and type 5"):
        motors(tmp_path, ArduLog(frame=(1, 5)), "a.bin")


@pytest.mark.parametrize(
    "old",
    [
        {"instanced": False},
        {"clock": "TimeMS"},
        {"throttle_limits": True, "limits": (1050.0, 1950.0)},
        {"column": "Chan"},
        {"functions": False, "parameters": {"FRAME": 1}},
    ],
)
def test_older_ardupilot_logs_are_read(tmp_path, old):
    read, u, recording = motors(tmp_path, ArduLog(**old), "a.bin")
    assert np.allclose(read.values, u, atol=STEP)
    assert len(recording.streams["imu"]) == len(u)
    assert recording.streams["imu"].t_s == pytest.approx(truth()[0], abs=1e-3)


@pytest.mark.parametrize(
    ("channels", "instances"),
    [
        ((1, 2, 3, 4), (0, 1, 2, 3)),
        ((5, 6, 7, 8), (4, 5, 6, 7)),
        ((5, 6, 7, 8), (0, 1, 2, 3)),
        ((4, 3, 2, 1), (3, 2, 1, 0)),
        ((1, 2, 3, 4), (9, 6, 7, 2)),
    ],
)
def test_esc_instances_are_the_outputs_or_the_motors_or_told_by_the_data(tmp_path, channels, instances):
    log = ArduLog(channels=channels, esc_instances=instances)
    speeds, u, _ = motors(tmp_path, log, "a.bin", like(ARDUPILOT[1, 1], "rotor_speed"))
    expected = 9000.0 * np.sqrt(u[np.maximum(np.arange(len(u)) - 4, 0)]) * np.pi / 30.0
    assert np.allclose(speeds.values, expected, rtol=1e-5, atol=1e-3)


def test_esc_telemetry_of_other_motors_is_refused_with_what_was_tested(tmp_path):
    t, u = truth()
    log = ArduLog(esc_instances=(4, 5, 6, 7))
    data = log.write(t, np.repeat(u[:, :1], 4, axis=1))  # all alike: the data do not tell
    (tmp_path / "a.bin").write_bytes(data)
    with pytest.raises(BadInput, match=r"instances 4, 5, 6, 7; tested were the outputs' \(0, 1, 2, 3\)"):
        read_recording(tmp_path / "a.bin", like(ARDUPILOT[1, 1], "rotor_speed"))


@pytest.mark.parametrize(("places", "functions"), [((4, 5, 6, 7), True), ((3, 1, 0, 2), True), ((7, 5, 4, 6), False)])
def test_px4_escs_are_the_motors_their_functions_or_their_speeds_say(tmp_path, places, functions):
    log = Px4Log(limits=dict.fromkeys((1, 2, 3, 4), (1000.0, 2000.0)), esc_places=places, esc_functions=functions)
    speeds, u, _ = motors(tmp_path, log, vehicle=like(ARDUPILOT[1, 1], "rotor_speed"))
    expected = np.round(9000.0 * np.sqrt(u[np.maximum(np.arange(len(u)) - 4, 0)])) * np.pi / 30.0
    assert np.allclose(speeds.values, expected, rtol=1e-5, atol=1e-3)


def test_several_instances_of_outputs_are_told_apart(tmp_path):
    log = Px4Log(instance=1, decoys=(0, 2), prefix="PWM_AUX", limits=dict.fromkeys((1, 2, 3, 4), (1000.0, 2000.0)))
    read, u, _ = motors(tmp_path, log)
    assert np.allclose(read.values, u, atol=1e-6)


WIRED = st.permutations(range(1, 9)).map(lambda p: tuple(p[:4]))
LOW, HIGH = st.integers(900, 1150).map(float), st.integers(1850, 2100).map(float)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    channels=WIRED,
    bounds=st.lists(st.tuples(LOW, HIGH), min_size=4, max_size=4),
    prefix=st.sampled_from(["PWM_MAIN", "PWM_AUX"]),
    instance=st.integers(0, 2),
    later=st.one_of(st.none(), st.tuples(st.floats(5.2, 8.9), LOW)),
)
def test_any_wiring_scale_and_history_of_a_px4_log_gives_the_same_motors(
    tmp_path_factory, channels, bounds, prefix, instance, later
):
    log = Px4Log(channels, prefix, instance, dict(zip(channels, bounds, strict=True)))
    log.decoys = tuple({0, 1, 2} - {instance})
    if later is not None:
        log.changes = ((later[0], f"{prefix}_MIN{channels[0]}", later[1]),)
    read, u, _ = motors(tmp_path_factory.mktemp("px4"), log)
    assert np.allclose(read.values, u, atol=1e-5)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    channels=st.permutations(range(1, 15)).map(lambda p: tuple(p[:4])),
    bounds=st.tuples(LOW, HIGH),
    kind=st.sampled_from([1, 2, 12, 13, 14]),
    later=st.one_of(st.none(), st.tuples(st.floats(5.2, 8.9), LOW)),
    old=st.sampled_from([{}, {"clock": "TimeMS"}, {"instanced": False}, {"column": "Ch"}]),
)
def test_any_wiring_scale_frame_and_history_of_an_ardupilot_log_gives_the_same_motors(
    tmp_path_factory, channels, bounds, kind, later, old
):
    assume(old.get("column") != "Ch" or max(channels) < 14)  # a record has room for the names of thirteen of these
    frame = ARDUPILOT[1, kind]
    log = ArduLog(channels, bounds, (1, kind), **old)
    if later is not None:
        log.changes = ((later[0], "MOT_PWM_MIN", later[1]),)
    read, u, _ = motors(tmp_path_factory.mktemp("ap"), log, "a.bin", like(frame))
    # Milliseconds round a change onto or before the sample beside it.
    off = np.abs(read.values - u).max(axis=1)
    assert np.sum(off > 2 * STEP) <= (2 if "clock" in old and later else 0)


def test_older_names_of_px4_are_read_and_a_missing_field_is_named(tmp_path):
    """1.12: odometry and setpoints as x y z; and a topic that lacks a field is left out by name, not called damaged."""
    from sim.mavlink.ulog import ULogWriter

    formats = {
        "actuator_motors": "uint64_t timestamp;uint64_t timestamp_sample;float[12] control;",
        "vehicle_visual_odometry": "uint64_t timestamp;float x;float y;float z;float[4] q;",
        "trajectory_setpoint": "uint64_t timestamp;float x;float y;float z;float yaw;",
        "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;",
    }
    log = ULogWriter(0, formats, {}, [])
    for k in range(100):
        log.add("actuator_motors", 10000 * k, 0, 0.5, 0.6, 0.5, 0.6, *[float("nan")] * 8)
        log.add("vehicle_visual_odometry", 10000 * k, 1.0, 2.0, -3.0, 1.0, 0.0, 0.0, 0.0)
        log.add("trajectory_setpoint", 10000 * k, 1.0, 2.0, -3.0, 0.5)
        log.add("sensor_combined", 10000 * k, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
    (tmp_path / "a.ulg").write_bytes(bytes(log.data))
    recording = read_recording(tmp_path / "a.ulg", QUAD)
    assert recording.streams["mocap"].values[0].tolist() == [1.0, -2.0, 3.0, 1.0, 0.0, 0.0, 0.0]
    assert recording.streams["setpoint"].values[0].tolist() == [1.0, -2.0, 3.0, -0.5]
    assert "imu" not in recording.streams
    assert any("imu: left out: sensor_combined of this log has no field gyro_integral_dt" in n for n in recording.notes)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "is empty"),
        (bytes(600), "zeros alone"),
        (b"\x1f\x8b\x08\x00" + bytes(40), "gzip; unpack it"),
        (b"PK\x03\x04" + bytes(40), "zip archive; unpack it"),
        (b"ULogEnc\x01" + bytes(40), "encrypted PX4 log"),
        (b"FMT, 128, 89, FMT, BBnNZ, Type\nFMT, 1, 2\n", "turned into text"),
        (b"time,roll,pitch\n1,2,3\n", "table in one file"),
        (b"#ROSBAG V2.0\n", "ROS 1 bag"),
        (b"<!DOCTYPE html><html>", "web page"),
        ("Grüße vom Feld\n".encode(), "is a text file"),
        (b"\x00\x05\xff\x10" * 20, "no known format"),
    ],
)
def test_a_file_of_another_kind_is_named_for_what_it_is(tmp_path, data, said):
    (tmp_path / "x.dat").write_bytes(data)
    with pytest.raises(BadInput, match=said):
        read_recording(tmp_path / "x.dat", QUAD)


def test_a_cut_and_a_damaged_dataflash_log_are_told(tmp_path):
    t, u = truth()
    data = ArduLog().write(t, u)
    (tmp_path / "a.bin").write_bytes(data[: len(data) - 20])
    assert any(
        "cut off in the middle of a record (20 bytes" in n for n in read_recording(tmp_path / "a.bin", QUAD).notes
    )
    hurt = data[: len(data) // 2] + b"\x17" * 100 + data[len(data) // 2 :]
    (tmp_path / "a.bin").write_bytes(hurt)
    recording = read_recording(tmp_path / "a.bin", QUAD)
    assert any("damaged bytes were skipped" in n for n in recording.notes)
    assert len(recording.streams["motors"]) >= len(t) - 3


def test_what_is_not_read_is_listed_one_line_each(tmp_path):
    log = Px4Log(limits=dict.fromkeys((1, 2, 3, 4), (1000.0, 2000.0)), decoys=(), esc_places=None)
    t, u = truth()
    data = log.write(t, u).replace(b"sensor_combined", b"sensor_combitwo")
    (tmp_path / "a.ulg").write_bytes(data)
    left = read_recording(tmp_path / "a.ulg", QUAD).left_out
    assert [line for line in left if line.startswith("sensor_combitwo")] == [
        "sensor_combitwo: 400 samples at 100 Hz are not read."
    ]
    assert len(left) == len(set(left))


@pytest.mark.parametrize(
    ("pairs", "said"), [(1, r"in rpm\? Divide by 9\.549297\."), (7, r"electrical rpm.*about 7 would fit")]
)
def test_electrical_rpm_is_told_from_rpm_by_how_much_too_fast_it_is(pairs, said):
    from groundstation.flightdata import Stream, motor_columns
    from groundstation.recording.plausible import check_motors

    vehicle = qball()
    hover = float(vehicle.motor_for_thrust(vehicle.mass_kg * vehicle.gravity_m_s2 / 4.0))
    values = np.full((50, 4), hover * 60.0 / (2.0 * np.pi) * pairs)
    with pytest.raises(BadInput, match=said):
        check_motors(Stream(np.arange(50.0), values, motor_columns("rotor_speed", 4)), vehicle)
