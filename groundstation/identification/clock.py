"""Coarse alignment of two clocks from rotation rates, before any model: which shift makes the two motions agree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import Refused
from groundstation.flightdata import resampled
from groundstation.frames import quat_conjugate, quat_exp, quat_log, quat_multiply, quat_rotate
from groundstation.linear_filters import both_ways, correlation, low_pass

Array = NDArray[np.float64]

GRID_HZ = 200.0
SMOOTHING_HZ = 8.0
INTEGRATION_HZ = 100.0


def rates_from_attitude(t_s: Array, quaternion: Array) -> tuple[Array, Array]:
    """Mean body rates between successive attitudes and the times between them, shapes (k-1, 3) and (k-1,)."""
    dt = np.diff(t_s)
    step = quat_log(quat_multiply(quat_conjugate(quaternion[:-1]), quaternion[1:]))
    return step / dt[:, None], 0.5 * (t_s[1:] + t_s[:-1])


def coarse_offset(
    t_gyro: Array,
    gyro: Array,
    t_pose: Array,
    quaternion: Array,
    *,
    expected_s: float = 0.0,
    source: str = "motion capture",
) -> tuple[float, float]:
    """Pose stamp minus gyro stamp of one instant, to a few milliseconds, by correlating smoothed rates.

    Args:
        expected_s: centre of the search, e.g. from arrival times; the search goes as far as half of each record
            overlaps.
        source: of the attitudes, for the refusal.

    Returns:
        Offset in seconds and the correlation coefficient there.

    Raises:
        Refused: the records share no motion to align by.
    """
    pose_rate, t_mid = rates_from_attitude(t_pose, quaternion)
    return _offset_of_rates((t_gyro, gyro), (t_mid, pose_rate), expected_s, source)


def coarse_offset_by_size(
    t_gyro: Array, gyro: Array, t_pose: Array, quaternion: Array, *, expected_s: float
) -> tuple[float, float]:
    """:func:`coarse_offset` by how fast both turn, not about which axes: for a marker body that is mounted anyhow."""
    pose_rate, t_mid = rates_from_attitude(t_pose, quaternion)
    gyro, pose_rate = (np.linalg.norm(rate, axis=1, keepdims=True) for rate in (gyro, pose_rate))
    return _offset_of_rates((t_gyro, gyro), (t_mid, pose_rate), expected_s, "motion capture")


def _offset_of_rates(
    gyro: tuple[Array, Array], pose: tuple[Array, Array], expected_s: float, source: str
) -> tuple[float, float]:
    """Where two series of rates, stamps and values each, agree best, and their correlation there."""
    step, a, b = 1.0 / GRID_HZ, _on_grid(*gyro), _on_grid(*pose)
    total, coefficient = _correlation(a, b)
    offsets = np.arange(-(len(a) - 1), len(b)) * step + pose[0][0] - gyro[0][0]
    # Far from what arrival times say, the evidence has to be better: a periodic excitation repeats itself.
    score = coefficient - 0.02 * np.abs(offsets - expected_s)
    best = int(np.argmax(score))
    if coefficient[best] < 0.3:
        raise Refused(
            f"the clocks of {source} and IMU cannot be aligned: their rates correlate by {coefficient[best]:.2f} at "
            "best.",
            "Fly with rotation about at least one axis, and check that both streams are of the same vehicle.",
        )
    return float(offsets[best] + _peak_shift(total, best) * step), float(coefficient[best])


def _on_grid(t: Array, rate: Array) -> Array:
    """Smoothed rates at GRID_HZ from the first stamp on.

    Raises:
        Refused: less than a second.
    """
    grid = np.arange(t[0], t[-1], 1.0 / GRID_HZ)
    if len(grid) < GRID_HZ:
        raise Refused("the clocks cannot be aligned: a record is shorter than a second.", "Record the whole flight.")
    return _smooth_rates(grid, t, rate)


def _smooth_rates(grid: Array, t: Array, rate: Array) -> Array:
    """Rates on a grid, clipped where they stray, low-passed without phase and without their mean."""
    on_grid = resampled(grid, t, rate)
    limit = 8.0 * np.median(np.abs(on_grid), axis=0) + 0.5
    sections = low_pass(4, SMOOTHING_HZ, GRID_HZ)
    smooth = both_ways(sections, np.clip(on_grid, -limit, limit))
    return smooth - smooth.mean(axis=0)


def _correlation(a: Array, b: Array) -> tuple[Array, Array]:
    """Correlation of b with a at every lag, and its coefficient; -1 where less than half of the shorter one
    overlaps.
    """
    total = np.asarray(sum(correlation(b[:, i], a[:, i]) for i in range(a.shape[1])))
    # The energies are those of the overlapping parts, so that the length of an overlap counts neither for nor against
    # it.
    ones_a, ones_b = np.ones(len(a)), np.ones(len(b))
    power_a: Array = (a**2).sum(axis=1)
    power_b: Array = (b**2).sum(axis=1)
    energy = np.sqrt(np.maximum(correlation(power_b, ones_a), 0.0) * np.maximum(correlation(ones_b, power_a), 0.0))
    overlap = correlation(ones_b, ones_a)
    enough = overlap > 0.5 * min(len(a), len(b))
    return total, np.where(enough, total / np.maximum(energy, 1e-9 * energy.max() + 1e-30), -1.0)


def _peak_shift(values: Array, best: int) -> float:
    """How far the peak of the parabola through three values lies from the middle one, in steps."""
    if not 0 < best < len(values) - 1:
        return 0.0
    y0, y1, y2 = values[best - 1 : best + 2]
    return 0.5 * (y0 - y2) / (y0 - 2 * y1 + y2) if y0 - 2 * y1 + y2 < 0 else 0.0


def fine_offset(t_gyro: Array, gyro: Array, t_pose: Array, quaternion: Array, coarse_s: float) -> float:
    r"""Pose stamp minus gyro stamp over some seconds, from attitudes instead of rates, whose noise is not
    differentiated.

    With Q the gyro's integral, R its matrix and d the offset less ``coarse_s``, a pose at t differs from Q(t - coarse)
    by

        log(q_pose Q^*) = c + k t - d R w    (world axes, small angles),

    where c is the unknown start, k t the drift by the gyro's bias, and w the rate there. Linear least squares gives d;
    poses more than four deviations off (jumps, frozen ones) are left out of a second pass.

    Args:
        coarse_s: from :func:`coarse_offset`.
    """
    step = 1.0 / INTEGRATION_HZ
    grid = np.arange(t_gyro[0], t_gyro[-1], step)
    rate = resampled(grid, t_gyro, gyro)
    turns = quat_exp(0.5 * step * (rate[1:] + rate[:-1]))
    attitude = np.empty((len(grid), 4))
    attitude[0] = quaternion[0]
    for index, turn in enumerate(turns):
        attitude[index + 1] = quat_multiply(attitude[index], turn)
    at = t_pose - coarse_s
    inside = (at > grid[0]) & (at < grid[-1])
    place = np.clip(np.searchsorted(grid, at[inside]) - 1, 0, len(grid) - 2)
    local = resampled(at[inside], grid, rate)
    here = quat_multiply(attitude[place], quat_exp(local * (at[inside] - grid[place])[:, None]))
    error = quat_log(quat_multiply(quaternion[inside], quat_conjugate(here)))
    turning = quat_rotate(here, local)
    elapsed = at[inside] - at[inside].mean()
    eye = np.broadcast_to(np.eye(3), (len(elapsed), 3, 3))
    columns = np.concatenate([-turning[:, :, None], eye, elapsed[:, None, None] * eye], axis=2)
    kept = np.ones(len(elapsed), dtype=bool)
    solution = np.zeros(7)
    for _ in range(2):
        solution = np.linalg.lstsq(columns[kept].reshape(-1, 7), error[kept].reshape(-1), rcond=None)[0]
        left = np.abs(error - columns @ solution).max(axis=1)
        kept = left < 4.0 * 1.4826 * np.median(left)
    return coarse_s + float(solution[0])
