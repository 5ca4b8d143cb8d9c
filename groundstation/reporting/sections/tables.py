"""Tables that more than one section needs: estimates with intervals, RMS errors with their improvement."""

from __future__ import annotations

from collections.abc import Mapping

from groundstation.identification.results import Estimate
from groundstation.reporting.markup import Child, Markup, element, fragment, table
from groundstation.reporting.units import (
    Scale,
    beyond_rounding,
    decimals,
    fixed,
    half_width,
    label,
    percent,
    scale_for,
    significant,
    split_unit,
)

UNCHANGED = 0.0005
"""Relative changes below this would be written as 0.0 %."""


def estimate_cell(name: str, estimate: Estimate | None, scale: Scale | None = None, note: Child = None) -> Markup:
    """Value with its 95 % interval below; digits follow from the interval. The unit is in the row's heading."""
    if estimate is None:
        return fragment("–", element("small", "not revealed"))
    scale = scale or Scale(1.0, split_unit(name)[1])
    width = half_width(estimate) * scale.factor
    value = estimate.value * scale.factor
    if width <= 0.0:
        return fragment(significant(value, 4), note)
    places = decimals(width)
    low, high = (bound * scale.factor for bound in estimate.ci95)
    interval = element("small", f"{fixed(low, places)} … {fixed(high, places)}")
    return fragment(fixed(value, places), interval, note)


def row_name(name: str, scale: Scale) -> Markup:
    """A parameter's name with the unit its row is written in."""
    return fragment(label(name), element("small", scale.unit) if scale.unit else None)


def error_table(
    caption: str, sets: Mapping[str, Mapping[str, float]], *, reference: str, improved: str | None = None
) -> Markup:
    """RMS errors by signal (rows) and parameter set (columns), each with its change from ``reference``.

    The change is 100 (RMS / RMS of the reference - 1), the seed paper's improvement (Tables 4-6) with the sign of what
    the error did: negative where it fell. Columns left of the reference get none.
    """
    signals = list(dict.fromkeys(signal for errors in sets.values() for signal in errors))
    columns = list(sets)
    rows = []
    sets = {name: {s: beyond_rounding(v) for s, v in errors.items()} for name, errors in sets.items()}
    for signal in signals:
        scale = scale_for(split_unit(signal)[1], [errors.get(signal, 0.0) for errors in sets.values()])
        base = sets.get(reference, {}).get(signal)
        first = columns.index(reference) + 1 if reference in columns else len(columns)
        cells = [_error_cell(sets[c].get(signal), base if i >= first else None, scale) for i, c in enumerate(columns)]
        rows.append([row_name(signal, scale), *cells])
    highlight = 1 + columns.index(improved) if improved in columns else None
    return table(caption, ["signal", *columns], rows, highlight=highlight)


def _error_cell(value: float | None, base: float | None, scale: Scale) -> Markup:
    if value is None:
        return fragment("–")
    shown = significant(value * scale.factor)
    if base is None or base <= 0.0:
        return fragment(shown)
    growth = value / base - 1.0
    if abs(growth) < UNCHANGED:
        return fragment(shown, element("small", "unchanged"))
    kind, arrow = ("better", "▾") if growth < 0.0 else ("worse", "▴")
    change = percent(growth) if growth < 1.0 else f"{significant(value / base, 2)} ×"
    return fragment(shown, element("small", f"{arrow} {change}", class_=kind))
