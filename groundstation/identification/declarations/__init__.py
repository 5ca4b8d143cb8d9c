"""Declaration checks: the data among themselves and against the vehicle file, before any fit.

None of them changes the data.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification.declarations.check import Check
from groundstation.identification.declarations.frames import frame_checks
from groundstation.identification.declarations.rotors import rotor_checks
from groundstation.identification.declarations.scale import lag_doubts, scale_checks, tensor_checks
from groundstation.identification.declarations.signals import flown, liveliest
from groundstation.identification.declarations.speeds import speed_checks

__all__ = ["Check", "check_declarations", "go_on", "lag_doubts", "said_first"]


def check_declarations(flight: FlightData) -> tuple[Check, ...]:
    """Every check that a flight's streams allow; those that are contradicted first."""
    flight = liveliest(flight)
    try:
        signals = flown(flight)
    except Refused:
        return ()  # it did not fly: the analysis says so
    found = [
        *frame_checks(flight),
        *rotor_checks(signals, flight.vehicle),
        *speed_checks(signals, flight.vehicle),
        *scale_checks(signals, flight.vehicle),
        *tensor_checks(flight.vehicle),
    ]
    rank = {"contradicted": 0, "doubtful": 1, "cannot tell": 2, "agrees": 3}
    return tuple(sorted(found, key=lambda check: rank[check.verdict]))


def go_on(checks: Sequence[Check], accepted: Collection[str] = ()) -> None:
    """Let pass the checks of a flight of which none is contradicted that was not accepted.

    Raises:
        Refused: with what explains the flight, and how to go on all the same.
    """
    against = [check for check in checks if check.verdict == "contradicted" and check.name not in accepted]
    if against:
        names = " ".join(f"--accept-declaration {check.name}" for check in against)
        raise Refused(
            " ".join(check.sentence() for check in against), f"Correct it, or go on all the same with {names}."
        )


def said_first(checks: Sequence[Check]) -> tuple[str, ...]:
    """Sentences about the declarations that the data contradict or make doubtful, to stand before every number."""
    return tuple(check.sentence() for check in checks if check.verdict in ("contradicted", "doubtful"))
