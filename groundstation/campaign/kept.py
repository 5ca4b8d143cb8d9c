"""What one round of a campaign leaves for the next: flights as they were loaded, and what was worked out of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from groundstation.flightdata import FlightData
from groundstation.identification.work import Work
from groundstation.model.flight_states import FlightStates
from groundstation.vehicle import Vehicle


@dataclass(slots=True)
class Kept:
    """The flights of one campaign; a round pools them all, and only the last one is new."""

    work: Work = field(default_factory=Work)
    _flights: dict[Path, FlightData] = field(default_factory=dict[Path, FlightData])

    def flight(self, folder: Path, vehicle: Vehicle) -> FlightData:
        """A flight of this vehicle from its folder.

        Raises:
            BadInput: it cannot be read.
        """
        from groundstation.recording import load_flight

        if folder not in self._flights:
            self._flights[folder] = load_flight(folder, vehicle=vehicle)
        return self._flights[folder]

    def states(self, flights: Sequence[FlightData]) -> list[FlightStates]:
        """What predictions of these flights start from and are judged by, of the motion that estimates of them use.

        Raises:
            Refused: a flight holds too little, or its clocks cannot be aligned.
        """
        from groundstation.identification.starts import smoothed_states

        return [smoothed_states(prepared) for prepared in self.work.prepared(flights, ())]
