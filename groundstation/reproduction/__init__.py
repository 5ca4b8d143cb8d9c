"""``groundstation reproduce``: the paper's flights on the simulated QBall 2, and its tables beside ours."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.json_types import JsonObject

Progress = Callable[[float, str], None]


def _say(share: float, text: str) -> None:
    print(f"{100 * share:3.0f} %  {text}", file=sys.stderr, flush=True)


def reproduce(keep: Path | None = None, progress: Progress = _say) -> tuple[JsonObject, str]:
    """Fly, identify, validate and compare.

    Args:
        keep: folder that the flights are left in, one bundle each; None: they are thrown away.
        progress: told the share done and what is being done.

    Returns:
        The JSON document and the text.

    Raises:
        BadInput: ``keep`` holds something already, or a simulated flight failed.
    """
    from groundstation.reproduction.flights import TRUTHS
    from groundstation.reproduction.ours import run
    from groundstation.reproduction.published import OUTPUT_TABLES, TABLE_3, TABLE_4
    from groundstation.reproduction.text import all_tables

    folder = Path(tempfile.mkdtemp(prefix="groundstation-")) if keep is None else keep
    try:
        runs = []
        shares = ((0.0, 0.6), (0.6, 0.8), (0.8, 1.0))
        for index, (truth, (first, last)) in enumerate(zip(TRUTHS, shares, strict=True)):

            def scaled(share: float, text: str, first: float = first, last: float = last) -> None:
                progress(first + share * (last - first), text)

            runs.append(run(truth, folder / f"vehicle-{index + 1}", scaled, circles=index == 0))
    finally:
        if keep is None:
            shutil.rmtree(folder, ignore_errors=True)
    facts = trajectory_facts()
    tables: dict[str, Any] = {
        "2": {"here": facts},
        "3": {"paper": TABLE_3, "here": {r.truth.name: r.parameters for r in runs}},
        "4": {"paper": TABLE_4, "here": runs[0].closed_loop},
    }
    tables |= {str(t.number): {"paper": t.rms, "here": runs[0].outputs[t.number]} for t in OUTPUT_TABLES}
    document = {"schema": "groundstation.reproduction/1", "low_pass_hz": runs[0].cutoff_hz, "tables": tables}
    return document, all_tables(runs, facts)


def trajectory_facts() -> dict[str, float]:
    """cond(W), largest tilt and yaw rate of the published trajectory over one period at 2 ms."""
    from groundstation.identification.regressors import standard_regressor
    from groundstation.reproduction.flights import identification_plan
    from groundstation.trajectory import rigid_motion

    series = identification_plan().series()
    motion = rigid_motion(series.sample(np.arange(0.0, series.period_s, 0.002)))
    w = standard_regressor(
        motion.specific_thrust_m_s2, motion.angular_velocity_body_rad_s, motion.angular_acceleration_body_rad_s2
    )
    tilt = np.rad2deg(np.abs(motion.euler_rad).max(axis=0))
    return {
        "condition_number": float(np.linalg.cond(w.reshape(-1, 7))),
        "roll_deg": float(tilt[0]),
        "pitch_deg": float(tilt[1]),
        "yaw_rate_rad_s": float(np.abs(motion.euler_rate_rad_s[:, 2]).max()),
    }
