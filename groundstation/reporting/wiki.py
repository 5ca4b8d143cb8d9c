"""A flight's report as Markdown, for a lab's wiki or a merge request: the same numbers as the page, without its
figures.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification.results import Identification
from groundstation.reporting.canonical import Canonical, canonical
from groundstation.reporting.card import landing_card
from groundstation.reporting.compare import cell, markdown_table
from groundstation.reporting.sections.data import hashes, reproduction_commands
from groundstation.reporting.units import (
    interval_text,
    label,
    method_text,
    readable,
    scale_for,
    significant,
    split_unit,
)

if TYPE_CHECKING:  # the diagnosis is heavy to import, and only its type is needed
    from groundstation.diagnosis.results import Diagnosis


def report_markdown(
    flight: FlightData,
    identification: Identification | Refused,
    diagnosis: Diagnosis | None,
    source: str,
    recording: Path | None,
) -> str:
    """The arguments are those of :func:`groundstation.reporting.report.report_html`."""
    lines = [f"# {cell(flight.name)}", "", cell(_facts(flight)), ""]
    if isinstance(identification, Refused):
        lines += [
            f"**Refused.** {cell(readable(identification.reason))} {cell(readable(identification.remedy))}".rstrip()
        ]
        found = None
    else:
        lines += list(_results(flight, identification, diagnosis))
        found = identification
    lines += ["", "## Reproduce", "", *(f"    {line}" for line in reproduction_commands(flight, found, source)), ""]
    lines += [f"- {cell(name)}: `{value}`" for name, value in hashes(flight, recording)]
    return "\n".join(lines) + "\n"


def _facts(flight: FlightData) -> str:
    kind = "simulated flight" if flight.truth is not None else "recorded flight"
    scenario = flight.metadata.get("scenario")
    return ", ".join([kind, f"vehicle {flight.vehicle.name}", *([f"scenario {scenario}"] if scenario else [])]) + "."


def _results(flight: FlightData, identification: Identification, diagnosis: Diagnosis | None) -> Iterator[str]:
    estimate = canonical(identification, diagnosis)
    document = {**identification.to_dict(), "estimate": estimate.to_dict()}
    told = diagnosis.to_dict() if diagnosis is not None else {}
    verdict = (
        f"**{diagnosis.verdict.capitalize()}.** {cell(readable(diagnosis.reason))}" if diagnosis is not None else ""
    )
    yield from (verdict.rstrip(), "") if verdict else ()
    yield from (f"- {cell(line)}" for line in landing_card(document, told, flight.vehicle.parameters()))
    yield from ("", f"## Parameters, by {cell(method_text(estimate.source))}", "")
    yield from _parameters(flight, estimate)
    if estimate.note:
        yield from ("", cell(estimate.note))
    if diagnosis is not None and diagnosis.findings:
        yield from ("", "## Findings", "")
        for finding in diagnosis.findings:
            where = f", rotor {finding.rotor}" if finding.rotor is not None else ""
            head = f"{finding.effect.replace('_', ' ')}{where} ({significant(100 * finding.confidence)} %)"
            yield f"- **{cell(head)}**: {cell(readable(finding.sentence))}"
    warnings = dict.fromkeys([*identification.warnings, *(diagnosis.warnings if diagnosis else ())])
    if warnings:
        yield from ("", "## Warnings", "")
        yield from (f"- {cell(readable(text))}" for text in warnings)


def _parameters(flight: FlightData, estimate: Canonical) -> list[str]:
    declared = flight.vehicle.parameters()
    true = flight.truth.parameters() if flight.truth is not None else {}
    rows = []
    for name, found in estimate.parameters.items():
        scale = scale_for(split_unit(name)[1], [found.value, declared.get(name, 0.0)])
        cells = [interval_text(found, scale)]
        cells += [significant(known[name] * scale.factor, 5) if name in known else "–" for known in (declared, true)]
        rows.append((label(name), scale.unit, *cells[: 3 if true else 2]))
    header = ("parameter", "unit", "estimate, ± 95 %", "declared", *(["true"] if true else []))
    return markdown_table(header, rows)
