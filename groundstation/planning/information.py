r"""How well a planned motion will reveal each parameter, before it is flown.

The wrench a vehicle needs is linear in its parameters, :math:`w(t) = \Phi(t)\Theta + e(t)`. A plan repeats with period
:math:`2\pi/\omega_f`, so :math:`\Phi` is a Fourier series with coefficients :math:`\Phi_k`, and noise with a smooth
two-sided spectrum :math:`S_r` on channel r leaves over a flight of T seconds the Fisher information (Mehra 1974; Ljung,
System Identification, 2nd ed., ch. 13)

.. math:: M = T \sum_r \sum_{k=-\infty}^{\infty} \Phi_{r,k}^H \Phi_{r,k} / S_r(k\,\omega_f).

The noise is what every flight has: a disturbance of the air with a memory of its own, and the gyro's noise, which
reaches the torque equation through the derivative that turns rates into angular acceleration. Effects (identifiers of
``docs/diagnosis.md``) may be added as further parameters: then every standard deviation is the one with them estimated
too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.errors import BadInput
from groundstation.planning.criteria import PARAMETERS, inertia_regressor
from groundstation.trajectory import FourierSeries, RigidMotion, rigid_motion
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Transfer = Callable[[NDArray[Any]], NDArray[Any]]

CHANNELS = ("force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")

SIGNALS = 25
"""Signals that regressors are made of: specific thrust, 3 x 6 inertia regressor by rows, body velocity, body rates."""
_THRUST, _INERTIA, _VELOCITY, _RATE = 0, 1, 19, 22


def signals(motion: RigidMotion) -> Annotated[Array, "k 25"]:
    """The signals of a motion, shape (k, 25). Body velocity is for a vehicle without side-slip correction: R^T v."""
    rate, turning = motion.angular_velocity_body_rad_s, motion.angular_acceleration_body_rad_s2
    roll, pitch, yaw = motion.euler_rad.T
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    vx, vy, vz = motion.velocity_world_m_s.T
    forward, left = cy * vx + sy * vy, cy * vy - sy * vx
    below = sp * forward + cp * vz
    velocity = np.column_stack([cp * forward - sp * vz, cr * left + sr * below, cr * below - sr * left])
    rows = inertia_regressor(rate, turning).reshape(-1, 18)
    return np.column_stack([motion.specific_thrust_m_s2, rows, velocity, rate])


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

    def spectra(self, vehicle: Vehicle, frequency_rad_s: ArrayLike) -> Array:
        r"""Two-sided noise spectra of the six channels, shape (6, k), N^2/Hz and (N m)^2/Hz.

        An Ornstein-Uhlenbeck process of RMS s and correlation time c has :math:`2 s^2 c / (1 + \omega^2 c^2)`; white
        noise of density n (per root hertz, one-sided as data sheets give it) has :math:`n^2/2`, and its derivative
        :math:`\omega^2 n^2/2`.
        """
        square = np.asarray(frequency_rad_s, dtype=float) ** 2
        weight = vehicle.mass_kg * vehicle.gravity_m_s2
        shape = 2.0 * self.correlation_s / (1.0 + square * self.correlation_s**2)
        force = (self.force_rms * weight) ** 2 * shape + 0.5 * (vehicle.mass_kg * self.accelerometer_m_s2_rthz) ** 2
        torque = (self.torque_rms * weight * vehicle.arm_m()) ** 2 * shape
        moments = np.diag(vehicle.inertia_tensor())
        return np.stack([force] * 3 + [torque + 0.5 * (m * self.gyro_rad_s_rthz) ** 2 * square for m in moments])


DEFAULT_NOISE = Noise()


@dataclass(frozen=True, slots=True)
class Column:
    """What one parameter adds to one channel of the wrench: a mix of signals, passed through a linear system."""

    channel: int
    mix: Array
    transfer: Transfer | None = None


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter with the size against which its standard deviation is a share, and its columns."""

    name: str
    scale: float
    columns: tuple[Column, ...]


def base_parameters(vehicle: Vehicle) -> tuple[Parameter, ...]:
    """Mass and inertia (eq. 12); products of inertia are measured against the geometric mean of their diagonal
    entries.
    """
    xx, yy, zz = np.diag(vehicle.inertia_tensor())
    scales = np.array([xx, np.sqrt(xx * yy), np.sqrt(xx * zz), yy, np.sqrt(yy * zz), zz])
    mass = Parameter(PARAMETERS[0], vehicle.mass_kg, (Column(2, _unit(_THRUST)),))
    inertia = [
        Parameter(name, float(scale), tuple(Column(3 + row, _unit(_INERTIA + 6 * row + j)) for row in range(3)))
        for j, (name, scale) in enumerate(zip(PARAMETERS[1:], scales, strict=True))
    ]
    return (mass, *inertia)


def _unit(signal: int) -> Array:
    vector = np.zeros(SIGNALS)
    vector[signal] = 1.0
    return vector


def _nominal_wrench(vehicle: Vehicle) -> list[tuple[int, Array]]:
    """Mixes that give F_z and the torques of the nominal vehicle."""
    entries = vehicle.inertia_tensor()[np.triu_indices(3)]
    force = vehicle.mass_kg * _unit(_THRUST)
    torques: list[Array] = []
    for row in range(3):
        mix = np.zeros(SIGNALS)
        mix[_INERTIA + 6 * row : _INERTIA + 6 * row + 6] = entries
        torques.append(mix)
    return [(2, force), *((3 + row, mix) for row, mix in enumerate(torques))]


def effect_parameters(vehicle: Vehicle, effect: str) -> tuple[Parameter, ...]:
    """Parameters of one effect, linearised about its absence (a lag about the declared one, or 50 ms).

    The scales are sizes worth finding: drag of 0.2 m kg/s, a centre of mass off by 2 % of the arm, damping that halves
    a rate in a second, 1 % of weight times arm per m/s of flapping, 50 ms of lag, 20 ms of delay.

    Raises:
        BadInput: the effect is none of those that a plan can weigh.
    """
    if effect not in _WEIGHED:
        raise BadInput(f"a plan cannot weigh the effect {effect}; it can {', '.join(sorted(_WEIGHED))}.")
    return _WEIGHED[effect](vehicle)


def _rotor_drag(vehicle: Vehicle) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"d_{'xy'[i]}_kg_s", 0.2 * vehicle.mass_kg, (Column(i, _unit(_VELOCITY + i)),)) for i in range(2)
    )


def _com_offset(vehicle: Vehicle) -> tuple[Parameter, ...]:
    heavy, size = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.gravity_m_s2 * _unit(_THRUST), 0.02 * vehicle.arm_m()
    return (
        Parameter("com_offset_x_m", size, (Column(4, -heavy),)),
        Parameter("com_offset_y_m", size, (Column(3, heavy),)),
    )


def _angular_damping(vehicle: Vehicle) -> tuple[Parameter, ...]:
    moments = np.diag(vehicle.inertia_tensor())
    return tuple(
        Parameter(f"damping_{'xyz'[i]}_nms", 0.7 * float(moments[i]), (Column(3 + i, _unit(_RATE + i)),))
        for i in range(3)
    )


def _flapping_moment(vehicle: Vehicle) -> tuple[Parameter, ...]:
    size = 0.01 * (vehicle.mass_kg * vehicle.gravity_m_s2) * vehicle.arm_m()
    return (Parameter("k_nm_s_m", size, (Column(3, -_unit(_VELOCITY + 1)), Column(4, _unit(_VELOCITY)))),)


def _motor_lag(vehicle: Vehicle) -> tuple[Parameter, ...]:
    lag = max(vehicle.rotors.lag.up_s, 0.05)
    columns = (Column(r, mix, lambda w: 1j * w / (1.0 + 1j * w * lag) ** 2) for r, mix in _nominal_wrench(vehicle))
    return (Parameter("rotor_lag_s", 0.05, tuple(columns)),)


def _input_delay(vehicle: Vehicle) -> tuple[Parameter, ...]:
    columns = (Column(r, mix, lambda w: 1j * w) for r, mix in _nominal_wrench(vehicle))
    return (Parameter("input_delay_s", 0.02, tuple(columns)),)


_WEIGHED: Mapping[str, Callable[[Vehicle], tuple[Parameter, ...]]] = {
    "rotor_drag": _rotor_drag,
    "com_offset": _com_offset,
    "angular_damping": _angular_damping,
    "flapping_moment": _flapping_moment,
    "motor_lag": _motor_lag,
    "input_delay": _input_delay,
}
"""Effects that a plan can weigh."""


def parameters(vehicle: Vehicle, effects: Sequence[str] = ()) -> tuple[Parameter, ...]:
    """Mass, inertia and the parameters of the given effects."""
    return (*base_parameters(vehicle), *(p for effect in effects for p in effect_parameters(vehicle, effect)))


@dataclass(frozen=True, slots=True)
class Block:
    """Columns of one channel that pass through one linear operator.

    Attributes:
        operator: from k samples of a period to real and imaginary parts of weighted Fourier coefficients, shape (m, k).
        mix: from signals to columns, shape (25, c).
        parameters: which parameter each column belongs to, shape (c,).
    """

    operator: Array
    mix: Array
    parameters: NDArray[np.intp]


def fisher_channels(
    vehicle: Vehicle,
    model: Sequence[Parameter],
    noise: Noise,
    base_frequency_rad_s: float,
    duration_s: float,
    samples: int,
) -> list[list[Block]]:
    """Blocks by channel such that the sum over channels of X^T X is the information in relative parameters.

    X stacks, for each block, operator @ (signals @ mix); columns of a channel stand side by side.
    """
    harmonic = np.arange((samples + 1) // 2)
    frequency = base_frequency_rad_s * harmonic
    waves = np.exp(-2j * np.pi * np.outer(harmonic, np.arange(samples)) / samples) / samples
    power = duration_s * np.where(harmonic == 0, 1.0, 2.0) / noise.spectra(vehicle, frequency)
    channels: list[list[Block]] = []
    for channel in range(len(CHANNELS)):
        entries = [(i, p.scale, c) for i, p in enumerate(model) for c in p.columns if c.channel == channel]
        blocks: list[Block] = []
        for transfer in dict.fromkeys(c.transfer for _, _, c in entries):
            here = [entry for entry in entries if entry[2].transfer is transfer]
            gain = np.sqrt(power[channel]) * (1.0 if transfer is None else transfer(frequency))
            complex_operator = gain[:, None] * waves
            blocks.append(
                Block(
                    np.vstack([complex_operator.real, complex_operator.imag]),
                    np.column_stack([scale * c.mix for _, scale, c in here]),
                    np.array([i for i, _, _ in here]),
                )
            )
        if blocks:
            channels.append(blocks)
    return channels


def gram_channels(vehicle: Vehicle, samples: int) -> list[list[Block]]:
    """Blocks such that the sum over channels of X^T X is the mean square of the seed paper's regressor (eq. 12)."""
    operator = np.eye(samples) / np.sqrt(samples)
    model = base_parameters(vehicle)
    channels: list[list[Block]] = []
    for channel in range(2, 6):
        here = [(i, c) for i, p in enumerate(model) for c in p.columns if c.channel == channel]
        channels.append([Block(operator, np.column_stack([c.mix for _, c in here]), np.array([i for i, _ in here]))])
    return channels


def assemble(channels: Sequence[Sequence[Block]], sampled: Array, size: int) -> Array:
    """Sum over channels of X^T X for signals of shape (k, 25), shape (size, size)."""
    total = np.zeros((size, size))
    for blocks in channels:
        x = np.hstack([block.operator @ (sampled @ block.mix) for block in blocks])
        index = np.concatenate([block.parameters for block in blocks])
        np.add.at(total, np.ix_(index, index), x.T @ x)
    return total


def information(
    series: FourierSeries, vehicle: Vehicle, noise: Noise = DEFAULT_NOISE, effects: Sequence[str] = ()
) -> Array:
    """Expected Fisher information of the relative parameters (each over its scale) from the whole series, shape (p, p).

    Args:
        series: the excitation, all its periods.
        vehicle: nominal vehicle.
        noise: what disturbs the flight.
        effects: identifiers of effects whose parameters are estimated too.
    """
    model = parameters(vehicle, effects)
    count = max(128, 32 * series.a.shape[1])
    t = np.arange(count) * (series.period_s / count)
    sampled = signals(rigid_motion(series.sample(t), vehicle.gravity_m_s2))
    channels = fisher_channels(vehicle, model, noise, series.base_frequency_rad_s, series.duration_s, count)
    return assemble(channels, sampled, len(model))


def predicted_std(
    series: FourierSeries, vehicle: Vehicle, noise: Noise = DEFAULT_NOISE, effects: Sequence[str] = ()
) -> dict[str, float]:
    """Expected standard deviation of each parameter in its own unit (Cramer-Rao); infinite where nothing is
    revealed.
    """
    model = parameters(vehicle, effects)
    values, vectors = np.linalg.eigh(information(series, vehicle, noise, effects))
    revealed = values > 1e-12 * values[-1]
    shares = np.where(vectors**2 > 1e-12, vectors**2, 0.0)
    spread = shares[:, revealed] @ (1.0 / values[revealed])
    spread[shares[:, ~revealed].sum(axis=1) > 0.0] = np.inf
    return {p.name: p.scale * float(np.sqrt(s)) for p, s in zip(model, spread, strict=True)}


def percentages(std: dict[str, float], vehicle: Vehicle) -> dict[str, float]:
    """Standard deviations of mass and inertia as per cent of their nominal size (see :func:`base_parameters`)."""
    scales = {p.name: p.scale for p in base_parameters(vehicle)}
    return {name: 100.0 * value / scales[name] for name, value in std.items() if name in scales}
