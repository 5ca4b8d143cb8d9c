"""What the forces on a vehicle can depend on: the signals every effect model is written in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import quat_rotate_inverse
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Signals:
    """k instants of one flight, or k parallel simulations at one instant. Unknown signals are NaN.

    What follows from them is worked out once, and cannot be written to.

    Attributes:
        t_s: time from the start of the flight, shape (k,).
        position_m, velocity_world_m_s: of the declared origin in the world, shape (k, 3).
        quaternion: attitude, (k, 4).
        rate_rad_s: body rates, (k, 3).
        motor: recorded motor values (speed, command or wrench) delayed but not lagged, (k, n).
        lagged: motor values after the rotor lag, (k, n); equal to ``motor`` where speeds were measured.
        lagged_rate: time derivative of ``lagged``, (k, n).
        thrust_n: thrust of each rotor by the declared constants, (k, n).
        voltage_v: battery voltage, (k,).
        charge_as: charge drawn since the start, (k,).
    """

    t_s: Annotated[Array, "k"]
    position_m: Annotated[Array, "k 3"]
    velocity_world_m_s: Annotated[Array, "k 3"]
    quaternion: Annotated[Array, "k 4"]
    rate_rad_s: Annotated[Array, "k 3"]
    motor: Annotated[Array, "k n"]
    lagged: Annotated[Array, "k n"]
    lagged_rate: Annotated[Array, "k n"]
    thrust_n: Annotated[Array, "k n"]
    voltage_v: Annotated[Array, "k"]
    charge_as: Annotated[Array, "k"]

    def velocity_body_m_s(self) -> Annotated[Array, "k 3"]:
        """Velocity over ground in body axes, (k, 3)."""
        return self._once("velocity", lambda: quat_rotate_inverse(self.quaternion, self.velocity_world_m_s))

    def axis_body(self, axis: int) -> Annotated[Array, "k 3"]:
        """An axis of the world in body axes, (k, 3)."""
        unit = np.broadcast_to(np.eye(3)[axis], (len(self.t_s), 3))
        return self._once(f"axis {axis}", lambda: quat_rotate_inverse(self.quaternion, unit))

    def at(self, rows: slice | NDArray[np.bool_] | NDArray[np.int64]) -> Signals:
        """Some of the instants, in double precision."""
        return Signals(*(np.asarray(getattr(self, each.name)[rows], dtype=float) for each in fields(self)))

    @cached_property
    def _known(self) -> dict[str, Array]:
        return {}

    def _once(self, name: str, made: Callable[[], Array]) -> Array:
        if name not in self._known:
            self._known[name] = made()
            self._known[name].flags.writeable = False
        return self._known[name]


def hover_share(signals: Signals, vehicle: Vehicle) -> Annotated[Array, "k"]:
    """Sum of rotor speeds over its value at hover, shape (k,): how much rotor there is to be dragged."""
    if vehicle.rotors.input == "wrench":
        return np.ones(len(signals.t_s))
    speed = np.sqrt(np.maximum(signals.thrust_n, 0.0))
    hover = vehicle.rotors.count * np.sqrt(vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count)
    return speed.sum(axis=1) / hover
