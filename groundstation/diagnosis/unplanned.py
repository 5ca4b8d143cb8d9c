r"""Effects of the air on flights that nobody planned: found where the data show them, without the rotors' fast torque.

On a flight without plan or setpoints the regression of the motion on the rotors' wrench lies: telemetry that is filtered or late
loses the torque, and the controller answers the disturbance. Turned round, three equations hold in the band where telemetry is right:

    torque   tau(T) = J w' - (lag) J w'' + D w + k (-v_y, v_x, 0) + trim + T offset    roll, pitch, yaw; the rotors' noise is in the output
    force    m f_xy = -d v_xy s + m bias                                               the accelerometer is the force: it needs no rotor
    lift     m f_z  = a T + b T^2 - k_w v_z s + l T |v_xy|^2 + m bias                  a and b: thrust constant and curve

with T the thrust, f the specific force, v the velocity in the body, w the body rates, s the rotors' speed over that at hover. J w'' is
what a delay or a filter of the telemetry does, to first order. Each is solved with past motion as instruments, in parts of the flights
that check each other (:mod:`.lagged_instruments`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import Effect, has_rotors, hover_share, library, weight
from groundstation.diagnosis.evidence import Candidate
from groundstation.diagnosis.lagged_instruments import Equation, PartEstimate, Parts, Pooled, pooled, two_stage
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.rivals import posterior
from groundstation.diagnosis.sentences import told
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate
from groundstation.model.parameters import Parameters
from groundstation.model.rotors import wrench_matrix

Array = NDArray[np.float64]

EDGE_S = 0.4
"""Left out beside every edge of what is used: the low pass looks that far."""
SAMPLES_PER_BAND = 8
"""Samples per period of the band's edge."""

Members = Mapping[str, tuple[str, ...]]
TORQUE: Members = {
    "angular_damping": ("damping_x_nms", "damping_y_nms", "damping_z_nms"),
    "flapping_moment": ("k_nm_s_m",),
}
FORCE: Members = {"rotor_drag": ("d_x_kg_s", "d_y_kg_s")}
LIFT: Members = {"climb_inflow": ("k_kg_s",), "translational_lift": ("lift_s2_m2",)}
"""Effects of each equation and their parameters, as the library names them."""
FOUND_HERE = frozenset((*TORQUE, *FORCE, *LIFT))


@dataclass(frozen=True, slots=True)
class Told:
    """What these equations say of one effect.

    Attributes:
        values: of each parameter.
        wald: sum of squares of values over deviations; chance: what noise alone passes once in 1 / ``effect_chance`` times.
        gain: fall of the squared error of each part with the values of the others.
        share: RMS of what it does, as a share of weight (forces) or weight times arm (torques).
        stands: beats chance, is of a plausible sign, matters, and holds on parts that did not choose it.
    """

    effect: Effect
    values: Mapping[str, Pooled]
    wald: float
    chance: float
    gain: float
    share: float
    stands: bool

    @property
    def candidate(self) -> Candidate:
        """For the joint estimate."""
        return Candidate(self.effect, {})

    def finding(self) -> Finding:
        """As a finding, with where it comes from."""
        values = {name: Estimate.normal(p.value, p.std) for name, p in self.values.items()}
        sentence = told(self.effect.sentence, **{name: p.value for name, p in self.values.items()})
        return Finding(
            effect=self.effect.identifier,
            parameters=values,
            evidence=f"{sentence} No plan is recorded: past motion is the instrument, and parts of the flights check each other.",
            confidence=posterior([self.chance - self.wald]),
            gain=self.gain,
        )

    def missed(self) -> str:
        """What is said of it where it does not stand: the least that would have been seen."""
        least = ", ".join(f"{name} {np.sqrt(self.chance) * p.std:.2g}" for name, p in self.values.items())
        return f"{self.effect.identifier} is not shown; the least that these flights could have shown: {least}."


def without_plan(prepared: Prepared) -> bool:
    """Neither plan nor setpoints are recorded: a smoothed path flown is no plan."""
    return prepared.flight.plan is None and prepared.flight.setpoint is None


def tell_unplanned(flights: Sequence[Prepared], p: Parameters) -> list[Told]:
    """What flights without a plan show of the air's effects; nothing where one has a plan, or rates or poses are missing.

    Args:
        flights: of one vehicle.
        p: the base fit, for mass, lag and dead time.
    """
    vehicle = flights[0].record.vehicle
    fit = all(
        without_plan(f) and f.source == "imu" and np.isfinite(f.velocity_m_s[f.record.keep]).all() for f in flights
    )
    if not fit or not has_rotors(vehicle):
        return []
    parts = [part for flight in flights for part in _parts(_slow(flight, p))]
    groups = ((TORQUE, _torque), (FORCE, _force), (LIFT, _lift))
    found: list[Told] = []
    for members, equations in groups:
        names = {name for parameters in members.values() for name in parameters}
        seen: dict[str, list[tuple[Equation, PartEstimate, int]]] = {name: [] for name in names}
        for part in parts:
            for equation, own in equations(part):
                estimate = two_stage(equation)
                if estimate is not None:
                    for index, name in enumerate(own):
                        seen[name].append((equation, estimate, index))
        for identifier, parameters in members.items():
            if all(len(seen[name]) > 1 for name in parameters):
                found.append(_judged(identifier, {name: seen[name] for name in parameters}))
    return found


@dataclass(frozen=True, slots=True)
class _Part:
    """Low-passed signals of a part of a flight, evenly sampled, and the scales of forces and torques."""

    used: NDArray[np.bool_]
    step_s: float
    torque: Array
    thrust: Array
    rate: Array
    turning: Array
    jerk: Array
    velocity: Array
    speed2: Array
    share: Array
    force: Array
    tensor: Array
    mass_kg: float
    scale_n: float
    arm_m: float


def _slow(prepared: Prepared, p: Parameters) -> _Part:
    """The whole flight below the band's edge."""
    from scipy.signal import butter, sosfiltfilt

    record = prepared.record
    rate_hz = 1.0 / float(np.median(np.diff(record.t_s)))
    edge = min(THRESHOLDS.unplanned_band_hz, 0.2 * rate_hz)
    sos = butter(2, edge, fs=rate_hz, output="sos")
    every = max(1, round(rate_hz / (SAMPLES_PER_BAND * edge)))

    def low(values: Array) -> Array:
        return np.asarray(sosfiltfilt(sos, np.nan_to_num(values), axis=0))

    signals = prepared.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope)
    vehicle = record.vehicle
    anchor = vehicle.mass_kg / p.mass_kg if vehicle.identification.anchor == "mass" else 1.0
    wrench = anchor * low(signals.thrust_n @ wrench_matrix(vehicle).T)
    velocity = signals.velocity_body_m_s()
    rate = low(record.rate_rad_s)
    turning = np.gradient(rate, record.t_s, axis=0)
    margin = round(EDGE_S * rate_hz)
    near = np.convolve(~record.keep, np.ones(2 * margin + 1), mode="same") > 0.5
    cut = slice(None, None, every)
    return _Part(
        used=(record.keep & ~near)[cut],
        step_s=every / rate_hz,
        torque=wrench[cut, 1:],
        thrust=wrench[cut, 0],
        rate=rate[cut],
        turning=turning[cut],
        jerk=np.gradient(turning, record.t_s, axis=0)[cut],
        velocity=low(velocity)[cut],
        speed2=low((velocity[:, :2] ** 2).sum(axis=1))[cut],
        share=low(hover_share(signals, vehicle))[cut],
        force=low(record.force_m_s2)[cut],
        tensor=vehicle.inertia_tensor(),
        mass_kg=anchor * p.mass_kg,
        scale_n=weight(vehicle),
        arm_m=vehicle.arm_m(),
    )


def _parts(whole: _Part) -> list[_Part]:
    """Equal shares of what is used of a flight, two at least."""
    used_s = float(whole.used.sum()) * whole.step_s
    count = max(2, int(used_s / THRESHOLDS.unplanned_part_s))
    number = np.minimum(np.cumsum(whole.used) * count // max(int(whole.used.sum()), 1), count - 1)
    return [replace(whole, used=whole.used & (number == index)) for index in range(count)]


def _torque(part: _Part) -> list[tuple[Equation, tuple[str, ...]]]:
    """Roll, pitch and yaw, in shares of weight times arm."""
    ones = np.ones((len(part.thrust), 1))
    gyroscopic = np.cross(part.rate, part.rate @ part.tensor)
    out = []
    for axis, name in enumerate("xyz"):
        columns, own = [part.rate[:, axis]], (f"damping_{name}_nms",)
        if axis < 2:
            columns.append(-part.velocity[:, 1] if axis == 0 else part.velocity[:, 0])
            own = (*own, "k_nm_s_m")
        columns += [part.turning[:, axis], part.jerk[:, axis], part.thrust - part.thrust.mean()]
        scale = part.scale_n * part.arm_m
        output = (part.torque[:, axis] - gyroscopic[:, axis]) / scale
        out.append((_equation(part, output, np.column_stack(columns) / scale, ones, len(own)), own))
    return out


def _force(part: _Part) -> list[tuple[Equation, tuple[str, ...]]]:
    """Forward and sideways, in shares of the weight."""
    ones = np.ones((len(part.thrust), 1))
    out = []
    for axis, name in enumerate("xy"):
        columns = np.column_stack([-part.velocity[:, axis] * part.share]) / part.scale_n
        output = part.mass_kg * part.force[:, axis] / part.scale_n
        out.append((_equation(part, output, columns, ones, 1), (f"d_{name}_kg_s",)))
    return out


def _lift(part: _Part) -> list[tuple[Equation, tuple[str, ...]]]:
    """Along the thrust, in shares of the weight; thrust constant, curve and bias stand beside."""
    thrust = part.thrust / part.scale_n
    mean = float(np.mean(thrust[part.used])) if part.used.any() else 1.0
    columns = np.column_stack(
        [-part.velocity[:, 2] * part.share / part.scale_n, thrust * part.speed2, thrust, (thrust - mean) ** 2]
    )
    output = part.mass_kg * part.force[:, 2] / part.scale_n
    ones = np.ones((len(thrust), 1))
    return [(_equation(part, output, columns, ones, 2), ("k_kg_s", "lift_s2_m2"))]


def _equation(part: _Part, output: Array, columns: Array, known: Array, effects: int) -> Equation:
    return Equation(output, columns, known, part.used, part.step_s, effects)


def _judged(identifier: str, seen: Mapping[str, Parts]) -> Told:
    from scipy.stats import f

    effect = library()[identifier]
    values = {name: pooled(parts) for name, parts in seen.items()}
    wald = sum((p.value / p.std) ** 2 for p in values.values())
    freedom = min(p.freedom for p in values.values())
    chance = len(values) * float(f.isf(THRESHOLDS.effect_chance, len(values), max(freedom, 1.0)))
    gain = sum(p.gain for p in values.values())
    margin = THRESHOLDS.plausible_margin_std
    ranges = {p.name: p.plausible for p in effect.parameters}
    plausible = all(
        ranges[n][0] - margin * p.std <= p.value <= ranges[n][1] + margin * p.std for n, p in values.items()
    )
    share = max(_size(seen[name], pool.value) for name, pool in values.items())
    stands = wald > chance and plausible and gain > 0.0 and share > THRESHOLDS.material_share
    return Told(effect, values, wald, chance, gain, share, stands)


def _size(parts: Parts, value: float) -> float:
    """RMS of what a parameter does, in the equations' units."""
    return abs(value) * float(np.sqrt(np.mean([np.mean(e.columns[e.used, i] ** 2) for e, _, i in parts])))
