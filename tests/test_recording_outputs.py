"""Outputs that do not go from 1000 to 2000 as thrust rises: read by what the log says of them, or refused by name."""

from __future__ import annotations

import re
import struct

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.recording import read_recording
from groundstation.recording.airframes import ARDUPILOT
from tests.test_recording_blackbox import log as blackbox
from tests.test_recording_blackbox import signed
from tests.test_recording_settings import QUAD, STEP, like, motors
from tests.written_logs import ArduLog, Px4Log, truth

LIMITS: dict[int, tuple[float, float]] = dict.fromkeys((1, 2, 3, 4), (1000.0, 2000.0))
LANDED_S = 8.9


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("PWM_MAIN_TIM0", 400.0, -3.0),
        ("UAVCAN_ENABLE", 0.0, 3.0),
        ("MAV_TYPE", 2.0, 22.0),
        ("PWM_MAIN_FUNC1", 101.0, 0.0),
        ("PWM_MAIN_MAX1", 2000.0, 1200.0),
    ],
)
def test_what_is_set_after_landing_is_of_the_next_flight(tmp_path, name, before, after):
    log = Px4Log(limits=LIMITS, parameters={name: before}, changes=((LANDED_S, name, after),))
    if name.endswith(("FUNC1", "MAX1")):
        log.parameters = {}
    read, u, _ = motors(tmp_path, log)
    assert np.allclose(read.values, u, atol=1e-6)


def test_outputs_before_output_functions_are_as_many_as_the_airframe_that_flew_has(tmp_path):
    log = Px4Log(functions=False, limits=LIMITS, parameters={"SYS_AUTOSTART": 4001.0, "MAV_TYPE": 2.0})
    log.changes = ((LANDED_S, "SYS_AUTOSTART", 6001.0), (LANDED_S, "MAV_TYPE", 13.0))
    read, u, _ = motors(tmp_path, log)
    assert np.allclose(read.values, u, atol=1e-6)


@pytest.mark.parametrize(("name", "value"), [("PWM_MAIN_REV", 4.0), ("PWM_MAIN_REV3", 1.0)])
def test_reversed_outputs_of_px4_are_refused(tmp_path, name, value):
    with pytest.raises(BadInput, match=r"output 3 is reversed \(PWM_MAIN_REV\)"):
        motors(tmp_path, Px4Log(limits=LIMITS, parameters={name: value}))
    other = Px4Log(limits=LIMITS, parameters={"PWM_MAIN_REV": 16.0, "PWM_AUX_REV": 1.0})  # a servo's
    read, u, _ = motors(tmp_path, other)
    assert np.allclose(read.values, u, atol=1e-6)


def test_dshot_both_ways_is_refused_and_is_nothing_to_pulses(tmp_path):
    parameters = {"PWM_MAIN_TIM0": -3.0, "DSHOT_3D_ENABLE": 1.0}
    with pytest.raises(BadInput, match="DSHOT_3D_ENABLE"):
        motors(tmp_path, Px4Log(dshot=True, limits=LIMITS, parameters=parameters))
    read, u, _ = motors(tmp_path, Px4Log(limits=LIMITS, parameters={**parameters, "PWM_MAIN_TIM0": 400.0}))
    assert np.allclose(read.values, u, atol=1e-6)


def servos(channels, low, high):
    return {f"SERVO{c}_{word}": value for c in channels for word, value in (("MIN", low), ("MAX", high))}


@pytest.mark.parametrize("channels", [(1, 2, 3, 4), (9, 12, 10, 11)])
def test_ardupilot_outputs_in_the_range_of_a_servo_are_scaled_by_that(tmp_path, channels):
    """MOT_PWM_TYPE 8: MOT_PWM_MIN and _MAX are 1000 and 2000 whatever goes out (AP_Motors_Class, rc_write)."""
    log = ArduLog(channels=channels, limits=(1100.0, 1900.0), parameters={"MOT_PWM_TYPE": 8.0})
    log.parameters |= {"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0, **servos(channels, 1100.0, 1900.0)}
    read, u, _ = motors(tmp_path, log, "a.bin")
    assert np.allclose(read.values, u, atol=STEP)
    log.parameters |= {"MOT_PWM_TYPE": 0.0, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}
    log.parameters |= servos(channels, 800.0, 2200.0)
    log.changes = ((LANDED_S, "MOT_PWM_TYPE", 8.0),)
    read, u, _ = motors(tmp_path, log, "b.bin")
    assert np.allclose(read.values, u, atol=STEP)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"MOT_PWM_TYPE": 8.0}, "tested were SERVOn_MIN and SERVOn_MAX, which MOT_PWM_TYPE 8 asks for"),
        ({"MOT_PWM_TYPE": 9.0}, "MOT_PWM_TYPE 9"),
        ({"SERVO_BLH_3DMASK": 2.0}, "SERVO_BLH_3DMASK 2: output 2 drives a motor both ways"),
        (
            {"MOT_PWM_TYPE": 8.0, "SERVO4_REVERSED": 1.0, **servos((1, 2, 3, 4), 1100.0, 1900.0)},
            "SERVO4_REVERSED 1: output 4 falls where thrust rises",
        ),
    ],
)
def test_ardupilot_outputs_that_do_not_rise_with_thrust_are_refused(tmp_path, parameters, said):
    with pytest.raises(BadInput, match=said):
        motors(tmp_path, ArduLog(parameters=parameters), "a.bin")


def test_ardupilot_outputs_of_others_may_go_both_ways(tmp_path):
    parameters = {"SERVO_BLH_3DMASK": 32.0, "SERVO1_REVERSED": 1.0}  # reversal is a servo's: motors are sent pulses
    read, u, _ = motors(tmp_path, ArduLog(parameters=parameters), "a.bin")
    assert np.allclose(read.values, u, atol=STEP)


def box(path, sent, headers):
    """A blackbox log of twenty samples at rest, its motors sent one value."""
    names = ["loopIteration", "time", *(f"gyroADC[{i}]" for i in range(3)), *(f"accSmooth[{i}]" for i in range(3))]
    names += [f"motor[{i}]" for i in range(4)]
    rows = [[k, 1000 * k, 0, 0, 0, 0, 0, 2048, *[sent] * 4] for k in range(20)]
    common = {"I interval": "1", "gyro_scale": "0x3d75c28f", "acc_1G": "2048", "maxthrottle": "2000"}
    path.write_bytes(blackbox([("I", b"".join(map(signed, r))) for r in rows], names, headers={**common, **headers}))
    return path


@pytest.mark.parametrize("firmware", ["Betaflight 4.5.0", "INAV 7.1.0"])
def test_motors_of_a_blackbox_that_turn_both_ways_are_refused(tmp_path, firmware):
    headers = {"Firmware revision": firmware, "motorOutput": "1000,2000", "motor_pwm_protocol": "0"}
    for features, refused in (("4096", True), ("-1", True), ("541065224", False)):
        path = box(tmp_path / "a.bbl", 1500, {**headers, "features": features})
        if refused:
            with pytest.raises(BadInput, match="its motors turn both ways"):
                read_recording(path, QUAD)
        else:
            assert np.all(read_recording(path, QUAD).streams["motors"].values == 0.5)


@pytest.mark.parametrize(("protocol", "output", "sent"), [("6", "1000,2000", 1400), ("0", "158,2047", 600)])
def test_a_protocol_that_the_range_of_the_outputs_contradicts_is_refused(tmp_path, protocol, output, sent):
    headers = {"Firmware revision": "Betaflight 4.5.0", "motorOutput": output, "motor_pwm_protocol": protocol}
    with pytest.raises(BadInput, match=rf"do not fit the header's range \(motorOutput '{output}'"):
        read_recording(box(tmp_path / "a.bbl", sent, headers), QUAD)


@pytest.mark.parametrize("kind", ["command", "rotor_speed"])
def test_speeds_of_some_rotors_do_not_keep_commands_from_being_read(tmp_path, kind):
    vehicle = like(ARDUPILOT[1, 1], kind)
    for log, name in (
        (Px4Log(limits=LIMITS, esc_places=(0, 1, 2), esc_functions=False), "a.ulg"),
        (ArduLog(esc_instances=(0, 1, 2)), "a.bin"),
    ):
        if kind == "rotor_speed":
            with pytest.raises(BadInput, match=r"tells speeds of 3 ESCs|covers 3 of 4 rotors"):
                motors(tmp_path, log, name, vehicle)
            continue
        read, u, recording = motors(tmp_path, log, name, vehicle)
        assert np.allclose(read.values, u, atol=STEP)
        assert any("it is not used" in note for note in recording.notes)


@pytest.mark.parametrize(
    "functions",
    [
        {"PWM_MAIN_FUNC1": 101.0, "PWM_MAIN_FUNC2": 102.0, "PWM_MAIN_FUNC3": 104.0},
        {"PWM_MAIN_FUNC1": 101.0, "PWM_MAIN_FUNC2": 102.0, "PWM_AUX_FUNC1": 103.0, "PWM_AUX_FUNC2": 104.0},
    ],
)
def test_functions_that_name_no_driver_of_all_motors_are_refused(tmp_path, functions):
    with pytest.raises(BadInput, match=r"no driver of its outputs has all motors from 1 to 4 .*FUNC2 is motor 4|3 is"):
        motors(tmp_path, Px4Log(limits=LIMITS, functions=False, parameters=functions))
    rest = {"UAVCAN_EC_FUNC1": 101.0, "UAVCAN_EC_FUNC2": 102.0}  # left of a driver that has no part in this flight
    read, u, _ = motors(tmp_path, Px4Log(limits=LIMITS, parameters=rest))
    assert np.allclose(read.values, u, atol=1e-6)


def test_motors_that_turn_both_ways_are_refused(tmp_path):
    t, u = truth()
    with pytest.raises(BadInput, match="CA_R_REV"):
        motors(tmp_path, Px4Log(topic="actuator_motors"), made=(t, np.where(u > 0.0, u - 0.5, np.nan)))


def test_speeds_are_those_of_the_escs_that_turn(tmp_path):
    """esc_status of another driver, or of no ESC at all, may be instance 0."""
    log = Px4Log(limits=LIMITS, esc_places=(0, 1, 2, 3)).write(*truth())
    record = struct.pack("<HBB", 3 + len("esc_status"), ord("A"), 0)
    subscribed = re.search(re.escape(record) + b"..esc_status", log, re.DOTALL)
    assert subscribed is not None
    data = bytearray(log)
    data[subscribed.start() + 3] = 1
    (tmp_path / "a.ulg").write_bytes(bytes(data))
    read = read_recording(tmp_path / "a.ulg", like(ARDUPILOT[1, 1], "rotor_speed"))
    assert read.streams["motors"].columns[0] == "m1_rad_s"
    assert not any("command" in note for note in read.notes)


def test_outputs_that_cannot_be_read_do_not_keep_speeds_from_being_read(tmp_path):
    """Motors that turn both ways, or have no limits in the log, have the speeds that their ESCs tell."""
    vehicle = like(ARDUPILOT[1, 1], "rotor_speed")
    both_ways = ArduLog(parameters={"SERVO_BLH_3DMASK": 15.0}, esc_instances=(0, 1, 2, 3))
    nothing = ArduLog(limits=(0.0, 0.0), esc_instances=(0, 1, 2, 3))
    reversed_ones = Px4Log(limits=LIMITS, parameters={"PWM_MAIN_REV": 15.0}, esc_places=(0, 1, 2, 3))
    for log, name in ((both_ways, "a.bin"), (nothing, "b.bin"), (reversed_ones, "a.ulg")):
        read, u, _ = motors(tmp_path, log, name, vehicle)
        expected = 9000.0 * np.sqrt(u[np.maximum(np.arange(len(u)) - 4, 0)]) * np.pi / 30.0
        assert np.allclose(read.values, expected, atol=0.06)
        with pytest.raises(BadInput):
            motors(tmp_path, log, name)
