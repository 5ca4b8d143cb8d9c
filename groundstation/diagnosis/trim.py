r"""What the mean thrusts of a flight say beside those of healthy flights, where body rates were not measured.

In the mean a vehicle that hovers or goes back and forth turns and climbs nowhere: the rotors balance its weight and
every steady torque. What changed since the healthy flights changes the commanded wrench :math:`w = A \bar T(u)` so as
to counter it:

    rotor i           F, tau_x, tau_y rise by A e_i T_i q, q = loss / (1 - loss); yaw by q + 1 - d of its torque, d the
                      torque per thrust that is left: 1 for a weak motor, the diameter's share for a shorter propeller
                      (thrust D^4, torque D^5), above 1 for one that is taped or chipped
    load at (x, y)    F rises by its weight G, tau_x by +y G, tau_y by -x G, yaw by nothing

Healthy flights differ from each other besides (battery, its place, its voltage). The covariance of that is unknown: it
has an inverse Wishart prior whose scale the healthy flights choose; integrated out it leaves Student's distribution in
all components together (Gelman et al., Bayesian Data Analysis, 3.6). The suspect flights were made in one state and
count as one more draw, however many they are. The hypotheses, sets of rotors and places among them, stand in
:mod:`.trim_hypotheses`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.trim_hypotheses import (
    PAIR,
    SHOWN,
    Explanation,
    Scatter,
    explanations,
    healthy_scatter,
    least_shown,
    load_somewhere,
    posteriors,
    weak_pair,
    weak_rotor,
)
from groundstation.identification.preparation import Prepared
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

CHANNELS = ("force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
LOADED = (
    "Compared with the healthy flights, the vehicle carries {mass_change_kg:g|more|less} on the side of rotor {rotor}."
)
WEAKER = "Compared with the healthy flights, rotor {rotor} is asked for {asked:%|more|less} thrust."
SHORTER = (
    "At the same thrust its torque is {ratio:% change|higher|lower}: a {kind} propeller with {sure:%} probability."
)
FAULTS = ("weak_rotor", "com_offset")
OTHERS = "a difference between two vehicles"
STRANGE = (
    "The references may not be of the same vehicle: with {sure:%} probability the difference is as between two "
    "individuals of one make. Give healthy flights of this very vehicle."
)
MISSED = (
    "No fault is shown. The least that would have been: a rotor with {loss:%} less thrust, or a load of {load:g} "
    "beside a rotor."
)
STRANGE_SHARE = 0.2
"""Share of the probability from which it is said that the references may be of another vehicle: one in five."""
LISTED_SHARE = 0.05
"""Share of the probability from which a rival is listed."""


@dataclass(frozen=True, slots=True)
class Trim:
    """What came of it: findings, error of each channel before and after on flights left out, and whether all is
    explained.
    """

    findings: tuple[Finding, ...]
    before: dict[str, float]
    after: dict[str, float]
    explained: bool
    notes: tuple[str, ...] = ()


def applies(suspects: Sequence[Prepared], references: Sequence[Prepared]) -> bool:
    """Rates are derived, single rotors are known, and there are flights enough to know how they scatter."""
    return (
        all(item.source != "imu" for item in (*suspects, *references))
        and suspects[0].record.vehicle.rotors.input != "wrench"
        and len(references) > THRESHOLDS.trim_freedom_least
    )


def compare_trims(suspects: Sequence[Prepared], references: Sequence[Prepared]) -> Trim:
    """Explain the difference of mean thrusts between suspect and healthy flights."""
    vehicle = suspects[0].record.vehicle
    suspect, reference = (np.array([mean_thrust(item) for item in group]) for group in (suspects, references))
    healthy = reference.mean(axis=0)
    scale = healthy.sum() * np.array([1.0, *([vehicle.arm_m()] * 2), vehicle.rotors.torque_to_thrust_m or 1.0])
    matrix = vehicle.allocation() / scale[:, None]
    suspect, reference = suspect @ matrix.T, reference @ matrix.T
    scatter, changes = healthy_scatter(reference), suspect - reference.mean(axis=0)
    patterns = matrix * healthy
    ranked, shares = _ranked(explanations(vehicle, patterns, changes.mean(axis=0), scatter))
    best = ranked[0]
    left = [one - _refitted(best, vehicle, patterns, rest, scatter) for one, rest in _leave_one_out(changes)]
    return Trim(
        _findings(ranked, shares, vehicle, len(reference)),
        _rms(changes * scale),
        _rms(np.array(left) * scale),
        ranked[0].strange < 0.5
        and scatter.exceeded(changes.mean(axis=0) - best.change) > THRESHOLDS.trim_healthy_chance,
        tuple(_notes(ranked, shares, vehicle, patterns, scatter)),
    )


def _ranked(found: Sequence[Explanation]) -> tuple[list[Explanation], list[float]]:
    """Explanations and their shares, the likeliest first; a fault before a difference of vehicles, if no healthy
    scatter makes it.

    A difference of two vehicles may hold a fault as well: which rotor or load would be looked at first is said, with
    its share.
    """
    shares = posteriors(found)
    order = sorted(range(len(found)), key=lambda index: -shares[index])
    if found[order[0]].effect == "other":
        fault = next(index for index in order if found[index].effect in FAULTS)
        faulty = sum(share for share, each in zip(shares, found, strict=True) if each.effect in FAULTS)
        if faulty > SHOWN * sum(share for share, each in zip(shares, found, strict=True) if each.effect == "none"):
            order = [fault, *(index for index in order if index != fault)]
    return [found[index] for index in order], [shares[index] for index in order]


def _notes(
    ranked: Sequence[Explanation], shares: Sequence[float], vehicle: Vehicle, patterns: Array, scatter: Scatter
) -> list[str]:
    """That the references may be of another vehicle, and where nothing is found the least that would have been."""
    other = sum(share * each.strange for each, share in zip(ranked, shares, strict=True))
    notes = [filled(STRANGE, sure=other)] if other > STRANGE_SHARE else []
    if ranked[0].effect == "none":
        loss, load = least_shown(vehicle, patterns, scatter)
        notes.append(filled(MISSED, loss=loss, load=load))
    return notes


def mean_thrust(prepared: Prepared) -> Array:
    """Mean thrust of each rotor in settled flight, (n,), by the declared curve."""
    thrust = prepared.signals(0.0, 0.0, 0.0).thrust_n
    t_s, keep, total = prepared.record.t_s, prepared.record.keep, thrust.sum(axis=1)
    aloft = total > THRESHOLDS.trim_flying_share * np.median(total[keep])
    ground = np.concatenate([[-np.inf], t_s[~aloft], [np.inf]])
    after = np.searchsorted(ground, t_s)
    apart = np.minimum(t_s - ground[after - 1], ground[np.minimum(after, len(ground) - 1)] - t_s)
    settled = keep & aloft & (apart > THRESHOLDS.trim_settled_s)
    return thrust[settled if settled.any() else keep & aloft].mean(axis=0)


def _refitted(best: Explanation, vehicle: Vehicle, patterns: Array, change: Array, scatter: Scatter) -> Array:
    """The change of wrench that the explanation ``best`` makes when it is fitted to another change."""
    if best.effect == "weak_rotor":
        one, *more = best.rotors
        fitted = (
            weak_pair((one, more[0]), patterns, change, PAIR, scatter)
            if more
            else weak_rotor(one, patterns, change, scatter)
        )
        return fitted.change
    return load_somewhere(vehicle, change, scatter).change if best.effect == "com_offset" else best.change


def _leave_one_out(changes: Array) -> list[tuple[Array, Array]]:
    """Each flight's change, and the mean of the others' (its own, where there is no other)."""
    if len(changes) == 1:
        return [(changes[0], changes[0])]
    return [(one, np.delete(changes, i, axis=0).mean(axis=0)) for i, one in enumerate(changes)]


def _rms(wrenches: Array) -> dict[str, float]:
    return dict(zip(CHANNELS, map(float, np.sqrt(np.mean(wrenches**2, axis=0))), strict=True))


def _findings(
    ranked: Sequence[Explanation], shares: Sequence[float], vehicle: Vehicle, healthy: int
) -> tuple[Finding, ...]:
    """What the best explanation names: a load, a rotor, or two; nothing where it is healthy scatter or something
    else.
    """
    best, *rivals = ranked
    if best.effect not in FAULTS:
        return ()
    behind = [2.0 * (each.evidence - best.evidence) for each in rivals]
    near = [each for each, far in zip(rivals, behind, strict=True) if far > -THRESHOLDS.inseparable]
    alternatives = tuple(dict.fromkeys(each.effect for each in near if each.effect in FAULTS))
    listed = [
        f"{_said(each)} ({100.0 * share:.0f} %)"
        for each, share in zip(rivals, shares[1:], strict=True)
        if share > LISTED_SHARE
    ]
    limit = f" With {healthy} healthy flights and no gyro, {' or '.join(listed)} cannot be excluded." if listed else ""
    gain = 2.0 * (best.evidence - next(each.evidence for each in ranked if each.effect == "none"))
    return tuple(
        Finding(
            effect=best.effect,
            parameters={
                name.removesuffix("/2"): value
                for name, value in best.parameters.items()
                if len(best.rotors) < 2 or name.endswith("/2") == (place == 1)
            },
            sentence=f"{_sentence(best, place, rotor)}{limit}",
            confidence=shares[0],
            alternatives=tuple(name for name in alternatives if name != best.effect),
            rotor=rotor,
            gain=gain,
        )
        for place, rotor in enumerate(best.rotors or (_nearest_rotor(best, vehicle),))
    )


def _said(explanation: Explanation) -> str:
    """An explanation in a few words."""
    if explanation.effect == "weak_rotor":
        rotors = " and ".join(map(str, explanation.rotors))
        return f"rotor{'s' if len(explanation.rotors) > 1 else ''} {rotors} weaker"
    words = {"com_offset": "a load", "none": "a difference between two days", "other": OTHERS}
    return words[explanation.effect]


def _sentence(explanation: Explanation, place: int, rotor: int) -> str:
    if explanation.effect == "com_offset":
        return filled(LOADED, rotor=str(rotor), mass_change_kg=explanation.parameters["mass_change_kg"].value)
    suffix = "/2" if place else ""
    loss = explanation.parameters[f"loss{suffix}"].value
    ratio = explanation.parameters[f"torque_to_thrust_ratio{suffix}"].value
    text = filled(WEAKER, rotor=str(rotor), asked=loss / (1.0 - loss))
    sure = explanation.ratio_off[place]
    kind = "shorter" if ratio < 1.0 else "taped or chipped"
    return f"{text} {filled(SHORTER, ratio=ratio, sure=sure, kind=kind)}" if sure > 0.5 else text


def _nearest_rotor(load: Explanation, vehicle: Vehicle) -> int:
    """In the direction of the load."""
    hubs = np.asarray(vehicle.rotors.position_m)[:, :2]
    towards = [load.parameters[name].value for name in ("com_offset_x_m", "com_offset_y_m")]
    return 1 + int(np.argmax(hubs @ towards / np.linalg.norm(hubs, axis=1)))
