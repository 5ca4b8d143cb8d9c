"""The preflight as text: each item with what was seen, how to mend it, and why it is looked at."""

from __future__ import annotations

from collections.abc import Mapping

from groundstation.flight.messages import CheckStatus, CoreStatus
from groundstation.flight.sequence import Phase

WHY: Mapping[str, str] = {
    "imu": "rates and accelerations are what is identified from",
    "motors": "the forces come from what the rotors do",
    "voltage": "an empty battery ends a flight in the air",
    "link": "no order reaches the vehicle without it",
    "streams": "what does not arrive cannot be identified from",
    "arming": "the autopilot itself would refuse",
    "disarmed": "a vehicle in somebody's hands is not to be taken over",
    "estimate": "without a position it cannot follow a path",
    "clock": "stamps that wander look like a lag of the rotors",
    "battery": "it must last for the plan and a reserve",
    "log": "the log on board has the motion at rates that no link carries",
    "disk": "a recording that stops is half a flight",
    "poses": "motion capture is what holds the position",
    "frames": "poses in another frame than the estimate fly it into the wall",
    "marker": "a marker body that moved makes every force seem to act elsewhere",
    "plan": "a plan beyond the vehicle's means is not flown, only begun",
    "room": "the path has to lie inside the box of the station file",
    "vibration": "it drowns accelerations, and it upsets the estimator",
    "oscillation": "a loop that is tuned too hot shakes itself apart",
}
A_SETTING = "a setting of the autopilot that the flight relies on"
_STEPS = (
    (Phase.IDLE, "the vehicle's process is up"),
    (Phase.PLANNED, "the plan is uploaded"),
    (Phase.UPLOADED, "everything below is checked"),
    (Phase.CHECKED, "started (s)"),
)


def checklist(status: CoreStatus) -> str:
    """The steps before a flight, why it ended where it did, and each check."""
    order = list(Phase)
    ended = status.phase == Phase.ABORTED
    here = len(order) if ended else order.index(Phase(status.phase))
    lines = []
    for phase, text in _STEPS:
        at = order.index(phase)
        word = "?" if ended else "ok" if at < here else "…" if at == here else ""
        lines.append(f"[{word:^4}] {text}")
    if status.reason:
        lines += ["", f"{'! ' if ended else ''}{status.reason}"]
    if status.checks:
        lines += ["", *map(check_line, sorted(status.checks, key=lambda check: check.ok))]
    return "\n".join(lines)


def check_line(check: CheckStatus) -> str:
    """One item; what failed comes with its reason."""
    why = WHY.get(check.name, A_SETTING)
    return f"[{'ok' if check.ok else 'FAIL':^4}] {check.name}: {check.text} (why: {why})"
