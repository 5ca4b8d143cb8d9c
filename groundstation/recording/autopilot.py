"""What logs of autopilots share: frames, motor numbering, and sentences about streams that are too slow.

PX4 and ArduPilot write NED in the world and FRD in the body. With N -> x, -E -> y, -D -> z and F -> x, -R -> y, -D ->
z, world and body both turn by pi about x, so that a vector changes the signs of y and z, and so does a quaternion's
vector part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import Stream
from groundstation.recording.airframes import Airframe
from groundstation.recording.tables import MissingField
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

MOTORS_SLOW_HZ = 50.0  # a rotor lag of 50 ms needs at least this


def z_up(vector: Array) -> Array:
    """A vector of NED or FRD in the frame with z up, shape (..., 3)."""
    return vector * np.array([1.0, -1.0, -1.0])


def z_up_quaternion(quaternion: Array) -> Array:
    """A quaternion from FRD to NED as one from FLU to the world with z up, scalar first, shape (..., 4)."""
    return quaternion * np.array([1.0, 1.0, -1.0, -1.0])


def motor_order(vehicle: Vehicle, airframe: Airframe, source: str) -> tuple[list[int], list[str]]:
    """For each rotor of the vehicle file, which of the log's motors it is: the assignment that lies closest.

    Positions are compared in units of their own root mean square, so that a frame that is known by angles alone matches
    any size; where rotors share a place (coaxial pairs) the turning direction decides.

    Args:
        vehicle: declared; its rotors stand in the file's own order.
        airframe: the log's motors in the autopilot's order.
        source: the log, for messages.

    Returns:
        Indices from 0, one per rotor of the vehicle file, and a note where turning directions differ.

    Raises:
        BadInput: the log drives another number of motors, or they stand elsewhere.
    """
    from scipy.optimize import linear_sum_assignment

    check_count(vehicle, airframe.count, airframe.name, source)
    declared, logged = _scaled(np.asarray(vehicle.rotors.position_m)[:, :2]), _scaled(airframe.position)
    apart = np.linalg.norm(declared[:, None] - logged[None, :], axis=2)
    spin = airframe.spin or tuple(vehicle.rotors.spin)
    turned = np.array([[0.1 * (mine != theirs) for theirs in spin] for mine in vehicle.rotors.spin])
    order = [int(motor) for motor in linear_sum_assignment(apart + turned)[1]]
    far = max(float(apart[rotor, motor]) for rotor, motor in enumerate(order))
    if far > _FAR:
        raise BadInput(
            f"{source}: the log's frame is {airframe.name}, and the rotors of '{vehicle.name}' do not stand like that "
            "(one is "
            f"{far:.1f} arms away in the best match); correct position_m, or give the file of the vehicle that flew."
        )
    return order, spin_notes(vehicle, order, airframe.spin)


_FAR = 0.6  # of the mean arm, 35 degrees: half of what neighbours of a hexa are apart


def _scaled(position: Array) -> Array:
    """Positions about their mean in units of their root mean square distance."""
    centred = position - position.mean(axis=0)
    return centred / max(float(np.sqrt(np.mean(np.sum(centred**2, axis=1)))), 1e-9)


def check_count(vehicle: Vehicle, motors: int, frame: str, source: str) -> None:
    """Raise where the log drives another number of motors than the vehicle file declares."""
    if motors != vehicle.rotors.count:
        raise BadInput(
            f"{source}: the log drives {motors} motors ({frame}), the vehicle file of '{vehicle.name}' has "
            f"{vehicle.rotors.count} rotors; give the file of the vehicle that flew."
        )


def motor_map(order: Sequence[int], wires: Sequence[str], frame: str) -> str:
    """The one note on which output of the log became which rotor of the vehicle file."""
    pairs = ", ".join(f"rotor {rotor + 1} is motor {motor + 1} ({wires[motor]})" for rotor, motor in enumerate(order))
    return f"motors: {pairs}; frame {frame}."


def spin_notes(vehicle: Vehicle, order: Sequence[int], logged_spin: Sequence[int]) -> list[str]:
    """A note where the vehicle file's turning directions contradict the autopilot's."""
    if not logged_spin:
        return []
    differ = [i + 1 for i, motor in enumerate(order) if logged_spin[motor] != vehicle.rotors.spin[i]]
    if not differ:
        return []
    return [f"motors: the autopilot says that rotors {differ} turn the other way than the vehicle file; check spin."]


def running(t_s: Array, command: Array) -> tuple[float, float]:
    """First and last time at which the motors' mean is above a tenth of its range, so when settings matter."""
    level = np.nan_to_num(command).mean(axis=1)
    on = np.flatnonzero(level - level.min() > 0.1 * np.ptp(level)) if len(level) else np.empty(0, int)
    return (float(t_s[on[0]]), float(t_s[on[-1]])) if len(on) else (-np.inf, np.inf)


def slow_note(name: str, stream: Stream, least_hz: float, remedy: str) -> list[str]:
    """A note where a stream is too slow to identify from."""
    rate = stream.rate_hz()
    if rate >= least_hz:
        return []
    return [f"{name}: {rate:.0f} Hz is too slow to identify inertias and lags ({least_hz:.0f} Hz or more); {remedy}"]


def wanted_input(vehicle: Vehicle, available: Mapping[str, bool], source: str) -> str:
    """The motor values to take: what the vehicle file declares, or commands where speeds were asked for and top speed
    is.

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


def present(name: str, read: Callable[[], tuple[Stream | None, list[str]]]) -> tuple[Stream | None, list[str]]:
    """An optional stream, or none and a note where the log lacks a field for it."""
    try:
        return read()
    except MissingField as error:
        return None, [f"{name}: left out: {error}."]


def one_line(error: BaseException) -> str:
    """A library's error as a part of a sentence."""
    return " ".join(str(error).split())[:120] or type(error).__name__
