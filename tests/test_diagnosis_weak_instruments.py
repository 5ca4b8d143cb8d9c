"""Where the plan is a weak instrument the joint estimate stays finite, its intervals hold, and strong ones do not
change.
"""

from __future__ import annotations

import numpy as np
import pytest
from flights import laboratory

from groundstation.diagnosis.attribution import Selection
from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.columns import Columns
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.joint import Products, estimated, strengths
from groundstation.diagnosis.linearisation import linearisation
from groundstation.diagnosis.pool import candidates
from groundstation.diagnosis.products import Table
from groundstation.diagnosis.weakness import weak_instruments
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

ROWS = 2000


def products(x: np.ndarray, z: np.ndarray, y: np.ndarray) -> Products:
    return Products(z.T @ x, z.T @ z, x.T @ x, z.T @ y, x.T @ y, len(y))


def drawn(random: np.random.Generator, weight: float, feedback: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two regressors that answer the noise, of unit size; the instrument of the second has a given weight in it.

    Args:
        feedback: correlation of regressors and noise.
    """
    z, e = random.standard_normal((ROWS, 2)), random.standard_normal(ROWS)
    own = np.sqrt(1.0 - feedback**2) * random.standard_normal((ROWS, 2)) + feedback * e[:, None]
    shares = np.array([0.8, weight])
    return z * shares + np.sqrt(1.0 - shares**2) * own, z, e


def test_strong_instruments_give_the_plain_estimate():
    seed = 11
    print("seed", seed)
    x, z, e = drawn(np.random.default_rng(seed), 0.5, 0.7)
    found = products(x, z, e)
    theta, covariance = estimated(found)
    inverse = np.linalg.inv(found.zx)
    std = np.sqrt(np.diag(inverse @ found.zz @ inverse.T))
    assert np.all(strengths(found) > 400.0)
    assert np.all(np.abs(theta - inverse @ found.zy) < 0.05 * std)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(std, rel=5e-3)


@pytest.mark.parametrize("weight", [0.0, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("feedback", [0.0, 0.5, 0.95])
def test_a_weak_instrument_leaves_a_finite_estimate_whose_interval_holds(weight, feedback):
    """F from nothing to twenty, up to nearly as much feedback as can be. Where chance alone ties the instrument to the
    motion, its tie to the noise comes along: nine in ten hold there, and none is far off.
    """
    seed, rounds = 3, 400
    print("seed", seed)
    random = np.random.default_rng(seed)
    scores = np.empty((rounds, 2))
    for index in range(rounds):
        theta, covariance = estimated(products(*drawn(random, weight, feedback)))
        scores[index] = theta / np.sqrt(np.diag(covariance))
    assert np.all(np.mean(np.abs(scores) < 1.96, axis=0) > (0.91 if feedback < 0.9 else 0.86)), "less 4 deviations"
    assert np.all(np.abs(scores) < 6.0), "no flight in 400 names an effect that is not there (5.3 deviations)"


def test_what_a_model_lacks_does_not_run_away_with_a_weak_direction():
    """A large effect that nobody has named yet stands in the residual, as damping does before it is found."""
    seed = 5
    print("seed", seed)
    x, z, e = drawn(np.random.default_rng(seed), 0.003, 0.0)
    lacking = 30.0 * (x[:, 1] + np.random.default_rng(seed + 1).standard_normal(ROWS))
    found = products(x, z, e + lacking)
    plain, (theta, _) = np.linalg.solve(found.zx, found.zy), estimated(found)
    rms = [float(np.sqrt(np.mean((e + lacking - x @ each) ** 2))) for each in (np.zeros(2), plain, theta)]
    print("residual without, plain, Fuller", rms, "F", strengths(found))
    assert rms[1] > 2.0 * rms[0], "the plain estimate makes the residual larger than it was"
    assert rms[2] < rms[0]


def test_a_prior_is_rows_of_its_own_and_what_no_row_is_of_stays():
    seed = 7
    print("seed", seed)
    x, z, e = drawn(np.random.default_rng(seed), 0.5, 0.3)
    x[:, 1] = z[:, 1] = 0.0
    theta, covariance = estimated(products(x, z, e).with_prior(np.diag([0.0, 25.0])))
    assert theta[1] == 0.0
    assert np.sqrt(covariance[1, 1]) == pytest.approx(0.2)


def test_instruments_that_are_the_regressors_are_least_squares():
    seed = 9
    print("seed", seed)
    x, _, e = drawn(np.random.default_rng(seed), 0.5, 0.9)
    found = products(x, x, e)
    theta, covariance = estimated(found)
    assert theta == pytest.approx(np.linalg.lstsq(x, e, rcond=None)[0])
    assert covariance == pytest.approx(np.linalg.inv(x.T @ x))
    assert np.all(strengths(found) > 1e9)


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    """A calm flight by commands, with drag and damping hidden, whose plan shows next to nothing of how it rolled.

    The instrument of the roll inertia is the same motion run backwards, but for a correlation of 0.003 with what the
    vehicle did, as by chance in PX4's log.
    """
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    vehicle = vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update={"speed_source": "command"})})
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 2.0})
    lab = laboratory(rotor_drag={"drag_kg_s": (0.4, 0.4)}, angular_damping={"damping_nms": (0.05, 0.05, 0.05)})
    air = lab.disturbance.model_copy(update={"force_share": 1e-4, "torque_share": 1e-4})
    prepared = prepare(flight_data(simulate(vehicle, plan, lab.model_copy(update={"disturbance": air}), 7)))
    fitted = fit_dynamics([prepared])
    found = Evidence([FlightEvidence(for_evidence(prepared), linearisation(fitted), fitted.options)])
    root, roll = np.sqrt(found.weight)[:, None], found.names.index("ixx_kg_m2")
    others = root * np.concatenate([found.x, np.delete(found.z, roll, axis=1)], axis=1)
    backwards, own = (root * found.z[:, [roll]])[::-1], root * found.x[:, [roll]]
    basis = np.linalg.qr(others[:, others.any(axis=0)])[0]
    backwards = backwards - basis @ (basis.T @ backwards)
    weak = backwards / np.linalg.norm(backwards) + 0.003 * own / np.linalg.norm(own)
    found.z = found.z.copy()
    found.z[:, [roll]] = weak * np.linalg.norm(own) / root
    found.base = Columns.of(found.x, found.z, np.zeros(6))
    found.table = Table(found.base, found.output, found.weight, found.time_of_rows()[1])
    return found


def test_damping_and_drag_are_found_where_the_plan_is_weak(evidence):
    vehicle = evidence.flights[0].prepared.record.vehicle
    selection = Selection(evidence, candidates(vehicle, evidence.flights[0].excited))
    chosen = selection.choose()
    print(evidence.solve([]).theta, selection.lag)
    assert {candidate.identifier for candidate, _ in chosen} == {"angular_damping", "rotor_drag"}
    solution, first = evidence.solve(chosen), 0
    for candidate, _ in chosen:
        count = len(candidate.effect.parameters)
        values, covariance = solution.part(first, count)
        first += count
        truth = {"angular_damping": 0.05, "rotor_drag": 0.4}[candidate.identifier]
        print(candidate.identifier, values, np.sqrt(np.diag(covariance)))
        assert np.all(np.abs(values - truth) < 0.1 * truth + 3.0 * np.sqrt(np.diag(covariance)))


def test_a_note_says_what_the_plan_hardly_shows(evidence):
    (note,) = weak_instruments(evidence, [])
    print(note)
    assert "Ixx (F = " in note and "F = 10 is asked for" in note
