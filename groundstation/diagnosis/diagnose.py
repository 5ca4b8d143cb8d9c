"""``diagnose``: find what the declared vehicle lacks, name it or say that nothing known does, and show the error before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.attribution import Named, Selection, candidates, folds
from groundstation.diagnosis.augmented import is_among
from groundstation.diagnosis.effect import is_commanded, library
from groundstation.diagnosis.evidence import Candidate, Columns, Evidence, FlightEvidence, Solution
from groundstation.diagnosis.kinematic import kinematic_findings
from groundstation.diagnosis.next_flight import rival_entries
from groundstation.diagnosis.proposal import with_proposals
from groundstation.diagnosis.results import Diagnosis, Finding, Unexplained
from groundstation.diagnosis.screen import dependences, unexplained
from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification.anchoring import anchored
from groundstation.identification.pipeline import DynamicFit, fit_dynamics
from groundstation.identification.prediction_error import fit
from groundstation.identification.preparation import Prepared, prepare
from groundstation.identification.record_model import CHANNELS, PAIRS, TENSOR, Parameters, initial_parameters
from groundstation.identification.results import Estimate
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]

EVIDENCE_RATE_HZ = 50.0
LEAST_LAG_S = 5e-3
CERTAIN = 25.0
"""Wald statistic (five standard deviations) for a lag or a delay."""
BASELINE = ("com_offset", "constant_wrench", "rotor_drag", "climb_inflow", "thrust_curve", "battery_sag")
"""What healthy flights of one vehicle share, where reference flights are given."""


def diagnose(
    flights: Sequence[FlightData],
    *,
    references: Sequence[FlightData] = (),
    held_out: Sequence[FlightData] = (),
    augmented: tuple[Candidate, ...] = (),
    progress: Progress = lambda fraction, text: None,
) -> Diagnosis:
    """Trace the residual of one or several flights of a vehicle to effects its declaration lacks.

    Args:
        flights: under suspicion; pooled.
        references: healthy flights of the same vehicle; findings are then what differs from them.
        held_out: flights that no estimate sees; the error before and after is then reported on them.
        augmented: effects that an earlier flight found (:func:`.augmented.known_candidates`); findings are what is beside them.
        progress: told the fraction done and what is being done.
    """
    name = " + ".join(flight.name for flight in flights)
    vehicle = flights[0].vehicle
    try:
        progress(0.05, "bringing the streams onto one clock")
        suspects = [_for_evidence(prepare(flight)) for flight in flights]
        healthy = [_for_evidence(prepare(flight)) for flight in references]
        unseen = [_for_evidence(prepare(flight)) for flight in held_out]
        progress(0.25, "base fit")
        fitted = fit_dynamics([*suspects, *healthy])
        evidence, baseline, named, solution = _select(fitted, suspects, healthy, augmented, (), progress)
        if named:
            # An effect swells the noise it is judged against: what was found is kept out of the noise, and all is judged anew.
            known = tuple(n.candidate for n in named)
            evidence, baseline, named, solution = _select(fitted, suspects, healthy, augmented, known, progress)
        chosen = [*baseline, *((n.candidate, n.columns) for n in named)]
        progress(0.9, "what is left")
        left = dependences(evidence, chosen)
    except Refused as refusal:
        return Diagnosis(
            flight=name, vehicle=vehicle.name, verdict="refused", reason=str(refusal), next_flight=refusal.remedy
        )
    lag = [] if references else _lag_findings(fitted, evidence, solution)
    kinematic = kinematic_findings(suspects[0], _thrust_tilt(suspects[0]))
    offset = sum(len(c.effect.parameters) for c, _ in baseline)
    findings = [*lag, *_findings(named, solution, vehicle, offset), *kinematic]
    remaining = with_proposals(
        evidence,
        chosen,
        unexplained(left),
        lambda more: _errors(evidence, chosen, list(more), fitted, False, unseen)["held_out"],
    )
    before, after = _parameters(evidence, vehicle, baseline, chosen, fitted, bool(lag))
    error = _errors(evidence, baseline, chosen, fitted, bool(lag), unseen)
    verdict = "unexplained" if remaining else "explained" if findings else "clean"
    progress(1.0, "done")
    return Diagnosis(
        flight=name,
        vehicle=vehicle.name,
        verdict=verdict,
        findings=tuple(findings),
        unexplained=remaining,
        error=error,
        parameters_before=before,
        parameters_after=after,
        next_flight=_next_flight(findings, remaining),
        reason=_reason(verdict, findings, remaining),
        warnings=tuple(_warnings(suspects, references)),
        candidates=(
            *(
                {"effect": n.candidate.identifier, "settings": dict(n.candidate.settings), "evidence": n.evidence}
                for n in named
            ),
            *rival_entries(
                evidence,
                chosen,
                [(n.candidate, n.alternatives) for n in named],
                _pool(vehicle, evidence.flights[0], references=bool(healthy)),
            ),
        ),
        residual=_residuals(evidence, baseline, chosen, fitted, bool(lag)),
    )


def _for_evidence(prepared: Prepared) -> Prepared:
    """Effects are slow: thin the fit to EVIDENCE_RATE_HZ."""
    rate = 1.0 / float(np.median(np.diff(prepared.record.t_s)))
    block = max(prepared.record.block, round(rate / EVIDENCE_RATE_HZ))
    return replace(prepared, record=replace(prepared.record, block=block))


def _select(
    fitted: DynamicFit,
    suspects: Sequence[Prepared],
    healthy: Sequence[Prepared],
    augmented: tuple[Candidate, ...],
    known: Sequence[Candidate],
    progress: Progress,
) -> tuple[Evidence, list[tuple[Candidate, Columns]], list[Named], Solution]:
    """Evidence with a noise model that leaves the known effects out, and what it asks for."""
    progress(0.5, "noise of each channel")
    evidence = _evidence(fitted, suspects, healthy, (*augmented, *known))
    vehicle = suspects[0].record.vehicle
    pool = [c for c in _pool(vehicle, evidence.flights[0], references=bool(healthy)) if not is_among(c, augmented)]
    baseline = _baseline(evidence, vehicle) if healthy else []
    baseline += [(c, columns) for c in augmented if (columns := evidence.columns(c, everywhere=True)) is not None]
    selection = Selection(evidence, pool, baseline, lambda f: progress(0.55 + 0.25 * f, "effects one by one"))
    progress(0.8, "selecting")
    return evidence, baseline, *selection.run()


def _evidence(
    fitted: DynamicFit, suspects: Sequence[Prepared], healthy: Sequence[Prepared], known: Sequence[Candidate]
) -> Evidence:
    best = fitted.best
    return Evidence(
        [FlightEvidence(item, best, fitted.options, known) for item in suspects],
        [FlightEvidence(item, best, fitted.options) for item in healthy],
    )


def _pool(vehicle: Vehicle, first: FlightEvidence, *, references: bool) -> list[Candidate]:
    pool = candidates(vehicle, first.signals)
    if references:
        payload = library()["payload_change"]
        pool.append(Candidate(payload, {"at_s": -1.0, "within_s": 1.0}))
    return pool


def _baseline(evidence: Evidence, vehicle: Vehicle) -> list[tuple[Candidate, Columns]]:
    out = []
    for name in BASELINE:
        effect = library()[name]
        if effect.applies(vehicle):
            candidate = Candidate(effect, {})
            columns = evidence.columns(candidate, everywhere=True)
            if columns is not None:
                out.append((candidate, columns))
    return out


def _findings(named: Sequence[Named], solution: Solution, vehicle: Vehicle, offset: int) -> list[Finding]:
    out = []
    for item in named:
        effect, settings = item.candidate.effect, dict(item.candidate.settings)
        count = len(effect.parameters)
        values, covariance = solution.part(offset, count)
        offset += count
        std = np.sqrt(np.diag(covariance))
        rotor = int(settings.pop("rotor")) if "rotor" in settings else None
        parameters = {n: Estimate.normal(v, s) for n, v, s in zip(effect.names(), values, std, strict=True)}
        parameters |= {n: Estimate(v, 0.0, (v, v)) for n, v in settings.items()}
        words = {n: f"{e.value:.3g}" for n, e in parameters.items()} | {"rotor": str(rotor)}
        out.append(
            Finding(
                effect=effect.identifier,
                parameters=parameters,
                evidence=effect.sentence.format(**words),
                confidence=item.confidence,
                alternatives=item.alternatives,
                rotor=rotor,
            )
        )
    return out


def _lag_findings(fitted: DynamicFit, evidence: Evidence, solution: Solution) -> list[Finding]:
    """A lag or a dead time that the vehicle file does not declare, from the joint estimate with the named effects."""
    first = evidence.flights[0]
    vehicle = first.prepared.record.vehicle
    names = list(first.names)
    p = first.parameters
    if not is_commanded(vehicle) or "rotor_lag_up_s" not in names:
        return []
    index = [names.index(n) for n in ("rotor_lag_up_s", "rotor_lag_down_s", "input_delay_s")]
    declared = vehicle.rotors.lag
    about = np.array([p.lag_up_s, p.lag_down_s, p.delay_s])
    values = about + solution.theta[index] - np.array([declared.up_s, declared.down_s, 0.0])
    covariance = solution.covariance[np.ix_(index, index)]

    def wald(part: Sequence[int]) -> float:
        v, c = values[list(part)], covariance[np.ix_(part, part)]
        return float(v @ np.linalg.solve(c, v))

    everything, without_delay, without_lag = wald([0, 1, 2]), wald([2]), wald([0, 1])
    if everything < CERTAIN + 10.0:
        return []
    total = float(values[:2].mean() + values[2])
    if total < LEAST_LAG_S:
        return []
    out = []
    both = without_delay > CERTAIN and without_lag > CERTAIN and values[2] > LEAST_LAG_S
    if both or without_lag >= without_delay or values[2] < LEAST_LAG_S:
        v, c = (values[:2], covariance[:2, :2]) if both else _conditional(values, covariance, 2)
        parameters = {
            "rotor_lag_up_s": Estimate.normal(v[0] + declared.up_s, np.sqrt(c[0, 0])),
            "rotor_lag_down_s": Estimate.normal(v[1] + declared.down_s, np.sqrt(c[1, 1])),
        }
        text = f"The rotors follow their commands with a lag of {1e3 * (v[0] + declared.up_s):.0f} ms up and {1e3 * (v[1] + declared.down_s):.0f} ms down that is not declared."
        out.append(
            Finding(
                "motor_lag",
                parameters,
                text,
                0.999 if without_lag > CERTAIN else 0.7,
                () if without_lag > CERTAIN else ("input_delay",),
            )
        )
    if both or (not out and without_delay > without_lag):
        v, c = (values[2:], covariance[2:, 2:]) if both else (np.array([total]), covariance[2:, 2:])
        out.append(
            Finding(
                "input_delay",
                {"input_delay_s": Estimate.normal(v[0], np.sqrt(c[0, 0]))},
                f"Commands take {1e3 * v[0]:.0f} ms to act.",
                0.99,
                () if without_delay > CERTAIN else ("motor_lag",),
            )
        )
    return out


def _conditional(values: Array, covariance: Array, fixed: int) -> tuple[Array, Array]:
    """Mean and covariance of the rest when one parameter is zero."""
    rest = [i for i in range(len(values)) if i != fixed]
    gain = covariance[rest, fixed] / covariance[fixed, fixed]
    return values[rest] - gain * values[fixed], covariance[np.ix_(rest, rest)] - np.outer(gain, covariance[fixed, rest])


def _thrust_tilt(prepared: Prepared) -> Array | None:
    force = prepared.record.force_m_s2[prepared.record.keep]
    if not np.isfinite(force).all() or prepared.source != "imu":
        return None
    mean = force.mean(axis=0)
    return mean[:2] / mean[2]


def _base_estimates(evidence: Evidence, vehicle: Vehicle, solution: Solution) -> dict[str, Estimate]:
    """Mass and tensor of a linearised joint estimate, under the anchor."""
    p = evidence.flights[0].parameters
    names = list(evidence.names)
    index = [names.index(n) for n in ("mass_kg", *TENSOR)]
    about = np.array([p.mass_kg, *(p.tensor[i, j] for i, j in PAIRS)])
    estimates, constants = anchored(
        vehicle, ["mass_kg", *TENSOR], about + solution.theta[index], solution.covariance[np.ix_(index, index)]
    )
    return {**estimates, **constants}


def _parameters(
    evidence: Evidence,
    vehicle: Vehicle,
    baseline: list[tuple[Candidate, Columns]],
    chosen: list[tuple[Candidate, Columns]],
    fitted: DynamicFit,
    lagged: bool,
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Base parameters with the effects left out and put in. Left out means re-estimated without them, lag included."""
    after = _base_estimates(evidence, vehicle, evidence.solve(chosen))
    if lagged:
        unlagged = _without_lag(fitted, vehicle)
        before, constants = anchored(vehicle, unlagged.names, unlagged.values, unlagged.covariance)
        return {**before, **constants}, after
    return _base_estimates(evidence, vehicle, evidence.solve(baseline)), after


def _without_lag(fitted: DynamicFit, vehicle: Vehicle):
    options = replace(fitted.options, lag=False, delay=False, com=False, yaw_trim=False, colour_rounds=1)
    models = [type(model)(model.record, (), None) for model in fitted.models]
    return fit(models, initial_parameters(vehicle, lag_s=0.0), options)


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


def _remaining(flight: FlightEvidence, chosen: Sequence[tuple[Candidate, Columns]], solution: Solution) -> Array:
    """Unwhitened residual of one flight after a joint estimate."""
    out = flight.residual - flight.sensitivity @ solution.theta[: solution.base]
    first = solution.base
    for candidate, _ in chosen:
        count = len(candidate.effect.parameters)
        theta = solution.theta[first : first + count]
        wrench = candidate.effect.wrench(flight.signals, flight.prepared.record.vehicle, candidate.settings)
        out = out - flight.predicted(wrench) @ theta
        first += count
    return out


def _errors(
    evidence: Evidence,
    baseline: list[tuple[Candidate, Columns]],
    chosen: list[tuple[Candidate, Columns]],
    fitted: DynamicFit,
    lagged: bool,
    unseen: Sequence[Prepared],
) -> dict[str, dict[str, dict[str, float]]]:
    """RMS of the residual wrench per channel on blocks (or flights) that no estimate saw: nominal, before, after."""
    vehicle = evidence.flights[0].prepared.record.vehicle
    nominal = initial_parameters(vehicle, lag_s=0.0)
    stages: dict[str, list[Array]] = {"nominal": [], "before": [], "after": []}
    unlagged = _without_lag(fitted, vehicle).parameters if lagged else None
    if unseen:
        others = [FlightEvidence(item, fitted.best, fitted.options) for item in unseen]
        pairs = {"before": (baseline, evidence.solve(baseline)), "after": (chosen, evidence.solve(chosen))}
        for flight in others:
            _collect(flight, np.ones(len(flight.model.t_s), dtype=bool), pairs, nominal, unlagged, stages)
    else:
        times, _, numbers = evidence.time_of_rows()
        for train, test in folds(evidence):
            pairs = {
                "before": (baseline, evidence.solve(baseline, train)),
                "after": (chosen, evidence.solve(chosen, train)),
            }
            for number, flight in enumerate(evidence.flights[: evidence.suspects]):
                mine = times[(numbers == number) & test]
                inside = np.isin(flight.model.t_s, mine)
                _collect(flight, inside, pairs, nominal, unlagged, stages)
    flight = evidence.flights[0]
    return {
        "held_out": {
            stage: {
                name: float(np.sqrt(np.nanmean(np.concatenate(parts)[:, index] ** 2)))
                for index, name in enumerate(CHANNELS)
                if index in flight.channels
            }
            for stage, parts in stages.items()
        }
    }


def _residuals(
    evidence: Evidence,
    baseline: list[tuple[Candidate, Columns]],
    chosen: list[tuple[Candidate, Columns]],
    fitted: DynamicFit,
    lagged: bool,
) -> dict[str, Array]:
    """Residual wrench of the first flight over time for the report: by channel before, and as "channel/after"."""
    flight = evidence.flights[0]
    before = (
        flight.model.residual(_without_lag(fitted, flight.prepared.record.vehicle).parameters)
        if lagged
        else _remaining(flight, baseline, evidence.solve(baseline))
    )
    after = _remaining(flight, chosen, evidence.solve(chosen))
    series = {"t_s": flight.model.t_s}
    for suffix, residual in (("", before), ("/after", after)):
        wrench = residual_wrench(flight, residual, flight.parameters)
        series |= {CHANNELS[index] + suffix: wrench[:, index] for index in flight.channels}
    return series


def _collect(
    flight: FlightEvidence,
    inside: NDArray[np.bool_],
    pairs: dict[str, tuple[list[tuple[Candidate, Columns]], Solution]],
    nominal: Parameters,
    unlagged: Parameters | None,
    stages: dict[str, list[Array]],
) -> None:
    p = flight.parameters
    stages["nominal"].append(residual_wrench(flight, flight.model.residual(nominal), p)[inside])
    for stage, (chosen, solution) in pairs.items():
        if stage == "before" and unlagged is not None:
            residual = flight.model.residual(unlagged)
        else:
            residual = _remaining(flight, chosen, solution)
        stages[stage].append(residual_wrench(flight, residual, p)[inside])


def _next_flight(findings: Sequence[Finding], remaining: Sequence[Unexplained]) -> str:
    """The manoeuvre that separates what this flight could not."""
    effects = library()
    parts = []
    for finding in findings:
        if finding.alternatives:
            rivals = ", ".join(finding.alternatives)
            how = effects[finding.effect].manoeuvre if finding.effect in effects else _OTHER.get(finding.effect, "")
            parts.append(f"To tell {finding.effect} from {rivals}: {how}.")
    if remaining:
        where = ", ".join(sorted({v for item in remaining for v in item.depends_on}))
        parts.append(
            f"Something unknown varies with {where}: fly slowly over its whole range, twice, in opposite directions."
        )
    return " ".join(parts)


_OTHER = {
    "motor_lag": "fly faster reversals (5 Hz and more) or attitude steps: a lag rounds them, a dead time shifts them",
    "input_delay": "fly faster reversals (5 Hz and more) or attitude steps: a lag rounds them, a dead time shifts them",
    "clock_offset": "turn the vehicle by hand, rotors off, in view of the cameras",
    "mocap_misalignment": "tilt by 15 degrees and more in roll and pitch",
    "imu_misalignment": "tilt by 15 degrees and more in roll and pitch",
}


def _reason(verdict: str, findings: Sequence[Finding], remaining: Sequence[Unexplained]) -> str:
    if verdict == "clean":
        return "No effect beats chance; what is left is this flight's own disturbance and sensor noise."
    if verdict == "explained":
        return f"{len(findings)} effect{'s' if len(findings) > 1 else ''} found; the rest is disturbance and noise."
    channels = ", ".join(item.channel for item in remaining)
    return f"A residual remains in {channels} that depends on the motion and that no known effect removes."


def _warnings(suspects: Sequence[Prepared], references: Sequence[FlightData]) -> list[str]:
    out = []
    if any(item.planned is None for item in suspects):
        out.append(
            "No plan or setpoints are recorded: without instruments a flexible effect of the inputs can soak up a disturbance."
        )
    if any(item.source != "imu" for item in suspects):
        out.append("Rates and accelerations are derived, not measured: small torques cannot be told.")
    return out
