"""The error before and after, and the parameters with the effects left out and put in.

*Before* is the base re-estimated without the effects, on the same training blocks; *nominal* is the declared vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate, Columns, Solution
from groundstation.diagnosis.evidence import FLIGHTS_OWN, Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.form_error import form_covariance
from groundstation.diagnosis.held_out import folds, held_out
from groundstation.identification.anchoring import anchored, anchored_covariance
from groundstation.identification.prediction_error import Fitted, output_error
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import CHANNELS, RecordModel
from groundstation.identification.results import Estimate
from groundstation.model.parameters import RIGID_BODY, Parameters, declared_parameters
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Chosen = Sequence[tuple[Candidate, Columns]]


@dataclass(frozen=True, slots=True)
class Split:
    """What is estimated on, and what is judged.

    Attributes:
        train: rows of the evidence that the estimates see; None for all.
        judged: flights, and which of their blocks no estimate sees.
        plain: the base as declared, by the training data alone, where a lag or a curve was found.
    """

    train: NDArray[np.bool_] | None
    judged: tuple[tuple[FlightEvidence, NDArray[np.bool_]], ...]
    plain: Fitted | None = None


def splits_of(evidence: Evidence, unseen: Sequence[Prepared], count: int | None = None) -> list[Split]:
    """The flights that no estimate saw, where there are some; else each flight by the others, or blocks of time
    (``count``, where it is given) by the rest.
    """
    if unseen:
        others = [evidence.flights[0].of(item) for item in unseen]
        return [Split(None, tuple((flight, np.ones(len(flight.model.t_s), dtype=bool)) for flight in others))]
    times, _, numbers = evidence.time_of_rows()
    return [
        Split(
            train,
            tuple(
                (flight, np.isin(flight.model.t_s, times[(numbers == number) & test]))
                for number, flight in enumerate(evidence.flights[: evidence.suspects])
                if np.any(test & (numbers == number))
            ),
        )
        for train, test in (held_out(evidence) if count is None else folds(evidence, count))
    ]


def with_plain(splits: Sequence[Split], evidence: Evidence, vehicle: Vehicle, plain: Fitted) -> list[Split]:
    """The same, each with the base as declared by its own training data; ``plain`` is that by all of them."""
    return [replace(split, plain=as_declared(evidence, vehicle, split.train, plain.parameters)) for split in splits]


def _base_estimates(
    evidence: Evidence, vehicle: Vehicle, chosen: Chosen, left_open: Array | None = None
) -> dict[str, Estimate]:
    """Mass and tensor of the linearised joint estimate with some effects, under the anchor."""
    estimates, constants = anchored(vehicle, RIGID_BODY, *_joint(evidence, chosen, left_open))
    return {**estimates, **constants}


def base_covariance(evidence: Evidence, vehicle: Vehicle, chosen: Chosen, left_open: Array) -> NDArray[np.float64]:
    """Covariance (7, 7) of mass and tensor with the effects put in, under the anchor."""
    return anchored_covariance(vehicle, RIGID_BODY, *_joint(evidence, chosen, left_open))


def flight_parameters(evidence: Evidence, chosen: Chosen) -> list[dict[str, Estimate]]:
    """Of each suspected flight by its own rows: mass, tensor and the effects' parameters ("rotor_drag.d_x_kg_s"),
    without what the anchor adds: its error is the same on every flight.
    """
    _, _, numbers = evidence.time_of_rows()
    out: list[dict[str, Estimate]] = []
    for number in range(evidence.suspects):
        solution = evidence.solve(chosen, numbers == number)
        values, covariance = _rigid_body(evidence, solution)
        found = dict(zip(RIGID_BODY, zip(values, np.sqrt(np.diag(covariance)), strict=True), strict=True))
        offset = 0
        for candidate, _ in chosen:
            names = candidate.effect.names()
            part, spread = solution.part(offset, len(names))
            rotor = f"_{candidate.settings['rotor']:g}" if candidate.effect.of_one_rotor else ""
            pairs = zip(part, np.sqrt(np.diag(spread)), strict=True)
            found |= dict(zip((f"{candidate.identifier}{rotor}.{name}" for name in names), pairs, strict=True))
            offset += len(names)
        out.append(
            {n: Estimate.normal(float(v), float(s)) for n, (v, s) in found.items() if np.isfinite(v) and s > 0.0}
        )
    return out


def _joint(
    evidence: Evidence, chosen: Chosen, left_open: Array | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mass and tensor with the effects put in, and their covariance with what is left open; None: what these effects'
    formulas leave.
    """
    solution = evidence.solve(chosen)
    form = form_covariance(evidence, chosen, solution) if left_open is None else left_open
    return _rigid_body(evidence, solution, form)


def _rigid_body(
    evidence: Evidence, solution: Solution, form: Array | float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mass and tensor of a joint estimate and their covariance, that of the effects' ``form`` added."""
    names = list(evidence.names)
    index = [names.index(n) for n in RIGID_BODY]
    values, jacobian = evidence.flights[0].rigid_body(solution)
    covariance = (solution.covariance + form)[np.ix_(index, index)]
    return values, jacobian @ covariance @ jacobian.T


def base_parameters(
    evidence: Evidence,
    vehicle: Vehicle,
    baseline: Chosen,
    chosen: Chosen,
    plain: Fitted | None,
    left_open: Array,
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Base parameters with the effects left out and put in. Left out means re-estimated without them, lag included.

    Args:
        left_open: what the formulas of the chosen, and explanations beside them, leave open in their joint estimate.
    """
    after = _base_estimates(evidence, vehicle, chosen, left_open)
    if plain is not None:
        before, constants = anchored(vehicle, plain.names, plain.values, plain.covariance)
        return {**before, **constants}, after
    return _base_estimates(evidence, vehicle, baseline), after


def as_declared(
    evidence: Evidence,
    vehicle: Vehicle,
    train: NDArray[np.bool_] | None = None,
    begin: Parameters | None = None,
) -> Fitted:
    """The base by the declared curve with rotors that follow as declared: *before*, where a lag or a curve was found.

    By output error: an estimate with a noise model would take most of what is missing for a disturbance, and its
    parameters would be worse than anyone would use.

    Args:
        train: rows whose times are used; None for all. begin: an estimate by more of the flights.
    """
    options = replace(evidence.flights[0].options, lag=False, delay=False, channels=(0, 1, 2, 5))
    models = [flight.declared for flight in evidence.flights]
    if train is not None:
        times, _, numbers = evidence.time_of_rows()
        models = [m for number, m in enumerate(models) if np.any(train & (numbers == number))]
        seen = [number for number in range(len(evidence.flights)) if np.any(train & (numbers == number))]
        for place, (number, model) in enumerate(zip(seen, models, strict=True)):
            left_out = times[(numbers == number) & ~train]
            if not len(left_out):
                continue
            t = model.record.t_s
            keep = model.record.keep & ~((t >= left_out.min()) & (t <= left_out.max()))
            models[place] = RecordModel(replace(model.record, keep=keep), (), None)
    return output_error(models, declared_parameters(vehicle, lag_s=0.0), options, begin)


def plain_gain(evidence: Evidence, chosen: Chosen, plain: Fitted | None) -> float:
    """Fall of the whitened squared error from the base as declared to everything that was found."""
    if plain is None:
        return 0.0
    residuals = [f.whitened_residual(f.declared.residual(plain.parameters)) for f in evidence.flights]
    after = evidence.remainder(chosen, evidence.solve(chosen))
    return float(np.sum(np.concatenate(residuals) ** 2 - after**2))


def residual_wrench(flight: FlightEvidence, residual: Array, p: Parameters) -> Array:
    """Wrench a residual of rates and specific forces stands for, smoothed over 0.2 s, (blocks, 6), torques first."""
    step = float(np.median(flight.model.dt))
    lag = max(1, round(0.2 / step))
    out = np.full((len(residual), 6), np.nan)
    out[lag:, :3] = (residual[lag:, :3] - residual[:-lag, :3]) / (lag * step) @ p.tensor
    total = np.cumsum(np.concatenate([np.zeros((1, 3)), residual[:, 3:]]), axis=0)
    out[lag:, 3:] = p.mass_kg * (total[lag + 1 :] - total[1:-lag]) / lag
    for start in np.flatnonzero(flight.model.restart):
        out[start : start + lag] = np.nan
    return out


def remaining(flight: FlightEvidence, chosen: Chosen, solution: Solution) -> Array:
    """Unwhitened residual of one flight after a joint estimate."""
    out = flight.residual - flight.sensitivity @ solution.theta[: len(flight.names)]
    first = solution.base
    for candidate, _ in chosen:
        count = len(candidate.effect.parameters)
        theta = solution.theta[first : first + count]
        out = out - flight.moved_by(candidate) @ theta
        first += count
    if solution.base > len(flight.names):
        return _without_own_bias(flight, out)
    return out


def _without_own_bias(flight: FlightEvidence, residual: Array) -> Array:
    """A residual less what the flight's own accelerometer biases make of it: no other flight can tell them, and no
    model is judged by them.
    """
    own = [index for index, name in enumerate(flight.names) if name in FLIGHTS_OWN]
    kept = np.isfinite(residual).all(axis=1)
    columns = flight.sensitivity[kept][:, :, own].reshape(-1, len(own))
    if not len(own) or not columns.any():
        return residual
    values = np.linalg.lstsq(columns, residual[kept].reshape(-1), rcond=1e-10)[0]
    return residual - flight.sensitivity[:, :, own] @ values


def residual_rms(evidence: Evidence, chosen: Chosen, solution: Solution) -> dict[int, float]:
    """RMS of the residual wrench by channel, N or N m, the largest of the suspected flights."""
    flights = evidence.flights[: evidence.suspects]
    rms = [
        np.sqrt(np.nanmean(residual_wrench(f, remaining(f, chosen, solution), f.parameters) ** 2, axis=0))
        for f in flights
    ]
    return {channel: float(max(each[channel] for each in rms)) for channel in flights[0].channels}


def held_out_errors(
    evidence: Evidence, baseline: Chosen, chosen: Chosen, splits: Sequence[Split]
) -> dict[str, dict[str, float]]:
    """RMS of the residual wrench per channel on data that no estimate saw: nominal, before, after."""
    nominal = declared_parameters(evidence.flights[0].prepared.record.vehicle, lag_s=0.0)
    stages: dict[str, list[Array]] = {"nominal": [], "before": [], "after": []}
    wrenches: dict[int, Array] = {}
    for split in splits:
        pairs = {
            "before": (baseline, evidence.solve(baseline, split.train)),
            "after": (chosen, evidence.solve(chosen, split.train)),
        }
        for flight, inside in split.judged:
            if id(flight) not in wrenches:
                wrenches[id(flight)] = residual_wrench(flight, flight.declared.residual(nominal), flight.parameters)
            stages["nominal"].append(wrenches[id(flight)][inside])
            _collect(flight, inside, pairs, split.plain, stages)
    channels = evidence.flights[0].channels
    return {
        stage: {
            name: float(np.sqrt(np.nanmean(np.concatenate(parts)[:, index] ** 2)))
            for index, name in enumerate(CHANNELS)
            if index in channels
        }
        for stage, parts in stages.items()
    }


def residual_series(
    evidence: Evidence,
    baseline: Chosen,
    chosen: Chosen,
    plain: Fitted | None,
) -> dict[str, Array]:
    """Residual wrench of the first flight over time for the report: by channel before, and as "channel/after"."""
    flight = evidence.flights[0]
    before = (
        flight.declared.residual(plain.parameters)
        if plain is not None
        else remaining(flight, baseline, evidence.solve(baseline))
    )
    after = remaining(flight, chosen, evidence.solve(chosen))
    series = {"t_s": flight.model.t_s}
    for suffix, residual in (("", before), ("/after", after)):
        wrench = residual_wrench(flight, residual, flight.parameters)
        series |= {CHANNELS[index] + suffix: wrench[:, index] for index in flight.channels}
    return series


def _collect(
    flight: FlightEvidence,
    inside: NDArray[np.bool_],
    pairs: dict[str, tuple[Chosen, Solution]],
    plain: Fitted | None,
    stages: dict[str, list[Array]],
) -> None:
    p = flight.parameters
    for stage, (chosen, solution) in pairs.items():
        if stage == "before" and plain is not None:
            residual = flight.declared.residual(plain.parameters)
        else:
            residual = remaining(flight, chosen, solution)
        stages[stage].append(residual_wrench(flight, residual, p)[inside])
