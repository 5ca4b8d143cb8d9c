"""Figures as plotly documents (data and layout), drawn in the browser. Colours are names ("@1") that the page resolves.

Long series are thinned to their envelope: every bin keeps its smallest and its largest sample at their own times, so
that no peak is lost and nothing is averaged.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.json_types import JsonObject

Array = NDArray[np.float64]
Figure = dict[str, Any]

DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
MARKERS = ("circle", "square", "diamond", "triangle-up", "triangle-down", "cross", "x", "star")
COLOURS = 8


def envelope(t_s: Array, values: Array, bins: int = 1000) -> tuple[Array, Array]:
    """Thin a series to at most two samples per bin, the smallest and the largest, in time order.

    A gap (over five median intervals) leaves a NaN between the samples around it, so that no line is drawn across.

    Args:
        t_s: times, increasing, shape (k,).
        values: samples, shape (k,).
        bins: number of equal bins of samples.

    Returns:
        Times and values, each of at most 2 bins samples plus one per gap.
    """
    t, y = np.asarray(t_s, dtype=float), np.asarray(values, dtype=float)
    finite = np.isfinite(t) & np.isfinite(y)
    t, y = t[finite], y[finite]
    if len(t) < 2:
        return t, y
    step = np.diff(t)
    gap = step > 5.0 * np.median(step)
    keep = np.arange(len(t))
    if len(t) > 2 * bins:
        edges = np.linspace(0, len(t), bins + 1).astype(int)
        pairs = [(a + int(np.argmin(y[a:b])), a + int(np.argmax(y[a:b]))) for a, b in itertools.pairwise(edges)]
        after_gap = np.flatnonzero(gap)
        keep = np.unique(np.concatenate([np.ravel(pairs), after_gap, after_gap + 1]).astype(int))
    breaks = np.searchsorted(keep, np.flatnonzero(gap) + 1)
    return np.insert(t[keep], breaks, np.nan), np.insert(y[keep], breaks, np.nan)


def rounded(values: Array, digits: int = 5) -> list[float | None]:
    """Numbers for JSON: significant digits relative to the largest, None for what is not finite."""
    y = np.asarray(values, dtype=float)
    finite = np.isfinite(y)
    largest = float(np.max(np.abs(y[finite]), initial=0.0))
    places = digits - 1 - math.floor(math.log10(largest)) if largest > 0.0 else 0
    return [round(float(v), places) if ok else None for v, ok in zip(y, finite, strict=True)]


def trace(t_s: Array, values: Array, name: str, style: int, **extra: Any) -> JsonObject:
    """A thinned line. ``style`` picks colour and dash together."""
    t, y = envelope(t_s, values)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": rounded(t, 7),
        "y": rounded(y),
        "connectgaps": False,
        "line": line(style),
        **extra,
    }


def line(style: int, width: float = 1.6) -> JsonObject:
    """Colour and dash of a style."""
    return {"color": f"@{style % COLOURS + 1}", "dash": DASHES[style % len(DASHES)], "width": width}


def reference(value: float, text: str, dash: str) -> JsonObject:
    """A horizontal line at a value, for layouts' ``shapes``."""
    shape = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": value, "y1": value}
    return {**shape, "line": {"color": "@muted", "width": 1.2, "dash": dash}, "name": text}


def shade(start: float, end: float) -> JsonObject:
    """A grey band between two times, for layouts' ``shapes``."""
    return {
        "type": "rect", "xref": "x", "yref": "paper", "x0": start, "x1": end, "y0": 0, "y1": 1,
        "fillcolor": "@shade", "line": {"width": 0}, "layer": "below",
    }  # fmt: skip


def time_figure(
    traces: Sequence[JsonObject],
    y_title: str,
    *,
    shapes: Sequence[JsonObject] = (),
    x_title: str = "time (s)",
    height: int = 300,
) -> Figure:
    """Lines over time."""
    return {
        "data": list(traces),
        "layout": {
            "height": height,
            "xaxis": {"title": {"text": x_title}},
            "yaxis": {"title": {"text": y_title}},
            "shapes": list(shapes),
            "hovermode": "x unified",
        },
    }


def focus(figure: Figure, start_s: float, end_s: float) -> Figure:
    """Start a time figure on a part of it; both axes fit what is drawn there (a double click shows the whole)."""
    if end_s <= start_s:
        return figure
    seen = [
        value
        for drawn in figure["data"]
        for t, value in zip(drawn["x"], drawn["y"], strict=True)
        if t is not None and value is not None and start_s <= t <= end_s
    ]
    if not seen:
        return figure
    margin = 0.08 * (max(seen) - min(seen)) or 0.05 * abs(seen[0]) or 1.0
    layout = figure["layout"]
    layout["xaxis"] = {**layout["xaxis"], "range": [start_s, end_s]}
    layout["yaxis"] = {**layout["yaxis"], "range": [min(seen) - margin, max(seen) + margin]}
    return figure


def path_figure(flown: Array, wanted: Array | None) -> Figure:
    """The path in three dimensions at equal scales, flown and wanted, shape (k, 3)."""
    drawn = {"flown": flown} if wanted is None else {"flown": flown, "wanted": wanted}
    points = np.concatenate(list(drawn.values()))
    points = points[np.isfinite(points).all(axis=1)]
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.ones(3))
    half = 0.55 * max(float(np.max(high - low)), 0.01)
    axes = {
        f"{name}axis": {"title": {"text": f"{name} (m)"}, "range": [round(middle - half, 4), round(middle + half, 4)]}
        for name, middle in zip("xyz", (0.5 * (low + high)).tolist(), strict=True)
    }
    camera = {"eye": {"x": 1.5, "y": -1.5, "z": 0.9}, "center": {"x": 0, "y": 0, "z": -0.1}}
    data = [_path_3d(part, name, i) for i, (name, part) in enumerate(drawn.items())]
    return {
        "data": data,
        "layout": {"height": 440, "scene": {"aspectmode": "cube", "dragmode": "turntable", "camera": camera, **axes}},
    }


def _path_3d(points: Array, name: str, style: int) -> JsonObject:
    thin = points[:: max(1, len(points) // 2500)]
    x, y, z = (rounded(thin[:, i]) for i in range(3))
    return {"type": "scatter3d", "mode": "lines", "name": name, "x": x, "y": y, "z": z, "line": line(style, 4)}


def plane_figure(flown: Array, wanted: Array | None, across: int, up: int) -> Figure:
    """A projection of the path with equal scales; ``across`` and ``up`` are axis numbers."""
    names = ("x (m)", "y (m)", "z (m)")

    def projected(points: Array, name: str, style: int) -> JsonObject:
        thin = points[:: max(1, len(points) // 2500)]
        return {
            "type": "scatter", "mode": "lines", "name": name, "line": line(style),
            "x": rounded(thin[:, across]), "y": rounded(thin[:, up]),
        }  # fmt: skip

    data = [projected(flown, "flown", 0)] + ([projected(wanted, "wanted", 1)] if wanted is not None else [])
    layout = {
        "height": 440,
        "xaxis": {"title": {"text": names[across]}},
        "yaxis": {"title": {"text": names[up]}, "scaleanchor": "x"},
    }
    return {"data": data, "layout": layout}


def bar_figure(groups: Mapping[str, Mapping[str, float]], title: str) -> Figure:
    """Bars side by side: group name -> {category: value}; patterns tell the groups apart without colour."""
    patterns = ("", "/", "x", ".", "-", "+")
    data = [
        {
            "type": "bar", "name": name, "x": list(values), "y": [float(v) for v in values.values()],
            "marker": {"color": f"@{i + 1}", "pattern": {"shape": patterns[i % len(patterns)], "solidity": 0.25}},
            "hovertemplate": "%{x}: %{y:.3g}<extra>" + name + "</extra>",
        }
        for i, (name, values) in enumerate(groups.items())
    ]  # fmt: skip
    return {
        "data": data,
        "layout": {"height": 320, "barmode": "group", "yaxis": {"title": {"text": title}, "rangemode": "tozero"}},
    }


def interval_figure(
    intervals: Mapping[str, tuple[float, float, float]],
    methods: Sequence[str],
    nominal: float | None,
    truth: float | None,
    unit: str,
) -> Figure:
    """Dot and whisker per method (value, low, high), nominal dashed, truth solid; ``methods`` fixes each one's
    style.
    """
    names = list(intervals)[::-1]
    data = [_interval(name, methods.index(name), *intervals[name]) for name in names]
    shapes = [
        {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": v, "x1": v,
         "line": {"color": colour, "width": width, "dash": dash}}
        for v, colour, dash, width in ((nominal, "@muted", "dash", 1.4), (truth, "@text", "solid", 1.6))
        if v is not None
    ]  # fmt: skip
    marks = [v for v in (nominal, truth) if v is not None]
    layout = {
        "height": 90 + 24 * len(names), "xaxis": {"title": {"text": unit}, "nticks": 5}, "shapes": shapes,
        "yaxis": {"type": "category", "categoryarray": names, "categoryorder": "array", "automargin": True},
    }  # fmt: skip
    if marks:  # an invisible marker keeps the reference lines inside the automatic range
        data.append({
            "type": "scatter", "mode": "markers", "x": marks, "y": [names[0]] * len(marks), "opacity": 0,
            "showlegend": False, "hoverinfo": "skip",
        })  # fmt: skip
    return {"data": data, "layout": layout}


def _interval(name: str, style: int, value: float, low: float, high: float) -> JsonObject:
    whisker = {
        "type": "data",
        "symmetric": False,
        "thickness": 2,
        "width": 5,
        "array": [high - value],
        "arrayminus": [value - low],
    }
    return {
        "type": "scatter",
        "mode": "markers",
        "x": [value],
        "y": [name],
        "name": name,
        "showlegend": False,
        "error_x": whisker,
        "marker": {"color": f"@{style % COLOURS + 1}", "symbol": MARKERS[style % len(MARKERS)], "size": 9},
    }


def spectrum(t_s: Array, values: Array) -> tuple[Array, Array]:
    """Amplitude density by Welch's method (Hann, eight segments or more) on a uniform grid: Hz, unit per root Hz."""
    from scipy.signal import welch

    t, y = np.asarray(t_s, dtype=float), np.asarray(values, dtype=float)
    finite = np.isfinite(t) & np.isfinite(y)
    t, y = t[finite], y[finite]
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], step)
    uniform = np.interp(grid, t, y)
    frequency, power = welch(uniform, fs=1.0 / step, nperseg=max(16, min(4096, len(grid) // 4)))
    return frequency[1:], np.sqrt(power[1:])


def spectrum_figure(series: Mapping[str, tuple[Array, Array]], unit: str) -> Figure:
    """Amplitude densities over frequency, both axes logarithmic."""
    data = [
        {"type": "scatter", "mode": "lines", "name": name, "x": rounded(f), "y": _logarithmic(a), "line": line(i)}
        for i, (name, (f, a)) in enumerate(series.items())
    ]
    layout = {
        "height": 300,
        "xaxis": {"type": "log", "title": {"text": "frequency (Hz)"}},
        "yaxis": {"type": "log", "title": {"text": f"{unit} / √Hz"}, "exponentformat": "power"},
    }
    return {"data": data, "layout": layout}


def _logarithmic(values: Array) -> list[float | None]:
    return [float(f"{v:.3e}") if np.isfinite(v) and v > 0.0 else None for v in values]


def coverage_figure(
    intervals: Mapping[str, Sequence[tuple[float, float]]], excluded: Sequence[tuple[float, float]]
) -> Figure:
    """One bar per uninterrupted stretch of each stream, so that gaps are seen; excluded segments are shaded."""
    data = []
    for name, stretches in list(intervals.items())[::-1]:
        x: list[float | None] = []
        for start, end in stretches:
            x += [round(start, 4), round(end, 4), None]
        data.append({
            "type": "scatter", "mode": "lines", "x": x, "y": [name] * len(x), "name": name, "showlegend": False,
            "line": {"color": "@1", "width": 12}, "connectgaps": False,
        })  # fmt: skip
    layout = {
        "height": 100 + 30 * len(data), "xaxis": {"title": {"text": "device time (s)"}},
        "yaxis": {"type": "category", "automargin": True}, "shapes": [shade(a, b) for a, b in excluded],
    }  # fmt: skip
    return {"data": data, "layout": layout}


def stretches(t_s: Array) -> list[tuple[float, float]]:
    """Uninterrupted parts of a stream: a step over five median intervals parts them."""
    t = np.asarray(t_s, dtype=float)
    if len(t) < 2:
        return [(float(v), float(v)) for v in t]
    step = np.diff(t)
    cuts = np.flatnonzero(step > 5.0 * np.median(step))
    starts = np.concatenate([[0], cuts + 1])
    ends = np.concatenate([cuts, [len(t) - 1]])
    return [(float(t[a]), float(t[b])) for a, b in zip(starts, ends, strict=True)]
