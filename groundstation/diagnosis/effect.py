"""What an effect is to the diagnosis: a wrench per unit of each parameter, computed from the signals of a flight.

One file per effect in ``effects/``; each defines ``EFFECT``. Adding an effect is adding a file. None of them shares a line
with the simulator.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Settings = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class ParameterInfo:
    """A parameter of an effect: name with unit last, scale of its prior, and what is physically plausible."""

    name: str
    prior_std: Callable[[Vehicle], float]
    plausible: tuple[float, float] = (-np.inf, np.inf)


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect that a rigid body with known thrusts leaves out.

    Attributes:
        identifier: of effects.md.
        equation, source: the model and where it is from.
        parameters: what is estimated, linearly.
        wrench: (signals, vehicle, settings) -> body force and torque about the declared origin per unit of each
            parameter, shape (k, 6, len(parameters)); NaN where the signals it needs are unknown.
        variants: settings to try (a rotor, an instant, a length); one empty set for most effects.
        finer: settings around one that was found, to look closer.
        applies: whether this vehicle's inputs can show it at all.
        confused_with: identifiers that look alike; manoeuvre: what tells it from them.
        sentence: one sentence a pilot understands, with {parameter} places.
        rests_on: identifiers of which one has to be there for it to mean anything (wind needs drag to be felt).
    """

    identifier: str
    equation: str
    source: str
    parameters: tuple[ParameterInfo, ...]
    wrench: Callable[[Signals, Vehicle, Settings], Array]
    sentence: str
    confused_with: tuple[str, ...]
    manoeuvre: str
    variants: Callable[[Signals, Vehicle], Sequence[Settings]] = field(default=lambda signals, vehicle: ({},))
    finer: Callable[[Settings], Sequence[Settings]] = field(default=lambda settings: ())
    applies: Callable[[Vehicle], bool] = field(default=lambda vehicle: True)
    rests_on: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def precision(self, vehicle: Vehicle) -> Array:
        """Prior precision of each parameter."""
        return np.array([1.0 / p.prior_std(vehicle) ** 2 for p in self.parameters])


@cache
def library() -> Mapping[str, Effect]:
    """All effects with a force model, by identifier, from the files in ``effects/``."""
    package = importlib.import_module("groundstation.diagnosis.effects")
    found = {}
    for module in pkgutil.iter_modules(package.__path__):
        loaded = importlib.import_module(f"{package.__name__}.{module.name}")
        if hasattr(loaded, "EFFECT"):
            found[loaded.EFFECT.identifier] = loaded.EFFECT
    return found


def blank(signals: Signals, parameters: int = 1) -> Array:
    """A wrench of zeros, shape (k, 6, parameters)."""
    return np.zeros((len(signals.t_s), 6, parameters))


def from_thrust(vehicle: Vehicle, thrust: Array) -> Array:
    """Body wrench (k, 6) of rotor thrusts (k, n)."""
    from groundstation.model.rotors import wrench_matrix

    out = np.zeros((len(thrust), 6))
    out[:, 2:] = thrust @ wrench_matrix(vehicle).T
    return out


def hover_share(signals: Signals, vehicle: Vehicle) -> Array:
    """Sum of rotor speeds over its value at hover, shape (k,): how much rotor there is to be dragged."""
    if vehicle.rotors.input == "wrench":
        return np.ones(len(signals.t_s))
    speed = np.sqrt(np.maximum(signals.thrust_n, 0.0))
    hover = vehicle.rotors.count * np.sqrt(vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count)
    return speed.sum(axis=1) / hover


def has_rotors(vehicle: Vehicle) -> bool:
    """The recording tells what each rotor did."""
    return vehicle.rotors.input != "wrench"


def is_commanded(vehicle: Vehicle) -> bool:
    """The recording holds what was asked of the rotors, not what they did."""
    return vehicle.rotors.input == "command" or (
        vehicle.rotors.input == "rotor_speed" and vehicle.rotors.speed_source == "command"
    )


def weight(vehicle: Vehicle) -> float:
    """Declared weight, N."""
    return vehicle.mass_kg * vehicle.gravity_m_s2


def wrench_of(effects: Mapping[str, Mapping[str, Mapping[str, float]]], vehicle: Vehicle) -> Callable[[Signals], Array]:
    """Total body wrench (k, 6) of a model document's effects, name -> parameter -> {value, std}; settings among them.

    A second finding of an effect stands under "name/2".
    """
    named = [(name.partition("/")[0], values) for name, values in effects.items()]
    known = [(library()[name], values) for name, values in named if name in library()]

    def wrench(signals: Signals) -> Array:
        total = np.zeros((len(signals.t_s), 6))
        for effect, values in known:
            numbers = {key: float(entry["value"]) for key, entry in values.items()}
            theta = np.array([numbers[name] for name in effect.names()])
            total += effect.wrench(signals, vehicle, numbers) @ theta
        return total

    return wrench
