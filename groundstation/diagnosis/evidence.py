r"""Whitened evidence of one or several flights, and what each effect would explain of it.

About a base fit everything is linear: y = X theta_base + sum C_v theta_v + e, rows whitened by each channel's own
coloured disturbance. Because the controller feeds disturbances back into the thrusts, a plain regression lets any
flexible term in the inputs win, on held-out blocks too. So the normal equations are taken with instruments, Z^T (y - A
theta) = 0: the columns that the planned motion would have, one for each parameter (each more keeps a share of the bias:
Bekker 1994). Where those are weak this has no moments, so that the estimate is Fuller's (:func:`.joint.estimated`). An
effect's evidence is its Wald statistic in the joint estimate. Without a plan Z = A.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import count, pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Batch, Candidate, Columns, Contest, Pair, Recent, Solution
from groundstation.diagnosis.effect import weight
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.joint import Products, estimated, strengths
from groundstation.diagnosis.products import FEW_ROWS, Member, Table, product
from groundstation.diagnosis.products import Pair as Crossed
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.whitening import spanning
from groundstation.identification.instrumental import lag_split_precision
from groundstation.identification.parts import by_parts, coefficients, sizes
from groundstation.identification.together import of_each
from groundstation.model.parameters import PriorContext, table

Array = NDArray[np.float64]

FLIGHTS_OWN = ("accel_bias_x_m_s2", "accel_bias_y_m_s2", "accel_bias_z_m_s2")
"""Base parameters that flights of one vehicle do not share."""


COLUMNS_BYTES = 192 * 2**20
"""Of candidates' columns that are held: those of three minutes of flight, all candidates together."""
BATCH_BYTES = 64 * 2**20
"""Of those that stand side by side."""


class Evidence:
    """Several flights of one vehicle with a common base, reference flights of its healthy state among them.

    Args:
        flights: those under suspicion.
        references: healthy flights: they share the base and the baseline, and no candidate acts on them.
    """

    def __init__(self, flights: Sequence[FlightEvidence], references: Sequence[FlightEvidence] = ()):
        self.suspects = len(flights)
        flights = [*flights, *references]
        self.flights = tuple(flights)
        self.names = flights[0].names
        self.y = np.concatenate([f.y for f in flights])
        own = self.of_each_flight()
        self.x = self._over([f.x for f in flights], own)
        self.z = self._over([f.z for f in flights], own)
        shared = np.diag(_joint_precision(flights[0])) + lag_split_precision(self.names)
        repeated = np.tile(np.diag(shared)[own], len(flights) - 1)
        self.prior = np.block(
            [
                [shared, np.zeros((len(shared), len(repeated)))],
                [np.zeros((len(repeated), len(shared))), np.diag(repeated)],
            ]
        )
        self.base = Columns.of(self.x, self.z, np.zeros(6))
        self.output = Columns.of(self.y[:, None], np.zeros((len(self.y), 0)), np.zeros(6))
        self._recent, self._batches = Recent(BATCH_BYTES if len(self.y) > FEW_ROWS else COLUMNS_BYTES), count()
        self._beside: tuple[tuple[int, ...], Products] | None = None
        self.folds: dict[tuple[int, float], list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]] = {}
        self._priors: dict[tuple[str, ...], Array] = {}
        self._solved: dict[tuple[int, tuple[int, ...]], tuple[NDArray[np.bool_], Solution]] = {}
        vehicle = flights[0].prepared.record.vehicle
        self.scale = weight(vehicle) * np.array([1.0] * 3 + [vehicle.arm_m()] * 3)
        self.weight = np.minimum(1.0, THRESHOLDS.outlier_std / np.maximum(np.abs(self._plain_remainder()), 1e-9))
        self.table = Table(self.base, self.output, self.weight, self.time_of_rows()[1])

    def of_each_flight(self) -> list[int]:
        """Base parameters that are another on every flight: the accelerometer's biases, which change from power-on to
        power-on.
        """
        return [index for index, name in enumerate(self.names) if name in FLIGHTS_OWN]

    def _over(self, columns: Sequence[Array], own: Sequence[int]) -> Array:
        """Columns of all flights, below each other, with those of a flight's ``own`` behind; of a single one its
        own array.
        """
        if len(columns) == 1:
            return columns[0]
        return np.concatenate([np.concatenate(columns), self._each_its_own([c[:, own] for c in columns])], axis=1)

    @staticmethod
    def _each_its_own(columns: Sequence[Array]) -> Array:
        """Columns by which each flight behind the first departs from it: its own in its own rows, zero elsewhere."""
        starts = np.cumsum([0, *(len(c) for c in columns)])
        out = np.zeros((starts[-1], sum(c.shape[1] for c in columns[1:])))
        at = 0
        for number, own in enumerate(columns[1:], 1):
            out[starts[number] : starts[number + 1], at : at + own.shape[1]] = own
            at += own.shape[1]
        return out

    def _plain_remainder(self) -> Array:
        """What base and known effects leave in the least squares sense: an effect's own rows are not outliers."""
        known = self._over_flights(self.flights[0].known, everywhere=False)
        seen = known.white[:, : known.wrench_rms.shape[1]]

        def a(rows: slice) -> Array:
            return np.concatenate([self.x[rows], seen[rows]], axis=1)

        scale = sizes(a, len(self.y)) + 1e-30
        found = coefficients(lambda rows: np.column_stack([a(rows) / scale, self.y[rows]]), len(self.y), rcond=1e-8)
        return by_parts(lambda rows: self.y[rows] - a(rows) @ (found / scale), len(self.y))

    def columns(self, candidate: Candidate, *, everywhere: bool = False) -> Columns | None:
        """A candidate's columns over all flights, zero on the references unless ``everywhere``; None where its signals
        are unknown.
        """
        return self.columns_of([candidate], everywhere=everywhere)[0]

    def columns_of(self, candidates: Sequence[Candidate], *, everywhere: bool = False) -> list[Columns | None]:
        """Those of many, whitened and kept side by side."""
        bytes_each = 2 * 8 * len(self.y)
        batches, width = list[list[Candidate]](), 0
        for candidate in candidates:
            more = len(candidate.effect.parameters)
            if not batches or (width + more) * bytes_each > BATCH_BYTES:
                batches.append([])
                width = 0
            batches[-1].append(candidate)
            width += more
        several = len(batches) > 1
        return [each for some in batches for each in self._held(tuple(some), everywhere, at_once=several)]

    def part(self, columns: Columns, own: slice) -> Columns:
        """Of some of the parameters."""

        def cut() -> Pair:
            sensitivity, instrument = columns.pair()
            return sensitivity[:, own], instrument[:, own]

        energy = None if columns.energy is None else columns.energy[:, own]
        found = Columns(cut, columns.wrench_rms[:, own], energy)
        self.table.add_part(columns.number, found.number, own)
        return found

    def _held(self, candidates: Sequence[Candidate], everywhere: bool, *, at_once: bool) -> list[Columns | None]:
        """Those of a batch, held for as long as there is room, and else made anew; ``at_once`` with their products,
        lest all of a long flight's batches be made a second time for them.
        """
        number, batch = next(self._batches), self._over_flights(candidates, everywhere)
        self._recent.hold(number, batch.white)

        def white() -> Array:
            return self._recent.batch(number, lambda: self._over_flights(candidates, everywhere).white)

        total, first = batch.wrench_rms.shape[1], 0
        apart = total if batch.planned else 0
        out: list[Columns | None] = []
        members: list[Member] = []
        for candidate, known in zip(candidates, batch.known, strict=True):
            own = slice(first, first + len(candidate.effect.parameters))
            wished = slice(own.start + apart, own.stop + apart)
            first = own.stop
            if not known:
                out.append(None)
                continue

            def pair(own: slice = own, wished: slice = wished) -> Pair:
                found = white()
                return found[:, own], found[:, wished]

            shown = bool(batch.energy[:, own].any(axis=0).all())
            columns = Columns(pair, batch.wrench_rms[:, own], batch.energy[:, wished], shown)
            members.append(Member(columns.number, own, wished))
            out.append(columns)
        self.table.add(white, members)
        if at_once and members:
            self.table.fill(members[0])
        return out

    def _over_flights(self, candidates: Sequence[Candidate], everywhere: bool) -> Batch:
        acted_on = self.flights if everywhere else self.flights[: self.suspects]
        parts = of_each(lambda flight: flight.batch(candidates), acted_on)
        parts += [flight.nothing(candidates) for flight in self.flights[len(acted_on) :]]
        return Batch.joined(parts, self.suspects)

    def solve(self, chosen: Sequence[tuple[Candidate, Columns]], rows: NDArray[np.bool_] | None = None) -> Solution:
        """Joint instrumental estimate of base and chosen candidates (:func:`.estimated`).

        Args:
            chosen: candidates with their columns.
            rows: which rows to use (all). Products over all rows are remembered, and solutions over some of them.
        """
        if rows is None:
            return Solution(*estimated(self._equations(chosen, rows)), self.x.shape[1])
        key = id(rows), tuple(columns.number for _, columns in chosen)
        if key not in self._solved:
            found = Solution(*estimated(self._equations(chosen, rows)), self.x.shape[1])
            self._solved[key] = rows, found  # the rows stay as well, so that no others have their number
        return self._solved[key][1]

    def strengths(self, chosen: Sequence[tuple[Candidate, Columns]]) -> Array:
        """F of the instruments of each parameter of :meth:`solve`, beside all the others."""
        return strengths(self._equations(chosen, None))

    def _equations(self, chosen: Sequence[tuple[Candidate, Columns]], rows: NDArray[np.bool_] | None) -> Products:
        members = [self.base, *(columns for _, columns in chosen)]
        return self._products_of(members, rows).with_prior(self._precision(chosen))

    def _products_of(self, members: Sequence[Columns], rows: NDArray[np.bool_] | None) -> Products:
        """Of all members together.

        A selection tries one candidate after another beside the same members: those are put together once and
        remembered.
        """
        first, last = members[:-1], members[-1]
        if not first:
            own, output = self._product(last, last, rows), self._product(last, self.output, rows)
            count = len(self.y) if rows is None else int(np.count_nonzero(rows))
            return Products(own.zx, own.zz, own.xx, output.zx[:, 0], output.xx[:, 0], count)
        key = tuple(columns.number for columns in first)
        if rows is not None:
            before = self._products_of(first, rows)
        elif self._beside is not None and self._beside[0] == key:
            before = self._beside[1]
        else:
            before = self._products_of(first, None)
            self._beside = key, before
        place = len(before.zy)
        total = place + last.sensitivity.shape[1]
        zx, zz, xx = np.empty((3, total, total))
        zx[:place, :place], zz[:place, :place], xx[:place, :place] = before.zx, before.zz, before.xx
        end = 0
        for columns in first:
            start, end = end, end + columns.sensitivity.shape[1]
            across = self._product(columns, last, rows)
            zx[start:end, place:], zz[start:end, place:], xx[start:end, place:] = across.zx, across.zz, across.xx
            back = across.turned()
            zx[place:, start:end], zz[place:, start:end], xx[place:, start:end] = back.zx, back.zz, back.xx
        own, output = self._product(last, last, rows), self._product(last, self.output, rows)
        zx[place:, place:], zz[place:, place:], xx[place:, place:] = own.zx, own.zz, own.xx
        zy, xy = np.append(before.zy, output.zx[:, 0]), np.append(before.xy, output.xx[:, 0])
        return Products(zx, zz, xx, zy, xy, before.rows)

    def products(self, chosen: Sequence[tuple[Candidate, Columns]]) -> Products:
        """Of base and chosen candidates with their priors."""
        return self._equations(chosen, None)

    def prior_of(self, candidate: Candidate) -> Array:
        """Prior precision of a candidate's parameters, (p,)."""
        key = candidate.identifier, *candidate.effect.names()
        if key not in self._priors:
            self._priors[key] = candidate.effect.precision(self.flights[0].prepared.record.vehicle)
        return self._priors[key]

    def _precision(self, chosen: Sequence[tuple[Candidate, Columns]]) -> Array:
        """Prior precision of base and chosen candidates together."""
        base = len(self.prior)
        known = [self.prior_of(candidate) for candidate, _ in chosen]
        total = base + sum(map(len, known))
        out = np.zeros((total, total))
        out[:base, :base] = self.prior
        out.ravel()[base * (total + 1) :: total + 1] = np.concatenate([np.zeros(0), *known])
        return out

    def threshold(self, columns: Columns, chance: float, members: Sequence[int] | None = None) -> float:
        r"""Wald statistic that noise passes with this probability.

        The noise is known from as many values as lie in the bands that an effect lives in, so that W / p follows an F
        distribution, whose second degrees of freedom are Satterthwaite's: :math:`1 / \nu = \sum_b s_b^2 / \nu_b` with
        the shares s_b of the effect's energy. For one slow parameter that asks for twice the chi-squared value.

        Args:
            members: which of the columns' parameters the statistic is of; None for all.
        """
        energy = self._energy(columns.instrument) if columns.energy is None else columns.energy
        return self.threshold_of(energy if members is None else energy[:, members], chance)

    def threshold_of(self, energy: Array, chance: float) -> float:
        """The same by how the energy of each parameter's instrument lies over channels and bands, (bands, p)."""
        from scipy.special import betaincinv

        total, count = float(energy.sum()), energy.shape[1]
        if not total > 0.0:
            return float("inf")  # the plan does none of it: no instrument tells it
        share: Array = energy.sum(axis=1) / total
        spread: Array = share * share / self._freedom
        freedom = 1.0 / float(spread.sum())
        left = np.asarray(
            betaincinv(0.5 * freedom, 0.5 * count, [chance]), dtype=np.float64
        )  # nu / (nu + W): beta distributed
        return freedom * (1.0 / float(left[0]) - 1.0)

    def _energy(self, instrument: Array) -> Array:
        """How that of each instrument lies over the channels and bands of the flights, (bands, p)."""
        starts = np.cumsum([0, *(len(flight.y) for flight in self.flights)])
        parts = [instrument[first:last] for first, last in pairwise(starts)]
        return np.concatenate([f.whitening.energy(part) for f, part in zip(self.flights, parts, strict=True)])

    def mean_square(self, rest: Array, columns: Columns) -> float:
        """Of what is left (rows,), in the channels and bands where an effect's instruments lie: one of noise alone."""
        energy = self._energy(columns.instrument) if columns.energy is None else columns.energy
        power = self.power(rest * np.sqrt(self.weight))
        share = energy.sum(axis=1)
        return float(share @ (power / self._freedom)) / float(share.sum())

    def power(self, values: Array) -> Array:
        """Sum of squares of whitened rows by the channels and bands of the flights, (bands,)."""
        starts = np.cumsum([0, *(len(flight.y) for flight in self.flights)])
        return np.concatenate(
            [
                flight.whitening.energy(values[first:last, None])[:, 0] * float(np.sum(values[first:last] ** 2))
                for flight, (first, last) in zip(self.flights, pairwise(starts), strict=True)
            ]
        )

    @cached_property
    def _freedom(self) -> Array:
        return np.concatenate([flight.whitening.freedom() for flight in self.flights])

    def _product(self, a: Columns, b: Columns, rows: NDArray[np.bool_] | None) -> Crossed:
        """Products of two members, remembered for all rows."""
        return self.table.pair(a, b) if rows is None else product(a, b, self.weight * rows)

    def contest(self, sets: Sequence[Sequence[tuple[Candidate, Columns]]]) -> Contest:
        r"""Fall of the instrumented squared residual :math:`|P_Z W^{1/2} (y - A \theta)|^2` that each set brings to the
        base alone.

        Z is common to all: the base's instruments and those of every member of any set, channel by channel, so that the
        falls compare (moment selection: Andrews 1999, Econometrica 67(3)).
        """
        members = {columns.number: columns for chosen in sets for _, columns in chosen}
        basis, crossed = self._common_products(list(members.values()))
        coordinates = basis.T @ crossed
        width = [1, self.x.shape[1], *(len(columns.wrench_rms[0]) for columns in members.values())]
        y, base, *parts = np.split(coordinates, np.cumsum(width)[:-1], axis=1)
        y, seen = y[:, 0], dict(zip(members, parts, strict=True))

        def left(chosen: Sequence[tuple[Candidate, Columns]]) -> float:
            a = np.concatenate([base, *(seen[columns.number] for _, columns in chosen)], axis=1)
            prior = self._precision(chosen)
            theta = np.linalg.solve(a.T @ a + prior, a.T @ y)
            return float(np.sum((y - a @ theta) ** 2) + theta @ prior @ theta)

        alone, remaining = left(()), [left(chosen) for chosen in sets]
        best = int(np.argmin(remaining))
        used = base.shape[1] + sum(columns.sensitivity.shape[1] for _, columns in sets[best])
        misfit = max(1.0, remaining[best] / max(basis.shape[1] - used, 1))
        return Contest([alone - other for other in remaining], misfit)

    def _common_products(self, members: Sequence[Columns]) -> tuple[Array, Array]:
        """What makes the base's instruments and those of all members in each channel orthonormal, (Z, r), and the
        products of those with y, the base and the members' sensitivities, (Z, 1 + P).
        """
        _, channels, _ = self.time_of_rows()
        told, own = np.unique(channels), sum(len(columns.wrench_rms[0]) for columns in members)
        shared = self.z.shape[1]
        gram = np.zeros((shared + own * len(told), shared + own * len(told)))
        crossed = np.zeros((len(gram), 1 + self.x.shape[1] + own))
        for place, channel in enumerate(told):
            rows = np.flatnonzero(channels == channel)
            left = np.concatenate([self.z[rows], *(columns.instrument[rows] for columns in members)], axis=1)
            parts = [self.y[rows, None], self.x[rows], *(columns.sensitivity[rows] for columns in members)]
            weighted = (left * self.weight[rows, None]).T
            index = np.r_[:shared, shared + place * own : shared + (place + 1) * own]
            gram[np.ix_(index, index)] += weighted @ left
            crossed[index] += weighted @ np.concatenate(parts, axis=1)
        return spanning(gram), crossed

    def remainder(self, chosen: Sequence[tuple[Candidate, Columns]], solution: Solution) -> Array:
        """Whitened residual after a solution."""
        a = np.concatenate([self.x, *(c.sensitivity for _, c in chosen)], axis=1)
        return self.y - a @ solution.theta

    def time_of_rows(self) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """Time, channel and flight of each whitened row."""
        return self._places

    @cached_property
    def _places(self) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        times: list[Array] = []
        channels: list[NDArray[np.int64]] = []
        flights: list[NDArray[np.int64]] = []
        for number, flight in enumerate(self.flights):
            for channel in flight.channels:
                times.append(flight.model.t_s)
                channels.append(np.full(len(flight.model.t_s), channel))
                flights.append(np.full(len(flight.model.t_s), number))
        return np.concatenate(times), np.concatenate(channels), np.concatenate(flights)


def _joint_precision(flight: FlightEvidence) -> Array:
    """Prior precision of the base's parameters, by the table."""
    record = flight.prepared.record
    context = PriorContext(record.vehicle, flight.parameters, record.force_bias_std, base_std=flight.base_std)
    entries = table()
    return np.array([1.0 / entries[name].joint_std(context) ** 2 for name in flight.names])
