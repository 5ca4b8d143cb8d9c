"""The figures and numbers of docs/stories: `python -m benchmarks.stories blind|weight|lag`

``blind`` draws what is hidden (two effects, their sizes, the true vehicle, the laboratory) from a seed, lets the
console commands fly, diagnose, export and fly again, and prints what they printed. ``weight`` and ``lag`` read measured
logs (``--data``). Each writes a figure into ``docs/stories``.
"""

from __future__ import annotations

import argparse
import json
import secrets
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import wrench_of
from groundstation.diagnosis.trim import compare_trims, mean_thrust
from groundstation.flightdata import FlightData
from groundstation.identification.preparation import Prepared, prepare
from groundstation.identification.starts import flight_states
from groundstation.model.prediction import predict
from groundstation.model.vehicle_model import declared_model, model_from_document
from groundstation.paths import find_config
from groundstation.recording import load_flight
from groundstation.reporting.exports import read_model
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict
from studies.hidden import declared, sizes

Array = NDArray[np.float64]

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "stories"
HIDEABLE = ("rotor_drag", "com_offset", "weak_rotor", "climb_inflow", "angular_damping", "payload_change")
HORIZONS_S = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
COLOURS = {
    "declared": "#8a8a8a",
    "identified": "#d9822b",
    "without lag": "#d9822b",
    "with findings": "#1f6fb2",
    "and disturbance": "#3a9a5b",
}
TENSOR = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


def command(*arguments: str) -> str:
    """What a console command prints; it is printed here too, as it was typed."""
    print("$ groundstation", " ".join(arguments), flush=True)
    done = subprocess.run(
        [sys.executable, "-P", "-m", "groundstation.cli", *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 3):
        raise SystemExit(done.stderr)
    print(done.stdout, flush=True)
    return done.stdout


def _figure(width: float, height: float, columns: int) -> tuple[Any, Any]:
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams.update(
        {"svg.hashsalt": "stories", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    )
    from matplotlib import pyplot

    return pyplot.subplots(1, columns, figsize=(width, height), constrained_layout=True)


def _save(figure: Any, name: str) -> None:
    path = FIGURES / name
    figure.savefig(path, metadata={"Date": None})
    print(f"figure: docs/stories/{name}")


def errors_by_horizon(flight: FlightData, document: dict[str, Any]) -> dict[str, dict[str, list[float]]]:
    """RMS error of the open-loop prediction by horizon: as declared, as identified without the effects, and with
    them.
    """
    vehicle = vehicle_from_dict(document["vehicle"], "the model")
    bare = {**document, "effects": {}}
    with_effects = model_from_document(document, vehicle, wrench_of(document["effects"], vehicle))
    models = {
        "declared": declared_model(vehicle),
        "identified": model_from_document(bare, vehicle),
        "with findings": with_effects,
    }
    states = flight_states(flight)
    out: dict[str, dict[str, list[float]]] = {name: {"position_m": [], "attitude_rad": []} for name in models}
    for name, model in models.items():
        for horizon in HORIZONS_S:
            error = predict(model, states, horizon_s=horizon).error["model"][f"{horizon:g}"]
            for quantity, values in out[name].items():
                values.append(error[quantity]["rms"])
    return out


def blind(seed: int, folder: Path) -> None:
    """Hide, fly, diagnose, export, fly again, diagnose what is still lacking."""
    import tomli_w

    random = np.random.default_rng(seed)
    vehicle = declared("qball2", ())
    names = [str(n) for n in random.choice(HIDEABLE, 2, replace=False)]
    effects = {name: sizes(vehicle)[name](random) for name in names}
    from sim.scenario import scenario_from_dict  # what is written is validated

    document = {
        "name": "unknown",
        "imu": {"gyro_density": 1e-4, "accel_density": 1.5e-3, "gyro_bias_std": 2e-3, "accel_bias_std": 2e-2},
        "mocap": {"position_std_m": 1.5e-4, "attitude_std_rad": 1e-3, "clock": {"jitter_s": 2e-4, "latency_s": 0.004}},
        "motors": {"noise_share": 0.002},
        "disturbance": {"force_share": 0.003, "torque_share": 0.002, "correlation_s": float(random.uniform(0.2, 0.8))},
        "truth": {
            "mass_factor": float(random.uniform(0.95, 1.05)),
            "inertia_factor": [float(f) for f in random.uniform(0.95, 1.15, 3)],
            "product_share": [float(f) for f in random.uniform(-0.015, 0.015, 3)],
        },
        "effects": effects,
    }
    scenario_from_dict(document)
    folder.mkdir(parents=True, exist_ok=True)
    hidden = folder / "unknown.toml"
    hidden.write_text(tomli_w.dumps(document), encoding="utf-8")
    plan = str(find_config("plans", "qball2"))
    common = ("rehearse", "--vehicle", "qball2", "--plan", plan)
    command(*common, "--scenario", str(hidden), "--seed", "1", "--logs", str(folder / "first"))
    first = next((folder / "first").glob("*/flight.mcap")).parent
    found = folder / "found.toml"
    command("export", str(first / "identification.toml"), "--format", "scenario", "--output", str(found))
    command(*common, "--scenario", str(hidden), "--seed", "2", "--logs", str(folder / "second"))
    second = next((folder / "second").glob("*/flight.mcap"))
    command("predict", str(first / "identification.toml"), str(second))
    command("diagnose", str(second), "--model", str(first / "identification.toml"))
    command(*common, "--scenario", str(found), "--seed", "3", "--logs", str(folder / "rehearsed"))
    rehearsed = next((folder / "rehearsed").glob("*/flight.mcap"))
    command("diagnose", str(rehearsed), "--model", str(first / "identification.toml"))
    print("what was hidden:", effects)
    errors = errors_by_horizon(load_flight(second), read_model(first / "identification.toml"))
    figure, axes = _figure(7.2, 2.8, 2)
    for axis, quantity, factor, unit in (
        (axes[0], "position_m", 1e3, "position, mm"),
        (axes[1], "attitude_rad", 180 / np.pi, "attitude, degrees"),
    ):
        for name, values in errors.items():
            axis.plot(
                HORIZONS_S, factor * np.array(values[quantity]), marker="o", ms=3, color=COLOURS[name], label=name
            )
        axis.set_xlabel("seconds ahead")
        axis.set_title(f"RMS error of the predicted {unit}", fontsize=9)
        axis.set_ylim(0.0)
    axes[0].legend(frameon=False)
    _save(figure, "blind.svg")


def lag(data: Path, folder: Path) -> None:
    """Crazyflie at 1 kHz without declared lag: diagnosed on 55 to 75 s, judged on 75 to 90 s of the same log."""
    log = str(data / "crazyflie-1khz" / "log15")
    seen = ("--vehicle", "crazyflie21", "--from", "55", "--to", "75")
    command("report", log, *seen, "--logs", str(folder))
    results = next(folder.glob("*/identification.toml")).parent
    command("diagnose", log, *seen, "--logs", str(folder / "again"))
    _lag_figure(data / "crazyflie-1khz" / "log15", results)


def _lag_figure(log: Path, results: Path) -> None:
    """Prediction on the unseen part, and the moments of inertia, with the lag left out and put in."""
    document = read_model(results / "identification.toml")
    diagnosis = json.loads((results / "diagnosis.json").read_text(encoding="utf-8"))
    before, after = ({n: diagnosis[part][n] for n in TENSOR} for part in ("parameters_before", "parameters_after"))
    for name in TENSOR:
        told = [
            f"{1e6 * part[name]['value']:.1f} ({1e6 * part[name]['ci95'][0]:.1f} .. {1e6 * part[name]['ci95'][1]:.1f})"
            for part in (before, after)
        ]
        print(f"{name} in 1e-6: without lag {told[0]}, with findings {told[1]}")
    vehicle = vehicle_from_dict(document["vehicle"], "the model")
    unseen = load_flight(log, vehicle=vehicle, start_s=75.0, end_s=90.0)
    constants = {n: e for n, e in document["parameters"].items() if n not in TENSOR}
    bare = {part: entries for part, entries in document.items() if part != "disturbance"}
    models = {
        "declared": declared_model(vehicle),
        "without lag": model_from_document({"parameters": {**constants, **before}}, vehicle),
        "with findings": model_from_document(bare, vehicle, wrench_of(document["effects"], vehicle)),
        "and disturbance": model_from_document(document, vehicle, wrench_of(document["effects"], vehicle)),
    }
    horizons = (0.02, 0.05, 0.1, 0.15, 0.2)
    states = flight_states(unseen)
    figure, axes = _figure(7.2, 2.8, 2)
    print("RMS error of the predicted body rate, rad/s, on 75 to 90 s")
    print(f"{'':16}" + "".join(f"{f'{h:g} s':>9}" for h in horizons))
    for name, model in models.items():
        found = [
            predict(model, states, horizon_s=h).error["model"][f"{h:g}"]["body_rate_rad_s"]["rms"] for h in horizons
        ]
        print(f"{name:16}" + "".join(f"{e:9.3f}" for e in found))
        axes[0].plot(horizons, found, marker="o", ms=3, color=COLOURS[name], label=name)
    axes[0].set_xlabel("seconds ahead")
    axes[0].set_xticks(horizons, [f"{h:g}" for h in horizons])
    axes[0].set_yscale("log")
    axes[0].set_yticks((0.1, 0.2, 0.5, 1, 2, 5), ("0.1", "0.2", "0.5", "1", "2", "5"), minor=False)
    axes[0].minorticks_off()
    axes[0].set_title("RMS error of the predicted body rate, rad/s", fontsize=9)
    axes[0].legend(frameon=False)
    for row, name in enumerate(TENSOR):
        for place, part, colour in ((-0.12, before, "without lag"), (0.12, after, "with findings")):
            low, high = (1e6 * end for end in part[name]["ci95"])
            axes[1].plot([low, high], [row + place] * 2, color=COLOURS[colour], lw=3)
        bench = 1e6 * getattr(vehicle.inertia_kg_m2, name[1:3])
        axes[1].plot([bench] * 2, [row - 0.35, row + 0.35], color="black", lw=1)
    axes[1].set_xscale("log")
    axes[1].minorticks_off()
    axes[1].set_xticks((10, 20, 50, 100, 200), ("10", "20", "50", "100", "200"))
    axes[1].set_xlabel("10⁻⁶ kg m²; black: pendulum, as declared")
    axes[1].set_yticks(range(3), ["Ixx", "Iyy", "Izz"])
    axes[1].set_title("95 % intervals of inertia", fontsize=9)
    _save(figure, "lag.svg")


GROUPS = {
    "normal_flight": ("healthy", "#8a8a8a"),
    "add_weight_W1_near_M3": ("weight beside rotor 3", "#1f6fb2"),
    "cut_propeller_M3_4mm_4mm_39mm": ("propeller 3 cut", "#d9822b"),
}
"""Folders of crazypad: what the figure calls them, and their colour."""


def weight(data: Path, folder: Path) -> None:
    """Crazyflie with a weight beside rotor 3, and with its propeller cut, against its healthy flights."""
    flights = {group: sorted((data / "crazypad" / group).glob("E*")) for group in GROUPS}
    healthy = [part for path in flights["normal_flight"] for part in ("--reference", str(path))]
    for group in list(GROUPS)[1:]:
        command(
            "diagnose", *map(str, flights[group]), *healthy, "--vehicle", "crazyflie21", "--logs", str(folder / group)
        )
    vehicle = load_vehicle(find_config("vehicles", "crazyflie21"))
    prepared = {g: [prepare(load_flight(path, vehicle=vehicle)) for path in paths] for g, paths in flights.items()}
    _one_by_one(prepared)
    _weight_figure(vehicle, prepared)


def _one_by_one(flights: dict[str, list[Prepared]]) -> None:
    """What each flight says by itself: the faulty ones beside all healthy ones, a healthy one beside the others."""
    well = flights["normal_flight"]
    for group, (name, _) in GROUPS.items():
        for flight in flights[group]:
            found = compare_trims([flight], [other for other in well if other is not flight]).findings
            told = [
                f"{f.effect}, rotor {f.rotor} ({f.confidence:.0%}), or {f.alternatives or 'nothing'}" for f in found
            ]
            print(f"{f'{name}, {flight.flight.name}':34}{', '.join(told) or 'nothing found'}")


def _weight_figure(vehicle: Vehicle, flights: dict[str, list[Prepared]]) -> None:
    """Where the mean commanded thrust in settled flight stands, and the yaw torque it makes, by the declared
    constants.
    """
    allocation = vehicle.allocation()
    towards = np.asarray(vehicle.rotors.position_m)[2, :2]
    towards = towards / np.linalg.norm(towards)
    figure, axes = _figure(7.2, 2.9, 2)
    print(f"{'flight':34}{'thrust, g':>11}{'its centre towards rotor 3, mm':>32}{'yaw torque over thrust, mm':>28}")
    means = {}
    for group, (name, colour) in GROUPS.items():
        rows = []
        for flight in flights[group]:
            force, roll, pitch, yaw = allocation @ mean_thrust(flight)
            centre = float(towards @ np.array([-pitch, roll]) / force)
            rows.append((1e3 * force / vehicle.gravity_m_s2, 1e3 * centre, 1e3 * yaw / force))
            print(f"{f'{name}, {flight.flight.name}':34}{rows[-1][0]:11.2f}{rows[-1][1]:32.2f}{rows[-1][2]:28.3f}")
        found = np.array(rows)
        means[group] = found.mean(axis=0)
        for axis, column in zip(axes, (0, 2), strict=True):
            axis.plot(found[:, 1], found[:, column], "o", color=colour, label=name)
    start = means["normal_flight"]
    # Rotor 3 must be asked for a share more: its thrust in grams joins the total at its hub, with its reaction torque.
    more = np.linspace(0.0, 1.8, 30)
    arm, torque = 1e3 * vehicle.arm_m(), -1e3 * vehicle.rotors.spin[2] * vehicle.rotors.torque_to_thrust_m
    total = start[0] + more
    centre = (start[1] * start[0] + arm * more) / total
    axes[0].plot(centre, total, "--", color="black", lw=1, label="rotor 3 asked for more")
    axes[1].plot(centre, (start[2] * start[0] + torque * more) / total, "--", color="black", lw=1)
    axes[1].axhline(start[2], color="black", lw=1, ls=":")
    for axis, text in zip(axes, ("commanded thrust, g", "yaw torque over thrust, mm"), strict=True):
        axis.set_xlabel("centre of thrust towards rotor 3, mm")
        axis.set_title(text, fontsize=9)
    axes[0].legend(frameon=False, fontsize=7)
    _save(figure, "weight.svg")


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.stories", description="Figures and numbers of docs/stories.")
    parser.add_argument("story", choices=("blind", "weight", "lag"))
    parser.add_argument("--seed", type=int, default=None, help="of what is hidden (default: a fresh one, printed)")
    parser.add_argument("--folder", type=Path, default=Path("logs/story"), help="for flights and results")
    parser.add_argument("--data", type=Path, help="folder of the measured flights")
    options = parser.parse_args(argv)
    if options.story != "blind" and options.data is None:
        parser.error("measured stories need --data")
    if options.story != "blind":
        {"lag": lag, "weight": weight}[options.story](options.data, options.folder)
        return 0
    seed = secrets.randbits(32) if options.seed is None else options.seed
    print("seed", seed)
    blind(seed, options.folder)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
