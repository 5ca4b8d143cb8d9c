"""What a diagnosis says that it would have found, it finds; what is published stands by the noise that is left."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from flights import laboratory

import groundstation.diagnosis.pipeline as pipeline
from groundstation.diagnosis import diagnose
from groundstation.diagnosis.judging import judge
from groundstation.diagnosis.results import Diagnosis
from groundstation.diagnosis.selection import Final, Selected
from groundstation.flightdata import FlightData
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

SEED = 31
Sized = tuple[str, str, Any]

EFFECTS: tuple[Sized, ...] = (
    ("angular_damping", "damping_z_nms", lambda size: {"damping_nms": [0.0, 0.0, size]}),
    ("thrust_curve", "exponent_error", lambda size: {"exponent": 2.0 + size}),
)


def flown(**effects: dict[str, Any]) -> FlightData:
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 4.0})
    return flight_data(simulate(load_vehicle(find_config("vehicles", "qball2")), plan, laboratory(**effects), SEED))


@cache
def healthy() -> Diagnosis:
    return diagnose([flown()])


@pytest.mark.parametrize(("effect", "parameter", "table"), EFFECTS, ids=[effect for effect, _, _ in EFFECTS])
def test_what_would_have_been_found_is_found_and_four_tenths_of_it_are_not(effect, parameter, table):
    assert healthy().verdict == "clean"
    (told,) = [t for t in healthy().would_show if (t.effect, t.parameter) == (effect, parameter)]
    for share, there in ((1.4, True), (0.4, False)):
        found = diagnose([flown(**{effect: table(share * told.least)})])
        named = {name for finding in found.findings for name in (finding.effect, *finding.alternatives)}
        assert (effect in named) is there, (share, told, named)


def test_what_is_found_is_not_among_what_would_be_and_sizes_are_positive_numbers():
    effect, parameter, table = EFFECTS[0]
    (told,) = [t for t in healthy().would_show if (t.effect, t.parameter) == (effect, parameter)]
    found = diagnose([flown(**{effect: table(3.0 * told.least)})])
    document = found.to_dict()["would_show"]
    assert effect not in {entry["effect"] for entry in document}
    assert len({(entry["effect"], entry["parameter"]) for entry in document}) == len(document) > 10
    assert all(0.0 < entry["least"] < np.inf and 0.0 < entry["share"] < np.inf for entry in document)


def test_intervals_are_those_of_the_noise_that_base_and_findings_leave(monkeypatch):
    seen: list[tuple[Selected, Final]] = []

    def remembered(case, selected, final, *rest):
        seen.append((selected, final))
        return judge(case, selected, final, *rest)

    monkeypatch.setattr(pipeline, "judge", remembered)
    diagnosis = diagnose([flown()])
    ((selected, final),) = seen
    own, guarded = final.evidence.flights[0], selected.evidence.flights[0]
    plain = guarded.beside((), generic=False)
    assert own.whitening.colours == plain.whitening.colours != guarded.whitening.colours
    at = final.evidence.names.index("mass_kg")
    own_std, guarded_std = (float(np.sqrt(each.solution.covariance[at, at])) for each in (final, selected))
    assert diagnosis.parameters_after["mass_kg"].std == pytest.approx(own_std, rel=1e-3)
    assert abs(guarded_std / own_std - 1.0) > 0.01
