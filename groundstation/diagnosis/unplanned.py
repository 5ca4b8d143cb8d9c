"""Effects of the air on flights that nobody planned: found where the data show them, without the rotors' fast torque.

On a flight without plan or setpoints the regression of the motion on the rotors' wrench lies: telemetry that is
filtered or late loses the torque, and the controller answers the disturbance. The equations turned round hold in the
band where telemetry is right (:mod:`groundstation.identification.low_frequency`). Each is solved with past motion as
instruments, in parts of the flights that check each other (:mod:`groundstation.identification.lagged_instruments`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import Effect, has_rotors, library
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.rivals import posterior
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.lagged_instruments import Equation, PartEstimate, Parts, Pooled, pooled, two_stage
from groundstation.identification.low_frequency import (
    Named,
    Slow,
    body_drag_equations,
    lift_equations,
    parts_of,
    rotor_drag_equations,
    slow,
    torque_equations,
    without_plan,
)
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate
from groundstation.model.parameters import Parameters
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

Members = Mapping[str, tuple[str, ...]]
TORQUE: Members = {
    "angular_damping": ("damping_x_nms", "damping_y_nms", "damping_z_nms"),
    "flapping_moment": ("k_nm_s_m",),
}
ROTOR_DRAG: Members = {"rotor_drag": ("d_x_kg_s", "d_y_kg_s")}
BODY_DRAG: Members = {"body_drag": ("c_kg_m",)}
LIFT: Members = {"climb_inflow": ("k_kg_s",), "translational_lift": ("lift_s2_m2",)}
"""Effects of each equation and their parameters, as the library names them."""


@dataclass(frozen=True, slots=True)
class PastMotion:
    """What these equations say of one effect.

    Attributes:
        values: of each parameter.
        wald: sum of squares of values over deviations; chance: what noise alone passes once in 1 / ``effect_chance``
            times.
        gain: fall of the squared error of each part with the values of the others.
        share: RMS of what it does, as a share of weight (forces) or weight times arm (torques).
        stands: beats chance, is of a plausible sign, matters, and holds on parts that did not choose it.
        rivals: effects that do what it does, and by how much less of the squared error falls with them.
    """

    effect: Effect
    values: Mapping[str, Pooled]
    wald: float
    chance: float
    gain: float
    share: float
    stands: bool
    rivals: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def candidate(self) -> Candidate:
        """For the joint estimate."""
        return Candidate(self.effect, {})

    def finding(self) -> Finding:
        """As a finding, with where it comes from and Student's intervals; a formula misses up to a tenth, which is two
        deviations of its part of the interval.
        """
        form = 0.5 * THRESHOLDS.form_error_share
        values = {
            n: Estimate.normal(p.value, float(np.hypot(p.spread(), form * p.value))) for n, p in self.values.items()
        }
        sentence = filled(self.effect.sentence, **{name: p.value for name, p in self.values.items()})
        return Finding(
            effect=self.effect.identifier,
            parameters=values,
            sentence=f"{sentence} No plan is recorded: past motion is the instrument, and parts of the flights check "
            "each other.",
            confidence=posterior([self.chance - self.wald, *(-lead for lead in self.rivals.values())]),
            alternatives=self.alternatives,
            gain=self.gain,
        )

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Rivals that explain alike."""
        return tuple(name for name, lead in self.rivals.items() if lead < THRESHOLDS.inseparable)

    def missed(self) -> str:
        """What is said of it where it does not stand: the least that would have been seen."""
        least = ", ".join(f"{name} {np.sqrt(self.chance) * p.std:.2g}" for name, p in self.values.items())
        return f"{self.effect.identifier} is not shown; the least that these flights could have shown: {least}."


def tell_unplanned(flights: Sequence[Prepared], p: Parameters) -> list[PastMotion]:
    """What flights without a plan show of the air's effects; nothing where one has a plan, or rates or poses are
    missing.

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
    parts = [part for flight in flights for part in parts_of(slow(flight, p))]
    drag = _likelier([*_told(parts, ROTOR_DRAG, rotor_drag_equations), *_told(parts, BODY_DRAG, body_drag_equations)])
    frame = sum(told.values["c_kg_m"].value for told in drag if told.stands and "c_kg_m" in told.values)
    lift = _told(parts, LIFT, lambda part: lift_equations(part, frame))
    hubs = sum(_at_hubs(told, vehicle) for told in drag if told.stands)
    return [*_told(parts, TORQUE, lambda part: torque_equations(part, hubs)), *drag, *lift]


def _at_hubs(drag: PastMotion, vehicle: Vehicle) -> float:
    """Yaw damping (N m s) of a drag of rotors, which each hub feels as it goes round: the mean of d_y x^2 + d_x y^2.

    That of a frame's drag is zero.
    """
    if not set(ROTOR_DRAG["rotor_drag"]) <= set(drag.values):
        return 0.0
    x2, y2 = np.mean(np.square(np.asarray(vehicle.rotors.position_m, dtype=float)), axis=0)[:2]
    return float(drag.values["d_y_kg_s"].value * x2 + drag.values["d_x_kg_s"].value * y2)


def _told(parts: Sequence[Slow], members: Members, equations: Callable[[Slow], Named]) -> list[PastMotion]:
    """What equations say of their effects, over all parts."""
    names = {name for parameters in members.values() for name in parameters}
    seen: dict[str, list[tuple[Equation, PartEstimate, int]]] = {name: [] for name in names}
    for part in parts:
        for equation, own in equations(part):
            estimate = two_stage(equation)
            if estimate is not None:
                for index, name in enumerate(own):
                    seen[name].append((equation, estimate, index))
    return [
        _judged(identifier, {name: seen[name] for name in parameters})
        for identifier, parameters in members.items()
        if all(len(seen[name]) > 1 for name in parameters)
    ]


def _likelier(drags: Sequence[PastMotion]) -> list[PastMotion]:
    """Of drags that both stand the one with which more of the squared error falls, with the other as its rival: at one
    speed they are the same, and together they would count it twice.
    """
    if not all(told.stands for told in drags) or len(drags) < 2:
        return list(drags)
    best, other = sorted(drags, key=lambda told: -told.gain)
    return [replace(best, rivals={other.effect.identifier: best.gain - other.gain})]


def _judged(identifier: str, seen: Mapping[str, Parts]) -> PastMotion:
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
    return PastMotion(effect, values, wald, chance, gain, share, stands)


def _size(parts: Parts, value: float) -> float:
    """RMS of what a parameter does, in the equations' units."""
    return abs(value) * float(np.sqrt(np.mean([np.mean(e.columns[e.used, i] ** 2) for e, _, i in parts])))
