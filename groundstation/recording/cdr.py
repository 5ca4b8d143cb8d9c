"""ROS 2 messages to bytes and back: plain CDR, little endian (OMG DDS-XTypes 1.3, 7.4.1; XCDR version 1).

Each primitive is aligned to its own size, counted from after the four bytes of encapsulation header. Messages of one
size are decoded all at once through a NumPy record type; those with strings or sequences one by one.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ENCAPSULATION = b"\x00\x01\x00\x00"
_SECONDS_MAX = 2**31 - 1
_NANOSECONDS_MAX_S = 9.2e9


def stamp_ns(seconds: float) -> int:
    """A time in whole nanoseconds, the nearest; 0 where that is no time 64 bits hold. May be negative."""
    return round(seconds * 1e9) if abs(seconds) < _NANOSECONDS_MAX_S else 0


def seconds_of_ns(nanoseconds: NDArray[np.int64]) -> Array:
    """Seconds of whole nanoseconds. A device that counts micro- or nanoseconds gets its own double back."""
    return nanoseconds / 1e9


def unsigned_ns(seconds: float) -> int:
    """A time for MCAP's unsigned 64-bit fields: clipped to what they hold."""
    return min(max(stamp_ns(seconds), 0), 2**63 - 1)


def ros_stamp(seconds: float) -> tuple[int, int]:
    """``builtin_interfaces/Time``: whole seconds (rounded down, clipped to 32 bits) and nanoseconds."""
    whole, rest = divmod(stamp_ns(seconds), 1_000_000_000)
    return (whole, rest) if -_SECONDS_MAX <= whole <= _SECONDS_MAX else (0, 0)


# Offsets below count from after the encapsulation header. A header is sec (4), nanosec (4), length of frame_id (4) and
# frame_id with its NUL; what follows is aligned to 8.
_IMU = struct.Struct("<4siII5s7x4d9d3d9d3d9d")
_POSE = struct.Struct("<4siII6s6x7d")
_BATTERY = struct.Struct("<4siII8s7f4BIII1s3xI1s")
_OWN = struct.Struct("<4siII6s6xdd")  # header with frame_id "world", device_s, received_s: 40 bytes
_MOTORS_HEAD = struct.Struct("<B3xI")
_SETPOINT = struct.Struct("<4d")
_STATE = struct.Struct("<13d")
_ZEROS9 = (0.0,) * 9
_NO_ORIENTATION = (0.0, 0.0, 0.0, 1.0, -1.0, *(0.0,) * 8)
_NAN = math.nan


def imu(device_s: float, gyro: Sequence[float], accel: Sequence[float]) -> bytes:
    """``sensor_msgs/Imu``; its first orientation covariance is -1: no orientation, as that message defines."""
    return _IMU.pack(
        *(ENCAPSULATION, *ros_stamp(device_s), 5, b"body\0"), *_NO_ORIENTATION, *gyro, *_ZEROS9, *accel, *_ZEROS9
    )


def pose(device_s: float, position: Sequence[float], quaternion: Sequence[float]) -> bytes:
    """``geometry_msgs/PoseStamped`` from a scalar-first quaternion."""
    w, x, y, z = quaternion
    return _POSE.pack(ENCAPSULATION, *ros_stamp(device_s), 6, b"world\0", *position, x, y, z, w)


def battery(device_s: float, voltage: float, current: float) -> bytes:
    """``sensor_msgs/BatteryState``: discharging counts negative there, and single precision is all it has."""
    with np.errstate(over="ignore"):
        volts, amperes = float(np.float32(voltage)), float(np.float32(-current))
    return _BATTERY.pack(
        *(ENCAPSULATION, *ros_stamp(device_s), 8, b"battery\0", volts, _NAN, amperes, _NAN, _NAN, _NAN, _NAN),
        *(2, 0, 0, 1, 0, 0, 1, b"\0", 1, b"\0"),
    )


def own_header(device_s: float, received_s: float) -> bytes:
    """Header and exact times that begin every message of our own."""
    return _OWN.pack(ENCAPSULATION, *ros_stamp(device_s), 6, b"world\0", device_s, received_s)


def motors(device_s: float, received_s: float, kind: int, values: Sequence[float]) -> bytes:
    """``groundstation_msgs/Motors``."""
    count = len(values)
    return own_header(device_s, received_s) + _MOTORS_HEAD.pack(kind, count) + struct.pack(f"<{count}d", *values)


def setpoint(device_s: float, received_s: float, values: Sequence[float]) -> bytes:
    """``groundstation_msgs/Setpoint``: x, y, z, yaw."""
    return own_header(device_s, received_s) + _SETPOINT.pack(*values)


def state(device_s: float, received_s: float, values: Sequence[float]) -> bytes:
    """``groundstation_msgs/State`` from values in the order of ``STATE_COLUMNS``."""
    x, y, z, vx, vy, vz, qw, qx, qy, qz, *rate = values
    return own_header(device_s, received_s) + _STATE.pack(x, y, z, qx, qy, qz, qw, vx, vy, vz, *rate)


def exact(device_s: float, received_s: float, values: Sequence[float] = ()) -> bytes:
    """``groundstation_msgs/Exact``."""
    head = struct.pack("<4sddI", ENCAPSULATION, device_s, received_s, len(values))
    return head + (b"\0\0\0\0" + struct.pack(f"<{len(values)}d", *values) if len(values) else b"")


class Encoder:
    """Appends fields with their alignment to a message that begins with :func:`own_header`."""

    def __init__(self, head: bytes) -> None:
        self._data = bytearray(head)

    def _align(self, size: int) -> None:
        self._data += b"\0" * (-(len(self._data) - 4) % size)

    def byte(self, value: int) -> Encoder:
        """uint8 or bool."""
        self._data.append(value)
        return self

    def count(self, value: int) -> Encoder:
        """uint32: the length of a sequence."""
        self._align(4)
        self._data += struct.pack("<I", value)
        return self

    def blob(self, value: bytes) -> Encoder:
        """uint8[]."""
        self.count(len(value))
        self._data += value
        return self

    def text(self, value: str) -> Encoder:
        """String, with its NUL."""
        return self.blob(value.encode("utf-8", "replace") + b"\0")

    def doubles(self, values: Sequence[float]) -> Encoder:
        """float64[]."""
        self.count(len(values))
        if len(values):
            self._align(8)
            self._data += struct.pack(f"<{len(values)}d", *values)
        return self

    def bytes(self) -> bytes:
        """The message."""
        return bytes(self._data)


class Decoder:
    """Reads fields with their alignment, starting after :func:`own_header` unless told otherwise."""

    def __init__(self, data: bytes, offset: int = _OWN.size) -> None:
        self._data = data
        self._at = offset

    def _align(self, size: int) -> None:
        self._at += -(self._at - 4) % size

    def byte(self) -> int:
        """uint8 or bool."""
        self._at += 1
        return self._data[self._at - 1]

    def count(self) -> int:
        """uint32."""
        self._align(4)
        self._at += 4
        return struct.unpack_from("<I", self._data, self._at - 4)[0]

    def blob(self) -> bytes:
        """uint8[]."""
        size = self.count()
        self._at += size
        return self._data[self._at - size : self._at]

    def text(self) -> str:
        """String."""
        return self.blob()[:-1].decode("utf-8", "replace")

    def doubles(self) -> tuple[float, ...]:
        """float64[]."""
        size = self.count()
        if not size:
            return ()
        self._align(8)
        self._at += 8 * size
        return struct.unpack_from(f"<{size}d", self._data, self._at - 8 * size)


def own_times(data: bytes, offset: int = _OWN.size - 16) -> tuple[float, float]:
    """device_s and received_s of a message of our own."""
    return struct.unpack_from("<dd", data, offset)


_HEADER_FIELDS = [("encapsulation", "V4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4"), ("frame", "V12")]
_OWN_FIELDS = [*_HEADER_FIELDS, ("device_s", "<f8"), ("received_s", "<f8")]

IMU_RECORD = np.dtype(
    [
        *_HEADER_FIELDS,
        *(("orientation", "<f8", 13), ("gyro", "<f8", 3), ("_g", "<f8", 9), ("accel", "<f8", 3), ("_a", "<f8", 9)),
    ]
)
POSE_RECORD = np.dtype([*_HEADER_FIELDS, ("position", "<f8", 3), ("xyzw", "<f8", 4)])
BATTERY_RECORD = np.dtype(
    [*_HEADER_FIELDS[:-1], ("frame", "V8"), ("voltage", "<f4"), ("_t", "<f4"), ("current", "<f4"), ("_rest", "V41")]
)
SETPOINT_RECORD = np.dtype([*_OWN_FIELDS, ("values", "<f8", 4)])
STATE_RECORD = np.dtype(
    [*_OWN_FIELDS, ("position", "<f8", 3), ("xyzw", "<f8", 4), ("velocity", "<f8", 3), ("rate", "<f8", 3)]
)


def motors_record(count: int) -> np.dtype:
    """Record type of a Motors message with that many values."""
    return np.dtype([*_OWN_FIELDS, ("kind", "u1"), ("_pad", "V3"), ("count", "<u4"), ("values", "<f8", (count,))])


def record_stamp_ns(record: NDArray) -> NDArray[np.int64]:
    """Header stamps of decoded records in nanoseconds."""
    return record["sec"].astype(np.int64) * 1_000_000_000 + record["nanosec"].astype(np.int64)
