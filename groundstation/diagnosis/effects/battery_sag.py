"""Battery sag: the same command gives less speed as the voltage falls."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank, from_thrust, is_commanded
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    out = blank(signals)
    if not np.isfinite(signals.voltage_v).all():
        return np.full_like(out, np.nan)
    full = vehicle.battery.full_v or float(np.max(signals.voltage_v))
    out[:, :, 0] = from_thrust(vehicle, signals.thrust_n * ((signals.voltage_v[:, None] / full) ** 2 - 1.0))
    return out


EFFECT = Effect(
    identifier="battery_sag",
    equation="T = T_declared (1 + a ((V / V_full)^2 - 1)): exact for a = 0 and a = 1",
    source="speed in proportion to voltage at equal duty: Quan 2017, Introduction to Multicopter Design, sec. 4.3",
    parameters=(ParameterInfo("exponent", lambda v: 1.0, (0.0, 2.0)),),
    wrench=_wrench,
    sentence=("As the battery sags, thrust falls by {exponent:%} of what speed proportional to voltage would give."),
    confused_with=("payload_change", "ground_effect"),
    manoeuvre="hover at one height early and late, with hard climbs that pull the voltage down in between",
    applies=is_commanded,
    shared_by_healthy=5,
)
