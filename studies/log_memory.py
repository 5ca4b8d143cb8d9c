"""What reading a log takes: seconds and memory of a process that does nothing else."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from groundstation.flightdata import Stream
from groundstation.vehicle import Vehicle
from studies.long_logs import map_of

FACTOR = 6.0
"""Most that the peak may be of the samples used, as doubles, beside what six seconds of the same format take."""


def measured(path: Path, everything: bool) -> dict[str, float]:
    """A log read in a process of its own: seconds, peak memory and the samples used, in MB."""
    call = (
        f"import json; from studies import log_memory; print(json.dumps(log_memory.read({str(path)!r}, {everything})))"
    )
    done = subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{path.name}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout)


def peak_mb() -> float:
    """The most memory that this process, or one that it waited for, has held so far.

    A child of a large process inherits that one's ``ru_maxrss``, so Linux's own count is taken of this process.
    """
    import resource

    per_mb = 2.0**20 if sys.platform == "darwin" else 1024.0
    own, children = (
        resource.getrusage(who).ru_maxrss / per_mb for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    status = Path("/proc/self/status")
    if status.exists():
        own = int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024.0
    return max(own, children)


def read(path: str, everything: bool) -> dict[str, float]:
    """In this process: seconds, peak memory and the samples used, in MB; a table with a map is converted."""
    from groundstation.paths import find_config
    from groundstation.recording import load_flight
    from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict

    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "x500")))
    document["rotors"]["input"] = "command"
    vehicle = vehicle_from_dict(document)
    begun = time.monotonic()
    if map_of(Path(path)).exists():
        streams = _converted(Path(path), vehicle)
    else:
        streams = load_flight(path, vehicle=vehicle, everything=everything).streams()
    used = sum(s.values.nbytes + s.t_s.nbytes for s in streams.values())
    return {"s": time.monotonic() - begun, "peak_mb": peak_mb(), "used_mb": used / 2.0**20}


def _converted(path: Path, vehicle: Vehicle) -> Mapping[str, Stream]:
    """What ``convert --map`` does."""
    from groundstation.recording.mapping import load_map, read_mapped
    from groundstation.recording.mcapfile import write_recording_as_mcap

    recording = read_mapped(path, load_map(map_of(path)), vehicle)
    write_recording_as_mcap(recording, path.with_suffix(".converted.mcap"))
    return recording.streams
