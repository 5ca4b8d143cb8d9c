r"""Covariance of linear estimates whose residual is coloured.

An estimate that is linear in the output, theta = sum_k H_k y_k, errs by sum_k H_k e_k. With e stationary, of spectrum
S(f), its covariance is the integral of H(f)* S(f) H(f): the residual's spectrum *at the frequencies where the estimator
listens*. For least squares H_k = A^{-1} Gamma_k^T, and this is the coloured-residual covariance of Morelli and Klein
(1997), A^{-1} [sum_ij Gamma_i^T R(i - j) Gamma_j] A^{-1}, evaluated in the frequency domain, where the autocorrelation
R need not be truncated. White residuals give the textbook sigma^2 A^{-1} back.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.linear_filters import fast_length, moving_mean

Array = NDArray[np.float64]

SMOOTHING_HZ = 0.25
"""Half-width of the spectral average: wider than a harmonic's line, narrower than the colour of what flights are
disturbed by.
"""


def coloured_covariance(
    influence: Annotated[Array, "k p outputs"], residual: Annotated[Array, "k outputs"], period_s: float
) -> Annotated[Array, "p p"]:
    """Covariance of sum_k H_k e_k for a stationary, coloured, mutually correlated residual.

    Args:
        influence: H_k, shape (k, n_parameters, n_outputs); zero where a sample was not used.
        residual: e_k, shape (k, n_outputs); zero where a sample was not used.
        period_s: sample spacing.

    Returns:
        Shape (n_parameters, n_parameters), in the parameters' units.
    """
    k, parameters, outputs = influence.shape
    # Padded by the memory that the smoothing leaves to R, so that the correlations below are linear, not circular.
    length = 2 * fast_length((k + int(1.0 / (SMOOTHING_HZ * period_s))) // 2 + 1)
    spectrum = _cross_spectrum(residual, period_s, length)
    active = (influence != 0.0).any(axis=0)
    listened = [np.zeros((np.count_nonzero(some), length // 2 + 1), dtype=complex) for some in active.T]
    for rows, some, output in zip(listened, active.T, range(outputs), strict=True):
        for row, parameter in zip(rows, np.flatnonzero(some), strict=True):
            row[:] = np.fft.rfft(influence[:, parameter, output], length)
    covariance = np.zeros((parameters, parameters))
    for (i, j), crossed in spectrum.items():
        crossed[1:-1] *= 2.0  # and at negative frequencies
        # the real part of H* S H, of real and imaginary parts as so many real numbers
        heard = (crossed * listened[i]).view(float) @ listened[j].view(float).T / length
        covariance[np.ix_(active[:, i], active[:, j])] += 0.5 * heard if i == j else heard
    return covariance + covariance.T


def _cross_spectrum(residual: Array, period_s: float, length: int) -> dict[tuple[int, int], NDArray[np.complex128]]:
    """Smoothed two-sided cross-spectra of the residual at the rfft frequencies of ``length``, variance per sample, of
    each pair of outputs, (length // 2 + 1,) each.

    Normalised so that white noise of variance s^2 has the value s^2.
    """
    used = max(np.count_nonzero(np.abs(residual).max(axis=1) > 0.0), 1)
    transform = [np.fft.rfft(row, length) for row in residual.T]
    bins = max(3, 2 * int(SMOOTHING_HZ * length * period_s) + 1)
    out: dict[tuple[int, int], NDArray[np.complex128]] = {}
    for (i, first), (j, second) in combinations_with_replacement(enumerate(transform), 2):
        raw = first * second.conj() / used
        smooth = np.zeros(len(raw), dtype=complex)
        smooth.real = moving_mean(raw.real, bins)
        if i != j:
            smooth.imag = moving_mean(raw.imag, bins)
        out[i, j] = smooth
    return out
