"""What a flight asks of the vehicle beforehand, and gives back afterwards: messages, parameters, our script.

No I/O, no clock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf

from drivers.mavlink.dialect import Message, mavlink, message_id
from drivers.mavlink.exchange import Ask, Steps
from drivers.mavlink.parameters import Parameters
from groundstation.flight import timeouts
from groundstation.flight.link.fusion import not_fused
from groundstation.flight.link.rates import cost_of_line, fit_rates
from groundstation.flight.link.upload import Way, choose_way
from groundstation.flight.link.view import VehicleView
from groundstation.flight.station import Station

SELDOM = 0.75
"""Share of the rate asked for under which a request is taken for lost; a line may lose a tenth."""
AMPLE = 1.5
"""What comes so many times as often as needed is left alone."""
ROUNDS = 3
ORIGIN_TRIES = 20
"""Once a second: ArduPilot takes no origin before its filter has started, some ten seconds after a restart."""
_KEPT = frozenset(
    {"HEARTBEAT", "SYS_STATUS", "STATUSTEXT", "COMMAND_ACK", "COMMAND_LONG", "TIMESYNC", "AUTOPILOT_VERSION",
     "PARAM_VALUE", "POSE"}
)  # fmt: skip
"""Never switched off on a slow line, where what nobody asked for is."""


class Preparation:
    """Of one vehicle.

    Args:
        view: what is known of it.
        station: whether poses come from motion capture decides which parameters matter.
        set_parameters: set the settable ones for the flight.
        bytes_per_s: what the line carries; None where that is no limit.
        left_changed: what earlier flights changed and never restored: vehicle -> name -> value before.

    Attributes:
        done: messages asked for and measured, parameters read.
        parameters: as read; None for one the vehicle does not have.
        changed: changed and not restored yet, with the value before.
        rates: asked for, by message.
        way: how a trajectory will be flown.
    """

    def __init__(
        self,
        view: VehicleView,
        station: Station,
        set_parameters: bool,
        bytes_per_s: float | None,
        left_changed: Mapping[str, Mapping[str, float]],
    ):
        self.view, self.station = view, station
        self.parameters: dict[str, float | None] = {}
        self.changed: dict[str, float] = {}
        self.rates: dict[str, float] = {}
        self.way = Way("setpoints", "the vehicle was not asked yet")
        self.done = False
        self._set, self._bytes_per_s, self._left = set_parameters, bytes_per_s, left_changed
        self._changes: list[tuple[str, float, float]] = []
        profile = view.profile
        self._dialogue = Parameters(profile.system, profile.component, bytewise=profile.bytewise_parameters)

    def steps(self) -> Steps[None]:
        """Ask for messages, read parameters, restore what an earlier flight left, set what this one needs, measure."""
        profile = self.view.profile
        yield Ask((profile.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0),), _named("AUTOPILOT_VERSION"), 0.7, 3)
        yield Ask((profile.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 261.0),), _named("COMMAND_ACK"), 0.7, 3)
        yield from self._streams()
        self.changed = dict(self._left.get(self.view.key, {}))
        yield from self.restore()
        if (yield from self._parameters()):
            yield from self._restart()
            yield from self._parameters()  # what it showed only after the restart
        if self.station.flies_by_poses:
            yield from self._fuse()
        self.way = yield from choose_way(profile, self.station.policy, self.parameters)
        if profile.climbs_by_command and not self.view.armed:
            # After a landing it stands in a mode that it does not arm in, and its own checks fail for that alone.
            yield Ask((profile.set_mode(profile.follow_mode),), _named("COMMAND_ACK"), 0.7, 3)
        if self.view.checks_pass is False:  # it says why only now and then, unless it is asked
            yield Ask((profile.command(mavlink.MAV_CMD_RUN_PREARM_CHECKS),), _named("COMMAND_ACK"), 0.7, 2)
        yield from self._measure()
        self.done = True

    def listen(self) -> Steps[None]:
        """For a vehicle found in flight: who it is, its messages, and what is to be restored once it is down."""
        yield Ask(
            (self.view.profile.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0),), _named("AUTOPILOT_VERSION"), 0.7, 3
        )
        self.changed = dict(self._left.get(self.view.key, {}))
        yield from self._streams()

    def restore(self) -> Steps[None]:
        """Write back what was there before."""
        for name, value in list(self.changed.items()):
            if (yield from self._dialogue.write(name, value)):
                del self.changed[name]
                self._changes.append((name, value, value))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the recording shall say of how it came over the line."""
        if self._bytes_per_s is None or not self.rates:
            return ()
        return cost_of_line(self.view.profile.streams, self.rates, self._bytes_per_s)

    def take_changes(self) -> list[tuple[str, float, float]]:
        """Name, value before and value now of every parameter changed since the last call."""
        changes, self._changes = self._changes, []
        return changes

    def _streams(self) -> Steps[None]:
        profile = self.view.profile
        self.rates = fit_rates(profile.streams, self._bytes_per_s)
        if self._bytes_per_s is not None:
            unasked = [name for name in self.view.meters if name not in self.rates and name not in _KEPT]
            for name in unasked:
                if not name.startswith("UNKNOWN"):
                    yield Ask((self._interval(name, 0.0),), acknowledges_interval, 0.5, 2)
        for name, rate in self.rates.items():
            yield Ask((self._interval(name, rate),), acknowledges_interval, 0.5, 4)

    def _measure(self) -> Steps[None]:
        """Count arrivals for a while; what is needed and comes by far too seldom is asked for again.

        An acknowledgement does not say of which message: a doubled one stands for a request that was lost.
        """
        least_hz = {
            w.name: min(AMPLE * w.needed_hz, SELDOM * self.rates[w.name])
            for w in self.view.profile.streams
            if w.needed_hz > 0.0
        }
        for _ in range(ROUNDS):
            before = {name: self._count(name) for name in least_hz}
            yield Ask((), lambda _m: False, timeouts.RATES_MEASURED_S, 1)
            seldom = [
                name
                for name, rate_hz in least_hz.items()
                if self._count(name) - before[name] <= rate_hz * timeouts.RATES_MEASURED_S
            ]
            if not seldom:
                return
            for name in seldom:
                yield Ask((self._interval(name, self.rates[name]),), acknowledges_interval, 0.5, 4)

    def _count(self, name: str) -> int:
        meter = self.view.meters.get(name)
        return 0 if meter is None else meter.count

    def _interval(self, name: str, rate_hz: float) -> Message:
        return self.view.profile.interval(message_id(name), rate_hz)

    def _parameters(self) -> Steps[bool]:
        """Read, and set where it is allowed; whether one was set that takes effect at a start of the autopilot."""
        mocap, indoors = self.station.mocap, self.station.flies_by_poses
        rules = self.view.profile.rules(self.view.version, indoors=indoors, pose_latency_s=mocap.latency_s)
        found = yield from self._dialogue.read_all([rule.name for rule in rules])
        self.parameters = {rule.name: found.get(rule.name) for rule in rules}
        restart = False
        for rule in rules:
            value = found.get(rule.name)
            if value is not None and not rule.holds(value) and rule.settable and self._set:
                self.changed.setdefault(rule.name, value)
                self._changes.append((rule.name, value, rule.accepted[0]))
                if (yield from self._dialogue.write(rule.name, rule.accepted[0])):
                    self.parameters[rule.name] = rule.accepted[0]
                    restart = restart or rule.restart
        return restart

    def _restart(self) -> Steps[None]:
        """Disarmed and on the ground, since nothing else is prepared.

        A firmware that refuses is found not to use the poses.
        """
        profile = self.view.profile
        number = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
        answer = yield Ask((profile.command(number, 1.0),), lambda m: _acknowledges(m, number), 1.0, 3)
        if answer is None or answer.result != mavlink.MAV_RESULT_ACCEPTED:
            return
        yield Ask((), lambda _m: False, timeouts.RESTART_BEGUN_S, 1)
        yield Ask((), _named("HEARTBEAT"), timeouts.RESTARTED_S, 1)
        yield from self._streams()

    def _fuse(self) -> Steps[None]:
        """Tell it where it is, and wait for the estimator to take the poses. The checks say whether it did."""
        yield Ask((self.view.profile.origin(),), _named("GPS_GLOBAL_ORIGIN"), 1.0, ORIGIN_TRIES)
        since_s = inf

        def steady(_m: Message) -> bool:
            """For some of the vehicle's seconds: a reset to the poses makes its own checks fail for a while."""
            nonlocal since_s
            state = self.view.state
            would_arm = self.view.checks_pass is not False or self.view.profile.arms_led
            if state is None or not would_arm or not_fused(self.view):
                since_s = inf
                return False
            since_s = min(since_s, state.device_s)
            return state.device_s - since_s >= timeouts.POSES_STEADY_S

        yield Ask((), steady, timeouts.POSES_FUSED_S, 1)


def _named(name: str) -> Callable[[Message], bool]:
    return lambda m: m.get_type() == name


def _acknowledges(m: Message, command: int) -> bool:
    return m.get_type() == "COMMAND_ACK" and m.command == command


def acknowledges_interval(m: Message) -> bool:
    """The answer to a request for a message's rate; it does not say which."""
    return _acknowledges(m, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)
