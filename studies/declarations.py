"""Wrong declarations on drawn flights, with a plan and without, and what the checks say of them
(``benchmarks.declarations``).

Flights are drawn as in the study (vehicles of 30 g to 3 kg, gentle and fast, with disturbance, noise, latency and clock
offsets).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from groundstation.errors import BadInput
from groundstation.flightdata import STATE_COLUMNS, FlightData, Stream
from groundstation.frames import quat_conjugate
from groundstation.identification.declarations import check_declarations
from groundstation.recording.repair import repair
from groundstation.vehicle import Vehicle

OUT = Path(__file__).resolve().parent.parent / "docs" / "results" / "declarations.json"
Change = Callable[[FlightData, np.random.Generator], FlightData]


def _with(flight: FlightData, name: str, change: Callable[[np.ndarray], np.ndarray]) -> FlightData:
    stream = getattr(flight, name)
    if stream is None:
        return flight
    return replace(flight, **{name: replace(stream, values=change(stream.values.copy()))})


def _rotors(flight: FlightData, **update: object) -> FlightData:
    rotors = flight.vehicle.rotors.model_copy(update=update)
    return replace(flight, vehicle=flight.vehicle.model_copy(update={"rotors": rotors}))


def swapped_rotors(flight: FlightData, random: np.random.Generator) -> FlightData:
    """Motors in another order than declared: any but the right one."""
    count = flight.vehicle.rotors.count
    order = np.arange(count)
    while np.array_equal(order, np.arange(count)):
        order = random.permutation(count)
    return _with(flight, "motors", lambda v: v[:, order])


def _mass(flight: FlightData, factor: float) -> FlightData:
    vehicle: Vehicle = flight.vehicle
    return replace(flight, vehicle=vehicle.model_copy(update={"mass_kg": vehicle.mass_kg * factor}))


def _pose(
    flight: FlightData, position: np.ndarray | None, quaternion: Callable[[np.ndarray], np.ndarray]
) -> FlightData:
    def change(values: np.ndarray) -> np.ndarray:
        if position is not None:
            values[:, :3] = values[:, :3] @ position.T
        values[:, 3:7] = quaternion(values[:, 3:7])
        return values

    return _with(flight, "mocap", change)


def _imu(flight: FlightData, gyro: np.ndarray, accel: np.ndarray) -> FlightData:
    return _with(flight, "imu", lambda v: np.column_stack([v[:, :3] @ gyro.T, v[:, 3:6] @ accel.T]))


def _times(flight: FlightData, factor: float) -> FlightData:
    streams = {name: Stream(s.t_s * factor, s.values, s.columns, None) for name, s in flight.streams().items()}
    window = None if flight.window_s is None else (flight.window_s[0] * factor, flight.window_s[1] * factor)
    return replace(flight, window_s=window, **streams)


FLIP = np.diag([1.0, -1.0, -1.0])
TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
MIRROR = np.diag([-1.0, 1.0, 1.0])


def _same(values: np.ndarray) -> np.ndarray:
    return values


def state_velocity(flight: FlightData, random: np.random.Generator) -> FlightData:
    """The state's velocity in NED beside a position in ENU."""
    return _with(flight, "state", lambda v: np.column_stack([v[:, :3], v[:, 3:6] @ NED.T, v[:, 6:]]))


WRONG: dict[str, Change] = {
    "rotors in another order": swapped_rotors,
    "spins the other way": lambda f, r: _rotors(f, spin=tuple(-s for s in f.vehicle.rotors.spin)),
    "spins side by side": lambda f, r: _rotors(
        f, spin=(1, -1, 1, -1) if f.vehicle.rotors.spin != (1, -1, 1, -1) else (1, 1, -1, -1)
    ),
    "quaternion x y z w": lambda f, r: _pose(f, None, lambda q: q[:, [1, 2, 3, 0]]),
    "quaternion world to body": lambda f, r: _pose(f, None, quat_conjugate),
    "pose in NED and FRD": lambda f, r: _pose(f, FLIP, lambda q: q * np.array([1.0, 1.0, -1.0, -1.0])),
    "positions in NED": lambda f, r: _pose(f, NED, _same),
    "positions y up": lambda f, r: _pose(f, Y_UP, _same),
    "positions mirrored": lambda f, r: _pose(f, MIRROR, _same),
    "positions in millimetres": lambda f, r: _pose(f, 1000.0 * np.eye(3), _same),
    "IMU in FRD": lambda f, r: _imu(f, FLIP, FLIP),
    "gyro alone in FRD": lambda f, r: _imu(f, FLIP, np.eye(3)),
    "IMU turned by 90 degrees": lambda f, r: _imu(f, TURN, TURN),
    "gyro mirrored": lambda f, r: _imu(f, MIRROR, np.eye(3)),
    "velocity of the state in NED": state_velocity,
    "gyro in degrees": lambda f, r: _imu(f, np.degrees(1.0) * np.eye(3), np.eye(3)),
    "accelerometer in g": lambda f, r: _imu(f, np.eye(3), np.eye(3) / 9.80665),
    "rotor speeds in rpm": lambda f, r: _with(f, "motors", lambda v: v * 60.0 / (2.0 * np.pi)),
    "electrical rad/s of 14 poles": lambda f, r: _with(f, "motors", lambda v: 7.0 * v),
    "turns per second": lambda f, r: _with(f, "motors", lambda v: v / (2.0 * np.pi)),
    "time in milliseconds": lambda f, r: _times(f, 1e3),
    "time in microseconds": lambda f, r: _times(f, 1e6),
    "time in nanoseconds": lambda f, r: _times(f, 1e9),
    "mass 2.5 times too large": lambda f, r: _mass(f, 2.5),
    "mass 0.4 of the right one": lambda f, r: _mass(f, 0.4),
    "thrust constant 1.3 times": lambda f, r: _rotors(
        f, thrust_coefficient_n_s2=1.3 * f.vehicle.rotors.thrust_coefficient_n_s2
    ),
}


def unplanned(flight: FlightData) -> FlightData:
    """The same flight as anyone records it: no plan, no setpoints, no known window, rotor speeds at 100 Hz behind a 20
    ms filter.
    """
    from scipy.signal import lfilter

    motors = flight.motors
    keep = np.exp(-float(np.median(np.diff(motors.t_s))) / 0.02)
    slow = lfilter([1.0 - keep], [1.0, -keep], motors.values - motors.values[0], axis=0) + motors.values[0]
    every = max(1, round(motors.rate_hz() / 100.0))
    received = None if motors.received_s is None else motors.received_s[::every]
    thin = Stream(motors.t_s[::every], slow[::every], motors.columns, received)
    return replace(flight, plan=None, setpoint=None, window_s=None, motors=thin)


def verdict(flight: FlightData) -> list[str]:
    """Names of the checks that speak up, or what reading refuses."""
    try:
        read = repair(flight)
    except BadInput as refusal:
        return [f"refused: {str(refusal)[:60]}"]
    return [check.name for check in check_declarations(read) if check.verdict in ("contradicted", "doubtful")]


def as_right(flight: FlightData) -> FlightData:
    """With the true mass declared: the study declares up to 15 % off, which is what the thrust check speaks of."""
    assert flight.truth is not None
    return replace(flight, vehicle=flight.vehicle.model_copy(update={"mass_kg": flight.truth.mass_kg}))


def with_state(flight: FlightData) -> FlightData:
    """With an estimate of the vehicle's own beside it: poses, their slope, and the attitudes' rates."""
    from groundstation.recording.derive import body_rates

    mocap = flight.mocap
    assert mocap is not None
    speed = np.gradient(mocap.values[:, :3], mocap.t_s, axis=0)
    values = np.column_stack(
        [mocap.values[:, :3], speed, mocap.values[:, 3:], body_rates(mocap.t_s, mocap.values[:, 3:])]
    )
    return replace(flight, state=Stream(mocap.t_s, values, STATE_COLUMNS, mocap.received_s))
