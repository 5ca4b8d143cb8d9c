"""Blackbox logs of Betaflight and INAV: each encoding by the format's own documentation, and a flight planted in a
log.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.frames import quat_from_euler
from groundstation.recording import load_flight, read_recording
from groundstation.recording.airframes import BETAFLIGHT_QUAD_X
from groundstation.recording.blackboxfile import decode_blackbox
from tests.test_recording_settings import like
from tests.written_logs import truth


def unsigned(value):
    out = bytearray()
    value &= 0xFFFFFFFF
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def signed(value):
    return unsigned((value << 1) ^ (value >> 31))


def log(frames, names, encodings=None, predictors=None, headers=None, end=True):
    """A log: frames are (mark, bytes)."""
    n = len(names)
    encodings, predictors = encodings or {"I": [0] * n, "P": [0] * n}, predictors or {"I": [0] * n, "P": [1] * n}
    lines = {
        "Product": "Blackbox flight data recorder by Nicholas Sherlock",
        "Field I name": ",".join(names),
        "Field I signed": ",".join(["1"] * n),
        "I interval": "32",
        "P interval": "1/1",
        **{f"Field {k} encoding": ",".join(map(str, encodings[k])) for k in "IP"},
        **{f"Field {k} predictor": ",".join(map(str, predictors[k])) for k in "IP"},
        **(headers or {}),
    }
    head = b"".join(f"H {key}:{value}\n".encode() for key, value in lines.items())
    body = b"".join(mark.encode() + data for mark, data in frames)
    return head + body + (b"E\xffEnd of log\0" if end else b"")


def rows(encoding, data, count, predictor=0, last=None):
    """The fields of one I frame (or of a P frame after an I frame of the given values)."""
    names = [f"f[{i}]" for i in range(count)]
    frames = [("I", data)] if last is None else [("I", b"".join(map(signed, last))), ("P", data)]
    kinds = {"I": [encoding] * count if last is None else [0] * count, "P": [encoding] * count}
    steps = {"I": [predictor if last is None else 0] * count, "P": [predictor] * count}
    (found,) = decode_blackbox(
        np.frombuffer(log(frames, names, kinds, steps, {"minthrottle": "1070", "motorOutput": "158,2047"}), np.uint8)
    )
    assert found.damaged == 0
    assert found.ended
    return found.rows[-1].tolist()


@pytest.mark.parametrize(
    ("encoding", "data", "values"),
    [
        (0, b"\x00\x01\x02\xff\x01", [0, -1, 1, -128]),
        (1, b"\x00\x7f\x80\x01\x05", [0, 127, 128, 5]),
        (3, unsigned(5) + unsigned(-5 & 0x3FFF), [-5, 5]),
        (6, b"\x05" + signed(7) + signed(-9), [7, 0, -9]),
        (7, bytes([0b00_01_11_00]), [1, -1, 0]),
        (7, bytes([0b01_00_0111, 0b1000_1111]), [7, -8, -1]),
        (7, bytes([0b10_011111, 0b00_100000, 0b00_111111]), [31, -32, -1]),
        (7, bytes([0b11_10_01_00, 0x80, 0x34, 0x12, 0xFF, 0xFF, 0x7F]), [-128, 0x1234, 0x7FFFFF]),
        (8, bytes([0b11_10_01_00, 0x50 | 0x0F, 0xB0 | 0x01, 0x23, 0x40]), [0, 5, -5, 0x1234]),
        (9, b"", [0, 0]),
        (10, bytes([0b01_01111_1, 0b0000_0111]), [15, -16, 7]),
        (10, bytes([0b10_011111, 0b11_100000, 0b0_0111111]), [127, -64, 63]),
    ],
)
def test_each_encoding_is_read_as_the_format_says(encoding, data, values):
    assert rows(encoding, data, len(values)) == values


def test_each_predictor_adds_what_the_format_says():
    assert rows(0, signed(3), 1, 1, [10]) == [13]
    assert rows(0, signed(3), 1, 2, [10]) == [13]  # 2 * 10 - 10
    assert rows(0, signed(3), 1, 3, [-7]) == [-4]
    assert rows(0, signed(3), 1, 4) == [1073]
    assert rows(0, signed(3), 1, 6, [10]) == [14]
    assert rows(0, signed(3), 1, 8) == [1503]
    assert rows(0, signed(3), 1, 11) == [161]


NAMES = ["loopIteration", "time", *(f"gyroADC[{i}]" for i in range(3)), *(f"accSmooth[{i}]" for i in range(3))]
NAMES += ["vbatLatest", *(f"motor[{i}]" for i in range(4)), *(f"eRPM[{i}]" for i in range(4))]
HEADERS = {
    **{
        "Firmware revision": "Betaflight 4.5.0",
        "gyro_scale": "0x3f800000",
        "acc_1G": "2048",
        "motorOutput": "158,2047",
    },
    **{"maxthrottle": "2000", "minthrottle": "1070", "motor_pwm_protocol": "6", "motor_poles": "14"},
}


def flown(tmp_path, u, headers=None, scale=lambda u: 48.0 + 1999.0 * u, names=None, **options):
    """A log of commands u at 1 kHz, written as I frames every 32 and differences between."""
    table = np.zeros((len(u), len(NAMES)), np.int64)
    table[:, 0], table[:, 1] = np.arange(len(u)), 70_000_000 + 1000 * np.arange(len(u))
    table[:, 2:5], table[:, 5:8], table[:, 8] = [90, -45, 30], [0, 0, 2048], 1580
    table[:, 9:13] = np.round(scale(u))
    table[:, 13:17] = np.round(u * 2000.0)
    frames = [
        ("I", b"".join(map(signed, row.tolist())))
        if k % 32 == 0
        else ("P", b"".join(map(signed, (row - table[k - 1]).tolist())))
        for k, row in enumerate(table)
    ]
    path = tmp_path / "LOG00001.BFL"
    path.write_bytes(log(frames, names or NAMES, headers={**HEADERS, **(headers or {})}, **options))
    return path


QUAD = like(BETAFLIGHT_QUAD_X)


def test_a_blackbox_log_comes_back_in_our_frames_and_units(tmp_path):
    _, u = truth()
    recording = read_recording(flown(tmp_path, u), QUAD)
    imu, motors = recording.streams["imu"], recording.streams["motors"]
    assert np.allclose(imu.values[0], [np.pi / 2, -np.pi / 4, np.pi / 6, 0.0, 0.0, 9.80665])
    assert np.allclose(motors.values, u, atol=0.5 / 1999.0)
    assert np.allclose(np.diff(motors.t_s), 1e-3)
    assert recording.streams["battery"].values[0, 0] == pytest.approx(15.8)
    assert sum("is motor" in note for note in recording.notes) == 1


def test_electrical_rpm_goes_by_the_pole_pairs(tmp_path):
    _, u = truth()
    speeds = read_recording(flown(tmp_path, u), like(BETAFLIGHT_QUAD_X, "rotor_speed")).streams["motors"]
    assert np.allclose(speeds.values, np.round(2000.0 * u) * 100.0 / 7.0 * 2.0 * np.pi / 60.0)
    with pytest.raises(BadInput, match="no motor_poles"):
        read_recording(flown(tmp_path, u, {"motor_poles": ""}), like(BETAFLIGHT_QUAD_X, "rotor_speed"))


@pytest.mark.parametrize("protocol", ["0", "1", "3"])
def test_pulses_are_a_share_of_what_the_esc_was_taught(tmp_path, protocol):
    _, u = truth()
    headers = {"motor_pwm_protocol": protocol, "maxthrottle": "1900", "motorOutput": "1070,1900"}
    recording = read_recording(flown(tmp_path, u, headers, lambda u: 1000.0 + 900.0 * u), QUAD)
    assert np.allclose(recording.streams["motors"].values, u, atol=0.5 / 900.0)


@pytest.mark.parametrize("protocol", ["0", "4", "5", "6"])
def test_inav_logs_pulses_whatever_its_protocol_and_the_gyro_before_its_filters(tmp_path, protocol):
    """As a log of INAV 8 has them: motorOutput 1050,2000 and gyroRaw in degrees/s."""
    _, u = truth()
    headers = {"Firmware revision": "INAV 8.0.0 (67ba0919)", "motor_pwm_protocol": protocol, "motorOutput": "1050,2000"}
    names = [name.replace("eRPM", "gyroRaw") if name != "eRPM[3]" else "rssi" for name in NAMES]
    recording = read_recording(flown(tmp_path, u, headers, lambda u: 1000.0 + 1000.0 * u, names=names), QUAD)
    assert np.allclose(recording.streams["motors"].values, u, atol=0.5 / 1000.0)
    assert np.allclose(recording.streams["imu"].values[:, 0], np.radians(np.round(u * 2000.0)[:, 0]))
    assert "imu: gyroRaw and accSmooth." in recording.notes


@pytest.mark.parametrize(
    ("revision", "volts"),
    [("Betaflight 4.5.0", 15.8), ("INAV 8.0.0", 15.8), ("Betaflight 3.4.0", 158.0), ("Cleanflight 2.5.0", 158.0)],
)
def test_the_batterys_unit_goes_by_firmware_and_version(tmp_path, revision, volts):
    found = read_recording(flown(tmp_path, truth()[1], {"Firmware revision": revision}), QUAD).streams["battery"]
    assert found.values[0, 0] == pytest.approx(volts)


def test_a_battery_of_a_firmware_whose_unit_is_not_known_is_left_out(tmp_path):
    recording = read_recording(flown(tmp_path, truth()[1], {"Firmware revision": "Betaflight 3.0.1"}), QUAD)
    assert "battery" not in recording.streams
    assert any("the unit of vbatLatest is not known" in note for note in recording.notes)


def test_a_planes_log_is_told_from_a_multicopters(tmp_path):
    names = [
        name.replace("motor[1]", "servo[0]").replace("motor[2]", "servo[1]").replace("motor[3]", "servo[2]")
        for name in NAMES
    ]
    with pytest.raises(BadInput, match="is not the log of a multicopter: it has 1 motor and 3 servos"):
        read_recording(flown(tmp_path, truth()[1], names=names), QUAD)


@pytest.mark.parametrize("shuffled", [[0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]])
def test_rotors_are_found_by_their_places(tmp_path, shuffled):
    _, u = truth()
    vehicle = QUAD.model_copy(
        update={
            "rotors": QUAD.rotors.model_copy(
                update={
                    "position_m": tuple(QUAD.rotors.position_m[i] for i in shuffled),
                    "spin": tuple(QUAD.rotors.spin[i] for i in shuffled),
                }
            )
        }
    )
    motors = read_recording(flown(tmp_path, u), vehicle).streams["motors"]
    assert np.allclose(motors.values, u[:, shuffled], atol=0.5 / 1999.0)


def test_a_damaged_or_cut_blackbox_log_is_told_and_read_up_to_there(tmp_path):
    _, u = truth()
    path = flown(tmp_path, u, end=False)
    recording = read_recording(path, QUAD)
    assert any("cut off" in note for note in recording.notes)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 40] = bytes(40)
    path.write_bytes(bytes(data))
    recording = read_recording(path, QUAD)
    assert any("damaged bytes were skipped" in note for note in recording.notes)
    motors = recording.streams["motors"]
    assert len(u) - 40 < len(motors) < len(u)
    kept = np.round((motors.t_s - 70.0) * 1e3).astype(int)
    assert np.allclose(motors.values, u[kept], atol=0.5 / 1999.0)


def test_the_longest_of_several_logs_is_read_and_told(tmp_path):
    _, u = truth()
    short = flown(tmp_path, u[:64]).read_bytes()
    path = flown(tmp_path, u)
    path.write_bytes(short + path.read_bytes())
    recording = read_recording(path, QUAD)
    assert len(recording.streams["motors"]) == len(u)
    assert any("holds 2 logs; number 2" in note for note in recording.notes)


def test_values_beyond_the_headers_range_are_refused(tmp_path):
    _, u = truth()
    with pytest.raises(BadInput, match="do not fit the header's range"):
        read_recording(
            flown(tmp_path, u, {"motor_pwm_protocol": "0", "maxthrottle": "1400"}, lambda u: 1000 + 900 * u), QUAD
        )


def test_inavs_own_estimate_is_the_state(tmp_path):
    """North 2 m, east 1 m, up 3 m, moving east; rolled right, nose up, heading north-east: in our frames y is west and
    yaw counter-clockwise.
    """
    names = [*NAMES[:13], *(f"{stem}[{i}]" for stem in ("attitude", "navPos", "navVel") for i in range(3))]
    row = [0, 0, 90, -45, 30, 0, 0, 2048, 1580, 1100, 1200, 1300, 1400, 100, -50, 450, 200, 100, 300, 0, 150, -20]
    frames = [("I", b"".join(map(signed, [k, 1000 * k, *row[2:]]))) for k in range(200)]
    headers = {**HEADERS, "Firmware revision": "INAV 7.1.0", "motorOutput": "", "motor_pwm_protocol": "1"}
    path = tmp_path / "LOG00001.TXT"
    path.write_bytes(log(frames, names, headers=headers))
    state = read_recording(path, QUAD).streams["state"].values[0]
    assert state[:6].tolist() == pytest.approx([2.0, -1.0, 3.0, 0.0, -1.5, -0.2])
    assert state[6:10] == pytest.approx(quat_from_euler(np.radians(10.0), np.radians(-5.0), np.radians(-45.0)))
    assert state[10:] == pytest.approx([np.pi / 2, -np.pi / 4, np.pi / 6])


def test_a_log_of_a_tenth_of_a_second_is_read_without_a_warning(tmp_path):
    _, u = truth()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(load_flight(flown(tmp_path, u[60:160]), vehicle=QUAD).motors) == 100
