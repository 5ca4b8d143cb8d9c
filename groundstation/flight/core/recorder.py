"""The recorder: a thread with a queue of its own, so that a slow disk delays nobody and no sample is dropped.

It also keeps what the status shows about each stream. A failing disk is reported once, through ``on_failure``, and ends
the flight; what was written before stays readable (small chunks).
"""

from __future__ import annotations

import json
import platform
import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from drivers.bus import Description, DroneStatus
from drivers.samples import Batch, Event, Motors, Raw, Sample
from groundstation.flight import timeouts
from groundstation.flight.core.meters import StreamMeter
from groundstation.flight.messages import StreamStatus
from groundstation.paths import commit
from groundstation.recording.computed_speeds import COMMANDS

if TYPE_CHECKING:
    from groundstation.recording.recorder import McapRecorder


class Sink(Protocol):
    """Where samples end up: ``groundstation.recording.McapRecorder``."""

    failure: str | None

    def add(self, sample: Sample, host_s: float, topic: str | None = None) -> None:
        """Write one sample, to its kind's own topic or another."""
        ...

    def add_status(self, device_s: float, host_s: float, phase: str, armed: bool, text: str = "") -> None:
        """Write the vehicle's status."""
        ...

    def set_metadata(self, values: Mapping[str, str]) -> None:
        """Add metadata that is known only now."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...


LATEST_S = 1e11
"""No clock of a device or a host, not even one that counts from 1970 in microseconds taken for seconds, is beyond it.
"""


def sound(batch: Batch, rotors: int) -> bool:
    """Whether a batch can be recorded and read again: its times are times, its motors those of the vehicle."""
    if len(batch.samples) != len(batch.host_s) or not all(abs(host_s) < LATEST_S for host_s in batch.host_s):
        return False
    return all(
        abs(sample.device_s) < LATEST_S
        and (not isinstance(sample, Motors) or len(sample.values) == (4 if sample.kind == "wrench" else rotors))
        for sample in batch.samples
    )


class Recorder:
    """Writes batches in the order in which they come.

    Args:
        sink: the open file.
        on_digested: called on the recorder's thread with the host time up to which everything is written.
        on_failure: called once with the sentence that says why writing failed.
        motor_kind: what the motors stream holds; commands that come beside speeds are recorded beside them.
    """

    def __init__(
        self,
        sink: Sink,
        on_digested: Callable[[float], None],
        on_failure: Callable[[str], None],
        motor_kind: str = "rotor_speed",
    ):
        self._sink, self._motor_kind = sink, motor_kind
        self._on_digested = on_digested
        self._on_failure = on_failure
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._failed = False
        self._window_end_s: float | None = None
        self._expected: int | None = None
        self._lock = threading.Lock()
        self._meters: dict[str, StreamMeter] = {}
        self.recorded = 0
        self.lost_batches = 0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def put(self, batch: Batch) -> None:
        """Hand over a batch; returns at once."""
        self._queue.put(lambda: self._write(batch))

    def note(self, host_s: float, kind: str, text: str) -> None:
        """Record an event of the station itself. Its stamp is the host's."""
        self._queue.put(lambda: self._sink.add(Event(host_s, kind, text), host_s))

    def status(self, status: DroneStatus) -> None:
        """Record what the vehicle says it is doing."""
        told = (status.device_s, status.host_s, status.phase, status.armed, status.text)
        self._queue.put(lambda: self._sink.add_status(*told))

    def metadata(self, values: Mapping[str, str]) -> None:
        """Record metadata that is known only now."""
        self._queue.put(lambda: self._sink.set_metadata(values))

    def window(self, window_s: tuple[float, float]) -> None:
        """Record the excitation's window at its start, and where it ends elsewhere than it was to."""
        start, end = window_s
        if self._window_end_s is None or abs(end - self._window_end_s) > timeouts.WINDOW_MOVED_S:
            self._window_end_s = end
            self.metadata({"window_start_s": repr(start), "window_end_s": repr(end)})

    def close(self) -> None:
        """Write what is queued and finish the file. Idempotent."""
        if self._thread.is_alive():
            self._queue.put(lambda: self._sink.set_metadata({"streams": json.dumps(self.counts())}))
            self._queue.put(None)
            self._thread.join()

    def streams(self, host_s: float) -> dict[str, StreamStatus]:
        """How each stream does."""
        with self._lock:
            return {name: meter.status(host_s) for name, meter in self._meters.items()}

    def counts(self) -> dict[str, dict[str, float]]:
        """What was counted of each stream: samples, gaps, duplicates, reordered ones, clock jumps."""
        with self._lock:
            return {name: meter.counts.document() for name, meter in self._meters.items()}

    def _run(self) -> None:
        while (job := self._queue.get()) is not None:
            job()
            self._watch()
        self._sink.close()
        self._watch()

    def _watch(self) -> None:
        if self._sink.failure and not self._failed:
            self._failed = True
            self._on_failure(f"the recording cannot be written: {self._sink.failure}")

    def _write(self, batch: Batch) -> None:
        if self._expected is not None and batch.sequence > self._expected:
            self.lost_batches += batch.sequence - self._expected
        self._expected = max(self._expected or 0, batch.sequence + 1)
        for sample, host_s in zip(batch.samples, batch.host_s, strict=True):
            self._sink.add(sample, host_s, f"/{COMMANDS}" if self._beside(sample) else None)
        self.recorded += len(batch.samples)
        with self._lock:
            for sample, host_s in zip(batch.samples, batch.host_s, strict=True):
                if not isinstance(sample, Event | Raw) and not self._beside(sample):
                    name = type(sample).__name__.lower()
                    self._meters.setdefault(name, StreamMeter()).add(sample.device_s, host_s)
        if batch.until_s or batch.host_s:
            self._on_digested(batch.until_s or batch.host_s[-1])

    def _beside(self, sample: Sample) -> bool:
        """A command beside the motors stream's measured speeds."""
        return isinstance(sample, Motors) and sample.kind == "command" != self._motor_kind


def open_recording(
    folder: Path, plan: Path, vehicle: Path, description: Description, drone: Sequence[str] = ()
) -> McapRecorder:
    """``flight.mcap`` of a flight, with what has to be known to read it: vehicle, plan, truth if simulated, seed,
    versions.
    """
    from groundstation.recording.recorder import McapRecorder

    metadata = {
        "flight": folder.name,
        "vehicle": description.vehicle,
        "scenario": description.scenario,
        "motor_kind": description.motor_kind,
        "python": platform.python_version(),
        "notes": json.dumps(description.notes),
        **({"seed": drone[drone.index("--seed") + 1]} if "--seed" in drone[:-1] else {}),
        **({"commit": made_of} if (made_of := commit()) else {}),
        **{name: version(name) for name in ("groundstation", "numpy", "eclipse-zenoh", "mcap")},
    }
    attachments = {"plan.toml": plan.read_bytes(), "vehicle.toml": vehicle.read_bytes()}
    if description.truth_toml:
        attachments["truth.toml"] = description.truth_toml.encode()
    path, number = folder / "flight.mcap", 2
    while path.exists():  # an interrupted flight's folder is continued beside what was recorded
        path, number = folder / f"flight-{number}.mcap", number + 1
    return McapRecorder(path, metadata, attachments)
