"""A plan that is flown along another heading than its own is compared with the flight in the flight's frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.flightdata import FlightData, Stream
from groundstation.frames import quat_from_euler, quat_rotate, quat_rotate_inverse
from groundstation.identification.instruments import FlownMotion, planned_motion
from groundstation.paths import find_config
from groundstation.trajectory import load_plan, rigid_motion
from groundstation.vehicle import load_vehicle

RATE_HZ = 100.0


def _flown(turn_rad: float) -> tuple[FlightData, FlownMotion]:
    """A plan flown without error along a heading, as its sensors tell it."""
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 1.0})
    series = plan.series()
    t_s = np.arange(0.0, series.duration_s, 1.0 / RATE_HZ)
    motion = rigid_motion(series.sample(t_s))
    euler = motion.euler_rad + np.array([0.0, 0.0, turn_rad])
    about = quat_from_euler(*np.array([[0.0, 0.0, turn_rad]]).T)[0]
    every = np.tile(about, (len(t_s), 1))
    path, velocity = quat_rotate(every, motion.position_m), quat_rotate(every, motion.velocity_world_m_s)
    force = np.zeros((len(t_s), 3))
    force[:, 2] = motion.specific_thrust_m_s2
    flown = FlownMotion(
        t_s, motion.angular_velocity_body_rad_s, force, (quat_from_euler(*euler.T), path, velocity), "imu", RATE_HZ
    )
    motors = Stream(t_s, np.ones((len(t_s), 4)), ("m1", "m2", "m3", "m4"))
    return FlightData("placed", load_vehicle(find_config("vehicles", "qball2")), motors, plan=plan), flown


@pytest.mark.parametrize("turn_rad", [0.0, 2.0, -3.1])
def test_a_plan_that_is_flown_along_another_heading_tells_the_flights_own_velocities(turn_rad):
    """Two flights that began along different headings told no drag together that each told alone."""
    flight, flown = _flown(turn_rad)
    keep = np.ones(len(flown.t_s), dtype=bool)
    planned = planned_motion(flight, flown, keep, 0.0, stand_in=False)
    assert planned is not None
    attitude, _, velocity = flown.smooth
    true = quat_rotate_inverse(attitude, velocity)
    slopes = np.sum(planned.velocity_body_m_s * true, axis=0) / np.sum(true**2, axis=0)
    assert slopes == pytest.approx(np.ones(3), abs=0.1), f"turned by {turn_rad} rad"
    world = quat_rotate(planned.quaternion, planned.velocity_body_m_s)
    assert np.sum(world * velocity) / np.sum(velocity**2) == pytest.approx(1.0, abs=0.1)


def test_a_heading_that_comes_and_goes_turns_no_plan():
    """A vehicle that follows another yaw than the plan's has no heading beside it."""
    flight, flown = _flown(0.0)
    yaw = np.linspace(0.0, 20.0, len(flown.t_s))
    turning = quat_from_euler(0.0 * yaw, 0.0 * yaw, yaw)
    other = replace(flown, smooth=(turning, flown.smooth[1], flown.smooth[2]))
    keep = np.ones(len(flown.t_s), dtype=bool)
    planned = planned_motion(flight, other, keep, 0.0, stand_in=False)
    assert planned is not None
    path = flown.smooth[1]
    assert np.sum((planned.position_m - planned.position_m.mean(0)) * (path - path.mean(0))) > 0.0
