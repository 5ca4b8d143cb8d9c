"""Small effects beside larger ones whose formulas may leave as much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flights import laboratory

from groundstation.diagnosis import selection as selected_module
from groundstation.diagnosis.attribution import Selection
from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import library
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.left_open import forms_of
from groundstation.diagnosis.rivals import Entry
from groundstation.diagnosis.selection import Selected
from groundstation.diagnosis.small import margins_beside_forms
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

SEED = 11
NAMES = ("com_offset", "climb_inflow", "translational_lift", "body_drag", "thrust_curve")


@pytest.fixture(scope="module")
def selection() -> Selection:
    """An inflow beside a centre of mass that is 36 mm off."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 3.0})
    hidden = laboratory(com_offset={"offset_m": [0.02, 0.03, 0.0]}, climb_inflow={"gain": 0.3})
    prepared = for_evidence(prepare(flight_data(simulate(vehicle, plan, hidden, SEED))))
    fitted = fit_dynamics([prepared])
    evidence = Evidence([FlightEvidence(prepared, fitted.best, fitted.options)])
    return Selection(evidence, [Candidate(library()[name], {}) for name in NAMES])


def _entry(selection: Selection, name: str) -> Entry:
    return next(entry for entry in selection.pool if entry[0].identifier == name)


def test_an_effect_that_no_form_of_a_larger_one_looks_like_stands(selection):
    large, small = _entry(selection, "com_offset"), _entry(selection, "climb_inflow")
    assert selection._margins_of_each([large], [small])[0] < 0.0, "a tenth of the offset's amplitude is more"
    names = {candidate.identifier for candidate, _ in selection.choose()}
    assert names == {"com_offset", "climb_inflow"}
    assert selection.small.kinds == {("climb_inflow", None)}


def test_an_effect_in_the_shape_of_a_form_does_not_stand(selection):
    """The forms of the inflow, one by one, beside all of them."""
    evidence, chosen = selection.evidence, [_entry(selection, name) for name in ("com_offset", "climb_inflow")]
    solution, forms = evidence.solve(chosen), list[Entry]()
    for first, count, (candidate, _) in ((0, 2, chosen[0]), (2, 1, chosen[1])):
        forms += forms_of(evidence, candidate, solution.part(first, count)[0])
    assert len(forms) > 10
    margins = margins_beside_forms(evidence, chosen, forms, forms, lambda candidate, columns, members: 0.0)
    assert max(margins) < 9.0, "three deviations of one that is estimated twice"


def test_what_is_left_where_an_effect_lives_is_one_of_noise_alone(selection):
    evidence, entry = selection.evidence, _entry(selection, "translational_lift")
    chosen = [_entry(selection, name) for name in ("com_offset", "climb_inflow")]
    rest = evidence.remainder(chosen, evidence.solve(chosen))
    found = evidence.mean_square(rest, entry[1])
    assert 0.5 < found < 1.6
    assert evidence.mean_square(2.0 * rest, entry[1]) == pytest.approx(4.0 * found)
    _, channels, _ = evidence.time_of_rows()
    elsewhere = np.where(channels < 3, 5.0, 1.0) * rest
    assert evidence.mean_square(elsewhere, entry[1]) < 1.5 * found, "a lift is a force"


def test_a_small_effect_is_told_from_what_forms_leave_and_not_from_what_the_large_one_moves(selection, monkeypatch):
    """A lift of 42 deviations was dropped beside rotors' inertia of 1100, a tenth of whose omission is more than it."""
    named, solution = selection.named(selection.choose())
    found = Selected(selection.evidence, [], named, solution, selection)
    huge = 1e6 * np.diag(np.diag(solution.covariance))
    monkeypatch.setattr(selected_module, "form_covariance", lambda evidence, chosen, solution: huge)
    assert {n.candidate.identifier for n in found.established().named} == {"com_offset", "climb_inflow"}
    unlikely = [replace(n, confidence=0.4) for n in named]
    assert not replace(found, named=unlikely).established().named
