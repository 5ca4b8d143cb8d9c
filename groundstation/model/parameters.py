"""The parameters a flight's dynamics are fitted in: one table that fit, diagnosis, model file, prediction and report
read.

Adding a parameter is one entry here and its sensitivity in ``identification/sensitivities.py``. An entry without
physics of its own in the model (:class:`Parameters` has no field for it) is kept in ``others``; the fit then takes it
for linear: what it adds to the outputs is its value times its sensitivity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Where the entries of TENSOR stand in the matrix."""
TENSOR = ("ixx_kg_m2", "ixy_kg_m2", "ixz_kg_m2", "iyy_kg_m2", "iyz_kg_m2", "izz_kg_m2")
BASIS = np.zeros((6, 3, 3))
for _index, (_i, _j) in enumerate(PAIRS):
    BASIS[_index, _i, _j] = BASIS[_index, _j, _i] = 1.0
RIGID_BODY = ("mass_kg", *TENSOR)


@dataclass(frozen=True, slots=True)
class Parameters:
    """The state of the fit in physical units.

    Attributes:
        tensor: about the centre of mass, (3, 3).
        lag_up_s, lag_down_s: of rising and falling rotors; lag_slope: share by which a rotor's rate of response rises
            with its speed.
        delay_s: dead time of the inputs. com_m: centre of mass, (3,). yaw_trim_nm: steady yaw torque.
        force_bias_m_s2: of the accelerometer, (3,).
        extra: coefficients of a fit's further wrench terms, in their order.
        others: parameters of the table without a field of their own, by name.
    """

    mass_kg: float
    tensor: Array
    lag_up_s: float
    lag_down_s: float
    delay_s: float
    com_m: Array
    yaw_trim_nm: float
    force_bias_m_s2: Array
    extra: Array = field(default_factory=lambda: np.zeros(0))
    lag_slope: float = 0.0
    others: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True, slots=True)
class FitOptions:
    """What a fit is free to change.

    ``channels`` are the outputs used (rates, then specific forces); ``lag``, ``delay``, ``com``, ``yaw_trim``, ``mass``
    and ``accel_delay`` free those parameters.
    """

    lag: bool = True
    symmetric_lag: bool = False
    delay: bool = True
    com: bool = True
    yaw_trim: bool = True
    mass: bool = True
    accel_delay: bool = False
    channels: tuple[int, ...] = (0, 1, 2, 5)
    colour_rounds: int = 3
    autoregression: int = 24


@dataclass(frozen=True, slots=True)
class PriorContext:
    """What a prior may depend on.

    Attributes:
        vehicle: as declared. about: where the fit starts or the evidence is linear about.
        force_bias_std: what is left unknown of the accelerometer's bias, (3,).
        mass_free: whether the mass is estimated at all.
        base_std: standard deviation of a parameter in the base fit, for the joint estimate.
    """

    vehicle: Vehicle
    about: Parameters
    force_bias_std: Array
    mass_free: bool = True
    base_std: Callable[[str], float] = lambda name: np.inf


Get = Callable[[Parameters], float]
Put = Callable[[Parameters, float], Parameters]
Prior = Callable[[PriorContext], tuple[float, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Free:
    """One parameter of the fit.

    Attributes:
        name: in every document, with its unit last. symbol: in formulas. label: for people.
        get, put: read it from the model's parameters, and put it into them (within its plausible range).
        free: whether these options free it.
        prior: weak mean and standard deviation of a fit, which keep an unexcited direction finite; far wider than any
            claim.
        joint_std: standard deviation of the prior of its change in the diagnosis' joint estimate.
        plausible: range of any vehicle from 20 g to 10 kg.
        declared: what the vehicle file says; None where a file cannot say it.
        timing: it delays the inputs. A plan's own columns instrument it weakly: all columns of the plan do, channel by
            channel.
        held: standard deviation by which the instrumental estimate holds it at the prediction error estimate; None: it
            does not.
        offset: where a model carries its effects, they say this number instead.
    """

    name: str
    symbol: str
    label: str
    get: Get
    put: Put
    free: Callable[[FitOptions], bool]
    prior: Prior
    joint_std: Callable[[PriorContext], float]
    plausible: tuple[float, float] = (-np.inf, np.inf)
    declared: Callable[[Vehicle], float] | None = None
    timing: bool = False
    held: float | None = None
    offset: bool = False


def _trace(context: PriorContext) -> float:
    return float(np.trace(context.about.tensor))


def kept_by_name(name: str) -> tuple[Get, Put]:
    """Read and put a parameter that the model keeps by name."""
    return (
        lambda p: p.others.get(name, 0.0),
        lambda p, value: replace(p, others={**p.others, name: value}),
    )


def _mass() -> Free:
    return Free(
        name="mass_kg",
        symbol="m",
        label="mass",
        get=lambda p: p.mass_kg,
        put=lambda p, value: replace(p, mass_kg=value),
        free=lambda options: True,
        prior=lambda c: (c.about.mass_kg, c.about.mass_kg if c.mass_free else 1e-6 * c.about.mass_kg),
        joint_std=lambda c: 0.5 * c.about.mass_kg,
        plausible=(0.0, np.inf),
        declared=lambda vehicle: vehicle.mass_kg,
    )


def _tensor_entry(name: str, i: int, j: int) -> Free:
    def put(p: Parameters, value: float) -> Parameters:
        tensor = p.tensor.copy()
        tensor[i, j] = tensor[j, i] = value
        return replace(p, tensor=tensor)

    return Free(
        name=name,
        symbol=f"J_{name[1:3]}",
        label=f"I{name[1:3]}",
        get=lambda p: p.tensor[i, j],
        put=put,
        free=lambda options: True,
        prior=lambda c: (c.about.tensor[i, j], c.about.tensor[i, j] * 2.0 if i == j else 0.3 * _trace(c)),
        joint_std=_trace,
        plausible=(0.0, np.inf) if i == j else (-np.inf, np.inf),
        declared=lambda vehicle: float(getattr(vehicle.inertia_kg_m2, name[1:3])),
    )


LAG_RANGE_S = (0.0, 0.5)
"""No rotor that carries a vehicle takes half a second to follow."""


def _lag(side: str) -> Free:
    field_name = f"lag_{side}_s"
    return Free(
        name=f"rotor_lag_{side}_s",
        symbol=f"tau_{side}",
        label=f"rotor lag {side}",
        get=lambda p: getattr(p, field_name),
        put=lambda p, value: replace(p, **{field_name: float(np.clip(value, *LAG_RANGE_S))}),
        free=lambda options: options.lag and not options.symmetric_lag,
        prior=lambda c: (0.05, 0.15),
        joint_std=lambda c: 0.15,
        plausible=LAG_RANGE_S,
        declared=lambda vehicle: getattr(vehicle.rotors.lag, f"{side}_s"),
        timing=True,
    )


def _one_lag() -> Free:
    def put(p: Parameters, value: float) -> Parameters:
        lag = float(np.clip(value, *LAG_RANGE_S))
        return replace(p, lag_up_s=lag, lag_down_s=lag)

    return Free(
        name="rotor_lag_s",
        symbol="tau",
        label="rotor lag",
        get=lambda p: p.lag_up_s,
        put=put,
        free=lambda options: options.lag and options.symmetric_lag,
        prior=lambda c: (0.05, 0.15),
        joint_std=lambda c: 0.15,
        plausible=LAG_RANGE_S,
        timing=True,
    )


def _lag_slope() -> Free:
    """Decision 8: a plan's own columns say little of it, and the estimate ran away with it; it stays with its
    interval.
    """
    return Free(
        name="rotor_lag_slope",
        symbol="s",
        label="rotor lag slope",
        get=lambda p: p.lag_slope,
        put=lambda p, value: replace(p, lag_slope=float(np.clip(value, -1.0, 1.0))),
        free=lambda options: options.lag and not options.symmetric_lag,
        prior=lambda c: (0.0, 0.5),
        joint_std=lambda c: c.base_std("rotor_lag_slope"),
        plausible=(-1.0, 1.0),
        declared=lambda vehicle: 0.0,
        timing=True,
        held=0.001,
    )


def _delay() -> Free:
    return Free(
        name="input_delay_s",
        symbol="T_d",
        label="input delay",
        get=lambda p: p.delay_s,
        put=lambda p, value: replace(p, delay_s=value),
        free=lambda options: options.delay,
        prior=lambda c: (0.0, 0.05),
        joint_std=lambda c: 0.15,
        plausible=(0.0, 0.5),
        declared=lambda vehicle: 0.0,
        timing=True,
    )


ACCEL_DELAY_S = 2e-3
"""How far the delays of gyro and accelerometer (filters, sampling) usually differ."""


def _accel_delay() -> Free:
    """Forces later than torques. Gyro and accelerometer pass different filters, and held commands reach a rate through
    their integral, a force at once. Without this a millisecond between the two looks like thrust lost to climbing, as
    jerk runs against velocity. Only a joint estimate frees it, as a change about a fit: the fit itself has none.
    """
    return Free(
        name="accel_delay_s",
        symbol="T_a",
        label="accelerometer delay",
        get=lambda p: 0.0,
        put=lambda p, value: p,
        free=lambda options: options.accel_delay and options.delay,
        prior=lambda c: (0.0, ACCEL_DELAY_S),
        joint_std=lambda c: ACCEL_DELAY_S,
        timing=True,
    )


def _com(axis: int) -> Free:
    def put(p: Parameters, value: float) -> Parameters:
        com = p.com_m.copy()
        com[axis] = value
        return replace(p, com_m=com)

    letter = "xyz"[axis]
    return Free(
        name=f"com_offset_{letter}_m",
        symbol=f"c_{letter}",
        label=f"centre of mass {letter}",
        get=lambda p: p.com_m[axis],
        put=put,
        free=lambda options: options.com,
        prior=lambda c: (0.0, c.vehicle.arm_m()),
        joint_std=_trace,
        offset=True,
    )


def _yaw_trim() -> Free:
    return Free(
        name="yaw_trim_nm",
        symbol="tau_z0",
        label="yaw trim",
        get=lambda p: p.yaw_trim_nm,
        put=lambda p, value: replace(p, yaw_trim_nm=value),
        free=lambda options: options.yaw_trim,
        prior=lambda c: (0.0, c.about.mass_kg * 10.0 * c.vehicle.arm_m()),
        joint_std=_trace,
        offset=True,
    )


def _accel_bias(axis: int) -> Free:
    def put(p: Parameters, value: float) -> Parameters:
        bias = p.force_bias_m_s2.copy()
        bias[axis] = value
        return replace(p, force_bias_m_s2=bias)

    letter = "xyz"[axis]
    return Free(
        name=f"accel_bias_{letter}_m_s2",
        symbol=f"b_{letter}",
        label=f"accel bias {letter}",
        get=lambda p: p.force_bias_m_s2[axis],
        put=put,
        free=lambda options: axis + 3 in options.channels,
        prior=lambda c: (0.0, c.force_bias_std[axis]),
        joint_std=lambda c: max(float(c.force_bias_std[axis]), 1e-4),
    )


FREE: tuple[Free, ...] = (
    _mass(),
    *(_tensor_entry(name, *pair) for name, pair in zip(TENSOR, PAIRS, strict=True)),
    _delay(),
    _one_lag(),
    _lag("up"),
    _lag("down"),
    _lag_slope(),
    _com(0),
    _com(1),
    _yaw_trim(),
    *(_accel_bias(axis) for axis in range(3)),
    _accel_delay(),
)
"""Every parameter, in the order of a fit's columns."""


def table() -> dict[str, Free]:
    """The entries by name."""
    return {entry.name: entry for entry in FREE}


def free_entries(options: FitOptions) -> list[Free]:
    """What these options free, in the order of a fit's columns."""
    return [entry for entry in FREE if entry.free(options)]


def values_of(p: Parameters, names: Sequence[str], extra_names: Sequence[str] = ()) -> Array:
    """Values of the named parameters, those of wrench terms among them, (len(names),)."""
    entries, extra = table(), dict(zip(extra_names, p.extra, strict=True))
    return np.array([extra[name] if name in extra else entries[name].get(p) for name in names], dtype=float)


def with_values(p: Parameters, names: Sequence[str], values: Array, extra_names: Sequence[str] = ()) -> Parameters:
    """The parameters with the named ones at these values, within what is plausible of lags."""
    entries, found = table(), dict(zip(names, values, strict=True))
    for name, value in found.items():
        if name in entries:
            p = entries[name].put(p, value)
    return replace(p, extra=np.array([found[name] for name in extra_names]))


def declared_parameters(vehicle: Vehicle, *, lag_s: float = 0.0, extra: int = 0) -> Parameters:
    """The declared vehicle with a lag for where none is declared; speeds that were measured have their lag behind
    them.
    """
    rotors = vehicle.rotors
    return Parameters(
        mass_kg=vehicle.mass_kg,
        tensor=vehicle.inertia_tensor(),
        lag_up_s=0.0 if rotors.measured else rotors.lag.up_s or lag_s,
        lag_down_s=0.0 if rotors.measured else rotors.lag.down_s or lag_s,
        delay_s=0.0,
        com_m=np.zeros(3),
        yaw_trim_nm=0.0,
        force_bias_m_s2=np.zeros(3),
        extra=np.zeros(extra),
    )
