r"""What turns a vehicle beside its model, carried on into a prediction.

About each axis the rate is the model's, plus a disturbance that an Ornstein-Uhlenbeck process describes, as the
prediction error estimate found it on the identified flights (:mod:`groundstation.identification.noise`):

    omega' = a(inputs, state) + d + white,    d' = -d / tau + white,    y = omega + white

A Kalman filter of these two states tells d at the start of a prediction from the rates measured until then (Anderson
and Moore, Optimal Filtering, ch. 4); from there it fades with its correlation time.

Beyond that the recorded inputs hold the controller's answer to disturbances that came later, and no model knows those:
an open loop drifts away while the flight did not. That a vehicle under control keeps turning back is information, too.
Its rates, of variance S and correlation time T, obey omega' = -omega / T + white of density 2 S / T; along the
prediction that is a measurement of d

    0 = a + d + omega / T + white,

and the covariances decide what it is worth: nothing for a model that knows its vehicle, much for one that is pushed
about.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
from numba import njit
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.json_types import Document

Array = NDArray[np.float64]


def three(values: Iterable[float]) -> tuple[float, float, float]:
    """One number for each body axis.

    Raises:
        ValueError: not three of them.
    """
    x, y, z = (float(v) for v in values)
    return x, y, z


@dataclass(frozen=True, slots=True)
class TurningDisturbance:
    """Angular disturbance of each body axis, three values each.

    Attributes:
        acceleration_rad_s2: standard deviation of d. correlation_s: tau.
        process_rad_s_rs: density root of the white part of the acceleration, rad/s per root second.
        sensor_rad_rs: density root of the white noise of the measured rates, rad per root second.
        turning_rad_s, turning_correlation_s: of the rates themselves, sqrt(S) and T; S is infinite where they tell
            nothing.
    """

    acceleration_rad_s2: tuple[float, float, float]
    correlation_s: tuple[float, float, float]
    process_rad_s_rs: tuple[float, float, float]
    sensor_rad_rs: tuple[float, float, float]
    turning_rad_s: tuple[float, float, float]
    turning_correlation_s: tuple[float, float, float]

    def to_dict(self) -> dict[str, list[float]]:
        """For a model document."""
        return {name: list(values) for name, values in asdict(self).items()}

    @classmethod
    def from_dict(cls, document: Document) -> TurningDisturbance:
        """Inverse of :meth:`to_dict`.

        Raises:
            BadInput: a field is missing, or is not three numbers.
        """
        try:
            fields = {name: three(document[name]) for name in cls.__slots__}
        except (KeyError, TypeError, ValueError):
            raise BadInput(
                f"the model's [disturbance] lacks three numbers for each of {', '.join(cls.__slots__)}; identify again."
            ) from None
        return cls(**fields)


@dataclass(frozen=True, slots=True)
class Carried:
    """Disturbance at each stamp from the past alone, (k, 3), and the covariance of (omega, d) it is known with, (3, 2,
    2).
    """

    acceleration_rad_s2: Annotated[Array, "k 3"]
    covariance: Annotated[Array, "3 2 2"]


def carried(noise: TurningDisturbance, t_s: Annotated[Array, "k"], beside: Annotated[Array, "k 3"]) -> Carried:
    """Filter the rates that the model does not account for.

    Args:
        t_s: stamps, (k,).
        beside: measured rates less the running integral of the model's angular acceleration along the flight, (k, 3).
    """
    step = np.maximum(np.diff(t_s, prepend=2.0 * t_s[0] - t_s[1]), 1e-6)
    found = [_filtered(beside[:, axis].copy(), step, *_densities(noise, axis)) for axis in range(3)]
    return Carried(np.stack([d for d, _ in found], axis=-1), np.stack([p for _, p in found]))


def gains(noise: TurningDisturbance, covariance: Array, step_s: float, steps: int) -> Array:
    """By how much each step of a prediction moves (omega, d) per unit of a + d + omega / T, against it, (steps, 2,
    3).
    """
    out = np.zeros((steps, 2, 3))
    for axis in range(3):
        _, transition, process, _ = _stepped(step_s, *_densities(noise, axis))
        time = noise.turning_correlation_s[axis]
        spread = 2.0 * noise.turning_rad_s[axis] ** 2 / (time * step_s)
        row = np.array([1.0 / time, 1.0])
        p = covariance[axis]
        for step in range(steps):
            p = transition @ p @ transition.T + process
            if np.isfinite(spread):
                out[step, :, axis] = p @ row / (row @ p @ row + spread)
                p = p - np.outer(out[step, :, axis], row @ p)
    return out


def fading(noise: TurningDisturbance, step_s: float) -> Array:
    """Share of d that is left after a step, (3,)."""
    return np.exp(-step_s / np.asarray(noise.correlation_s))


def turning(rate_rad_s: Array, step_s: float) -> tuple[Array, Array]:
    """sqrt(S) and T of each axis of evenly sampled rates (k, 3): T is the autocovariance summed until it first is
    negative, over S.
    """
    time = np.zeros(3)
    square = np.mean(rate_rad_s**2, axis=0)
    for axis, values in enumerate(rate_rad_s.T):
        count = len(values)
        covariance = np.fft.irfft(np.abs(np.fft.rfft(values, 2 * count)) ** 2)[:count] / count
        crossing = np.flatnonzero(covariance < 0.0)
        time[axis] = (
            step_s * float(np.sum(covariance[: crossing[0] if len(crossing) else count])) / max(square[axis], 1e-300)
        )
    return np.sqrt(square), np.maximum(time, step_s)


def pooled(parts: Sequence[TurningDisturbance]) -> TurningDisturbance:
    """One disturbance for several flights: mean variances and densities of the flights that tell of an axis, mean
    correlation times.
    """

    def of_axes(name: str, power: float) -> tuple[float, float, float]:
        values = np.array([getattr(part, name) for part in parts], dtype=float)
        telling = np.array([part.acceleration_rad_s2 for part in parts]) > 0.0
        out: list[float] = [
            np.mean(v[t] ** power) ** (1.0 / power) if t.any() else v[0]
            for v, t in zip(values.T, telling.T, strict=True)
        ]
        return three(out)

    squares = ("acceleration_rad_s2", "process_rad_s_rs", "sensor_rad_rs", "turning_rad_s")
    times = ("correlation_s", "turning_correlation_s")
    return TurningDisturbance(**{n: of_axes(n, 2.0) for n in squares}, **{n: of_axes(n, 1.0) for n in times})


def _densities(noise: TurningDisturbance, axis: int) -> tuple[float, float, float, float]:
    """Variance of d, its correlation time, and the densities of process and sensor."""
    return (
        noise.acceleration_rad_s2[axis] ** 2,
        noise.correlation_s[axis],
        noise.process_rad_s_rs[axis] ** 2,
        noise.sensor_rad_rs[axis] ** 2,
    )


@njit(cache=True)
def _stepped(
    step: float, variance: float, correlation: float, process: float, sensor: float
) -> tuple[float, Array, Array, float]:
    """Share of d kept, transition and process covariance of (omega, d) over a step, and the sensor's variance in it."""
    keep = np.exp(-step / correlation)
    transition = np.array([[1.0, correlation * (1.0 - keep)], [0.0, keep]])
    new = variance * (1.0 - keep * keep)
    noise = np.array([[process * step + new * step * step / 3.0, 0.5 * new * step], [0.5 * new * step, new]])
    return keep, transition, noise, sensor / step


@njit(cache=True)
def _filtered(
    y: Array, step: Array, variance: float, correlation: float, process: float, sensor: float
) -> tuple[Array, Array]:
    """Causal estimate of d at each sample of omega less the model's, and the covariance of (omega, d) at the last
    one.
    """
    out = np.zeros(len(y))
    state = np.array([y[0], 0.0])
    p = np.array([[sensor / step[0], 0.0], [0.0, variance]])
    for k in range(1, len(y)):
        _, transition, noise, spread = _stepped(step[k], variance, correlation, process, sensor)
        state = transition @ state
        p = transition @ p @ transition.T + noise
        total = p[0, 0] + spread
        if total > 0.0 and np.isfinite(y[k]):
            gain = p[:, 0].copy() / total
            state = state + gain * (y[k] - state[0])
            p = p - np.outer(gain, p[0].copy())
        out[k] = state[1]
    return out, p
