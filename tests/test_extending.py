"""docs/extending.md, done as it says: its code is typed into a copy of the repository, which then flies, identifies,
diagnoses, reports, exports and predicts with the new effect and the new parameter.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.timeout(900)  # numba compiles the simulator once more
ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
DENSITY_KG_M, DRIFT_M_S3 = 0.05, 0.02

STRANGER = """
import json
from dataclasses import replace

{flying}
# The page's second example, in a flight without the cable: the accelerometer's z axis drifts while it warms up.
steady = api.simulate("qball2", scenario="lab", seed=8)
values = steady.imu.values.copy()
values[:, list(steady.imu.columns).index("accel_z_m_s2")] += {drift} * (steady.imu.t_s - steady.imu.t_s[0])
warming = replace(steady, imu=replace(steady.imu, values=values))
without_drift, drifted = (api.identify(each, predictive=False) for each in (steady, warming))

identification = api.identify(flight, predictive=False)
model = api.model_document(identification, flight.vehicle, found)
without = {{**model, "effects": {{}}}}
drifted_model = api.model_document(drifted, flight.vehicle)
api.write_report("report.html", flight, identification, found)
api.write_report("drifted.html", warming, drifted)
errors = [api.predict(each, flight, use="physical").error["model"]["0.5"] for each in (model, without)]
print(json.dumps({{
    "verdict": found.verdict,
    "findings": {{f.effect: f.sentence for f in found.findings}},
    "density": [f.parameters["cable_kg_m"].ci95 for f in found.findings if f.effect == "hanging_cable"],
    "drift": [each.model["accel_drift_z_m_s3"].ci95 for each in (without_drift, drifted)],
    "rows": [row["parameter"] for row in drifted.records()],
    "model": drifted_model["model"],
    "csv": api.export(drifted_model, "csv"),
    "effects": model["effects"],
    "scenario": api.export(model, "scenario"),
    "reports": [open(name, encoding="utf-8").read() for name in ("report.html", "drifted.html")],
    "miss_m_s": [each["velocity_m_s"]["rms"] for each in errors],
}}))
"""


def blocks(kind: str) -> list[str]:
    """Blocks of code on the page."""
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE, re.M | re.S)


def insert(path: Path, before: str, text: str) -> None:
    """Put text above the only place that reads so."""
    source = path.read_text(encoding="utf-8")
    assert source.count(before) == 1, (path.name, before)
    path.write_text(source.replace(before, text + before), encoding="utf-8")


def type_in(clone: Path) -> None:
    """What the page says."""
    effect, simulated, entry = blocks("python")
    _, sensitivity = blocks("text")
    (clone / "groundstation/diagnosis/effects/hanging_cable.py").write_text(effect, encoding="utf-8")
    (clone / "sim/effects/hanging_cable.py").write_text(simulated, encoding="utf-8")
    parameters = clone / "groundstation/model/parameters.py"
    insert(parameters, "FREE: tuple[Free, ...] = (", re.sub(r"^from .*\n+", "", entry) + "\n\n")
    insert(parameters, ')\n"""Every parameter, in the order', "    _accel_drift_z(),\n")
    insert(clone / "groundstation/identification/sensitivities.py", '}\n"""Of parameters that act alike', sensitivity)


@pytest.fixture(scope="module")
def clone(tmp_path_factory) -> Path:
    """The packages with the page's code in them; what numba compiled before is copied along."""
    folder = tmp_path_factory.mktemp("clone")
    for name in ("groundstation", "drivers", "sim", "configs"):
        shutil.copytree(ROOT / name, folder / name)
    type_in(folder)
    return folder


@pytest.fixture(scope="module")
def seen(clone) -> dict[str, Any]:
    """What the page's last block and the program's other outputs give in the copy."""
    flying = blocks("text")[0].replace("print(", "(")
    program = STRANGER.format(flying=flying, drift=DRIFT_M_S3)
    known = {"PYTHONPATH": str(clone), "NUMBA_OPT": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], cwd=clone, env=os.environ | known, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


def test_an_effect_takes_two_new_files_and_a_parameter_changes_two(clone):
    def sources(folder: Path) -> dict[str, bytes]:
        return {
            str(path.relative_to(folder)): path.read_bytes()
            for name in ("groundstation", "sim", "drivers")
            for path in (folder / name).rglob("*.py")
        }

    before, after = sources(ROOT), sources(clone)
    assert set(after) - set(before) == {
        "groundstation/diagnosis/effects/hanging_cable.py",
        "sim/effects/hanging_cable.py",
    }
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"groundstation/model/parameters.py", "groundstation/identification/sensitivities.py"}


def test_the_effect_is_found_in_a_simulated_flight_beside_the_laboratorys_clock_offset_alone(seen):
    assert seen["verdict"] == "explained" and set(seen["findings"]) == {"hanging_cable", "clock_offset"}, seen[
        "findings"
    ]
    low, high = seen["density"][0]
    assert low < DENSITY_KG_M < high and high - low < 0.5 * DENSITY_KG_M, (low, high)


def test_report_scenario_model_and_prediction_know_the_effect(seen):
    sentence = seen["findings"]["hanging_cable"]
    assert re.fullmatch(r"A cable hangs from the vehicle: each metre of height adds [\d.]+ g\.", sentence)
    assert sentence in seen["reports"][0]
    assert re.search(r"\[effects\.hanging_cable\]\ndensity_kg_m = 0\.0[45]", seen["scenario"])
    assert set(seen["effects"]["hanging_cable"]) == {"cable_kg_m"}
    with_it, without = seen["miss_m_s"]
    assert with_it < 0.9 * without, seen["miss_m_s"]


def test_the_parameter_is_estimated_and_shown_wherever_parameters_are(seen):
    (none, (low, high)), name = seen["drift"], "accel_drift_z_m_s3"
    half = 0.5 * (high - low)  # two deviations
    assert abs(0.5 * (low + high) - DRIFT_M_S3) < 2.0 * half < 0.2 * DRIFT_M_S3, (low, high)
    assert none[0] < 0.0 < none[1], none
    assert name in seen["rows"] and name in seen["model"]
    assert re.search(rf"^{name},.*,m/s³,identified$", seen["csv"], re.M)
    assert "accelerometer drift z" in seen["reports"][1]
