"""RotorPy's parameters of an identified vehicle."""

from __future__ import annotations

import numpy as np

from groundstation.errors import BadInput
from groundstation.reporting.identified import Identified
from groundstation.vehicle import INERTIA_NAMES

LEAST_LAG_S = 1e-3
"""RotorPy divides by the lag; a vehicle without one gets a lag that its rotors, at 100 Hz and less, do not show."""
_ROTORPY_HOLDS = ("com_offset", "rotor_drag", "climb_inflow", "body_drag", "translational_lift", "flapping_moment")


def _rotorpy_coefficients(model: Identified) -> dict[str, float]:
    """RotorPy's numbers of rotors and air by their names."""
    rotors = model.vehicle.rotors
    k = rotors.thrust_coefficient_n_s2 or 0.0
    speed_sum = model.hover_speed_sum_rad_s() or 1.0
    lift = model.effects.get("translational_lift", {}).get("lift_s2_m2", 0.0)
    weight = model.vehicle.mass_kg * model.vehicle.gravity_m_s2
    return {
        **{f"c_D{axis}": model.effects.get("body_drag", {}).get("c_kg_m", 0.0) for axis in "xyz"},
        "k_eta": k,
        "k_m": k * rotors.torque_to_thrust_m,
        "k_d": float(np.mean(model.rotor_drag_kg_s)) / speed_sum,
        "k_z": model.climb_damping_kg_s / speed_sum,
        "k_h": lift * weight / rotors.count,
        "k_flap": -model.effects.get("flapping_moment", {}).get("k_nm_s_m", 0.0) / speed_sum,
        "tau_m": max(model.mean_lag_s(), LEAST_LAG_S),
        "rotor_speed_min": 0.0,
        "rotor_speed_max": rotors.speed_max_rad_s or 0.0,
        "motor_noise_std": 0.0,
    }


def to_rotorpy(model: Identified) -> str:
    """A Python module with RotorPy's ``quad_params``. Positions are from the centre of mass; +direction is +torque
    about z.

    Rotor coefficients are per rotor and rotor speed: those found at hover, shared out over the hover speeds; lift at
    hover thrust. RotorPy's flapping moment has the sign opposite to ours (ours lifts the nose when flying forward).
    """
    rotors = model.vehicle.rotors
    if rotors.thrust_coefficient_n_s2 is None or rotors.speed_max_rad_s is None:
        raise BadInput(
            "rotorpy drives rotors by speed: declare thrust_coefficient_n_s2 and speed_max_rad_s, or export mjcf."
        )
    tensor = model.vehicle.inertia_kg_m2
    lines = [
        '"""' + " ".join(_safe(s) for s in model.provenance(_ROTORPY_HOLDS)),
        "",
        "SI units; x forward, y left, z up."
        + (
            ""
            if model.mean_lag_s() >= LEAST_LAG_S
            else f" tau_m is {LEAST_LAG_S} s, the least that RotorPy takes; no lag was found."
        ),
        '"""',
        "",
    ]
    lines += ["import numpy as np", "", "quad_params = {", f"    'mass': {model.vehicle.mass_kg!r},"]
    lines += [f"    'I{name}': {getattr(tensor, name)!r}," for name in INERTIA_NAMES]
    lines += [f"    'num_rotors': {rotors.count},", "    'rotor_pos': {"]
    for i, position in enumerate(np.asarray(rotors.position_m) - model.com_offset_m, start=1):
        lines.append(f"        'r{i}': np.array({position.tolist()!r}),")
    lines += ["    },", f"    'rotor_directions': np.array({[-s for s in rotors.spin]!r}),"]
    lines.append(f"    'rI': np.array({(np.asarray(model.vehicle.imu.position_m) - model.com_offset_m).tolist()!r}),")
    lines += [f"    {name!r}: {value!r}," for name, value in _rotorpy_coefficients(model).items()]
    return "\n".join([*lines, "}", ""])


def _safe(text: str) -> str:
    """Text that cannot end a docstring."""
    return text.replace("\\", "/").replace('"', "'")
