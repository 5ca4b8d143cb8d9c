"""Faults of the vehicle, for rehearsals that should end safe anyway."""

from __future__ import annotations

from collections.abc import Callable

from groundstation.errors import BadInput
from sim.mavlink.autopilot import Autopilot

JUMP_M = (0.5, 0.0, 0.0)
LOW_PERCENT = 6


def _deny_arming(a: Autopilot) -> None:
    a.deny_arming = "Compass inconsistent"


def _silent(a: Autopilot) -> None:
    a.silent = True


def _battery_low(a: Autopilot) -> None:
    a.battery.stuck_percent = LOW_PERCENT


FAULTS: dict[str, Callable[[Autopilot], None]] = {
    "deny-arming": _deny_arming,
    "pilot": lambda a: a.pilot_takes_over(),
    "reboot": lambda a: a.reboot(),
    "estimator-reset": lambda a: a.estimator.jump(JUMP_M),
    "silent": _silent,
    "battery-low": _battery_low,
}
"""What each fault does to the vehicle."""


def parse_fault(text: str) -> tuple[float, str]:
    """(seconds, name) of ``NAME@SECONDS``.

    Raises:
        BadInput: unknown name, or no time.
    """
    name, _, seconds = text.partition("@")
    if name not in FAULTS:
        raise BadInput(f"--fault {text}: there is no fault '{name}'; there are {', '.join(FAULTS)}.")
    try:
        return float(seconds), name
    except ValueError:
        raise BadInput(f"--fault {text}: write {name}@SECONDS, for example {name}@20.") from None


class FaultSchedule:
    """Faults in order of time, each applied once."""

    def __init__(self, faults: list[tuple[float, str]]):
        self._left = sorted(faults, reverse=True)

    def apply(self, a: Autopilot, now_s: float) -> None:
        """Whatever is due by now."""
        while self._left and self._left[-1][0] <= now_s:
            FAULTS[self._left.pop()[1]](a)
