"""The paper's four flights on the simulated QBall 2, each flown by the simulator in a process of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from groundstation.flight.client.simulate import simulate
from groundstation.flightdata import FlightData
from groundstation.json_types import JsonObject
from groundstation.paths import find_config
from groundstation.trajectory import ChannelCoefficients, Coefficients, Plan, load_plan
from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict

PERIODS = 5.0
"""The paper flies 0 s < t < 50 s."""
CLOCK_S = 0.012
"""Offset between motion capture and IMU in the simulated laboratory; told to the methods, as the paper's are
synchronised.
"""


@dataclass(frozen=True, slots=True)
class Truth:
    """A true vehicle to fly: what the paper leaves open. Tensor entries that are not given are the nominal ones."""

    name: str
    mass_kg: float
    inertia_kg_m2: Mapping[str, float]
    why: str


TRUTHS = (
    Truth(
        "nominal tensor",
        1.8225,
        {"xx": 0.03, "yy": 0.03, "zz": 0.04},
        "the mass all four methods agree on, the manufacturer's tensor",
    ),
    Truth(
        "lighter tensor with products",
        1.8225,
        {"xx": 0.0225, "yy": 0.0255, "zz": 0.036, "xy": -0.0008, "yz": -0.0006},
        "the manufacturer's tensor lessened by 10 to 25 %, with products of the size of Table 3's",
    ),
    Truth(
        "Table 3's tilt inertias",
        1.8225,
        {"xx": 0.012, "yy": 0.0154, "zz": 0.027, "xy": -0.0008, "yz": -0.0006},
        "Ixx and Iyy of Table 3 (LS) with nearly the largest Izz that such a body can have (Ixx + Iyy), where the "
        "table has 0.083",
    ),
)


def identification_plan() -> Plan:
    """Table 2's trajectory, five periods."""
    return load_plan(find_config("plans", "paper_table2")).model_copy(update={"periods": PERIODS})


def circle_plan(radius_m: float, altitude_m: float) -> Plan:
    """The circle of IV-C as a Fourier series of one harmonic, ten rounds of 5 s.

    The paper climbs to the altitude during the first 5 s; here the take-off does, and the 0.1 m oscillation is there
    from the start. Both begin with the speed of the circle, from rest.
    """
    w = 2.0 * math.pi / 5.0

    def channel(a: float = 0.0, b: float = 0.0, c: float = 0.0) -> ChannelCoefficients:
        return ChannelCoefficients(a=(a,), b=(b,), c=c)

    return Plan(
        vehicle="qball2",
        base_frequency_rad_s=w,
        periods=10.0,
        coefficients=Coefficients(
            x=channel(b=-radius_m * w),
            y=channel(a=radius_m * w),
            z=channel(a=0.1 * w, c=altitude_m),
            yaw=channel(a=math.radians(15.0) * w),
        ),
        note=f"circle of {radius_m} m at {altitude_m} m, section IV-C",
    )


def fly(plan: Plan, truth: Truth, seed: int, folder: Path) -> FlightData:
    """Fly a plan in a simulator process and load what it recorded.

    The wrench is known as the paper knows it, from what the controller asked for.

    Raises:
        BadInput: the simulator refused or failed; its last words say why.
    """
    folder.mkdir(parents=True, exist_ok=True)
    declared = vehicle_to_dict(load_vehicle(find_config("vehicles", "qball2")))
    declared["rotors"]["speed_source"] = "command"
    return simulate(vehicle_from_dict(declared), plan, _scenario(truth), seed, folder / "flight")


def _scenario(truth: Truth) -> JsonObject:
    """The seed scenario's world with this true vehicle."""
    import tomllib

    document = tomllib.loads(find_config("scenarios", "seed").read_text(encoding="utf-8"))
    document["name"] = truth.name
    document["truth"] = {"mass_kg": truth.mass_kg, "inertia_kg_m2": dict(truth.inertia_kg_m2)}
    return document
