"""Effects of the air on flights without a plan: past motion as the instrument, parts of flights as each other's
check.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from groundstation.diagnosis.unplanned import PastMotion, tell_unplanned
from groundstation.flightdata import FlightData, Stream
from groundstation.identification.lagged_instruments import Equation, pooled, two_stage
from groundstation.identification.preparation import Prepared, prepare
from groundstation.model.parameters import declared_parameters
from groundstation.recording.load import load_flight
from groundstation.vehicle import Vehicle
from studies.unplanned import flights_of

STEP_S = 0.08


def closed_loop(seed: int, theta: float, count: int = 4000) -> Equation:
    """An output whose disturbance, 0.1 s long, drives the regressor, too: what feedback does to a regression."""
    print("seed", seed)
    random = np.random.default_rng(seed)
    kick, push = random.standard_normal((2, count))
    disturbance, motion = np.zeros(count), np.zeros(count)
    for i in range(1, count):
        disturbance[i] = np.exp(-STEP_S / 0.05) * disturbance[i - 1] + kick[i]
        motion[i] = np.exp(-STEP_S / 1.0) * motion[i - 1] + 0.3 * push[i] + 0.3 * disturbance[i]
    output = theta * motion + disturbance
    ones = np.ones((count, 1))
    return Equation(output, motion[:, None], ones, np.ones(count, dtype=bool), STEP_S, 1)


def test_past_motion_is_an_instrument_that_feedback_does_not_bias():
    equation = closed_loop(5, 0.7)
    plain = np.linalg.lstsq(np.column_stack([equation.columns, equation.known]), equation.output, rcond=None)[0][0]
    found = two_stage(equation)
    assert found is not None
    assert abs(found.values[0] - 0.7) < 3.0 * found.std[0]
    assert plain - 0.7 > 5.0 * found.std[0]


def test_parts_that_disagree_widen_the_interval_and_predict_each_other_worse():
    agree = [(e, p, 0) for seed in range(4) for e in [closed_loop(seed, 0.7)] if (p := two_stage(e)) is not None]
    apart = [
        (e, p, 0) for i in range(4) for e in [closed_loop(i, 0.7 * (-1.0) ** i)] if (p := two_stage(e)) is not None
    ]
    assert pooled(agree).gain > 0.0 > pooled(apart).gain
    assert pooled(apart).std > 3.0 * pooled(agree).std


@pytest.mark.parametrize(("count", "scatter"), [(3, 1.0), (3, 4.0), (4, 2.0), (8, 4.0)])
def test_few_parts_that_tell_their_own_scatter_have_students_interval(count: int, scatter: float):
    """The interval of a normal distribution held the truth in 82 of 100 draws of three parts that scatter four times
    more than they say.
    """
    random = np.random.default_rng(5)
    equation = closed_loop(1, 0.0, 200)
    part = two_stage(equation)
    assert part is not None
    inside = []
    for _ in range(400):
        values = 0.7 + scatter * 0.1 * random.standard_normal(count)
        drawn = [(equation, replace(part, values=np.array([v]), std=np.array([0.1])), 0) for v in values]
        found = pooled(drawn)
        inside.append(abs(found.value - 0.7) <= 1.96 * found.spread())
    assert np.mean(inside) > 0.92


def test_a_gap_or_a_column_of_nothing_gives_no_estimate():
    equation = closed_loop(1, 0.7, 400)
    assert two_stage(replace(equation, columns=np.zeros_like(equation.columns))) is None
    assert two_stage(replace(equation, used=np.zeros(400, dtype=bool))) is None


@cache
def flown(seed: int) -> tuple[tuple[Prepared, ...], Vehicle, dict[str, dict]]:
    """Two flights of the study, prepared, the true vehicle, and what acts on it."""
    print("seed", seed)
    flights, truth, hidden, _ = flights_of(seed)
    return tuple(prepare(flight) for flight in flights), truth, hidden


def told(seed: int) -> dict[str, PastMotion]:
    prepared, truth, _ = flown(seed)
    base = replace(declared_parameters(prepared[0].record.vehicle, lag_s=0.0), mass_kg=truth.mass_kg)
    return {each.effect.identifier: each for each in tell_unplanned(prepared, base)}


@pytest.mark.parametrize("seed", [4001, 4002, 8900])  # of the last a drag at the hubs damps the yaw
def test_what_stands_is_there_and_what_is_not_there_does_not_stand(seed: int):
    hidden = flown(seed)[2]
    standing = {name for name, each in told(seed).items() if each.stands}
    assert standing == set(hidden)


def test_values_lie_within_three_standard_deviations_of_the_truth():
    found, (_, truth, hidden) = told(4001), flown(4001)
    vehicle = flown(4001)[0][0].record.vehicle
    hover = np.sqrt(vehicle.mass_kg / truth.mass_kg)  # drag is given at the declared vehicle's rotor speeds in hover
    true = {
        "d_x_kg_s": hover * hidden["rotor_drag"]["drag_kg_s"][0],
        "d_y_kg_s": hover * hidden["rotor_drag"]["drag_kg_s"][1],
        "k_nm_s_m": hidden["flapping_moment"]["k_nm_s_m"],
        **dict(
            zip(
                ("damping_x_nms", "damping_y_nms", "damping_z_nms"),
                hidden["angular_damping"]["damping_nms"],
                strict=True,
            )
        ),
    }
    values = {name: value for each in found.values() for name, value in each.values.items()}
    for name, size in true.items():
        assert abs(values[name].value - size) < 3.0 * values[name].std, name
        assert values[name].std < 0.6 * size, name


def test_drag_of_a_frame_is_not_counted_twice_as_drag_of_rotors_and_inflow():
    prepared, truth, hidden = flown(4002)
    assert "rotor_drag" not in hidden
    drag_kg_m = 0.04 * truth.mass_kg
    dragged = []
    for each in prepared:
        signals = each.signals(0.0, 0.0, 0.0, 0.0)
        velocity = signals.velocity_body_m_s()
        push = -drag_kg_m / truth.mass_kg * np.linalg.norm(velocity, axis=1, keepdims=True) * velocity
        dragged.append(replace(each, record=replace(each.record, force_m_s2=each.record.force_m_s2 + push)))
    base = replace(declared_parameters(prepared[0].record.vehicle, lag_s=0.0), mass_kg=truth.mass_kg)
    found = {each.effect.identifier: each for each in tell_unplanned(dragged, base) if each.stands}
    assert set(found) == {"body_drag", *hidden}
    value = found["body_drag"].values["c_kg_m"]
    assert abs(value.value - drag_kg_m) < 3.0 * value.std and value.std < 0.3 * drag_kg_m


def test_what_is_missed_says_the_least_that_would_have_been_seen():
    missed = told(4002)["flapping_moment"]
    assert "the least that these flights could have shown: k_nm_s_m" in missed.missed()


def test_nothing_is_told_this_way_where_a_plan_or_setpoints_are_recorded():
    prepared, *_ = flown(4002)
    flight: FlightData = prepared[0].flight
    setpoint = Stream(flight.motors.t_s, np.zeros((len(flight.motors.t_s), 11)), ())
    planned = replace(prepared[0], flight=replace(flight, setpoint=setpoint))
    assert tell_unplanned([planned], declared_parameters(flight.vehicle, lag_s=0.0)) == []


NANODRONE = Path(__file__).parents[2] / "shared" / "data" / "nanodrone"


@pytest.mark.skipif(not NANODRONE.is_dir(), reason="the measured flights are not here")
def test_measured_flights_show_drag_inflow_and_flapping_and_agree_with_each_other():
    base = None
    found = []
    for name in ("random1_20251017_run2", "random2_20251017_run4"):
        prepared = prepare(load_flight(NANODRONE / name))
        base = base or declared_parameters(prepared.record.vehicle, lag_s=0.0)
        found.append({each.effect.identifier: each for each in tell_unplanned([prepared], base)})
    for name in ("rotor_drag", "climb_inflow", "flapping_moment"):
        first, second = (each[name] for each in found)
        assert first.stands and second.stands, name
        for parameter, value in first.values.items():
            other = second.values[parameter]
            assert abs(value.value - other.value) < 3.0 * np.hypot(value.std, other.std), parameter
    assert not any(each["angular_damping"].stands for each in found), (
        "the telemetry does not show it: it may not be claimed"
    )
