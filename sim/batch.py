"""Fly one plan without a core, and leave a flight bundle: ``python -P -m sim.batch --plan paper_table2 --out DIR``."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import tomli_w

from groundstation.errors import BadInput, GroundStationError
from groundstation.paths import find_config
from groundstation.trajectory import load_plan, plan_to_dict
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_to_dict
from sim.flight import SimulatedFlight, simulate
from sim.scenario import load_scenario

IMU = "gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
POSE = "x_m,y_m,z_m,qw,qx,qy,qz"
STATE = "x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,qw,qx,qy,qz,wx_rad_s,wy_rad_s,wz_rad_s"
WRENCH = "force_z_n,torque_x_nm,torque_y_nm,torque_z_nm"
SETPOINT = "x_m,y_m,z_m,yaw_rad"
BATTERY = "voltage_v,current_a"


def columns(vehicle: Vehicle) -> dict[str, str]:
    """Header of each file of a flight bundle, after the times."""
    rotors = vehicle.rotors
    unit = {"rotor_speed": "rad_s", "command": "command"}.get(rotors.input)
    motors = WRENCH if unit is None else ",".join(f"m{i}_{unit}" for i in range(1, rotors.count + 1))
    return {"imu": IMU, "mocap": POSE, "motors": motors, "battery": BATTERY, "setpoint": SETPOINT, "state": STATE}


def empty_folder(folder: Path) -> None:
    """Make a folder, or take one that is empty.

    Raises:
        BadInput: it holds something already, or cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        taken = any(folder.iterdir())
    except OSError as error:
        raise BadInput(f"{folder}: cannot be made ({error.strerror}); give another --out.") from None
    if taken:
        raise BadInput(f"{folder} is not empty; give another --out.")


def write(flight: SimulatedFlight, folder: Path) -> None:
    """Write a simulated flight as a bundle into an empty folder, with plan and true vehicle beside it.

    Raises:
        BadInput: it cannot be written.
    """
    try:
        headers = columns(flight.vehicle)
        for name, (stamps, arrivals, values) in flight.streams.items():
            table = np.column_stack([stamps, arrivals, values])
            header = f"t_s,received_s,{headers[name]}"
            np.savetxt(folder / f"{name}.csv", table, fmt="%.12g", delimiter=",", header=header, comments="")
        documents = {
            "vehicle": vehicle_to_dict(flight.vehicle),
            "truth": vehicle_to_dict(flight.truth),
            "plan": plan_to_dict(flight.plan),
        }
        for name, document in documents.items():
            (folder / f"{name}.toml").write_text(tomli_w.dumps(document), encoding="utf-8")
        about = {
            "schema": "groundstation.bundle/1",
            "name": folder.name,
            "window_s": list(flight.window_s),
            "metadata": {"scenario": flight.scenario},
        }
        (folder / "flight.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written ({error.strerror}); give another --out.") from None


def main(argv: list[str] | None = None) -> int:
    """Fly and write; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -P -m sim.batch", description="One simulated flight as a bundle.")
    parser.add_argument("--vehicle", default="qball2", help="vehicle file, or the name of a shipped one")
    parser.add_argument("--plan", required=True, help="plan file, or the name of a shipped one")
    parser.add_argument("--scenario", default="seed", help="scenario file, or the name of a shipped one")
    parser.add_argument("--seed", type=int, default=1, help="of all noise; same seed, same flight")
    parser.add_argument("--out", required=True, type=Path, help="folder of the bundle")
    options = parser.parse_args(argv)
    try:
        vehicle = load_vehicle(find_config("vehicles", options.vehicle))
        plan = load_plan(find_config("plans", options.plan))
        scenario = load_scenario(find_config("scenarios", options.scenario))
        empty_folder(options.out)
        write(simulate(vehicle, plan, scenario, options.seed), options.out)
    except GroundStationError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
