r"""The nonlinear program behind a plan, with exact first and second derivatives (CasADi), solved by an interior point.

Unknowns are the coefficients of eq. (18) in a basis of the null space of the rest conditions (velocity and acceleration
vanish at both ends: :math:`\sum_l a_l = 0` and :math:`\sum_l l\,b_l = 0` in each channel), so that every iterate starts and
ends at rest; the offsets where the start is free; the base frequency where it is free. A smallest eigenvalue is not
smooth where eigenvalues meet, and at an optimum they do. It is therefore lifted: with a lower triangular L,

.. math:: \max_{\theta, s, L} s \quad\text{subject to}\quad M(\theta) = s I + L L^T ,

which is smooth and has the same solution. D- and A-optimality use the same lifting with s = 0.

Time enters as the phase of the base frequency: derivative n of a channel is :math:`\omega_f^{n-1}` times a constant matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from groundstation.planning.information import DEFAULT_NOISE, Noise, fourier_rows, parameter_scales
from groundstation.planning.limits import Envelope
from groundstation.trajectory import FourierSeries
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

_TRIANGLE = [(i, j) for i in range(6) for j in range(i + 1)]
_EIGENVALUE_CRITERIA = ("condition", "E")
_INPUTS = 18  # position, velocity, acceleration, jerk, snap (3 each), yaw and two derivatives


@dataclass(frozen=True, slots=True)
class Problem:
    """What to optimise.

    Attributes:
        vehicles: candidates for the vehicle; the worst case counts.
        envelopes: limits of each.
        criterion: one of ``criteria.CRITERIA``.
        harmonics: N of eq. (18), at least 2 (one harmonic cannot start and end at rest).
        base_frequency_rad_s: smallest and largest allowed; equal when fixed.
        duration_s: of the whole flight, for the information.
        start: x, y, z, yaw at both ends, or None where the optimiser may choose.
        noise: what disturbs the flight.
    """

    vehicles: tuple[Vehicle, ...]
    envelopes: tuple[Envelope, ...]
    criterion: str
    harmonics: int
    base_frequency_rad_s: tuple[float, float]
    duration_s: float
    start: tuple[float, float, float, float] | None = None
    noise: Noise = DEFAULT_NOISE

    @property
    def bases(self) -> tuple[Array, ...]:
        """For each channel, coefficients [a, b] from its free unknowns, shape (2 N, free), orthonormal columns.

        A channel that starts on the edge of the room cannot have jerk there either: to third order the motion would
        leave the room just before or just after.
        """
        harmonic = np.arange(1, self.harmonics + 1)
        none = np.zeros(self.harmonics)
        at_rest = [np.concatenate([harmonic**0, none]), np.concatenate([none, harmonic])]
        no_jerk = np.concatenate([harmonic**2, none])
        bases = []
        for channel, (low, high) in enumerate(self.room):
            on_edge = self.start is not None and not low < self.start[channel] < high
            conditions = np.array([*at_rest, no_jerk] if on_edge else at_rest, dtype=float)
            bases.append(np.linalg.svd(conditions)[2][len(conditions) :].T)
        return tuple(bases)

    @property
    def room(self) -> tuple[tuple[float, float], ...]:
        """Range of x, y, z and yaw that every vehicle may use."""
        ranges = []
        for channel, name in enumerate(("x_max_m", "y_max_m", "z_max_m", "yaw_max_rad")):
            low, high = -np.inf, np.inf
            for envelope in self.envelopes:
                upper = getattr(envelope.limits, name)
                lower = envelope.limits.z_min_m if channel == 2 else (None if upper is None else -upper)
                high = high if upper is None else min(high, upper)
                low = low if lower is None else max(low, lower)
            ranges.append((low, high))
        return tuple(ranges)

    @property
    def unknowns(self) -> int:
        """Length of the vector of unknowns: coefficients, offsets if the start is free, and the base frequency."""
        return sum(basis.shape[1] for basis in self.bases) + (4 if self.start is None else 0) + 1

    def series(self, unknowns: Array) -> FourierSeries:
        """The trajectory that the unknowns stand for (one period)."""
        bases, count = self.bases, self.harmonics
        edges = np.cumsum([basis.shape[1] for basis in bases])
        pieces = np.split(unknowns[: edges[-1]], edges[:-1])
        coefficients = np.stack([basis @ piece for basis, piece in zip(bases, pieces, strict=True)])
        a, b, frequency = coefficients[:, :count], coefficients[:, count:], float(unknowns[-1])
        below = (b / (frequency * np.arange(1, count + 1))).sum(axis=1)
        start = unknowns[edges[-1] : edges[-1] + 4] if self.start is None else np.array(self.start)
        return FourierSeries(a, b, start + below, frequency)

    def unknowns_of(self, series: FourierSeries) -> Array:
        """Unknowns of the trajectory nearest to a given one with the same number of harmonics."""
        coefficients = np.hstack([series.a, series.b])
        parts = [basis.T @ row for basis, row in zip(self.bases, coefficients, strict=True)]
        if self.start is None:
            parts.append(series.derivatives(0.0, 0)[0, 0])
        return np.concatenate([*parts, [series.base_frequency_rad_s]])


def _derivative_matrix(harmonics: int, phase: Array, order: int) -> Array:
    """Derivative of a channel by phase per unit of its coefficients [a, b] at unit frequency, shape (k, 2 N)."""
    harmonic = np.arange(1, harmonics + 1)
    turn = (1j * harmonic) ** order / harmonic * np.exp(1j * np.outer(phase, harmonic))
    return np.hstack([np.real(-1j * turn), np.real(-turn)])


def _flat_samples(problem: Problem, unknowns: ca.MX, phase: Array) -> ca.MX:
    """Inputs of the sample functions at given phases, shape (18, k)."""
    low, high = problem.base_frequency_rad_s
    frequency = low if low == high else unknowns[-1]
    bases = problem.bases
    edges = np.concatenate([[0], np.cumsum([basis.shape[1] for basis in bases])])
    channels = [unknowns[edges[i] : edges[i + 1]] for i in range(4)]
    start = unknowns[edges[4] : edges[4] + 4] if problem.start is None else ca.DM(problem.start)
    matrices = [_derivative_matrix(problem.harmonics, phase, order) for order in range(5)]
    matrices[0] = matrices[0] - _derivative_matrix(problem.harmonics, np.zeros(1), 0)

    def row(channel: int, order: int) -> ca.MX:
        value = (ca.DM(matrices[order] @ bases[channel]) @ channels[channel]).T * frequency ** (order - 1)
        return value + start[channel] if order == 0 else value

    return ca.vertcat(*[row(i, order) for order in range(5) for i in range(3)], *[row(3, order) for order in range(3)])


def _motion(gravity_m_s2: float) -> tuple[ca.SX, dict[str, ca.SX]]:
    """Attitude, body rates and their derivatives by differentiating eq. (26)-(27) along the trajectory."""
    flat = ca.SX.sym("flat", _INPUTS)
    acceleration, jerk, snap = flat[6:9], flat[9:12], flat[12:15]
    yaw = flat[15]
    forward = acceleration[0] * ca.cos(yaw) + acceleration[1] * ca.sin(yaw)
    sideways = acceleration[0] * ca.sin(yaw) - acceleration[1] * ca.cos(yaw)
    up = acceleration[2] + gravity_m_s2
    length = ca.sqrt(forward**2 + up**2)
    euler = ca.vertcat(ca.atan2(sideways, length), ca.atan2(forward, up), yaw)
    state, first, second = (ca.vertcat(v, flat[15 + i]) for i, v in enumerate((acceleration, jerk, snap)))
    euler_rate = ca.jtimes(euler, state, first)
    roll, pitch = euler[0], euler[1]
    rate = ca.vertcat(
        euler_rate[0] - ca.sin(pitch) * euler_rate[2],
        ca.cos(roll) * euler_rate[1] + ca.sin(roll) * ca.cos(pitch) * euler_rate[2],
        -ca.sin(roll) * euler_rate[1] + ca.cos(roll) * ca.cos(pitch) * euler_rate[2],
    )
    turning = ca.jtimes(rate, state, first) + ca.jtimes(rate, first, second)
    return flat, {
        "tangents": ca.vertcat(sideways / length, forward / up),
        "specific_thrust": ca.sqrt(length**2 + sideways**2),
        "rate": rate,
        "turning": turning,
    }


def _inertia_rows(rate: ca.SX, turning: ca.SX) -> ca.SX:
    """Rows 2-4 of eq. (12), shape (3, 6): columns are Y e_j, from I dw + w x I w with unit tensors."""
    columns = []
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = 1.0
        columns.append(ca.DM(unit) @ turning + ca.cross(rate, ca.DM(unit) @ rate))
    return ca.horzcat(*columns)


@dataclass(frozen=True, slots=True)
class LimitGroup:
    """Limits evaluated together: ``function`` maps a flat sample to values that must stay within lower..upper."""

    function: ca.Function
    lower: Array
    upper: Array


def limit_groups(envelope: Envelope) -> dict[str, LimitGroup]:
    """Limits in force, each value divided by its bound so that all are of order one."""
    flat, motion = _motion(envelope.gravity_m_s2)
    limits = envelope.limits
    groups: dict[str, LimitGroup] = {}

    def add(name: str, value: ca.SX, lower: float | Array, upper: float | Array) -> None:
        count = value.numel()
        groups[name] = LimitGroup(
            ca.Function(name, [flat], [value]), np.broadcast_to(lower, count), np.broadcast_to(upper, count)
        )

    for axis, bound in enumerate((limits.x_max_m, limits.y_max_m)):
        if bound is not None:
            add("xy"[axis], flat[axis] / bound, -1.0, 1.0)
    if limits.z_min_m is not None or limits.z_max_m is not None:
        low = -np.inf if limits.z_min_m is None else limits.z_min_m
        add("z", flat[2], low, np.inf if limits.z_max_m is None else limits.z_max_m)
    if limits.yaw_max_rad is not None:
        add("yaw", flat[15] / limits.yaw_max_rad, -1.0, 1.0)
    if limits.speed_max_m_s is not None:
        add("speed", flat[3:6] / limits.speed_max_m_s, -1.0, 1.0)
    if limits.yaw_rate_max_rad_s is not None:
        add("yaw_rate", flat[16] / limits.yaw_rate_max_rad_s, -1.0, 1.0)
    if limits.acceleration_max_m_s2 is not None:
        add("acceleration", ca.sumsqr(flat[6:9]) / limits.acceleration_max_m_s2**2, -np.inf, 1.0)
    if limits.tilt_max_rad is not None:
        add("tilt", motion["tangents"] / np.tan(limits.tilt_max_rad), -1.0, 1.0)
    inertia = ca.DM(envelope.inertia_kg_m2)
    torque = inertia @ motion["turning"] + ca.cross(motion["rate"], inertia @ motion["rate"])
    weight = envelope.mass_kg * envelope.gravity_m_s2
    forces = ca.vertcat(envelope.mass_kg * motion["specific_thrust"], torque)
    if limits.thrust_max_n is not None:
        add("thrust", forces[0] / weight, -np.inf, limits.thrust_max_n / weight)
    if limits.torque_max_nm is not None:
        add("torque", torque / limits.torque_max_nm, -1.0, 1.0)
    hover = weight / len(envelope.mixing)
    least, greatest = envelope.rotor_thrust_n
    add("rotors", ca.DM(envelope.mixing) @ forces / hover, least / hover, greatest / hover)
    return groups


def _symmetric(packed: ca.MX) -> ca.MX:
    matrix = ca.MX(6, 6)
    for k, (i, j) in enumerate(_TRIANGLE):
        matrix[i, j] = packed[k]
        matrix[j, i] = packed[k]
    return matrix


def _information(problem: Problem, unknowns: ca.MX, vehicle: Vehicle, samples: int) -> tuple[ca.MX, ca.MX]:
    """Mass information (scalar) and inertia information (6 x 6); they share no channel, so nothing lies between them.

    For the condition number both are mean squares of the regressor; otherwise expected Fisher information in relative
    parameters.
    """
    phase = 2.0 * np.pi * np.arange(samples) / samples
    flat, motion = _motion(vehicle.gravity_m_s2)
    rows = _inertia_rows(motion["rate"], motion["turning"])
    inputs = _flat_samples(problem, unknowns, phase)
    if problem.criterion == "condition":
        gram = rows.T @ rows
        lower = ca.vertcat(*[gram[i, j] for i, j in _TRIANGLE])
        mass, inertia = ca.Function("squares", [flat], [motion["specific_thrust"] ** 2, lower]).map(samples)(inputs)
        return ca.sum2(mass) / samples, _symmetric(ca.sum2(inertia) / samples)
    columns = ca.Function("columns", [flat], [motion["specific_thrust"], *[rows[i, :].T for i in range(3)]]).map(
        samples
    )
    scales = parameter_scales(vehicle)
    cos, sin = fourier_rows(samples)
    harmonic = np.arange(len(cos))
    spectra = problem.noise.spectra(vehicle, ca.DM(harmonic) * unknowns[-1])
    counted = ca.DM(np.where(harmonic == 0, 1.0, 2.0)) * problem.duration_s
    blocks = []
    for channel, (values, spectrum) in enumerate(zip(columns(inputs), spectra, strict=True)):
        relative = values.T @ ca.diag(ca.DM(scales[:1] if channel == 0 else scales[1:]))
        weight = ca.repmat(ca.sqrt(counted / spectrum), 1, relative.shape[1])
        real, imaginary = (weight * (ca.DM(matrix) @ relative) for matrix in (cos, sin))
        blocks.append(real.T @ real + imaginary.T @ imaginary)
    return blocks[0], blocks[1] + blocks[2] + blocks[3]


def _trace_of_inverse(size: int) -> ca.Function:
    """tr((L L^T)^-1) = |L^-1|_F^2 from the packed lower triangle."""
    packed = ca.SX.sym("packed", size * (size + 1) // 2)
    lower = ca.SX(size, size)
    for k, (i, j) in enumerate((i, j) for i in range(size) for j in range(i + 1)):
        lower[i, j] = packed[k]
    columns = []
    for j in range(size):
        column: list[ca.SX] = []
        for i in range(size):
            right = (1.0 if i == j else 0.0) - sum(lower[i, k] * column[k] for k in range(i))
            column.append(right / lower[i, i])
        columns.append(ca.vertcat(*column))
    return ca.Function("trace_of_inverse", [packed], [ca.sumsqr(ca.horzcat(*columns))])


def largest_eigenvalue_bound(mass: ca.MX, inertia: ca.MX) -> ca.MX:
    """Largest eigenvalue of the block-diagonal matrix as its 8-norm: exact to rounding where mass dominates, else above."""
    power = inertia / mass
    for _ in range(3):
        power = power @ power
    return mass * (1.0 + ca.trace(power)) ** 0.125


@dataclass(frozen=True, slots=True)
class _Lifted:
    """One vehicle's criterion: its cost, its own variables, and what ties them to the information."""

    cost: ca.MX
    variables: ca.MX
    equations: ca.MX
    inequalities: ca.MX


def _lift(criterion: str, mass: ca.MX, inertia: ca.MX) -> _Lifted:
    """Cost (to be made small, a logarithm in every case) of a block-diagonal information matrix."""
    packed = ca.MX.sym("packed", len(_TRIANGLE))
    lower = ca.MX(6, 6)
    for k, (i, j) in enumerate(_TRIANGLE):
        lower[i, j] = packed[k]
    gap = inertia - lower @ lower.T
    if criterion in _EIGENVALUE_CRITERIA:
        smallest = ca.MX.sym("smallest")
        gap = gap - smallest * ca.MX.eye(6)
        largest = ca.log(largest_eigenvalue_bound(mass, inertia)) if criterion == "condition" else 0.0
        cost, variables, inequalities = largest - ca.log(smallest), ca.vertcat(packed, smallest), mass - smallest
    elif criterion == "D":
        cost = -ca.log(mass) - 2.0 * sum(ca.log(lower[i, i]) for i in range(6))
        variables, inequalities = packed, ca.MX(0, 1)
    else:
        cost, variables, inequalities = ca.log(1.0 / mass + _trace_of_inverse(6)(packed)), packed, ca.MX(0, 1)
    return _Lifted(cost, variables, ca.vertcat(*[gap[i, j] for i, j in _TRIANGLE]), inequalities)


def _lift_values(criterion: str, mass: float, inertia: Array, share: float) -> Array:
    """Lifted variables that satisfy their equations at a given information, s being a share of the smallest eigenvalue."""
    smallest = share * min(float(np.linalg.eigvalsh(inertia)[0]), mass) if criterion in _EIGENVALUE_CRITERIA else 0.0
    lower = np.linalg.cholesky(inertia - smallest * np.eye(6))
    packed = [lower[i, j] for i, j in _TRIANGLE]
    return np.array([*packed, smallest] if criterion in _EIGENVALUE_CRITERIA else packed)


class Program:
    """A compiled program; :meth:`solve` may be called from many starting points.

    Args:
        problem: what to optimise.
        phases: for each vehicle and limit group the phases of the base frequency at which it is held.
        reference: unknowns whose information sets the scale; they must reveal every parameter a little.
        warm: start the interior point close to its end, for starting points that nearly solve the program.
    """

    def __init__(
        self, problem: Problem, phases: Sequence[Mapping[str, Array]], reference: Array, *, warm: bool = False
    ) -> None:
        self.problem, self._warm = problem, warm
        unknowns = ca.MX.sym("unknowns", problem.unknowns)
        vehicles = problem.vehicles[:1] if problem.criterion == "condition" else problem.vehicles
        pairs = [_information(problem, unknowns, each, 8 * problem.harmonics) for each in vehicles]
        self._information = ca.Function("information", [unknowns], [part for pair in pairs for part in pair])
        self._scale = [float(np.linalg.eigvalsh(inertia)[0]) for _, inertia in self.information(reference)]
        lifted = [_lift(problem.criterion, m / k, i / k) for (m, i), k in zip(pairs, self._scale, strict=True)]

        parts = [unknowns, *(each.variables for each in lifted)]
        values = [each.equations for each in lifted]
        lower = [np.zeros(each.equations.numel()) for each in lifted]
        upper = [np.zeros(each.equations.numel()) for each in lifted]

        def keep(value: ca.MX, least: Array, greatest: Array) -> None:
            values.append(ca.vec(value))
            lower.append(least)
            upper.append(greatest)

        for each in lifted:
            count = each.inequalities.numel()
            keep(each.inequalities, np.zeros(count), np.full(count, np.inf))
        self._costs = ca.Function("costs", [ca.vertcat(*parts)], [each.cost for each in lifted])
        objective = lifted[0].cost
        if len(lifted) > 1:
            objective = ca.MX.sym("worst")
            parts.append(objective)
            for each in lifted:
                keep(objective - each.cost, np.zeros(1), np.full(1, np.inf))
        for envelope, held in zip(problem.envelopes, phases, strict=True):
            groups = limit_groups(envelope)
            for name, phase in held.items():
                count, group = len(phase), groups[name]
                if count:
                    limited = group.function.map(count)(_flat_samples(problem, unknowns, phase))
                    keep(limited, np.tile(group.lower, count), np.tile(group.upper, count))
        self._bounds = np.concatenate(lower), np.concatenate(upper)
        options = {"print_level": 0, "sb": "yes", "max_iter": 300, "tol": 1e-6, "mu_strategy": "adaptive"}
        if warm:
            options |= {"mu_strategy": "monotone", "mu_init": 1e-5, "bound_push": 1e-8, "bound_frac": 1e-8}
        self._solver = ca.nlpsol(
            "plan",
            "ipopt",
            {"x": ca.vertcat(*parts), "f": objective, "g": ca.vertcat(*values)},
            {"ipopt": options, "print_time": False, "error_on_fail": False},
        )

    def information(self, unknowns: Array) -> list[tuple[float, Array]]:
        """Mass and inertia information of each vehicle at given unknowns."""
        parts = [np.array(part) for part in self._information(unknowns)]
        return [(float(parts[k].item()), parts[k + 1]) for k in range(0, len(parts), 2)]

    def solve(self, unknowns: Array, reach: float = np.inf) -> Array:
        """Unknowns at a local optimum reached from the given ones (feasible or not: judge it by its limits).

        Args:
            reach: how far each unknown may move (m/s, rad/s; m, rad for the start).
        """
        criterion, problem = self.problem.criterion, self.problem
        lifts = [
            _lift_values(criterion, mass / scale, inertia / scale, 0.999 if self._warm else 0.5)
            for (mass, inertia), scale in zip(self.information(unknowns), self._scale, strict=True)
        ]
        start = np.concatenate([unknowns, *lifts])
        if len(lifts) > 1:
            start = np.append(start, max(float(cost) for cost in self._costs(start)))
        least, greatest = np.full(len(start), -np.inf), np.full(len(start), np.inf)
        least[: problem.unknowns], greatest[: problem.unknowns] = unknowns - reach, unknowns + reach
        least[problem.unknowns - 1], greatest[problem.unknowns - 1] = problem.base_frequency_rad_s
        offset = problem.unknowns
        for lift in lifts:  # diagonal of L and the smallest eigenvalue are positive
            positive = [k for k, (i, j) in enumerate(_TRIANGLE) if i == j and criterion not in _EIGENVALUE_CRITERIA]
            positive += [len(_TRIANGLE)] if criterion in _EIGENVALUE_CRITERIA else []
            least[offset + np.array(positive)] = 1e-9
            offset += len(lift)
        answer = self._solver(x0=start, lbx=least, ubx=greatest, lbg=self._bounds[0], ubg=self._bounds[1])
        return np.array(answer["x"]).ravel()[: problem.unknowns]
