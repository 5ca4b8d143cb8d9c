"""``identify``: from recorded flights to parameters with intervals, by every method, and which of them to believe."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import GroundStationError, NotIdentifiable
from groundstation.flightdata import FlightData
from groundstation.identification.anchoring import anchored, anchored_covariance
from groundstation.identification.consistency import nearest_rigid_body, physically_consistent
from groundstation.identification.declarations import check_declarations, lag_doubts, said_first
from groundstation.identification.disagreement import with_doubts
from groundstation.identification.identifiability import (
    angular_acceleration,
    never_moved,
    partial_answer,
    revealed,
    unphysical,
    unrevealed,
    unsettled,
)
from groundstation.identification.instrumental import instrumental
from groundstation.identification.physical_limits import outside
from groundstation.identification.prediction_error import Fitted, fit, fit_from_declared, output_error
from groundstation.identification.predictive_choice import physical_model, prediction_section
from groundstation.identification.preparation import Prepared, damping_terms, prepare_all
from groundstation.identification.record_model import BodyWrench, DynamicRecord, RecordModel
from groundstation.identification.results import MASS_AND_TENSOR, Estimate, Identification, MethodResult
from groundstation.identification.unplanned import LOW, LOW_NOTE, LOW_REASON, by_low_frequencies
from groundstation.identification.unplanned import applies as low_frequencies_apply
from groundstation.identification.validation import validate
from groundstation.model.disturbance import TurningDisturbance, pooled, three, turning
from groundstation.model.parameters import FitOptions, Parameters
from groundstation.model.rotors import wrench_matrix
from groundstation.options import DEFAULT_OPTIONS, AnalysisOptions

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]

QUIET = 0.2
"""Share of the angular acceleration of the liveliest flight below which a flight without a plan only answers its disturbance."""
DISAGREES = 3.0
"""Standard deviations between two estimates from which one of them is taken to be biased."""


@dataclass(frozen=True, slots=True)
class DynamicFit:
    """The fits of one or several flights of one vehicle, before they are read under an anchor."""

    prepared: tuple[Prepared, ...]
    models: tuple[RecordModel, ...]
    options: FitOptions
    filter_error: Fitted
    instrumental: Fitted | None

    @property
    def best_name(self) -> str:
        """IV where a plan is known, else FE.

        FE would be a little sharper where the controller saw no more than the record holds and the inputs are exact, but
        a test of that (Durbin, Wu and Hausman) is weakest on the gentle flights where the bias is largest.
        """
        return "FE" if self.instrumental is None else "IV"

    @property
    def best(self) -> Fitted:
        """The estimate to believe."""
        return self.filter_error if self.instrumental is None else self.instrumental


def options_for(prepared: Prepared) -> FitOptions:
    """What is free for this kind of input: measured speeds and wrenches have no lag to find."""
    rotors = prepared.record.vehicle.rotors
    channels = (0, 1, 2, 5) if np.isfinite(prepared.record.force_m_s2).all() else (0, 1, 2)
    return FitOptions(lag=not prepared.record.motors.measured and rotors.input != "wrench", channels=channels)


def _models_of(prepared: Sequence[Prepared]) -> tuple[RecordModel, ...]:
    """One model a flight. Flights without a plan leave an axis to those of the others that turn about it much more."""
    strength = np.array([angular_acceleration(item) for item in prepared])
    quiet = strength < QUIET * strength.max(axis=0)
    models = []
    for item, axes in zip(prepared, quiet, strict=True):
        terms, planned = damping_terms(item)
        silent = frozenset(np.flatnonzero(axes).tolist()) if planned is None else frozenset()
        models.append(RecordModel(item.record, terms, planned, silent))
    return tuple(models)


def _without_gain(model: RecordModel, fitted: Fitted) -> RecordModel:
    """The model with every damping that came out negative held at zero.

    Air takes energy from a turning vehicle and gives none. Without a plan, what feeds the disturbance back passes for the contrary,
    and a model with it runs away when it is simulated.
    """
    held = tuple(
        replace(term, prior_std=1e-6 * term.prior_std) if coefficient < 0.0 else term
        for term, coefficient in zip(model.extra, fitted.parameters.extra, strict=True)
    )
    return RecordModel(model.record, held, model.planned, model.silent)


def fit_dynamics(prepared: Sequence[Prepared], progress: Progress = lambda fraction, text: None) -> DynamicFit:
    """Prediction error and instrumental estimates of the pooled flights."""
    options = options_for(prepared[0])
    models = _models_of(prepared)
    if any(len(model.t_s) < 50 for model in models):
        raise NotIdentifiable(
            "a flight holds less than a second of usable data.", "Leave out less of it, or fly longer."
        )
    progress(0.4, "prediction error with the flight's own disturbance")
    filter_error = fit_from_declared(models, prepared[0].record.vehicle, options)
    if any(item.planned is None for item in prepared) and filter_error.parameters.extra.min(initial=0.0) < 0.0:
        models = tuple(_without_gain(model, filter_error) for model in models)
        filter_error = fit(models, filter_error.parameters, options)
    if _curve_is_free(prepared, filter_error):
        progress(0.6, "thrust curve")
        return _with_free_curve(prepared, models, options, filter_error)
    refined = None
    if all(item.planned is not None for item in prepared):
        progress(0.7, "instrumental variables from the plan")
        refined = instrumental(models, filter_error, options)
    return DynamicFit(tuple(prepared), models, options, filter_error, refined)


CURVE = ("thrust_curve_c0_n", "thrust_curve_c1_n", "thrust_curve_c2_n")


def _curve_is_free(prepared: Sequence[Prepared], fitted: Fitted) -> bool:
    """The mass is weighed, the declared curve is another vehicle's, and the thrust varied enough to show its shape."""
    vehicle = prepared[0].record.vehicle
    if vehicle.identification.anchor != "mass" or vehicle.rotors.thrust_curve is None:
        return False
    if any(item.planned is not None for item in prepared):
        return False
    p = fitted.parameters
    return any(_thrust_spread(item, p.lag_up_s, p.lag_down_s) > 0.08 for item in prepared)


def _thrust_spread(prepared: Prepared, up_s: float, down_s: float) -> float:
    total = prepared.signals(up_s, down_s, 0.0).thrust_n[prepared.record.keep].sum(axis=1)
    return float(np.std(total) / np.mean(total))


def _with_free_curve(
    prepared: Sequence[Prepared], models: Sequence[RecordModel], options: FitOptions, fitted: Fitted
) -> DynamicFit:
    """Fit again with the mass held and the curve's coefficients free, at the lag found, twice."""
    vehicle = prepared[0].record.vehicle
    curve = np.asarray(vehicle.rotors.thrust_curve)
    options = replace(options, mass=False)
    scale = vehicle.mass_kg / fitted.parameters.mass_kg
    start = replace(
        fitted.parameters,
        mass_kg=vehicle.mass_kg,
        tensor=fitted.parameters.tensor * scale,
        extra=np.concatenate([fitted.parameters.extra * scale, curve * (scale - 1.0)]),
    )
    found = fitted
    for _ in range(2):
        models = tuple(
            RecordModel(
                item.record,
                (*model.extra[: len(fitted.parameters.extra)], *curve_terms(item, start)),
                None,
                model.silent,
            )
            for item, model in zip(prepared, models, strict=True)
        )
        found = fit(models, start, options)
        start = found.parameters
    return DynamicFit(tuple(prepared), tuple(models), options, found, None)


def curve_terms(prepared: Prepared, p: Parameters) -> list[BodyWrench]:
    """Body wrench per unit change of each coefficient of the thrust curve, at a given lag and delay."""
    vehicle = prepared.record.vehicle
    lagged = prepared.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope).lagged
    matrix = wrench_matrix(vehicle)
    terms = []
    for power, (name, declared) in enumerate(zip(CURVE, vehicle.rotors.thrust_curve or (), strict=True)):
        value = lagged**power @ matrix.T
        span = max(abs(declared), 0.2 * vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count)
        terms.append(BodyWrench(name, value, prior_std=span))
    return terms


def identify(
    flights: Sequence[FlightData],
    options: AnalysisOptions = DEFAULT_OPTIONS,
    *,
    predictive: bool = False,
    progress: Progress = lambda fraction, text: None,
) -> Identification:
    """Identify one vehicle from one or several of its flights.

    Args:
        flights: recordings of the same vehicle; they are pooled.
        options: stretches to leave out.
        predictive: fit and choose a prediction model beside the physical one, too.
        progress: told the fraction done and what is being done.

    Raises:
        BadInput: an option that only a diagnosis can use, or a stretch outside the flights.
        Refused: too short, clocks that cannot be aligned, or a motion that reveals too little; with the remedy.
    """
    progress(0.05, "bringing the streams onto one clock")
    options.require_only("identify", "exclude")
    exclude = options.exclude
    checks = check_declarations(flights[0])
    prepared = prepare_all(flights, exclude)
    fitted = fit_dynamics(prepared, progress)
    low = by_low_frequencies(prepared, fitted.best) if low_frequencies_apply(prepared) else None
    best = fitted.best if low is None else low
    vehicle = prepared[0].record.vehicle
    combinations = revealed(fitted.models, vehicle, fitted.options)
    hidden = never_moved(combinations) | unrevealed(best, prepared)
    if fitted.instrumental is None or low is not None:
        hidden |= unphysical(best, prepared)
    else:
        hidden |= unsettled(fitted.instrumental, fitted.filter_error)
    partial = partial_answer(best, hidden, prepared)
    methods = dict(_seed_methods(prepared, exclude, progress))
    progress(0.85, "output error")
    oe = output_error(fitted.models, best.parameters, fitted.options)
    found = {"OE": oe, "FE": fitted.filter_error} | ({} if fitted.instrumental is None else {"IV": fitted.instrumental})
    methods |= {name: _result(fitted, fit, hidden, _METHOD_NOTES[name]) for name, fit in found.items()}
    name, reason = fitted.best_name, _reason(fitted)
    if low is not None:
        name, reason = LOW, LOW_REASON
        methods[name] = _result(fitted, low, hidden, LOW_NOTE)
    warnings = [*said_first(checks), *([] if partial is None else [partial])]
    trouble = physically_consistent(methods[name].parameters)
    if trouble:
        best, away = nearest_rigid_body(best, [term.name for term in fitted.models[0].extra])
        warnings.append(
            f"The {name} estimate belongs to no rigid body ({trouble}), and the nearest that does is {away:.1f} standard "
            "deviations away: an effect is missing from the model, or the data lack it."
        )
        name = f"{name}, rigid body"
        reason = f"{name}: of all rigid bodies the nearest to {reason}"
        methods[name] = _result(
            fitted, best, hidden, f"{_METHOD_NOTES['rigid body']} {away:.1f} standard deviations off."
        )
    _, constants = anchored(vehicle, best.names, best.values, best.covariance)
    model = {**constants, **_model(best, prepared[0])}
    warnings[:0] = lag_doubts(model, vehicle)
    impossible = outside(vehicle, methods[name].parameters, model)
    hidden |= impossible
    warnings += [f"{key}: {text}." for key, text in impossible.items()]
    methods = {key: method.without(impossible) for key, method in methods.items()}
    model = {key: estimate for key, estimate in model.items() if key not in impossible}
    if vehicle.identification.anchor == "mass" and vehicle.rotors.input != "wrench":
        hidden["torque_to_thrust_m"] = (
            "a measured reaction torque: yaw torque and yaw inertia scale together, weighing does not fix them"
        )
    bounds, _ = anchored(vehicle, best.names, best.values, best.bound)
    first = prepared[0]
    progress(0.95, "validation")
    validation = validate(
        first.flight,
        methods,
        mocap_minus_imu_s=0.0 if first.clock is None else first.clock.mocap_minus_imu_s,
        exclude=exclude,
    )
    methods = with_doubts(methods, name)
    disturbance, prediction = _disturbance(fitted.models, best, fitted.options), {}
    if predictive:
        progress(0.96, "prediction model")
        physical = physical_model(vehicle, methods[name].parameters, model, disturbance)
        prediction = prediction_section(prepared, physical)
    progress(1.0, "done")
    return Identification(
        flight=" + ".join(flight.name for flight in flights),
        vehicle=vehicle.name,
        anchor=vehicle.identification.anchor,
        methods=methods,
        model=model,
        best=name,
        best_reason=reason,
        clock=first.clock,
        not_identifiable=hidden,
        declarations=tuple(check.to_dict() for check in checks),
        warnings=tuple(warnings),
        bound={key: value.std for key, value in bounds.items() if key not in hidden},
        window_s=first.window_s,
        excluded_s=tuple((float(a), float(b)) for a, b in exclude),
        quality=tuple(note for item in prepared for note in (*item.flight.notes, *item.notes)),
        validation=validation,
        revealed=tuple(combinations),
        disturbance=disturbance,
        prediction=prediction,
    )


_METHOD_NOTES = {
    "OE": "Output error over shooting windows of 2 s: right only where there is no disturbance.",
    "FE": "Filter (prediction) error with the flight's own coloured disturbance; takes the rotor speeds for exact.",
    "IV": "Instrumental variables: the planned motion is the instrument, so neither feedback nor noisy inputs bias it.",
    "rigid body": "The nearest rigid body in the metric of the estimate's covariance.",
}


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
        return "FE: no plan or setpoints are recorded, so the prediction error estimate with a noise model is the best there is."
    worst, size = _disagreement(fitted.instrumental, fitted.filter_error)
    verdict = (
        f"FE agrees within {size:.1f} standard deviations"
        if size < DISAGREES
        else f"FE differs by {size:.1f} standard deviations in {worst}: feedback or noisy rotor speeds bias it"
    )
    flights = [item.flight for item in fitted.prepared]
    if any(flight.plan is None and flight.setpoint is None for flight in flights):
        return (
            "IV: neither plan nor setpoints are recorded, and the smoothed path flown is the instrument: noisy rotor speeds do not "
            f"bias it, but it is not immune to feedback from disturbances; {verdict}."
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


def _model(fit: Fitted, prepared: Prepared) -> dict[str, Estimate]:
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
    if prepared.compatibility is not None:
        found = prepared.compatibility
        kinds = (
            "gyro",
            "accel",
            *(() if prepared.clock is None else ("mocap_rotation", "mocap_position", "mocap_tilt")),
        )
        for name in found.revealed:
            if name.startswith(kinds):
                out[name] = Estimate.normal(found.values[name], found.std[name])
        if prepared.clock is not None:
            out["stamp_jitter_s"] = Estimate.time(found.values["stamp_jitter_s"], found.std["stamp_jitter_s"])
    return out


_TIMES = ("input_delay_s", "rotor_lag_up_s", "rotor_lag_down_s")


def _disturbance(models: Sequence[RecordModel], fit: Fitted, options: FitOptions) -> TurningDisturbance:
    """What turned the vehicle beside the model, by the noise model of each flight and axis."""
    parts, first = [], 0
    for model in models:
        channels = model.channels(options)
        colour = dict(zip(channels, fit.colours[first : first + len(channels)], strict=True))
        first += len(channels)
        step = float(np.median(model.dt))
        size, time = turning(model.rate, step)
        told = [colour.get(axis) for axis in range(3)]
        sensor = _white_density(model.record)
        parts.append(
            TurningDisturbance(
                acceleration_rad_s2=three(0.0 if c is None else c.disturbance for c in told),
                correlation_s=three(1.0 if c is None else c.correlation_s for c in told),
                process_rad_s_rs=three(0.0 if c is None else c.process for c in told),
                sensor_rad_rs=three(
                    0.0 if c is None else max(c.sensor * np.sqrt(step), own)
                    for c, own in zip(told, sensor, strict=True)
                ),
                turning_rad_s=three(size),
                turning_correlation_s=three(time),
            )
        )
    return pooled(parts)


def _white_density(record: DynamicRecord) -> Array:
    """Density root of the rates' white noise, rad per root second, by their second differences at the record's own rate, (3,).

    A fit to averaged samples need not see it: a disturbance may turn the vehicle by more between two of them.
    """
    step = float(np.median(np.diff(record.t_s)))
    second = np.diff(record.rate_rad_s, 2, axis=0)[record.keep[2:]]
    return np.asarray(np.sqrt(np.mean(second**2, axis=0) / 6.0 * step), dtype=float)


def _torque_rms(models: Sequence[RecordModel], fit: Fitted, options: FitOptions) -> list[float]:
    """RMS of the torque residual at up to 10 Hz, from differences of the rate residual over 0.1 s."""
    rows = []
    for model in models:
        residual = model.evaluate(fit.parameters, options)[0][:, :3]
        lag = max(1, round(0.1 / float(np.median(model.dt))))
        if len(residual) > lag:
            rows.append(
                (residual[lag:] - residual[:-lag])
                / (model.t_s[lag:] - model.t_s[:-lag])[:, None]
                @ fit.parameters.tensor
            )
    return [float(v) for v in np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0))] if rows else [float("nan")] * 3


def _seed_methods(
    prepared: Sequence[Prepared], exclude: Sequence[tuple[float, float]], progress: Progress
) -> dict[str, MethodResult]:
    """The seed's four methods on the first flight; a refusal of theirs is a note, not a failure of the whole."""
    from groundstation.identification.seed import identify_seed

    progress(0.75, "the seed's four methods")
    first = prepared[0]
    offset = 0.0 if first.clock is None else first.clock.mocap_minus_imu_s
    try:
        return identify_seed(first.flight, mocap_minus_imu_s=offset, exclude=exclude)
    except GroundStationError as error:
        note = str(error)
        return {name: MethodResult(parameters={}, note=note) for name in ("LS", "GD", "FMLS", "FMGD")}
