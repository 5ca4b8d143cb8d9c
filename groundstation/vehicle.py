"""The vehicle as it is declared before a flight: ``vehicle.toml`` of the flight bundle, validated.

Every section and default is described in ``configs/vehicles/``. A loader collects all faults of a file and reports them
in one sentence. Nothing here is estimated; estimates live in ``groundstation.identification``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from groundstation.errors import BadInput
from groundstation.json_types import JsonObject
from groundstation.outside import read_toml
from groundstation.targets import parse_targets

Array = NDArray[np.float64]
Vector3 = tuple[float, float, float]
Positive = Annotated[float, Field(ge=1e-15, le=1e12)]
NonNegative = Annotated[float, Field(ge=0.0, le=1e12)]
"""Beyond any vehicle, in any unit used here, and far from where products of three of them overflow or vanish."""

INERTIA_NAMES = ("xx", "xy", "xz", "yy", "yz", "zz")
"""Order of the tensor's entries in every parameter vector, as in the seed paper's Theta (eq. 12)."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Inertia(_Section):
    """Entries of the tensor about the centre of mass, body axes, kg m^2 (``xy`` is the entry itself, not its
    negative).
    """

    xx: Positive
    yy: Positive
    zz: Positive
    xy: float = 0.0
    xz: float = 0.0
    yz: float = 0.0

    def tensor(self) -> Array:
        """The symmetric tensor, shape (3, 3)."""
        return np.array(
            [[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]], dtype=float
        )

    @model_validator(mode="after")
    def _positive_definite(self) -> Inertia:
        if np.linalg.eigvalsh(self.tensor())[0] <= 0.0:
            raise ValueError("the tensor is not positive definite; check the signs and sizes of its products")
        return self


class RotorLag(_Section):
    """Declared first-order lag from command to rotor speed, seconds, speeding up and slowing down."""

    up_s: NonNegative = 0.0
    down_s: NonNegative = 0.0


class Rotors(_Section):
    """Geometry and constants of the rotors; rotor i makes T_i = k Omega_i^2 along its axis a_i and the torque -spin_i c
    T_i a_i.

    ``axis`` are the directions of thrust in the body; None: all along body z.
    """

    position_m: tuple[Vector3, ...]
    spin: tuple[Literal[-1, 1], ...]
    axis: tuple[Vector3, ...] | None = None
    radius_m: Positive = 0.1
    thrust_coefficient_n_s2: Positive | None = None
    torque_to_thrust_m: Positive
    speed_max_rad_s: Positive | None = None
    input: Literal["rotor_speed", "command", "wrench"] = "rotor_speed"
    speed_source: Literal["telemetry", "command"] = "telemetry"
    thrust_curve: Vector3 | None = None
    lag: RotorLag = RotorLag()

    @property
    def measured(self) -> bool:
        """Whether recorded inputs are speeds that were measured, not what was asked of the rotors."""
        return self.input == "rotor_speed" and self.speed_source == "telemetry"

    @field_validator("position_m")
    @classmethod
    def _enough_rotors(cls, value: tuple[Vector3, ...]) -> tuple[Vector3, ...]:
        if not 3 <= len(value) <= 16:
            raise ValueError(f"{len(value)} rotors given; 3 to 16 are supported")
        return value

    @field_validator("axis")
    @classmethod
    def _unit_axes(cls, value: tuple[Vector3, ...] | None) -> tuple[Vector3, ...] | None:
        for i, axis in enumerate(value or (), start=1):
            if not 0.999 <= float(np.linalg.norm(axis)) <= 1.001:
                raise ValueError(f"the axis of rotor {i}, {list(axis)}, is no unit vector; divide it by its length")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Rotors:
        if len(self.spin) != len(self.position_m):
            raise ValueError(f"spin has {len(self.spin)} entries for {len(self.position_m)} rotor positions")
        if self.axis is not None and len(self.axis) != len(self.position_m):
            raise ValueError(f"axis has {len(self.axis)} entries for {len(self.position_m)} rotor positions")
        if self.input == "command" and self.thrust_curve is not None:
            return self
        if self.input == "wrench":
            return self
        if self.thrust_curve is not None:
            raise ValueError('thrust_curve maps commands to thrust and needs input = "command"')
        if self.thrust_coefficient_n_s2 is None:
            raise ValueError("thrust_coefficient_n_s2 is missing (only a thrust_curve or a wrench input replaces it)")
        if self.input == "command" and self.speed_max_rad_s is None:
            raise ValueError('speed_max_rad_s is missing: input = "command" needs it or a thrust_curve')
        return self

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.position_m)

    @property
    def tilted(self) -> bool:
        """Whether any rotor's thrust is not along body z."""
        return self.axis is not None and any(tuple(axis) != (0.0, 0.0, 1.0) for axis in self.axis)

    def axes(self) -> Array:
        """Unit vector of each rotor's thrust in the body, shape (n, 3)."""
        axes = np.asarray(self.axis or ((0.0, 0.0, 1.0),) * self.count, dtype=float)
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True), dtype=float)


class Imu(_Section):
    """Where the IMU sits in the body, and the cut-off of its driver's low-pass filter (None: unfiltered)."""

    position_m: Vector3 = (0.0, 0.0, 0.0)
    filter_hz: Positive | None = None


class Mocap(_Section):
    """The tracked point in the body, and the rotation vector from the body to the marker frame."""

    position_m: Vector3 = (0.0, 0.0, 0.0)
    rotation_rad: Vector3 = (0.0, 0.0, 0.0)


class Battery(_Section):
    """Full voltage (None: the flight's highest), and what a plan may draw."""

    full_v: Positive | None = None
    empty_v: Positive | None = None
    capacity_as: Positive | None = None
    internal_resistance_ohm: NonNegative = 0.0


class Limits(_Section):
    """What a plan for this vehicle must keep. None: no limit."""

    x_max_m: Positive | None = None
    y_max_m: Positive | None = None
    z_min_m: float | None = None
    z_max_m: float | None = None
    yaw_max_rad: Positive | None = None
    speed_max_m_s: Positive | None = None
    yaw_rate_max_rad_s: Positive | None = None
    acceleration_max_m_s2: Positive | None = None
    tilt_max_rad: Positive | None = None
    thrust_max_n: Positive | None = None
    torque_max_nm: Positive | None = None


class Control(_Section):
    """Gains of the simulated vehicle's controller (seed paper eq. 28-32), and the rates its loops sample at."""

    position_p: Vector3 = (11.5, 10.0, 10.5)
    position_i: Vector3 = (0.04, 0.07, 1.3)
    position_d: Vector3 = (5.5, 5.0, 6.0)
    attitude_p: Vector3 = (2.0, 2.0, 2.6)
    attitude_i: Vector3 = (0.03, 0.05, 0.01)
    attitude_d: Vector3 = (0.6, 0.6, 1.0)
    derivative_filter_rad_s: Positive = 20.0


class Until(_Section):
    """How long a flight lasts where its length is decided in flight: until ``targets`` are met, ``at_most_s`` of
    excitation at the most.
    """

    targets: str
    at_most_s: Positive = 80.0

    @field_validator("targets")
    @classmethod
    def _are_targets(cls, value: str) -> str:
        try:
            parse_targets(value)
        except BadInput as error:
            raise ValueError(str(error)) from None
        return value


class IdentificationSettings(_Section):
    """Constants of the place, how surely the declared values are known, and what anchors the scale."""

    air_density_kg_m3: Positive = 1.20
    gravity_m_s2: Positive = 9.80665
    mass_std_kg: NonNegative = 0.0
    thrust_coefficient_std: NonNegative = 0.0
    torque_to_thrust_std: NonNegative = 0.0
    anchor: Literal["thrust", "mass"] = "thrust"


class Vehicle(_Section):
    """A declared vehicle. Construct with :func:`load_vehicle` or :func:`vehicle_from_dict`."""

    name: str
    mass_kg: Positive
    inertia_kg_m2: Inertia
    rotors: Rotors
    imu: Imu = Imu()
    mocap: Mocap = Mocap()
    battery: Battery = Battery()
    limits: Limits = Limits()
    control: Control = Control()
    identification: IdentificationSettings = IdentificationSettings()
    until: Until | None = None

    @property
    def gravity_m_s2(self) -> float:
        """Local gravity."""
        return self.identification.gravity_m_s2

    def inertia_tensor(self) -> Array:
        """Declared tensor about the centre of mass, shape (3, 3), kg m^2."""
        return self.inertia_kg_m2.tensor()

    def parameters(self) -> dict[str, float]:
        """What is declared of the quantities an identification estimates, under the names its results use."""
        tensor = {f"i{axes}_kg_m2": float(getattr(self.inertia_kg_m2, axes)) for axes in INERTIA_NAMES}
        lag = {"rotor_lag_up_s": self.rotors.lag.up_s, "rotor_lag_down_s": self.rotors.lag.down_s}
        values = {"mass_kg": self.mass_kg, **tensor, **lag, "torque_to_thrust_m": self.rotors.torque_to_thrust_m}
        if self.rotors.thrust_coefficient_n_s2 is not None:
            values["thrust_coefficient_n_s2"] = self.rotors.thrust_coefficient_n_s2
        return values

    def allocation(self) -> Array:
        """Map rotor thrusts (n,) to [F_z, tau_x, tau_y, tau_z] about the declared origin, shape (4, n)."""
        return self.six_row_allocation()[2:]

    def six_row_allocation(self) -> Array:
        """Map rotor thrusts (n,) to body force and torque about the declared origin, shape (6, n).

        F = sum T_i a_i, tau = sum r_i x T_i a_i - spin_i c T_i a_i.
        """
        axes, position = self.rotors.axes(), np.asarray(self.rotors.position_m, dtype=float)
        reaction = -np.asarray(self.rotors.spin, dtype=float) * self.rotors.torque_to_thrust_m
        return np.concatenate([axes.T, (np.cross(position, axes) + reaction[:, None] * axes).T])

    def mixing(self) -> Array:
        """The smallest rotor thrusts that make [F_z, tau_x, tau_y, tau_z], shape (n, 4); tilted ones push sideways
        besides.
        """
        return np.asarray(np.linalg.pinv(self.allocation()), dtype=float)

    def turns_freely(self) -> bool:
        """Whether no rotor makes a torque about z, as three whose tilts cancel their reaction torques: yaw is nobody's
        to steer.
        """
        allocation = self.allocation()
        return bool(np.abs(allocation[3]).max() < 1e-3 * self.rotors.torque_to_thrust_m)

    def thrust(self, motor: ArrayLike, voltage_ratio: ArrayLike = 1.0) -> Array:
        """Declared thrust of each rotor in newton from the motor values of ``rotors.input``.

        Args:
            motor: rotor speed in rad/s, or normalised command, shape (..., n).
            voltage_ratio: battery voltage over full voltage; scales the speed a command gives.
        """
        value = np.asarray(motor, dtype=float)
        if self.rotors.input == "command":
            value = value * np.asarray(voltage_ratio, dtype=float)
            if self.rotors.thrust_curve is not None:
                c0, c1, c2 = self.rotors.thrust_curve
                return c0 + c1 * value + c2 * value**2
            value = value * (self.rotors.speed_max_rad_s or 0.0)
        return (self.rotors.thrust_coefficient_n_s2 or 0.0) * value**2

    def motor_for_thrust(self, thrust_n: ArrayLike) -> Array:
        """Motor value (speed or command) that gives a thrust by the declared constants; inverse of :meth:`thrust`."""
        thrust = np.maximum(np.asarray(thrust_n, dtype=float), 0.0)
        if self.rotors.thrust_curve is not None:
            c0, c1, c2 = self.rotors.thrust_curve
            if abs(c2) < 1e-12:
                return np.maximum((thrust - c0) / c1, 0.0)
            return np.maximum((-c1 + np.sqrt(np.maximum(c1**2 - 4 * c2 * (c0 - thrust), 0.0))) / (2 * c2), 0.0)
        speed = np.sqrt(thrust / (self.rotors.thrust_coefficient_n_s2 or 1.0))
        return speed / (self.rotors.speed_max_rad_s or 1.0) if self.rotors.input == "command" else speed

    def rotor_thrust_max_n(self) -> float:
        """Largest thrust of one rotor: by its top speed, its thrust curve at full command, or the declared total."""
        if self.rotors.thrust_curve is not None:
            return float(sum(self.rotors.thrust_curve))
        if self.rotors.speed_max_rad_s is not None and self.rotors.thrust_coefficient_n_s2 is not None:
            return self.rotors.thrust_coefficient_n_s2 * self.rotors.speed_max_rad_s**2
        if self.limits.thrust_max_n is not None:
            return self.limits.thrust_max_n / self.rotors.count
        return float("inf")

    def arm_m(self) -> float:
        """Mean distance of the rotors from the origin, in the rotor plane."""
        return float(np.mean(np.linalg.norm(np.asarray(self.rotors.position_m)[:, :2], axis=1)))


_TOP = {"vehicle", "rotors", "imu", "mocap", "battery", "limits", "control", "identification", "until"}


def _flatten(document: dict) -> dict:
    """Move ``[vehicle]`` keys to the top, where the model has them."""
    body = document.get("vehicle")
    if not isinstance(body, dict):
        raise BadInput("the [vehicle] section is missing; it needs name, mass_kg and [vehicle.inertia_kg_m2]")
    unknown = sorted(set(document) - _TOP)
    if unknown:
        raise BadInput(f"unknown section [{unknown[0]}]; known are {', '.join(sorted(_TOP))}")
    rest = {key: value for key, value in document.items() if key != "vehicle"}
    clash = sorted(set(body) & set(rest))
    if clash:
        raise BadInput(f"unknown key '{clash[0]}' in [vehicle]")
    return {**body, **rest}


def _fault(error: dict) -> str:
    path = [str(part) for part in error["loc"]]
    head = path[0] if path else ""
    place = ".".join(path if head in _TOP else ["vehicle", *path])
    if error["type"] == "extra_forbidden":
        return f"{place} is not a known key"
    if error["type"] == "missing":
        return f"{place} is missing"
    text = error["msg"].removeprefix("Value error, ")
    return f"{place}: {text[0].lower() + text[1:] if text else 'is wrong'}"


def vehicle_from_dict(document: JsonObject, source: str = "vehicle.toml") -> Vehicle:
    """Validate a parsed ``vehicle.toml``.

    Raises:
        BadInput: one sentence that names every fault and the file.
    """
    try:
        return Vehicle.model_validate(_flatten(document))
    except ValidationError as error:
        faults = "; ".join(_fault(dict(item)) for item in error.errors())
        raise BadInput(f"{source}: {faults}. Correct it; configs/vehicles/ documents every key.") from None
    except BadInput as error:
        raise BadInput(f"{source}: {error}.") from None


def load_vehicle(path: str | Path) -> Vehicle:
    """Read a vehicle file.

    Raises:
        BadInput: the file is missing, no TOML, or wrong; all faults at once.
    """
    path = Path(path)
    document = read_toml(path, "a vehicle file")
    return vehicle_from_dict(document, str(path))


def vehicle_to_dict(vehicle: Vehicle) -> dict:
    """The document that :func:`vehicle_from_dict` reads back to an equal vehicle.

    Gains that were never given stay out: their absence tells the simulator to tune its own.
    """
    sections = vehicle.model_dump(exclude_none=True, mode="json")
    if "control" not in vehicle.model_fields_set:
        sections.pop("control")
    body = {key: sections.pop(key) for key in ("name", "mass_kg", "inertia_kg_m2")}
    return {"vehicle": body, **sections}
