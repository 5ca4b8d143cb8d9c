"""Which effects the evidence asks for: forward selection with backward checks, rivals told, chance excluded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.beside import beside
from groundstation.diagnosis.columns import Candidate, Columns, Solution
from groundstation.diagnosis.discrepancy import Discrepancy, allowance
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.held_out import held_out
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.rivals import (
    Entry,
    Kind,
    began_once,
    clearly,
    has_changes,
    in_settings,
    kind_of,
    material,
    nearby,
    plausible,
    posterior,
    preferred,
)
from groundstation.diagnosis.small import SmallEffects
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.whitening import orthonormal
from groundstation.identification.record_model import CHANNELS

Array = NDArray[np.float64]

SETTLED = 1e-3
"""Relative change of settings below which they follow from the values found."""


@dataclass(frozen=True, slots=True)
class Named:
    """A candidate that stands.

    Attributes:
        evidence: margin of its Wald statistic over chance and over what the other effects' formulas may miss.
        gain: fall of the whitened squared error on blocks no estimate saw, when it is put in last.
        alternatives: effects that explain as much; confidence: its posterior share among them and nothing at all.
        measured: the finding, where other means than the joint estimate give its numbers.
    """

    candidate: Candidate
    columns: Columns
    evidence: float
    gain: float
    alternatives: tuple[str, ...]
    confidence: float
    measured: Finding | None = None


class Selection:
    """Forward selection over columns computed once.

    Args:
        pool: what may be named. baseline: what is there in any case.
        variants: how many settings each effect is tried in; None for those in the pool.
        small: what may stand as small effects do (:mod:`.small`).
    """

    def __init__(
        self,
        evidence: Evidence,
        pool: Sequence[Candidate],
        baseline: Sequence[Entry] = (),
        progress: Callable[[float], None] = lambda fraction: None,
        variants: Mapping[str, int] | None = None,
        small: Iterable[Kind] = (),
    ):
        self.evidence = evidence
        self.baseline = list(baseline)
        self.pool: list[Entry] = []
        for candidate, columns in zip(pool, evidence.columns_of(pool), strict=True):
            if columns is not None and np.any(columns.wrench_rms > 0.0) and columns.shown:
                self.pool.append((candidate, columns))
        progress(1.0)
        self.discrepancy = Discrepancy(evidence)
        lag = self.discrepancy.lag(evidence.solve(self.baseline))
        self.lag = self.discrepancy.by_channel(lag)
        self.small = SmallEffects(evidence, self.discrepancy, lag, self.threshold, small)
        self.variants = Counter(c.identifier for c, _ in self.pool) if variants is None else variants
        self._passed: dict[tuple[int, int], float] = {}
        self._alone: dict[frozenset[int], Array] = {}
        self._beaten: list[tuple[set[Kind], float]] = []

    def threshold(self, candidate: Candidate, columns: Columns, members: Sequence[int] | None = None) -> float:
        """Wald statistic of all parameters (or some) that noise passes with probability ``effect_chance`` in any of an
        effect's variants.
        """
        key = columns.number, -1 if members is None else len(members)
        if key not in self._passed:
            self._passed[key] = self._passing(candidate, columns, members, THRESHOLDS.effect_chance)
        return self._passed[key]

    def _passing(self, candidate: Candidate, columns: Columns, members: Sequence[int] | None, chance: float) -> float:
        """The same with any probability."""
        tried = max(self.variants[candidate.identifier], candidate.effect.scanned)
        return self.evidence.threshold(columns, chance / tried, members)

    def _cost(self, entry: Entry) -> float:
        """What an entry has to explain in a contest: what chance gives it, and what an instant gives that was looked
        for.

        The search for an instant is one more parameter, which costs the logarithm of the number of rows (Schwarz 1978),
        about as much as ``inseparable``: a rotor that was weak all along is not one that failed early for less.
        """
        return self.threshold(*entry) + (THRESHOLDS.inseparable if began_once(entry) else 0.0)

    def _margins(self, chosen: Sequence[Entry], members: Sequence[int] | None = None) -> list[float]:
        """Margin of each member (or of some) over chance and over the others' form errors; -inf if implausible or
        immaterial.
        """
        solution = self.evidence.solve([*self.baseline, *chosen])
        offset = sum(len(c.effect.parameters) for c, _ in self.baseline)
        energies = self.discrepancy.energies(chosen, solution, offset)
        out: list[float] = []
        for index, (candidate, columns) in enumerate(chosen):
            first, offset = offset, offset + len(candidate.effect.parameters)
            if members is not None and index not in members:
                continue
            values, covariance = solution.part(first, offset - first)
            if (
                not self.has_prerequisites(candidate, chosen)
                or not plausible(candidate, values, covariance)
                or not material(self.evidence, columns, values)
            ):
                out.append(-np.inf)
                continue
            others = self._without(chosen, index)
            telling = candidate.effect.telling()
            chance = self.threshold(candidate, columns, telling)
            beyond = solution.wald(first, telling) - chance
            margin = beyond - allowance(energies[index], others)
            if margin <= 0.0 < beyond and kind_of(chosen[index]) in self.small.kinds:
                rest = [*chosen[:index], *chosen[index + 1 :]]
                margin = max(margin, *self.small.margins([*self.baseline, *rest], [chosen[index]]))
            out.append(margin)
        return out

    def _margins_of_each(self, chosen: Sequence[Entry], entries: Sequence[Entry]) -> list[float]:
        """That of each of several entries beside a set, as :meth:`_margins` has it."""
        out = [-np.inf] * len(entries)
        others = self._together(chosen)
        for found in beside(self.evidence, [*self.baseline, *chosen], entries):
            walds = found.walds()
            energies = self.discrepancy.energy_of_each(found)
            right = found.plausible() & found.material(self.evidence.scale)
            for place, index in enumerate(found.index):
                candidate, columns = entries[index]
                if right[place] and self.has_prerequisites(candidate, [*chosen, entries[index]]):
                    least = self.threshold(candidate, columns, candidate.effect.telling())
                    out[index] = float(walds[place]) - least - allowance(energies[place], others)
        return out

    def needed(self, entry: Entry, values: Array, chosen: Sequence[Entry]) -> float:
        """Wald statistic from which an entry of these values would stand beside a set."""
        candidate, columns = entry
        return self.threshold(candidate, columns, candidate.effect.telling()) + self._left_to(entry, values, chosen)

    def suspected(self, entry: Entry, values: Array, chosen: Sequence[Entry]) -> float:
        """The same from which it is a hint."""
        candidate, columns = entry
        chance = self._passing(candidate, columns, candidate.effect.telling(), THRESHOLDS.hint_chance)
        return chance + self._left_to(entry, values, chosen)

    def _left_to(self, entry: Entry, values: Array, chosen: Sequence[Entry]) -> float:
        """Evidence that the formulas of a set may leave to an entry of these values beside it."""
        return allowance(self.discrepancy.energy(entry[1], values), self._together(chosen))

    def _without(self, chosen: Sequence[Entry], index: int) -> Array:
        """Energy by channel, shape (6,), of lag and the other members as they are estimated without one.

        What their formulas may leave to it is theirs where it is not there: beside it, two that are alike nearly
        cancel, and their energies mean nothing.
        """
        return self._together([*chosen[:index], *chosen[index + 1 :]])

    def _together(self, rest: Sequence[Entry]) -> Array:
        """The same of a set."""
        key = frozenset(columns.number for _, columns in rest)
        if key not in self._alone:
            solution = self.evidence.solve([*self.baseline, *rest])
            first = sum(len(c.effect.parameters) for c, _ in self.baseline)
            self._alone[key] = self.discrepancy.energies(rest, solution, first).sum(axis=0) + self.lag
        return self._alone[key]

    def has_prerequisites(self, candidate: Candidate, chosen: Sequence[Entry]) -> bool:
        """Whether one of the effects that it rests on is there, or it rests on none."""
        there = {c.identifier for c, _ in (*self.baseline, *chosen)}
        return not candidate.effect.rests_on or bool(there.intersection(candidate.effect.rests_on))

    def _best_addition(self, chosen: Sequence[Entry]) -> Entry | None:
        """What shows most beside a set; None where nothing does."""
        entries = self._others(chosen, frozenset())
        margins = self._margins_of_each(chosen, entries)
        best = int(np.argmax(margins)) if entries else 0
        return entries[best] if entries and margins[best] > 0.0 else None

    def _best_of_all(self, chosen: Sequence[Entry], refuted: Set[str]) -> Entry | None:
        """The same where those count, too, that stand as small effects do: what the formulas of the set may leave hides
        them, and they explain more beside its forms than what shows most.
        """
        entries = self._others(chosen, refuted)
        margins = self._margins_of_each(chosen, entries)
        best = int(np.argmax(margins)) if entries else 0
        least = max(margins[best], 0.0) if entries else 0.0
        shown = entries[best] if least > 0.0 else None
        hidden = [entry for entry, margin in zip(entries, margins, strict=True) if margin <= 0.0] if chosen else []
        small = self._beating_chance(chosen, hidden, least)
        margins = self.small.margins([*self.baseline, *chosen], small) if small else []
        best = int(np.argmax(margins)) if margins else 0
        if not margins or margins[best] <= least:
            return shown
        self.small.kinds.add(kind_of(small[best]))
        return small[best]

    def _others(self, chosen: Sequence[Entry], refuted: Set[str]) -> list[Entry]:
        """The pool without effects that were chosen or refuted."""
        taken = {c.identifier for c, _ in chosen} | refuted
        return [entry for entry in self.pool if entry[0].identifier not in taken]

    def _beating_chance(self, chosen: Sequence[Entry], entries: Sequence[Entry], least: float = 0.0) -> list[Entry]:
        """Those of some that beat chance beside a set by more than so much."""
        out: list[Entry] = []
        for found in beside(self.evidence, [*self.baseline, *chosen], entries):
            right = found.plausible() & found.material(self.evidence.scale)
            for entry, wald, fits in zip(found.entries, found.walds(), right, strict=True):
                chance = self.threshold(*entry, found.telling)
                if fits and wald > chance + least and self.has_prerequisites(entry[0], [*chosen, entry]):
                    out.append(entry)
        return out

    def _stands(self, chosen: Sequence[Entry], index: int) -> bool:
        """Whether a member stands, as any effect or as small ones do."""
        if self._margins(chosen, [index])[0] > 0.0:
            return True
        rest = [*chosen[:index], *chosen[index + 1 :]]
        entries = self._beating_chance(rest, [chosen[index]]) if rest else []
        if not entries or self.small.margins([*self.baseline, *rest], entries)[0] <= 0.0:
            return False
        self.small.kinds.add(kind_of(chosen[index]))
        return True

    def choose(self) -> list[Entry]:
        """The set that explains most beyond chance: of the one that forward selection ends in, and those from other
        starts.

        Forward selection takes what explains most by itself. Two faults together can look most like a third, and no
        exchange of one member leads out of that corner. So a selection begins at every rotor and every other effect
        that shows by itself, too, and the sets contest all places together, through the same instruments.
        """
        found = self._selected([])
        if not found:
            return found
        rivals = self._from_other_starts(found)
        best = preferred([found, *rivals], *self._scores([found, *rivals]))
        if best > 0:
            polished = self._selected(self._polished(rivals[best - 1]))
            if polished:
                rivals = [found, *rivals]
                found = polished
        scores, misfit = self._scores([found, *rivals])
        own = {kind_of(entry) for entry in found}
        beaten = [({kind_of(e) for e in rival}, score) for rival, score in zip(rivals, scores[1:], strict=True)]
        # A set that is one exchange away contests that place, and is counted there.
        self._beaten = [(kinds, (score - scores[0]) / misfit) for kinds, score in beaten if len(kinds ^ own) > 2]
        return found

    def _scores(self, sets: Sequence[Sequence[Entry]]) -> tuple[list[float], float]:
        """What each set explains beyond what chance could give each of its members; and the misfit of the best."""
        result = self.evidence.contest([[*self.baseline, *chosen] for chosen in sets])
        costs = [sum(map(self._cost, chosen)) for chosen in sets]
        return [fall - cost for fall, cost in zip(result.falls, costs, strict=True)], result.misfit

    def _from_other_starts(self, found: Sequence[Entry]) -> list[list[Entry]]:
        """The sets that plain forward selection ends in from each kind of candidate that ``found`` does without."""
        best: dict[Kind, tuple[float, Entry]] = {}
        for entry, margin in zip(self.pool, self._margins_of_each([], self.pool), strict=True):
            if margin > best.get(kind_of(entry), (-np.inf, entry))[0]:
                best[kind_of(entry)] = margin, entry
        within = {kind_of(entry) for entry in found}
        starts = [entry for kind, (margin, entry) in best.items() if kind not in within and (margin > 0.0 or kind[1])]
        seen, out = {frozenset(within)}, list[list[Entry]]()
        for start in starts:
            grown = self._grown(start)
            kinds = frozenset(kind_of(entry) for entry in grown)
            if grown and kinds not in seen and min(self._margins(grown)) > 0.0:
                seen.add(kinds)
                out.append(grown)
        return out

    def _grown(self, start: Entry) -> list[Entry]:
        """Forward selection from one candidate, without rivals for a place."""
        chosen, been = [start], {frozenset({start[1].number})}
        while len(chosen) < THRESHOLDS.effects_most and (entry := self._best_addition(chosen)) is not None:
            chosen = self._pruned([*chosen, entry])
            now = frozenset(columns.number for _, columns in chosen)
            if now in been:  # two that drive each other out would take turns for ever
                break
            been.add(now)
        return chosen

    def _polished(self, chosen: list[Entry]) -> list[Entry]:
        """The same, looked at closely; what does not lessen the error on blocks no estimate saw is left out."""
        for index in range(len(chosen)):
            chosen = self._refined(chosen, index)
        chosen = self._pruned(self._contested(chosen))
        return [e for i, e in enumerate(chosen) if self._improves_held_out([*chosen[:i], *chosen[i + 1 :]], e)]

    def _selected(self, chosen: list[Entry]) -> list[Entry]:
        """Select, prune, and let rivals contest each place."""
        refuted: set[str] = set()
        for _ in range(2 * THRESHOLDS.effects_most):
            entry = self._best_of_all(chosen, refuted) if len(chosen) < THRESHOLDS.effects_most else None
            if entry is None:
                break
            *_, entry = refined = self._refined([*chosen, entry], len(chosen))
            if not self._improves_held_out(chosen, entry):
                refuted.add(entry[0].identifier)
                continue
            before = [c for c, _ in chosen]
            chosen = self._pruned(self._contested(refined))
            if [c for c, _ in chosen] == before:
                break
            refuted = set()  # beside others, what made a prediction worse may make it better
        return chosen

    def still_significant(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Those of some candidates that stand together by this evidence; the weakest falls first."""
        columns = ((candidate, self.evidence.columns(candidate)) for candidate in candidates)
        chosen = [(candidate, found) for candidate, found in columns if found is not None]
        while chosen:
            margins = self._margins(chosen)
            worst = int(np.argmin(margins))
            if margins[worst] > 0.0:
                break
            chosen = chosen[:worst] + chosen[worst + 1 :]
        return [candidate for candidate, _ in chosen]

    def named(self, chosen: Sequence[Entry]) -> tuple[list[Named], Solution]:
        """What was chosen with its alternatives, in order of the error it takes away, and the joint estimate."""
        chosen = self._settled(chosen)
        for _ in range(THRESHOLDS.refinements_most):
            before, chosen = chosen, self._settled(chosen, [e for e, _ in chosen if not has_changes(e.effect)])
            if all(one is other for one, other in zip(before, chosen, strict=True)):
                break
        margins = self._margins(chosen)
        named: list[Named] = []
        for index, (entry, margin) in enumerate(zip(chosen, margins, strict=True)):
            rest = [*chosen[:index], *chosen[index + 1 :]]
            contest, misfit = self._contest(chosen, index)
            alternatives, confidence = self._alternatives(contest, margin, misfit)
            gain = self.held_out_gain(rest, entry)
            named.append(Named(*entry, margin, gain, alternatives, confidence))
        named.sort(key=lambda n: -n.gain)
        order = [(n.candidate, n.columns) for n in named]
        return named, self.evidence.solve([*self.baseline, *order])

    def _settled(self, chosen: Sequence[Entry], members: Sequence[Candidate] | None = None) -> list[Entry]:
        """The same with all (or some) in the settings that follow from the values found."""
        solution = self.evidence.solve([*self.baseline, *chosen])
        first = sum(len(c.effect.parameters) for c, _ in self.baseline)
        out: list[Entry] = []
        for entry in chosen:
            candidate, count = entry[0], len(entry[0].effect.parameters)
            settings = candidate.effect.settled(candidate.settings, solution.part(first, count)[0])
            first += count
            known = settings.keys() == candidate.settings.keys()
            same = known and np.allclose(
                *([a[n] for n in settings] for a in (settings, candidate.settings)), rtol=SETTLED
            )
            if same or (members is not None and candidate not in members):
                out.append(entry)
                continue
            others = [*self.baseline, *(other for other in chosen if other is not entry)]
            out.append(in_settings(self.evidence, others, entry, settings))
        return out

    def _refined(self, chosen: list[Entry], index: int) -> list[Entry]:
        """Look closer at the instant, the length or the curve of a member, through instruments common to all
        settings.
        """
        for number in range(THRESHOLDS.refinements_most):
            current = chosen[index]
            entries = [current]
            # Margins through instruments of their own do not compare, nor those of one parameter of several.
            if number == 0 and (has_changes(current[0].effect) or not began_once(current)):
                entries += [entry for entry in self.pool if kind_of(entry) == kind_of(current)]
            for settings in nearby(self.evidence, self.baseline, chosen, index):
                finer = Candidate(current[0].effect, settings)
                columns = self.evidence.columns(finer)
                if columns is not None:
                    entries.append((finer, columns))
            sets = [[*self.baseline, *chosen[:index], entry, *chosen[index + 1 :]] for entry in entries]
            best = entries[int(np.argmax(self.evidence.contest(sets).falls))] if len(entries) > 1 else current
            trial = [*chosen[:index], best, *chosen[index + 1 :]]
            if best is current or not self._stands(trial, index):
                break
            chosen = trial
        return chosen

    def _pruned(self, chosen: list[Entry]) -> list[Entry]:
        while len(chosen) > 1:
            margins = self._margins(chosen)
            worst = int(np.argmin(margins))
            if margins[worst] > 0.0:
                break
            chosen = chosen[:worst] + chosen[worst + 1 :]
        return chosen

    def _contested(self, chosen: list[Entry]) -> list[Entry]:
        """Give each place to whoever serves the set best through instruments common to all who ask for it."""
        for index in range(len(chosen)):
            contest, _ = self._contest(chosen, index)
            entry = max(contest, key=lambda item: item[1])[0]
            if entry is not chosen[index]:
                chosen = self._refined([*chosen[:index], entry, *chosen[index + 1 :]], index)
        return chosen

    def _contest(self, chosen: list[Entry], index: int) -> tuple[list[tuple[Entry, float]], float]:
        """The member at ``index`` and its strongest rivals, with what each explains beyond chance, the member first;
        and the misfit.

        A rival is another effect, or the same one of another rotor.
        A Wald statistic is through an effect's own instruments; two of them do not compare. Here all pass the same
        ones.
        """
        others, own = {c.identifier for i, (c, _) in enumerate(chosen) if i != index}, kind_of(chosen[index])
        best: dict[Kind, tuple[float, Entry]] = {}
        kinds = [(kind_of(entry), entry) for entry in self.pool]
        entries = [entry for kind, entry in kinds if kind != own and kind[0] not in others]
        margins = self._margins_of_each([*chosen[:index], *chosen[index + 1 :]], entries)
        for entry, margin in zip(entries, margins, strict=True):
            if margin > best.get(kind_of(entry), (0.0, entry))[0]:
                best[kind_of(entry)] = margin, entry
        rivals = [entry for _, entry in sorted(best.values(), key=lambda item: -item[0])[: THRESHOLDS.rivals_most]]
        sets = [[*self.baseline, *chosen[:index], entry, *chosen[index + 1 :]] for entry in (chosen[index], *rivals)]
        rest = [*self.baseline, *chosen[:index], *chosen[index + 1 :]]
        result = self.evidence.contest([rest, *sets])
        falls = result.falls
        return [
            (entry, fall - falls[0] - self._cost(entry))
            for entry, fall in zip((chosen[index], *rivals), falls[1:], strict=True)
        ], result.misfit

    def _alternatives(
        self, contest: list[tuple[Entry, float]], margin: float, misfit: float
    ) -> tuple[tuple[str, ...], float]:
        """Alternatives to the first of a contest, and its posterior share among all of it, whole sets without it, and
        nothing.

        Differences that form errors can make count for no more than ``inseparable``. Where even the best set leaves
        more than noise, all differences count for as much less (quasi-likelihood: McCullagh and Nelder 1989, section
        9).
        """
        (entry, own), *rivals = contest
        close = clearly(own)
        kind = kind_of(entry)
        near = [kind_of(rival) for rival, score in rivals if score > own - close * misfit]
        scale = THRESHOLDS.inseparable / close
        differences = [(score - own) / misfit * scale for _, score in rivals]
        sets = [difference * scale for kinds, difference in self._beaten if kind not in kinds]
        alternatives = tuple(dict.fromkeys(name for name, _ in near if name != kind[0]))
        return alternatives, posterior([*differences, *sets, -margin / misfit])

    def held_out_gain(self, chosen: Sequence[Entry], entry: Entry) -> float:
        """Fall of the whitened squared residual on blocks no estimate saw, guard gaps left out, when ``entry`` is
        added.
        """
        return float(np.sum(self._held_out_gains(chosen, entry)))

    def _improves_held_out(self, chosen: Sequence[Entry], entry: Entry) -> bool:
        """Whether an effect lessens the error on blocks no estimate saw, and in no channel adds more to it than its
        form excuses.
        """
        gains = self._held_out_gains(chosen, entry)
        total = float(np.sum(gains))
        return total > 0.0 and float(np.min(gains)) > -(THRESHOLDS.inseparable + THRESHOLDS.form_error_share * total)

    def _held_out_gains(self, chosen: Sequence[Entry], entry: Entry) -> Array:
        """The same by channel, shape (6,), in what the instruments span: a column of measured speeds adds their noise
        to a residual that is right.
        """
        before = [*self.baseline, *chosen]
        after = [*before, entry]
        root = np.sqrt(self.evidence.weight)
        instruments = np.concatenate([self.evidence.z, *(columns.instrument for _, columns in after)], axis=1)
        _, channels, _ = self.evidence.time_of_rows()
        gains = np.zeros(len(CHANNELS))
        for train, test in held_out(self.evidence):
            old = root * self.evidence.remainder(before, self.evidence.solve(before, train))
            new = root * self.evidence.remainder(after, self.evidence.solve(after, train))
            for channel in np.unique(channels):
                rows = test & (channels == channel)
                basis = orthonormal(root[rows, None] * instruments[rows])
                gains[channel] += np.sum((basis.T @ old[rows]) ** 2) - np.sum((basis.T @ new[rows]) ** 2)
        return gains
