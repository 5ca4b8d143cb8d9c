"""What fixes the scale: trusted rotor constants, or a weighed mass. Both are the same fit read in two ways.

Thrusts enter only as T/m and tau(T) J^-1: scaling thrust constant, mass and tensor by one factor changes nothing a
flight could show. The fit takes the declared thrust; the anchor turns its result into the parameters that were asked
for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


def anchored(
    vehicle: Vehicle, names: Sequence[str], values: Array, covariance: Array
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Mass and tensor, and the thrust constants, under the vehicle's anchor, intervals widened by the anchor's own.

    Args:
        names, values, covariance: of a fit on the declared thrust constants; must hold mass and the tensor.

    Returns:
        (mass and tensor, model parameters that the anchor makes unknown).
    """
    theta, cov, scale, scale_std = _under_anchor(vehicle, names, values, covariance)
    constants = {} if scale is None else thrust_constants(vehicle, scale, scale_std)
    return _estimates(MASS_AND_TENSOR, theta, cov), constants


def anchored_covariance(vehicle: Vehicle, names: Sequence[str], values: Array, covariance: Array) -> Array:
    """Covariance of mass and tensor, shape (7, 7), in the order of MASS_AND_TENSOR, whose diagonal :func:`anchored`
    gives.
    """
    return _under_anchor(vehicle, names, values, covariance)[1]


def _under_anchor(
    vehicle: Vehicle, names: Sequence[str], values: Array, covariance: Array
) -> tuple[Array, Array, float | None, float]:
    """Mass and tensor, their covariance, and the factor of the thrust constants with its deviation; None where they are
    trusted.
    """
    settings = vehicle.identification
    index = [names.index(name) for name in MASS_AND_TENSOR]
    theta = np.asarray(values, dtype=float)[index]
    cov = np.asarray(covariance, dtype=float)[np.ix_(index, index)]
    tensor = theta[1:]
    # Torque ratio c scales yaw torque: J rows of yaw follow it. d(izz)/izz = dc/c; products with z share half of it.
    ratio = np.zeros(7)
    ratio[6] = theta[6]
    ratio[[3, 5]] = 0.5 * theta[[3, 5]]
    extra = settings.torque_to_thrust_std**2 * np.outer(ratio, ratio)
    if settings.anchor == "thrust" or vehicle.rotors.input == "wrench":
        cov = cov + settings.thrust_coefficient_std**2 * np.outer(theta, theta) + extra
        return theta, cov, None, 0.0
    scale = vehicle.mass_kg / theta[0]
    relative_mass_std = settings.mass_std_kg / vehicle.mass_kg
    # values: m fixed, J = scale * J_fit; jacobian with respect to (m_fit, J_fit)
    jacobian = np.zeros((7, 7))
    jacobian[1:, 0] = -scale * tensor / theta[0]
    jacobian[1:, 1:] = scale * np.eye(6)
    anchored_values = np.concatenate([[vehicle.mass_kg], scale * tensor])
    cov_anchored = (
        jacobian @ cov @ jacobian.T
        + relative_mass_std**2 * np.outer(anchored_values, anchored_values)
        + extra * scale**2
    )
    scale_std = scale * float(np.hypot(np.sqrt(cov[0, 0]) / theta[0], relative_mass_std))
    return anchored_values, cov_anchored, scale, scale_std


def thrust_constants(vehicle: Vehicle, scale: float, std: float) -> dict[str, Estimate]:
    """Declared thrust constants times an estimated factor."""
    rotors = vehicle.rotors
    if rotors.thrust_curve is not None:
        return {
            f"thrust_curve_c{i}_n": Estimate.normal(c * scale, abs(c) * std) for i, c in enumerate(rotors.thrust_curve)
        }
    if rotors.thrust_coefficient_n_s2 is None:
        return {}
    k = rotors.thrust_coefficient_n_s2
    return {"thrust_coefficient_n_s2": Estimate.normal(k * scale, k * std)}


def _estimates(names: Sequence[str], values: Array, covariance: Array) -> dict[str, Estimate]:
    return {
        name: Estimate.normal(value, float(np.sqrt(max(variance, 0.0))))
        for name, value, variance in zip(names, values, np.diag(covariance), strict=True)
    }
