"""Battery sag: the same command gives less speed as the voltage falls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from groundstation.diagnosis.effect import Effect, Followed, ParameterInfo, Settings, blank, from_thrust, is_commanded
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _full_v(signals: Signals, vehicle: Vehicle) -> float:
    """Of a full battery, NaN where voltages are unknown."""
    if not np.isfinite(signals.voltage_v).all():
        return float("nan")
    return vehicle.battery.full_v or float(np.max(signals.voltage_v))


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    return _below(_full_v(signals, vehicle), signals, vehicle)


def _followed(
    signals: Signals, planned: Signals | None, vehicle: Vehicle, several: Sequence[Settings], alone: bool
) -> Followed:
    """In a part of a flight the battery was as full as at any time of the whole."""
    full, asked = (None if s is None else _full_v(s, vehicle) for s in (signals, planned))

    def wrenches(now: Signals, ahead: Signals | None) -> list[np.ndarray]:
        pairs = ((full, now), (asked, ahead))
        return [_below(full_v, some, vehicle) for full_v, some in pairs if full_v is not None and some is not None]

    return wrenches


def _below(full: float, signals: Signals, vehicle: Vehicle) -> np.ndarray:
    """Wrench (k, 6, 1) of a battery that was full at a voltage."""
    out = blank(signals)
    if not np.isfinite(full):
        return np.full_like(out, np.nan)
    out[:, :, 0] = from_thrust(vehicle, signals.thrust_n * ((signals.voltage_v[:, None] / full) ** 2 - 1.0))
    return out


EFFECT = Effect(
    identifier="battery_sag",
    equation="T = T_declared (1 + a ((V / V_full)^2 - 1)): exact for a = 0 and a = 1",
    source="speed in proportion to voltage at equal duty: Quan 2017, Introduction to Multicopter Design, sec. 4.3",
    parameters=(ParameterInfo("exponent", lambda v: 1.0, (0.0, 2.0)),),
    wrench=_wrench,
    followed=_followed,
    sentence=("As the battery sags, thrust falls by {exponent:%} of what speed proportional to voltage would give."),
    confused_with=("payload_change", "ground_effect"),
    manoeuvre="hover at one height early and late, with hard climbs that pull the voltage down in between",
    applies=is_commanded,
    shared_by_healthy=5,
)
