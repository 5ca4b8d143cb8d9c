"""Identify, export, fly in a firmware's own simulator, record over MAVLink, identify again.

python -m benchmarks.round_trip_firmware [--px4 PATH] [--arducopter PATH] [--model identification.toml]

The first flight is our simulator's (x500, scenario hall, findings put in), or the given model's. PX4's simulation in
hardware flies the ``px4-sih`` parameters, ArduCopter's simulator the ``ardupilot-sitl`` frame, each with our plan,
uploaded and led by ``groundstation fly`` as with any vehicle, and identified from what came over the link. The second
identification starts from the declared vehicle, with the thrust curve that the simulator has. z is the difference to
what the file holds, in standard deviations of the second estimate; what a simulator does not hold is zero there. Kept
in docs/results/exports_round_trip.json. Each runs as its instance 7, beside others: UDP 14547, TCP 5830.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from scipy.signal import butter, sosfiltfilt

from benchmarks.exports_round_trip_table import CERTAIN, RESULTS
from groundstation import api
from groundstation.flightdata import FlightData, resampled
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.paths import find_config
from groundstation.reporting.canonical import estimate_in
from groundstation.reporting.exports import read_model
from groundstation.reporting.identified import identified_from_document
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from studies.firmware import SIH_ENVIRONMENT, arducopter_command, process, px4_command

NOT_READY, READY_S, INSTANCE, PATIENCE_S = 3, 300.0, 7, 15.0
ALTITUDE_M = 593.0
"""ArduPilot's reference height, at which the exported thrust holds."""
HOME = f"-35.363262,149.165237,{ALTITUDE_M:g},353"
PRODUCTS = ("ixy_kg_m2", "ixz_kg_m2", "iyz_kg_m2")
GRID_S, FILTER_S = 0.004, 0.012
"""Grid of the regression, and by how much the gyro's filter is late (20 Hz, second order)."""
BESIDE = ("rotor_lag_up_s", "rotor_lag_down_s")
"""Told, not judged: an autopilot's outputs reach the rotors a step later, which is part of the lag found there."""


@dataclass(frozen=True)
class There:
    """A firmware with the exported vehicle in its simulator."""

    reader: str
    link: str
    command: list[str]
    environment: dict[str, str]
    declared: dict[str, Any]
    holds: dict[str, float]
    lacks: str
    flown: str = "40 s, the plan of `fly`"
    noiseless: bool = False


def in_px4(binary: Path, model: Mapping[str, Any], folder: Path) -> There:
    """PX4's simulation in hardware. Its start script takes parameters from the environment."""
    lines = [line.split("\t") for line in api.export(model, "px4-sih").splitlines() if not line.startswith("#")]
    sih = {name: float(value) for _, _, name, value, _ in lines}
    declared = dict(model["vehicle"])
    rotors = {k: v for k, v in declared["rotors"].items() if k not in ("thrust_coefficient_n_s2", "speed_max_rad_s")}
    declared["rotors"] = rotors | {"input": "command", "thrust_curve": [0.0, sih["SIH_T_MAX"], 0.0]}
    names = dict(zip(MASS_AND_TENSOR, ("MASS", "IXX", "IXY", "IXZ", "IYY", "IYZ", "IZZ"), strict=True))
    turned = {"ixy_kg_m2": -1.0, "ixz_kg_m2": -1.0}  # FRD
    holds = {name: turned.get(name, 1.0) * sih[f"SIH_{key}"] for name, key in names.items()}
    holds |= dict.fromkeys(BESIDE, sih["SIH_T_TAU"])
    return There(
        "PX4 v1.17.0-alpha1, SIH", f"udpin://127.0.0.1:{14540 + INSTANCE}",
        [*px4_command(binary, folder), "-i", str(INSTANCE)],
        SIH_ENVIRONMENT | {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in sih.items()}, declared, holds,
        "centre of mass; thrust by the square of the command (linear, matched at hover)",
    )  # fmt: skip


def in_arducopter(binary: Path, model: Mapping[str, Any], folder: Path) -> There:
    """ArduCopter's multicopter simulator. The flight is led on board, on the vehicle's own clock."""
    frame = folder / "vehicle.json"
    frame.write_text(api.export(model, "ardupilot-sitl"), encoding="utf-8")
    vehicle = identified_from_document(model).vehicle
    named = {name: value for name, value in vehicle.parameters().items() if name in MASS_AND_TENSOR}
    holds = named | dict.fromkeys(PRODUCTS, 0.0) | dict.fromkeys(BESIDE, 0.0)
    volts = f"SIM_BATT_VOLTAGE {vehicle.battery.full_v:g}\nSCR_ENABLE 1\n"
    link = f"tcp://127.0.0.1:{5760 + 10 * INSTANCE}"
    command = [*arducopter_command(binary, folder, volts, model=f"quad:{frame.name}"), "--home", HOME, f"-I{INSTANCE}"]
    return There(
        "ArduCopter 4.7.0-dev, SITL", link, command, {}, dict(model["vehicle"]), holds,
        "products of inertia; lag; reaction torque in proportion to thrust (slope matched at hover); gyroscopic torque",
        noiseless=True,
    )  # fmt: skip


def with_little_yaw(binary: Path, model: Mapping[str, Any], folder: Path) -> There:
    """The same by a plan that hardly yaws: without a rate about z there is no gyroscopic torque to miss."""
    there = in_arducopter(binary, model, folder)
    limits = there.declared["limits"] | {"yaw_rate_max_rad_s": 0.1, "yaw_max_rad": 0.2}
    return replace(there, declared=there.declared | {"limits": limits}, flown="40 s, at most 0.1 rad/s of yaw")


def gyroscopic(flight: FlightData, held: Mapping[str, float]) -> list[tuple[float, float]]:
    """Share of Euler's gyroscopic torque that flew, about x and y, with its standard deviation: 1 is all of it, 0 none.

    Least squares of the rotors' torque on angular acceleration, the product of the other two rates, rate and a
    constant, below 3 Hz: tau_x = Ixx dw_x + c w_y w_z + d w_x + b, where a rigid body has c = Izz - Iyy. A record of
    T seconds below 3 Hz has 6 T samples of its own.
    """
    assert flight.imu is not None and flight.setpoint is not None
    t_s = np.arange(flight.setpoint.t_s[0] + 1.0, flight.setpoint.t_s[-1] - 1.0, GRID_S)
    rate = resampled(t_s + FILTER_S, flight.imu.t_s, flight.imu.values)[:, :3]
    thrust = flight.vehicle.thrust(resampled(t_s, flight.motors.t_s, flight.motors.values))
    torque = thrust @ flight.vehicle.allocation().T[:, 1:]
    low = np.asarray(butter(3, 2.0 * 3.0 * GRID_S, output="sos"))
    shares = []
    moments = [held[f"i{axis}{axis}_kg_m2"] for axis in "xyz"]
    for axis, first, second in ((0, 1, 2), (1, 2, 0)):
        columns = [np.gradient(rate[:, axis], t_s), rate[:, first] * rate[:, second], rate[:, axis]]
        design = np.column_stack([sosfiltfilt(low, np.array(columns)).T, np.ones(len(t_s))])
        wanted = sosfiltfilt(low, torque[:, axis])
        found = np.linalg.lstsq(design, wanted, rcond=None)[0]
        spread = np.std(wanted - design @ found) * np.sqrt(np.linalg.inv(design.T @ design)[1, 1] / (6.0 * GRID_S))
        whole = moments[second] - moments[first]
        shares.append((float(found[1] / whole), float(spread / abs(whole))))
    return shares


def patient_station(folder: Path) -> Path:
    """The shipped station, whose guard waits for a simulation that a busy machine stops for seconds."""
    document = tomllib.loads(find_config("stations", "default").read_text(encoding="utf-8"))
    for name in ("state_age", "link_age", "setpoint_age", "core_silent"):
        document["guard"][name]["limit"] = PATIENCE_S
    document["guard"]["tracking"]["limit"] = 2.5
    path = folder / "station.toml"
    path.write_text(tomli_w.dumps(document), encoding="utf-8")
    return path


def flown(there: There, vehicle: Path, folder: Path) -> Path:
    """What ``groundstation fly`` left of a whole flight, once the firmware is ready to fly it."""
    command = [sys.executable, "-P", "-m", "groundstation.cli", "fly", "--link", there.link, "--vehicle", str(vehicle)]
    command += ["--yes-simulated", "--set-parameters", "--logs", str(folder / "flights"), "--json"]
    command += ["--station", str(patient_station(folder))]
    end = time.monotonic() + READY_S
    while True:
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode != NOT_READY or time.monotonic() > end:
            break
        print(ended.stderr.strip().splitlines()[-1], flush=True)
    if ended.returncode:
        raise SystemExit(f"{there.reader}: fly ended with {ended.returncode}:\n{ended.stdout}\n{ended.stderr[-3000:]}")
    return max((folder / "flights").glob("*/identification.json"), key=lambda path: path.stat().st_mtime)


def compared(there: There, document: Mapping[str, Any]) -> dict[str, Any]:
    """Each number the file holds, and again; judged by the seven."""
    found = estimate_in(document)[1]
    rows = {
        name: {
            "exported": held,
            "again": found[name]["value"],
            "std": found[name]["std"],
            "z": (found[name]["value"] - held) / found[name]["std"],
        }
        for name, held in there.holds.items()
        if name in found
    }
    worst = max(abs(rows[name]["z"]) for name in MASS_AND_TENSOR if name in rows)
    told = {"version": there.reader, "flown": there.flown, "lacks": there.lacks, "parameters": rows}
    return told | {"worst_z": worst, "agrees": worst < CERTAIN}


def round_trip(there: There, folder: Path) -> dict[str, Any]:
    """Fly there and identify; the comparison."""
    vehicle = folder / "declared.toml"
    vehicle.write_text(tomli_w.dumps(vehicle_to_dict(vehicle_from_dict(there.declared))), encoding="utf-8")
    with process(there.command, folder, **there.environment):
        found = flown(there, vehicle, folder)
    told = compared(there, json.loads(found.read_text(encoding="utf-8")))
    if not there.noiseless:
        return told
    return told | {"gyroscopic": gyroscopic(api.load_flight(found.with_name("flight.mcap")), there.holds)}


def first_model(seed: int) -> dict[str, Any]:
    """Of a flight of our simulator, with what the diagnosis found."""
    flight = api.simulate("x500", scenario="hall", seed=seed)
    return api.model_document(api.identify(flight, predictive=False), flight.vehicle, api.diagnose(flight))


READERS: dict[str, tuple[str, Callable[[Path, Mapping[str, Any], Path], There]]] = {
    "px4": ("px4", in_px4),
    "arducopter": ("arducopter", in_arducopter),
    "arducopter, little yaw": ("arducopter", with_little_yaw),
}
"""Firmware, and how the export gets into it."""


def main() -> int:
    """Each firmware that is given; prints a table and keeps it as JSON."""
    parser = argparse.ArgumentParser(prog="benchmarks.round_trip_firmware", description=__doc__)
    parser.add_argument("--px4", type=Path, help="binary of PX4 (px4_sitl_default)")
    parser.add_argument("--arducopter", type=Path, help="binary of ArduCopter (sitl)")
    parser.add_argument("--model", type=Path, help="start from this identification.toml")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", choices=READERS, help="this one (repeatable)")
    parser.add_argument("--keep", type=Path, help="folder in which flights are kept")
    options = parser.parse_args()
    model = read_model(options.model) if options.model else first_model(options.seed)
    results = json.loads(RESULTS.read_text(encoding="utf-8"))
    for name, (firmware, make) in READERS.items():
        binary = getattr(options, firmware)
        if binary is None or name not in (options.only or READERS):
            continue
        folder = (options.keep or Path(tempfile.mkdtemp())) / name.replace(", ", "-").replace(" ", "-")
        folder.mkdir(parents=True, exist_ok=True)
        results["readers"][name] = told = round_trip(make(binary.resolve(), model, folder), folder)
        print(f"\n{told['version']}: worst |z| {told['worst_z']:.2f}, {'agrees' if told['agrees'] else 'DIFFERS'}")
        for parameter, row in told["parameters"].items():
            print(
                f"  {parameter:<18} held {row['exported']:.6g}  again {row['again']:.6g} ± {1.96 * row['std']:.2g}  "
                f"z {row['z']:+.2f}"
            )
        shares = ", ".join(f"{share:.2f} +- {std:.2f}" for share, std in told.get("gyroscopic", ()))
        print(f"  share of the gyroscopic torque about x and y: {shares or 'not seen through this noise'}")
        RESULTS.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return 0 if all(each["agrees"] for each in results["readers"].values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
