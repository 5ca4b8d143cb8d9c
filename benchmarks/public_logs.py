"""Every log in a folder, as people bring them: what it is, what came of it, how long it took and how much memory.

``python -m benchmarks.public_logs DIR [--out FILE.json]`` prints a table; docs/logs.md keeps what was tried. The file
keeps the rows of other logs that it had. The
vehicles of public logs are not known: those that ship stand in (rotor speeds by command), so that the verdict says what
was read, or why nothing was, and not what the vehicle weighs. Each log is read in a process of its own, for its memory
and its end alone.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from groundstation.writing import write_whole

LIMIT_S = 300.0
_TOLD = ("left out", "skipped", "too slow", "cut off", "not ended", "primary core")
"""Words of the notes that stand in the table."""
VEHICLES = ("x500", "crazyflie21", "hexa", "qball2")


def read(path: Path) -> dict[str, object]:
    """One log in this process: verdict, seconds, peak memory."""
    import resource
    import time

    from groundstation.errors import GroundStationError
    from groundstation.paths import find_config
    from groundstation.recording import load_flight
    from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict

    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun, said = time.monotonic(), []
    streams: dict[str, object] = {}
    for name in VEHICLES:
        document = vehicle_to_dict(load_vehicle(find_config("vehicles", name)))
        rotors = document["rotors"]
        if rotors["input"] == "rotor_speed":
            rotors |= {
                "input": "command",
                "speed_source": "command",
                "speed_max_rad_s": rotors.get("speed_max_rad_s", 1000.0),
            }
        try:
            flight = load_flight(path, vehicle=vehicle_from_dict(document))
        except GroundStationError as error:
            said.append(str(error).removeprefix(f"{path}: "))
            continue
        streams = {key: f"{len(s)} at {s.rate_hz():.0f} Hz" for key, s in flight.streams().items()}
        said = list(flight.notes)
        break
    return {
        "log": path.name,
        "read": bool(streams),
        "streams": streams,
        "said": said[:12] if streams else said[:1],
        "seconds": round(time.monotonic() - begun, 2),
        "peak_mb": round((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) / 1024.0),
        "size_mb": round(sum(f.stat().st_size for f in ([path] if path.is_file() else path.iterdir())) / 1e6, 2),
    }


def tried(path: Path) -> dict[str, object]:
    """One log in a process of its own; a crash or a hang is a verdict."""
    command = [sys.executable, "-m", "benchmarks.public_logs", "--one", str(path)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return {"log": path.name, "read": False, "said": [f"HANGS for more than {LIMIT_S:.0f} s"], "seconds": LIMIT_S}
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no word"])[-1]
        return {"log": path.name, "read": False, "said": [f"CRASHES: {last}"], "seconds": 0.0}
    return json.loads(done.stdout.splitlines()[-1])


def logs_in(folder: Path) -> list[Path]:
    """The logs below a folder: files, and the folders of ROS 2 bags. A folder in it names where its logs are from."""
    bags = {path.parent for path in folder.rglob("metadata.yaml")}
    files = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    return sorted([*bags, *(path for path in files if not bags & set(path.parents))])


def line(row: dict[str, object]) -> str:
    """A row of the table in docs/logs.md."""
    streams = row.get("streams") or {}
    assert isinstance(streams, dict)
    said = row["said"]
    assert isinstance(said, list)
    verdict = ", ".join(f"{k} {v}" for k, v in streams.items()) if streams else f"refused: {said[0] if said else ''}"
    told = [text for text in map(str, said) if streams and any(word in text for word in _TOLD)]
    verdict += "".join(f" ({text})" for text in told)
    cells = (row["source"], row["log"], row.get("size_mb", ""), verdict, row["seconds"], row.get("peak_mb", ""))
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--one", action="store_true", help="read this one log in this process")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(read(options.folder)))
        return
    rows = []
    print("| source | log | MB | verdict | s | MB of memory |\n| --- | --- | --- | --- | --- | --- |")
    for path in logs_in(options.folder):
        inside = path.relative_to(options.folder).parent.parts
        rows.append({"source": inside[0].replace("+", "/") if inside else "", **tried(path)})
        print(line(rows[-1]), flush=True)
    if options.out is not None:
        before = json.loads(options.out.read_text(encoding="utf-8")) if options.out.is_file() else []
        anew = {(row["source"], row["log"]) for row in rows}
        kept = [row for row in before if (row["source"], row["log"]) not in anew] + rows
        kept.sort(key=lambda row: (row["source"], row["log"]))
        write_whole(options.out, json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
