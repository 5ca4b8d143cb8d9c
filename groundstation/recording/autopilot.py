"""What PX4 and ArduPilot logs share: frames, motor numbering, and sentences about streams that are too slow.

Both write NED in the world and FRD in the body. With N -> x, -E -> y, -D -> z and F -> x, -R -> y, -D -> z, world and
body both turn by pi about x, so that a vector changes the signs of y and z, and so does a quaternion's vector part.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import Stream
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

MOTORS_SLOW_HZ = 50.0  # a rotor lag of 50 ms needs at least this
QUAD_X = ((1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (-1.0, -1.0))
"""Both autopilots' quad X, motor 1 first: front right, rear left, front left, rear right; (x, y) in FLU."""


def z_up(vector: Array) -> Array:
    """A vector of NED or FRD in the frame with z up, shape (..., 3)."""
    return vector * np.array([1.0, -1.0, -1.0])


def z_up_quaternion(quaternion: Array) -> Array:
    """A quaternion from FRD to NED as one from FLU to the world with z up, scalar first, shape (..., 4)."""
    return quaternion * np.array([1.0, 1.0, -1.0, -1.0])


def motor_order(vehicle: Vehicle, layout: Array) -> tuple[list[int], list[str]]:
    """For each rotor of the vehicle file, which of the autopilot's motors it is.

    Args:
        vehicle: declared; its rotors stand in the file's own order.
        layout: (x, y) of the autopilot's motors in FLU, in its order, in any unit, shape (n, 2).

    Returns:
        Indices from 0, one per rotor of the vehicle file, and a note where the order differs or is a guess.

    Raises:
        BadInput: the autopilot drives another number of motors.
    """
    count = vehicle.rotors.count
    if len(layout) != count:
        raise BadInput(f"the log has {len(layout)} motors, the vehicle file {count}; give the file of this vehicle.")
    declared = _bearings(np.asarray(vehicle.rotors.position_m)[:, :2])
    logged = _bearings(layout)
    apart = np.abs((declared[:, None] - logged[None, :] + np.pi) % (2.0 * np.pi) - np.pi)
    order = [int(i) for i in np.argmin(apart, axis=1)]
    if len(set(order)) != count or float(np.max(np.min(apart, axis=1))) > np.radians(30.0):
        return list(range(count)), [
            "motors: the autopilot's geometry does not match the vehicle file's rotor positions; "
            "its motor i is taken for rotor i. Check position_m."
        ]
    if order == list(range(count)):
        return order, []
    said = ", ".join(f"rotor {rotor + 1} is motor {motor + 1}" for rotor, motor in enumerate(order))
    return order, [f"motors: sorted into the vehicle file's order by position ({said})."]


def _bearings(position: Array) -> Array:
    return np.arctan2(position[:, 1], position[:, 0])


def spin_notes(vehicle: Vehicle, order: list[int], logged_spin: list[int]) -> list[str]:
    """A note where the vehicle file's turning directions contradict the autopilot's."""
    differ = [i + 1 for i, motor in enumerate(order) if logged_spin[motor] != vehicle.rotors.spin[i]]
    if not differ:
        return []
    return [f"motors: the autopilot says that rotors {differ} turn the other way than the vehicle file; check spin."]


def slow_note(name: str, stream: Stream, least_hz: float, remedy: str) -> list[str]:
    """A note where a stream is too slow to identify from."""
    rate = stream.rate_hz()
    if rate >= least_hz:
        return []
    return [f"{name}: {rate:.0f} Hz is too slow to identify inertias and lags ({least_hz:.0f} Hz or more); {remedy}"]


def wanted_input(vehicle: Vehicle, available: Mapping[str, bool], source: str) -> str:
    """The motor values to take: what the vehicle file declares, or commands where speeds were asked for and top speed is.

    Raises:
        BadInput: the log has the other kind alone.
    """
    kind = vehicle.rotors.input
    if available.get(kind):
        return kind
    if kind == "rotor_speed" and available.get("command") and vehicle.rotors.speed_max_rad_s is not None:
        return "command"
    has = [name for name, there in available.items() if there]
    if not has:
        raise BadInput(
            f"{source}: holds no motor outputs; log them (docs/formats.md says which settings) and fly again."
        )
    raise BadInput(
        f"{source}: has no {'rotor speeds' if kind == 'rotor_speed' else f'motor values of the kind {kind}'}; "
        f'give a vehicle file with input = "{has[0]}".'
    )


def one_line(error: BaseException) -> str:
    """A library's error as a part of a sentence."""
    return " ".join(str(error).split())[:120] or type(error).__name__
