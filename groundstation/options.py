"""What an analysis takes besides the flights: one object, so that no option is lost on the way through its steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from groundstation.errors import BadInput
from groundstation.flightdata import FlightData

OPTION_NAMES = {
    "exclude": "--exclude",
    "references": "--reference",
    "held_out": "--held-out",
    "known_effects": "--model",
}
"""Field of :class:`AnalysisOptions` -> option on the command line."""


@dataclass(frozen=True, slots=True)
class AnalysisOptions:
    """Options of ``identify``, ``diagnose`` and ``analyse``.

    Attributes:
        exclude: stretches (start, end) of the analysed flights to leave out, s, on the IMU's clock. References and
            held-out flights have clocks of their own and are used whole.
        references: healthy flights of the same vehicle; findings are then what differs from them.
        held_out: flights that no estimate sees; errors before and after are then of them.
        known_effects: ``effects`` of a model document, what an earlier flight found; findings are then what is beside
            them.
    """

    exclude: tuple[tuple[float, float], ...] = ()
    references: tuple[FlightData, ...] = ()
    held_out: tuple[FlightData, ...] = ()
    known_effects: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict[str, Any])

    def require_only(self, command: str, *honoured: str) -> None:
        """Refuse what a command cannot honour.

        Raises:
            BadInput: an option is set that is not among ``honoured``.
        """
        for each in fields(self):
            if each.name not in honoured and getattr(self, each.name):
                raise BadInput(
                    f"{command} cannot use {OPTION_NAMES[each.name]}; leave it out, or use diagnose or report."
                )


DEFAULT_OPTIONS = AnalysisOptions()
"""Whole flights, on their own."""
