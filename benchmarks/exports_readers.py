"""Each export in its own reader, where that is installed: what it reads against what was exported. `python -m
benchmarks.exports_readers`

Readers that are no dependency of the project (crazyflow, cflib) go into an environment of their own; the results of the
others stay.
"""

from __future__ import annotations

import importlib
import json
import tempfile
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.reporting.exports import export, mat_file
from tests.exported import MASS, OFFSET, TENSOR, document, x_frame

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results" / "exports_readers.json"
RPM = 30.0 / np.pi


def _far(read: Any, exported: Any) -> float:
    """Largest difference as a share of the largest number."""
    a, b = np.asarray(read, dtype=float), np.asarray(exported, dtype=float)
    return float(np.max(np.abs(a - b)) / np.max(np.abs(b)))


def scipy_mat(folder: Path) -> dict[str, float]:
    """MATLAB's file by scipy.io."""
    from scipy.io import loadmat

    path = folder / "vehicle.mat"
    path.write_bytes(mat_file(document()))
    found = loadmat(path, simplify_cells=True)["vehicle"]
    return {"mass": _far(found["mass_kg"], MASS), "tensor": _far(found["inertia_kg_m2"], TENSOR)}


def mujoco_mjcf(folder: Path) -> dict[str, float]:
    """MJCF by MuJoCo."""
    mujoco: Any = importlib.import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(export(document(), "mjcf"))
    body = model.body("base").id
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return {
        "mass": _far(model.body_mass[body], MASS),
        "centre": _far(model.body_ipos[body], OFFSET),
        "tensor": _far(tensor, TENSOR),
    }


def pybullet_urdf(folder: Path) -> dict[str, float]:
    """URDF by Bullet."""
    bullet: Any = importlib.import_module("pybullet")
    path = folder / "vehicle.urdf"
    path.write_text(export(document(), "pybullet"), encoding="utf-8")
    client = bullet.connect(bullet.DIRECT)
    body = bullet.loadURDF(str(path), flags=bullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client)
    info = bullet.getDynamicsInfo(body, -1, physicsClientId=client)
    axes = np.array(bullet.getMatrixFromQuaternion(info[4])).reshape(3, 3)
    bullet.disconnect(client)
    tensor = axes @ np.diag(info[2]) @ axes.T
    return {"mass": _far(info[0], MASS), "centre": _far(info[3], OFFSET), "tensor": _far(tensor, TENSOR)}


def crazyflow_toml(folder: Path) -> dict[str, float]:
    """Acceleration of a body at rest whose first rotor alone turns, by crazyflow's own equations, against Newton and
    Euler.
    """
    import tomllib

    dynamics: Any = importlib.import_module("crazyflow.dynamics.first_principles.dynamics").dynamics
    (told,) = tomllib.loads(export(document(), "crazyflow")).values()
    names = (
        "mass",
        "L",
        "prop_inertia",
        "J",
        "rpm2thrust",
        "rpm2torque",
        "mixing_matrix",
        "drag_matrix",
        "rotor_dyn_coef",
    )
    numbers = {name: np.asarray(told[name], dtype=float) for name in names}
    speeds = np.array([400.0, 0.0, 0.0, 0.0])
    still = np.zeros(3)
    _, _, force, turning, _ = dynamics(
        still, np.array([0.0, 0.0, 0.0, 1.0]), still, still, speeds * RPM, speeds * RPM,
        gravity_vec=np.array([0.0, 0.0, -9.81]), J_inv=np.linalg.inv(numbers["J"]), **numbers,
    )  # fmt: skip
    vehicle = x_frame()
    thrust = float(vehicle.thrust(400.0))
    arm = float(told["L"])
    torque = np.array([-arm, -arm, -vehicle.rotors.spin[0] * vehicle.rotors.torque_to_thrust_m]) * thrust
    return {
        "acceleration": _far(force, [0.0, 0.0, thrust / MASS - 9.81]),
        "angular acceleration": _far(turning, np.linalg.solve(TENSOR, torque)),
    }


def cflib_yaml(folder: Path) -> dict[str, float]:
    """Stored parameters by cflib's reader."""
    manager: Any = importlib.import_module("cflib.localization").ParamFileManager
    path = folder / "parameters.yaml"
    path.write_text(export(document(), "crazyflie"), encoding="utf-8")
    found = manager.read(str(path))
    moments = [found[f"ctrlLee.J_{axis}"].stored_value for axis in "xyz"]
    return {"mass": _far(found["ctrlLee.mass"].stored_value, MASS), "moments": _far(moments, np.diag(TENSOR))}


READERS: dict[str, tuple[str, Callable[[Path], dict[str, float]]]] = {
    "matlab (.mat)": ("scipy", scipy_mat),
    "mjcf": ("mujoco", mujoco_mjcf),
    "pybullet": ("pybullet", pybullet_urdf),
    "crazyflow": ("crazyflow", crazyflow_toml),
    "crazyflie": ("cflib", cflib_yaml),
}


def main() -> None:
    """Each reader that is here; prints a line for each, and keeps them as JSON."""
    kept = json.loads(RESULTS.read_text(encoding="utf-8"))["formats"] if RESULTS.is_file() else {}
    for name, (package, read) in READERS.items():
        try:
            installed = version(package)
        except PackageNotFoundError:
            print(f"{name}: {package} is not installed")
            continue
        with tempfile.TemporaryDirectory() as folder:
            differs = read(Path(folder))
        kept[name] = {"reader": package, "version": installed, "differs": differs}
        print(
            f"{name}: {package} {installed}: "
            + ", ".join(f"{what} differs by {far:.1e}" for what, far in differs.items())
        )
    document_ = {"schema": "groundstation.exports_readers/1", "formats": dict(sorted(kept.items()))}
    RESULTS.write_text(json.dumps(document_, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
