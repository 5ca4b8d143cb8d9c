"""The discriminating flight: odds that mean what they say, limits kept, refusal where nothing can tell."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.errors import Refused
from groundstation.planning.discriminate import Candidate, plan_discrimination, separation
from groundstation.planning.information import DEFAULT_NOISE, Noise, signals
from groundstation.planning.limits import envelope, series_excesses
from groundstation.planning.plan import paper_plan, paper_problem
from groundstation.trajectory import RigidMotion


def base_columns(motion: RigidMotion) -> np.ndarray:
    """Mass and inertia in the six channels, shape (k, 6, 7)."""
    sampled = signals(motion)
    columns = np.zeros((len(sampled), 6, 7))
    columns[:, 2, 0] = sampled[:, 0]
    columns[:, 3:, 1:] = sampled[:, 1:19].reshape(-1, 3, 6)
    return columns


def force_along_velocity(name: str, size: float, power: float) -> Candidate:
    """Drag in the rotor plane proportional to |v|^(power-1) v: linear for rotor drag, quadratic for body drag."""

    def shape(motion: RigidMotion) -> np.ndarray:
        velocity = signals(motion)[:, 19:21]
        forces = np.zeros((len(velocity), 6))
        forces[:, :2] = -velocity * np.linalg.norm(velocity, axis=1, keepdims=True) ** (power - 1.0)
        return forces

    def explanations(t: np.ndarray, motion: RigidMotion) -> list[tuple[np.ndarray, np.ndarray]]:
        columns = np.concatenate([base_columns(motion), shape(motion)[:, :, None]], axis=2)
        return [(np.zeros((len(t), 6)), columns)]

    return Candidate(name, lambda t, motion: size * shape(motion), explanations)


LINEAR, QUADRATIC = force_along_velocity("rotor_drag", 0.3, 1.0), force_along_velocity("body_drag", 0.5, 2.0)


@pytest.fixture(scope="module")
def qball():
    return paper_problem()["vehicle"]


def test_a_rival_that_can_imitate_the_truth_is_not_told_apart(qball):
    series = paper_plan().series()
    smaller = force_along_velocity("rotor_drag too", 0.1, 1.0)
    assert separation(LINEAR, smaller, series, qball)[0] == pytest.approx(0.0, abs=1e-9)
    assert separation(LINEAR, QUADRATIC, series, qball)[0] > 1.0


def test_twice_the_noise_quarters_the_odds(qball):
    series = paper_plan().series()
    loud = Noise(
        *(2.0 * value for value in (DEFAULT_NOISE.force_rms, DEFAULT_NOISE.torque_rms)),
        DEFAULT_NOISE.correlation_s,
        *(2.0 * value for value in (DEFAULT_NOISE.gyro_rad_s_rthz, DEFAULT_NOISE.accelerometer_m_s2_rthz)),
    )
    quiet_odds, loud_odds = (separation(LINEAR, QUADRATIC, series, qball, noise)[0] for noise in (DEFAULT_NOISE, loud))
    assert loud_odds == pytest.approx(quiet_odds / 4.0)


def test_odds_live_in_the_channels_where_the_candidates_differ(qball):
    total, channels = separation(LINEAR, QUADRATIC, paper_plan().series(), qball)
    assert channels.sum() == pytest.approx(total)
    assert channels[:2].sum() > 0.99 * total


def test_the_planned_flight_keeps_the_limits_and_beats_the_published_one(qball):
    found = plan_discrimination(qball, (LINEAR, QUADRATIC), trials=24)
    assert max(series_excesses(found.plan.series(), envelope(qball)).values()) <= 1e-6
    published = min(
        separation(*pair, paper_plan().series(), qball)[0] for pair in ((LINEAR, QUADRATIC), (QUADRATIC, LINEAR))
    )
    assert found.log_odds["rotor_drag", "body_drag"] > published
    assert found.probability > 0.99
    assert sum(found.channels.values()) == pytest.approx(1.0)


def test_no_motion_tells_a_model_from_itself(qball):
    with pytest.raises(Refused, match="no motion within these limits tells rotor_drag and same apart"):
        plan_discrimination(qball, (LINEAR, force_along_velocity("same", 0.3, 1.0)), trials=4)
