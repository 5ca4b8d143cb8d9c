"""What is published of a lag that nobody declared."""

from __future__ import annotations

import numpy as np
import pytest
from flights import laboratory

from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.timing import NAMES, lag_findings
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

SEED = 5


def evidence_of(**effects: dict[str, float]) -> Evidence:
    """Of one flight whose motors are commanded, about its fit."""
    print("seed", SEED)
    vehicle = load_vehicle(find_config("vehicles", "qball2-commanded"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 1.5})
    flown = for_evidence(prepare(flight_data(simulate(vehicle, plan, laboratory(**effects), SEED))))
    fitted = fit_dynamics([flown])
    return Evidence([FlightEvidence(flown, fitted.best, fitted.options)])


@pytest.mark.parametrize(("widened", "named"), [(1.0, ["motor_lag"]), (1e4, [])])
def test_a_lag_is_named_where_its_published_region_does_not_hold_zero(widened: float, named: list[str]):
    evidence = evidence_of(motor_lag={"hover_s": 0.05})
    solution = evidence.solve([])
    published = solution.covariance.copy()
    index = [evidence.names.index(name) for name in NAMES]
    published[np.ix_(index, index)] *= widened
    assert [finding.effect for finding in lag_findings(evidence, solution, published)] == named


@pytest.mark.parametrize(("widened", "named"), [(1.0, ["input_delay", "motor_lag"]), (9.0, ["input_delay"])])
def test_a_lag_beside_a_dead_time_is_told_by_what_is_published(widened: float, named: list[str]):
    """Of 8 ms beside 20 ms; by ten deviations, or a third of that."""
    evidence = evidence_of(motor_lag={"hover_s": 0.008}, input_delay={"delay_s": 0.02})
    solution, p = evidence.solve([]), evidence.flights[0].parameters
    index = [evidence.names.index(name) for name in NAMES]
    lags = np.array([p.lag_up_s, p.lag_down_s]) + solution.theta[index[:2]]
    published = solution.covariance.copy()
    told = lags.sum() / float(np.sqrt(published[np.ix_(index[:2], index[:2])].sum()))
    published[np.ix_(index, index)] *= widened * (told / 10.0) ** 2
    found = lag_findings(evidence, solution, published)
    assert sorted(finding.effect for finding in found) == named
