"""Fit of the prediction model to what lies 0.1 and 0.5 s ahead (multiple shooting), and the choice between it and
simpler ones.

Windows start all over the flights (Bock and Plitt 1984, multiple shooting, with every start given by the flight). The
size of each error counts, not its square, in units of what a guess of constant velocity and rate misses in that flight,
so one wild stretch does not decide. The choice is made on blocks of time, or whole flights, that the judged fit has not
seen, by the rule of one standard error (Breiman et al. 1984, Classification and regression trees, 3.4.3): a simpler
model stays unless a richer one is clearly better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import resampled
from groundstation.frames import quat_conjugate, quat_exp, quat_log, quat_multiply, quat_normalise
from groundstation.identification.newton import Expansion, scored
from groundstation.model.flight_states import FlightStates
from groundstation.model.prediction import QUANTITIES, error_norms
from groundstation.model.predictive import (
    NAMES,
    NUMBERS,
    WITHOUT_TORQUE,
    PredictiveModel,
    Windows,
    course,
    run,
    starting,
    windows,
)
from groundstation.model.predictive_kernel import missed
from groundstation.model.vehicle_model import VehicleModel, declared_model

Array = NDArray[np.float64]
Index = NDArray[np.int64]

HORIZONS_S = (0.01, 0.1, 0.5)
"""What a fit looks at: half a second is what a planner needs, 0.1 s what a controller needs, 0.01 s holds the start to
the measured state.
"""
WEIGHTS = (0.2, 0.36, 1.0)
"""Of the horizons: the shorter one is, the more of its error is noise of the measured state."""
WINDOWS = 450
"""Most windows of a fit, over all flights: on the nano-drone benchmark twice as many change no error by half a percent.
"""
FIT_STEP_S = 0.01
WIDEST = 1e3
"""Error, in those of constant velocity, beyond which a model has run away, and how far does not matter."""
SHRINK = 0.02
"""Cost of one spread away from a number's start; the errors themselves cost about 5 together, one prediction of
constant velocity 11.
"""
DIFFERENCE = 1e-3
"""Of a number, in its spreads, by which rows' slopes are taken."""
FEWEST = 20
"""Windows of a flight that a fit takes."""
BLOCK_S = 4.0
"""Blocks of a judgement: several times as long as a horizon, and many in a minute."""
GUARD_S = 0.6
"""Distance of a training window from a judged block: the longest horizon and some."""
FOLDS = 3
SHORTEST_S = 12.0
"""Flight below which there is nothing to fit to and judge by at once: three blocks."""

Candidate = tuple[str, PredictiveModel | VehicleModel | None]


@dataclass(frozen=True, slots=True)
class Shooting:
    """The windows of one flight: their starts, what is true at each horizon, and the size of an error."""

    states: FlightStates
    index: Index
    truth: Array
    scale: Array
    flight: int
    block: Index

    def only(self, chosen: NDArray[np.bool_]) -> Shooting:
        """Those of the windows."""
        return Shooting(
            self.states, self.index[chosen], self.truth[:, chosen], self.scale, self.flight, self.block[chosen]
        )


@dataclass(frozen=True, slots=True)
class Judgement:
    """What was chosen, and the mean error of every candidate on unseen blocks.

    Attributes:
        kind: "fitted", "without_torque", "unpublished", "physical" or "constant_velocity".
        model: the fitted one, whatever was chosen; None where no fit was possible.
        errors: candidate -> horizon -> quantity -> mean norm.
        score: candidate -> mean error in units of constant velocity's, and its standard error.
        loses: where the chosen one is worse than constant velocity: (horizon, quantity).
        reason: a sentence.
    """

    kind: str
    model: PredictiveModel | None
    errors: Mapping[str, Mapping[str, Mapping[str, float]]]
    score: Mapping[str, tuple[float, float]]
    loses: tuple[tuple[str, str], ...]
    blocks: int
    reason: str


def shooting(states: FlightStates, flight: int, keep: NDArray[np.bool_], windows: int) -> Shooting | None:
    """Windows of a flight, evenly over what is kept; None where fewer than 20 fit.

    Args:
        keep: which of the states' stamps may be used.
        windows: about how many.
    """
    t = states.t_s
    known = keep & np.isfinite(states.start_rate_rad_s).all(axis=1) & np.isfinite(states.rate_rad_s).all(axis=1)
    if np.isfinite(states.start_quaternion).all(axis=1).mean() > 0.5:
        parts = (states.start_quaternion, states.start_velocity_m_s, states.quaternion, states.velocity_m_s)
        known &= np.all([np.isfinite(x).all(axis=1) for x in parts], axis=0)
    bad = np.concatenate([[0], np.cumsum(~known)])
    gap = np.concatenate([[0], np.cumsum(np.diff(t) > 0.1)])
    last = np.searchsorted(t, t + HORIZONS_S[-1] + 0.01)
    inside = last < len(t)
    last = np.minimum(last, len(t) - 1)
    good = np.flatnonzero(inside & (bad[last + 1] == bad[:-1]) & (gap[last] == gap) & (t > t[0] + 0.2))
    if len(good) < 20:
        return None
    index = good[:: max(1, len(good) // windows)]
    truth = np.stack([_at(states, t[index] + h) for h in HORIZONS_S])
    still = _differences(_constant(states, index, HORIZONS_S), truth)
    scale = np.linalg.norm(still, axis=-1).mean(axis=1)
    block = np.floor((t[index] - t[0]) / BLOCK_S).astype(np.int64)
    return Shooting(states, index, truth, np.maximum(scale, 1e-9), flight, block)


def _at(states: FlightStates, at_s: Array) -> Array:
    """What a flight is judged by at times, (k, 13)."""
    nearest = np.clip(np.searchsorted(states.t_s, at_s - 0.5 * np.median(np.diff(states.t_s))), 0, len(states.t_s) - 1)

    def columns(values: Array) -> Array:
        return resampled(at_s, states.t_s, values)

    parts = (columns(states.position_m), columns(states.velocity_m_s), states.quaternion[nearest])
    return np.concatenate([*parts, columns(states.rate_rad_s)], axis=1)


def _constant(states: FlightStates, index: Index, horizons: Sequence[float]) -> Array:
    p, v = states.start_position_m[index], states.start_velocity_m_s[index]
    q, w = states.start_quaternion[index], states.start_rate_rad_s[index]
    return np.stack([np.concatenate([p + h * v, v, quat_multiply(q, quat_exp(h * w)), w], axis=1) for h in horizons])


def _differences(found: Array, truth: Array) -> Array:
    """Position, velocity, attitude (rotation vector) and rate less the truth, (m, k, 4, 3); zero where nothing is
    known.
    """
    turned = quat_log(quat_normalise(quat_multiply(quat_conjugate(truth[..., 6:10]), found[..., 6:10])))
    parts = (found[..., :3] - truth[..., :3], found[..., 3:6] - truth[..., 3:6], turned)
    return np.stack([*(np.nan_to_num(x) for x in parts), found[..., 10:] - truth[..., 10:]], axis=-2)


@dataclass(frozen=True, slots=True)
class Squares:
    """What a fit minimises: the rows of the windows of each flight, and a pull towards where the numbers started.

    Attributes:
        shots, begun: of each flight; windows are of the start's base.
        start: the model before the fit. free: its numbers that are fitted.
    """

    shots: tuple[Shooting, ...]
    begun: tuple[Windows, ...]
    start: PredictiveModel
    free: tuple[str, ...]

    def model(self, x: Array) -> PredictiveModel:
        """With numbers in units of their spreads."""
        return self.start.with_values(self.free, x * self._spread)

    @property
    def _spread(self) -> Array:
        return np.array([NUMBERS[NAMES.index(name)].spread for name in self.free])

    @property
    def origin(self) -> Array:
        """Where the numbers started, in these units, (P,)."""
        return self.start.values[[NAMES.index(name) for name in self.free]] / self._spread

    def box(self) -> tuple[Array, Array]:
        """Bounds of the numbers in these units, (P,) each."""
        numbers = [NUMBERS[NAMES.index(name)] for name in self.free]
        return np.array([n.low for n in numbers]) / self._spread, np.array([n.high for n in numbers]) / self._spread

    def rows(self, x: Array) -> list[Array]:
        """Of each flight's windows, (k, rows of one): their squares add up to twice the cost, in units of constant
        velocity's.
        """
        values, share = self.model(x).values, 1.0 / np.sqrt(len(self.shots))
        return [share * _weighted(shot, flown, values) for shot, flown in zip(self.shots, self.begun, strict=True)]

    def slopes(self, x: Array, rows: Sequence[Array]) -> list[Array]:
        """How the rows at ``x`` answer to each number, (P, k, rows of one) for each flight."""
        high, out = self.box()[1], [np.empty((len(x), *own.shape)) for own in rows]
        for number, by in enumerate(np.where(x + DIFFERENCE > high, -DIFFERENCE, DIFFERENCE)):
            there = x.copy()
            there[number] += by
            for own, after, before in zip(out, self.rows(there), rows, strict=True):
                own[number] = (after - before) / by
        return out

    def expansion(self, x: Array, rows: Sequence[Array], slopes: Sequence[Array]) -> Expansion:
        """The cost about a point by Gauss and Newton."""
        away = x - self.origin
        r = np.concatenate([own.ravel() for own in rows])
        j = np.concatenate([own.reshape(len(x), -1) for own in slopes], axis=1)
        cost = 0.5 * float(r @ r) + 0.5 * SHRINK * float(away @ away)
        return Expansion(cost, j @ r + SHRINK * away, j @ j.T + SHRINK * np.eye(len(x)))


@dataclass(frozen=True, slots=True)
class Fitted:
    """The numbers that a fit of all windows found, (P,), and how the rows answer to them there."""

    squares: Squares
    x: Array
    slopes: tuple[Array, ...]

    @property
    def model(self) -> PredictiveModel:
        """With these numbers."""
        return self.squares.model(self.x)

    def only(self, chosen: Sequence[NDArray[np.bool_]]) -> PredictiveModel:
        """What a fit of some of the windows finds: steps from here by the slopes that are known.

        The rows are those windows' own, so that it ends where they are best, however far that is from here.
        """
        some = [n for n, own in enumerate(chosen) if own.sum() >= FEWEST]
        squares = Squares(
            tuple(self.squares.shots[n].only(chosen[n]) for n in some),
            tuple(self.squares.begun[n].only(chosen[n]) for n in some),
            self.squares.start,
            self.squares.free,
        )
        slopes: list[Array] = []
        for n in some:
            fewer = len(chosen) * len(chosen[n]) / (len(some) * int(chosen[n].sum()))
            slopes.append(self.slopes[n][:, chosen[n]] * np.sqrt(fewer))
        found, _ = scored(lambda x: squares.expansion(x, squares.rows(x), slopes), self.x, *squares.box())
        return squares.model(found)


def fitted(squares: Squares) -> Fitted:
    """The numbers by least squares over all windows, shrunk towards the start."""
    best: list[tuple[float, list[Array]]] = []

    def expanded(x: Array) -> Expansion:
        rows = squares.rows(x)
        slopes = squares.slopes(x, rows)
        told = squares.expansion(x, rows, slopes)
        if not best or told.cost < best[0][0]:
            best[:] = [(told.cost, slopes)]
        return told

    found, _ = scored(expanded, squares.origin, *squares.box())
    return Fitted(squares, found, tuple(best[0][1]))


def _weighted(shot: Shooting, begun: Windows, values: Array) -> Array:
    """Rows of each window, (k, rows): their squares add up to the sizes of the errors, in units of constant
    velocity's.
    """
    found = run(values, begun, HORIZONS_S, FIT_STEP_S)
    weight = np.sqrt(np.array(WEIGHTS) / len(shot.index))
    rows = missed(found, shot.truth, shot.scale, weight, WIDEST)
    return rows.transpose(1, 0, 2, 3).reshape(rows.shape[1], -1)


def free_numbers(pose: bool, torque: bool) -> tuple[str, ...]:
    """What a fit may move: velocity's numbers need poses, the smaller model leaves the torque alone."""
    return tuple(n.name for n in NUMBERS if (pose or not n.pose) and (torque or n.name not in WITHOUT_TORQUE))


def _fit(shots: Sequence[Shooting], model: VehicleModel, torque: bool) -> Fitted:
    start = starting(model)
    if not torque:
        start = start.with_values(WITHOUT_TORQUE[:3], np.zeros(3))
    begun = tuple(windows(course(start.base, shot.states), shot.index) for shot in shots)
    return fitted(Squares(tuple(shots), begun, start, free_numbers(all(b.flown.pose for b in begun), torque)))


def _folds(shots: Sequence[Shooting]) -> list[list[NDArray[np.bool_]]]:
    """For each fold, which windows of each flight are judged: whole flights where there are enough, else blocks of
    time.
    """
    if len(shots) >= FOLDS:
        return [[np.full(len(s.index), s.flight % FOLDS == fold) for s in shots] for fold in range(FOLDS)]
    return [[s.block % FOLDS == fold for s in shots] for fold in range(FOLDS)]


def _unseen(shot: Shooting, judged: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Windows to train with: none that overlaps a judged one."""
    if judged.all() or not judged.any():
        return ~judged
    t = shot.states.t_s[shot.index]
    near = np.searchsorted(t[judged], t)
    after = np.abs(t[judged][np.minimum(near, judged.sum() - 1)] - t)
    before = np.abs(t[judged][np.maximum(near - 1, 0)] - t)
    return ~judged & (np.minimum(after, before) > GUARD_S)


def judged(
    shots: Sequence[Shooting], physical: VehicleModel, base: VehicleModel, unpublished: VehicleModel | None = None
) -> Judgement:
    """Fit and choose.

    Args:
        shots: windows of every flight.
        physical: the identified model, a candidate itself.
        base: what the fitted models' gains refer to.
        unpublished: another candidate, with moments that the identification does not publish; None for none.
    """
    norms: dict[str, list[Array]] = {}
    where: list[tuple[int, Index]] = []
    unfitted = {"constant_velocity": None, "declared": declared_model(shots[0].states.vehicle), "physical": physical}
    if unpublished is not None:
        unfitted["unpublished"] = unpublished
    known = [{name: _sizes(model, shot) for name, model in unfitted.items()} for shot in shots]
    fits = {"without_torque": _fit(shots, base, torque=False), "fitted": _fit(shots, base, torque=True)}
    for fold in _folds(shots):
        training = [_unseen(s, j) for s, j in zip(shots, fold, strict=True)]
        testing = [(s, sizes, j) for s, sizes, j in zip(shots, known, fold, strict=True) if j.any()]
        if not any(own.sum() >= FEWEST for own in training) or not testing:
            continue
        models = {name: fit.only(training) for name, fit in fits.items()}
        for shot, sizes, chosen in testing:
            seen = shot.only(chosen)
            where.append((seen.flight, seen.block))
            for name in unfitted:
                norms.setdefault(name, []).append(sizes[name][:, chosen])
            for name, model in models.items():
                norms.setdefault(name, []).append(_sizes(model, seen))
    return _chosen(norms, where, shots, fits)


def _sizes(model: PredictiveModel | VehicleModel | None, shot: Shooting) -> Array:
    """Errors of each window, (horizons judged, k, 4): infinite where a model runs away, NaN of a pose not known."""
    if isinstance(model, VehicleModel):
        norms = error_norms(model, shot.states, shot.index, list(HORIZONS_S))
        found = np.stack([np.stack([norms[h][q] for q in QUANTITIES], axis=-1) for h in HORIZONS_S])
    else:
        path = (
            _constant(shot.states, shot.index, HORIZONS_S)
            if model is None
            else run(model.values, windows(course(model.base, shot.states), shot.index), HORIZONS_S)
        )
        found = np.linalg.norm(_differences(path, shot.truth), axis=-1)
    ran_away = np.isnan(found[..., 3:])  # the rate, which is always known
    return np.where(ran_away & np.isnan(found), np.inf, found)


def _blocks(sizes: Sequence[Array], where: Sequence[tuple[int, Index]], scale: Mapping[int, Array]) -> Array:
    """Mean error of each block in units of constant velocity's in its flight."""
    out: list[float] = []
    for norm, (flight, block) in zip(sizes, where, strict=True):
        size = scale[flight][:, None]
        each = np.minimum(np.nan_to_num(norm / size, nan=0.0, posinf=1e3), 1e3)[1:]  # the shortest horizon is noise
        told = max(1, int((size[1:] > 1e-9).sum()))
        total = each.sum(axis=(0, 2)) / told
        out += [float(total[block == b].mean()) for b in np.unique(block)]
    return np.array(out)


SIMPLEST_FIRST = ("constant_velocity", "physical", "unpublished", "without_torque", "fitted")
JUDGED = tuple(f"{h:g}" for h in HORIZONS_S[1:])
"""Horizons that a choice looks at: what lies 0.01 s ahead is the noise of the start."""


def _chosen(
    norms: Mapping[str, Sequence[Array]],
    where: Sequence[tuple[int, Index]],
    shots: Sequence[Shooting],
    fits: Mapping[str, Fitted],
) -> Judgement:
    scale = {s.flight: s.scale for s in shots}
    blocks = {name: _blocks(sizes, where, scale) for name, sizes in norms.items()}
    score = {
        name: (float(values.mean()), float(values.std() / np.sqrt(max(1, len(values) - 1))))
        for name, values in blocks.items()
    }
    errors = {name: _means(sizes) for name, sizes in norms.items()}
    kind = _simplest_of_the_best(blocks, {name: _lost(errors, name) for name in errors})
    model = fits[kind].model if kind in fits else None
    loses = _lost(errors, kind)
    text = ", ".join(f"{name} {score[name][0]:.2f}" for name in sorted(score, key=lambda n: score[n][0]))
    reason = (
        f"mean error 0.1 and 0.5 s ahead on {len(blocks[kind])} blocks that no fit to what lies ahead has seen, in "
        f"units of constant velocity's: {text}; the simplest within one standard error of the best is taken."
    )
    return Judgement(kind, model, errors, score, loses, len(blocks[kind]), reason)


def _lost(errors: Mapping[str, Mapping[str, Mapping[str, float]]], kind: str) -> tuple[tuple[str, str], ...]:
    """Horizons and quantities in which a candidate misses more than constant velocity, by more than rounding, or runs
    away.
    """
    still, own = errors["constant_velocity"], errors[kind]
    return tuple((h, q) for h, by in still.items() for q, size in by.items() if own[h].get(q, np.inf) > 1.02 * size)


def _simplest_of_the_best(blocks: Mapping[str, Array], lost: Mapping[str, Sequence[tuple[str, str]]]) -> str:
    """The simplest candidate within one standard error of the best. One that loses to constant velocity at a horizon of
    the choice is out where another model does not.
    """
    sound = [name for name in blocks if not any(horizon in JUDGED for horizon, _ in lost[name])]
    running = sound if len(sound) > 1 else list(blocks)
    best = min(running, key=lambda name: float(blocks[name].mean()))
    for name in SIMPLEST_FIRST:
        if name in running:
            difference = blocks[name] - blocks[best]
            if difference.mean() <= difference.std() / np.sqrt(max(1, len(difference) - 1)):
                return name
    return best


def _means(sizes: Sequence[Array]) -> dict[str, dict[str, float]]:
    every = np.concatenate(sizes, axis=1)
    return {
        f"{h:g}": {
            q: float(np.mean(every[i, :, k][np.isfinite(every[i, :, k])]))
            for k, q in enumerate(QUANTITIES)
            if np.isfinite(every[i, :, k]).any() and every[i, :, k].any()
        }
        for i, h in enumerate(HORIZONS_S)
    }
