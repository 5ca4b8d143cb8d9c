"""The seed paper's four methods on a flight: LS, GD on the standard model (34), FMLS, FMGD on the filtered model
(38).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import FlightData
from groundstation.identification.anchoring import thrust_constants
from groundstation.identification.estimators import STRETCH, LinearEstimate, gradient_descent, least_squares, run_of
from groundstation.identification.filters import FilterPair, seed_pair
from groundstation.identification.parts import by_parts, parts_of
from groundstation.identification.regressors import Assembled, RateProducts, rate_products, transport_and_gravity
from groundstation.identification.results import MASS_AND_TENSOR, OUTPUTS, Estimate, Evolution, MethodResult
from groundstation.identification.seed_signals import Processing, SeedSignals, process_flight
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

FILTER_CUTOFF_RAD_S = 30.0
"""lambda of the seed's filters (II-D.2)."""
FINEST_GAIN_ERROR = 0.0038
"""The seed's pair is run on a grid so fine that its gain, 1 + lambda T/2, is off by no more than this."""
LARGEST_STD = 0.25
"""A parameter whose standard deviation exceeds this share of its size gets no number; a product's size is the trace."""
NOISE_SHARE = 0.25
"""A direction of the tensor in which sensor noise makes more than this share of the regressor's power gets no number.
"""


@dataclass(frozen=True, slots=True)
class Regression:
    """Gamma Theta = Upsilon on a uniform grid.

    Attributes:
        rows: Gamma, shape (k, 4, 7), made as it is asked for; the first column is zero where nothing tells specific
            force.
        output: Upsilon, [F_z, tau_x, tau_y, tau_z], N and N m, shape (k, 4).
        t_s: shape (k,).
        used: shape (k,).
        note: what the model is and what it leaves out.
    """

    rows: Assembled
    output: Annotated[Array, "k 4"]
    t_s: Annotated[Array, "k"]
    used: Annotated[NDArray[np.bool_], "k"]
    note: str = ""

    @property
    def regressor(self) -> Annotated[Array, "k 4 7"]:
        """Gamma, all of it."""
        return self.rows[slice(None)]


def standard_regression(signals: SeedSignals) -> Regression:
    """The standard model (34): accelerations from differentiated signals."""
    rate, derivative = signals.rate, signals.rate_derivative
    first = np.zeros(len(rate)) if signals.specific_force is None else signals.specific_force[:, 2].copy()
    return Regression(Assembled(first, derivative, RateProducts(rate)), signals.wrench, signals.t_s, signals.used)


def filtered_regression(
    signals: SeedSignals,
    pair: Callable[[float, float], FilterPair] = seed_pair,
    *,
    cutoff_rad_s: float = FILTER_CUTOFF_RAD_S,
    period_s: float | None = None,
) -> Regression:
    """The filtered model (38): g on the momenta, f on the rest and on the output; no acceleration is needed.

    Args:
        signals: processed flight.
        pair: (lambda, T) -> filters; the seed's (35)-(36), or :func:`filters.matched_pair`.
        cutoff_rad_s: lambda.
        period_s: the filters' T. None: the grid's, divided until the seed's pair is off by at most 0.38 %. The paper's
            is 2 ms, which makes inertias 2.9 % too low.
    """
    rate = signals.rate
    finest = 2.0 * FINEST_GAIN_ERROR / cutoff_rad_s
    steps = int(np.ceil(signals.period_s / finest)) if period_s is None else max(1, round(signals.period_s / period_s))
    filters = pair(cutoff_rad_s, signals.period_s / steps).at_every(steps)
    f_wrench, f_products = filters.f(signals.wrench), filters.f(rate_products(rate))
    g_rate = filters.g(rate)
    note = f"The filters run at T = {1e3 * signals.period_s / steps:.2f} ms."
    if signals.velocity_body is not None and signals.gravity_body is not None:
        velocity, gravity = signals.velocity_body, signals.gravity_body
        rest = by_parts(lambda rows: transport_and_gravity(velocity[rows], rate[rows], gravity[rows])[:, 2], len(rate))
        first = filters.g(velocity[:, 2]) + filters.f(rest)
    elif signals.specific_force is not None:
        first = filters.f(signals.specific_force[:, 2])
        note += " Without velocities the accelerometer stands for the first row."
    else:
        first = np.zeros(len(rate))
    settled = signals.t_s >= signals.t_s[0] + 10.0 / cutoff_rad_s
    return Regression(Assembled(first, g_rate, f_products), f_wrench, signals.t_s, signals.used & settled, note)


@dataclass(frozen=True, slots=True)
class Regressions:
    """A flight as the seed's methods see it: its processed signals, and both models."""

    signals: SeedSignals
    standard: Regression
    filtered: Regression

    @classmethod
    def of(cls, signals: SeedSignals, *, filter_period_s: float | None = None) -> Regressions:
        """Of processed signals; ``filter_period_s`` as in :func:`filtered_regression`."""
        standard, filtered = standard_regression(signals), filtered_regression(signals, period_s=filter_period_s)
        return cls(signals.without_series(), standard, filtered)


def identify_seed(
    flight: FlightData,
    *,
    mocap_minus_imu_s: float = 0.0,
    exclude: Sequence[tuple[float, float]] = (),
) -> dict[str, MethodResult]:
    """LS, GD, FMLS and FMGD of a flight, as in the seed, with intervals that allow for coloured residuals.

    They take the regressor for exact and the rotors for immediate; what noise, lag and clocks do to them is theirs.

    Raises:
        NotIdentifiable: this motion reveals none of the parameters, or the streams do not overlap.
    """
    signals = process_flight(flight, Processing(mocap_minus_imu_s=mocap_minus_imu_s, exclude=exclude))
    return seed_methods(Regressions.of(signals), flight.vehicle)


def seed_methods(regressions: Regressions, vehicle: Vehicle, *, refuse: bool = True) -> dict[str, MethodResult]:
    """The four methods on a flight's regressions; see :func:`identify_seed`.

    Args:
        vehicle: as declared; its constants made the wrench, and its anchor says what fixes the scale.
        refuse: leave out what the motion does not reveal; False gives every number, as the paper does.
    """
    signals = regressions.signals
    results: dict[str, MethodResult] = {}
    for regression, names in ((regressions.standard, ("LS", "GD")), (regressions.filtered, ("FMLS", "FMGD"))):
        doubtful = noisy_parameters(regression, signals.rate_derivative_noise) if refuse else {}
        rows = regression.rows if len(regression.t_s) > STRETCH else regression.rows[:]
        for name, estimator in zip(names, (least_squares, gradient_descent), strict=True):
            estimate = estimator(rows, regression.output, regression.t_s, regression.used)
            results[name] = _result(estimate, vehicle, doubtful, refuse, (*signals.notes, regression.note))
    if not any(result.parameters for result in results.values()):
        reasons = next(iter(results.values())).note
        raise NotIdentifiable(
            f"This motion reveals none of the parameters. {reasons}", "Fly an excitation.", MASS_AND_TENSOR
        )
    return results


def noisy_parameters(regression: Regression, noise: Array) -> dict[str, str]:
    """Parameters of the tensor whose regressor is largely sensor noise, with the reason.

    The normal matrix A of the data holds N, that of noise of the given standard deviation in the angular accelerations
    alone; where u^T N u > share u^T A u least squares is pulled towards zero by that share (errors in variables).

    Args:
        regression: either model.
        noise: standard deviation of the noise in alpha, rad/s^2, shape (3,).
    """
    used, total = np.flatnonzero(regression.used), np.zeros((6, 6))
    for part in parts_of(len(used)):
        gamma = regression.rows[run_of(used[part])][:, 1:, 1:]
        total += np.tensordot(gamma, gamma, axes=((0, 1), (0, 1)))
    total /= max(len(used), 1)
    # Row i of inertia_columns(alpha, 0) is linear in alpha: E[d^T d] is diagonal for independent axes.
    a, b, c = np.asarray(noise, dtype=float) ** 2
    shares = np.diag(np.diag([a, a + b, a + c, b, b + c, c]))
    scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
    values, vectors = np.linalg.eigh(total / np.outer(scale, scale))
    out: dict[str, str] = {}
    for value, vector in zip(values, vectors.T, strict=True):
        share = float(vector @ (shares / np.outer(scale, scale)) @ vector) / max(value, 1e-300)
        if value < 1e-10 or share > NOISE_SHARE:
            for name, weight in zip(MASS_AND_TENSOR[1:], vector, strict=True):
                if abs(weight) > 0.3:
                    out[name] = "the motion does not move it" if value < 1e-10 else "the motion drowns in sensor noise"
    return out


def _result(
    estimate: LinearEstimate, vehicle: Vehicle, doubtful: Mapping[str, str], refuse: bool, notes: Sequence[str]
) -> MethodResult:
    """Scale by the anchor, widen by its uncertainty, and leave out what is not revealed."""
    values, covariance, evolution, extra = _anchored(estimate, vehicle)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    trace = float(np.sum(np.abs(values[[1, 4, 6]])))
    sizes = np.array([abs(v) if i in (0, 1, 4, 6) else trace for i, v in enumerate(values)])
    parameters: dict[str, Estimate] = dict(extra)
    reasons: dict[str, str] = {}
    for index, name in enumerate(MASS_AND_TENSOR):
        if name in parameters:
            continue
        if not np.isfinite(values[index]):
            reasons[name] = "the motion does not move it"
        elif refuse and name in doubtful:
            reasons[name] = doubtful[name]
        elif refuse and not std[index] <= LARGEST_STD * sizes[index]:
            reasons[name] = f"its standard deviation, {std[index]:.2g}, is over a quarter of its size"
        else:
            parameters[name] = Estimate.normal(values[index], std[index])
    refused = [f"{name} gets no number: {reason}." for name, reason in reasons.items()]
    known = [name for name in MASS_AND_TENSOR if name in parameters and np.isfinite(evolution).any()]
    return MethodResult(
        parameters=parameters,
        condition_number=estimate.condition_number,
        rms_output_error={name: float(rms) for name, rms in zip(OUTPUTS, estimate.rms_residual, strict=True)},
        evolution=Evolution(
            estimate.evolution_t_s, {name: evolution[:, MASS_AND_TENSOR.index(name)] for name in known}
        ),
        note=" ".join(n for n in (*notes, *refused) if n),
        covariance=covariance,
    )


def _anchored(estimate: LinearEstimate, vehicle: Vehicle) -> tuple[Array, Array, Array, dict[str, Estimate]]:
    """Apply the anchor: which constant carries the scale, and how surely it is known.

    With "thrust", Theta is as estimated, and the declared uncertainties of the thrust constant (everything) and of the
    torque-to-thrust ratio (what the yaw torque tells: Izz) are added. With "mass", the declared thrust constant is
    wrong by s = m_declared/m_estimated: it is s k, the tensor is s times what was estimated, and the torque-to-thrust
    ratio stays as declared, because the yaw row only tells Izz over it.
    """
    settings = vehicle.identification
    values, covariance, evolution = estimate.values.copy(), estimate.covariance.copy(), estimate.evolution
    ratio = np.zeros(7)
    ratio[6] = values[6]
    extra: dict[str, Estimate] = {}
    if settings.anchor == "mass" and np.isfinite(values[0]):
        scale = vehicle.mass_kg / values[0]
        # theta' = s theta with s = m0/theta_0: d theta'_i = s d theta_i - s theta_i/theta_0 d theta_0.
        jacobian = scale * np.eye(7)
        jacobian[:, 0] -= scale * values / values[0]
        relative = float(np.sqrt(covariance[0, 0])) / values[0]
        covariance = jacobian @ covariance @ jacobian.T
        values = scale * values
        evolution = evolution * vehicle.mass_kg / evolution[:, :1]
        anchor = settings.mass_std_kg / vehicle.mass_kg
        spread = scale * float(np.hypot(relative, anchor))
        extra = {
            "mass_kg": Estimate.normal(vehicle.mass_kg, settings.mass_std_kg),
            **(thrust_constants(vehicle, scale, spread) or {"thrust_scale": Estimate.normal(scale, spread)}),
        }
        ratio *= scale
    else:
        anchor = settings.thrust_coefficient_std
    finite = np.where(np.isfinite(values), values, 0.0)
    covariance = covariance + anchor**2 * np.outer(finite, finite)
    covariance += settings.torque_to_thrust_std**2 * np.outer(np.nan_to_num(ratio), np.nan_to_num(ratio))
    return values, covariance, evolution, extra
