r"""How well a planned motion will reveal each parameter, before it is flown.

The wrench a vehicle needs is linear in its parameters, :math:`w(t) = \Phi(t)\Theta + e(t)`. A plan repeats with period
:math:`2\pi/\omega_f`, so :math:`\Phi` is a Fourier series with coefficients :math:`\Phi_k`, and noise with a smooth
two-sided spectrum :math:`S_r` on channel r leaves over a flight of T seconds the Fisher information (Ljung, System
Identification, ch. 13; Mehra 1974)

.. math:: M = T \sum_r \sum_{k=-\infty}^{\infty} \Phi_{r,k}^H \Phi_{r,k} / S_r(k\,\omega_f).

The noise is what every flight has: a disturbance of the air with a memory of its own, and the gyro's noise, which reaches
the torque equation through the derivative that turns rates into angular acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.planning.criteria import PARAMETERS, regressor
from groundstation.trajectory import FourierSeries, rigid_motion
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Noise:
    """What disturbs a flight: stated defaults, to be replaced by what earlier flights showed.

    Attributes:
        force_rms: of the disturbance force on each axis, as a share of weight.
        torque_rms: of the disturbance torque about each axis, as a share of weight times rotor arm.
        correlation_s: time in which the disturbance forgets itself (Ornstein-Uhlenbeck).
        gyro_rad_s_rthz: gyro noise density in flight, vibration included.
        accelerometer_m_s2_rthz: accelerometer noise density in flight, vibration included.
    """

    force_rms: float = 0.003
    torque_rms: float = 0.003
    correlation_s: float = 0.5
    gyro_rad_s_rthz: float = 3e-4
    accelerometer_m_s2_rthz: float = 5e-3

    def spectra(self, vehicle: Vehicle, frequency_rad_s: Any) -> tuple[Any, Any, Any, Any]:
        r"""Two-sided noise spectra of F_z, tau_x, tau_y and tau_z, N^2/Hz and (N m)^2/Hz.

        An Ornstein-Uhlenbeck process of RMS s and correlation time c has :math:`2 s^2 c / (1 + \omega^2 c^2)`; white
        noise of density n (per root hertz, one-sided as data sheets give it) has :math:`n^2/2`, and its derivative
        :math:`\omega^2 n^2/2`. Only arithmetic is used, so frequencies may be an array or a symbolic vector.
        """
        square = frequency_rad_s * frequency_rad_s
        weight = vehicle.mass_kg * vehicle.gravity_m_s2
        shape = 2.0 * self.correlation_s / (1.0 + square * self.correlation_s**2)
        force = (self.force_rms * weight) ** 2 * shape + 0.5 * (vehicle.mass_kg * self.accelerometer_m_s2_rthz) ** 2
        torque = (self.torque_rms * weight * vehicle.arm_m()) ** 2 * shape
        x, y, z = (
            torque + 0.5 * (moment * self.gyro_rad_s_rthz) ** 2 * square for moment in np.diag(vehicle.inertia_tensor())
        )
        return force, x, y, z


DEFAULT_NOISE = Noise()


def parameter_scales(vehicle: Vehicle) -> Array:
    """Sizes against which a standard deviation is a percentage: nominal values; for products the geometric mean, (7,)."""
    xx, yy, zz = np.diag(vehicle.inertia_tensor())
    return np.array([vehicle.mass_kg, xx, np.sqrt(xx * yy), np.sqrt(xx * zz), yy, np.sqrt(yy * zz), zz])


def fourier_rows(count: int) -> tuple[Array, Array]:
    """Real and imaginary part of the Fourier coefficients of harmonics 0..h, h = ceil(count/2) - 1, each (h + 1, count)."""
    phase = 2.0 * np.pi * np.outer(np.arange((count + 1) // 2), np.arange(count)) / count
    return np.cos(phase) / count, -np.sin(phase) / count


def harmonic_weights(
    vehicle: Vehicle, noise: Noise, base_frequency_rad_s: float, duration_s: float, count: int
) -> Array:
    """Information per squared Fourier coefficient of each channel and harmonic 0..count-1, shape (4, count).

    Harmonic zero stands alone; every other stands for its negative frequency too.
    """
    harmonics = np.arange(count)
    twice = np.where(harmonics == 0, 1.0, 2.0)
    return duration_s * twice / np.stack(noise.spectra(vehicle, harmonics * base_frequency_rad_s))


def information(series: FourierSeries, vehicle: Vehicle, noise: Noise = DEFAULT_NOISE, *, samples: int = 0) -> Array:
    """Expected Fisher information of mass and inertia from a flight of the whole series, shape (7, 7).

    Args:
        samples: per period; default so many that the products of the highest harmonics are resolved.
    """
    count = samples or max(128, 32 * series.a.shape[1])
    t = np.arange(count) * (series.period_s / count)
    phi = regressor(rigid_motion(series.sample(t), vehicle.gravity_m_s2))
    cos, sin = fourier_rows(count)
    weights = harmonic_weights(vehicle, noise, series.base_frequency_rad_s, series.duration_s, len(cos))
    real, imaginary = np.einsum("hk,krp->rhp", cos, phi), np.einsum("hk,krp->rhp", sin, phi)
    return np.einsum("rh,rhp,rhq->pq", weights, real, real) + np.einsum("rh,rhp,rhq->pq", weights, imaginary, imaginary)


def predicted_std(series: FourierSeries, vehicle: Vehicle, noise: Noise = DEFAULT_NOISE) -> dict[str, float]:
    """Expected standard deviation of each parameter in its own unit (Cramer-Rao); infinite where nothing is revealed."""
    scales = parameter_scales(vehicle)
    scaled = information(series, vehicle, noise) * np.outer(scales, scales)
    values, vectors = np.linalg.eigh(scaled)
    floor = 1e-12 * values[-1]
    variance = np.where(values > floor, 1.0 / np.maximum(values, floor), np.inf)
    seen = np.where(vectors**2 > 1e-12, vectors**2, 0.0)
    with np.errstate(invalid="ignore"):
        spread = np.where(seen > 0.0, seen * variance, 0.0).sum(axis=1)
    return {name: float(value) for name, value in zip(PARAMETERS, scales * np.sqrt(spread), strict=True)}


def percentages(std: dict[str, float], vehicle: Vehicle) -> dict[str, float]:
    """Standard deviations as per cent of :func:`parameter_scales`."""
    scales = dict(zip(PARAMETERS, parameter_scales(vehicle), strict=True))
    return {name: 100.0 * value / scales[name] for name, value in std.items() if name in scales}
