"""Which message rates a link can carry: what is needed first, then the wishes in proportion. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.mavlink.dialect import MESSAGES, message_id
from groundstation.flight.profiles import StreamWish

SHARE = 0.75
"""Of the line's bytes; the rest is for heartbeats, parameters, texts and answers."""

_FRAME_BYTES = 12


def frame_bytes(name: str) -> int:
    """Bytes of one frame of a message on the wire, unsigned and at full length."""
    number = message_id(name)
    return _FRAME_BYTES + MESSAGES[number].unpacker.size


def fit_rates(wishes: Sequence[StreamWish], bytes_per_s: float | None) -> dict[str, float]:
    """Rate for each wish on a line that carries so many bytes a second; None: all are granted.

    The needed rates come first; what is left is shared so that every wish gets the same fraction of the rest. Where not
    all fits, messages that only say better what another says are not asked for at all: their rate is 0.
    """
    if bytes_per_s is None:
        return {w.name: w.rate_hz for w in wishes}
    budget = SHARE * bytes_per_s
    if sum(w.rate_hz * frame_bytes(w.name) for w in wishes) > budget:
        spared = {w.name: 0.0 for w in wishes if w.instead_of}
        if spared:
            return spared | fit_rates([w for w in wishes if not w.instead_of], bytes_per_s)
    needed = sum(w.needed_hz * frame_bytes(w.name) for w in wishes)
    rest = sum((w.rate_hz - w.needed_hz) * frame_bytes(w.name) for w in wishes)
    fraction = min(1.0, max(0.0, (budget - needed) / rest)) if rest > 0.0 else 1.0
    tight = min(1.0, budget / needed) if needed > 0.0 else 1.0
    return {w.name: tight * w.needed_hz + fraction * (w.rate_hz - w.needed_hz) for w in wishes}
