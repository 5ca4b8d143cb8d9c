r"""What may have changed between healthy flights and others, and how likely each is: sets of rotors, a load, another
vehicle.

Each hypothesis has its marginal likelihood for a change of wrench (4,), over all sizes, kinds and places it could have,
and a prior share:

    nothing          scatter of healthy flights alone                                                      1
    one rotor        any of them, weak or with a propeller that is shorter or rougher                      1
    two rotors       any pair, each as above                                                               PAIR
    a load           anywhere on the vehicle, on it or on a string                                         1

Each of them is taken twice: the healthy flights are of the same individual, or (OTHER times as likely) of another one
of its make, whose trims scatter by more. Nothing but that is a hypothesis of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.results import Estimate
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

SIZES, RATIOS, SCALES, PRIORS = 150, 16, 16, 6
"""Points of the integrals: over a size, the torque per thrust, the scale of Student's distribution, and of the prior.
"""
PAIR_SIZES, PAIR_RATIOS = 20, 4
"""The same for each rotor of a pair."""
PAIR, OTHER = 0.2, 0.1
"""Prior shares: two faults at once are rarer than one, and healthy flights are said to be of the same vehicle."""
INDIVIDUALS = 0.04
"""How the trims of two individuals of one make differ, as shares of weight, arm and torque: two Crazyflies of CrazyPAD,
whose healthy flights are in shared/data, differ by up to 0.034."""
SHOWN = 19.0
"""Odds against nothing from which a fault counts as shown."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """How trims of a healthy vehicle differ from their mean, components as shares of the weight: a mixture of Student's
    distributions, ``matrices`` (k, 4, 4) with one number of degrees of freedom and ``shares`` (k,).
    """

    matrices: Array
    shares: Array
    freedom: float

    def wider(self) -> Scatter:
        """The same between individuals of one make."""
        return Scatter(self.matrices + INDIVIDUALS**2 * np.eye(self.matrices.shape[-1]), self.shares, self.freedom)

    def log_density(self, left: Array) -> Array:
        """Of differences (..., 4)."""
        from scipy.special import gammaln, logsumexp

        count = int(left.shape[-1])
        roots = np.linalg.cholesky(np.linalg.inv(self.matrices))
        white = left.reshape(-1, count) @ np.moveaxis(roots, 0, 1).reshape(count, -1)
        square = np.sum(white.reshape(*left.shape[:-1], len(roots), count) ** 2, axis=-1)
        total = 0.5 * (self.freedom + count)
        constant = float(gammaln(total)) - float(gammaln(0.5 * self.freedom))
        constant -= 0.5 * count * float(np.log(self.freedom * np.pi))
        each = constant - 0.5 * np.linalg.slogdet(self.matrices)[1] - total * np.log1p(square / self.freedom)
        return np.asarray(logsumexp(each + np.log(self.shares), axis=-1), dtype=float)

    def normal_parts(self) -> tuple[Array, Array]:
        """The same as a mixture of normal distributions: covariances (m, 4, 4) and the logarithms of their shares
        (m,).
        """
        from scipy.stats import gamma

        middle = (np.arange(SCALES) + 0.5) / SCALES
        precision = gamma.ppf(middle, 0.5 * self.freedom, scale=2.0 / self.freedom)
        covariances = self.matrices[:, None] / precision[:, None, None]
        shares = np.repeat(np.log(self.shares / SCALES), SCALES)
        return covariances.reshape(-1, *self.matrices.shape[1:]), shares

    def exceeded(self, left: Array) -> float:
        """Probability that healthy scatter is larger than a difference (4,)."""
        from scipy.stats import f

        square: Array = np.einsum("i,kij,j->k", left, np.linalg.inv(self.matrices), left)
        return float(self.shares @ f.sf(square / len(left), len(left), self.freedom))


@dataclass(frozen=True, slots=True)
class Explanation:
    """A hypothesis: its marginal log-likelihood, its parameters, and the mean change of wrench it makes (4,).

    Attributes:
        rotors: which are weak; none for a load. Parameters of the second stand behind those of the first, with "/2".
        ratio_off: of each of them, the probability that its torque per thrust is not that of a whole propeller.
        strange: how much of it rests on the healthy flights being another individual's.
    """

    effect: str
    evidence: float
    change: Array
    parameters: dict[str, Estimate]
    rotors: tuple[int, ...] = ()
    ratio_off: tuple[float, ...] = ()
    strange: float = 0.0


def healthy_scatter(reference: Array) -> Scatter:
    """Of a flight of another session about the mean of healthy ones (n, 4), covariance and the prior's scale integrated
    out.
    """
    flights, count = reference.shape
    apart = reference - reference.mean(axis=0)
    prior = count + 2  # the fewest degrees of freedom with which the prior has a mean: the square of the scale
    spread = np.geomspace(*THRESHOLDS.trim_scatter_shares, PRIORS)[:, None, None] ** 2 * np.eye(count) + apart.T @ apart
    freedom = prior + flights - count
    return Scatter(spread * (1.0 + 1.0 / flights) / freedom, np.full(PRIORS, 1.0 / PRIORS), float(freedom))


def explanations(vehicle: Vehicle, patterns: Array, change: Array, scatter: Scatter) -> list[Explanation]:
    """All explanations of a change of wrench (4,); ``patterns`` is what each rotor's healthy thrust makes, (4, n)."""
    rotors = range(1, patterns.shape[1] + 1)
    pairs = list(combinations(rotors, 2))
    wide = float(scatter.wider().log_density(change)) + float(np.log(OTHER))
    return [
        Explanation("none", float(scatter.log_density(change)), np.zeros(4), {}),
        *(either(partial(weak_rotor, rotor, patterns, change), scatter) for rotor in rotors),
        *(either(partial(weak_pair, pair, patterns, change, PAIR / len(pairs)), scatter) for pair in pairs),
        either(partial(load_somewhere, vehicle, change), scatter),
        Explanation("other", wide, np.zeros(4), {}, strange=1.0),
    ]


def either(explain: Callable[[Scatter], Explanation], scatter: Scatter) -> Explanation:
    """A hypothesis, the healthy flights being of the same individual or (less likely before) of another one."""
    one, two = explain(scatter), explain(scatter.wider())
    evidence, (same, other) = _integrated(np.array([one.evidence, two.evidence + np.log(OTHER)]))
    parameters: dict[str, Estimate] = {}
    for name, first in one.parameters.items():
        second = two.parameters[name]
        weight, values = np.array([same, other]), np.array([first.value, second.value])
        parameters[name] = _moments(weight, values, np.array([first.std, second.std]) ** 2)
    off = tuple(same * a + other * b for a, b in zip(one.ratio_off, two.ratio_off, strict=True))
    change = same * one.change + other * two.change
    return Explanation(one.effect, evidence, change, parameters, one.rotors, off, float(other))


def posteriors(found: Sequence[Explanation]) -> list[float]:
    """Share of each explanation."""
    return list(map(float, _integrated(np.array([each.evidence for each in found]))[1]))


def _ratios(count: int) -> tuple[Array, Array]:
    """Torque per thrust that is missing, as a share, (count,): a whole propeller, a shorter or a rougher one; and their
    prior.
    """
    least = 1.0 - THRESHOLDS.trim_propeller_shortest
    off = np.linspace(2.0 * least / count, least, count // 2)
    missing = np.concatenate([[0.0], off, -off])
    prior = np.full(len(missing), 0.5 / (len(missing) - 1))
    prior[0] = 0.5
    return missing, prior


def weak_rotor(rotor: int, patterns: Array, change: Array, scatter: Scatter) -> Explanation:
    """A weak motor or a propeller that is not whole, as likely before; all rotors together have the prior share of one
    explanation.
    """
    pattern = patterns[:, rotor - 1]
    loss = THRESHOLDS.trim_loss_most * np.arange(1, SIZES + 1) / SIZES
    missing, prior = _ratios(RATIOS)
    more = loss / (1.0 - loss)
    yaw = np.array([0.0, 0.0, 0.0, pattern[3]])
    left = change - more[:, None, None] * pattern - missing[None, :, None] * yaw
    evidence, weight = _integrated(scatter.log_density(left) + np.log(prior) - np.log(SIZES))
    parameters = {
        "loss": _moments(weight, np.broadcast_to(loss[:, None], weight.shape)),
        "torque_to_thrust_ratio": _moments(weight, np.broadcast_to(1.0 - missing, weight.shape)),
    }
    mean = float(np.sum(weight * more[:, None])) * pattern + float(np.sum(weight * missing)) * yaw
    off = (float(np.sum(weight[:, 1:])),)
    return Explanation("weak_rotor", evidence - np.log(patterns.shape[1]), mean, parameters, (rotor,), off)


def weak_pair(pair: tuple[int, int], patterns: Array, change: Array, prior: float, scatter: Scatter) -> Explanation:
    """Two rotors at once, each as :func:`weak_rotor` has it."""
    loss = THRESHOLDS.trim_loss_most * np.arange(1, PAIR_SIZES + 1) / PAIR_SIZES
    missing, share = _ratios(PAIR_RATIOS)
    more = loss / (1.0 - loss)
    own = [patterns[:, rotor - 1] for rotor in pair]
    yaw = [np.array([0.0, 0.0, 0.0, pattern[3]]) for pattern in own]
    one, two = (
        more[:, None, None] * pattern + missing[None, :, None] * turn for pattern, turn in zip(own, yaw, strict=True)
    )
    left = change - one[:, :, None, None] - two[None, None]
    log_prior = np.log(share)[None, :, None, None] + np.log(share) - 2.0 * np.log(PAIR_SIZES)
    evidence, weight = _integrated(scatter.log_density(left) + log_prior)
    parameters: dict[str, Estimate] = {}
    off: list[float] = []
    mean = np.einsum("abcd,abi->i", weight, one) + np.einsum("abcd,cdi->i", weight, two)
    for index, suffix in enumerate(("", "/2")):
        each = weight.sum(axis=(2, 3) if index == 0 else (0, 1))
        parameters[f"loss{suffix}"] = _moments(each, np.broadcast_to(loss[:, None], each.shape))
        parameters[f"torque_to_thrust_ratio{suffix}"] = _moments(each, np.broadcast_to(1.0 - missing, each.shape))
        off.append(float(np.sum(each[:, 1:])))
    return Explanation("weak_rotor", evidence + float(np.log(prior)), mean, parameters, pair, tuple(off))


def load_somewhere(vehicle: Vehicle, change: Array, scatter: Scatter) -> Explanation:
    """A load somewhere on the vehicle, its place integrated in closed form."""
    share = THRESHOLDS.trim_load_most * np.arange(1, SIZES + 1) / SIZES
    arm = vehicle.arm_m()
    reach = float(np.max(np.abs(vehicle.rotors.position_m))) + vehicle.rotors.radius_m
    place = reach**2 / 3.0 / arm**2  # variance of a place anywhere on the vehicle
    columns = np.zeros((SIZES, 1, 4, 2))
    columns[:, 0, 2, 0], columns[:, 0, 1, 1] = -share, share  # of x and y, in arms
    left = change - share[:, None] * np.array([1.0, 0.0, 0.0, 0.0])
    noise, shares = scatter.normal_parts()
    covariance = noise + place * (columns @ columns.swapaxes(2, 3))
    inverse = np.linalg.inv(covariance)
    square = np.einsum("si,smij,sj->sm", left, inverse, left, optimize=True)
    density = -0.5 * square - 0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    evidence, weight = _integrated(density + shares - np.log(SIZES))
    gain = place * columns.swapaxes(2, 3) @ inverse
    where = np.einsum("smjk,sk->smj", gain, left)
    spread = place * (1.0 - np.einsum("smjk,smkj->smj", gain, np.broadcast_to(columns, (*gain.shape[:2], 4, 2))))
    lever = (share / (1.0 + share))[:, None] * arm
    parameters = {"mass_change_kg": _moments(weight, share[:, None] * vehicle.mass_kg)}
    for axis, name in enumerate(("com_offset_x_m", "com_offset_y_m")):
        parameters[name] = _moments(weight, lever * where[..., axis], lever**2 * spread[..., axis])
    moved = np.einsum("sm,s,smj->j", weight, share, where)
    mean = np.array([float(np.sum(weight * share[:, None])), moved[1], -moved[0], 0.0])
    return Explanation("com_offset", evidence, mean, parameters)


def least_shown(vehicle: Vehicle, patterns: Array, scatter: Scatter) -> tuple[float, float]:
    """Least loss of the rotor that shows worst, and least load beside a rotor (kg), that these flights would have
    shown.
    """
    most = THRESHOLDS.trim_loss_most
    sizes = most * np.arange(1, 26) / 25
    hubs = np.abs(np.asarray(vehicle.rotors.position_m)[0, :2]) / vehicle.arm_m()

    def shown(change: Array, found: Explanation) -> bool:
        return found.evidence - float(scatter.log_density(change)) > np.log(SHOWN)

    losses: list[float] = []
    for rotor in range(1, patterns.shape[1] + 1):
        changes = [(size, size / (1.0 - size) * patterns[:, rotor - 1]) for size in sizes]
        losses.append(next((s for s, c in changes if shown(c, weak_rotor(rotor, patterns, c, scatter))), most))
    loads = [(size, size * np.array([1.0, hubs[1], -hubs[0], 0.0])) for size in sizes]
    load = next((s for s, c in loads if shown(c, load_somewhere(vehicle, c, scatter))), most)
    return max(losses), load * vehicle.mass_kg


def _integrated(log_terms: Array) -> tuple[float, Array]:
    """Log of the sum of exponentials, and each term's share of it."""
    top = float(log_terms.max())
    terms = np.exp(log_terms - top)
    return top + float(np.log(terms.sum())), terms / terms.sum()


def _moments(weight: Array, values: Array, variance: Array | float = 0.0) -> Estimate:
    mean = float(np.sum(weight * values))
    return Estimate.normal(mean, float(np.sqrt(np.sum(weight * ((values - mean) ** 2 + variance)))))
