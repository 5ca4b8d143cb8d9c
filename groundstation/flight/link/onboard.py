"""The excitation as the vehicle's own script flies it: told where, started, watched by its reports. No I/O, no clock.

The script (``profiles/excitation.lua``) is ordered by five parameters and reports in a named float. While it flies, no
setpoint leaves the link; a change of mode ends it on board, so landing, hold and a pilot's switch need no further word.
"""

from __future__ import annotations

from math import isfinite
from typing import Literal

from drivers.mavlink.dialect import Message
from drivers.mavlink.exchange import Steps, listen
from drivers.mavlink.geometry import flip
from drivers.mavlink.parameters import Parameters
from groundstation.flight import timeouts
from groundstation.flight.link.placement import Placement
from groundstation.flight.link.profiles import Profile

REPORT = "GSPATH"
ORDER, PLACE = "SCR_USER1", ("SCR_USER2", "SCR_USER3", "SCR_USER4", "SCR_USER5")
_IDLE, _COMPLETE = -1.0, -2.0


class OnboardExcitation:
    """One excitation flown by the script.

    Args:
        profile: of the autopilot.

    Attributes:
        ended_s: when it was first heard that the excitation ended before its end; None while it did not.
    """

    def __init__(self, profile: Profile):
        self._parameters = Parameters(profile.system, profile.component, bytewise=profile.bytewise_parameters)
        self._value = _IDLE
        self._heard_s: float | None = None
        self.ended_s: float | None = None

    def hear(self, now_s: float, messages: list[Message]) -> None:
        """Take note of reports."""
        for m in messages:
            if is_report(m) and isfinite(m.value):
                self._value, self._heard_s = m.value, now_s
                if m.value >= _COMPLETE:
                    self.ended_s = None
                elif self.ended_s is None:
                    self.ended_s = now_s

    def place(self, placement: Placement) -> Steps[str]:
        """Withdraw any order that stands there, and tell where the plan's origin lies; "" or the reason it failed."""
        place = (*flip(placement.origin_m), -placement.yaw_rad)
        for name, value in ((ORDER, 0.0), *zip(PLACE, place, strict=True)):
            if not (yield from self._parameters.write(name, value)):
                return f"the vehicle did not take {name}, which its script needs"
        return ""

    def start(self) -> Steps[str]:
        """Order the excitation, and wait until it is reported; "" or the reason it did not begin."""
        if not (yield from self._parameters.write(ORDER, 1.0)):
            return f"the vehicle did not take {ORDER}, which starts its script"
        answer = yield listen(lambda m: is_report(m) and m.value != _IDLE, timeouts.SCRIPT_SILENT_S)
        if answer is None:
            return f"the script on board was not heard to start within {timeouts.SCRIPT_SILENT_S:g} s"
        return "the script on board would not start; its text says why" if answer.value < _COMPLETE else ""

    def progress_s(self, now_s: float) -> float:
        """Seconds flown by now: the last report, and the time since."""
        return 0.0 if self._heard_s is None else max(0.0, self._value) + now_s - self._heard_s

    def state(self, now_s: float) -> Literal["flying", "complete", "ended", "silent"]:
        """What the reports say."""
        if self._heard_s is None or now_s - self._heard_s > timeouts.SCRIPT_SILENT_S:
            return "silent"
        if self._value >= 0.0:
            return "flying"
        return "complete" if self._value == _COMPLETE else "ended"


def is_report(m: Message) -> bool:
    """Whether a message is a report of our script."""
    return m.get_type() == "NAMED_VALUE_FLOAT" and m.name == REPORT
