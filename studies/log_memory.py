"""What reading a log takes: seconds and memory of a process that does nothing else."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

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
    """In this process: seconds, peak memory and the samples used, in MB."""
    from groundstation.paths import find_config
    from groundstation.recording import load_flight
    from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict

    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "x500")))
    document["rotors"]["input"] = "command"
    vehicle = vehicle_from_dict(document)
    begun = time.monotonic()
    flight = load_flight(path, vehicle=vehicle, everything=everything)
    used = sum(s.values.nbytes + s.t_s.nbytes for s in flight.streams().values())
    return {"s": time.monotonic() - begun, "peak_mb": peak_mb(), "used_mb": used / 2.0**20}
