"""A motion-capture server's clock on ours: within its error bar, drift followed, steps found; no packet moves it."""

# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false,
# reportOperatorIssue=false
from __future__ import annotations

import re

import numpy as np
import pytest

from drivers.mocap.health import Summary, clock_text, vehicle_clock_text
from drivers.mocap.serverclock import ServerClock, ServerTime, hull_slope
from groundstation.flightdata import MOCAP_COLUMNS, Stream
from groundstation.identification.clock_steps import cut_steps
from groundstation.identification.results import Clock
from groundstation.recording.online_clock import online_clock
from groundstation.recording.recorded import Texts

SEEDS = range(12)


def run(seed: int, *, seconds: float = 60.0, drift: float = 0.0, hold_up_s: float = 0.002, exchanges: bool = True):
    """A 100 Hz stream through a jittery network with a smallest transit of 0.2 ms; (true offset, clock) at the end."""
    rng, clock = np.random.default_rng(seed), ServerClock()
    offset = float(rng.uniform(-1e4, 1e9))
    errors, bars = [], []
    if not exchanges:
        clock.round_trip(6e-4)
    for host in 1000.0 + np.arange(0.0, seconds, 0.01):
        server = (1.0 + drift) * host + offset
        sent = server
        arrival = host + 2e-4 + rng.exponential(hold_up_s)
        assert not clock.arrival(sent, arrival), f"seed {seed}: a step where there was none"
        if exchanges and rng.random() < 0.05:
            out, back = 2e-4 + rng.exponential(hold_up_s, 2)
            assert not clock.exchange(host - out, server, host + back)
        if host > 1020.0:
            errors.append(clock.now.host_s(server) - host)
            bars.append(clock.now.error_s)
    return np.array(errors), np.array(bars), clock


@pytest.mark.parametrize("exchanges", [True, False], ids=["asked both ways", "bounded by a round trip"])
@pytest.mark.parametrize("drift", [0.0, 5e-5], ids=["even clocks", "50 ppm"])
def test_the_error_bar_holds_and_is_below_half_a_millisecond(exchanges, drift):
    inside, size = [], []
    for seed in SEEDS:
        errors, bars, _ = run(seed, drift=drift, exchanges=exchanges)
        inside.append(np.mean(np.abs(errors) <= bars))
        size.append(np.quantile(np.abs(errors), 0.95))
    print(f"seeds {SEEDS}: inside {np.mean(inside):.3f}, 95 % within {1e3 * np.max(size):.3f} ms")
    assert np.mean(inside) > 0.95
    assert max(size) < 5e-4


def test_packets_that_are_late_for_two_seconds_are_congestion_and_no_step():
    clock = ServerClock()
    for host in np.arange(0.0, 20.0, 0.01):
        late = 0.08 if 10.0 < host < 12.0 else 0.0
        assert not clock.arrival(host + 5.0, host + 0.0003 + late)
    assert clock.steps == 0
    assert clock.now.offset_s == pytest.approx(-5.0, abs=1e-3)


@pytest.mark.parametrize("step_s", [-500.0, -0.2, -0.02, 0.02, 3.0], ids=lambda s: f"{s:+g} s")
def test_a_step_is_found_and_what_was_known_is_dropped(step_s):
    clock, offset = ServerClock(), 7.0
    found_s = None
    for host in np.arange(0.0, 20.0, 0.01):
        offset = 7.0 + (step_s if host >= 10.0 else 0.0)
        if clock.arrival(host + offset, host + 0.0004) and found_s is None:
            found_s = host - 10.0
    assert clock.steps == 1
    assert 0.0 <= found_s < 3.0
    assert clock.now.offset_s == pytest.approx(-offset, abs=1e-3)


def test_an_answer_shows_a_step_at_once_that_arrivals_would_show_late():
    clock = ServerClock()
    for host in np.arange(0.0, 5.0, 0.01):
        clock.arrival(host + 7.0, host + 0.0004)
    assert clock.exchange(5.0, 5.0005 + 6.98, 5.001), "20 ms back, which late arrivals show after seconds"


def test_a_stamp_is_never_later_than_its_arrival():
    clock = ServerClock()
    rng = np.random.default_rng(3)
    for host in np.arange(0.0, 10.0, 0.005):
        arrival = host + rng.exponential(0.003)
        clock.arrival(host, arrival)
        assert clock.host_s(host, arrival) <= arrival


def test_the_hull_finds_the_slope_under_late_packets():
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 40.0)
    late = rng.exponential(0.004, len(t))
    late[::5] = 0.0
    assert hull_slope([(x, 3e-5 * x + y) for x, y in zip(t, late, strict=True)]) == pytest.approx(3e-5, abs=2e-7)


def stamped(step_s: float = 0.0, at_s: float = 12.0, seed: int = 4) -> Stream:
    """Twenty seconds of poses at 120 Hz, their arrivals, and a clock that is set while they come."""
    rng = np.random.default_rng(seed)
    true = np.arange(0.0, 20.0, 1.0 / 120.0)
    late = 0.005 + rng.exponential(0.002, len(true))
    stamps = true + 300.0 + np.where(true > at_s, step_s, 0.0)
    return Stream(stamps, np.stack([true, *[np.zeros_like(true)] * 6], axis=-1), MOCAP_COLUMNS, true + late)


@pytest.mark.parametrize("step_s", [-3.0, -0.05, 0.03, 0.2, 40.0], ids=lambda s: f"{s:+g} s")
def test_a_step_within_a_recording_is_found_and_cut(step_s):
    whole, notes = cut_steps(stamped(step_s))
    (note,) = notes
    told_ms = float(re.search(r"stepped by ([-+]\d+) ms", note)[1])
    assert told_ms == pytest.approx(1e3 * step_s, abs=2.0)
    assert len(whole) > 2380
    np.testing.assert_allclose(whole.t_s - whole.values[:, 0], 300.0, atol=1.5e-3)


def test_a_recording_without_a_step_is_left_as_it_is():
    for seed in range(5):
        stream = stamped(seed=seed)
        assert cut_steps(stream) == (stream, []), f"seed {seed}"
    congested = stamped()
    congested.received_s[1200:1300] += 0.3
    assert cut_steps(congested)[1] == []


def test_what_the_link_knew_in_flight_is_read_from_its_events():
    summary = Summary(120.0, 0.005, 0.008, 1e-5, 0, 0.0, 0.01, 0.0005)
    line = clock_text(ServerTime(12.5, 3.0, 2.5e-5, 1e-4, "two-way", 1), 3e-4, summary)
    rows = [("clock", line + vehicle_clock_text(4000.0 + 1e-4 * n, 2e-4)) for n in range(5)]
    events = Texts(np.arange(5.0), (*rows[:2], ("mocap", "stepped"), *rows[3:]), ("kind", "text"))
    online = online_clock(events)
    assert online.at(3.5) == (pytest.approx(4000.00035), pytest.approx(5e-4))
    assert online.steps == 1
    assert online_clock(None) is None
    clock = Clock(4000.0002, 1e-4, online_s=4000.00035, online_error_s=5e-4)
    assert clock.agrees
    assert not Clock(4000.003, 1e-4, online_s=4000.0, online_error_s=5e-4).agrees
    assert Clock(1.0, 1e-4).agrees is None
