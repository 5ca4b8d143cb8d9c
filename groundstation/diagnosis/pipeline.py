"""``diagnose``: find what the declared vehicle lacks, name it or say that nothing known does, and show the error before
and after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from groundstation.diagnosis.augmented import known_candidates
from groundstation.diagnosis.base import Base, base_fit, for_evidence
from groundstation.diagnosis.case import Case, case_of, sensors, straightened, thrust_exponent
from groundstation.diagnosis.comparison import base_covariance, flight_parameters
from groundstation.diagnosis.effect import catalogue
from groundstation.diagnosis.hanging import hanging, holding
from groundstation.diagnosis.hints import hints
from groundstation.diagnosis.judging import Judged, judge
from groundstation.diagnosis.next_flight import rival_entries
from groundstation.diagnosis.possible import possible
from groundstation.diagnosis.published import published
from groundstation.diagnosis.results import Diagnosis, Finding, Hint, Unexplained, WouldShow
from groundstation.diagnosis.screen import dependences
from groundstation.diagnosis.selection import Final, Progress, Selected, select_beside
from groundstation.diagnosis.swing import Swing
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.trim import applies as trim_applies
from groundstation.diagnosis.trim import compare_trims
from groundstation.diagnosis.turned import told_by_rotors, turn_of_imu
from groundstation.diagnosis.unplanned import PastMotion, tell_unplanned
from groundstation.diagnosis.weakness import weak_instruments
from groundstation.diagnosis.would_show import would_show
from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification.anchoring import anchored, anchored_covariance
from groundstation.identification.declarations import said_first
from groundstation.identification.identifiability import unrevealed
from groundstation.identification.low_frequency import without_plan
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.identification.unplanned import applies as low_frequencies_apply
from groundstation.identification.unplanned import by_low_frequencies
from groundstation.identification.work import Work
from groundstation.json_types import JsonObject
from groundstation.options import DEFAULT_OPTIONS, AnalysisOptions


def diagnose(
    flights: Sequence[FlightData],
    options: AnalysisOptions = DEFAULT_OPTIONS,
    *,
    progress: Progress = lambda fraction, text: None,
    work: Work | None = None,
) -> Diagnosis:
    """Trace the residual of one or several flights of a vehicle to effects its declaration lacks.

    Args:
        flights: under suspicion; pooled.
        options: stretches to leave out, healthy flights to compare with, flights to judge by, effects that are known.
        progress: told the fraction done and what is being done.
        work: of another analysis of the same flights, or to be kept for one.
    """
    work = Work(once=True) if work is None else work
    checks = work.checked(flights[0])
    found = _diagnose(flights, options, progress, work)
    return replace(
        found,
        declarations=tuple(check.to_dict() for check in checks),
        warnings=(*said_first(checks), *found.warnings),
    )


def _diagnose(flights: Sequence[FlightData], options: AnalysisOptions, progress: Progress, work: Work) -> Diagnosis:
    """What :func:`diagnose` finds, the declarations taken as they are."""
    name = " + ".join(flight.name for flight in flights)
    augmented = known_candidates(options.known_effects)
    try:
        progress(0.05, "bringing the streams onto one clock")
        case, kinematic = sensors(as_flown := case_of(flights, options, work))
        if case.healthy and trim_applies(case.suspects, case.healthy):
            return _by_trim(name, case)
        case, departure = thrust_exponent(case)
        progress(0.25, "base fit")
        base = base_fit(case, work)
        air = [] if case.healthy else tell_unplanned(case.suspects, base.fitted.parameters)
        case = case.map(for_evidence)
        selected = select_beside(air, case, base, augmented, progress)
        before, kinematic = kinematic, told_by_rotors(kinematic, selected.evidence, selected.chosen)
        if turn_of_imu(kinematic) != turn_of_imu(before):
            case, departure = thrust_exponent(straightened(as_flown, kinematic))
            base = base_fit(case, work)
            case = case.map(for_evidence)
            selected = select_beside(air, case, base, augmented, progress)
        progress(0.9, "what is left")
        left = dependences(selected.evidence, selected.chosen, len(selected.baseline))
        final = selected.final()
    except Refused as refusal:
        vehicle = flights[0].vehicle.name
        return Diagnosis(
            flight=name, vehicle=vehicle, verdict="refused", reason=str(refusal), next_flight=refusal.remedy
        )
    judged = judge(case, selected, final, kinematic, departure, left, progress)
    progress(1.0, "done")
    found = _with_low_frequencies(_diagnosis(name, case, selected, final, judged, air), case, base)
    if not case.healthy and all(c.identifier != "slung_load" for c, _ in selected.chosen):
        found = _with_swing(found, hanging(case.suspects[0], base.fitted.parameters, selected.sizes()))
    found = possible(found, case.vehicle)
    hidden = unrevealed(base.fitted, case.suspects)
    return published(found, hidden) if hidden else found


def _with_swing(found: Diagnosis, swing: Swing | None) -> Diagnosis:
    """Not clean, with a warning, and with a mass whose interval holds the load, where the force that is left is that of
    a load below the vehicle and no finding says so.
    """
    if swing is None:
        return found
    after, covariance = holding(found.parameters_after, found.covariance_after, swing)
    return replace(
        found,
        verdict="unexplained" if found.verdict in ("clean", "explained") else found.verdict,
        reason=swing.sentence(),
        warnings=(swing.sentence(), *found.warnings),
        swing={"load_kg": swing.load_kg, "length_m": swing.length_m},
        parameters_after=after,
        covariance_after=covariance,
    )


def _with_low_frequencies(found: Diagnosis, case: Case, base: Base) -> Diagnosis:
    """Mass and moments as an identification of the same flights tells them, where there is no plan."""
    if not low_frequencies_apply(case.suspects):
        return found
    low = by_low_frequencies(case.suspects, base.fitted)
    hidden = unrevealed(low, case.suspects)
    estimates, constants = anchored(case.vehicle, low.names, low.values, low.covariance)
    own = {name: value for name, value in estimates.items() if name not in hidden}
    beside = {name: value for name, value in found.parameters_after.items() if name not in MASS_AND_TENSOR}
    return replace(
        found,
        parameters_before={name: value for name, value in found.parameters_before.items() if name not in hidden},
        parameters_after={**own, **beside, **constants},
        covariance_after=anchored_covariance(case.vehicle, low.names, low.values, low.covariance),
    )


def _diagnosis(
    name: str, case: Case, selected: Selected, final: Final, judged: Judged, air: Sequence[PastMotion]
) -> Diagnosis:
    """All of it as the result that is written and shown."""
    hinted = _hints(case, selected)
    reason = _reason(judged.verdict, judged.findings, judged.unexplained, hinted)
    return Diagnosis(
        flight=name,
        vehicle=case.vehicle.name,
        verdict=judged.verdict,
        findings=judged.findings,
        unexplained=judged.unexplained,
        error={"held_out": judged.error},
        parameters_before=judged.before,
        parameters_after=judged.after,
        covariance_after=base_covariance(final.evidence, case.vehicle, final.chosen, judged.left_open),
        by_flight=tuple(flight_parameters(final.evidence, final.chosen)) if len(case.suspects) > 1 else (),
        next_flight=_next_flight(judged.findings, judged.unexplained, hinted),
        reason=" ".join(filter(None, (judged.worse, reason))),
        warnings=tuple(_warnings(case.suspects)),
        notes=(
            *judged.notes,
            *weak_instruments(selected.evidence, selected.chosen),
            *(told.missed() for told in air if not told.stands),
        ),
        adopted=not judged.worse,
        candidates=tuple(_candidate_entries(case, selected)),
        residual=judged.residual,
        would_show=tuple(_would_show(case, selected)),
        hints=tuple(hinted),
    )


def _would_show(case: Case, selected: Selected) -> list[WouldShow]:
    """What would have been found; without a plan past motion tells that of the air, and of the rest little is sure."""
    if any(item.planned is None for item in case.suspects):
        return []
    return would_show(selected.selection, [(n.candidate, n.columns) for n in selected.named])


def _hints(case: Case, selected: Selected) -> list[Hint]:
    """Of flights with a plan, as :func:`_would_show`."""
    if any(item.planned is None for item in case.suspects):
        return []
    return hints(selected.selection, [(n.candidate, n.columns) for n in selected.named])


def _candidate_entries(case: Case, selected: Selected) -> list[JsonObject]:
    """The named candidates, and what each alternative would have to be, for planning the next flight."""
    named = [
        {
            "effect": n.candidate.identifier,
            "settings": dict(n.candidate.settings),
            "evidence": float(n.evidence),
            "held_out_gain": n.gain,
        }
        for n in selected.named
    ]
    pool = [candidate for candidate, _ in selected.selection.pool]
    alternatives = [(n.candidate, n.alternatives) for n in selected.named]
    return [*named, *rival_entries(selected.evidence, selected.chosen, alternatives, pool)]


def _by_trim(name: str, case: Case) -> Diagnosis:
    """What mean thrusts say, where the rates that a dynamic comparison needs were not measured."""
    found = compare_trims(case.suspects, case.healthy)
    shares = {c: min((rms / found.before[c]) ** 2, 1.0) for c, rms in found.after.items() if found.before[c] > 0.0}
    remaining = (
        ()
        if found.explained
        else tuple(Unexplained(c, share) for c, share in shares.items() if share > THRESHOLDS.trim_unexplained_share)
    )
    verdict = "unexplained" if remaining else "explained" if found.findings else "clean"
    return Diagnosis(
        flight=name,
        vehicle=case.vehicle.name,
        verdict=verdict,
        findings=found.findings,
        unexplained=remaining,
        error={
            "held_out": {
                "before": found.before,
                "after": found.after,
                "simulation_before": {},
                "simulation_after": {},
            }
        },
        next_flight=_next_flight(found.findings, ()),
        reason=_reason(verdict, found.findings, remaining),
        warnings=(
            "Body rates were not measured: only the mean thrusts are compared with those of the healthy flights, by "
            "the declared thrust curve. Yaw alone tells a load from a weak rotor there, and a battery or another day "
            "changes it, too; a gyro and rotor speeds would show inertia, and tell them apart.",
        ),
        notes=(*found.notes, "Prediction and closed-loop simulation are left out: body rates were not measured."),
    )


def _next_flight(findings: Sequence[Finding], remaining: Sequence[Unexplained], hinted: Sequence[Hint] = ()) -> str:
    """The manoeuvre that separates what this flight could not, or shows what it gave a hint of."""
    effects = catalogue()
    parts: list[str] = []
    for finding in findings:
        if finding.alternatives:
            rivals = ", ".join(finding.alternatives)
            parts.append(f"To tell {finding.effect} from {rivals}: {effects[finding.effect].manoeuvre}.")
    if remaining:
        where = ", ".join(sorted({v for item in remaining for v in item.depends_on}))
        parts.append(
            f"Something unknown varies with {where}: fly slowly over its whole range, twice, in opposite directions."
        )
    for hint in hinted[:1]:
        parts.append(
            f"There is a hint of {hint.effect.replace('_', ' ')}, not enough for a finding; a flight that would show "
            f"it: {effects[hint.effect].manoeuvre}."
        )
    return " ".join(parts)


def _reason(
    verdict: str, findings: Sequence[Finding], remaining: Sequence[Unexplained], hinted: Sequence[Hint] = ()
) -> str:
    if verdict == "clean" and hinted:
        return "No effect is a finding; what is left passes for this flight's own disturbance and sensor noise."
    if verdict == "clean":
        return "No effect beats chance; what is left is this flight's own disturbance and sensor noise."
    if verdict == "explained":
        return f"{len(findings)} effect{'s' if len(findings) > 1 else ''} found; the rest is disturbance and noise."
    if not remaining:
        return ""
    channels = ", ".join(item.channel for item in remaining)
    return f"A residual remains in {channels} that depends on the motion and that no known effect removes."


def _warnings(suspects: Sequence[Prepared]) -> list[str]:
    out: list[str] = []
    if any(without_plan(item) for item in suspects):
        out.append(
            "No plan or setpoints are recorded, and the path flown is no plan: what the controller answers a "
            "disturbance with can pass for an effect of the inputs. Drag, inflow, lift, flapping and damping are told "
            "by past motion instead."
        )
    if any(item.source != "imu" for item in suspects):
        out.append("Rates and accelerations are derived, not measured: small torques cannot be told.")
    return out
