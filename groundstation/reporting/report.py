"""One flight's report: a self-contained HTML file that opens from disk, without a network."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification.results import Identification
from groundstation.reporting.markup import element, fragment
from groundstation.reporting.page import Page
from groundstation.reporting.sections.data import add_data, add_reproduction, add_warnings
from groundstation.reporting.sections.evidence import add_evolution, add_residuals, add_validation, add_would_show
from groundstation.reporting.sections.flight import add_flight
from groundstation.reporting.sections.parameters import add_parameters
from groundstation.reporting.sections.verdict import add_verdict
from groundstation.reporting.units import fixed
from groundstation.reporting.wiki import report_markdown
from groundstation.writing import write_whole

if TYPE_CHECKING:  # the diagnosis is heavy to import, and only its type is needed
    from groundstation.diagnosis.results import Diagnosis


def report_html(
    flight: FlightData,
    identification: Identification | Refused,
    diagnosis: Diagnosis | None = None,
    *,
    live: Sequence[str] = (),
    source: str | None = None,
    recording: Path | None = None,
) -> str:
    """The report as HTML text.

    Args:
        flight: the recording, with the truth where it was simulated.
        identification: the result, or the refusal with its reason and remedy.
        diagnosis: what the declared vehicle lacks, where that was asked.
        live: what was noticed while flying (lost messages, guard actions), one sentence each.
        source: the recording (and options) in the commands that reproduce the report; by default the flight's name.
        recording: the file it was read from, whose hash the report states.
    """
    page = Page(f"{flight.name} – flight report")
    result = None if isinstance(identification, Refused) else identification
    add_verdict(page, identification, diagnosis, flight.vehicle.parameters())
    if result is not None:
        add_parameters(page, flight, result)
    add_flight(page, flight, result)
    if result is not None:
        add_evolution(page, flight, result)
        add_validation(page, result)
    add_residuals(page, diagnosis)
    add_would_show(page, diagnosis)
    add_data(page, flight, result, live)
    add_warnings(page, [*(result.warnings if result else ()), *(diagnosis.warnings if diagnosis else ())])
    add_reproduction(page, flight, result, source or flight.metadata.get("source", flight.name), recording)
    return page.html(_header(flight), _footer())


def write_report(
    path: str | Path,
    flight: FlightData,
    identification: Identification | Refused,
    diagnosis: Diagnosis | None = None,
    *,
    live: Sequence[str] = (),
    source: str | None = None,
) -> Path:
    """Write :func:`report_html` to ``path`` and return it, and beside it the same as Markdown.

    Without a ``source``, a ``flight.mcap`` beside it is named.
    """
    path = Path(path)
    recording = path.with_name("flight.mcap")
    if source is None and recording.is_file():
        source = shlex.quote(str(recording))
    named = source or flight.metadata.get("source", flight.name)
    write_whole(path.with_suffix(".md"), report_markdown(flight, identification, diagnosis, named, recording))
    return write_whole(
        path, report_html(flight, identification, diagnosis, live=live, source=source, recording=recording)
    )


def _header(flight: FlightData) -> str:
    spans = [(s.t_s[0], s.t_s[-1]) for s in flight.streams().values() if len(s) > 1]
    duration = max((end - start for start, end in spans), default=0.0)
    kind = "simulated flight" if flight.truth is not None else "recorded flight"
    scenario = flight.metadata.get("scenario")
    facts = [kind, f"vehicle {flight.vehicle.name}", f"{fixed(float(duration), 1)} s"]
    facts += [f"scenario {scenario}"] if scenario else []
    return fragment(element("h1", flight.name), element("p", " · ".join(facts), class_="sub"))


def _footer() -> str:
    return element(
        "p", "Intervals are 95 %. World z up; body x forward, y left, z up. SI units unless a prefix is written."
    )
