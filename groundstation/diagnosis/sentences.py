"""Sentences of findings: templates whose places say the unit and the words that stand for the sign.

A place is ``{name}``, or ``{name:unit}``, or ``{name:unit|above zero|below zero}``: "{loss:%|less|more} thrust" is "3.0
% less thrust", and -0.03 is "3.0 % more thrust". Values are in SI units; each unit of :data:`UNITS` scales its own. No
number has an exponent.
"""

from __future__ import annotations

import math
import string
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit as people read it.

    Attributes:
        text: after the number.
        factor: from SI.
        step: to which it is rounded; three significant digits where None.
        smaller: units for values below a tenth, larger first.
        base: subtracted before scaling; a ratio of 1.03 is 3 % more.
    """

    text: str
    factor: float = 1.0
    step: int | None = None
    smaller: tuple[Unit, ...] = ()
    base: float = 0.0


def _with_milli(text: str) -> Unit:
    return Unit(text, smaller=(Unit(f"m{text}", 1e3), Unit(f"µ{text}", 1e6)))


UNITS: Mapping[str, Unit] = {
    "": Unit(""),
    "mm": Unit("mm", 1e3, step=1),
    "m": Unit("m", step=2),
    "ms": Unit("ms", 1e3, step=1),
    "s": Unit("s", step=1),
    "%": Unit("%", 1e2, step=1),
    "% change": Unit("%", 1e2, step=1, base=1.0),
    "degrees": Unit("degrees", 180.0 / math.pi, step=2),
    "N": _with_milli("N"),
    "N m": _with_milli("N m"),
    "g": Unit("g", 1e3),
    "g cm²": Unit("g cm²", 1e7),
}
"""By the name a template uses.

Steps are a tenth of a millimetre, millisecond and percent, which no flight tells more finely.
"""


def filled(template: str, **values: float | str) -> str:
    """A template with its values in words.

    Args:
        template: see the module; values: in SI units, or text that stands as it is.

    Raises:
        ValueError: a unit that is not in :data:`UNITS`.
    """
    return _Words().vformat(template, (), values)


def quantity(value: float, unit: str, above: str = "", below: str = "") -> str:
    """A value with its unit; with words for both signs its magnitude and the word.

    >>> quantity(-0.006, "mm", "forward", "back")
    '6.0 mm back'
    """
    if unit not in UNITS:
        raise ValueError(f"unit {unit!r} of a sentence: expected one of {', '.join(filter(None, UNITS))}")
    shown = UNITS[unit]
    value = value - shown.base
    word = below if value < 0.0 else above
    return " ".join(filter(None, (_number(abs(value) if below else value, shown), word)))


def _number(value: float, unit: Unit) -> str:
    if not math.isfinite(value):
        return f"an unknown number of {unit.text}".removesuffix(" of ")
    finer = next(
        (u for u in (unit, *unit.smaller) if abs(value) * u.factor >= 0.1),
        unit if value == 0.0 or not unit.smaller else unit.smaller[-1],
    )
    scaled = value * finer.factor
    places = finer.step if finer.step is not None else _places(scaled)
    if finer.step is not None and abs(scaled) >= 100.0:
        places = 0
    text = f"{scaled:.{places}f}"
    text = text.lstrip("-") if float(text) == 0.0 else text.replace("-", "−")
    return f"{text} {finer.text}".rstrip()


def _places(value: float) -> int:
    """Decimals of three significant digits."""
    return 0 if value == 0.0 else min(6, max(0, 2 - math.floor(math.log10(abs(value)))))


class _Words(string.Formatter):
    """Fills places as :func:`filled` says; what is text already stands as it is."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, str):
            return value
        unit, _, signs = format_spec.partition("|")
        above, _, below = signs.partition("|")
        return quantity(float(value), unit, above, below)
