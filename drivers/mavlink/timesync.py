"""Map a device's clock to the host's from TIMESYNC exchanges, with drift and an error bar. Pure.

One exchange gives host times h0 (request left) and h1 (answer came) and the device time d between them, so at the
host's midpoint the device showed d within +-(h1 - h0)/2. The line d = d0 + (1 + drift)(h - h0) is fitted to the newest
window with weights 1/(half round trip + quantum)^2, so that slow exchanges hardly count. PX4's simulated clock ran 1.2
% slow: an offset alone would be wrong by 12 ms after a second.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import inf, sqrt


@dataclass(frozen=True, slots=True)
class ClockFit:
    """The line through the exchanges of one window.

    Attributes:
        host_s, device_s: a point on the line, the weighted mean.
        rate: device seconds per host second.
        point_std_s, rate_std: standard errors of the line at that point and of the rate.
        asymmetry_s: half the shortest round trip: what an uneven way could hide, never averaged out.
        exchanges: how many exchanges the fit rests on.
    """

    host_s: float
    device_s: float
    rate: float
    point_std_s: float
    rate_std: float
    asymmetry_s: float
    exchanges: int

    def device(self, host_s: float) -> float:
        """Device time at a host time."""
        return self.device_s + self.rate * (host_s - self.host_s)

    def host(self, device_s: float) -> float:
        """Host time at a device time."""
        return self.host_s + (device_s - self.device_s) / self.rate

    def error_s(self, host_s: float) -> float:
        """One standard error of :meth:`device` at a host time, plus the asymmetry bound."""
        return sqrt(self.point_std_s**2 + (self.rate_std * (host_s - self.host_s)) ** 2) + self.asymmetry_s


class Timesync:
    """Collects exchanges and fits them.

    Args:
        window_s: how far back the line reaches; a clock's drift is steady over this time.
        quantum_s: steps in which the device's clock moves (PX4 in its simulator: 4 ms), as far as it is known.

    Attributes:
        resets: how often the device's clock jumped (a reboot); what was known before is dropped each time.
    """

    def __init__(self, window_s: float = 30.0, quantum_s: float = 1e-4):
        self._window_s, self._quantum_s = window_s, quantum_s
        self._exchanges: deque[tuple[float, float, float]] = deque()
        self._fit: ClockFit | None = None
        self.resets = 0

    def add(self, sent_s: float, device_s: float, received_s: float) -> bool:
        """One exchange; returns False for one that cannot be (negative or absurd round trip)."""
        half = 0.5 * (received_s - sent_s)
        if half < 0.0 or half > 2.0:
            return False
        middle = sent_s + half
        if self._exchanges and self._jumped(middle, device_s, half):
            self._exchanges.clear()
            self.resets += 1
        self._exchanges.append((middle, device_s, half))
        while middle - self._exchanges[0][0] > self._window_s:
            self._exchanges.popleft()
        self._fit = self._line()
        return True

    def fit(self) -> ClockFit | None:
        """The line, or None before the first exchange. Fewer than three assume equal rates, and 5 % doubt about it."""
        return self._fit

    def _line(self) -> ClockFit:
        h0, d0, _ = self._exchanges[-1]  # offsets from the newest keep the sums well conditioned
        weights = [1.0 / (half + self._quantum_s) ** 2 for _, _, half in self._exchanges]
        total = sum(weights)
        pairs = list(zip(weights, self._exchanges, strict=True))
        mean_h = sum(w * (h - h0) for w, (h, _, _) in pairs) / total
        mean_d = sum(w * (d - d0) for w, (_, d, _) in pairs) / total
        spread = sum(w * (h - h0 - mean_h) ** 2 for w, (h, _, _) in pairs)
        asymmetry = min(half for _, _, half in self._exchanges)
        if len(self._exchanges) < 3 or spread <= 0.0:
            return ClockFit(h0 + mean_h, d0 + mean_d, 1.0, 1.0 / sqrt(total), 0.05, asymmetry, len(self._exchanges))
        rate = sum(w * (h - h0 - mean_h) * (d - d0 - mean_d) for w, (h, d, _) in pairs) / spread
        residual = sum(w * (d - d0 - mean_d - rate * (h - h0 - mean_h)) ** 2 for w, (h, d, _) in pairs)
        scale = residual / (len(self._exchanges) - 2)
        return ClockFit(
            h0 + mean_h, d0 + mean_d, rate, sqrt(scale / total), sqrt(scale / spread), asymmetry, len(self._exchanges)
        )

    def error_s(self, host_s: float) -> float:
        """The fit's error bar; infinite without one."""
        fit = self.fit()
        return inf if fit is None else fit.error_s(host_s)

    def _jumped(self, host_s: float, device_s: float, half: float) -> bool:
        """The device's clock is away from where the last exchange puts it by more than 5 % drift and both trips
        explain.
        """
        last_h, last_d, last_half = self._exchanges[-1]
        return abs((device_s - last_d) - (host_s - last_h)) > 0.05 * abs(host_s - last_h) + half + last_half + 0.05
