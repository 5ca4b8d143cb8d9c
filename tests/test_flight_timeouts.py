"""Time-outs stand in one table, each with its reason, and those that have to fit each other do."""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path

import pytest

from drivers import bus
from groundstation.flight import timeouts
from groundstation.flight.link.profiles.arducopter import ArduCopter
from groundstation.flight.link.profiles.px4 import Px4

FLIGHT = Path(timeouts.__file__).parent
MEASURES = {"CLOCK_S", "HEARTBEAT_S", "CLOCK_ERROR_S", "GROUND_S", "STRETCH_S", "BROKEN_S", "JUDGED_AFTER_S"} | {
    "RATE_WINDOW_S",
    "LATEST_S",
    "KEPT_S",
    "CARRIED_S",
    "LATE_S",
    "JUMP_S",
}
"""Limits and windows of data, in seconds: they say how something is judged, not how long anyone waits."""


def names() -> dict[str, str]:
    """Each constant of the table with the docstring behind it."""
    body = ast.parse(Path(timeouts.__file__).read_text(encoding="utf-8")).body
    found = {}
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            reason = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
            found[node.targets[0].id] = str(reason)
    return found


def test_every_timeout_has_a_reason_a_unit_and_a_reader():
    code = "\n".join(path.read_text(encoding="utf-8") for path in FLIGHT.rglob("*.py") if path.stem != "timeouts")
    assert len(names()) > 30
    for name, reason in names().items():
        assert name.endswith("_S") and len(reason.split()) > 4, name
        assert f"timeouts.{name}" in code, f"{name} is read by nobody"


def test_no_process_keeps_a_timeout_of_its_own():
    own = re.compile(r"^([A-Z][A-Z_]*(?<!PER)_S) = [0-9]", re.M)
    found = {
        (path.name, name)
        for path in FLIGHT.rglob("*.py")
        if path.stem != "timeouts"
        for name in own.findall(path.read_text(encoding="utf-8"))
    }
    assert {name for _, name in found} <= MEASURES, found


def test_who_is_asked_answers_before_who_asks_gives_up():
    assert inspect.signature(bus.ask).parameters["timeout_s"].default > timeouts.ORDER_ANSWERED_S
    assert timeouts.MODE_CHANGED_S < timeouts.ORDER_ANSWERED_S
    assert timeouts.PARAMETERS_RESTORED_S < timeouts.VEHICLE_LEAVE_S
    assert timeouts.VEHICLE_HEARD_S + timeouts.VEHICLE_READY_S <= timeouts.VEHICLE_START_S


def test_silence_is_longer_than_some_of_what_is_sent_in_it():
    assert timeouts.LINK_SILENT_S > 10.0 * timeouts.STATUS_EVERY_S
    assert timeouts.LINK_SILENT_S < timeouts.VEHICLE_SILENT_S
    assert timeouts.MODE_CHANGED_S > timeouts.HEARTBEAT_EVERY_S
    assert timeouts.SIMULATED_LOOK_S == 2.0 * timeouts.STREAMS_LOOK_S


@pytest.mark.parametrize("profile", [Px4, ArduCopter])
def test_a_turn_of_the_link_is_short_beside_the_failsafe_that_misses_its_setpoints(profile: type):
    assert 0.5 * profile.setpoint_timeout_s > timeouts.LATE_STEP_S + timeouts.CATCH_UP_S
