"""Golden results: what identify, diagnose, predict and plan gave on fixed flights, to the last bit
(``benchmarks.golden``).

A move of code keeps every number. A change of behaviour changes some: freeze anew and say in the commit which and why.
Numbers are equal bit by bit where libraries and processor are those of the file; on other machines findings are, and
identified values within ``ELSEWHERE`` of their standard deviations. Sentences are not compared, only numbers, names,
verdicts and what was found.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: sums over threads come in another order

import hashlib
import json
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.diagnosis import diagnose
from groundstation.flightdata import FlightData
from groundstation.identification.pipeline import identify
from groundstation.identification.starts import flight_states
from groundstation.model.prediction import predict
from groundstation.model.vehicle_model import model_from_document
from groundstation.options import AnalysisOptions
from groundstation.paths import find_config
from groundstation.planning import plan_excitation
from groundstation.recording import load_flight
from groundstation.reporting.exports import model_document
from groundstation.trajectory import load_plan, plan_to_dict
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict
from sim.flight import simulate
from sim.scenario import load_scenario, scenario_from_dict
from studies.flown import flight_data

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "tests" / "golden" / "results.json"
DATA = ROOT.parent / "shared" / "data"
SEED = 20261129
ELSEWHERE = 0.5
"""Share of its standard deviation by which an identified value may move on another processor.

Where sums round otherwise, a fit stops at another point within its tolerance, the search for a plan ends in another
optimum, and of two explanations of a lag that suit equally well the other one may win: on 15 s of PX4's log the sizes
of findings moved by up to five standard deviations when the linear algebra's kernel was changed. So elsewhere only what
was found and what was identified has to agree; every number is compared, bit by bit, on a machine like the one that
froze them.
"""

PROSE = frozenset(
    ("sentence", "reason", "best_reason", "note", "notes", "warnings", "next_flight", "quality", "remedies", "proposal")
)
"""Keys whose text is for people; it may be reworded."""


class Missing(Exception):
    """The measured flight is not on this machine."""


def environment() -> dict[str, Any]:
    """What decides the last bits: libraries, their kernels and the processor that code is compiled for."""
    import casadi
    import llvmlite.binding as llvm
    import numba
    import scipy
    from threadpoolctl import threadpool_info

    kernels = sorted({f"{each['internal_api']} {each.get('architecture', '')}" for each in threadpool_info()})
    features = json.dumps(dict(sorted(llvm.get_host_cpu_features().items())))
    versions = {module.__name__: module.__version__ for module in (np, scipy, numba, casadi)}
    return {
        **versions,
        "kernels": [each for each in kernels if each.startswith("openblas")],
        "processor": f"{llvm.get_host_cpu_name()} {hashlib.sha256(features.encode()).hexdigest()[:12]}",
        "machine": f"{platform.system()} {platform.machine()}",
    }


def simulated(
    seed: int, periods: float, rotors: Mapping[str, Any] | None = None, **effects: dict[str, Any]
) -> FlightData:
    """A flight of the laboratory with effects planted in it."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    vehicle = vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update=dict(rotors or {}))})
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": periods})
    laboratory = load_scenario(find_config("scenarios", "lab"))
    planted = laboratory.model_copy(update={"effects": scenario_from_dict({"effects": effects}).effects})
    return flight_data(simulate(vehicle, plan, planted, SEED + seed))


def sih_vehicle() -> Vehicle:
    """PX4's built-in quadrotor with mass, inertias and reaction torque declared wrongly, and no lag."""
    rotors = {
        "position_m": [[0.2, -0.2, 0.0], [-0.2, 0.2, 0.0], [0.2, 0.2, 0.0], [-0.2, -0.2, 0.0]],
        "spin": [1, 1, -1, -1],
        "torque_to_thrust_m": 0.02,
        "input": "command",
        "speed_source": "command",
        "thrust_curve": [0.0, 5.0, 0.0],
    }
    body = {"name": "sih", "mass_kg": 1.1, "inertia_kg_m2": {"xx": 0.02, "yy": 0.02, "zz": 0.035}}
    return vehicle_from_dict({"vehicle": body, "rotors": rotors})


def recorded(path: str, vehicle: Vehicle, start_s: float | None, end_s: float | None) -> FlightData:
    """A stretch of a measured flight."""
    if not (DATA / path).exists():
        raise Missing(f"{DATA / path} is not there")
    return load_flight(DATA / path, vehicle=vehicle, start_s=start_s, end_s=end_s)


def fingerprint(flight: FlightData) -> dict[str, str]:
    """A hash of each stream: where these differ, the flight has changed and not what is said of it."""
    streams = {name: getattr(flight, name) for name in ("imu", "mocap", "motors", "battery", "setpoint", "state")}
    return {
        name: hashlib.sha256(stream.t_s.tobytes() + stream.values.tobytes()).hexdigest()[:16]
        for name, stream in streams.items()
        if stream is not None
    }


def results(flight: FlightData, unseen: FlightData, references: tuple[FlightData, ...] = ()) -> dict[str, Any]:
    """Everything that is found of one flight, and a prediction of another."""
    identification = identify([flight])
    diagnosis = diagnose([flight], AnalysisOptions(references=references))
    document = model_document(identification, flight.vehicle)
    prediction = predict(model_from_document(document, flight.vehicle), flight_states(unseen), horizon_s=0.3)
    series = {
        name: [len(values), float(np.nansum(values)), float(np.nansum(np.square(values)))]
        for name, values in diagnosis.residual.items()
    }
    return {
        "input": [fingerprint(each) for each in (flight, unseen, *references)],
        "identify": identification.to_dict(),
        "model": document,
        "diagnose": diagnosis.to_dict() | {"residual": series},
        "predict": prediction.to_dict(),
    }


def clean() -> dict[str, Any]:
    return results(simulated(0, 2.0), simulated(1, 1.0))


def weak_rotor() -> dict[str, Any]:
    planted = {"weak_rotor": {"rotor": 3, "loss": 0.06}, "com_offset": {"offset_m": (0.006, -0.004, 0.0)}}
    return results(simulated(2, 2.0, **planted), simulated(3, 1.0, **planted))


def commanded() -> dict[str, Any]:
    rotors = {"speed_source": "command"}
    planted = {"motor_lag": {"hover_s": 0.05, "propeller_share": 0.4}, "rotor_drag": {"drag_kg_s": (0.25, 0.25)}}
    return results(simulated(4, 2.0, rotors, **planted), simulated(5, 1.0, rotors, **planted))


def load_lost() -> dict[str, Any]:
    planted = {"payload_change": {"mass_kg": 0.1, "time_s": 14.0}}
    return results(simulated(6, 2.0, **planted), simulated(7, 1.0), (simulated(8, 2.0),))


def px4_sih() -> dict[str, Any]:
    return results(*(recorded("px4-sih/excitation.ulg", sih_vehicle(), *part) for part in ((30.0, 45.0), (45.0, 53.0))))


def crazyflie_log() -> dict[str, Any]:
    vehicle = load_vehicle(find_config("vehicles", "crazyflie21"))
    return results(*(recorded("crazyflie-1khz/log10", vehicle, *part) for part in ((40.0, 48.0), (50.0, 55.0))))


def plans() -> dict[str, Any]:
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    wanted: tuple[tuple[str, tuple[str, ...]], ...] = (("condition", ()), ("D", ("rotor_drag", "motor_lag")))
    return {
        criterion: plan_to_dict(
            plan_excitation(
                vehicle, criterion=criterion, harmonics=3, duration_s=10.0, seed=SEED, starts=1, effects=effects
            )
        )
        for criterion, effects in wanted
    }


def clean_four_periods() -> dict[str, Any]:
    return results(simulated(9, 4.0), simulated(10, 2.0))


def hover_thrusts() -> dict[str, Any]:
    """Poses and powers alone: what the mean thrusts say against a healthy flight."""
    vehicle = load_vehicle(find_config("vehicles", "crazyflie21"))
    folders = ("cut_propeller_M3_4mm_4mm_39mm/E8_log00", "normal_flight/E9_log00", "normal_flight/E9_log01")
    cut, *healthy = (recorded(f"crazypad/{folder}", vehicle, None, None) for folder in folders)
    return {"input": [fingerprint(each) for each in (cut, *healthy)]} | {
        "diagnose": diagnose([cut], AnalysisOptions(references=tuple(healthy))).to_dict()
    }


Case = Callable[[], dict[str, Any]]
SHORT: tuple[Case, ...] = (clean, weak_rotor, commanded, load_lost, px4_sih, crazyflie_log, plans)
LONG: tuple[Case, ...] = (clean_four_periods, hover_thrusts)


def plain(value: Any, key: str = "") -> Any:
    """The same with numpy's numbers as Python's, without what is written for people."""
    if isinstance(value, Mapping):
        pairs = (
            (str(k), v) for k, v in value.items() if k not in PROSE and not (k == "evidence" and isinstance(v, str))
        )
        return {k: plain(v, k) for k, v in pairs}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return plain(value.tolist()) if hasattr(value, "tolist") else value


def differences(was: Any, now: Any, path: str = "", *, exactly: bool = True) -> Iterator[str]:
    """Where two results differ: any number of another bit pattern; or, unless ``exactly``, identified values by
    ``ELSEWHERE``.
    """
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        if set(was) != set(now):
            yield f"{path}: gone {sorted(set(was) - set(now))}, new {sorted(set(now) - set(was))}"
        if not exactly and {"value", "std"} <= set(was) & set(now):
            if "/diagnose/" not in path and abs(was["value"] - now["value"]) > ELSEWHERE * was["std"] + 1e-9 * abs(
                was["value"]
            ):
                yield f"{path}: {was['value']!r} is {now['value']!r} now, standard deviation {was['std']!r}"
            return
        for key in sorted(set(was) & set(now)):
            yield from differences(was[key], now[key], f"{path}/{key}", exactly=exactly)
    elif isinstance(was, list) and isinstance(now, list):
        if len(was) != len(now):
            yield f"{path}: {len(was)} entries were {len(now)} now"
        for index, pair in enumerate(zip(was, now, strict=False)):
            yield from differences(*pair, f"{path}/{index}", exactly=exactly)
    elif isinstance(was, float) and isinstance(now, float):
        if exactly and repr(was) != repr(now):
            yield f"{path}: {was!r} is {now!r} now"
    elif was != now:
        yield f"{path}: {was!r} is {now!r} now"


def frozen() -> dict[str, Any]:
    """The file of golden results."""
    return json.loads(FILE.read_text())


def compare(case: Case, golden: Mapping[str, Any]) -> list[str]:
    """Where a case differs from the file: bit by bit on the file's machine, within ``ELSEWHERE`` on others.

    Raises:
        Missing: the measured flight is not on this machine.
    """
    same = environment() == golden["environment"]
    now = plain(case())
    was = golden["cases"][case.__name__]
    if same and was.get("input") != now.get("input"):
        return [
            f"{case.__name__}: the flight itself has changed (its streams' hashes differ), freeze anew if that is meant"
        ]
    if not same:
        was, now = ({key: value for key, value in each.items() if key != "input"} for each in (was, now))
    return list(differences(was, now, case.__name__, exactly=same))


def freeze() -> None:
    """Write the file anew."""
    describe = ["git", "describe", "--always", "--dirty"]
    git = subprocess.run(describe, cwd=ROOT, capture_output=True, text=True, check=True)
    cases: dict[str, Any] = {}
    for case in (*SHORT, *LONG):
        try:
            cases[case.__name__] = plain(case())
        except Missing as missing:
            sys.exit(f"{missing}; the golden results are frozen where all flights are.")
    document = {"commit": git.stdout.strip(), "environment": environment(), "seed": SEED, "cases": cases}
    FILE.write_text(json.dumps(document, indent=None, separators=(",", ":")).replace('},"', '},\n"') + "\n")
