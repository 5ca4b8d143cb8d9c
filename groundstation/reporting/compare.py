"""Two flights or more on one page: what agrees, what changed and by how many standard deviations, as HTML and as
Markdown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from pathlib import Path
from typing import Any

from groundstation.documents import read_diagnosis, read_identification
from groundstation.errors import BadInput
from groundstation.identification.results import Estimate
from groundstation.reporting import figures
from groundstation.reporting.canonical import estimate_in, estimate_of
from groundstation.reporting.card import landing_card
from groundstation.reporting.markup import Child, element, fragment, table
from groundstation.reporting.page import Page
from groundstation.reporting.units import (
    half_width,
    interval_text,
    label,
    percent,
    scale_for,
    significant,
    split_unit,
)
from groundstation.writing import write_whole

DIFFERS = 2.8
"""Standard deviations of a difference from which it is said to be one: 5 chances in 1000 for one parameter, and of the
ten that are compared, one comparison in twenty by chance."""


@dataclass(frozen=True, slots=True)
class Flown:
    """A flight's documents, as the analysis left them in its folder."""

    name: str
    identification: Mapping[str, Any]
    diagnosis: Mapping[str, Any]

    def parameters(self) -> dict[str, Estimate]:
        """Those of the one estimate that hold a number."""
        known = {name: estimate_of(entry) for name, entry in estimate_in(self.identification)[1].items()}
        return {name: estimate for name, estimate in known.items() if estimate is not None}


def read_flown(folder: Path) -> Flown:
    """The documents in a flight's folder, or beside its recording.

    Raises:
        BadInput: it is not identified.
    """
    folder = folder if folder.is_dir() else folder.parent
    if not (folder / "identification.json").is_file():
        raise BadInput(f"{folder}: has no identification.json; `groundstation report` makes one of its recording.")
    found = folder / "diagnosis.json"
    return Flown(
        folder.resolve().name,
        read_identification(folder / "identification.json"),
        read_diagnosis(found) if found.is_file() else {},
    )


def apart(first: Estimate, second: Estimate) -> float:
    """The difference in its own standard deviations; of independent flights."""
    spread = hypot(first.std, second.std)
    return (second.value - first.value) / spread if spread > 0.0 else 0.0


def change(name: str, first: Estimate, second: Estimate) -> str:
    """The difference: a share of the first where that is beyond its own interval, else in the parameter's unit."""
    if abs(first.value) > half_width(first):
        return percent(second.value / first.value - 1.0)
    scale = scale_for(split_unit(name)[1], [second.value - first.value])
    difference = (second.value - first.value) * scale.factor
    return f"{'+' if difference > 0.0 else ''}{significant(difference)} {scale.unit}".strip()


def comparison_rows(flights: Sequence[Flown]) -> list[tuple[str, ...]]:
    """A row for each parameter that two flights or more tell: name, unit, each flight, change from first to last,
    judgement.
    """
    told = [flight.parameters() for flight in flights]
    rows = []
    for name in dict.fromkeys(name for known in told for name in known):
        found = [known.get(name) for known in told]
        present = [estimate for estimate in found if estimate is not None]
        if len(present) < 2:
            continue
        scale = scale_for(split_unit(name)[1], [estimate.value for estimate in present])
        cells = [interval_text(estimate, scale) if estimate else "–" for estimate in found]
        z = apart(present[0], present[-1])
        word = f"{'differs' if abs(z) > DIFFERS else 'agrees'} ({significant(abs(z), 2)} σ)"
        rows.append((label(name), scale.unit, *cells, change(name, present[0], present[-1]), word))
    return rows


def summary(flights: Sequence[Flown]) -> str:
    """What differs between the first flight and the last, in a sentence."""
    rows = comparison_rows(flights)
    moved = [f"{row[0]} {row[-2]}" for row in rows if row[-1].startswith("differs")]
    return comparison_sentence(flights[0].name, flights[-1].name, len(rows), moved)


def comparison_sentence(first: str, last: str, compared: int, moved: Sequence[str]) -> str:
    """What moved ("mass +2.0 %") between two flights or groups, of how many parameters."""
    if not compared:
        return "These flights share no parameter that both reveal."
    if not moved:
        return f"Nothing differs between {first} and {last} beyond the intervals, over {compared} parameters."
    return f"From {first} to {last} these differ beyond their intervals: {', '.join(moved)}."


def _findings(flight: Flown) -> str:
    found = [f["evidence"] for f in flight.diagnosis.get("findings", ())]
    return " ".join(found) or ("Nothing was found." if flight.diagnosis else "This flight was not diagnosed.")


def _header(flights: Sequence[Flown]) -> tuple[str, ...]:
    return ("parameter", "unit", *(flight.name for flight in flights), "change", "judgement")


def comparison_markdown(flights: Sequence[Flown]) -> str:
    """The same as Markdown, for a wiki."""
    lines = [f"# {len(flights)} flights compared", "", summary(flights), ""]
    lines += markdown_table(_header(flights), comparison_rows(flights))
    for flight in flights:
        lines += ["", f"## {cell(flight.name)}", "", *(f"- {cell(line)}" for line in _card(flight))]
        lines += ["", cell(_findings(flight))]
    return "\n".join(lines) + "\n"


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table's lines; what would end a cell, or begin markup, is escaped."""
    lines = [f"| {' | '.join(map(cell, header))} |", f"|{' --- |' * len(header)}"]
    return [*lines, *(f"| {' | '.join(map(cell, row))} |" for row in rows)]


def cell(text: str) -> str:
    """Text as text: no markup of Markdown or HTML, no line end."""
    for sign in "\\`*_[]<>|#":
        text = text.replace(sign, f"\\{sign}")
    return " ".join(text.split())


def _card(flight: Flown) -> tuple[str, str, str]:
    return landing_card(flight.identification, flight.diagnosis, {})


def comparison_html(flights: Sequence[Flown]) -> str:
    """The page, self-contained as a report is."""
    page = Page(f"{len(flights)} flights compared")
    rows = comparison_rows(flights)
    caption = f"Estimates with their 95 % half widths; a difference of more than {DIFFERS:g} σ is one."
    page.section(
        "verdict",
        "What changed",
        element("p", element("strong", summary(flights))),
        table(caption, _header(flights), rows) if rows else None,
    )
    page.section("parameters", "Side by side", element("div", _panels(page, flights), class_="small"))
    page.section("flights", "Flight by flight", *(_flight(flight) for flight in flights))
    head = fragment(element("h1", f"{len(flights)} flights compared"), element("p", _vehicles(flights), class_="sub"))
    return page.html(head, element("p", "Intervals are 95 %."))


def _vehicles(flights: Sequence[Flown]) -> str:
    return " · ".join(dict.fromkeys(str(flight.identification.get("vehicle", "")) for flight in flights))


def _flight(flight: Flown) -> Child:
    return fragment(
        element("h3", flight.name),
        element("ul", [element("li", line) for line in _card(flight)]),
        element("p", _findings(flight)),
    )


def _panels(page: Page, flights: Sequence[Flown]) -> list[Child]:
    told = {flight.name: flight.parameters() for flight in flights}
    panels: list[Child] = []
    for name in dict.fromkeys(name for known in told.values() for name in known):
        here = {flight: known[name] for flight, known in told.items() if name in known}
        if len(here) < 2:
            continue
        scale = scale_for(split_unit(name)[1], [estimate.value for estimate in here.values()])
        shown = {
            f: (scale.factor * e.value, scale.factor * e.ci95[0], scale.factor * e.ci95[1]) for f, e in here.items()
        }
        panels.append(page.figure(figures.interval_figure(shown, list(told), None, None, scale.unit), label(name)))
    return panels


def write_comparison(path: Path, folders: Sequence[Path]) -> Path:
    """Write the page, or Markdown where the name ends in .md; beside a page also the Markdown.

    Raises:
        BadInput: fewer than two flights, or one that is not identified.
    """
    if len(folders) < 2:
        raise BadInput("two flights or more are compared; name their folders.")
    flights = [read_flown(folder) for folder in folders]
    text = comparison_markdown(flights)
    if path.suffix == ".md":
        return write_whole(path, text)
    write_whole(path.with_suffix(".md"), text)
    return write_whole(path, comparison_html(flights))
