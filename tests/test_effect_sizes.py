"""Sizes of findings against what a scenario hides."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.diagnosis.effect import catalogue
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from studies.effect_sizes import TRUE, deviations
from studies.hidden import sizes

X500 = load_vehicle(find_config("vehicles", "x500"))


def test_every_size_is_one_of_the_effect_and_of_its_scenario():
    """A renamed parameter would drop out of the count without a word."""
    hidden = {name: table(np.random.default_rng(7)) for name, table in sizes(X500).items()}
    for effect, parameters in TRUE.items():
        known = {p.name for p in catalogue()[effect].parameters}
        assert set(parameters) - {"length_m"} <= known, effect
        for truth in parameters.values():
            assert np.isfinite(truth(hidden[effect], X500)), effect


def test_a_size_counts_by_its_own_standard_deviation():
    findings = [
        {"effect": "payload_change", "parameters": {"mass_change_kg": {"value": -0.11, "std": 0.005}}},
        {"effect": "weak_rotor", "parameters": {"loss": {"value": 0.05, "std": 0.01}}},
    ]
    found = deviations(findings, {"payload_change": {"mass_kg": 0.1}}, X500)
    assert found == {"payload_change.mass_change_kg": pytest.approx(-2.0)}
