"""The flight that settles a diagnosis: which hypotheses, what they predict, a plan that flies, and refusals."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from groundstation.analysis.analyse import with_next_flight
from groundstation.cli import main
from groundstation.diagnosis.next_flight import Hypothesis, candidate, contenders, odds_sentence, plan_next
from groundstation.diagnosis.results import Diagnosis, Finding
from groundstation.errors import Refused
from groundstation.identification.results import Estimate
from groundstation.paths import find_config
from groundstation.planning.discriminate import separation
from groundstation.planning.limits import envelope, series_excesses
from groundstation.trajectory import FourierSeries, load_plan, rigid_motion
from groundstation.vehicle import load_vehicle


def document(effect: str, parameters: dict[str, float], *rivals: dict[str, Any], rotor: int | None = None) -> dict:
    values = {name: {"value": value} for name, value in parameters.items()}
    finding = {"effect": effect, "parameters": values, "rotor": rotor, "alternatives": [r["effect"] for r in rivals]}
    return {
        "schema": "groundstation.diagnosis/1",
        "flight": "last",
        "vehicle": "x500",
        "findings": [finding],
        "candidates": [{**r, "rival_of": effect} for r in rivals],
    }


WEAK = {"effect": "weak_rotor", "settings": {"rotor": 2.0}, "values": {"loss": 0.03}}
OPEN = document("com_offset", {"com_offset_x_m": 0.004, "com_offset_y_m": -0.004}, WEAK)


@pytest.fixture(scope="module")
def x500():
    return load_vehicle(find_config("vehicles", "x500"))


def slow_circle(periods: float = 2.0, frequency: float = 0.05) -> FourierSeries:
    a, b = np.zeros((4, 2)), np.zeros((4, 2))
    a[0], a[1], a[2] = (0.05, -0.05), (-0.05, 0.05), (0.03, -0.03)
    return FourierSeries(a, b, np.array([0.0, 0.0, 1.8, 0.0]), 2 * np.pi * frequency, periods)


def test_the_planned_flight_keeps_the_limits_and_tells_far_more_than_a_gentle_one(x500):
    found = plan_next(OPEN, x500)
    assert max(series_excesses(found.plan.series(), envelope(x500)).values()) <= 1e-6
    rivals, shared = contenders(OPEN)
    one, other = (candidate(h, x500, shared) for h in rivals)
    gentle = min(separation(one, other, slow_circle(), x500)[0], separation(other, one, slow_circle(), x500)[0])
    assert found.log_odds["com_offset", "weak_rotor"] > 10.0 * gentle > 0.0
    assert "tell com_offset and weak_rotor apart" in odds_sentence(found)


def test_a_lag_and_a_dead_time_part_with_the_fourth_power_of_frequency(x500):
    """Both are -tau dw/dt to first order; what a dead time's fit leaves of a lag goes with frequency squared, odds with
    its square.
    """
    lag, delay = (candidate(Hypothesis(n, {}, {"shift_s": 0.02}), x500, ()) for n in ("motor_lag", "input_delay"))
    size = {}
    for frequency in (0.05, 0.1):
        series = slow_circle(frequency=frequency)
        t = np.arange(640) * series.duration_s / 640
        motion = rigid_motion(series.sample(t), x500.gravity_m_s2)
        assert lag.wrench is not None and delay.wrench is not None
        rest = lag.wrench(t, motion) - delay.wrench(t, motion)
        torque = np.abs(lag.wrench(t, motion)[:, 3:]).max()
        size[frequency] = np.abs(rest[:, 3:]).max() / torque
    assert size[0.1] / size[0.05] == pytest.approx(
        2.0, rel=0.2
    )  # relative to the lag's own wrench: linear in frequency
    assert size[0.1] < 0.05


def test_what_holds_either_way_is_fitted_anew_under_both(x500):
    both = {**OPEN, "findings": [*OPEN["findings"], _drag()]}
    rivals, shared = contenders(both)
    assert [h.effect for h in rivals] == ["com_offset", "weak_rotor"] and [h.effect for h in shared] == ["rotor_drag"]
    t = np.linspace(0.0, 20.0, 200)
    motion = rigid_motion(slow_circle().sample(t), x500.gravity_m_s2)
    columns = [candidate(rivals[0], x500, part).explanations(t, motion)[0][1] for part in ((), shared)]
    assert columns[1].shape[2] == columns[0].shape[2] + 2


def _drag() -> dict[str, Any]:
    return {
        "effect": "rotor_drag",
        "parameters": {"d_x_kg_s": {"value": 0.3}, "d_y_kg_s": {"value": 0.3}},
        "rotor": None,
        "alternatives": [],
    }


def test_findings_that_stand_alone_need_no_flight():
    with pytest.raises(Refused, match="no two explanations"):
        contenders({**OPEN, "findings": [_drag()]})


def test_frames_that_no_force_shows_are_refused_with_the_manoeuvre():
    turned = {"effect": "imu_misalignment", "parameters": {}, "rotor": None, "alternatives": ["mocap_misalignment"]}
    with pytest.raises(Refused, match="no motion tells them apart") as refusal:
        contenders({"findings": [turned], "next_flight": "tilt by 15 degrees"})
    assert "tilt by 15 degrees" in str(refusal.value)


def test_the_command_writes_a_plan_that_can_be_flown(tmp_path, capfd):
    path, output = tmp_path / "diagnosis.json", tmp_path / "next.toml"
    path.write_text(json.dumps(OPEN))
    arguments = ["plan", "--discriminate", str(path), "--time-budget-s", "0.5", "--output", str(output), "--json"]
    assert main(arguments) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["expected_log_odds"][0]["pair"] == ["com_offset", "weak_rotor"] and answer["criterion"] == "T"
    assert load_plan(output).vehicle == "x500"


@pytest.mark.parametrize("text", ["", "[]", '{"schema": "groundstation.plan/1"}'])
def test_what_is_no_diagnosis_is_status_2_and_one_sentence(tmp_path, text, capfd):
    path = tmp_path / "diagnosis.json"
    path.write_text(text)
    assert main(["plan", "--discriminate", str(path)]) == 2
    told = capfd.readouterr().err.strip()
    assert "diagnose`" in told and "\n" not in told


def test_after_a_diagnosis_that_leaves_two_the_plan_is_written_and_named(tmp_path, x500):
    parameters = {n: Estimate.normal(v["value"], 1e-3) for n, v in OPEN["findings"][0]["parameters"].items()}
    finding = Finding("com_offset", parameters, "beside the origin", 0.6, ("weak_rotor",))
    left_open = Diagnosis("last", "x500", "explained", (finding,), next_flight="Yaw.", candidates=OPEN["candidates"])
    told, path = with_next_flight(tmp_path, left_open, x500)
    assert path == tmp_path / "next_flight.toml" and load_plan(path).criterion == "T"
    assert told.next_flight.startswith("Yaw. Planned as next_flight.toml: a flight of 40 s")
    settled = Diagnosis("last", "x500", "clean")
    assert with_next_flight(tmp_path, settled, x500) == (settled, None)


def test_a_load_beside_what_is_open_stands_with_its_published_numbers():
    """Changes of its settings are in these; a campaign that found such a load ended in a traceback."""
    numbers = {"load_kg": 0.08, "length_m": 0.6, "air_1_s": 0.2, "depth_m": 0.0}
    load = {
        "effect": "slung_load",
        "parameters": {name: {"value": value, "std": 0.01} for name, value in numbers.items()},
        "alternatives": [],
    }
    _, shared = contenders({**OPEN, "findings": [*OPEN["findings"], load]})
    (found,) = [each for each in shared if each.effect == "slung_load"]
    assert found.values is not None
    assert found.values["load_kg"] == 0.08
    assert {v for n, v in found.values.items() if n != "load_kg"} == {0.0}
    assert found.settings["length_m"] == 0.6
