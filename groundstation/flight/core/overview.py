"""What clients are shown of a flight, gathered as it goes. Nothing here decides anything."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from drivers.bus import DroneStatus
from drivers.samples import Battery, Event, Motors, Sample
from groundstation.flight.core.ground_check import checklist, with_troubles
from groundstation.flight.core.live import LiveEstimate
from groundstation.flight.core.recorder import Recorder
from groundstation.flight.core.signals import signals, stream_of
from groundstation.flight.core.until import FlyUntil
from groundstation.flight.messages import CheckStatus, CoreStatus, SuspectStatus
from groundstation.flight.sequence import IN_FLIGHT, Phase
from groundstation.flight.sequence import Sequence as FlightSequence
from groundstation.json_types import JsonObject
from groundstation.vehicle import Vehicle

NOTES = 8


class FlightView:
    """The newest of everything.

    Args:
        folder: of the flight.
        vehicle: as declared.
    """

    def __init__(self, folder: Path, vehicle: Vehicle):
        self._folder, self._vehicle = folder, vehicle.name
        self._declared, self.live = vehicle, LiveEstimate(vehicle)
        self._checks: dict[str, CheckStatus] = {}
        self.drone: DroneStatus | None = None
        self.until: FlyUntil | None = None
        self.suspects: tuple[SuspectStatus, ...] = ()
        self.suspects_s = 0.0
        self.battery_v = 0.0
        self.motors: tuple[float, ...] = ()
        self._measured = False
        self.mocap = ""
        self._newest: dict[str, Sample] = {}
        self.progress, self.text = 0.0, ""
        self.table: dict[str, tuple[float, float, float, float]] = {}
        self.notes: deque[str] = deque(maxlen=NOTES)
        self.lease, self.real_time, self.rejected = "", False, 0

    def see(self, samples: Sequence[Sample], phase: Phase) -> None:
        """Keep the newest values that views show."""
        self.live.see(samples, phase)
        for sample in samples:
            self._newest[stream_of(sample)] = sample
            if isinstance(sample, Battery):
                self.battery_v = sample.voltage_v
            elif isinstance(sample, Motors):
                self._measured |= sample.kind == "rotor_speed"
                if sample.kind == "rotor_speed" or not self._measured:
                    self.motors = sample.values
            elif isinstance(sample, Event) and sample.kind == "preflight":
                self._note_check(sample.text)
            elif isinstance(sample, Event) and sample.kind in ("clock", "mocap"):
                self.mocap = sample.text

    def _note_check(self, text: str) -> None:
        """A check of the link, as it says it: ``name verdict: what was seen``."""
        head, _, seen = text.partition(": ")
        name, _, verdict = head.rpartition(" ")
        shown = f"forced: {seen}" if verdict == "forced" else seen
        self._checks[name] = CheckStatus(name, verdict in ("ok", "forced"), shown)

    def status(self, sequence: FlightSequence, recorder: Recorder | None, host_s: float) -> CoreStatus:
        """As of host time."""
        flying = sequence.phase in IN_FLIGHT
        streams = recorder.streams(host_s) if recorder else {}
        if flying:
            self.table, self.text = self.live.table, self.live.trouble
        return CoreStatus(
            flight=self._folder.name,
            folder=str(self._folder),
            vehicle=self._vehicle,
            phase=sequence.phase,
            reason=sequence.reason or sequence.aborting,
            exit_status=sequence.exit_status,
            real_time=self.real_time,
            host_s=host_s,
            motors=self.motors,
            battery_v=self.battery_v,
            streams=with_troubles(streams, in_flight=flying) if recorder else {},
            recorded=recorder.recorded if recorder else 0,
            lost=recorder.lost_batches if recorder else 0,
            rejected=self.rejected,
            lease=self.lease,
            progress=self.progress,
            text=self.text,
            table=self.table,
            notes=tuple(self.notes),
            checks=(*self._checks.values(), *(checklist(streams, self.battery_v, self._declared) if recorder else ())),
            signals=signals(self._newest),
            clock_s=self.live.clock_s,
            mocap=self.mocap,
            until=self.until.status() if self.until is not None and flying else None,
            suspects=self.suspects if flying else (),
            suspects_s=self.suspects_s,
            **self._motion(),
        )

    def _motion(self) -> JsonObject:
        drone = self.drone
        if drone is None:
            return {}
        moving = drone.phase in ("takeoff", "exciting")
        return {
            "vehicle_phase": drone.phase,
            "flight_s": drone.flight_s,
            "time_left_s": max(0.0, drone.flight_end_s - drone.flight_s),
            "tracking_error_m": math.dist(drone.position_m, drone.setpoint_m) if moving else 0.0,
            "position_m": drone.position_m,
            "setpoint_m": drone.setpoint_m,
            "euler_rad": drone.euler_rad,
        }
