"""What was flown: path, attitude, tracking, rotors, battery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import FlightData
from groundstation.identification.results import Identification
from groundstation.reporting import figures
from groundstation.reporting.markup import Markup, element, fragment, table
from groundstation.reporting.motion import Flown, flown
from groundstation.reporting.page import Page
from groundstation.reporting.units import significant

Array = NDArray[np.float64]
AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class View:
    """Where time figures start, and what they shade.

    Attributes:
        window_s: the analysed part; empty (0, 0) where none is stated.
        excluded_s: segments left out of the analysis.
    """

    window_s: tuple[float, float] = (0.0, 0.0)
    excluded_s: tuple[tuple[float, float], ...] = ()

    @property
    def partial(self) -> bool:
        """An analysed part is stated."""
        return self.window_s[1] > self.window_s[0]

    def holds(self, t_s: Array) -> NDArray[np.bool_]:
        """Samples inside the analysed part; all of them where none is stated, or where it holds fewer than two."""
        inside = (t_s >= self.window_s[0]) & (t_s <= self.window_s[1])
        return inside if self.partial and inside.sum() > 1 else np.ones(len(t_s), dtype=bool)

    def figure(self, lines: list[dict], y_title: str, height: int = 300) -> figures.Figure:
        """Lines over time, starting on the analysed part, excluded segments shaded."""
        shapes = [figures.shade(a, b) for a, b in self.excluded_s]
        return figures.focus(figures.time_figure(lines, y_title, shapes=shapes, height=height), *self.window_s)


def add_flight(page: Page, flight: FlightData, identification: Identification | None) -> None:
    """Path and attitude where there are poses; rotors and battery where they were recorded."""
    motion = flown(flight, identification.clock if identification else None)
    view = View(identification.window_s, identification.excluded_s) if identification else View()
    partly = (
        "start on the analysed part, a double click shows the whole flight, and what is shaded is excluded; they"
        if view.partial
        else ""
    )
    hint = f"Figures over time {partly} zoom together: what is chosen on one is shown on all.".replace("  ", " ")
    parts: list[Markup | None] = [element("p", hint, class_="note")]
    if motion is None:
        text = "No pose was recorded: position, attitude and tracking cannot be shown."
        parts.append(element("p", text, class_="note"))
    else:
        parts += [_paths(page, motion, view), _attitude(page, motion, view), _tracking(page, motion, view)]
    parts += [_motors(page, flight, view), _battery(page, flight, view)]
    page.section("flown", "What was flown", *parts)


def _paths(page: Page, motion: Flown, view: View) -> Markup:
    here = view.holds(motion.t_s)
    path = _broken(motion.t_s[here], motion.position_m[here])
    wanted = _broken(motion.t_s[here], motion.wanted[here, :3]) if motion.wanted is not None else None
    part = "in the analysed part of the flight" if here.sum() < len(here) else "over the whole flight"
    return element(
        "div",
        page.figure(
            figures.path_figure(path, wanted),
            f"The path {part}, from {motion.source}. Drag to turn, scroll to zoom; the modebar's arrow turns it by "
            "itself.",
        ),
        page.figure(figures.plane_figure(path, wanted, 0, 1), "The same from above, equal scales."),
        class_="pair",
    )


def _broken(t_s: Array, points: Array) -> Array:
    """NaN rows in the gaps of a path, so that no line is drawn across what was not seen."""
    step = np.diff(t_s)
    cuts = np.flatnonzero(step > 5.0 * np.median(step)) + 1 if len(step) else []
    return np.insert(points, cuts, np.nan, axis=0)


def _attitude(page: Page, motion: Flown, view: View) -> Markup:
    degrees = np.degrees(motion.euler_rad)
    tilt = np.degrees(np.arccos(np.clip(np.cos(motion.euler_rad[:, 0]) * np.cos(motion.euler_rad[:, 1]), -1, 1)))
    lines = [figures.trace(motion.t_s, degrees[:, i], name, i) for i, name in enumerate(("roll", "pitch"))]
    lines.append(figures.trace(motion.t_s, tilt, "tilt", 2))
    yaw = [figures.trace(motion.t_s, degrees[:, 2], "yaw", 0)]
    if motion.wanted is not None:
        yaw.append(figures.trace(motion.t_s, np.degrees(motion.wanted[:, 3]), "wanted", 1))
    return element(
        "div",
        page.figure(
            view.figure(lines, "angle (°)"),
            f"Tilt; at most {significant(float(np.nanmax(tilt)), 3)}°.",
        ),
        page.figure(view.figure(yaw, "yaw (°)"), "Yaw."),
        class_="pair",
    )


def _tracking(page: Page, motion: Flown, view: View) -> Markup | None:
    error = motion.tracking_error()
    if error is None:
        return element("p", "No setpoints and no plan were recorded: tracking cannot be judged.", class_="note")
    here = view.holds(motion.t_s) & np.isfinite(error).all(axis=1)
    lines = [figures.trace(motion.t_s, 1e3 * error[:, i], axis, i) for i, axis in enumerate(AXES)]
    rows = []
    if here.any():
        scales = ((1e3, "mm"),) * 3 + ((180.0 / np.pi, "°"),)
        for i, (name, (factor, unit)) in enumerate(zip((*AXES, "yaw"), scales, strict=True)):
            e = factor * error[here, i]
            rows.append(
                (
                    f"{name} ({unit})",
                    *(significant(float(v)) for v in (np.sqrt(np.mean(e**2)), np.mean(e), np.max(np.abs(e)))),
                )
            )
    summary = (
        table(f"Tracking error over {here.sum()} poses of the analysed part.", ("axis", "RMS", "mean", "largest"), rows)
        if rows
        else None
    )
    return fragment(
        element("h3", "Tracking"),
        page.figure(view.figure(lines, "flown − wanted (mm)"), "Position error."),
        summary,
    )


def _motors(page: Page, flight: FlightData, view: View) -> Markup:
    kind = flight.vehicle.rotors.input
    titles = {"rotor_speed": "rotor speed (rad/s)", "command": "command", "wrench": "wrench (N, N m)"}
    names = flight.motors.columns if kind == "wrench" else [f"rotor {i + 1}" for i in range(len(flight.motors.columns))]
    solid = {"dash": "solid", "width": 1}
    lines, rows = [], []
    here = view.holds(flight.motors.t_s)
    for i, (name, values) in enumerate(zip(names, flight.motors.values.T, strict=True)):
        line = {**figures.line(i), **solid}  # dashes drown in the noise of a fast stream
        lines.append({**figures.trace(flight.motors.t_s, values, name.replace("_", " "), i), "line": line})
        numbers = (f(values[here]) for f in (np.nanmean, np.nanstd, np.nanmin, np.nanmax))
        rows.append((name.replace("_", " "), *(significant(float(v), 4) for v in numbers)))
    summary = table(
        f"{titles[kind].capitalize()} over {here.sum()} samples of the analysed part.",
        ("channel", "mean", "standard deviation", "smallest", "largest"),
        rows,
    )
    commanded = kind != "rotor_speed" or flight.vehicle.rotors.speed_source == "command"
    caption = (
        f"What drove the vehicle, on the motors' clock ({'as commanded, not measured' if commanded else 'measured'})."
    )
    return fragment(element("h3", "Rotors"), page.figure(view.figure(lines, titles[kind]), caption), summary)


def _battery(page: Page, flight: FlightData, view: View) -> Markup | None:
    if flight.battery is None or len(flight.battery) < 2:
        return None
    lines = [figures.trace(flight.battery.t_s, flight.battery.column("voltage_v"), "voltage", 0)]
    figure = view.figure(lines, "voltage (V)", height=220)
    return page.figure(figure, "Battery at the terminals.")
