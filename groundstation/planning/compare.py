"""Which excitation to fly: families of signals under the same limits, judged by what they will reveal."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

from groundstation.errors import BadInput
from groundstation.json_types import JsonObject
from groundstation.planning.information import DEFAULT_NOISE, Noise, percentages, predicted_std
from groundstation.planning.limits import envelope
from groundstation.planning.plan import FREQUENCY_MAX_HZ, describe, paper_plan, plan_excitation
from groundstation.planning.problem import Problem
from groundstation.planning.signals import Family, families, family_series
from groundstation.trajectory import FourierSeries, Plan
from groundstation.vehicle import Vehicle

DIAGONAL = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")
PRODUCTS = ("ixy_kg_m2", "ixz_kg_m2", "iyz_kg_m2")
EFFECTS = ("rotor_drag", "com_offset", "angular_damping", "motor_lag", "input_delay")


@dataclass(frozen=True, slots=True)
class Entry:
    """One excitation in the table.

    Attributes:
        family: its name.
        text: what a pilot should know.
        top_frequency_hz: of the highest harmonic that moves.
        condition_number: cond(W).
        mass_percent, inertia_percent, products_percent: predicted standard deviation of mass, of the worst diagonal
            inertia and of the worst product, as per cent (products: of the geometric mean of their diagonal entries).
        effects_std: predicted standard deviations of the effects' parameters, everything estimated together.
        largest_violation: of a limit, in its own unit.
        plan: to be flown; None where the family does not fit.
    """

    family: str
    text: str
    top_frequency_hz: float = math.nan
    condition_number: float = math.nan
    mass_percent: float = math.nan
    inertia_percent: float = math.nan
    products_percent: float = math.nan
    effects_std: dict[str, float] | None = None
    largest_violation: float = math.nan
    plan: Plan | None = None


@dataclass(frozen=True, slots=True)
class Comparison:
    """Excitations of one vehicle, best worst-inertia first."""

    vehicle: str
    duration_s: float
    entries: tuple[Entry, ...]

    def to_dict(self) -> JsonObject:
        """The table as a JSON document; what a family cannot give is null."""
        rows: list[JsonObject] = []
        for entry in self.entries:
            row = {key: value for key, value in asdict(replace(entry, plan=None)).items() if key != "plan"}
            rows.append({k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()})
        return {
            "schema": "groundstation.plan-comparison/1",
            "vehicle": self.vehicle,
            "duration_s": self.duration_s,
            "families": rows,
        }

    def to_text(self) -> str:
        """The table for people."""
        lines = [
            f"{self.duration_s:.0f} s with {self.vehicle}: predicted standard deviations",
            f"{'excitation':<14} {'top Hz':>6} {'cond(W)':>8} {'mass %':>7} {'inertia %':>9} {'products %':>10} "
            f"{'lag ms':>7} {'c.o.m. mm':>9} {'drag kg/s':>9}",
        ]
        for e in self.entries:
            if e.plan is None:
                lines.append(f"{e.family:<14} {e.text}")
                continue
            std = e.effects_std or {}
            lines.append(
                f"{e.family:<14} {e.top_frequency_hz:6.2f} {e.condition_number:8.2f} {e.mass_percent:7.3f} "
                f"{e.inertia_percent:9.2f} {e.products_percent:10.2f} {1e3 * std.get('rotor_lag_s', math.nan):7.2f} "
                f"{1e3 * max(std.get('com_offset_x_m', 0.0), std.get('com_offset_y_m', 0.0)):9.3f} "
                f"{max(std.get('d_x_kg_s', 0.0), std.get('d_y_kg_s', 0.0)):9.4f}"
            )
        lines += [f"{e.family}: {e.text}" for e in self.entries if e.plan is not None]
        lines.append(
            "inertia and products: the worst entry; lag, centre of mass and drag with everything estimated together"
        )
        return "\n".join(lines)


def _unwatched(_series: FourierSeries) -> None:
    """Nobody looks at the iterates."""


def compare_families(
    vehicle: Vehicle,
    *,
    criterion: str = "A",
    harmonics: int = 5,
    base_frequency_rad_s: float | None = None,
    duration_s: float = 40.0,
    frequency_max_hz: float = FREQUENCY_MAX_HZ,
    start: tuple[float, float, float, float] | None = None,
    noise: Noise = DEFAULT_NOISE,
    seed: int = 3,
    time_budget_s: float = 8.0,
    progress: Callable[[float, str], None] = lambda fraction, text: None,
    **limits: float,
) -> Comparison:
    """Plan every family for one vehicle over the same time under the same limits, and predict what each would reveal.

    Arguments are those of :func:`plan_excitation`; the time goes to the optimised series, half of it with the base
    frequency free where one was given.
    """
    bounds = envelope(vehicle, limits)
    problem = Problem((vehicle,), (bounds,), criterion, harmonics, 1.0, duration_s, start, noise)
    searched = [None] if base_frequency_rad_s is None else [base_frequency_rad_s, None]
    entries: list[Entry] = []
    for k, base in enumerate(searched):

        def part(fraction: float, text: str, done: int = k) -> None:
            progress(0.9 * (done + fraction) / len(searched), text)

        plan = plan_excitation(
            vehicle, criterion=criterion, harmonics=harmonics, base_frequency_rad_s=base, duration_s=duration_s,
            frequency_max_hz=frequency_max_hz, start=start, noise=noise, seed=seed,
            time_budget_s=time_budget_s / len(searched), progress=part, effects=(), starts=None, watch=_unwatched,
            **limits,
        )  # fmt: skip
        where = "the base frequency as given" if base else f"base frequency free below {frequency_max_hz:g} Hz"
        name = "series, free" if base is None and len(searched) > 1 else "series"
        entries.append(_entry(name, f"Fourier series optimised for {criterion}, {where}", plan, vehicle, noise))
    progress(0.95, "families")
    entries += [_designed(family, problem) for family in families(frequency_max_hz)]
    if vehicle.name == "qball2":
        entries.append(_published(problem))
    progress(1.0, "done")
    known = sorted(entries, key=lambda e: e.inertia_percent if math.isfinite(e.inertia_percent) else math.inf)
    return Comparison(vehicle.name, duration_s, tuple(known))


def _designed(family: Family, problem: Problem) -> Entry:
    """A family whose signals are designed, not searched, within the problem's limits."""
    vehicle, noise = problem.vehicles[0], problem.noise
    try:
        series = family_series(family, problem)
    except BadInput as refusal:
        return Entry(family.name, str(refusal))
    flown = replace(series, periods=float(round(problem.duration_s / series.period_s)))
    plan = describe(flown, replace(problem, criterion=family.name))
    return _entry(family.name, family.text, plan, vehicle, noise)


def _published(problem: Problem) -> Entry:
    """The trajectory of Table 2, over the same time."""
    vehicle, noise = problem.vehicles[0], problem.noise
    published = paper_plan().series()
    flown = replace(published, periods=max(problem.duration_s / published.period_s, 1.0))
    plan = describe(flown, replace(problem, criterion="condition"))
    text = "published in Table 2 of the seed paper"
    if plan.largest_violation:
        text += f"; exceeds a limit by {plan.largest_violation:.2g}"
    return _entry("paper", text, plan, vehicle, noise)


def _entry(name: str, text: str, plan: Plan, vehicle: Vehicle, noise: Noise) -> Entry:
    series = plan.series()
    share = percentages(predicted_std(series, vehicle, noise), vehicle)
    moving = [k for k in range(series.a.shape[1]) if abs(series.a[:, k]).max() + abs(series.b[:, k]).max() > 1e-12]
    together = predicted_std(series, vehicle, noise, EFFECTS)
    return Entry(
        family=name,
        text=text,
        top_frequency_hz=(moving[-1] + 1) * series.base_frequency_rad_s / (2.0 * math.pi),
        condition_number=plan.condition_number or math.nan,
        mass_percent=share["mass_kg"],
        inertia_percent=_worst(share, DIAGONAL),
        products_percent=_worst(share, PRODUCTS),
        effects_std={name: value for name, value in together.items() if name not in share},
        largest_violation=plan.largest_violation or 0.0,
        plan=plan,
    )


def _worst(share: dict[str, float], names: Sequence[str]) -> float:
    return max(share[name] for name in names)
