"""What explanations beside the findings leave open in mass, tensor and the findings themselves."""

from __future__ import annotations

import sys
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

module = sys.modules[left_open.__module__]
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
    alone = evidence.solve([])
    moved = evidence.solve(pool).theta[: alone.base] - alone.theta
    found = left_open(evidence, [], pool, lambda candidate, columns: CHANCE)
    assert np.allclose(found, np.outer(moved, moved))
    index = [evidence.names.index(name) for name in RIGID_BODY]
    assert (np.diag(found) > np.diag(alone.covariance))[index].any(), (
        "the inflow moves something by more than noise does"
    )


def test_nothing_is_left_open_where_nothing_beats_chance(evidence):
    pool = _entries(evidence, "climb_inflow", "body_drag")
    assert not left_open(evidence, [], pool, lambda candidate, columns: np.inf).any()


def test_the_form_of_a_named_effect_leaves_something_open_however_well_it_fits(evidence):
    chosen = _entries(evidence, "climb_inflow")
    found = left_open(evidence, chosen, [], lambda candidate, columns: np.inf)
    solution = evidence.solve(chosen)
    scale = np.sqrt(np.diag(solution.covariance))
    assert np.linalg.eigvalsh(found / np.outer(scale, scale))[0] > -1e-9
    added = np.sqrt(np.diag(found)) / scale
    assert 0.1 < added[evidence.names.index("mass_kg")] < 10.0, added
    assert (added[solution.base :] > 0.1).any(), "the effect's own size is not sure to what noise allows, either"


def test_a_form_in_its_effects_own_shape_is_the_same_effect_of_another_size(evidence, monkeypatch):
    """As with a drag that goes with a power of a speed which hardly changes: nothing is left open in the size."""
    constant = {"a constant": lambda signals: np.ones(len(signals.t_s))}
    monkeypatch.setattr(module, "QUANTITIES", constant)
    chosen = _entries(evidence, "climb_inflow")
    solution = evidence.solve(chosen)
    forms = list(module._misshapen(evidence, chosen, solution))
    by_constant = [form for form in forms if "a constant" in form.entry[0].identifier]
    assert by_constant
    for form in by_constant:
        moved, _ = module._seen_by(evidence, chosen, solution, [form])
        std = np.sqrt(np.diag(solution.covariance))
        assert np.abs(moved[solution.base :] / std[solution.base :]).max() < 0.05, form.entry[0].identifier


def test_an_effect_that_pushes_in_one_direction_has_forms_of_its_own(evidence):
    """A weak rotor's torque may lose another share than its thrust."""
    candidate = Candidate(library()["weak_rotor"], {"rotor": 1.0})
    columns = evidence.columns(candidate)
    assert columns is not None
    chosen = [(candidate, columns)]
    forms = {
        form.entry[0].identifier: form.entry[1] for form in module._misshapen(evidence, chosen, evidence.solve(chosen))
    }
    assert {"weak_rotor, loss by thrust", "weak_rotor, row 2", "weak_rotor, row 5"} <= set(forms)
    own, twisted = columns.sensitivity[:, 0], forms["weak_rotor, row 5"].sensitivity[:, 0]
    assert abs(own @ twisted) < 0.99 * np.linalg.norm(own) * np.linalg.norm(twisted)


def test_a_form_over_a_speed_is_that_of_the_power_below_without_a_constant(evidence):
    """A lift with v in the place of v^2: short by a constant, it would move the mass."""
    speed = np.linspace(0.6, 3.0, 50)
    over = module._scaled(lambda signals: speed, np.ones(1), over=True)
    wrench = np.repeat(speed[:, None, None] ** 2, 6, axis=1)
    slope, constant = np.polyfit(speed, over(None)(None, wrench)[:, 2, 0], 1)
    assert abs(constant) < 0.05 * slope * float(np.sqrt(np.mean(speed**2)))
