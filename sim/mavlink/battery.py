"""What the firmware makes of its battery: charge drawn, share left, how worried to be."""

from __future__ import annotations

from groundstation.vehicle import Battery

_FULL_V = 16.2
_EMPTY_SHARE = 0.85
_LOW, _CRITICAL, _EMERGENCY = 15, 7, 5
"""PX4's BAT_LOW_THR, BAT_CRIT_THR, BAT_EMERGEN_THR, percent."""


class BatteryGauge:
    """Counts charge where the capacity is declared, else reads the voltage between full and empty.

    Attributes:
        used_mah: drawn since the beginning.
        stuck_percent: what it reads whatever is true (a fault); None reads the truth.
    """

    def __init__(self, declared: Battery):
        self._declared = declared
        self._voltage_v = declared.full_v or _FULL_V
        self.used_mah = 0.0
        self.stuck_percent: int | None = None

    def measure(self, voltage_v: float, current_a: float, dt_s: float) -> None:
        """One sample."""
        self._voltage_v = voltage_v
        self.used_mah += current_a * dt_s / 3.6

    @property
    def percent(self) -> int:
        """Charge left."""
        if self.stuck_percent is not None:
            return self.stuck_percent
        if self._declared.capacity_as is not None:
            share = 1.0 - 3.6 * self.used_mah / self._declared.capacity_as
        else:
            full = self._declared.full_v or _FULL_V
            empty = self._declared.empty_v or _EMPTY_SHARE * full
            share = (self._voltage_v - empty) / (full - empty)
        return max(0, min(100, round(100 * share)))

    @property
    def charge_state(self) -> int:
        """MAV_BATTERY_CHARGE_STATE: 1 fine, 2 low, 3 critical, 4 emergency."""
        percent = self.percent
        return 1 + (percent <= _LOW) + (percent <= _CRITICAL) + (percent <= _EMERGENCY)
