"""Hostile frames in flight, until so many were sent to a vehicle in the air: crashes, hangs, memory, and what became of
it.

python -m benchmarks.hostile [--frames 100000] [--profile px4] [--kind all]

Frames come from benchmarks/relay.py, which builds them with code of its own, in the autopilot's name and from its
address: any content of the messages a link uses, impossible numbers, other components, unknown ids, wrong checksums,
noise. Left out are the autopilot's heartbeat and its landed state: on an unsigned link they are the vehicle's own word,
and only signing tells them from a forger's. Flights follow one another until the count is reached. Results:
docs/results/hostile.json.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import time
from pathlib import Path
from typing import Any

from benchmarks.rig import Flight

OUT = Path("docs/results/hostile.json")
PER_S = 2000
FLIGHT_S = 25.0


def memory_mb(pid: int) -> float:
    """Most resident memory of a process so far; 0 for one that is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), 0.0)


def fly(profile: str, kind: str, left: int) -> dict[str, Any]:
    """One flight under fire until it is down, or its share is sent."""
    flight = Flight(profile)
    try:
        if not flight.excite():
            return {"failed": flight.ended(1.0)[1], "sent_in_air": 0}
        pids = flight.pids()
        flight.order(frames=kind, per_s=PER_S, count=left)
        end, most = time.monotonic() + FLIGHT_S, dict.fromkeys(pids, 0.0)
        link_ended = False
        while time.monotonic() < end:
            most = {name: max(most[name], memory_mb(pid)) for name, pid in pids.items()}
            link_ended |= not Path(f"/proc/{pids['link']}").exists() and flight.core.poll() is None
            if flight.seen[-1]["armed"] is False:
                break
            time.sleep(0.05)
        if flight.core.poll() is None:
            os.kill(flight.core.pid, signal.SIGTERM)
        down = flight.until_down(60.0)
        status, reason = flight.ended()
        last = flight.seen[-1]
        return {
            "sent_in_air": last["injected_in_air"],
            "sent": last["injected"],
            "link_crashed": link_ended,
            "status": status,
            "reason": reason,
            "down": down is not None,
            "longest_silence_s": last["longest_up_gap_s"],
            "memory_mb": {name: round(value, 1) for name, value in most.items()},
        }
    finally:
        flight.close()


def main() -> None:
    """Fly until enough was sent; JSON and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100_000, help="sent to a vehicle in the air, for each autopilot")
    parser.add_argument("--profile", action="append", choices=("px4", "arducopter"))
    parser.add_argument("--kind", action="append", help="kinds of benchmarks/relay.py, in turn; default mixed and all")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    kinds = options.kind or ["mixed", "all"]
    results: dict[str, list[dict[str, Any]]] = json.loads(options.out.read_text()) if options.out.exists() else {}
    for profile in options.profile or ["px4", "arducopter"]:
        flights = results[profile] = []
        while (left := options.frames - sum(f["sent_in_air"] for f in flights)) > 0 and len(flights) < 40:
            kind = kinds[len(flights) % len(kinds)]
            flights.append({"kind": kind, **fly(profile, kind, left)})
            options.out.parent.mkdir(parents=True, exist_ok=True)
            options.out.write_text(json.dumps(results, indent=1) + "\n")
    print(table(results))


def table(results: dict[str, list[dict[str, Any]]]) -> str:
    """The results as a table."""
    lines = [
        "| autopilot | flights | frames in the air | link crashes | all down | longest silence | link | core |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for profile, flights in results.items():
        flown = [f for f in flights if "failed" not in f]
        silence = max(f["longest_silence_s"] for f in flown)
        memory = [max(f["memory_mb"][name] for f in flown) for name in ("link", "core")]
        crashes, down = sum(f["link_crashed"] for f in flown), all(f["down"] for f in flown)
        lines.append(
            f"| {profile} | {len(flown)} | {sum(f['sent_in_air'] for f in flown)} | {crashes} | "
            f"{'yes' if down else 'no'} | {silence:.2f} s | {memory[0]:.0f} MB | {memory[1]:.0f} MB |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
