"""Every sentence a finding may say, with typical values of either sign (``benchmarks.sentences`` writes
docs/sentences.md).
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from groundstation.diagnosis import trim
from groundstation.diagnosis.effect import Effect, EffectInfo, FittedEffect, ParameterInfo, SensorEffect, catalogue
from groundstation.diagnosis.sentences import filled
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle

PAGE = Path(__file__).resolve().parents[1] / "docs/sentences.md"
HEAD = """# What findings say

Made by `python -m benchmarks.sentences` from the templates beside the effects (`groundstation/diagnosis/effects/`), \
with a typical value of
either sign where a parameter can have both. A test holds this page to the templates. How places are filled: \
`groundstation/diagnosis/sentences.py`.
"""
VEHICLE = load_vehicle(find_config("vehicles", "qball2"))
SIGNALS = cast("Any", SimpleNamespace(t_s=np.linspace(0.0, 60.0, 601)))
"""All that the variants of effects ask of a flight."""
TYPICAL = 0.1
"""Of a parameter's prior standard deviation; what is estimated without a prior takes four times the least that matters.
"""


def sentences() -> dict[str, list[str]]:
    """By identifier, in the order of the catalogue; without those that never make a finding."""
    out = {name: _of(effect) for name, effect in catalogue().items()}
    out["comparison of trims"] = [
        filled(trim.LOADED, rotor="3", mass_change_kg=0.0123),
        *(filled(trim.WEAKER, rotor="2", asked=asked) for asked in (0.25, -0.25)),
        filled(trim.SHORTER, ratio=0.83, sure=0.97, kind="shorter"),
    ]
    return {name: said for name, said in out.items() if said}


def page() -> str:
    """The page in Markdown."""
    rows = (f"| `{name}` | {text} |" for name, said in sentences().items() for text in said)
    return "\n".join([HEAD, "| effect | sentence |", "| --- | --- |", *rows, ""])


def _of(effect: EffectInfo) -> list[str]:
    if isinstance(effect, Effect):
        settings = [*effect.variants(SIGNALS, VEHICLE)]
        chosen = {"rotor": "3"} | {n: v for n, v in settings[len(settings) // 2].items() if n != "rotor"}
        size = {p.name: TYPICAL * p.prior_std(VEHICLE) for p in effect.parameters}
        return _both(effect.sentence, effect.parameters, size, chosen)
    if isinstance(effect, FittedEffect):
        ratio = effect.parameters[0].plausible[0] > 0.0  # about one
        size = {p.name: 4.0 * effect.least for p in effect.parameters}
        if ratio:
            return [filled(effect.sentence, **{n: 1.0 + 40.0 * s * v for n, v in size.items()}) for s in (1.0, -1.0)]
        return _both(effect.sentence, effect.parameters, size, {})
    if isinstance(effect, SensorEffect):
        out = []
        for reading in effect.readings:
            size = dict.fromkeys(reading.parameters, 4.0 * reading.least)
            parameters = tuple(p for p in effect.parameters if p.name in reading.parameters)
            out += _both(reading.sentence, parameters, size, {"size": 4.0 * reading.least})
        return out
    return []


def _both(
    sentence: str, parameters: tuple[ParameterInfo, ...], size: dict[str, float], beside: dict[str, Any]
) -> list[str]:
    """With values above zero, and below it where that is plausible."""
    signed = ({n: s * v for n, v in size.items()} for s in (1.0, -1.0))
    low = {p.name: p.plausible[0] for p in parameters if not p.companion}
    said = [filled(sentence, **{n: max(v, low.get(n, v)) for n, v in values.items()}, **beside) for values in signed]
    return list(dict.fromkeys(said if min(low.values()) < 0.0 else said[:1]))
