r"""Intervals that may be looked at until they are small: error spent over finitely many looks, and a bound for every
moment. Numbers only.

An interval of 95 % holds at one moment that was chosen beforehand. Who looks again and again, and stops when it is
narrow, looks at many intervals. Two ways keep the error of *all* looks together at :math:`\alpha`. Both use that the
estimate at look k has information :math:`I_k = 1/\sigma_k^2`, and that the score :math:`S_k = I_k(\hat\theta_k-\theta)`
is, for efficient estimates, Brownian motion at time :math:`I_k`: independent increments :math:`N(0, I_k-I_{k-1})`
(Jennison and Turnbull, Group Sequential Methods, 2000, ch. 11).

* **Spent** (:class:`Spending`). The looks are known beforehand, K of them. At look k the share k/K of :math:`\alpha`
  may be spent, and the critical value :math:`c_k` solves :math:`P(|S_j|\le c_j\sqrt{I_j}, j<k;\ |S_k|>c_k\sqrt{I_k}) =
  \alpha/K` (Lan and DeMets, Biometrika 70, 1983; linear spending, Kim and DeMets, Biometrika 74, 1987), by recursive
  integration (Armitage, McPherson and Rowe, JRSS A 132, 1969).
* **At any time** (:func:`at_any_time`). Mixing :math:`\exp(\lambda S-\lambda^2 I/2)` over :math:`\lambda\sim
  N(0,1/\rho)` gives a martingale; Ville's inequality bounds it for ever (Robbins, Ann. Math. Statist. 41, 1970;
  asymptotic form with estimated variance: Waudby-Smith, Arbour, Sinha, Kennedy and Ramdas, Ann. Statist. 52, 2024,
  theorem 2.2): :math:`|S|\le\sqrt{(I+\rho)(\ln\frac{I+\rho}{\rho}-2\ln\alpha)}`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import lambertw, ndtr, ndtri

Array = NDArray[np.float64]

ERROR = 0.05
"""Of all looks together."""
_GRID = 401
"""Points on which the density of the score is kept; the critical values are right to four digits."""
_LEAST_STEP = 1e-6
"""Share of the information by which a look must exceed the one before, to be a look of its own."""


class Spending:
    """Critical values of one parameter, look by look.

    Args:
        looks: how many there may be in all.
        error: of all of them together.
    """

    def __init__(self, looks: int, error: float = ERROR):
        if looks < 1:
            raise ValueError("there must be at least one look.")
        self._each = error / looks
        self._information = 0.0
        self._score: Array = np.zeros(1)
        self._mass: Array = np.ones(1)
        self._spared = 0.0
        self._critical = math.inf

    def look(self, std: float) -> float:
        """Critical value of the next look: the interval is the estimate +- this times ``std``.

        Args:
            std: standard deviation of the estimate now, in any unit that stays. Infinite: nothing is known, and what
                this look may spend is left to the next. No smaller than at the look before: that look's value goes on.
        """
        self._spared += self._each
        information = std**-2 if math.isfinite(std) and std > 0.0 else 0.0
        gained = information - self._information
        if gained <= _LEAST_STEP * max(information, self._information):
            return self._critical if information > 0.0 else math.inf
        step = math.sqrt(gained)

        def leaving(edge: float) -> float:
            """Probability to be beyond +-edge now, having been within at all looks before."""
            return float(self._mass @ (ndtr((self._score - edge) / step) + ndtr((-edge - self._score) / step)))

        def missing(edge: float) -> float:
            return leaving(edge) - self._spared

        size = math.sqrt(information)
        edge = brentq(missing, 0.0, 12.0 * size)
        self._carry(edge, step)
        self._information, self._spared, self._critical = information, 0.0, edge / size
        return self._critical

    def _carry(self, edge: float, step: float) -> None:
        """The score's density within +-edge at this look, on Simpson's grid; its weights are folded into the mass."""
        grid = np.linspace(-edge, edge, _GRID)
        weight = np.full(_GRID, 2.0)
        weight[1::2], weight[[0, -1]] = 4.0, 1.0
        distance = (grid[:, None] - self._score[None, :]) / step
        density = np.exp(-0.5 * distance**2) @ self._mass / (step * math.sqrt(2.0 * math.pi))
        self._mass, self._score = density * weight * (grid[1] - grid[0]) / 3.0, grid


def at_any_time(std: float, sharpest: float, error: float = ERROR) -> float:
    r"""Critical value that holds at all moments together, whenever one looks and however often.

    Args:
        std: standard deviation of the estimate now.
        sharpest: that at which the bound is to be tightest, for example the target's. There :math:`\rho =
            I/(-W_{-1}(-\alpha^2/e)-1)`.
        error: of all moments together.
    """
    if not (math.isfinite(std) and std > 0.0):
        return math.inf
    ratio = float(-lambertw(-(error**2) / math.e, -1).real) - 1.0
    rho = sharpest**-2 / ratio
    information = std**-2
    score = math.sqrt((information + rho) * (math.log1p(information / rho) - 2.0 * math.log(error)))
    return score / math.sqrt(information)


def at_one_moment(error: float = ERROR) -> float:
    """Critical value of an interval that is looked at once: 1.96 at 5 %."""
    return float(-ndtri(0.5 * error))
