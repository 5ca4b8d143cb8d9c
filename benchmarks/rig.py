"""One flight of real processes with the relay between autopilot and station: for the fault table and the hostile
frames.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import tomli_w

from groundstation.errors import BadInput, Refused
from groundstation.flight.client.client import FlightOrder, outcome, start_core
from groundstation.flight.client.rehearse import LinkOrder, linked_vehicle
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.paths import find_config
from groundstation.trajectory import plan_from_dict
from studies.firmware import PX4_ENVIRONMENT, arducopter_command, px4_command

START_S, FIRMWARE_READY_S = 90.0, 150.0
PLAN = {
    "schema": "groundstation.plan/1", "vehicle": "x500", "base_frequency_rad_s": 2.0944, "periods": 20.0,
    "coefficients": {
        "x": {"a": [0.3], "b": [0.0], "c": 0.0}, "y": {"a": [0.0], "b": [0.0]}, "z": {"a": [0.0], "b": [0.0], "c": 1.0},
        "yaw": {"a": [0.0], "b": [0.0]},
    },
}  # fmt: skip


def free_port() -> int:
    """A UDP port nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


class Flight:
    """Autopilot, relay, core and link; started when made.

    Args:
        profile: ``px4`` or ``arducopter``.
        binary: of its firmware, flown on this project's physics; None flies the emulated one.
    """

    def __init__(self, profile: str, binary: Path | None = None):
        self.root = Path(tempfile.mkdtemp(prefix="rig-"))
        self.firmware = binary is not None
        self.port = free_port()
        relay = [sys.executable, str(Path(__file__).with_name("relay.py")), str(self.port)]
        relay += ["14540"] if binary is not None and profile == "px4" else []
        self.relay = subprocess.Popen(relay, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.relay.stdout is not None
        vehicle_port = json.loads(self.relay.stdout.readline())["vehicle_port"]
        self.seen: list[dict[str, Any]] = []
        threading.Thread(target=self._listen, daemon=True).start()
        self.autopilot = [self._child(command) for command in self._commands(profile, binary, vehicle_port)]
        self._tries = 0
        self._start_core()

    def _commands(self, profile: str, binary: Path | None, port: int) -> list[list[str]]:
        """Of what stands for the vehicle."""
        if binary is None:
            emulator = [sys.executable, "-P", "-m", "sim.mavlink", "--profile", profile, "--vehicle", "x500"]
            return [[*emulator, "--link", f"udpout://127.0.0.1:{port}"]]
        physics = [sys.executable, "-P", "-m", "sim.firmware", "--vehicle", "x500"]
        if profile == "px4":
            return [[*physics, "--px4", "tcp://127.0.0.1:4560", "--scenario", "hall"], px4_command(binary, self.root)]
        command = arducopter_command(binary, self.root, link=f"udpclient:127.0.0.1:{port}")
        return [[*physics, "--arducopter", "127.0.0.1:9002", "--scenario", "hall"], command]

    def _child(self, command: list[str]) -> subprocess.Popen[bytes]:
        environment = {**os.environ, **PX4_ENVIRONMENT}
        where = None if command[0] == sys.executable else self.root
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment,
            cwd=where,
        )  # fmt: skip

    def _start_core(self) -> None:
        """A core and a link in a folder of their own."""
        self._tries += 1
        self.folder = self.root / f"2026-11-29T12-00-{self._tries:02d}-x500"
        self.folder.mkdir()
        plan, station = self.folder / "plan.toml", self.root / "station.toml"
        plan.write_text(tomli_w.dumps(plan_from_dict(PLAN).model_dump(mode="json", by_alias=True, exclude_none=True)))
        station.write_text('[policy]\nclimb_m_s = 1.0\nsettle_s = 1.0\ntrajectory = "setpoints"\n')
        vehicle = find_config("vehicles", "x500")
        order = LinkOrder(f"udpin://127.0.0.1:{self.port}", str(station), set_parameters=True)
        drone = linked_vehicle(self.folder, vehicle, order)
        self.core, _ = start_core(FlightOrder(self.folder, plan, vehicle, drone, analyse=False), start=True)

    def _listen(self) -> None:
        assert self.relay.stdout is not None
        for line in self.relay.stdout:
            self.seen.append(json.loads(line))

    def order(self, **order: Any) -> None:
        """To the relay."""
        assert self.relay.stdin is not None
        self.relay.stdin.write(json.dumps(order) + "\n")
        self.relay.stdin.flush()

    def journal(self) -> list[dict[str, Any]]:
        """What the core decided so far."""
        log = self.folder / JOURNAL
        return read_journal(log) if log.is_file() else []

    def excite(self) -> bool:
        """Wait for the excitation; whether it came. Firmware that has no position yet is asked again."""
        end = time.monotonic() + (START_S + FIRMWARE_READY_S * self.firmware)
        while time.monotonic() < end:
            if any(entry["text"].endswith("-> exciting") for entry in self.journal()):
                return True
            if self.core.poll() is not None:
                if not self.firmware or self.core.poll() != Refused.exit_status:
                    return False
                self._start_core()
            time.sleep(0.05)
        return False

    def pids(self) -> dict[str, int]:
        """Core and link."""
        children = Path(f"/proc/{self.core.pid}/task/{self.core.pid}/children").read_text().split()
        link = [int(p) for p in children if b"flight.link" in Path(f"/proc/{p}/cmdline").read_bytes()]
        return {"core": self.core.pid, "link": link[0]}

    def until_down(self, limit_s: float) -> dict[str, Any] | None:
        """The first word of the vehicle that it is disarmed; None when none came in time."""
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            if self.seen and self.seen[-1]["armed"] is False:
                return next(s for s in self.seen[::-1] if s["armed"] is False)
            time.sleep(0.02)
        return None

    def ended(self, limit_s: float = 15.0) -> tuple[int | None, str]:
        """Exit status and sentence of the core; None when it has none."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.core.wait(limit_s)
        if self.core.poll() is None:
            return None, "the core still waits for the vehicle"
        try:
            return outcome(self.folder)
        except BadInput:
            return None, "no core is left to say"

    def close(self) -> None:
        """End what was started here."""
        with contextlib.suppress(OSError, IndexError):
            for pid in self.pids().values():
                os.kill(pid, signal.SIGKILL)
        self.core.kill()
        for process in (*self.autopilot, self.relay):
            process.kill()
            process.wait()
        shutil.rmtree(self.root, ignore_errors=True)
