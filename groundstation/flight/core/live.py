"""The estimates that views are shown during a flight. They fly nothing: they may be late or fail, and nothing waits for
them.

Samples go into a short queue that a thread of low importance empties; when it is full, samples are left out of this
estimate (never out of the recording), and the estimator takes the hole as a hole.
"""

from __future__ import annotations

import math
import queue
import threading
import traceback
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.samples import Battery, Imu, Motors, Pose, Sample
from groundstation.errors import Refused
from groundstation.flight.sequence import Phase
from groundstation.flightdata import Stream, motor_columns
from groundstation.vehicle import Vehicle

if TYPE_CHECKING:
    from groundstation.identification.recursive import RecursiveEstimate, RecursiveEstimator
    from groundstation.identification.results import Estimate

Table = dict[str, tuple[float, float, float, float]]
Array = NDArray[np.float64]
STRETCH_S = 4.0
BROKEN_S = 0.01
QUEUE = 40
"""Batches: two seconds of a flight at the wall clock's pace."""
JUDGED_AFTER_S = 2.0
"""Of excitation, until speeds that were computed from the commands are told from measured ones."""
_ON_GROUND = frozenset({Phase.PLANNED, Phase.UPLOADED, Phase.CHECKED})


class LiveClock:
    """Stamp of motion capture minus that of the IMU, from the rotation that both saw in stretches of four seconds.

    Each stretch gives an offset (:func:`groundstation.identification.clock.fine_offset`); their mean and Student's
    interval from their scatter are what is shown. A stretch without rotation tells nothing, and one far from the
    others' median had samples missing: both are left out.
    """

    def __init__(self) -> None:
        self._gyro: list[tuple[float, ...]] = []
        self._poses: list[tuple[float, ...]] = []
        self._found: list[float] = []

    def take(self, samples: Sequence[Sample]) -> tuple[float, float] | None:
        """Work samples in; (offset, half its 95 % interval) once three stretches have told."""
        for sample in samples:
            if isinstance(sample, Imu):
                self._gyro.append((sample.device_s, *sample.gyro_rad_s))
            elif isinstance(sample, Pose):
                self._poses.append((sample.device_s, *sample.quaternion))
        if self._gyro and self._gyro[-1][0] - self._gyro[0][0] > STRETCH_S:
            gyro, poses = np.array(self._gyro), np.array(self._poses)
            self._gyro, self._poses = [], []
            if len(poses) > STRETCH_S:
                self._align(gyro, poses)
        found = np.array(self._found)
        found = found[np.abs(found - np.median(found)) < BROKEN_S] if len(found) else found
        if len(found) < 3:
            return None
        from scipy.special import stdtrit

        spread = float(found.std(ddof=1)) / math.sqrt(len(found))
        return float(found.mean()), float(stdtrit(len(found) - 1, 0.975)) * spread

    def _align(self, gyro: Array, poses: Array) -> None:
        from groundstation.identification.clock import coarse_offset, fine_offset

        both = (gyro[:, 0], gyro[:, 1:], poses[:, 0], poses[:, 1:])
        try:
            self._found.append(fine_offset(*both, coarse_offset(*both)[0]))
        except Refused:
            return


class LiveEstimate:
    """Mass and diagonal tensor so far, and the clocks' offset.

    Args:
        vehicle: as declared.

    Attributes:
        inline: samples are worked in at once, on the thread that hands them over; for simulated time, which waits.
        estimates: the newest, by parameter.
        table: parameter -> (nominal, estimate, low, high), NaN where not told yet; empty before the first estimate.
        clock_s: see :class:`LiveClock`; None before it is known.
        trouble: why there will be no more; empty while all is well.
    """

    def __init__(self, vehicle: Vehicle):
        self.table: Table = {}
        self.estimates: Mapping[str, Estimate] = {}
        self.inline = False
        self.trouble = ""
        self.clock_s: tuple[float, float] | None = None
        self._clock = LiveClock()
        self._vehicle = vehicle
        self._estimator: RecursiveEstimator | None = None
        self._unjudged: list[Motors] | None = []
        self._queue: queue.Queue[tuple[Sequence[Sample], Phase]] = queue.Queue(QUEUE)
        threading.Thread(target=self._run, name="live-estimate", daemon=True).start()

    def see(self, samples: Sequence[Sample], phase: Phase) -> None:
        """Hand over samples; returns at once."""
        if self.inline and not self.trouble:
            if phase is Phase.EXCITING or phase in _ON_GROUND:
                self.take(samples, phase)
        elif (phase is Phase.EXCITING or phase in _ON_GROUND) and not self._queue.full():
            self._queue.put((samples, phase))

    def _run(self) -> None:
        while not self.trouble:
            self.take(*self._queue.get())

    def take(self, samples: Sequence[Sample], phase: Phase) -> None:
        """Work samples in, on the caller's thread; a fault ends the estimates and nothing else."""
        try:
            self._take(samples, phase)
        except Refused as error:
            self.trouble = str(error)
        except Exception as error:
            self.trouble = f"the live estimate ended ({type(error).__name__}: {error})"
            traceback.print_exc()

    def _take(self, samples: Sequence[Sample], phase: Phase) -> None:
        if self._estimator is None:
            from groundstation.identification.recursive import RecursiveEstimator

            self._estimator = RecursiveEstimator(self._vehicle)
        imu = np.array([(s.device_s, *s.gyro_rad_s, *s.accel_m_s2) for s in samples if isinstance(s, Imu)])
        if phase is not Phase.EXCITING:
            self._estimator.rest(imu.reshape(-1, 7))
            return
        self.clock_s = self._clock.take(samples) or self.clock_s
        for sample in samples:
            if isinstance(sample, Battery):
                self._estimator.battery(sample.voltage_v)
        rotors = self._vehicle.rotors
        spun = [
            s for s in samples if isinstance(s, Motors) and len(s.values) == (4 if s.kind == "wrench" else rotors.count)
        ]
        if self._unjudged is not None:
            self._judge(spun)
        motors = np.array([(s.device_s, *s.values) for s in spun if s.kind == rotors.input])
        if (newest := self._estimator.add(imu, motors)) is not None:
            self.table, self.estimates = self._rows(newest), newest.parameters

    def _judge(self, motors: Sequence[Motors]) -> None:
        """End the estimates, once, where the ESCs' speeds are the commands times a number: the flight goes by the
        commands.
        """
        from groundstation.recording.computed_speeds import commands_behind

        self._unjudged = seen = [*(self._unjudged or ()), *motors]
        if not seen or seen[-1].device_s - seen[0].device_s < JUDGED_AFTER_S:
            return
        self._unjudged = None
        speeds, commands = (_stream(seen, kind) for kind in ("rotor_speed", "command"))
        found = commands_behind(speeds, commands) if len(speeds) and len(commands) else None
        if found is not None:
            self.table, self.estimates = {}, {}
            raise Refused(f"no live estimate: {found[1]}")

    def _rows(self, newest: RecursiveEstimate) -> Table:
        from groundstation.identification.recursive import SHOWN

        unknown = (math.nan, math.nan, math.nan)
        known = {name: (e.value, *e.ci95) for name, e in newest.parameters.items()}
        declared = self._vehicle.parameters()
        return {name: (declared[name], *known.get(name, unknown)) for name in SHOWN}


def _stream(motors: Sequence[Motors], kind: str) -> Stream:
    rows = np.array([(m.device_s, *m.values) for m in motors if m.kind == kind]).reshape(-1, 1 + len(motors[0].values))
    return Stream(rows[:, 0], rows[:, 1:], motor_columns(kind, rows.shape[1] - 1))
