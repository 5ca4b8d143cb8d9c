"""docs/extending.md, done as it says: its code is typed into a copy of the repository, which then flies, identifies,
diagnoses, reports, exports and predicts with the new effect and the new parameter.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
DENSITY_KG_M, DRIFT_M_S3 = 0.05, 0.01
SEED = 7

STRANGER = """
import json, sys
from dataclasses import replace

import numpy as np

from groundstation import api

{flying}
# The page's second example: the accelerometer's z axis drifts while it warms up.
imu = flight.imu
values = imu.values.copy()
values[:, list(imu.columns).index("az_m_s2")] += {drift} * (imu.t_s - imu.t_s[0])
flight = replace(flight, imu=replace(imu, values=values))

identification = api.identify(flight, predictive=False)
model = api.model_document(identification, flight.vehicle, found)
other = {{name: values for name, values in model.items() if name != "effects"}} | {{"effects": {{}}}}
api.write_report("report.html", flight, identification, found)
errors = [api.predict(each, flight, horizon_s=0.5, use="physical").error for each in (model, other)]
print(json.dumps({{
    "verdict": found.verdict,
    "findings": [[f.effect, f.sentence, f.parameters["cable_kg_m"].ci95] for f in found.findings],
    "drift": identification.model["accel_drift_z_m_s3"].ci95,
    "rows": [row["parameter"] for row in identification.records()],
    "model": {{part: list(model[part]) for part in ("model", "effects")}},
    "csv": api.export(model, "csv"),
    "scenario": api.export(model, "scenario"),
    "report": open("report.html", encoding="utf-8").read(),
    "climb_m_s": [float(list(each.values())[0]["0.5"]["velocity_m_s"]["rms"]) if False else each for each in errors],
}}, default=float))
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
