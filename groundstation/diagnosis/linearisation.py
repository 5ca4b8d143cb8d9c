"""The point that a flight's evidence is linear about.

A torque that depends on the motion biases the tensor of a base fit that lacks it, the rotors' angular momentum by
half and more, and about such a tensor nothing linear finds it back. Where the flight is much likelier with such torques
free, their fit is the better point. Nothing is named here: what is there, the evidence about that point says. Where
speeds are commanded and not measured, lag and dead time are free, and a torque that leads the command is one of them to
any such fit: there the base stays as it is, or is the prediction error estimate where what is lacking has led the
instruments far off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import Effect, bending
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.dynamic_fit import DynamicFit
from groundstation.identification.identifiability import unsettled
from groundstation.identification.prediction_error import Fitted, fit
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import BodyWrench, RecordModel
from groundstation.model.parameters import Parameters

Array = NDArray[np.float64]


def linearisation(fitted: DynamicFit) -> Fitted:
    """The best base fit, or a likelier one with the bending torques free."""
    own = fitted.filter_error
    if fitted.options.lag:
        return own if unsettled(fitted.best, own) else fitted.best
    vehicle = fitted.prepared[0].record.vehicle
    effects = [effect for effect in bending() if effect.applies(vehicle)]
    models = [
        RecordModel(item.record, (*model.extra, *_terms(item, own.parameters, effects)), None, model.silent)
        for item, model in zip(fitted.prepared, fitted.models, strict=True)
    ]
    count = len(models[0].extra) - len(own.parameters.extra)
    if count == 0 or len({len(model.extra) for model in models}) > 1:
        return fitted.best
    start = replace(own.parameters, extra=np.concatenate([own.parameters.extra, np.zeros(count)]))
    freed = fit(models, start, fitted.options)
    if own.cost - freed.cost < THRESHOLDS.bent_base_cost * count:
        return fitted.best
    return replace(fitted.best, parameters=replace(freed.parameters, extra=fitted.best.parameters.extra))


def _terms(prepared: Prepared, p: Parameters, effects: list[Effect]) -> list[BodyWrench]:
    """The effects' wrenches at the IMU's stamps; none whose signals are unknown."""
    signals, vehicle = prepared.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope), prepared.record.vehicle
    found = [(effect, effect.wrench(signals, vehicle, {})) for effect in effects]
    return [
        BodyWrench(parameter.name, wrench[:, :, index], prior_std=parameter.prior_std(vehicle))
        for effect, wrench in found
        if np.isfinite(wrench).all()
        for index, parameter in enumerate(effect.parameters)
    ]
