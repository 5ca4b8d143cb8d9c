"""The noise that findings are judged against: white behind its model, and not made small by what was fitted to it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2, f

from groundstation.diagnosis.attribution import Selection
from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.effect import library
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.joint import updated_rigid_body
from groundstation.diagnosis.linearisation import linearisation
from groundstation.diagnosis.scale import scale_findings
from groundstation.diagnosis.signals import hat_functions
from groundstation.diagnosis.whitening import bands_of, coefficients
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.identification.results import Estimate
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data

LINES = np.array([0.0, 0.6, 2.0, 6.0, 30.0])
"""Hz, between which the mean power is looked at."""


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    """A flight of the reference scenario in a disturbance of second order, which the noise model's first order is
    not.
    """
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    lab = load_scenario(find_config("scenarios", "lab"))
    air = lab.disturbance.model_copy(update={"order": 2, "correlation_s": 0.5})
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 4.0})
    flown = simulate(vehicle, plan, lab.model_copy(update={"disturbance": air}), 5)
    prepared = for_evidence(prepare(flight_data(flown)))
    fitted = fit_dynamics([prepared])
    return Evidence([FlightEvidence(prepared, fitted.best, fitted.options)])


def test_what_the_base_leaves_is_white_from_the_lowest_frequencies_up(evidence):
    flight = evidence.flights[0]
    rows = evidence.remainder([], evidence.solve([])).reshape(len(flight.channels), -1)
    power = np.abs(np.fft.rfft(rows, axis=1)) ** 2 / rows.shape[1]
    frequency = np.fft.rfftfreq(rows.shape[1], float(np.median(flight.model.dt)))
    for low, high in pairwise(LINES):
        inside = (frequency >= low) & (frequency < high)
        count = 2 * len(flight.channels) * int(inside.sum())
        # 3.3 sigma of the periodogram itself, and a fifth for the estimated spectrum
        assert abs(power[:, inside].mean() - 1.0) < 0.2 + 3.3 * np.sqrt(2.0 / count), (low, high)


def test_hat_functions_are_polygons_through_one_knot_each():
    print("seed", 7)
    random = np.random.default_rng(7)
    knots = np.sort(random.normal(size=6))
    values = np.concatenate([random.normal(size=300), knots, [knots[0] - 1.0, knots[-1] + 1.0, np.nan]])
    polygons = np.stack([np.interp(values, knots, peak) for peak in np.eye(6)], axis=1)
    assert np.array_equal(hat_functions(values, knots), polygons, equal_nan=True)


def test_the_vehicle_as_declared_is_asked_for_no_differences_by_a_lag(evidence):
    flight = evidence.flights[0]
    p = flight.parameters
    assert flight.model.predicted(p, replace(flight.options, lag=True, delay=True)).moved
    assert not flight.model.of_vehicle(flight.prepared.record.vehicle).predicted(p).moved


def test_an_effect_is_averaged_over_a_block_as_the_sensors_are(evidence):
    flight, rate = evidence.flights[0], 2.0 * np.pi * 8.0
    record, model = flight.prepared.record, flight.model
    step = float(np.median(np.diff(record.t_s)))
    shown = np.sin(0.5 * rate * step * record.block) / (record.block * np.sin(0.5 * rate * step))
    assert shown < 0.98, "a frequency that a block dampens"
    wrench = np.zeros((len(record.t_s), 6, 1))
    wrench[:, 2, 0] = wrench[:, 5, 0] = np.sin(rate * record.t_s)
    seen = flight.course.predicted(wrench)[:, :, 0]
    force = shown * np.sin(rate * model.t_s) / flight.parameters.mass_kg
    turned = shown * (np.cos(rate * record.t_s[0]) - np.cos(rate * model.t_s)) / rate
    turned = turned * np.linalg.inv(flight.parameters.tensor)[2, 2]
    for got, expected in ((seen[:, 5], force), (seen[:, 2], turned)):
        assert np.std(got - expected) < 0.005 * np.std(expected)


def test_a_step_to_another_mass_and_tensor_lands_at_once(evidence):
    """What a solution about one rigid body says of another is linear in the inverses."""
    flight = evidence.flights[0]
    p, index = flight.parameters, list(flight.names).index("mass_kg")
    solution = evidence.solve([])
    solution.theta[:] = 0.0
    solution.theta[index] = p.mass_kg**2 * (1.0 / p.mass_kg - 1.0 / (1.4 * p.mass_kg))
    inertia = list(flight.names).index("izz_kg_m2")
    own = p.tensor[2, 2]
    solution.theta[inertia] = own**2 * (1.0 / own - 1.0 / (1.4 * own))
    about = flight.updated_base(evidence.flights[0]._fitted, solution)
    assert about.parameters.mass_kg == pytest.approx(1.4 * p.mass_kg)
    assert about.parameters.tensor[2, 2] == pytest.approx(1.4 * own, rel=0.01)  # products of inertia aside
    solution.theta[index] = 1.1 * p.mass_kg
    assert flight.updated_base(evidence.flights[0]._fitted, solution) is evidence.flights[0]._fitted


def test_the_jacobian_of_such_a_step_is_its_slope():
    about = np.array([1.5, 0.03, 0.001, -0.002, 0.025, 0.0005, 0.04])
    step = 0.2 * about
    found = updated_rigid_body(about, step)
    assert found is not None
    for k in range(7):
        more = updated_rigid_body(about, step + 1e-7 * np.eye(7)[k])
        assert more is not None
        assert (more[0] - found[0]) / 1e-7 == pytest.approx(found[1][:, k], rel=1e-4, abs=1e-5)


def test_instruments_that_went_far_astray_give_way_to_the_prediction_error():
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    vehicle = vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update={"speed_source": "command"})})
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 2.0})
    flown = simulate(vehicle, plan, load_scenario(find_config("scenarios", "lab")), 5)
    fitted = fit_dynamics([for_evidence(prepare(flight_data(flown)))])
    own, refined = fitted.filter_error, fitted.instrumental
    assert refined is not None and linearisation(fitted) is refined
    astray = refined.values.copy()
    astray[refined.names.index("ixx_kg_m2")] *= 0.3
    assert linearisation(replace(fitted, instrumental=replace(refined, values=astray))) is own


def test_a_fit_of_many_columns_takes_noise_and_a_draw_puts_it_back():
    random = np.random.default_rng(3)
    rows, columns, rounds = 400, 80, 60
    x = random.standard_normal((rows, columns)) * np.geomspace(1e-4, 1e3, columns)
    left = {False: 0.0, True: 0.0}
    for _ in range(rounds):
        y = random.standard_normal(rows)
        for drawn in left:
            theta = coefficients(x.T @ x, x.T @ y, random if drawn else None)
            left[drawn] += float(np.mean((y - x @ theta) ** 2)) / rounds
    assert left[False] == pytest.approx(1.0 - columns / rows, abs=0.02)
    assert left[True] == pytest.approx(1.0, abs=0.02)


def test_an_effect_in_one_band_has_to_beat_what_is_known_of_the_noise_there(evidence):
    flight = evidence.flights[0]
    rows, count = len(flight.model.t_s), len(flight.channels)
    time = np.arange(rows)
    band = flight.whitening.bands[2]
    slow, broad = np.zeros((count, rows)), np.zeros((count, rows))
    slow[0] = np.cos(2.0 * np.pi * (band.start + 1) * time / rows)
    broad[:] = np.random.default_rng(1).standard_normal((count, rows))
    known = 2.0 * (band.stop - band.start)
    found = [evidence.threshold(_columns(part), 1e-5) for part in (slow, broad)]
    assert found[0] == pytest.approx(f.isf(1e-5, 1, known), rel=1e-3)
    assert chi2.isf(1e-5, 1) < found[1] < 1.05 * chi2.isf(1e-5, 1)


def _columns(rows: np.ndarray) -> Columns:
    column = rows.reshape(-1, 1)
    return Columns.of(column, column, np.zeros((6, 1)))


@pytest.mark.parametrize("count", [3, 17, 500, 2001])
def test_bands_cover_every_frequency_once(count):
    bands = bands_of(count)
    assert [i for band in bands for i in range(band.start, band.stop)] == list(range(count))


def test_only_a_weighed_mass_tells_another_thrust_constant():
    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "qball2")))
    vehicle = vehicle_from_dict(document)
    declared = vehicle.rotors.thrust_coefficient_n_s2
    assert declared is not None
    found = {"thrust_coefficient_n_s2": Estimate.normal(1.06 * declared, 0.004 * declared)}
    (finding,) = scale_findings(vehicle, found)
    assert finding.effect == "thrust_scale"
    assert finding.parameters["thrust_scale"].value == pytest.approx(1.06)
    unsure = vehicle.model_copy(
        update={"identification": vehicle.identification.model_copy(update={"thrust_coefficient_std": 0.05})}
    )
    assert scale_findings(unsure, found) == []  # the declaration itself is not surer than that
    assert scale_findings(vehicle, {"mass_kg": Estimate.normal(2.0, 0.001)}) == []


def test_what_was_refuted_alone_is_asked_again_beside_others(monkeypatch):
    """A damping beside rotors' inertia makes a prediction worse alone, and better beside it."""
    one, other = [
        (Candidate(effect, {}), Columns.of(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(6)))
        for effect in list(library().values())[:2]
    ]
    selection = object.__new__(Selection)

    def best(chosen, refuted):
        return next((e for e in (one, other) if e not in chosen and e[0].identifier not in refuted), None)

    monkeypatch.setattr(selection, "_best_of_all", best)
    monkeypatch.setattr(selection, "_refined", lambda chosen, index: chosen)
    monkeypatch.setattr(selection, "_improves_held_out", lambda chosen, entry: entry is other or other in chosen)
    for same in ("_contested", "_pruned"):
        monkeypatch.setattr(selection, same, list)
    assert selection._selected([]) == [other, one]


def test_two_candidates_that_drive_each_other_out_do_not_take_turns_for_ever(monkeypatch):
    """On measured flights without a plan this kept the diagnosis busy without end."""
    entries = [
        (Candidate(effect, {}), Columns.of(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(6)))
        for effect in list(library().values())[:3]
    ]
    start, one, other = entries
    selection = object.__new__(Selection)
    monkeypatch.setattr(selection, "_best_addition", lambda chosen: other if chosen[-1] is one else one)
    monkeypatch.setattr(selection, "_pruned", lambda chosen: [start, chosen[-1]])
    assert len(selection._grown(start)) == 2
