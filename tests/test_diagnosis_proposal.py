"""The sparse formula: dimensionless terms, found on a wall that no file models, and none on a flight with nothing
hidden.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from test_diagnosis_flights import _flight

from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.proposal import dictionary, induced_velocity, select, with_proposals
from groundstation.diagnosis.results import Unexplained
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle

SUSPECTED = (Unexplained("force_x_n", 0.5, ("position_x_m",)),)


@cache
def evidence_of(wall: bool) -> Evidence:
    """Evidence of a flight with or without a wall, straight from the base fit."""
    hidden = {"attracting_wall": {"strength_n_m3": 3.0}} if wall else {}
    prepared = for_evidence(prepare(_flight(**hidden)))
    fitted = fit_dynamics([prepared])
    return Evidence([FlightEvidence(prepared, fitted.best, fitted.options)])


def test_a_wall_is_proposed_as_a_force_along_the_world_that_grows_towards_it():
    evidence = evidence_of(True)
    terms = select(evidence, [], dictionary(SUSPECTED))
    assert terms[0][0].identifier.startswith("force along world x: (x/arm)")
    solution = evidence.solve(terms)
    values = [solution.part(i, 1)[0][0] for i in range(len(terms))]
    vehicle = evidence.flights[0].prepared.record.vehicle
    signals = evidence.flights[0].signals
    force = sum(v * t.effect.wrench(signals, vehicle, {})[:, 0, 0] for (t, _), v in zip(terms, values, strict=True))
    x = signals.position_m[:, 0]
    truth = 3.0 / (np.maximum(1.5 - x, 0.0) + 0.5) ** 3
    assert np.corrcoef(force, truth)[0, 1] > 0.9


def test_on_a_flight_with_nothing_hidden_no_term_stands():
    assert select(evidence_of(False), [], dictionary(SUSPECTED)) == []


def test_the_formula_stands_at_its_channel_with_its_held_out_gain_and_only_where_it_gains():
    items = (*SUSPECTED, Unexplained("torque_z_nm", 0.2, ("yaw_rad",)))
    error = {"before": {"force_x_n": 0.2, "torque_z_nm": 0.01}, "after": {"force_x_n": 0.1, "torque_z_nm": 0.01}}
    told = with_proposals(evidence_of(True), [], items, lambda chosen: error)
    assert "proposal, not a finding: force along world x = weight [" in told[0].proposal
    assert "held out, the error falls from 0.2 to 0.1 N" in told[0].proposal
    assert told[1].proposal == ""


@pytest.mark.parametrize("mass", [1.0, 4.0])
def test_terms_are_dimensionless_a_heavier_vehicle_has_the_same_coefficients(mass):
    """Weight, arm and the induced velocity of hover carry the units: v_h goes with the root of the weight."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    heavier = vehicle.model_copy(update={"mass_kg": mass * vehicle.mass_kg})
    assert induced_velocity(heavier) == pytest.approx(np.sqrt(mass) * induced_velocity(vehicle))


def test_the_dictionary_holds_only_what_was_found_to_matter():
    names = [term.identifier for term in dictionary((Unexplained("torque_y_nm", 0.3, ("rate_x_rad_s",)),))]
    assert all(name.startswith("torque along body y: ") and "omega_x" in name for name in names) and len(names) == 3
