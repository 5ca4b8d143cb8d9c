"""What the vehicle is asked to do, step by step, until it *shows* it: an acknowledgement alone is none. No I/O, no
clock.

Each order is a conversation that ends with "" or with the reason of a refusal, the vehicle's own texts included.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.exchange import Ask, Steps
from drivers.samples import Vector3
from groundstation.flight import timeouts
from groundstation.flight.link.profiles import Profile
from groundstation.flight.link.view import VehicleView
from groundstation.flight.station import Policy

_UNDER_WAY = mavlink.MAV_RESULT_IN_PROGRESS


@dataclass(frozen=True, slots=True)
class Orders:
    """The orders of one vehicle.

    Args:
        profile: its autopilot's manners.
        policy: the station's.
        view: what is known of it; read at every step.
    """

    profile: Profile
    policy: Policy
    view: VehicleView

    def arm(self, *, led: bool = False) -> Steps[str]:
        """``led``: setpoints flow already, and it is armed in the mode that follows them."""
        if led:
            yield Ask((), _nothing, timeouts.SETPOINTS_FIRST_S, 1)
        if led or self.profile.climbs_by_command:
            reason = yield from self.mode(self.profile.follow_mode)
            if reason:
                return reason
        reason = yield from self._confirmed(self.profile.arm(), "arming", lambda: self.view.armed is True)
        return reason

    def disarm(self) -> Steps[str]:
        return (yield from self._confirmed(self.profile.disarm(), "disarming", lambda: self.view.armed is False))

    def stand_down(self) -> Steps[str]:
        """Disarm whatever was asked before, and see that it stays so: an order to arm may still be on its way."""
        for _ in range(6):
            yield Ask((self.profile.disarm(),), _nothing, 0.4, 1)
            if self.view.armed is False:
                yield Ask((), _nothing, 0.4, 1)
                if self.view.armed is False:
                    return ""
        return "the vehicle does not disarm"

    def follow(self) -> Steps[str]:
        """Setpoints flow already; wait until there are enough of them, then ask for the mode that follows them."""
        yield Ask((), _nothing, timeouts.SETPOINTS_FIRST_S, 1)
        return (yield from self.mode(self.profile.follow_mode))

    def climb(self, height_m: float) -> Steps[str]:
        """Command a climb, and wait for the height."""
        if self.view.mode != self.profile.follow_mode:
            reason = yield from self.mode(self.profile.follow_mode)
            if reason:
                return reason
        assert self.view.state is not None  # noqa: S101 - `start` was refused without a position
        ground_m = self.view.state.position_m[2]

        def there() -> bool:
            state = self.view.state
            return (
                state is not None
                and abs(state.position_m[2] - ground_m - height_m) < 0.2
                and (distance(state.velocity_m_s, (0.0, 0.0, 0.0)) < self.policy.settled_speed_m_s)
            )

        command = self.profile.take_off(height_m)
        return (yield from self._confirmed(command, "taking off", there, wait_s=timeouts.CLIMB_S))

    def mode(self, mode: str) -> Steps[str]:
        command = self.profile.set_mode(mode)
        return (yield from self._confirmed(command, f"mode {mode}", lambda: self.view.mode == mode))

    def _confirmed(
        self, command: Message, what: str, there: Callable[[], bool], wait_s: float = timeouts.MODE_CHANGED_S
    ) -> Steps[str]:
        """Send a command, take its acknowledgement, and wait until the vehicle shows the effect: an acknowledgement is
        none.
        """
        told = len(self.view.texts)

        def final(m: Message) -> bool:
            return m.get_type() == "COMMAND_ACK" and m.command == command.command and m.result != _UNDER_WAY

        ack = yield Ask((command,), final, 0.5, 4)
        if ack is None and not there():
            return f"{what}: the vehicle did not acknowledge"
        if ack is not None and ack.result != mavlink.MAV_RESULT_ACCEPTED and not there():
            yield Ask((), _nothing, 0.2, 1)  # its reason comes as a text just after
            texts = [t for t in list(self.view.texts)[told:] if not t.startswith(("info", "debug", "notice"))]
            name = mavlink.enums["MAV_RESULT"][ack.result].name.removeprefix("MAV_RESULT_").lower().replace("_", " ")
            return f"{what}: {name}" + (f" ({'; '.join(dict.fromkeys(texts))})" if texts else "")
        waited = 0.0
        while not there():
            if waited > wait_s:
                return f"{what} was acknowledged, but did not happen within {wait_s:g} s"
            yield Ask((), _nothing, 0.05, 1)
            waited += 0.05
        return ""


def distance(a: Vector3, b: Vector3) -> float:
    """Between two points, or of two vectors."""
    return sqrt(sum((p - q) ** 2 for p, q in zip(a, b, strict=True)))


def _nothing(_message: Message) -> bool:
    return False
