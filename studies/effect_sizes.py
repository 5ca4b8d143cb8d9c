"""What a finding's parameters are in truth, where a scenario states them one to one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from groundstation.vehicle import Vehicle

Table = Mapping[str, Any]
Truth = Callable[[Table, Vehicle], float]


def _key(name: str, factor: float = 1.0, index: int | None = None) -> Truth:
    return lambda table, _: factor * float(table[name] if index is None else table[name][index])


def _axes(parameter: str, name: str, axes: str = "xyz") -> dict[str, Truth]:
    return {parameter.format(axis): _key(name, index="xyz".index(axis)) for axis in axes}


TRUE: Mapping[str, Mapping[str, Truth]] = {
    "angular_damping": _axes("damping_{}_nms", "damping_nms"),
    "body_drag": {
        "c_kg_m": lambda table, vehicle: 0.5 * vehicle.identification.air_density_kg_m3 * table["area_m2"][0]
    },
    "clock_offset": {"mocap_minus_imu_s": _key("offset_s")},
    "com_offset": _axes("com_offset_{}_m", "offset_m", "xy"),
    "constant_wrench": {
        **_axes("force_world_{}_n", "force_world_n", "xy"),
        **_axes("torque_{}_nm", "torque_body_nm"),
    },
    "imu_misalignment": _axes("rotation_{}_rad", "rotation_rad"),
    "input_delay": {"input_delay_s": _key("delay_s")},
    "mocap_misalignment": _axes("rotation_{}_rad", "rotation_rad"),
    "mocap_tilt": _axes("tilt_{}_rad", "tilt_rad", "xy"),
    "payload_change": {"mass_change_kg": _key("mass_kg", -1.0)},
    "rotor_degradation": {"loss": _key("loss")},
    "rotor_gyroscopic": {"rotor_inertia_kg_m2": _key("inertia_kg_m2")},
    "slung_load": {"load_kg": _key("mass_kg"), "length_m": _key("length_m")},
    "tether": {"stiffness_n_m": _key("stiffness_n_m")},
    "thrust_curve": {"exponent_error": lambda table, _: float(table["exponent"]) - 2.0},
    "weak_rotor": {"loss": _key("loss")},
}
"""Effect -> parameter of its finding -> its truth from the effect's table in the scenario.

Drag, flapping, inflow, lift, lag and the battery's sag have other forms in the simulator: no one number there is the
finding's.
"""


def deviations(findings: list[Mapping[str, Any]], hidden: Mapping[str, Table], vehicle: Vehicle) -> dict[str, float]:
    """(Found minus true) over standard deviation of each parameter that was hidden and found.

    Args:
        findings: as :meth:`groundstation.diagnosis.results.Finding.to_dict` writes them.
        hidden: effect -> its table in the scenario.
        vehicle: declared; its air density is the scenario's.

    Returns:
        "effect.parameter" -> standard deviations.
    """
    out = {}
    for finding in findings:
        effect = finding["effect"]
        for name, truth in TRUE.get(effect, {}).items():
            estimate = finding["parameters"].get(name)
            if effect in hidden and estimate is not None and estimate["std"] > 0.0:
                out[f"{effect}.{name}"] = (estimate["value"] - truth(hidden[effect], vehicle)) / estimate["std"]
    return out
