"""A motion-capture server's clock on ours: within its error bar, drift followed, steps found; no packet moves it."""

# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false, reportOperatorIssue=false
from __future__ import annotations

import numpy as np
import pytest

from drivers.mocap.serverclock import ServerClock, hull_slope

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
