"""What makes the seed's LS and FMLS disagree? Flies Table 2's trajectory with one hidden mechanism at a time.

Run with ``python -m benchmarks.disagreement``; the output is kept in docs/disagreement.md.
``--best`` shows instead what the estimate that ``identify`` believes makes of some of the mechanisms.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from groundstation.flightdata import FlightData
from groundstation.identification.estimators import least_squares
from groundstation.identification.filters import matched_pair, seed_pair
from groundstation.identification.seed import Regression, filtered_regression, standard_regression
from groundstation.identification.seed_signals import Processing, process_flight
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.flight import simulate
from sim.scenario import scenario_from_dict
from studies.flown import flight_data

PAPER = {"ixx": 0.01200 / 0.00749, "iyy": 0.01537 / 0.00976, "izz": 0.08295 / 0.05130, "mass": 1.82246 / 1.82245}
DIAGONAL = (1, 4, 6)
SEEDS = 5


@dataclass(frozen=True)
class Case:
    """One mechanism at one size: what the scenario adds, and how the data are processed."""

    name: str
    scenario: Mapping[str, Any] = field(default_factory=dict)
    cutoff_hz: float = 5.0
    period_s: float = 0.002
    pair: str = "seed"
    random: bool = False


def cases() -> list[Case]:
    """From nothing hidden to each mechanism."""

    def effect(name: str, **parameters: Any) -> dict[str, Any]:
        return {"effects": {name: parameters}}

    def lag(seconds: float) -> dict[str, Any]:
        return {"truth": {"lag": {"up_s": seconds, "down_s": seconds}}}

    def draught(share: float, correlation_s: float) -> dict[str, Any]:
        return {"disturbance": {"torque_share": share, "correlation_s": correlation_s}}

    def gyro(density: float) -> dict[str, Any]:
        return {"imu": {"gyro_density": density}}

    return [
        Case("nothing hidden, matched filter pair", pair="matched"),
        Case("nothing hidden, the seed's pair at 2 ms"),
        Case("the seed's pair at 1/100 s", period_s=1 / 100),
        Case("the seed's pair at 1/30 s", period_s=1 / 30),
        Case("rotor lag 50 ms", lag(0.05)),
        Case("rotor lag 100 ms", lag(0.1)),
        Case("input delay 20 ms", effect("input_delay", delay_s=0.02)),
        Case("input delay 40 ms", effect("input_delay", delay_s=0.04)),
        Case("input delay 20 ms, low-pass 20 Hz", effect("input_delay", delay_s=0.02), cutoff_hz=20.0),
        Case("clock offset 50 ms", effect("clock_offset", offset_s=0.05)),
        Case("rotor drag 0.25 kg/s", effect("rotor_drag", drag_kg_s=(0.25, 0.25))),
        Case("flapping moment 0.02 N m per m/s", effect("flapping_moment", k_nm_s_m=0.02)),
        Case("angular damping 0.02 N m s", effect("angular_damping", damping_nms=(0.02, 0.02, 0.02))),
        Case("centre of mass off by 5 mm in x and y", effect("com_offset", offset_m=(0.005, -0.005, 0.0))),
        Case(
            "the same by 4.5 mm, pair at 1/30 s",
            effect("com_offset", offset_m=(0.0045, -0.0045, 0.0)),
            period_s=1 / 30,
        ),
        Case("centre of mass off by 30 mm in z", effect("com_offset", offset_m=(0.0, 0.0, -0.03))),
        Case("gyro noise 1e-4 rad/s/rtHz", gyro(1e-4), random=True),
        Case("gyro noise 1e-3 rad/s/rtHz", gyro(1e-3), random=True),
        Case("gyro noise 1e-3, low-pass 20 Hz", gyro(1e-3), cutoff_hz=20.0, random=True),
        Case("gyro noise 1e-3, low-pass 100 Hz", gyro(1e-3), cutoff_hz=100.0, random=True),
        Case("torque draught 0.0035 N m, 0.3 s", draught(0.001, 0.3), random=True),
        Case("torque draught 0.018 N m, 0.3 s", draught(0.005, 0.3), random=True),
        Case("torque draught 0.08 N m, 1 s", draught(0.0228, 1.0), random=True),
        Case("torque draught 0.08 N m, 0.3 s", draught(0.0228, 0.3), random=True),
        Case("torque draught 0.08 N m, 0.05 s", draught(0.0228, 0.05), random=True),
        Case("torque draught 0.08 N m, 0.05 s, pair at 1/30 s", draught(0.0228, 0.05), period_s=1 / 30, random=True),
    ]


def declared() -> Vehicle:
    """The QBall 2, whose wrench is known, as the paper's, from what the controller asked for."""
    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "qball2")))
    document["rotors"]["speed_source"] = "command"
    return vehicle_from_dict(document)


def fly(case: Case, seed: int) -> FlightData:
    """Table 2's trajectory for 50 s in an otherwise ideal laboratory with poses at 30 Hz."""
    plan = load_plan(find_config("plans", "paper_table2")).model_copy(update={"periods": 5.0})
    scenario = {"mocap": {"rate_hz": 30.0}, "control": {"position_hz": 30.0}, **case.scenario}
    return flight_data(simulate(declared(), plan, scenario_from_dict(scenario), seed), case.name)


def solve(regression: Regression) -> tuple[np.ndarray, np.ndarray]:
    """Theta and RMS residual."""
    estimate = least_squares(regression.regressor, regression.output, regression.t_s, regression.used, points=2)
    return estimate.values, estimate.rms_residual


def measure(case: Case, seed: int) -> np.ndarray:
    """LS over truth, FMLS over truth, LS over FMLS (Ixx, Iyy, Izz each), LS mass over FMLS mass, LS residual of
    tau_x.
    """
    flight = fly(case, seed)
    pair: dict[str, Any] = {"seed": seed_pair, "matched": matched_pair}
    make = pair[case.pair]
    standard = process_flight(flight, Processing(cutoff_hz=case.cutoff_hz, period_s=0.002, accelerometer=False))
    signals = standard
    if case.period_s > 0.002:
        signals = process_flight(
            flight, Processing(cutoff_hz=case.cutoff_hz, period_s=case.period_s, accelerometer=False)
        )
    ls, residual = solve(standard_regression(standard))
    fmls, _ = solve(filtered_regression(signals, make, period_s=case.period_s))
    truth = np.diag(flight.truth.inertia_tensor())
    d = list(DIAGONAL)
    return np.concatenate([ls[d] / truth, fmls[d] / truth, ls[d] / fmls[d], [ls[0] / fmls[0], residual[1]]])


def best_cases() -> list[Case]:
    """Mechanisms on top of the seed scenario's noise and draught."""
    world = {
        "imu": {"gyro_density": 1e-4, "accel_density": 1.5e-3},
        "disturbance": {"force_share": 0.001, "torque_share": 0.001, "correlation_s": 0.3},
    }
    return [
        Case("draught and sensor noise", world),
        Case("and rotor lag 50 ms", {**world, "truth": {"lag": {"up_s": 0.05, "down_s": 0.05}}}),
        Case("and input delay 20 ms", {**world, "effects": {"input_delay": {"delay_s": 0.02}}}),
        Case("and gyro noise 1e-3", {**world, "imu": {"gyro_density": 1e-3, "accel_density": 1.5e-3}}),
    ]


def print_best() -> None:
    """Estimate over truth and claimed standard deviation of the seed's methods and of the one that is believed."""
    from groundstation.identification.pipeline import identify

    print(f"{'hidden mechanism':<32}{'method':<8}" + "".join(f"{n:>17}" for n in ("mass", "Ixx", "Iyy", "Izz")))
    for case in best_cases():
        flight = fly(case, 1)
        result = identify([flight])
        truth = [flight.truth.mass_kg, *np.diag(flight.truth.inertia_tensor())]
        for name in ("LS", "FMLS", "GD", "FMGD", result.best):
            cells = ""
            for key, expected in zip(("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"), truth, strict=True):
                estimate = result.methods[name].parameters.get(key)
                cells += (
                    f"{'-':>17}"
                    if estimate is None
                    else f"{estimate.value / expected:>9.4f} ({estimate.std / expected:.4f})"
                )
            print(f"{case.name:<32}{name:<8}{cells}", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="flights of each case that has noise")
    parser.add_argument("--best", action="store_true", help="the estimate that identify believes, on some mechanisms")
    options = parser.parse_args()
    if options.best:
        print_best()
        return
    print(f"{'':<48}{'LS / truth':^19}{'FMLS / truth':^19}{'LS / FMLS':^27}{'tau_x':>8}")
    print(f"{'hidden mechanism':<48}" + "".join(f"{n:>6}" for n in ("Ixx", "Iyy", "Izz")) + " ", end="")
    print(
        "".join(f"{n:>6}" for n in ("Ixx", "Iyy", "Izz")) + " " + "".join(f"{n:>6}" for n in ("Ixx", "Iyy", "Izz")),
        end="",
    )
    print(f"{'mass':>8}{'N m':>9}")
    blank = "     -" * 3
    print(f"{'the paper, Table 3 and 5':<48}{blank} {blank} ", end="")
    print("".join(f"{PAPER[n]:6.3f}" for n in ("ixx", "iyy", "izz")) + f"{PAPER['mass']:8.4f}{0.0789:9.4f}")
    for case in cases():
        rows = np.array([measure(case, seed) for seed in range(1, (options.seeds if case.random else 1) + 1)])
        for line, values in (
            ("", np.mean(rows, axis=0)),
            ("spread", np.std(rows, axis=0, ddof=1) if len(rows) > 1 else None),
        ):
            if values is None:
                continue
            name = case.name if not line else f"   spread over {len(rows)} flights"
            groups = " ".join("".join(f"{v:6.3f}" for v in values[i : i + 3]) for i in (0, 3, 6))
            print(f"{name:<48}{groups}{values[9]:8.4f}{values[10]:9.4f}", flush=True)


if __name__ == "__main__":
    main()
