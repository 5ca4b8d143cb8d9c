"""What a plan must keep: the room, speeds and tilt a user states, and what the rotors and the battery can give.

A limit has one name everywhere: that of ``[limits]`` in the vehicle file, and ``rotor_thrust_min_n`` and
``rotor_thrust_max_n`` for the range of a single rotor at the empty battery's voltage. Speed is meant per axis and tilt
for roll and pitch each, as in the seed paper (section III-B); acceleration is the vector's length.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationError

from groundstation.errors import BadInput
from groundstation.trajectory import FourierSeries, RigidMotion, rigid_motion
from groundstation.vehicle import Limits, Vehicle

Array = NDArray[np.float64]

UNITS = {"m": "m", "rad": "rad", "m_s": "m/s", "rad_s": "rad/s", "m_s2": "m/s^2", "n": "N", "nm": "N m"}

STEP_S = 0.0005
"""Limits are verified at such steps."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """Limits in force for one vehicle.

    Attributes:
        limits: of the vehicle file, with overrides; None is no limit.
        rotor_thrust_n: least and greatest thrust of one rotor.
        mass_kg, inertia_kg_m2: nominal, to turn a motion into a wrench.
        mixing: rotor thrusts for [F_z, tau_x, tau_y, tau_z], shape (n, 4).
        gravity_m_s2: local gravity.
    """

    limits: Limits
    rotor_thrust_n: tuple[float, float]
    mass_kg: float
    inertia_kg_m2: Array
    mixing: Array
    gravity_m_s2: float

    def stated(self) -> dict[str, float]:
        """Every limit that is in force, by name."""
        named = self.limits.model_dump(exclude_none=True)
        least, greatest = self.rotor_thrust_n
        named["rotor_thrust_min_n"] = least
        if np.isfinite(greatest):
            named["rotor_thrust_max_n"] = greatest
        return named


def rotor_thrust_range_n(vehicle: Vehicle) -> tuple[float, float]:
    """Thrust one rotor can be relied on for: from rest to full command at the empty battery's voltage.

    A battery at voltage V turns a rotor at most V/V_full as fast, so thrust falls with its square.
    """
    battery, rotors = vehicle.battery, vehicle.rotors
    ratio = battery.empty_v / battery.full_v if battery.empty_v and battery.full_v else 1.0
    if rotors.thrust_curve is not None:
        return max(rotors.thrust_curve[0], 0.0), float(vehicle.thrust(1.0, ratio))
    return 0.0, vehicle.rotor_thrust_max_n() * ratio**2


def envelope(vehicle: Vehicle, overrides: Mapping[str, float | None] | None = None) -> Envelope:
    """The limits in force for a vehicle, the given ones replacing those of its file.

    Raises:
        BadInput: an override that is no limit or no possible value, or limits that exclude even hovering.
    """
    given = {key: value for key, value in (overrides or {}).items() if value is not None}
    unknown = sorted(set(given) - set(Limits.model_fields))
    if unknown:
        raise BadInput(f"{unknown[0]} is not a limit; there are {', '.join(Limits.model_fields)}.")
    try:
        limits = Limits.model_validate(vehicle.limits.model_dump() | given)
    except ValidationError as error:
        first = error.errors()[0]
        raise BadInput(f"limit {first['loc'][0]} = {first['input']}: {first['msg'].lower()}; correct it.") from None
    allocation = vehicle.allocation()
    rank = np.linalg.matrix_rank(allocation, tol=1e-9 * np.abs(allocation).max())
    if rank < 4 and not (rank == 3 and vehicle.turns_freely()):
        raise BadInput(
            f"{vehicle.name}: the rotors cannot make thrust and three torques independently, so no attitude can be "
            "flown; correct position_m, axis and spin in [rotors]."
        )
    result = Envelope(
        limits=limits,
        rotor_thrust_n=rotor_thrust_range_n(vehicle),
        mass_kg=vehicle.mass_kg,
        inertia_kg_m2=vehicle.inertia_tensor(),
        mixing=vehicle.mixing(),
        gravity_m_s2=vehicle.gravity_m_s2,
    )
    _check_hover(result, vehicle.name)
    return result


def _check_hover(envelope: Envelope, name: str) -> None:
    limits, weight = envelope.limits, envelope.mass_kg * envelope.gravity_m_s2
    if limits.z_min_m is not None and limits.z_max_m is not None and limits.z_max_m <= limits.z_min_m:
        raise BadInput(
            f"z_max_m = {limits.z_max_m:g} m is not above z_min_m = {limits.z_min_m:g} m; "
            f"raise z_max_m by more than {limits.z_min_m - limits.z_max_m:g} m."
        )
    if limits.thrust_max_n is not None and limits.thrust_max_n <= weight:
        raise BadInput(
            f"thrust_max_n = {limits.thrust_max_n:g} N does not carry {name}, which weighs {weight:.4g} N; "
            f"{weight - limits.thrust_max_n:.3g} N are missing to hover."
        )
    thrusts = envelope.mixing @ np.array([weight, 0.0, 0.0, 0.0])
    least, greatest = envelope.rotor_thrust_n
    if thrusts.max() >= greatest:
        raise BadInput(
            f"rotor_thrust_max_n = {greatest:.4g} N (a rotor of {name} at the empty battery's voltage): hovering takes "
            f"{thrusts.max():.4g} N of rotor {int(thrusts.argmax()) + 1}, {thrusts.max() - greatest:.3g} N too much; "
            "lighten the vehicle or correct [rotors] and [battery]."
        )
    if thrusts.min() <= least:
        raise BadInput(
            f"rotor_thrust_min_n = {least:.4g} N: hovering would take {thrusts.min():.4g} N of rotor "
            f"{int(thrusts.argmin()) + 1} of {name}, {least - thrusts.min():.3g} N too little; correct [rotors]."
        )


def check_start(envelope: Envelope, start: ArrayLike) -> None:
    """Refuse a start (x, y, z, yaw) outside the limits.

    Raises:
        BadInput: names the limit and how far outside it the start lies.
    """
    x, y, z, yaw = np.asarray(start, dtype=float)
    limits = envelope.limits
    for label, value, upper, name in (
        ("x", abs(x), limits.x_max_m, "x_max_m"),
        ("y", abs(y), limits.y_max_m, "y_max_m"),
        ("yaw", abs(yaw), limits.yaw_max_rad, "yaw_max_rad"),
        ("z", z, limits.z_max_m, "z_max_m"),
        ("z", -z, None if limits.z_min_m is None else -limits.z_min_m, "z_min_m"),
    ):
        if upper is not None and value > upper:
            raise BadInput(
                f"the start lies outside {name} = {abs(upper):g}: {label} is {value - upper:.4g} too far; "
                "move the start or widen the limit."
            )


def wrench(motion: RigidMotion, envelope: Envelope) -> Array:
    """[F_z, tau_x, tau_y, tau_z] that a motion takes of the nominal vehicle, shape (k, 4)."""
    rate, inertia = motion.angular_velocity_body_rad_s, envelope.inertia_kg_m2
    torque = motion.angular_acceleration_body_rad_s2 @ inertia + np.cross(rate, rate @ inertia)
    return np.column_stack([envelope.mass_kg * motion.specific_thrust_m_s2, torque])


def excesses(motion: RigidMotion, envelope: Envelope) -> dict[str, float]:
    """By how much a motion exceeds each limit in force, in the limit's unit (negative: what is left)."""
    limits = envelope.limits
    forces = wrench(motion, envelope)
    rotors = forces @ envelope.mixing.T
    least, greatest = envelope.rotor_thrust_n
    position, yaw = motion.position_m, motion.euler_rad[:, 2]
    largest = {
        "x_max_m": np.abs(position[:, 0]).max(),
        "y_max_m": np.abs(position[:, 1]).max(),
        "z_max_m": position[:, 2].max(),
        "yaw_max_rad": np.abs(yaw).max(),
        "speed_max_m_s": np.abs(motion.velocity_world_m_s).max(),
        "yaw_rate_max_rad_s": np.abs(motion.euler_rate_rad_s[:, 2]).max(),
        "acceleration_max_m_s2": np.linalg.norm(motion.acceleration_world_m_s2, axis=1).max(),
        "tilt_max_rad": np.abs(motion.euler_rad[:, :2]).max(),
        "thrust_max_n": forces[:, 0].max(),
        "torque_max_nm": np.abs(forces[:, 1:]).max(),
    }
    result = {
        name: float(value) - bound for name, value in largest.items() if (bound := getattr(limits, name)) is not None
    }
    if limits.z_min_m is not None:
        result["z_min_m"] = float(limits.z_min_m - position[:, 2].min())
    result["rotor_thrust_min_n"] = float(least - rotors.min())
    if np.isfinite(greatest):
        result["rotor_thrust_max_n"] = float(rotors.max() - greatest)
    return result


def series_excesses(series: FourierSeries, envelope: Envelope, step_s: float = STEP_S) -> dict[str, float]:
    """:func:`excesses` over one period, sampled so finely that no coarser grid can see more than rounding beyond it."""
    t = np.linspace(0.0, min(series.period_s, series.duration_s), int(np.ceil(series.period_s / step_s)) + 1)
    return excesses(rigid_motion(series.sample(t), envelope.gravity_m_s2), envelope)


def largest_violation(series: FourierSeries, envelopes: tuple[Envelope, ...], step_s: float = STEP_S) -> float:
    """The largest excess over any limit of any vehicle; zero when all are kept."""
    return max(0.0, *(max(series_excesses(series, each, step_s).values()) for each in envelopes))
