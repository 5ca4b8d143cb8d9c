"""The simulated drone as a process: the flight manager on the bus, paced by the core's credit or by the wall clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import msgspec

from drivers import bus
from drivers.access import own_login
from drivers.samples import Batch, encode_batch
from groundstation.vehicle import Vehicle
from sim.build import STEP_S
from sim.drone import Drone
from sim.scenario import Scenario
from sim.simulation import Simulation

_STATUS_S = 0.1  # of the drone's time
_LINGER_S = 10.0  # how long a lock-stepped drone outlives its core once it has landed
_LINGER_REAL_TIME_S = 120.0  # and one in real time, to which somebody may connect a new core


class Station:
    """What the drone knows of the core: how far it may run, and whether the core lives. Fed from the bus' threads.

    Args:
        clock: monotonic seconds.
        silence_s: without a word for so long, the core is taken for dead.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, silence_s: float = bus.CREDIT_TIMEOUT_S):
        self._clock, self._silence_s = clock, silence_s
        self._changed = threading.Condition()
        self._credit = bus.Credit(0.0)
        self._heard_s: float | None = None
        self._gone = False
        self._left = False

    def on_credit(self, credit: bus.Credit) -> None:
        """The core grants time.

        A grant may arrive after the word that its core is gone; only a token takes that back.
        """
        with self._changed:
            self._credit, self._heard_s = credit, self._clock()
            self._changed.notify()

    def on_alive(self, _key: str, here: bool) -> None:
        """The core's liveliness token came or went."""
        with self._changed:
            self._gone = not here
            self._left |= not here
            self._changed.notify()

    @property
    def lost(self) -> bool:
        """Whether a core that was there is gone."""
        if self._heard_s is None:
            return False
        return self._gone or self._clock() - self._heard_s > self._silence_s

    def take_leave(self) -> bool:
        """Whether the core has left since this was last asked, even if another has come meanwhile."""
        with self._changed:
            left, self._left = self._left, False
            return left

    @property
    def credit_s(self) -> float:
        """How far the drone may run."""
        return self._credit.host_s

    def wait(self, seconds: float) -> None:
        """Wait for news, at most so long."""
        with self._changed:
            self._changed.wait(seconds)


class DroneProcess:
    """Serves a drone on an open session until told to shut down."""

    def __init__(self, drone: Drone, session, *, clock: Callable[[], float] = time.monotonic):
        self.drone = drone
        self.keys = bus.DroneKeys(drone.description.drone)
        self._clock = clock
        self._real_time = drone.description.real_time
        self.station = Station(clock, bus.CREDIT_TIMEOUT_S if self._real_time else bus.LOCK_STEP_TIMEOUT_S)
        self._offset_s = clock() if self._real_time else 0.0
        self._door = threading.Lock()  # held by who asks; the loop passes through it before each stretch
        self._lock = threading.Lock()
        self._told_to_end = False
        self._ending = threading.Event()
        self._sequence = 0
        self._last_status: tuple[str, str, float] = ("", "", -1.0)
        self._samples = bus.Publisher(session, self.keys.samples, lossless=not self._real_time)
        self._status = bus.Publisher(session, self.keys.status, lossless=not self._real_time)
        self._served = [
            bus.serve(session, self.keys.upload, bus.Upload, self._locked(drone.upload)),
            bus.serve(session, self.keys.command, bus.Command, self._locked(self._command), self._end_if_told),
            bus.serve(session, self.keys.describe, bus.Describe, lambda _request: drone.description),
            bus.subscribe(session, self.keys.credit, bus.decoder_of(bus.Credit), self.station.on_credit),
            bus.watch_alive(session, bus.CORE_ALIVE, self.station.on_alive),
        ]

    def _locked(self, handler: Callable[..., bus.Answer]) -> Callable[..., msgspec.Struct]:
        def answer(request: msgspec.Struct) -> bus.Answer:
            with self._door, self._lock:
                given = handler(request)
                self._publish_status()
                return given

        return answer

    def _command(self, request: bus.Command) -> bus.Answer:
        given = self.drone.command(request)
        self._told_to_end |= request.name == "shutdown" and given.ok
        return given

    def _end_if_told(self) -> None:
        """End the process, once the answer to the one who asked for it is on its way."""
        if self._told_to_end:
            self._ending.set()

    def run(self) -> None:
        """Fly until shut down, or until the core has left the drone behind on the ground for long."""
        linger_s = _LINGER_REAL_TIME_S if self._real_time else _LINGER_S
        alone_since: float | None = None
        while not self._ending.is_set():
            lost = self.station.lost
            orphaned = self.station.take_leave() or lost
            if lost and not self.drone.airborne:
                alone_since = self._clock() if alone_since is None else alone_since
                if self._clock() - alone_since > linger_s:
                    return
            elif not lost:
                alone_since = None
            with self._lock:
                if orphaned and (self.drone.airborne or self.drone.armed):
                    self.drone.land("the station is gone; landing by itself")
            if not self._may_run(lost):
                self.station.wait(0.05)
                continue
            with self._door:
                pass
            with self._lock:
                self._advance()

    def _may_run(self, lost: bool) -> bool:
        """Whether the next stretch is due: by the wall clock, by credit, or because nobody grants any more."""
        ahead = self.drone.simulation.time_s + self.drone.description.batch_s
        if self._real_time:
            wait = ahead + self._offset_s - self._clock()
            if wait > 0.0:
                self._ending.wait(wait)
            return True
        if lost:
            return self.drone.airborne or self.drone.armed
        return ahead <= self.station.credit_s + 0.5 * STEP_S

    def _advance(self) -> None:
        arrived = self.drone.advance(round(self.drone.description.batch_s / STEP_S))
        times = tuple(at + self._offset_s for at, _ in arrived)
        samples = tuple(sample for _, sample in arrived)
        until_s = self.drone.simulation.time_s + self._offset_s
        self._samples.put(encode_batch(Batch(self._sequence, times, samples, until_s)))
        self._sequence += 1
        self._publish_status()

    def _publish_status(self) -> None:
        status = self.drone.status(self._offset_s)
        phase, text, told_s = self._last_status
        if (status.phase, status.text) != (phase, text) or status.host_s >= told_s + _STATUS_S - 1e-9:
            self._last_status = (status.phase, status.text, status.host_s)
            self._status.put(status)


def serve_drone(name: str, endpoint: str, vehicle: Vehicle, scenario: Scenario, seed: int, *, real_time: bool) -> None:
    """Join the bus as a drone and serve until shut down.

    Raises:
        BadInput: the scenario does not fit the vehicle.
        ConnectionError: nobody listens on the endpoint.
    """
    drone = Drone(name, vehicle, scenario, seed, real_time=real_time)
    Simulation(vehicle, scenario, seed).idle(1)  # the loop is compiled, or loaded, before anybody waits for it
    session = bus.open_session(connect=[endpoint], login=own_login())
    try:
        process = DroneProcess(drone, session)
        with bus.alive(session, process.keys.alive):
            process.run()
    finally:
        session.close()
