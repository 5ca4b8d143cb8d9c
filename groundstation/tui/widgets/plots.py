"""Line plots in braille, for live data and for plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from textual_plot import HiResMode, PlotWidget

STYLES = ("cyan", "yellow", "yellow")
"""The first line is drawn through, the others with crosses: colour alone tells nothing apart."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a plot."""

    x: ArrayLike
    y: ArrayLike


class Plot(PlotWidget):
    """Lines that are replaced as a whole. It takes no focus, so that the screens' keys stay theirs.

    Args:
        x_label, y_label: what the axes are, with their units.
        id: of the widget.
        span: the least that the axes show; less would be a drawing of noise, with ticks that run into each other.
    """

    can_focus = False

    def __init__(self, x_label: str, y_label: str, id: str, span: tuple[float, float] = (0.0, 0.0)):
        super().__init__(id=id, allow_pan_and_zoom=False)
        self._names, self._span = (x_label, y_label), span

    def on_mount(self) -> None:
        """Name the axes."""
        self.set_xlabel(self._names[0])
        self.set_ylabel(self._names[1])
        self.margin_left, self.margin_top, self.margin_bottom = 8, 1, 2

    def draw(self, lines: Sequence[Line]) -> None:
        """Show these instead of what was shown: one line, and up to two more as crosses."""
        self.clear()
        for axis, least, set_limits in zip("xy", self._span, (self.set_xlimits, self.set_ylimits), strict=True):
            every = np.concatenate([np.asarray(getattr(line, axis), dtype=float) for line in lines])
            low, high = float(every.min()), float(every.max())
            if high - low < least:
                set_limits(0.5 * (low + high - least), 0.5 * (low + high + least))
            else:
                set_limits(None, None)
        first, *others = lines
        self.plot(first.x, first.y, line_style=STYLES[0], hires_mode=HiResMode.BRAILLE)
        for line, style in zip(others, STYLES[1:], strict=False):
            self.scatter(line.x, line.y, marker="+", marker_style=style)
