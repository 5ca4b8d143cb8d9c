r"""What the mean thrusts of a flight say beside those of healthy flights, where body rates were not measured.

In the mean a vehicle that hovers or goes back and forth turns and climbs nowhere: the rotors balance its weight and every steady
torque. What changed since the healthy flights changes the commanded wrench :math:`w = A \bar T(u)` so as to counter it:

    rotor i           F, tau_x, tau_y rise by A e_i T_i q, q = loss / (1 - loss); yaw by q + 1 - d of its torque, d the torque per
                      thrust that is left: 1 for a weak motor, the diameter's share for a shorter propeller (thrust D^4, torque D^5)
    load at (x, y)    F rises by its weight G, tau_x by +y G, tau_y by -x G, yaw by nothing

Healthy flights differ from each other besides (battery, its place, its voltage). The covariance of that is unknown: it has an
inverse Wishart prior whose scale the healthy flights choose; integrated out it leaves Student's distribution in all components
together (Gelman et al., Bayesian Data Analysis, 3.6). The suspect flights were made in one state and count as one more draw, however many they
are. Every explanation has its marginal likelihood, over all sizes and places it could have, and one prior share; "nothing
changed" is one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.rivals import posterior
from groundstation.diagnosis.sentences import told
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

CHANNELS = ("force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
LOADED = (
    "Compared with the healthy flights, the vehicle carries {mass_change_kg:g|more|less} on the side of rotor {rotor}."
)
WEAKER = "Compared with the healthy flights, rotor {rotor} is asked for {asked:%|more|less} thrust."
SHORTER = (
    "At the same thrust its torque is {ratio:% change|higher|lower}: a shorter propeller with {sure:%} probability."
)
RIVALS = {"weak_rotor": "a weak rotor", "com_offset": "a shifted centre of mass"}
SIZES, RATIOS, SCALES, PRIORS = 150, 16, 16, 6
"""Points of the integrals: over a size, the torque per thrust, the scale of Student's distribution, and of the prior."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """How trims of a healthy vehicle differ from their mean, components as shares of the weight: a mixture of Student's
    distributions, ``matrices`` (k, 4, 4) with one number of degrees of freedom and ``shares`` (k,).
    """

    matrices: Array
    shares: Array
    freedom: float

    def log_density(self, left: Array) -> Array:
        """Of differences (..., 4)."""
        from scipy.special import gammaln, logsumexp

        count = left.shape[-1]
        white = left[..., None, None, :] @ np.linalg.cholesky(np.linalg.inv(self.matrices))
        square = np.sum(white[..., 0, :] ** 2, axis=-1)
        total = 0.5 * (self.freedom + count)
        constant = gammaln(total) - gammaln(0.5 * self.freedom) - 0.5 * count * np.log(self.freedom * np.pi)
        each = constant - 0.5 * np.linalg.slogdet(self.matrices)[1] - total * np.log1p(square / self.freedom)
        return np.asarray(logsumexp(each + np.log(self.shares), axis=-1), dtype=float)

    def normal_parts(self) -> tuple[Array, Array]:
        """The same as a mixture of normal distributions: covariances (m, 4, 4) and the logarithms of their shares (m,)."""
        from scipy.stats import gamma

        middle = (np.arange(SCALES) + 0.5) / SCALES
        precision = gamma.ppf(middle, 0.5 * self.freedom, scale=2.0 / self.freedom)
        covariances = self.matrices[:, None] / precision[:, None, None]
        shares = np.repeat(np.log(self.shares / SCALES), SCALES)
        return covariances.reshape(-1, *self.matrices.shape[1:]), shares

    def exceeded(self, left: Array) -> float:
        """Probability that healthy scatter is larger than a difference (4,)."""
        from scipy.stats import f

        square = np.einsum("i,kij,j->k", left, np.linalg.inv(self.matrices), left)
        return float(self.shares @ f.sf(square / len(left), len(left), self.freedom))


@dataclass(frozen=True, slots=True)
class Explanation:
    """An explanation: its marginal log-likelihood, its parameters, and the mean change of wrench it makes (4,).

    ``shorter`` is, of a weak rotor, the probability that its propeller is short and not its motor weak.
    """

    effect: str
    evidence: float
    change: Array
    parameters: dict[str, Estimate]
    rotor: int | None = None
    shorter: float = 0.0


@dataclass(frozen=True, slots=True)
class Trim:
    """What came of it: findings, error of each channel before and after on flights left out, and whether all is explained."""

    findings: tuple[Finding, ...]
    before: dict[str, float]
    after: dict[str, float]
    explained: bool


def applies(suspects: Sequence[Prepared], references: Sequence[Prepared]) -> bool:
    """Rates are derived, single rotors are known, and there are flights enough to know how they scatter."""
    return (
        all(item.source != "imu" for item in (*suspects, *references))
        and suspects[0].record.vehicle.rotors.input != "wrench"
        and len(references) > THRESHOLDS.trim_freedom_least
    )


def compare_trims(suspects: Sequence[Prepared], references: Sequence[Prepared]) -> Trim:
    """Explain the difference of mean thrusts between suspect and healthy flights."""
    vehicle = suspects[0].record.vehicle
    suspect, reference = (np.array([mean_thrust(item) for item in group]) for group in (suspects, references))
    healthy = reference.mean(axis=0)
    scale = healthy.sum() * np.array([1.0, *([vehicle.arm_m()] * 2), vehicle.rotors.torque_to_thrust_m or 1.0])
    matrix = vehicle.allocation() / scale[:, None]
    suspect, reference = suspect @ matrix.T, reference @ matrix.T
    scatter, changes = healthy_scatter(reference), suspect - reference.mean(axis=0)
    ranked = sorted(
        explanations(vehicle, matrix * healthy, changes.mean(axis=0), scatter),
        key=lambda explanation: -explanation.evidence,
    )
    best = ranked[0]
    left = [one - _refitted(best, vehicle, matrix * healthy, rest, scatter) for one, rest in _leave_one_out(changes)]
    return Trim(
        () if best.effect == "none" else (_finding(ranked, vehicle, len(reference)),),
        _rms(changes * scale),
        _rms(np.array(left) * scale),
        scatter.exceeded(changes.mean(axis=0) - best.change) > THRESHOLDS.trim_healthy_chance,
    )


def mean_thrust(prepared: Prepared) -> Array:
    """Mean thrust of each rotor in settled flight, (n,), by the declared curve."""
    thrust = prepared.signals(0.0, 0.0, 0.0).thrust_n
    t_s, keep, total = prepared.record.t_s, prepared.record.keep, thrust.sum(axis=1)
    aloft = total > THRESHOLDS.trim_flying_share * np.median(total[keep])
    ground = np.concatenate([[-np.inf], t_s[~aloft], [np.inf]])
    after = np.searchsorted(ground, t_s)
    apart = np.minimum(t_s - ground[after - 1], ground[np.minimum(after, len(ground) - 1)] - t_s)
    settled = keep & aloft & (apart > THRESHOLDS.trim_settled_s)
    return thrust[settled if settled.any() else keep & aloft].mean(axis=0)


def healthy_scatter(reference: Array) -> Scatter:
    """Of a flight of another session about the mean of healthy ones (n, 4), covariance and the prior's scale integrated out."""
    flights, count = reference.shape
    apart = reference - reference.mean(axis=0)
    prior = count + 2  # the fewest degrees of freedom with which the prior has a mean: the square of the scale
    spread = np.geomspace(*THRESHOLDS.trim_scatter_shares, PRIORS)[:, None, None] ** 2 * np.eye(count) + apart.T @ apart
    freedom = prior + flights - count
    return Scatter(spread * (1.0 + 1.0 / flights) / freedom, np.full(PRIORS, 1.0 / PRIORS), float(freedom))


def explanations(vehicle: Vehicle, patterns: Array, change: Array, scatter: Scatter) -> list[Explanation]:
    """All explanations of a change of wrench (4,); ``patterns`` is what each rotor's healthy thrust makes, (4, n)."""
    nothing = Explanation("none", float(scatter.log_density(change)), np.zeros(4), {})
    weak = [_weak_rotor(rotor, patterns, change, scatter) for rotor in range(1, patterns.shape[1] + 1)]
    return [nothing, *weak, _load(vehicle, change, scatter)]


def _weak_rotor(rotor: int, patterns: Array, change: Array, scatter: Scatter) -> Explanation:
    """A weak motor or a shorter propeller, as likely before; all rotors together have the prior share of one explanation."""
    pattern = patterns[:, rotor - 1]
    loss = THRESHOLDS.trim_loss_most * np.arange(1, SIZES + 1) / SIZES
    shorter = (1.0 - THRESHOLDS.trim_propeller_shortest) * np.linspace(0.0, 1.0, RATIOS)
    prior = np.full(RATIOS, 0.5 / RATIOS)
    prior[0] += 0.5
    more = loss / (1.0 - loss)
    yaw = np.array([0.0, 0.0, 0.0, pattern[3]])
    left = change - more[:, None, None] * pattern - shorter[None, :, None] * yaw
    evidence, weight = _integrated(scatter.log_density(left) + np.log(prior) - np.log(SIZES))
    parameters = {
        "loss": _moments(weight, np.broadcast_to(loss[:, None], weight.shape)),
        "torque_to_thrust_ratio": _moments(weight, np.broadcast_to(1.0 - shorter, weight.shape)),
    }
    mean = float(np.sum(weight * more[:, None])) * pattern + float(np.sum(weight * shorter)) * yaw
    return Explanation(
        "weak_rotor", evidence - np.log(patterns.shape[1]), mean, parameters, rotor, float(np.sum(weight[:, 1:]))
    )


def _load(vehicle: Vehicle, change: Array, scatter: Scatter) -> Explanation:
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


def _integrated(log_terms: Array) -> tuple[float, Array]:
    """Log of the sum of exponentials, and each term's share of it."""
    top = float(log_terms.max())
    terms = np.exp(log_terms - top)
    return top + float(np.log(terms.sum())), terms / terms.sum()


def _moments(weight: Array, values: Array, variance: Array | float = 0.0) -> Estimate:
    mean = float(np.sum(weight * values))
    return Estimate.normal(mean, float(np.sqrt(np.sum(weight * ((values - mean) ** 2 + variance)))))


def _refitted(best: Explanation, vehicle: Vehicle, patterns: Array, change: Array, scatter: Scatter) -> Array:
    """The change of wrench that the explanation ``best`` makes when it is fitted to another change."""
    if best.rotor is not None:
        return _weak_rotor(best.rotor, patterns, change, scatter).change
    return best.change if best.effect == "none" else _load(vehicle, change, scatter).change


def _leave_one_out(changes: Array) -> list[tuple[Array, Array]]:
    """Each flight's change, and the mean of the others' (its own, where there is no other)."""
    if len(changes) == 1:
        return [(changes[0], changes[0])]
    return [(one, np.delete(changes, i, axis=0).mean(axis=0)) for i, one in enumerate(changes)]


def _rms(wrenches: Array) -> dict[str, float]:
    return dict(zip(CHANNELS, map(float, np.sqrt(np.mean(wrenches**2, axis=0))), strict=True))


def _finding(ranked: Sequence[Explanation], vehicle: Vehicle, healthy: int) -> Finding:
    best, *rivals = ranked
    behind = [2.0 * (explanation.evidence - best.evidence) for explanation in rivals]
    near = [
        s.effect
        for s, far in zip(rivals, behind, strict=True)
        if far > -THRESHOLDS.inseparable and s.effect != best.effect
    ]
    alternatives = tuple(dict.fromkeys(name for name in near if name != "none"))
    rotor = best.rotor or _nearest_rotor(best, vehicle)
    said = " or ".join(
        [*(RIVALS[name] for name in alternatives), *(["a difference between two days"] if "none" in near else [])]
    )
    limit = f" With {healthy} healthy flights and no gyro, {said} cannot be excluded." if said else ""
    return Finding(
        effect=best.effect,
        parameters=best.parameters,
        evidence=f"{_sentence(best, rotor)}{limit}",
        confidence=posterior(behind),
        alternatives=alternatives,
        rotor=rotor,
        gain=2.0
        * (best.evidence - next(explanation.evidence for explanation in ranked if explanation.effect == "none")),
    )


def _sentence(explanation: Explanation, rotor: int) -> str:
    if explanation.effect == "com_offset":
        return told(LOADED, rotor=str(rotor), mass_change_kg=explanation.parameters["mass_change_kg"].value)
    loss, ratio = explanation.parameters["loss"].value, explanation.parameters["torque_to_thrust_ratio"].value
    text = told(WEAKER, rotor=str(rotor), asked=loss / (1.0 - loss))
    return f"{text} {told(SHORTER, ratio=ratio, sure=explanation.shorter)}" if explanation.shorter > 0.5 else text


def _nearest_rotor(load: Explanation, vehicle: Vehicle) -> int:
    """In the direction of the load."""
    hubs = np.asarray(vehicle.rotors.position_m)[:, :2]
    towards = [load.parameters[name].value for name in ("com_offset_x_m", "com_offset_y_m")]
    return 1 + int(np.argmax(hubs @ towards / np.linalg.norm(hubs, axis=1)))
