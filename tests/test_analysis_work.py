"""What analyses share, hold and cost: a diagnosis after an identification, columns of candidates, kernels beside plain
loops.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.cli import main
from groundstation.diagnosis import diagnose
from groundstation.diagnosis.columns import Recent
from groundstation.identification import instruments
from groundstation.identification import work as work_module
from groundstation.identification.block_kernel import outputs
from groundstation.identification.noise import NoiseModel, innovation_products, innovations
from groundstation.identification.pipeline import identify
from groundstation.identification.position_kernel import position_costs
from groundstation.identification.preparation import prepare
from groundstation.identification.sensitivities import TURNING
from groundstation.identification.smoothing import position_filter
from groundstation.identification.work import Work
from groundstation.model.parameters import PAIRS
from groundstation.model.rotors import cumulative, declared_thrust, interpolate_columns, mean_thrusts, motor_input
from groundstation.paths import find_config
from groundstation.recording.bundle import write_bundle
from groundstation.vehicle import load_vehicle
from studies.estimators import loop_least_squares, problem
from studies.study import draw
from studies.timing import seconds

SEED = 2001
DIAGNOSE_LOOPS = 120.0
"""A loose bound: 20 s of flight were 32 plain loops over 10 s when this was written, 65 on another machine."""


def test_a_diagnosis_after_an_identification_says_the_same_for_less() -> None:
    print("study seed", SEED)
    flight, _, _ = draw(SEED, 0.5)
    gamma, upsilon, _ = problem()
    work = Work()
    identify([flight], work=work)
    alone = diagnose([flight])
    after: list = []
    after_s = seconds(lambda: after.append(diagnose([flight], work=work)))
    alone_s = seconds(lambda: diagnose([flight]))
    loop_s = min(seconds(lambda: loop_least_squares(gamma[:5000], upsilon[:5000])) for _ in range(3))
    assert after[0].to_dict() == alone.to_dict()
    assert after_s < 0.85 * alone_s < 0.85 * DIAGNOSE_LOOPS * loop_s


def test_the_command_that_diagnoses_prepares_and_fits_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    print("study seed", SEED)
    flight, _, _ = draw(SEED, 0.5)
    counted: list[str] = []

    def counting(name: str) -> Callable[..., object]:
        made = getattr(work_module, name)

        def counts(*args: object, **kwargs: object) -> object:
            counted.append(name)
            return made(*args, **kwargs)

        return counts

    for name in ("prepare_all", "fit_dynamics", "check_declarations"):
        monkeypatch.setattr(work_module, name, counting(name))
    folder = write_bundle(flight, tmp_path / "flight")
    assert main(["diagnose", str(folder), "--logs", str(tmp_path), "--json"]) == 0
    assert sorted(counted) == ["check_declarations", "fit_dynamics", "prepare_all"]


def test_a_planned_motion_in_parts_is_that_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    print("study seed", SEED)
    flight, _, _ = draw(SEED, 0.5)
    found = []
    for part in (10**9, 1000):
        monkeypatch.setattr(instruments, "PART", part)
        planned = prepare(flight).planned
        assert planned is not None
        found.append(planned)
    whole, parts = found
    for name in ("rate_rad_s", "angular_acceleration_rad_s2", "specific_thrust_m_s2", "position_m", "quaternion"):
        assert getattr(parts, name) == pytest.approx(getattr(whole, name), rel=1e-9, abs=1e-9)


def test_batches_that_find_no_room_are_made_anew() -> None:
    recent, made = Recent(3000), []

    def batch(number: int) -> np.ndarray:
        def anew() -> np.ndarray:
            made.append(number)
            return np.full((100, 2), float(number))

        return recent.batch(number, anew)

    assert batch(1)[0, 0] == 1.0 and batch(1)[5, 1] == 1.0 and made == [1]
    assert batch(2)[0, 0] == 2.0 and made == [1, 2]
    assert batch(1)[0, 0] == 1.0 and made == [1, 2, 1]


@pytest.mark.parametrize("name", ["qball2", "x500"])
def test_block_means_of_rotors_are_those_of_the_lagged_grid(name: str) -> None:
    print("seed", 5)
    random, vehicle = np.random.default_rng(5), load_vehicle(find_config("vehicles", name))
    count = vehicle.rotors.count
    hover = float(vehicle.motor_for_thrust(vehicle.mass_kg * vehicle.gravity_m_s2 / count))
    stamps = np.cumsum(random.uniform(1.5e-3, 4e-3, 800))
    values = hover * random.uniform(0.8, 1.2, (800, count))
    motors = motor_input(stamps, values, measured=False, hover=hover)
    t_s = np.arange(stamps[0] + 0.1, stamps[-1] - 0.05, 2.1e-3)
    members = np.arange(len(t_s) // 3 * 3).reshape(-1, 3)
    lags = [(0.04, 0.06, 0.2), (0.0, 0.0, 0.0), (0.003, 0.05, 0.0), (0.03, 0.03, -0.1), (0.08, 0.02, 0.1)]
    delays = [0.0, 0.0137]
    wanted = [(lag, delay) for lag in lags for delay in delays]
    found = mean_thrusts(vehicle, motors, wanted, (t_s, members))
    for (lag, delay), mean in zip(wanted, found, strict=True):
        thrust = declared_thrust(vehicle, motors.lagged(*lag))
        integral = cumulative(thrust, motors.step_s, held=lag[0] == 0.0)
        for row, grid in enumerate((thrust, integral)):
            plain = interpolate_columns(t_s - delay, motors.start_s, motors.step_s, grid)[members].mean(axis=1)
            assert mean[:, row] == pytest.approx(plain, rel=1e-9, abs=1e-12)


def test_costs_of_position_noises_are_those_of_the_filter() -> None:
    print("seed", 6)
    random = np.random.default_rng(6)
    dt = np.concatenate([[0.0], random.uniform(0.008, 0.012, 399)])
    z = np.cumsum(np.cumsum(1e-5 * random.standard_normal((400, 3)), axis=0), axis=0)
    z += 1e-3 * random.standard_normal((400, 3))
    noises = np.array([[1e-3, 0.01, 0.01, 0.3], [2e-3, 0.1, 0.01, 0.3], [1e-3, 0.5, 0.03, 0.3]])
    for noise, cost in zip(noises, position_costs(z, dt, noises), strict=True):
        e, s, *_ = position_filter(z, dt, noise, True)
        known = np.isfinite(s)
        squares = np.minimum(e[known] ** 2 / s[known, None], 25.0)
        assert cost == pytest.approx(0.5 * (3.0 * np.sum(np.log(s[known])) + np.sum(squares)), rel=1e-10)


@pytest.mark.parametrize("integrated", [True, False])
def test_products_of_innovations_in_parts_are_those_of_the_whole(integrated: bool) -> None:
    print("seed", 7)
    random = np.random.default_rng(7)
    count = 10_000
    z, columns = random.standard_normal(count), random.standard_normal((count, 3))
    dt = random.uniform(0.018, 0.022, count)
    restart = np.zeros(count, dtype=bool)
    restart[[0, 5000]] = True
    colour = NoiseModel(2.0, 0.4, 0.1, 0.5)
    e, s = innovations(np.column_stack([z, columns]), dt, restart, colour, integrated=integrated)
    white = e / np.sqrt(s)[:, None]
    found = innovation_products(z, columns, dt, restart, colour, integrated=integrated)
    assert found == pytest.approx(white.T @ white, rel=1e-10)


def test_what_turns_a_body_is_made_of_integrated_products_of_its_rates() -> None:
    print("seed", 8)
    random = np.random.default_rng(8)
    rate, blank = random.standard_normal((50, 3)), np.zeros((50, 6))
    root = random.standard_normal((3, 3))
    tensor: np.ndarray = root @ root.T
    turned = np.stack([rate[:, i] * rate[:, j] for i, j in PAIRS], axis=1)
    entries = np.array([tensor[i, j] for i, j in PAIRS])
    expected = np.cross(rate, rate @ tensor)
    found, _ = outputs(blank, blank, turned, (entries, np.eye(3), np.zeros(3)), np.zeros(50))
    assert found == pytest.approx(-expected, rel=1e-12)
    assert np.einsum("ces,ks,e->kc", TURNING, turned, entries) == pytest.approx(expected, rel=1e-12)
