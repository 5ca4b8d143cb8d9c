"""ArduPilot's JSON interface (libraries/SITL/examples/JSON/readme.md of its sources): a UDP packet of servo outputs in,
one line of JSON out, in lock-step. The firmware's time is the one we send.
"""

from __future__ import annotations

import json
import struct

from drivers.mavlink.geometry import flip, flip_quaternion
from sim.mavlink.airframe import Airframe

_HEADER = struct.Struct("<HHI")
_CHANNELS = {18458: 16, 29569: 32}
"""Servo channels by the packet's magic number."""


class JsonExchange:
    """Answers servo packets with the state one frame later.

    Args:
        airframe: the physics.
        rotors: how many of the servo outputs drive it, from the first.

    Attributes:
        time_s: physics time.
        missed: frames the firmware counted that never reached us.
    """

    def __init__(self, airframe: Airframe, rotors: int):
        self._airframe, self._rotors = airframe, rotors
        self._frame: int | None = None
        self._last_line = b""
        self.time_s = 0.0
        self.missed = 0

    def answer(self, packet: bytes) -> bytes | None:
        """The line that answers a packet; None for what is no servo packet.

        A frame counted twice is a resend after a lost answer: it is answered again and moves nothing. A count that
        falls back is a restarted firmware.
        """
        parsed = _parse(packet)
        if parsed is None:
            return None
        rate_hz, frame, widths = parsed
        if frame == self._frame:
            return self._last_line
        if self._frame is not None and frame > self._frame:
            self.missed += frame - self._frame - 1
        self._frame = frame
        dt = 1.0 / max(rate_hz, 1)
        self._airframe.step(dt, tuple(_command(width) for width in widths[: self._rotors]))
        self.time_s += dt
        self._last_line = self._line()
        return self._last_line

    def _line(self) -> bytes:
        state, imu = self._airframe.state, self._airframe.imu()
        document = {
            "timestamp": self.time_s,
            "imu": {"gyro": list(flip(imu.gyro_rad_s)), "accel_body": list(flip(imu.accel_m_s2))},
            "position": list(flip(state.position_m)),
            "quaternion": list(flip_quaternion(state.quaternion)),
            "velocity": list(flip(state.velocity_m_s)),
            "battery": {"voltage": state.voltage_v, "current": state.current_a},
        }
        return b"\n" + json.dumps(document, separators=(",", ":")).encode() + b"\n"


def _parse(packet: bytes) -> tuple[int, int, tuple[int, ...]] | None:
    """Frame rate (Hz), frame count and pulse widths (us)."""
    if len(packet) < _HEADER.size:
        return None
    magic, rate_hz, frame = _HEADER.unpack_from(packet)
    channels = _CHANNELS.get(magic)
    if channels is None or len(packet) != _HEADER.size + 2 * channels:
        return None
    return rate_hz, frame, struct.unpack_from(f"<{channels}H", packet, _HEADER.size)


def _command(width_us: int) -> float:
    """Rotor command of a pulse width: 1000 us stops, 2000 us is full speed; 0 is no pulse."""
    return min(1.0, max(0.0, (width_us - 1000) / 1000.0))
