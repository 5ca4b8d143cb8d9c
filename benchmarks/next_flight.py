"""Does one planned flight settle what a gentle one left open? `python -m benchmarks.next_flight`

For each pair that is easily mistaken, and each of the two as the truth: a gentle flight is diagnosed, the next flight
is planned from its diagnosis (from the pair itself where the gentle flight left nothing open), flown with the same
hidden effect in fresh noise, and diagnosed alone. Size of the effect, true vehicle, biases, disturbance and noise are
drawn from a master seed that is new each run and printed.
"""

from __future__ import annotations

import argparse
import secrets
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from groundstation.diagnosis import diagnose
from groundstation.diagnosis.next_flight import odds_sentence, plan_next
from groundstation.errors import FlightAborted, Refused
from groundstation.trajectory import Plan, coefficients_from_arrays
from sim.flight import simulate
from studies.flown import flight_data
from studies.hidden import Table, declared, sizes, world
from studies.tally import share

PAIRS = (
    ("clock_offset", "motor_lag"),
    ("com_offset", "weak_rotor"),
    ("payload_change", "battery_sag"),
    ("rotor_drag", "wind"),
)
BESIDE = {"wind": ("rotor_drag",)}
"""What a truth is flown beside, and must be named with: air is felt through drag alone."""
VEHICLE = "x500"
STATES = ("settled", "open", "wrong", "silent")


def gentle(random: np.random.Generator) -> Plan:
    """Two periods of 20 s within a decimetre: what a cautious pilot flies first."""
    order = np.arange(1, 4)
    a, b = random.standard_normal((2, 4, 3))
    a -= a.mean(axis=1, keepdims=True)
    b -= (b @ order)[:, None] * order / (order @ order)
    w = 2.0 * np.pi / 20.0
    size = np.array([0.1, 0.1, 0.1, 0.2])[:, None] * w / np.hypot(a, b).max(axis=1, keepdims=True)
    a, b = a * size, b * size
    start = np.array([0.0, 0.0, 1.6, 0.0])
    offset = start + (b / (w * order)).sum(axis=1)
    return Plan(
        vehicle=VEHICLE, base_frequency_rad_s=w, periods=2.0, coefficients=coefficients_from_arrays(a, b, offset)
    )


def state(document: dict[str, Any], truth: str, rival: str) -> str:
    """Settled: the truth and what it is flown beside are named, and the rival is neither named nor an alternative."""
    named = {f["effect"]: f["alternatives"] for f in document["findings"]}
    wanted = (truth, *BESIDE.get(truth, ()))
    if all(name in named for name in wanted):
        rival_open = any(rival in named[name] for name in wanted)
        return "settled" if rival in wanted or (rival not in named and not rival_open) else "open"
    mentioned = any(truth in (name, *others) for name, others in named.items())
    return "open" if mentioned else "wrong" if named else "silent"


def nominal(truth: str, rival: str) -> dict[str, Any]:
    """A diagnosis that leaves the pair open, for planning where the gentle flight did not."""
    vehicle = declared(VEHICLE, ())
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    values: dict[str, dict[str, float]] = {
        "clock_offset": {"mocap_minus_imu_s": 0.02},
        "motor_lag": {"rotor_lag_up_s": 0.05, "rotor_lag_down_s": 0.05},
        "com_offset": {"com_offset_x_m": 0.004, "com_offset_y_m": 0.004},
        "weak_rotor": {"loss": 0.05},
        "payload_change": {"mass_change_kg": -0.03 * vehicle.mass_kg, "at_s": 20.0, "within_s": 1.0},
        "battery_sag": {"exponent": 0.8},
        "rotor_drag": {"d_x_kg_s": 0.1 * vehicle.mass_kg, "d_y_kg_s": 0.1 * vehicle.mass_kg},
        "wind": {"force_world_x_n": 0.005 * weight, "force_world_y_n": 0.005 * weight, "drag_ratio": 1.0},
    }
    rotor = 1 if truth == "weak_rotor" else None
    finding = {"effect": truth, "parameters": {n: {"value": v} for n, v in values[truth].items()}, "rotor": rotor}
    settings = {n: v for n, v in values[rival].items() if n in ("at_s", "within_s", "drag_ratio")} | {"rotor": 1.0}
    own = {n: v for n, v in values[rival].items() if n not in settings}
    entry = {"effect": rival, "settings": settings, "values": own, "rival_of": truth}
    return {"flight": "", "findings": [{**finding, "alternatives": [rival]}], "candidates": [entry]}


def case(truth: str, rival: str, random: np.random.Generator) -> tuple[str, str, str, float]:
    """States after the gentle and after the planned flight, the planned one's sentence, and seconds of its planning."""
    vehicle = declared(VEHICLE, (truth, rival))
    names = (truth, *BESIDE.get(truth, ()))
    hidden: dict[str, Table] = {name: sizes(vehicle)[name](random) for name in names}
    if "motor_lag" in hidden:
        hidden["motor_lag"]["hover_s"] = min(hidden["motor_lag"]["hover_s"], 0.045)  # what its controller still bears
    documents = []
    plan, sentence, seconds = gentle(random), "", 0.0
    for turn in range(2):
        simulated = simulate(vehicle, plan, world(random, hidden, vehicle), int(random.integers(2**31)))
        documents.append(diagnose([flight_data(simulated, "unknown")]).to_dict())
        if turn:
            break
        began = time.perf_counter()
        try:
            found = plan_next(documents[0], vehicle)
        except Refused:
            found = plan_next(nominal(truth, rival), vehicle)
        plan, sentence, seconds = found.plan, odds_sentence(found), time.perf_counter() - began
    first, second = (
        f"{state(d, truth, rival)} ({d['verdict']}: {', '.join(f['effect'] for f in d['findings']) or 'nothing'})"
        for d in documents
    )
    return first, second, sentence, seconds


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.next_flight", description="One planned flight settles it.")
    parser.add_argument("--flights", type=int, default=3, help="of each truth of each pair")
    parser.add_argument("--seed", type=int, default=None, help="master seed (default: a fresh one, printed)")
    parser.add_argument("--pair", type=int, choices=range(1, len(PAIRS) + 1), help="one of the pairs only")
    options = parser.parse_args(argv)
    master = secrets.randbits(32) if options.seed is None else options.seed
    print("master seed", master, f"{VEHICLE}, {options.flights} flights of each truth", flush=True)
    random = np.random.default_rng(master)
    counts: dict[tuple[str, str], tuple[Counter[str], Counter[str]]] = {}
    for pair in PAIRS if options.pair is None else PAIRS[options.pair - 1 : options.pair]:
        for truth, rival in (pair, pair[::-1]):
            tally = counts.setdefault((truth, rival), (Counter(), Counter()))
            for own in random.spawn(options.flights):
                try:
                    first, second, sentence, seconds = case(truth, rival, own)
                except FlightAborted as error:
                    print(f"{truth} | {rival}: left out, {error}", flush=True)
                    continue
                tally[0][first.split()[0]] += 1
                tally[1][second.split()[0]] += 1
                print(
                    f"{truth} | {rival}: gentle {first}; planned in {seconds:.1f} s {second}\n    {sentence}",
                    flush=True,
                )
    print(f"\n{'truth | rival':32} {'gentle flight':38} planned flight")
    for (truth, rival), (first, second) in counts.items():
        told = [", ".join(f"{s} {c[s]}" for s in STATES if c[s]) for c in (first, second)]
        print(f"{truth + ' | ' + rival:32} {told[0]:38} {told[1]}")
    for name, index in (("gentle", 0), ("planned", 1)):
        total = sum((c[index] for c in counts.values()), Counter())
        print(f"settled by the {name} flight: {share(total['settled'], sum(total.values()))}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
