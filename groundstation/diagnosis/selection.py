"""The effects that the evidence asks for, selected about the base fit, and again about what was found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.attribution import Named, Selection
from groundstation.diagnosis.augmented import is_among
from groundstation.diagnosis.base import Base
from groundstation.diagnosis.case import Case
from groundstation.diagnosis.columns import Candidate, Solution
from groundstation.diagnosis.effect import shared_by_healthy
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.form_error import form_covariance
from groundstation.diagnosis.left_open import left_open
from groundstation.diagnosis.pool import pool_of
from groundstation.diagnosis.rivals import Entry, kind_of
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.unplanned import PastMotion
from groundstation.identification.memory import released
from groundstation.identification.together import of_each
from groundstation.model.parameters import BASIS, RIGID_BODY, values_of
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class Final:
    """What is published: base, baseline and named effects estimated together.

    Attributes:
        evidence: whitened by the noise that these leave.
        baseline: effects that are there in any case. chosen: these, and the named ones behind them.
        solution: of the chosen.
    """

    evidence: Evidence
    baseline: list[Entry]
    chosen: list[Entry]
    solution: Solution


@dataclass(frozen=True, slots=True)
class Selected:
    """What was selected, and the joint estimate of everything.

    Attributes:
        baseline: effects that are there in any case: known from an earlier flight, or shared by the healthy flights.
        named: effects that the evidence asks for, in order of the error they take away.
        solution: base, baseline and named effects, estimated together.
        selection: what they were selected from.
    """

    evidence: Evidence
    baseline: list[Entry]
    named: list[Named]
    solution: Solution
    selection: Selection

    @property
    def chosen(self) -> list[Entry]:
        """Baseline and named effects, in the order of the solution."""
        return [*self.baseline, *((n.candidate, n.columns) for n in self.named)]

    def sizes(self) -> list[tuple[Candidate, Array]]:
        """The chosen, with the values of their parameters."""
        first, out = self.solution.base, list[tuple[Candidate, Array]]()
        for candidate, _ in self.chosen:
            count = len(candidate.effect.parameters)
            out.append((candidate, self.solution.theta[first : first + count]))
            first += count
        return out

    def final(self) -> Final:
        """The joint estimate by the noise that is left beside it.

        What keeps unnamed effects out of the noise they are judged against takes most of the noise at low frequencies
        along, so that its size there is hardly known. Once nothing more is named, all that is left is noise.
        """
        evidence = by_what_is_left(self.evidence, self.baseline, [(n.candidate, n.columns) for n in self.named])
        baseline = _with_columns(evidence, [candidate for candidate, _ in self.baseline], everywhere=True)
        chosen = [*baseline, *_with_columns(evidence, [n.candidate for n in self.named], everywhere=False)]
        return Final(evidence, baseline, chosen, evidence.solve(chosen))

    def is_bent(self) -> bool:
        """Whether the joint estimate moves mass or tensor so far that an effect's size changes by more than its
        deviation.

        A force is seen divided by the base's mass, a torque by its tensor: where these are a share too large, so is the
        effect, which nothing linear puts right.
        """
        if not self.chosen:
            return False
        flight = self.evidence.flights[0]
        about, moved = values_of(flight.parameters, RIGID_BODY), flight.rigid_body(self.solution)[0]
        tensor: Array = np.einsum("k,kij->ij", about[1:], BASIS)
        step: Array = np.einsum("k,kij->ij", (moved - about)[1:], BASIS)
        turns: NDArray[np.complex128] = np.linalg.eigvals(np.linalg.solve(tensor, step)).astype(complex)
        turned = np.abs(turns).max()
        acts = np.concatenate([columns.wrench_rms > 0.0 for _, columns in self.chosen], axis=1)
        share = np.maximum(acts[:3].any(axis=0) * abs(moved[0] / about[0] - 1.0), acts[3:].any(axis=0) * turned)
        effects = slice(self.solution.base, None)
        std = np.sqrt(np.diag(self.solution.covariance)[effects])
        return bool(np.any(share * np.abs(self.solution.theta[effects]) > std))

    def left_open(self) -> Array:
        """Covariance (p, p) that explanations beside the chosen leave open in the joint estimate."""
        return left_open(self.evidence, self.chosen, self.selection.pool, self.selection.threshold)

    def established(self) -> Selected:
        """Without members whose size is not told from zero where sets without them explain as much, or where they stand
        as small effects do.

        Confidence below a half says the first. The size is told by the interval that holds what formulas and
        explanations beside the findings leave open, too: such a number makes up for what another's formula misses.
        A small effect was judged beside the forms of the others one by one, so that of these it has to be told from
        what they leave open (:mod:`.left_open`), and not from a share of the whole of what leaving another out moves:
        beside an effect of thousands of deviations nothing would be.
        """
        small = self.selection.small.kinds
        by_forms = [kind_of((n.candidate, n.columns)) in small for n in self.named]
        unlikely = [n.confidence < 0.5 and not n.alternatives for n in self.named]
        if not any((*by_forms, *unlikely)):
            return self
        solution = self.solution
        left_open = solution.covariance + self.left_open()
        spread = left_open + form_covariance(self.evidence, self.chosen, solution) if any(unlikely) else left_open
        first = solution.base + sum(len(candidate.effect.parameters) for candidate, _ in self.baseline)
        kept: list[Entry] = []
        for item, formed, doubted in zip(self.named, by_forms, unlikely, strict=True):
            own = slice(first, first + len(item.candidate.effect.parameters))
            first = own.stop
            std = np.sqrt(np.diag(spread if doubted else left_open)[own])
            if not (formed or doubted) or np.any(np.abs(solution.theta[own]) > 1.96 * std):
                kept.append((item.candidate, item.columns))
        if len(kept) == len(self.named):
            return self
        named, solution = self.selection.named(kept)
        return replace(self, named=named, solution=solution)


def select(
    case: Case,
    base: Base,
    augmented: tuple[Candidate, ...],
    progress: Progress,
    settled: frozenset[str] = frozenset(),
) -> Selected:
    """The effects that stand.

    An effect swells the noise it is judged against, and bends the base it is judged about: what was found is kept out
    of the noise, the base moves to the joint estimate, and all is judged anew, until the base moves no further than
    matters (:meth:`Selected.is_bent`).

    Args:
        case: its flights at the evidence's rate.
        base: the fit to begin about.
        augmented: effects known from an earlier flight.
        progress: told the fraction done and what is being done.
        settled: effects that are told by other means, and not named here.
    """
    found = _select(case, base, augmented, (), progress, settled)
    for _ in range(THRESHOLDS.passes_most - 1):
        if not found.named:
            break
        known = tuple(n.candidate for n in found.named)
        base = replace(base, fitted=found.evidence.flights[0].updated_base(base.fitted, found.solution))
        del found  # one evidence at a time: that of an hour is a gigabyte
        found = _select(case, base, augmented, known, progress, settled)
        if not found.is_bent():
            break
    return found.established()


def select_beside(
    air: Sequence[PastMotion], case: Case, base: Base, augmented: tuple[Candidate, ...], progress: Progress
) -> Selected:
    """:func:`select` beside what flights without a plan tell by past motion.

    What stands there is there in any case; what was looked for there and does not stand is not named by instruments
    that feedback bends.
    """
    standing = [told for told in air if told.stands and not is_among(told.candidate, augmented)]
    known = (*augmented, *(told.candidate for told in standing))
    found = select(
        case, base, known, progress, frozenset(name for told in air for name in (told.effect.identifier, *told.rivals))
    )
    own = {id(told.candidate.effect): told for told in standing}
    baseline = [entry for entry in found.baseline if id(entry[0].effect) not in own]
    ours = [entry for entry in found.baseline if id(entry[0].effect) in own]
    named = [
        Named(candidate, columns, told.wald - told.chance, told.gain, told.alternatives, finding.confidence, finding)
        for candidate, columns in ours
        for told in [own[id(candidate.effect)]]
        for finding in [told.finding()]
    ]
    return replace(found, baseline=baseline, named=[*named, *found.named])


def _select(
    case: Case,
    base: Base,
    augmented: tuple[Candidate, ...],
    known: Sequence[Candidate],
    progress: Progress,
    settled: frozenset[str],
) -> Selected:
    """Evidence with a noise model that leaves the known effects out, and what it asks for."""
    progress(0.5, "noise of each channel")
    evidence = Evidence(
        of_each(lambda flight: FlightEvidence(flight, base.fitted, base.options, (*augmented, *known)), case.suspects),
        of_each(lambda flight: FlightEvidence(flight, base.fitted, base.options), case.healthy),
    )
    released(case.suspects)
    vehicle, references = case.suspects[0].record.vehicle, bool(case.healthy)
    pool = [
        c
        for c in pool_of(vehicle, evidence, references=references)
        if not is_among(c, augmented) and c.identifier not in settled
    ]
    baseline = _baseline(evidence, vehicle, augmented, references=references)
    selection = Selection(evidence, pool, baseline, lambda f: progress(0.55 + 0.25 * f, "effects one by one"))
    released(case.suspects)
    progress(0.8, "selecting")
    chosen = _confirmed(selection, selection.choose(), case, augmented)
    return Selected(evidence, baseline, *selection.named(chosen), selection)


def _confirmed(selection: Selection, chosen: list[Entry], case: Case, augmented: tuple[Candidate, ...]) -> list[Entry]:
    """Those of the chosen that stand against the noise as it is with nothing but them kept out, too.

    What is kept out of the noise lest effects hide in it takes noise along, most at the lowest frequencies.
    """
    if not chosen:
        return chosen
    evidence = by_what_is_left(selection.evidence, selection.baseline, chosen)
    vehicle = case.suspects[0].record.vehicle
    baseline = _baseline(evidence, vehicle, augmented, references=bool(case.healthy))
    again = Selection(evidence, (), baseline, variants=selection.variants, small=selection.small.kinds)
    left = again.still_significant([candidate for candidate, _ in chosen])
    return [entry for entry in chosen if entry[0] in left]


def by_what_is_left(evidence: Evidence, baseline: Sequence[Entry], chosen: Sequence[Entry]) -> Evidence:
    """The same flights, their noise all that the base, the baseline and the chosen effects leave."""
    shared = tuple(candidate for candidate, _ in baseline)
    own = (*shared, *(candidate for candidate, _ in chosen))
    flights, suspects = evidence.flights, evidence.suspects
    return Evidence(
        of_each(lambda flight: flight.beside(own, generic=False), flights[:suspects]),
        of_each(lambda flight: flight.beside(shared, generic=False), flights[suspects:]),
    )


def _with_columns(evidence: Evidence, candidates: Iterable[Candidate], *, everywhere: bool) -> list[Entry]:
    """Candidates with their columns in an evidence; without those whose signals are unknown."""
    found = ((candidate, evidence.columns(candidate, everywhere=everywhere)) for candidate in candidates)
    return [(candidate, columns) for candidate, columns in found if columns is not None]


def _baseline(evidence: Evidence, vehicle: Vehicle, augmented: Sequence[Candidate], *, references: bool) -> list[Entry]:
    """What is there in any case: effects that are known, and where there are reference flights what those share."""
    shared = shared_by_healthy() if references else []
    members = [Candidate(effect, {}) for effect in shared if effect.applies(vehicle)]
    return _with_columns(evidence, (*members, *augmented), everywhere=True)
