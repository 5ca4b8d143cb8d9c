"""Open-loop prediction: from every moment of a flight, simulate ahead with the recorded inputs and see how far off it is.

All windows are integrated side by side (RK4 on a 5 ms grid, thrusts averaged over each step), for the identified model, the
declared vehicle, and a guess of constant velocity and rate. States start from the past alone, the disturbance among them that an
identified model carries on (:mod:`.disturbance`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput, Refused
from groundstation.flightdata import resampled
from groundstation.frames import (
    quat_conjugate,
    quat_exp,
    quat_log,
    quat_multiply,
    quat_normalise,
)
from groundstation.model.disturbance import Carried, TurningDisturbance, carried, fading, gains
from groundstation.model.parameters import FREE, RIGID_BODY, Parameters, declared_parameters
from groundstation.model.predictive import PredictiveModel, simulate
from groundstation.model.rigid_kernel import Body, stepped, turned
from groundstation.model.rotors import (
    MotorInput,
    cumulative,
    declared_thrust,
    interpolate_columns,
    wrench_matrix,
)
from groundstation.model.signals import Signals
from groundstation.tabular import Record, Tabular
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Wrench = Callable[[Signals], Array]

STEP_S = 0.005
WINDOWS_PER_S = 100.0
QUANTITIES = ("position_m", "velocity_m_s", "attitude_rad", "body_rate_rad_s")


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """What a prediction needs to know of a vehicle.

    Attributes:
        vehicle: declared geometry and constants; thrusts are its own times ``thrust_scale``.
        tensor: about the centre of mass, (3, 3).
        com_m: centre of mass in the body.
        damping_nms, climb_damping_kg_s: linear damping of rates and climb.
        wrench: further body force and torque about the origin, (k, 6), from signals; None for none.
        disturbance: what turns it besides; None for none.
    """

    vehicle: Vehicle
    mass_kg: float
    tensor: Array
    lag_up_s: float = 0.0
    lag_down_s: float = 0.0
    lag_slope: float = 0.0
    delay_s: float = 0.0
    thrust_scale: float = 1.0
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_trim_nm: float = 0.0
    damping_nms: tuple[float, float, float] = (0.0, 0.0, 0.0)
    climb_damping_kg_s: float = 0.0
    wrench: Wrench | None = None
    disturbance: TurningDisturbance | None = None


def declared_model(vehicle: Vehicle) -> VehicleModel:
    """The vehicle as declared."""
    lag = vehicle.rotors.lag
    return VehicleModel(vehicle, vehicle.mass_kg, vehicle.inertia_tensor(), lag.up_s, lag.down_s)


DAMPING = ("damping_x_nms", "damping_y_nms", "damping_z_nms")
CLIMB_DAMPING = "damping_climb_kg_s"
"""Of the fit's wrench terms: names in a model document."""


def _parameters(vehicle: Vehicle, values: Mapping[str, float], *, offsets: bool) -> Parameters:
    """The declared parameters with those that are named; without ``offsets`` the effects of a document say those."""
    lag = vehicle.rotors.lag
    p = replace(declared_parameters(vehicle), lag_up_s=lag.up_s, lag_down_s=lag.down_s)
    for entry in FREE:
        if entry.name in values and (offsets or not entry.offset):
            p = entry.put(p, values[entry.name])
    return p


def model_from_document(document: Mapping[str, Any], vehicle: Vehicle, wrench: Wrench | None = None) -> VehicleModel:
    """The model in an ``identification.toml``; what it does not hold is as declared.

    Args:
        document: with ``parameters`` and ``model``, name -> {value, std}, and ``effects``.
        vehicle: as declared when the model was made.
        wrench: of the document's effects; then dampings and offsets come from there and not from the base fit.
    """
    values = {
        name: float(entry["value"])
        for part in ("parameters", "model")
        for name, entry in document.get(part, {}).items()
    }
    effects = document.get("effects", {})
    for name in ("motor_lag", "input_delay"):
        values |= {key: float(entry["value"]) for key, entry in effects.get(name, {}).items()}
    p = _parameters(vehicle, values, offsets=wrench is None)
    if not all(name in values for name in RIGID_BODY[1:]):
        p = replace(p, tensor=nearest_mixture(p.tensor, vehicle.inertia_tensor()))
    if np.linalg.eigvalsh(p.tensor)[0] <= 0.0:
        raise BadInput("the model's inertia tensor is not positive definite; identify on a flight that reveals it.")
    scale = 1.0
    if "thrust_coefficient_n_s2" in values and vehicle.rotors.thrust_coefficient_n_s2:
        scale = values["thrust_coefficient_n_s2"] / vehicle.rotors.thrust_coefficient_n_s2
    elif "thrust_curve_c1_n" in values and vehicle.rotors.thrust_curve is not None:
        curve = tuple(values.get(f"thrust_curve_c{i}_n", c) for i, c in enumerate(vehicle.rotors.thrust_curve))
        vehicle = vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update={"thrust_curve": curve})})
    damping = {name: values.get(name, 0.0) if wrench is None else 0.0 for name in (*DAMPING, CLIMB_DAMPING)}
    x, y, z = (damping[name] for name in DAMPING)
    return VehicleModel(
        vehicle=vehicle,
        mass_kg=p.mass_kg,
        tensor=p.tensor,
        lag_up_s=p.lag_up_s,
        lag_down_s=p.lag_down_s,
        lag_slope=p.lag_slope,
        delay_s=p.delay_s,
        thrust_scale=scale,
        com_m=(float(p.com_m[0]), float(p.com_m[1]), 0.0),
        yaw_trim_nm=p.yaw_trim_nm,
        damping_nms=(x, y, z),
        climb_damping_kg_s=damping[CLIMB_DAMPING],
        wrench=wrench,
        disturbance=TurningDisturbance.from_dict(document["disturbance"]) if "disturbance" in document else None,
    )


def nearest_mixture(tensor: Array, declared: Array) -> Array:
    """A tensor that is partly measured, with as much of the declared one as makes a rigid body of it, shape (3, 3).

    Moments must be positive and obey the triangle inequality: the second moment of mass tr(J)/2 1 - J is positive definite.
    """
    for share in np.linspace(0.0, 1.0, 21):
        mixed = (1.0 - share) * tensor + share * declared
        if np.linalg.eigvalsh(0.5 * np.trace(mixed) * np.eye(3) - mixed)[0] > 0.0:
            return np.asarray(mixed, dtype=float)
    return declared


@dataclass(frozen=True, slots=True)
class FlightStates:
    """Where a flight was, at stamps t: starts (from the past alone) and references to judge by; NaN where unknown.

    Windows lie within ``window_s``, and within one of its ``stretches`` where these are given.
    """

    t_s: Array
    start_position_m: Array
    start_velocity_m_s: Array
    start_quaternion: Array
    start_rate_rad_s: Array
    position_m: Array
    velocity_m_s: Array
    quaternion: Array
    rate_rad_s: Array
    motors: MotorInput
    voltage_v: Array
    window_s: tuple[float, float]
    vehicle: Vehicle
    stretches: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Prediction(Tabular):
    """Errors of each predictor at each horizon, and the model's predicted states at the last one."""

    horizon_s: float
    windows: int
    error: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]
    start_s: Array
    final: Mapping[str, Array]
    predictor: str = "the physical model"

    def to_dict(self) -> dict[str, Any]:
        """The document ``predict --json`` prints (docs/formats.md)."""
        return {
            "schema": "groundstation.prediction/1",
            "horizon_s": self.horizon_s,
            "windows": self.windows,
            "predictor": self.predictor,
            "worse_than_constant_velocity": [f"{q} at {h} s" for h, q in self.worse()],
            "error": {
                k: {h: {q: dict(v) for q, v in e.items()} for h, e in by.items()} for k, by in self.error.items()
            },
        }

    def worse(self) -> list[tuple[str, str]]:
        """Horizons and quantities in which the model errs more (by 2 %, more than rounding) than constant velocity does."""
        still = self.error["constant_velocity"]
        return [
            (h, q)
            for h, by in self.error["model"].items()
            for q, e in by.items()
            if q in still[h] and e["mean_norm"] > 1.02 * still[h][q]["mean_norm"] + 1e-12
        ]

    def records(self) -> list[Record]:
        """One row per horizon and quantity: RMS error of each predictor."""
        return [
            {
                "quantity": quantity,
                "horizon_s": float(horizon),
                **{name: by[horizon][quantity]["rms"] for name, by in self.error.items()},
            }
            for horizon, quantities in self.error["model"].items()
            for quantity in quantities
        ]

    def _title(self) -> str:
        return f"RMS error of open-loop prediction over {self.windows} windows"

    def to_text(self) -> str:
        """A table of RMS errors at each horizon."""
        worse = ", ".join(f"{q} at {h} s" for h, q in self.worse())
        lines = [
            *([f"WORSE than constant velocity in this flight: {worse}"] if worse else []),
            f"{self.windows} windows, RMS error of the open-loop prediction by {self.predictor}",
        ]
        for horizon in self.error["model"]:
            lines.append(f"  after {horizon} s")
            for quantity in self.error["model"][horizon]:
                parts = [f"{name} {by[horizon][quantity]['rms']:.4g}" for name, by in self.error.items()]
                lines.append(f"    {quantity:<16} " + "   ".join(parts))
        return "\n".join(lines)

    def rows(self) -> tuple[tuple[str, ...], Array]:
        """Columns of state.csv and one row per window: its start and the predicted state at the horizon."""
        names = ("t_s", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s", "qw", "qx", "qy", "qz")
        columns = [self.start_s[:, None], *(self.final[k] for k in ("position", "velocity", "quaternion", "rate"))]
        return (*names, "wx_rad_s", "wy_rad_s", "wz_rad_s"), np.concatenate(columns, axis=1)


def predict(
    model: VehicleModel | PredictiveModel | None,
    states: FlightStates,
    *,
    horizon_s: float = 0.5,
    predictor: str = "the physical model",
    progress: Callable[[float, str], None] = lambda fraction, text: None,
) -> Prediction:
    """Simulate ahead from every window's start with the identified, the declared and the constant-velocity model.

    Args:
        model: physical or predictive; None is constant velocity itself.
        states: of the flight.
        horizon_s: how far.
        predictor: what the model is called.
        progress: told the fraction done.

    Raises:
        BadInput: the horizon is not between 0.01 s and 10 s.
        Refused: the flight is shorter than the horizon.
    """
    if not 0.01 <= horizon_s <= 10.0:
        raise BadInput(f"a horizon of {horizon_s} s cannot be predicted; give one between 0.01 and 10 s.")
    t = states.t_s
    inside = np.zeros(len(t), dtype=bool)
    for first, last in states.stretches or (states.window_s,):
        inside |= (t >= first) & (t <= last - horizon_s - 0.02)
    index = np.flatnonzero(inside & np.isfinite(states.start_rate_rad_s).all(axis=1))
    if len(index) == 0:
        raise Refused(
            f"no window of {horizon_s} s fits into this flight.", "Give a shorter horizon or a longer flight."
        )
    rate = 1.0 / float(np.median(np.diff(t)))
    index = index[:: max(1, round(rate / WINDOWS_PER_S))]
    horizons = sorted({h for h in (0.01, 0.1, 0.5) if h <= horizon_s + 1e-9} | {round(horizon_s, 6)})
    error: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    final: dict[str, Array] = {}
    predictors = {"model": model, "nominal": declared_model(states.vehicle), "constant_velocity": None}
    for number, (name, each) in enumerate(predictors.items()):
        progress(number / 3.0, f"predicting with {name}")
        path = _path(each, states, index, horizons)
        lost = np.asarray(~np.isfinite(path[horizons[-1]]["rate"]).all(axis=1))
        if name == "model" and 0.0 < lost.mean() <= 0.5:  # a few windows: constant velocity stands in, and that is said
            still = _constant(states, index, horizons)
            path = {h: {k: np.where(lost[:, None], still[h][k], x) for k, x in path[h].items()} for h in horizons}
            predictor += f" (constant velocity in {lost.sum()} of {len(lost)} windows, where it runs away)"
        error[name] = {f"{h:g}": _errors(states, t[index] + h, path[h]) for h in horizons}
        if name == "model":
            final = path[horizons[-1]]
            _refuse_what_ran_away(error[name], final, states)
    return Prediction(horizon_s, len(index), error, t[index], final, predictor)


def _refuse_what_ran_away(
    error: Mapping[str, Mapping[str, Mapping[str, float]]], final: Mapping[str, Array], states: FlightStates
) -> None:
    """A prediction without a number for what is known is a refusal, not an empty field."""
    for horizon, quantities in error.items():
        told = QUANTITIES if np.isfinite(states.quaternion).all(axis=1).any() else QUANTITIES[3:]
        missing = [q for q in told if q not in quantities or not np.isfinite(quantities[q]["mean_norm"])]
        lost = np.mean(~np.isfinite(final["rate"]).all(axis=1))
        if missing or lost > 0.0:
            raise Refused(
                f"the model runs away: {horizon} s ahead it has no finite {missing[0] if missing else 'body rate'} in this flight.",
                "Predict with the [prediction] section (`--use prediction`), or identify again from livelier flights.",
            )


def _path(
    model: VehicleModel | PredictiveModel | None, states: FlightStates, index: NDArray[np.int64], horizons: list[float]
) -> dict[float, dict[str, Array]]:
    """The states that any kind of model predicts."""
    if model is None:
        return _constant(states, index, horizons)
    if isinstance(model, PredictiveModel):
        return simulate(model, states, index, horizons)
    return _simulate(model, states, index, horizons)


def error_norms(
    model: VehicleModel,
    states: FlightStates,
    index: NDArray[np.int64],
    horizons: list[float],
    *,
    step_s: float = STEP_S,
) -> dict[float, dict[str, Array]]:
    """Size of the error of each window at each horizon (ascending), by quantity, shape (windows,); NaN where unknown.

    Args:
        index: at which of the states' stamps windows start.
        step_s: of the integration; thrusts are averaged over each.
    """
    path = _simulate(model, states, index, horizons, step_s)
    return {h: _norms(states, states.t_s[index] + h, path[h]) for h in horizons}


@np.errstate(over="ignore", invalid="ignore")  # a model that runs away has no error that is a number
def _norms(states: FlightStates, at_s: Array, found: Mapping[str, Array]) -> dict[str, Array]:
    def reference(values: Array) -> Array:
        return resampled(at_s, states.t_s, values)

    nearest = np.clip(np.searchsorted(states.t_s, at_s), 0, len(states.t_s) - 1)
    truth = states.quaternion[nearest]
    differences = {
        "position_m": found["position"] - reference(states.position_m),
        "velocity_m_s": found["velocity"] - reference(states.velocity_m_s),
        "attitude_rad": quat_log(quat_normalise(quat_multiply(quat_conjugate(truth), found["quaternion"]))),
        "body_rate_rad_s": found["rate"] - reference(states.rate_rad_s),
    }
    return {name: np.linalg.norm(differences[name], axis=1) for name in QUANTITIES}


def _errors(states: FlightStates, at_s: Array, found: Mapping[str, Array]) -> dict[str, dict[str, float]]:
    out = {}
    for name, norm in _norms(states, at_s, found).items():
        known = np.isfinite(norm)
        if known.any():
            out[name] = {"mean_norm": float(norm[known].mean()), "rms": float(np.sqrt(np.mean(norm[known] ** 2)))}
    return out


def _constant(states: FlightStates, index: NDArray[np.int64], horizons: list[float]) -> dict[float, dict[str, Array]]:
    p, v = states.start_position_m[index], states.start_velocity_m_s[index]
    q, w = states.start_quaternion[index], states.start_rate_rad_s[index]
    return {
        h: {"position": p + h * v, "velocity": v, "quaternion": quat_multiply(q, quat_exp(h * w)), "rate": w}
        for h in horizons
    }


@dataclass(frozen=True, slots=True)
class _Inputs:
    """What the rotors of a model do over the flight, on the motors' grid: thrusts, their running integral, lagged values, their slope."""

    thrust: Array
    impulse: Array
    lagged: Array
    slope: Array

    @classmethod
    def of(cls, model: VehicleModel, motors: MotorInput) -> _Inputs:
        lagged = motors.lagged(model.lag_up_s, model.lag_down_s, model.lag_slope)
        thrust = declared_thrust(model.vehicle, lagged) * model.thrust_scale
        held = not motors.measured and model.lag_up_s <= 1e-6 and model.lag_down_s <= 1e-6
        impulse = cumulative(thrust, motors.step_s, held=held)
        return cls(thrust, impulse, lagged, np.gradient(lagged, motors.step_s, axis=0))


class _Motion:
    """Accelerations of a model's vehicle in one flight's signals."""

    def __init__(self, model: VehicleModel, states: FlightStates):
        self._model, self._motors, self._start_s = model, states.motors, states.t_s[0]
        self.inputs = _Inputs.of(model, states.motors)
        self._matrix = wrench_matrix(model.vehicle)
        self._inverse = np.asarray(np.linalg.inv(model.tensor), dtype=float)
        self._com, self._damping = np.asarray(model.com_m), np.asarray(model.damping_nms)

    def at(self, values: Array, when: Array) -> Array:
        """Columns of the motors' grid at times of the flight."""
        return interpolate_columns(when - self._model.delay_s, self._motors.start_s, self._motors.step_s, values)

    def wrench(self, when: Array, p: Array, v: Array, q: Array, w: Array, rotors: Array, voltage: Array) -> Array:
        """Body force and torque of the model's effects, (k, 6)."""
        if self._model.wrench is None:
            return np.zeros((len(when), 6))
        signals = Signals(
            t_s=when - self._start_s,
            position_m=p,
            velocity_world_m_s=v,
            quaternion=q,
            rate_rad_s=w,
            motor=self.at(self._motors.value, when),
            lagged=self.at(self.inputs.lagged, when),
            lagged_rate=self.at(self.inputs.slope, when),
            thrust_n=rotors,
            voltage_v=voltage,
            charge_as=np.full(len(when), np.nan),
        )
        return np.nan_to_num(self._model.wrench(signals))

    @property
    def body(self) -> Body:
        """What the kernel needs of the model."""
        m = self._model
        parts = self._com, self._damping, float(m.yaw_trim_nm), m.climb_damping_kg_s, m.vehicle.gravity_m_s2
        return m.mass_kg, np.ascontiguousarray(m.tensor, dtype=float), self._inverse, *parts

    def pushed(self, rotors: Array, extra: Array) -> Array:
        """Body force and torque of rotors' thrusts and of the effects beside them, (k, 6)."""
        return extra + rotors @ self._matrix.T


def _carried(noise: TurningDisturbance, motion: _Motion, states: FlightStates) -> Carried:
    """The disturbance at each stamp, from what the rates did beside the model until then."""
    t_s, w = states.t_s, states.start_rate_rad_s
    known = np.isfinite(states.start_quaternion).all(axis=1, keepdims=True)
    q = np.where(known, states.start_quaternion, [1.0, 0.0, 0.0, 0.0])
    rotors = motion.at(motion.inputs.thrust, t_s)
    p, v = states.start_position_m, states.start_velocity_m_s
    extra = motion.wrench(t_s, p, v, q, w, rotors, states.voltage_v)
    turning = turned(v, q, w, motion.pushed(rotors, extra), motion.body)
    step = np.diff(t_s, prepend=t_s[0])[:, None]
    return carried(noise, t_s, w - np.cumsum(np.nan_to_num(turning) * step, axis=0))


@np.errstate(over="ignore", invalid="ignore")  # a model that runs away has no error that is a number
def _simulate(
    model: VehicleModel, states: FlightStates, index: NDArray[np.int64], horizons: list[float], h: float = STEP_S
) -> dict[float, dict[str, Array]]:
    """Over all windows at once, in compiled steps; returns the states at each horizon."""
    motion = _Motion(model, states)
    impulse = motion.inputs.impulse
    start = states.t_s[index]
    known = np.isfinite(states.start_quaternion[index]).all(axis=1, keepdims=True)
    q = np.where(known, states.start_quaternion[index], [1.0, 0.0, 0.0, 0.0])
    parts = (states.start_position_m[index], states.start_velocity_m_s[index], q, states.start_rate_rad_s[index])
    x = np.concatenate(parts, axis=1)
    p, v, q, w = x[:, :3], x[:, 3:6], x[:, 6:10], x[:, 10:]
    voltage = states.voltage_v[index]
    steps = round(horizons[-1] / h)
    marks = {round(horizon / h): horizon for horizon in horizons}
    pushed, keep, pace, back = np.zeros_like(w), np.ones(3), np.zeros(3), np.zeros((steps, 2, 3))
    if model.disturbance is not None:
        found = _carried(model.disturbance, motion, states)
        pushed, keep = found.acceleration_rad_s2[index], fading(model.disturbance, h)
        pace = 1.0 / np.asarray(model.disturbance.turning_correlation_s)
        back = gains(model.disturbance, found.covariance, h, steps)
    out: dict[float, dict[str, Array]] = {}
    before = motion.at(impulse, start)
    for step in range(steps):
        now = start + step * h
        after = motion.at(impulse, now + h)
        rotors = (after - before) / h
        before = after
        extra = motion.wrench(now + 0.5 * h, p, v, q, w, rotors, voltage)
        turning = stepped(x, motion.pushed(rotors, extra), pushed, motion.body, h)
        away = turning + pace * w
        w -= back[step, 0] * away
        pushed = keep * pushed - back[step, 1] * away
        if step + 1 in marks:
            blank = np.where(known, 1.0, np.nan)
            names = ("position", "velocity", "quaternion", "rate")
            out[marks[step + 1]] = dict(zip(names, (p * blank, v * blank, q * blank, w.copy()), strict=True))
    return out
