"""Mass and moments of flights without a plan: right within their intervals, or not told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from groundstation.diagnosis.pipeline import diagnose
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.low_frequency import without_plan
from groundstation.identification.pipeline import identify
from groundstation.identification.preparation import prepare, prepare_all
from groundstation.identification.unplanned import applies, by_low_frequencies
from groundstation.paths import find_config
from groundstation.recording.load import load_flight
from groundstation.vehicle import load_vehicle
from studies.unplanned import flights_of

MOMENTS = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


@pytest.mark.parametrize("seed", [4008, 4011])
def test_what_is_published_lies_in_its_interval_where_lift_and_late_telemetry_bend_a_fit(seed: int):
    print("seed", seed)
    (flight, _), truth, *_ = flights_of(seed)
    found = identify([flight])
    assert found.best == "LF" and "neither plan nor setpoints" in found.best_reason
    published, true = found.methods["LF"].parameters, truth.parameters()
    assert abs(published["mass_kg"].value / true["mass_kg"] - 1.0) < 0.004
    for name, estimate in published.items():
        assert abs(estimate.value - true[name]) < 2.5 * estimate.std, name
    assert {"ixy_kg_m2", "ixz_kg_m2", "iyz_kg_m2"} <= set(found.not_identifiable)


@pytest.mark.parametrize("lacking", [("imu", "state"), ("mocap", "state"), ("mocap", "imu")])
def test_what_is_published_of_a_flight_that_lacks_streams_lies_in_its_interval(lacking: tuple[str, ...]):
    """The fit to the rates gave this vehicle 1.3 times its mass and 2.7 to 4.4 times its moments."""
    print("seed", 7711)
    (flight, _), truth, *_ = flights_of(7711)
    found = identify([replace(flight, **dict.fromkeys(lacking))])
    published, true = found.methods[found.best].parameters, truth.parameters()
    assert found.best == "LF" and "mass_kg" in published
    for name, estimate in published.items():
        assert abs(estimate.value - true[name]) < 2.5 * estimate.std, name


def test_a_moment_that_feedback_blows_up_is_not_told_for_being_large():
    """The residual of a moment is as large as it is; by the declared one it is nothing that the flight shows."""
    print("seed", 4008)
    (flight, _), *_ = flights_of(4008)
    names = [n for n in MOMENTS if n in identify([flight]).methods["LF"].parameters]
    assert names
    small = flight.vehicle.model_copy(
        update={"inertia_kg_m2": flight.vehicle.inertia_kg_m2.model_copy(
            update={n[1:3]: 0.02 * getattr(flight.vehicle.inertia_kg_m2, n[1:3]) for n in MOMENTS}
        )}
    )  # fmt: skip
    hidden = identify([replace(flight, vehicle=small)]).not_identifiable
    assert set(names) <= set(hidden)


def test_moments_that_a_slow_figure_of_eight_does_not_show_are_not_told():
    print("seed", 4009)
    (flight, _), *_ = flights_of(4009)
    found = identify([flight])
    assert not set(MOMENTS) & set(found.methods[found.best].parameters)
    assert set(MOMENTS) <= set(found.not_identifiable)


def test_a_diagnosis_tells_the_same_masses_and_moments_as_an_identification():
    print("seed", 4002)
    (flight, _), *_ = flights_of(4002)
    found, diagnosis = identify([flight]), diagnose([flight])
    own = found.methods["LF"].parameters
    assert set(own) == set(diagnosis.parameters_after) & {"mass_kg", *MOMENTS}
    for name, estimate in own.items():
        assert diagnosis.parameters_after[name].value == pytest.approx(estimate.value, rel=0.01)
    assert "climb_inflow" in {finding.effect for finding in diagnosis.findings}


def test_a_flight_with_a_plan_is_not_told_this_way():
    (flight, _), *_ = flights_of(4002)
    prepared = prepare(flight)
    assert without_plan(prepared) and applies([prepared])
    setpoint = flight.motors
    planned = replace(prepared, flight=replace(flight, setpoint=setpoint))
    assert not without_plan(planned) and not applies([planned])


def test_low_frequencies_go_by_the_thrust_curve_that_the_fit_found():
    """The declared curve is another vehicle's: by it the weighed 27 g come out as 33.5 +- 0.5."""
    log = Path(__file__).parents[2] / "shared" / "data" / "crazyflie-1khz" / "log15"
    if not log.exists():
        pytest.skip(f"the measured flights are not there: {log}")
    vehicle = load_vehicle(find_config("vehicles", "crazyflie21"))
    prepared = prepare_all([load_flight(log, vehicle=vehicle, start_s=55.0, end_s=63.0)], ())
    fitted = fit_dynamics(prepared).best
    low = by_low_frequencies(prepared, fitted)
    assert "thrust_curve_c2_n" in fitted.names
    assert abs(low.value("mass_kg") - 0.027) < 2.0 * low.std("mass_kg") < 0.003
    assert abs(low.value("ixx_kg_m2") - fitted.value("ixx_kg_m2")) < 1.0 * low.std("ixx_kg_m2")
