"""The recorder: samples of a flight into one MCAP file that survives a crash."""

from __future__ import annotations

import json
import math
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import groundstation
from drivers.samples import Battery, Event, Imu, Motors, Pose, Raw, Sample, Setpoint, State
from groundstation.errors import BadInput
from groundstation.recording import cdr
from groundstation.recording.container import ContainerWriter
from groundstation.recording.recorded import MOTOR_KINDS
from groundstation.recording.schemas import EXACT, EXACT_TYPE, ROW, ROW_TYPE, TOPICS

METADATA = "groundstation"
"""Name of the metadata records; of several the last holds."""
SCHEMA = "groundstation.recording/1"
_FLUSH_S = 1.0


class McapRecorder:
    """Writes samples as they come. Safe to use from several threads.

    What was recorded more than a second of host time ago is on its way to the disk, whatever happens to the process;
    :mod:`~groundstation.recording.keeper` writes it through, so that it survives the machine's end, too. A
    full disk does not raise: recording ends, ``failure`` says so, and ``lost`` counts the samples that are missing.

    Args:
        path: the file; it must not exist.
        metadata: scenario name, versions and the like.
        attachments: files by name, "vehicle.toml", "plan.toml" and "truth.toml" among them.

    Raises:
        BadInput: the file exists already or cannot be made.
    """

    def __init__(
        self,
        path: str | Path,
        metadata: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes | str] | None = None,
    ) -> None:
        self.path = Path(path)
        self.failure: str | None = None
        self.written = 0
        self.lost = 0
        self._lock = threading.Lock()
        self._channels: dict[str, int] = {}
        self._metadata = {"schema": SCHEMA, "groundstation": groundstation.__version__, **(metadata or {})}
        self._flushed_s = -math.inf
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("xb", buffering=0)
            self._writer = ContainerWriter(self._file, "ros2", f"groundstation {groundstation.__version__}")
        except FileExistsError:
            raise BadInput(f"{path}: exists already; a recording is never written over. Name another file.") from None
        except OSError as error:
            raise BadInput(f"{path}: cannot be written ({error.strerror}); name a file on a disk with room.") from None
        self._do(0, partial(self._writer.metadata, METADATA, self._metadata))
        for name, data in (attachments or {}).items():
            self.attach(name, data)

    def _do(self, samples: int, write: Callable[[], None]) -> None:
        """Write unless the disk has failed; count the samples that were taken and those that were not."""
        with self._lock:
            if self.failure is not None:
                self.lost += samples
                return
            try:
                write()
                self.written += samples
            except OSError as error:
                self.lost += samples
                self.failure = (
                    f"{self.path}: recording ended after {self.written} samples ({error.strerror}); "
                    "make room on the disk before the next flight."
                )

    def attach(self, name: str, data: bytes | str) -> None:
        """Add a file."""
        body = data.encode() if isinstance(data, str) else data
        media = "application/toml" if name.endswith(".toml") else "application/octet-stream"
        self._do(0, partial(self._writer.attachment, name, media, body))

    def set_metadata(self, values: Mapping[str, str]) -> None:
        """Add metadata that is known only now, such as ``window_start_s`` and ``window_end_s``."""

        def write() -> None:
            self._metadata |= values
            self._writer.metadata(METADATA, self._metadata)

        self._do(0, write)

    def add(self, sample: Sample, host_s: float, topic: str | None = None) -> None:
        """Record a sample.

        Args:
            sample: as a driver gave it.
            host_s: its arrival on the host's monotonic clock, seconds; NaN where it is not known.
            topic: where to put it instead of its kind's own topic, for a second device of a kind.
        """
        self._do(1, partial(self._add, sample, host_s, topic))

    def add_status(self, device_s: float, host_s: float, phase: str, armed: bool, text: str = "") -> None:
        """Record the vehicle's status."""
        message = cdr.Encoder(cdr.own_header(device_s, host_s)).text(phase).byte(armed).text(text).bytes()
        self._do(1, partial(self._own, "status", None, device_s, host_s, message))

    def row_channel(self, topic: str, numbers: Sequence[str], texts: Sequence[str]) -> int:
        """Register a channel of columns of any names; returns its id for :meth:`add_row`."""
        names = {"numbers": json.dumps(list(numbers)), "texts": json.dumps(list(texts))}
        with self._lock:
            return self._writer.channel(topic, ROW_TYPE, ROW, names)

    def add_row(
        self, channel: int, device_s: float, host_s: float, values: Sequence[float], texts: Sequence[str]
    ) -> None:
        """Record one row of such columns."""
        encoder = cdr.Encoder(cdr.own_header(device_s, host_s)).doubles(values).count(len(texts))
        for text in texts:
            encoder.text(text)
        self._do(1, partial(self._message, channel, device_s, host_s, encoder.bytes()))

    def sync(self) -> None:
        """Write what was flushed through to the disk. Waits for the disk, and holds up no :meth:`add`."""
        if not self._file.closed:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the index and close the file. Without it the file opens as well, only slower."""
        if not self._file.closed:
            self._do(0, self._writer.finish)
            self._do(0, self.sync)
            self._file.close()

    def __enter__(self) -> McapRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _channel(self, name: str, type_name: str, definition: str) -> int:
        if name not in self._channels:
            self._channels[name] = self._writer.channel(name, type_name, definition)
        return self._channels[name]

    def _message(self, channel: int, device_s: float, host_s: float, data: bytes, sequence: int | None = None) -> None:
        """Log time: arrival, or device time where that is not known. Publish time: device time."""
        log_s = host_s if math.isfinite(host_s) else device_s
        self._writer.message(channel, cdr.unsigned_ns(log_s), cdr.unsigned_ns(device_s), data, sequence)
        if not log_s - self._flushed_s < _FLUSH_S:
            self._flushed_s = log_s if math.isfinite(log_s) else self._flushed_s
            self._writer.flush()

    def _own(self, stream: str, topic: str | None, device_s: float, host_s: float, data: bytes) -> None:
        kind = TOPICS[stream]
        self._message(self._channel(topic or kind.name, kind.type, kind.definition), device_s, host_s, data)

    def _standard(
        self, stream: str, topic: str | None, device_s: float, host_s: float, data: bytes, values: Sequence[float] = ()
    ) -> None:
        """A standard message, after a companion with what it had to round."""
        kind = TOPICS[stream]
        name = topic or kind.name
        channel = self._channel(name, kind.type, kind.definition)
        if values or not (_survives(device_s) and _survives(host_s)):
            companion = self._channel(f"{name}/exact", EXACT_TYPE, EXACT)
            exact = cdr.exact(device_s, host_s, values)
            self._message(companion, device_s, host_s, exact, self._writer.count(channel))
        self._message(channel, device_s, host_s, data)

    def _add(self, sample: Sample, host_s: float, topic: str | None) -> None:
        device_s = sample.device_s
        if isinstance(sample, Imu):
            data = cdr.imu(device_s, sample.gyro_rad_s, sample.accel_m_s2)
            self._standard("imu", topic, device_s, host_s, data)
        elif isinstance(sample, Pose):
            self._standard("mocap", topic, device_s, host_s, cdr.pose(device_s, sample.position_m, sample.quaternion))
        elif isinstance(sample, Motors):
            data = cdr.motors(device_s, host_s, MOTOR_KINDS.index(sample.kind), sample.values)
            self._own("motors", topic, device_s, host_s, data)
        elif isinstance(sample, Battery):
            data = cdr.battery(device_s, sample.voltage_v, sample.current_a)
            self._standard("battery", topic, device_s, host_s, data, (sample.voltage_v, sample.current_a))
        elif isinstance(sample, Setpoint):
            data = cdr.setpoint(device_s, host_s, (*sample.position_m, sample.yaw_rad))
            self._own("setpoint", topic, device_s, host_s, data)
        elif isinstance(sample, State):
            values = (*sample.position_m, *sample.velocity_m_s, *sample.quaternion, *sample.rate_rad_s)
            self._own("state", topic, device_s, host_s, cdr.state(device_s, host_s, values))
        elif isinstance(sample, Event):
            encoder = cdr.Encoder(cdr.own_header(device_s, host_s)).text(sample.kind).text(sample.text)
            self._own("events", topic, device_s, host_s, encoder.bytes())
        elif isinstance(sample, Raw):
            encoder = cdr.Encoder(cdr.own_header(device_s, host_s)).byte(sample.direction == "out").blob(sample.data)
            self._own("raw", topic, device_s, host_s, encoder.bytes())


def _survives(seconds: float) -> bool:
    """Whether whole nanoseconds give this double back, from MCAP's unsigned fields and the message's stamp."""
    return 0.0 <= seconds < 2.0**31 and round(seconds * 1e9) / 1e9 == seconds and math.copysign(1.0, seconds) > 0.0
