"""Trajectories of the flat outputs x, y, z and yaw, the motion they imply, and plans as files.

The excitation is the finite Fourier series of the seed paper (eq. 18). Roll and pitch follow from eq. (26)-(27), which
put body z along acceleration plus gravity; body rates and their derivatives follow exactly from jerk and snap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from groundstation.errors import BadInput
from groundstation.json_types import JsonObject
from groundstation.outside import read_toml
from groundstation.tabular import Record, Tabular

Array = NDArray[np.float64]
CHANNELS = ("x", "y", "z", "yaw")


@dataclass(frozen=True, slots=True)
class FlatState:
    """Flat outputs and their time derivatives at k instants.

    Attributes:
        position: [x, y, z] in the world and derivatives 0..4 (to snap), shape (5, k, 3), m, m/s, ...
        yaw: yaw and derivatives 0..2, shape (3, k), rad, rad/s, rad/s^2.
    """

    position: Annotated[Array, "orders k 3"]
    yaw: Annotated[Array, "yaw_orders k"]


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """The motion a vehicle with thrust along body z must make to follow flat outputs, shape (k, ...)."""

    position_m: Annotated[Array, "k 3"]
    velocity_world_m_s: Annotated[Array, "k 3"]
    acceleration_world_m_s2: Annotated[Array, "k 3"]
    euler_rad: Annotated[Array, "k 3"]
    euler_rate_rad_s: Annotated[Array, "k 3"]
    angular_velocity_body_rad_s: Annotated[Array, "k 3"]
    angular_acceleration_body_rad_s2: Annotated[Array, "k 3"]
    specific_thrust_m_s2: Annotated[Array, "k"]


class Trajectory(Protocol):
    """Anything that can be sampled at given times."""

    @property
    def duration_s(self) -> float:
        """Seconds from start to end."""
        ...

    def sample(self, t_s: ArrayLike) -> FlatState:
        """Flat outputs at times from the trajectory's start."""
        ...


@dataclass(frozen=True, slots=True)
class FourierSeries:
    """Seed paper eq. (18): q_i(t) = sum_l a_il/(w l) sin(w l t) - b_il/(w l) cos(w l t) + c_i.

    Attributes:
        a: sine amplitudes of x, y, z (m/s) and yaw (rad/s), shape (4, N).
        b: cosine amplitudes, shape (4, N).
        c: offsets, shape (4,).
        base_frequency_rad_s: w.
        periods: how often the period is flown.
    """

    a: Annotated[Array, "4 N"]
    b: Annotated[Array, "4 N"]
    c: Annotated[Array, "4"]
    base_frequency_rad_s: float
    periods: float = 1.0

    @property
    def period_s(self) -> float:
        """2 pi / w."""
        return 2.0 * np.pi / self.base_frequency_rad_s

    @property
    def duration_s(self) -> float:
        """All periods."""
        return self.periods * self.period_s

    def derivatives(self, t_s: ArrayLike, highest: int) -> Array:
        """Channels and derivatives 0..highest at times t, shape (highest + 1, k, 4)."""
        t = np.atleast_1d(np.asarray(t_s, dtype=float))
        w = self.base_frequency_rad_s * np.arange(1, int(self.a.shape[1]) + 1)
        phase = np.exp(1j * w * t[:, None])
        # q = Re(sum z e^{iwt}) + c with z = -(b + i a)/w; each derivative multiplies by i w.
        z = -(self.b + 1j * self.a) / w
        out = np.stack([np.real(phase @ ((1j * w) ** n * z).T) for n in range(highest + 1)])
        out[0] += self.c
        return out

    def sample(self, t_s: ArrayLike) -> FlatState:
        """Flat outputs at times from the start; before and after, the ends are held at rest."""
        t = np.atleast_1d(np.asarray(t_s, dtype=float))
        d = self.derivatives(np.clip(t, 0.0, self.duration_s), 4)
        d[1:, (t < 0.0) | (t > self.duration_s)] = 0.0
        return FlatState(d[:, :, :3], d[:3, :, 3])


@dataclass(frozen=True, slots=True)
class RestToRest:
    """Straight line between two points at rest, degree-9 polynomial: rates and their derivatives vanish at both
    ends.
    """

    start: Array  # x, y, z, yaw
    end: Array
    duration_s: float

    def sample(self, t_s: ArrayLike) -> FlatState:
        """Flat outputs at times from the start, held outside."""
        t = np.atleast_1d(np.asarray(t_s, dtype=float))
        s = np.clip(t / self.duration_s, 0.0, 1.0)
        polynomial = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
        shape = [polynomial.deriv(n)(s) / self.duration_s**n for n in range(5)]
        d = np.stack(shape)[:, :, None] * (np.asarray(self.end) - np.asarray(self.start))
        d[0] += self.start
        return FlatState(d[:, :, :3], d[:3, :, 3])


@dataclass(frozen=True, slots=True)
class Sequence:
    """Trajectories one after the other."""

    parts: tuple[Trajectory, ...]

    @property
    def duration_s(self) -> float:
        """Sum of the parts."""
        return float(sum(part.duration_s for part in self.parts))

    def sample(self, t_s: ArrayLike) -> FlatState:
        """Flat outputs at times from the start of the first part; outside, the ends are held."""
        t = np.atleast_1d(np.asarray(t_s, dtype=float))
        position = np.empty((5, len(t), 3))
        yaw = np.empty((3, len(t)))
        starts = np.concatenate([[0.0], np.cumsum([part.duration_s for part in self.parts])[:-1]])
        which = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(self.parts) - 1)
        for index, part in enumerate(self.parts):
            here = which == index
            if here.any():
                flat = part.sample(t[here] - starts[index])
                position[:, here], yaw[:, here] = flat.position, flat.yaw
        return FlatState(position, yaw)


def rigid_motion(flat: FlatState, gravity_m_s2: float = 9.80665) -> RigidMotion:
    """Attitude, body rates and their derivatives of a vehicle that follows flat outputs exactly.

    With c1 = a_x cos(psi) + a_y sin(psi), c2 = a_x sin(psi) - a_y cos(psi), d = a_z + g: tan(theta) = c1/d (eq. 26) and
    tan(phi) = c2/sqrt(c1^2 + d^2) (eq. 27). Both are differentiated twice in closed form; omega = W^-1 eta_dot.
    """
    ax, ay, az = (flat.position[2:5, :, i] for i in range(3))  # derivatives 2, 3, 4
    c1, c1d, c1dd = _along_heading(ax, ay, flat.yaw)
    c2, c2d, c2dd = _along_heading(-ay, ax, flat.yaw)
    d, dd, ddd = az[0] + gravity_m_s2, az[1], az[2]
    r2 = c1**2 + d**2
    r = np.sqrt(r2)
    rd = (c1 * c1d + d * dd) / r
    rdd = (c1d**2 + dd**2 + c1 * c1dd + d * ddd - rd**2) / r

    theta = np.arctan2(c1, d)
    n1 = c1d * d - c1 * dd
    theta1 = n1 / r2
    theta2 = (c1dd * d - c1 * ddd) / r2 - theta1 * 2 * rd / r
    s2 = c2**2 + r2
    phi = np.arctan2(c2, r)
    m1 = c2d * r - c2 * rd
    phi1 = m1 / s2
    phi2 = (c2dd * r - c2 * rdd) / s2 - phi1 * 2 * (c2 * c2d + r * rd) / s2

    euler = (np.stack([phi, theta, flat.yaw[0]], axis=-1), np.stack([phi1, theta1, flat.yaw[1]], axis=-1))
    omega, omega1 = _body_rates(*euler, np.stack([phi2, theta2, flat.yaw[2]], axis=-1))
    return RigidMotion(
        position_m=flat.position[0],
        velocity_world_m_s=flat.position[1],
        acceleration_world_m_s2=flat.position[2],
        euler_rad=euler[0],
        euler_rate_rad_s=euler[1],
        angular_velocity_body_rad_s=omega,
        angular_acceleration_body_rad_s2=omega1,
        specific_thrust_m_s2=np.sqrt(s2),
    )


def _along_heading(u: Array, v: Array, yaw: Array) -> tuple[Array, Array, Array]:
    """Values of f = u cos(psi) + v sin(psi) with two derivatives, of u, v and psi with two each, shape (3, k).

    h = -u sin(psi) + v cos(psi) is its derivative by psi.
    """
    psi, psi1, psi2 = yaw
    cos, sin = np.cos(psi), np.sin(psi)
    f, h = u[0] * cos + v[0] * sin, -u[0] * sin + v[0] * cos
    f1, h1 = u[1] * cos + v[1] * sin, -u[1] * sin + v[1] * cos
    return f, f1 + psi1 * h, (u[2] * cos + v[2] * sin) + 2 * psi1 * h1 + psi2 * h - psi1**2 * f


def _body_rates(euler: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Body rates omega = W^-1 eta_dot and their derivative, from roll, pitch, yaw and two derivatives, shape (k, 3)
    each.
    """
    phi, theta, _ = euler.T
    phi1, theta1, psi1 = first.T
    phi2, theta2, psi2 = second.T
    cp, sp, ct, st = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta)
    omega = np.stack([phi1 - st * psi1, cp * theta1 + sp * ct * psi1, -sp * theta1 + cp * ct * psi1], axis=-1)
    omega1 = np.stack(
        [
            phi2 - ct * theta1 * psi1 - st * psi2,
            cp * theta2 - sp * phi1 * theta1 + (cp * ct * phi1 - sp * st * theta1) * psi1 + sp * ct * psi2,
            -sp * theta2 - cp * phi1 * theta1 - (sp * ct * phi1 + cp * st * theta1) * psi1 + cp * ct * psi2,
        ],
        axis=-1,
    )
    return omega, omega1


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ChannelCoefficients(_Model):
    """a, b, c of eq. (18) for one channel."""

    a: tuple[float, ...]
    b: tuple[float, ...]
    c: float = 0.0


class Coefficients(_Model):
    """The four channels; x, y, z in m/s and m, yaw in rad/s and rad."""

    x: ChannelCoefficients
    y: ChannelCoefficients
    z: ChannelCoefficients
    yaw: ChannelCoefficients

    @model_validator(mode="after")
    def _same_length(self) -> Coefficients:
        lengths = {len(v) for c in (self.x, self.y, self.z, self.yaw) for v in (c.a, c.b)}
        if len(lengths) != 1 or 0 in lengths:
            raise ValueError(f"a and b of all channels must have the same number of harmonics, not {sorted(lengths)}")
        return self


RENAMED_PARAMETERS = {
    "com_x_m": "com_offset_x_m",
    "com_y_m": "com_offset_y_m",
    "damping_x_nm_s": "damping_x_nms",
    "damping_y_nm_s": "damping_y_nms",
    "damping_z_nm_s": "damping_z_nms",
    "flapping_n_s": "k_nm_s_m",
}
"""Names in plan files of earlier versions -> the names that estimates have."""


class PlannedUntil(_Model):
    """Of a plan whose length is decided in flight: it lasts ``planned_periods`` unless it is ended early or told to go
    on.

    Attributes:
        targets: half widths of 95 % intervals as shares, by parameter.
        planned_periods: flown where nobody decides; ``periods`` of the plan is the most.
        automatic: the station decides; else the operator does.
    """

    targets: dict[str, Annotated[float, Field(gt=0.0, lt=1.0)]]
    planned_periods: Annotated[int, Field(ge=1)]
    automatic: bool = False


class Plan(_Model, Tabular):
    """An excitation to fly: what is in a plan file.

    ``limits`` are those it was made to keep (names of ``[limits]``).
    """

    schema_version: str = Field(default="groundstation.plan/1", alias="schema")
    vehicle: str
    base_frequency_rad_s: Annotated[float, Field(gt=0.0)]
    periods: Annotated[float, Field(gt=0.0)] = 1.0
    coefficients: Coefficients
    criterion: str = "condition"
    condition_number: float | None = None
    largest_violation: float | None = None
    limits: dict[str, float] = Field(default_factory=dict)
    predicted_std: dict[str, float] = Field(default_factory=dict)
    note: str = ""
    until: PlannedUntil | None = None

    @model_validator(mode="after")
    def _ends_at_rest_points(self) -> Plan:
        if self.until is not None and (
            self.periods != round(self.periods) or self.until.planned_periods > self.periods
        ):
            raise ValueError("with [until], periods must be a whole number, and no fewer than planned_periods")
        return self

    @field_validator("predicted_std", mode="before")
    @classmethod
    def _names_of_old_files(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        named = cast(JsonObject, value)
        return {RENAMED_PARAMETERS.get(name, name): std for name, std in named.items()}

    def to_dict(self) -> dict[str, object]:
        """The plan file's document."""
        return plan_to_dict(self)

    @property
    def first_periods(self) -> float:
        """Periods that are flown unless something else is decided in flight."""
        return self.periods if self.until is None else float(self.until.planned_periods)

    def as_flown(self, seconds: float) -> Plan:
        """The plan of a flight whose excitation lasted so long, where its length was decided in flight."""
        if self.until is None:
            return self
        periods = min(max(round(seconds * self.base_frequency_rad_s / (2.0 * np.pi)), 1), self.periods)
        return self.model_copy(update={"periods": float(periods), "until": None})

    def records(self) -> list[Record]:
        """One row per parameter: the standard deviation to expect of a flight of this plan."""
        return [{"parameter": name, "predicted_std": std} for name, std in self.predicted_std.items()]

    def _title(self) -> str:
        duration = self.periods * 2.0 * np.pi / self.base_frequency_rad_s
        condition = "" if self.condition_number is None else f", cond(W) {self.condition_number:.2f}"
        return f"plan for {self.vehicle}: {duration:.1f} s{condition}"

    def series(self) -> FourierSeries:
        """The excitation trajectory."""
        channels = [getattr(self.coefficients, name) for name in CHANNELS]
        return FourierSeries(
            a=np.array([c.a for c in channels]),
            b=np.array([c.b for c in channels]),
            c=np.array([c.c for c in channels]),
            base_frequency_rad_s=self.base_frequency_rad_s,
            periods=self.periods,
        )


def coefficients_from_arrays(a: ArrayLike, b: ArrayLike, c: ArrayLike) -> Coefficients:
    """Coefficients from arrays of shape (4, N), (4, N), (4,)."""
    rows = zip(
        CHANNELS, np.asarray(a, dtype=float), np.asarray(b, dtype=float), np.asarray(c, dtype=float), strict=True
    )
    return Coefficients(
        **{k: ChannelCoefficients(a=tuple(map(float, p)), b=tuple(map(float, q)), c=float(r)) for k, p, q, r in rows}
    )


def plan_from_dict(document: object, source: str = "plan") -> Plan:
    """Validate a plan document.

    Raises:
        BadInput: one sentence naming every fault.
    """
    if not isinstance(document, dict):
        raise BadInput(f"{source}: is no table of keys and values. Make a plan with `groundstation plan`.")
    try:
        return Plan.model_validate(document)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, e['loc'])) or 'plan'}: {e['msg']}" for e in error.errors())
        raise BadInput(f"{source}: {faults}. Correct it, or make a new plan with `groundstation plan`.") from None


def load_plan(path: str | Path) -> Plan:
    """Read a plan file.

    Raises:
        BadInput: the file is missing, no TOML, or wrong.
    """
    path = Path(path)
    document = read_toml(path, "a plan")
    return plan_from_dict(document, str(path))


def plan_to_dict(plan: Plan) -> JsonObject:
    """The document that :func:`plan_from_dict` reads back to an equal plan."""
    return plan.model_dump(by_alias=True, exclude_none=True, mode="json")


def flight_path(plan: Plan, ground: ArrayLike, *, climb_m_s: float = 0.4, settle_s: float = 3.0) -> Sequence:
    """Take-off from ``ground`` (x, y, z, yaw) to the excitation's start, settle, excite, return, and land.

    The legs are rest to rest; the excitation itself starts and ends at rest, so position, velocity and acceleration are
    continuous throughout.
    """
    series = plan.series()
    ends = series.derivatives([0.0, series.duration_s], 0)[0]
    floor = np.asarray(ground, dtype=float)
    up = floor.copy()
    up[2] = ends[0, 2]

    def leg(start: Array, end: Array) -> RestToRest:
        # Peak speed of the degree-9 polynomial is 2.46 times its mean.
        distance = max(float(np.linalg.norm(end[:3] - start[:3])), abs(float(end[3] - start[3])))
        return RestToRest(start, end, max(2.0, 2.46 * distance / climb_m_s))

    def hold(point: Array) -> RestToRest:
        return RestToRest(point, point, settle_s)

    down = ends[1].copy()
    down[2] = floor[2]
    return Sequence((leg(floor, up), leg(up, ends[0]), hold(ends[0]), series, hold(ends[1]), leg(ends[1], down)))


def with_periods(path: Sequence, periods: float) -> Sequence:
    """A :func:`flight_path` whose excitation has so many whole periods; it ends where it began, so the legs stay as
    they are.
    """
    parts = tuple(replace(p, periods=float(periods)) if isinstance(p, FourierSeries) else p for p in path.parts)
    return Sequence(parts)


def changed_length(path: Sequence, at_s: float, order: str, most: float) -> Sequence | str:
    """A path whose excitation ends at the next rest point ("finish"), or a period later than it would ("extend"); or
    why not.

    Args:
        path: of :func:`flight_path`.
        at_s: where on it the vehicle is.
        most: periods that were checked before the flight.
    """
    before = 0.0
    for part in path.parts:
        if isinstance(part, FourierSeries):
            into = at_s - before
            if not 0.0 <= into < part.duration_s:
                return "the excitation is not being flown."
            if order == "extend":
                longer = part.periods + 1.0
                return (
                    with_periods(path, longer)
                    if longer <= most
                    else f"{most:g} periods were checked before the flight; it ends there."
                )
            return with_periods(path, min(part.periods, np.floor(into / part.period_s) + 1.0))
        before += part.duration_s
    return "the plan has no rest points."
