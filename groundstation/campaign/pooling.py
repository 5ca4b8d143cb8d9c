r"""What belongs to the vehicle, what to the day, what to the flight: one parameter over flights on several days.
Numbers only.

Flight j of day i has the estimate y_ij with its own standard deviation s_ij (a hierarchical normal model: Gelman et
al., Bayesian Data Analysis, 3rd ed., ch. 5; DerSimonian and Laird 1986 with two levels):

.. math::  y_{ij} = \mu + d_i + u_{ij} + e_{ij}, \quad d_i\sim N(0,\tau_d^2), \; u_{ij}\sim N(0,\tau_f^2), \; e_{ij}\sim
N(0,s_{ij}^2)

:math:`\mu` is the vehicle's, :math:`\mu+d_i` the day's, :math:`\mu+d_i+u_{ij}` the flight's value. Given the two
scatters, all of these are jointly Gaussian with :math:`\mu` flat (best linear unbiased prediction, Robinson, Statist.
Sci. 6, 1991). The scatters are not known, so everything is averaged over a grid of them by its marginal likelihood and
half-t priors with four degrees of freedom (Gelman, Bayesian Anal. 1, 2006) whose scale is the median s: flights of one
vehicle scatter about as much as their intervals say, until more flights say otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from groundstation.identification.results import Estimate

Array = NDArray[np.float64]

FLAT = 1e4
"""Standard deviation that stands for a flat prior of the vehicle's value, in units of the spread of everything seen."""
_SCATTERS = np.concatenate([[0.0], np.geomspace(0.1, 30.0, 14)])
"""In units of the median s."""

OF_THE_DAY = ("wind", "battery_sag", "mocap_misalignment", "mocap_tilt", "clock_offset", "constant_wrench")
"""Effects that a day has and another has not: air, battery, marker body.

All others, and mass and tensor, belong to the vehicle.
"""


@dataclass(frozen=True, slots=True)
class Level:
    """A value and its standard deviation."""

    value: float
    std: float

    def to_dict(self) -> dict[str, float]:
        """As it is written."""
        return {"value": self.value, "std": self.std}


@dataclass(frozen=True, slots=True)
class Levels:
    """One parameter at each level.

    Attributes:
        vehicle: what another flight on another day is expected to have.
        days: by day.
        flights: in the order they were given.
        scatter_days, scatter_flights: standard deviations that no interval covers, posterior means.
    """

    vehicle: Level
    days: Mapping[str, Level]
    flights: tuple[Level, ...]
    scatter_days: float
    scatter_flights: float

    def to_dict(self) -> dict[str, object]:
        """As it is written."""
        return {
            "vehicle": self.vehicle.to_dict(),
            "days": {name: level.to_dict() for name, level in self.days.items()},
            "flights": [level.to_dict() for level in self.flights],
            "scatter_days": self.scatter_days,
            "scatter_flights": self.scatter_flights,
        }


def levels(values: Sequence[float] | Array, stds: Sequence[float] | Array, days: Sequence[str]) -> Levels:
    """Vehicle, days and flights of one parameter.

    Args:
        values, stds: of each flight; finite, std > 0.
        days: on which each was flown.

    Raises:
        ValueError: there is no flight, lengths differ, or a number is none.
    """
    y, s = np.asarray(values, float), np.asarray(stds, float)
    if (
        not len(y)
        or not len(y) == len(s) == len(days)
        or not (np.isfinite(y).all() and np.isfinite(s).all() and (s > 0.0).all())
    ):
        raise ValueError("pooling needs a finite value, a positive standard deviation and a day for each flight.")
    names = list(dict.fromkeys(days))
    of_day = np.array([[float(day == name) for name in names] for day in days])
    unit, centre = float(np.median(s)), float(np.mean(y))
    weight, means, variances, scatters = _grid((y - centre) / unit, s / unit, of_day)
    mean = weight @ means
    std = np.sqrt(np.maximum(weight @ (variances + (means - mean) ** 2), 0.0)) * unit
    mean = centre + unit * mean
    out = [Level(float(m), float(d)) for m, d in zip(mean, std, strict=True)]
    count = len(names)
    tau_d, tau_f = (float(v) * unit for v in weight @ scatters)
    return Levels(
        out[0],
        dict(zip(names, out[1 : 1 + count], strict=True)),
        tuple(out[1 + count :]),
        tau_d if count > 1 else 0.0,
        tau_f,
    )


def _grid(y: Array, s: Array, of_day: Array) -> tuple[Array, Array, Array, Array]:
    """Weights of the scatters, and means and variances of [mu, mu + d, mu + d + u] at each; shapes (g,), (g, n), (g,
    n), (g, 2).
    """
    flights, days = len(of_day), len(of_day.T)
    # from the state [mu, d, u] to what is seen, and to what is told
    seen = np.concatenate([np.ones((flights, 1)), of_day, np.eye(flights)], axis=1)
    width = int(seen.shape[1])
    own = np.eye(1 + days, width) + np.eye(1, width) * (np.arange(1 + days) > 0)[:, None]
    told = np.concatenate([own, seen])
    flat = FLAT * float(np.max(np.hypot(s, np.ptp(y))))
    between = _SCATTERS if days > 1 else _SCATTERS[:1]
    pairs = [(a, b) for a in between for b in (_SCATTERS if flights > 1 else _SCATTERS[:1])]
    log: list[float] = []
    means: list[Array] = []
    variances: list[Array] = []
    for day, flight in pairs:
        prior = np.concatenate([[flat**2], np.full(days, day**2), np.full(flights, flight**2)])
        total = (seen * prior) @ seen.T + np.diag(s**2)
        gain = np.linalg.solve(total, seen * prior).T
        state = gain @ y
        covariance = np.diag(prior) - gain @ (seen * prior)
        means.append(told @ state)
        variances.append(np.einsum("ij,jk,ik->i", told, covariance, told))
        log.append(
            -0.5 * (np.linalg.slogdet(total)[1] + y @ np.linalg.solve(total, y))
            + _log_prior(day) * (days > 1)
            + _log_prior(flight) * (flights > 1)
        )
    weight = np.exp(np.array(log) - max(log))
    return weight / weight.sum(), np.array(means), np.array(variances), np.array(pairs)


def _log_prior(scatter: float) -> float:
    """Half-t of four degrees of freedom and scale 1 as a share of the grid: its probability of the cell."""
    index = int(np.searchsorted(_SCATTERS, scatter))
    edges: Array = np.concatenate([[0.0], 0.5 * (_SCATTERS[1:] + _SCATTERS[:-1]), [1.2 * _SCATTERS[-1]]])
    return float(np.log(2.0 * (stdtr(4, float(edges[index + 1])) - stdtr(4, float(edges[index])))))


def pooled(by_flight: Sequence[Mapping[str, Estimate]], days: Sequence[str]) -> dict[str, Levels]:
    """Levels of each parameter that every flight gave an estimate of; nothing of a single flight."""
    if len(by_flight) < 2:
        return {}
    names = [name for name in by_flight[0] if all(name in each for each in by_flight)]
    return {n: levels([e[n].value for e in by_flight], [e[n].std for e in by_flight], days) for n in names}


def widened(
    estimates: Mapping[str, Mapping[str, float]],
    found: Mapping[str, Levels],
    by_flight: Sequence[Mapping[str, Estimate]],
) -> dict[str, dict[str, float]]:
    """Joint estimates whose standard deviations hold what flights scatter beyond their own intervals, as a share of the
    value.
    """
    out: dict[str, dict[str, float]] = {}
    for name, entry in estimates.items():
        std = entry["std"]
        if name in found and found[name].vehicle.value:
            level = found[name].vehicle
            independent = 1.0 / sum(each[name].std ** -2 for each in by_flight)
            extra = max(level.std**2 - independent, 0.0) / level.value**2
            std = float(np.hypot(std, np.sqrt(extra) * entry["value"]))
        out[name] = {**entry, "std": std}
    return out


def level_of(name: str) -> str:
    """To what a parameter belongs: "day" or "vehicle"; of a finding's parameter ("wind.velocity_x_m_s") by its
    effect.
    """
    return "day" if name.partition(".")[0] in OF_THE_DAY else "vehicle"


def day_of(flight: str) -> str:
    """Day of a flight's folder (2026-01-31T12-00-00-x500); the whole name where it does not begin with one."""
    day, t, _ = flight.partition("T")
    return day if t and len(day) == 10 and day.replace("-", "").isdigit() else flight
