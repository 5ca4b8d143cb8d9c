"""The flight sequence: its rules, tried with every order of events Hypothesis can think of."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from groundstation.flight import sequence as seq
from groundstation.flight.sequence import Do, Phase

GOOD = (
    seq.PlanChosen(40.0),
    seq.UploadAnswered(True),
    seq.ChecksAnswered(True),
    seq.StartRequested(),
    seq.VehicleAirborne(),
    seq.VehicleExciting(),
    seq.VehicleLanding(),
    seq.VehicleLanded(),
)
STARTED = 4
EXCITED = 6
REASONS = st.sampled_from(["", "low battery", "operator"])
EVENTS = st.one_of(
    st.builds(seq.PlanChosen, st.floats(1.0, 100.0)),
    st.builds(seq.UploadAnswered, st.booleans(), REASONS),
    st.builds(seq.ChecksAnswered, st.booleans(), REASONS),
    st.just(seq.StartRequested()),
    st.builds(seq.AbortRequested, st.sampled_from(["Ctrl-C", "operator"]), st.booleans()),
    st.just(seq.LandRequested()),
    st.just(seq.VehicleAirborne()),
    st.just(seq.VehicleExciting()),
    st.builds(seq.VehicleLanding, REASONS),
    st.just(seq.VehicleLanded()),
    st.builds(seq.VehicleLost, st.just("link gone")),
    st.builds(seq.LinkDied, st.just("link killed")),
    st.just(seq.VehicleStands()),
    st.builds(seq.StartRefused, st.just("not armable")),
    st.builds(seq.AnalysisFinished, st.sampled_from([0, 1, 2, 3])),
    st.just(seq.Tick()),
)


def run(events, state=None, start_s=0.0):
    """Feed events a second apart; the last state and all actions."""
    state, actions = state or seq.Sequence(), []
    for index, event in enumerate(events):
        state, more = seq.step(state, event, start_s + index)
        actions += more
    return state, [action.do for action in actions]


def analysed(state):
    """The same once the analysis of what was flown is over."""
    assert state.phase is Phase.LANDED
    return run([seq.AnalysisFinished(0)], seq.analysing(state, 90.0), 91.0)[0]


def test_a_good_flight_does_each_thing_once_and_in_order():
    state, done = run(GOOD)
    assert state.phase is Phase.LANDED
    assert done == [Do.UPLOAD, Do.CHECK, Do.START, Do.CLOSE_RECORDING, Do.ANALYSE]
    state, done = run([seq.AnalysisFinished(0)], seq.analysing(state, 8.0), 9.0)
    assert (state.phase, state.exit_status, done) == (Phase.DONE, 0, [Do.FINISH])


@pytest.mark.parametrize("reached", range(len(GOOD) + 1))
def test_an_abort_from_anywhere_ends_aborted_and_in_flight_only_after_landing(reached):
    state, _ = run(GOOD[:reached])
    airborne = state.started
    state, done = run([seq.AbortRequested("Ctrl-C")], state, 100.0)
    if airborne:
        assert state.phase is Phase.LANDING and done == [Do.ABORT]
        state, done = run([seq.VehicleLanded()], state, 110.0)
    flown = EXCITED <= reached < len(GOOD)
    if flown:
        assert done == [Do.CLOSE_RECORDING, Do.ANALYSE], "what was flown is analysed like any flight"
        state, done = run([seq.AnalysisFinished(0, "identified by IV")], seq.analysing(state, 111.0), 112.0)
    assert (state.phase, state.exit_status) == (Phase.ABORTED, 4)
    assert done[-1] is Do.FINISH
    on_ground = "the analysis was given up: Ctrl-C"
    assert state.reason == (
        "Ctrl-C; of what was flown: identified by IV" if flown else on_ground if reached == len(GOOD) else "Ctrl-C"
    )


@pytest.mark.parametrize(
    "refusal",
    [
        (GOOD[:1], seq.UploadAnswered(False, "tilt too large"), "tilt too large"),
        (GOOD[:2], seq.ChecksAnswered(False, "battery empty"), "battery empty"),
        (GOOD[:4], seq.StartRefused("accelerometer inconsistent"), "accelerometer inconsistent"),
    ],
)
def test_a_refusal_to_fly_has_the_status_of_a_refusal_and_its_reason(refusal):
    before, event, why = refusal
    state, done = run([*before, event])
    assert (state.phase, state.exit_status) == (Phase.ABORTED, 3)
    assert why in state.reason
    assert done[-3:] == [Do.DISARM, Do.CLOSE_RECORDING, Do.FINISH]


@pytest.mark.parametrize("reached", range(1, len(GOOD)))
def test_silence_also_ends_the_flight(reached):
    state, _ = run(GOOD[:reached])
    now = 10.0
    for _ in range(3):
        now += 10_000.0
        state, _ = run([seq.Tick()], state, now)
    assert state.phase is Phase.ABORTED
    assert state.exit_status == (5 if reached >= STARTED else 4)


@pytest.mark.parametrize("reached", range(1, len(GOOD)))
def test_a_lost_vehicle_closes_the_recording(reached):
    state, done = run([*GOOD[:reached], seq.VehicleLost("process ended")])
    assert (state.phase, done.count(Do.CLOSE_RECORDING)) == (Phase.ABORTED, 1)


@pytest.mark.parametrize("reached", range(1, len(GOOD)))
@pytest.mark.parametrize("down", [True, False])
def test_a_lost_vehicle_that_was_started_and_not_seen_down_may_still_fly(reached, down):
    state, _ = run([*GOOD[:reached], seq.VehicleLost("process ended", down)])
    flies = reached >= STARTED and not down
    assert state.exit_status == (5 if flies else 4)
    assert ("may still be flying" in state.reason) is flies


def test_a_landing_that_was_heard_of_only_at_its_end_is_no_complete_flight():
    state = analysed(run([*GOOD[:6], seq.VehicleLanded("the core is gone")])[0])
    assert (state.phase, state.exit_status, state.reason) == (Phase.ABORTED, 4, "the core is gone")


def test_an_abort_at_arming_ends_once_the_vehicle_shows_that_it_stands():
    state, done = run([*GOOD[:STARTED], seq.AbortRequested("Ctrl-C"), seq.VehicleStands()])
    assert (state.phase, state.exit_status, done[-1]) == (Phase.ABORTED, 4, Do.FINISH)
    assert "did not take off" in state.reason
    state, _ = run([*GOOD[:STARTED], seq.VehicleStands()])
    assert state.phase is Phase.CHECKED, "it stands until it was armed"


@pytest.mark.parametrize("reached", range(STARTED, len(GOOD) - 1))
def test_a_link_that_dies_in_flight_is_waited_for_until_its_successor_has_landed_it(reached):
    state, done = run([*GOOD[:reached], seq.LinkDied("killed")])
    assert state.phase is Phase.LANDING and Do.CLOSE_RECORDING not in done
    state, _ = run([seq.VehicleLanded()], state, 20.0)
    state = analysed(state) if reached >= EXCITED else state
    assert (state.phase, state.exit_status, state.reason) == (Phase.ABORTED, 4, "killed")


def test_a_vehicle_found_in_flight_is_waited_for_and_its_flight_is_an_aborted_one():
    state, done = run([seq.TakenOver("found in flight", 30.0), seq.VehicleLanded()])
    assert (state.phase, state.exit_status) == (Phase.ABORTED, 4)
    assert Do.START not in done and done[-2:] == [Do.CLOSE_RECORDING, Do.FINISH]


def test_excitation_before_the_climb_was_seen_is_a_fault():
    state, done = run([*GOOD[:4], seq.VehicleExciting()])
    assert state.phase is Phase.LANDING and done[-1] is Do.ABORT and "airborne" in state.aborting


def test_landing_early_on_request_keeps_what_was_recorded():
    state, done = run([*GOOD[:6], seq.LandRequested(), seq.VehicleLanded()])
    assert state.phase is Phase.LANDED
    assert done[-3:] == [Do.LAND, Do.CLOSE_RECORDING, Do.ANALYSE]


@pytest.mark.parametrize("reached", range(len(GOOD) + 1))
def test_rotors_off_goes_to_the_vehicle_once_wherever_it_is_believed_to_be(reached):
    state, _ = run(GOOD[:reached])
    state, done = run([seq.AbortRequested("rotors stopped by operator", rotors_off=True)], state, 100.0)
    assert done[0] is Do.KILL and done.count(Do.KILL) == 1
    assert Do.ABORT not in done and Do.DISARM not in done
    assert state.phase is (Phase.LANDING if state.started else Phase.ABORTED)


def test_a_vehicle_that_comes_down_by_itself_has_aborted():
    state = analysed(run([*GOOD[:6], seq.VehicleLanding("battery failsafe"), seq.VehicleLanded()])[0])
    assert (state.phase, state.exit_status, state.reason) == (Phase.ABORTED, 4, "battery failsafe")


def test_a_second_abort_is_still_an_abort():
    state, done = run([*GOOD[:6], seq.AbortRequested("Ctrl-C"), seq.AbortRequested("Ctrl-C again")])
    assert done[-2:] == [Do.ABORT, Do.ABORT] and state.aborting == "Ctrl-C"


class AnyOrder(RuleBasedStateMachine):
    """Whatever comes, in whatever order and at whatever pace, the rules of the module hold."""

    def __init__(self):
        super().__init__()
        self.state, self.now, self.seen, self.done = seq.Sequence(), 0.0, [Phase.IDLE], []

    @rule(event=EVENTS, wait=st.floats(0.0, 300.0))
    def happens(self, event, wait):
        self.now += wait
        before = self.state
        self.state, actions = seq.step(before, event, self.now)
        self.done += [action.do for action in actions]
        if self.state.phase is Phase.LANDED:
            self.state = seq.analysing(self.state, self.now)
        if self.state.phase is not self.seen[-1]:
            self.seen.append(self.state.phase)
        if before.final:
            assert self.state == before and not actions
        if Do.START in [action.do for action in actions]:
            assert before.phase is Phase.CHECKED and not before.started

    @invariant()
    def excites_only_from_the_air(self):
        for earlier, later in zip(self.seen, self.seen[1:], strict=False):
            assert later is not Phase.EXCITING or earlier is Phase.AIRBORNE
            assert later is not Phase.AIRBORNE or earlier is Phase.CHECKED

    @invariant()
    def closes_the_recording_once_and_finishes_once(self):
        assert self.done.count(Do.CLOSE_RECORDING) <= 1
        assert self.done.count(Do.FINISH) == int(self.state.final)
        assert self.done.count(Do.START) <= 1
        assert not self.state.final or Do.CLOSE_RECORDING in self.done

    @invariant()
    def ends_with_a_status_only_when_final(self):
        assert (self.state.exit_status is not None) == self.state.final
        assert self.state.phase is not Phase.DONE or Phase.IDENTIFYING in self.seen

    @invariant()
    def an_abort_now_ends_the_flight(self):
        state, _ = seq.step(self.state, seq.AbortRequested("test"), self.now)
        if not state.final:
            assert state.phase is Phase.LANDING and state.aborting
            excited = state.excited
            state, _ = seq.step(state, seq.VehicleLanded(), self.now)
            if excited:
                assert state.phase is Phase.LANDED
                state, _ = seq.step(state, seq.AbortRequested("again"), self.now)
        assert state.final


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=150, stateful_step_count=25, deadline=None)


@given(st.lists(EVENTS, max_size=30))
@settings(max_examples=100, deadline=None)
def test_steps_are_pure(events):
    assert run(events) == run(events)
