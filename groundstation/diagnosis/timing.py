"""A lag or a dead time between command and thrust that the vehicle file does not declare: which of the two, or both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Solution
from groundstation.diagnosis.effect import is_commanded
from groundstation.diagnosis.effects.input_delay import EFFECT as DELAY
from groundstation.diagnosis.effects.motor_lag import EFFECT as LAG
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.rivals import posterior
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.results import Estimate

Array = NDArray[np.float64]

NAMES = (*LAG.names()[:2], *DELAY.names())
SLOPE = LAG.names()[2]
MEAN_LAG, ALONE = np.array([0.5, 0.5, 0.0]), np.array([0.0, 0.0, 1.0])
"""Of lag up, lag down and dead time: the mean of the lags, and the dead time."""


def _estimated(first: FlightEvidence, solution: Solution, published: Array) -> tuple[Array, Array, Array, _Beside]:
    """Lags up and down and dead time beyond the declared ones (3,), their covariance (3, 3) by noise alone and as it is
    published, and what stands beside.
    """
    names, p, declared = list(first.names), first.parameters, first.prepared.record.vehicle.rotors.lag
    index = [names.index(n) for n in NAMES]
    values = np.array([p.lag_up_s, p.lag_down_s, p.delay_s]) + solution.theta[index]
    values -= [declared.up_s, declared.down_s, 0.0]
    at = names.index(SLOPE)
    slope = Estimate.normal(float(p.lag_slope + solution.theta[at]), float(np.sqrt(published[at, at])))
    step_s = float(np.median(np.diff(first.prepared.flight.motors.t_s)))
    beside = _Beside(declared.up_s, declared.down_s, slope, step_s)
    own = np.ix_(index, index)
    return values, solution.covariance[own], published[own], beside


def lag_findings(evidence: Evidence, solution: Solution, published: Array) -> list[Finding]:
    """From the joint estimate with the named effects; lag and dead time are rivals, or stand together.

    With W the Wald statistic of all three parameters, that of the delay alone is what a lag cannot explain, and the
    other way round: the two single explanations differ by it. Both stand where each is told from none in what is
    published (``timing_divided_std``), a lag alone where the published region of the lags does not hold none: what the
    noise tells of them, weak instruments and formulas may leave open.

    Args:
        published: covariance (p, p) that the intervals are of: the joint estimate's and what is left open beside it.
    """
    first = evidence.flights[0]
    if not is_commanded(first.prepared.record.vehicle) or NAMES[0] not in first.names:
        return []
    values, covariance, spread, lags = _estimated(first, solution, published)

    def wald(part: Sequence[int]) -> float:
        v, c = values[list(part)], covariance[np.ix_(part, part)]
        return float(v @ np.linalg.solve(c, v))

    everything, only_delay_explains, only_lag_explains = wald([0, 1, 2]), wald([2]), wald([0, 1])
    chance = THRESHOLDS.timing_wald + THRESHOLDS.timing_wald_joint_more - everything
    lag, delay = float(values[:2].mean()), float(values[2])
    if chance >= 0.0 or lag + delay < LAG.least:
        return []
    lag_std, delay_std = (float(np.sqrt(part @ spread @ part)) for part in (MEAN_LAG, ALONE))
    divided = min(lag / lag_std, delay / delay_std) > THRESHOLDS.timing_divided_std
    both = min(only_delay_explains, only_lag_explains) > THRESHOLDS.timing_wald and lag > LAG.least
    if both and delay > DELAY.least and divided:
        return [
            _lag(values, spread, lags, only_lag_explains, (THRESHOLDS.timing_wald - only_lag_explains,)),
            _delay(
                delay,
                spread[2, 2],
                lags.step_s,
                only_delay_explains,
                (THRESHOLDS.timing_wald - only_delay_explains,),
            ),
        ]
    lead = only_lag_explains - only_delay_explains
    if lead >= 0.0 or delay < DELAY.least:
        lags_alone, published_alone = _conditional(values, covariance, spread)
        if float(lags_alone @ np.linalg.solve(published_alone, lags_alone)) < THRESHOLDS.timing_told_wald:
            return []
        close = lead < THRESHOLDS.inseparable
        return [_lag(lags_alone, published_alone, lags, everything, (chance, -lead), close)]
    close = -lead < THRESHOLDS.inseparable
    return [_delay(lag + delay, spread[2, 2], lags.step_s, everything, (chance, lead), close)]


@dataclass(frozen=True, slots=True)
class _Beside:
    """What is known beside the lags' departures: the declared lags, the rate's dependence on speed, the interval of
    the commands.
    """

    up_s: float
    down_s: float
    slope: Estimate
    step_s: float


def _lag(
    values: Array,
    covariance: Array,
    beside: _Beside,
    gain: float,
    rivals: Sequence[float],
    close: bool = False,
) -> Finding:
    """The finding; its intervals carry what the interval of the recorded commands leaves open, as those of an
    identification do.
    """
    up, down = float(values[0] + beside.up_s), float(values[1] + beside.down_s)
    std = np.sqrt(np.diag(covariance))
    return Finding(
        effect=LAG.identifier,
        parameters={
            NAMES[0]: Estimate.time(up, float(std[0]), beside.step_s),
            NAMES[1]: Estimate.time(down, float(std[1]), beside.step_s),
            SLOPE: beside.slope,
        },
        sentence=filled(LAG.sentence, **{NAMES[0]: up, NAMES[1]: down}),
        confidence=posterior(rivals),
        alternatives=(DELAY.identifier,) if close else (),
        gain=gain,
    )


def _delay(
    value: float, variance: float, step_s: float, gain: float, rivals: Sequence[float], close: bool = False
) -> Finding:
    return Finding(
        effect=DELAY.identifier,
        parameters={NAMES[2]: Estimate.time(value, float(np.sqrt(variance)), step_s)},
        sentence=filled(DELAY.sentence, **{NAMES[2]: float(value)}),
        confidence=posterior(rivals),
        alternatives=(LAG.identifier,) if close else (),
        gain=gain,
    )


def _conditional(values: Array, covariance: Array, spread: Array) -> tuple[Array, Array]:
    """The lags when there is no dead time, and their covariance as it is published."""
    alone = np.column_stack([np.eye(2), -covariance[:2, 2] / covariance[2, 2]])
    return alone @ values, alone @ spread @ alone.T
