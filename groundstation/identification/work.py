"""What one analysis of some flights has worked out and the next one of the same flights need not: motion and fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from groundstation.flightdata import FlightData
from groundstation.identification.declarations import Check, check_declarations
from groundstation.identification.dynamic_fit import DynamicFit, Progress, fit_dynamics
from groundstation.identification.preparation import Prepared, prepare_all

Stretches = Sequence[tuple[float, float]]


@dataclass(slots=True)
class Work:
    """Flights brought onto one clock, and fitted; the last of each. It is as large as the flights themselves.

    Flights are told apart by which objects they are: nothing is compared.

    Attributes:
        once: no other analysis follows, and fits are not kept.
    """

    once: bool = False
    _flights: tuple[list[FlightData], list[tuple[float, float]], list[Prepared]] | None = field(default=None)
    _fit: tuple[list[Prepared], DynamicFit] | None = field(default=None)
    _checks: tuple[FlightData, tuple[Check, ...]] | None = field(default=None)

    def checked(self, flight: FlightData) -> tuple[Check, ...]:
        """:func:`.declarations.check_declarations`."""
        if self._checks is None or self._checks[0] is not flight:
            self._checks = flight, check_declarations(flight)
        return self._checks[1]

    def prepared(self, flights: Sequence[FlightData], exclude: Stretches) -> list[Prepared]:
        """:func:`.preparation.prepare_all`; a flight that was among the last ones is not prepared again."""
        known = self._flights
        if known is None or known[1] != list(exclude):
            known = list[FlightData](), list(exclude), list[Prepared]()
        if not _same(known[0], flights):
            before = {id(flight): prepared for flight, prepared in zip(known[0], known[2], strict=True)}
            known = list(flights), list(exclude), prepare_all(flights, exclude, before)
        self._flights = known
        return known[2]

    def fitted(self, prepared: Sequence[Prepared], progress: Progress = lambda fraction, text: None) -> DynamicFit:
        """:func:`.dynamic_fit.fit_dynamics`."""
        if self.once:
            return fit_dynamics(prepared, progress)
        known = self._fit
        if known is None or not _same(known[0], prepared):
            known = self._fit = list(prepared), fit_dynamics(prepared, progress)
        return known[1]


def _same(some: Sequence[object], others: Sequence[object]) -> bool:
    return len(some) == len(others) and all(one is other for one, other in zip(some, others, strict=True))
