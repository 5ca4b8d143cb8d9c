"""Multisines are orthogonal and flat, sweeps sweep, everything rests at its ends and keeps the limits; the table is
fair.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.paths import find_config
from groundstation.planning.compare import compare_families
from groundstation.planning.limits import envelope, series_excesses
from groundstation.planning.plan import PAPER_START, paper_problem
from groundstation.planning.problem import Problem
from groundstation.planning.signals import _low_peak_phases, families, family_series
from groundstation.trajectory import rigid_motion
from groundstation.vehicle import Vehicle, load_vehicle

FAMILIES = {family.name: family for family in families(1.0)}


def problem(vehicle: Vehicle, duration_s: float = 40.0) -> Problem:
    return Problem((vehicle,), (envelope(vehicle),), "A", 5, 1.0, duration_s)


@pytest.fixture(scope="module")
def qball() -> Vehicle:
    return paper_problem()["vehicle"]


@pytest.fixture(scope="module")
def made(qball):
    return {name: family_series(family, problem(qball)) for name, family in FAMILIES.items()}


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_keeps_the_limits_uses_them_and_rests_at_its_ends(name, made, qball):
    series = made[name]
    over = series_excesses(series, envelope(qball))
    assert max(over.values()) <= 1e-6
    bounds = envelope(qball).stated()
    assert max(excess / bounds[name] for name, excess in over.items() if bounds[name] > 0.0) > -0.05
    ends = series.derivatives([0.0, series.period_s], 2)
    assert ends[0, 0] == pytest.approx(ends[0, 1], abs=1e-9)
    assert ends[1:] == pytest.approx(0.0, abs=1e-9)
    assert (40.0 / series.period_s) == pytest.approx(round(40.0 / series.period_s))


def test_multisine_channels_share_no_harmonic_so_their_accelerations_are_orthogonal(made):
    series = made["multisine"]
    t = np.arange(4000) / 4000 * series.period_s
    acceleration = series.derivatives(t, 2)[2]
    gram = acceleration.T @ acceleration
    assert gram == pytest.approx(np.diag(np.diag(gram)), abs=1e-9 * gram.max())


def test_clipping_lowers_the_peak_factor_below_schroeder_and_far_below_zero_phase():
    harmonics = np.arange(5, 41, 4)
    order = np.arange(1, len(harmonics) + 1)
    schroeder = -np.pi * order * (order - 1) / len(harmonics)
    basis = np.exp(2j * np.pi * np.outer(np.arange(2000), harmonics) / 2000)

    def peak_factor(phase):
        signal = np.real(basis @ np.exp(1j * phase))
        return np.abs(signal).max() / np.sqrt(np.mean(signal**2))

    best = peak_factor(_low_peak_phases(harmonics, schroeder))
    assert best < peak_factor(schroeder)
    assert best < 0.6 * peak_factor(np.zeros(len(harmonics)))


def test_a_sweep_moves_one_channel_at_a_time_from_slow_to_fast(made):
    series = made["sweep"]
    t = np.linspace(0.0, series.period_s, 8000, endpoint=False)
    acceleration = np.abs(series.derivatives(t, 2)[2, :, :3])
    for channel in range(3):
        quarter = (t >= 10.0 * channel) & (t < 10.0 * (channel + 1))
        share = np.sum(acceleration[quarter, channel] ** 2) / np.sum(acceleration[:, channel] ** 2)
        assert share > 0.9
        signal = series.derivatives(t[quarter], 2)[2, :, channel]
        half_periods = np.diff(np.flatnonzero(np.diff(np.sign(signal))))
        assert half_periods[-4:].mean() < 0.5 * half_periods.max()
        assert np.argmax(half_periods) < len(half_periods) // 2


def test_attitude_multisines_hardly_move_the_vehicle(made, qball):
    motion = rigid_motion(made["attitude"].sample(np.linspace(0.0, 20.0, 5000)), qball.gravity_m_s2)
    assert np.ptp(motion.position_m[:, :2], axis=0).max() < 0.15
    assert np.abs(motion.euler_rad[:, :2]).max() > 0.03


def test_too_short_a_flight_is_refused_with_the_time_it_takes(qball):
    with pytest.raises(BadInput, match=r"10 s are too short for a multisine from 0.2 to 1 Hz; fly it for about"):
        family_series(FAMILIES["multisine"], problem(qball, duration_s=10.0))


def test_the_table_ranks_families_by_the_worst_inertia_and_flags_what_exceeds_a_limit(qball):
    table = compare_families(
        qball,
        harmonics=3,
        base_frequency_rad_s=paper_problem()["base_frequency_rad_s"],
        start=PAPER_START,
        time_budget_s=0.1,
    )
    names = [entry.family for entry in table.entries]
    assert set(names) == {"series", "series, free", "multisine", "sweep", "attitude", "paper"}
    worst = [entry.inertia_percent for entry in table.entries]
    assert worst == sorted(worst)
    over = {entry.family for entry in table.entries if entry.largest_violation > 1e-6}
    assert over == {"paper"}
    document = json.loads(json.dumps(table.to_dict(), allow_nan=False))
    assert [row["family"] for row in document["families"]] == names
    text = table.to_text()
    assert all(name in text for name in names)
    assert "exceeds a limit" in text


def test_families_fit_a_small_vehicle_by_its_rotors():
    vehicle = load_vehicle(find_config("vehicles", "crazyflie21"))
    series = family_series(FAMILIES["attitude"], problem(vehicle))
    assert max(series_excesses(series, envelope(vehicle)).values()) <= 1e-6
