"""The process that stands for the vehicle, as the core watches it: a link that ends or hangs in flight gets a
successor, which lands.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.access import Login, hand_over
from groundstation.errors import BadInput, Refused
from groundstation.flight import sequence as seq
from groundstation.flight import timeouts
from groundstation.flight.children import Child, module_command, start_child
from groundstation.flight.core.settings import Settings

DRONE = "vehicle"
"""Its name on the bus."""
LINK_MODULE = "groundstation.flight.link.process"
SUCCESSORS = 3
"""Links started in the place of one that ended in flight, before the vehicle is left to its own failsafe."""


class VehicleProcess:
    """Started, watched, replaced. Used on the core's main thread.

    Args:
        settings: of the flight.
        clock: monotonic seconds.

    Attributes:
        heard_s: when something was heard from it last.
    """

    def __init__(self, settings: Settings, clock: Callable[[], float]) -> None:
        self._settings, self._clock = settings, clock
        self._child: Child | None = None
        self._successors = 0
        self.heard_s = clock()

    def start(self, take_over: str = "") -> None:
        """Start it; ``take_over`` is what it does with a vehicle in flight."""
        more = ("--take-over", take_over) if take_over else ()
        self._child = start_child(
            module_command(*self._settings.drone, *more, "--drone", DRONE, "--connect", self._settings.listen[0]),
            self._settings.folder / "vehicle.log",
            environment=hand_over(Login("drone", self._settings.secrets["drone"])),
        )

    def heard(self) -> None:
        """It said something."""
        self.heard_s = self._clock()

    def can_be_replaced(self, state: seq.Sequence) -> bool:
        """Whether another link may be started in the place of one that ended or hangs."""
        linked = self._settings.drone[0] == LINK_MODULE
        return linked and state.started and not state.final and self._successors < SUCCESSORS

    def replace(self) -> None:
        """Start another, which lands the vehicle; one that hangs holds the port, so it is ended first."""
        if self._child is not None:
            self._child.kill()
            self._child.wait()
        self._successors += 1
        self.heard()
        self.start("land")

    def ended(self) -> tuple[str, str] | None:
        """How it ended, and why it refused where it did; None while it runs."""
        status = None if self._child is None else self._child.poll()
        if self._child is None or status is None:
            return None
        detail = self._child.last_words()
        text = f"the vehicle's process ended with status {status}" + (f": {detail}" if detail else "")
        return text, detail if status in (BadInput.exit_status, Refused.exit_status) else ""

    def silent(self, state: seq.Sequence, *, described: bool, seen: bool) -> str:
        """What to say of it once nothing was heard for too long; empty before that.

        Args:
            state: of the flight.
            described: it has said what it is.
            seen: a status of the one that runs now was seen.
        """
        patience = timeouts.LINK_SILENT_S if self.can_be_replaced(state) else timeouts.VEHICLE_SILENT_S
        if not described or (self._successors and not seen):
            patience = timeouts.VEHICLE_START_S  # it was just started
        if self._clock() - self.heard_s <= patience:
            return ""
        return f"nothing was heard from the vehicle's process for {patience:g} s"

    def leave(self) -> int | None:
        """Wait for its end; its process id where it goes on by itself, to bring its vehicle down or restore parameters.

        Never killed.
        """
        if self._child is None or self._child.leave(timeouts.VEHICLE_LEAVE_S):
            return None
        return self._child.pid
