"""Plans: what a user asks for, put to the optimiser, and the answer as a plan file or JSON document."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from groundstation.errors import BadInput
from groundstation.json_types import JsonObject
from groundstation.paths import configs_dir, find_config
from groundstation.planning.criteria import CRITERIA, condition_number
from groundstation.planning.information import DEFAULT_NOISE, Noise, percentages, predicted_std
from groundstation.planning.limits import Envelope, check_start, envelope, largest_violation, series_excesses
from groundstation.trajectory import FourierSeries, Plan, coefficients_from_arrays, load_plan, plan_to_dict
from groundstation.vehicle import Vehicle, load_vehicle

if TYPE_CHECKING:
    from groundstation.planning.library import Solved
    from groundstation.planning.problem import Problem

PAPER_START = (0.0, 0.0, 0.7, 0.0)
"""x, y, z, yaw at both ends in the seed paper (section III-B); Table 2 keeps it to its four printed digits."""

PAPER_BASE_FREQUENCY_RAD_S = math.radians(36.0)
PAPER_HARMONICS = 5
PAPER_DURATION_S = 40.0  # section III-D identifies on 10 s < t < 50 s

FREQUENCY_MAX_HZ = 1.0
"""Highest harmonic where the base frequency is free: a position loop on a 30 Hz motion capture follows little above it.
"""

AUTOPILOT = {"frequency_max_hz": 0.5, "acceleration_max_m_s2": 1.5}
"""Of a plan for a vehicle on a link: ArduCopter's firmware, tuned for another vehicle, was 0.45 m off at most within
these limits, and lost a plan of 0.8 Hz and 2 m/s^2 (docs/firmware.md). A plan made with ``groundstation plan`` may ask
for more.
"""

_HARMONICS = (3, 5, 8)
_NEARLY = 0.005  # a limit is reached when this share of it is left
_POOR_PERCENT = 50.0  # a parameter less sure than this is hardly revealed


def paper_problem() -> dict[str, Any]:
    """Arguments of :func:`plan_excitation` that pose the seed paper's problem (section III-B) for its vehicle."""
    return {
        "vehicle": load_vehicle(find_config("vehicles", "qball2")),
        "criterion": "condition",
        "harmonics": PAPER_HARMONICS,
        "base_frequency_rad_s": PAPER_BASE_FREQUENCY_RAD_S,
        "duration_s": PAPER_DURATION_S,
        "start": PAPER_START,
    }


def paper_plan() -> Plan:
    """The published trajectory (Table 2)."""
    return load_plan(find_config("plans", "paper_table2"))


def plan_excitation(
    vehicle: Vehicle | Sequence[Vehicle],
    *,
    criterion: str = "condition",
    harmonics: int | None = 5,
    base_frequency_rad_s: float | None = None,
    duration_s: float | None = None,
    frequency_max_hz: float = FREQUENCY_MAX_HZ,
    start: tuple[float, float, float, float] | None = None,
    noise: Noise = DEFAULT_NOISE,
    effects: Sequence[str] = (),
    seed: int = 3,
    time_budget_s: float | None = None,
    starts: int | None = None,
    progress: Callable[[float, str], None] = lambda fraction, text: None,
    watch: Callable[[FourierSeries], None] = lambda series: None,
    **limits: float,
) -> Plan:
    """The best excitation found for a vehicle within its limits.

    Args:
        vehicle: the vehicle, or several candidates for what it may be: then the worst case counts (robust design).
        criterion: "condition" (the seed paper's cond(W)), "D", "A" or "E".
        harmonics: N of eq. (18), 2 or more; None lets the optimiser choose among 3, 5 and 8.
        base_frequency_rad_s: w_f; None lets the optimiser choose, a whole number of periods filling the duration.
        duration_s: of the excitation; default 40 s. With a given base frequency it is rounded to whole periods.
        frequency_max_hz: no harmonic lies above it where the base frequency is free.
        start: x, y, z, yaw at both ends (m, rad); None lets the optimiser choose.
        noise: the disturbance and sensor noise to expect.
        effects: identifiers of effects whose parameters are estimated with mass and inertia (criteria D, A and E).
        seed: of the random starting points.
        time_budget_s: seconds for random starts beside the solved rooms that ship; None: one start at each base
            frequency, from the solved room most like this one. An interrupt (Ctrl-C) ends the search early and keeps
            the best so far.
        starts: number of starting points instead of a time.
        progress: called with the share of the work that is done and a line of text.
        watch: called with each trajectory that the solver tries; KeyboardInterrupt raised in it ends the search.
        **limits: values that replace those of the vehicle's ``[limits]``, by the same names.

    Returns:
        A plan that keeps every limit to 1e-7 of its unit between samples too.

    Raises:
        BadInput: an argument is impossible, or limits exclude even hovering; names the limit and how far off it is.
    """
    from groundstation.planning.optimiser import Budget, best_of
    from groundstation.planning.problem import Problem

    vehicles = (vehicle,) if isinstance(vehicle, Vehicle) else tuple(vehicle)
    envelopes = tuple(envelope(each, limits) for each in vehicles)
    for each in envelopes:
        if start is not None:
            check_start(each, start)
    _check(criterion, harmonics, time_budget_s)
    base = Problem(vehicles, envelopes, criterion, 1, 1.0, 1.0, start, noise, tuple(effects))
    problems = _at_each_frequency(base, harmonics, base_frequency_rad_s, duration_s, frequency_max_hz)
    budget = Budget(seed, time_budget_s, starts)
    found = best_of(problems, budget, library=solved_rooms(), progress=progress, watch=watch)
    series = replace(found.series, periods=float(round(problems[0].duration_s / found.series.period_s)))
    plan = describe(series, base)
    if not math.isfinite(found.sampled_bound):
        return plan
    said = f"criterion {found.cost:.5g}; with limits held at sampled instants only, the search reached"
    return plan.model_copy(update={"note": f"{plan.note}; {said} {found.sampled_bound:.5g}"})


def _at_each_frequency(
    problem: Problem,
    harmonics: int | None,
    base_frequency_rad_s: float | None,
    duration_s: float | None,
    frequency_max_hz: float,
) -> list[Problem]:
    """The same task at each number of harmonics and each base frequency that may be flown."""
    problems: list[Problem] = []
    for count in _HARMONICS if harmonics is None else (harmonics,):
        try:
            duration, periods = _timing(base_frequency_rad_s, duration_s, count, frequency_max_hz)
        except BadInput:
            if harmonics is None and problems:
                continue
            raise
        base = replace(problem, harmonics=count, duration_s=duration)
        problems += [replace(base, base_frequency_rad_s=2.0 * math.pi * k / duration) for k in periods]
    return problems


def solved_rooms() -> list[Solved]:
    """The library of solved rooms that ships; ``python -m benchmarks.plan_library`` makes it."""
    from groundstation.planning.library import Solved

    path = configs_dir() / "library" / "plans.json"
    document: JsonObject = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {"plans": []}
    return [Solved.from_dict(each) for each in document["plans"]]


def describe(series: FourierSeries, problem: Problem, note: str = "") -> Plan:
    """A trajectory as the plan that solves a problem: its condition number, what it should reveal to the first of the
    vehicles, and by how much it exceeds a limit.
    """
    vehicle, envelopes = problem.vehicles[0], problem.envelopes
    std = predicted_std(series, vehicle, problem.noise, problem.effects)
    return Plan(
        vehicle=vehicle.name,
        base_frequency_rad_s=series.base_frequency_rad_s,
        periods=series.periods,
        coefficients=coefficients_from_arrays(series.a, series.b, series.c),
        criterion=problem.criterion,
        condition_number=condition_number(replace(series, periods=1.0), vehicle.gravity_m_s2),
        largest_violation=largest_violation(series, envelopes),
        limits=envelopes[0].stated(),
        predicted_std={name: value for name, value in std.items() if math.isfinite(value)},
        note=note or _note(series, vehicle, envelopes, std),
    )


def _note(series: FourierSeries, vehicle: Vehicle, envelopes: Sequence[Envelope], std: dict[str, float]) -> str:
    """Which limits the motion reaches, and what it hardly reveals because of them."""
    reached: dict[str, None] = {}
    for each in envelopes:
        bounds = each.stated()
        over = series_excesses(series, each)
        reached |= {name: None for name, excess in over.items() if excess > -_NEARLY * abs(bounds[name])}
    text = f"limits reached: {', '.join(reached) or 'none'}"
    poor = {name: share for name, share in percentages(std, vehicle).items() if not share <= _POOR_PERCENT}
    if poor:
        worst = max(poor, key=lambda name: poor[name])
        text += (
            f"; hardly reveals {', '.join(poor)} ({worst} to {poor[worst]:.3g} %): widen the limits reached or fly "
            "longer"
        )
    return text


def plan_document(plan: Plan) -> JsonObject:
    """The document that ``plan --json`` prints (schema groundstation.plan/1)."""
    return plan_to_dict(plan)


def _timing(
    base: float | None, duration: float | None, harmonics: int, frequency_max_hz: float
) -> tuple[float, list[int]]:
    """Duration of the flight, and how many periods it may consist of."""
    for name, value in (("base frequency", base), ("duration", duration), ("highest frequency", frequency_max_hz)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise BadInput(f"the {name} must be positive, not {value:g}; correct it.")
    wanted = PAPER_DURATION_S if duration is None else duration
    if base is not None:
        period = 2.0 * math.pi / base
        if wanted < 0.999 * period:
            raise BadInput(
                f"the duration of {wanted:g} s is shorter than one period of {period:.4g} s; "
                f"give at least {period:.4g} s or a higher base frequency."
            )
        return round(wanted / period) * period, [round(wanted / period)]
    most = math.floor(wanted * frequency_max_hz / harmonics + 1e-9)
    if most < 1:
        raise BadInput(
            f"{harmonics} harmonics below {frequency_max_hz:g} Hz take {harmonics / frequency_max_hz:.4g} s, longer "
            f"than the duration of {wanted:g} s; use fewer harmonics, a longer flight or a higher top frequency."
        )
    return wanted, sorted({max(round(most / share), 1) for share in (1.0, 1.3, 1.7, 2.2, 3.0, 4.0)}, reverse=True)


def _check(criterion: str, harmonics: int | None, time_budget_s: float | None) -> None:
    if criterion not in CRITERIA:
        raise BadInput(f"{criterion} is not a criterion; there are {', '.join(CRITERIA)}.")
    if harmonics is not None and harmonics < 2:
        raise BadInput(f"{harmonics} harmonics cannot start and end at rest; use 2 or more.")
    if time_budget_s is not None and not time_budget_s > 0.0:
        raise BadInput(f"the time budget must be positive, not {time_budget_s:g} s; correct it.")


__all__ = [
    "FREQUENCY_MAX_HZ",
    "PAPER_START",
    "describe",
    "paper_plan",
    "paper_problem",
    "plan_document",
    "plan_excitation",
]
