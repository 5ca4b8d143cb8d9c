"""How numbers are written: the unit from the parameter's name, a readable prefix, digits from the interval."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from groundstation.identification.results import Estimate
from groundstation.model.parameters import table

UNITS: Mapping[str, str] = {
    "kg_m2": "kg m²",
    "nm_s_m": "N m s/m",
    "nm_s": "N m s",
    "s2_m2": "s²/m²",
    "nms": "N m s",
    "n_s2": "N s²",
    "m_s2": "m/s²",
    "m_s3": "m/s³",
    "rad_s2": "rad/s²",
    "rad_s": "rad/s",
    "rpm": "rpm",
    "kg_s": "kg/s",
    "kg_m3": "kg/m³",
    "kg_m": "kg/m",
    "kg_rad": "kg/rad",
    "n_m": "N/m",
    "m_s": "m/s",
    "v_a": "V/A",
    "ohm": "Ω",
    "nm": "N m",
    "rad": "rad",
    "deg": "°",
    "kg": "kg",
    "hz": "Hz",
    "n": "N",
    "s": "s",
    "m": "m",
    "v": "V",
    "a": "A",
}
"""Unit suffixes of parameter and column names, longest first where one ends another."""

_PREFIXES = {0: "", -3: "m", -6: "µ", -9: "n", 3: "k"}
_PREFIXED = {"s", "m", "N", "N m", "rad", "rad/s", "V", "A"}
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_LABELS: Mapping[str, str] = {
    "com_offset_z": "centre of mass z",
    "torque_to_thrust": "torque to thrust",
    "x": "x",
    "y": "y",
    "z": "z",
}


_FITTED: Mapping[str, str] = {name: entry.label for name, entry in table().items()}


@dataclass(frozen=True, slots=True)
class Scale:
    """Multiply by ``factor`` to show a number in ``unit``."""

    factor: float
    unit: str


def split_unit(name: str) -> tuple[str, str]:
    """A snake-case name with its unit last, as (stem, unit text): ("rotor_lag_up", "s"). No unit: (name, "")."""
    for suffix, unit in UNITS.items():
        if name.endswith("_" + suffix):
            return name[: -len(suffix) - 1], unit
    return name, ""


def label(name: str) -> str:
    """A parameter or signal in words: "ixx_kg_m2" is "Ixx", "rotor_lag_up_s" is "rotor lag up"."""
    stem, _ = split_unit(name)
    if name in _FITTED:
        return _FITTED[name]
    if stem in _LABELS:
        return _LABELS[stem]
    return stem.replace("_", " ")


_METHODS: Mapping[str, str] = {
    "IV": "instrumental variables",
    "OE": "output error",
    "FE": "filter error",
    "PE": "prediction error",
    "LF": "low frequencies",
    "LS": "least squares",
    "GD": "gradient descent",
    "FMLS": "least squares on the filtered model",
    "FMGD": "gradient descent on the filtered model",
}


def method_text(source: str) -> str:
    """A method in words: "IV + findings" is "instrumental variables (IV), findings put in"."""
    method, plus, _ = source.partition(" + findings")
    words = f"{_METHODS[method]} ({method})" if method in _METHODS else method
    return f"{words}, findings put in" if plus else words


_NAME = re.compile(r"(?<![\w/.`-])[a-z][a-z0-9]*(?:_[a-z0-9]+)+(?!\w|[/`-]|\.\w)")


def readable(text: str, identifiers: Collection[str] = ()) -> str:
    """A sentence with its snake-case parameters and signals (known by their unit) and ``identifiers`` in words."""

    def words(match: re.Match[str]) -> str:
        name = match[0]
        return label(name) if split_unit(name)[1] else name.replace("_", " ") if name in identifiers else name

    return _NAME.sub(words, text)


def scale_for(unit: str, magnitudes: Iterable[float]) -> Scale:
    """The prefix, or power of ten, that puts the largest magnitude between 0.1 and 100 (engineering notation)."""
    largest = max((abs(m) for m in magnitudes if math.isfinite(m)), default=0.0)
    if unit == "" and 0.0 < largest < 1e-4:
        return Scale(1e6, "ppm")
    if largest == 0.0 or unit in {"", "°", "Hz", "rpm", "m/s", "m/s²"}:
        return Scale(1.0, unit)
    exponent = 3 * math.floor((math.log10(largest) + 1.0) / 3 + 1e-12)
    if unit == "kg" and -6 <= exponent < 0:
        return Scale(1e3 if exponent == -3 else 1e6, "g" if exponent == -3 else "mg")
    if exponent == 0 or (largest < 1e4 and exponent > 0):
        return Scale(1.0, unit)
    if unit in _PREFIXED and exponent in _PREFIXES:
        return Scale(10.0**-exponent, _PREFIXES[exponent] + unit)
    return Scale(10.0**-exponent, f"10{str(exponent).translate(_SUPERSCRIPT)} {unit}")


ROUNDING = 1e-12
"""An error below this, in SI, is the arithmetic's own: no sensor here tells a millionth of a millionth."""


def beyond_rounding(value: float) -> float:
    """The error, or zero where it is rounding alone."""
    return value if abs(value) >= ROUNDING else 0.0


def decimals(uncertainty: float, digits: int = 2) -> int:
    """Decimals that show ``digits`` significant digits of an uncertainty; at least 0, at most 9."""
    if not math.isfinite(uncertainty) or uncertainty <= 0.0:
        return 4
    return min(9, max(0, digits - 1 - math.floor(math.log10(uncertainty))))


def fixed(value: float, places: int) -> str:
    """Fixed decimals with a typographic minus; never "−0.00"; what is not finite is a dash."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.{places}f}"
    return text.replace("-", "−") if float(text) != 0.0 else text.lstrip("-")


def significant(value: float, digits: int = 3) -> str:
    """A number by itself, to some significant digits."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        return fixed(value, max(0, digits - 1 - exponent))
    mantissa = fixed(value / 10.0**exponent, digits - 1)
    return f"{mantissa}·10{str(exponent).translate(_SUPERSCRIPT)}"


def half_width(estimate: Estimate) -> float:
    """Half of the 95 % interval, or 1.96 standard deviations where there is none."""
    low, high = estimate.ci95
    width = 0.5 * (high - low)
    return width if math.isfinite(width) and width > 0.0 else 1.959964 * estimate.std


def interval_text(estimate: Estimate, scale: Scale) -> str:
    """Value and 95 % half width without the unit: "1.8254 ± 0.0012"; the value alone where nothing is known of its
    width.
    """
    width = half_width(estimate) * scale.factor
    if width <= 0.0 or not math.isfinite(width):
        return significant(estimate.value * scale.factor)
    places = decimals(width)
    return f"{fixed(estimate.value * scale.factor, places)} ± {fixed(width, places)}"


def quantity(name: str, estimate: Estimate) -> str:
    """Value, 95 % half width and unit in one line: "1.8254 ± 0.0012 kg"."""
    _, unit = split_unit(name)
    scale = scale_for(unit, [estimate.value])
    text = interval_text(estimate, scale)
    return f"({text})·{scale.unit}" if scale.unit.startswith("10") else f"{text} {scale.unit}".strip()


def percent(ratio: float, places: int = 1) -> str:
    """A signed percentage: 0.123 is "+12.3 %"."""
    if not math.isfinite(ratio):
        return "–"
    text = fixed(100.0 * ratio, places)
    return f"{'+' if ratio > 0 and float(text.replace('−', '-')) != 0 else ''}{text} %"
