"""The station file: the room, the limits and what happens at each, and what the operator's policy is.

Validated whole.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from groundstation.errors import BadInput
from groundstation.outside import read_toml
from groundstation.paths import find_config
from groundstation.vehicle import Until

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Vector3 = tuple[float, float, float]
ActionName = Literal["hold", "land", "kill"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Limit(_Section):
    """One limit: past ``limit`` for ``for_s`` seconds without a break, do ``action``."""

    limit: NonNegative
    action: ActionName = "land"
    for_s: NonNegative = 0.0


class Box(_Section):
    """Where the vehicle may be, in the plan's frame, metres (lowest, highest)."""

    x_m: tuple[float, float] = (-3.0, 3.0)
    y_m: tuple[float, float] = (-3.0, 3.0)
    z_m: tuple[float, float] = (-0.5, 3.0)

    @model_validator(mode="after")
    def _ordered(self) -> Box:
        for name in ("x_m", "y_m", "z_m"):
            low, high = getattr(self, name)
            if low >= high:
                raise ValueError(f"{name}: the lowest ({low:g}) must be below the highest ({high:g})")
        return self


class GuardLimits(_Section):
    """Every limit of the guard; the unit stands in the comment of ``configs/stations/default.toml``."""

    box: Limit = Limit(limit=0.0, for_s=0.1)
    speed: Limit = Limit(limit=3.0, for_s=0.1)
    tilt: Limit = Limit(limit=0.7, for_s=0.1)
    tracking: Limit = Limit(limit=1.2, for_s=0.3)
    pose_age: Limit = Limit(limit=0.3)
    pose_disagreement: Limit = Limit(limit=0.4, for_s=0.2)
    state_age: Limit = Limit(limit=0.9)
    link_age: Limit = Limit(limit=0.8)
    battery: Limit = Limit(limit=0.15, for_s=2.0)
    estimator_reset: Limit = Limit(limit=0.3)
    oscillation: Limit = Limit(limit=0.8, for_s=0.5)
    core_silent: Limit = Limit(limit=3.0)
    setpoint_age: Limit = Limit(limit=0.4)
    abort: Limit = Limit(limit=0.0)


class Policy(_Section):
    """How the station flies.

    Attributes:
        placement: ``takeoff``: the plan's origin is where the vehicle stands (no common frame is known);
            ``world``: the plan is in the frame of the poses.
        setpoint_hz: how often setpoints leave.
        climb_m_s: of take-off and approach.
        settle_s: hover before and after the excitation.
        settled_error_m, settled_speed_m_s: the excitation starts only within these.
        settle_timeout_s: lands if it has not settled by then.
        hold_s: a hold becomes a landing after this.
        when_core_is_silent: land, or complete the plan first.
        trajectory: ``auto``: flown on board by our script where the autopilot takes it, else by setpoints from the
            link; ``setpoints``: always by setpoints.
    """

    placement: Literal["takeoff", "world"] = "takeoff"
    setpoint_hz: Annotated[float, Field(ge=10.0, le=400.0)] = 50.0
    climb_m_s: Positive = 0.4
    settle_s: Positive = 3.0
    settled_error_m: Positive = 0.3
    settled_speed_m_s: Positive = 0.3
    settle_timeout_s: Positive = 15.0
    hold_s: Positive = 5.0
    when_core_is_silent: Literal["land", "complete"] = "land"
    trajectory: Literal["auto", "setpoints"] = "auto"


class MarkerCalibration(_Section):
    """How the marker body sits on the vehicle, as ``groundstation calibrate`` measured it; SI, body axes.

    Attributes:
        body: name of the marker body that was measured.
        measured: day, "2026-11-29".
        position_m, position_std_m: its origin from the IMU.
        rotation_rad, rotation_std_rad: rotation vector from its axes to the body's.
        tilt_rad: of the poses' world against gravity, about x and y.
        scale: the poses' metre is this much too long, as a share.
        delay_s, delay_std_s: how much later than the exposure stamps are, beyond what the protocol tells; the driver
            takes it off them, so that they are those of the exposure for everyone: vehicle, recording, guard.
    """

    body: str
    measured: str
    position_m: Vector3
    position_std_m: Vector3 = (0.001, 0.001, 0.001)
    rotation_rad: Vector3
    rotation_std_rad: Vector3 = (0.002, 0.002, 0.002)
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    scale: Annotated[float, Field(gt=-0.5, lt=1.0)] = 0.0
    delay_s: Annotated[float, Field(ge=-0.2, le=0.2)] = 0.0
    delay_std_s: NonNegative = 0.0


class MocapSource(_Section):
    """Where poses come from, and how they are passed on to the vehicle.

    Attributes:
        system: which protocol; ``none`` without motion capture.
        host: of its server, with ``:port`` where that is not the usual one.
        body: name or number of the rigid body; the topic for ros2, the system id for mavlink.
        up: the axis that points up in the system's world.
        needed_hz: preflight refuses below this.
        to_vehicle_hz: rate of poses to the vehicle's estimator; 0 sends none.
        std_m, std_rad: what the estimator is told of their accuracy.
        latency_s: how much later than its exposure a pose is stamped, of a system that was not calibrated; stamps stay
            as they are, and the estimator is told of it indoors. Each flight with poses measures it and says the line
            to write. 0 with a calibration, whose ``delay_s`` takes its place.
        calibration: how the marker body sits; None takes it for the vehicle's declared tracked point.
    """

    system: Literal["none", "natnet", "qtm", "vicon", "vrpn", "zenoh", "ros2", "mavlink"] = "none"
    host: str = "127.0.0.1"
    body: str = "1"
    up: Literal["y", "z"] = "z"
    needed_hz: Positive = 50.0
    to_vehicle_hz: NonNegative = 50.0
    std_m: Positive = 0.005
    std_rad: Positive = 0.01
    latency_s: Annotated[float, Field(ge=0.0, le=0.25)] = 0.0
    calibration: MarkerCalibration | None = None

    @field_validator("system", mode="before")
    @classmethod
    def _maker(cls, value: object) -> object:
        """OptiTrack is what speaks NatNet."""
        return "natnet" if value == "optitrack" else value

    @model_validator(mode="after")
    def _of_this_body(self) -> MocapSource:
        if self.calibration is not None and self.calibration.body != self.body:
            raise ValueError(
                f"calibration is of body '{self.calibration.body}', body is '{self.body}': calibrate it, or delete the "
                "section"
            )
        if self.calibration is not None and self.latency_s:
            raise ValueError(
                f"latency_s = {self.latency_s:g} beside a calibration counts a delay twice: calibration.delay_s is "
                "taken off the stamps already, so delete latency_s (or the calibration)"
            )
        return self


class Station(_Section):
    """A station file.

    Attributes:
        indoors: the vehicle's estimator flies by the poses, without satellites. Left out, it is so where poses are sent
            to it; false leaves the poses to the recording, and the vehicle to its own estimate.
        until: how long flights last where that is decided in flight; the vehicle file's goes before it.
    """

    schema_version: str = Field(default="groundstation.station/1", alias="schema")
    name: str = "default"
    system: Annotated[int, Field(ge=1, le=255)] | None = None  # the vehicle's MAVLink system id; None: the first heard
    indoors: bool | None = None
    box: Box = Box()
    guard: GuardLimits = GuardLimits()
    policy: Policy = Policy()
    mocap: MocapSource = MocapSource()
    until: Until | None = None

    @model_validator(mode="after")
    def _poses_indoors(self) -> Station:
        if self.indoors and (self.mocap.system == "none" or not self.mocap.to_vehicle_hz):
            raise ValueError(
                "indoors = true needs poses for the vehicle: name the [mocap] system, with to_vehicle_hz above 0"
            )
        return self

    @property
    def flies_by_poses(self) -> bool:
        """Whether the vehicle's estimator is to use the poses."""
        sent = self.mocap.system != "none" and self.mocap.to_vehicle_hz > 0.0
        return sent if self.indoors is None else self.indoors


def station_from_dict(document: dict, source: str = "station") -> Station:
    """Validate a parsed station file.

    Raises:
        BadInput: one sentence that names every fault.
    """
    try:
        return Station.model_validate(document)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, e['loc'])) or 'station'}: {e['msg']}" for e in error.errors())
        raise BadInput(f"{source}: {faults}. Correct it; configs/stations/default.toml documents every key.") from None


def load_station(name_or_path: str | Path = "default") -> Station:
    """Read a station file, shipped or one's own.

    Raises:
        BadInput: the file is missing, no TOML, or wrong.
    """
    path = find_config("stations", name_or_path)
    document = read_toml(path, "a station file")
    return station_from_dict(document, str(path))
