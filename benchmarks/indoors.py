"""Indoors by motion capture: whole flights, and cameras that go dark at each phase, on the emulated autopilots and on
firmware.

python -m benchmarks.indoors [--px4 PATH] [--arducopter PATH] [--cut PHASE ...] [--out docs/results/indoors.json]

Physics and cameras (an OptiTrack server fed by them) run in this process, so that what the vehicle really did is known;
the firmware or the emulated autopilot, core and link are processes of their own. Without a path the emulated autopilot
is flown. With firmware its ports must be free: TCP 4560 and UDP 14540 (PX4), UDP 9002 and TCP 5760 (ArduCopter).
Results are kept by autopilot, kind and phase, and added to what is there.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from benchmarks.rig import PLAN, free_port
from groundstation.errors import BadInput, GroundStationError
from groundstation.flight.client.client import FlightOrder, outcome, start_core
from groundstation.flight.client.rehearse import LinkOrder, linked_vehicle
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.paths import find_config
from groundstation.recording.load import read_recording
from groundstation.trajectory import plan_from_dict
from groundstation.vehicle import load_vehicle
from sim.build import true_vehicle
from sim.firmware.__main__ import serve_json, serve_tcp
from sim.firmware.arducopter import JsonExchange
from sim.firmware.px4 import HilExchange
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.plant import SimulatedAirframe
from sim.mavlink.process import Service, attach
from sim.mavlink.px4 import Px4
from sim.scenario import load_scenario
from studies.firmware import PX4_ENVIRONMENT, arducopter_command, px4_command

OUT = Path("docs/results/indoors.json")
PHASES = ("before arming", "climbing", "settling", "exciting", "landing", "never")
ABORTED = {"landing": 5.0, "never": 20.0}
"""Seconds of excitation after which the operator ends the flight."""
WHOLE = ("whole", "declared")
YAW_RAD = 0.7
"""The vehicle does not look along the room's x: a yaw that is not taken from the poses would show."""
SHARES = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")
READY_S, DOWN_S, TRIES = 150.0, 60.0, 4


@dataclass
class Moment:
    """The truth at an instant."""

    at_s: float
    position_m: tuple[float, float, float]
    on_ground: bool
    turning: bool


class World:
    """Physics, cameras and an autopilot.

    Args:
        autopilot: ``px4`` or ``arducopter``.
        binary: of the firmware; None flies the emulated one.
        root: where the firmware keeps its files.
    """

    def __init__(self, autopilot: str, binary: Path | None, root: Path):
        scenario = load_scenario(find_config("scenarios", "hall"))
        start = scenario.start.model_copy(update={"yaw_rad": YAW_RAD})
        self.vehicle = load_vehicle(find_config("vehicles", "x500"))
        mocap = scenario.mocap.model_copy(update={"dropouts_per_minute": 0.0, "freezes_per_minute": 0.0})
        self.scenario = scenario.model_copy(
            update={"start": start, "mocap": mocap}
        )  # dark is what is tried here, alone
        self.airframe = SimulatedAirframe(self.vehicle, self.scenario, seed=1)
        self.airframe.step(0.004, (0.0,) * 4)
        self.camera_port = free_port()
        self.airframe.filmed_from(f"127.0.0.1:{self.camera_port}")
        self.moments: list[Moment] = []
        self._stop = False
        self._children: list[subprocess.Popen[bytes]] = []
        self._log = (root / "firmware.log").open("wb")
        self._root = root
        run, self.link = {
            ("px4", True): self._px4, ("arducopter", True): self._arducopter,
            ("px4", False): lambda _: self._emulated(Px4), ("arducopter", False): lambda _: self._emulated(ArduCopter),
        }[autopilot, binary is not None](binary)  # fmt: skip
        self._threads = [threading.Thread(target=run, daemon=True), threading.Thread(target=self._watch, daemon=True)]
        for thread in self._threads:
            thread.start()

    def dark(self) -> None:
        """No camera sees it any more."""
        assert self.airframe.cameras is not None
        self.airframe.cameras.covered = True

    def close(self) -> None:
        """End what was started here."""
        self._stop = True
        for child in self._children:
            child.kill()
            child.wait()
        for thread in self._threads:
            thread.join(5.0)
        if self.airframe.cameras is not None:
            self.airframe.cameras.close()
        self._log.close()

    def _watch(self) -> None:
        while not self._stop:
            state = self.airframe.state
            turning = max(state.rotor_speed_rad_s) > 50.0
            self.moments.append(Moment(time.monotonic(), state.position_m, state.on_ground, turning))
            time.sleep(0.02)

    def _start(self, command: list[str], **environment: str) -> None:
        self._children.append(
            subprocess.Popen(
                command, cwd=self._root, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log,
                env={**os.environ, **environment},
            )
        )  # fmt: skip

    def _px4(self, binary: Path) -> tuple[Callable[[], None], str]:
        server = socket.create_server(("127.0.0.1", 4560))
        self._start(px4_command(binary, self._root), **PX4_ENVIRONMENT)

        def run() -> None:
            connection, _ = server.accept()
            with server, connection, contextlib.suppress(GroundStationError):
                serve_tcp(HilExchange(self.airframe, 4), connection, lambda: self._stop, 1.0)

        return run, "udpin://127.0.0.1:14540"

    def _arducopter(self, binary: Path) -> tuple[Callable[[], None], str]:
        place = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        place.bind(("127.0.0.1", 9002))
        self._start(arducopter_command(binary, self._root))

        def run() -> None:
            with place:
                serve_json(JsonExchange(self.airframe, 4), place, lambda: self._stop)

        return run, "tcp://127.0.0.1:5760"

    def _emulated(self, kind: type[Px4] | type[ArduCopter]) -> tuple[Callable[[], None], str]:
        port = free_port()
        drift = -0.012 if kind is Px4 else 0.0
        autopilot = kind(self.vehicle, self.airframe, boot_s=60.0, clock_drift=drift, unix_s=time.time(), seed=1)
        service = Service(autopilot, attach(autopilot, (f"udpout://127.0.0.1:{port}",)))

        def run() -> None:
            while not self._stop:
                begun = time.monotonic()
                service.turn(begun)
                time.sleep(max(0.0005, autopilot.tick_s - (time.monotonic() - begun)))

        return run, f"udpin://127.0.0.1:{port}"


def station_file(root: Path, world: World, latency_s: float) -> Path:
    """A room with cameras."""
    path = root / "station.toml"
    path.write_text(
        'indoors = true\n[policy]\nclimb_m_s = 0.7\nsettle_s = 2.0\ntrajectory = "setpoints"\n[mocap]\nsystem = '
        '"natnet"\n'
        f'host = "127.0.0.1:{world.camera_port}"\nneeded_hz = 40.0\nlatency_s = {latency_s:g}\n'
    )
    return path


class Cut:
    """One flight whose cameras go dark at a phase."""

    def __init__(self, world: World, phase: str, root: Path, latency_s: float):
        self.world, self.phase, self.root = world, phase, root
        self.folder = root / "2026-11-29T12-00-00-x500"
        self.latency_s = latency_s

    def fly(self) -> dict[str, Any]:
        """What happened; refused before the phase: ``failed`` says why."""
        end = time.monotonic() + READY_S
        while True:
            shutil.rmtree(self.folder, ignore_errors=True)
            result = self._once()
            if "failed" not in result or time.monotonic() > end:
                return result

    def _once(self) -> dict[str, Any]:
        self.folder.mkdir()
        plan, vehicle = self.folder / "plan.toml", find_config("vehicles", "x500")
        document = plan_from_dict(PLAN).model_dump(mode="json", by_alias=True, exclude_none=True)
        plan.write_text(tomli_w.dumps(document))
        station = station_file(self.root, self.world, self.latency_s)
        drone = linked_vehicle(self.folder, vehicle, LinkOrder(self.world.link, str(station), set_parameters=True))
        self.core, _ = start_core(FlightOrder(self.folder, plan, vehicle, drone, analyse=False), start=True)
        try:
            if not self._reached():
                return {"failed": self._outcome()[1]}
            return self._dark()
        finally:
            self.core.kill()

    def _texts(self) -> list[str]:
        log = self.folder / JOURNAL
        return [entry["text"] for entry in read_journal(log)] if log.is_file() else []

    def _reached(self) -> bool:
        """Wait for the phase; whether it came."""
        seen: dict[str, Callable[[], bool]] = {
            "before arming": lambda: any("-> uploaded" in t for t in self._texts()),
            "climbing": lambda: self.world.moments[-1].position_m[2] > 0.5,
            "settling": lambda: self.world.moments[-1].position_m[2] > 0.9,
            "exciting": lambda: any(t.endswith("-> exciting") for t in self._texts()),
            "landing": lambda: any(t.endswith("-> landing") for t in self._texts()),
            "never": lambda: any(t.endswith("-> landing") for t in self._texts()),
        }
        end, excited_s = time.monotonic() + 240.0, None
        while time.monotonic() < end and self.core.poll() is None:
            if self.phase in ABORTED and excited_s is None and seen["exciting"]():
                excited_s = time.monotonic()
            if excited_s is not None and time.monotonic() > excited_s + ABORTED[self.phase]:
                os.kill(self.core.pid, signal.SIGTERM)  # an abort: the autopilot's own landing, with the cameras on
                excited_s = math.inf
            if seen[self.phase]():
                if self.phase == "exciting":
                    time.sleep(5.0)
                return True
            time.sleep(0.02)
        return False

    def _dark(self) -> dict[str, Any]:
        if self.phase != "never":
            self.world.dark()
        dark_s = time.monotonic()
        there = self.world.moments[-1].position_m
        end = dark_s + DOWN_S
        while time.monotonic() < end:
            last = self.world.moments[-1]
            if last.on_ground and not last.turning and time.monotonic() > dark_s + 3.0:
                break
            time.sleep(0.05)
        status, reason = self._outcome()
        after = [m for m in self.world.moments if m.at_s >= dark_s]
        flown = [m for m in after if not m.on_ground]
        ground_s = next((m.at_s for m in after if m.on_ground and m.at_s > (flown[-1].at_s if flown else 0.0)), None)
        still_s = next((m.at_s for m in after if not m.turning and m.at_s >= (ground_s or math.inf)), None)
        landing = [e["monotonic_s"] for e in read_journal(self.folder / JOURNAL) if e["text"].endswith("-> landing")]
        drift = max((math.dist(m.position_m[:2], there[:2]) for m in flown), default=0.0)
        return {
            "reason": reason, "status": status, "left_the_ground": bool(flown),
            "noticed_s": round(landing[0] - dark_s, 2) if landing and landing[0] > dark_s else None,
            "ground_s": round(ground_s - dark_s, 2) if flown and ground_s is not None else None,
            "stopped_s": round(still_s - dark_s, 2) if flown and still_s is not None else None,
            "drift_m": round(drift, 2),
            "by": who(reason, bool(flown)), "latency": self._latency(), "latency_declared_s": self.latency_s,
        }  # fmt: skip

    def _latency(self) -> str:
        """What the link measured of the poses; empty where it measured none."""
        events = read_recording(self.folder / "flight.mcap").texts.get("events")
        said = [row[1] for row in events.rows] if events is not None else []
        return next((text for text in said if text.startswith("poses are stamped")), "")

    def _outcome(self) -> tuple[int | None, str]:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.core.wait(60.0)
        with contextlib.suppress(BadInput):
            return outcome(self.folder)
        return None, "the core did not end"


def who(reason: str, flown: bool) -> str:
    """Who brought it down."""
    if not flown:
        return "never left the ground"
    if "motion-capture pose" in reason:
        return "guard"
    if "did not ask for" in reason:
        return "vehicle"
    return "the landing under way" if "abort" in reason or "stop" in reason else "station"


def whole(world: World, root: Path, latency_s: float) -> dict[str, Any]:
    """A flight by the command line with its own plan, to the report."""
    station = station_file(root, world, latency_s)
    command = [
        sys.executable,
        "-P",
        "-m",
        "groundstation.cli",
        "fly",
        "--link",
        world.link,
        "--vehicle",
        "x500",
        "--json",
    ]
    command += ["--yes-simulated", "--set-parameters", "--station", str(station), "--logs", str(root / "flights")]
    end = time.monotonic() + READY_S
    while True:
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode != 3 or time.monotonic() > end:
            break
    newest = max((root / "flights").glob("*/flight.mcap"), key=lambda path: path.stat().st_mtime)
    said = [row[1] for row in read_recording(newest).texts["events"].rows]
    found = newest.with_name("identification.json")
    result: dict[str, Any] = {
        "status": ended.returncode, "latency_declared_s": latency_s,
        "latency": next((t for t in said if t.startswith("poses are stamped")), ""),
        "fusion": next((t for t in said[::-1] if t.startswith("fusion ")), ""),
        "frames": next((t for t in said[::-1] if t.startswith("frames ")), ""),
        "reason": "" if ended.returncode == 0 else (ended.stderr or ended.stdout)[-300:],
    }  # fmt: skip
    if ended.returncode == 0 and found.is_file():
        true = true_vehicle(world.vehicle, world.scenario).parameters()
        document = json.loads(found.read_text())
        estimates = document["methods"][document["best"]]["parameters"]
        for name in (n for n in ("mass_kg", *SHARES) if n in estimates):  # what the flight shows
            off = estimates[name]["value"] / true[name] - 1.0
            result[name] = {"off": round(off, 4), "in_stds": round(off * true[name] / estimates[name]["std"], 2)}
    return result


def table(results: dict[str, Any]) -> str:
    """The flights with cameras that went dark, as a table."""
    lines = [
        "| vehicle | cameras dark while | noticed after | by | on the ground after | drifted at most | exit status |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for vehicle, kept in results.items():
        for phase in PHASES:
            r = kept.get(phase)
            if r is None:
                continue
            if "failed" in r:
                lines.append(f"| {vehicle} | {phase} | not flown: {r['failed']} | | | | |")
                continue
            cells = [
                r["by"],
                *(_figure(r[k], unit) for k, unit in (("ground_s", "s"), ("drift_m", "m"))),
            ]
            noticed = _figure(r["noticed_s"], "s")
            lines.append(f"| {vehicle} | {phase} | {noticed} | {' | '.join(cells)} | {r['status']} |")
    return "\n".join(lines)


def _figure(value: float | None, unit: str) -> str:
    return "—" if value is None else f"{value:.2f} {unit}"


def measured_s(sentence: str) -> float | None:
    """The latency a flight found."""
    match = re.match(r"poses are stamped (-?[0-9.]+) ms", sentence)
    return None if match is None else max(0.0, round(float(match[1]) * 1e-3, 3))


def main() -> None:
    """Fly, and keep what was seen after each flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--px4", type=Path, help="binary of the firmware; without it the emulated one is flown")
    parser.add_argument("--arducopter", type=Path)
    parser.add_argument("--only", choices=("px4", "arducopter"))
    parser.add_argument("--cut", nargs="*", default=[*WHOLE, *PHASES], choices=(*WHOLE, *PHASES))
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--table", action="store_true", help="print what was kept, and fly nothing")
    options = parser.parse_args()
    results: dict[str, Any] = json.loads(options.out.read_text()) if options.out.is_file() else {}
    if options.table:
        print(table(results))
        return
    for autopilot in (options.only,) if options.only else ("px4", "arducopter"):
        binary = {"px4": options.px4, "arducopter": options.arducopter}[autopilot]
        kept = results.setdefault(f"{autopilot} {'firmware' if binary else 'emulator'}", {})
        for phase in options.cut:
            for _ in range(TRIES):
                kept[phase] = flown(autopilot, binary, phase, kept)
                if "failed" not in kept[phase]:
                    break
            options.out.parent.mkdir(parents=True, exist_ok=True)
            options.out.write_text(json.dumps(results, indent=1) + "\n")
            print(autopilot, phase, json.dumps(kept[phase]), flush=True)


def flown(autopilot: str, binary: Path | None, phase: str, kept: dict[str, Any]) -> dict[str, Any]:
    """One flight in a fresh world; ``declared`` is a whole one with the latency that the first measured."""
    root = Path(tempfile.mkdtemp(prefix="indoors-"))
    world = World(autopilot, binary, root)
    try:
        found = measured_s(kept.get("whole", {}).get("latency", "")) or 0.0
        if phase in WHOLE:
            return whole(world, root, found if phase == "declared" else 0.0)
        return Cut(world, phase, root, found).fly()
    finally:
        world.close()
        shutil.rmtree(root, ignore_errors=True)


if __name__ == "__main__":
    main()
