"""What one instant of a plan needs and reveals, with exact first and second derivatives (CasADi).

Inputs are the flat outputs of one instant: position, velocity, acceleration, jerk, snap (three each), yaw and its first
two derivatives. Attitude is that of eq. (26)-(27); body rates and their derivatives come from differentiating it along
the trajectory, independently of the closed forms in ``groundstation.trajectory``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from groundstation.planning.limits import Envelope
from groundstation.planning.problem import FLAT_INPUTS

Array = NDArray[np.float64]

_POSITION, _VELOCITY, _ACCELERATION, _JERK, _SNAP, _YAW = 0, 3, 6, 9, 12, 15


class SampleFunction:
    """A vector function of one flat sample, evaluated at many at once.

    Args:
        flat: symbolic inputs, 18.
        value: symbolic outputs.

    Attributes:
        size: number of outputs.
        active: indices of the inputs they depend on.
        pattern: which output depends on which active input, shape (size, active).
        linear: whether all second derivatives vanish.
    """

    def __init__(self, flat: ca.SX, value: ca.SX) -> None:
        value = ca.cse(value)  # what occurs twice is worked out, and differentiated, once
        weight = ca.SX.sym("weight", value.numel())
        jacobian = ca.jacobian(value, flat)
        self.size = value.numel()
        self.active = np.unique(np.array(jacobian.sparsity().get_triplet()[1], dtype=int))
        active = [int(i) for i in self.active]
        hessian = ca.hessian(ca.dot(weight, value), flat)[0][active, active]
        self.linear = hessian.nnz() == 0
        self.pattern = np.array(ca.DM(jacobian[:, active].sparsity(), 1.0)) != 0.0
        self._single = {
            "value": ca.Function("value", [flat], [ca.densify(value)]),
            "jacobian": ca.Function("jacobian", [flat], [ca.densify(ca.vec(jacobian[:, active]))]),
            "hessian": ca.Function("hessian", [flat, weight], [ca.densify(ca.vec(hessian))]),
        }
        self._maps: dict[tuple[str, int], tuple[Callable[[], None], list[Array], Array, object]] = {}

    def _evaluated(self, kind: str, *inputs: Array) -> Array:
        """Outputs for columns of inputs, by memory that is shared with CasADi: its own matrices cost more than the
        numbers.
        """
        count = inputs[0].shape[1]
        if (kind, count) not in self._maps:
            mapped = self._single[kind].map(count)
            buffer, call = mapped.buffer()
            given = [np.zeros(mapped.numel_in(i)) for i in range(len(inputs))]
            found = np.zeros(mapped.numel_out(0))
            for i, each in enumerate(given):
                buffer.set_arg(i, each.data)  # pyright: ignore[reportCallIssue]: typed as C++ has it, with a size
            buffer.set_res(0, found.data)  # pyright: ignore[reportCallIssue]
            self._maps[kind, count] = call, given, found, buffer
        call, given, found, _ = self._maps[kind, count]
        for each, values in zip(given, inputs, strict=True):
            each.reshape(count, -1)[:] = values.T
        call()
        return found.copy()

    def value(self, samples: Array) -> Array:
        """Outputs at samples of shape (18, k), shape (size, k)."""
        return self._evaluated("value", samples).reshape((self.size, -1), order="F")

    def jacobian(self, samples: Array) -> Array:
        """Derivative of outputs by active inputs, shape (size, active, k)."""
        return self._evaluated("jacobian", samples).reshape((self.size, -1, samples.shape[1]), order="F")

    def hessian(self, samples: Array, weights: Array) -> Array:
        """Second derivative of each sample's weighted sum of outputs by active inputs, shape (active, active, k)."""
        active = len(self.active)
        return self._evaluated("hessian", samples, weights).reshape((active, active, -1), order="F")


@dataclass(frozen=True, slots=True)
class _Motion:
    flat: ca.SX
    tangents: ca.SX
    specific_thrust: ca.SX
    velocity_body: ca.SX
    rate: ca.SX
    turning: ca.SX


@lru_cache(maxsize=8)
def _motion(gravity_m_s2: float) -> _Motion:
    flat = ca.SX.sym("flat", FLAT_INPUTS)
    acceleration, jerk, snap = (flat[i : i + 3] for i in (_ACCELERATION, _JERK, _SNAP))
    yaw = flat[_YAW]
    forward = acceleration[0] * ca.cos(yaw) + acceleration[1] * ca.sin(yaw)
    sideways = acceleration[0] * ca.sin(yaw) - acceleration[1] * ca.cos(yaw)
    up = acceleration[2] + gravity_m_s2
    length = ca.sqrt(forward**2 + up**2)
    euler = ca.vertcat(ca.atan2(sideways, length), ca.atan2(forward, up), yaw)
    state, first, second = (ca.vertcat(v, flat[_YAW + i]) for i, v in enumerate((acceleration, jerk, snap)))
    euler_rate = ca.jtimes(euler, state, first)
    roll, pitch = euler[0], euler[1]
    rate = ca.vertcat(
        euler_rate[0] - ca.sin(pitch) * euler_rate[2],
        ca.cos(roll) * euler_rate[1] + ca.sin(roll) * ca.cos(pitch) * euler_rate[2],
        -ca.sin(roll) * euler_rate[1] + ca.cos(roll) * ca.cos(pitch) * euler_rate[2],
    )
    thrust = ca.sqrt(length**2 + sideways**2)
    up_axis = ca.vertcat(acceleration[0], acceleration[1], up) / thrust
    nose = ca.cross(ca.vertcat(-ca.sin(yaw), ca.cos(yaw), 0.0), up_axis)
    nose = nose / ca.norm_2(nose)
    velocity = flat[_VELOCITY : _VELOCITY + 3]
    return _Motion(
        flat=flat,
        tangents=ca.vertcat(sideways / length, forward / up),
        specific_thrust=thrust,
        velocity_body=ca.vertcat(
            ca.dot(nose, velocity), ca.dot(ca.cross(up_axis, nose), velocity), ca.dot(up_axis, velocity)
        ),
        rate=rate,
        turning=ca.jtimes(rate, state, first) + ca.jtimes(rate, first, second),
    )


@lru_cache(maxsize=8)
def signal_function(gravity_m_s2: float) -> SampleFunction:
    """The signals of ``information.signals``, in the same order."""
    motion = _motion(gravity_m_s2)
    columns: list[ca.SX] = []
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = 1.0
        columns.append(ca.DM(unit) @ motion.turning + ca.cross(motion.rate, ca.DM(unit) @ motion.rate))
    rows = ca.horzcat(*columns)
    return SampleFunction(
        motion.flat, ca.vertcat(motion.specific_thrust, ca.vec(rows.T), motion.velocity_body, motion.rate)
    )


@dataclass(frozen=True, slots=True)
class LimitGroup:
    """Limits evaluated together: outputs of ``function`` must stay within lower..upper, all of order one."""

    function: SampleFunction
    lower: Array
    upper: Array

    def excess(self, samples: Array) -> Array:
        """Distance beyond the nearer bound, negative inside, shape (size, k)."""
        value = self.function.value(samples)
        return np.maximum(value - self.upper[:, None], self.lower[:, None] - value)


def limit_groups(envelope: Envelope) -> dict[str, LimitGroup]:
    """Limits in force, each value divided by its bound (heights excepted)."""
    motion, limits = _motion(envelope.gravity_m_s2), envelope.limits
    flat = motion.flat
    groups: dict[str, LimitGroup] = {}

    def add(name: str, value: ca.SX, lower: float, upper: float) -> None:
        function = SampleFunction(flat, value)
        groups[name] = LimitGroup(function, np.full(function.size, lower), np.full(function.size, upper))

    for name, index, bound in (("x", 0, limits.x_max_m), ("y", 1, limits.y_max_m), ("yaw", _YAW, limits.yaw_max_rad)):
        if bound is not None:
            add(name, flat[index] / bound, -1.0, 1.0)
    if limits.z_min_m is not None or limits.z_max_m is not None:
        low = -np.inf if limits.z_min_m is None else limits.z_min_m
        add("z", flat[2] * 1.0, low, np.inf if limits.z_max_m is None else limits.z_max_m)
    if limits.speed_max_m_s is not None:
        add("speed", flat[_VELOCITY : _VELOCITY + 3] / limits.speed_max_m_s, -1.0, 1.0)
    if limits.yaw_rate_max_rad_s is not None:
        add("yaw_rate", flat[_YAW + 1] / limits.yaw_rate_max_rad_s, -1.0, 1.0)
    if limits.acceleration_max_m_s2 is not None:
        square = ca.sumsqr(flat[_ACCELERATION : _ACCELERATION + 3]) / limits.acceleration_max_m_s2**2
        add("acceleration", square, -np.inf, 1.0)
    if limits.tilt_max_rad is not None:
        add("tilt", motion.tangents / np.tan(limits.tilt_max_rad), -1.0, 1.0)
    inertia = ca.DM(envelope.inertia_kg_m2)
    torque = inertia @ motion.turning + ca.cross(motion.rate, inertia @ motion.rate)
    weight = envelope.mass_kg * envelope.gravity_m_s2
    forces = ca.vertcat(envelope.mass_kg * motion.specific_thrust, torque)
    if limits.thrust_max_n is not None:
        add("thrust", forces[0] / weight, -np.inf, limits.thrust_max_n / weight)
    if limits.torque_max_nm is not None:
        add("torque", torque / limits.torque_max_nm, -1.0, 1.0)
    hover = weight / len(envelope.mixing)
    least, greatest = (thrust / hover for thrust in envelope.rotor_thrust_n)
    add("rotors", ca.DM(envelope.mixing) @ forces / hover, least, greatest)
    return groups
