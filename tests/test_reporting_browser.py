"""The report in a real browser: every figure is drawn, nothing fails, nothing is asked of the network."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from groundstation.reporting import write_report
from tests import reporting_fixture as fixture
from tests.test_reporting_report import HOSTILE

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed (Debian's package is chromium)")

FLAGS = (
    *(
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
    ),
    *(
        "--disable-component-update",
        "--disable-sync",
        "--disable-features=NetworkTimeServiceQuerying",
        "--enable-unsafe-swiftshader",
        "--window-size=1280,16000",
    ),
    *("--virtual-time-budget=20000", "--enable-logging=stderr", "--dump-dom"),
)


def opened(report: Path, profile: Path) -> tuple[str, list[str], list[str]]:
    """The page as it stands after scripts ran, console messages above a warning, and addresses asked for."""
    net_log = profile / "net.json"
    command = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", f"--log-net-log={net_log}", report.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line and "willReadFrequently" not in line]
    failed = [line for line in console if "GL Driver Message" not in line]
    requests = re.findall(r'"url":"(https?://[^"]*)"', net_log.read_text(encoding="utf-8"))
    return done.stdout, failed, requests


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> tuple[str, list[str], list[str]]:
    folder = tmp_path_factory.mktemp("report")
    report = write_report(folder / "report.html", fixture.flight(), fixture.identification(), fixture.diagnosis())
    return opened(report, folder)


def test_every_figure_is_drawn(page):
    dom, _, _ = page
    drawn, all_of_them = re.search(r'data-drawn="(\d+)/(\d+)"', dom).groups()
    assert drawn == all_of_them and int(drawn) > 20
    assert dom.count('class="plot js-plotly-plot"') == int(drawn)
    assert "could not be drawn" not in dom


def test_nothing_fails_and_nothing_is_fetched(page):
    _, console, requests = page
    assert console == []
    assert requests == []


def test_colours_are_resolved_from_the_style_sheet(page):
    dom, _, _ = page
    lines = re.findall(r'class="js-line"[^>]*stroke: ([^;"]+)', dom)
    assert len(lines) > 40
    assert all(colour.startswith("rgb(") for colour in lines)
    assert len(set(lines)) >= 4


def test_hostile_names_run_nothing(tmp_path):
    report = write_report(tmp_path / "report.html", *fixture.hostile(HOSTILE))
    dom, console, requests = opened(report, tmp_path)
    assert 'data-taken="1"' not in dom
    assert "<title>taken</title>" not in dom
    assert console == [] and requests == []
    drawn, all_of_them = re.search(r'data-drawn="(\d+)/(\d+)"', dom).groups()
    assert drawn == all_of_them
