"""The report in a real browser: every figure is drawn, nothing fails, nothing is asked of the network."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from groundstation.reporting.compare import write_comparison
from groundstation.reporting.report import write_report
from tests import browser
from tests import reporting_fixture as fixture
from tests.accessibility import ABSENT, axe_source, findings
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
    *("--disable-component-update", "--disable-sync", "--enable-unsafe-swiftshader", "--window-size=1280,16000"),
    *("--virtual-time-budget=20000", "--enable-logging=stderr", "--dump-dom"),
)
BROWSERS_OWN = re.compile(r"(^|\.)google(apis)?\.com$")
"""Chromium asks its maker for the time and for updates at every start; the report never names it."""
HINTS = ("willReadFrequently", "GL Driver Message")
"""Performance hints that Chromium gives on plotly's use of a canvas; no faults."""


def opened(report: Path, profile: Path) -> tuple[str, list[str], list[str]]:
    """The page as it stands after its scripts ran, what the console said, and the hosts that were asked for
    something.
    """
    net_log = profile / "net.json"
    command = [
        str(CHROMIUM),
        *FLAGS,
        f"--user-data-dir={profile}",
        f"--log-net-log={net_log}",
        f"{report.as_uri()}#all",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line and not any(h in line for h in HINTS)]
    hosts = re.findall(r'"url":"(?:https?|wss?)://([^"/:]*)', net_log.read_text(encoding="utf-8"))
    return done.stdout, console, [host for host in hosts if not BROWSERS_OWN.search(host)]


def drawn(dom: str) -> tuple[int, int]:
    """Figures drawn, and figures there are."""
    found = re.search(r'data-drawn="(\d+)/(\d+)"', dom)
    assert found is not None
    return int(found[1]), int(found[2])


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> tuple[str, list[str], list[str]]:
    folder = tmp_path_factory.mktemp("report")
    report = write_report(folder / "report.html", fixture.flight(), fixture.identification(), fixture.diagnosis())
    return opened(report, folder)


def test_every_figure_is_drawn(page):
    dom, _, _ = page
    count, of = drawn(dom)
    assert count == of > 20
    assert dom.count('class="plot js-plotly-plot"') == of
    assert 'class="plot absent' not in dom


def test_nothing_fails_and_nothing_is_fetched(page):
    _, console, hosts = page
    assert console == []
    assert hosts == []


def test_colours_are_resolved_from_the_style_sheet(page):
    dom, _, _ = page
    lines = re.findall(r'class="js-line"[^>]*stroke: ([^;"]+)', dom)
    assert len(lines) > 40
    assert all(colour.startswith("rgb(") for colour in lines)
    assert len(set(lines)) >= 4


def test_hostile_names_run_nothing(tmp_path):
    report = write_report(tmp_path / "report.html", *fixture.hostile(HOSTILE))
    dom, console, hosts = opened(report, tmp_path)
    assert 'data-taken="1"' not in dom
    assert "<title>taken</title>" not in dom
    assert console == [] and hosts == []
    count, of = drawn(dom)
    assert count == of


def test_even_markup_that_slipped_in_could_fetch_nothing(tmp_path):
    report = write_report(tmp_path / "report.html", fixture.flight(), fixture.identification())
    planted = '<main><img src="http://pixel.invalid/a.png"><link rel="stylesheet" href="http://style.invalid/b.css">'
    report.write_text(report.read_text(encoding="utf-8").replace("<main>", planted, 1), encoding="utf-8")
    _, console, hosts = opened(report, tmp_path)
    assert hosts == []
    assert sum("Content Security Policy" in line for line in console) == 2


SHOWN = """(async () => {
  while (!document.querySelector(".copies")) await new Promise((r) => setTimeout(r, 50));
  const copied = [];
  Object.defineProperty(navigator, "clipboard", { value: { writeText: async (text) => { copied.push(text); } } });
  const buttons = [...document.querySelector(".copies").querySelectorAll("button")];
  buttons.forEach((button) => button.click());
  const fold = document.querySelector("#reproduce details.fold");
  fold.open = false;
  location.hash = "reproduce";
  await new Promise((r) => setTimeout(r, 200));
  return { copied, unfolded: fold.open, first: document.querySelector("#verdict details.fold") === null };
})()"""


ZOOMED = """(async () => {
  const timed = [...document.querySelectorAll(".plot")].filter(
    (p) => p.layout && p.layout.xaxis && p.layout.xaxis.title && p.layout.xaxis.title.text === "time (s)");
  await Plotly.relayout(timed[0], { "xaxis.range": [11, 12] });
  await new Promise((r) => setTimeout(r, 500));
  const scene = document.querySelector('[data-title^="Turn about the vertical"]');
  return { timed: timed.length, ranges: timed.map((p) => p.layout.xaxis.range.map(Math.round).join()), turns: scene \
!== null };
})()"""


async def all_drawn(page: browser.Page, address: str) -> int:
    """Open a page with every section open, and wait until every figure is drawn, without scrolling; how many there
    are.
    """
    await page.open(f"{address}#all")
    for _ in range(1200):
        told = await page.value_of("document.documentElement?.dataset.drawn || '0/1'")
        done, of = (told or "0/1").split("/")  # nothing while the page before is left
        if done == of:
            return int(of)
        await asyncio.sleep(0.05)
    raise AssertionError(f"{done} of {of} figures were drawn in a minute")


async def test_all_is_drawn_without_scrolling_figures_over_time_zoom_together_and_the_path_turns(tmp_path):
    report = write_report(tmp_path / "report.html", fixture.flight(), fixture.identification(), fixture.diagnosis())
    async with browser.page(tmp_path / "profile") as page:
        assert await all_drawn(page, report.as_uri()) == report.read_text().count('class="plot"') > 20
        shown = await page.value_of(ZOOMED)
    assert shown["timed"] > 8 and set(shown["ranges"]) == {"11,12"}
    assert shown["turns"]


SCREENS = ((400, 800), (1000, 800), (1600, 900))


async def first_screen(page: browser.Page, width: int, height: int) -> float:
    """Where the lower of verdict (with the next step) and tiles ends, in pixels from the top."""
    await page.ask(
        "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
    )
    ends = "[...document.querySelectorAll('.verdict, .cards')].map((e) => e.getBoundingClientRect().bottom)"
    return await page.value_of(f"scrollTo(0, 0), Math.max(...{ends})")


async def test_tables_copy_sections_fold_and_the_first_screen_holds_verdict_and_tiles(tmp_path):
    report = write_report(tmp_path / "report.html", fixture.flight(), fixture.identification(), fixture.diagnosis())
    async with browser.page(tmp_path / "profile") as page:
        await page.open(report.as_uri())
        await page.value_of(
            "new Promise((r) => document.readyState === 'complete' ? r() : addEventListener('load', r))"
        )
        lowest = [await first_screen(page, *size) for size in SCREENS]
        shown = await page.value_of(SHOWN)
    assert all(bottom <= height for bottom, (_, height) in zip(lowest, SCREENS, strict=True)), lowest
    tsv, latex = shown["copied"]
    assert "\t" in tsv and len({line.count("\t") for line in tsv.strip().splitlines()}) == 1
    assert latex.startswith("\\begin{tabular}{lr") and latex.count("\\hline") == 3 and "±" not in latex
    assert shown["unfolded"] and shown["first"]


def test_each_figure_offers_svg_png_and_csv(page):
    dom, figures = page[0], drawn(page[0])[1]
    for kind in ("SVG", "PNG", "CSV"):
        assert dom.count(f'data-title="Save as {kind}"') >= figures - 1  # the path in three dimensions needs WebGL


@pytest.mark.skipif(axe_source() is None, reason=ABSENT)
async def test_axe_finds_nothing_serious_in_a_report_or_a_comparison(tmp_path):
    """Contrast, landmarks, names, order of headings: with every section open and every figure drawn, in light and
    dark.
    """
    source = axe_source()
    assert source is not None
    report = write_report(tmp_path / "report.html", fixture.flight(), fixture.identification(), fixture.diagnosis())
    both = [fixture.written(tmp_path / name) for name in ("a", "b")]
    compared = write_comparison(tmp_path / "compare.html", both)
    async with browser.page(tmp_path / "profile") as page:
        for place, schemes in ((report, ("light", "dark")), (compared, ("light",))):
            await all_drawn(page, place.as_uri())
            for scheme in schemes:
                feature = {"name": "prefers-color-scheme", "value": scheme}
                await page.ask("Emulation.setEmulatedMedia", media="screen", features=[feature])
                found = await findings(page, source)
                assert not found, f"{place.name}, {scheme}: {json.dumps(found, indent=1)}"
