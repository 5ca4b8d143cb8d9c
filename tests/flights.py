"""Simulated flights for tests: plans and laboratories."""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.paths import find_config
from groundstation.trajectory import Plan, coefficients_from_arrays
from sim.scenario import Scenario, load_scenario, scenario_from_dict


def rest_to_rest_plan(
    vehicle: str = "qball2", *, amplitude_m: float = 0.3, periods: float = 2.0, harmonics: int = 5, seed: int = 1
) -> Plan:
    """A random Fourier series at 36 degrees/s that starts and ends at rest with zero velocity and acceleration.

    The constraints sum a = 0 (velocity is sum a cos + b sin at t = 0), sum b l = 0 (acceleration) are met by
    projection; the position amplitude is scaled to ``amplitude_m`` in x and y, half of it in z, and 0.3 rad in yaw.
    """
    random = np.random.default_rng(seed)
    order = np.arange(1, harmonics + 1)
    a, b = random.standard_normal((2, 4, harmonics))
    a -= a.mean(axis=1, keepdims=True)
    b -= (b @ order)[:, None] * order / (order @ order)
    w = np.deg2rad(36.0)
    t = np.linspace(0.0, 2.0 * np.pi / w, 500)[:, None, None]
    shape = np.sum(a / (w * order) * np.sin(w * order * t) - b / (w * order) * np.cos(w * order * t), axis=-1)
    size = np.array([amplitude_m, amplitude_m, 0.5 * amplitude_m, 0.3]) / np.abs(shape - shape[0]).max(axis=0)
    offset = np.array([0.0, 0.0, 1.1, 0.0]) - size * 0.5 * (shape.max(axis=0) + shape.min(axis=0))
    coefficients = coefficients_from_arrays(a * size[:, None], b * size[:, None], offset)
    return Plan(vehicle=vehicle, base_frequency_rad_s=w, periods=periods, coefficients=coefficients)


def laboratory(**effects: dict[str, Any]) -> Scenario:
    """The laboratory with clocks that agree and rotors as declared, and these effects; mass and inertia stay wrong."""
    lab = load_scenario(find_config("scenarios", "lab"))
    agreeing = {"offset_s": 0.0, "drift_ppm": 0.0}
    sections = {
        name: (section := getattr(lab, name)).model_copy(update={"clock": section.clock.model_copy(update=agreeing)})
        for name in ("mocap", "motors")
    }
    planted = scenario_from_dict({"effects": effects}).effects
    return lab.model_copy(update={**sections, "truth": lab.truth.model_copy(update={"lag": None}), "effects": planted})
