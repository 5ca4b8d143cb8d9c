"""The dynamic fit of one or several flights: prediction error, the thrust curve where it is free, instrumental
variables.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import NotIdentifiable
from groundstation.identification.damping import damping_terms
from groundstation.identification.identifiability import quiet_axes
from groundstation.identification.instrumental import instrumental
from groundstation.identification.memory import released
from groundstation.identification.prediction_error import Fitted, fit, fit_from_declared
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import BodyWrench, RecordModel
from groundstation.identification.resolution import no_finer, unresolved_share
from groundstation.model.parameters import FitOptions, Parameters
from groundstation.model.rotors import wrench_matrix

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]


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

        FE would be a little sharper where the controller saw no more than the record holds and the inputs are exact,
        but a test of that (Durbin, Wu and Hausman) is weakest on the gentle flights where the bias is largest.
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
    models: list[RecordModel] = []
    for item, axes in zip(prepared, quiet_axes(prepared), strict=True):
        terms, planned = damping_terms(item)
        silent: frozenset[int] = frozenset(np.flatnonzero(axes).tolist() if planned is None else ())
        models.append(RecordModel(item.record, terms, planned, silent))
    return tuple(models)


def _without_gain(model: RecordModel, fitted: Fitted) -> RecordModel:
    """The model with every damping that came out negative held at zero.

    Air takes energy from a turning vehicle and gives none. Without a plan, what feeds the disturbance back passes for
    the contrary, and a model with it runs away when it is simulated.
    """
    held = tuple(
        replace(term, prior_std=1e-6 * term.prior_std) if coefficient < 0.0 else term
        for term, coefficient in zip(model.extra, fitted.parameters.extra, strict=True)
    )
    return RecordModel(model.record, held, model.planned, model.silent)


def fit_dynamics(prepared: Sequence[Prepared], progress: Progress = lambda fraction, text: None) -> DynamicFit:
    """Prediction error and instrumental estimates of the pooled flights, no finer than their streams resolve."""
    found = _fitted(prepared, progress)
    p = found.best.parameters
    shares = [unresolved_share(item, model, p) for item, model in zip(found.prepared, found.models, strict=True)]
    for model in found.models:
        model.forget()
    released(prepared)
    share = np.mean(shares, axis=0)
    refined = None if found.instrumental is None else no_finer(found.instrumental, share)
    return replace(found, filter_error=no_finer(found.filter_error, share), instrumental=refined)


def _fitted(prepared: Sequence[Prepared], progress: Progress) -> DynamicFit:
    options = options_for(prepared[0])
    models = _models_of(prepared)
    if any(len(model.t_s) < 50 for model in models):
        raise NotIdentifiable(
            "a flight holds less than a second of data without gaps.",
            "Leave out less of it, lose fewer samples, or fly longer.",
        )
    released(prepared)
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
        released(prepared)
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
    total: Array = prepared.signals(up_s, down_s, 0.0).thrust_n[prepared.record.keep].sum(axis=1)
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
    terms: list[BodyWrench] = []
    for power, (name, declared) in enumerate(zip(CURVE, vehicle.rotors.thrust_curve or (), strict=True)):
        value = lagged**power @ matrix.T
        span = max(abs(declared), 0.2 * vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count)
        terms.append(BodyWrench(name, value, prior_std=span))
    return terms
