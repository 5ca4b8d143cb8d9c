"""Blackbox logs of Betaflight and INAV as streams.

Body axes are x ahead, y left, z up already: a positive pitch of the firmware's is nose down, a positive yaw
counter-clockwise, and the accelerometer reads +1 g on z at rest (imu.c, mixer.c). Scales are in the header:
``gyro_scale`` (degrees/s per count), ``acc_1G`` (counts per g), ``motorOutput`` and ``motor_pwm_protocol``,
``motor_poles``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import BATTERY_COLUMNS, IMU_COLUMNS, STATE_COLUMNS, Stream, motor_columns
from groundstation.frames import quat_from_euler
from groundstation.recording.airframes import BETAFLIGHT_QUAD_X
from groundstation.recording.autopilot import (
    MOTORS_SLOW_HZ,
    check_count,
    motor_map,
    motor_order,
    one_line,
    present,
    slow_note,
    wanted_input,
)
from groundstation.recording.blackboxfile import BlackboxLog, decode_blackbox
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.recorded import Recording
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

_G = 9.80665
_RPM = 2.0 * np.pi / 60.0
_DSHOT_LEAST, _DSHOT_FULL = 48.0, 2047.0  # DShot's throttle values; below are commands
_PULSE_LEAST = 1000.0  # microseconds at which an ESC calibrated by the firmware stands still
_PULSE_SHORTEST = 850.0  # least that motorOutput can be set to; DShot's idle ends at a fifth of its range, 448
_FIRST_DIGITAL = 5.0  # motor_pwm_protocol: PWM, OneShot125, OneShot42, Multishot, brushed, then the digital ones
_BOTH_WAYS = 1 << 12  # bit of the header's features
_USED = ("loopIteration", "time", "vbatLatest", "amperageLatest", "vbat", "amperage")


def read_blackbox(path: Path, vehicle: Vehicle, part: Part = WHOLE) -> Recording:
    """The longest log of the file, or a part: gyro and accelerometer, motor values as commands, or the ESCs' speeds.

    Raises:
        BadInput: it is damaged, holds no flight, or one of another vehicle.
    """
    try:
        logs = decode_blackbox(np.memmap(path, np.uint8, mode="r"), part)
    except (ValueError, IndexError) as error:
        raise BadInput(f"{path}: a header is damaged ({one_line(error)}); copy the log again.") from None
    if not logs:
        raise BadInput(f"{path}: holds no frames of flight; copy the log again, or log for longer.")
    log = max(logs, key=lambda log: len(log.rows))
    t_s = log.column("time") / 1e6
    notes, losses = [], _losses(path, log)
    if len(logs) > 1:
        notes.append(
            f"{path.name}: holds {len(logs)} logs; number {logs.index(log) + 1}, the longest ({t_s[-1] - t_s[0]:.0f} "
            "s), is read."
        )
    streams: dict[str, Stream] = {}
    streams["motors"], said = _motors(log, t_s, vehicle, str(path))
    notes += [*losses, *said]
    for name, read in (("imu", _imu), ("battery", _battery), ("state", _state)):
        stream, said = present(name, lambda read=read: read(log, t_s))
        notes += said
        if stream is not None:
            streams[name] = stream
    extras = {"blackbox": Stream(t_s, log.rows.astype(float), log.names)} if part == WHOLE else {}
    revision = log.headers.get("Firmware revision", "")
    return Recording(
        name=path.stem,
        streams=streams,
        extras=extras,
        metadata={"format": "blackbox", "ver_sw": revision},
        notes=tuple(notes),
        left_out=tuple(losses),
    )


def _losses(path: Path, log: BlackboxLog) -> list[str]:
    notes = [f"{path.name}: {log.damaged} damaged bytes were skipped."] if log.damaged else []
    if not log.ended:
        notes.append(f"{path.name}: the log was cut off (it has no end mark); it was read up to there.")
    return notes


_UNFILTERED = ("gyroUnfilt", "gyroRaw")
"""The gyro before the firmware's filters, degrees/s over gyro_scale as gyroADC is: Betaflight's name, and INAV's."""
_SLOW = (
    "lower blackbox_sample_rate (Betaflight), or blackbox_rate_num over blackbox_rate_denom (INAV), to log every loop."
)


def _imu(log: BlackboxLog, t_s: Array) -> tuple[Stream | None, list[str]]:
    """The gyro before the firmware's filters, where it was logged, and the accelerometer."""
    name = next((name for name in _UNFILTERED if log.elements(name) == 3), "gyroADC")
    rates = np.column_stack([log.column(f"{name}[{i}]") for i in range(3)])
    scale = log.number("gyro_scale", 0.0)
    if scale <= 0.0:
        return None, ["imu: left out: the header has no gyro_scale."]
    g = log.number("acc_1G", 0.0)
    force = np.column_stack([log.column(f"accSmooth[{i}]") for i in range(3)])
    if g <= 0.0:
        return None, ["imu: left out: the header has no acc_1G."]
    stream = Stream(t_s, np.hstack([np.radians(rates * scale), force / g * _G]), IMU_COLUMNS)
    note = f"imu: {name} and accSmooth."
    if name == "gyroADC":
        note = (
            "imu: gyroADC, which the firmware has filtered, in steps of "
            f"{scale:g} degrees/s, and accSmooth; declare [imu] filter_hz, or log gyroUnfilt (INAV: gyroRaw)."
        )
    return stream, [note, *slow_note("imu", stream, 100.0, _SLOW)]


_VOLTS = (
    ("Betaflight", (4, 0), 0.01),
    ("Betaflight", (3, 1), 0.1),
    ("Cleanflight", (2, 0), 0.1),
    ("EmuFlight", (0, 0), 0.01),
)
"""Firmware, version from which on, volts per count of vbatLatest (blackbox-log-viewer, its fields presenter)."""


def _battery(log: BlackboxLog, t_s: Array) -> tuple[Stream | None, list[str]]:
    """The battery's voltage and current.

    Hundredths of either in INAV and since Betaflight 4.0; earlier currents need the board's scale.
    """
    revision = log.headers.get("Firmware revision", "")
    volts = next((name for name in ("vbatLatest", "vbat") if name in log), None)
    if volts is None:
        return None, []
    version = re.search(r"(Betaflight|INAV|EmuFlight|Cleanflight)\D*(\d+)\.?(\d*)", revision)
    unit = None
    if version is not None and version[1] == "INAV":
        unit = 0.01
    elif version is not None:
        own = int(version[2]), int(version[3] or 0)
        unit = next((volt for name, since, volt in _VOLTS if name == version[1] and own >= since), None)
    if unit is None:
        return None, [f"battery: left out: the unit of {volts} is not known for '{revision or 'this firmware'}'."]
    current = next((name for name in ("amperageLatest", "amperage") if name in log), None)
    known = current is not None and unit == 0.01
    amperes = log.column(current) / 100.0 if current and known else np.full(len(t_s), np.nan)
    return Stream(t_s, np.column_stack([log.column(volts) * unit, amperes]), BATTERY_COLUMNS), []


def _state(log: BlackboxLog, t_s: Array) -> tuple[Stream | None, list[str]]:
    """INAV's own estimate; no other firmware of this family logs one.

    navPos and navVel are centimetres north, east and up of where it first knew its position; attitude is in tenths of a
    degree, yaw clockwise from north (imu.c, navigation_pos_estimator.c). Ours is x north, y west, z up.
    """
    if not all(log.elements(name) == 3 for name in ("navPos", "navVel", "attitude")):
        return None, []
    scale = log.number("gyro_scale", 0.0)
    if scale <= 0.0:
        return None, ["state: left out: the header has no gyro_scale."]
    north_west_up = np.array([0.01, -0.01, 0.01])
    roll, pitch, yaw = np.radians(0.1 * log.array("attitude")).T
    rates = np.radians(np.column_stack([log.column(f"gyroADC[{i}]") for i in range(3)]) * scale)
    values = [log.array("navPos") * north_west_up, log.array("navVel") * north_west_up]
    values += [quat_from_euler(roll, pitch, -yaw), rates]
    return Stream(t_s, np.hstack(values), STATE_COLUMNS), ["state: navPos, navVel, attitude and gyroADC."]


def _motors(log: BlackboxLog, t_s: Array, vehicle: Vehicle, source: str) -> tuple[Stream, list[str]]:
    count, escs = log.elements("motor"), log.elements("eRPM")
    if not count:
        raise BadInput(f"{source}: holds no motor values (motor[0] and on); log them.")
    if count < 3:
        surfaces = f" and {log.elements('servo')} servos" if log.elements("servo") else ""
        raise BadInput(
            f"{source}: is not the log of a multicopter: it has {count} "
            f"motor{'s' if count > 1 else ''}{surfaces}; give a log of one with "
            "three rotors or more."
        )
    check_count(vehicle, count, f"motor[0] to motor[{count - 1}]", source)
    order, notes = list(range(count)), []
    frame = "not told by the log, motor i is taken for rotor i"
    if count == BETAFLIGHT_QUAD_X.count:
        order, notes = motor_order(vehicle, BETAFLIGHT_QUAD_X, source)
        frame = BETAFLIGHT_QUAD_X.name
    turned = escs == count and bool(log.array("eRPM").any())
    kind = wanted_input(vehicle, {"command": True, "rotor_speed": turned}, source)
    if kind == "rotor_speed":
        values, said = _speeds(log, source)
        wires = [f"eRPM[{i}]" for i in range(count)]
    else:
        values, said = _commands(log, source)
        wires = [f"motor[{i}]" for i in range(count)]
    stream = Stream(t_s, values[:, order], motor_columns(kind, count))
    return stream, [motor_map(order, wires, frame), *notes, said, *slow_note("motors", stream, MOTORS_SLOW_HZ, _SLOW)]


def _commands(log: BlackboxLog, source: str) -> tuple[Array, str]:
    """What the ESCs were sent, as a share of their protocol's range.

    Raises:
        BadInput: the header gives no range, or the values lie outside it.
    """
    if int(log.number("features", 0.0)) & _BOTH_WAYS:
        raise BadInput(
            f"{source}: its motors turn both ways (the feature 3D of Betaflight, REVERSIBLE_MOTORS of INAV), which is "
            'not read; log eRPM (a vehicle file with input = "rotor_speed"), or switch the feature off.'
        )
    sent = log.array("motor")
    low, _, high = log.headers.get("motorOutput", "").partition(",")
    protocol = log.number("motor_pwm_protocol", -1.0)
    top = float(high) if high.strip().isdigit() else 0.0
    # INAV logs pulses whatever goes to the ESC, and maps mincommand and maxthrottle to DShot's ends (mixer.c).
    inav = "INAV" in log.headers.get("Firmware revision", "")
    digital = not inav and (protocol >= _FIRST_DIGITAL or (protocol < 0.0 and top > 2000.0))
    if digital:
        least, full, said = _DSHOT_LEAST, _DSHOT_FULL, "DShot, from 48 to 2047"
    else:
        least, full = _PULSE_LEAST, log.number("maxthrottle", top)
        said = f"pulses from {least:g} to maxthrottle {full:g}"
    idle = float(low) if low.strip().isdigit() else 0.0
    contradicted = idle >= _PULSE_LEAST if digital else 0.0 < idle < _PULSE_SHORTEST and not inav
    if contradicted or full <= least or float(np.mean(sent > full + 1.0)) > 0.01:
        raise BadInput(
            f"{source}: motor values of {np.min(sent):g} to {np.max(sent):g} do not fit the header's range "
            f"(motorOutput '{low},{high}', motor_pwm_protocol {protocol:g}; tested: {said}); say the scale with "
            "`groundstation convert --map`."
        )
    return np.clip((sent - least) / (full - least), 0.0, 1.0), f"motors: motor[] as {said}."


def _speeds(log: BlackboxLog, source: str) -> tuple[Array, str]:
    """Rotor speeds from electrical ones: eRPM counts hundreds of electrical revolutions per minute.

    Raises:
        BadInput: the header does not say how many poles the motors have.
    """
    poles = log.number("motor_poles", 0.0)
    if poles < 2.0:
        raise BadInput(
            f"{source}: eRPM is electrical, and the header has no motor_poles; count the motor's magnets, and give "
            'input = "command", or the scale with `groundstation convert --map`.'
        )
    return log.array("eRPM") * 100.0 / (0.5 * poles) * _RPM, f"motors: eRPM over {0.5 * poles:g} pole pairs."
