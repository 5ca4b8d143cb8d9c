"""Poses of a motion capture on a link: into the vehicle's axes, on to the autopilot, into the checks."""

from __future__ import annotations

from collections import deque
from math import inf

from drivers.mavlink.dialect import Message
from drivers.samples import Event, Imu, Pose, State
from groundstation.flight.link.marker import MarkerVerdict, MarkerWatch
from groundstation.flight.link.markers import Markers
from groundstation.flight.link.pose_latency import Latency, PoseLatency
from groundstation.flight.link.view import Meter, VehicleView
from groundstation.flight.station import Station
from groundstation.vehicle import Vehicle

CARRIED = 200
"""Pairs of the vehicle's state and a pose that the checks look at."""


class CapturedPoses:
    """The poses of one flight, and what is known from them.

    Attributes:
        said: what the motion capture's client told last; empty while all is well.
    """

    def __init__(self, vehicle: Vehicle, station: Station) -> None:
        calibration = station.mocap.calibration
        self._station = station
        self._carried: deque[tuple[State, Pose]] = deque(maxlen=CARRIED)
        self._latency, self._markers = PoseLatency(), Markers(vehicle.mocap)
        self._sent_s = -inf
        self._marker = None if calibration is None else MarkerWatch(calibration, vehicle)
        self.said = ""

    def begin(self) -> None:
        """A flight starts: delays are measured anew."""
        self._latency = PoseLatency()

    @property
    def carried(self) -> tuple[tuple[State, Pose], ...]:
        """Pairs of states and poses over which the vehicle was moved."""
        return tuple(self._carried)

    @property
    def marker(self) -> MarkerVerdict | None:
        """Whether the calibrated marker body still sits where it was; None without a calibration."""
        return None if self._marker is None else self._marker.verdict()

    @property
    def latency(self) -> Latency | None:
        """The poses' delay in flight; None while it is not known."""
        return self._latency.result()

    def watch(self, sample: Imu | Pose, host_s: float) -> None:
        """On the ground: the marker body's seat is looked at."""
        if self._marker is not None:
            self._marker.take(sample, host_s)

    def state(self, host_s: float, state: State) -> None:
        """The vehicle's own attitude, which the poses' delay is measured by."""
        self._latency.state(host_s, state)

    def pose(self, pose: Pose, received_s: float, view: VehicleView, *, in_air: bool) -> list[Message]:
        """Take a pose of the marker body; what goes to the autopilot."""
        pose = self._markers.body(pose)
        view.sample(pose, received_s)
        view.meters.setdefault("POSE", Meter()).add(received_s)
        if in_air:
            self._latency.pose(pose.device_s, pose.quaternion)
        if view.state is not None and received_s - view.state_s < 0.05:  # so old a state is still of the pose's place
            self._carried.append((view.state, pose))
        mocap = self._station.mocap
        if (
            self._station.indoors is False
            or mocap.to_vehicle_hz <= 0.0
            or received_s - self._sent_s < 0.9 / mocap.to_vehicle_hz
        ):
            return []
        self._sent_s = received_s
        return list(view.profile.external_pose(pose, pose.device_s, mocap.std_m, mocap.std_rad, 0))

    def heard(self, event: Event) -> None:
        """The motion capture's client says how it is."""
        self.said = "" if event.kind == "clock" else event.text
