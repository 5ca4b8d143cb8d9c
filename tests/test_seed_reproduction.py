"""The reproduction: the paper's numbers as printed, the flights as the paper flew them, and what the comparison
finds.
"""

import subprocess
import sys

import numpy as np
import pytest

from groundstation.identification.results import MASS_AND_TENSOR, OUTPUTS, Validation
from groundstation.identification.validation import improvement_percent
from groundstation.reproduction import trajectory_facts
from groundstation.reproduction.flights import TRUTHS, circle_plan
from groundstation.reproduction.ours import run
from groundstation.reproduction.published import CIRCLES, OUTPUT_TABLES, TABLE_3, TABLE_4
from groundstation.reproduction.text import all_tables, table_3


def test_published_improvements_follow_from_the_published_errors():
    """Guards the transcription: P_imp of Tables 4, 5 and 12 as printed, recomputed."""
    four = improvement_percent(Validation("closed_loop", TABLE_4, 0))
    assert four["LS"]["x_m"] == pytest.approx(4.84, abs=0.02)
    assert four["GD"]["yaw_deg"] == pytest.approx(-22.25, abs=0.02)
    assert four["FMGD"]["torque_z_nm"] == pytest.approx(2.86, abs=0.02)
    five, twelve = OUTPUT_TABLES[0], OUTPUT_TABLES[-1]
    assert five.number == 5
    assert twelve.number == 12
    assert improvement_percent(Validation("output", five.rms, 0))["LS"]["force_z_n"] == pytest.approx(10.85, abs=0.02)
    assert improvement_percent(Validation("output", twelve.rms, 0))["FMGD"]["torque_y_nm"] == pytest.approx(
        11.67, abs=0.05
    )


def test_published_sets_belong_to_no_rigid_body():
    """Paper-notes: Izz exceeds Ixx + Iyy by a factor of 3.0 to 3.5 in all four."""
    for values in TABLE_3.values():
        assert 2.9 < values["izz_kg_m2"] / (values["ixx_kg_m2"] + values["iyy_kg_m2"]) < 3.6


def test_circle_is_that_of_the_paper():
    radius, altitude = CIRCLES["circle 2"]
    series = circle_plan(radius, altitude).series()
    t = np.linspace(5.0, 40.0, 300)
    flat = series.sample(t)
    w = 2 * np.pi / 5
    expected = np.column_stack([radius * np.cos(w * t), radius * np.sin(w * t), altitude + 0.1 * np.sin(w * t)])
    np.testing.assert_allclose(flat.position[0], expected, atol=1e-12)
    np.testing.assert_allclose(flat.yaw[0], np.deg2rad(15) * np.sin(w * t), atol=1e-12)
    assert series.duration_s == pytest.approx(50.0)


def test_published_trajectory_exceeds_its_own_limits():
    facts = trajectory_facts()
    assert facts["roll_deg"] == pytest.approx(6.22, abs=0.01)
    assert facts["pitch_deg"] == pytest.approx(6.07, abs=0.01)
    assert facts["yaw_rate_rad_s"] == pytest.approx(0.5014, abs=1e-4)


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    return run(TRUTHS[0], tmp_path_factory.mktemp("reproduction"), lambda share, text: None, circles=False)


def test_reproduced_flight_finds_the_true_vehicle_and_the_filter_pairs_gap(ours):
    truth = ours.parameters["truth"]
    for name in MASS_AND_TENSOR:
        assert abs(ours.parameters["LS"][name] - truth[name]) < 4.0 * ours.std["LS"][name], name
    for name in ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        assert ours.parameters["LS"][name] / ours.parameters["FMLS"][name] == pytest.approx(1.030, abs=0.005)
        paper = TABLE_3["LS"][name] / TABLE_3["FMLS"][name]
        assert ours.parameters["LS"][name] / ours.slow_fmls[name] == pytest.approx(paper, rel=0.05)


def test_mass_improves_thrust_in_both_validations(ours):
    assert set(ours.outputs) == {5, 6}
    for columns, best in ((ours.outputs[5], "LS"), (ours.outputs[6], "FMLS"), (ours.closed_loop, "LS")):
        assert columns[best]["force_z_n"] < 0.5 * columns["nominal"]["force_z_n"]
    assert set(ours.outputs[5]["LS"]) == set(OUTPUTS)


def test_text_has_every_number_and_says_why(ours):
    text = table_3([ours])
    for values in TABLE_3.values():
        for value in values.values():
            assert f"{value:.5f}" in text
    assert "no rigid body has" in text
    complete = type(ours)(
        **{name: getattr(ours, name) for name in ours.__slots__ if name != "outputs"},
        outputs={table.number: ours.outputs[5 if table.methods[0] == "LS" else 6] for table in OUTPUT_TABLES},
    )
    whole = all_tables([complete], trajectory_facts())
    assert whole.count("Where they differ") == 10
    assert "nan" not in whole


def test_batch_refuses_a_folder_that_holds_something(tmp_path):
    (tmp_path / "mine.txt").write_text("keep me")
    command = [sys.executable, "-P", "-m", "sim.batch", "--plan", "paper_table2", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "not empty" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "mine.txt").read_text() == "keep me"
