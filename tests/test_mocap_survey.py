"""Looking at an installation: what is wrong with a body is named, what answers is found, what keeps the clock is
read.
"""

# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportArgumentType=false
# pyright: reportGeneralTypeIssues=false, reportOptionalOperand=false
from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from drivers.mocap.discovery import Found
from drivers.mocap.health import Summary, clock_text, reported_clock
from drivers.mocap.serverclock import ServerTime
from groundstation.flight.host_clock import chrony, ptp, timesyncd
from groundstation.flight.mocap_judging import Track, faults, flips, upright
from groundstation.flight.mocap_survey import survey
from sim.mocap.scene import Figure, Seen
from sim.mocap.server import Server, Setup

GOOD = Summary(120.0, 0.005, 0.008, 1e-5, 0, 0.0, 0.01, 0.0005)


def track(name: str = "drone", offset: float = 0.0, seconds: float = 3.0) -> Track:
    """The figure, as 120 Hz cameras see it."""
    t = np.arange(0.0, seconds, 1.0 / 120.0)
    poses = [Figure().at(x + offset)[0].pose for x in t]
    return Track(name, t, np.array([p for p, _ in poses]), np.array([q for _, q in poses]))


def test_a_body_that_is_well_tracked_has_no_fault():
    assert faults(track(), GOOD) == []
    assert len(flips(track())) == 0


def test_symmetric_markers_are_named_by_their_flips():
    body = track()
    w, x, y, z = body.quaternion[100:150].T
    body.quaternion[100:150] = np.stack([-z, y, -x, w], axis=-1)
    (fault,) = faults(body, GOOD)
    assert fault == "'drone' flips (2 times): its markers are symmetric; move one"


def test_two_bodies_that_change_names_are_named():
    first, second = track("drone"), track("rover", offset=2.5)
    for each in (first, second):
        each.position[200:], each.quaternion[200:] = each.position[200:].copy(), each.quaternion[200:].copy()
    first.position[200:], second.position[200:] = second.position[200:].copy(), first.position[200:].copy()
    assert "'drone' is swapped with 'rover': make their markers differ" in faults(first, GOOD, [second])


@pytest.mark.parametrize(
    ("up", "words"),
    [
        ((0.0, 0.0, 1.0), ""),
        ((0.05, 0.0, 0.99875), "2.9 degrees off"),
        ((0.0, 1.0, 0.0), 'up = "y"'),
        ((1.0, 0.0, 0.0), "ground plane"),
    ],
    ids=["z up", "tilted", "y up", "x up"],
)
def test_the_axis_that_points_up_is_told_with_what_to_do(up, words):
    assert words in upright(np.array(up))
    assert bool(upright(np.array(up))) == bool(words)


def test_lost_slow_and_late_bodies_are_named():
    told = faults(track(), Summary(20.0, 0.02, 0.08, 1e-5, 3, 0.2, 0.5, float("nan")))
    assert [word in sentence for word, sentence in zip(("20 Hz", "lost in 20 %", "80 ms late"), told, strict=True)] == [
        True
    ] * 3


class Symmetric(Figure):
    """Its vehicle flips by half a turn, about ten times a second."""

    def at(self, time_s: float) -> list[Seen]:
        drone, *rest = super().at(time_s)
        (place, (w, x, y, z)) = drone.pose
        turned = (-z, y, -x, w) if int(10.0 * time_s) % 2 else (w, x, y, z)
        return [Seen("drone", 1, (place, turned)), *rest]


def test_a_survey_finds_bodies_rates_clock_and_the_one_that_flips():
    with Server(Setup("vicon"), Symmetric()) as server:
        found = survey(Found("vicon", server.host), 1.0, "drone")
    assert set(found.bodies) == {"drone", "wand"}
    assert found.bodies["wand"].rate_hz == pytest.approx(100.0, rel=0.1)
    assert found.clock_error_s < 0.01
    assert any("flips" in fault for fault in found.faults)
    assert not any("wand" in fault and "flips" in fault for fault in found.faults)
    json.dumps(found.document(), allow_nan=False)


def test_a_survey_names_a_body_that_is_not_there_and_a_world_on_its_side():
    with Server(Setup("vicon", y_up=True)) as server:
        found = survey(Found("vicon", server.host), 0.5, "dron")
    assert any("no body 'dron'; there are drone, wand" in fault for fault in found.faults)
    assert any('up = "y"' in fault for fault in found.faults)


def test_nothing_on_the_network_is_no_failure(tmp_path):
    run = [sys.executable, "-P", "-m", "groundstation.cli", "doctor", "--mocap", "--seconds", "1"]
    done = subprocess.run(run, capture_output=True, text=True, timeout=120, cwd=tmp_path, env=os.environ)
    assert done.returncode == 0, done.stderr
    assert "what each needs" in done.stdout.lower() or " Hz" in done.stdout


def test_what_a_driver_tells_of_its_clock_is_read_back():
    text = clock_text(ServerTime(12.5, 3.0, 2.5e-5, 1e-4, "two-way", 1), 3e-4, GOOD)
    told = reported_clock(text)
    assert (told.error_s, told.method, told.steps) == (pytest.approx(3e-4), "two-way", 1)
    assert told.drift == pytest.approx(2.5e-5)
    assert reported_clock("mocap: anything else") is None


def test_chrony_ptp_and_timesyncd_are_read_and_anything_else_is_nothing():
    line = "A9FEA97B,ntp1.lab,2,1614171205.0,-0.000020,0.00001,0.00002,-2.5,0.001,0.05,0.000400,0.000100,64.2,Normal"
    assert chrony(line) == "chrony follows ntp1.lab: off by -20 us, within 300 us"
    assert "grandmaster: off by -1.2 us" in ptp("\tmaster_offset  -1234\n\tgmPresent true\n")
    assert "without a grandmaster" in ptp("master_offset 0\ngmPresent false")
    assert timesyncd("NTPSynchronized=yes\n")
    assert [read("\xff,garbage") for read in (chrony, ptp, timesyncd)] == ["", "", ""]
