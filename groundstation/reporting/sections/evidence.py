"""Why to believe it: evolution of the estimates, prediction errors, closed-loop simulation, residuals and their
colour.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from groundstation.flightdata import FlightData
from groundstation.identification.results import MASS_AND_TENSOR, Identification, Validation
from groundstation.reporting import figures
from groundstation.reporting.markup import Markup, element, fragment, table
from groundstation.reporting.page import Page
from groundstation.reporting.sections.parameters import parameter_scale
from groundstation.reporting.sections.tables import error_table
from groundstation.reporting.sections.verdict import effect_name
from groundstation.reporting.units import label, scale_for, significant, split_unit

if TYPE_CHECKING:  # the diagnosis is heavy to import, and only its type is needed
    from groundstation.diagnosis.results import Diagnosis

_CHECKS = {
    "output": "Output prediction error (regressor times parameters, minus output)",
    "closed_loop": "Closed-loop simulation against the flight",
    "prediction": "Open-loop prediction with the recorded inputs",
}


def key(names: Mapping[str, int]) -> Markup:
    """A legend that several small figures share: the name of each style, by its number."""
    dash_arrays = {
        "solid": "",
        "dash": "7 4",
        "dot": "2 3",
        "dashdot": "7 3 2 3",
        "longdash": "11 4",
        "longdashdot": "11 3 2 3",
    }
    items = []
    for name, number in names.items():
        style = figures.line(number)
        stroke = f"var(--{style['color'][1:]})"
        drawn = element(
            "line",
            x1="0",
            y1="5",
            x2="34",
            y2="5",
            style=f"stroke:{stroke};stroke-width:2.2;stroke-dasharray:{dash_arrays[style['dash']]}",
        )
        items.append(element("li", element("svg", drawn, width="34", height="10", aria_hidden="true"), name))
    return element("ul", items, class_="key")


def add_evolution(page: Page, flight: FlightData, identification: Identification) -> None:
    """Figures 4 and 5 of the seed paper: how the estimates moved as data came in."""
    moving = {name: m.evolution for name, m in identification.methods.items() if m.evolution is not None}
    if not moving:
        return
    nominal = flight.vehicle.parameters()
    truth = flight.truth.parameters() if flight.truth is not None else {}
    panels = []
    for name in MASS_AND_TENSOR:
        present = {method: e for method, e in moving.items() if name in e.values}
        if not present:
            continue
        scale = parameter_scale(name, identification, nominal)
        lines = [
            {
                **figures.trace(
                    e.t_s, scale.factor * e.values[name], method, list(identification.methods).index(method)
                ),
                "showlegend": False,
            }
            for method, e in present.items()
        ]
        shapes = [
            figures.reference(scale.factor * source[name], text, dash)
            for source, text, dash in ((nominal, "nominal", "dash"), (truth, "true", "solid"))
            if name in source
        ]
        figure = figures.time_figure(lines, scale.unit, shapes=shapes, height=250)
        _robust_range(figure)
        panels.append(page.figure(figure, label(name)))
    lines_text = "Grey dashed line: nominal" + ("; grey solid line: truth." if truth else ".")
    page.section(
        "evolution",
        "How the estimates settled",
        element("p", "The estimate from the data up to each instant. ", lines_text, class_="note"),
        key({name: list(identification.methods).index(name) for name in moving}),
        element("div", panels, class_="small"),
        folded=True,
    )


def _robust_range(figure: figures.Figure) -> None:
    """Start zoomed on where the estimates settle: the second half of every line, and the reference lines, with a
    margin.
    """
    settled = []
    for drawn in figure["data"]:
        values = [v for v in drawn["y"][len(drawn["y"]) // 2 :] if v is not None]
        settled += values
    settled += [shape["y0"] for shape in figure["layout"]["shapes"] if shape["type"] == "line"]
    if settled:
        low, high = min(settled), max(settled)
        margin = 0.15 * (high - low) or 0.05 * abs(high) or 1.0
        figure["layout"]["yaxis"]["range"] = [low - margin, high + margin]


def add_validation(page: Page, identification: Identification) -> None:
    """Tables 4-6 of the seed paper: RMS errors and the improvement over nominal."""
    seed = {name: dict(m.rms_output_error) for name, m in identification.methods.items() if m.rms_output_error}
    parts: list[Markup] = [_validation(check, identification.best) for check in identification.validation]
    if seed and not any(check.kind == "output" for check in identification.validation):
        parts.append(
            error_table(
                "RMS output prediction error by method.", seed, reference="nominal", improved=identification.best
            )
        )
    if not parts:
        parts = [element("p", "No validation was run on this flight.", class_="note")]
    note = "Below each error its change from nominal: ▾ it fell, ▴ it grew."
    legend = element("p", note, class_="note") if identification.validation else None
    page.section("validation", "Validation", legend, *parts)


def _validation(check: Validation, best: str) -> Markup:
    title = _CHECKS.get(check.kind, check.kind.replace("_", " "))
    order = dict.fromkeys(("nominal", best, *check.rms))
    ordered = {name: check.rms[name] for name in order if name in check.rms}
    caption = f"RMS over {check.samples} samples. {check.note}".strip()
    return fragment(element("h3", title), error_table(caption, ordered, reference="nominal", improved=best))


def add_would_show(page: Page, diagnosis: Diagnosis | None) -> None:
    """From what size on effects that were not found would have been."""
    if diagnosis is None or not diagnosis.would_show:
        return
    rows = []
    for told in diagnosis.would_show:
        size = (
            f"{significant(told.least, 2)} {split_unit(told.parameter)[1]}".strip()
            if told.share < 1.0
            else "not at all"
        )
        rows.append((effect_name(told.effect), label(told.parameter), size, f"{significant(100 * told.share, 2)} %"))
    caption = (
        "Effects that are not among the findings, and the size from which on these flights show them nine times out of "
        "ten (of the rotor and the instant that show worst). Share: of its force in weight, of its torque in weight "
        "times arm, root mean square."
    )
    header = ("effect", "parameter", "shown from", "share")
    page.section("would-show", "What else would have been found", table(caption, header, rows), folded=True)


def add_residuals(page: Page, diagnosis: Diagnosis | None) -> None:
    """Residual of each channel over time and over frequency, before and after.

    ``diagnosis.residual`` holds "t_s", the residual before under the channel's name, and after the findings were added
    under the name followed by "/after".
    """
    if diagnosis is None or "t_s" not in diagnosis.residual:
        return
    t = diagnosis.residual["t_s"]
    parts = []
    for channel in [c for c in diagnosis.residual if c != "t_s" and "/" not in c]:
        series = {"before": diagnosis.residual[channel]}
        if f"{channel}/after" in diagnosis.residual:
            series["after"] = diagnosis.residual[f"{channel}/after"]
        largest = max((float(np.nanmax(np.abs(v), initial=0.0)) for v in series.values()), default=0.0)
        scale = scale_for(split_unit(channel)[1], [largest])
        lines = [figures.trace(t, scale.factor * v, name, i) for i, (name, v) in enumerate(series.items())]
        colour = {
            name: figures.spectrum(t, scale.factor * v) for name, v in series.items() if np.isfinite(v).sum() > 64
        }
        parts.append(
            element(
                "div",
                page.figure(figures.time_figure(lines, scale.unit), f"Residual of {label(channel)}."),
                page.figure(figures.spectrum_figure(colour, scale.unit), f"Its amplitude density: {label(channel)}.")
                if colour
                else None,
                class_="pair",
            )
        )
    note = "The wrench that is left, smoothed over 0.2 s: above 2 Hz its density falls off by that alone."
    page.section("residuals", "Residuals", element("p", note, class_="note"), *parts, folded=True)
