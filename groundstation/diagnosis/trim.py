r"""What the mean thrusts of a flight say beside those of healthy flights, where body rates were not measured.

In the mean a vehicle that hovers or goes back and forth turns and climbs nowhere: the rotors balance its weight and every steady
torque. If something changed since the healthy flights, the commanded wrench :math:`w = A \bar T(u)` changes so as to counter it:

    weak rotor i      w rises by A e_i T_i q, q = loss/(1 - loss): thrust, both tilt torques and yaw alike
    load beside       F rises by its weight, tau_x by +c_y F, tau_y by -c_x F, yaw by nothing

Healthy flights differ from each other besides (battery, trim): their scatter is the noise, known to few degrees of freedom, so
that differences are Student's (t of each component, correlations neglected). The suspect flights were made in one state and count
as one more draw, however many they are. An explanation that leaves a component less probable than EXCLUDED is
out of the question; the others are compared by their
marginal likelihood (Laplace), each of one prior share; "nothing changed" is one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.attribution import posterior
from groundstation.diagnosis.results import Finding
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate
from groundstation.model.rotors import wrench_matrix
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

CHANNELS = ("force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
LEAST_FREEDOM = 3
FLYING = 0.6
"""Share of the median total thrust from which the vehicle is taken to fly."""
EXCLUDED = 1e-3
"""Probability below which an explanation is out of the question."""
MOST_LOAD = 0.5
"""Largest load, as a share of the weight."""


@dataclass(frozen=True, slots=True)
class _Story:
    """An explanation: its columns (4, p), the width of each parameter's prior, and what it is called."""

    effect: str
    rotor: int | None
    columns: Array
    width: Array


@dataclass(frozen=True, slots=True)
class Trim:
    """What came of it: findings, error of each channel before and after on flights left out, and whether all is explained."""

    findings: tuple[Finding, ...]
    before: dict[str, float]
    after: dict[str, float]
    explained: bool


def applies(suspects: Sequence[Prepared], references: Sequence[Prepared]) -> bool:
    """Rates are derived, single rotors are known, and there are flights enough to know how they scatter."""
    return (
        all(item.source != "imu" for item in (*suspects, *references))
        and suspects[0].record.vehicle.rotors.input != "wrench"
        and len(references) > LEAST_FREEDOM
    )


def compare_trims(suspects: Sequence[Prepared], references: Sequence[Prepared]) -> Trim:
    """Explain the difference of mean thrusts between suspect and healthy flights."""
    vehicle = suspects[0].record.vehicle
    ill, well = (np.array([_mean_thrust(item) for item in group]) for group in (suspects, references))
    matrix = wrench_matrix(vehicle)
    stories = _stories(vehicle, well.mean(axis=0), float(ill.mean(axis=0).sum() - well.mean(axis=0).sum()))
    ill, well = ill @ matrix.T, well @ matrix.T
    freedom = len(well) - 1
    std = np.std(well, axis=0, ddof=1) * np.sqrt(1.0 + 1.0 / len(well))
    change = ill.mean(axis=0) - well.mean(axis=0)
    judged = sorted(
        ((_possible(story, change, std, freedom), _evidence(story, change, std, freedom), story) for story in stories),
        key=lambda item: (not item[0], -item[1]),
    )
    explained, _, story = judged[0]
    after = [_left(story, one - well.mean(axis=0), std, np.delete(ill, i, axis=0).mean(axis=0) - well.mean(axis=0))[1]
             for i, one in enumerate(ill)] if len(ill) > 1 else [_left(story, change, std)[1]]  # fmt: skip
    findings = () if story.effect == "none" else (_finding(vehicle, change, std, freedom, judged),)
    return Trim(
        findings,
        dict(zip(CHANNELS, map(float, np.sqrt(np.mean((ill - well.mean(axis=0)) ** 2, axis=0))), strict=True)),
        dict(zip(CHANNELS, map(float, np.sqrt(np.mean(np.square(after), axis=0))), strict=True)),
        explained,
    )


def _mean_thrust(prepared: Prepared) -> Array:
    thrust = prepared.signals(0.0, 0.0, 0.0).thrust_n[prepared.record.keep]
    total = thrust.sum(axis=1)
    return thrust[total > FLYING * np.median(total)].mean(axis=0)


def _stories(vehicle: Vehicle, healthy: Array, lift: float) -> list[_Story]:
    """All explanations; ``lift`` is the change of total thrust, N."""
    matrix, weight = wrench_matrix(vehicle), float(healthy.sum())
    none = _Story("none", None, np.zeros((4, 0)), np.zeros(0))
    weak = [
        _Story("weak_rotor", i + 1, matrix[:, i : i + 1] * healthy[i], np.array([1.0])) for i in range(len(healthy))
    ]
    beside = np.zeros((4, 3))
    beside[0, 0] = vehicle.gravity_m_s2  # mass
    beside[2, 1], beside[1, 2] = -weight, weight  # com x, y
    share = float(
        np.clip(lift / weight, 1e-3, MOST_LOAD)
    )  # a load sits on the vehicle, so it shifts the centre by its share
    reach = float(np.max(np.abs(vehicle.rotors.position_m))) + vehicle.rotors.radius_m
    width = np.array([MOST_LOAD * weight / vehicle.gravity_m_s2, *([2.0 * share * reach] * 2)])
    return [none, *weak, _Story("com_offset", None, beside, width)]


def _solved(story: _Story, change: Array, std: Array) -> tuple[Array, Array]:
    a = story.columns / std[:, None]
    gram = a.T @ a + np.diag(1.0 / story.width**2)
    covariance = np.asarray(np.linalg.inv(gram), dtype=float)
    return np.asarray(np.linalg.solve(gram, a.T @ (change / std)), dtype=float), covariance


def _left(story: _Story, change: Array, std: Array, fitted_on: Array | None = None) -> tuple[Array, Array]:
    """What a story leaves of a change, in standard deviations and in units, fitted on it or on another."""
    values, _ = _solved(story, change if fitted_on is None else fitted_on, std)
    left = change - story.columns @ values
    return left / std, left


def _evidence(story: _Story, change: Array, std: Array, freedom: int) -> float:
    """Twice the log of the marginal likelihood, by Laplace; all rotors together have the prior share of one story."""
    values, covariance = _solved(story, change, std)
    if len(values) and values[0] < 0.0:  # neither a load nor a loss below nothing
        return -np.inf
    misfit = (freedom + 1) * float(np.sum(np.log1p(_left(story, change, std)[0] ** 2 / freedom)))
    occam = sum(
        2.0 * np.log(w / (np.sqrt(2.0 * np.pi) * s))
        for w, s in zip(story.width, np.sqrt(np.diag(covariance)), strict=True)
    )
    return -misfit - float(occam) - (2.0 * np.log(4.0) if story.rotor is not None else 0.0)


def _possible(story: _Story, change: Array, std: Array, freedom: int) -> bool:
    """No component that a story leaves is less probable than EXCLUDED, by itself."""
    from scipy.stats import t as student

    values, _ = _solved(story, change, std)
    largest = float(np.max(np.abs(_left(story, change, std)[0])))
    return bool(np.all(values[:1] >= 0.0) and 2.0 * student.sf(largest, freedom) > EXCLUDED)


def _finding(
    vehicle: Vehicle, change: Array, std: Array, freedom: int, judged: Sequence[tuple[bool, float, _Story]]
) -> Finding:
    (_, own, story), *rivals = judged
    values, covariance = _solved(story, change, std)
    sigma = np.sqrt(np.diag(covariance))
    odds = [score - own if possible else 2.0 * np.log(EXCLUDED) for possible, score, _ in rivals]
    near = [rival.effect for possible, _, rival in rivals if possible and rival.columns.size]
    alternatives = tuple(dict.fromkeys(name for name in near if name != story.effect))
    if story.effect == "weak_rotor":
        loss = float(values[0] / (1.0 + values[0]))
        parameters = {"loss": Estimate.normal(loss, float(sigma[0]) * (1.0 - loss) ** 2)}
        rotor = story.rotor
        text = f"Beside the healthy flights rotor {rotor} is asked for {100.0 * values[0]:.0f} % more thrust"
    else:
        names = ("mass_change_kg", "com_offset_x_m", "com_offset_y_m")
        parameters = {n: Estimate.normal(float(v), float(s)) for n, v, s in zip(names, values, sigma, strict=True)}
        hubs = np.asarray(vehicle.rotors.position_m)[:, :2]
        rotor = 1 + int(np.argmax(hubs @ values[1:] / np.linalg.norm(hubs, axis=1)))
        text = f"Beside the healthy flights {1e3 * values[0]:.1f} g more are carried towards rotor {rotor}"
    said = " or ".join(alternatives)
    limit = f"; {said} cannot be excluded with {freedom + 1} healthy flights and no gyro" if said else ""
    return Finding(
        effect=story.effect,
        parameters=parameters,
        evidence=f"{text}{limit}.",
        confidence=posterior(odds),
        alternatives=alternatives,
        rotor=rotor,
        gain=float(own - next(score for _, score, s in judged if s.effect == "none")),
    )
