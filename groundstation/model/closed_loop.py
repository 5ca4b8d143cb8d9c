"""The seed's closed loop: rigid body (1)-(4) under its PID (28)-(32), in the conditions of section IV-A.

Used to ask which parameter set flies most like the recorded flight (Tables 4-6). Fixed step of 1 ms; position and yaw
are sampled and held at the motion capture's rate, roll, pitch and their rates at the IMU's; commanded tilt is
differentiated by 20 s/(s + 20); thrust and torque saturate. The controller knows the declared mass, whatever the plant
weighs.

Two corrections to the printed equations: virtual work with d(eta)/dt = W omega gives tau = W^T (...) in (31), and
(29)-(30) need no factor m, f_p being a force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.frames import quat_from_euler, quat_rotate
from groundstation.model.signals import Signals
from groundstation.trajectory import Trajectory
from groundstation.vehicle import Vehicle

if TYPE_CHECKING:
    from groundstation.model.closed_loop_kernel import Law

Array = NDArray[np.float64]

STEP_S = 0.001
ROUNDS = 5
Wrench = Callable[[Signals], Array]


@dataclass(frozen=True, slots=True)
class Conditions:
    """How the loop is sampled and limited (section IV-A).

    Attributes:
        pose_hz: rate at which position, velocity, yaw and yaw rate are sampled and held.
        imu_hz: rate at which roll, pitch and their rates are sampled and held.
        rotor_level: limit each rotor's thrust; False limits the wrench, as the seed does.
    """

    pose_hz: float = 30.0
    imu_hz: float = 500.0
    rotor_level: bool = False


@dataclass(frozen=True, slots=True)
class Body:
    """The rigid body that the controller flies.

    Attributes:
        mass_kg: its mass.
        inertia: its tensor about the centre of mass, kg m^2, shape (3, 3).
    """

    mass_kg: float
    inertia: ArrayLike


@dataclass(frozen=True, slots=True)
class Start:
    """Where a simulation starts, and how long it lasts.

    Attributes:
        at_s: time on the trajectory; before the trajectory's start it is held.
        duration_s: None: to the trajectory's end.
        state: position (world), velocity (body), roll, pitch, yaw, body rates, shape (12,); None: on the trajectory, at
            rest and level.
    """

    at_s: float = 0.0
    duration_s: float | None = None
    state: ArrayLike | None = None


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """A simulated flight, one row per millisecond.

    Attributes:
        t_s: seconds from the start, shape (k,).
        position_m: world, shape (k, 3).
        euler_rad: roll, pitch, yaw, shape (k, 3).
        velocity_body_m_s: shape (k, 3).
        rate_rad_s: body rates, shape (k, 3).
        wrench: applied [F_z, tau_x, tau_y, tau_z], N and N m, shape (k, 4).
    """

    t_s: Annotated[Array, "k"]
    position_m: Annotated[Array, "k 3"]
    euler_rad: Annotated[Array, "k 3"]
    velocity_body_m_s: Annotated[Array, "k 3"]
    rate_rad_s: Annotated[Array, "k 3"]
    wrench: Annotated[Array, "k 4"]


def simulate_closed_loop(
    vehicle: Vehicle,
    trajectory: Trajectory,
    body: Body,
    start: Start | None = None,
    *,
    conditions: Conditions | None = None,
    wrench: Wrench | None = None,
) -> ClosedLoop:
    """Fly a trajectory with a given body.

    Args:
        vehicle: declared: gains, limits, gravity, and the mass that the controller reckons with.
        trajectory: desired x, y, z, yaw.
        body: what flies.
        start: None: the whole trajectory, from rest on it.
        conditions: sampling and limits; None: those of section IV-A.
        wrench: body force and torque of effects, (k, 6) from signals. The loop is flown again with what the last
            round's motion makes of them (waveform relaxation, Lelarasmee 1982), four times; effects are weak beside the
            loop.
    """
    from groundstation.model.closed_loop_kernel import Plant, fly

    start = start or Start()
    length = trajectory.duration_s - start.at_s if start.duration_s is None else start.duration_s
    t = np.asarray(STEP_S * np.arange(int(length / STEP_S + 1e-9) + 1), dtype=float)
    flat = trajectory.sample(start.at_s + t)
    wanted = np.column_stack([flat.position[0], flat.position[1], flat.position[2], flat.yaw[0], flat.yaw[1]])
    if start.state is None:
        state = np.zeros(12)
        state[:3], state[8] = wanted[0, :3], wanted[0, 9]
    else:
        state = np.array(start.state, dtype=float)
    tensor = np.ascontiguousarray(body.inertia, dtype=float)
    plant = Plant(float(body.mass_kg), tensor, np.ascontiguousarray(np.linalg.inv(tensor)))
    law = _control_law(vehicle, conditions or Conditions())

    def flight(push: Array) -> ClosedLoop:
        states, wrenches = fly(wanted, state, push, law, plant)
        return ClosedLoop(t, states[:, :3], states[:, 6:9], states[:, 3:6], states[:, 9:], wrenches)

    flown = flight(np.zeros((len(t), 6)))
    if wrench is not None:
        for _ in range(ROUNDS - 1):
            flown = flight(np.ascontiguousarray(np.nan_to_num(wrench(_signals(vehicle, flown)))))
    return flown


def _control_law(vehicle: Vehicle, conditions: Conditions) -> Law:
    """What the kernel takes of the controller."""
    from groundstation.model.closed_loop_kernel import Law

    control, limits = vehicle.control, vehicle.limits
    gains = np.array(
        [control.position_p, control.position_i, control.position_d,
         control.attitude_p, control.attitude_i, control.attitude_d]
    )  # fmt: skip
    believed = np.array([vehicle.mass_kg, vehicle.gravity_m_s2, control.derivative_filter_rad_s])
    rotor_max = vehicle.rotor_thrust_max_n() if conditions.rotor_level else np.inf
    thrust_max = limits.thrust_max_n or vehicle.rotor_thrust_max_n() * vehicle.rotors.count
    most = np.array([thrust_max, limits.torque_max_nm or np.inf, rotor_max])
    rates = np.array([conditions.pose_hz, conditions.imu_hz])
    allocation, mixing = np.ascontiguousarray(vehicle.six_row_allocation()), np.ascontiguousarray(vehicle.mixing())
    return Law(believed, gains, most, allocation, mixing, rates, STEP_S)


def _signals(vehicle: Vehicle, flown: ClosedLoop) -> Signals:
    """What effects depend on, along a simulated flight; there is no battery in it."""
    from groundstation.model.rotors import thrusts_for

    quaternion = quat_from_euler(*flown.euler_rad.T)
    thrust = flown.wrench @ thrusts_for(vehicle).T
    motor = thrust if vehicle.rotors.input == "wrench" else vehicle.motor_for_thrust(thrust)
    unknown = np.full(len(flown.t_s), np.nan)
    return Signals(
        t_s=flown.t_s,
        position_m=flown.position_m,
        velocity_world_m_s=quat_rotate(quaternion, flown.velocity_body_m_s),
        quaternion=quaternion,
        rate_rad_s=flown.rate_rad_s,
        motor=motor,
        lagged=motor,
        lagged_rate=np.gradient(motor, flown.t_s, axis=0),
        thrust_n=thrust,
        voltage_v=unknown,
        charge_as=unknown,
    )
