"""Open-loop prediction: from every moment of a flight, simulate ahead with the recorded inputs and see how far off it
is.

All windows are integrated side by side (RK4 on a 5 ms grid, thrusts averaged over each step), for the identified model,
the declared vehicle, and a guess of constant velocity and rate. States start from the past alone, the disturbance among
them that an identified model carries on (:mod:`.disturbance`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput, Refused
from groundstation.flightdata import resampled
from groundstation.frames import quat_conjugate, quat_log, quat_multiply, quat_normalise
from groundstation.json_types import JsonObject
from groundstation.model.flight_states import FlightStates
from groundstation.model.held_back import NAMES, held_back
from groundstation.model.predictive import PredictiveModel, simulate
from groundstation.model.rollout import STEP_S, constant_velocity
from groundstation.model.rollout import simulate as rollout
from groundstation.model.vehicle_model import VehicleModel, declared_model
from groundstation.tabular import Record, Tabular

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Paths = dict[float, dict[str, Array]]
"""States by name at each horizon."""
Errors = dict[str, dict[str, dict[str, float]]]

WINDOWS_PER_S = 100.0
QUANTITIES = ("position_m", "velocity_m_s", "attitude_rad", "body_rate_rad_s")


@dataclass(frozen=True, slots=True)
class Prediction(Tabular):
    """Errors of each predictor at each horizon, and the model's predicted states at the last one."""

    horizon_s: float
    windows: int
    error: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]
    start_s: Array
    final: Mapping[str, Array]
    predictor: str = "the physical model"

    def to_dict(self) -> JsonObject:
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
        """Horizons and quantities in which the model errs more (by 2 %, more than rounding) than constant velocity
        does.
        """
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
    hold_back: bool = False,
    progress: Callable[[float, str], None] = lambda fraction, text: None,
) -> Prediction:
    """Simulate ahead from every window's start with the identified, the declared and the constant-velocity model.

    Args, raises: those of :func:`predict_alone`.
    """
    alone = predict_alone(
        model, states, horizon_s=horizon_s, predictor=predictor, hold_back=hold_back, progress=progress
    )
    index, horizons = _starts(states, horizon_s), _horizons(horizon_s)
    error = dict(alone.error)
    others = {"nominal": declared_model(states.vehicle), "constant_velocity": None}
    for number, (name, each) in enumerate(others.items(), 1):
        progress(number / 3.0, f"predicting with {name}")
        error[name] = _errors_at(_path(each, states, index, horizons), states, alone.start_s)
    return replace(alone, error=error)


def predict_alone(
    model: VehicleModel | PredictiveModel | None,
    states: FlightStates,
    *,
    horizon_s: float = 0.5,
    predictor: str = "the physical model",
    hold_back: bool = False,
    progress: Callable[[float, str], None] = lambda fraction, text: None,
) -> Prediction:
    """Simulate ahead from every window's start with one model.

    Args:
        model: physical or predictive; None is constant velocity itself.
        states: of the flight.
        horizon_s: how far.
        predictor: what the model is called.
        hold_back: weigh the model against constant velocity by what both have missed of late (:mod:`.held_back`).
        progress: told the fraction done.

    Raises:
        BadInput: the horizon is not between 0.01 s and 10 s.
        Refused: the flight is shorter than the horizon.
    """
    if not 0.01 <= horizon_s <= 10.0:
        raise BadInput(f"a horizon of {horizon_s} s cannot be predicted; give one between 0.01 and 10 s.")
    index, horizons = _starts(states, horizon_s), _horizons(horizon_s)
    at_s = states.t_s[index]
    progress(0.0, "predicting with model")
    path, stood_in = _without_runaways(_path(model, states, index, horizons), states, index, horizons)
    if hold_back and model is not None:
        path, shares = held_back(path, constant_velocity(states, index, horizons), states, at_s)
        stood_in += _how_far(shares[horizons[-1]])
    error = {"model": _errors_at(path, states, at_s)}
    final = path[horizons[-1]]
    _refuse_what_ran_away(error["model"], final, states)
    return Prediction(horizon_s, len(index), error, at_s, final, predictor + stood_in)


def _horizons(horizon_s: float) -> list[float]:
    return sorted({h for h in (0.01, 0.1, 0.5) if h <= horizon_s + 1e-9} | {round(horizon_s, 6)})


def _starts(states: FlightStates, horizon_s: float) -> Index:
    """At which stamps windows start: far enough before the end of a stretch, WINDOWS_PER_S of them at most."""
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
    return index[:: max(1, round(rate / WINDOWS_PER_S))]


def _without_runaways(path: Paths, states: FlightStates, index: Index, horizons: list[float]) -> tuple[Paths, str]:
    """Constant velocity in the place of a few windows in which the model runs away, and what to say of it."""
    lost = np.asarray(~np.isfinite(path[horizons[-1]]["rate"]).all(axis=1))
    if not 0.0 < lost.mean() <= 0.5:
        return path, ""
    still = constant_velocity(states, index, horizons)
    mixed = {h: {k: np.where(lost[:, None], still[h][k], x) for k, x in path[h].items()} for h in horizons}
    return mixed, f" (constant velocity in {lost.sum()} of {len(lost)} windows, where it runs away)"


def _how_far(shares: Mapping[str, float]) -> str:
    """What to say where the model has less than half of the weight, or far more than all of it."""
    weights = {q: shares[n] for q, n in zip(QUANTITIES, NAMES, strict=True)}
    said = ""
    for what, chosen in (
        ("held back towards constant velocity, which missed less", {q: k for q, k in weights.items() if k < 0.5}),
        ("carried on beyond the model, which moves too little here", {q: k for q, k in weights.items() if k > 1.1}),
    ):
        told = ", ".join(f"{quantity} by {share:.0%} of the model" for quantity, share in chosen.items())
        said += f" ({what}: {told})" if told else ""
    return said


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
                f"the model runs away: {horizon} s ahead it has no finite {missing[0] if missing else 'body rate'} in "
                "this flight.",
                "Predict with the [prediction] section (`--use prediction`), or identify again from livelier flights.",
            )


def _path(
    model: VehicleModel | PredictiveModel | None, states: FlightStates, index: Index, horizons: list[float]
) -> Paths:
    """The states that any kind of model predicts."""
    if model is None:
        return constant_velocity(states, index, horizons)
    if isinstance(model, PredictiveModel):
        return simulate(model, states, index, horizons)
    return rollout(model, states, index, horizons)


def error_norms(
    model: VehicleModel,
    states: FlightStates,
    index: Index,
    horizons: list[float],
    *,
    step_s: float = STEP_S,
) -> dict[float, dict[str, Array]]:
    """Size of the error of each window at each horizon (ascending), by quantity, shape (windows,); NaN where unknown.

    Args:
        index: at which of the states' stamps windows start.
        step_s: of the integration; thrusts are averaged over each.
    """
    path = rollout(model, states, index, horizons, step_s)
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


def _errors_at(path: Paths, states: FlightStates, start_s: Array) -> Errors:
    """Mean and RMS error of each quantity at each horizon."""
    return {f"{h:g}": _errors(states, start_s + h, found) for h, found in path.items()}


def _errors(states: FlightStates, at_s: Array, found: Mapping[str, Array]) -> dict[str, dict[str, float]]:
    out: dict[str, dict[str, float]] = {}
    for name, norm in _norms(states, at_s, found).items():
        known = np.isfinite(norm)
        if known.any():
            out[name] = {"mean_norm": float(norm[known].mean()), "rms": float(np.sqrt(np.mean(norm[known] ** 2)))}
    return out
