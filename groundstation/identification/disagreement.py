"""A method that is far from the one to believe says so beside its own numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from groundstation.identification.results import MethodResult
from groundstation.model.parameters import table

COMPARED = ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")
FAR = 0.1
"""Share of a mass or moment by which nobody would use one value for the other."""
BEYOND = 3.0
"""Standard deviations of both together, beyond which chance is out of the question."""


def with_doubts(methods: Mapping[str, MethodResult], best: str) -> dict[str, MethodResult]:
    """The methods, each with a sentence in its note where it is far from the best one."""
    return {
        name: replace(method, note=f"{method.note} {said}".strip())
        if name != best and (said := _doubt(method, methods[best], best))
        else method
        for name, method in methods.items()
    }


def _doubt(method: MethodResult, believed: MethodResult, best: str) -> str:
    """Which number is farthest from the best method's, and by how much; empty where none is far."""
    found: list[tuple[float, str]] = []
    for name in COMPARED:
        one, other = method.parameters.get(name), believed.parameters.get(name)
        if one is None or other is None or other.value == 0.0:
            continue
        share = one.value / other.value - 1.0
        away = abs(one.value - other.value) / max(float(np.hypot(one.std, other.std)), 1e-300)
        if abs(share) > FAR and away > BEYOND:
            found.append((abs(share), f"{table()[name].label} is {abs(share):.1%} {'above' if share > 0 else 'below'}"))
    return (
        "" if not found else f"Not to be used here: its {max(found)[1]} that of {best}, more than both intervals allow."
    )
