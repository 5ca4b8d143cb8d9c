"""A campaign over MAVLink on the emulated PX4 whose program is killed (SIGKILL) in the middle of its second flight, and
goes on: `python -m benchmarks.campaign_killed`

The vehicle flies on, since its core is a process of its own. The campaign that is resumed at once follows that flight
to its end, takes it in, and flies on until it ends. Real time: six to ten minutes. It fails where a flight was flown
twice or is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from benchmarks.rig import free_port
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal

UNTIL = "ixx,iyy,izz:5%,mass:1%"
PATIENCE_S = 900.0
CLI = (sys.executable, "-P", "-m", "groundstation.cli", "campaign", "--yes-simulated")


@contextmanager
def autopilot(vehicle: str, scenario: str, port: int) -> Iterator[None]:
    """The emulated PX4 in this scenario."""
    command = [sys.executable, "-P", "-m", "sim.mavlink", "--profile", "px4", "--vehicle", vehicle]
    command += ["--scenario", scenario, "--link", f"udpout://127.0.0.1:{port}"]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
    ) as process:
        try:
            first_served(process.pid)
            yield
        finally:
            process.kill()


def first_served(pid: int) -> None:
    """Give a process and its session precedence where that is allowed: a simulation behind real time is a vehicle
    astray.
    """
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, -10)
        Path(f"/proc/{pid}/autogroup").write_text("-10")


def stand(logs: Path) -> Mapping[str, Any]:
    """The campaign's document; empty before there is one."""
    found = next(logs.glob("campaign-*/campaign.json"), None)
    return json.loads(found.read_text()) if found is not None else {}


def excited(logs: Path) -> bool:
    """Whether the second flight is in its excitation."""
    now = stand(logs)
    log = Path(now.get("pending", {}).get("folder", "/nowhere")) / JOURNAL
    return (
        len(now.get("rounds", ())) == 1
        and log.is_file()
        and any(entry["text"].endswith("-> exciting") for entry in read_journal(log))
    )


def until(done: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    """Wait for it while the process runs."""
    end = time.monotonic() + PATIENCE_S
    while not done():
        if process.poll() is not None:
            raise SystemExit(f"the campaign ended before it could be killed (status {process.poll()})")
        if time.monotonic() > end:
            raise SystemExit(f"the campaign did not come to where it is killed within {PATIENCE_S:.0f} s")
        time.sleep(0.2)


def main() -> int:
    """Begin, kill, resume, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--vehicle", default="x500")
    parser.add_argument("--scenario", default="hall")
    parser.add_argument("--until", default=UNTIL)
    parser.add_argument("--logs", type=Path, default=None, help="folder for the flights (default: a temporary one)")
    options = parser.parse_args()
    logs = (options.logs or Path(tempfile.mkdtemp(prefix="campaign-killed-"))).resolve()
    link = ["--link", f"udpin://127.0.0.1:{(port := free_port())}", "--logs", str(logs)]
    with autopilot(options.vehicle, options.scenario, port):
        begun = subprocess.Popen([*CLI, "--vehicle", options.vehicle, "--until", options.until, *link])
        try:
            until(lambda: excited(logs), begun)
        finally:
            begun.kill()  # SIGKILL
            begun.wait()
        killed = stand(logs)["pending"]["folder"]
        print(f"\nkilled while {Path(killed).name} was flown; resuming", flush=True)
        folder = next(logs.glob("campaign-*"))
        status = subprocess.run(
            [*CLI, "--resume", str(folder), *link], check=False, timeout=2.0 * PATIENCE_S
        ).returncode
    return judged(logs, killed, status)


def judged(logs: Path, killed: str, status: int) -> int:
    """0 where the killed flight is the second round's, each flight was taken in once, and the campaign ended."""
    end = stand(logs)
    rounds = [r["folder"] for r in end["rounds"]]
    flown = sorted(str(each.parent) for each in logs.glob("*/flight.mcap"))
    right = rounds[1:2] == [killed] and sorted(rounds) == flown and bool(end["outcome"])
    print(f"rounds: {len(rounds)}, recordings: {len(flown)}, the killed flight is round 2: {rounds[1:2] == [killed]}")
    print(f"outcome: {end['outcome']} (exit status {status}): {end['sentence']}")
    return 0 if right else 1


if __name__ == "__main__":
    raise SystemExit(main())
