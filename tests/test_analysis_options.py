"""What a user leaves out is left out of every step, and what cannot be honoured is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.analysis.analyse import analyse
from groundstation.diagnosis import diagnose
from groundstation.errors import BadInput
from groundstation.identification.pipeline import identify
from groundstation.options import AnalysisOptions
from studies.golden import simulated


def test_a_stretch_left_out_reaches_the_fit_the_diagnosis_and_the_report(tmp_path: Path) -> None:
    flight = simulated(20, 2.0)
    assert flight.window_s is not None
    first = flight.window_s[0] + 6.0
    left_out = (first, first + 4.0)
    found = analyse([flight], tmp_path, AnalysisOptions(exclude=(left_out,)))
    assert found.identification.excluded_s == (left_out,)
    judged = np.asarray(found.diagnosis.residual["t_s"])
    assert len(judged) > 100
    assert not np.any((judged > left_out[0] + 0.1) & (judged < left_out[1] - 0.1)), (
        "the diagnosis saw what was left out"
    )
    assert f"--exclude {left_out[0]:g}:{left_out[1]:g}" in found.files["report"].read_text()


def test_what_identify_cannot_honour_is_refused_with_the_options_name() -> None:
    flight = simulated(20, 1.0)
    with pytest.raises(BadInput, match="identify cannot use --reference"):
        identify([flight], AnalysisOptions(references=(flight,)))


@pytest.mark.parametrize("step", [identify, diagnose])
def test_a_stretch_outside_the_flight_is_refused(step) -> None:
    with pytest.raises(BadInput, match="nothing to leave out from 9000 to 9001 s: stamps run from"):
        step([simulated(20, 1.0)], AnalysisOptions(exclude=((9000.0, 9001.0),)))
