"""The answer of an identification: which estimate to believe and why, what every method found, and what stays
hidden.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import GroundStationError
from groundstation.identification.anchoring import anchored, anchored_covariance
from groundstation.identification.consistency import nearest_rigid_body, physically_consistent
from groundstation.identification.declarations import lag_doubts
from groundstation.identification.dynamic_fit import CURVE, DynamicFit, Progress
from groundstation.identification.identifiability import (
    never_moved,
    partial_answer,
    revealed,
    unphysical,
    unrevealed,
    unsettled,
)
from groundstation.identification.memory import released
from groundstation.identification.physical_limits import outside
from groundstation.identification.prediction_error import Fitted, coarse_output_error
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import RecordModel
from groundstation.identification.results import MASS_AND_TENSOR, Estimate, MethodResult, Revealed
from groundstation.identification.seed import Regressions, seed_methods
from groundstation.identification.seed_signals import Processing, process_flight
from groundstation.identification.sudden import mass_step
from groundstation.identification.unplanned import LOW, LOW_NOTE, LOW_REASON, by_low_frequencies
from groundstation.identification.unplanned import applies as low_frequencies_apply
from groundstation.model.parameters import FitOptions
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

DISAGREES = 3.0
"""Standard deviations between two estimates from which one of them is taken to be biased."""
_TIMES = ("input_delay_s", "rotor_lag_up_s", "rotor_lag_down_s")

METHOD_NOTES = {
    "OE": "Output error over shooting windows of 2 s: right only where there is no disturbance.",
    "FE": "Filter (prediction) error with the flight's own coloured disturbance; takes the rotor speeds for exact.",
    "IV": "Instrumental variables: the planned motion is the instrument, so neither feedback nor noisy inputs bias it.",
    "rigid body": "The nearest rigid body in the metric of the estimate's covariance.",
}


@dataclass(frozen=True, slots=True)
class Answer:
    """What an identification says, as far as it has come.

    Attributes:
        fitted: the fits that it rests on. best: the one to believe; name and reason say which and why.
        combinations: of mass and tensor that the motion acted on.
        hidden: parameter -> why it gets no number.
        methods: results by name. model: the other parameters of the best one.
        regressions: the seed's, of the first flight, where it allows them.
        warnings: a sentence each.
    """

    fitted: DynamicFit
    best: Fitted
    name: str
    reason: str
    combinations: tuple[Revealed, ...]
    hidden: Mapping[str, str]
    warnings: tuple[str, ...]
    methods: Mapping[str, MethodResult] = field(default_factory=dict[str, MethodResult])
    model: Mapping[str, Estimate] = field(default_factory=dict[str, Estimate])
    regressions: Regressions | None = None

    @property
    def vehicle(self) -> Vehicle:
        """As declared."""
        return self.fitted.prepared[0].record.vehicle


def believed(fitted: DynamicFit, warnings: Sequence[str] = ()) -> Answer:
    """The estimate to believe, before any other method is asked, and what the motion hides from it."""
    prepared = fitted.prepared
    low = by_low_frequencies(prepared, fitted.best) if low_frequencies_apply(prepared) else None
    best = fitted.best if low is None else low
    combinations = tuple(revealed(fitted.models, prepared[0].record.vehicle, fitted.options))
    hidden = never_moved(combinations) | unrevealed(best, prepared)
    if fitted.instrumental is None or low is not None:
        hidden |= unphysical(best, prepared)
    else:
        hidden |= unsettled(fitted.instrumental, fitted.filter_error)
    partial = partial_answer(best, hidden, prepared)
    step = mass_step(fitted.models, fitted.best, fitted.options)
    return Answer(
        fitted=fitted,
        best=best,
        name=fitted.best_name if low is None else LOW,
        reason=_reason(fitted) if low is None else LOW_REASON,
        combinations=combinations,
        hidden=hidden,
        warnings=(*warnings, *([] if step is None else [step.told()]), *([] if partial is None else [partial])),
    )


def with_methods(answer: Answer, exclude: Sequence[tuple[float, float]], progress: Progress) -> Answer:
    """With the seed's four methods, output error and the fits that the answer rests on."""
    fitted = answer.fitted
    progress(0.75, "output error")
    found = {
        "OE": coarse_output_error(fitted.models, answer.best.parameters, fitted.options),
        "FE": fitted.filter_error,
    }
    if fitted.instrumental is not None:
        found["IV"] = fitted.instrumental
    results = {name: _result(fitted, fit, answer.hidden, METHOD_NOTES[name]) for name, fit in found.items()}
    if answer.name == LOW:
        results[LOW] = _result(fitted, answer.best, answer.hidden, LOW_NOTE)
    for model in fitted.models:
        model.forget()  # what the seed's methods regress is as large
    released(fitted.prepared)
    progress(0.85, "the seed's four methods")
    regressions, methods = _seed_methods(fitted.prepared[0], exclude)
    return replace(answer, methods={**methods, **results}, regressions=regressions)


def as_rigid_body(answer: Answer) -> Answer:
    """The nearest rigid body, where the estimate belongs to none."""
    name, fitted = answer.name, answer.fitted
    trouble = physically_consistent(answer.methods[name].parameters)
    if not trouble:
        return answer
    best, away = nearest_rigid_body(answer.best, [term.name for term in fitted.models[0].extra])
    warning = (
        f"The {name} estimate belongs to no rigid body ({trouble}), and the nearest that does is {away:.1f} standard "
        "deviations away: an effect is missing from the model, or the data lack it."
    )
    nearest = f"{name}, rigid body"
    note = f"{METHOD_NOTES['rigid body']} {away:.1f} standard deviations off."
    return replace(
        answer,
        best=best,
        name=nearest,
        reason=f"{nearest}: of all rigid bodies the nearest to {answer.reason}",
        methods={**answer.methods, nearest: _result(fitted, best, answer.hidden, note)},
        warnings=(*answer.warnings, warning),
    )


def within_limits(answer: Answer) -> Answer:
    """With the other parameters of the model, and without what no vehicle can have or weighing cannot fix."""
    vehicle, best = answer.vehicle, answer.best
    _, constants = anchored(vehicle, best.names, best.values, best.covariance)
    model = {**constants, **_other_parameters(best, answer.fitted.prepared[0])}
    impossible = outside(vehicle, answer.methods[answer.name].parameters, model)
    hidden = {**answer.hidden, **impossible}
    if vehicle.identification.anchor == "mass" and vehicle.rotors.input != "wrench":
        hidden["torque_to_thrust_m"] = (
            "a measured reaction torque: yaw torque and yaw inertia scale together, weighing does not fix them"
        )
    told = (f"{key}: {text}." for key, text in impossible.items())
    return replace(
        answer,
        hidden=hidden,
        methods={key: method.without(impossible) for key, method in answer.methods.items()},
        model={key: estimate for key, estimate in model.items() if key not in impossible},
        warnings=(*lag_doubts(model, vehicle), *answer.warnings, *told),
    )


def bound_of(answer: Answer) -> dict[str, float]:
    """Cramer-Rao standard deviation of what the motion reveals."""
    best = answer.best
    bounds, _ = anchored(answer.vehicle, best.names, best.values, best.bound)
    return {key: value.std for key, value in bounds.items() if key not in answer.hidden}


def _result(fitted: DynamicFit, fit: Fitted, hidden: Mapping[str, str], note: str) -> MethodResult:
    """A fit under the vehicle's anchor, less what the motion did not reveal."""
    parameters, _ = anchored(fitted.prepared[0].record.vehicle, fit.names, fit.values, fit.covariance)
    torques = _torque_rms(fitted.models, fit, fitted.options)
    return MethodResult(
        parameters={key: value for key, value in parameters.items() if key not in hidden},
        rms_output_error={
            "force_z_n": float(fit.residual_rms[5] * fit.parameters.mass_kg),
            **dict(zip(("torque_x_nm", "torque_y_nm", "torque_z_nm"), torques, strict=True)),
        },
        note=note,
        covariance=anchored_covariance(fitted.prepared[0].record.vehicle, fit.names, fit.values, fit.covariance),
    )


def _reason(fitted: DynamicFit) -> str:
    if fitted.instrumental is None:
        return (
            "FE: no plan or setpoints are recorded, so the prediction error estimate with a noise model is the best "
            "there is."
        )
    worst, size = _disagreement(fitted.instrumental, fitted.filter_error)
    verdict = (
        f"FE agrees within {size:.1f} standard deviations"
        if size < DISAGREES
        else f"FE differs by {size:.1f} standard deviations in {worst}: feedback or noisy rotor speeds bias it"
    )
    flights = [item.flight for item in fitted.prepared]
    if any(flight.plan is None and flight.setpoint is None for flight in flights):
        return (
            "IV: neither plan nor setpoints are recorded, and the smoothed path flown is the instrument: noisy rotor "
            f"speeds do not bias it, but it is not immune to feedback from disturbances; {verdict}."
        )
    return f"IV: the plan is known, so it is immune to feedback from disturbances; {verdict}."


def _disagreement(first: Fitted, second: Fitted) -> tuple[str, float]:
    """The parameter in which two estimates differ most, and by how many standard deviations."""
    worst, size = "mass_kg", 0.0
    for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        distance = abs(first.value(name) - second.value(name)) / float(np.hypot(first.std(name), second.std(name)))
        if distance > size:
            worst, size = name, distance
    return worst, size


def _other_parameters(fit: Fitted, prepared: Prepared) -> dict[str, Estimate]:
    """The other parameters of the model, those that mean something for this vehicle."""
    h = float(np.median(np.diff(prepared.flight.motors.t_s)))
    out: dict[str, Estimate] = {}
    for name in fit.names:
        if name in MASS_AND_TENSOR or name.startswith("accel_bias"):
            continue
        value, std = fit.value(name), fit.std(name)
        if name in CURVE:
            value += (prepared.record.vehicle.rotors.thrust_curve or (0.0, 0.0, 0.0))[CURVE.index(name)]
        if name in _TIMES:
            out[name] = Estimate.time(value, std, h)
        else:
            out[name] = Estimate.normal(value, std)
    return out | _of_sensors(prepared)


def _of_sensors(prepared: Prepared) -> dict[str, Estimate]:
    """What the streams' agreement says of gyro, accelerometer, motion capture and their clocks."""
    found = prepared.compatibility
    out: dict[str, Estimate] = {}
    if found is None:
        return out
    capture = () if prepared.clock is None else ("mocap_rotation", "mocap_position", "mocap_tilt")
    for name in found.revealed:
        if name.startswith(("gyro", "accel", *capture)):
            out[name] = Estimate.normal(found.values[name], found.std[name])
    if prepared.clock is not None:
        out["stamp_jitter_s"] = Estimate.time(found.values["stamp_jitter_s"], found.std["stamp_jitter_s"])
    return out


def _torque_rms(models: Sequence[RecordModel], fit: Fitted, options: FitOptions) -> list[float]:
    """RMS of the torque residual at up to 10 Hz, from differences of the rate residual over 0.1 s."""
    untimed = replace(options, lag=False, delay=False)  # without what no residual needs
    rows: list[Array] = []
    for model in models:
        residual = model.residual_of(fit.parameters, model.predicted(fit.parameters, untimed))[:, :3]
        lag = max(1, round(0.1 / float(np.median(model.dt))))
        if len(residual) > lag:
            rows.append(
                (residual[lag:] - residual[:-lag])
                / (model.t_s[lag:] - model.t_s[:-lag])[:, None]
                @ fit.parameters.tensor
            )
    return [float(v) for v in np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0))] if rows else [float("nan")] * 3


def _seed_methods(
    first: Prepared, exclude: Sequence[tuple[float, float]]
) -> tuple[Regressions | None, dict[str, MethodResult]]:
    """The seed's four methods on the first flight and what they regress; a refusal of theirs is a note, not a failure
    of the whole.
    """
    offset = 0.0 if first.clock is None else first.clock.mocap_minus_imu_s
    regressions = None
    try:
        processing = Processing(mocap_minus_imu_s=offset, exclude=exclude)
        regressions = Regressions.of(process_flight(first.flight, processing))
        return regressions, seed_methods(regressions, first.flight.vehicle)
    except GroundStationError as error:
        note = str(error)
        return regressions, {name: MethodResult(parameters={}, note=note) for name in ("LS", "GD", "FMLS", "FMGD")}
