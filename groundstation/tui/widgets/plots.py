"""Line plots in braille, for live data and for plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from textual_plot import HiResMode, PlotWidget
from textual_plot.axis_formatter import NumericAxisFormatter

STYLES = ("#0087d7", "#d75f00", "#d75f00")
"""The first line is drawn through, the others with crosses: colour alone tells nothing apart. Both are of the
256 colours that every terminal has, and stand out from light and dark."""

NARROW = 60
INTERVALS = 2.0
"""Half widths of the last interval that are shown above and below an evolution."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a plot."""

    x: ArrayLike
    y: ArrayLike


class Plot(PlotWidget):
    """Lines that are replaced as a whole. It takes no focus, so that the screens' keys stay theirs.

    Args:
        title: what is drawn over what, with the unit; it stands in the frame.
        id: of the widget.
        span: the least that the axes show; less would be a drawing of noise, with ticks that run into each other.
    """

    can_focus = False

    def __init__(self, title: str, id: str, span: tuple[float, float] = (0.0, 0.0)):
        super().__init__(id=id, allow_pan_and_zoom=False)
        self.border_title, self._span = title, span

    def on_mount(self) -> None:
        """Ticks take one row, the values on the left eight columns."""
        self.margin_left, self.margin_top, self.margin_bottom = 8, 0, 1

    def draw(self, lines: Sequence[Line]) -> None:
        """Show these instead of what was shown: one line, and up to two more as crosses."""
        first, *others = lines
        self._reset(lines)
        self.plot(first.x, first.y, line_style=STYLES[0], hires_mode=HiResMode.BRAILLE)
        for line, style, marker in zip(others, STYLES[1:], ("+", "×"), strict=False):
            self.scatter(line.x, line.y, marker=marker, marker_style=style)

    def draw_interval(self, value: Line, low: Line, high: Line) -> None:
        """Show a line between two that bound it; what the bounds were at first is cut off where they were far apart."""
        self._reset([value])
        half = float(np.asarray(high.y)[-1] - np.asarray(low.y)[-1]) / 2.0
        every = np.asarray(value.y, dtype=float)
        self.set_ylimits(float(every.min()) - INTERVALS * half, float(every.max()) + INTERVALS * half)
        for line, style in zip((low, high, value), (*STYLES[1:], STYLES[0]), strict=True):
            self.plot(line.x, line.y, line_style=style, hires_mode=HiResMode.BRAILLE)

    def _reset(self, lines: Sequence[Line]) -> None:
        self.clear()
        for axis, least, set_limits in zip("xy", self._span, (self.set_xlimits, self.set_ylimits), strict=True):
            every = np.concatenate([np.asarray(getattr(line, axis), dtype=float) for line in lines])
            low, high = float(every.min()), float(every.max())
            if high - low < least:
                low, high = 0.5 * (low + high - least), 0.5 * (low + high + least)
                set_limits(low, high)
            else:
                set_limits(None, None)
            if axis == "x":  # in a narrow plot the numbers would run into each other
                crowded = high > low and self.size.width < NARROW
                self.set_xticks(NumericAxisFormatter().get_ticks(low, high)[::2] if crowded else None)
