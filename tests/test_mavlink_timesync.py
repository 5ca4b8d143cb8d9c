"""Clock fits with planted drift, offset, jitter and quantisation; parameters' two encodings; conversations'
patience.
"""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink.dialect import mavlink
from drivers.mavlink.exchange import Ask, Conversation, listen
from drivers.mavlink.parameters import decode_value, encode_value
from drivers.mavlink.timesync import Timesync


def exchanges(
    sync: Timesync, *, rate: float, offset: float, seconds: float, seed: int = 1, quantum: float = 0.0
) -> float:
    """TIMESYNC at 10 Hz over ways of 1 ms and exponential delays of 3 ms each; the last host time."""
    rng = random.Random(seed)
    for n in range(int(seconds * 10)):
        sent = 50.0 + n / 10
        there = sent + 0.001 + rng.expovariate(1 / 0.003)
        device = offset + rate * there
        device -= device % quantum if quantum else 0.0
        sync.add(sent, device, there + 0.001 + rng.expovariate(1 / 0.003))
    return 50.0 + seconds


@pytest.mark.parametrize("rate", [0.988, 1.0, 1.002])
def test_planted_drift_and_offset_come_back_within_the_error_bar(rate):
    sync = Timesync()
    now = exchanges(sync, rate=rate, offset=-40.0, seconds=25.0)
    fit = sync.fit()
    assert fit.rate == pytest.approx(rate, abs=4 * fit.rate_std + 1e-5)
    assert abs(fit.device(now) - (-40.0 + rate * now)) < 3 * fit.error_s(now)
    assert fit.error_s(now) < 0.003


def test_the_error_bar_covers_the_truth_in_most_runs_and_is_not_lavish():
    covered, bars = 0, []
    for seed in range(60):
        sync = Timesync()
        now = exchanges(sync, rate=0.9995, offset=7.0, seconds=8.0, seed=seed)
        error = abs(sync.fit().device(now) - (7.0 + 0.9995 * now))
        covered += error <= sync.error_s(now)
        bars.append(sync.error_s(now))
    assert covered >= 41  # at least one standard error
    assert max(bars) < 0.006


def test_a_clock_that_moves_in_steps_of_four_milliseconds_is_still_known():
    sync = Timesync(quantum_s=0.004)
    now = exchanges(sync, rate=0.988, offset=0.0, seconds=25.0, quantum=0.004)
    assert abs(sync.fit().device(now) - (0.988 * now - 0.002)) < 0.002


def test_a_line_beats_an_offset_where_the_clock_drifts():
    sync = Timesync()
    now = exchanges(sync, rate=0.988, offset=0.0, seconds=25.0)
    assert abs(sync.fit().device(now + 2.0) - 0.988 * (now + 2.0)) < 0.003, "an offset alone would be wrong by 24 ms"


def test_a_restart_drops_what_was_known():
    sync = Timesync()
    now = exchanges(sync, rate=1.0, offset=1000.0, seconds=5.0)
    sync.add(now + 1.0, 0.5, now + 1.002)
    assert sync.resets == 1
    assert sync.fit().device(now + 1.001) == pytest.approx(0.5, abs=1e-6)


def test_a_way_there_and_back():
    sync = Timesync()
    now = exchanges(sync, rate=0.988, offset=3.0, seconds=10.0)
    fit = sync.fit()
    assert fit.host(fit.device(now)) == pytest.approx(now)


def test_impossible_exchanges_are_refused_and_nothing_known_is_infinite_doubt():
    sync = Timesync()
    assert not sync.add(10.0, 1.0, 9.9)
    assert not sync.add(10.0, 1.0, 20.0)
    assert sync.fit() is None
    assert sync.error_s(10.0) == float("inf")


@given(
    st.integers(-(2**31), 2**31 - 1).filter(
        lambda v: (v & 0x7F800000) != 0x7F800000
    ),  # NaN's bits do not survive a float
)
@settings(max_examples=100, deadline=None)
def test_integers_survive_as_bits_in_a_float(value):
    kind = mavlink.MAV_PARAM_TYPE_INT32
    assert decode_value(encode_value(value, kind, bytewise=True), kind, bytewise=True) == value


def test_the_two_encodings_differ_as_the_autopilots_do():
    kind = mavlink.MAV_PARAM_TYPE_INT32
    assert encode_value(4, kind, bytewise=False) == 4.0
    assert 0.0 < encode_value(4, kind, bytewise=True) < 1e-40
    assert encode_value(0.25, mavlink.MAV_PARAM_TYPE_REAL32, bytewise=True) == 0.25


def question(answers: list):
    def steps():
        answers.append((yield Ask(("hello",), lambda m: m == "good", timeout_s=1.0, tries=3)))
        answers.append((yield listen(lambda m: m == "late", 2.0)))
        return "done"

    return steps()


def test_a_question_is_asked_again_until_its_tries_are_spent():
    answers: list = []
    talk = Conversation(question(answers))
    sent = [(t / 10, m) for t in range(60) for m in talk.step(t / 10, [])]
    assert [t for t, _ in sent] == pytest.approx([0.0, 1.0, 2.0])
    assert answers == [None, None]
    assert talk.done
    assert talk.result == "done"


def test_the_answer_is_told_from_other_messages_and_is_taken_at_once():
    answers: list = []
    talk = Conversation(question(answers))
    talk.step(0.0, [])
    assert talk.step(0.1, ["bad", "good", "late"]) == []
    assert answers == ["good", "late"]


def test_a_conversation_that_fails_keeps_its_error_and_ends():
    def steps():
        yield Ask((), lambda _m: False, 0.1, 1)
        raise ValueError("no")

    talk = Conversation(steps())
    talk.step(0.0, [])
    talk.step(1.0, [])
    assert talk.done
    assert str(talk.error) == "no"
