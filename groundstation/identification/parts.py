"""Long records a part at a time: what is made of every sample only to be interpolated or summed is never held whole.

Sums go on from part to part in the order that they have without parts, so that results are the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import resampled

Array = NDArray[np.float64]
Rows = Callable[[slice], Array]
"""What some of the samples are made to, (n, m)."""

PART = 65536
"""Samples that are held at a time: a minute at 1 kHz."""


LONG = 2**19
"""Samples from which what is only kept for later is kept in single precision: a quarter of an hour at 500 Hz."""


def kept(values: Array) -> Array:
    """Values to keep: those of a long record in single precision, 6e-8 of their size."""
    return values if len(values) <= LONG else cast(Array, values.astype(np.float32))


def double(values: Array) -> Array:
    """Values that were kept, to work with."""
    return np.asarray(values, dtype=float)


def parts_of(count: int, size: int | None = None) -> list[slice]:
    """All of so many samples in parts of PART, or another size; one, and an empty one where there are none."""
    size = PART if size is None else size
    return [slice(first, min(first + size, count)) for first in range(0, max(count, 1), size)]


def evenly(count: int, most: int) -> list[slice]:
    """All of so many samples in parts of nearly the same length, none longer than ``most``."""
    bounds = np.linspace(0, count, max(1, -(-count // most)) + 1).astype(int).tolist()
    return [slice(first, last) for first, last in pairwise(bounds)]


def by_parts(made: Rows, count: int) -> Array:
    """What each sample is made to, of all samples, (count, ...), where one does not depend on another."""
    parts = parts_of(count)
    first = made(parts[0])
    if len(parts) == 1:
        return first
    out = np.empty((count, *first.shape[1:]))
    out[parts[0]] = first
    for part in parts[1:]:
        out[part] = made(part)
    return out


def weighted_products(x: Array, weight: Array | None = None) -> Array:
    """X^T W X of rows (n, p), (p, p)."""
    total = np.zeros((x.shape[1], x.shape[1]))
    for part in parts_of(len(x), 2 * PART):
        rows = x[part]
        total += rows.T @ (rows if weight is None else rows * weight[part, None])
    return total


def running_sums(made: Rows, count: int) -> Iterator[tuple[slice, Array]]:
    """Samples and the running sums there, part by part; each begins with the last sample of the one before."""
    last: Array | None = None
    for part in parts_of(count):
        values = made(part)
        if last is None:
            total = np.cumsum(values, axis=0)
            yield part, total
        else:
            values[0] += last
            total = np.concatenate([last[None, :], np.cumsum(values, axis=0)])
            yield slice(part.start - 1, part.stop), total
        last = total[-1].copy()


def running_integrals(made: Rows, dt: Array) -> Iterator[tuple[slice, Array, Array]]:
    """Samples, and the running integral and its running integral there by the trapezoidal rule, part by part.

    Each part begins with the last sample of the one before.

    Args:
        dt: before each sample, (k,).
    """
    speed = path = np.zeros(0)
    for part in parts_of(len(dt)):
        samples = slice(max(part.start - 1, 0), part.stop)
        values, steps = made(samples), dt[samples][1:, None]
        if part.start == 0:
            speed = path = np.zeros(values.shape[1])
        speeds = _accumulated(speed, 0.5 * (values[1:] + values[:-1]) * steps)
        paths = _accumulated(path, 0.5 * (speeds[1:] + speeds[:-1]) * steps)
        yield samples, speeds, paths
        speed, path = speeds[-1].copy(), paths[-1].copy()


def _accumulated(start: Array, steps: Array) -> Array:
    """From a start by steps (n, m), (n + 1, m)."""
    if len(steps):
        steps[0] += start
    return np.concatenate([start[None, :], np.cumsum(steps, axis=0)])


def at_times(parts: Iterator[tuple[slice, Array]], stamps_s: Array, at_s: Array) -> Array:
    """:func:`.resampled` of values that come part by part, each with the last sample of the one before."""
    out, done = np.zeros((0, 0)), 0
    for samples, values in parts:
        if not out.size:
            out = np.empty((len(at_s), values.shape[1]))
        whole = samples.stop >= len(stamps_s)
        stop = len(at_s) if whole else int(np.searchsorted(at_s, stamps_s[samples.stop - 1]))
        out[done:stop] = resampled(at_s[done:stop], stamps_s[samples], values)
        done = max(done, stop)
    return out


def coefficients(made: Rows, count: int, rcond: float) -> Array:
    """Least-squares coefficients of the last column of rows (n, p + 1) by those before it, columns of size one; those
    of many rows from triangular factors of the parts.
    """
    parts = parts_of(count, 4 * PART)
    rows = made(parts[0])
    if len(parts) > 1:
        factors = [np.linalg.qr(rows if part is parts[0] else made(part), mode="r") for part in parts]
        rows = np.asarray(np.linalg.qr(np.concatenate(factors), mode="r"), dtype=float)
    return np.asarray(np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=rcond)[0], dtype=float)


def sizes(made: Rows, count: int) -> Array:
    """Norm of each column of rows (n, p), (p,)."""
    return np.sqrt(sum(np.sum(made(part) ** 2, axis=0) for part in parts_of(count, 4 * PART)))
