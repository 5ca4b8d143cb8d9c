"""Plans keep their promises: every limit, rest at both ends, the paper's figures and better, exact derivatives,
refusals.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundstation.errors import BadInput
from groundstation.paths import find_config
from groundstation.planning import optimiser, terms
from groundstation.planning.criteria import condition_number
from groundstation.planning.information import percentages, signals
from groundstation.planning.limits import envelope
from groundstation.planning.plan import PAPER_START, paper_plan, paper_problem, plan_document, plan_excitation
from groundstation.planning.problem import Problem
from groundstation.planning.program import Program
from groundstation.planning.samples import limit_groups, signal_function
from groundstation.trajectory import FourierSeries, plan_from_dict, rigid_motion
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict

DIAGONAL = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


def qball() -> Vehicle:
    return paper_problem()["vehicle"]


def heavier(vehicle: Vehicle, factor: float) -> Vehicle:
    inertia = vehicle.inertia_kg_m2.model_copy(
        update={n: factor * getattr(vehicle.inertia_kg_m2, n) for n in ("xx", "zz")}
    )
    return vehicle.model_copy(
        update={"name": "candidate", "mass_kg": factor * vehicle.mass_kg, "inertia_kg_m2": inertia}
    )


def violation(series: FourierSeries, vehicle: Vehicle, **overrides: float) -> float:
    """Largest excess over the room, speeds, tilt, wrench and rotors on the 2 ms grid, written out on its own."""
    limits = vehicle.limits.model_copy(update=overrides)
    motion = rigid_motion(series.sample(np.arange(0.0, series.duration_s + 1e-9, 0.002)), vehicle.gravity_m_s2)
    x, y, z = motion.position_m.T
    tensor, rate = vehicle.inertia_tensor(), motion.angular_velocity_body_rad_s
    torque = motion.angular_acceleration_body_rad_s2 @ tensor + np.cross(rate, rate @ tensor)
    thrust = vehicle.mass_kg * motion.specific_thrust_m_s2
    rotors = np.linalg.lstsq(vehicle.allocation(), np.vstack([thrust, torque.T]), rcond=None)[0]
    reached = {
        "x_max_m": np.abs(x).max(),
        "y_max_m": np.abs(y).max(),
        "z_max_m": z.max(),
        "yaw_max_rad": np.abs(motion.euler_rad[:, 2]).max(),
        "speed_max_m_s": np.abs(motion.velocity_world_m_s).max(),
        "yaw_rate_max_rad_s": np.abs(motion.euler_rate_rad_s[:, 2]).max(),
        "acceleration_max_m_s2": np.linalg.norm(motion.acceleration_world_m_s2, axis=1).max(),
        "tilt_max_rad": np.abs(motion.euler_rad[:, :2]).max(),
        "thrust_max_n": thrust.max(),
        "torque_max_nm": np.abs(torque).max(),
    }
    over = [value - getattr(limits, name) for name, value in reached.items() if getattr(limits, name) is not None]
    if limits.z_min_m is not None:
        over.append(limits.z_min_m - z.min())
    return max(*over, rotors.max() - vehicle.rotor_thrust_max_n(), -rotors.min())


def assert_rests_at_both_ends(series: FourierSeries) -> None:
    ends = series.derivatives([0.0, series.duration_s], 2)
    assert ends[0, 0] == pytest.approx(ends[0, 1], abs=1e-9)
    assert ends[1:] == pytest.approx(0.0, abs=1e-9)


def problem(criterion: str, vehicles: tuple[Vehicle, ...], effects: tuple[str, ...] = (), start=None) -> Problem:
    envelopes = tuple(envelope(each) for each in vehicles)
    return Problem(vehicles, envelopes, criterion, 3, 0.8, 40.0, start, effects=effects)


@pytest.mark.parametrize(
    ("criterion", "effects", "candidates"),
    [
        ("condition", (), 1),
        ("D", ("motor_lag",), 1),
        ("A", ("rotor_drag", "com_offset"), 2),
        ("E", ("input_delay",), 2),
    ],
)
def test_first_and_second_derivatives_are_exact(criterion, effects, candidates):
    vehicles = (qball(), heavier(qball(), 1.3))[:candidates]
    task = problem(criterion, vehicles, effects)
    groups = [limit_groups(each) for each in task.envelopes]
    phases = [dict.fromkeys(each, np.linspace(0.0, 6.0, 7)) for each in groups]
    program = Program(task, groups, phases)
    rng = np.random.default_rng(3)
    point = np.append(optimiser.random_start(task, rng), -0.4)
    direction = rng.normal(size=len(point)) * np.maximum(np.abs(point), 1e-2)
    limits, matrices = program.values(point)
    weights = rng.normal(size=len(limits))
    multipliers = [m @ m.T for m in (rng.normal(size=each.shape) for each in matrices)]
    step = 1e-6

    def lagrangian(v):
        values, each = program.values(v)
        inequalities = sum(np.sum(a * b) for a, b in zip(multipliers, each, strict=True))
        return weights @ values + inequalities - program.cost(v)

    def gradient(v):
        cost, jacobian, slopes = program.slopes(v)
        return (
            jacobian.T @ weights + sum(np.tensordot(z, g, 2) for z, g in zip(multipliers, slopes, strict=True)) - cost
        )

    def slope(function):
        return (function(point + step * direction) - function(point - step * direction)) / (2 * step)

    first = gradient(point)
    assert slope(lagrangian) == pytest.approx(first @ direction, rel=1e-6, abs=1e-6 * np.abs(first).max())
    second = sum(program.curvature(point, weights, multipliers)) @ direction
    assert slope(gradient) == pytest.approx(second, rel=1e-5, abs=1e-6 * np.abs(second).max())


def test_symbolic_signals_agree_with_the_closed_form_motion():
    series = paper_plan().series()
    t = np.linspace(0.0, series.period_s, 101)
    d = series.derivatives(t, 4)
    flat = np.hstack([*d[:, :, :3], d[:3, :, 3].T]).T
    expected = signals(rigid_motion(series.sample(t), 9.81))[1:-1].T
    assert signal_function(9.81).value(flat)[:, 1:-1] == pytest.approx(expected, abs=1e-10)


def test_paper_problem_beats_the_published_trajectory_within_the_limits_it_exceeds():
    plan = plan_excitation(**paper_problem(), starts=1)
    series = plan.series()
    assert condition_number(series) <= 16.27
    assert plan.condition_number == pytest.approx(condition_number(series), rel=1e-9)
    assert violation(series, qball()) <= 1e-6
    assert plan.largest_violation is not None and plan.largest_violation <= 1e-7
    assert_rests_at_both_ends(series)
    assert series.derivatives(0.0, 0)[0, 0] == pytest.approx(PAPER_START, abs=1e-9)


def test_at_the_tilt_really_flown_the_condition_number_falls_below_15_17():
    tilt = np.radians(6.2155)
    series = plan_excitation(**paper_problem(), starts=1, tilt_max_rad=tilt).series()
    assert condition_number(series) <= 15.17
    assert violation(series, qball(), tilt_max_rad=tilt) <= 1e-6


def test_a_free_base_frequency_sharpens_the_worst_diagonal_inertia_threefold():
    published = paper_plan()
    plan = plan_excitation(
        qball(), criterion="A", duration_s=40.0, start=PAPER_START, tilt_max_rad=np.radians(6.2155), starts=1
    )
    assert plan.series().duration_s == pytest.approx(published.series().duration_s)
    assert violation(plan.series(), qball(), tilt_max_rad=np.radians(6.2155)) <= 1e-6
    ours, theirs = (percentages(each.predicted_std, qball()) for each in (plan, published))
    assert max(theirs[name] for name in DIAGONAL) >= 3.0 * max(ours[name] for name in DIAGONAL)


def test_rotor_limits_are_kept_where_they_are_what_binds():
    """A crazyflie in a large hall, free to tilt, runs into what its rotors give at an empty battery."""
    vehicle = load_vehicle(find_config("vehicles", "crazyflie21"))
    wide: dict[str, Any] = {"tilt_max_rad": 1.2, "speed_max_m_s": 8.0, "x_max_m": 9.0, "y_max_m": 9.0, "z_max_m": 9.0}
    plan = plan_excitation(vehicle, criterion="D", harmonics=3, starts=1, **wide)
    assert violation(plan.series(), vehicle, **wide) <= 1e-6
    assert plan.limits["rotor_thrust_max_n"] < vehicle.rotor_thrust_max_n()


def test_a_robust_plan_is_no_worse_for_the_worst_vehicle_than_the_nominal_plan():
    nominal = qball()
    flatter = nominal.inertia_kg_m2.model_copy(update={"xx": 0.02, "yy": 0.045, "zz": 0.05})
    candidates = (nominal, nominal.model_copy(update={"name": "candidate", "inertia_kg_m2": flatter}))
    common = {"criterion": "E", "harmonics": 3, "base_frequency_rad_s": 0.8, "start": PAPER_START, "starts": 2}
    robust, single = (plan_excitation(each, **common).series() for each in (candidates, nominal))
    task = problem("E", candidates)
    assert optimiser.cost(robust, task) <= 1.002 * optimiser.cost(single, task)


def test_an_interrupt_keeps_the_best_so_far():
    seen: list[float] = []

    def interrupt(fraction: float, text: str) -> None:
        seen.append(fraction)
        if len(seen) == 1:
            raise KeyboardInterrupt

    plan = plan_excitation(**paper_problem(), time_budget_s=600.0, progress=interrupt)
    assert len(seen) == 2
    assert violation(plan.series(), qball()) <= 1e-6
    assert plan.condition_number is not None and plan.condition_number < 17.0


def test_an_interrupt_inside_the_solver_ends_it_and_keeps_a_plan_that_can_be_flown(monkeypatch):
    """A callback's KeyboardInterrupt would be swallowed by the solver, which would go on for minutes."""
    calls = 0
    room = terms.HeldLimit.room

    def interrupted(self, unknowns):
        nonlocal calls
        calls += 1
        if calls == 60:
            raise KeyboardInterrupt
        return room(self, unknowns)

    monkeypatch.setattr(terms.HeldLimit, "room", interrupted)
    plan = plan_excitation(**paper_problem(), time_budget_s=600.0)
    assert calls < 120
    assert violation(plan.series(), qball()) <= 1e-6


def test_who_watches_sees_each_trajectory_that_is_tried_and_can_end_the_search():
    seen = []

    def watch(series) -> None:
        seen.append(series)
        if len(seen) == 8:
            raise KeyboardInterrupt

    plan = plan_excitation(**paper_problem(), time_budget_s=600.0, watch=watch)
    assert len(seen) == 8
    costs = [optimiser.cost(series, problem("condition", (qball(),))) for series in seen]
    assert min(costs[1:]) < costs[0], "it gets better as it goes"
    assert violation(plan.series(), qball()) <= 1e-6


def test_an_interrupted_polish_still_gives_the_coarse_solution(monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(optimiser, "_polish", interrupted)
    plan = plan_excitation(**paper_problem(), time_budget_s=600.0)
    assert violation(plan.series(), qball()) <= 1e-6
    assert plan.condition_number is not None and plan.condition_number < 17.0


def test_the_same_seed_gives_the_same_plan_and_the_document_reads_back():
    common = {"harmonics": 3, "base_frequency_rad_s": 0.8, "starts": 1, "seed": 5}
    first, second = (plan_excitation(qball(), **common) for _ in range(2))
    assert first == second
    document = plan_document(first)
    assert document["schema"] == "groundstation.plan/1"
    assert plan_from_dict(document) == first
    assert set(document["coefficients"]) == {"x", "y", "z", "yaw"}


def test_a_plan_says_which_limits_stand_in_the_way_of_what_it_hardly_reveals():
    gentle = plan_excitation(
        qball(), criterion="A", harmonics=2, base_frequency_rad_s=0.7, duration_s=9.0, tilt_max_rad=0.03, starts=1
    )
    assert "tilt_max_rad" in gentle.note
    assert "hardly reveals ixx_kg_m2" in gentle.note


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"z_max_m": 0.6}, r"z_max_m = 0.6 m is not above z_min_m = 0.7 m; raise z_max_m by more than 0.1 m"),
        ({"thrust_max_n": 15.0}, r"thrust_max_n = 15 N does not carry qball2.*2.55 N are missing"),
        ({"start": (0.0, 0.0, 1.7, 0.0)}, r"outside z_max_m = 1.5: z is 0.2 too far"),
        ({"start": (0.0, -1.3, 1.0, 0.0)}, r"outside y_max_m = 1: y is 0.3 too far"),
        ({"tilt_max_rad": -0.1}, r"limit tilt_max_rad = -0.1"),
        ({"roll_max_rad": 0.1}, r"roll_max_rad is not a limit"),
        ({"harmonics": 1}, r"1 harmonics cannot start and end at rest"),
        ({"criterion": "best"}, r"best is not a criterion"),
        ({"duration_s": 5.0}, r"shorter than one period of 10 s"),
        ({"duration_s": 4.0, "base_frequency_rad_s": None}, r"5 harmonics below 1 Hz take 5 s"),
    ],
)
def test_impossible_requests_name_the_limit_and_how_far_off_it_is(arguments, sentence):
    with pytest.raises(BadInput, match=sentence):
        plan_excitation(**(paper_problem() | arguments), starts=1)


def test_a_vehicle_too_heavy_for_its_rotors_is_refused_by_name():
    with pytest.raises(BadInput, match=r"rotor_thrust_max_n = 5\.97.*hovering takes 6\.\d+ N of rotor \d"):
        plan_excitation(heavier(qball(), 1.4), starts=1)


@st.composite
def vehicles(draw) -> Vehicle:
    mass = draw(st.floats(0.03, 6.0))
    arm = draw(st.floats(0.03, 0.4))
    moment = mass * arm**2 * draw(st.floats(0.1, 0.5))
    ratio = draw(st.floats(1.2, 2.5))
    limits = {
        "x_max_m": draw(st.floats(0.3, 5.0)),
        "y_max_m": draw(st.floats(0.3, 5.0)),
        "z_min_m": 0.4,
        "z_max_m": draw(st.floats(0.2, 5.0)),
        "speed_max_m_s": draw(st.floats(0.2, 4.0)),
        "yaw_rate_max_rad_s": draw(st.floats(0.2, 3.0)),
        "tilt_max_rad": draw(st.floats(0.03, 0.6)),
    }
    optional = {"acceleration_max_m_s2": st.floats(0.3, 5.0), "torque_max_nm": st.floats(1e-3, 1.0)}
    limits |= {name: draw(values) for name, values in optional.items() if draw(st.booleans())}
    side = arm / np.sqrt(2.0)
    return vehicle_from_dict(
        {
            "vehicle": {
                "name": "random",
                "mass_kg": mass,
                "inertia_kg_m2": {"xx": moment, "yy": draw(st.floats(0.8, 1.2)) * moment, "zz": 1.6 * moment},
            },
            "rotors": {
                "position_m": [[side, -side, 0.0], [-side, side, 0.0], [side, side, 0.0], [-side, -side, 0.0]],
                "spin": [1, 1, -1, -1],
                "thrust_coefficient_n_s2": 1e-5,
                "torque_to_thrust_m": 0.2 * arm,
                "speed_max_rad_s": float(np.sqrt(ratio * mass * 9.80665 / 4.0 / 1e-5)),
            },
            "limits": limits,
        }
    )


@settings(max_examples=6, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(vehicles(), st.sampled_from(["condition", "A", "E"]), st.integers(2, 4), st.booleans())
def test_random_rooms_and_vehicles_give_a_plan_that_keeps_every_limit_or_a_named_reason(
    vehicle, criterion, harmonics, on_floor
):
    limits = vehicle.limits
    start = (0.0, 0.0, limits.z_min_m, 0.0) if on_floor else None
    try:
        plan = plan_excitation(
            vehicle, criterion=criterion, harmonics=harmonics, duration_s=20.0, start=start, starts=1
        )
    except BadInput as refusal:
        assert limits.z_max_m is not None and limits.z_max_m <= 0.4
        assert "z_max_m" in str(refusal)
        return
    series = plan.series()
    assert violation(series, vehicle) <= 1e-6
    assert_rests_at_both_ends(series)
    assert series.duration_s == pytest.approx(20.0)
    assert all(np.isfinite(value) for value in plan.predicted_std.values())
    assert dataclasses.is_dataclass(series)
