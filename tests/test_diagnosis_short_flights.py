"""A flight of a quarter of a minute is judged by its own noise: nothing slow in it passes for a dependence."""

from __future__ import annotations

from dataclasses import replace

import pytest

from groundstation.diagnosis import diagnose, screen
from groundstation.flightdata import FlightData
from studies.odd import _flown

SEED = 20
"""One on which the first noise shows something: of 1 to 24 this one alone. Which do depends on columns that are kept
out of it.
"""


@pytest.fixture(scope="module")
def flight() -> FlightData:
    """14 s in a laboratory, without any effect."""
    return _flown(SEED)


def test_a_short_clean_flight_is_clean(flight: FlightData, monkeypatch: pytest.MonkeyPatch):
    print("seed", SEED)
    looked: list[int] = []
    shown = screen._shown

    def told(evidence, chosen, among):
        found = shown(evidence, chosen, among)
        looked.append(len(found))
        return found

    monkeypatch.setattr(screen, "_shown", told)
    assert diagnose([replace(flight, name="short")]).verdict == "clean"
    assert looked[0] > 0 and looked[1:] == [0], "against the first noise, which lacks what is slow, one shows"
