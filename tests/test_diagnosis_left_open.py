"""What explanations beside the findings leave open in mass and tensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from flights import laboratory

from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import library
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.left_open import left_open
from groundstation.diagnosis.rivals import Entry
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.model.parameters import RIGID_BODY
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

SEED = 11
CHANCE = 30.0
"""Wald statistic of one parameter that chance does not reach."""


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    """A flight with an inflow that nobody has named yet."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 3.0})
    flown = simulate(vehicle, plan, laboratory(climb_inflow={"gain": 1.0}), SEED)
    prepared = for_evidence(prepare(flight_data(flown)))
    fitted = fit_dynamics([prepared])
    return Evidence([FlightEvidence(prepared, fitted.best, fitted.options)])


def _entries(evidence: Evidence, *names: str) -> Sequence[Entry]:
    candidates = [Candidate(library()[name], {}) for name in names]
    return [(c, columns) for c in candidates if (columns := evidence.columns(c)) is not None]


def test_an_explanation_that_nobody_named_leaves_open_how_far_it_moves_mass_and_tensor(evidence):
    pool = _entries(evidence, "climb_inflow")
    index = [evidence.names.index(name) for name in RIGID_BODY]
    moved = evidence.solve(pool).theta[index] - evidence.solve([]).theta[index]
    found = left_open(evidence, [], pool, lambda candidate, columns: CHANCE)
    assert np.allclose(found, np.outer(moved, moved))
    own = np.diag(evidence.solve([]).covariance)[index]
    assert (np.diag(found) > own).any(), "the inflow moves something by more than noise does"


def test_nothing_is_left_open_where_nothing_beats_chance(evidence):
    pool = _entries(evidence, "climb_inflow", "body_drag")
    assert not left_open(evidence, [], pool, lambda candidate, columns: np.inf).any()


def test_the_form_of_a_named_effect_leaves_something_open_however_well_it_fits(evidence):
    chosen = _entries(evidence, "climb_inflow")
    found = left_open(evidence, chosen, [], lambda candidate, columns: np.inf)
    assert np.linalg.eigvalsh(found)[0] > -1e-12 * np.trace(found)
    index = [evidence.names.index(name) for name in RIGID_BODY]
    added = np.sqrt(np.diag(found) / np.diag(evidence.solve(chosen).covariance)[index])
    assert 0.1 < added[0] < 10.0, added
