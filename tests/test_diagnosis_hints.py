"""A hint beats chance and is no finding; a flight planned for it tells more; a campaign flies it once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from flights import laboratory

from groundstation.analysis.analyse import with_next_flight
from groundstation.analysis.documents import write_json
from groundstation.campaign import campaign as campaigns
from groundstation.campaign import ending
from groundstation.campaign.deciding import GENTLE_M_S2, next_plan
from groundstation.diagnosis import diagnose, next_flight
from groundstation.diagnosis.discrepancy import allowance, allowance_by_band
from groundstation.diagnosis.next_flight import NOTHING, candidate, contenders, odds_sentence, plan_next
from groundstation.diagnosis.results import Diagnosis
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.errors import NotIdentifiable
from groundstation.flightdata import FlightData
from groundstation.paths import find_config
from groundstation.planning.discriminate import separation
from groundstation.planning.limits import envelope, series_excesses
from groundstation.targets import parse_targets
from groundstation.trajectory import load_plan, rigid_motion
from groundstation.tui.documents import suspect_rows
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

SEED = 31


@cache
def diagnosed(lift: float) -> Diagnosis:
    """Of two flights by one plan, whose gain of translational lift is this."""
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), load_plan(find_config("plans", "qball2"))
    room = laboratory(translational_lift={"gain": lift}) if lift else laboratory()
    return diagnose([flight_data(simulate(vehicle, plan, room, SEED + number)) for number in range(2)])


def test_what_beats_chance_and_is_no_finding_is_a_hint_with_its_size():
    found = diagnosed(1.5)
    assert not found.findings
    (hint,) = found.hints
    assert hint.effect == "translational_lift"
    assert hint.values["lift_s2_m2"] > 0.0
    assert "hint of translational lift" in found.next_flight
    assert "beats chance" not in found.reason, "it does"
    assert found.to_dict()["hints"][0]["evidence"] == hint.evidence


def test_what_is_found_and_what_is_not_there_are_no_hints():
    assert not diagnosed(0.0).hints and not diagnosed(0.0).next_flight
    large = diagnosed(6.0)
    assert [finding.effect for finding in large.findings] == ["translational_lift"] and not large.hints


def test_the_flight_for_a_hint_keeps_the_limits_and_shows_it_far_better_than_the_last():
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), load_plan(find_config("plans", "qball2"))
    document = diagnosed(1.5).to_dict()
    (hint, nothing), shared = contenders(document)
    assert nothing.effect == NOTHING and not shared
    found = plan_next(document, vehicle, trials=120)
    assert max(series_excesses(found.plan.series(), envelope(vehicle)).values()) <= 1e-6
    one, other = candidate(hint, vehicle, shared), candidate(nothing, vehicle, shared)
    assert found.log_odds["translational_lift", NOTHING] > 2.0 * separation(one, other, plan.series(), vehicle)[0] > 0.0
    assert "should show translational_lift if it is there" in odds_sentence(found)


def test_the_analysis_writes_the_flight_for_a_hint(tmp_path: Path):
    found, path = with_next_flight(tmp_path, diagnosed(1.5), load_vehicle(find_config("vehicles", "qball2")))
    assert path is not None and load_plan(path).vehicle == "qball2"
    assert "Planned as next_flight.toml: a flight of 40 s that should show translational_lift" in found.next_flight
    assert [row[0] for row in suspect_rows(found.to_dict())] == ["translational lift"]
    assert with_next_flight(tmp_path, diagnosed(0.0), load_vehicle(find_config("vehicles", "qball2")))[1] is None


TURNED: dict[str, Any] = {
    "effect": "imu_misalignment",
    "parameters": {},
    "rotor": None,
    "alternatives": ["mocap_misalignment"],
}
UNTOLD = "imu_misalignment or mocap_misalignment"
HINT: dict[str, Any] = {
    "effect": "translational_lift",
    "settings": {},
    "values": {"lift_s2_m2": 0.006},
    "evidence": 13.0,
    "needed": 21.0,
}


def test_a_campaign_flies_for_a_hint_once_and_not_before_two_flights_or_its_targets(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(next_flight, "HINT_TRIALS", 4)
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    estimates = {"mass_kg": {"value": 1.8, "std": 0.01}}
    document: dict[str, Any] = {"findings": [], "hints": [HINT], "by_flight": [{}, {}]}

    def decided(reached: float, sought: tuple[str, ...] = (), **changes: Any) -> str:
        found = next_plan(
            vehicle, {**document, **changes}, estimates, {"mass_kg": reached}, sought=sought, seed=1, time_budget_s=0.2
        )
        assert ("hint" in found.why) is bool(found.sought)
        return found.sought

    assert decided(0.5) == decided(3.0) == "translational_lift"
    assert decided(0.5, by_flight=[]) == "translational_lift"
    assert not decided(3.0, by_flight=[]) and not decided(0.5, sought=("translational_lift",))
    assert decided(0.5, findings=[TURNED]) == "translational_lift", "no motion tells the two that are open"
    found = next_plan(vehicle, {"findings": [TURNED]}, estimates, {"mass_kg": 3.0}, seed=1, time_budget_s=0.2)
    assert found.untold == UNTOLD and "to sharpen" in found.why


def begun_in(folder: Path, **changes: Any) -> tuple[campaigns.Campaign, campaigns.Round]:
    """A campaign of one round against which nothing stands, and that round."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    (folder / "plan.toml").write_bytes(find_config("plans", "qball2").read_bytes())
    errors = {"velocity_m_s": 0.1}
    done = campaigns.Round(
        str(folder),
        "",
        40.0,
        judged={"after": errors},
        seen=errors,
        verdict="clean",
        estimates={"mass_kg": {"value": 1.8, "std": 0.001}},
        reached={"mass_kg": 0.5},
    )
    done = replace(done, **changes)
    return campaigns.Campaign(folder, vehicle, parse_targets("mass:0.5%"), 5, 1, rounds=(done,)), done


def test_a_campaign_ends_where_no_motion_tells_what_is_left_open(tmp_path: Path):
    begun, done = begun_in(tmp_path, verdict="explained", findings=(TURNED,))
    on = ending.with_round(begun, done)
    assert not on.outcome and on.rounds[-1].not_settled == (f"left open: {UNTOLD}",)
    ended = ending.with_round(on, replace(done, untold=UNTOLD))
    assert ended.outcome == "limit" and f"no flight was found that tells it: {UNTOLD}" in ended.sentence
    unsharp = replace(done, untold=UNTOLD, reached={"mass_kg": 2.0})
    assert not ending.with_round(on, unsharp).outcome, "a target that flights still sharpen"
    other = replace(done, untold="motor_lag or input_delay")
    assert not ending.with_round(on, other).outcome, "something else is left open than was when it was planned"


def test_what_swings_too_far_is_flown_gently_and_estimated_from_gentle_flights_alone(tmp_path: Path):
    begun, done = begun_in(tmp_path, verdict="unexplained")
    begun.save()
    document = {**diagnosed(0.0).to_dict(), "hints": [], "swing": {"load_kg": 0.05, "length_m": 0.5}}
    write_json(tmp_path / "diagnosis-1.json", document)
    decision = campaigns._decision(begun, {})
    assert decision.gently and "gently, for a load swings below" in decision.why
    motion = rigid_motion(decision.plan.series().sample(np.linspace(0.0, 40.0, 2000)))
    assert np.abs(motion.acceleration_world_m_s2).max() <= GENTLE_M_S2 + 1e-6

    class Asked:
        """Keeps which flights are asked for, and estimates none."""

        folders: ClassVar[list[str]] = []

        def flight(self, folder: Path, vehicle: object) -> FlightData:
            self.folders.append(folder.name)
            return flight_data(simulate(begun.vehicle, load_plan(find_config("plans", "qball2")), laboratory(), SEED))

        def states(self, flights: object) -> None:
            raise NotIdentifiable("no", "no")

    again = replace(begun, rounds=(done, replace(done, folder=str(tmp_path / "second"), gently="why")))
    after = campaigns.take_in(again, tmp_path / "third", "", aims={"gently": "why"}, kept=Asked())
    assert sorted(Asked.folders) == ["second", "third"]
    assert campaigns.load_campaign(after.save().folder).rounds[-1].gently == "why"


def test_a_campaign_does_not_end_on_a_hint_that_nothing_was_flown_for(tmp_path: Path):
    begun, done = begun_in(tmp_path)
    on = ending.with_round(begun, replace(done, hints=(HINT,)))
    assert not on.outcome and "translational lift" in on.rounds[-1].not_settled[0]
    assert ending.with_round(on, replace(done, hints=(HINT,), sought="translational_lift")).outcome == "settled"
    assert ending.with_round(begun, done).outcome == "settled"
    kept = campaigns.load_campaign(on.save().folder)
    assert kept.rounds[-1].hints == (HINT,)


def test_a_share_of_a_lag_leaves_nothing_to_a_torque_of_other_frequencies():
    steady, lag = np.array([4.0, 0.0, 0.0]), np.array([0.0, 50.0, 30.0])
    assert allowance_by_band(steady, lag) == 0.0
    alike = allowance_by_band(lag, 100.0 * lag)
    assert alike == pytest.approx(THRESHOLDS.form_error_share**2 * 100.0 * lag.sum())
    assert allowance(np.array([4.0]), np.array([80.0])) > 0.0


def test_a_steady_wrench_stands_beside_a_dead_time_and_a_tether():
    """The dead time's energy in the torques' channels hid it: a share of it was allowed at any frequency."""
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2-commanded")), load_plan(find_config("plans", "qball2"))
    torque = {"force_world_n": [0.0, 0.0, 0.0], "torque_body_nm": [0.006, -0.009, 0.003]}
    room = laboratory(constant_wrench=torque, input_delay={"delay_s": 0.03}, tether={"stiffness_n_m": 0.5})
    found = diagnose([flight_data(simulate(vehicle, plan, room, SEED))])
    assert {finding.effect for finding in found.findings} == {"constant_wrench", "input_delay", "tether"}
