r"""The flight that settles what the last one left open, from the document of its diagnosis.

A finding with ``alternatives`` is a set of hypotheses. Along a planned motion each predicts a wrench (inverse dynamics
of the declared vehicle gives the rotors' thrusts); :func:`~groundstation.planning.discriminate.plan_discrimination`
chooses the motion whose hardest pair is told apart best (T-optimality). A lag or a dead time between command and thrust
acts on the whole wrench w(t) that the motion takes: what a lag :math:`\tau` leaves of the commands that made it is
:math:`-\tau\,\dot w(t)`, and what a dead time d leaves is :math:`w(t) - w(t + d)`, equal to first order in frequency.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.effect import Effect, Settings, library
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.errors import BadInput, Refused
from groundstation.frames import quat_from_euler
from groundstation.json_types import Document, JsonObject
from groundstation.model.rotors import thrusts_for
from groundstation.model.signals import Signals
from groundstation.planning import discriminate
from groundstation.planning.criteria import inertia_regressor
from groundstation.planning.plan import FREQUENCY_MAX_HZ
from groundstation.trajectory import RigidMotion
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

TIMING = ("motor_lag", "input_delay", "clock_offset")
"""Shifts between command and motion; with rates from poses alone a clock's offset is one too, which is the hard case.
"""
TIMING_FREQUENCY_MAX_HZ = 2.0
"""A lag and a dead time part with the square of frequency: such plans go up to where attitude still follows."""
DURATION_S = 40.0
TRIAL_S = 0.12
"""What a motion tried takes, about."""


NOTHING = "nothing"
"""The explanation of a hint by chance."""
HINT_TRIALS = 200
"""Motions tried for a hint, some seconds: its two explanations cost little."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One explanation: an effect with its settings, and its parameters where its size is known."""

    effect: str
    settings: Settings
    values: Mapping[str, float] | None


def rival_entries(
    evidence: Evidence,
    chosen: Sequence[tuple[Candidate, Columns]],
    named: Sequence[tuple[Candidate, Sequence[str]]],
    pool: Sequence[Candidate],
) -> list[JsonObject]:
    """What each alternative would have to be to explain the flight as well, for the diagnosis' ``candidates``.

    Args:
        evidence: of the flights.
        chosen: baseline and named candidates, as they were estimated together.
        named: those named, with the identifiers that explain as much.
        pool: every candidate there is.
    """
    out: list[JsonObject] = []
    for finding, alternatives in named:
        place = next(i for i, (c, _) in enumerate(chosen) if c is finding)
        first = sum(len(c.effect.parameters) for c, _ in chosen[:place])
        for name in alternatives:
            tried = [(c, evidence.columns(c)) for c in pool if c.identifier == name]
            scored: list[tuple[float, Candidate, Array]] = []
            for rival, columns in tried:
                if columns is None:
                    continue
                solution = evidence.solve([*chosen[:place], (rival, columns), *chosen[place + 1 :]])
                count = len(rival.effect.parameters)
                scored.append((solution.wald(first, range(count)), rival, solution.part(first, count)[0]))
            if scored:
                wald, rival, theta = max(scored, key=lambda item: item[0])
                values = dict(zip(rival.effect.names(), theta.tolist(), strict=True))
                entry: JsonObject = {"effect": name, "settings": dict(rival.settings), "evidence": wald}
                out.append({**entry, "values": values, "rival_of": finding.identifier})
    return out


def contenders(document: Document) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """The hypotheses of the first finding that is not settled, else of the first hint, and the findings that hold
    whichever is true.

    Args:
        document: of schema groundstation.diagnosis/1.

    Raises:
        Refused: every finding stands alone and there is no hint, or what is open shows in no force.
    """
    findings = document.get("findings", [])
    open_ones = [f for f in findings if f["alternatives"]]
    hints = [h for h in document.get("hints", []) if h["effect"] in library()]
    if not open_ones and hints:
        hint = Hypothesis(hints[0]["effect"], hints[0]["settings"], hints[0]["values"])
        return [hint, Hypothesis(NOTHING, {}, None)], [_found(f) for f in findings if f["effect"] in library()]
    if not open_ones:
        raise Refused(
            f"the diagnosis of {document.get('flight') or 'this flight'} leaves no two explanations to tell apart.",
            "Plan with `groundstation plan` for better estimates instead.",
        )
    sizes = {(c["effect"], c["rival_of"]): c for c in document.get("candidates", []) if "rival_of" in c}
    for finding in open_ones:
        rivals: list[Hypothesis] = []
        for name in finding["alternatives"]:
            entry = sizes.get((name, finding["effect"]))
            if name in TIMING:
                rivals.append(Hypothesis(name, {}, {"shift_s": _shift(finding["parameters"])}))
            elif entry is not None and name in library():
                rivals.append(_rival(name, entry))
            elif name in library():
                rivals.append(Hypothesis(name, {}, None))
        if rivals and (finding["effect"] in library() or finding["effect"] in TIMING):
            shared = [_found(f) for f in findings if f is not finding and f["effect"] in library()]
            return [_found(finding), *rivals], shared
    names = "; ".join(f"{f['effect']} and {', '.join(f['alternatives'])}" for f in open_ones)
    raise Refused(
        f"{names}: no motion tells them apart by the forces it takes.",
        document.get("next_flight") or "Measure what distinguishes them directly.",
    )


def _rival(name: str, entry: Document) -> Hypothesis:
    """An alternative with its size, where the document holds the whole of it."""
    values: Document | None = entry.get("values")
    settings: Document = entry.get("settings") or {}
    numbers = all(isinstance(value, int | float) for value in settings.values())
    if values is None or not numbers or not set(library()[name].needed()) <= set(values):
        return Hypothesis(name, {}, None)
    return Hypothesis(name, settings, values)


def _shift(parameters: Mapping[str, Mapping[str, float]]) -> float:
    """Seconds by which a timing effect delays the thrust: its lag (mean of up and down) and dead time, or clock
    offset.
    """
    values = {name: float(entry["value"]) for name, entry in parameters.items()}
    lags = [v for n, v in values.items() if n.startswith("rotor_lag")]
    return (sum(lags) / len(lags) if lags else 0.0) + sum(
        abs(values.get(n, 0.0)) for n in ("input_delay_s", "mocap_minus_imu_s")
    )


def _found(finding: Document) -> Hypothesis:
    """A finding of the document; what is not among the effect's parameters is a setting. Changes of settings are in
    these where they are not published.
    """
    if finding["effect"] in TIMING:
        return Hypothesis(finding["effect"], {}, {"shift_s": _shift(finding["parameters"])})
    effect = library()[finding["effect"]]
    names = effect.names()
    values = {name: float(entry["value"]) for name, entry in finding["parameters"].items()}
    missing = [name for name in effect.needed() if name not in values]
    if missing:
        raise BadInput(
            f"the diagnosis lacks {', '.join(missing)} of {finding['effect']}; write it again with `diagnose`."
        )
    settings = {n: v for n, v in values.items() if n not in names}
    if finding.get("rotor") is not None:
        settings["rotor"] = float(finding["rotor"])
    return Hypothesis(finding["effect"], settings, {n: values.get(n, 0.0) for n in names})


def signals_of(vehicle: Vehicle, t_s: Array, motion: RigidMotion) -> Signals:
    """What the declared vehicle's signals would be along a motion, with a battery that hover empties in twelve minutes.

    Thrusts follow by inverse dynamics.
    """
    thrust = _nominal_wrench(vehicle, motion)[:, 2:] @ thrusts_for(vehicle).T
    motor = thrust if vehicle.rotors.input == "wrench" else vehicle.motor_for_thrust(thrust)
    load = np.sum(np.maximum(thrust, 0.0) ** 1.5, axis=1)
    hover = vehicle.rotors.count * (vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count) ** 1.5
    spent = np.cumsum(load / hover) * float(np.median(np.diff(t_s)))
    full = vehicle.battery.full_v or 1.0
    empty = vehicle.battery.empty_v or 0.85 * full
    return Signals(
        t_s=t_s,
        position_m=motion.position_m,
        velocity_world_m_s=motion.velocity_world_m_s,
        quaternion=quat_from_euler(*motion.euler_rad.T),
        rate_rad_s=motion.angular_velocity_body_rad_s,
        motor=motor,
        lagged=motor,
        lagged_rate=np.gradient(motor, t_s, axis=0),
        thrust_n=thrust,
        voltage_v=full - (full - empty) * (_SAG_IN_HOVER * load / hover + spent / _HOVER_S),
        charge_as=spent,
    )


_SAG_IN_HOVER = 0.2  # of the range from full to empty, by internal resistance at hover current
_HOVER_S = 720.0


def _nominal_wrench(vehicle: Vehicle, motion: RigidMotion) -> Array:
    """Body force and torque that the motion takes of the declared vehicle, shape (k, 6)."""
    tensor, rate = vehicle.inertia_tensor(), motion.angular_velocity_body_rad_s
    out = np.zeros((len(rate), 6))
    out[:, 2] = vehicle.mass_kg * motion.specific_thrust_m_s2
    out[:, 3:] = motion.angular_acceleration_body_rad_s2 @ tensor + np.cross(rate, rate @ tensor)
    return out


def _base_columns(motion: RigidMotion) -> Array:
    """Mass and the six entries of the tensor, shape (k, 6, 7)."""
    rate, turning = motion.angular_velocity_body_rad_s, motion.angular_acceleration_body_rad_s2
    out = np.zeros((len(rate), 6, 7))
    out[:, 2, 0] = motion.specific_thrust_m_s2
    out[:, 3:, 1:] = inertia_regressor(rate, turning)
    return out


def _shifted(values: Array, by_s: float, span_s: float, order: int = 0) -> Array:
    """Periodic samples (k, ...) over ``span_s``, ``by_s`` later, differentiated ``order`` times."""
    frequency = 2.0 * np.pi * np.arange(len(values) // 2 + 1) / span_s
    factor = np.exp(1j * frequency * by_s) * (1j * frequency) ** order
    return np.fft.irfft(np.fft.rfft(values, axis=0) * factor[:, None], len(values), axis=0)


def _few(variants: Sequence[Settings]) -> list[Settings]:
    """At most THRESHOLDS.rival_settings_most settings, evenly chosen."""
    index = np.unique(
        np.linspace(0, len(variants) - 1, min(THRESHOLDS.rival_settings_most, len(variants))).round().astype(int)
    )
    return [variants[i] for i in index]


def candidate(hypothesis: Hypothesis, vehicle: Vehicle, shared: Sequence[Hypothesis]) -> discriminate.Candidate:
    """A hypothesis as the planner takes it; mass, tensor and the shared findings are fitted anew under each."""

    def common(t_s: Array, motion: RigidMotion, signals: Signals) -> Array:
        parts = [_base_columns(motion)]
        for other in shared:
            effect = library()[other.effect]
            parts.append(effect.wrench(signals, vehicle, _on_plan(effect, other.settings, t_s)))
        return np.concatenate(parts, axis=2)

    if hypothesis.effect == NOTHING:
        return _nothing(vehicle, common)
    make = _timing if hypothesis.effect in TIMING else _forced
    return make(hypothesis, vehicle, common)


Common = Callable[[Array, RigidMotion, Signals], Array]


def _on_plan(effect: Effect, settings: Settings, t_s: Array) -> Settings:
    """Settings with their instants inside the plan: what happened in flight is taken to happen again."""
    span = float(t_s[-1] - t_s[0])
    return {n: float(np.clip(v, 0.2 * span, 0.8 * span)) if n in effect.instants else v for n, v in settings.items()}


def _forced(hypothesis: Hypothesis, vehicle: Vehicle, common: Common) -> discriminate.Candidate:
    """An effect of the library."""
    effect: Effect = library()[hypothesis.effect]

    def wrench(t_s: Array, motion: RigidMotion) -> Array:
        values = hypothesis.values or {}
        columns = effect.wrench(signals_of(vehicle, t_s, motion), vehicle, _on_plan(effect, hypothesis.settings, t_s))
        return columns @ effect.named_in(values)

    def explanations(t_s: Array, motion: RigidMotion) -> list[tuple[Array, Array]]:
        signals = signals_of(vehicle, t_s, motion)
        base = common(t_s, motion, signals)
        nothing = np.zeros((len(t_s), 6))
        variants = _few(list(effect.variants(signals, vehicle)))
        return [(nothing, np.concatenate([base, effect.of(v).wrench(signals, vehicle, v)], axis=2)) for v in variants]

    return discriminate.Candidate(hypothesis.effect, None if hypothesis.values is None else wrench, explanations)


def _nothing(vehicle: Vehicle, common: Common) -> discriminate.Candidate:
    """What is shared alone. It is a rival only: what explains more than it is never worse."""

    def explanations(t_s: Array, motion: RigidMotion) -> list[tuple[Array, Array]]:
        return [(np.zeros((len(t_s), 6)), common(t_s, motion, signals_of(vehicle, t_s, motion)))]

    return discriminate.Candidate(NOTHING, None, explanations)


def _timing(hypothesis: Hypothesis, vehicle: Vehicle, common: Common) -> discriminate.Candidate:
    """A lag, or a dead time (a clock's offset acts as one); the latter is linearised about its size."""
    shift = (hypothesis.values or {})["shift_s"]
    lags = hypothesis.effect == "motor_lag"

    def span(t_s: Array) -> float:
        return float(t_s[-1] - t_s[0]) * len(t_s) / (len(t_s) - 1)

    def wrench(t_s: Array, motion: RigidMotion) -> Array:
        needed = _nominal_wrench(vehicle, motion)
        if lags:
            return -shift * _shifted(needed, 0.0, span(t_s), 1)
        return needed - _shifted(needed, shift, span(t_s))

    def explanations(t_s: Array, motion: RigidMotion) -> list[tuple[Array, Array]]:
        base = common(t_s, motion, signals_of(vehicle, t_s, motion))
        slope = -_shifted(_nominal_wrench(vehicle, motion), 0.0 if lags else shift, span(t_s), 1)
        about = np.zeros((len(t_s), 6)) if lags else wrench(t_s, motion)
        return [(about, np.concatenate([base, slope[:, :, None]], axis=2))]

    return discriminate.Candidate(hypothesis.effect, wrench, explanations)


def plan_next(
    document: Document,
    vehicle: Vehicle,
    *,
    duration_s: float = DURATION_S,
    trials: int | None = None,
    seed: int = 3,
    progress: Callable[[float, str], None] = lambda fraction, text: None,
    **limits: float,
) -> discriminate.Separation:
    """The flight that tells the first unsettled finding of a diagnosis from its alternatives; where there is none, the
    one that shows best what it gives a hint of.

    Args:
        document: of schema groundstation.diagnosis/1. vehicle: as declared. duration_s: of the excitation.
        trials: motions tried (0.1 s each and more with more hypotheses); None for what takes a second or two.
        seed: of the search.
        progress: called with the share of the work that is done and a line of text.
        **limits: overrides of the vehicle's.

    Raises:
        Refused: nothing is open, or no motion tells it apart.
        BadInput: limits exclude hovering.
    """
    rivals, shared = contenders(document)
    _check_rotors((*rivals, *shared), vehicle)
    timing = any(h.effect in TIMING for h in rivals)
    bounds: dict[str, Any] = dict(limits)
    usual = HINT_TRIALS if rivals[-1].effect == NOTHING else max(6, 24 // len(rivals))
    return discriminate.plan_discrimination(
        vehicle,
        [candidate(h, vehicle, shared) for h in rivals],
        periods=(4, 8, 16) if timing else (2, 4, 8),
        frequency_max_hz=TIMING_FREQUENCY_MAX_HZ if timing else FREQUENCY_MAX_HZ,
        duration_s=duration_s,
        trials=usual if trials is None else trials,
        seed=seed,
        progress=progress,
        **bounds,
    )


def _check_rotors(hypotheses: Sequence[Hypothesis], vehicle: Vehicle) -> None:
    """Raise BadInput where a diagnosis names a rotor that the vehicle has not: it is another vehicle's."""
    for hypothesis in hypotheses:
        rotor = hypothesis.settings.get("rotor", 1.0)
        if not 1 <= rotor <= vehicle.rotors.count:
            raise BadInput(
                f"the diagnosis names rotor {rotor:g} of {hypothesis.effect}, {vehicle.name} has "
                f"{vehicle.rotors.count}; give this diagnosis' own vehicle with --vehicle."
            )


def odds_sentence(found: discriminate.Separation) -> str:
    """What the planned flight should settle, for a pilot: which pairs, with what odds, in which channel."""
    pair, log_odds = min(found.log_odds.items(), key=lambda item: item[1])
    names = list(dict.fromkeys(name for each in found.log_odds for name in each))
    odds = f"{np.exp(log_odds):.0f} to 1" if log_odds < THRESHOLDS.log_odds_most else "better than a million to 1"
    hardest = "" if len(names) == 2 else f"the hardest to part are {' and '.join(pair)}, "
    channel = max(found.channels, key=lambda name: found.channels[name])
    if names[-1] == NOTHING:
        return (
            f"a flight of {found.plan.series().duration_s:.0f} s that should show {names[0]} if it is there, at "
            f"expected odds of {odds}, mostly by {channel} (in the disturbance of a quiet room)."
        )
    return (
        f"a flight of {found.plan.series().duration_s:.0f} s that should tell {', '.join(names[:-1])} and {names[-1]} "
        f"apart, {hardest}at expected odds of {odds}, mostly by {channel} (in the disturbance of a quiet room, and if "
        "what happened happens again)."
    )
