r"""Inverse dynamics, in the band where rotor telemetry that is filtered and late still has the torque.

    torque   tau(T) = J w' - (lag) J w'' + D w + k (-v_y, v_x, 0) + trim + T offset    roll, pitch, yaw
    force    m f_xy = -d v_xy s + m bias               the accelerometer is the force: it needs no rotor
             m f_xy = -c |v| v_xy + m bias             the same, of a frame instead of rotors
    lift     m f_z  = a T + b (T - mean)^2 + (lag) T' - k_w v_z s + l T |v_xy|^2 + m bias

with T the thrust, f the specific force, v the velocity in the body, w the body rates, s the rotors' speed over that at
hover. The rotors' wrench is the output: its noise attenuates nothing (inverse dynamics: Janot, Vandanjon and Gautier
2014). J w'' is what a delay or a filter of the telemetry does, to first order; above the band it is of second order,
and the torque is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.lagged_instruments import Equation
from groundstation.identification.preparation import Prepared
from groundstation.linear_filters import both_ways, low_pass
from groundstation.model.parameters import Parameters
from groundstation.model.rotors import wrench_matrix
from groundstation.model.signals import hover_share

Array = NDArray[np.float64]

BAND_HZ = 1.5
"""Edge of the band: telemetry 50 ms late has a phase error of 0.47 rad there, whose second order is 0.11. Chosen before
benchmarks.unplanned, with its seeds 4000 to 4003 and shared/data/nanodrone in sight."""
PART_S = 15.0
"""Length of the parts that check each other: many manoeuvres in each, and two or more in half a minute."""
EDGE_S = 0.4
"""Left out beside every edge of what is used: the low pass looks that far."""
SAMPLES_PER_BAND = 8
"""Samples per period of the band's edge."""

Named = list[tuple[Equation, tuple[str, ...]]]
"""Equations and the names of the parameters that the first of their columns have."""


@dataclass(frozen=True, slots=True)
class Slow:
    """Signals of a flight or a part of it below the band's edge, evenly sampled.

    Attributes:
        used: which samples count, (k,). step_s: of the samples.
        torque, thrust: by the declared constants, under the anchor, (k, 3) and (k,).
        rate, turning, jerk: body rates and their derivatives, (k, 3).
        velocity: in the body, (k, 3). drag: |v| v, (k, 3). speed2: |v_xy|^2, (k,).
        share: the rotors' speed over that at hover, (k,).
        force: specific force, (k, 3).
        tensor, mass_kg: declared, and of the base fit under the anchor. scale_n, arm_m: weight and arm, the scales of
            the equations.
    """

    used: NDArray[np.bool_]
    step_s: float
    torque: Array
    thrust: Array
    rate: Array
    turning: Array
    jerk: Array
    velocity: Array
    drag: Array
    speed2: Array
    share: Array
    force: Array
    tensor: Array
    mass_kg: float
    scale_n: float
    arm_m: float


def without_plan(prepared: Prepared) -> bool:
    """Neither plan nor setpoints are recorded: a smoothed path flown is no plan."""
    return prepared.flight.plan is None and prepared.flight.setpoint is None


def _low_pass(edge_hz: float, rate_hz: float, stretches: Sequence[slice]) -> Callable[[Array], Array]:
    """What keeps columns below the edge, each stretch by itself: what stands in a gap is of no flight."""
    sections = low_pass(2, edge_hz, rate_hz)

    def low(values: Array) -> Array:
        out = np.zeros(values.shape)
        for stretch in stretches:
            out[stretch] = both_ways(sections, np.nan_to_num(values[stretch]))
        return out

    return low


def slow(prepared: Prepared, p: Parameters) -> Slow:
    """A whole flight below the band's edge, with the mass, lag and dead time of a base fit ``p``."""
    record, vehicle = prepared.record, prepared.record.vehicle
    rate_hz = 1.0 / float(np.median(np.diff(record.t_s)))
    edge = min(BAND_HZ, 0.2 * rate_hz)
    cut = slice(None, None, max(1, round(rate_hz / (SAMPLES_PER_BAND * edge))))
    margin = round(EDGE_S * rate_hz)
    stretches = [slice(*ends) for ends in _runs(record.keep) if ends[1] - ends[0] > 2 * margin]
    low = _low_pass(edge, rate_hz, stretches)
    signals = prepared.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope)
    anchor = vehicle.mass_kg / p.mass_kg if vehicle.identification.anchor == "mass" else 1.0
    wrench = anchor * low(signals.thrust_n @ wrench_matrix(vehicle).T)
    sideways = np.pad(wrench[:, :2], ((0, 0), (0, 1))) / (anchor * p.mass_kg)  # of tilted rotors
    velocity = signals.velocity_body_m_s()
    rate = low(record.rate_rad_s)
    turning = np.gradient(rate, record.t_s, axis=0)
    used = np.zeros(len(record.keep), bool)
    for stretch in stretches:
        used[stretch.start + margin : stretch.stop - margin] = True
    return Slow(
        used=used[cut],
        step_s=float(cut.step) / rate_hz,
        torque=wrench[cut, 3:],
        thrust=wrench[cut, 2],
        rate=rate[cut],
        turning=turning[cut],
        jerk=np.gradient(turning, record.t_s, axis=0)[cut],
        velocity=low(velocity)[cut],
        drag=low(np.linalg.norm(velocity, axis=1, keepdims=True) * velocity)[cut],
        speed2=low((velocity[:, :2] ** 2).sum(axis=1))[cut],
        share=low(hover_share(signals, vehicle))[cut],
        force=(low(record.force_m_s2) - sideways)[cut],
        tensor=vehicle.inertia_tensor(),
        mass_kg=anchor * p.mass_kg,
        scale_n=vehicle.mass_kg * vehicle.gravity_m_s2,
        arm_m=vehicle.arm_m(),
    )


def _runs(keep: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one past the last of each run of what is kept."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], keep, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def parts_of(whole: Slow) -> list[Slow]:
    """Equal shares of what is used of a flight, two at least."""
    used_s = float(whole.used.sum()) * whole.step_s
    count = max(2, int(used_s / PART_S))
    number = np.minimum(np.cumsum(whole.used) * count // max(int(whole.used.sum()), 1), count - 1)
    return [replace(whole, used=whole.used & (number == index)) for index in range(count)]


def torque_equations(part: Slow, hubs_damping_nms: float = 0.0) -> Named:
    """Roll, pitch and yaw, in shares of weight times arm: damping, flapping, then inertia, lateness and an offset of
    the centre of mass; the yaw damping of a drag that acts at the hubs is known.
    """
    ones = np.ones((len(part.thrust), 1))
    gyroscopic = np.cross(part.rate, part.rate @ part.tensor)
    scale = part.scale_n * part.arm_m
    out: Named = []
    for axis, name in enumerate("xyz"):
        columns, own = [part.rate[:, axis]], (f"damping_{name}_nms",)
        if axis < 2:
            columns.append(-part.velocity[:, 1] if axis == 0 else part.velocity[:, 0])
            own = (*own, "k_nm_s_m")
        columns += [part.turning[:, axis], part.jerk[:, axis], part.thrust - part.thrust.mean()]
        known = hubs_damping_nms * part.share * part.rate[:, 2] if axis == 2 else 0.0
        output = (part.torque[:, axis] - gyroscopic[:, axis] - known) / scale
        out.append((_equation(part, output, np.column_stack(columns) / scale, ones, len(own)), own))
    return out


def rotor_drag_equations(part: Slow) -> Named:
    """Forward and sideways, in shares of the weight: drag of the rotors."""
    against = -part.velocity * part.share[:, None]
    return [(_sideways(part, against, axis), (f"d_{name}_kg_s",)) for axis, name in enumerate("xy")]


def body_drag_equations(part: Slow) -> Named:
    """Forward and sideways, in shares of the weight: drag of the frame."""
    return [(_sideways(part, -part.drag, axis), ("c_kg_m",)) for axis in (0, 1)]


def _sideways(part: Slow, against: Array, axis: int) -> Equation:
    ones = np.ones((len(part.thrust), 1))
    output = part.mass_kg * part.force[:, axis] / part.scale_n
    return _equation(part, output, against[:, axis, None] / part.scale_n, ones, 1)


def lift_equations(part: Slow, body_drag_kg_m: float = 0.0) -> Named:
    """Along the thrust, in shares of the weight: inflow and translational lift, then thrust constant, curve and
    lateness; the drag of a frame is known.
    """
    ones = np.ones((len(part.thrust), 1))
    output = (part.mass_kg * part.force[:, 2] + body_drag_kg_m * part.drag[:, 2]) / part.scale_n
    return [(_equation(part, output, _lift_columns(part), ones, 2), ("k_kg_s", "lift_s2_m2"))]


def moment_equations(part: Slow) -> list[Equation]:
    """The torque's equations with the moment of inertia first."""
    out: list[Equation] = []
    for equation, own in torque_equations(part):
        order = [len(own), *(index for index in range(equation.columns.shape[1]) if index != len(own))]
        out.append(replace(equation, columns=equation.columns[:, order], effects=1))
    return out


def lightness_equation(part: Slow) -> Equation:
    """f_z = T / m with inflow, lift and curve beside it: one over the mass first.

    The accelerometer's bias is left to its interval.
    """
    columns = _lift_columns(part)[:, [2, 0, 1, 3, 4]]
    return _equation(part, part.force[:, 2] / part.scale_n, columns, np.zeros((len(part.thrust), 0)), 1)


def _lift_columns(part: Slow) -> Array:
    thrust = part.thrust / part.scale_n
    mean = float(np.mean(thrust[part.used])) if part.used.any() else 1.0
    climb = -part.velocity[:, 2] * part.share / part.scale_n
    late = np.gradient(thrust, part.step_s)  # of telemetry: in a band it looks like an inflow
    return np.column_stack([climb, thrust * part.speed2, thrust, (thrust - mean) ** 2, late])


def _equation(part: Slow, output: Array, columns: Array, known: Array, effects: int) -> Equation:
    return Equation(output, columns, known, part.used, part.step_s, effects)
