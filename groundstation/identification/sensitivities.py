"""What each parameter of the table (:mod:`groundstation.model.parameters`) changes of the rates and specific forces.

Two forms: along the measured motion, and along the planned one, which owes nothing to a flight's disturbances (the
instruments). Each gives d(prediction)/d(parameter) as rates (blocks, 3) and specific forces (blocks, 3) at the fit's
rate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import skew
from groundstation.linear_filters import first_order
from groundstation.model.parameters import BASIS, PAIRS, TENSOR, FitOptions, Parameters, free_entries
from groundstation.model.rotors import Lag, thrusts_for

if TYPE_CHECKING:
    from groundstation.identification.record_model import Predicted, RecordModel

Array = NDArray[np.float64]
Pair = tuple[Array, Array]


TIMING = ("input_delay_s", "rotor_lag_s", "rotor_lag_up_s", "rotor_lag_down_s", "rotor_lag_slope")
"""Parameters whose sensitivity is a difference."""
TIME_STEP_S = 1e-3
SLOPE_STEP = 0.05
"""Of differences by a time and by a lag's slope."""
HELD_MOST_S = 0.02
"""Longest time between commands over which a difference is taken: motion changes within more."""


def _turning() -> Array:
    out = np.zeros((3, len(PAIRS), len(PAIRS)))
    for entry, basis in enumerate(BASIS):
        for product, (i, j) in enumerate(PAIRS):
            out[:, entry, product] += (skew(np.eye(3)[i]) @ basis)[:, j]
            if i != j:
                out[:, entry, product] += (skew(np.eye(3)[j]) @ basis)[:, i]
    return out


TURNING = _turning()
"""Omega x J omega per entry of the tensor and product of two rates, both in the order of PAIRS, (3, 6, 6)."""


@dataclass(frozen=True, slots=True)
class Step:
    """Where rotors are worked out once more for a difference: their lag, the dead time, and how far that is."""

    lag: Lag
    delay_s: float
    size: float


def lag_of(p: Parameters) -> Lag:
    """Of the rotors."""
    return p.lag_up_s, p.lag_down_s, p.lag_slope


def timing_steps(p: Parameters, options: FitOptions, held_s: float) -> dict[str, Step]:
    """Of each free parameter that delays the inputs.

    Commands that hold for ``held_s`` make stairs. Samples that come as often see each stair at one place, where being a
    little later changes nothing, or all of it, unless a lag smooths them: only over a whole stair is a difference the
    slope.
    """
    stairs = max(p.lag_up_s, p.lag_down_s) < held_s
    least = max(TIME_STEP_S, min(held_s, HELD_MOST_S)) if stairs else TIME_STEP_S
    size = max(least, 0.02 * max(p.lag_up_s, p.lag_down_s))
    up, down, slope = lag_of(p)
    found = {
        "input_delay_s": Step((up, down, slope), p.delay_s + least, least),
        "rotor_lag_s": Step((up + size, down + size, slope), p.delay_s, size),
        "rotor_lag_up_s": Step((up + size, down, slope), p.delay_s, size),
        "rotor_lag_down_s": Step((up, down + size, slope), p.delay_s, size),
        "rotor_lag_slope": Step((up, down, slope + SLOPE_STEP), p.delay_s, SLOPE_STEP),
    }
    free = {entry.name for entry in free_entries(options)}
    return {name: step for name, step in found.items() if name in free}


class Point:
    """A record's model at given parameters.

    Attributes:
        inverse: of the tensor, (3, 3). arm: from a force to the torque c x F, (3, 3), to multiply from the right.
        blank: no change, (blocks, 3).
    """

    def __init__(self, model: RecordModel, p: Parameters):
        self.model = model
        self.p = p
        self.inverse = np.asarray(np.linalg.inv(p.tensor), dtype=float)
        self.arm = skew(p.com_m).T
        self.blank = np.zeros((len(model.t_s), 3))

    def along(self, axis: int, values: Array | float) -> Array:
        """Values on one axis, (blocks, 3)."""
        out = self.blank.copy()
        out[:, axis] = values
        return out

    @cached_property
    def impulse(self) -> Array:
        """Running integral of the rotors' force, (blocks, 3)."""
        raise NotImplementedError


class Measured(Point):
    """Along the measured motion: sensitivities are analytic, those of lag and delay are differences of the exact
    lag.
    """

    def __init__(self, model: RecordModel, p: Parameters, prediction: Predicted):
        super().__init__(model, p)
        self.prediction = prediction

    @cached_property
    def impulse(self) -> Array:
        """Of the predicted force."""
        return self.prediction.impulse[:, :3]

    def moved(self, name: str) -> Pair:
        """By a lag, its slope or the dead time: a difference of the exact lag."""
        force, impulse = self.prediction.moved[name]
        torque = impulse[:, 3:] - impulse[:, :3] @ self.arm
        return torque @ self.inverse.T, force / self.p.mass_kg


class Planned(Point):
    """Along the planned motion.

    A thrust y behind a lag: y' = (u - y) / tau, so dy/dtau = -y' through the same lag, of rising or falling rotors.
    Where its rate is (1 + s x) / tau, dy/ds = tau x y' through the lag, with x of the command u = y + tau y' above
    hover's.
    """

    def __init__(self, model: RecordModel, p: Parameters):
        super().__init__(model, p)
        if model.planned is None:
            raise ValueError("no planned motion was given for this record")
        plan = self.plan = model.planned
        rate = plan.rate_rad_s
        self.wrench = np.zeros((len(rate), 6))
        self.wrench[:, 2] = p.mass_kg * plan.specific_thrust_m_s2
        self.wrench[:, 3:] = plan.angular_acceleration_rad_s2 @ p.tensor + np.cross(rate, rate @ p.tensor)

    @cached_property
    def impulse(self) -> Array:
        """Of the planned thrust."""
        return self.model.integrated(self.wrench[:, :3])

    @cached_property
    def mean_rate(self) -> Array:
        """(blocks, 3)."""
        return self.model.average(self.plan.rate_rad_s)

    @cached_property
    def turned(self) -> Array:
        """Integrals of products of the rates, (blocks, 6)."""
        return self.model.integrated_products(self.plan.rate_rad_s)

    @cached_property
    def slope(self) -> Array:
        """Rate of change of the planned wrench, (k, 6)."""
        return np.asarray(np.gradient(self.wrench, self.model.record.t_s, axis=0), dtype=float)

    @cached_property
    def to_rotors(self) -> Array:
        """From [F_z, tau] to rotors' thrusts, (4, n)."""
        return thrusts_for(self.model.record.vehicle).T

    @cached_property
    def by_rotor(self) -> Array:
        """Rate of change of each rotor's thrust, (k, n)."""
        return self.slope[:, 2:] @ self.to_rotors

    @cached_property
    def rising(self) -> Array:
        """Of rotors that speed up, behind their lag, (k, n)."""
        return self.behind_lag(np.maximum(self.by_rotor, 0.0), self.p.lag_up_s)

    @cached_property
    def falling(self) -> Array:
        """Of rotors that slow down, behind their lag, (k, n)."""
        return self.behind_lag(np.minimum(self.by_rotor, 0.0), self.p.lag_down_s)

    def later(self, values: Array) -> Pair:
        """What a wrench (k, 6) that is taken away changes."""
        mean = self.model.integrated(values[:, 3:])
        return -mean @ self.inverse.T, -self.model.average(values[:, :3]) / self.p.mass_kg

    def later_rotors(self, thrusts: Array) -> Pair:
        """The same of rotors' thrusts (k, n)."""
        return self.later(thrusts @ self.model.matrix.T)

    def behind_lag(self, values: Array, lag_s: float) -> Array:
        """Columns at the IMU's stamps through a first-order lag, shape kept."""
        if lag_s < 1e-4:
            return values
        keep = float(np.exp(-self.model.sample_s / lag_s))
        return first_order((1.0 - keep, 0.0), -keep, values)


def _measured_entry(index: int) -> Callable[[Measured], Pair]:
    def sensitivity(at: Measured) -> Pair:
        column = at.model.turned @ TURNING[:, index].T
        return -(at.prediction.rate @ BASIS[index].T + column) @ at.inverse.T, at.blank

    return sensitivity


def _planned_entry(index: int) -> Callable[[Planned], Pair]:
    return lambda at: (
        -(at.mean_rate @ BASIS[index].T + at.turned @ TURNING[:, index].T) @ at.inverse.T,
        at.blank,
    )


def _planned_slope(at: Planned) -> Pair:
    p, model = at.p, at.model
    asked = at.wrench[:, 2:] @ at.to_rotors + np.where(at.by_rotor > 0.0, p.lag_up_s, p.lag_down_s) * at.by_rotor
    above = model.record.vehicle.motor_for_thrust(asked) / model.record.motors.hover - 1.0
    change = p.lag_up_s * at.behind_lag(above * at.rising, p.lag_up_s)
    change += p.lag_down_s * at.behind_lag(above * at.falling, p.lag_down_s)
    return at.later_rotors(-change)


def _moved(name: str) -> Callable[[Measured], Pair]:
    return lambda at: at.moved(name)


def _forces_alone(pair: Pair) -> Pair:
    return np.zeros_like(pair[0]), pair[1]


def _accel_bias(axis: int) -> Callable[[Point], Pair]:
    return lambda at: (at.blank, at.along(axis, 1.0))


EITHER: dict[str, Callable[[Point], Pair]] = {
    "com_offset_x_m": lambda at: (-at.impulse @ skew(np.eye(3)[0]).T @ at.inverse.T, at.blank),
    "com_offset_y_m": lambda at: (-at.impulse @ skew(np.eye(3)[1]).T @ at.inverse.T, at.blank),
    "yaw_trim_nm": lambda at: (at.along(2, at.model.elapsed_s) @ at.inverse.T, at.blank),
    "accel_bias_x_m_s2": _accel_bias(0),
    "accel_bias_y_m_s2": _accel_bias(1),
    "accel_bias_z_m_s2": _accel_bias(2),
}
"""Of parameters that act alike along either motion."""

MEASURED: dict[str, Callable[[Measured], Pair]] = {
    "mass_kg": lambda at: (at.blank, -at.prediction.force / at.p.mass_kg**2),
    **{name: _measured_entry(index) for index, name in enumerate(TENSOR)},
    **{name: _moved(name) for name in TIMING},
    "accel_delay_s": lambda at: _forces_alone(MEASURED["input_delay_s"](at)),
}

PLANNED: dict[str, Callable[[Planned], Pair]] = {
    "mass_kg": lambda at: (at.blank, -at.model.average(at.wrench[:, :3]) / at.p.mass_kg**2),
    **{name: _planned_entry(index) for index, name in enumerate(TENSOR)},
    "input_delay_s": lambda at: at.later(at.slope),
    "rotor_lag_s": lambda at: at.later_rotors(at.rising + at.falling),
    "rotor_lag_up_s": lambda at: at.later_rotors(at.rising),
    "rotor_lag_down_s": lambda at: at.later_rotors(at.falling),
    "rotor_lag_slope": _planned_slope,
    "accel_delay_s": lambda at: _forces_alone(PLANNED["input_delay_s"](at)),
}


def sensitivity_of(name: str) -> Callable[[Measured], Pair]:
    """Of one parameter, along the measured motion."""
    return EITHER[name] if name in EITHER else MEASURED[name]


def measured_sensitivities(at: Measured, options: FitOptions) -> dict[str, Pair]:
    """Of each parameter that is free, and of each wrench term of the model, by name."""
    found = {entry.name: sensitivity_of(entry.name)(at) for entry in free_entries(options)}
    for term, means in zip(at.model.extra, at.model.extra_means, strict=True):
        if means.against is not None and means.against >= 3:
            found[term.name] = np.outer(means.integral, at.inverse[:, means.against - 3]), at.blank
            continue
        integral, push = means.dense()
        torque = integral[:, 3:] - integral[:, :3] @ at.arm
        found[term.name] = torque @ at.inverse.T, push / at.p.mass_kg
    return found


def planned_sensitivities(model: RecordModel, p: Parameters, options: FitOptions) -> Array:
    """Those of a record's plan at ``p``, shape (blocks, 6, P), columns as in :meth:`.RecordModel.evaluate`."""
    at = Planned(model, p)
    found = {
        entry.name: EITHER[entry.name](at) if entry.name in EITHER else PLANNED[entry.name](at)
        for entry in free_entries(options)
    }
    for term, value in zip(model.extra, at.plan.extra, strict=True):
        mean, push = model.means_of(term, value).dense()
        found[term.name] = mean[:, 3:] @ at.inverse.T, push / p.mass_kg
    return stacked(found)


MEMORY = 40.0
"""Lags after which a rotor has forgotten what was asked of it, to the last bit."""


def planned_parts(model: RecordModel, p: Parameters, options: FitOptions) -> Iterator[tuple[slice, Array]]:
    """Blocks and :func:`planned_sensitivities`, part by part.

    A part begins with the last block of the one before, from which its integrals go on.
    """
    before_s, last = MEMORY * max(p.lag_up_s, p.lag_down_s), None
    for blocks in model.parts():
        overlap = 0 if last is None else 1
        part = model.part(slice(blocks.start - overlap, blocks.stop), before_s)
        found = planned_sensitivities(part, p, options)
        if last is not None:
            found[:, :3] += last - found[0, :3]
        last = found[-1, :3].copy()
        yield blocks, found[overlap:]


def stacked(found: dict[str, Pair]) -> Array:
    """Columns (rate, force) of each parameter side by side, (blocks, 6, P); each column's samples lie together."""
    first = next(iter(found.values()))[0]
    out = np.empty((6, len(found), len(first)))
    for column, (rate, force) in enumerate(found.values()):
        out[:3, column], out[3:, column] = rate.T, force.T
    return out.transpose(2, 0, 1)
