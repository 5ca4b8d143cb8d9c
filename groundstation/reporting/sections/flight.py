"""What was flown: path, attitude, tracking, rotors, battery."""

from __future__ import annotations

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


def add_flight(page: Page, flight: FlightData, identification: Identification | None) -> None:
    """Path and attitude where there are poses; rotors and battery where they were recorded."""
    motion = flown(flight, identification.clock if identification else None)
    shapes = _bands(identification)
    parts: list[Markup | None] = []
    if motion is None:
        parts.append(
            element("p", "No pose was recorded: position, attitude and tracking cannot be shown.", class_="note")
        )
    else:
        parts += [
            _paths(page, motion, identification),
            _attitude(page, motion, shapes),
            _tracking(page, motion, identification, shapes),
        ]
    parts += [_motors(page, flight, shapes), _battery(page, flight, shapes)]
    page.section("flown", "What was flown", *parts)


def _bands(identification: Identification | None) -> list[dict]:
    """Excluded segments, shaded."""
    return [figures.shade(a, b) for a, b in identification.excluded_s] if identification else []


def in_window(t_s: Array, identification: Identification | None) -> NDArray[np.bool_]:
    """Samples inside the analysed window; all of them where none is stated."""
    if identification is None or identification.window_s[1] <= identification.window_s[0]:
        return np.ones(len(t_s), dtype=bool)
    start, end = identification.window_s
    return (t_s >= start) & (t_s <= end)


def _paths(page: Page, motion: Flown, identification: Identification | None) -> Markup:
    here = in_window(motion.t_s, identification)
    here = here if here.sum() > 1 else np.ones(len(here), dtype=bool)
    path = _broken(motion.t_s[here], motion.position_m[here])
    wanted = _broken(motion.t_s[here], motion.wanted[here, :3]) if motion.wanted is not None else None
    part = "in the analysed part of the flight" if here.sum() < len(here) else "over the whole flight"
    return element(
        "div",
        page.figure(
            figures.path_figure(path, wanted), f"The path {part}, from {motion.source}. Drag to turn, scroll to zoom."
        ),
        page.figure(figures.plane_figure(path, wanted, 0, 1), "The same from above, equal scales."),
        class_="pair",
    )


def _broken(t_s: Array, points: Array) -> Array:
    """NaN rows in the gaps of a path, so that no line is drawn across what was not seen."""
    step = np.diff(t_s)
    cuts = np.flatnonzero(step > 5.0 * np.median(step)) + 1 if len(step) else []
    return np.insert(points, cuts, np.nan, axis=0)


def _attitude(page: Page, motion: Flown, shapes: list[dict]) -> Markup:
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
            figures.time_figure(lines, "angle (°)", shapes=shapes),
            f"Tilt; at most {significant(float(np.nanmax(tilt)), 3)}°.",
        ),
        page.figure(figures.time_figure(yaw, "yaw (°)", shapes=shapes), "Yaw."),
        class_="pair",
    )


def _tracking(page: Page, motion: Flown, identification: Identification | None, shapes: list[dict]) -> Markup | None:
    error = motion.tracking_error()
    if error is None:
        return element("p", "No setpoints and no plan were recorded: tracking cannot be judged.", class_="note")
    here = in_window(motion.t_s, identification) & np.isfinite(error).all(axis=1)
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
        page.figure(figures.time_figure(lines, "flown − wanted (mm)", shapes=shapes), "Position error."),
        summary,
    )


def _motors(page: Page, flight: FlightData, shapes: list[dict]) -> Markup:
    kind = flight.vehicle.rotors.input
    titles = {"rotor_speed": "rotor speed (rad/s)", "command": "command", "wrench": "wrench (N, N m)"}
    names = flight.motors.columns if kind == "wrench" else [f"rotor {i + 1}" for i in range(len(flight.motors.columns))]
    lines = [
        figures.trace(flight.motors.t_s, flight.motors.values[:, i], name.replace("_", " "), i)
        for i, name in enumerate(names)
        if i < flight.motors.values.shape[1]
    ]
    caption = "What drove the vehicle, on the motors' clock"
    caption += (
        " (as commanded, not measured)."
        if kind != "rotor_speed" or flight.vehicle.rotors.speed_source == "command"
        else " (measured)."
    )
    return fragment(
        element("h3", "Rotors"), page.figure(figures.time_figure(lines, titles[kind], shapes=shapes), caption)
    )


def _battery(page: Page, flight: FlightData, shapes: list[dict]) -> Markup | None:
    if flight.battery is None or len(flight.battery) < 2:
        return None
    lines = [figures.trace(flight.battery.t_s, flight.battery.column("voltage_v"), "voltage", 0)]
    figure = figures.time_figure(lines, "voltage (V)", shapes=shapes, height=220)
    return page.figure(figure, "Battery at the terminals.")
