"""A vehicle's model simulated ahead from many starts at once, with the recorded inputs (RK4, thrusts averaged over each
step).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import quat_exp, quat_multiply
from groundstation.model.disturbance import Carried, TurningDisturbance, carried, fading, gains
from groundstation.model.flight_states import FlightStates
from groundstation.model.rigid_kernel import Body, stepped, turned
from groundstation.model.rotors import (
    MotorInput,
    cumulative,
    declared_thrust,
    interpolate_columns,
    wrench_matrix,
)
from groundstation.model.signals import Signals
from groundstation.model.vehicle_model import RememberingWrench, VehicleModel

Array = NDArray[np.float64]
Index = NDArray[np.int64]
State = tuple[Array, Array, Array, Array]
"""Position and velocity in the world, attitude, body rates, a row each."""

STEP_S = 0.005


def constant_velocity(states: FlightStates, index: Index, horizons: Sequence[float]) -> dict[float, dict[str, Array]]:
    """The guess that nothing changes: velocity and rate stay what they were."""
    p, v = states.start_position_m[index], states.start_velocity_m_s[index]
    q, w = states.start_quaternion[index], states.start_rate_rad_s[index]
    return {
        h: {"position": p + h * v, "velocity": v, "quaternion": quat_multiply(q, quat_exp(h * w)), "rate": w}
        for h in horizons
    }


@dataclass(frozen=True, slots=True)
class Inputs:
    """What the rotors of a model do over the flight, on the motors' grid: thrusts and their running integral."""

    thrust: Array
    impulse: Array

    @classmethod
    def of(cls, model: VehicleModel, motors: MotorInput) -> Inputs:
        thrust = declared_thrust(model.vehicle, _lagged(model, motors)) * model.thrust_scale
        held = not motors.measured and model.lag_up_s <= 1e-6 and model.lag_down_s <= 1e-6
        return cls(thrust, cumulative(thrust, motors.step_s, held=held))


def _lagged(model: VehicleModel, motors: MotorInput) -> Array:
    """Motor values behind a model's lag, on their grid."""
    return motors.lagged(model.lag_up_s, model.lag_down_s, model.lag_slope)


class Motion:
    """Accelerations of a model's vehicle in one flight's signals."""

    def __init__(self, model: VehicleModel, states: FlightStates):
        self.model, self._motors, self._start_s = model, states.motors, states.t_s[0]
        self.inputs = Inputs.of(model, states.motors)
        self._matrix = wrench_matrix(model.vehicle)
        self._inverse = np.asarray(np.linalg.inv(model.tensor), dtype=float)
        self._wrench = model.wrench
        self._com, self._damping = np.asarray(model.com_m), np.asarray(model.damping_nms)

    @cached_property
    def _rotors(self) -> tuple[Array, Array]:
        """Lagged motor values and their slope, on the motors' grid: forces may depend on them."""
        lagged = _lagged(self.model, self._motors)
        return lagged, np.gradient(lagged, self._motors.step_s, axis=0)

    def at(self, values: Array, when: Array) -> Array:
        """Columns of the motors' grid at times of the flight."""
        return interpolate_columns(when - self.model.delay_s, self._motors.start_s, self._motors.step_s, values)

    def begin(self, states: FlightStates, index: Index) -> None:
        """Let what has a past go on, in windows side by side, from what it was at stamps of the flight."""
        if isinstance(self.model.wrench, RememberingWrench):
            self._wrench = self.model.wrench.begun(self.flown(states), index)

    def flown(self, states: FlightStates) -> Signals:
        """Signals along the flight, as far as the past alone tells them."""
        t_s, known = states.t_s, np.isfinite(states.start_quaternion).all(axis=1, keepdims=True)
        q = np.where(known, states.start_quaternion, [1.0, 0.0, 0.0, 0.0])
        rotors = self.at(self.inputs.thrust, t_s)
        parts = (states.start_position_m, states.start_velocity_m_s, q, states.start_rate_rad_s)
        return self._signals(t_s, parts, rotors, states.voltage_v)

    def wrench(self, when: Array, state: State, rotors: Array, voltage: Array) -> Array:
        """Body force and torque of the model's effects, (k, 6)."""
        if self._wrench is None:
            return np.zeros((len(when), 6))
        return np.nan_to_num(self._wrench(self._signals(when, state, rotors, voltage)))

    def along(self, flown: Signals) -> Array:
        """The same along a flight."""
        wrench = self.model.wrench
        return np.zeros((len(flown.t_s), 6)) if wrench is None else np.nan_to_num(wrench(flown))

    def _signals(self, when: Array, state: State, rotors: Array, voltage: Array) -> Signals:
        p, v, q, w = state
        return Signals(
            t_s=when - self._start_s,
            position_m=p,
            velocity_world_m_s=v,
            quaternion=q,
            rate_rad_s=w,
            motor=self.at(self._motors.value, when),
            lagged=self.at(self._rotors[0], when),
            lagged_rate=self.at(self._rotors[1], when),
            thrust_n=rotors,
            voltage_v=voltage,
            charge_as=np.full(len(when), np.nan),
        )

    @property
    def body(self) -> Body:
        """What the kernel needs of the model."""
        m = self.model
        parts = self._com, self._damping, float(m.yaw_trim_nm), m.climb_damping_kg_s, m.vehicle.gravity_m_s2
        return m.mass_kg, np.ascontiguousarray(m.tensor, dtype=float), self._inverse, *parts

    def pushed(self, rotors: Array, extra: Array) -> Array:
        """Body force and torque of rotors' thrusts and of the effects beside them, (k, 6)."""
        return extra + rotors @ self._matrix.T


def _carried(noise: TurningDisturbance, motion: Motion, states: FlightStates) -> Carried:
    """The disturbance at each stamp, from what the rates did beside the model until then."""
    t_s, w = states.t_s, states.start_rate_rad_s
    flown = motion.flown(states)
    extra = motion.along(flown)
    pushed = motion.pushed(flown.thrust_n, extra)
    turning = turned(flown.velocity_world_m_s, flown.quaternion, w, pushed, motion.body)
    step = np.diff(t_s, prepend=t_s[0])[:, None]
    return carried(noise, t_s, w - np.cumsum(np.nan_to_num(turning) * step, axis=0))


@dataclass(frozen=True, slots=True)
class _Disturbed:
    """What turns each window besides the model: acceleration at the start (windows, 3), its fading a step (3,), and the
    pull back.

    Attributes:
        pace: 1/s by which turning forgets, (3,). back: of rate and of acceleration at each step, (steps, 2, 3).
    """

    pushed: Array
    keep: Array
    pace: Array
    back: Array

    @classmethod
    def of(cls, motion: Motion, states: FlightStates, index: Index, h: float, steps: int) -> _Disturbed:
        """From what the model's disturbance was at each window's start; none where it has none."""
        noise = motion.model.disturbance
        if noise is None:
            return cls(np.zeros((len(index), 3)), np.ones(3), np.zeros(3), np.zeros((steps, 2, 3)))
        found = _carried(noise, motion, states)
        pace = 1.0 / np.asarray(noise.turning_correlation_s)
        return cls(found.acceleration_rad_s2[index], fading(noise, h), pace, gains(noise, found.covariance, h, steps))


@np.errstate(over="ignore", invalid="ignore")  # a model that runs away has no error that is a number
def simulate(
    model: VehicleModel, states: FlightStates, index: Index, horizons: Sequence[float], h: float = STEP_S
) -> dict[float, dict[str, Array]]:
    """Over all windows at once, in compiled steps; returns the states at each horizon (ascending)."""
    motion = Motion(model, states)
    start, voltage = states.t_s[index], states.voltage_v[index]
    known = np.isfinite(states.start_quaternion[index]).all(axis=1, keepdims=True)
    q = np.where(known, states.start_quaternion[index], [1.0, 0.0, 0.0, 0.0])
    parts = (states.start_position_m[index], states.start_velocity_m_s[index], q, states.start_rate_rad_s[index])
    x = np.concatenate(parts, axis=1)
    p, v, q, w = x[:, :3], x[:, 3:6], x[:, 6:10], x[:, 10:]
    steps, marks = round(horizons[-1] / h), {round(horizon / h): horizon for horizon in horizons}
    disturbed = _Disturbed.of(motion, states, index, h, steps)
    motion.begin(states, index)
    pushed, blank = disturbed.pushed, np.where(known, 1.0, np.nan)
    out: dict[float, dict[str, Array]] = {}
    before = motion.at(motion.inputs.impulse, start)
    for step, (back_rate, back_acceleration) in enumerate(disturbed.back):
        now = start + step * h
        after = motion.at(motion.inputs.impulse, now + h)
        rotors = (after - before) / h
        before = after
        extra = motion.wrench(now + 0.5 * h, (p, v, q, w), rotors, voltage)
        turning = stepped(x, motion.pushed(rotors, extra), pushed, motion.body, h)
        away = turning + disturbed.pace * w
        w -= back_rate * away
        pushed = disturbed.keep * pushed - back_acceleration * away
        if step + 1 in marks:
            reached = (p * blank, v * blank, q * blank, w.copy())
            out[marks[step + 1]] = dict(zip(("position", "velocity", "quaternion", "rate"), reached, strict=True))
    return out
