"""The flight sequence as a state machine: events in, actions out. It holds no socket, process, thread or clock.

    idle -> planned -> uploaded -> checked -> airborne -> exciting -> landing -> landed -> identifying -> done
              any state before ``landed`` -> (landing ->) aborted

Rules that hold whatever arrives, in whatever order (tests/test_flight_sequence.py lets Hypothesis try to break them):

* the vehicle is asked to arm only in ``checked``, and ``exciting`` is reached only from ``airborne``;
* an abort on the ground ends in ``aborted`` at once; once the vehicle was told to start, it goes through ``landing``;
* every state that waits for somebody else has a deadline, so silence also ends the flight;
* the status says 4 only of a vehicle that was seen on the ground, or never left it; of any other 5: it may still be
  flying;
* ``done`` and ``aborted`` are final, and the recording is closed exactly once on the way to them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

from groundstation.errors import FlightAborted, LinkLost, Refused


class Phase(StrEnum):
    """Where the flight is."""

    IDLE = "idle"
    PLANNED = "planned"
    UPLOADED = "uploaded"
    CHECKED = "checked"
    AIRBORNE = "airborne"
    EXCITING = "exciting"
    LANDING = "landing"
    LANDED = "landed"
    IDENTIFYING = "identifying"
    DONE = "done"
    ABORTED = "aborted"


IN_FLIGHT = frozenset({Phase.AIRBORNE, Phase.EXCITING, Phase.LANDING})
FINAL = frozenset({Phase.DONE, Phase.ABORTED})


class Do(StrEnum):
    """What the core is asked to do."""

    UPLOAD = "upload"
    CHECK = "check"
    START = "start"
    ABORT = "abort"
    KILL = "kill"
    LAND = "land"
    DISARM = "disarm"
    CLOSE_RECORDING = "close_recording"
    ANALYSE = "analyse"
    FINISH = "finish"


@dataclass(frozen=True, slots=True)
class Action:
    """Something to do, and why in one sentence."""

    do: Do
    reason: str = ""


# Events ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PlanChosen:
    """A plan is there; its whole path, take-off and landing included, takes ``duration_s``."""

    duration_s: float


@dataclass(frozen=True, slots=True)
class UploadAnswered:
    """The vehicle took the plan, or refused it."""

    ok: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class ChecksAnswered:
    """Preflight is over."""

    ok: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class StartRequested:
    """The operator wants to fly."""


@dataclass(frozen=True, slots=True)
class AbortRequested:
    """Somebody wants it to end now. Everyone may; with the rotors off, wherever it is believed to be, the operator."""

    reason: str
    rotors_off: bool = False


@dataclass(frozen=True, slots=True)
class LandRequested:
    """The operator has seen enough: land, and use what was recorded."""


@dataclass(frozen=True, slots=True)
class VehicleAirborne:
    """The vehicle left the ground."""


@dataclass(frozen=True, slots=True)
class VehicleExciting:
    """The vehicle began the excitation."""


@dataclass(frozen=True, slots=True)
class VehicleLanding:
    """The vehicle is on its way down; with a reason when it was not the plan's end that brought it there."""

    abort_reason: str = ""


@dataclass(frozen=True, slots=True)
class VehicleLanded:
    """The vehicle stands on the ground, disarmed; with a reason when it came down early, and its landing was not heard
    of.
    """

    abort_reason: str = ""


@dataclass(frozen=True, slots=True)
class VehicleStands:
    """The vehicle stands disarmed, although it was told to start: what was asked of it at arming is over."""


@dataclass(frozen=True, slots=True)
class LinkDied:
    """The vehicle's process ended or hung in flight; another was started, which lands the vehicle."""

    reason: str


@dataclass(frozen=True, slots=True)
class TakenOver:
    """This core found a vehicle in flight and is to bring it down; its plan takes ``duration_s``."""

    reason: str
    duration_s: float


@dataclass(frozen=True, slots=True)
class VehicleLost:
    """The vehicle's process or link is gone for good.

    Attributes:
        reason: in one sentence.
        down: with the vehicle on the ground, e.g. crashed.
        refused: it said no, and ended.
    """

    reason: str
    down: bool = False
    refused: bool = False


@dataclass(frozen=True, slots=True)
class StartRefused:
    """The vehicle denied arming or starting."""

    reason: str


@dataclass(frozen=True, slots=True)
class AnalysisFinished:
    """The worker is done; ``exit_status`` as in docs/formats.md."""

    exit_status: int
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passed."""


Event = (
    PlanChosen
    | UploadAnswered
    | ChecksAnswered
    | StartRequested
    | AbortRequested
    | LandRequested
    | VehicleAirborne
    | VehicleExciting
    | VehicleLanding
    | VehicleLanded
    | VehicleLost
    | VehicleStands
    | LinkDied
    | TakenOver
    | StartRefused
    | AnalysisFinished
    | Tick
)


@dataclass(frozen=True, slots=True)
class Deadlines:
    """How long each wait may take, seconds of the clock that :func:`step` is given."""

    upload_s: float = 20.0
    checks_s: float = 120.0
    operator_s: float = 1800.0
    take_off_s: float = 60.0
    slack: float = 1.5
    landing_s: float = 60.0
    analysis_s: float = 600.0


@dataclass(frozen=True, slots=True)
class Sequence:
    """State of the sequence.

    Attributes:
        phase: where it is.
        since_s: when it came there.
        plan_s: duration of the path that was planned.
        started: the vehicle was told to start and has not been seen landed since.
        excited: the excitation began: what was flown of it is analysed, however the flight ends.
        aborting: why the flight is being ended early; empty if it is not.
        exit_status: of the process, once final.
        reason: the sentence that explains the final phase.
    """

    phase: Phase = Phase.IDLE
    since_s: float = 0.0
    plan_s: float = 0.0
    started: bool = False
    excited: bool = False
    aborting: str = ""
    exit_status: int | None = None
    reason: str = ""
    deadlines: Deadlines = Deadlines()

    @property
    def final(self) -> bool:
        """Nothing more will happen."""
        return self.phase in FINAL


GIVEN_UP = "the analysis was given up"
"""What is said of a flight that is down and recorded, and whose analysis somebody ended."""
MAY_FLY = "the link died; the vehicle may still be flying: go and look, with the remote control at hand"
"""What is said of a vehicle that nobody saw on the ground."""

Result = tuple[Sequence, tuple[Action, ...]]


def step(state: Sequence, event: Event, now_s: float) -> Result:
    """The next state and what to do, given an event and the time at which it arrived."""
    if state.final:
        return state, ()
    if isinstance(event, AbortRequested):
        return _abort(state, event.reason, now_s, rotors_off=event.rotors_off)
    if isinstance(event, VehicleLost):
        return _lost(state, event, now_s)
    if isinstance(event, LinkDied):
        if not state.started:
            return _lost(state, VehicleLost(event.reason), now_s)
        return _led_down(state, event.reason, now_s)
    if isinstance(event, TakenOver):
        return _led_down(replace(state, plan_s=event.duration_s), event.reason, now_s)
    if isinstance(event, Tick):
        overdue = _overdue(state, now_s)
        return (state, ()) if overdue is None else overdue
    return _BY_PHASE[state.phase](state, event, now_s)


def _enter(state: Sequence, phase: Phase, now_s: float, *actions: Action, **changes: object) -> Result:
    return replace(state, phase=phase, since_s=now_s, **changes), actions  # type: ignore[arg-type]


def _aborted(
    state: Sequence, reason: str, now_s: float, *before: Action, status: int = FlightAborted.exit_status
) -> Result:
    """Final: close the recording and end with the status of an aborted flight, or of a refusal to fly."""
    actions = (*before, Action(Do.CLOSE_RECORDING), Action(Do.FINISH, reason))
    return _enter(state, Phase.ABORTED, now_s, *actions, started=False, exit_status=status, reason=reason)


def _refused(state: Sequence, reason: str, now_s: float) -> Result:
    """It never flew, because something said no: final, with the status of a refusal."""
    return _aborted(state, reason, now_s, Action(Do.DISARM, reason), status=Refused.exit_status)


def _abort(state: Sequence, reason: str, now_s: float, *, rotors_off: bool = False) -> Result:
    kill = Action(Do.KILL, reason)
    if state.phase in (Phase.LANDED, Phase.IDENTIFYING):
        # On the ground with the recording closed: only the analysis is given up.
        why = "; ".join(filter(None, (state.aborting, f"{GIVEN_UP}: {reason}")))
        actions = ((kill,) if rotors_off else ()) + (Action(Do.FINISH, why),)
        return _enter(state, Phase.ABORTED, now_s, *actions, exit_status=FlightAborted.exit_status, reason=why)
    if not state.started:
        return _aborted(state, reason, now_s, kill if rotors_off else Action(Do.DISARM, reason))
    stop = kill if rotors_off else Action(Do.ABORT, reason)
    if state.phase is Phase.LANDING:
        # Say it again: the first request may have been lost, and repeating it is harmless.
        return replace(state, aborting=state.aborting or reason), (stop,)
    return _enter(state, Phase.LANDING, now_s, stop, aborting=reason)


def _lost(state: Sequence, event: VehicleLost, now_s: float) -> Result:
    if state.phase in (Phase.LANDED, Phase.IDENTIFYING):
        return state, ()
    reason = "; ".join(filter(None, (state.aborting, event.reason)))
    if state.started and not event.down:
        return _aborted(state, f"{reason}; {MAY_FLY}", now_s, status=LinkLost.exit_status)
    if event.refused and not state.started:
        return _aborted(state, reason, now_s, status=Refused.exit_status)
    return _aborted(state, reason, now_s)


def _led_down(state: Sequence, reason: str, now_s: float) -> Result:
    """Somebody else brings it down already: wait for the ground."""
    if state.phase in (Phase.LANDED, Phase.IDENTIFYING):
        return state, ()
    since_s = state.since_s if state.phase is Phase.LANDING else now_s
    return replace(state, phase=Phase.LANDING, since_s=since_s, started=True, aborting=state.aborting or reason), ()


def _overdue(state: Sequence, now_s: float) -> Result | None:
    wait, limits = now_s - state.since_s, state.deadlines
    if state.phase is Phase.PLANNED and wait > limits.upload_s:
        return _abort(state, f"the vehicle did not answer the upload within {limits.upload_s:g} s", now_s)
    if state.phase is Phase.UPLOADED and wait > limits.checks_s:
        return _abort(state, f"the checks were not over within {limits.checks_s:g} s", now_s)
    if state.phase is Phase.CHECKED and not state.started and wait > limits.operator_s:
        return _abort(state, f"nobody started the flight within {limits.operator_s:g} s", now_s)
    if state.phase is Phase.CHECKED and state.started and wait > limits.take_off_s:
        return _abort(state, f"the vehicle did not leave the ground within {limits.take_off_s:g} s", now_s)
    if state.phase in (Phase.AIRBORNE, Phase.EXCITING):
        allowed = limits.slack * state.plan_s + limits.take_off_s
        if wait > allowed:
            return _abort(
                state, f"the flight was still {state.phase} after {allowed:.0f} s, longer than its plan", now_s
            )
    if state.phase is Phase.LANDING and wait > limits.slack * state.plan_s + limits.landing_s:
        reason = f"{state.aborting or 'the plan had ended'}; the landing was not confirmed: {MAY_FLY}"
        return _aborted(state, reason, now_s, Action(Do.LAND, reason), status=LinkLost.exit_status)
    if state.phase is Phase.IDENTIFYING and wait > limits.analysis_s:
        return _finish(state, 1, f"the analysis did not end within {limits.analysis_s:g} s", now_s)
    return None


def _finish(state: Sequence, exit_status: int, reason: str, now_s: float) -> Result:
    if state.aborting:  # what was flown has been analysed; it is an aborted flight all the same
        why = f"{state.aborting}; of what was flown: {reason}" if reason else state.aborting
        finish = Action(Do.FINISH, why)
        return _enter(state, Phase.ABORTED, now_s, finish, exit_status=FlightAborted.exit_status, reason=why)
    return _enter(state, Phase.DONE, now_s, Action(Do.FINISH, reason), exit_status=exit_status, reason=reason)


def _idle(state: Sequence, event: Event, now_s: float) -> Result:
    if isinstance(event, PlanChosen):
        return _enter(state, Phase.PLANNED, now_s, Action(Do.UPLOAD), plan_s=event.duration_s)
    return state, ()


def _planned(state: Sequence, event: Event, now_s: float) -> Result:
    if isinstance(event, UploadAnswered):
        if not event.ok:
            return _refused(state, f"the vehicle refused the plan: {event.reason}", now_s)
        return _enter(state, Phase.UPLOADED, now_s, Action(Do.CHECK))
    return state, ()


def _uploaded(state: Sequence, event: Event, now_s: float) -> Result:
    if isinstance(event, ChecksAnswered):
        if not event.ok:
            return _refused(state, f"preflight failed: {event.reason}", now_s)
        return _enter(state, Phase.CHECKED, now_s)
    return state, ()


def _checked(state: Sequence, event: Event, now_s: float) -> Result:
    if isinstance(event, StartRequested) and not state.started:
        return _enter(state, Phase.CHECKED, now_s, Action(Do.START), started=True)
    if not state.started:
        return state, ()
    if isinstance(event, StartRefused):
        return _refused(state, f"the vehicle refused to start: {event.reason}", now_s)
    if isinstance(event, VehicleAirborne):
        return _enter(state, Phase.AIRBORNE, now_s)
    if isinstance(event, VehicleExciting):
        return _abort(state, "the vehicle began the excitation before it was seen airborne", now_s)
    if isinstance(event, LandRequested):
        return _enter(state, Phase.LANDING, now_s, Action(Do.LAND))
    return _coming_down(state, event, now_s)


def _airborne(state: Sequence, event: Event, now_s: float) -> Result:
    if isinstance(event, VehicleExciting) and state.phase is Phase.AIRBORNE:
        return _enter(state, Phase.EXCITING, now_s, excited=True)
    if isinstance(event, LandRequested):
        return _enter(state, Phase.LANDING, now_s, Action(Do.LAND))
    return _coming_down(state, event, now_s)


def _coming_down(state: Sequence, event: Event, now_s: float) -> Result:
    """What the vehicle may do by itself at any time once started."""
    if isinstance(event, VehicleLanding):
        return _enter(state, Phase.LANDING, now_s, aborting=state.aborting or event.abort_reason)
    if isinstance(event, VehicleLanded):
        aborting = state.aborting or (
            event.abort_reason if state.phase is Phase.EXCITING else "the vehicle landed before the excitation"
        )
        return _landed(replace(state, aborting=aborting), now_s)
    return state, ()


def _landing(state: Sequence, event: Event, now_s: float) -> Result:
    if isinstance(event, VehicleLanding) and event.abort_reason and not state.aborting:
        return replace(state, aborting=event.abort_reason), ()
    if isinstance(event, VehicleLanded):
        return _landed(state, now_s)
    if isinstance(event, VehicleStands) and state.aborting:
        return _aborted(state, f"{state.aborting}; the vehicle is disarmed and did not take off", now_s)
    return state, ()


def _landed(state: Sequence, now_s: float) -> Result:
    if state.aborting and not state.excited:
        return _aborted(state, state.aborting, now_s)
    landed, _ = _enter(state, Phase.LANDED, now_s, started=False)
    return landed, (Action(Do.CLOSE_RECORDING), Action(Do.ANALYSE))


def _on_ground(state: Sequence, event: Event, now_s: float) -> Result:
    if isinstance(event, AnalysisFinished):
        return _finish(state, event.exit_status, event.reason, now_s)
    return state, ()


def analysing(state: Sequence, now_s: float) -> Sequence:
    """``landed`` becomes ``identifying`` once the core has the worker running on a closed recording."""
    return replace(state, phase=Phase.IDENTIFYING, since_s=now_s) if state.phase is Phase.LANDED else state


_BY_PHASE = {
    Phase.IDLE: _idle,
    Phase.PLANNED: _planned,
    Phase.UPLOADED: _uploaded,
    Phase.CHECKED: _checked,
    Phase.AIRBORNE: _airborne,
    Phase.EXCITING: _airborne,
    Phase.LANDING: _landing,
    Phase.LANDED: _on_ground,
    Phase.IDENTIFYING: _on_ground,
}
