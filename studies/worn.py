"""Flights of a worn vehicle: a rotor that loses 6 % beside an offset of the centre of mass (``benchmarks.worn``)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from groundstation.diagnosis import diagnose
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data

PLANS = ("qball2", "paper_table2")
ROTOR, LOSS = 2, 0.06
TRUE = {"weak_rotor", "com_offset", "clock_offset"}
"""Everything the scenario hides that the library has a word for; rotors' lag and inertia are declared wrongly beside.
"""
SURE = 0.99
WAIT_S = (1.0, 5.0)


def is_right(finding: Mapping[str, Any]) -> bool:
    """Whether a finding names what is there: the effect, and of the rotors the one that is weak."""
    known = TRUE | {"motor_lag", "thrust_scale", "input_delay"}
    return finding["effect"] in known and finding["rotor"] in (None, ROTOR)


def fly(plan: str, seed: int, wait_s: float) -> dict[str, Any]:
    """One flight and what was said of it."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    scenario = load_scenario(find_config("scenarios", "worn"))
    simulated = simulate(vehicle, load_plan(find_config("plans", plan)), scenario, seed, rest_s=wait_s)
    started = time.perf_counter()
    diagnosis = diagnose([flight_data(simulated, "worn")])
    rotors = [f for f in diagnosis.findings if f.rotor is not None]
    mass = diagnosis.parameters_after["mass_kg"]
    return {
        "plan": plan,
        "seed": seed,
        "wait_s": wait_s,
        "verdict": diagnosis.verdict,
        "rotor_first": rotors[0].rotor if rotors else None,
        "effect_first": rotors[0].effect if rotors else None,
        "findings": [
            {
                "effect": f.effect,
                "rotor": f.rotor,
                "confidence": f.confidence,
                "values": {n: e.value for n, e in f.parameters.items()},
                "alternatives": list(f.alternatives),
            }
            for f in diagnosis.findings
        ],
        "mass_sigma": (mass.value - simulated.truth.mass_kg) / max(mass.std, 1e-12),
        "mass_error": mass.value / simulated.truth.mass_kg - 1.0,
        "covered": bool(mass.ci95[0] <= simulated.truth.mass_kg <= mass.ci95[1]),
        "seconds": time.perf_counter() - started,
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The figures of a set of flights."""
    findings = [f for row in rows for f in row["findings"]]
    sure = [f for f in findings if f["confidence"] >= SURE]
    right = sum(r["rotor_first"] == ROTOR and r["effect_first"] == "weak_rotor" for r in rows)
    return {
        "flights": len(rows),
        "right rotor first": right,
        "explained": sum(r["verdict"] == "explained" for r in rows),
        "findings at 0.99 and more": len(sure),
        "of these right": sum(map(is_right, sure)),
        "findings below": len(findings) - len(sure),
        "of them right": sum(is_right(f) for f in findings if f["confidence"] < SURE),
        "true mass within its interval": sum(bool(r["covered"]) for r in rows),
        "largest error of mass": max((abs(r["mass_error"]) for r in rows), default=0.0),
    }
