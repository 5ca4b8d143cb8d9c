"""Whether a vehicle can fly a path: checked before a plan is accepted, with the reason when it cannot."""

from __future__ import annotations

import numpy as np

from groundstation.trajectory import Sequence, rigid_motion
from groundstation.vehicle import Vehicle

_GRID_S = 0.01
_MARGIN_M = 0.02  # how far a path may leave the room: the room is the planner's business, not a wall
_HEADROOM = 0.95  # share of a rotor's thrust that a path may ask for; the rest is for the controller
_TILT_MAX_RAD = 0.65


def why_not(vehicle: Vehicle, path: Sequence, floor_m: float) -> str:
    """One sentence that says why the vehicle cannot fly the path, or nothing.

    The motion is the exact one of the path; rotor thrusts follow from the declared mass, tensor and allocation.

    Args:
        vehicle: as declared.
        path: take-off to landing.
        floor_m: height of the origin when it stands.
    """
    t = np.arange(0.0, path.duration_s, _GRID_S)
    motion = rigid_motion(path.sample(t), vehicle.gravity_m_s2)
    if not np.isfinite(motion.position_m).all():
        return "the path is not finite; plan again."
    low = motion.position_m[:, 2].min() - floor_m
    if low < -_MARGIN_M:
        return f"the path goes {-low:.2f} m below the floor the drone stands on; raise its z offset."
    reason = _leaves_room(vehicle, motion.position_m)
    if reason:
        return reason
    tilt = np.abs(motion.euler_rad[:, :2]).max()
    if tilt > _TILT_MAX_RAD:
        at = t[np.abs(motion.euler_rad[:, :2]).max(axis=1).argmax()]
        return (
            f"the path asks for {np.degrees(tilt):.0f} degrees of tilt after {at:.1f} s; the drone tilts "
            f"{np.degrees(_TILT_MAX_RAD):.0f} at most."
        )
    return _lacks_thrust(vehicle, motion, t)


def _leaves_room(vehicle: Vehicle, position: np.ndarray) -> str:
    limits = vehicle.limits
    for axis, name, bound in ((0, "x", limits.x_max_m), (1, "y", limits.y_max_m)):
        reach = np.abs(position[:, axis]).max()
        if bound is not None and reach > bound + _MARGIN_M:
            return f"the path reaches {name} = {reach:.2f} m; the vehicle file allows {bound:g} m."
    top = position[:, 2].max()
    if limits.z_max_m is not None and top > limits.z_max_m + _MARGIN_M:
        return f"the path rises to {top:.2f} m; the vehicle file allows {limits.z_max_m:g} m."
    return ""


def _lacks_thrust(vehicle: Vehicle, motion, t: np.ndarray) -> str:
    tensor = vehicle.inertia_tensor()
    w, w1 = motion.angular_velocity_body_rad_s, motion.angular_acceleration_body_rad_s2
    torque = w1 @ tensor.T + np.cross(w, w @ tensor.T)
    wrench = np.column_stack([vehicle.mass_kg * motion.specific_thrust_m_s2, torque])
    total = vehicle.limits.thrust_max_n
    if total is not None and wrench[:, 0].max() > total:
        return f"the path asks for {wrench[:, 0].max():.1f} N of thrust; the vehicle file allows {total:g} N."
    if vehicle.rotors.input == "wrench":
        return ""
    thrusts = wrench @ vehicle.mixing().T
    most = vehicle.rotor_thrust_max_n()
    when, rotor = np.unravel_index(thrusts.argmax(), thrusts.shape)
    if thrusts[when, rotor] > _HEADROOM * most:
        return (
            f"the path asks rotor {rotor + 1} for {thrusts[when, rotor]:.2f} N after {t[when]:.1f} s; it gives "
            f"{most:.2f} N, of which {1.0 - _HEADROOM:.0%} are kept for control."
        )
    when, rotor = np.unravel_index(thrusts.argmin(), thrusts.shape)
    if thrusts[when, rotor] < 0.0:
        return f"the path asks rotor {rotor + 1} to pull downwards after {t[when]:.1f} s; fly it more gently."
    return ""
