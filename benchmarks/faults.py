"""Every fault of line, processes and senders, in flight, by real processes: noticed, mode, ground, disarmed, by whom,
status.

make faults    (or: python -m benchmarks.faults [FAULT ...] [--profile px4] [--px4 BINARY] [--arducopter BINARY])

What the vehicle does is told by the relay between it and the station (benchmarks/relay.py), which knows MAVLink by
itself. Twice as many faults on virtual time: python -m benchmarks.faults_virtual. Results: docs/results/faults.json; of
real firmware, whose binaries are given: docs/results/faults_firmware.json.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.rig import Flight

OUT, OUT_FIRMWARE = Path("docs/results/faults.json"), Path("docs/results/faults_firmware.json")
LIMIT_S = 40.0
Break = Callable[[Flight], None]


def process(who: tuple[str, ...], number: signal.Signals) -> Break:
    """A signal to processes of the station."""

    def apply(flight: Flight) -> None:
        pids = flight.pids()
        for name in who:
            os.kill(pids[name], number)

    return apply


def relay(**order: Any) -> Break:
    """An order to the relay."""
    return lambda flight: flight.order(**order)


def folder_removed(flight: Flight) -> None:
    """Somebody tidies up."""
    shutil.rmtree(flight.folder)


FAULTS: dict[str, Break] = {
    "line cut 6.5 s": relay(cut=6.5, way="both"),
    "line cut for ever": relay(cut=1e9, way="both"),
    "way to the vehicle cut for ever": relay(cut=1e9, way="up"),
    "5 % lost, doubled, damaged, delayed": relay(loss=0.05),
    "link killed": process(("link",), signal.SIGKILL),
    "link stopped (hangs)": process(("link",), signal.SIGSTOP),
    "core killed": process(("core",), signal.SIGKILL),
    "core and link killed": process(("core", "link"), signal.SIGKILL),
    "operator's abort (SIGTERM)": process(("core",), signal.SIGTERM),
    "flight's folder removed": folder_removed,
    "one ATTITUDE with infinite roll": relay(frames="infinite_attitude", per_s=1000, count=1),
    "impossible frames as the autopilot, 500/s": relay(frames="impossible", per_s=500, seconds=5.0),
    "component 197 claims 3 m away, 50/s": relay(frames="component", per_s=50, seconds=5.0),
    "60 x 60 kB of garbage from a stranger": relay(stranger="garbage", per_s=60, count=60),
    "stranger floods, 1000/s": relay(stranger="noise", per_s=1000, seconds=5.0),
}
TRIES = 3
HARMLESS_S = 7.0
"""A fault that brings nobody down within this is flown through; the flight is then ended by an abort."""


def measure(profile: str, name: str, binary: Path | None) -> dict[str, Any]:
    """One flight with one fault."""
    flight = Flight(profile, binary)
    try:
        if not flight.excite():
            return {"fault": name, "autopilot": profile, "failed": flight.ended(1.0)[1]}
        before = flight.seen[-1]
        begun = time.monotonic()
        FAULTS[name](flight)
        down = flight.until_down(HARMLESS_S)
        changed = [s for s in flight.seen if s["at_s"] > begun and s["mode"] != before["mode"]]
        through = down is None and not changed
        if through:
            os.kill(flight.core.pid, signal.SIGTERM)
        down = down or flight.until_down(LIMIT_S)
        status, reason = flight.ended()
        seen = [s for s in flight.seen if s["at_s"] > begun]
        ordered = next((s["at_s"] for s in seen if s["mode_orders"] > before["mode_orders"]), None)
        mode = next((s["at_s"] for s in seen if s["mode"] != before["mode"]), None)
        ground = next((s["at_s"] for s in seen if s["landed"] == 1), None)
        landing = next(
            (e["monotonic_s"] for e in flight.journal() if e["monotonic_s"] > begun and e["kind"] == "phase"), None
        )
        noticed = min((t for t in (ordered, landing) if t is not None), default=None)
        passed = next((s["at_s"] for s in seen if s["mode_orders_passed"] > before["mode_orders_passed"]), None)
        by_station = mode is not None and passed is not None and passed <= mode + 0.15
        new = "another link" in reason
        by = "flown through; ended by the operator" if through else (
            ("a new link" if new else "the station") if by_station else "the vehicle's failsafe"
        )  # fmt: skip
        setpoints = seen[-1]["setpoints"] - before["setpoints"] if through else None

        def after(t: float | None) -> float | None:
            return None if t is None or through else round(t - begun, 2)

        return {
            "fault": name,
            "autopilot": profile,
            "noticed_s": after(noticed),
            "mode_s": after(mode),
            "ground_s": after(ground),
            "disarmed_s": after(down["at_s"] if down else None),
            "by": by,
            "status": status,
            "reason": reason,
            "setpoints_through": setpoints,
            "stranger_got": seen[-1]["stranger_got"],
        }
    finally:
        flight.close()


def table(results: list[dict[str, Any]]) -> str:
    """The results as a table."""
    lines = [
        "| fault | autopilot | noticed | mode changed | on the ground | disarmed | by | exit status |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in results:
        if "failed" in r:
            lines.append(f"| {r['fault']} | {r['autopilot']} | not flown: {r['failed']} | | | | | |")
            continue
        times = ["—" if r[k] is None else f"{r[k]:.2f} s" for k in ("noticed_s", "mode_s", "ground_s", "disarmed_s")]
        status = r["reason"] if r["status"] is None else str(r["status"])
        by = (
            r["by"]
            if r["setpoints_through"] is None
            else f"{r['by']} ({r['setpoints_through']} setpoints in {HARMLESS_S:.0f} s)"
        )
        lines.append(f"| {r['fault']} | {r['autopilot']} | {' | '.join(times)} | {by} | {status} |")
    return "\n".join(lines)


def main() -> None:
    """Fly, and keep what was seen after each flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("faults", nargs="*", help="names or beginnings of them; all by default")
    parser.add_argument("--profile", action="append", choices=("px4", "arducopter"))
    parser.add_argument("--px4", type=Path, help="binary of the firmware, flown instead of the emulated autopilot")
    parser.add_argument("--arducopter", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    firmware = {name: path for name in ("px4", "arducopter") if (path := getattr(options, name)) is not None}
    options.out = options.out or (OUT_FIRMWARE if firmware else OUT)
    profiles = options.profile or list(firmware) or ["px4", "arducopter"]
    wanted = [n for n in FAULTS if not options.faults or any(n.startswith(f) for f in options.faults)]
    keep = (options.faults or firmware) and options.out.is_file()
    kept = json.loads(options.out.read_text()) if keep else []
    results = {(r["fault"], r["autopilot"]): r for r in kept}
    for name in wanted:
        for profile in profiles:
            results[name, profile] = measured = flown(profile, name, firmware.get(profile))
            options.out.parent.mkdir(parents=True, exist_ok=True)
            order = sorted(results, key=lambda key: (list(FAULTS).index(key[0]), key[1] != "px4"))
            options.out.write_text(json.dumps([results[key] for key in order], indent=1) + "\n")
            print(table([measured]).splitlines()[-1], flush=True)


def flown(profile: str, name: str, binary: Path | None) -> dict[str, Any]:
    """A flight that reached its excitation; a busy machine may land one before, which says nothing of the fault."""
    result: dict[str, Any] = {}
    for _ in range(TRIES):
        result = measure(profile, name, binary)
        if "failed" not in result:
            break
    return result


if __name__ == "__main__":
    main()
