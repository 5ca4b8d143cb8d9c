"""A worn vehicle: two faults together that look most like a third, and a gentle flight on which they nearly cancel."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.diagnosis import diagnose
from groundstation.recording import load_flight
from studies.worn import ROTOR, fly, is_right

LATER = Path(__file__).parents[2] / "shared" / "data" / "fails" / "worn-later-start.mcap"
SEED, WAIT_S = 1679872251, 1.95


@pytest.mark.skipif(not LATER.is_file(), reason="shared/data is not here")
def test_the_flight_that_began_later_names_the_rotor_that_is_weak():
    flight = load_flight(LATER)
    found = diagnose([flight])
    rotors = [finding for finding in found.findings if finding.rotor is not None]
    assert [(f.effect, f.rotor) for f in rotors] == [("weak_rotor", ROTOR)]
    assert rotors[0].parameters["loss"].value == pytest.approx(0.06, abs=0.003)
    assert flight.truth is not None
    mass = found.parameters_after["mass_kg"]
    assert abs(mass.value - flight.truth.mass_kg) < 4.0 * mass.std
    assert found.verdict == "explained"


def test_a_gentle_flight_names_it_too():
    row = fly("paper_table2", SEED, WAIT_S)
    assert row["effect_first"] == "weak_rotor" and row["rotor_first"] == ROTOR, f"seed {SEED}: {row}"
    assert all(map(is_right, row["findings"]))
