"""The gate of a MAVLink message: every field that is used here lies in a range that can be, or the message is refused.

A frame's checksum says that it arrived as it was sent, not that it says something possible: infinity and NaN are legal
IEEE floats on the wire. What passes here needs no further check where it is used. Total: it raises for no message.

Ranges are far outside of what a small multirotor does, and far inside of what doubles and nanoseconds in 64 bits carry,
so that no arithmetic behind the gate overflows.
"""

from __future__ import annotations

from math import sqrt

from drivers.mavlink.dialect import Message, mavlink

Range = tuple[float, float]

_METRES: Range = (-1e6, 1e6)
_M_S: Range = (-1e3, 1e3)
_M_S2: Range = (-1e4, 1e4)
_RAD: Range = (-10.0, 10.0)  # angles come in -pi..pi or 0..2 pi
_RAD_S: Range = (-1e3, 1e3)
_MICROSECONDS: Range = (0.0, 4e15)  # since boot, or since 1970 until the year 2096
_NANOSECONDS: Range = (0.0, 4e18)
_UNIT: Range = (-1.1, 1.1)
_BIG: Range = (-1e9, 1e9)

_POSITION = {"x": _METRES, "y": _METRES, "z": _METRES}
_VELOCITY = {"vx": _M_S, "vy": _M_S, "vz": _M_S}
_RATES = {"rollspeed": _RAD_S, "pitchspeed": _RAD_S, "yawspeed": _RAD_S}

RANGES: dict[str, dict[str, Range]] = {
    "ATTITUDE": {"roll": _RAD, "pitch": _RAD, "yaw": _RAD, **_RATES},
    "ATTITUDE_QUATERNION": {"q1": _UNIT, "q2": _UNIT, "q3": _UNIT, "q4": _UNIT, **_RATES},
    "LOCAL_POSITION_NED": {**_POSITION, **_VELOCITY},
    "ODOMETRY": {"time_usec": _MICROSECONDS, **_POSITION, **_VELOCITY, **_RATES, "q": _UNIT},
    "HIGHRES_IMU": {
        "time_usec": _MICROSECONDS,
        **{f"{axis}acc": _M_S2 for axis in "xyz"},
        **{f"{axis}gyro": _RAD_S for axis in "xyz"},
    },
    "RAW_IMU": {"time_usec": _MICROSECONDS},
    "ACTUATOR_OUTPUT_STATUS": {"time_usec": _MICROSECONDS},
    "ESC_STATUS": {"time_usec": _MICROSECONDS},
    "TIMESYNC": {"tc1": _NANOSECONDS, "ts1": (-9e18, 9e18)},
    "VIBRATION": {f"vibration_{axis}": _BIG for axis in "xyz"},
    "STORAGE_INFORMATION": {"available_capacity": _BIG},
    "NAMED_VALUE_FLOAT": {"value": _BIG},
}
"""What is used of a message, and between which values; integers that any value of suits are left out."""

_QUATERNIONS = {"ATTITUDE_QUATERNION": ("q1", "q2", "q3", "q4"), "ODOMETRY": ("q",)}
_LEAST_NORM, _MOST_NORM = 0.9, 1.1
_CODES = {"COMMAND_ACK": ("result", "MAV_RESULT"), "EXTENDED_SYS_STATE": ("landed_state", "MAV_LANDED_STATE")}


def refusal(message: Message) -> str:
    """Why a message is not believed, as "roll is inf"; empty for one that is."""
    name = message.get_type()
    for field, (low, high) in RANGES.get(name, {}).items():
        for value in _values(message, field):
            if not low <= value <= high:  # written so that NaN is refused
                return f"{field} is {value:g}"
    if name in _QUATERNIONS:
        norm = sqrt(sum(v * v for field in _QUATERNIONS[name] for v in _values(message, field)))
        if not _LEAST_NORM <= norm <= _MOST_NORM:
            return f"the quaternion's length is {norm:.3g}"
    if name in _CODES:
        field, enum = _CODES[name]
        if getattr(message, field, None) not in mavlink.enums[enum]:
            return f"{field} is {getattr(message, field, None)}, which is none"
    return ""


def _values(message: Message, field: str) -> tuple[float, ...]:
    value = getattr(message, field, None)
    return tuple(value) if isinstance(value, list | tuple) else () if value is None else (value,)
