"""The recorder at full load through a whole core, with the UI attached: what is lost, what it costs, what is counted,
what a kill costs.

python -m benchmarks.full_load [--minutes 10] [--out docs/results/full_load.json]

A vehicle's process of its own puts on the bus, in real time: IMU at 1 kHz, poses of three bodies at 360 Hz each, four
rotor speeds at 400 Hz, setpoints at 50 Hz, raw MAVLink frames at 400 Hz. The core records as in any flight, and the
terminal UI follows it. Faults are planted into the streams: single samples left out, doubled and swapped, and a device
clock that is set forward and back; the record has to count each. Then a second, shorter flight is killed (SIGKILL) in
the air. What was recorded is counted by the MCAP library's reader.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

RATES_HZ = {"imu": 1000, "pose": 3 * 360, "motors": 400, "setpoint": 50, "raw": 400}
STEP_S = 0.02
PLANTED_EVERY_S = 20.0
FAULTS = ("gaps", "duplicates", "reordered", "clock_jumps")
LEAST_SHARE = 0.5
KILL_AFTER_S = 15.0
PATIENCE_S = 120.0
"""For the core's first order: starts on a busy machine take long."""


class Load:
    """Samples of each stream as they are due, with faults planted into the IMU's in turn; keeps count of both."""

    def __init__(self, plants: bool):
        self.put, self.planted = dict.fromkeys(RATES_HZ, 0), dict.fromkeys(FAULTS, 0)
        self._plants, self._made, self._next_s, self._ahead_s = plants, dict.fromkeys(RATES_HZ, 0), PLANTED_EVERY_S, 0.0
        self._turn = 0

    def until(self, begun_s: float, now_s: float) -> list[tuple[Any, float]]:
        """What has become due, in order of time."""
        out = []
        for name, rate in RATES_HZ.items():
            due = int((now_s - begun_s) * rate)
            stamps = [begun_s + k / rate for k in range(self._made[name], due)]
            self._made[name] = due
            if name == "imu" and len(stamps) > 4:
                stamps = self._faulty(stamps, now_s - begun_s)
            self.put[name] += len(stamps)
            ahead_s = self._ahead_s if name == "imu" else 0.0
            arrivals = [min(t, now_s) for t in sorted(stamps)]  # a swapped pair arrives in the wrong order
            out += [(self._sample(name, t + ahead_s), at) for t, at in zip(stamps, arrivals, strict=True)]
        return sorted(out, key=lambda pair: pair[1])

    def _faulty(self, stamps: list[float], elapsed_s: float) -> list[float]:
        if not self._plants or elapsed_s < self._next_s:
            return stamps
        self._next_s += PLANTED_EVERY_S
        fault = FAULTS[self._turn % len(FAULTS)]
        self._turn += 1
        self.planted[fault] += 1
        if fault == "gaps":
            return [*stamps[:2], *stamps[3:]]
        if fault == "duplicates":
            return [*stamps[:2], stamps[1], *stamps[2:]]
        if fault == "reordered":
            return [stamps[0], stamps[2], stamps[1], *stamps[3:]]
        self._ahead_s = 0.0 if self._ahead_s else 3600.0
        return stamps

    @staticmethod
    def _sample(name: str, t: float) -> Any:
        from drivers.samples import Imu, Motors, Pose, Raw, Setpoint

        if name == "imu":
            return Imu(t, (0.001, 0.0, 0.0), (0.0, 0.0, 9.80665))
        if name == "pose":
            return Pose(t, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))
        if name == "motors":
            return Motors(t, (400.0, 401.0, 402.0, 403.0))
        return Setpoint(t, (0.0, 0.0, 1.0), 0.0) if name == "setpoint" else Raw(t, "in", bytes(60))


class Vehicle:
    """The vehicle's side of the bus, without physics: it flies as long as it is told to, and says what it has put."""

    def __init__(self, options: argparse.Namespace):
        from drivers import bus
        from drivers.access import own_login

        self.bus, self.options = bus, options
        self.session = bus.open_session(connect=[options.connect], login=own_login())
        self.keys = bus.DroneKeys(options.drone)
        self.phase, self.crc, self.start_s, self.told = "idle", None, 0.0, Path(options.told)
        self.samples = bus.Publisher(self.session, self.keys.samples)
        self.statuses = bus.Publisher(self.session, self.keys.status)
        described = bus.Description("full load", "full load", real_time=True)
        self.handles = [
            bus.subscribe(self.session, self.keys.credit, bus.decoder_of(bus.Credit), lambda _credit: None),
            bus.serve(self.session, self.keys.upload, bus.Upload, self.upload),
            bus.serve(self.session, self.keys.command, bus.Command, self.command),
            bus.serve(self.session, self.keys.describe, bus.Describe, lambda _ask: described),
            bus.watch_alive(self.session, bus.CORE_ALIVE, self.core_went),
        ]

    def core_went(self, _key: str, alive: bool) -> None:
        """Nobody is left to fly for."""
        if not alive:
            os._exit(0)

    def upload(self, request: Any) -> Any:
        """Take the plan."""
        self.phase, self.crc = "uploaded", request.crc32
        return self.bus.Answer(True)

    def command(self, request: Any) -> Any:
        """Take an order."""
        if request.name == "start":
            self.phase, self.start_s = "takeoff", time.monotonic()
        elif request.name in ("abort", "land") and self.phase in ("takeoff", "exciting"):
            self.phase = "landing"
        return self.bus.Answer(True)

    def run(self) -> None:
        """Put samples until the flight is over, and say what was put."""
        from drivers.samples import Batch, encode_batch

        sequence, load, over_s = 0, Load(self.options.plants), None
        with self.bus.alive(self.session, self.keys.alive):
            patient_s = time.monotonic() + PATIENCE_S
            while self.phase == "idle":  # what comes before the core asked what this is, belongs to no flight
                if time.monotonic() > patient_s:
                    raise SystemExit(f"the core has ordered nothing for {PATIENCE_S:.0f} s")
                time.sleep(STEP_S)
            begun_s = time.monotonic()
            patient_s = begun_s + PATIENCE_S
            while over_s is None or time.monotonic() < over_s + 1.0:
                now_s = time.monotonic()
                if not self.start_s and now_s > patient_s:
                    raise SystemExit(f"the core has started nothing for {PATIENCE_S:.0f} s")
                pairs = [] if self.down(now_s) else load.until(begun_s, now_s)
                if pairs:
                    samples, times = zip(*pairs, strict=True)
                    self.samples.put(encode_batch(Batch(sequence, times, samples, now_s)))
                    sequence += 1
                self.fly(now_s)
                if self.phase == "landed" and over_s is None:
                    over_s = now_s
                if over_s == now_s:
                    self.told.write_text(json.dumps({"put": load.put, "planted": load.planted, "batches": sequence}))
                time.sleep(max(0.0, begun_s + (int((now_s - begun_s) / STEP_S) + 1) * STEP_S - time.monotonic()))

    def down(self, now_s: float) -> bool:
        """On the ground: the last samples have a second and a half to arrive before the word that it has landed closes
        the recording."""
        return bool(self.start_s) and now_s - self.start_s > 2.5 + self.options.seconds

    def fly(self, now_s: float) -> None:
        """Phases by the clock."""
        flown = now_s - self.start_s if self.start_s else 0.0
        if self.phase == "takeoff" and flown > 2.0:
            self.phase = "exciting"
        elif self.phase == "exciting" and flown > 2.0 + self.options.seconds:
            self.phase = "landing"
            self.start_s = now_s - 2.0 - self.options.seconds
        elif self.phase == "landing" and flown > 4.0 + self.options.seconds:
            self.phase = "landed"
        window = (self.start_s + 2.0, self.start_s + 2.0 + self.options.seconds) if self.start_s else None
        armed = self.phase in ("takeoff", "exciting", "landing")
        status = self.bus.DroneStatus(
            self.phase, armed, now_s, now_s, "", flown, 4.0 + self.options.seconds, window, plan_crc32=self.crc
        )
        self.statuses.put(status)


def used_s(pid: int) -> float:
    """Processor time of a process so far, all threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    """Memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def plan_file(folder: Path, seconds: float) -> Path:
    """A hover whose flight is as long as the load lasts, as a plan."""
    import tomli_w

    from groundstation.trajectory import coefficients_from_arrays

    flat = [[0.0]] * 4
    coefficients = coefficients_from_arrays(flat, flat, [0.0, 0.0, 1.0, 0.0]).model_dump(mode="json")
    document = {
        "vehicle": "qball2",
        "base_frequency_rad_s": 2.0 * 3.141592653589793 / seconds,
        "coefficients": coefficients,
    }
    path = folder / "plan.toml"
    path.write_text(tomli_w.dumps(document))
    return path


class Flight:
    """One flight at full load: core, vehicle and UI; what they cost is taken while it flies."""

    def __init__(self, root: Path, seconds: float, *, kill_after_s: float | None):
        self.root, self.seconds, self.kill_after_s = root, seconds, kill_after_s
        self.folder, self.told = root / "logs" / "flight", root / "told.json"
        self.memory: list[float] = []
        self.newest: Any = None
        self.killed_s: float | None = None
        self.cpu = self.flown_s = 0.0

    async def fly(self) -> None:
        """From start to end, or until it is killed."""
        from groundstation.flight.client.client import FlightOrder, start_core
        from groundstation.paths import find_config
        from groundstation.tui.app import GroundStation
        from groundstation.tui.watch import CoreWatch

        drone = ("benchmarks.full_load", "--seconds", str(self.seconds), "--told", str(self.told))
        drone = (*drone, "--plants") if self.kill_after_s is None else drone
        plan, vehicle = plan_file(self.root, self.seconds), find_config("vehicles", "qball2").resolve()
        core, access = start_core(FlightOrder(self.folder, plan, vehicle, drone, analyse=False), start=True)
        app = GroundStation(self.root / "logs", analyse=False)
        async with app.run_test(size=(120, 40)) as pilot:
            app.follow(CoreWatch(access, self.folder), simulated=True)
            await self._watch(app, pilot, core)
        core.wait(60.0)

    async def _watch(self, app: Any, pilot: Any, core: Any) -> None:
        flying_s = cpu_s = 0.0
        while core.poll() is None:
            await pilot.pause(0.5)
            status = app.core.newest
            self.newest = status or self.newest
            if status is None or status.phase != "exciting" or core.poll() is not None:
                continue
            now_s, used = time.monotonic(), used_s(core.pid)
            if not flying_s:
                flying_s, cpu_s = now_s, used
            self.memory.append(resident_mb(core.pid))
            self.flown_s, self.cpu = now_s - flying_s, used - cpu_s
            if self.kill_after_s is not None and self.flown_s > self.kill_after_s:
                self.killed_s = time.monotonic()
                os.kill(core.pid, signal.SIGKILL)
                return


def recorded(path: Path) -> tuple[int, float, dict[str, Any]]:
    """By the MCAP library, as far as the file goes: messages (of one sample once), the newest time, the counts."""
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message, Metadata
    from mcap.stream_reader import StreamReader

    topics: dict[int, str] = {}
    count, newest_ns, counted = 0, 0, "{}"
    with path.open("rb") as file, contextlib.suppress(McapError, EOFError, OSError):
        for record in StreamReader(file, record_size_limit=None).records:
            if isinstance(record, Message):
                count += not topics[record.channel_id].endswith("/exact")
                newest_ns = max(newest_ns, record.log_time)
            elif isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Metadata):
                counted = record.metadata.get("streams", counted)
    return count, 1e-9 * newest_ns, json.loads(counted)


def whole(root: Path, seconds: float) -> dict[str, Any]:
    """The flight that is not killed."""
    flight = Flight(root, seconds, kill_after_s=None)
    asyncio.run(flight.fly())
    told = json.loads(flight.told.read_text())
    count, _, counted = recorded(flight.folder / "flight.mcap")
    imu = counted.get("imu", {})
    return {
        "seconds_in_the_air": round(flight.flown_s, 1), "put": told["put"], "batches": told["batches"],
        "batches_lost": flight.newest.lost, "recorded": flight.newest.recorded, "read_back": count,
        "core_share": round(flight.cpu / flight.flown_s, 3), "load_average": os.getloadavg()[1],
        "memory_mb": [round(flight.memory[len(flight.memory) // 10], 1), round(flight.memory[-1], 1)],
        "planted": told["planted"], "counted": {name: imu.get(name) for name in FAULTS}, "streams": counted,
    }  # fmt: skip


def killed(root: Path) -> dict[str, Any]:
    """The flight whose core is killed in the air: what had been put when, and what is in the file."""
    flight = Flight(root, KILL_AFTER_S + 30.0, kill_after_s=KILL_AFTER_S)
    asyncio.run(flight.fly())
    count, newest_s, _ = recorded(flight.folder / "flight.mcap")
    assert flight.killed_s is not None
    return {"read_back": count, "lost_s": round(flight.killed_s - newest_s, 3)}


def verdict(document: dict[str, Any]) -> list[str]:
    """What was wanted and is not so."""
    run, kill = document["whole"], document["killed"]
    wrong = []
    if run["batches_lost"] or run["recorded"] != sum(run["put"].values()):
        wrong.append(f"lost: {run['batches_lost']} batches, {sum(run['put'].values()) - run['recorded']} samples")
    if run["core_share"] > LEAST_SHARE:
        wrong.append(f"the core took {run['core_share']:.2f} of a core")
    if run["planted"] != run["counted"]:
        wrong.append(f"planted {run['planted']}, counted {run['counted']}")
    if kill["lost_s"] > 1.0:
        wrong.append(f"SIGKILL cost {kill['lost_s']:.2f} s")
    return wrong


def told_of(document: dict[str, Any]) -> str:
    """For people."""
    run, kill = document["whole"], document["killed"]
    put, (begin, end) = sum(run["put"].values()), run["memory_mb"]
    lines = [
        f"full load   {run['seconds_in_the_air']:.0f} s in the air, {put} samples put in {run['batches']} batches "
        f"(load average {run['load_average']:.1f})",
        f"lost        {run['batches_lost']} batches, {put - run['recorded']} samples; "
        f"{run['read_back']} messages read back",
        f"core        {run['core_share']:.2f} of a core (recorder, bus, sequence, live estimate; UI attached)",
        f"memory      {begin:.0f} MB after a tenth of the flight, {end:.0f} MB at its end",
        f"IMU faults  planted {run['planted']}",
        f"            counted {run['counted']}",
        *(f"{name:<11} {json.dumps(counts)}" for name, counts in run["streams"].items() if name != "imu"),
        f"SIGKILL     loses the last {kill['lost_s']:.2f} s",
    ]
    return "\n".join(lines)


def table(document: dict[str, Any]) -> str:
    """What it prints, for docs/safety.md."""
    return f"```\n{told_of(document)}\n```"


def main() -> int:
    """Fly, count, kill, count; JSON and a table. Status 1 where something is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--out", type=Path, help="keep the figures as JSON")
    for name in ("--drone", "--connect", "--told"):
        parser.add_argument(name, help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--plants", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.connect:
        Vehicle(options).run()
        return 0
    os.environ["PYTHONPATH"] = str(Path(__file__).resolve().parent.parent)
    document: dict[str, Any] = {"rates_hz": RATES_HZ}
    for name, run in (("whole", lambda root: whole(root, 60.0 * options.minutes)), ("killed", killed)):
        with tempfile.TemporaryDirectory(prefix="full-load-") as folder:
            document[name] = run(Path(folder))
    print(told_of(document))
    if options.out is not None:
        options.out.write_text(json.dumps(document, indent=1) + "\n")
    for fault in (wrong := verdict(document)):
        print(f"NOT AS IT SHOULD BE: {fault}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
