"""What a flight that is still in the air seems to lack: odds, silence where it is too early, and a process that nothing
waits for.
"""

from __future__ import annotations

import threading

import pytest

from groundstation.analysis.suspects import LARGEST_ODDS, odds, suspicion
from groundstation.flight.core.suspects import LiveSuspects, Suspicion
from groundstation.flight.messages import CoreStatus, SuspectStatus
from groundstation.paths import find_config
from groundstation.recording import write_mcap
from groundstation.trajectory import load_plan
from groundstation.tui.documents import until_lines
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data
from tests.flights import laboratory


@pytest.mark.parametrize(("confidence", "expected"), [(0.5, 1.0), (0.975, 39.0), (1.0, LARGEST_ODDS)])
def test_odds_are_those_of_the_confidence(confidence, expected):
    assert odds(confidence) == pytest.approx(expected)


def test_without_a_recording_nothing_is_suspected(tmp_path):
    assert suspicion(tmp_path) == {"seconds": 0.0, "suspects": []}
    (tmp_path / "flight.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert suspicion(tmp_path) == {"seconds": 0.0, "suspects": []}


@pytest.mark.slow
def test_drag_is_suspected_from_half_a_recording(tmp_path):
    """The recording is cut off in the air, as it is on the disk while the vehicle flies."""
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), load_plan(find_config("plans", "qball2"))
    scenario = laboratory(rotor_drag={"drag_kg_s": [0.4, 0.35]})
    short = plan.model_copy(update={"periods": 4.0})
    write_mcap(flight_data(simulate(vehicle, short, scenario, 5)), tmp_path / "whole.mcap")
    content = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "flight.mcap").write_bytes(content[: int(0.7 * len(content))])
    found = suspicion(tmp_path)
    assert found["seconds"] < 19.5
    assert found["seconds"] > 8.0
    assert found["suspects"][0]["effect"] == "rotor drag"
    assert found["suspects"][0]["odds"] > 20.0


@pytest.mark.slow
def test_the_process_answers_and_is_not_asked_again_before_its_time(tmp_path):
    heard: list[Suspicion] = []
    answered = threading.Event()

    def on_found(found: Suspicion) -> None:
        heard.append(found)
        answered.set()

    suspects = LiveSuspects(tmp_path, on_found)
    try:
        suspects.ask(100.0)
        assert answered.wait(60.0)
        suspects.ask(101.0)
        assert heard == [Suspicion(0.0)]
    finally:
        suspects.stop()


def test_the_screen_says_what_is_likely_and_what_it_may_be_instead():
    status = CoreStatus("f", "f", "v", suspects=(SuspectStatus("rotor drag", 40.0, ("body drag",)),), suspects_s=21.4)
    assert until_lines(status) == "suspected after 21 s: rotor drag likely, 40:1 (or body drag)"
