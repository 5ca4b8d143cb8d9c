"""Did the force change for good at one instant of the flight? A load let go, a rotor that lost a blade.

Such a step is many times the air's own disturbance, and a noise model that is fitted to it takes it for a disturbance
of long memory: the larger the step, the better it hides. So it is looked for first, by least squares, before any noise
is modelled (Basseville and Nikiforov 1993, Detection of Abrupt Changes, 2.6): the instant at which a step explains most
of what a line and a bend in time, and the thrust itself, leave of the vertical force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.prediction_error import Fitted
from groundstation.identification.record_model import RecordModel
from groundstation.model.parameters import FitOptions

Array = NDArray[np.float64]

SHARE = 0.7
"""Of what is left of the vertical force, above which it is a step's: a drift is taken out before, and the best step
in a random walk explains about a half of it."""
AVERAGED_S = 0.25
"""Over which forces are averaged: a step stands out from a sensor's noise, not from the air's slow disturbance."""
LEAST_CHANGE = 0.02
"""Of the mass, from which an identification speaks of it: less is what a battery or the air does, too."""
INSTANTS, CLOSER = 60, 3
"""Instants that are tried, and how often closer ones about the best."""
EITHER_SIDE_S = 2.0
"""Of flight: a step with less on one side of it is a take-off or a landing."""
VERTICAL = 5


@dataclass(frozen=True, slots=True)
class Steps:
    """What a flight's vertical force leaves, and what may explain it.

    Attributes:
        left: (k,), averaged, less the base. base: orthonormal columns (k, m). averaged: samples to an average.
    """

    left: Array
    base: Array
    averaged: int

    @classmethod
    def of(cls, t_s: Array, residual: Array, columns: Array, averaged_s: float = AVERAGED_S) -> Steps:
        """From a residual (blocks,) at times, beside columns (blocks, m) that may be in it, and a bend in time."""
        averaged = max(1, round(averaged_s / float(np.median(np.diff(t_s))))) if len(t_s) > 1 else 1
        time = np.linspace(-1.0, 1.0, len(t_s))
        beside = np.concatenate([columns, np.stack([np.ones_like(time), time, time**2], axis=1)], axis=1)
        beside = _averaged(np.nan_to_num(beside), averaged)
        beside = beside[:, np.any(beside != 0.0, axis=0)]
        size: Array = np.linalg.norm(beside, axis=0)
        u, s, _ = np.linalg.svd(beside / size, full_matrices=False)
        base = u[:, s > 1e-6 * s.max(initial=0.0)]
        left = _averaged(np.nan_to_num(residual)[:, None], averaged)[:, 0]
        return cls(left - base @ (base.T @ left), base, averaged)

    def explained(self, column: Array) -> tuple[float, float]:
        """Share of what is left that a column (blocks,) explains, and its coefficient."""
        own = _averaged(np.nan_to_num(column)[:, None], self.averaged)[:, 0]
        own = own - self.base @ (self.base.T @ own)
        energy, total = float(own @ own), float(self.left @ self.left)
        if energy <= 1e-12 * max(float(np.sum(column**2)), 1e-300) or total <= 0.0:
            return 0.0, 0.0
        size = float(own @ self.left) / energy
        return size**2 * energy / total, size


def _averaged(columns: Array, count: int) -> Array:
    whole = len(columns) // count * count
    return columns[:whole].reshape(-1, count, columns.shape[1]).mean(axis=1)


@dataclass(frozen=True, slots=True)
class MassStep:
    """At an instant the vehicle became lighter or heavier, by a share of its mass."""

    at_s: float
    change: float

    def told(self) -> str:
        """The sentence of an identification."""
        way = "lighter" if self.change < 0.0 else "heavier"
        return (
            f"At {self.at_s:.1f} s the vehicle became {abs(self.change):.0%} {way}, or its rotors gave that much "
            f"{'more' if self.change < 0.0 else 'less'} thrust at the same speeds, and stayed so: the mass given is of "
            "neither part of the flight. Run `groundstation diagnose`, or use one part "
            f"(--to {self.at_s:.1f} or --from {self.at_s:.1f})."
        )


def mass_step(models: Sequence[RecordModel], best: Fitted, options: FitOptions) -> MassStep | None:
    """The largest step of the mass within a flight; None where no step of LEAST_CHANGE explains what is left."""
    found = [step for model in models if (step := _of_flight(model, best, options)) is not None]
    return max(found, key=lambda step: abs(step.change), default=None)


def _of_flight(model: RecordModel, best: Fitted, options: FitOptions) -> MassStep | None:
    p, names = best.parameters, model.names(options)
    if VERTICAL not in options.channels or "mass_kg" not in names or not len(model.t_s):
        return None
    residual = model.residual_of(p, model.predicted(p, options))[:, VERTICAL]
    # copies of the one channel: a view would hold those of all channels, and of all parts at once
    sensitivity = np.concatenate(
        [model.sensitivities(p, options, part)[:, VERTICAL].copy(order="K") for part in model.parts()]
    )
    first, last = float(model.t_s[0]) + EITHER_SIDE_S, float(model.t_s[-1]) - EITHER_SIDE_S
    if first >= last:
        return None
    by_mass = sensitivity[:, names.index("mass_kg")]
    steps = Steps.of(model.t_s, residual, sensitivity)
    instants = np.linspace(first, last, INSTANTS)
    spacing = float(instants[1] - instants[0])
    share = size = at_s = 0.0
    for _ in range(CLOSER):
        tried = [(*steps.explained(np.where(model.t_s >= at, by_mass, 0.0)), float(at)) for at in instants]
        share, size, at_s = max(tried)
        instants = np.clip(at_s + spacing * np.linspace(-0.9, 0.9, 9), first, last)
        spacing /= 4.0
    change = size / best.parameters.mass_kg
    return MassStep(at_s, change) if share > SHARE and abs(change) > LEAST_CHANGE else None
