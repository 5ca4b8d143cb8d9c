r"""What sampled streams cannot resolve: no interval is finer.

Between samples a stream is taken as linear, and what is integrated is so by the trapezoidal rule. Of a sinusoid of
angular frequency w sampled every h, a piecewise linear curve holds the share sinc^2(w h / 2) = 1 - (w h)^2 / 12 + ...
(Oppenheim and Schafer 2010, section 4.3), and the trapezoidal rule errs by the same share. Such an error is one of
gain: mass or moment takes it as its own. It is systematic, so that no number of samples averages it out, and a fit of
a flight without noise does not see it.

w is the mean-square frequency of what the parameter answers to, force or torque (Rice 1944, section 3.3): w^2 =
E[y'^2] / E[y^2]. It comes from differences over one and two blocks, D_1 and D_2, whose difference D_2 - D_1 = 3 w^2
dt^2 E[y^2] is free of white noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import Stream
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import RecordModel
from groundstation.model.parameters import Parameters

Array = NDArray[np.float64]

_ANSWERS = {"mass_kg": 2, "ixx_kg_m2": 3, "iyy_kg_m2": 4, "izz_kg_m2": 5}
"""Which row of force and torque each parameter answers to."""


def unresolved_share(prepared: Prepared, model: RecordModel, p: Parameters) -> Annotated[Array, "6"]:
    """The part of each row of force and torque that the flight's streams do not resolve, (6,)."""
    streams = [s for s in (prepared.flight.imu, prepared.flight.motors, prepared.flight.mocap) if s is not None]
    steps = [_step_s(stream) for stream in streams] or [0.0]
    return frequency_squared(model, model.wrench(p)) * float(np.sum(np.square(steps))) / 12.0


def _step_s(stream: Stream) -> float:
    return float(np.median(np.diff(stream.t_s))) if len(stream) > 1 else 0.0


def frequency_squared(model: RecordModel, values: Array) -> Array:
    """Mean-square angular frequency of block means (blocks, n), less white noise, (n,); 0 where it is not known."""
    inside = ~model.restart
    pair, triple = inside[1:], inside[1:-1] & inside[2:]
    if np.count_nonzero(triple) < 3:
        return np.zeros((values.shape[1],))
    first = np.mean((values[1:] - values[:-1])[pair] ** 2, axis=0)
    second = np.mean((values[2:] - values[:-2])[triple] ** 2, axis=0)
    slope = np.maximum(second - first, 0.0) / 3.0
    noise = np.maximum(first - slope, 0.0) / 2.0
    size = np.var(values, axis=0) - noise
    step = float(np.median(model.dt))
    return np.where(size > 0.0, slope / np.maximum(size, 1e-30) / step**2, 0.0)


def no_finer(fitted: Fitted, share: Array) -> Fitted:
    """With the deviations of mass and moments no smaller than what is not resolved of their size; correlations stay.

    Args:
        fitted: a fit.
        share: of each row of force and torque, (6,).
    """
    least = {name: abs(fitted.value(name)) * share[row] for name, row in _ANSWERS.items() if name in fitted.names}
    widened = _widening(fitted, least)
    if np.all(widened == 1.0):
        return fitted
    return replace(fitted, covariance=fitted.covariance * np.outer(widened, widened))


def _widening(fitted: Fitted, least: Mapping[str, float]) -> Array:
    factor = np.ones(len(fitted.names))
    for name, floor in least.items():
        std = fitted.std(name)
        if 0.0 < std < floor:
            factor[fitted.names.index(name)] = floor / std
    return factor
