"""A station and its views in two network namespaces, with a line between them that delays, loses and is cut. As root on
Linux.

python -m benchmarks.shared_station [--out docs/results/shared_station.json]

Two simulated flights in real time (drone, core and gate as processes at the station). The first is armed and started
from the laptop; while it flies, the line gets worse step by step, and is cut for ever; the flight has to end as
planned, with nothing lost. The second is watched from the wall over a bad line and aborted from there.
Of each condition: how often the status arrives, the longest silence, and how long an order takes there and back.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks.packet_line import Condition, PacketLine, namespaces

STATION, LAPTOP = ("gs-station", "10.77.0.1"), ("gs-laptop", "10.77.0.2")
PORT = 7451
EACH_S = 5.5
CONDITIONS = {
    "a cable": Condition(),
    "20 ms": Condition(0.02, 0.005),
    "100 ms, 2 % lost": Condition(0.1, 0.03, 0.02),
    "150 ms, 10 % lost": Condition(0.15, 0.05, 0.1),
    "cut for 3 s": Condition(cut=True),
    "a cable again": Condition(),
    "cut for ever": Condition(cut=True),
}
CUT_S = 3.0
ABORT_OVER = "100 ms, 2 % lost"
PATIENCE_S = 300.0
ROOT = Path(__file__).resolve().parent.parent


def home(root: Path, who: str) -> None:
    """Keys and passes of one machine."""
    os.environ["XDG_CONFIG_HOME"] = str(root / who)


def be_station(root: Path, flight: str) -> None:
    """The station: its core, its gate; says how the flight ended."""
    from groundstation.flight.client.client import FlightOrder, outcome, start_core
    from groundstation.flight.client.rehearse import simulated_drone
    from groundstation.flight.share.sharing import share
    from groundstation.paths import find_config
    from groundstation.recording.load import read_recording

    home(root, "station")
    stop, folder = threading.Event(), root / "logs" / flight
    say = lambda text: print(json.dumps({"said": text}), flush=True)  # noqa: E731
    gate = threading.Thread(daemon=True, target=share, args=(root / "logs", f"tls/{STATION[1]}:{PORT}", (), stop, say))
    gate.start()
    vehicle, scenario = (
        find_config(kind, name).resolve() for kind, name in (("vehicles", "qball2"), ("scenarios", "seed"))
    )
    drone = simulated_drone(vehicle, scenario, 1, real_time=True)
    plan = find_config("plans", "qball2").resolve()
    core, _ = start_core(FlightOrder(folder, plan, vehicle, drone, analyse=False))
    core.wait(PATIENCE_S)
    status, reason = outcome(folder)
    if not (folder / "flight.mcap").is_file():
        raise SystemExit(f"{reason}: {(folder / 'core.log').read_text()[-2000:]}")
    recording = read_recording(folder / "flight.mcap")
    counted = json.loads(recording.metadata["streams"])
    entries = [json.loads(line) for line in (folder / "flight.log.jsonl").read_text().splitlines()]
    told = next((e["text"] for e in entries if e["kind"] == "recording"), "")
    phases = {e["text"].split(" -> ")[1]: e["monotonic_s"] for e in entries if e["kind"] == "phase"}
    print(
        json.dumps({"status": status, "reason": reason, "recording": told, "streams": counted, "phases": phases}),
        flush=True,
    )
    stop.set()
    gate.join()


def be_view(root: Path, name: str, abort_after_s: float) -> None:
    """A view with a pass: starts the flight if it may, says what it hears; lines on its input name the condition.
    Aborts, if it is to."""
    from groundstation.flight.share import passes, remote
    from groundstation.flight.share.messages import FileRequest

    home(root, "laptop")
    shown = passes.read_pass(root / f"{name}.pass")
    words: list[str] = []
    threading.Thread(target=lambda: [words.append(line.strip()) for line in sys.stdin], daemon=True).start()
    with remote.connect(f"{STATION[1]}:{PORT}", shown, timeout_s=30.0) as client:
        asked = leased = False
        heard, seen = [], ""
        order_s, flying_s = 0.0, 0.0
        while True:
            shared = client.shared(0.1)
            now_s = time.monotonic()
            status = remote.status_of(shared) if shared is not None else None
            if status is not None and shared is not None and shared.fresh:
                heard.append(now_s)
                print(
                    json.dumps({"heard": now_s, "phase": status.phase, "seen": words[-1] if words else ""}), flush=True
                )
                if client.operates and not leased:
                    leased = client.take_lease().ok
                if status.phase == "checked" and leased and not asked:
                    asked = client.command("start").ok
                if status.phase == "exciting" and seen != "exciting":
                    flying_s = now_s
                seen = status.phase
            if now_s - order_s > 0.5:
                order_s = now_s
                try:
                    client.file(FileRequest("none", "plan.toml"))
                    print(
                        json.dumps({"round_trip_s": time.monotonic() - now_s, "seen": words[-1] if words else ""}),
                        flush=True,
                    )
                except ConnectionError:
                    pass
            if flying_s and abort_after_s and now_s - flying_s > abort_after_s:
                before_s = time.monotonic()
                answer = client.command("abort", 10.0)
                print(json.dumps({"abort": answer.ok, "asked_s": before_s, "answered_s": time.monotonic()}), flush=True)
                return
            if "over" in words:
                return


class Process:
    """A program in a namespace; its lines of JSON are kept."""

    def __init__(self, place: tuple[str, str], *arguments: str):
        command = ["ip", "netns", "exec", place[0], sys.executable, "-P", "-m", "benchmarks.shared_station", *arguments]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, cwd=arguments[1]
        )
        self.lines: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        for line in self._process.stdout or ():
            self.lines.append(json.loads(line))

    def tell(self, word: str) -> None:
        """A line to it."""
        if self._process.stdin is not None and self._process.poll() is None:
            self._process.stdin.write(word + "\n")
            self._process.stdin.flush()

    def find(self, key: str) -> list[dict[str, Any]]:
        """Lines with a key."""
        return [line for line in list(self.lines) if key in line]

    @property
    def running(self) -> bool:
        """It has not ended."""
        return self._process.poll() is None

    def wait_for(self, key: str, value: str = "", beside: Process | None = None) -> dict[str, Any]:
        """The first line with a key, and a value, while this one runs and the one ``beside`` it."""
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            for line in self.find(key):
                if not value or line[key] == value:
                    return line
            if not self.running or (beside is not None and not beside.running):
                break
            time.sleep(0.05)
        raise SystemExit(f"waited in vain for {key} {value}: {self.lines[-3:]}")

    def end(self) -> None:
        """It ends by itself; else it is ended."""
        try:
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            self._process.terminate()


@contextmanager
def network() -> Iterator[PacketLine]:
    """Both namespaces and the line."""
    with namespaces(STATION[0], LAPTOP[0]):
        line = PacketLine(((STATION[0], f"{STATION[1]}/24"), (LAPTOP[0], f"{LAPTOP[1]}/24")), seed=7)
        try:
            yield line
        finally:
            line.close()


def invite(root: Path) -> None:
    """Passes for laptop and wall."""
    from groundstation.flight.share import passes

    home(root, "station")
    for name, role in (("laptop", "operate"), ("wall", "watch")):
        made = passes.invite(name, role, [STATION[1]], datetime.datetime.now(datetime.UTC))  # type: ignore[arg-type]
        passes.write_pass(root / f"{name}.pass", made)


def summary(view: Process, name: str) -> dict[str, Any]:
    """What a view heard under one condition."""
    heard = [line["heard"] for line in view.find("heard") if line["seen"] == name]
    trips = sorted(line["round_trip_s"] for line in view.find("round_trip_s") if line["seen"] == name)
    gaps = [b - a for a, b in pairwise(heard)]
    span = heard[-1] - heard[0] if len(heard) > 1 else 0.0
    return {
        "condition": name, "statuses": len(heard), "per_s": round(len(gaps) / span, 1) if span else 0.0,
        "longest_silence_s": round(max(gaps), 2) if gaps else None,
        "order_p50_ms": round(1e3 * statistics.median(trips), 1) if trips else None,
        "order_max_ms": round(1e3 * trips[-1], 1) if trips else None,
    }  # fmt: skip


def cut_flight(root: Path, line: PacketLine) -> dict[str, Any]:
    """Armed from the laptop, flown to its end while the line gets worse and is cut."""
    line.condition = Condition()
    station = Process(STATION, "--station", str(root), "--flight", "cut")
    station.wait_for("said")
    laptop = Process(LAPTOP, "--view", str(root), "--name", "laptop")
    laptop.wait_for("phase", "exciting", station)
    cut_s = 0.0
    for name, condition in CONDITIONS.items():
        line.condition = condition
        laptop.tell(name)
        if name == "cut for ever":
            cut_s = time.monotonic()
            break
        time.sleep(CUT_S if condition.cut else EACH_S)
    ended = station.wait_for("status")
    rows = [summary(laptop, name) for name in CONDITIONS]
    laptop.tell("over")
    for each in (laptop, station):
        each.end()
    ended["cut_s_before_landing"] = round(ended["phases"].get("landing", 0.0) - cut_s, 1)
    return {"conditions": rows, "flight": ended, "packets": {"carried": line.carried, "dropped": line.dropped}}


def abort_flight(root: Path, line: PacketLine) -> dict[str, Any]:
    """Watched and aborted from the wall; the operator's laptop is there too."""
    line.condition = Condition()
    station = Process(STATION, "--station", str(root), "--flight", "abort")
    station.wait_for("said")
    laptop = Process(LAPTOP, "--view", str(root), "--name", "laptop")
    laptop.wait_for("phase", "checked", station)
    wall = Process(LAPTOP, "--view", str(root), "--name", "wall", "--abort-after-s", "5")
    line.condition = CONDITIONS[ABORT_OVER]
    word, ended = wall.wait_for("abort", beside=station), station.wait_for("status")
    laptop.tell("over")
    for each in (wall, laptop, station):
        each.end()
    took_s = {
        name: round(ended["phases"][name] - word["asked_s"], 2) for name in ("landing",) if name in ended["phases"]
    }
    return {
        "condition": ABORT_OVER, "landing_s": took_s.get("landing"),
        "answered_s": round(word["answered_s"] - word["asked_s"], 2),
        "flight": ended,
    }  # fmt: skip


def table(document: dict[str, Any]) -> str:
    """The results for docs/machines.md."""
    lines = [
        "| line, each way | status, a second | longest silence | order there and back, median | most |",
        "| --- | --- | --- | --- | --- |",
    ]
    dash = "—"
    for row in document["cut"]["conditions"]:
        silence = dash if row["longest_silence_s"] is None else f"{row['longest_silence_s']:.2f} s"
        trip = [dash if row[k] is None else f"{row[k]:.0f} ms" for k in ("order_p50_ms", "order_max_ms")]
        lines.append(f"| {row['condition']} | {row['per_s'] or dash} | {silence} | {trip[0]} | {trip[1]} |")
    flight, abort = document["cut"]["flight"], document["abort"]
    lines += [
        "",
        f"The line was cut for ever {flight['cut_s_before_landing']:.0f} s before the planned landing: "
        f"exit status {flight['status']}, {flight['recording']}.",
        f"An abort from the wall over {abort['condition']}: answered after {abort['answered_s']:.2f} s, "
        f"landing after {abort['landing_s']:.2f} s, exit status {abort['flight']['status']} "
        f"({abort['flight']['reason']}).",
    ]
    return "\n".join(lines)


def main() -> int:
    """Fly both; JSON and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/results/shared_station.json"))
    for name in ("--station", "--view"):
        parser.add_argument(name, type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--flight", default="flight", help=argparse.SUPPRESS)
    parser.add_argument("--name", default="laptop", help=argparse.SUPPRESS)
    parser.add_argument("--abort-after-s", type=float, default=0.0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.station:
        be_station(options.station, options.flight)
        return 0
    if options.view:
        be_view(options.view, options.name, options.abort_after_s)
        return 0
    with tempfile.TemporaryDirectory(prefix="shared-station-") as folder, network() as line:
        root = Path(folder)
        invite(root)
        document = {"seed": 7, "cut": cut_flight(root, line), "abort": abort_flight(root, line)}
    options.out.write_text(json.dumps(document, indent=1) + "\n")
    print(table(document))
    wrong = document["cut"]["flight"]["status"] != 0 or document["abort"]["flight"]["status"] != 4
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
