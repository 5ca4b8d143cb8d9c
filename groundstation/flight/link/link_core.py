"""The link without I/O: bytes and orders in, bytes, samples and answers out, on the time it is given.

One :class:`LinkCore` serves one vehicle. Its :meth:`~LinkCore.step` is called whenever bytes arrive, and at least as
often as setpoints are due; guard and setpoints come first in it and wait for nothing. What the vehicle or strangers
send cannot end it: work is bounded (:mod:`~groundstation.flight.link.inlet`), fields pass a gate, and a handler that
fails is counted, told and skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import inf
from typing import TypeVar

from drivers.mavlink.codec import Received
from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.exchange import Conversation, Steps
from drivers.mavlink.signing import Signing
from drivers.mavlink.telemetry import Telemetry
from drivers.mavlink.transports import Peer
from drivers.mocap.health import vehicle_clock_text
from drivers.samples import Event, Imu, Pose, Raw, Setpoint, State
from groundstation.errors import BadInput
from groundstation.flight import timeouts
from groundstation.flight.link.captured import CapturedPoses
from groundstation.flight.link.guard import Guard, Verdict
from groundstation.flight.link.identity import speaker
from groundstation.flight.link.inlet import Arrival, Complaints, Inlet, says_who_it_is
from groundstation.flight.link.options import PLAIN, Options, Output
from groundstation.flight.link.phase import GUARDED, IN_AIR, Answered, Phase
from groundstation.flight.link.pilot import Pilot
from groundstation.flight.link.pose_latency import latency_sentence
from groundstation.flight.link.preflight import Check, Situation, failures, run_checks
from groundstation.flight.link.prepare import Preparation
from groundstation.flight.link.profiles import profile_for
from groundstation.flight.link.roster import Roster
from groundstation.flight.link.sending import PlanSending
from groundstation.flight.link.view import VehicleView
from groundstation.flight.link.voice import Voice
from groundstation.flight.link.watch import Disagreement, observe
from groundstation.flight.station import Station
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle

T = TypeVar("T")


class LinkCore:
    """One vehicle's link.

    Args:
        vehicle: as declared.
        station: limits and policy.
        options: see :class:`Options`.
        signing: key for the whole flight; None leaves MAVLink unsigned.
        free_bytes: room where the recording goes; None when nobody keeps one.
        restore: parameters earlier flights changed and never restored: vehicle -> name -> value before.

    Attributes:
        view, pilot: None until an autopilot was heard.
        ready: streams asked for and measured, parameters read.
        trouble: why it is not; one sentence.
        roster: autopilots heard on the link.
        checks: of the last upload.
        datagrams: the line's frames never continue in the next read.
        found_flying: it was armed when it was first heard, and does not say that it stands on the ground.
    """

    def __init__(
        self, vehicle: Vehicle, station: Station, options: Options = PLAIN, signing: Signing | None = None,
        restore: dict[str, dict[str, float]] | None = None, free_bytes: Callable[[], int | None] = lambda: None,
    ):  # fmt: skip
        self.vehicle, self.station, self.options = vehicle, station, options
        self._voice = Voice(options, signing)
        self.clock = self._voice.clock
        self.view: VehicleView | None = None
        self.pilot: Pilot | None = None
        self.ready = False
        self.roster = Roster(options.system)
        self.trouble = self.roster.trouble()
        self.checks: list[Check] = []
        self.preparation: Preparation | None = None
        self.datagrams = True
        self._left_changed = restore or {}
        self.free_bytes = free_bytes
        self.verdict: Verdict | None = None
        self._inlet = Inlet(signing)
        self._complaints = Complaints()
        self._stepped_s = self._load_told_s = -inf
        self._telemetry: Telemetry | None = None
        self._guard: Guard | None = None
        self.found_flying = False
        self._restoring: Conversation[None] | None = None
        self._talks: list[Conversation] = []
        self._events: list[Event] = []
        self._setpoint_due_s = self._setpoint_device_s = -inf
        self._core_s: float | None = None
        self._abort = ""
        self._sending: PlanSending | None = None
        self._phase = Phase.IDLE
        self._disagreement = Disagreement()
        self._captured = CapturedPoses(vehicle, station)

    # Orders from the core ---------------------------------------------------------------------------------------------

    def core_heard(self, now_s: float) -> None:
        """The core lives."""
        self._core_s = now_s

    def core_lost(self) -> None:
        """The core is known to be gone."""
        if self._core_s is not None:
            self._core_s = -inf

    def upload(self, plan: Plan, now_s: float) -> Answered:
        """Check everything and take the plan."""
        if not self.ready or self.pilot is None:
            return Answered(False, f"the link is not ready: {self.trouble}.")
        try:
            self.check(plan, now_s)
        except BadInput as error:
            return Answered(False, str(error))
        if reason := failures(self.checks):
            return Answered(False, reason)
        assert self.preparation is not None  # noqa: S101 - ready
        self._sending = PlanSending(self.pilot, plan, lambda text: self.note(now_s, "upload", text))
        return self._sending.begin(self.preparation.way, self.converse)

    def check(self, plan: Plan | None, now_s: float) -> list[Check]:
        """Run every check as of now; the answers also go into the recording.

        Raises:
            BadInput: a forced check does not exist.
        """
        assert self.view is not None  # noqa: S101 - ready
        poses = self._captured
        situation = Situation(
            now_s, self.view, self.station, self.vehicle, plan, self.parameters, self.clock.error_s(now_s),
            poses.carried, self.free_bytes(), poses.marker, poses.said,
        )  # fmt: skip
        self.checks = run_checks(situation, self.options.force)
        for check in self.checks:
            verdict = "forced" if check.forced else "ok" if check.ok else "failed"
            remedy = f"; {check.remedy}" if check.remedy else ""
            self.note(now_s, "preflight", f"{check.name} {verdict}: {check.reason}{remedy}")
        return self.checks

    def order(self, name: str, now_s: float, reason: str = "") -> Answered:
        """Arm, start, abort, land, disarm."""
        if self.pilot is None:
            return Answered(False, f"there is no vehicle: {self.trouble}.")
        if name == "abort" and self.pilot.phase in GUARDED:
            self._abort = reason or "by the operator"
            return Answered(True)
        if name == "start":
            self._abort, self.verdict = "", None
            self._guard = Guard(self.station.guard, self.station.box, self.vehicle.battery.empty_v)
            self._disagreement = Disagreement()
            self._captured.begin()
            if self.view is not None:
                self.view.take_jump()
        return self.pilot.order(name, now_s, reason)

    def pose(self, pose: Pose, received_s: float) -> Output:
        """A motion-capture pose; its stamp is on the capture system's clock, mapped to ours by its driver."""
        out = Output(samples=[(pose, received_s)])
        if self.view is None or self.pilot is None:
            return out
        self._watch_marker(pose, received_s)
        for message in self._captured.pose(pose, received_s, self.view, in_air=self.pilot.phase in IN_AIR):
            self._send(message, received_s, out)
        return out

    def mocap_event(self, event: Event, received_s: float) -> None:
        """The motion capture's client says how it is."""
        fit, text = self.clock.fit(), event.text
        if event.kind == "clock" and fit is not None:
            text += vehicle_clock_text(received_s - fit.device(received_s), fit.error_s(received_s))
        self._captured.heard(event)
        self.note(received_s, event.kind, text)

    def _watch_marker(self, sample: Imu | Pose, host_s: float) -> None:
        if self._phase not in IN_AIR:
            self._captured.watch(sample, host_s)

    # One step ---------------------------------------------------------------------------------------------------------

    def step(self, now_s: float, incoming: Iterable[tuple[Peer, bytes]]) -> Output:
        """Take in what came, decide, and give what leaves."""
        out = Output()
        on_time, self._stepped_s = now_s - self._stepped_s < timeouts.LATE_STEP_S, now_s
        if on_time:  # after a stall what waits in the port is heard first, within its bounds
            self._guard_flight(now_s, out)
        messages = self._receive(now_s, incoming, out)
        if self.view is not None and self.pilot is not None:
            self._guard_flight(now_s, out)
            self._lead(now_s, messages, out)
            self._converse(now_s, messages, out)
        self._keep_alive(now_s, out)
        out.samples += [(event, now_s) for event in self._events]
        self._events.clear()
        return out

    @property
    def next_s(self) -> float:
        """When :meth:`step` is due again though nothing arrives."""
        return self._setpoint_due_s if self.pilot is not None and self.pilot.phase in GUARDED else -inf

    @property
    def waiting(self) -> bool:
        """Something arrived that :meth:`step` has not come to yet."""
        return self._inlet.waiting

    @property
    def peer(self) -> Peer | None:
        """Where the vehicle is; None before it is known."""
        return self._inlet.peer

    @property
    def target_system(self) -> int | None:
        """The vehicle's system id."""
        return None if self.view is None else self.view.profile.system

    @property
    def parameters(self) -> Mapping[str, float | None]:
        """As read from the vehicle; None for one it does not have."""
        return {} if self.preparation is None else self.preparation.parameters

    @property
    def changed(self) -> Mapping[str, float]:
        """Parameters changed and not restored yet, with their values before."""
        return {} if self.preparation is None else self.preparation.changed

    def device_s(self, now_s: float) -> float:
        """The vehicle's clock now: by TIMESYNC, else its newest stamp."""
        fit = self.clock.fit()
        if fit is not None:
            return fit.device(now_s)
        return self._telemetry.newest_s if self._telemetry is not None else 0.0

    def lost_frames(self) -> tuple[int, int]:
        """Frames received and lost on the way here, by the vehicle's sequence numbers."""
        counters = [
            c for codec in self._inlet.codecs.values() for k, c in codec.counters.items() if k[0] == self.target_system
        ]
        return sum(c.received for c in counters), sum(c.lost for c in counters)

    # Receiving --------------------------------------------------------------------------------------------------------

    def _receive(self, now_s: float, incoming: Iterable[tuple[Peer, bytes]], out: Output) -> list[Message]:
        silent = now_s - self._inlet.heard_s > timeouts.ADDRESS_SILENT_S
        self._inlet.put(now_s, incoming, others=silent)
        messages: list[Message] = []
        arrivals = self._inlet.take(datagrams=self.datagrams)
        while True:
            name = "what arrived"
            try:
                arrival = next(arrivals)
                name = arrival.received.name
                if self._belongs(arrival, silent, out):
                    self._take(arrival.received, arrival.received_s, out)
                    if arrival.received.message is not None:
                        messages.append(arrival.received.message)
            except StopIteration:
                break
            except Exception as error:  # whatever it is, who flies goes on
                self._complain(f"{name} could not be taken in ({type(error).__name__}: {error}); skipped", now_s, out)
        if now_s - self._load_told_s >= timeouts.STRANGERS_TOLD_EVERY_S and self._inlet.load.datagrams:
            self._load_told_s = now_s
            self._tell(out, now_s, "link", f"strangers on the port, not listened to: {self._inlet.take_load()}")
        return messages

    def _belongs(self, arrival: Arrival, silent: bool, out: Output) -> bool:
        """Whether it is the vehicle's autopilot that says it, from where the vehicle is."""
        received, now_s = arrival.received, arrival.received_s
        if received.message is not None and says_who_it_is(received):
            said = self.roster.hears(received.frame.system, received.message.autopilot)
            if said:
                self._tell(out, now_s, "link", said)
            self.trouble = self.trouble if self.view is not None else self.roster.trouble() or self.trouble
        if self.view is None:
            self._discover(received, arrival.peer, now_s, out)
        if self.view is None or self.pilot is None:
            return False
        in_flight = self.pilot.phase in IN_AIR
        found = speaker(arrival, self.view.profile, self.peer, self.clock.fit(), silent=silent, in_flight=in_flight)
        if found.said:
            self._complain(found.said, now_s, out)
        if found.who == "moved":
            self._inlet.bind(arrival.peer, now_s)
        elif found.who == "beside" and self.options.keep_raw:
            out.samples.append((Raw(now_s, "in", received.frame.raw), now_s))
        if received.refused and found.who in ("vehicle", "moved"):
            codec = self._inlet.codecs[arrival.peer]
            self._complain(f"{codec.refusal_of(received.frame)}; not believed", now_s, out)
        return found.who in ("vehicle", "moved")

    def _complain(self, what: str, now_s: float, out: Output) -> None:
        """Count it, and tell it seldom."""
        if self._complaints.count(what):
            self._tell(out, now_s, "link", f"{what} ({self._complaints.counts.get(what, 0)} so far)")

    def _discover(self, received: Received, peer: Peer, now_s: float, out: Output) -> None:
        """The first heartbeat of an autopilot decides who flies here."""
        m = received.message
        if not says_who_it_is(received) or m is None or self.options.system not in (None, received.frame.system):
            return
        try:
            profile = profile_for(m.autopilot, received.frame.system, received.frame.component)
        except BadInput as error:
            self.trouble = str(error)
            return
        self._inlet.bind(peer, now_s)
        self.view = VehicleView(profile)
        self.pilot = Pilot(profile, self.station.policy, self.view, by_poses=self.station.flies_by_poses)
        self._telemetry = Telemetry(
            self.vehicle.rotors.count, system=profile.system, imu=profile.imu, pwm_us=profile.pwm_us
        )
        self.found_flying = not self.options.quiet and bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if self.options.take_over:
            self._take_over(now_s, armed=self.found_flying)
        elif not self.options.quiet and not self.found_flying:
            self._prepare()
        self.trouble = "asking the vehicle for its messages and parameters"
        self._tell(out, now_s, "link", f"{profile.name} heard as system {profile.system} from {peer}")

    def _take_over(self, now_s: float, *, armed: bool) -> None:
        """Bring down what another link or station left in the air; what it does is known from its first heartbeat
        on.
        """
        assert self.pilot is not None and self.view is not None  # noqa: S101 - discovered
        self.preparation = Preparation(self.view, self.station, False, self.options.bytes_per_s, self._left_changed)
        self.converse(self.preparation.listen())
        self.ready = True
        if not armed:
            self.pilot.phase = Phase.LANDED
        else:
            self._guard = Guard(self.station.guard, self.station.box, self.vehicle.battery.empty_v)
            hold_s = timeouts.TAKEN_OVER_HOLD_S if self.options.take_over == "hold" else 0.0
            self.pilot.take_over(now_s, "taken over in flight by a new link", hold_s=hold_s)

    def prepare_on_ground(self) -> None:
        """It was armed when it was found, and stands on the ground: go on as with any other."""
        self.found_flying = False
        self._prepare()

    def _prepare(self) -> None:
        if self.view is not None:
            self.preparation = Preparation(
                self.view, self.station, self.options.set_parameters, self.options.bytes_per_s, self._left_changed
            )
            self.converse(self.preparation.steps())

    def _take(self, received: Received, now_s: float, out: Output) -> None:
        assert self.view is not None and self._telemetry is not None  # noqa: S101 - discovered before
        if self.options.keep_raw:
            out.samples.append((Raw(now_s, "in", received.frame.raw), now_s))
        before, restarts = self.view.mode, self.view.restarts
        self.view.message(received, now_s)
        if self.view.restarts != restarts:
            self._telemetry.restart()
            self._setpoint_device_s = -inf
            self._tell(out, now_s, "link", "the autopilot restarted")
        if self.view.mode != before:
            self._tell(out, now_s, "mode", f"{before or 'unknown'} -> {self.view.mode}")
        for sample in self._telemetry.samples(received):
            self.view.sample(sample, now_s)
            out.samples.append((sample, now_s))
            if isinstance(sample, Imu):
                self._watch_marker(sample, now_s)
            if isinstance(sample, State) and (fit := self.clock.fit()) is not None:
                self._captured.state(fit.host(sample.device_s), sample)
        if received.name == "TIMESYNC":
            self._voice.timesync(received.message, now_s, out)

    # Guarding and leading ---------------------------------------------------------------------------------------------

    def _guard_flight(self, now_s: float, out: Output) -> None:
        if self.pilot is None or self.pilot.phase not in GUARDED or self._guard is None:
            return
        seen = observe(now_s, self.pilot, self.station, self._disagreement, self._core_s, self._abort)
        verdict = self._guard.step(now_s, seen)
        if verdict is not None and verdict != self.verdict:
            self.verdict = verdict
            self._tell(out, now_s, "guard", f"{verdict.action}: {verdict.reason}")
            self.pilot.obey(verdict, now_s)

    def _lead(self, now_s: float, messages: list[Message], out: Output) -> None:
        assert self.pilot is not None  # noqa: S101
        due = now_s >= self._setpoint_due_s
        if due:
            period = 1.0 / self.station.policy.setpoint_hz
            next_s = self._setpoint_due_s + period  # on a grid, so that lateness does not add up
            self._setpoint_due_s = next_s if next_s > now_s else now_s + period
        for message in self.pilot.step(now_s, messages, setpoint_due=due):
            self._send(message, now_s, out)
        device_s = self.device_s(now_s)
        if due and self.pilot.target is not None and device_s > self._setpoint_device_s:
            self._setpoint_device_s = device_s  # a clock map that is corrected backwards gives no stamp twice
            placed = self.pilot.placement.to_vehicle(self.pilot.target)
            out.samples.append((Setpoint(device_s, placed.position_m, placed.yaw_rad), now_s))
        if self.pilot.phase is not self._phase:
            self._tell(out, now_s, "link", f"{self._phase} -> {self.pilot.phase} {self.pilot.reason}".strip())
            self._phase = self.pilot.phase
            # Before touch-down: the recording ends with the flight.
            if self._phase is Phase.LANDING and (found := self._captured.latency) is not None:
                told = latency_sentence(found, self.clock.error_s(now_s), self.station.mocap)
                self._tell(out, now_s, "latency", told)

    def converse(self, steps: Steps[T]) -> Conversation[T]:
        """Hold a conversation beside the flight: parameters, files, logs. Watch its ``done``."""
        talk = Conversation(steps)
        self._talks.append(talk)
        return talk

    def restore_parameters(self) -> None:
        """Begin to write back what was changed for the flight; only disarmed. ``changed`` empties as it succeeds."""
        busy = self._restoring is not None and not self._restoring.done
        if self.preparation is not None and not busy and self.changed and self.view is not None and not self.view.armed:
            self._restoring = self.converse(self.preparation.restore())

    def _converse(self, now_s: float, messages: Sequence[Message], out: Output) -> None:
        for talk in list(self._talks):
            for message in talk.step(now_s, messages):
                self._send(message, now_s, out)
            if talk.done:
                self._talks.remove(talk)
        if self._sending is not None and self._sending.sent():
            self._sending = None
        if self.preparation is not None:
            out.changed = self.preparation.take_changes()
            if self.preparation.done and not self.ready:
                self.ready, self.trouble = True, ""

    # Sending ----------------------------------------------------------------------------------------------------------

    def _keep_alive(self, now_s: float, out: Output) -> None:
        if not self.found_flying or self.options.take_over:
            self._voice.heartbeat(now_s, out)
        if self.view is not None:
            self._voice.ask_time(now_s, out)

    def _send(self, message: Message, now_s: float, out: Output) -> None:
        self._voice.send(message, now_s, out)

    def note(self, now_s: float, kind: str, text: str) -> None:
        """Put an event into the recording, with the next step."""
        self._events.append(Event(self.device_s(now_s), kind, text))

    def _tell(self, out: Output, now_s: float, kind: str, text: str) -> None:
        out.samples.append((Event(self.device_s(now_s), kind, text), now_s))
