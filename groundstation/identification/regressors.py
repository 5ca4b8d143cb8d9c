"""The regressors of the seed paper: standard (12), filtered (13)-(17), and all six rows of the rigid body.

With the products of the body rates kept apart, every one of them has the same form: a first entry (what multiplies the
mass), an acceleration-like triple that multiplies the tensor (I alpha), and the six products that make omega x I omega.
The standard regressor takes them as they are, the filtered one takes them through f and s f.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Values = Annotated[ArrayLike, "k"]
Triples = Annotated[ArrayLike, "k 3"]
Products = Annotated[ArrayLike, "k 6"]
Regressor = Annotated[Array, "k 4 7"]
Index = slice | NDArray[np.intp] | NDArray[np.bool_]


def rate_products(rate: Triples) -> Annotated[Array, "k 6"]:
    """Products [pp, pq, pr, qq, qr, rr] of body rates (k, 3), rad^2/s^2, shape (k, 6)."""
    p, q, r = np.asarray(rate, dtype=float).T
    return np.stack([p * p, p * q, p * r, q * q, q * r, r * r], axis=-1)


def inertia_columns(alpha: Triples, products: Products) -> Annotated[Array, "k 3 6"]:
    """Columns that multiply [Ixx, Ixy, Ixz, Iyy, Iyz, Izz] in I alpha + omega x I omega (seed eq. 8-10, signs
    restored).

    Args:
        alpha: angular acceleration (or s f(s) of the rate), rad/s^2, shape (k, 3).
        products: [pp, pq, pr, qq, qr, rr], rad^2/s^2, shape (k, 6).

    Returns:
        Rows roll, pitch, yaw, shape (k, 3, 6).
    """
    a = np.asarray(alpha, dtype=float)
    out = np.empty((len(a), 3, 6))
    _fill_inertia(a, products, out)
    return out


def _fill_inertia(alpha: Triples, products: Products, out: Array) -> None:
    """:func:`inertia_columns` into an array (k, 3, 6)."""
    from groundstation.identification.kernels import fill_inertia

    fill_inertia(np.asarray(alpha, dtype=float), np.asarray(products, dtype=float), out)


def assemble(first: Values, alpha: Triples, products: Products) -> Regressor:
    """Regressor of [F_z, tau_x, tau_y, tau_z] on [m, Ixx, Ixy, Ixz, Iyy, Iyz, Izz] (seed eq. 12), shape (k, 4, 7)."""
    first = np.asarray(first, dtype=float)
    out = np.zeros((len(first), 4, 7))
    out[:, 0, 0] = first
    _fill_inertia(alpha, products, out[:, 1:, 1:])
    return out


def standard_regressor(specific_force_z: Values, rate: Triples, rate_derivative: Triples) -> Regressor:
    """Phi of seed eq. (12), shape (k, 4, 7).

    Args:
        specific_force_z: dw/dt + pv - qu + g cos(theta) cos(phi), m/s^2, shape (k,): what an accelerometer reads on z.
        rate: body rates, rad/s, shape (k, 3).
        rate_derivative: their derivatives, rad/s^2, shape (k, 3).
    """
    return assemble(specific_force_z, rate_derivative, rate_products(rate))


def momentum_regressor(velocity: Triples, rate: Triples) -> Regressor:
    """Phi_a of seed eq. (13): [m w, I omega] = Phi_a Theta, shape (k, 4, 7). Velocity in the body, m/s."""
    velocity = np.asarray(velocity, dtype=float)
    return assemble(velocity[:, 2], rate, np.zeros((len(velocity), 6)))


def coriolis_gravity_regressor(velocity: Triples, rate: Triples, gravity_body: Triples) -> Regressor:
    """Phi_b of seed eq. (13): [m (S(omega) v + g R^T e_z)_z, S(omega) I omega] = Phi_b Theta, shape (k, 4, 7).

    Args:
        velocity: in the body, m/s, shape (k, 3).
        rate: body rates, rad/s, shape (k, 3).
        gravity_body: g R^T e_z, m/s^2, shape (k, 3).
    """
    first = transport_and_gravity(velocity, rate, gravity_body)[:, 2]
    return assemble(first, np.zeros((len(first), 3)), rate_products(rate))


def transport_and_gravity(velocity: Triples, rate: Triples, gravity_body: Triples) -> Annotated[Array, "k 3"]:
    """S(omega) v + g R^T e_z, m/s^2, shape (k, 3); velocity and rate in the body."""
    return np.cross(np.asarray(rate, dtype=float), np.asarray(velocity, dtype=float)) + np.asarray(gravity_body)


def six_row_regressor(specific_force: Triples, rate: Triples, rate_derivative: Triples) -> Annotated[Array, "k 6 7"]:
    """Regressor of [F_x, F_y, F_z, tau_x, tau_y, tau_z] on Theta, shape (k, 6, 7).

    The body x and y rows (seed eq. 5-6 times m) say what the seed drops: without drag, wind or tether the specific
    force along x and y is zero, so m times it is the residual force there.
    """
    specific_force = np.asarray(specific_force, dtype=float)
    out = np.zeros((len(specific_force), 6, 7))
    out[:, :3, 0] = specific_force
    _fill_inertia(rate_derivative, rate_products(rate), out[:, 3:, 1:])
    return out


@dataclass(frozen=True, slots=True)
class RateProducts:
    """:func:`rate_products` of body rates (k, 3), of those samples that are asked for."""

    rate: Annotated[Array, "k 3"]

    def __getitem__(self, rows: Index) -> Annotated[Array, "n 6"]:
        return rate_products(self.rate[rows])


@dataclass(frozen=True, slots=True)
class Assembled:
    """A regressor (k, 4, 7) of which only those rows are made that are asked for: made, it is three times as large.

    Attributes:
        first, alpha, products: as :func:`assemble` takes them.
    """

    first: Annotated[Array, "k"]
    alpha: Annotated[Array, "k 3"]
    products: Annotated[Array, "k 6"] | RateProducts

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of all rows."""
        return len(self.first), 4, 7

    def __getitem__(self, rows: Index) -> Regressor:
        """Some rows, (n, 4, 7)."""
        return assemble(self.first[rows], self.alpha[rows], self.products[rows])
