"""A plan on its way to whoever flies it: the script on board, or the pilot here with setpoints. No I/O, no clock."""

from __future__ import annotations

from collections.abc import Callable

from drivers.mavlink.exchange import Conversation, Steps
from groundstation.flight.link.phase import Answered
from groundstation.flight.link.pilot import Pilot
from groundstation.flight.link.upload import Way, send_coefficients
from groundstation.trajectory import Plan


class PlanSending:
    """One plan.

    Args:
        pilot: takes it.
        plan: as checked.
        tell: takes the way it will be flown, as a sentence for the recording.
    """

    def __init__(self, pilot: Pilot, plan: Plan, tell: Callable[[str], None]):
        self._pilot, self._plan, self._tell = pilot, plan, tell
        self._talk: Conversation[None] | None = None
        self._way = Way("setpoints", "")
        self._answer = Answered()

    def begin(self, way: Way, converse: Callable[[Steps[None]], Conversation[None]]) -> Answered:
        """Send it that way; the answer may come later."""
        if way.kind == "onboard" and self._plan.until is not None:
            way = Way("setpoints", "how long it lasts is decided in flight, which the script on board cannot do")
        self._way = way
        if way.kind == "setpoints":
            return self._take(way, onboard=False)
        self._talk = converse(send_coefficients(self._pilot.profile, way.folder, self._plan.series()))
        return self._answer

    def sent(self) -> bool:
        """Whether the coefficients are on board, or were refused; then the answer is there."""
        if self._talk is None:
            return True
        if not self._talk.done:
            return False
        if self._talk.error is None:
            taken = self._take(self._way, onboard=True)
        else:
            why = f"the coefficients were not taken: {self._talk.error}"
            taken = self._take(Way("setpoints", why), onboard=False)
        self._answer.ok, self._answer.reason = taken.ok, taken.reason
        return True

    def _take(self, way: Way, *, onboard: bool) -> Answered:
        """Have the pilot take it; the way is the answer's sentence when it was taken."""
        taken = self._pilot.upload(self._plan, onboard=onboard)
        self._tell(str(way))
        return Answered(True, str(way)) if taken.ok else taken
