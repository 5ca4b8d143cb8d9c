"""What an identification yields: values with intervals, per method, and the reasons."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from groundstation.json_types import JsonObject
from groundstation.tabular import Record, Tabular

if TYPE_CHECKING:  # numba takes a second to import, and only the type is needed
    from groundstation.model.disturbance import TurningDisturbance

Array = NDArray[np.float64]

MASS_AND_TENSOR = (
    *("mass_kg", "ixx_kg_m2", "ixy_kg_m2", "ixz_kg_m2"),
    *("iyy_kg_m2", "iyz_kg_m2", "izz_kg_m2"),
)
"""Theta of the seed paper (eq. 12), under the names used in JSON."""

OUTPUTS = ("force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
"""Rows of the seed paper's regressor (eq. 12)."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value, its standard deviation and its 95 % interval, in the unit its name carries."""

    value: float
    std: float
    ci95: tuple[float, float]

    @classmethod
    def normal(cls, value: float, std: float) -> Estimate:
        """With a Gaussian interval."""
        return cls(float(value), float(std), (float(value - 1.959964 * std), float(value + 1.959964 * std)))

    @classmethod
    def time(cls, value: float, std: float, step_s: float = 0.0) -> Estimate:
        """A lag or delay, which is not negative, nor is its interval.

        When within an interval of recorded commands ``step_s`` one took effect, and by which steps an autopilot or
        simulator runs a lag, no record says: a lag tau in Euler steps of h acts as one of -h / ln(1 - h / tau), about
        tau - h / 2. Lag and dead time carry that as an error that is uniform over the interval.
        """
        std = float(np.hypot(std, step_s / np.sqrt(12.0)))
        low = max(0.0, value - 1.96 * std)
        return cls(max(value, 0.0), std, (low, max(low, value + 1.96 * std)))

    def to_dict(self) -> JsonObject:
        """JSON form of docs/formats.md."""
        return {"value": self.value, "std": self.std, "ci95": list(self.ci95)}


@dataclass(frozen=True, slots=True)
class Evolution:
    """How the estimates of a method moved as data came in (seed paper, Figures 4 and 5)."""

    t_s: Array
    values: Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class MethodResult:
    """One method's answer. Parameters that the flight does not reveal are absent.

    ``covariance`` is of mass and tensor, (7, 7) in the order of MASS_AND_TENSOR; None where the method gives none.
    """

    parameters: Mapping[str, Estimate]
    condition_number: float | None = None
    rms_output_error: Mapping[str, float] = field(default_factory=dict[str, float])
    evolution: Evolution | None = None
    note: str = ""
    covariance: Array | None = None

    def without(self, names: Collection[str]) -> MethodResult:
        """The same without some of its parameters."""
        return replace(self, parameters={key: value for key, value in self.parameters.items() if key not in names})

    def to_dict(self) -> JsonObject:
        """JSON form of docs/formats.md."""
        return {
            "parameters": {name: estimate.to_dict() for name, estimate in self.parameters.items()},
            "condition_number": self.condition_number,
            "rms_output_error": dict(self.rms_output_error),
            "note": self.note,
        }


@dataclass(frozen=True, slots=True)
class Revealed:
    """A combination of mass and tensor, and what all of it makes of torque and force in this motion: a share of weight
    (times arm).

    ``combination`` holds the weight of each parameter, in units of its declared value (products: of the trace); squares
    add up to 1.
    """

    share: float
    combination: Mapping[str, float]

    def to_dict(self) -> JsonObject:
        """JSON form."""
        return {"share": self.share, "combination": dict(self.combination)}


@dataclass(frozen=True, slots=True)
class Clock:
    """Motion-capture stamp minus IMU stamp of one instant, at the middle of the flight, and its drift (s/s).

    ``online_s`` within ``online_error_s`` is what the link knew of it in flight, without looking at the motion; None
    where it told nothing.
    """

    mocap_minus_imu_s: float
    std_s: float
    drift: float = 0.0
    drift_std: float = 0.0
    online_s: float | None = None
    online_error_s: float | None = None

    @property
    def agrees(self) -> bool | None:
        """Whether both intervals meet; None without the link's."""
        if self.online_s is None or self.online_error_s is None:
            return None
        return abs(self.online_s - self.mocap_minus_imu_s) <= self.online_error_s + 1.959964 * self.std_s


@dataclass(frozen=True, slots=True)
class Validation:
    """RMS errors of one check, by signal, for each parameter set ("nominal", "LS", ...).

    ``kind`` is "output" (eq. 43), "closed_loop" (Table 4) or "prediction".
    """

    kind: str
    rms: Mapping[str, Mapping[str, float]]
    samples: int
    note: str = ""


@dataclass(frozen=True, slots=True)
class Identification(Tabular):
    """The result of ``identify``.

    Attributes:
        methods: by name: LS, GD, FMLS, FMGD of the seed, and ours.
        model: the other parameters of the best model: lag, delay, thrust constants, biases, ...
        best: which method the model is taken from; ``best_reason`` says why, in a sentence.
        not_identifiable: parameter name -> what motion or stream would reveal it.
        bound: Cramer-Rao standard deviation of each parameter on this flight, disturbance counted.
        window_s: the part of the flight that was used, on the IMU's clock (motors' without IMU).
        revealed: which combinations of mass and tensor the motion acted on, and how strongly, before any fit.
        disturbance: what turned the vehicle beside the model; None where it was not estimated.
        prediction: the ``[prediction]`` section of a model file; empty where it was not asked for or the flights are
            too short.
        quality: repairs and data-compatibility findings, one sentence each.
    """

    flight: str
    vehicle: str
    anchor: str
    methods: Mapping[str, MethodResult]
    model: Mapping[str, Estimate]
    best: str
    best_reason: str = ""
    clock: Clock | None = None
    not_identifiable: Mapping[str, str] = field(default_factory=dict[str, str])
    warnings: tuple[str, ...] = ()
    bound: Mapping[str, float] = field(default_factory=dict[str, float])
    window_s: tuple[float, float] = (0.0, 0.0)
    excluded_s: tuple[tuple[float, float], ...] = ()
    quality: tuple[str, ...] = ()
    validation: tuple[Validation, ...] = ()
    revealed: tuple[Revealed, ...] = ()
    disturbance: TurningDisturbance | None = None
    declarations: tuple[Mapping[str, Any], ...] = ()
    prediction: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def records(self) -> list[Record]:
        """One row per parameter: the best method's estimate with its 95 % interval; None where the flight does not
        tell.
        """
        best = self.methods.get(self.best)
        found = {**(best.parameters if best else {}), **self.model}
        rows: list[Record] = [
            {"parameter": name, "value": e.value, "std": e.std, "low": e.ci95[0], "high": e.ci95[1]}
            for name, e in found.items()
        ]
        nothing = {"value": None, "std": None, "low": None, "high": None}
        return rows + [{"parameter": name, **nothing} for name in self.not_identifiable if name not in found]

    def _title(self) -> str:
        return f"{self.flight}: {self.vehicle}, identified by {self.best}, 95 % intervals"

    def to_dict(self) -> JsonObject:
        """The document ``identify --json`` prints (docs/formats.md)."""
        clock = self.clock
        return {
            "schema": "groundstation.identification/1",
            "flight": self.flight,
            "vehicle": self.vehicle,
            "anchor": self.anchor,
            "methods": {name: method.to_dict() for name, method in self.methods.items()},
            "model": {name: estimate.to_dict() for name, estimate in self.model.items()},
            "best": self.best,
            "best_reason": self.best_reason,
            "clock": None
            if clock is None
            else {
                "mocap_minus_imu_s": clock.mocap_minus_imu_s,
                "std_s": clock.std_s,
                "drift": clock.drift,
                "drift_std": clock.drift_std,
                "online_s": clock.online_s,
                "online_error_s": clock.online_error_s,
                "online_agrees": clock.agrees,
            },
            "not_identifiable": list(self.not_identifiable),
            "remedies": dict(self.not_identifiable),
            "prediction": dict(self.prediction),
            "revealed": [each.to_dict() for each in self.revealed],
            "declarations": [dict(check) for check in self.declarations],
            "warnings": list(self.warnings),
            "bound": dict(self.bound),
            "window_s": list(self.window_s),
            "excluded_s": [list(pair) for pair in self.excluded_s],
            "quality": list(self.quality),
            "validation": [
                {"kind": v.kind, "samples": v.samples, "note": v.note, "rms": {k: dict(r) for k, r in v.rms.items()}}
                for v in self.validation
            ],
        }
