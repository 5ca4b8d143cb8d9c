"""The room to scale, from above and from the side: plan ahead, path flown, where the vehicle is, heights, walls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from textual_hires_canvas import Canvas, TextAlign

from groundstation.tui.margins import FlightLimits

Array = NDArray[np.float64]
PLAN, FLOWN, WALL, ROOM = "#808080", "#0087d7", "#d70000", "#5f8787"
HERE, WANTED = "◉", "+"
MARGIN = 0.08
"""Of the larger side, left free around what is shown."""
DOTS_X, DOTS_Y = 2, 4
"""Braille dots of a cell: squares on a terminal whose cells are twice as high as wide."""
LEAST_M = 0.5


@dataclass(frozen=True, slots=True)
class View:
    """A part of the canvas that shows two axes of the world at a scale.

    Attributes:
        axes: world axes to the right and up.
        left, top, width, height: in cells.
        centre: of what is shown, m.
        dots_m: braille dots to a metre.
    """

    axes: tuple[int, int]
    left: int
    top: int
    width: int
    height: int
    centre: tuple[float, float]
    dots_m: float

    def cells(self, points: Array) -> Array:
        """Positions in cells, shape (k, 2), of points in the world, shape (k, 3)."""
        across = (points[:, self.axes[0]] - self.centre[0]) * self.dots_m / DOTS_X + self.left + 0.5 * self.width
        down = (self.centre[1] - points[:, self.axes[1]]) * self.dots_m / DOTS_Y + self.top + 0.5 * self.height
        return np.column_stack([across, down])

    def holds(self, cells: Array) -> NDArray[np.bool_]:
        """Which of them lie inside."""
        x, y = cells.T
        right, bottom = self.left + self.width, self.top + self.height
        return (x >= self.left) & (x < right) & (y >= self.top) & (y < bottom)


def layout(width: int, height: int, low: Array, high: Array) -> tuple[View, View]:
    """The view from above (y up) and from the side (z up), at one scale, beside or below each other, whichever is
    larger.
    """
    size = np.maximum(high - low, LEAST_M)
    x, y, z = (float(v) for v in size * (1.0 + 2.0 * MARGIN))
    above_rows = max(1, min(height - 2, round((height - 1) * y / (y + z))))
    below = min(DOTS_X * width / x, DOTS_Y * above_rows / y, DOTS_Y * (height - 1 - above_rows) / z)
    half = (width - 1) // 2
    beside = min(DOTS_X * half / x, DOTS_Y * height / max(y, z))
    middle = 0.5 * (low + high)
    over, side = (float(middle[0]), float(middle[1])), (float(middle[0]), float(middle[2]))
    if below >= beside:
        rest = height - 1 - above_rows
        return View((0, 1), 0, 0, width, above_rows, over, below), View(
            (0, 2), 0, above_rows + 1, width, rest, side, below
        )
    return View((0, 1), 0, 0, half, height, over, beside), View(
        (0, 2), half + 1, 0, width - half - 1, height, side, beside
    )


ZOOMS = ("room", "path", "box")
TITLES = {
    "room": "the plan's room: above, side",
    "path": "the path close up: above, side",
    "box": "the guard's box: above, side",
}


def extent(limits: FlightLimits, flown: Array, zoom: str) -> tuple[Array, Array]:
    """Lowest and highest corner of what is shown.

    Of "room" the plan with its room and the floor, of "path" the plan alone, of "box" also the guard's box. Without any
    of them it is what was flown, or the origin.
    """
    path = np.asarray(limits.path, dtype=float).reshape(-1, 3)
    points = [path, flown if zoom != "path" or not len(path) else path]
    if zoom != "path" or not any(map(len, points)):
        points.append(np.zeros((1, 3)))
    room = limits.room
    x, y = room.get("x_max_m"), room.get("y_max_m")
    if zoom != "path" and x and y:
        points.append(np.array([[-x, -y, 0.0], [x, y, room.get("z_max_m", 0.0)]]))
    if zoom == "box" and limits.box:
        points.append(np.array(limits.box).T)
    every = np.vstack([p.reshape(-1, 3) for p in points])
    every = every[np.isfinite(every).all(axis=1)]
    return every.min(axis=0), every.max(axis=0)


class RoomView(Canvas):
    """The canvas. It takes no focus, so that the screens' keys stay theirs."""

    can_focus = False

    def __init__(self, id: str):
        super().__init__(id=id)
        self._zoom = 0
        self.border_title = TITLES[ZOOMS[0]]
        self._drawn: tuple[FlightLimits, Array, Array | None, Array | None] | None = None

    def next_zoom(self) -> None:
        """Another part of the world."""
        self._zoom = (self._zoom + 1) % len(ZOOMS)
        self.border_title = TITLES[ZOOMS[self._zoom]]

    def show(self, limits: FlightLimits, flown: Array, here: Array | None, wanted: Array | None) -> None:
        """Draw the room.

        Args:
            limits: of the flight, with the planned path.
            flown: positions so far, shape (k, 3).
            here, wanted: where the vehicle is and should be, shape (3,); None on the ground.
        """
        self._drawn = (limits, flown, here, wanted)
        self._draw()

    def on_resize(self) -> None:
        """Draw it again at the new size."""
        self._draw()

    def _draw(self) -> None:
        if self._drawn is None or min(self.size) < 8:
            return
        limits, flown, here, wanted = self._drawn
        with self.batch_refresh():
            self.reset(self.size, refresh=False)
            for view in layout(self.size.width, self.size.height, *extent(limits, flown, ZOOMS[self._zoom])):
                self._walls(view, limits)
                self._path(view, np.asarray(limits.path, dtype=float).reshape(-1, 3), PLAN)
                self._path(view, flown, FLOWN)
                self._marker(view, wanted, WANTED)
                self._marker(view, here, HERE)
                self._words(view, here)

    def _walls(self, view: View, limits: FlightLimits) -> None:
        room, box = limits.room, limits.box
        x, y = room.get("x_max_m"), room.get("y_max_m")
        if x and y:
            low, high = (-x, -y, room.get("z_min_m", 0.0)), (x, y, room.get("z_max_m", 0.0))
            self._rectangle(view, np.array([low, high]), ROOM)
        if box:
            self._rectangle(view, np.array(box).T, WALL)
        if view.axes[1] == 2:  # the floor
            self._path(view, np.array([[-1e3, 0.0, 0.0], [1e3, 0.0, 0.0]]), PLAN)

    def _rectangle(self, view: View, corners: Array, style: str) -> None:
        a, b = view.axes
        (low_a, high_a), (low_b, high_b) = corners[:, a], corners[:, b]
        points = np.zeros((5, 3))
        points[:, a] = low_a, high_a, high_a, low_a, low_a
        points[:, b] = low_b, low_b, high_b, high_b, low_b
        self._path(view, points, style)

    def _path(self, view: View, points: Array, style: str) -> None:
        if len(points) > 1:
            self.draw_hires_lines(list(_clipped(view, view.cells(points))), style=style)

    def _marker(self, view: View, point: Array | None, sign: str) -> None:
        if point is None:
            return
        cells = view.cells(point.reshape(1, 3))
        if view.holds(cells)[0]:
            x, y = (int(v) for v in cells[0])
            self.set_pixel(x, y, sign, style="bold")

    def _words(self, view: View, here: Array | None) -> None:
        """The scale under the view from above; beside the one from the side, the height."""
        if view.axes[1] == 1:
            cells = round(view.dots_m / DOTS_X)
            bar = f"├{'─' * max(0, cells - 2)}┤ 1 m" if cells <= view.width // 2 else ""
            self.write_text(view.left, view.top + view.height - 1, bar)
        elif here is not None:
            x, y = (int(v) for v in view.cells(here.reshape(1, 3))[0])
            y = min(max(y, view.top), view.top + view.height - 1)
            left = x + 9 < view.left + view.width
            self.write_text(
                x + 2 if left else x - 2, y, f"{here[2]:.2f} m", TextAlign.LEFT if left else TextAlign.RIGHT
            )


def _clipped(view: View, cells: Array) -> Iterator[tuple[float, float, float, float]]:
    """Segments between cells inside the view (Liang and Barsky 1984)."""
    low = np.array([view.left, view.top], dtype=float)
    high = low + np.array([view.width, view.height]) - 1e-6
    start, step = cells[:-1], np.diff(cells, axis=0)
    for a, d in zip(start, step, strict=True):
        if not np.isfinite(a).all() or not np.isfinite(d).all():
            continue
        begin, end = 0.0, 1.0
        for i in range(2):
            if d[i] == 0.0:
                if not low[i] <= a[i] <= high[i]:
                    end = -1.0
                continue
            near, far = sorted(((low[i] - a[i]) / d[i], (high[i] - a[i]) / d[i]))
            begin, end = max(begin, near), min(end, far)
        if begin <= end:
            yield (*(a + begin * d), *(a + end * d))
