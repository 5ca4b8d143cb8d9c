"""What the residual still depends on when every named effect has been taken out: all there is for the unknown.

For each variable a smooth basis (hat functions over its quantiles) is offered to each channel, through the same
instruments and whitening as an effect; its joint Wald statistic against chance, shared among all pairs, is the measure.
It sees nonlinear dependence, and colour is in the noise model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.along import Along, Beside
from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.comparison import residual_rms
from groundstation.diagnosis.course import joined
from groundstation.diagnosis.discrepancy import Discrepancy
from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, from_thrust, weight
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import WRENCH_ROW, FlightEvidence
from groundstation.diagnosis.results import Unexplained
from groundstation.diagnosis.rivals import Entry
from groundstation.diagnosis.signals import hat_functions
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.frames import euler_from_quat
from groundstation.identification.parts import parts_of
from groundstation.identification.record_model import CHANNELS
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


def _yaw(signals: Signals) -> Array:
    return np.unwrap(euler_from_quat(signals.quaternion)[:, 2])


VARIABLES: dict[str, Callable[[Signals], Array]] = {
    "position_x_m": lambda s: s.position_m[:, 0],
    "position_y_m": lambda s: s.position_m[:, 1],
    "position_z_m": lambda s: s.position_m[:, 2],
    "velocity_x_m_s": lambda s: s.velocity_body_m_s()[:, 0],
    "velocity_y_m_s": lambda s: s.velocity_body_m_s()[:, 1],
    "velocity_z_m_s": lambda s: s.velocity_body_m_s()[:, 2],
    "yaw_rad": _yaw,
    "roll_rad": lambda s: euler_from_quat(s.quaternion)[:, 0],
    "pitch_rad": lambda s: euler_from_quat(s.quaternion)[:, 1],
    "rate_x_rad_s": lambda s: s.rate_rad_s[:, 0],
    "rate_y_rad_s": lambda s: s.rate_rad_s[:, 1],
    "rate_z_rad_s": lambda s: s.rate_rad_s[:, 2],
    "thrust_n": lambda s: s.thrust_n.sum(axis=1),
    "thrust_rate": lambda s: np.gradient(s.thrust_n.sum(axis=1), s.t_s),
    "voltage_v": lambda s: s.voltage_v,
    "time_s": lambda s: s.t_s,
}


UNWRAPPED = frozenset({"yaw_rad"})
"""Which of them goes on from turn to turn, so that a part of a flight tells it but for whole turns."""


@dataclass(frozen=True, slots=True)
class Dependence:
    """A dependence of one channel on one variable that chance does not make."""

    channel: str
    variable: str
    margin: float
    share: float


def _hats(name: str, knots: Array) -> Callable[[Signals], Array]:
    """Hat functions of a variable over knots, but the first, (k, knots - 1)."""
    return lambda signals: hat_functions(VARIABLES[name](signals), knots)[:, 1:]


def dependences(evidence: Evidence, chosen: Sequence[Entry], shared: int = 0) -> list[Dependence]:
    """Every pair of channel and variable that still shows beyond chance, strongest first.

    As an effect has to (:func:`.selection.select`), the strongest of each channel stands against the noise with nothing
    but it and the chosen kept out, too. Whatever else is kept out takes noise along, most of it slow: on a flight of a
    quarter of a minute more than is left.

    Args:
        chosen: effects of the joint estimate; the first ``shared`` of them act on all flights.
    """
    found = _shown(evidence, chosen, None)
    if not found:
        return found
    strongest = {d.channel: d for d in reversed(found)}
    kept_out = (*(candidate for candidate, _ in chosen), *(_candidate(evidence, d) for d in strongest.values()))
    suspects = [flight.beside(kept_out, generic=False) for flight in evidence.flights[: evidence.suspects]]
    anew = Evidence(suspects, evidence.flights[evidence.suspects :])
    entries = ((c, anew.columns(c, everywhere=number < shared)) for number, (c, _) in enumerate(chosen))
    again = _shown(anew, [(c, columns) for c, columns in entries if columns is not None], found)
    standing = {(d.channel, d.variable) for d in again}
    return [d for d in found if (d.channel, d.variable) in standing]


def _candidate(evidence: Evidence, dependence: Dependence) -> Candidate:
    """A dependence as an effect: the force or torque of its channel as a function of its variable."""
    flight = evidence.flights[0]
    hats = _hats_of(dependence.variable, flight, flight.prepared.record.keep)
    row, name = WRENCH_ROW[CHANNELS.index(dependence.channel)], f"{dependence.channel} by {dependence.variable}"

    def wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
        values = np.zeros((0, 0)) if hats is None else hats(signals)
        out = np.zeros((len(values), 6, values.shape[1]))
        out[:, row] = values
        return out

    parameters = tuple(ParameterInfo(f"{name}, {knot}") for knot in range(1, THRESHOLDS.dependence_knots))
    return Candidate(
        Effect(
            identifier=name,
            equation="",
            source="",
            parameters=parameters,
            confused_with=(),
            manoeuvre="",
            wrench=wrench,
            pointwise=dependence.variable not in UNWRAPPED,
            sentence="",
        ),
        {},
    )


def _hats_of(name: str, flight: FlightEvidence, kept: NDArray[np.bool_]) -> Callable[[Signals], Array] | None:
    """Hat functions over the quantiles of a variable on a flight; None where it is unknown or hardly varies."""
    values = VARIABLES[name](flight.signals)
    if not np.isfinite(values).all() or np.ptp(values[kept]) < 1e-9:
        return None
    knots = np.unique(np.quantile(values[kept], np.linspace(0.0, 1.0, THRESHOLDS.dependence_knots)))
    return None if len(knots) < 4 else _hats(name, knots)


def _shown(evidence: Evidence, chosen: Sequence[Entry], among: Sequence[Dependence] | None) -> list[Dependence]:
    """Pairs of channel and variable that show beyond chance in an evidence, strongest first; of some or of all."""
    looked, beside = _Looked.at(evidence, chosen), Beside(evidence, chosen)
    wanted = None if among is None else {(d.channel, d.variable) for d in among}
    found: list[Dependence] = []
    for name in VARIABLES:
        channels = [c for c in looked.channels if wanted is None or (CHANNELS[c], name) in wanted]
        hats = _hats_of(name, looked.flight, looked.kept) if channels else None
        if hats is None:
            continue
        told = beside.along(hats, channels, looked.prior, pointwise=name not in UNWRAPPED)
        for channel, estimate in told.items():
            if (shown := looked.shown(name, channel, estimate, hats)) is not None:
                found.append(shown)
    return sorted(found, key=lambda d: -d.margin)


@dataclass(frozen=True, slots=True)
class _Looked:
    """What is compared with when the residual of a selection is searched for dependences.

    Attributes:
        flight: the first. kept: its samples in use, (k,).
        scales: of each channel, the least size that matters. channels: those that leave as much.
        energy: of form errors by channel, (6,).
    """

    evidence: Evidence
    chosen: Sequence[tuple[Candidate, Columns]]
    flight: FlightEvidence
    kept: NDArray[np.bool_]
    scales: Mapping[int, float]
    channels: Sequence[int]
    energy: Array

    @classmethod
    def at(cls, evidence: Evidence, chosen: Sequence[tuple[Candidate, Columns]]) -> _Looked:
        """From the joint estimate of a selection."""
        first = evidence.flights[0]
        vehicle = first.prepared.record.vehicle
        discrepancy, solution = Discrepancy(evidence), evidence.solve(chosen)
        left = residual_rms(evidence, chosen, solution)
        scales = {
            c: THRESHOLDS.material_share * weight(vehicle) * (vehicle.arm_m() if c < 3 else 1.0) for c in first.channels
        }
        return cls(
            evidence=evidence,
            chosen=chosen,
            flight=first,
            kept=first.prepared.record.keep,
            scales=scales,
            channels=[c for c in first.channels if left[c] >= scales[c]],  # nothing material can hide in less
            energy=discrepancy.energies(chosen, solution).sum(axis=0) + discrepancy.of_lag(solution),
        )

    def prior(self, channel: int) -> float:
        """Precision of the height of a hat function: a fifth of the weight, or of weight times arm."""
        vehicle = self.flight.prepared.record.vehicle
        return 1.0 / (0.2 * weight(vehicle) * (vehicle.arm_m() if channel < 3 else 1.0)) ** 2

    def _named(self, row: int) -> Array:
        """Of the wrench of a constant, thrust and what is named already, a row, (k, p)."""
        course, pieces = self.flight.course, list[Array]()
        known = [course.seen_wrench_of(candidate) for candidate, _ in self.chosen]
        whole = [None if way.pointwise else way.made(course.signals, None)[0][:, row] for way in known]
        for part in parts_of(len(course.signals.t_s)):
            now = course.signals.at(part)
            lift = from_thrust(course.vehicle, now.thrust_n)[:, row, None]
            own = [
                way.made(now, None)[0][:, row] if other is None else other[part]
                for way, other in zip(known, whole, strict=True)
            ]
            pieces.append(np.concatenate([np.ones_like(lift), lift, *own], axis=1))
        return joined(pieces)

    def shown(self, name: str, channel: int, estimate: Along, hats: Callable[[Signals], Array]) -> Dependence | None:
        """The dependence of a channel on a variable; None where chance, form errors or what is named make it."""
        pairs = len(VARIABLES) * len(self.flight.channels)
        margin = (
            estimate.wald()
            - self.evidence.threshold_of(estimate.energy, THRESHOLDS.dependence_chance / pairs)
            - THRESHOLDS.form_error_share**2 * self.energy[channel]
        )
        if margin <= 0.0:
            return None
        named = self._named(WRENCH_ROW[channel])
        size = _own_size(hats(self.flight.signals), estimate.values, estimate.covariance, named, self.kept)
        if size < self.scales[channel]:
            return None
        disturbance = disturbance_std(self.evidence, channel)
        return Dependence(CHANNELS[channel], name, margin, size**2 / (size**2 + disturbance**2))


def _own_size(part: Array, values: Array, covariance: Array, explained: Array, kept: NDArray[np.bool_]) -> float:
    """Standard deviation of what a dependence adds to what a constant, thrust and the named effects could give.

    Noise in its coefficients makes a size of its own, trace(G cov), which is taken out: what matters to nobody is not
    made large by a basis that is known badly.
    """
    size: Array = np.linalg.norm(explained[kept], axis=0) + 1e-30
    columns = explained[kept] / size
    own = part[kept] - columns @ np.linalg.lstsq(columns, part[kept], rcond=1e-8)[0]
    own = own - np.asarray(own.mean(axis=0), dtype=float)
    gram = own.T @ own / len(own)
    return float(np.sqrt(max(values @ gram @ values - np.trace(gram @ covariance), 0.0)))


def disturbance_std(evidence: Evidence, channel: int) -> float:
    """Standard deviation of the fitted disturbance of a channel, N or N m."""
    flight = evidence.flights[0]
    colour = flight.whitening.colours[flight.channels.index(channel)]
    scale = float(flight.parameters.tensor[channel, channel]) if channel < 3 else flight.parameters.mass_kg
    return colour.disturbance * scale


def unexplained(found: Sequence[Dependence]) -> tuple[Unexplained, ...]:
    """Dependences gathered by channel: share of the largest, variables in order of evidence within half of the
    strongest.
    """
    out: list[Unexplained] = []
    for channel in dict.fromkeys(d.channel for d in found):
        mine = [d for d in found if d.channel == channel]
        strong = tuple(d.variable for d in mine if d.margin > 0.5 * mine[0].margin)
        out.append(Unexplained(channel, round(float(max(d.share for d in mine)), 4), strong[:4]))
    return tuple(out)
