"""Which message rates a link can carry: what is needed first, then the wishes in proportion. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt

from drivers.mavlink.dialect import MESSAGES, message_id
from groundstation.flight.link.profiles import StreamWish

SHARE = 0.75
"""Of the line's bytes; the rest is for heartbeats, parameters, texts and answers."""

MOTION_HZ = 100.0
"""Messages wished for so often carry motion; the others tell how things stand."""

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


def cost_of_line(wishes: Sequence[StreamWish], granted: Mapping[str, float], bytes_per_s: float) -> tuple[str, ...]:
    """What a line that cannot carry every wish costs the estimate, for the report; nothing where it carries them all.

    Half the rate is the highest frequency a record shows (Nyquist). Where white sensor noise rules, a variance
    is inverse to the number of samples.
    """
    line = f"link: the line of {10 * bytes_per_s:.0f} baud"
    said = []
    thinned = [w for w in wishes if w.rate_hz >= MOTION_HZ and 0.0 < granted[w.name] < 0.99 * w.rate_hz]
    if thinned:
        fastest = max(thinned, key=lambda w: w.rate_hz)
        rate_hz = granted[fastest.name]
        said.append(
            f"{line} brought {', '.join(f'{w.name} at {granted[w.name]:.0f} of {w.rate_hz:.0f} Hz' for w in thinned)}: "
            f"motion above {0.5 * rate_hz:.0f} Hz is not in the record, and where sensor noise rules, intervals are "
            f"{sqrt(fastest.rate_hz / rate_hz):.1f} times as wide; the onboard log does not depend on the line."
        )
    dropped = [w.name for w in wishes if w.instead_of and granted[w.name] == 0.0]
    if dropped:
        said.append(f"{line} had no room for {', '.join(dropped)}; what tells the same less well was taken.")
    return tuple(said)
