r"""A sparse formula for a residual that no effect of the library removes: a proposal, never a finding.

By Buckingham's theorem a force is the weight (a torque: weight times arm) times a function of dimensionless groups. The
groups are made of the variables that the screen found the residual to depend on: position over arm, velocity over the
induced velocity of hover :math:`v_h = \sqrt{m g / (2 \rho A)}`, rates times arm over :math:`v_h`, thrust over weight,
angles as they are. Their low powers and products make a dictionary; terms are added one at a time while each beats
chance, shared among all that were tried, in the joint instrumental estimate with everything else, and lessens the error
on blocks that no estimate saw (forward regression with held-out blocks; the dictionary after Brunton, Proctor, Kutz
2016, PNAS 113(15)).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.beside import beside
from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.effect import Effect, Followed, ParameterInfo, Settings, blank, weight
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.held_out import held_out
from groundstation.diagnosis.results import Unexplained
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.frames import euler_from_quat, quat_rotate_inverse
from groundstation.identification.record_model import CHANNELS
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Chosen = Sequence[tuple[Candidate, Columns]]
HeldOut = Callable[[Chosen], Mapping[str, Mapping[str, float]]]

Shape = Callable[[Signals, Vehicle], Array]
About = Callable[[Signals], Shape]
"""From the signals of a flight to what gives a shape in any part of it."""


@dataclass(frozen=True, slots=True)
class Group:
    """A dimensionless group: how it is written, its values in a flight, and the powers that are offered ("odd" ones
    keep the sign).
    """

    text: str
    about: About
    powers: tuple[str, ...] = ("{}", "{}^2", "{}^3")


def induced_velocity(vehicle: Vehicle) -> float:
    """Induced velocity of hover by momentum theory, m/s (Leishman 2006, eq. 2.16)."""
    area = vehicle.rotors.count * np.pi * vehicle.rotors.radius_m**2
    return float(np.sqrt(weight(vehicle) / (2.0 * vehicle.identification.air_density_kg_m3 * area)))


def _at_once(values: Shape) -> About:
    """Values that the instant tells."""
    return lambda whole: values


def _position(axis: int) -> Group:
    return Group(f"({'xyz'[axis]}/arm)", _at_once(lambda s, v: s.position_m[:, axis] / v.arm_m()))


def _velocity(axis: int) -> Group:
    return Group(
        f"(v_{'xyz'[axis]}/v_h)",
        _at_once(lambda s, v: s.velocity_body_m_s()[:, axis] / induced_velocity(v)),
        ("{}", "{}^2", "|{}|{}"),
    )


def _rate(axis: int) -> Group:
    return Group(
        f"(omega_{'xyz'[axis]} arm/v_h)",
        _at_once(lambda s, v: s.rate_rad_s[:, axis] * v.arm_m() / induced_velocity(v)),
        ("{}", "{}^2", "|{}|{}"),
    )


def _angle(axis: int) -> Group:
    name = ("roll", "pitch", "yaw")[axis]
    about = _at_once(lambda s, v: np.sin(euler_from_quat(s.quaternion)[:, axis]))
    return Group(f"sin({name})", about, ("{}", "{}^2"))


def _thrust(signals: Signals, vehicle: Vehicle) -> Array:
    return signals.thrust_n.sum(axis=1) / weight(vehicle) - 1.0


def _trend(signals: Signals) -> Array:
    return np.gradient(signals.thrust_n.sum(axis=1), signals.t_s)


def _thrust_trend(whole: Signals) -> Shape:
    typical = max(float(np.std(_trend(whole), dtype=float)), 1e-12)
    return lambda signals, vehicle: np.tanh(_trend(signals) / typical)


def _fallen(whole: Signals) -> Shape:
    start_v = whole.voltage_v[0]
    return lambda signals, vehicle: 1.0 - signals.voltage_v / start_v


def _elapsed(whole: Signals) -> Shape:
    begin_s, length_s = whole.t_s[0], max(float(whole.t_s[-1] - whole.t_s[0]), 1e-9)
    return lambda signals, vehicle: (signals.t_s - begin_s) / length_s


GROUPS: Mapping[str, tuple[Group, ...]] = {
    **{f"position_{'xyz'[i]}_m": (_position(i),) for i in range(3)},
    **{f"velocity_{'xyz'[i]}_m_s": (_velocity(i),) for i in range(3)},
    **{f"rate_{'xyz'[i]}_rad_s": (_rate(i),) for i in range(3)},
    **{name: (_angle(i),) for i, name in enumerate(("roll_rad", "pitch_rad", "yaw_rad"))},
    "thrust_n": (Group("(T/W - 1)", _at_once(_thrust)),),
    "thrust_rate": (Group("sign(dT/dt)", _thrust_trend, ("{}",)),),
    "voltage_v": (Group("(1 - V/V_start)", _fallen, ("{}",)),),
    "time_s": (Group("(t/duration)", _elapsed, ("{}", "{}^2")),),
}
"""By variable of the screen."""


def _raised(group: Group, power: str) -> About:
    def about(whole: Signals) -> Shape:
        values = group.about(whole)

        def shape(signals: Signals, vehicle: Vehicle) -> Array:
            u = values(signals, vehicle)
            return np.abs(u) * u if power == "|{}|{}" else u ** float(power.partition("^")[2] or 1)

        return shape

    return about


def _product(one: Group, other: Group) -> About:
    def about(whole: Signals) -> Shape:
        a, b = one.about(whole), other.about(whole)
        return lambda signals, vehicle: a(signals, vehicle) * b(signals, vehicle)

    return about


def _shapes(variables: Sequence[str]) -> list[tuple[str, About]]:
    """Powers of each variable's groups, and products of two variables."""
    groups = [group for name in variables for group in GROUPS.get(name, ())]
    out = [(p.replace("{}", g.text), _raised(g, p)) for g in groups for p in g.powers]
    for i, one in enumerate(groups):
        out += [(f"{one.text} {other.text}", _product(one, other)) for other in groups[i + 1 :]]
    return out


def _targets(channel: str) -> tuple[tuple[str, int], ...]:
    """Directions in which a term may act to show in a channel: its body axis, and for a sideways force the world's
    axes.
    """
    row = CHANNELS.index(channel)
    if row < 3:
        return (("body", 3 + row),)
    axis = row - 3
    return (("body", axis), *((("world", 0), ("world", 1)) if axis < 2 else (("world", 2),)))


def _where(frame: str, row: int) -> str:
    return f"{'force' if row < 3 else 'torque'} along {frame} {'xyz'[row % 3]}"


def _term(text: str, about: About, frame: str, row: int) -> Candidate:
    """One entry of the dictionary, as an effect with one dimensionless coefficient."""

    def pushed(shape: Shape, signals: Signals, vehicle: Vehicle) -> Array:
        out = blank(signals)
        values = shape(signals, vehicle) * weight(vehicle) * (vehicle.arm_m() if row >= 3 else 1.0)
        if frame == "world":
            out[:, :3, 0] = quat_rotate_inverse(signals.quaternion, values[:, None] * np.eye(3)[row])
        else:
            out[:, row, 0] = values
        return out

    def wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
        return pushed(about(signals), signals, vehicle)

    def followed(
        signals: Signals, planned: Signals | None, vehicle: Vehicle, several: Sequence[Settings], alone: bool
    ) -> Followed:
        shapes = [about(whole) for whole in (signals, planned) if whole is not None]
        return lambda now, ahead: [
            pushed(shape, some, vehicle) for shape, some in zip(shapes, (now, ahead), strict=False) if some is not None
        ]

    effect = Effect(
        identifier=f"{_where(frame, row)}: {text}",
        equation=text,
        source="dictionary of the sparse proposal",
        parameters=(ParameterInfo("coefficient", lambda vehicle: 1.0),),
        wrench=wrench,
        followed=followed,
        sentence="",
        confused_with=(),
        manoeuvre="",
    )
    return Candidate(effect, {})


def dictionary(remaining: Sequence[Unexplained]) -> list[Candidate]:
    """Every term that the unexplained channels and what they depend on give reason for."""
    found: dict[str, Candidate] = {}
    for item in remaining:
        for text, about in _shapes(item.depends_on):
            for frame, row in _targets(item.channel):
                term = _term(text, about, frame, row)
                found.setdefault(term.identifier, term)
    return list(found.values())


def select(evidence: Evidence, chosen: Chosen, terms: Sequence[Candidate]) -> list[tuple[Candidate, Columns]]:
    """Forward regression over the dictionary; a term that later ones make needless is dropped again."""
    from scipy.stats import chi2

    found = zip(terms, evidence.columns_of(terms), strict=True)
    pool = [(term, columns) for term, columns in found if columns is not None and columns.shown]
    least = float(chi2.isf(THRESHOLDS.term_chance / max(len(pool), 1), 1))
    offset = sum(len(c.effect.parameters) for c, _ in chosen)
    taken: list[tuple[Candidate, Columns]] = []

    def walds(entries: Sequence[tuple[Candidate, Columns]]) -> list[float]:
        solution = evidence.solve([*chosen, *entries])
        return [solution.wald(offset + i, [0]) for i in range(len(entries))]

    while len(taken) < THRESHOLDS.terms_most:
        open_ones = [entry for entry in pool if not any(_alike(entry, t) for t in taken)]
        scores = np.zeros(len(open_ones))
        for some in beside(evidence, [*chosen, *taken], open_ones):
            scores[list(some.index)] = some.walds()
        if not open_ones or scores.max() <= least:
            break
        entry = open_ones[int(np.argmax(scores))]
        if _held_out_gain(evidence, [*chosen, *taken], entry) <= 0.0:
            break
        taken.append(entry)
        kept = [t for t, w in zip(taken, walds(taken), strict=True) if w > least]
        if len(kept) < len(taken):
            taken = kept
            break
    return taken


def _alike(one: tuple[Candidate, Columns], other: tuple[Candidate, Columns]) -> bool:
    """Whether two terms do nearly the same on these flights (the same one included): a formula takes one of them."""
    a, b = one[1].sensitivity[:, 0], other[1].sensitivity[:, 0]
    return abs(float(a @ b)) > THRESHOLDS.same_term_correlation * float(np.linalg.norm(a) * np.linalg.norm(b))


def _held_out_gain(evidence: Evidence, before: Chosen, entry: tuple[Candidate, Columns]) -> float:
    """Fall of the whitened squared residual on blocks no estimate saw when ``entry`` is added."""
    gain = 0.0
    for train, test in held_out(evidence):
        old = evidence.remainder(before, evidence.solve(before, train))[test]
        new = evidence.remainder([*before, entry], evidence.solve([*before, entry], train))[test]
        gain += float(np.sum(evidence.weight[test] * (old**2 - new**2)))
    return gain


def with_proposals(
    evidence: Evidence, chosen: Chosen, remaining: Sequence[Unexplained], held_out: HeldOut
) -> tuple[Unexplained, ...]:
    """What is unexplained, with a formula where one holds on data it was not fitted on.

    Args:
        evidence: of the flights.
        chosen: everything that is estimated already.
        remaining: channels and what they depend on, by the screen.
        held_out: from chosen candidates and terms to RMS by channel on blocks no estimate saw: {"before": .., "after":
            ..}.
    """
    terms = select(evidence, chosen, dictionary(remaining)) if remaining else []
    if not terms:
        return tuple(remaining)
    error = held_out([*chosen, *terms])
    solution = evidence.solve([*chosen, *terms])
    offset = sum(len(c.effect.parameters) for c, _ in chosen)
    values = [float(solution.part(offset + i, 1)[0][0]) for i in range(len(terms))]
    out: list[Unexplained] = []
    for item in remaining:
        kind = item.channel.partition("_")[0]
        here = tuple(_where(*target) for target in _targets(item.channel))
        mine = [(t, v) for (t, _), v in zip(terms, values, strict=True) if t.identifier.startswith(here)]
        before, after = error["before"].get(item.channel, np.nan), error["after"].get(item.channel, np.nan)
        if mine and after < before:
            unit = "N" if kind == "force" else "N m"
            gain = f"held out, the error falls from {before:.3g} to {after:.3g} {unit}"
            out.append(replace(item, proposal=f"{_formula(mine, kind)}; {gain}"))
        else:
            out.append(item)
    return tuple(out)


def _formula(terms: Sequence[tuple[Candidate, float]], kind: str) -> str:
    """Terms gathered by direction, as a sum."""
    scale = "weight" if kind == "force" else "weight arm"
    sums: dict[str, str] = {}
    for term, value in terms:
        where, _, text = term.identifier.partition(": ")
        before = sums.get(where, "")
        sign = " - " if value < 0.0 else " + "
        sums[where] = f"{before}{sign}{abs(value):.3g} {text}"
    told = [f"{where} = {scale} [{total.removeprefix(' + ').strip()}]" for where, total in sums.items()]
    return "a proposal, not a finding: " + ", ".join(told)
