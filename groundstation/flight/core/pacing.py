"""How far a lock-stepped vehicle may run: to fixed instants on the ground, ahead of the recorder in the air. No I/O.

What is asked of a simulated vehicle takes effect at the simulated instant at which it stands. On the ground, time
therefore stands still wherever an order may come: at 0 until the plan is uploaded, and at the end of the look at its
streams until somebody starts the flight. However long that takes on the wall's clock, the same orders meet the same
vehicle, and one seed gives one flight, to the last bit.
"""

from __future__ import annotations

from drivers.bus import DroneStatus
from drivers.samples import Batch, Event
from groundstation.flight import timeouts
from groundstation.flight.sequence import IN_FLIGHT, Phase

_ROUNDING_S = 1e-6
_AT_REST = ("landed", "crashed")


class Pace:
    """Simulated time as the core grants it.

    Args:
        lock_step: whether the vehicle waits for credit; one at the wall's pace only hears that the core lives.
    """

    def __init__(self, *, lock_step: bool):
        self.lock_step = lock_step
        self._hold_s = 0.0
        self._down = False
        self._received_s = 0.0
        self._early: list[DroneStatus] = []

    def credit_s(self, phase: Phase, digested_s: float) -> float:
        """How far the vehicle may run now, given what is written."""
        if not self.lock_step or phase in IN_FLIGHT:
            return digested_s + timeouts.SIMULATED_AHEAD_S
        return max(self._hold_s, digested_s)

    def look(self) -> None:
        """Grant the time that the checks need, or some more."""
        self._hold_s += timeouts.SIMULATED_LOOK_AGAIN_S if self._hold_s else timeouts.SIMULATED_LOOK_S

    def stands(self, digested_s: float) -> bool:
        """Whether everything up to the instant at which the vehicle waits is written."""
        return not self.lock_step or digested_s >= self._hold_s - _ROUNDING_S

    def owes(self, phase: Phase, digested_s: float) -> bool:
        """Whether something is to be heard of the vehicle: one that waits for time says nothing."""
        return phase in IN_FLIGHT or not self.stands(digested_s)

    def recorded(self, batch: Batch) -> bool:
        """Whether a batch belongs to the flight: in lock-step, up to the one in which the vehicle came to rest."""
        if not self.lock_step:
            return True
        self._received_s = max(self._received_s, batch.until_s)
        if self._down:
            return False
        events = [sample for sample in batch.samples if isinstance(sample, Event) and sample.kind == "phase"]
        self._down = any(event.text.partition(":")[0] in _AT_REST for event in events)
        return True

    def heard(self, status: DroneStatus) -> None:
        """The vehicle said how it is: on the bus, a word may overtake the samples that came before it."""
        self._early.append(status)

    def due(self) -> list[DroneStatus]:
        """What it said up to the samples that are here, in order; each is given once."""
        now = [s for s in self._early if not self.lock_step or s.host_s <= self._received_s + _ROUNDING_S]
        self._early = self._early[len(now) :]
        return now
