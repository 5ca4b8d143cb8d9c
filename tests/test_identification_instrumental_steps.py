"""A step of the instrumental estimate never leaves the flight behind."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import count

import numpy as np

from groundstation.identification import instrumental
from groundstation.identification.dynamic_fit import _models_of, options_for
from groundstation.identification.prediction_error import Fitted, Problem, fit_from_declared
from groundstation.identification.preparation import prepare
from groundstation.model.parameters import FitOptions
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data
from tests.flights import laboratory


@cache
def flown() -> tuple[Problem, Fitted, FitOptions]:
    """A flight by commands, and its prediction error estimate."""
    vehicle = load_vehicle(find_config("vehicles", "qball2-commanded"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 1.0})
    prepared = prepare(flight_data(simulate(vehicle, plan, laboratory(), 5)))
    models, options = tuple(_models_of([prepared])), options_for(prepared)
    start = fit_from_declared(models, prepared.record.vehicle, options)
    return Problem(models, options, start.parameters), start, options


def test_a_step_that_leads_away_is_halved_until_it_does_not() -> None:
    """Begun at dead times of 0.03 and 0.06 s too many, whole steps end 4 and 51 deviations off in mass."""
    problem, start, options = flown()
    plain = instrumental.instrumental(problem.models, start, options)
    own = [plain.names.index(name) for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")]
    for too_late_s in (0.03, 0.06):
        parameters = replace(start.parameters, delay_s=start.parameters.delay_s + too_late_s)
        point = problem.at(parameters)
        late = replace(start, parameters=parameters, values=problem.values(point), residual_rms=point.rms())
        found = instrumental.instrumental(problem.models, late, options)
        away = (found.values - plain.values)[own] / np.sqrt(np.diag(plain.covariance))[own]
        print(f"begun {too_late_s} s late: {away.round(2)} deviations away")
        assert np.all(np.abs(away) < 4.0)


def test_a_step_far_too_long_is_shortened_until_the_residual_stays(monkeypatch):
    """Of two pooled flights that hardly told lag from dead time a dead time of 0.95 s came out, and no moment."""
    problem, start, options = flown()
    models = problem.models
    plain = instrumental.instrumental(models, start, options)
    whole = instrumental._equations

    def too_long(*arguments):
        zx, zz, ze = whole(*arguments)
        return zx, zz, ze + 100.0 * np.sqrt(np.diag(zz))

    monkeypatch.setattr(instrumental, "_equations", too_long)
    found = instrumental.instrumental(models, start, options)
    monkeypatch.setattr(instrumental, "RESIDUAL_GROWTH", np.inf)
    less = count(0.0, -1.0)
    monkeypatch.setattr(instrumental, "_merit", lambda _: next(less))
    wild = instrumental.instrumental(models, start, options)
    own = np.maximum(start.residual_rms, instrumental.RESIDUAL_LEAST)
    growth = [np.max(each.residual_rms / own) for each in (plain, found, wild)]
    print("growth of the residual: plain, shortened, whole steps:", growth)
    assert growth[0] < 2.0, "a flight that tells all is not touched"
    assert growth[1] <= 5.0
    assert growth[2] > 50.0
