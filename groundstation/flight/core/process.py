r"""The core process of one flight: sequence, recorder and bus. It flies on when every client is gone.

    python -P -m groundstation.flight.core.process --folder logs/NAME --plan P --vehicle V \
        --listen tcp/127.0.0.1:7450 -- sim ...

What follows ``--`` is the module and arguments of the process that stands for the vehicle: the simulated drone, or the
link to a real one. Both speak the drone's side of ``drivers.bus``; the core adds ``--drone`` and ``--connect``.

The main thread owns the sequence and waits on one queue; zenoh's threads and the recorder put into it. Requests that
can take time (upload, arm, abort) are asked on a thread of their own, so that credit and status never wait for them.
"""

from __future__ import annotations

import queue
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from drivers import bus
from drivers.samples import Batch, decode_batch
from groundstation.errors import BadInput, GroundStationError
from groundstation.flight import sequence as seq
from groundstation.flight import timeouts
from groundstation.flight.core.analysing import FlightAnalysis
from groundstation.flight.core.ground_check import check_ground
from groundstation.flight.core.lease import OperatorLease
from groundstation.flight.core.orders import ClientOrders
from groundstation.flight.core.overview import FlightView
from groundstation.flight.core.pacing import Pace
from groundstation.flight.core.recorder import Recorder, open_recording, sound
from groundstation.flight.core.requests import Requests
from groundstation.flight.core.settings import Settings, parse
from groundstation.flight.core.status_events import event_of
from groundstation.flight.core.until import FlyUntil
from groundstation.flight.core.vehicle_process import DRONE, VehicleProcess
from groundstation.flight.journal import ENDPOINT_FILE, RAW_LOG, WATCH_FILE, Journal
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.messages import CLIENT_ALIVE, CoreCommand, Lease
from groundstation.recording.keeper import Keeper
from groundstation.recording.manifest import write_manifest
from groundstation.trajectory import Plan, flight_path, load_plan
from groundstation.vehicle import Vehicle, load_vehicle

LOCK_STEP_SLACK = 20.0
"""Factor on all deadlines of a lock-stepped flight, which may run slower than the wall's clock."""


class FlightCore:
    """Runs one flight from upload to report. Construct and :meth:`run` on the main thread.

    Args:
        settings: what to fly and where to keep it.
        clock: monotonic seconds; passed in so that nothing here reads a clock by itself.
    """

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic):
        self.settings = settings
        self.clock = clock
        self.plan: Plan = load_plan(settings.plan)
        self.vehicle: Vehicle = load_vehicle(settings.vehicle)
        self.journal = Journal(settings.folder / JOURNAL, clock)
        self.inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.state = seq.Sequence()
        self.view = FlightView(settings.folder, self.vehicle)
        self.description = bus.Description()
        self.recorder: Recorder | None = None
        self.pace = Pace(lock_step=False)  # until the vehicle has said what it is
        self.lease = OperatorLease()
        self._clients = ClientOrders(
            self.lease, clock, lambda: self.state.phase, self.inbox.put, self.event, self._agree
        )
        self.digested_s = self.moment_s = 0.0
        self._first_s: float | None = None
        self.finished = False
        self._credit_sent = (-1.0, -1e9)
        self._status_sent = -1e9
        self._malformed = 0
        self._abort_heard = False
        self._keeper: Keeper | None = None
        self._process = VehicleProcess(settings, clock)
        self._analysis = FlightAnalysis(self, self.inbox.put)

    # Main loop --------------------------------------------------------------------------------------------------------

    def run(self) -> int:
        """Fly; returns the exit status."""
        self.settings.folder.mkdir(parents=True, exist_ok=True)
        secrets = self.settings.secrets
        with (
            bus.open_session(listen=self.settings.listen, admit=(secrets, DRONE)) as session,
            bus.alive(session, bus.CORE_ALIVE),
        ):
            keys = bus.DroneKeys(DRONE)
            self._requests = Requests(session, keys, self, self.inbox.put, lambda: bool(self.state.aborting))
            self._credit = bus.Publisher(session, keys.credit)
            self._status = bus.Publisher(session, bus.CORE_STATUS)
            self._handles = [
                bus.subscribe(session, keys.samples, decode_batch, self._from_bus(self._on_batch)),
                bus.subscribe(session, keys.status, bus.decoder_of(bus.DroneStatus), self._from_bus(self._on_word)),
                bus.serve(session, bus.CORE_COMMAND, CoreCommand, self._clients.command),
                bus.serve(session, bus.CORE_ABORT, CoreCommand, self._clients.abort),
                bus.serve(session, bus.CORE_LEASE, Lease, self._clients.lease),
                bus.watch_alive(session, keys.alive, self._on_drone_alive),
                bus.watch_alive(session, CLIENT_ALIVE.format(client="*"), self.lease.client_alive),
            ]
            try:
                self._process.start(self.settings.take_over)
                while not self.finished:
                    self._turn()
                self._publish_status(force=True)
            finally:
                self._shut_down()
        return self.state.exit_status if self.state.exit_status is not None else 1

    def _turn(self) -> None:
        """Handle what came, or what time brought."""
        try:
            self.inbox.get(timeout=0.05)()
            while not self.finished:
                self.inbox.get_nowait()()
        except queue.Empty:
            pass
        self._check_children()
        self.event(seq.Tick())
        self._analysis.watch(self.state.phase, self.clock(), lock_step=self.pace.lock_step)
        self._send_credit()
        self._publish_status()

    def _from_bus(self, handler: Callable[[Any], None]) -> Callable[[Any], None]:
        """A handler for zenoh's thread that runs ``handler`` on the main thread."""
        return lambda message: self.inbox.put(lambda: handler(message))

    def event(self, event: seq.Event) -> None:
        """Take an event into the sequence and do what follows from it."""
        before = self.state
        self.state, actions = seq.step(self.state, event, self.clock())
        if self.state.phase is not before.phase:
            self.tell("phase", f"{before.phase} -> {self.state.phase}", reason=self.state.reason or self.state.aborting)
        for action in actions:
            self._do(action)
        if self.state.phase is not before.phase:
            self._publish_status(force=True)

    def tell(self, kind: str, text: str, **figures: Any) -> None:
        """One line in the flight's log, one event in the recording, one sentence for the clients."""
        self.journal.write(kind, text, host_s=self.moment_s, **{k: v for k, v in figures.items() if v != ""})
        reason = figures.get("reason")
        self.view.notes.append(f"{text}: {reason}" if reason else text)
        if self.recorder is not None:
            self.recorder.note(self.moment_s, kind, self.view.notes[-1])

    # From the vehicle -------------------------------------------------------------------------------------------------

    def _on_drone_alive(self, _key: str, is_alive: bool) -> None:
        def handle() -> None:
            if is_alive:
                self._requests.describe()
            else:
                if not self._process.can_be_replaced(
                    self.state
                ):  # a link's end shows in its process, and another is started
                    self.event(seq.VehicleLost("the vehicle's process vanished from the bus"))

        self.inbox.put(handle)

    def described(self, description: bus.Description) -> None:
        """The vehicle said what it is: record it, and send it the plan."""
        if self.recorder is not None or self.state.final:
            return  # the vehicle's process came back; its flight goes on, or is over
        self._process.heard()
        self.description, self.pace = description, Pace(lock_step=not description.real_time)
        if self.plan.until is not None:
            self.view.until = FlyUntil(self.plan, self.vehicle, lock_step=self.pace.lock_step)
            self.view.live.inline = self.pace.lock_step
        sink = open_recording(
            self.settings.folder, self.settings.plan, self.settings.vehicle, description, self.settings.drone
        )
        self.recorder = Recorder(
            sink,
            on_digested=lambda host_s: self.inbox.put(lambda: self._digested(host_s)),
            on_failure=lambda reason: self.inbox.put(lambda: self.event(seq.AbortRequested(reason))),
            motor_kind=description.motor_kind,
        )
        self._keeper = Keeper(sink.path, sink.sync, lambda reason: self.inbox.put(lambda: self._unkept(reason)))
        if not description.real_time:
            # Deadlines run on the wall's clock; a simulation slower than real time is no fault.
            self.state = replace(self.state, deadlines=seq.Deadlines(slack=LOCK_STEP_SLACK))
        duration_s = flight_path(self.plan, (0.0, 0.0, 0.0, 0.0)).duration_s
        if self.settings.take_over:
            self.event(seq.TakenOver(f"found in flight and taken over ({self.settings.take_over})", duration_s))
        else:
            self.event(seq.PlanChosen(duration_s))

    def _unkept(self, reason: str) -> None:
        """What is recorded now would be lost: there is no use in flying on."""
        if self.state.phase not in (seq.Phase.LANDED, seq.Phase.IDENTIFYING):
            self.event(seq.AbortRequested(f"the recording is not kept: {reason}"))

    def _digested(self, host_s: float) -> None:
        self.digested_s = max(self.digested_s, host_s)
        self.moment_s = self.digested_s
        self._first_s = host_s if self._first_s is None else self._first_s
        if self.state.phase is seq.Phase.UPLOADED and self.pace.stands(self.digested_s):
            self._check()

    def _on_batch(self, batch: Batch) -> None:
        self._process.heard()
        if not sound(batch, self.vehicle.rotors.count):
            self._malformed += 1
            return
        over = self.state.phase in (seq.Phase.LANDED, seq.Phase.IDENTIFYING)
        if self.pace.recorded(batch) and self.recorder is not None and not over:
            self.recorder.put(batch)
        self.view.see(batch.samples, self.state.phase)
        for status in self.pace.due():
            self._on_status(status)
        if self.pace.lock_step:
            self._until_known(batch.until_s)

    def _on_word(self, word: bus.DroneStatus) -> None:
        self._process.heard()
        self.pace.heard(word)
        for status in self.pace.due():
            self._on_status(status)

    def _on_status(self, status: bus.DroneStatus) -> None:
        self.moment_s = status.host_s
        before, self.view.drone = self.view.drone, status
        self._stands(status)
        if not self.pace.lock_step:
            self._until_known(status.host_s)
        if self.recorder is not None and status.phase == "exciting" and status.window_s is not None:
            self.recorder.window(status.window_s)
            if self.view.until is not None:
                self.view.until.follow(status)
        if before is not None and status.phase == before.phase:
            return
        if self.recorder is not None:
            self.recorder.status(status)
        self.journal.write("vehicle", status.phase, host_s=status.host_s, said=status.text)
        if (event := event_of(status, self.state.phase)) is not None:
            self.event(event)

    def _stands(self, status: bus.DroneStatus) -> None:
        """An abort was answered, and the vehicle shows that it neither flies nor is armed."""
        if self._abort_heard and status.phase in ("idle", "uploaded") and not status.armed:
            self.event(seq.VehicleStands())

    def abort_answered(self) -> None:
        """The vehicle's status now shows whether there was anything to abort."""
        self._abort_heard = True
        if self.view.drone is not None:
            self._stands(self.view.drone)

    def _until_known(self, host_s: float) -> None:
        """Shortly before a rest point of a flight until known: whether it ends there or goes on."""
        until = self.view.until
        if until is None or self.state.phase is not seq.Phase.EXCITING:
            return
        order, told = until.moment(host_s, self.description.batch_s, self.view.live.estimates, self.view.battery_v)
        if told:
            self.tell("until", told)
        if order:
            self._requests.change_length(order, lambda ok: until.answered(order, ok=ok))

    def _agree(self) -> str:
        return "this flight has a fixed length." if self.view.until is None else self.view.until.agree()

    # Actions ----------------------------------------------------------------------------------------------------------

    def _do(self, action: seq.Action) -> None:
        """Carry out one action of the sequence."""
        match action.do:
            case seq.Do.UPLOAD:
                self._requests.upload(self.settings.plan)
            case seq.Do.CHECK:
                self._check()
            case seq.Do.START:
                self._requests.start()
                self._analysis.prepare()
            case seq.Do.ABORT | seq.Do.KILL | seq.Do.LAND | seq.Do.DISARM:
                name: bus.CommandName = action.do.value  # type: ignore[assignment]
                self._requests.command(name)
            case seq.Do.CLOSE_RECORDING:
                self._close_recording()
            case seq.Do.ANALYSE:
                self._analyse()
            case seq.Do.FINISH:
                self.finished = True

    def _close_recording(self) -> None:
        if self._keeper is not None:
            self._keeper.close()
        if self.recorder is not None:
            self.recorder.close()
            self.journal.write(
                "recording",
                f"{self.recorder.recorded} samples recorded, {self.recorder.lost_batches} batches were lost",
                streams=self.recorder.counts(),
            )
            self._seal("plan.toml", *(file.name for file in self.settings.folder.glob("flight*.mcap")))

    def _seal(self, *names: str) -> None:
        """Checksums of files that are complete; the flight goes on without them."""
        inputs = {"plan.toml": self.settings.plan, "vehicle.toml": self.settings.vehicle}
        if failed := write_manifest(self.settings.folder, names, inputs):
            self.tell("manifest", failed)

    def _check(self) -> None:
        """Called as data come in, until it can say yes or no."""
        if self.recorder is None or self._first_s is None:
            self.pace.look()
            return
        streams = self.recorder.streams(self.digested_s)
        volts = self.view.battery_v
        answer = check_ground(streams, volts, self.vehicle, self.digested_s - self._first_s)
        if answer is None:
            self.pace.look()
            return
        rates = {name: round(stream.rate_hz, 1) for name, stream in streams.items()}
        told = "streams and battery are as they should be" if answer.ok else "not ready to fly"
        self.tell("checks", told, reason=answer.reason, rates_hz=rates, battery_v=volts)
        self.event(answer)
        if self.settings.start:
            self.event(seq.StartRequested())

    def _analyse(self) -> None:
        if not self._analysis.begin():
            self.event(seq.AnalysisFinished(0, "" if self.state.aborting else "not asked for"))
            return
        self.state = seq.analysing(self.state, self.clock())

    # Housekeeping -----------------------------------------------------------------------------------------------------

    def _check_children(self) -> None:
        if self.state.phase in (seq.Phase.LANDED, seq.Phase.IDENTIFYING):
            return
        if ended := self._process.ended():
            self._lost(ended[0], refused=ended[1])
            return
        described, seen = self.recorder is not None, self.view.drone is not None
        owed = not described or self.pace.owes(self.state.phase, self.digested_s)
        if owed and (silence := self._process.silent(self.state, described=described, seen=seen)):
            self._lost(silence)

    def _lost(self, reason: str, *, refused: str = "") -> None:
        """A link is started again and takes over by landing; another vehicle's process is lost."""
        if not self._process.can_be_replaced(self.state):
            self.event(seq.VehicleLost(refused or reason, refused=bool(refused)))
            return
        self.tell("vehicle", "another link is started, and lands the vehicle", reason=reason)
        self.event(seq.LinkDied(f"{reason}; another link landed it"))
        self.view.drone = None
        self._process.replace()

    def _send_credit(self) -> None:
        now, credit = self.clock(), self.pace.credit_s(self.state.phase, self.digested_s)
        if self.view.until is not None:
            credit = min(credit, self.view.until.hold_s())
        sent, at = self._credit_sent
        if self.recorder is not None and (credit >= sent + 0.1 or now - at > timeouts.CREDIT_EVERY_S):
            self._credit.put(bus.Credit(credit))
            self._credit_sent = (credit, now)

    def _publish_status(self, *, force: bool = False) -> None:
        now = self.clock()
        if not force and now - self._status_sent < timeouts.STATUS_EVERY_S:
            return
        self._status_sent = now
        self.view.rejected = self._malformed + sum(getattr(handle, "rejected", 0) for handle in self._handles)
        self.view.lease, self.view.real_time = self.lease.holder, self.description.real_time
        self._status.put(self.view.status(self.state, self.recorder, self.digested_s))

    def _shut_down(self) -> None:
        """Leave nothing behind: recording closed, orders given, children gone, the outcome in the log."""
        self._requests.close()
        if self.recorder is not None:
            self.recorder.close()
        self._analysis.stop()
        if (pid := self._process.leave()) is not None:
            self.tell("vehicle", "the vehicle's process goes on by itself", pid=pid)
        elif self.recorder is not None:
            self._seal(RAW_LOG)
        for name in (ENDPOINT_FILE, WATCH_FILE):
            (self.settings.folder / name).unlink(missing_ok=True)
        status = self.state.exit_status if self.state.exit_status is not None else 1
        self.journal.write("outcome", self.state.phase, exit_status=status, reason=self.state.reason)
        self.journal.close()

    def abort(self, reason: str) -> None:
        """Ask for an abort from a signal handler or another thread."""
        self.inbox.put(lambda: self.event(seq.AbortRequested(reason)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the process."""
    settings = parse(arguments)
    try:
        core = FlightCore(settings)
    except GroundStationError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: core.abort("the core was asked to stop"))
    try:
        return core.run()
    except (GroundStationError, ConnectionError) as error:
        print(error, file=sys.stderr)
        return BadInput.exit_status


if __name__ == "__main__":
    sys.exit(main())
