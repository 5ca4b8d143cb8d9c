"""Effects that push and turn the body by where it is and how it moves: a file each in this folder, found by itself.

Such a file is named by the effect's identifier. It holds ``EFFECT``, a NamedTuple of parameters with defaults whose
last field is ``on: bool = True``, and ``wrench``, compiled: (parameters, :class:`Moving`) -> force (N) and torque about
the origin (N m), both in the body. What acts inside rotors, battery or sensors is in the modules that
:mod:`sim.effects` lists.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numba

from sim.algebra import Quaternion, Vector, add


class Moving(NamedTuple):
    """Where the body is and how it moves.

    Attributes:
        position: of the origin in the world, m.
        velocity: of the origin in the world, m/s.
        attitude: quaternion from the body to the world, scalar first.
        rate: of the body, in the body, rad/s.
        air: velocity relative to the air, in the body, m/s.
        density: of the air, kg/m^3.
        flight_s: since take-off; negative on the ground.
    """

    position: Vector
    velocity: Vector
    attitude: Quaternion
    rate: Vector
    air: Vector
    density: float
    flight_s: float


Wrench = Callable[[Any, Moving], tuple[Vector, Vector]]
Sum = Callable[[Any, Moving, Vector, Vector], tuple[Vector, Vector]]


def found() -> Mapping[str, ModuleType]:
    """The files of this folder that hold an effect of the body, by identifier."""
    names = sorted(each.name for each in pkgutil.iter_modules([str(Path(__file__).parent)]))
    modules = {
        name: importlib.import_module(f"sim.effects.{name}") for name in names if f"sim.effects.{name}" != __name__
    }
    return {name: module for name, module in modules.items() if hasattr(module, "EFFECT")}


def summed(parts: Sequence[tuple[int, Wrench]]) -> Sum:
    """(effects, motion, force, torque) -> force and torque with what each effect that is on adds.

    Args:
        parts: place among the effects, and wrench, of each.

    Compiled as one chain of functions, since numba has no list of functions; what calls it is kept on disk.
    """

    @numba.njit(error_model="numpy", forceinline=True)
    def nothing(effects: Any, at: Moving, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
        return force, torque

    total: Sum = nothing
    for place, wrench in parts:
        total = _after(total, place, wrench)
    return total


def _after(before: Sum, place: int, wrench: Wrench) -> Sum:
    @numba.njit(error_model="numpy", forceinline=True)
    def total(effects: Any, at: Moving, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
        force, torque = before(effects, at, force, torque)
        if effects[place].on:
            push, twist = wrench(effects[place], at)
            force, torque = add(force, push), add(torque, twist)
        return force, torque

    return total
