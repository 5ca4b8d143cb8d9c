r"""The link's own state machine of one flight: what leaves towards the vehicle, and when nothing may. No I/O, no clock.

    idle -> uploaded -> armed -> climbing -> following -> landing -> landed
                                 \\-> holding -> landing          \\-> released (the pilot has it)

Rules that hold whatever else happens:

* Setpoints leave only while ``climbing`` (where the autopilot climbs by setpoints) and ``following``; where it arms in
  no other mode (PX4 by poses alone), also before, for a place under the ground that it stands on. After any loss they
  never come back by themselves: PX4 re-enters OFFBOARD on the first one, and takes off again from the ground.
* A mode we did not command means somebody else decided: released at once. From then on only the operator's ``land``
  sends anything.
* A landing is commanded again and again until the vehicle shows it or a pilot takes over.
"""

from __future__ import annotations

from math import nextafter

import numpy as np

from drivers.mavlink.dialect import Message
from drivers.mavlink.exchange import Conversation, Steps
from drivers.mavlink.geometry import yaw_of
from drivers.samples import Vector3
from groundstation.flight import timeouts
from groundstation.flight.link.guard import Verdict
from groundstation.flight.link.onboard import OnboardExcitation
from groundstation.flight.link.orders import Orders, distance
from groundstation.flight.link.phase import GUARDED, IN_AIR, Answered, Phase
from groundstation.flight.link.placement import Placement, target_at
from groundstation.flight.link.profiles import Profile, Target
from groundstation.flight.link.view import VehicleView
from groundstation.flight.station import Policy
from groundstation.trajectory import Plan, Sequence, changed_length, flight_path, with_periods

UNDER_GROUND_M = 0.3
"""How far under it the place lies that an armed vehicle is led to while it stands: near enough to be no order to move.
"""
_ABORTED = "the flight was aborted; upload a plan again to"


class Pilot:
    """Flies one plan.

    Args:
        profile: the autopilot's manners.
        policy: the station's.
        view: what is known of the vehicle; kept by someone else, read here.
        by_poses: the vehicle's estimator flies by external poses.

    Attributes:
        phase: where the flight is.
        reason: why it is coming down, when it was not the plan's end.
        excitation_s: host times at which the excitation began and ended.
        target: where the vehicle should be now, in the plan's frame; None while we do not lead.
    """

    def __init__(self, profile: Profile, policy: Policy, view: VehicleView, *, by_poses: bool = False):
        self.profile, self.policy, self.view = profile, policy, view
        self._orders = Orders(profile, policy, view)
        self.phase = Phase.IDLE
        self.reason = ""
        self.plan: Plan | None = None
        self.placement = Placement()
        self.path: Sequence | None = None
        self.path_s = 0.0
        self.excitation_s: tuple[float | None, float | None] = (None, None)
        self.target: Target | None = None
        self.setpoint_sent_s: float | None = None
        self._since_s = 0.0
        self._path_stepped_s: float | None = None
        self._waiting_since_s: float | None = None
        self._talk: Conversation[str] | None = None
        self._talk_answer: Answered | None = None
        self._again_s = -1e9
        self._restarts = view.restarts
        self._excitation_lasts_s = 0.0
        self._kill = False
        self._script: OnboardExcitation | None = None
        self._handed_over = False
        self._led = False
        self._aborted = False
        self._hold_s = policy.hold_s
        self._arms_led = by_poses and profile.arms_led
        self._standing: Target | None = None

    # Orders -----------------------------------------------------------------------------------------------------------

    def upload(self, plan: Plan, *, onboard: bool = False) -> Answered:
        """Take a plan; only on the ground.

        ``onboard``: its excitation is on the vehicle, for the script there to fly.
        """
        if self.phase in IN_AIR or self.view.armed:
            return Answered(False, f"a plan is taken only on the ground and disarmed; the flight is {self.phase}.")
        self.plan, self.reason, self.excitation_s = plan, "", (None, None)
        self._aborted = False
        self._script = OnboardExcitation(self.profile) if onboard else None
        self._handed_over = False
        self.phase = Phase.UPLOADED
        return Answered(True)

    def order(self, name: str, now_s: float, reason: str = "") -> Answered:
        """An order of the operator; the answer may come later."""
        match name:
            case "arm":
                return self._arm(now_s)
            case "start":
                return self._start(now_s)
            case "finish" | "extend":
                return self._change_length(name)
            case "abort" | "land":
                return self._order_landing(name, now_s, reason)
            case "kill" if self.phase in GUARDED:
                self.obey(Verdict("kill", "operator", "the operator stopped the rotors"), now_s)
                return Answered(True)
            case "kill" | "disarm":
                return self._order_disarm(now_s)
        return Answered(False, f"'{name}' is no order a vehicle knows.")

    def _arm(self, now_s: float) -> Answered:
        if self._aborted:
            return Answered(False, f"{_ABORTED} arm.")
        if self.phase is not Phase.UPLOADED:
            return Answered(False, f"arming needs an uploaded plan; the flight is {self.phase}.")
        state = self.view.state
        if self._arms_led and state is not None and self._talk is None:
            x, y, z = state.position_m
            still = (0.0, 0.0, 0.0)
            self._standing = Target((x, y, z - UNDER_GROUND_M), still, still, yaw_of(state.quaternion), 0.0)
        return self._begin(self._orders.arm(led=self._standing is not None), now_s)

    def _start(self, now_s: float) -> Answered:
        if self._aborted:
            return Answered(False, f"{_ABORTED} start.")
        if self.phase is not Phase.ARMED or not self.view.armed or self.plan is None or self.view.state is None:
            return Answered(False, f"starting needs an armed vehicle with a position; the flight is {self.phase}.")
        state = self.view.state
        if self.policy.placement == "takeoff":
            self.placement = Placement(state.position_m, yaw_of(state.quaternion))
        ground = self.placement.to_plan(state.position_m)
        self._restarts = self.view.restarts
        self._enter(Phase.CLIMBING, now_s)
        if self.profile.climbs_by_command:
            return self._begin(self._rising(self._start_height() - ground[2]), now_s)
        self._set_path(ground, now_s)
        return self._begin(self._orders.follow(), now_s)

    def _change_length(self, name: str) -> Answered:
        """End the excitation at its next rest point, or let it go on; never past what was checked on the ground."""
        if not self.exciting or self.path is None or self.plan is None or self._handed_over:
            return Answered(False, f"'{name}' is for an excitation that the link leads; the flight is {self.phase}.")
        changed = changed_length(self.path, self.path_s, name, self.plan.periods)
        if isinstance(changed, str):
            return Answered(False, changed)
        self._take_path(changed)
        return Answered(True)

    def _take_path(self, path: Sequence) -> None:
        self.path, self._excitation_lasts_s = path, float(path.parts[3].duration_s)

    def _order_landing(self, name: str, now_s: float, reason: str) -> Answered:
        if self.phase in (Phase.IDLE, Phase.LANDED):
            return Answered(True)
        if self.phase in (Phase.UPLOADED, Phase.ARMED):
            return self._stand_down(now_s, reason or f"the operator asked to {name}")
        if self.view.in_pilots_hands and name == "abort":
            return Answered(False, f"the pilot flies it in {self.view.mode}; say 'land' to take it back and land it.")
        if self.phase is not Phase.LANDING:
            self.land(now_s, reason or f"the operator asked to {name}")
        return Answered(True)

    def _stand_down(self, now_s: float, reason: str) -> Answered:
        """Before the start: nothing arms or starts any more until a plan is uploaded again."""
        asked = self._talk is not None or self.view.armed
        self.reason, self._aborted, self._standing = reason, True, None
        self._cancel_talk()
        return self._begin(self._orders.stand_down(), now_s) if asked else Answered(True)

    def take_over(self, now_s: float, reason: str, *, hold_s: float = 0.0) -> None:
        """Bring down a vehicle that somebody else started; ``hold_s``: hold it so long before.

        A pilot goes before it.
        """
        self.reason, self._hold_s, self._led = reason, hold_s, True
        self._enter(Phase.HOLDING if hold_s > 0.0 else Phase.LANDING, now_s)

    def _order_disarm(self, now_s: float) -> Answered:
        if self.phase in IN_AIR and self.view.on_ground is not True:
            return Answered(False, "disarming is refused in the air; land first.")
        if not self.view.armed:
            return Answered(True)
        return self._begin(self._orders.disarm(), now_s)

    # The guard's and the station's decisions --------------------------------------------------------------------------

    def obey(self, verdict: Verdict, now_s: float) -> None:
        """Carry out what the guard decided; stronger decisions replace weaker ones."""
        if self.phase not in GUARDED:
            return
        if verdict.action == "kill":
            self._cancel_talk()
            self.reason = self.reason or verdict.reason
            self._kill = True
            self._enter(Phase.LANDING, now_s)
        elif self.phase is not Phase.LANDING and verdict.action == "land":
            self.land(now_s, verdict.reason)
        elif self.phase in (Phase.CLIMBING, Phase.FOLLOWING):
            self._cancel_talk()
            self.reason = self.reason or verdict.reason
            self._enter(Phase.HOLDING, now_s)

    def land(self, now_s: float, reason: str = "") -> None:
        """Stop leading, and have the autopilot land."""
        self._cancel_talk()
        self.reason = self.reason or reason
        self._enter(Phase.LANDING, now_s)

    # One step ---------------------------------------------------------------------------------------------------------

    def step(self, now_s: float, messages: list[Message], *, setpoint_due: bool = True) -> list[Message]:
        """What leaves now; a setpoint among it only when one is due."""
        out: list[Message] = []
        if self._script is not None:
            self._script.hear(now_s, messages)
        if self._talk is not None:
            out += self._talk.step(now_s, messages)
            if self._talk is not None and self._talk.done:
                self._finish_talk(now_s)
        self._notice(now_s)
        match self.phase:
            case Phase.FOLLOWING if self._handed_over:
                self._watch_script(now_s)
            case Phase.FOLLOWING:
                self._advance_path(now_s)
            case Phase.HOLDING:
                self._keep_holding(now_s, out)
            case Phase.LANDING:
                self._keep_landing(now_s, out)
        leading = (self.phase is Phase.FOLLOWING and not self._handed_over) or (
            self.phase is Phase.CLIMBING and self.path is not None
        )
        if leading and setpoint_due:
            self._setpoint(now_s, out)
        elif self._standing is not None and setpoint_due:
            out.append(self.profile.setpoint(self._standing, now_s))
        return out

    @property
    def exciting(self) -> bool:
        """Between the excitation's start and its end."""
        return self.excitation_s[0] is not None and self.excitation_s[1] is None and self.phase is Phase.FOLLOWING

    def window_s(self, now_s: float) -> tuple[float, float] | None:
        """Host times of the excitation: as it happened, what has not happened as planned; None before the path
        begins.
        """
        begun, ended = self.excitation_s
        if begun is not None:
            return begun, ended if ended is not None else begun + self._excitation_lasts_s
        if self.path is None:
            return None
        begin, end = self._window()
        start_s = now_s + max(0.0, begin - self.path_s)
        return start_s, start_s + end - begin

    def progress_s(self) -> tuple[float, float]:
        """Seconds flown on the path, and its length; zeros off it."""
        return (0.0, 0.0) if self.path is None else (self.path_s, self.path.duration_s)

    def _notice(self, now_s: float) -> None:
        """What the vehicle did by itself, or somebody else with it."""
        view = self.view
        self._led = self.phase in GUARDED and (self._led or view.mode == self.profile.follow_mode)
        if self.phase in IN_AIR and view.armed is False:
            if self.phase is not Phase.LANDING:
                self.reason = self.reason or f"the vehicle disarmed while {self.phase}"
            self._cancel_talk()
            self._enter(Phase.LANDED, now_s)
        elif self.phase is Phase.ARMED and view.armed is False:
            self._enter(Phase.UPLOADED, now_s)
            self._standing = None
        elif self.phase is Phase.ARMED and self._standing is not None and view.mode != self.profile.follow_mode:
            self._standing = None
        elif self._led and self._taken_over():
            self._release(now_s)
        elif self.phase in (Phase.CLIMBING, Phase.FOLLOWING) and view.restarts != self._restarts:
            self.land(now_s, "the autopilot restarted")

    def _taken_over(self) -> bool:
        """A mode we did not ask for: while leading any, while holding or landing a pilot's."""
        if self.phase in (Phase.CLIMBING, Phase.FOLLOWING):
            return self.view.mode != self.profile.follow_mode
        return self.phase in GUARDED and self.view.in_pilots_hands

    def _release(self, now_s: float) -> None:
        self._cancel_talk()
        self.reason = self.reason or f"the mode became {self.view.mode}, which the station did not ask for; let go"
        self._enter(Phase.RELEASED, now_s)

    def _setpoint(self, now_s: float, out: list[Message]) -> None:
        assert self.path is not None  # noqa: S101 - set before these phases are entered
        self.target = target_at(self.path, self.path_s)
        self.setpoint_sent_s = now_s
        out.append(self.profile.setpoint(self.placement.to_vehicle(self.target), now_s))

    def _advance_path(self, now_s: float) -> None:
        assert self.path is not None  # noqa: S101
        dt = now_s - (self._path_stepped_s if self._path_stepped_s is not None else now_s)
        self._path_stepped_s = now_s
        begin, end = self._window()
        before, self.path_s = self.path_s, self.path_s + dt
        if before < begin <= self.path_s and not self._settled():
            self.path_s = nextafter(begin, 0.0)
            self._waiting_since_s = now_s if self._waiting_since_s is None else self._waiting_since_s
            if now_s - self._waiting_since_s > self.policy.settle_timeout_s:
                self.land(now_s, f"the vehicle did not settle within {self.policy.settle_timeout_s:g} s; not excited")
            return
        if before < begin <= self.path_s and self._script is not None:
            self._hand_over(begin, now_s)
            return
        if before < begin <= self.path_s:
            self.excitation_s = (now_s, None)
        if before < end <= self.path_s:
            self.excitation_s = (self.excitation_s[0], now_s)
        if self.path_s >= self.path.duration_s:
            self.land(now_s)

    def _rising(self, height_m: float) -> Steps[str]:
        """The climb; before it the script is told where the plan lies."""
        if self._script is not None and (reason := (yield from self._script.place(self.placement))):
            return reason
        return (yield from self._orders.climb(height_m))

    def _hand_over(self, begin: float, now_s: float) -> None:
        """From here the script on board leads; setpoints of ours would contradict it."""
        assert self._script is not None  # noqa: S101 - asked before
        self.path_s, self._handed_over, self.setpoint_sent_s = nextafter(begin, 0.0), True, None
        self._begin(self._script.start(), now_s)

    def _watch_script(self, now_s: float) -> None:
        """Follow the script by its reports; lead again when it is through, land when it is not heard."""
        assert self._script is not None and self.path is not None  # noqa: S101 - handed over
        if self._talk is not None:
            return
        begin, end = self._window()
        match self._script.state(now_s):
            case "flying":
                flown = self._script.progress_s(now_s)
                self.path_s = min(begin + flown, nextafter(end, 0.0))
                self.excitation_s = (self.excitation_s[0] or now_s - flown, None)
                self.target = target_at(self.path, self.path_s)
            case "complete":
                self.path_s, self._path_stepped_s, self._handed_over = end, now_s, False
                self.excitation_s = (self.excitation_s[0], now_s)
            case "silent":
                self.land(now_s, "the script on board was not heard any more")
            case "ended" if self.view.heartbeat_s > (self._script.ended_s or now_s):
                # Only after a heartbeat: a pilot's switch ends the script too, and its mode is not to be taken back.
                self.land(now_s, "the script on board ended before the excitation was flown")
            case "ended":
                pass  # a heartbeat that does not come is the guard's business

    def _settled(self) -> bool:
        """Close to the excitation's start, and slow."""
        state = self.view.state
        if state is None or self.target is None or self.view.on_ground:
            return False
        error = distance(self.placement.to_plan(state.position_m), self.target.position_m)
        speed = distance(state.velocity_m_s, (0.0, 0.0, 0.0))
        return error <= self.policy.settled_error_m and speed <= self.policy.settled_speed_m_s

    def _window(self) -> tuple[float, float]:
        """Start and end of the excitation on the path."""
        assert self.path is not None  # noqa: S101
        begin = float(sum(part.duration_s for part in self.path.parts[:3]))
        return begin, begin + float(self.path.parts[3].duration_s)

    def _set_path(self, start: Vector3, now_s: float) -> None:
        """From where it is, through the excitation, to the hover from which the autopilot lands."""
        assert self.plan is not None and self.view.state is not None  # noqa: S101
        yaw = yaw_of(self.view.state.quaternion) - self.placement.yaw_rad
        yaw = float(np.arctan2(np.sin(yaw), np.cos(yaw)))
        whole = flight_path(self.plan, (*start, yaw), climb_m_s=self.policy.climb_m_s, settle_s=self.policy.settle_s)
        self._take_path(with_periods(Sequence(whole.parts[:-1]), self.plan.first_periods))
        self.path_s, self._path_stepped_s, self._waiting_since_s = 0.0, None, None

    def _start_height(self) -> float:
        assert self.plan is not None  # noqa: S101
        return float(self.plan.series().derivatives([0.0], 0)[0, 0, 2])

    def _keep_holding(self, now_s: float, out: list[Message]) -> None:
        if now_s - self._since_s > self._hold_s:
            self.land(now_s)
        elif now_s >= self._again_s and self.view.mode != self.profile.hold_mode:
            self._again_s = now_s + timeouts.ORDER_AGAIN_S
            out.append(self.profile.set_mode(self.profile.hold_mode))

    def _keep_landing(self, now_s: float, out: list[Message]) -> None:
        if now_s < self._again_s:
            return
        self._again_s = now_s + timeouts.ORDER_AGAIN_S
        if self._kill:
            out.append(self.profile.kill())
            return
        if self.view.mode != self.profile.land_mode:
            out.append(self.profile.set_mode(self.profile.land_mode))
        if self.view.on_ground is True and now_s - self._since_s > 3.0:
            out.append(self.profile.disarm())  # refused in the air, should the knowledge of the ground be stale

    # Conversations ----------------------------------------------------------------------------------------------------

    def _begin(self, steps: Steps[str], now_s: float) -> Answered:
        """Start a conversation that returns "" or the reason of a refusal."""
        if self._talk is not None:
            return Answered(False, "the vehicle is still being asked something else; try again.")
        self._talk, self._talk_answer = Conversation(steps), Answered()
        return self._talk_answer

    def _finish_talk(self, now_s: float) -> None:
        talk, answer = self._talk, self._talk_answer
        self._talk = self._talk_answer = None
        assert talk is not None and answer is not None  # noqa: S101
        reason = str(talk.error) if talk.error is not None else talk.result or ""
        answer.ok, answer.reason = not reason, reason
        if self.phase is Phase.UPLOADED and not reason and self.view.armed:
            self._enter(Phase.ARMED, now_s)
        elif self.phase is Phase.UPLOADED:
            self._standing = None
        elif self.phase in (Phase.CLIMBING, Phase.FOLLOWING) and reason:
            self.land(now_s, reason)
        elif self.phase is Phase.CLIMBING and self.view.state is not None:
            if self.profile.climbs_by_command:
                self._set_path(self.placement.to_plan(self.view.state.position_m), now_s)
            self._enter(Phase.FOLLOWING, now_s)

    def _cancel_talk(self) -> None:
        if self._talk is not None and self._talk_answer is not None:
            self._talk.cancel()
            self._talk_answer.ok, self._talk_answer.reason = False, self.reason or "interrupted"
            self._talk = self._talk_answer = None

    def _enter(self, phase: Phase, now_s: float) -> None:
        if phase is not self.phase:
            self.phase, self._since_s, self._again_s = phase, now_s, -1e9
        if phase is not Phase.ARMED:
            self._standing = None
        if phase not in (Phase.CLIMBING, Phase.FOLLOWING):
            self.path, self.target, self.setpoint_sent_s = None, None, None
