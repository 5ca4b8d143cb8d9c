"""A load that swings below the vehicle is told by its resonance, and a disturbance is no load."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from flights import laboratory

from groundstation.diagnosis.swing import LENGTH_WITHIN, LOAD_WITHIN, Swing, swing_of
from groundstation.identification.preparation import prepare
from groundstation.model.parameters import declared_parameters
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

SEED = 3
LOAD_KG, LENGTH_M = 0.1, 0.9


def _swing(**effects: dict[str, Any]) -> Swing | None:
    """What is said of a short flight, by the mass that its thrusts carry."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 3.0})
    flown = simulate(vehicle, plan, laboratory(**effects), SEED)
    carried = flown.truth.mass_kg + (LOAD_KG if effects else 0.0)
    return swing_of(prepare(flight_data(flown)), replace(declared_parameters(vehicle, lag_s=0.0), mass_kg=carried))


def test_a_swinging_load_is_told_with_its_size_and_its_cable_within_what_is_said():
    found = _swing(slung_load={"mass_kg": LOAD_KG, "length_m": LENGTH_M, "attachment_m": (0.0, 0.0, -0.05)})
    assert found is not None
    assert LOAD_WITHIN[0] * found.load_kg < LOAD_KG < LOAD_WITHIN[1] * found.load_kg, found
    assert LENGTH_WITHIN[0] * found.length_m < LENGTH_M < LENGTH_WITHIN[1] * found.length_m, found
    assert "swings as a load" in found.sentence()


def test_a_disturbance_of_the_laboratory_is_no_load():
    assert _swing() is None
