"""A gyro in degrees per second is refused by what the poses, or without them the rotors, say; a right one is not."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.flightdata import Stream
from groundstation.paths import find_config
from groundstation.recording.plausible import check_gyro
from groundstation.vehicle import load_vehicle

VEHICLE = load_vehicle(find_config("vehicles", "qball2"))
T_S = np.arange(0.0, 10.0, 0.005)
RATE = 1.5 * np.sin(2.0 * np.pi * 0.5 * T_S)
"""About x, rad/s."""


def poses(roll_rad) -> Stream:
    q = np.stack([np.cos(roll_rad / 2), np.sin(roll_rad / 2), 0 * roll_rad, 0 * roll_rad], axis=1)
    return Stream(T_S, q, ("qw", "qx", "qy", "qz"))


def imu(rate) -> Stream:
    return Stream(T_S, np.stack([rate, 0 * rate, 0 * rate], axis=1), ("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s"))


def motors(torque_x_nm) -> Stream:
    """Speeds that hover and give a torque about x."""
    hover = VEHICLE.mass_kg * 9.81
    wrench = np.stack([np.full(len(T_S), hover), torque_x_nm, 0 * T_S, 0 * T_S], axis=1)
    thrust = np.maximum(np.linalg.lstsq(VEHICLE.allocation(), wrench.T, rcond=None)[0].T, 0.0)
    columns = tuple(f"m{number}" for number in range(1, VEHICLE.rotors.count + 1))
    return Stream(T_S, np.sqrt(thrust / VEHICLE.thrust(np.ones((1, VEHICLE.rotors.count)))[0]), columns)


@pytest.mark.parametrize(("scale", "refused"), [(1.0, False), (np.degrees(1.0), True)])
def test_the_poses_tell_degrees(scale, refused):
    roll = -1.5 / np.pi * (np.cos(np.pi * T_S) - 1.0)
    arguments = imu(scale * RATE), poses(roll), motors(0 * T_S), VEHICLE
    if refused:
        with pytest.raises(BadInput, match=r"57 times what the poses say"):
            check_gyro(*arguments)
    else:
        check_gyro(*arguments)


def test_a_vehicle_in_the_hand_is_no_gyro_in_degrees():
    """It turns as its rotors, which hardly turn, would never turn it: that is no matter of units where poses agree."""
    slow = 0.5 * RATE
    roll = -0.75 / np.pi * (np.cos(np.pi * T_S) - 1.0)
    idle = motors(1e-4 * np.cos(np.pi * T_S) * VEHICLE.inertia_tensor()[0, 0])
    check_gyro(imu(slow), poses(roll), idle, VEHICLE)
    with pytest.raises(BadInput, match="the rotors say"):
        check_gyro(imu(slow), None, idle, VEHICLE)
