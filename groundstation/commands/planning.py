"""``groundstation plan``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from groundstation.commands.common import ProgressLine, Result, assignments, example, json_option, packed, suggestion
from groundstation.errors import BadInput
from groundstation.json_types import JsonObject

if TYPE_CHECKING:
    from groundstation.trajectory import Plan
    from groundstation.vehicle import Vehicle

LIMIT_OPTIONS = {
    "x-max-m": "x_max_m",
    "y-max-m": "y_max_m",
    "z-min-m": "z_min_m",
    "z-max-m": "z_max_m",
    "yaw-max-deg": "yaw_max_rad",
    "speed-max-m-s": "speed_max_m_s",
    "yaw-rate-max-deg-s": "yaw_rate_max_rad_s",
    "acceleration-max-m-s2": "acceleration_max_m_s2",
    "tilt-max-deg": "tilt_max_rad",
    "thrust-max-n": "thrust_max_n",
    "torque-max-nm": "torque_max_nm",
}
"""Option -> limit of the vehicle file that it overrides; options in degrees set limits in radians."""


LONGEST_SEARCH_S = 86_400.0
"""A day: what is longer is a slip of the finger."""
BUDGET_S = 8.0
"""Of --compare and --discriminate where none is given."""


def limit_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """One option per limit."""
    for option, limit in reversed(LIMIT_OPTIONS.items()):
        function = click.option(f"--{option}", limit, type=float, help=f"Override the vehicle's {limit}.")(function)
    return function


def limits_in_si(values: dict[str, float | None]) -> dict[str, float]:
    """The limits that were given, angles in radians."""
    degrees = {limit for option, limit in LIMIT_OPTIONS.items() if "-deg" in option}
    return {k: math.radians(v) if k in degrees else v for k, v in values.items() if v is not None}


@dataclass(frozen=True, slots=True)
class Wanted:
    """The plan that the command line asks for; None is the planner's own choice."""

    vehicle: str | None
    paper: bool
    criterion: str | None
    harmonics: int | None
    base_frequency_deg_s: float | None
    duration_s: float | None
    frequency_max_hz: float | None
    more_limits: tuple[str, ...]
    seed: int
    time_budget_s: float | None
    compare: bool
    discriminate: Path | None
    output: Path | None

    def chooses_itself(self) -> bool:
        """Whether it says how to plan, or for what."""
        how = self.criterion or self.harmonics or self.base_frequency_deg_s or self.frequency_max_hz
        return bool(self.paper or self.compare or how)

    def problem(self) -> JsonObject:
        """What the planner is asked, by its own names.

        Raises:
            BadInput: the paper's problem for another vehicle.
        """
        from groundstation import api
        from groundstation.planning import paper_problem

        if self.paper and self.vehicle not in (None, "qball2"):
            raise BadInput("--paper is the QBall 2's problem; leave out --vehicle, or plan without --paper.")
        found: dict[str, Any] = (
            paper_problem() if self.paper else {"vehicle": api.load_vehicle(self.vehicle or "qball2")}
        )
        given = {
            "criterion": self.criterion,
            "harmonics": self.harmonics,
            "base_frequency_rad_s": None
            if self.base_frequency_deg_s is None
            else math.radians(self.base_frequency_deg_s),
            "duration_s": self.duration_s,
            "frequency_max_hz": self.frequency_max_hz,
        }
        return found | {key: value for key, value in given.items() if value is not None}


@click.command(epilog=example("groundstation plan --paper --tilt-max-deg 6.2155 --output plan.toml"))
@click.option("--vehicle", default=None, help="Vehicle file, or the name of a shipped one.  [default: qball2]")
@click.option(
    "--paper",
    is_flag=True,
    help="The paper's problem: the QBall 2 in its room, five harmonics of 36 degrees/s, cond(W).",
)
@click.option("--criterion", type=click.Choice(["condition", "D", "A", "E"], case_sensitive=False), default=None,
              help="What is optimised: cond(W), or D-, A- or E-optimality.")  # fmt: skip
@click.option("--harmonics", type=click.IntRange(1, 40), default=None, help="Harmonics per channel.")
@click.option("--base-frequency-deg-s", type=float, default=None, help="Base frequency; free if not given.")
@click.option("--duration-s", type=float, default=None, help="Length of the excitation, s.")
@click.option("--frequency-max-hz", type=float, default=None, help="No harmonic above it where the base is free.")
@click.option("--limit", "more_limits", multiple=True, metavar="NAME=VALUE", help="Any limit by its name, SI.")
@click.option("--seed", type=int, default=3, show_default=True, help="Seed of the random starts.")
@click.option("--time-budget-s", type=click.FloatRange(0.1, LONGEST_SEARCH_S), default=None,
              help="Seconds to search on from random starts; without it the first answer is enough.")  # fmt: skip
@click.option("--compare", is_flag=True, help="Compare families of signals under the same limits, as a table.")
@click.option("--discriminate", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="diagnosis.json: plan the flight that settles what it left open or hints at.")  # fmt: skip
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), default=None, help="Plan file to write.")
@limit_options
@json_option
@packed(Wanted)
def plan(wanted: Wanted, **limits: float | None) -> Result:
    """Optimise an excitation trajectory for a vehicle and a room. Ctrl-C gives the best so far."""
    bounds = limits_in_si(limits) | known_limits(assignments(wanted.more_limits))
    if wanted.discriminate is not None:
        return _discriminating(wanted, wanted.discriminate, bounds)
    from groundstation import api
    from groundstation.planning import plan_document

    problem: dict[str, Any] = {**wanted.problem(), **bounds}
    line = ProgressLine()
    if wanted.compare:
        from groundstation.planning.compare import compare_families

        time_budget_s = wanted.time_budget_s or BUDGET_S
        table = compare_families(seed=wanted.seed, time_budget_s=time_budget_s, progress=line.fraction, **problem)
        line.end()
        return Result(table.to_dict(), table.to_text())
    found = api.plan_excitation(seed=wanted.seed, time_budget_s=wanted.time_budget_s, progress=line.fraction, **problem)
    line.end()
    if wanted.output is not None:
        _write(found, wanted.output)
    return Result(plan_document(found), plan_text(found, wanted.output))


def _discriminating(wanted: Wanted, path: Path, limits: dict[str, float]) -> Result:
    """The flight that settles a diagnosis."""
    if wanted.chooses_itself():
        raise BadInput("--discriminate chooses criterion and frequencies itself; leave those options out.")
    from groundstation import api
    from groundstation.diagnosis.next_flight import TRIAL_S, odds_sentence
    from groundstation.documents import read_diagnosis
    from groundstation.planning import plan_document

    document = read_diagnosis(path)
    line = ProgressLine()
    found = api.plan_next_flight(
        document,
        _vehicle_of(path, document, wanted.vehicle),
        duration_s=wanted.duration_s,
        trials=max(int((wanted.time_budget_s or BUDGET_S) / TRIAL_S), 4),
        seed=wanted.seed,
        progress=line.fraction,
        **limits,
    )
    line.end()
    if wanted.output is not None:
        _write(found.plan, wanted.output)
    odds = [{"pair": list(pair), "log_odds": value} for pair, value in found.log_odds.items()]
    answer = {**plan_document(found.plan), "expected_log_odds": odds, "channels": found.channels}
    return Result(answer, f"next flight: {odds_sentence(found)}\n{plan_text(found.plan, wanted.output)}")


def _vehicle_of(path: Path, document: JsonObject, given: str | None) -> Vehicle:
    """The vehicle as given, else as declared in the identification beside the diagnosis, else the shipped one of its
    name.
    """
    from groundstation.paths import find_config, shipped_config
    from groundstation.reporting.exports import read_model
    from groundstation.vehicle import load_vehicle, vehicle_from_dict

    model = path.with_name("identification.toml")
    if given is None and model.is_file():
        return vehicle_from_dict(read_model(model)["vehicle"], str(model))
    if given is None:
        return load_vehicle(shipped_config("vehicles", document.get("vehicle")))
    return load_vehicle(find_config("vehicles", given))


def known_limits(values: dict[str, float]) -> dict[str, float]:
    """The same, once every name is a limit's.

    Raises:
        BadInput: a name is not; the sentence lists those there are.
    """
    known = sorted(LIMIT_OPTIONS.values())
    for name in values:
        if name not in known:
            raise BadInput(f"{name} is not a limit. {suggestion(name, known)}")
    return values


def _write(found: Plan, path: Path) -> None:
    from groundstation.analysis.plans import write_plan

    write_plan(found, path)


def plan_text(found: Plan, output: Path | None) -> str:
    """A plan for people: what it is, what it keeps, what it will tell."""
    from groundstation.reporting.units import label, scale_for, significant, split_unit

    series = found.series()
    lines = [
        f"plan for {found.vehicle}: {series.duration_s:.1f} s, {series.a.shape[1]} harmonics of"
        f" {math.degrees(series.base_frequency_rad_s):.3g} degrees/s, criterion {found.criterion}"
    ]
    if found.condition_number is not None:
        lines.append(
            f"cond(W) {found.condition_number:.3f}, largest violation of a limit {found.largest_violation or 0:.1e}"
        )
    if found.predicted_std:
        lines.append("predicted standard deviations:")
        for name, std in found.predicted_std.items():
            scale = scale_for(split_unit(name)[1], [std])
            lines.append(f"  {label(name):<12} {significant(std * scale.factor)} {scale.unit}")
    lines += [f"note: {found.note}"] if found.note else []
    lines.append(f"written to {output}" if output else "not written: give --output FILE to keep it")
    return "\n".join(lines)
