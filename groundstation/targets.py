"""What flights are to reach: half widths of 95 % intervals as shares of their parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping

from groundstation.errors import BadInput
from groundstation.json_types import Document

SHORT = {
    "mass": "mass_kg",
    **{name: f"{name}_kg_m2" for name in ("ixx", "iyy", "izz")},
    "lag": "rotor_lag_up_s",
}
"""Names that people type, and the parameters they stand for."""
DEFAULT = "ixx,iyy,izz:2%,mass:0.5%"
HALF_95 = 1.959964


def parse_targets(text: str) -> dict[str, float]:
    """``ixx,iyy,izz:2%,mass:0.5%`` as {"ixx_kg_m2": 0.02, ..., "mass_kg": 0.005}: names wait for the next percentage.

    Raises:
        BadInput: a name that is unknown, a percentage that is none or not between 0 and 100, or names without one.
    """
    out: dict[str, float] = {}
    waiting: list[str] = []
    for part in (piece.strip() for piece in text.split(",")):
        name, colon, share = part.partition(":")
        if name not in SHORT:
            raise BadInput(f"'{name}' is no target; there are {', '.join(SHORT)} (for example {DEFAULT}).")
        waiting.append(SHORT[name])
        if colon:
            out |= dict.fromkeys(waiting, _share(share.strip(), part))
            waiting = []
    if waiting:
        raise BadInput(f"'{text}' ends without a percentage; write for example {DEFAULT}.")
    return out


def _share(text: str, part: str) -> float:
    try:
        value = float(text.removesuffix("%")) / 100.0
    except ValueError:
        value = math.nan
    if not 0.0 < value < 1.0:
        raise BadInput(f"'{part}' has no percentage between 0 and 100; write for example mass:0.5%.")
    return value


def reached(estimates: Document, targets: Mapping[str, float]) -> dict[str, float]:
    """Half width of each target's interval as a share of the target: 1 or less is met, infinity is not revealed.

    Args:
        estimates: name -> {"value", "std"}.
        targets: of :func:`parse_targets`.
    """
    out = {}
    for name, share in targets.items():
        entry = estimates.get(name)
        if entry is None or not entry["value"] or not math.isfinite(entry["std"]):
            out[name] = math.inf
        else:
            out[name] = HALF_95 * entry["std"] / abs(entry["value"]) / share
    return out
