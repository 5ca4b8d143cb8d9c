"""How fast the recorder writes, and reads back: samples a second of a flight's usual mixture, to a real file.

Run with ``python -m benchmarks.recorder``.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

from drivers.samples import Battery, Imu, Motors, Pose, Sample
from groundstation.recording import McapRecorder, read_recording

RUNS = 5
SECONDS = 60
RATE_HZ = 500


def flight() -> list[tuple[Sample, float]]:
    """A minute at 500 Hz: IMU and rotor speeds, poses at 100 Hz, battery at 10 Hz."""
    samples: list[tuple[Sample, float]] = []
    for index in range(SECONDS * RATE_HZ):
        t = index / RATE_HZ
        samples.append((Imu(t, (0.1, 0.2, 0.3), (0.1, 0.2, 9.8)), t))
        samples.append((Motors(t, (600.0, 600.0, 600.0, 600.0)), t))
        if index % 5 == 0:
            samples.append((Pose(t, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0)), t))
        if index % 50 == 0:
            samples.append((Battery(t, 12.0, 10.0), t))
    return samples


def main() -> None:
    """Print medians."""
    samples = flight()
    written, read = [], []
    for _ in range(RUNS):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "flight.mcap"
            began = time.perf_counter()
            with McapRecorder(path) as recorder:
                for sample, host_s in samples:
                    recorder.add(sample, host_s)
            written.append(len(samples) / (time.perf_counter() - began))
            began = time.perf_counter()
            recording = read_recording(path)
            read.append(len(samples) / (time.perf_counter() - began))
            assert sum(len(stream) for stream in recording.streams.values()) == len(samples)
    needed = len(samples) / SECONDS
    print(
        f"recorder: {statistics.median(written):9.0f} samples/s written, {statistics.median(written) / needed:.0f} "
        "times"
    )
    print(f"          what {SECONDS} s at {RATE_HZ} Hz need; {statistics.median(read):.0f} samples/s read back")


if __name__ == "__main__":
    main()
