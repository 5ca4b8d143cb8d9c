"""Checks before a flight over MAVLink: each says yes or no with its reason and remedy; none is skipped silently.

A check that cannot be made fails, saying so. ``force`` names checks whose failure the operator answers for; it is
recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, pi, sqrt

import numpy as np

from drivers.mavlink.geometry import tilt_cosine, yaw_of
from drivers.samples import Pose, State
from groundstation.errors import BadInput
from groundstation.flight.link.fusion import not_fused
from groundstation.flight.link.marker import MarkerVerdict
from groundstation.flight.link.profiles import ParameterRule, Profile
from groundstation.flight.link.view import VehicleView
from groundstation.flight.station import Station
from groundstation.trajectory import Plan, flight_path, rigid_motion
from groundstation.vehicle import Vehicle

HEARTBEAT_S = 3.0
VIBRATION_M_S2 = 30.0
CLOCK_ERROR_S = 0.02
RESERVE = 1.5
MOVED_M = 0.3
MIB = 1 << 20
LOG_MIB_PER_S = 0.35
"""Of a PX4 log with every topic at full rate; the excitation's own profile writes about a third of it."""
RECORDED_MIB_PER_S = 0.3
"""Recording and raw log of a flight at the highest rates."""
GROUND_S = 120.0
"""Of a flight's time before and after the plan, generously."""


@dataclass(frozen=True, slots=True)
class Check:
    """One answer.

    Attributes:
        name: what ``--force`` takes.
        ok: passed, or forced.
        reason: what was seen, with figures.
        remedy: what to do about it; empty when it passed.
        forced: it failed, and the operator answers for it.
    """

    name: str
    ok: bool
    reason: str
    remedy: str = ""
    forced: bool = False


@dataclass(frozen=True, slots=True)
class Situation:
    """Everything the checks look at.

    Attributes:
        now_s: host time.
        view: what is known of the vehicle.
        station, vehicle, plan: the files; without a plan what concerns it is not checked, and says so.
        parameters: read from the vehicle; None for one it does not have.
        clock_error_s: of the vehicle's clock against ours.
        disk_free_bytes: where the recording goes; None when nobody keeps one.
        carried: (state, pose) pairs over which the vehicle was moved, to compare their frames.
        marker: whether the calibrated marker body still sits where it was; None without a calibration.
        mocap_said: what the motion capture's client told last.
    """

    now_s: float
    view: VehicleView
    station: Station
    vehicle: Vehicle
    plan: Plan | None
    parameters: Mapping[str, float | None]
    clock_error_s: float
    carried: Sequence[tuple[State, Pose]] = ()
    disk_free_bytes: int | None = None
    marker: MarkerVerdict | None = None
    mocap_said: str = ""

    @property
    def profile(self) -> Profile:
        """Of the vehicle."""
        return self.view.profile


def run_checks(situation: Situation, force: Sequence[str] = ()) -> list[Check]:
    """All checks, in order.

    Raises:
        BadInput: ``force`` names a check that does not exist.
    """
    checks = list(_all(situation))
    names = {check.name for check in checks}
    unknown = [name for name in force if name not in names]
    if unknown:
        raise BadInput(f"--force {', '.join(unknown)}: no such check; there are {', '.join(sorted(names))}.")
    return [replace(check, ok=True, forced=True) if not check.ok and check.name in force else check for check in checks]


def failures(checks: Sequence[Check]) -> str:
    """One sentence for all failed checks; empty when none failed."""
    return "; ".join(f"{c.name}: {c.reason} ({c.remedy})" for c in checks if not c.ok)


def _all(s: Situation) -> Iterator[Check]:
    yield _heartbeat(s)
    yield _streams(s)
    yield _arming(s)
    yield _disarmed(s)
    yield _estimate(s)
    yield _clock(s)
    yield _battery(s)
    yield _log(s)
    yield _disk(s)
    yield from _parameters(s)
    yield from _poses(s)
    yield _plan_fits_vehicle(s)
    yield _plan_fits_room(s)
    yield _vibration(s)
    yield _oscillation(s)


def _answer(name: str, ok: bool, reason: str, remedy: str) -> Check:
    return Check(name, ok, reason, "" if ok else remedy)


def _heartbeat(s: Situation) -> Check:
    age = s.now_s - s.view.heartbeat_s
    return _answer(
        "link", age < HEARTBEAT_S, f"last heartbeat {age:.1f} s ago" if isfinite(age) else "no heartbeat",
        "check cable, port, baud rate and that the autopilot runs",
    )  # fmt: skip


def _streams(s: Situation) -> Check:
    slow = [
        f"{w.name} comes at {s.view.rate_hz(w.name, s.now_s):.1f} Hz, needed {w.needed_hz:g} Hz for {w.why}"
        for w in s.profile.streams
        if w.needed_hz > 0.0 and s.view.rate_hz(w.name, s.now_s) < 0.8 * w.needed_hz
    ]
    rates = ", ".join(f"{w.name} {s.view.rate_hz(w.name, s.now_s):.0f} Hz" for w in s.profile.streams)
    return _answer(
        "streams", not slow, "; ".join(slow) or rates, "use a faster link, or look what else asks for messages on it"
    )


def _arming(s: Situation) -> Check:
    if s.view.checks_pass is None:
        return Check("arming", True, "the autopilot does not tell beforehand; it will when it is armed")
    if s.profile.arms_led and s.station.flies_by_poses:
        follow = s.profile.follow_mode
        return Check("arming", True, f"by poses alone it arms in {follow} only, and tells when it is armed there")
    own = [
        t for t in s.view.texts if "PreArm" in t or "Preflight" in t
    ]  # where it says why, what else it says is noise
    texts = own or [t for t in s.view.texts if t.startswith(("critical", "error"))]
    said = "; ".join(dict.fromkeys(texts)) or f"not well: {', '.join(s.view.unhealthy)}" * bool(s.view.unhealthy)
    return _answer(
        "arming",
        s.view.checks_pass,
        "the autopilot's own checks pass"
        if s.view.checks_pass
        else f"the autopilot would not arm: {said or 'no text'}",
        "do what its text says; positions can take 40 s after power-on",
    )


def _disarmed(s: Situation) -> Check:
    return _answer(
        "disarmed", s.view.armed is False and s.view.on_ground is not False,
        f"armed: {s.view.armed}, on the ground: {s.view.on_ground}", "disarm it and put it on the ground",
    )  # fmt: skip


def _estimate(s: Situation) -> Check:
    state, age = s.view.state, s.now_s - s.view.state_s
    if state is None or age > 1.0:
        return Check(
            "estimate", False, "the vehicle tells no position", "wait for its estimator, or give it poses or satellites"
        )
    speed = sqrt(sum(v * v for v in state.velocity_m_s))
    tilt = np.arccos(np.clip(tilt_cosine(state.quaternion), -1.0, 1.0))
    return _answer(
        "estimate", speed < 0.3 and tilt < 0.2,
        f"standing still it reports {speed:.2f} m/s and {np.degrees(tilt):.0f} degrees of tilt",
        "put it level, keep it still and wait for the estimator",
    )  # fmt: skip


def _clock(s: Situation) -> Check:
    """Poses must be stamped on a clock the vehicle shares; without them all streams are on the vehicle's own clock."""
    known = isfinite(s.clock_error_s)
    seen = f"the vehicle's clock is known to {1e3 * s.clock_error_s:.1f} ms" if known else "TIMESYNC is not answered"
    if s.station.mocap.system == "none":
        return Check("clock", True, f"{seen}; without motion capture all streams are on the vehicle's own clock")
    return _answer("clock", s.clock_error_s < CLOCK_ERROR_S, seen, "wait some seconds, or use a quieter or faster link")


def _battery(s: Situation) -> Check:
    remedy = "charge it"
    if s.view.battery_remaining is None and s.view.battery is None:
        return Check("battery", False, "the vehicle reports no battery", "configure its battery monitor")
    limit = s.station.guard.battery.limit
    remaining, seen = s.view.battery_remaining, s.view.battery
    volts = f", {seen.voltage_v:.2f} V" if seen else ""
    empty = s.vehicle.battery.empty_v
    if empty is not None and seen is not None and seen.voltage_v < empty:
        return Check(
            "battery", False, f"{seen.voltage_v:.2f} V is below the vehicle file's empty {empty:.2f} V", remedy
        )
    if remaining is None:
        return Check("battery", True, f"remaining charge unknown{volts}")
    return _answer("battery", remaining > RESERVE * limit, f"{100 * remaining:.0f} %{volts}", remedy)


def _flight_s(s: Situation) -> float:
    return GROUND_S + (0.0 if s.plan is None else s.plan.series().duration_s)


def _log(s: Situation) -> Check:
    """Room for the onboard log, which has the motion at rates no link carries."""
    if s.view.logs is False:
        return Check(
            "log", False, "the autopilot says that its onboard log does not work",
            "look at its card (in, formatted, not full), and at LOG_BACKEND_TYPE",
        )  # fmt: skip
    room, needed = s.view.log_room_mib, LOG_MIB_PER_S * _flight_s(s)
    if room is None:
        told = "the onboard log works; its room is not told" if s.view.logs else "the vehicle tells nothing of its log"
        return Check("log", True, told)
    return _answer(
        "log", room >= needed, f"{room:.0f} MiB free for the onboard log, {needed:.0f} MiB wanted",
        "put a card in, or erase old logs from it",
    )  # fmt: skip


def _disk(s: Situation) -> Check:
    """Room for the recording, here."""
    if s.disk_free_bytes is None:
        return Check("disk", True, "no recording is kept here")
    room, needed = s.disk_free_bytes / MIB, RECORDED_MIB_PER_S * _flight_s(s)
    return _answer(
        "disk", room >= needed, f"{room:.0f} MiB free for the recording, {needed:.0f} MiB wanted",
        "free room where the flights are kept, or give another folder with --logs",
    )  # fmt: skip


def _parameters(s: Situation) -> Iterator[Check]:
    indoors, latency_s = s.station.flies_by_poses, s.station.mocap.latency_s
    for rule in s.profile.rules(s.view.version, indoors=indoors, pose_latency_s=latency_s):
        yield _parameter(rule, s.parameters.get(rule.name))


def _parameter(rule: ParameterRule, value: float | None) -> Check:
    if value is None:
        return Check(
            rule.name,
            not rule.required,
            f"cannot be read; {rule.why}",
            "" if not rule.required else "check the firmware",
        )
    ok = rule.holds(value)
    if ok or not rule.required:
        return Check(rule.name, True, f"is {value:g}" + ("" if ok else f"; better {rule.accepted[0]:g}: {rule.why}"))
    remedy = f"set it to {rule.accepted[0]:g}"
    if rule.settable:
        remedy += ", or allow it with --set-parameters (restored afterwards)"
    return Check(rule.name, False, f"is {value:g}; {rule.why}", remedy)


def _poses(s: Situation) -> Iterator[Check]:
    mocap, view = s.station.mocap, s.view
    if mocap.system == "none":
        yield Check("poses", True, "no motion capture in the station file; the vehicle's own estimate is all there is")
        return
    rate, age = view.rate_hz("POSE", s.now_s), s.now_s - view.pose_changed_s
    none = ": ".join(filter(None, (f"none from {mocap.system} at {mocap.host}", s.mocap_said)))
    yield _answer(
        "poses", rate >= mocap.needed_hz and age < 0.3,
        f"{rate:.0f} Hz, the newest {age:.2f} s old" if view.pose else none,
        f"start the motion capture, check host and body '{mocap.body}' in the station file",
    )  # fmt: skip
    yield _frames(s)
    if s.station.flies_by_poses:
        yield _fusion(s)
    yield _marker(s)


def _fusion(s: Situation) -> Check:
    """The estimator flies by the poses: its flags, its innovations, and where it says it is."""
    why = not_fused(s.view)
    horizontal, vertical, heading = s.view.estimator_ratios
    return _answer(
        "fusion", not why,
        why or f"the estimator uses the poses; innovations at {horizontal:.2f} (position), {vertical:.2f} (height), "
        f"{heading:.2f} (heading) of their gates",
        "let --set-parameters set what poses need, or set it by hand and restart the autopilot; then wait some seconds",
    )  # fmt: skip


def _marker(s: Situation) -> Check:
    """The marker body sits where it was calibrated."""
    if s.marker is None:
        return Check(
            "marker",
            True,
            "not calibrated: the marker body is taken for the vehicle's declared tracked point (`groundstation "
            "calibrate`)",
        )
    return _answer("marker", s.marker.ok, s.marker.seen, "fasten it and calibrate again with `groundstation calibrate`")


def _frames(s: Situation) -> Check:
    """Poses and estimate move alike: same axes, same yaw.

    Told from a hand-carried move, or from standing (yaw alone).
    """
    if s.view.pose is None or s.view.state is None:
        return Check("frames", False, "no pose or no estimate to compare", "see 'poses' and 'estimate'")
    gap = yaw_of(s.view.pose.quaternion) - yaw_of(s.view.state.quaternion)
    gap = abs((gap + pi) % (2 * pi) - pi)
    if gap > 0.35:
        return Check(
            "frames", False, f"yaw differs by {np.degrees(gap):.0f} degrees between poses and estimate",
            "align the rigid body's axes with the vehicle's, x forward",
        )  # fmt: skip
    verdict = compare_frames(s.carried)
    if verdict is None:
        distance = sqrt(sum((a - b) ** 2 for a, b in zip(s.view.pose.position_m, s.view.state.position_m, strict=True)))
        return _answer(
            "frames",
            distance < 0.3,
            f"standing, poses and estimate lie {distance:.2f} m apart, yaw {np.degrees(gap):.0f} degrees",
            f"the estimator does not use the poses, or axes are swapped: carry the vehicle {MOVED_M:g} m along x, then "
            "y, and check again",
        )
    return verdict


def compare_frames(carried: Sequence[tuple[State, Pose]]) -> Check | None:
    r"""Fit the rotation that takes the poses' path to the estimate's (Kabsch); None when it was hardly moved.

    With centred paths P, E (3, k): :math:`U S V^T = E P^T`, :math:`R = U V^T`. R is the identity when the frames agree;
    a negative determinant is a mirrored axis, another signed permutation a swapped one.
    """
    if len(carried) < 2:
        return None
    estimate = np.array([state.position_m for state, _ in carried]).T
    poses = np.array([pose.position_m for _, pose in carried]).T
    estimate, poses = estimate - estimate.mean(axis=1, keepdims=True), poses - poses.mean(axis=1, keepdims=True)
    u, spread, vt = np.linalg.svd(estimate @ poses.T / poses.shape[1])
    if sqrt(spread[1]) < 0.25 * MOVED_M:  # moved in one direction at most
        return None
    residual_same = float(np.sqrt(np.mean(np.sum((estimate - poses) ** 2, axis=0))))
    size = float(np.sqrt(np.mean(np.sum(poses**2, axis=0))))
    ok = residual_same < 0.3 * size
    rotation = np.round(u @ vt, 1)
    return _answer(
        "frames", ok,
        f"carried over {size:.2f} m rms, poses and estimate differ by {residual_same:.2f} m rms"
        + ("" if ok else f"; the best map from poses to estimate is {rotation.tolist()}"),
        "swap or mirror the axes in the motion capture's settings until this is the identity",
    )  # fmt: skip


def _plan_fits_vehicle(s: Situation) -> Check:
    """Thrust, tilt and speed of the plan against what this vehicle has (declared top speed, limits)."""
    if s.plan is None:
        return Check("plan", True, "no plan was given to check")
    series = s.plan.series()
    times = np.linspace(0.0, series.duration_s, max(200, int(50 * series.duration_s)))
    motion = rigid_motion(series.sample(times), s.vehicle.gravity_m_s2)
    thrust = s.vehicle.mass_kg * float(np.max(motion.specific_thrust_m_s2))
    faults = []
    limits = s.vehicle.limits
    rotors = s.vehicle.rotors
    top = limits.thrust_max_n
    if top is None and rotors.speed_max_rad_s and rotors.thrust_coefficient_n_s2:
        top = rotors.count * rotors.thrust_coefficient_n_s2 * rotors.speed_max_rad_s**2
    if top is not None and thrust > 0.9 * top:
        faults.append(f"thrust {thrust:.1f} N of {top:.1f} N")
    tilt = float(np.max(np.abs(motion.euler_rad[:, :2])))
    if tilt > 0.9 * s.station.guard.tilt.limit:
        faults.append(f"tilt {tilt:.2f} rad against the guard's {s.station.guard.tilt.limit:.2f}")
    speed = float(np.max(np.linalg.norm(motion.velocity_world_m_s, axis=1)))
    if speed > 0.9 * s.station.guard.speed.limit:
        faults.append(f"speed {speed:.2f} m/s against the guard's {s.station.guard.speed.limit:.2f}")
    jerk = series.derivatives(times, 3)[3]
    for axis, value, limit in zip(
        ("horizontal", "vertical"), (np.hypot(jerk[:, 0], jerk[:, 1]).max(), abs(jerk[:, 2]).max()),
        s.profile.jerk_limits_m_s3(s.parameters), strict=True,
    ):  # fmt: skip
        if value > limit:
            faults.append(
                f"{axis} jerk {value:.1f} m/s^3, which the autopilot smooths to {limit:.1f} (--set-parameters)"
            )
    return _answer(
        "plan", not faults, "; ".join(faults) or f"needs {thrust:.1f} N, {tilt:.2f} rad, {speed:.2f} m/s",
        "make a gentler plan for this vehicle with `groundstation plan`",
    )  # fmt: skip


def _plan_fits_room(s: Situation) -> Check:
    if s.plan is None:
        return Check("room", True, "no plan was given to check")
    state = s.view.state
    ground = (0.0, 0.0, 0.0, 0.0)
    if s.station.policy.placement == "world" and state is not None:
        ground = (*state.position_m, yaw_of(state.quaternion))
    path = flight_path(s.plan, ground, climb_m_s=s.station.policy.climb_m_s)
    points = path.sample(np.arange(0.0, path.duration_s, 0.05)).position[0]
    box = s.station.box
    out = [
        f"{axis} {points[:, i].min():.2f} to {points[:, i].max():.2f} m in {low:g} to {high:g} m"
        for i, (axis, (low, high)) in enumerate(zip("xyz", (box.x_m, box.y_m, box.z_m), strict=True))
        if points[:, i].min() < low or points[:, i].max() > high
    ]
    return _answer("room", not out, "; ".join(out) or "the whole path lies inside the box",
                   "move the vehicle, widen the station's box if the room allows, or plan for this room")  # fmt: skip


def _vibration(s: Situation) -> Check:
    seen = s.view.vibration_m_s2
    if seen is None:
        return Check("vibration", True, "the vehicle does not report it")
    return _answer(
        "vibration", max(seen) < VIBRATION_M_S2, f"{max(seen):.1f} m/s^2", "balance propellers, check mounts"
    )


def _oscillation(s: Situation) -> Check:
    rms, limit = s.view.oscillation.rms_rad_s, s.station.guard.oscillation.limit
    return _answer("oscillation", rms < limit, f"{rms:.3f} rad/s rms above 8 Hz, standing", "check IMU and mounting")
