r"""Can a mass and tensor belong to a rigid body, and if not, which rigid body is nearest to what was measured?

A body of positive density has a positive mass m and a positive definite second moment of mass Sigma = tr(J)/2 1 - J
about its centre of mass (the pseudo-inertia of Wensing, Kim and Slotine 2018, IEEE RA-L 3(1), here with its first
moment at nought, as J is about the centre of mass): J itself is then positive definite and its principal moments obey
the triangle inequality.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.prediction_error import Fitted
from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.model.parameters import with_values

Array = NDArray[np.float64]

UPPER = np.triu_indices(3)
LOWER = np.tril_indices(3)
DIAGONAL = np.array([0, 2, 5])
"""Where the diagonal stands among the entries of LOWER."""


def physically_consistent(parameters: Mapping[str, Estimate]) -> str:
    """Why mass and tensor cannot belong to a rigid body, or an empty string (also where one of them has no number)."""
    if not all(name in parameters for name in MASS_AND_TENSOR):
        return ""
    mass, *entries = (parameters[name].value for name in MASS_AND_TENSOR)
    moments = np.linalg.eigvalsh(_symmetric(np.array(entries)))
    if mass <= 0.0:
        return "its mass is not positive"
    if moments[0] <= 0.0:
        return "its tensor is not positive definite"
    if moments[2] > moments[0] + moments[1]:
        return (
            f"its largest principal moment is {moments[2] / (moments[0] + moments[1]):.2f} times the sum of the "
            "other two"
        )
    return ""


def nearest_rigid_body(fitted: Fitted, extra_names: Sequence[str]) -> tuple[Fitted, float]:
    r"""The rigid body nearest to an estimate in the metric of its covariance, and how many standard deviations away it
    is.

    Minimise (theta - theta_hat)^T P^-1 (theta - theta_hat) over m = e^a and Sigma = L L^T with the diagonal of L as
    exponentials (log-Cholesky: Rucker and Wensing 2022, IEEE RA-L 7(2)), where P is the covariance of mass and tensor
    whatever the other parameters are. Those follow by what the fit knows of them, P_xm P^-1 (theta - theta_hat). The
    covariance is kept: cut off at the edge of the possible, the true spread is smaller.

    Args:
        extra_names: of the fit's extra wrench terms.
    """
    index = [fitted.names.index(name) for name in MASS_AND_TENSOR]
    measured, covariance = fitted.values[index], fitted.covariance[np.ix_(index, index)]
    rigid, away = nearest_values(measured, covariance)
    gain = fitted.covariance[:, index] @ np.linalg.inv(covariance)
    values = fitted.values + gain @ (rigid - measured)
    parameters = with_values(fitted.parameters, fitted.names, values, extra_names)
    return replace(fitted, values=values, parameters=parameters), away


def nearest_values(measured: Array, covariance: Array) -> tuple[Array, float]:
    """Mass and tensor (7,) of the rigid body nearest to measured ones with covariance (7, 7), and how many standard
    deviations away it is.
    """
    from scipy.optimize import least_squares

    whiten = np.linalg.cholesky(np.linalg.inv(covariance)).T

    def distance(logs: Array) -> Array:
        return whiten @ (_mass_and_tensor(logs) - measured)

    found = least_squares(distance, _logarithms(measured), x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12)
    return _mass_and_tensor(found.x), float(np.linalg.norm(found.fun))


def _symmetric(upper: Array) -> Array:
    out = np.zeros((3, 3))
    out[UPPER] = upper
    return out + out.T - np.diag(np.diag(out))


def _mass_and_tensor(logs: Array) -> Array:
    """Mass and tensor (7,) of log-Cholesky coordinates (7,)."""
    entries = logs[1:].copy()
    entries[DIAGONAL] = np.exp(entries[DIAGONAL])
    lower = np.zeros((3, 3))
    lower[LOWER] = entries
    second_moment = lower @ lower.T
    tensor = np.trace(second_moment) * np.eye(3) - second_moment
    return np.concatenate([[np.exp(logs[0])], tensor[UPPER]])


def _logarithms(values: Array) -> Array:
    """Log-Cholesky coordinates of a body near some values: second moments under a hundredth of the largest are raised
    to it.
    """
    tensor = _symmetric(values[1:])
    moments, axes = np.linalg.eigh(0.5 * np.trace(tensor) * np.eye(3) - tensor)
    raised = np.maximum(moments, 0.01 * np.abs(moments).max())
    entries = np.linalg.cholesky(axes @ np.diag(raised) @ axes.T)[LOWER]
    entries[DIAGONAL] = np.log(entries[DIAGONAL])
    return np.concatenate([[np.log(abs(values[0]))], entries])
