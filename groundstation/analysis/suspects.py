"""What a flight that is still in the air seems to lack, by the diagnosis of its recording as far as it goes.

    python -P -m groundstation.analysis.suspects FOLDER

answers each line on standard input with a JSON document on standard output: ``{"seconds": 21.3, "suspects": [{"effect":
"rotor drag", "odds": 40.0, "alternatives": []}]}``. It runs at low priority, and what it cannot tell yet it leaves out.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from groundstation.errors import GroundStationError
from groundstation.flightdata import FlightData
from groundstation.priority import set_nice

FEWEST_S = 8.0
"""Of excitation before the first diagnosis: some periods of the slowest effects, and time for a noise model."""
LARGEST_ODDS = 1000.0
"""Beyond it odds are not told apart: noise models of a few seconds do not reach further."""
NICE = 10


class Suspect(TypedDict):
    """One effect."""

    effect: str
    odds: float
    alternatives: list[str]


class Suspicion(TypedDict):
    """After so many seconds of excitation."""

    seconds: float
    suspects: list[Suspect]


def odds(confidence: float) -> float:
    """Of a probability, at most :data:`LARGEST_ODDS`."""
    return min(confidence / max(1.0 - confidence, 1.0 / LARGEST_ODDS), LARGEST_ODDS)


def wrongly_declared(flight: FlightData) -> list[Suspect]:
    """Declarations that the flight contradicts, hover and excitation as far as they go; they come before any effect."""
    from groundstation.identification.declarations import check_declarations

    checks = [check for check in check_declarations(flight) if check.verdict == "contradicted"]
    return [
        {"effect": f"{check.name.replace('_', ' ')} declared wrongly", "odds": LARGEST_ODDS, "alternatives": []}
        for check in checks
    ]


def suspicion(folder: Path) -> Suspicion:
    """Of the recording in a flight's folder, as it is now; without suspects where it is too short or cannot be read
    yet.
    """
    from groundstation.diagnosis import diagnose
    from groundstation.recording import load_flight

    nothing: Suspicion = {"seconds": 0.0, "suspects": []}
    try:
        flight = load_flight(folder)
        if not len(flight.motors):
            return nothing
        wrong = wrongly_declared(replace(flight, window_s=None))
        if flight.window_s is None:  # it hovers still
            return {"seconds": 0.0, "suspects": wrong}
        start, end = flight.window_s[0], min(flight.window_s[1], float(flight.motors.t_s[-1]))
        if end - start < FEWEST_S or wrong:  # behind a wrong declaration every effect is one that is not there
            return {"seconds": max(0.0, end - start), "suspects": wrong}
        found = diagnose([replace(flight, window_s=(start, end))])
    except GroundStationError:
        return nothing
    suspects: list[Suspect] = [
        {
            "effect": f"{f.effect.replace('_', ' ')}{f' {f.rotor}' if f.rotor else ''}",
            "odds": odds(f.confidence),
            "alternatives": [name.replace("_", " ") for name in f.alternatives],
        }
        for f in found.findings
    ]
    return {"seconds": end - start, "suspects": sorted(suspects, key=lambda s: -s["odds"])}


def main() -> int:
    """Entry point of the process."""
    set_nice(NICE)
    folder = Path(sys.argv[1])
    for _ in sys.stdin:
        print(json.dumps(suspicion(folder)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
