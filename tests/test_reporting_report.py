"""The report: one file that stands by itself, says what it must, in order, and lets no name from a log become
markup.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import Stream
from groundstation.identification.results import Estimate
from groundstation.reporting.report import report_html, write_report
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from tests import reporting_fixture as fixture

HOSTILE = (
    """<script>document.documentElement.dataset.taken="1"</script>"""
    """<img src=x onerror="document.title='taken'">&"'</style>"""
)
VOID = {"meta", "br", "hr", "link", "img", "input"}


class Document(HTMLParser):
    """Elements with their attributes, and text by the element it is in; raises where tags do not nest."""

    def __init__(self, text: str):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.stack: list[str] = []
        self.feed(text)
        self.close()
        assert not self.stack, f"left open: {self.stack}"

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.stack.append(tag)

    def handle_endtag(self, tag):
        assert self.stack and self.stack.pop() == tag

    def handle_data(self, data):
        self.texts.append((self.stack[-1] if self.stack else "", data))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]

    def visible(self) -> str:
        return " ".join(t for tag, t in self.texts if tag not in {"script", "style", "title"})


def payload(text: str, name: str) -> str:
    packed = re.search(rf'<script id="{name}"[^>]*>([^<]*)</script>', text)
    assert packed is not None
    return gzip.decompress(base64.b64decode(packed[1])).decode()


@pytest.fixture(scope="module")
def html() -> str:
    return report_html(
        fixture.flight(), fixture.identification(), fixture.diagnosis(), live=("Two setpoints came late.",)
    )


@pytest.fixture(scope="module")
def document(html) -> Document:
    return Document(html)


def test_nothing_is_fetched_from_anywhere(html, document):
    for tag, attributes in document.elements:
        assert not attributes.keys() & {"src", "srcset", "data", "action", "background", "poster"}, tag
        if "href" in attributes:
            assert attributes["href"].startswith("#")
    style = "".join(text for tag, text in document.texts if tag == "style")
    assert "url(" not in style and "@import" not in style
    policy = next(a["content"] for a in document.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy and "http" not in policy
    assert len(html.encode()) < 3_000_000


def test_sections_stand_in_the_order_a_reader_asks(document):
    order = [a["id"] for a in document.all("section")]
    assert order == [
        "verdict",
        "parameters",
        "flown",
        "evolution",
        "validation",
        "residuals",
        "data",
        "warnings",
        "reproduce",
    ]
    ids = [a["id"] for _, a in document.elements if "id" in a]
    assert len(ids) == len(set(ids))
    assert {a["href"][1:] for a in document.all("a")} <= set(ids)


def test_every_table_and_figure_can_be_read_without_seeing(html, document):
    assert len(document.all("caption")) == len(document.all("table")) > 8
    assert all(a.get("scope") in {"row", "col"} for a in document.all("th"))
    ids = {a["id"] for _, a in document.elements if "id" in a}
    plots = [a for a in document.all("div") if a.get("class") == "plot"]
    assert all(a["role"] == "group" and a["aria-labelledby"] in ids for a in plots)
    figures = json.loads(payload(html, "data-figures"))
    assert set(figures) == {a["id"] for a in plots} and len(plots) > 20
    assert len(document.all("html")) == 1 and document.all("html")[0]["lang"] == "en"


def test_findings_come_with_their_sentence_size_rivals_and_rotor(document):
    text = document.visible()
    assert text.index("Rotor drag") < text.index("Motor lag") < text.index("Weak rotor")
    assert "0.30 N for each metre per second" in text and "0.302 ± 0.022 kg/s" in text
    assert "cannot tell it from: input delay" in text and "rotor 3" in text
    assert "hover 10 s" in text.lower() and "position x, speed" in text


def test_prediction_is_shown_by_horizon_with_how_many_times_smaller_its_error_became(document):
    text = document.visible()
    rows = text[text.index("open-loop prediction") :]
    assert rows.index("position, 0.1 s") < rows.index("body rate, 0.1 s") < rows.index("position, 0.5 s")
    assert "ratio 4.00" in rows and "ratio 5.00" in rows
    assert "144 windows that lie in data no estimate saw" in rows


def test_names_from_logs_never_become_markup():
    plain = Document(report_html(fixture.flight(), fixture.identification(), fixture.diagnosis()))
    hostile = report_html(*fixture.hostile(HOSTILE), live=(HOSTILE,))
    document = Document(hostile)
    assert not document.all("img")
    assert len(document.all("script")) == len(plain.all("script")) == 3
    assert len(document.all("style")) == 1
    assert not [k for _, attributes in document.elements for k in attributes if k.startswith("on")]
    assert document.visible().count("dataset.taken") > 15  # shown as text, wherever it came from
    assert "<script>document" not in hostile


def test_intervals_say_whether_they_hold_the_truth(html):
    flight, ident = fixture.flight(), fixture.identification()
    assert flight.truth is not None
    true = flight.truth.parameters()
    holds = [
        estimate.ci95[0] <= true[name] <= estimate.ci95[1]
        for method in ident.methods.values()
        for name, estimate in method.parameters.items()
    ]
    in_model = [e.ci95[0] <= true[n] <= e.ci95[1] for n, e in ident.model.items() if n in true]
    holds += in_model
    assert html.count('title="✓ holds the truth"') == sum(holds)
    assert html.count('title="✕ misses the truth"') == len(holds) - sum(holds) > 5
    measured = report_html(replace(flight, truth=None), ident)
    assert "holds the truth" not in measured and ">true<" not in measured


def test_an_errors_change_has_the_sign_of_what_it_did(document):
    """Closed loop, x: nominal 12.0 mm, LS 7.44 mm: 100 (1 - 7.44/12) = 38.0 %."""
    text = document.visible()
    assert "▾ −38.0 %" in text and "▴ +5.0 %" in text  # torque z grew from 4.0 to 4.2 mN m


def test_envelopes_keep_the_peaks_of_a_spike_in_the_rotors(tmp_path):
    flight = fixture.flight()
    values = flight.motors.values.copy()
    values[7003, 2] = 871.25
    spiked = replace(flight, motors=replace(flight.motors, values=values))
    figures = json.loads(payload(report_html(spiked, fixture.identification()), "data-figures"))
    rotors = next(f for f in figures.values() if any(t.get("name") == "rotor 3" for t in f["data"]))
    trace = next(t for t in rotors["data"] if t["name"] == "rotor 3")
    assert len(trace["y"]) < 2100 < len(values)
    peak = int(np.argmax([v or 0.0 for v in trace["y"]]))
    assert trace["y"][peak] == pytest.approx(871.25, abs=0.01)
    assert trace["x"][peak] == pytest.approx(flight.motors.t_s[7003], abs=1e-4)


def test_poses_are_drawn_on_the_imus_clock():
    flight, ident = fixture.flight(), fixture.identification()
    assert ident.clock is not None and flight.mocap is not None
    clock = replace(ident.clock, mocap_minus_imu_s=0.5, drift=0.0)
    figures = json.loads(payload(report_html(flight, replace(ident, clock=clock)), "data-figures"))
    yaw = next(t for f in figures.values() for t in f["data"] if t.get("name") == "yaw")
    assert yaw["x"][0] == pytest.approx(flight.mocap.t_s[0] - 0.5, abs=1e-4)


def test_tracking_error_is_judged_against_setpoints_else_against_the_plan():
    from groundstation.reporting.motion import flown

    flight = fixture.flight()
    clock = fixture.identification().clock
    with_setpoints = flown(flight, clock)
    assert with_setpoints is not None
    # The fixture flies 80 ms late: the error is the path's speed times the delay, and nothing but noise at rest.
    error = with_setpoints.tracking_error()
    assert error is not None
    resting = with_setpoints.t_s > 32.0
    assert np.nanmax(np.abs(error[resting, :3])) < 3e-3
    assert np.nanmax(np.abs(error[:, :3])) > 0.02
    start = fixture.flight_path(fixture.plan(), [0, 0, 0, 0]).duration_s - fixture.plan().series().duration_s
    by_plan = flown(replace(flight, setpoint=None, window_s=(start, start + 10.0)), clock)
    assert by_plan is not None and by_plan.wanted is not None
    assert np.isnan(by_plan.wanted[by_plan.t_s < start - 1.0]).all()
    without = flown(replace(flight, setpoint=None, plan=None), clock)
    assert without is not None and without.tracking_error() is None


def test_a_refusal_is_a_report_with_reason_and_remedy():
    refusal = NotIdentifiable("A hover does not turn the vehicle.", "Fly the planned excitation.", ("ixx_kg_m2",))
    document = Document(report_html(fixture.flight(), refusal))
    text = document.visible()
    assert "Refused" in text and "A hover does not turn the vehicle." in text and "Fly the planned excitation." in text
    assert "No number is given for: Ixx" in text.replace("  ", " ")
    assert "parameters" not in [a["id"] for a in document.all("section")]


@pytest.mark.parametrize("missing", ["imu", "mocap", "battery", "setpoint"])
def test_a_stream_that_was_not_recorded_leaves_the_rest(missing):
    flight = replace(fixture.flight(), **{missing: None})
    ident = replace(
        fixture.identification(), clock=None if missing in {"imu", "mocap"} else fixture.identification().clock
    )
    text = Document(report_html(flight, ident)).visible()
    if missing == "mocap":
        assert "No pose was recorded" in text


def test_poor_flights_still_get_a_report():
    """One sample per stream, no plan, no window, wrench input, NaN in poses, infinite intervals."""
    flight = fixture.flight()
    one = {name: Stream(s.t_s[:1], s.values[:1], s.columns) for name, s in flight.streams().items()}
    Document(report_html(replace(flight, **one, plan=None, window_s=None), fixture.identification()))

    vehicle = vehicle_to_dict(flight.vehicle)
    vehicle["rotors"]["input"] = "wrench"
    wrench = Stream(flight.motors.t_s, flight.motors.values, ("force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm"))
    assert flight.mocap is not None
    values = flight.mocap.values.copy()
    values[100:200] = np.nan
    odd = replace(flight, vehicle=vehicle_from_dict(vehicle), motors=wrench, mocap=replace(flight.mocap, values=values))
    ident = fixture.identification()
    endless = Estimate(0.03, np.inf, (-np.inf, np.inf))
    methods = {**ident.methods, "LS": replace(ident.methods["LS"], parameters={"ixx_kg_m2": endless})}
    text = Document(report_html(odd, replace(ident, methods=methods, best="gone"))).visible()
    assert "nan" not in text.lower().replace("nano", "") and " inf" not in text


def test_the_same_flight_gives_the_same_bytes(tmp_path, html):
    path = write_report(
        tmp_path / "report.html",
        fixture.flight(),
        fixture.identification(),
        fixture.diagnosis(),
        live=("Two setpoints came late.",),
    )
    assert path.read_text(encoding="utf-8") == html
