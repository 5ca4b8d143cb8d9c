"""The fleet report: what a vehicle's parameters did over its flights, as text and as one HTML file without a
network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.errors import BadInput
from groundstation.fleet.catalogue import Catalogue, Filter
from groundstation.fleet.trends import SHORTEST, Difference, Trend, compare_groups, trend
from groundstation.identification.results import Estimate
from groundstation.json_types import JsonObject
from groundstation.reporting.markup import Child, element, fragment, sentence_list, table
from groundstation.reporting.page import Page
from groundstation.reporting.units import interval_text, label, percent, quantity, scale_for, split_unit
from groundstation.writing import write_whole

DIFFERENT = 0.01
"""Holm-adjusted p below which two groups of flights are said to differ: one comparison in a hundred, over all
parameters.
"""


@dataclass(frozen=True, slots=True)
class Series:
    """One parameter of a vehicle over its flights, and its trend."""

    name: str
    flights: tuple[str, ...]
    values: tuple[float, ...]
    stds: tuple[float, ...]
    trend: Trend


def vehicle_trends(catalogue: Catalogue, vehicle: str) -> list[Series]:
    """Every canonical parameter of a vehicle with flights enough to say something."""
    found = {name: s for name, s in catalogue.series(vehicle).items() if len(s[0]) >= SHORTEST}
    return [
        Series(name, tuple(flights), tuple(values), tuple(stds), trend(values, stds, parameters=len(found)))
        for name, (flights, values, stds) in found.items()
    ]


def parameter_label(name: str) -> str:
    """A parameter in words; of a finding "weak_rotor_2.thrust_factor": "weak rotor 2: thrust factor"."""
    effect, dot, parameter = name.rpartition(".")
    return f"{effect.replace('_', ' ')}: {label(parameter)}" if dot else label(name)


def change_sentence(series: Series) -> str:
    """What moved, from which flight on, by how much, and how surely."""
    change = series.trend.change
    if change is None:
        return ""
    about = float(np.mean(series.trend.mean))
    if change.kind == "drift":
        total = change.size * (len(series.flights) - 1)
        return (
            f"{parameter_label(series.name)} drifts by {_size(series.name, change.size, change.std, about)} a flight:"
            f" {_share(total, about)} over {len(series.flights)} flights (probability "
            f"{_probability(change.probability)})."
        )
    return (
        f"{parameter_label(series.name)} changed by {_size(series.name, change.size, change.std, about)} from flight"
        f" {series.flights[change.at]} on (probability {_probability(change.probability)};"
        f" {change.at_probability:.0%} within a flight of it)."
    )


def _size(name: str, size: float, std: float, about: float) -> str:
    text = quantity(name.rpartition(".")[2], Estimate.normal(size, std))
    share = _share(size, about)
    return f"{text} ({share})" if share else text


def _share(size: float, about: float) -> str:
    """A change as a percentage, where what it changes is not near zero."""
    return percent(size / about) if abs(about) > abs(size) else ""


def _probability(value: float) -> str:
    return "over 99.9 %" if value > 0.999 else f"{100 * value:.1f} %"


def trend_lines(catalogue: Catalogue, vehicle: str) -> list[str]:
    """The trends of a vehicle in lines for a terminal: what moved first, then what lies outside its limits."""
    series = vehicle_trends(catalogue, vehicle)
    count = len(catalogue.rows(Filter(vehicle=vehicle)))
    if not series:
        return [f"{vehicle}: {count} flight{'s' if count != 1 else ''}; a trend needs {SHORTEST} that are identified."]
    lines = [sentence for s in series if (sentence := change_sentence(s))]
    for s in series:
        lines += [
            f"{parameter_label(s.name)} of {s.flights[i]} lies outside its control limits." for i in s.trend.outside
        ]
    return [
        f"{vehicle}: {count} flights.",
        *(lines or ["Nothing moved by more than its intervals and its scatter allow."]),
    ]


def trend_document(catalogue: Catalogue, vehicle: str) -> JsonObject:
    """The same for machines."""
    return {
        "vehicle": vehicle,
        "parameters": {
            s.name: {
                "flights": list(s.flights),
                "value": list(s.values),
                "std": list(s.stds),
                "scatter": s.trend.scatter,
                "probability_of_change": s.trend.probability,
                "change": None
                if (c := s.trend.change) is None
                else {"kind": c.kind, "from_flight": s.flights[c.at], "size": c.size, "std": c.std},
                "outside": [s.flights[i] for i in s.trend.outside],
            }
            for s in vehicle_trends(catalogue, vehicle)
        },
    }


def group(catalogue: Catalogue, name: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Canonical parameters (values, stds) of the flights that bear a tag, or of one flight by its name or folder.

    Raises:
        BadInput: no flight bears the tag or name.
    """
    rows = [
        r
        for r in catalogue.rows()
        if name in (r["tags"] or ()) or name in (r["flight"], r["folder"], Path(r["folder"]).name)
    ]
    if not rows:
        raise BadInput(f"'{name}' is neither a tag nor a flight here; `groundstation flights` lists both.")
    names = {n for r in rows for n in r["parameters"]}
    return {
        n: (
            np.array([r["parameters"][n]["value"] for r in rows if n in r["parameters"]]),
            np.array([r["parameters"][n]["std"] for r in rows if n in r["parameters"]]),
        )
        for n in sorted(names)
        if all(r["parameters"][n]["std"] > 0.0 for r in rows if n in r["parameters"])
    }


def compare(catalogue: Catalogue, first: str, second: str) -> dict[str, tuple[Difference, float]]:
    """Parameters that both groups have: their difference and its p value, corrected for their number (Holm)."""
    return compare_groups(group(catalogue, first), group(catalogue, second))


def comparison_lines(found: Mapping[str, tuple[Difference, float]], first: str, second: str) -> list[str]:
    """Differences in lines for a terminal, the surest first."""
    lines = [f"{second} less {first}:"]
    for name, (d, p) in sorted(found.items(), key=lambda item: item[1][1]):
        mark = "differs" if p < DIFFERENT else "the same within what the flights tell"
        lines.append(f"  {parameter_label(name)}: {_size(name, d.size, d.std, d.first)}, p {p:.2g}: {mark}")
    return lines


def write_fleet_report(path: Path, catalogue: Catalogue, pair: tuple[str, str] | None = None) -> Path:
    """One HTML file: each vehicle's flights, trends and control charts; and the comparison of two groups where
    asked.
    """
    page = Page("Fleet report")
    vehicles = catalogue.vehicles()
    series = {vehicle: vehicle_trends(catalogue, vehicle) for vehicle in vehicles}
    moved = [f"{v}: {text}" for v, all_ in series.items() for s in all_ if (text := change_sentence(s))]
    page.section(
        "verdict",
        "What moved",
        sentence_list(moved) if moved else element("p", "Nothing moved by more than intervals and scatter allow."),
    )
    if pair is not None:
        found = compare(catalogue, *pair)
        header = ("parameter", *pair, "difference", "p (Holm)")
        page.section("compare", f"{pair[1]} against {pair[0]}", table("Two groups", header, _difference_rows(found)))
    for index, vehicle in enumerate(vehicles):
        page.section(f"vehicle-{index}", vehicle, *_vehicle(page, catalogue, vehicle, series[vehicle]))
    header = fragment(
        element("h1", "Fleet report"), element("p", f"{catalogue.logs} · {len(catalogue.rows())} flights", class_="sub")
    )
    footer = element("p", "Dots are flights with 95 % intervals; the band holds 99.7 % of flights while nothing moves.")
    try:
        return write_whole(path, page.html(header, footer))
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); name a file in a folder that exists.") from None


def _difference_rows(found: Mapping[str, tuple[Difference, float]]) -> list[Sequence[Child]]:
    rows: list[Sequence[Child]] = []
    for name, (d, p) in sorted(found.items(), key=lambda item: item[1][1]):
        unit = scale_for(split_unit(name)[1], [d.first, d.second])
        values = [interval_text(Estimate(v, 0.0, (v, v)), unit) for v in (d.first, d.second)]
        rows.append(
            (
                fragment(parameter_label(name), element("small", unit.unit)),
                *values,
                _size(name, d.size, d.std, d.first),
                f"{p:.2g}",
            )
        )
    return rows


def _vehicle(page: Page, catalogue: Catalogue, vehicle: str, series: Sequence[Series]) -> list[Child]:
    """Its sentences, its charts, its flights."""
    out: list[Child] = [sentence_list(trend_lines(catalogue, vehicle)[1:])]
    out += [page.figure(_chart(s), f"{parameter_label(s.name)} over flights") for s in series if _worth_a_chart(s)]
    rows = [
        (
            r["flight"],
            r["date"][:16].replace("T", " "),
            r["state"],
            r["verdict"] or "–",
            " ".join(r["tags"] or ()),
            r["note"] or "",
        )
        for r in catalogue.rows(Filter(vehicle=vehicle))
    ]
    out.append(table(f"Flights of {vehicle}", ("flight", "UTC", "state", "verdict", "tags", "note"), rows))
    return out


def _worth_a_chart(series: Series) -> bool:
    return series.trend.change is not None or bool(series.trend.outside) or "." not in series.name


def _chart(series: Series) -> JsonObject:
    """A control chart: estimates with intervals, the level, and the limits of each flight."""
    scale = scale_for(split_unit(series.name.rpartition(".")[2])[1], series.values)
    x = list(series.flights)

    def scaled(values: Any) -> list[float]:
        return [float(v) * scale.factor for v in values]

    def curve(values: Any, name: str, **extra: Any) -> JsonObject:
        style = {"color": "@muted", "width": 1, "shape": "hvh", "dash": "dot"}
        return {"type": "scatter", "mode": "lines", "x": x, "y": scaled(values), "name": name, "line": style, **extra}

    points = {
        "type": "scatter", "mode": "markers", "x": x, "y": scaled(series.values), "name": "estimate",
        "error_y": {"type": "data", "array": scaled(1.959964 * s for s in series.stds), "thickness": 1.5, "width": 3},
        "marker": {"color": "@1", "size": 7},
    }  # fmt: skip
    data = [
        curve(series.trend.high, "limits"),
        curve(series.trend.low, "limits", showlegend=False),
        curve(series.trend.mean, "level", line={"color": "@2", "width": 2, "shape": "hvh"}),
        points,
    ]
    layout = {
        "height": 260,
        "xaxis": {"type": "category", "nticks": 12},
        "yaxis": {
            "title": {
                "text": f"{parameter_label(series.name)} ({scale.unit})" if scale.unit else parameter_label(series.name)
            }
        },
    }
    return {"data": data, "layout": layout}
