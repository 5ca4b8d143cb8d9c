r"""The prediction model: what predicts a flight best from what its vehicle records, beside the physical model.

A physical parameter is a claim about the vehicle. Rotor speeds that arrive filtered, late or over a radio lose the
torque, and an open loop with all of it drifts away, however right the tensor. This model takes each signal for what it
is worth:

    v' = R (G_T T / m (1 + c |v_xy|^2) e_z - D v_b + f) - g e_z
    w' = G (J^-1 tau - (1 - s) [J^-1 tau]_slow) - L w + K (v_b,y, -v_b,x, 0) + b + d - J^-1 (w x J w)

with v_b the velocity in the body, thrust T and torque tau of the rotors as the base model (physical or declared) has
them, delayed and led by du/dt. G in [0, 4] are the gains the signals are worth, s is the share of the torque's slow
part: what holds a trim that the model does not know turns nothing. D is drag, c translational lift, L damping, K the
moment of flapping rotors (Faessler, Franchi and Scaramuzza 2018; Mahony, Kumar and Corke 2012). d and f are a
disturbance that an observer of constant gains tells from the past (Luenberger 1971, An introduction to observers); each
fades with a time of its own. A window starts from the observer's rates, less or more of the measured ones put in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.json_types import Document, JsonObject
from groundstation.model.flight_states import FlightStates
from groundstation.model.predictive_kernel import (
    DELAY,
    FLAPPING,
    SLOW_TIME,
    integrated,
    observed,
    observer_means,
    seen,
    simulated,
    window_means,
)
from groundstation.model.rotors import declared_thrust, wrench_matrix
from groundstation.model.vehicle_model import VehicleModel

Array = NDArray[np.float64]

GRID_S = 0.005
"""Grid of the rotor signals: well below the time in which a rotor answers."""
KEPT_MEANS = 6
"""Sets of the numbers that rotor signals depend on whose means are kept: a point, and its differences by each."""
OBSERVED_S = 0.008
"""Between two stamps that the observer takes: of denser ones it takes each n-th, and where a window starts.

Its gains act over longer.
"""


@dataclass(frozen=True, slots=True)
class Number:
    """One number of the model: its range, where a fit starts, and the spread it is shrunk with."""

    name: str
    low: float
    high: float
    start: float
    spread: float
    pose: bool = False


def _axes(axes: str, of_each: Number) -> tuple[Number, ...]:
    """The same number for several axes; ``{}`` in its name stands for the axis."""
    return tuple(replace(of_each, name=of_each.name.format(axis)) for axis in axes)


NUMBERS: tuple[Number, ...] = (
    Number("thrust_gain", 0.5, 2.0, 1.0, 0.1, pose=True),
    *_axes("xyz", Number("drag_{}_1_s", 0.0, 5.0, 0.3, 0.5, pose=True)),
    Number("translational_lift_s2_m2", -0.05, 0.05, 0.0, 0.01, pose=True),
    *_axes("xyz", Number("torque_gain_{}", 0.0, 4.0, 0.6, 0.5)),
    *_axes("xyz", Number("damping_{}_1_s", 0.0, 60.0, 4.0, 5.0)),
    *_axes("xy", Number("flapping_{}_rad_s_m", -60.0, 60.0, 0.0, 5.0, pose=True)),
    *_axes("xyz", Number("trim_{}_rad_s2", -100.0, 100.0, 0.0, 2.0)),
    Number("delay_s", 0.0, 0.1, 0.01, 0.02),
    Number("lead_s", 0.0, 0.1, 0.005, 0.02),
    Number("slow_torque_share", 0.0, 1.0, 0.7, 0.3),
    Number("slow_torque_time_s", 0.2, 10.0, 2.0, 1.0),
    Number("rate_bandwidth_xy_1_s", 2.0, 400.0, 40.0, 20.0),
    Number("disturbance_gain_xy", 0.0, 2.0, 0.5, 0.5),
    Number("disturbance_time_xy_s", 0.02, 10.0, 0.2, 0.2),
    Number("rate_bandwidth_z_1_s", 2.0, 400.0, 40.0, 20.0),
    Number("disturbance_gain_z", 0.0, 2.0, 0.5, 0.5),
    Number("disturbance_time_z_s", 0.02, 10.0, 0.2, 0.2),
    Number("measured_rate_share", 0.0, 1.0, 0.8, 0.3),
    Number("force_bandwidth_1_s", 0.0, 20.0, 0.5, 0.5, pose=True),
    Number("force_time_s", 0.05, 20.0, 2.0, 1.0, pose=True),
)
"""Ranges hold what a multirotor can have; starts and spreads are a small vehicle's, and weigh little against a flight's
data.
"""
NAMES = tuple(number.name for number in NUMBERS)
WITHOUT_TORQUE = (
    "torque_gain_x",
    "torque_gain_y",
    "torque_gain_z",
    "slow_torque_share",
    "slow_torque_time_s",
    "delay_s",
    "lead_s",
)
"""Numbers that are zero or idle in the smaller model that leaves the rotors' torque alone."""


@dataclass(frozen=True, slots=True)
class Base:
    """The rotors' thrust and torque, and the inertia, that gains refer to; taken from the physical or the declared
    model.
    """

    mass_kg: float
    tensor: Array
    com_m: tuple[float, float, float]
    thrust_scale: float
    lag_up_s: float
    lag_down_s: float
    lag_slope: float
    delay_s: float

    @classmethod
    def of(cls, model: VehicleModel) -> Base:
        """Of a vehicle's model."""
        return cls(
            model.mass_kg, np.asarray(model.tensor, dtype=float), model.com_m, model.thrust_scale,
            model.lag_up_s, model.lag_down_s, model.lag_slope, model.delay_s,
        )  # fmt: skip

    def to_dict(self) -> JsonObject:
        """For a model document."""
        fields = {name: getattr(self, name) for name in self.__slots__}
        return fields | {"tensor": [[float(x) for x in row] for row in self.tensor], "com_m": list(self.com_m)}


@dataclass(frozen=True, slots=True)
class PredictiveModel:
    """A prediction model: the base it refers to, and its numbers in the order of :data:`NAMES`."""

    base: Base
    values: Array

    def value(self, name: str) -> float:
        """One number by its name."""
        return float(self.values[NAMES.index(name)])

    def with_values(self, names: Sequence[str], values: Array) -> PredictiveModel:
        """The same with some numbers replaced, held inside their ranges."""
        out = self.values.copy()
        for name, value in zip(names, values, strict=True):
            number = NUMBERS[NAMES.index(name)]
            out[NAMES.index(name)] = min(max(float(value), number.low), number.high)
        return replace(self, values=out)

    def to_dict(self) -> JsonObject:
        """For a model document."""
        return {"base": self.base.to_dict(), "numbers": dict(zip(NAMES, map(float, self.values), strict=True))}

    @classmethod
    def from_dict(cls, document: Document) -> PredictiveModel:
        """Inverse of :meth:`to_dict`.

        Raises:
            BadInput: a number is missing, is none, or lies outside its range.
        """
        try:
            base = {name: document["base"][name] for name in Base.__slots__}
            tensor = np.array(base.pop("tensor"), dtype=float).reshape(3, 3)
            x, y, z = (float(c) for c in base.pop("com_m"))
            rest = {name: float(value) for name, value in base.items()}
            values = np.array([float(document["numbers"][name]) for name in NAMES])
        except (KeyError, TypeError, ValueError):
            raise BadInput("the model's [prediction] section is incomplete; identify again.") from None
        for number, value in zip(NUMBERS, values, strict=True):
            if not number.low - 1e-9 <= value <= number.high + 1e-9:
                raise BadInput(
                    f"the model's [prediction] has {number.name} = {value:g}, outside {number.low:g} to "
                    f"{number.high:g}; identify again."
                )
        if rest["mass_kg"] <= 0.0 or np.linalg.eigvalsh(tensor)[0] <= 0.0:
            raise BadInput("the model's [prediction.base] belongs to no rigid body; identify again.")
        return cls(Base(tensor=tensor, com_m=(x, y, z), **rest), values)


def starting(model: VehicleModel) -> PredictiveModel:
    """Where a fit starts: the base model's own damping, everything else by :data:`NUMBERS`."""
    base = Base.of(model)
    found = PredictiveModel(base, np.array([number.start for number in NUMBERS]))
    damping = np.maximum(np.asarray(model.damping_nms) / np.diag(base.tensor), 4.0)
    return found.with_values(("damping_x_1_s", "damping_y_1_s", "damping_z_1_s"), np.minimum(damping, 30.0))


@dataclass(frozen=True, slots=True)
class Course:
    """A flight as the kernels take it: contiguous arrays, the rotor signals on their grid."""

    t_s: Array
    position: Array
    velocity: Array
    quaternion: Array
    rate: Array
    rotor: Array
    rotor_start_s: float
    tensor: Array
    inverse: Array
    gravity_m_s2: float
    pose: bool


def course(base: Base, states: FlightStates) -> Course:
    """A flight's starts and rotor signals for a base model."""
    vehicle, motors = states.vehicle, states.motors
    lagged = motors.lagged(base.lag_up_s, base.lag_down_s, base.lag_slope)
    wrench = declared_thrust(vehicle, lagged) @ wrench_matrix(vehicle).T * base.thrust_scale
    force = wrench[:, :3]
    torque = wrench[:, 3:] - np.cross(np.asarray(base.com_m), force)
    inverse = np.asarray(np.linalg.inv(base.tensor), dtype=float)
    signals = np.concatenate([force[:, 2:] / base.mass_kg, torque @ inverse.T, force[:, :2] / base.mass_kg], axis=1)
    size = max(1, round(GRID_S / motors.step_s))
    count = max(len(signals) // size, 2)
    rotor = signals[: count * size].reshape(count, size, 6).mean(axis=1) if len(signals) >= count * size else signals
    q = states.start_quaternion
    pose = bool(np.isfinite(q).all(axis=1).mean() > 0.5)
    known = np.isfinite(q).all(axis=1, keepdims=True)
    return Course(
        t_s=np.ascontiguousarray(states.t_s, dtype=float),
        position=np.ascontiguousarray(np.nan_to_num(states.start_position_m)),
        velocity=np.ascontiguousarray(np.nan_to_num(states.start_velocity_m_s)),
        quaternion=np.ascontiguousarray(np.where(known, q, [1.0, 0.0, 0.0, 0.0])),
        rate=np.ascontiguousarray(states.start_rate_rad_s, dtype=float),
        rotor=np.ascontiguousarray(rotor),
        rotor_start_s=motors.start_s + base.delay_s,
        tensor=np.ascontiguousarray(base.tensor),
        inverse=np.ascontiguousarray(inverse),
        gravity_m_s2=vehicle.gravity_m_s2,
        pose=pose,
    )


@dataclass(frozen=True, slots=True)
class Windows:
    """Starts on a course, and what the kernels need of the course for them, whatever the numbers are.

    Attributes:
        flown: the course.
        t_s, rate, inputs: stamps that the observer takes, measured rates there, and what it needs of them
            (:func:`.seen`).
        at: which of those the windows start from, (k,).
        start_s, pose: times of the starts, and positions, velocities and attitudes there, (k, 10).
        made: means of the rotor signals by the numbers that they depend on; most of a fit's trials leave those alone.
    """

    flown: Course
    t_s: Array
    rate: Array
    inputs: Array
    at: NDArray[np.int64]
    start_s: Array
    pose: Array
    made: dict[tuple[bytes, float, int], tuple[Array, Array]] = field(
        default_factory=dict[tuple[bytes, float, int], tuple[Array, Array]]
    )

    def means(self, values: Array, step_s: float, steps: int) -> tuple[Array, Array]:
        """Mean rotor signals between the observer's stamps, and over each step of the windows."""
        key = values[DELAY : SLOW_TIME + 1].tobytes(), step_s, steps
        if key not in self.made:
            if len(self.made) >= KEPT_MEANS:
                self.made.pop(next(iter(self.made)))
            delay = float(values[DELAY])
            rotor = (integrated(self.flown.rotor, GRID_S, values), self.flown.rotor_start_s, GRID_S)
            self.made[key] = (
                observer_means(self.t_s, self.inputs, rotor, delay),
                window_means(self.start_s, rotor, delay, step_s, steps),
            )
        return self.made[key]

    def only(self, chosen: NDArray[np.bool_]) -> Windows:
        """Some of the starts, behind the same observer."""
        return Windows(
            self.flown, self.t_s, self.rate, self.inputs, self.at[chosen], self.start_s[chosen], self.pose[chosen]
        )


def windows(flown: Course, index: NDArray[np.int64]) -> Windows:
    """The windows that start from stamps ``index`` of a course."""
    c = flown
    every = max(1, int(OBSERVED_S / max(float(np.median(np.diff(c.t_s))), 1e-4)))
    taken = np.union1d(np.arange(0, len(c.t_s), every), index)
    pose = np.concatenate([c.position, c.velocity, c.quaternion], axis=1)
    body = (c.tensor, c.inverse, c.gravity_m_s2)
    inputs = seen(c.t_s[taken], c.velocity[taken], c.quaternion[taken], c.rate[taken], body)
    at = np.searchsorted(taken, index)
    return Windows(c, c.t_s[taken], c.rate[taken], inputs, at, c.t_s[index], np.ascontiguousarray(pose[index]))


def run(values: Array, begun: Windows, horizons: Sequence[float], step_s: float = GRID_S) -> Array:
    """States (position, velocity, attitude, rates) of windows at each horizon (ascending), (m, k, 13)."""
    c = begun.flown
    if not c.pose:  # velocities are unknown, and what depends on them is left out
        values = values.copy()
        values[FLAPPING : FLAPPING + 2] = 0.0
    marks = np.array([max(1, round(h / step_s)) for h in horizons], dtype=np.int64)
    between, ahead = begun.means(values, step_s, int(marks[-1]))
    rates, extras = observed(begun.rate, begun.inputs, between, values, c.pose)
    starts = (begun.pose, rates[begun.at], extras[begun.at])
    return simulated(starts, ahead, values, (c.tensor, c.inverse, c.gravity_m_s2), step_s, marks)


def simulate(
    model: PredictiveModel, states: FlightStates, index: NDArray[np.int64], horizons: Sequence[float]
) -> dict[float, dict[str, Array]]:
    """The states at each horizon, as :func:`groundstation.model.prediction.predict` judges them; NaN where no pose is
    known.
    """
    found = run(model.values, windows(course(model.base, states), index), horizons)
    known = np.isfinite(states.start_quaternion[index]).all(axis=1, keepdims=True)
    blank = np.where(known, 1.0, np.nan)
    return {
        h: {
            "position": x[:, :3] * blank,
            "velocity": x[:, 3:6] * blank,
            "quaternion": x[:, 6:10] * blank,
            "rate": x[:, 10:],
        }
        for h, x in zip(horizons, found, strict=True)
    }
