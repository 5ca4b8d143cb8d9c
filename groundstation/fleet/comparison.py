"""Two flights, or two groups of flights, against each other, as a result for Python: what `compare` and `flights
--compare` tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.fleet.report import DIFFERENT
from groundstation.fleet.trends import Groups, compare_groups
from groundstation.identification.results import Estimate
from groundstation.json_types import JsonObject
from groundstation.reporting.compare import DIFFERS, Flown, change, comparison_sentence
from groundstation.reporting.units import label
from groundstation.tabular import Record, Tabular


@dataclass(frozen=True, slots=True)
class Compared:
    """One parameter, in the unit that its name carries.

    Attributes:
        first, second: the estimate of one flight, or the random-effects mean of a group.
        size: second less first.
        std: standard deviation of that.
        z: the difference in its own standard deviations.
        p: two-sided, corrected for the number of parameters (Holm).
        differs: of two flights, more than 2.8 standard deviations; of groups, p below 0.01.
        change: the difference in words: a share of the first, or in the parameter's unit where the first may as well be
            zero.
    """

    first: float
    second: float
    size: float
    std: float
    z: float
    p: float
    differs: bool
    change: str


@dataclass(frozen=True, slots=True)
class Comparison(Tabular):
    """What differs between two flights, or two groups.

    Attributes:
        first, second: names of the flights.
        parameters: by name, each that both sides tell.
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    parameters: Mapping[str, Compared]

    @property
    def summary(self) -> str:
        """What differs, in a sentence."""
        moved = [f"{label(name)} {row.change}" for name, row in self.parameters.items() if row.differs]
        return comparison_sentence(", ".join(self.first), ", ".join(self.second), len(self.parameters), moved)

    def records(self) -> list[Record]:
        """A row for each parameter."""
        return [
            {"parameter": name, **asdict(row), "differs": "yes" if row.differs else "no"}
            for name, row in self.parameters.items()
        ]

    def to_dict(self) -> JsonObject:
        """The same as a JSON document."""
        return {
            "schema": "groundstation.differences/1",
            "first": list(self.first),
            "second": list(self.second),
            "summary": self.summary,
            "parameters": {name: asdict(row) for name, row in self.parameters.items()},
        }

    def _title(self) -> str:
        return self.summary


def compare_flights(first: Sequence[Flown], second: Sequence[Flown]) -> Comparison:
    """Compare two flights, or two groups, by the one estimate of each.

    Raises:
        BadInput: a side has no flight.
    """
    if not first or not second:
        raise BadInput("a comparison needs a flight on each side.")
    single = len(first) == len(second) == 1
    rows: dict[str, Compared] = {}
    for name, (found, p) in compare_groups(_group(first), _group(second)).items():
        z = found.size / found.std
        before, after = (Estimate.normal(value, found.std / np.sqrt(2.0)) for value in (found.first, found.second))
        if single:
            before, after = first[0].parameters()[name], second[0].parameters()[name]
        differs = abs(z) > DIFFERS if single else p < DIFFERENT
        rows[name] = Compared(
            found.first, found.second, found.size, found.std, z, p, differs, change(name, before, after)
        )
    return Comparison(tuple(f.name for f in first), tuple(f.name for f in second), rows)


def _group(flights: Sequence[Flown]) -> Groups:
    """Values and standard deviations by parameter; what has no spread says nothing of a difference."""
    told = [flight.parameters() for flight in flights]
    out: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for name in dict.fromkeys(name for known in told for name in known):
        found = [known[name] for known in told if name in known and known[name].std > 0.0]
        if found:
            out[name] = (np.array([e.value for e in found]), np.array([e.std for e in found]))
    return out
