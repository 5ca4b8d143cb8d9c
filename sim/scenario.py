"""Scenario files: how good the sensors are, how the true vehicle differs, what else acts. Validated, all faults at
once.

A scenario is a TOML with the sections below, every key optional. The defaults are an ideal laboratory without noise,
lag, offsets and disturbance, so that a file says exactly what it adds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator

from groundstation.errors import BadInput
from groundstation.outside import read_toml
from groundstation.vehicle import Inertia, RotorLag, Vehicle
from sim.effects import Effects

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Vector3 = tuple[float, float, float]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True)


class Clock(_Section):
    """A device's clock and the way of its samples to the host.

    Attributes:
        offset_s: device time minus true time at the start.
        drift_ppm: rate error.
        jitter_s: standard deviation of the stamps against the true sampling instants.
        latency_s: from sampling to arrival.
        latency_jitter_s: mean of an exponential delay on top.
        phase: first sample after this share of a period; None draws it.
    """

    offset_s: float = 0.0
    drift_ppm: float = 0.0
    jitter_s: NonNegative = 0.0
    latency_s: NonNegative = 0.0
    latency_jitter_s: NonNegative = 0.0
    phase: Share | None = 0.0


class ImuModel(_Section):
    """Inertial sensor; densities are one-sided, so that a sample's standard deviation is density sqrt(rate/2).

    Attributes:
        rate_hz: samples per second.
        gyro_density: rad/s per sqrt(Hz).
        accel_density: m/s^2 per sqrt(Hz).
        gyro_bias_std: of each axis' bias, drawn once, rad/s.
        accel_bias_std: of each axis' bias, drawn once, m/s^2.
        gyro_walk: of the bias, rad/s per sqrt(s).
        accel_walk: of the bias, m/s^2 per sqrt(s).
        clock: see :class:`Clock`.
    """

    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] = 500.0
    gyro_density: NonNegative = 0.0
    accel_density: NonNegative = 0.0
    gyro_bias_std: NonNegative = 0.0
    accel_bias_std: NonNegative = 0.0
    gyro_walk: NonNegative = 0.0
    accel_walk: NonNegative = 0.0
    clock: Clock = Clock()


class MocapModel(_Section):
    """Motion capture.

    Attributes:
        rate_hz: poses per second.
        position_std_m: noise of each coordinate.
        attitude_std_rad: noise of each component of the rotation vector.
        dropouts_per_minute: how often the body is lost.
        dropout_s: mean length of a loss (exponential).
        freezes_per_minute: how often the tracker repeats its last pose.
        freeze_s: mean length of a freeze.
        clock: see :class:`Clock`.
    """

    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] = 120.0
    position_std_m: NonNegative = 0.0
    attitude_std_rad: NonNegative = 0.0
    dropouts_per_minute: NonNegative = 0.0
    dropout_s: Positive = 0.2
    freezes_per_minute: NonNegative = 0.0
    freeze_s: Positive = 0.1
    clock: Clock = Clock()


class MotorModel(_Section):
    """Rotor-speed telemetry, where the vehicle has it (else commands are recorded at the control rate).

    Attributes:
        rate_hz: samples per second.
        noise_share: standard deviation as a share of the hover value.
        clock: see :class:`Clock`; also stamps setpoints and the vehicle's own state.
    """

    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] = 500.0
    noise_share: NonNegative = 0.0
    clock: Clock = Clock()


class BatteryModel(_Section):
    """Battery and its telemetry; what the vehicle file leaves out is sized for twelve minutes of hover.

    Attributes:
        rate_hz: samples per second.
        voltage_std_v: noise.
        current_std_a: noise.
        start_charge: share of charge at the start.
        capacity_as: overrides the vehicle file's.
        resistance_ohm: overrides the vehicle file's.
        clock: see :class:`Clock`.
    """

    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] = 10.0
    voltage_std_v: NonNegative = 0.0
    current_std_a: NonNegative = 0.0
    start_charge: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    capacity_as: Positive | None = None
    resistance_ohm: NonNegative | None = None
    clock: Clock = Clock()


class StreamRate(_Section):
    """Rate of a stream the flight software makes; 0 leaves it out."""

    rate_hz: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0


class ControlModel(_Section):
    """Rates of the control loops; the position loop holds its output in between (zero-order hold)."""

    attitude_hz: Literal[1000, 500, 250, 200, 125, 100] = 500
    position_hz: Annotated[float, Field(gt=0.0, le=500.0)] = 100.0


class DisturbanceModel(_Section):
    """Coloured force (world) and torque (body) on every axis.

    Attributes:
        force_share: RMS of each component over the weight.
        torque_share: RMS of each component over weight times arm.
        correlation_s: time constant.
        order: 1 is an Ornstein-Uhlenbeck process, 2 the same passed once more through its lag.
    """

    force_share: NonNegative = 0.0
    torque_share: NonNegative = 0.0
    correlation_s: Annotated[float, Field(ge=0.01)] = 0.5
    order: Literal[1, 2] = 1


class Truth(_Section):
    """How the true vehicle differs from the declared one; absolute values go before factors.

    Attributes:
        mass_kg: true mass.
        mass_factor: true over declared mass.
        inertia_kg_m2: true tensor.
        inertia_factor: true over declared xx, yy, zz.
        product_share: true xy, xz, yz as shares of the true trace.
        lag: true first-order lag of the rotors.
    """

    mass_kg: Positive | None = None
    mass_factor: Positive = 1.0
    inertia_kg_m2: Inertia | None = None
    inertia_factor: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    product_share: Vector3 | None = None
    lag: RotorLag | None = None


class Start(_Section):
    """Where the vehicle stands: the origin's position when its feet are on the floor, and its heading."""

    position_m: Vector3 = (0.0, 0.0, 0.1)
    yaw_rad: float = 0.0


class Scenario(_Section):
    """One simulated world. Construct with :func:`load_scenario` or :func:`scenario_from_dict`."""

    name: str = "clean"
    imu: ImuModel = ImuModel()
    mocap: MocapModel = MocapModel()
    motors: MotorModel = MotorModel()
    battery: BatteryModel = BatteryModel()
    setpoint: StreamRate = StreamRate(rate_hz=50.0)
    state: StreamRate = StreamRate()
    control: ControlModel = ControlModel()
    disturbance: DisturbanceModel = DisturbanceModel()
    truth: Truth = Truth()
    start: Start = Start()
    effects: Effects = Effects()

    @field_validator("effects", mode="before")
    @classmethod
    def _tables(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        switched_off = Effects()
        unknown = sorted(set(value) - set(Effects._fields))
        if unknown:
            raise ValueError(f"unknown effect '{unknown[0]}'; there are {', '.join(Effects._fields)}")
        chosen = {}
        for name, table in value.items():
            try:
                chosen[name] = TypeAdapter(type(getattr(switched_off, name))).validate_python(table)
            except ValidationError as error:
                first = error.errors()[0]
                raise ValueError(f"{name}.{'.'.join(map(str, first['loc']))}: {first['msg'].lower()}") from None
        return switched_off._replace(**chosen)


def true_vehicle(declared: Vehicle, scenario: Scenario) -> Vehicle:
    """The vehicle as it is: mass, tensor and lag by ``[truth]``, the rest as declared.

    Raises:
        BadInput: the tensor belongs to no rigid body.
    """
    truth = scenario.truth
    inertia = truth.inertia_kg_m2
    if inertia is None:
        diagonal = np.diag(declared.inertia_tensor()) * np.array(truth.inertia_factor)
        products = np.array([declared.inertia_kg_m2.xy, declared.inertia_kg_m2.xz, declared.inertia_kg_m2.yz])
        if truth.product_share is not None:
            products = np.array(truth.product_share) * diagonal.sum()
        names = ("xx", "yy", "zz", "xy", "xz", "yz")
        entries = dict(zip(names, map(float, [*diagonal, *products]), strict=True))
        try:
            inertia = Inertia(**entries)
        except ValidationError:
            raise BadInput(
                "scenario: [truth] makes a tensor that is not positive definite; lessen its products."
            ) from None
    moments = np.linalg.eigvalsh(inertia.tensor())
    if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
        raise BadInput(
            "scenario: the true tensor breaks the triangle inequality (largest principal moment "
            f"{moments[2]:.4g} > {moments[0]:.4g} + {moments[1]:.4g}); no rigid body has it, change [truth]."
        )
    lag = truth.lag or declared.rotors.lag
    return declared.model_copy(
        update={
            "mass_kg": truth.mass_kg or declared.mass_kg * truth.mass_factor,
            "inertia_kg_m2": inertia,
            "rotors": declared.rotors.model_copy(update={"lag": lag}),
        }
    )


RENAMED = {"angular_damping": {"linear_nm_s": "damping_nms"}, "flapping_moment": {"moment_n_s": "k_nm_s_m"}}
"""Effect -> key in scenario files of earlier versions -> key now, the name that estimates have."""


def _with_new_names(document: dict) -> dict:
    effects = document.get("effects")
    if not isinstance(effects, dict):
        return document
    renamed = {
        name: {RENAMED.get(name, {}).get(key, key): v for key, v in values.items()}
        if isinstance(values, dict)
        else values
        for name, values in effects.items()
    }
    return {**document, "effects": renamed}


def scenario_from_dict(document: dict, source: str = "scenario") -> Scenario:
    """Validate a parsed scenario.

    Raises:
        BadInput: one sentence that names every fault and the file.
    """
    try:
        return Scenario.model_validate(_with_new_names(document) if isinstance(document, dict) else document)
    except ValidationError as error:
        faults = "; ".join(
            f"{'.'.join(map(str, e['loc'])) or 'scenario'}: {e['msg'].removeprefix('Value error, ')}"
            for e in error.errors()
        )
        raise BadInput(f"{source}: {faults}. Correct it; sim/scenario.py documents every key.") from None


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file; its name is the file's unless it gives one.

    Raises:
        BadInput: the file is missing, no TOML, or wrong.
    """
    path = Path(path)
    document = read_toml(path, "a scenario file")
    return scenario_from_dict({"name": path.stem, **document}, str(path))
