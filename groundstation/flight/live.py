"""The estimate that views are shown during a flight. It flies nothing: it may be late or fail, and nothing waits for it.

Samples go into a short queue that a thread of low importance empties; when it is full, samples are left out of this
estimate (never out of the recording), and the estimator takes the hole as a hole.
"""

from __future__ import annotations

import math
import queue
import threading
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from drivers.samples import Battery, Imu, Motors, Sample
from groundstation.flight.sequence import Phase
from groundstation.vehicle import Vehicle

if TYPE_CHECKING:
    from groundstation.identification.recursive import RecursiveEstimate, RecursiveEstimator

Table = dict[str, tuple[float, float, float, float]]
QUEUE = 40
"""Batches: two seconds of a flight at the wall clock's pace."""
_ON_GROUND = frozenset({Phase.PLANNED, Phase.UPLOADED, Phase.CHECKED})


class LiveEstimate:
    """Mass and diagonal tensor so far.

    Args:
        vehicle: as declared.

    Attributes:
        table: parameter -> (nominal, estimate, low, high), NaN where not told yet; empty before the first estimate.
        trouble: why there will be no more; empty while all is well.
    """

    def __init__(self, vehicle: Vehicle):
        self.table: Table = {}
        self.trouble = ""
        self._vehicle = vehicle
        self._estimator: RecursiveEstimator | None = None
        self._queue: queue.Queue[tuple[Sequence[Sample], Phase]] = queue.Queue(QUEUE)
        threading.Thread(target=self._run, name="live-estimate", daemon=True).start()

    def see(self, samples: Sequence[Sample], phase: Phase) -> None:
        """Hand over samples; returns at once."""
        if (phase is Phase.EXCITING or phase in _ON_GROUND) and not self._queue.full():
            self._queue.put((samples, phase))

    def _run(self) -> None:
        while not self.trouble:
            self.take(*self._queue.get())

    def take(self, samples: Sequence[Sample], phase: Phase) -> None:
        """Work samples in, on the caller's thread; a fault ends the estimates and nothing else."""
        try:
            self._take(samples, phase)
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
        for sample in samples:
            if isinstance(sample, Battery):
                self._estimator.battery(sample.voltage_v)
        kind = self._vehicle.rotors.input
        motors = np.array([(s.device_s, *s.values) for s in samples if isinstance(s, Motors) and s.kind == kind])
        if (newest := self._estimator.add(imu, motors)) is not None:
            self.table = self._rows(newest)

    def _rows(self, newest: RecursiveEstimate) -> Table:
        from groundstation.identification.recursive import SHOWN

        unknown = (math.nan, math.nan, math.nan)
        known = {name: (e.value, *e.ci95) for name, e in newest.parameters.items()}
        declared = self._vehicle.parameters()
        return {name: (declared[name], *known.get(name, unknown)) for name in SHOWN}
