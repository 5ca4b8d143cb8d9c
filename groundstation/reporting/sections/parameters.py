"""Parameters by method with intervals, beside what was declared and (in simulation) what was true."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from groundstation.flightdata import FlightData
from groundstation.identification.results import MASS_AND_TENSOR, Estimate, Identification
from groundstation.reporting import figures
from groundstation.reporting.markup import Markup, element, fragment, table
from groundstation.reporting.page import Page
from groundstation.reporting.sections.tables import estimate_cell, row_name
from groundstation.reporting.units import (
    Scale,
    half_width,
    label,
    percent,
    readable,
    scale_for,
    significant,
    split_unit,
)

LEAST_PART = 0.2
"""Parts of a combination that are left out of its name."""


def add_parameters(page: Page, flight: FlightData, identification: Identification) -> None:
    """Tables and dot-and-whisker panels."""
    nominal = flight.vehicle.parameters()
    truth = flight.truth.parameters() if flight.truth is not None else {}
    anchor = (
        "The declared rotor constants fix the scale; mass and inertia are estimated against them."
        if identification.anchor == "thrust"
        else "The declared mass fixes the scale; the rotor constants are estimated against it."
    )
    best = element("p", element("strong", f"Best: {identification.best}. "), reason(identification))
    page.section(
        "parameters",
        "Parameters",
        best,
        element("p", anchor, class_="note"),
        _method_table(identification, nominal, truth),
        _panels(page, identification, nominal, truth),
        _notes(identification),
        _model_table(identification, nominal, truth),
        _revealed(identification),
        _not_identifiable(identification),
    )


def reason(identification: Identification) -> str:
    """Why the best method is the best, as a sentence of its own."""
    text = identification.best_reason.removeprefix(f"{identification.best}:").strip()
    return readable(text[:1].upper() + text[1:])


def _ordered(identification: Identification) -> list[str]:
    """Methods, the best one first."""
    rest = [name for name in identification.methods if name != identification.best]
    return ([identification.best] if identification.best in identification.methods else []) + rest


def _tensor_scale(identification: Identification, nominal: Mapping[str, float]) -> Scale:
    """One power of ten for the whole tensor, from nominal and the best method: others may be far off."""
    best = identification.methods.get(identification.best)
    sizes = [v for n, v in nominal.items() if n.endswith("kg_m2")]
    sizes += [e.value for n, e in best.parameters.items() if n.endswith("kg_m2")] if best else []
    return scale_for("kg m²", sizes)


def parameter_scale(name: str, identification: Identification, nominal: Mapping[str, float]) -> Scale:
    """One scale for a parameter in all its columns and figures."""
    if name.endswith("kg_m2"):
        return _tensor_scale(identification, nominal)
    estimates = [m.parameters[name] for m in identification.methods.values() if name in m.parameters]
    estimates += [identification.model[name]] if name in identification.model else []
    sizes = [nominal.get(name, 0.0), *(max(abs(e.value), half_width(e)) for e in estimates)]
    return scale_for(split_unit(name)[1], sizes)


def _against_truth(name: str, estimate: Estimate, truth: Mapping[str, float]) -> Markup | None:
    """Error against the truth (products: as a share of the trace), and whether the interval holds it."""
    if name not in truth:
        return None
    true = truth[name]
    trace = sum(truth[f"i{a}_kg_m2"] for a in ("xx", "yy", "zz"))
    product = name in {"ixy_kg_m2", "ixz_kg_m2", "iyz_kg_m2"}
    size = trace if product else abs(true)
    if size == 0.0:
        return None
    holds = estimate.ci95[0] <= true <= estimate.ci95[1]
    mark = "✓ holds the truth" if holds else "✕ misses the truth"
    text = f"{percent((estimate.value - true) / size, 2)}{' of trace' if product else ''} {mark[0]}"
    return element("small", text, class_="better" if holds else "worse", title=mark)


def _method_table(identification: Identification, nominal: Mapping[str, float], truth: Mapping[str, float]) -> Markup:
    """One row per parameter; next to its name the best method, then its bound, nominal and truth, then the others."""

    def method_column(method: str) -> Callable[[str, Scale], Markup]:
        def cell(name: str, scale: Scale) -> Markup:
            estimate = identification.methods[method].parameters.get(name)
            note = _against_truth(name, estimate, truth) if estimate is not None else None
            return estimate_cell(name, estimate, scale, note)

        return cell

    columns: dict[str, Callable[[str, Scale], Markup | str]] = {}
    names = {f"{m}, best" if m == identification.best else m: m for m in _ordered(identification)}
    methods = {header: method_column(method) for header, method in names.items()}
    columns |= dict(list(methods.items())[:1])
    if identification.bound:
        columns["Cramér–Rao bound"] = lambda name, scale: _bound_cell(identification, name, scale)
    columns["nominal"] = lambda name, scale: _plain(nominal.get(name), scale)
    if truth:
        columns["true"] = lambda name, scale: _plain(truth.get(name), scale)
    columns |= methods

    extra = {n for m in identification.methods.values() for n in m.parameters} - set(MASS_AND_TENSOR)
    rows: list[list[Markup | str]] = []
    for name in (*MASS_AND_TENSOR, *sorted(extra)):
        scale = parameter_scale(name, identification, nominal)
        rows.append([row_name(name, scale), *(cell(name, scale) for cell in columns.values())])
    conditions = {header: identification.methods[method].condition_number for header, method in names.items()}
    if any(c is not None for c in conditions.values()):
        numbers = [conditions.get(header) for header in columns]
        rows.append(["condition number", *(significant(c) if c is not None else "" for c in numbers)])
    caption = "Estimates with their 95 % intervals below."
    if truth:
        caption += " Third line: error against the simulated truth; ✓ the interval holds it, ✕ it does not."
    if identification.bound:
        caption += " The bound is the least standard deviation any unbiased estimator can reach on this flight."
    return table(caption, ["parameter", *columns], rows, highlight=1 if identification.best in names.values() else None)


def _bound_cell(identification: Identification, name: str, scale: Scale) -> Markup:
    """The bound, and how many times wider the best method's standard deviation is."""
    bound = identification.bound.get(name)
    if bound is None or bound <= 0.0:
        return fragment("–")
    best = identification.methods.get(identification.best)
    estimate = best.parameters.get(name) if best else None
    ratio = f"{identification.best}: {significant(estimate.std / bound, 2)} ×" if estimate else None
    return fragment(significant(bound * scale.factor, 2), element("small", ratio) if ratio else None)


def _plain(value: float | None, scale: Scale) -> str:
    """A declared or true value, without the zeros nobody wrote."""
    if value is None:
        return "–"
    text = significant(value * scale.factor, 5)
    return text.rstrip("0").rstrip(".") if "." in text and "·" not in text else text


def _panels(
    page: Page, identification: Identification, nominal: Mapping[str, float], truth: Mapping[str, float]
) -> Markup:
    methods = _ordered(identification)
    panels = []
    for name in MASS_AND_TENSOR:
        scale = parameter_scale(name, identification, nominal)
        intervals = {}
        for method in methods:
            estimate = identification.methods[method].parameters.get(name)
            if estimate is not None:
                value, low, high = (scale.factor * v for v in (estimate.value, *estimate.ci95))
                intervals[method] = (value, low, high)
        if not intervals:
            continue
        marks = [scale.factor * source[name] if name in source else None for source in (nominal, truth)]
        figure = figures.interval_figure(intervals, list(identification.methods), marks[0], marks[1], scale.unit)
        panels.append(page.figure(figure, label(name)))
    true = ", solid line: truth" if truth else ""
    return fragment(
        element("h3", "Methods side by side"),
        element("p", f"Dot: estimate, whisker: 95 % interval, dashed line: nominal{true}.", class_="note"),
        element("div", panels, class_="small"),
    )


def _notes(identification: Identification) -> Markup | None:
    """What the methods have to say, methods that say the same together."""
    methods: dict[str, list[str]] = {}
    for name, method in identification.methods.items():
        if method.note:
            methods.setdefault(method.note, []).append(name)
    items = [
        element("li", element("strong", f"{', '.join(names)}: "), readable(note)) for note, names in methods.items()
    ]
    return element("ul", items) if items else None


def _model_table(
    identification: Identification, nominal: Mapping[str, float], truth: Mapping[str, float]
) -> Markup | None:
    if not identification.model:
        return None
    rows = []
    for name, estimate in identification.model.items():
        scale = parameter_scale(name, identification, nominal)
        row = [row_name(name, scale), _plain(nominal.get(name), scale)]
        row += [_plain(truth.get(name), scale)] if truth else []
        row += [estimate_cell(name, estimate, scale, _against_truth(name, estimate, truth))]
        rows.append(row)
    header = ["parameter", "declared", *(["true"] if truth else []), "estimate"]
    caption = f"The rest of the model, estimated together with mass and inertia ({identification.best})."
    return fragment(
        element("h3", "Rotors, delays and sensors"), table(caption, header, rows, highlight=len(header) - 1)
    )


def _revealed(identification: Identification) -> Markup | None:
    """Combinations of parameters by how strongly the motion acts on them, the strongest first."""
    if not identification.revealed:
        return None
    rows = []
    for each in identification.revealed:
        parts = sorted(each.combination.items(), key=lambda item: -abs(item[1]))
        top = parts[0][1] or 1.0
        words = [f"{value / top:+.1f} {label(name)}" for name, value in parts if abs(value / top) > LEAST_PART]
        rows.append((" ".join(words).removeprefix("+1.0 "), f"{significant(100.0 * each.share, 2)} %"))
    caption = (
        "Combinations of mass and tensor, each in units of its declared value (products: of the trace), by the torque "
        "or force that all of it makes in this motion, as a share of weight (times arm). From singular values, before "
        "any fit. A flight's disturbance is usually 0.1 % and more."
    )
    return fragment(
        element("h3", "What this motion acts on"), table(caption, ("combination", "share"), rows, class_="text")
    )


def _not_identifiable(identification: Identification) -> Markup | None:
    if not identification.not_identifiable:
        return None
    rows = [(label(name), readable(remedy) or "–") for name, remedy in identification.not_identifiable.items()]
    caption = "These get no number, because any number would be a guess."
    return fragment(
        element("h3", "What this flight does not reveal"),
        table(caption, ("parameter", "what would reveal it"), rows, class_="text"),
    )
