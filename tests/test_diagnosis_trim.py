"""Mean thrusts of flights without a gyro, beside those of healthy ones: which rotor, whether a load could do it, and
how sure.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.trim import compare_trims, mean_thrust
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle

VEHICLE = load_vehicle(find_config("vehicles", "x500"))
WEIGHT = VEHICLE.mass_kg * VEHICLE.gravity_m_s2
HOVER = np.full(4, WEIGHT / VEHICLE.rotors.count)
MATRIX = VEHICLE.allocation()
HUBS = np.asarray(VEHICLE.rotors.position_m)[:, :2]
SCALE = WEIGHT * np.array([1.0, VEHICLE.arm_m(), VEHICLE.arm_m(), VEHICLE.rotors.torque_to_thrust_m or 1.0])


def _flight(thrust: np.ndarray) -> Any:
    """What the comparison reads of a flight: the thrust of each rotor, at 20 Hz."""
    record = SimpleNamespace(vehicle=VEHICLE, keep=np.ones(len(thrust), dtype=bool), t_s=0.05 * np.arange(len(thrust)))
    return SimpleNamespace(record=record, signals=lambda *_: SimpleNamespace(thrust_n=thrust))


def _steady(mean: np.ndarray) -> Any:
    return _flight(np.tile(mean, (20, 1)))


def _flights(mean: np.ndarray, count: int) -> list[Any]:
    return [_steady(mean + one) for one in np.random.default_rng(3).normal(0.0, 0.004 * HOVER, (count, 4))]


def _more(wrench: np.ndarray) -> np.ndarray:
    """Thrusts that make a wrench more."""
    return np.linalg.pinv(MATRIX) @ wrench


def _weak(rotor: int, loss: float, torque_ratio: float = 1.0) -> np.ndarray:
    """What is asked for more, so that a rotor gives its thrust again, and the others the torque it now lacks."""
    own = MATRIX[:, rotor - 1] * HOVER[rotor - 1]
    return _more(loss / (1.0 - loss) * own + (1.0 - torque_ratio) * np.array([0.0, 0.0, 0.0, own[3]]))


def _load(share: float, place: np.ndarray) -> np.ndarray:
    """The lift of a load at a place, and what keeps it level."""
    return _more(share * WEIGHT * np.array([1.0, place[1], -place[0], 0.0]))


HEALTHY = _flights(HOVER, 5)


def _found(mean: np.ndarray) -> Finding:
    (finding,) = compare_trims(_flights(HOVER + mean, 3), HEALTHY).findings
    return finding


def test_a_rotor_that_works_harder_alone_is_a_weak_rotor():
    found = compare_trims(_flights(HOVER + _weak(3, 0.2), 3), HEALTHY)
    (finding,) = found.findings
    assert (finding.effect, finding.rotor) == ("weak_rotor", 3) and finding.confidence > 0.95
    assert abs(finding.parameters["loss"].value - 0.2) < 0.03
    assert abs(finding.parameters["torque_to_thrust_ratio"].value - 1.0) < 0.03
    assert found.after["torque_z_nm"] < 0.3 * found.before["torque_z_nm"] and found.explained


def test_a_shorter_propeller_is_told_from_a_weak_motor_by_its_torque():
    """Diameter 0.83 of what it was: torque over thrust goes with D."""
    finding = _found(_weak(2, 0.2, torque_ratio=0.83))
    assert (finding.effect, finding.rotor) == ("weak_rotor", 2)
    ratio = finding.parameters["torque_to_thrust_ratio"]
    assert abs(ratio.value - 0.83) < 0.05 and ratio.ci95[1] < 1.0
    assert "shorter propeller" in finding.sentence and "shorter" not in _found(_weak(2, 0.2)).sentence


def test_a_load_beside_a_rotor_moves_the_centre_and_leaves_yaw_alone():
    finding = _found(_load(0.1, HUBS[2]))
    assert (finding.effect, finding.rotor) == ("com_offset", 3)
    assert abs(finding.parameters["mass_change_kg"].value / (0.1 * VEHICLE.mass_kg) - 1.0) < 0.2
    for axis, name in enumerate(("com_offset_x_m", "com_offset_y_m")):
        assert abs(finding.parameters[name].value - 0.1 / 1.1 * HUBS[2, axis]) < 0.2 * 0.1 * abs(HUBS[2, axis])


def test_between_a_load_and_a_weak_rotor_both_are_named_and_neither_is_sure():
    """Half of the yaw that a weak rotor would ask for: what a battery of another session might change."""
    own = MATRIX[:, 2] * HOVER[2]
    finding = _found(_more(0.08 * own * np.array([1.0, 1.0, 1.0, 0.6])))
    assert {finding.effect, *finding.alternatives} == {"weak_rotor", "com_offset"}
    assert finding.rotor == 3 and finding.confidence < 0.9 and "cannot be excluded" in finding.sentence


def test_flights_that_scatter_as_the_healthy_ones_do_give_no_finding():
    assert compare_trims(_flights(HOVER, 2), HEALTHY).findings == ()


def test_the_turn_back_after_lift_off_is_no_trim():
    """A vehicle set down askew turns back by a difference of rotors that lasts a second: means keep it, settled flight
    does not.
    """
    grounded, turning, settled = np.zeros((20, 4)), np.tile(HOVER, (20, 1)), np.tile(HOVER, (100, 1))
    turning += 0.4 * HOVER * np.sign(MATRIX[3])
    thrust = np.concatenate([grounded, turning, settled, grounded])
    np.testing.assert_allclose(mean_thrust(_flight(thrust)), HOVER, rtol=1e-12)
    assert THRESHOLDS.trim_settled_s > 1.0
    np.testing.assert_allclose(mean_thrust(_flight(np.concatenate([grounded, turning, grounded]))), turning[0])


def test_confidence_is_the_rate_at_which_the_name_is_right():
    """Sessions whose trims differ by 1 %, and what is hidden drawn from the priors that the comparison states."""
    rng = np.random.default_rng(11)
    right, sure = [], []
    for _ in range(80):
        session, hidden = rng.normal(0.0, 0.01, (2, 4)) * SCALE, rng.integers(3)
        rotor, loss = int(rng.integers(1, 5)), rng.uniform(0.0, 0.5)
        fault = (
            np.zeros(4),
            _weak(rotor, loss, 1.0 if rng.random() < 0.5 else rng.uniform(0.7, 1.0)),
            _load(rng.uniform(0.0, 0.5), rng.normal(0.0, 0.2, 2)),
        )[hidden]
        healthy = [_steady(HOVER + _more(session[0] + s)) for s in rng.normal(0.0, 0.003, (5, 4)) * SCALE]
        ill = [_steady(HOVER + fault + _more(session[1] + s)) for s in rng.normal(0.0, 0.003, (3, 4)) * SCALE]
        found = compare_trims(ill, healthy).findings
        if found:
            right.append((found[0].effect, found[0].rotor) == ("weak_rotor", rotor) if hidden == 1 else
                         (hidden, found[0].effect) == (2, "com_offset"))  # fmt: skip
            sure.append(found[0].confidence)
    assert len(right) > 35
    assert abs(np.mean(right) - np.mean(sure)) < 0.1, (np.mean(right), np.mean(sure))


def test_two_weak_rotors_are_two_findings_with_one_posterior():
    found = compare_trims(_flights(HOVER + _weak(1, 0.2) + _weak(4, 0.3), 3), HEALTHY).findings
    assert [finding.rotor for finding in found] == [1, 4]
    assert {finding.effect for finding in found} == {"weak_rotor"} and found[0].confidence == found[1].confidence > 0.8
    for finding, loss in zip(found, (0.2, 0.3), strict=True):
        assert abs(finding.parameters["loss"].value - loss) < 2.5 * finding.parameters["loss"].std


def test_a_propeller_that_takes_more_torque_is_taped_or_chipped():
    finding = _found(_weak(3, 0.15, torque_ratio=1.2))
    assert (finding.effect, finding.rotor) == ("weak_rotor", 3)
    assert "taped or chipped" in finding.sentence and finding.parameters["torque_to_thrust_ratio"].value > 1.05


def test_references_of_another_individual_are_said_to_be_and_no_rotor_is_sure():
    """Trims that differ as those of two individuals do: no fault of one rotor, no load."""
    other = _more(np.array([-0.03, 0.02, -0.035, -0.04]) * SCALE)
    found = compare_trims(_flights(HOVER + other, 3), HEALTHY)
    assert "may not be of the same vehicle" in " ".join(found.notes) and not found.explained
    assert all(finding.confidence < 0.6 for finding in found.findings)


def test_what_is_not_found_says_the_least_that_would_have_been():
    (note,) = compare_trims(_flights(HOVER, 2), HEALTHY).notes
    assert "No fault is shown. The least that would have been: a rotor with" in note
    percent = float(note.split("a rotor with ")[1].split(" %")[0])
    assert compare_trims(_flights(HOVER + _weak(1, 0.01 * percent + 0.05), 3), HEALTHY).findings
