"""What turned the vehicle beside the model: the disturbance torque as a prediction and a simulation need it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.prediction_error import Fitted, noise_of
from groundstation.identification.record import DynamicRecord
from groundstation.identification.record_model import RecordModel
from groundstation.model.disturbance import TurningDisturbance, pooled, three, turning
from groundstation.model.parameters import FitOptions

Array = NDArray[np.float64]


def turning_disturbance(models: Sequence[RecordModel], fit: Fitted, options: FitOptions) -> TurningDisturbance:
    """What turned the vehicle beside the model, by the noise model of each flight and axis."""
    parts: list[TurningDisturbance] = []
    for model, noise in zip(models, noise_of(fit, models, options), strict=True):
        colour = dict(zip(noise.channels, noise.colours, strict=True))
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
    """Density root of the rates' white noise, rad per root second, by their second differences at the record's own
    rate, (3,).

    A fit to averaged samples need not see it: a disturbance may turn the vehicle by more between two of them.
    """
    step = float(np.median(np.diff(record.t_s)))
    second = np.diff(record.rate_rad_s, 2, axis=0)[record.keep[2:]]
    return np.asarray(np.sqrt(np.mean(second**2, axis=0) / 6.0 * step), dtype=float)
