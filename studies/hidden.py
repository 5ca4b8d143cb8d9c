"""What a blind bench hides: sizes of each effect, the laboratory it is flown in, and the vehicle that is declared."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from groundstation.paths import find_config
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.scenario import Scenario, scenario_from_dict
from studies.study import IMU_NOISE

COMMANDED = ("motor_lag", "input_delay", "battery_sag")
"""Effects that show only where rotor speeds are commanded, not measured."""
INVENTED = ("attracting_wall", "thrust_memory", "magnet")
"""No file of the library models these."""

LAG = {"up_s": 0.03, "down_s": 0.04}
"""Of rotors whose speed is measured, and of those with an inertia."""

Random = np.random.Generator
Table = dict[str, Any]


def _signed(random: Random, low: float, high: float) -> float:
    return float(random.choice([-1.0, 1.0]) * random.uniform(low, high))


def _turn(random: Random, size: float) -> list[float]:
    direction = random.standard_normal(3)
    return list(map(float, size * direction / np.linalg.norm(direction)))


def sizes(vehicle: Vehicle) -> dict[str, Callable[[Random], Table]]:
    """For each effect what its table in a scenario may be; forces scale with weight, torques with weight times arm."""
    mass, weight = vehicle.mass_kg, vehicle.mass_kg * vehicle.gravity_m_s2
    torque = weight * vehicle.arm_m()

    def per(scale: float, low: float, high: float) -> Callable[[Random], float]:
        return lambda r: float(scale * r.uniform(low, high))

    def rotor(r: Random) -> int:
        return int(r.integers(1, vehicle.rotors.count + 1))

    return {
        "motor_lag": lambda r: {"hover_s": per(1.0, 0.03, 0.08)(r)},
        "input_delay": lambda r: {"delay_s": per(1.0, 0.015, 0.04)(r)},
        "clock_offset": lambda r: {"offset_s": _signed(r, 0.005, 0.04)},
        "rotor_drag": lambda r: {"drag_kg_s": [per(mass, 0.06, 0.25)(r), per(mass, 0.06, 0.25)(r)]},
        "body_drag": lambda r: {"area_m2": [per(mass, 0.03, 0.12)(r)] * 3},
        "flapping_moment": lambda r: {"k_nm_s_m": per(torque, 0.005, 0.02)(r)},
        "angular_damping": lambda r: {"damping_nms": [per(torque, 0.004, 0.015)(r)] * 3},
        "translational_lift": lambda r: {"gain": per(1.0, 0.5, 1.0)(r)},
        "climb_inflow": lambda r: {"gain": per(1.0, 0.4, 1.0)(r)},
        "wind": lambda r: {"velocity_m_s": [*_turn(r, 1.0)[:2], 0.0], "gust_m_s": 0.1},
        "weak_rotor": lambda r: {"rotor": rotor(r), "loss": per(1.0, 0.03, 0.15)(r)},
        "rotor_degradation": lambda r: {
            "rotor": rotor(r),
            "loss": per(1.0, 0.04, 0.15)(r),
            "start_s": per(1, 18, 32)(r),
        },
        "thrust_curve": lambda r: {"exponent": 2.0 + _signed(r, 0.15, 0.4)},
        "com_offset": lambda r: {"offset_m": [_signed(r, 0.002, 0.01), _signed(r, 0.002, 0.01), 0.0]},
        "rotor_gyroscopic": lambda r: {"inertia_kg_m2": per(mass, 1e-5, 4e-5)(r)},
        "battery_sag": lambda r: {"strength": per(1.0, 0.5, 1.0)(r)},
        "payload_change": lambda r: {"mass_kg": per(mass, 0.015, 0.06)(r), "time_s": per(1, 18, 32)(r)},
        "slung_load": lambda r: {"mass_kg": per(mass, 0.02, 0.06)(r), "length_m": per(1.0, 0.3, 1.0)(r)},
        "tether": lambda r: {"stiffness_n_m": per(weight, 0.01, 0.04)(r)},
        "constant_wrench": lambda r: {
            "force_world_n": [*_turn(r, weight * r.uniform(0.0, 0.03))[:2], 0.0],
            "torque_body_nm": _turn(r, torque * r.uniform(0.01, 0.03)),
        },
        "imu_misalignment": lambda r: {"rotation_rad": _turn(r, r.uniform(0.01, 0.04))},
        "mocap_misalignment": lambda r: {"rotation_rad": _turn(r, r.uniform(0.01, 0.04)), "offset_m": [0.0] * 3},
        "mocap_tilt": lambda r: {"tilt_rad": [_signed(r, 0.008, 0.03), _signed(r, 0.008, 0.03)]},
        "attracting_wall": lambda r: {"strength_n_m3": per(weight, 0.06, 0.2)(r), "distance_m": per(1.0, 1.0, 1.6)(r)},
        "thrust_memory": lambda r: {"width_share": per(1.0, 0.04, 0.1)(r)},
        "magnet": lambda r: {"strength_n_m4": per(weight, 0.0005, 0.003)(r), "position_m": [0.4, 0.2, 0.4]},
    }


def world(random: Random, hidden: dict[str, Table], vehicle: Vehicle) -> Scenario:
    """A laboratory with drawn disturbance, biases and jitter, whose clocks agree and whose rotors are as declared.

    Rotors whose speed is measured lag behind their commands as all rotors do; the diagnosis sees the speeds.
    """

    def clock(jitter_s: float) -> Table:
        return {"jitter_s": float(jitter_s * random.uniform(0.5, 2.0)), "latency_s": 0.004, "latency_jitter_s": 0.001}

    return scenario_from_dict(
        {
            "name": "unknown",
            "imu": {
                **IMU_NOISE,
                "clock": clock(2e-5),
            },
            "mocap": {
                "rate_hz": float(random.choice([60.0, 100.0, 120.0])),
                "position_std_m": 1.5e-4,
                "attitude_std_rad": 1e-3,
                "dropouts_per_minute": 1.0,
                "dropout_s": 0.1,
                "clock": clock(2e-4),
            },
            "motors": {"rate_hz": 500.0, "noise_share": 0.002, "clock": clock(2e-5)},
            "battery": {"rate_hz": 10.0, "voltage_std_v": 0.01, "current_std_a": 0.1},
            "disturbance": {
                "force_share": float(random.uniform(0.001, 0.004)),
                "torque_share": float(random.uniform(0.001, 0.003)),
                "correlation_s": float(random.uniform(0.2, 0.8)),
                "order": int(random.integers(1, 3)),
            },
            "truth": {
                "mass_factor": float(random.uniform(0.95, 1.05)),
                "inertia_factor": [float(f) for f in (*random.uniform(1.0, 1.2, 2), random.uniform(0.85, 1.0))],
                "product_share": [float(f) for f in random.uniform(-0.015, 0.015, 3)],
                **({} if vehicle.rotors.speed_source == "command" else {"lag": LAG}),
            },
            "effects": hidden,
        }
    )


def declared(name: str, hidden: Collection[str]) -> Vehicle:
    """A vehicle of configs/; with the speeds commanded, not measured, where the effect lies in between, and with a lag
    where rotors that follow commands have an inertia.
    """
    vehicle = load_vehicle(find_config("vehicles", name))
    source = "command" if set(hidden) & set(COMMANDED) else vehicle.rotors.speed_source
    at_once = vehicle.rotors.lag.up_s == vehicle.rotors.lag.down_s == 0.0
    lagging = "rotor_gyroscopic" in hidden and source == "command" and at_once
    if source == vehicle.rotors.speed_source and not lagging:
        return vehicle
    document = vehicle_to_dict(vehicle)
    document["rotors"] |= {"speed_source": source, **({"lag": LAG} if lagging else {})}
    return vehicle_from_dict(document)
