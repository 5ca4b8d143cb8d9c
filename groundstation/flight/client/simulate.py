"""One simulated flight without a core: the simulator flies a plan in a process of its own and leaves a bundle."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from groundstation.errors import BadInput
from groundstation.flight.children import module_command
from groundstation.flightdata import FlightData
from groundstation.json_types import Document
from groundstation.paths import find_config
from groundstation.recording import load_flight
from groundstation.trajectory import Plan, plan_to_dict
from groundstation.vehicle import Vehicle, vehicle_to_dict


def simulate(vehicle: Vehicle, plan: Plan, scenario: Document | str | Path, seed: int, folder: Path) -> FlightData:
    """Fly a plan and load what was recorded.

    Args:
        vehicle: as declared.
        plan: what to fly.
        scenario: its document, its file, or a shipped name.
        seed: of all noise.
        folder: empty or new; keeps the bundle.

    Raises:
        BadInput: the simulator refused or failed; its last words say why.
    """
    with tempfile.TemporaryDirectory(prefix="groundstation-") as place:
        documents: dict[str, Mapping[str, Any]] = {"vehicle": vehicle_to_dict(vehicle), "plan": plan_to_dict(plan)}
        if isinstance(scenario, Mapping):
            documents["scenario"] = scenario
        options = ["--seed", str(seed), "--out", str(folder.resolve())]
        for name, document in documents.items():
            path = Path(place) / f"{name}.toml"
            path.write_text(tomli_w.dumps(dict(document)), encoding="utf-8")
            options += [f"--{name}", str(path)]
        if not isinstance(scenario, Mapping):
            options += ["--scenario", str(find_config("scenarios", scenario).resolve())]
        command = module_command("sim.batch", *options)
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=place)
    if done.returncode != 0:
        words = done.stderr.strip().splitlines()
        said = words[-1].removeprefix("error: ") if words else f"exit status {done.returncode}"
        raise BadInput(f"the simulated flight failed: {said}")
    return load_flight(folder)
