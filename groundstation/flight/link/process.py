"""The link process: owns the port, the guard, the setpoints' age and the raw log of one vehicle.

    python -P -m groundstation.flight.link.process --link udpin://127.0.0.1:14540 --vehicle V --station S \
        --drone vehicle --connect tcp/127.0.0.1:7450

Towards the core it is a drone like the simulated one (``drivers.bus``). One thread flies: it waits for bytes or for the
next setpoint, steps :class:`~groundstation.flight.link.link_core.LinkCore` and writes what comes out. Publishing and
the raw log have threads and queues of their own, so that neither a slow core nor a full disk delays a setpoint. When
the core dies the vehicle is landed, parameters are restored, and the process ends.
"""

from __future__ import annotations

import contextlib
import gc
import os
import queue
import signal
import sys
import time
from collections.abc import Callable, Sequence

from drivers import bus
from drivers.access import own_login
from drivers.mavlink import tlog
from drivers.mavlink.transports import Transport, open_transport
from drivers.samples import Batch, Motors, Pose, Raw, Sample, encode_batch
from groundstation.errors import BadInput, GroundStationError, Refused
from groundstation.flight import timeouts
from groundstation.flight.link.arguments import Kept, bandwidth_of, free_bytes, parse, signing_of
from groundstation.flight.link.background import Writer
from groundstation.flight.link.link_core import LinkCore, Options, Output
from groundstation.flight.link.parameter_journal import ParameterJournal
from groundstation.flight.link.phase import IN_AIR, Answered, Phase
from groundstation.flight.link.pose_source import PoseSource
from groundstation.flight.messages import IN_FLIGHT
from groundstation.flight.station import load_station
from groundstation.outside import parse_json, parse_toml
from groundstation.priority import set_nice
from groundstation.trajectory import plan_from_dict
from groundstation.vehicle import load_vehicle

NOT_AHEAD = (
    "link: the system does not let it run ahead of other programs, and setpoints leave less evenly on a busy machine; "
    "a line 'USER - nice -10' in /etc/security/limits.conf allows it"
)

_PHASES: dict[Phase, bus.DronePhase] = {
    Phase.IDLE: "idle",
    Phase.UPLOADED: "uploaded",
    Phase.ARMED: "armed",
    Phase.CLIMBING: "takeoff",
    Phase.FOLLOWING: "takeoff",
    Phase.HOLDING: "landing",
    Phase.LANDING: "landing",
    Phase.RELEASED: "landing",
    Phase.LANDED: "landed",
}


class LinkProcess:
    """Runs one link until the vehicle is down and nobody needs it.

    Args:
        core: the link without I/O.
        transport: the port.
        drone: name on the bus.
        kept: what it writes down.
        clock: monotonic seconds.
    """

    def __init__(
        self, core: LinkCore, transport: Transport, drone: str, kept: Kept, clock: Callable[[], float] = time.monotonic
    ):
        self.core, self.transport, self.vehicle, self.clock = core, transport, core.vehicle, clock
        core.datagrams = transport.datagrams
        self._keys = bus.DroneKeys(drone)
        self._drone = drone
        self._journal = kept.journal
        self._inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._waiting: list[tuple[Answered, queue.SimpleQueue[bus.Answer]]] = []
        self._batch: list[tuple[Sample, float]] = []
        self._sequence = 0
        self._sent_s = self._status_s = -1e9
        self._phase = ""
        self._stop_reason = ""
        self._core_seen = False
        self._core_gone_s: float | None = None
        self._motor_kind: str | None = None
        self._notes: tuple[str, ...] = ()
        self._log = kept.raw_log.open("ab", buffering=0) if kept.raw_log is not None else None
        self._log_synced_s = 0.0
        self._memory, self._remembered_s = kept.memory, -1e9
        self._told_failures: set[str] = set()
        self._logger = Writer("raw log", self._write_log) if self._log is not None else None
        mocap = core.station.mocap
        self._poses = PoseSource(mocap, core.vehicle) if mocap.system != "none" else None

    def _became_ready(self) -> bool:
        """Wait for a vehicle and for its preparation; False where the link was stopped before.

        Raises:
            Refused: the vehicle flies already, or is not ready in time.
        """
        core = self.core
        self._until(lambda: core.view is not None or bool(self._stop_reason), self.clock() + timeouts.VEHICLE_HEARD_S)
        if core.found_flying and not core.ready:
            self._until(self._tells_where_it_is, self.clock() + timeouts.LANDED_STATE_S)
            self._refuse_in_flight()
        if core.view is not None:
            self._until(lambda: core.ready or bool(self._stop_reason), self.clock() + timeouts.VEHICLE_READY_S)
        if self._stop_reason and not core.ready:
            return False
        if not core.ready:
            raise Refused(
                f"the vehicle is not ready: {core.trouble}.",
                self.transport.trouble or "Check the link, and that nothing else speaks to the vehicle on it.",
            )
        return True

    def _tells_where_it_is(self) -> bool:
        view = self.core.view
        return view is not None and view.on_ground is not None

    def run(self, endpoint: str) -> int:
        """Serve the core at an endpoint; returns the exit status."""
        if not set_nice(-10):  # ahead of the analysis, where the system allows it
            self._notes = (NOT_AHEAD,)
        sys.setswitchinterval(timeouts.SWITCH_INTERVAL_S)
        gc.freeze()
        gc.disable()  # collections of a long run would delay setpoints; samples hold no cycles
        with bus.open_session(connect=[endpoint], login=own_login()) as session:
            self._samples = bus.Publisher(session, self._keys.samples, lossless=True)
            self._status = bus.Publisher(session, self._keys.status)
            self._publisher = Writer("publisher", lambda item: item())  # type: ignore[operator]
            credit = bus.subscribe(
                session, self._keys.credit, bus.decoder_of(bus.Credit), lambda _c: self._later(self._hear)
            )
            core_alive = bus.watch_alive(
                session, bus.CORE_ALIVE, lambda _k, alive: self._later(lambda: self._core(alive))
            )
            handles = [credit, core_alive]
            try:
                if not self._became_ready():
                    return 0
                handles += [
                    bus.serve(session, self._keys.upload, bus.Upload, self._on_upload),
                    bus.serve(session, self._keys.command, bus.Command, self._on_command),
                    bus.serve(session, self._keys.describe, bus.Describe, lambda _d: self.describe()),
                ]
                with bus.alive(session, self._keys.alive):
                    self._until(self._finished, None)
                    self._restore()
            finally:
                self._publish(force=True)
                self._publisher.close()
                if self._logger is not None:
                    self._logger.close()
                self.transport.close()
                if self._poses is not None:
                    self._poses.close()
                del handles
        return 0

    def _refuse_in_flight(self) -> None:
        """Say what flies there and what can be done; on the ground, go on.

        Raises:
            Refused: it flies. No heartbeat has left since it was heard, so that its own failsafe acts.
        """
        view = self.core.view
        assert view is not None  # noqa: S101 - found
        if view.on_ground is True:
            self.core.prepare_on_ground()
            return
        height = "" if view.state is None else f", {view.state.position_m[2]:.1f} m up"
        raise Refused(
            f"{IN_FLIGHT} ({view.mode or 'mode not told'}{height}); it gets no heartbeat from here, so that its own "
            "failsafe acts where it has one for a lost station.",
            "To bring it down: the same command with --take-over land, or --take-over hold (a minute, then it lands); "
            "the interrupted flight's folder is continued. The remote control goes before either.",
        )

    def stop(self, reason: str) -> None:
        """Ask for the end from a signal handler; in the air the vehicle is landed first."""
        self._stop_reason = self._stop_reason or reason

    def describe(self) -> bus.Description:
        """What flies here."""
        view = self.core.view
        name = view.profile.name if view is not None else ""
        return bus.Description(
            drone=self._drone,
            vehicle=self.vehicle.name,
            motor_kind=self.motor_kind(),  # type: ignore[arg-type]
            real_time=True,
            scenario=f"mavlink {name}",
            notes=(*self._notes, *(self.core.preparation.notes if self.core.preparation is not None else ())),
        )

    def motor_kind(self) -> str:
        """Rotor speeds where the vehicle declares them and the ESCs report them often enough; else commands."""
        if self._motor_kind is None:
            view, now = self.core.view, self.clock()
            reported = False
            if view is not None:
                speeds = max(view.rate_hz(name, now) for name in ("ESC_STATUS", "ESC_TELEMETRY_1_TO_4"))
                reported = speeds > max(1.0, 0.25 * view.rate_hz("SERVO_OUTPUT_RAW", now))
            wanted = self.vehicle.rotors.input
            self._motor_kind = "rotor_speed" if wanted == "rotor_speed" and reported else "command"
        return self._motor_kind

    # The loop ---------------------------------------------------------------------------------------------------------

    def _until(self, done: Callable[[], bool], deadline_s: float | None) -> None:
        while not done() and (deadline_s is None or self.clock() < deadline_s):
            self.turn()

    def turn(self) -> None:
        """Wait, step, write."""
        due = self.core.next_s - self.clock()
        if not self.core.waiting:
            self.transport.wait(min(timeouts.IDLE_WAIT_S, due) if due > -1e6 else timeouts.IDLE_WAIT_S)
        now = self.clock()
        if self._stop_reason and self.core.pilot is not None and self.core.pilot.phase in IN_AIR:
            self.core.order("abort", now, self._stop_reason)
        for sample, received_s in self._poses.read() if self._poses is not None else ():
            if isinstance(sample, Pose):
                self._emit(self.core.pose(sample, received_s))
            else:
                self.core.mocap_event(sample, received_s)
        self._emit(self.core.step(now, self.transport.read()))
        if self.core.peer is not None:
            self.transport.answer(self.core.peer)
        if (
            not self._inbox.empty()
        ):  # after what arrived, so that an order is not judged by the knowledge before a stall
            while self.core.waiting and self.clock() - now < timeouts.CATCH_UP_S:
                self._emit(self.core.step(self.clock(), ()))
            while not self._inbox.empty():
                self._inbox.get_nowait()()
            self._emit(self.core.step(self.clock(), ()))
        if self.core.pilot is not None and self.core.pilot.phase is Phase.LANDED:
            self.core.restore_parameters()
        self._answer()
        self._publish()

    def _emit(self, out: Output) -> None:
        for name, before, after in out.changed:  # on disk before the vehicle hears of it
            try:
                self._journal.note(self.core.view.key if self.core.view else "", name, before, after)
            except OSError as error:
                self._tell_failure(f"{name} ({before:g} before) is not noted for restoring", str(error))
        for data in out.send:
            self.transport.write(data)
        for sample, host_s in out.samples:
            if isinstance(sample, Raw) and self._logger is not None:
                self._logger.put((time.time(), sample.data))
                self._tell_failure("the raw log is not written any more", self._logger.failure)
            if not isinstance(sample, Motors) or (
                self.core.ready and self.motor_kind() in (sample.kind, "rotor_speed")
            ):
                self._batch.append((sample, host_s))

    def _tell_failure(self, what: str, why: str) -> None:
        """Once, in the recording and in this process's log: the recording may be what does not get it."""
        if why and what not in self._told_failures:
            self._told_failures.add(what)
            self.core.note(self.clock(), "link", f"{what}: {why}")
            with contextlib.suppress(OSError):  # its log may be on the disk that is full
                print(f"{what}: {why}", file=sys.stderr, flush=True)

    def _finished(self) -> bool:
        phase = self.core.pilot.phase if self.core.pilot is not None else Phase.IDLE
        unheard_s = self.clock() - self.core.view.heard_s if self.core.view is not None else 0.0
        if phase in IN_AIR and not (self._core_gone_s is not None and unheard_s > timeouts.VEHICLE_LOST_S):
            return False
        gone = self._core_gone_s is not None and self.clock() - self._core_gone_s > 1.0
        return gone or bool(self._stop_reason)

    def _restore(self) -> None:
        self.core.restore_parameters()
        self._until(lambda: not self.core.changed, self.clock() + timeouts.PARAMETERS_RESTORED_S)

    # The bus ----------------------------------------------------------------------------------------------------------

    def _later(self, job: Callable[[], None]) -> None:
        self._inbox.put(job)

    def _hear(self) -> None:
        self._core_gone_s = None
        self.core.core_heard(self.clock())

    def _core(self, alive: bool) -> None:
        if alive:
            self._core_seen = True
            self._hear()
        elif self._core_seen:
            self._core_gone_s = self.clock()
            self.core.core_lost()

    def _on_upload(self, upload: bus.Upload) -> bus.Answer:
        """On the bus's thread: check the bytes, and have the flying thread check the flight."""
        if not bus.checksum_holds(upload):
            return bus.Answer(False, "the plan was damaged on its way (checksum); send it again")
        try:
            parse = parse_toml if upload.format == "toml" else parse_json
            plan = plan_from_dict(parse(upload.plan, "the uploaded plan"), "the uploaded plan")
        except GroundStationError as error:
            return bus.Answer(False, str(error))
        return self._ask(lambda: self.core.upload(plan, self.clock()))

    def _on_command(self, command: bus.Command) -> bus.Answer:
        if command.name == "shutdown":
            if self.core.pilot is not None and self.core.pilot.phase in IN_AIR:
                return bus.Answer(False, "shutting down is refused in the air; land first")
            self.stop("the core asked for it")
            return bus.Answer(True)
        return self._ask(lambda: self.core.order(command.name, self.clock()), at_once=command.name == "start")

    def _ask(self, job: Callable[[], Answered], *, at_once: bool = False) -> bus.Answer:
        """Run a request on the flying thread and wait for its answer; ``at_once``: that it has begun is answer
        enough.
        """
        reply: queue.SimpleQueue[bus.Answer] = queue.SimpleQueue()

        def run() -> None:
            answered = job()
            if at_once and answered.ok is None:
                reply.put(bus.Answer(True))
            else:
                self._waiting.append((answered, reply))

        self._later(run)
        try:
            return reply.get(timeout=timeouts.ORDER_ANSWERED_S)
        except queue.Empty:
            return bus.Answer(False, "the vehicle did not answer in time")

    def _answer(self) -> None:
        """Behind what led to the answer: a core that is refused ends at once, and each check belongs in its record."""
        ready = [(answered, reply) for answered, reply in self._waiting if answered.ok is not None]
        if ready:
            self._publish(force=True)
        for answered, reply in ready:
            self._waiting.remove((answered, reply))
            answer = bus.Answer(bool(answered.ok), answered.reason)
            self._publisher.put(lambda reply=reply, answer=answer: reply.put(answer))

    def _publish(self, *, force: bool = False) -> None:
        now = self.clock()
        if self._memory is not None and now - self._remembered_s >= timeouts.SIGNING_MEMORY_EVERY_S:
            self._remembered_s = now
            self._publisher.put(self._memory.write)
        self._tell_failure("samples or status could not be published", self._publisher.failure)
        if self._batch and (force or now - self._sent_s >= timeouts.PUBLISH_EVERY_S):
            samples, times = zip(*self._batch, strict=True)
            batch = Batch(self._sequence, times, samples)
            self._publisher.put(lambda: self._samples.put(encode_batch(batch)))
            self._sequence, self._batch, self._sent_s = self._sequence + 1, [], now
        status = self.status(now)
        if force or status.phase != self._phase or now - self._status_s >= timeouts.STATUS_EVERY_S:
            self._phase, self._status_s = status.phase, now
            self._publisher.put(lambda: self._status.put(status))

    def status(self, now_s: float) -> bus.DroneStatus:
        """What the core is shown."""
        core, pilot, view = self.core, self.core.pilot, self.core.view
        device_s = core.device_s(now_s)
        if pilot is None or view is None:
            return bus.DroneStatus("idle", False, device_s, now_s, core.trouble)
        phase = _PHASES[pilot.phase]
        begun, ended = pilot.excitation_s
        if pilot.phase is Phase.FOLLOWING and begun is not None:
            phase = "exciting" if ended is None else "landing"
        flight: dict[str, object] = {}
        if view.state is not None:
            from groundstation.frames import euler_from_quat

            roll, pitch, yaw = (float(a) for a in euler_from_quat(view.state.quaternion))
            here = pilot.placement.to_plan(view.state.position_m)  # the frame of the plan, of the box and of every view
            flight = {"position_m": here, "euler_rad": (roll, pitch, yaw)}
        if pilot.target is not None:
            flight["setpoint_m"] = pilot.target.position_m
        if (window := pilot.window_s(now_s)) is not None:
            flight["window_s"] = tuple(device_s + (t - now_s) * self._rate() for t in window)
        text = pilot.reason or core.trouble or self.transport.trouble
        flight_s, end_s = pilot.progress_s()
        return bus.DroneStatus(
            phase,
            bool(view.armed),
            device_s,
            now_s,
            text,
            flight_s=flight_s,
            flight_end_s=end_s,
            **flight,  # type: ignore[arg-type]
        )

    def _rate(self) -> float:
        fit = self.core.clock.fit()
        return 1.0 if fit is None else fit.rate

    def _write_log(self, item: object) -> None:
        assert self._log is not None and isinstance(item, tuple)  # noqa: S101 - this thread's own queue
        self._log.write(tlog.record(*item))
        if item[0] - self._log_synced_s > timeouts.RAW_LOG_SYNC_EVERY_S:
            self._log_synced_s = item[0]
            os.fsync(self._log.fileno())


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the process."""
    options = parse(arguments)
    try:
        vehicle, station = load_vehicle(options.vehicle), load_station(options.station)
        journal = ParameterJournal(options.journal)
        memory = signing_of(options.key_file, options.journal)
        signing = memory.signing if memory is not None else None
        settings = Options(
            options.system or station.system,
            tuple(options.force),
            options.set_parameters,
            options.bytes_per_s or bandwidth_of(options.link),
            take_over=options.take_over,
        )
        core = LinkCore(vehicle, station, settings, signing, journal.pending(), free_bytes(options.raw_log))
        kept = Kept(journal, options.raw_log, memory)
        process = LinkProcess(core, open_transport(options.link), options.drone, kept)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: process.stop("the link was asked to stop"))
        return process.run(options.connect)
    except GroundStationError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    except (ValueError, ConnectionError) as error:
        print(error, file=sys.stderr)
        return BadInput.exit_status


if __name__ == "__main__":
    sys.exit(main())
