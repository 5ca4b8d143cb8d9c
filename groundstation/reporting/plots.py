"""Matplotlib figures of results, for notebooks and papers.

The report's figures are interactive and live in :mod:`.figures`.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from groundstation.diagnosis.results import Diagnosis
from groundstation.flightdata import FlightData
from groundstation.frames import euler_from_quat, quat_normalise
from groundstation.identification.results import Estimate, Identification
from groundstation.model.prediction import QUANTITIES, Prediction
from groundstation.reporting.units import label, scale_for, split_unit
from groundstation.trajectory import Plan

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Plottable = FlightData | Plan | Identification | Diagnosis | Prediction
BLUE, RED, GREY = "#1f6fb2", "#d1495b", "#667080"


class Drawing(Figure):
    """A figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png", dpi=100, metadata={"Software": None})
        return out.getvalue()


def plot(result: Plottable, flight: FlightData | None = None) -> Figure:
    """The figure of a result, by its type."""
    for kind, draw in _DRAW.items():
        if isinstance(result, kind):
            figure = draw(result, flight) if draw is _identification else draw(result)
            for axes in figure.axes:
                axes.spines[["top", "right"]].set_visible(False)
            return figure
    raise TypeError(f"no figure of a {type(result).__name__}; there are {', '.join(k.__name__ for k in _DRAW)}.")


def _identification(found: Identification, flight: FlightData | None) -> Figure:
    """Each parameter in a row of its own: value and 95 % interval, the declared and the true value where they are
    known.
    """
    marks: dict[str, tuple[Mapping[str, float], str, str]] = {}
    if flight is not None:
        marks["declared"] = (flight.vehicle.parameters(), "|", GREY)
    if flight is not None and flight.truth is not None:
        marks["true"] = (flight.truth.parameters(), "x", RED)
    best = found.methods[found.best].parameters
    figure = Drawing(figsize=(8.0, 0.55 * len(best) + 0.9), layout="constrained")
    grid = figure.subplots(len(best), 1, squeeze=False)
    for axes, (name, estimate) in zip(grid[:, 0], best.items(), strict=True):
        _interval_row(
            axes,
            name,
            estimate,
            {key: (v[name], marker, colour) for key, (v, marker, colour) in marks.items() if name in v},
        )
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    figure.suptitle(f"{found.flight}: {found.best}, 95 % intervals", fontsize=10)
    return figure


def _interval_row(axes: Axes, name: str, estimate: Estimate, marks: Mapping[str, tuple[float, str, str]]) -> None:
    scale = scale_for(split_unit(name)[1], [estimate.value])
    low, high = (scale.factor * bound for bound in estimate.ci95)
    axes.plot([low, high], [0, 0], color=BLUE, linewidth=3, solid_capstyle="butt")
    axes.plot([scale.factor * estimate.value], [0], "o", color=BLUE, markersize=5, label="estimate, 95 % interval")
    for key, (value, marker, colour) in marks.items():
        axes.plot(
            [scale.factor * value], [0], marker, color=colour, markersize=11, markeredgewidth=2, label=key, linestyle=""
        )
    axes.set_yticks([0], [f"{label(name)} ({scale.unit})"])
    axes.margins(x=0.1 if marks else 0.6)
    axes.ticklabel_format(axis="x", useOffset=False, style="plain")
    axes.tick_params(axis="x", labelsize=7, pad=1)
    axes.locator_params(axis="x", nbins=5)


def _diagnosis(found: Diagnosis) -> Figure:
    """RMS error of each channel on data that no estimate saw: before and after."""
    stages = found.error.get("held_out", {})
    drawn = {stage: stages[stage] for stage in ("nominal", "before", "after") if stages.get(stage)}
    figure = Drawing(figsize=(8.0, 3.0), layout="constrained")
    force, torque = figure.subplots(1, 2)
    for axes, unit, title in ((force, "_n", "force (N)"), (torque, "_nm", "torque (N m)")):
        channels = [c for c in drawn.get("before", {}) if c.endswith(unit)]
        _bars(axes, {stage: [values.get(c, np.nan) for c in channels] for stage, values in drawn.items()})
        axes.set_xticks(range(len(channels)), [label(c) for c in channels])
        axes.set_title(f"RMS {title}", fontsize=10)
    force.legend(frameon=False, fontsize=8)
    figure.suptitle(f"{found.flight}: {found.verdict}", fontsize=10)
    return figure


def _bars(axes: Axes, groups: Mapping[str, list[float]]) -> None:
    width = 0.8 / max(len(groups), 1)
    for number, (stage, values) in enumerate(groups.items()):
        at = np.arange(len(values)) + width * (number - 0.5 * (len(groups) - 1))
        axes.bar(at, values, width, label=stage, color=(GREY, RED, BLUE)[number % 3])


def _flight(flight: FlightData) -> Figure:
    """The path from above and in height, and the tilt."""
    poses = flight.mocap if flight.mocap is not None else flight.state
    figure = Drawing(figsize=(9.0, 3.0), layout="constrained")
    if poses is None:
        axes = figure.subplots()
        for name, values in zip(flight.motors.columns, flight.motors.values.T, strict=True):
            axes.plot(flight.motors.t_s, values, linewidth=0.7, label=name)
        axes.set(xlabel="time (s)", ylabel="motors", title="No pose was recorded")
        axes.legend(frameon=False, fontsize=8)
        return figure
    above, height, tilt = figure.subplots(1, 3)
    x, y, z = (poses.column(f"{axis}_m") for axis in "xyz")
    euler = euler_from_quat(quat_normalise(np.column_stack([poses.column(c) for c in ("qw", "qx", "qy", "qz")])))
    above.plot(x, y, color=BLUE, linewidth=0.8)
    above.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    height.plot(poses.t_s, z, color=BLUE, linewidth=0.8)
    height.set(xlabel="time (s)", ylabel="z (m)")
    cosine = np.clip(np.cos(euler[:, 0]) * np.cos(euler[:, 1]), -1.0, 1.0)
    tilt.plot(poses.t_s, np.degrees(np.arccos(cosine)), color=BLUE, linewidth=0.8)
    tilt.set(xlabel="time (s)", ylabel="tilt (°)")
    return figure


def _plan(plan: Plan) -> Figure:
    """Position and yaw over the excitation."""
    series = plan.series()
    t_s = np.linspace(0.0, series.duration_s, 1000)
    flat = series.sample(t_s)
    figure = Drawing(figsize=(8.0, 3.0), layout="constrained")
    axes = figure.subplots()
    for name, values, colour in zip("xyz", flat.position[0].T, (BLUE, RED, "#2e8b57"), strict=True):
        axes.plot(t_s, values, label=f"{name} (m)", color=colour, linewidth=1.0)
    axes.plot(t_s, flat.yaw[0], label="yaw (rad)", color=GREY, linewidth=1.0, linestyle="--")
    axes.set(xlabel="time (s)", ylabel="plan")
    axes.legend(frameon=False, fontsize=8, ncols=4, loc="upper right")
    return figure


def _prediction(found: Prediction) -> Figure:
    """RMS error by horizon, one panel per quantity."""
    horizons = [float(h) for h in found.error["model"]]
    figure = Drawing(figsize=(9.0, 2.8), layout="constrained")
    for axes, quantity in zip(figure.subplots(1, len(QUANTITIES)), QUANTITIES, strict=True):
        for (name, by), colour in zip(found.error.items(), (BLUE, RED, GREY), strict=False):
            axes.loglog(
                horizons, [e[quantity]["rms"] for e in by.values()], "o-", label=name, color=colour, markersize=3
            )
        axes.set(xlabel="horizon (s)", title=f"{label(quantity)} ({split_unit(quantity)[1]})")
        axes.title.set_fontsize(9)
    figure.axes[0].legend(frameon=False, fontsize=7)
    return figure


_DRAW: Mapping[type, Callable[..., Figure]] = {
    FlightData: _flight,
    Plan: _plan,
    Identification: _identification,
    Diagnosis: _diagnosis,
    Prediction: _prediction,
}
