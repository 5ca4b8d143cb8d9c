"""Recorded commands on the model's grid: what counts is when each was stamped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flights import laboratory
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.identification.dynamic_fit import fit_dynamics, options_for
from groundstation.identification.preparation import prepare
from groundstation.identification.record_model import RecordModel
from groundstation.model.rotors import cumulative, motor_input
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data


@given(seed=st.integers(0, 2**32 - 1), jitter_s=st.floats(0.0, 4e-4), rate_hz=st.sampled_from([100.0, 333.0, 500.0]))
@settings(max_examples=50, deadline=None)
def test_commands_act_from_their_stamps_however_these_lie_on_the_grid(
    seed: int, jitter_s: float, rate_hz: float
) -> None:
    """The impulse up to any point of the grid is that of the commands as they were stamped."""
    random = np.random.default_rng(seed)
    t = np.arange(200) / rate_hz + random.uniform(-jitter_s, jitter_s, 200)
    values = random.uniform(0.0, 1.0, (200, 2))
    motors = motor_input(t, values, measured=False)
    found = cumulative(motors.value, motors.step_s, held=True)
    done = np.concatenate([np.zeros((1, 2)), np.cumsum(np.diff(t)[:, None] * values[:-1], axis=0)])
    expected = np.column_stack([np.interp(motors.t_s, t, column) for column in done.T])
    np.testing.assert_allclose(found, expected, atol=2e-9 * len(motors.t_s))


def test_what_a_dead_time_changes_does_not_hang_on_where_in_a_command_the_samples_fall() -> None:
    """Samples as often as commands see each at one place; a millisecond later there was a stair or none: by the
    dead time the RMS was 0.10 to 2.8 m/s^2 per second, where 1.4 is right.
    """
    vehicle = load_vehicle(find_config("vehicles", "qball2-commanded"))
    plan = load_plan(find_config("plans", "paper_table2")).model_copy(update={"vehicle": "qball2-commanded"})
    lab = laboratory()
    clock = lab.motors.clock.model_copy(update={"jitter_s": 2e-5, "phase": 0.0})
    lab = lab.model_copy(update={"motors": lab.motors.model_copy(update={"clock": clock})})
    prepared = prepare(flight_data(simulate(vehicle, plan, lab, 1)))
    p, options = fit_dynamics([prepared]).filter_error.parameters, replace(options_for(prepared), accel_delay=True)
    columns: list[np.ndarray] = []
    for delay_s in (-5e-4, -2.5e-4, 0.0, 2.5e-4, 5e-4, 1e-3, 1.5e-3):
        at = replace(p, delay_s=delay_s, lag_up_s=0.0, lag_down_s=0.0, lag_slope=0.0, extra=np.zeros(0))
        model = RecordModel(prepared.record, (), prepared.planned)
        _, sensitivity, names = model.evaluate(at, options)
        columns.append(sensitivity[:, 5, names.index("input_delay_s")])
    sizes = np.std(columns, axis=1)
    assert sizes.max() < 1.25 * sizes.min(), sizes


def test_a_dead_time_is_told_from_a_lag_where_stamps_that_lie_on_the_grid_jitter() -> None:
    """By 20 microseconds: a lag of 13 ms with a dead time of 11 was likelier by 300 nats than what was there."""
    vehicle = load_vehicle(find_config("vehicles", "qball2-commanded"))
    plan = load_plan(find_config("plans", "paper_table2")).model_copy(update={"vehicle": "qball2-commanded"})
    lab = laboratory(input_delay={"delay_s": 0.0237})
    clock = lab.motors.clock.model_copy(update={"jitter_s": 2e-5, "phase": 0.0})
    lab = lab.model_copy(update={"motors": lab.motors.model_copy(update={"clock": clock})})
    p = fit_dynamics([prepare(flight_data(simulate(vehicle, plan, lab, 1)))]).filter_error.parameters
    assert p.delay_s == pytest.approx(0.0237, abs=0.001)
    assert max(p.lag_up_s, p.lag_down_s) < 0.002
