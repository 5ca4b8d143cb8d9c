"""A step of the instrumental estimate never leaves the flight behind."""

from __future__ import annotations

import numpy as np

from groundstation.identification import instrumental
from groundstation.identification.dynamic_fit import _models_of, options_for
from groundstation.identification.prediction_error import fit_from_declared
from groundstation.identification.preparation import prepare
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data
from tests.flights import laboratory


def test_a_step_far_too_long_is_shortened_until_the_residual_stays(monkeypatch):
    """Of two pooled flights that hardly told lag from dead time a dead time of 0.95 s came out, and no moment."""
    vehicle = load_vehicle(find_config("vehicles", "qball2-commanded"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 1.0})
    prepared = prepare(flight_data(simulate(vehicle, plan, laboratory(), 5)))
    models, options = _models_of([prepared]), options_for(prepared)
    start = fit_from_declared(models, prepared.record.vehicle, options)
    plain = instrumental.instrumental(models, start, options)
    whole = instrumental._equations

    def too_long(*arguments):
        zx, zz, ze = whole(*arguments)
        return zx, zz, ze + 100.0 * np.sqrt(np.diag(zz))

    monkeypatch.setattr(instrumental, "_equations", too_long)
    found = instrumental.instrumental(models, start, options)
    monkeypatch.setattr(instrumental, "RESIDUAL_GROWTH", np.inf)
    wild = instrumental.instrumental(models, start, options)
    own = np.maximum(start.residual_rms, instrumental.RESIDUAL_LEAST)
    growth = [np.max(each.residual_rms / own) for each in (plain, found, wild)]
    print("growth of the residual: plain, shortened, whole steps:", growth)
    assert growth[0] < 2.0, "a flight that tells all is not touched"
    assert growth[1] <= 5.0
    assert growth[2] > 50.0
