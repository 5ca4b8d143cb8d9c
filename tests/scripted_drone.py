"""A vehicle's process that does what a test tells it: the drone's side of drivers.bus without physics, and with faults.

    python -P tests/scripted_drone.py --drone NAME --connect ENDPOINT [--fault FAULT@PHASE]

Faults: ``refuse`` (the upload, with phase "upload"; arming, with "arm"), ``die``, ``freeze`` (SIGSTOP), ``crash``,
``land`` (comes down by itself), ``mute`` (stops sending), ``gap`` (drops a batch), ``hold`` (stays in the phase until
it is told to land).
"""

from __future__ import annotations

import argparse
import os
import queue
import signal
import sys
from itertools import accumulate

from drivers import bus
from drivers.access import own_login
from drivers.samples import Batch, Battery, Imu, Motors, Pose, encode_batch

PHASES: tuple[tuple[bus.DronePhase, float], ...] = (("takeoff", 2.0), ("exciting", 6.0), ("landing", 2.0))
LANDED: bus.DronePhase = "landed"
STEP_S = 0.05
REST = Imu(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.80665))


class Drone:
    phase: bus.DronePhase

    def __init__(self, options):
        self.fault, _, self.fault_phase = (options.fault or "none@never").partition("@")
        self.session = bus.open_session(connect=[options.connect], login=own_login())
        self.keys = bus.DroneKeys(options.drone)
        self.inbox = queue.SimpleQueue()
        self.phase, self.host_s, self.credit_s, self.start_s = "idle", 0.0, -1.0, 0.0
        self.began_s = 0.0
        self.sequence, self.crc, self.muted = 0, None, False
        self.samples = bus.Publisher(self.session, self.keys.samples, lossless=True)
        self.statuses = bus.Publisher(self.session, self.keys.status, lossless=True)
        self.handles = [
            bus.subscribe(self.session, self.keys.credit, bus.decoder_of(bus.Credit), self.inbox.put),
            bus.serve(self.session, self.keys.upload, bus.Upload, self.upload),
            bus.serve(self.session, self.keys.command, bus.Command, self.command),
            bus.serve(
                self.session, self.keys.describe, bus.Describe, lambda _: bus.Description("scripted", "scripted")
            ),
            bus.watch_alive(self.session, bus.CORE_ALIVE, lambda _, alive: None if alive else self.inbox.put("alone")),
        ]

    def upload(self, request):
        if (self.fault, self.fault_phase) == ("refuse", "upload"):
            return bus.Answer(False, "this vehicle cannot fly that")
        self.inbox.put(("uploaded", request.crc32))
        return bus.Answer(bus.checksum_holds(request), "checksum")

    def command(self, request):
        if request.name == "arm" and (self.fault, self.fault_phase) == ("refuse", "arm"):
            return bus.Answer(False, "the compass says no")
        self.inbox.put(request.name)
        return bus.Answer(True)

    def run(self):
        with bus.alive(self.session, self.keys.alive):
            while True:
                message = self.inbox.get()
                if isinstance(message, bus.Credit):
                    self.credit_s = max(self.credit_s, message.host_s)
                    while self.host_s < self.credit_s and self.phase != "landed":
                        self.step()
                elif message == "start":
                    self.start_s = self.began_s = self.host_s
                    self.enter("takeoff")
                elif message in ("abort", "land", "alone") and self.phase in ("takeoff", "exciting"):
                    self.start_s = self.host_s - PHASES[0][1] - PHASES[1][1]
                    self.enter("landing")
                    if message == "alone":
                        self.credit_s = float("inf")
                        while self.phase != "landed":
                            self.step()
                        sys.exit(0)
                elif message in ("abort", "land") and (self.fault, self.fault_phase) == ("hold", self.phase):
                    self.fault = "none"
                elif isinstance(message, tuple):
                    self.crc = message[1]
                    self.enter("uploaded")

    def step(self):
        self.host_s += STEP_S
        times = [self.host_s - STEP_S + 0.01 * (i + 1) for i in range(5)]
        if not (self.fault == "gap" and self.phase == self.fault_phase and self.sequence % 7 == 0) and not self.muted:
            samples = [Imu(t, REST.gyro_rad_s, REST.accel_m_s2) for t in times]
            samples += [Motors(t, (400.0,) * 4) for t in times]
            samples += [Pose(times[-1], (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0)), Battery(times[-1], 12.0, 5.0)]
            self.samples.put(
                encode_batch(Batch(self.sequence, tuple(s.device_s for s in samples), tuple(samples), self.host_s))
            )
        self.sequence += 1
        if self.phase in ("takeoff", "exciting", "landing"):
            ends = accumulate(duration for _, duration in PHASES)
            if self.fault == "hold" and self.phase == self.fault_phase:
                self.start_s += STEP_S
            flown = self.host_s - self.start_s
            begun: list[bus.DronePhase] = [name for (name, _), end in zip(PHASES, ends, strict=True) if flown < end]
            at: bus.DronePhase = begun[0] if begun else LANDED
            self.enter(at) if at != self.phase else self.report()
        else:
            self.report()

    def enter(self, phase: bus.DronePhase):
        self.phase = phase
        self.report()
        if phase != self.fault_phase:
            return
        if self.fault == "die":
            os._exit(7)
        if self.fault == "freeze":
            os.kill(os.getpid(), signal.SIGSTOP)
        if self.fault == "mute":
            self.muted = True
        if self.fault == "crash":
            self.enter("crashed")
        if self.fault == "land":
            self.start_s = self.host_s - PHASES[0][1] - PHASES[1][1]
            self.phase = "landing"
            self.report("low battery")

    def report(self, text=""):
        if self.muted:
            return
        flown = self.host_s - self.start_s if self.start_s else 0.0
        window = (self.began_s + PHASES[0][1], self.began_s + PHASES[0][1] + PHASES[1][1]) if self.began_s else None
        armed = self.phase in ("takeoff", "exciting", "landing")
        self.statuses.put(
            bus.DroneStatus(self.phase, armed, self.host_s, self.host_s, text, flown, 10.0, window, plan_crc32=self.crc)
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--drone", required=True)
    parser.add_argument("--connect", required=True)
    parser.add_argument("--fault", default="")
    Drone(parser.parse_args()).run()
