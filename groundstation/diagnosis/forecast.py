"""What the findings are worth where no estimate looked: prediction ahead of time, and the closed loop against the
flight.

The parameters of each split (:class:`.comparison.Split`) are estimated on its training data without and with the
effects, and judged on the rest beside the vehicle as declared. Windows of a prediction lie wholly in what is judged,
and start from what the sensors said until then; sensor biases and the clock, which all columns share, are the whole
flight's.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Solution
from groundstation.diagnosis.comparison import Chosen, Split
from groundstation.diagnosis.effect import Acting, Effect, Settings
from groundstation.diagnosis.evidence import Evidence
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.identification.starts import smoothed_states
from groundstation.identification.validation import closed_loop_validation
from groundstation.model.parameters import BASIS, PAIRS, Parameters, table, values_of, with_values
from groundstation.model.prediction import error_norms
from groundstation.model.vehicle_model import VehicleModel, declared_model
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Stages = dict[str, dict[str, float]]

HORIZONS_S = (0.1, 0.5)
STEP_S = 0.01
EVERY_S = 0.25
"""Between the starts of two windows: half of the longer one, so that little is counted twice."""
WINDOWS_MOST = 400
"""In one part that is judged: of so many an error's RMS is known to a few percent."""


def vehicle_model(evidence: Evidence, chosen: Chosen, solution: Solution) -> VehicleModel:
    """What a joint estimate makes of the vehicle, by the declared thrust (the anchor changes no motion)."""
    first = evidence.flights[0]
    p = first.parameters
    names = [name for name in evidence.names if table()[name].timing]
    steps = solution.theta[[evidence.names.index(name) for name in names]]
    values = values_of(p, names) + steps
    at = with_values(p, names, values)
    slopes = [value for name, value in zip(names, values, strict=True) if name == "rotor_lag_slope"]
    (mass, *entries), _ = first.rigid_body(solution)
    vehicle = first.prepared.record.vehicle.model_copy(update={"mass_kg": float(mass)})
    parts, offset = list[tuple[Effect, Settings, Array]](), 0
    for candidate, _ in chosen:
        count = len(candidate.effect.parameters)
        parts.append((candidate.effect, candidate.settings, solution.part(offset, count)[0]))
        offset += count
    return VehicleModel(
        vehicle=vehicle,
        mass_kg=float(mass),
        tensor=np.einsum("k,kij->ij", entries, BASIS),
        lag_up_s=at.lag_up_s,
        lag_down_s=at.lag_down_s,
        lag_slope=float(slopes[0])
        if slopes
        else at.lag_slope,  # as estimated: a part of a flight may go past its range
        delay_s=at.delay_s,
        wrench=Acting(parts, vehicle) if parts else None,
    )


def model_as_declared(vehicle: Vehicle, p: Parameters) -> VehicleModel:
    """The declared curve and lag with an estimated mass and tensor."""
    return VehicleModel(vehicle, p.mass_kg, p.tensor, p.lag_up_s, p.lag_down_s)


def models_of(evidence: Evidence, baseline: Chosen, chosen: Chosen, split: Split) -> dict[str, VehicleModel]:
    """Nominal, before and after, by the training data of a split."""
    declared = evidence.flights[0].prepared.flight.vehicle
    before = (
        vehicle_model(evidence, baseline, evidence.solve(baseline, split.train))
        if split.plain is None
        else model_as_declared(declared, split.plain.parameters)
    )
    nothing_found = split.plain is None and len(chosen) == len(baseline)
    after = before if nothing_found else vehicle_model(evidence, chosen, evidence.solve(chosen, split.train))
    return {"nominal": declared_model(declared), "before": before, "after": after}


def prediction_errors(
    evidence: Evidence, baseline: Chosen, chosen: Chosen, splits: Sequence[Split]
) -> tuple[Stages, int]:
    """RMS error of the open-loop prediction after each of HORIZONS_S, and how many windows it is of.

    Stages are called "prediction_0.1_s_before" and so on; without a rigid body's mass and tensor a stage is empty.
    """
    found: dict[str, dict[str, list[Array]]] = defaultdict(lambda: defaultdict(list))
    starts: dict[tuple[str, int, int], tuple[VehicleModel, Prepared, list[NDArray[np.int64]]]] = {}
    nominal, windows = declared_model(evidence.flights[0].prepared.flight.vehicle), 0
    for split in splits:
        models = models_of(evidence, baseline, chosen, split) | {"nominal": nominal}
        for flight, inside in split.judged:
            index = window_starts(flight.prepared, flight.model.t_s[inside])
            windows += len(index)
            for stage, model in models.items() if len(index) else ():
                key = stage, id(model), id(flight)
                starts.setdefault(key, (model, flight.prepared, []))[2].append(index)
    judged = {key[2]: prepared for key, (_, prepared, _) in starts.items()}
    states = {number: smoothed_states(prepared) for number, prepared in judged.items()}
    known: dict[tuple[int, int], Mapping[float, Mapping[str, Array]]] = {}
    for (stage, *key), (model, _, parts) in starts.items():
        own = key[0], key[1]
        if own not in known:
            known[own] = error_norms(model, states[own[1]], np.concatenate(parts), list(HORIZONS_S), step_s=STEP_S)
        for horizon, norms in known[own].items():
            for quantity, values in norms.items():
                found[f"prediction_{horizon:g}_s_{stage}"][quantity].append(values)
    return {stage: _pooled(norms) for stage, norms in found.items()}, windows


def simulation_errors(evidence: Evidence, baseline: Chosen, chosen: Chosen, splits: Sequence[Split]) -> Stages:
    """RMS difference between the flight and the declared controller flying the plan, where no estimate looked.

    Stages are "simulation_nominal", "simulation_before" and "simulation_after"; one whose loop diverges is left out,
    and all without a plan.
    """
    squares: dict[str, list[tuple[int, Mapping[str, float]]]] = defaultdict(list)
    parts = 0
    for split in splits:
        models = models_of(evidence, baseline, chosen, split)
        sets = {stage: _mass_and_tensor(model) for stage, model in models.items()}
        wrenches = {stage: model.wrench for stage, model in models.items() if model.wrench is not None}
        for flight, inside in split.judged:
            judged = flight.model.t_s[inside]
            recorded, clock = flight.prepared.flight, flight.prepared.clock
            if recorded.plan is None:
                return {}
            check = closed_loop_validation(
                recorded,
                sets,
                mocap_minus_imu_s=clock.mocap_minus_imu_s if clock is not None else 0.0,
                exclude=((-np.inf, judged[0]), (judged[-1], np.inf), *flight.prepared.excluded_s),
                wrenches=wrenches,
            )
            parts += 1
            for stage, rms in check.rms.items():
                squares[f"simulation_{stage}"].append((check.samples, rms))
    return {stage: _weighted(found) for stage, found in squares.items() if len(found) == parts}


def unknown_loop(prepared: Prepared) -> str:
    """Why the closed loop of a flight cannot be simulated; empty where it can."""
    flight = prepared.flight
    if "control" not in flight.vehicle.model_fields_set:
        return "the autopilot's control law is not known (the vehicle file declares no [control])"
    if flight.plan is None or flight.window_s is None:
        return "no plan is recorded with the time it was flown"
    return "no poses are recorded" if flight.mocap is None else ""


def forecast(
    evidence: Evidence, baseline: Chosen, chosen: Chosen, splits: Sequence[Split], halves: Sequence[Split]
) -> tuple[Stages, tuple[str, ...]]:
    """Errors of prediction and closed-loop simulation by stage, and a sentence on what they are of or why there are
    none.

    Args:
        splits: whose judged parts are predicted.
        halves: whose judged parts are compared with the simulated loop, which runs on from part to part.
    """
    empty: Stages = {"simulation_before": {}, "simulation_after": {}}
    everything = [m for split in (*splits, *halves) for m in models_of(evidence, baseline, chosen, split).values()]
    if not all(_is_rigid(model) for model in everything):
        return empty, (
            "Prediction and closed-loop simulation are left out: a part of the flight gives a tensor that no body has.",
        )
    errors, windows = prediction_errors(evidence, baseline, chosen, splits)
    notes = (f"Predictions are judged on {windows} windows that lie in data no estimate saw.",)
    why = next((reason for split in halves for f, _ in split.judged if (reason := unknown_loop(f.prepared))), "")
    if why:
        return errors | empty, (*notes, f"The closed loop is not simulated against the flight: {why}.")
    return errors | empty | simulation_errors(evidence, baseline, chosen, halves), notes


def window_starts(prepared: Prepared, judged_s: Array) -> NDArray[np.int64]:
    """At which stamps windows start that lie wholly in what is judged, without a break."""
    record, longest = prepared.record, HORIZONS_S[-1]
    if not len(judged_s) or judged_s[-1] - judged_s[0] <= longest:
        return np.zeros(0, dtype=np.int64)
    every = max(EVERY_S, float(judged_s[-1] - judged_s[0]) / WINDOWS_MOST)
    first = np.searchsorted(record.t_s, np.arange(judged_s[0], judged_s[-1] - longest, every))
    last = np.minimum(np.searchsorted(record.t_s, record.t_s[first] + longest), len(record.t_s) - 1)
    left_out = np.cumsum(~record.keep)
    whole = (left_out[last] == left_out[first]) & record.keep[first] & (record.t_s[last] <= judged_s[-1])
    return first[whole & np.isfinite(record.rate_rad_s[first]).all(axis=1)]


def _pooled(norms: Mapping[str, Sequence[Array]]) -> dict[str, float]:
    pooled = {name: np.concatenate(list(parts)) for name, parts in norms.items()}
    return {name: float(np.sqrt(np.nanmean(values**2))) for name, values in pooled.items() if np.isfinite(values).any()}


def _weighted(found: Sequence[tuple[int, Mapping[str, float]]]) -> dict[str, float]:
    total = sum(samples for samples, _ in found)
    return {
        name: float(np.sqrt(sum(samples * rms[name] ** 2 for samples, rms in found) / total)) for name in found[0][1]
    }


def _mass_and_tensor(model: VehicleModel) -> dict[str, float]:
    entries = [float(model.mass_kg), *(float(model.tensor[i, j]) for i, j in PAIRS)]
    return dict(zip(MASS_AND_TENSOR, entries, strict=True))


def _is_rigid(model: VehicleModel) -> bool:
    return model.mass_kg > 0.0 and bool(np.linalg.eigvalsh(model.tensor)[0] > 0.0)
