"""Sample types that flow from a vehicle to the station, and their wire form (MessagePack through msgspec).

World: z up. Body: x forward, y left, z up. Quaternions scalar first, body to world. SI units. Every sample carries the
device's own time; the arrival time on the host is added where it arrives.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class _Sample(msgspec.Struct, frozen=True, array_like=True, tag=True, kw_only=False):
    device_s: float


class Imu(_Sample, frozen=True, array_like=True, tag="imu"):
    """One inertial sample in the body: rates, and specific force (+g on z at rest)."""

    gyro_rad_s: Vector3
    accel_m_s2: Vector3


class Pose(_Sample, frozen=True, array_like=True, tag="pose"):
    """One motion-capture pose of the marker body in the world; the stamp is the exposure."""

    position_m: Vector3
    quaternion: Quaternion


class Motors(_Sample, frozen=True, array_like=True, tag="motors"):
    """Rotor speeds (rad/s), or commands (0..1), or the wrench, as ``kind`` says."""

    values: tuple[float, ...]
    kind: Literal["rotor_speed", "command", "wrench"] = "rotor_speed"


class Battery(_Sample, frozen=True, array_like=True, tag="battery"):
    """Battery at the terminals."""

    voltage_v: float
    current_a: float


class Setpoint(_Sample, frozen=True, array_like=True, tag="setpoint"):
    """What the vehicle was told to follow."""

    position_m: Vector3
    yaw_rad: float


class State(_Sample, frozen=True, array_like=True, tag="state"):
    """The vehicle's own estimate: velocity in the world, rates in the body."""

    position_m: Vector3
    velocity_m_s: Vector3
    quaternion: Quaternion
    rate_rad_s: Vector3


class Event(_Sample, frozen=True, array_like=True, tag="event"):
    """Something that happened: phase changes, texts of the autopilot, guard actions, clock estimates."""

    kind: str
    text: str


class Raw(_Sample, frozen=True, array_like=True, tag="raw"):
    """A raw frame of a link, as it came or went."""

    direction: Literal["in", "out"]
    data: bytes


Sample = Imu | Pose | Motors | Battery | Setpoint | State | Event | Raw


class Batch(msgspec.Struct, frozen=True, array_like=True):
    """Samples in order of arrival, with a sequence number so that losses can be counted.

    Attributes:
        sequence: counts batches from 0 without gaps.
        host_s: the host's monotonic time at which each sample arrived; simulated in lock-step.
        samples: the samples.
        until_s: host time up to which nothing is missing; of a lock-stepped vehicle, where its time stands.
    """

    sequence: Annotated[int, msgspec.Meta(ge=0, le=2**53)]
    host_s: tuple[float, ...]
    samples: tuple[Sample, ...]
    until_s: float = 0.0


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Batch)


def encode_batch(batch: Batch) -> bytes:
    """Wire form of a batch."""
    return _encoder.encode(batch)


def decode_batch(data: bytes) -> Batch:
    """Inverse of :func:`encode_batch`.

    Raises:
        ValueError: the bytes are not a batch.
    """
    try:
        return _decoder.decode(data)
    except (msgspec.DecodeError, RecursionError) as error:
        raise ValueError(f"not a batch of samples: {error}") from None
