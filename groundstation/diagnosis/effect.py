"""What an effect is to the diagnosis, and all of them.

One file per identifier of the effects' vocabulary in ``effects/``; each defines ``EFFECT``, by what shows it: a force
or torque (:class:`Effect`), the sensors among themselves (:class:`SensorEffect`), the base fit (:class:`FittedEffect`),
or nothing that flies (:class:`EffectInfo`). Adding one is adding a file. None of them shares a line with the simulator.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

if TYPE_CHECKING:  # the preparation is heavy to import, and only its type is needed
    from groundstation.identification.preparation import Prepared

Array = NDArray[np.float64]
Settings = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class ParameterInfo:
    """A parameter of an effect: name with unit last, scale of its prior, and what is physically plausible.

    The prior is the joint estimate's; infinite for what is estimated elsewhere. ``plausible`` is wide enough for every
    vehicle from 20 g to 10 kg; a force or torque outside of it is not named. A ``companion`` is fitted along and says
    nothing for the effect: a steady pull may come with a tether, but only the stiffness tells one. One that
    ``changes`` a setting is the first parameter times that setting's departure from its value: a finding gives the
    setting with an interval in its place. ``form`` is the share of its value (of the setting's) by which the formula
    itself may miss, as a standard deviation.
    """

    name: str
    prior_std: Callable[[Vehicle], float] = field(default=lambda vehicle: np.inf)
    plausible: tuple[float, float] = (-np.inf, np.inf)
    companion: bool = False
    changes: str = ""
    form: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectInfo:
    """What is known of an effect before any flight; nothing more where no flight shows it.

    Attributes:
        identifier: of the effects' vocabulary.
        equation, source: the model and where it is from.
        parameters: what is estimated.
        confused_with: identifiers that look alike; manoeuvre: what tells it from them.
    """

    identifier: str
    equation: str
    source: str
    parameters: tuple[ParameterInfo, ...]
    confused_with: tuple[str, ...]
    manoeuvre: str

    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def needed(self) -> tuple[str, ...]:
        """Names of the parameters that every finding has. What changes a setting is in that setting already, and a
        companion that was not estimated is nothing.
        """
        return tuple(p.name for p in self.parameters if not (p.changes or p.companion))

    def named_in(self, values: Mapping[str, float]) -> Array:
        """The parameters of a finding."""
        needed = self.needed()
        return np.array([values[name] if name in needed else values.get(name, 0.0) for name in self.names()])


Followed = Callable[[Signals, Signals | None], list[Array]]
"""From signals and planned signals of a part of a flight to wrenches there, (k, 6, p) each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect(EffectInfo):
    """A force or torque that a rigid body with known thrusts leaves out, linear in its parameters.

    Attributes:
        wrench: (signals, vehicle, settings) -> body force and torque about the declared origin per unit of each
            parameter, shape (k, 6, len(parameters)); NaN where the signals it needs are unknown.
        pointwise: the wrench at an instant follows from the signals at that instant and its neighbours, so that a long
            flight may be gone through in parts.
        followed: (signals and planned signals of a whole flight, vehicle, several settings, whether ``alone``) -> what
            gives the wrenches of these settings in any part of the flight, and behind them their instruments where
            planned signals are given; None where the instant tells all, or nothing less than the whole.
        instrument: (signals, planned signals, vehicle, settings) -> the wrench's instruments; None for ``wrench`` of
            the planned ones. What a pendulum does follows from the motion there was; by a plan it is soon out of step.
        straight: of an effect of one parameter that pushes in one direction all along: how hard, (k,), and the wrench
            of one, (6,); ``wrench`` is their product (:func:`pushing`). Many settings are then worked out at once.
        alone: the wrench's columns of those parameters that change no setting, (k, 6, own); None where the others are
            no further work.
        sentence: one sentence a pilot understands, with places for parameters and settings as :mod:`.sentences` says.
        variants: settings to try (a rotor, an instant, a length); one empty set for most effects.
        searched: (signals, samples in use, vehicle) -> settings that a search of the flight gives, tried in the place
            of ``variants``; ``scanned`` is of how many it is the outcome.
        finer: settings around one that was found, to look closer.
        settled: settings as they follow from the values that were found (a load that was let go was on board before).
        among: what is estimated of it in some settings; None for itself.
        spread: (settings, first parameter) -> standard deviations of settings; others are given without one.
        applies: whether this vehicle's inputs can show it at all.
        instants: settings that are instants of the flight, s, with a setting ``within_s`` beside them that ``finer``
            halves; a replay at another length keeps them inside it.
        of_one_rotor: its settings name a rotor, and a finding of it does.
        shared_by_healthy: healthy flights of one vehicle have it, too, so that it is fitted to all flights and never a
            finding beside them; the number is its place among those.
        bends_base: a base fit that lacks it takes its torque for inertia, so that the fit is tried with it; the number
            is its place.
        scenario: (values, vehicle) -> name and table of the simulator's form under ``[effects]``; None where
            ``reporting/scenario.py`` refits it or the simulator has no such effect.
        begun: (signals, vehicle, settings, index) -> ``wrench`` of windows that start at stamps ``index`` of a flight,
            at one instant after another; None where it depends on the instant alone.
        rests_on: identifiers of which one has to be there for it to mean anything (wind needs drag to be felt).
    """

    wrench: Callable[[Signals, Vehicle, Settings], Array]
    sentence: str
    pointwise: bool = False
    followed: Callable[[Signals, Signals | None, Vehicle, Sequence[Settings], bool], Followed] | None = None
    instrument: Callable[[Signals, Signals, Vehicle, Settings], Array] | None = None
    straight: Callable[[Signals, Vehicle, Settings], tuple[Array, Array]] | None = None
    alone: Callable[[Signals, Vehicle, Settings], Array] | None = None
    variants: Callable[[Signals, Vehicle], Sequence[Settings]] = field(default=lambda signals, vehicle: ({},))
    searched: Callable[[Signals, NDArray[np.bool_], Vehicle], Sequence[Settings]] | None = None
    scanned: int = 1
    among: Callable[[Settings], Effect] | None = None
    finer: Callable[[Settings], Sequence[Settings]] = field(default=lambda settings: ())
    settled: Callable[[Settings, Array], Settings] = field(default=lambda settings, values: settings)
    spread: Callable[[Settings, float], Mapping[str, float]] = field(default=lambda settings, value: {})
    applies: Callable[[Vehicle], bool] = field(default=lambda vehicle: True)
    begun: Callable[[Signals, Vehicle, Settings, NDArray[np.int64]], Callable[[Signals], Array]] | None = None
    rests_on: tuple[str, ...] = ()
    instants: tuple[str, ...] = ()
    of_one_rotor: bool = False
    shared_by_healthy: int | None = None
    bends_base: int | None = None
    scenario: Callable[[Mapping[str, float], Vehicle], tuple[str, dict[str, Any]]] | None = None

    def of(self, settings: Settings) -> Effect:
        """What is estimated of it in some settings."""
        return self if self.among is None else self.among(settings)

    def telling(self) -> list[int]:
        """Which of the parameters tell the effect."""
        return [index for index, parameter in enumerate(self.parameters) if not parameter.companion]

    def unchanged(self, signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
        """Wrench of the parameters that change no setting, (k, 6, own)."""
        if self.alone is not None:
            return self.alone(signals, vehicle, settings)
        own = [index for index, parameter in enumerate(self.parameters) if not parameter.changes]
        return self.wrench(signals, vehicle, settings)[:, :, own]

    def precision(self, vehicle: Vehicle) -> Array:
        """Prior precision of each parameter."""
        return np.array([1.0 / p.prior_std(vehicle) ** 2 for p in self.parameters])


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedEffect(EffectInfo):
    """An effect whose parameters the base fit frees, or gives beside mass and tensor: what they differ from is
    declared.

    Attributes:
        least: size below which it is no finding, in its parameters' unit.
        sentence: one sentence a pilot understands, with places for its parameters.
    """

    least: float
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Numbers of the flight-path reconstruction that an effect of the sensors shows in.

    Attributes:
        names: of the reconstruction (:attr:`.Compatibility.values`).
        parameters: what a finding calls them; ``sign`` turns them into the effect's sense.
        least: Euclidean norm of their departure from ``declared`` below which it is no finding.
        sentence: one sentence a pilot understands, with places for its parameters or for the departure's norm, {size}.
        applies: whether this flight can tell it.
        beside: further names, given where they are certain by themselves.
    """

    names: tuple[str, ...]
    parameters: tuple[str, ...]
    least: float
    sentence: str
    sign: float = 1.0
    declared: Callable[[Vehicle], Array] = field(default=lambda vehicle: np.zeros(1))
    applies: Callable[[Prepared], bool] = field(default=lambda prepared: True)
    beside: tuple[str, ...] = ()


ROTATION = tuple(f"mocap_rotation_{a}_rad" for a in "xyz")
"""The reconstruction's rotation of the tracked frame against the IMU."""
ROTATION_PARAMETERS = tuple(ParameterInfo(f"rotation_{a}_rad", plausible=(-np.pi, np.pi)) for a in "xyz")
"""What a finding calls it."""


def turned_reading(sentence: str, sign: float = 1.0) -> Reading:
    """The rotation between tracked frame and IMU, which an effect shows in with a sign of its own."""
    return Reading(
        names=ROTATION,
        parameters=tuple(parameter.name for parameter in ROTATION_PARAMETERS),
        least=np.deg2rad(0.3),
        sentence=sentence,
        sign=sign,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorEffect(EffectInfo):
    """A clock or a frame that is not what it was taken for: no force is missing, gyro, accelerometer and poses
    disagree.

    Attributes:
        readings: where it shows, clearest first; one that stands makes the finding.
    """

    readings: tuple[Reading, ...]


_REGISTERED: dict[str, EffectInfo] = {}


def register(effect: EffectInfo) -> None:
    """Add an effect to the catalogue of this process, or replace the one of its identifier; a file in ``effects/``
    stays.
    """
    _REGISTERED[effect.identifier] = effect
    library.cache_clear()


def catalogue() -> Mapping[str, EffectInfo]:
    """All effects by identifier, from the files in ``effects/`` and by :func:`register`."""
    package = importlib.import_module("groundstation.diagnosis.effects")
    modules = [importlib.import_module(f"{package.__name__}.{m.name}") for m in pkgutil.iter_modules(package.__path__)]
    return {module.EFFECT.identifier: module.EFFECT for module in modules} | _REGISTERED


@cache
def library() -> Mapping[str, Effect]:
    """Those with a force model, by identifier."""
    return {name: effect for name, effect in catalogue().items() if isinstance(effect, Effect)}


def blank(signals: Signals, parameters: int = 1) -> Annotated[Array, "k 6 p"]:
    """A wrench of zeros, shape (k, 6, parameters)."""
    return np.zeros((len(signals.t_s), 6, parameters))


def from_thrust(vehicle: Vehicle, thrust: Annotated[Array, "k n"]) -> Annotated[Array, "k 6"]:
    """Body wrench (k, 6) of rotor thrusts (k, n)."""
    from groundstation.model.rotors import wrench_matrix

    return np.asarray(thrust @ wrench_matrix(vehicle).T, dtype=float)


def from_inflow(vehicle: Vehicle, thrust: Annotated[Array, "k n"]) -> Annotated[Array, "k 6"]:
    """Body wrench (k, 6) of thrusts (k, n) that rotors gain or lose by the air through them, at the speed they turn.

    Their reaction torque stays. By blade element theory C_Q = lambda C_T + sigma C_d0 / 8 and dC_T / dlambda = -g C_T /
    lambda, so that dC_Q / dlambda = (1 - g) C_T: with g of 0.5 to 1 between a third of what the thrust loses, the other
    way, and nothing (Leishman 2006, sec. 2.14 and 3.3).
    """
    if not has_rotors(vehicle):
        return from_thrust(vehicle, thrust) * [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]
    axes = vehicle.rotors.axes()
    arms = np.cross(np.asarray(vehicle.rotors.position_m, dtype=float), axes)
    return np.asarray(thrust @ np.concatenate([axes, arms], axis=1), dtype=float)


def about_centre(vehicle: Vehicle, signals: Signals) -> Annotated[Array, "k 6 2"]:
    """Body wrench about the declared origin per metre that the centre of mass lies beside it along x and y: thrust has
    an arm, and the origin is carried round the centre.

    -c x F with F along z, and -m (omega' x c + omega x (omega x c)): Etkin & Reid 1996, sec. 4.3.
    """
    out, lift = blank(signals, 2), from_thrust(vehicle, signals.thrust_n)[:, 2]
    out[:, 4, 0], out[:, 3, 1] = lift, -lift
    rate = signals.rate_rad_s
    turning = np.gradient(rate, signals.t_s, axis=0) if len(rate) > 1 else np.zeros_like(rate)
    for axis in range(2):
        unit = np.eye(3)[axis]
        out[:, :3, axis] = -vehicle.mass_kg * (np.cross(turning, unit) + np.cross(rate, np.cross(rate, unit)))
    return out


def lift_of(vehicle: Vehicle, thrust: Annotated[Array, "k n"]) -> Annotated[Array, "k"]:
    """Body force along z (k,) of rotor thrusts (k, n)."""
    from groundstation.model.rotors import wrench_matrix

    return np.asarray(thrust @ wrench_matrix(vehicle)[2], dtype=float)


def rotor_wrench(vehicle: Vehicle, rotor: int) -> Annotated[Array, "6"]:
    """Body wrench (6,) of one newton of a rotor's thrust, by its number from zero."""
    from groundstation.model.rotors import wrench_matrix

    return np.asarray(wrench_matrix(vehicle)[:, rotor], dtype=float)


def pushing(
    straight: Callable[[Signals, Vehicle, Settings], tuple[Array, Array]],
) -> Callable[[Signals, Vehicle, Settings], Array]:
    """The wrench (k, 6, 1) of an effect that pushes in one direction."""

    def wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
        how_hard, direction = straight(signals, vehicle, settings)
        return (how_hard[:, None] * direction)[:, :, None]

    return wrench


def ramp(t_s: Annotated[Array, "k"], at_s: float, within_s: float) -> Annotated[Array, "k"]:
    """From zero to one within a time about an instant, shape as ``t_s``."""
    return np.clip((t_s - at_s) / within_s + 0.5, 0.0, 1.0)


def sharper(settings: Settings, instant: str) -> tuple[Settings, ...]:
    """Ramps of half the length about instants near the one found: a step is met only by those a fraction of it away."""
    length = settings["within_s"]
    shifts = np.linspace(-0.5, 0.5, 9)
    return tuple(
        {**settings, instant: settings[instant] + s * length, "within_s": 0.5 * length} for s in shifts.tolist()
    )


def has_rotors(vehicle: Vehicle) -> bool:
    """The recording tells what each rotor did."""
    return vehicle.rotors.input != "wrench"


def is_commanded(vehicle: Vehicle) -> bool:
    """The recording holds what was asked of the rotors, not what they did."""
    return vehicle.rotors.input == "command" or (
        vehicle.rotors.input == "rotor_speed" and vehicle.rotors.speed_source == "command"
    )


def weight(vehicle: Vehicle) -> float:
    """Declared weight, N."""
    return vehicle.mass_kg * vehicle.gravity_m_s2


@dataclass(frozen=True, slots=True)
class Acting:
    """Effects that act on a vehicle: each with its settings and its parameters."""

    parts: Sequence[tuple[Effect, Settings, Array]]
    vehicle: Vehicle

    def __call__(self, signals: Signals) -> Array:
        """Their wrench along a flight, (k, 6)."""
        columns = [effect.wrench(signals, self.vehicle, settings) for effect, settings, _ in self.parts]
        return self._total(signals, columns)

    def begun(self, signals: Signals, index: NDArray[np.int64]) -> Callable[[Signals], Array]:
        """Their wrench in windows that start at stamps ``index`` of a flight."""

        def plainly(effect: Effect, settings: Settings) -> Callable[[Signals], Array]:
            return lambda now: effect.wrench(now, self.vehicle, settings)

        going = [
            plainly(effect, settings) if effect.begun is None else effect.begun(signals, self.vehicle, settings, index)
            for effect, settings, _ in self.parts
        ]
        return lambda now: self._total(now, [wrench(now) for wrench in going])

    def _total(self, signals: Signals, columns: Sequence[Array]) -> Array:
        out = np.zeros((len(signals.t_s), 6))
        for own, (_, _, values) in zip(columns, self.parts, strict=True):
            out += own @ values
        return out


class _Numbers(dict[str, float]):
    """Parameters and settings of an effect in a model document; one that is missing is named."""

    def __init__(self, name: str, values: Mapping[str, Mapping[str, float]]) -> None:
        super().__init__({key: float(entry["value"]) for key, entry in values.items()})
        self._name = name

    def __missing__(self, key: str) -> float:
        raise BadInput(f"the model's effect '{self._name}' lacks '{key}'; write the model again with `report`.")


def wrench_of(effects: Mapping[str, Mapping[str, Mapping[str, float]]], vehicle: Vehicle) -> Acting:
    """Total body wrench (k, 6) of a model document's effects, name -> parameter -> {value, std}; settings among them.

    A second finding of an effect stands under "name/2".

    Raises:
        BadInput: an effect lacks a parameter, or, when its wrench is asked for, a setting.
    """
    parts: list[tuple[Effect, Settings, Array]] = []
    for name, values in effects.items():
        effect = library().get(name.partition("/")[0])
        if effect is not None:
            numbers = _Numbers(name, values)
            parts.append((effect, numbers, effect.named_in(numbers)))
    return Acting(parts, vehicle)


def shared_by_healthy() -> list[Effect]:
    """What healthy flights of one vehicle share, in the order of the joint estimate."""
    found = [
        (effect.shared_by_healthy, effect) for effect in library().values() if effect.shared_by_healthy is not None
    ]
    return [effect for _, effect in sorted(found, key=lambda pair: pair[0])]


def bending() -> list[Effect]:
    """Effects whose torque depends on the motion as inertia's does, in the order of the fit."""
    found = [(effect.bends_base, effect) for effect in library().values() if effect.bends_base is not None]
    return [effect for _, effect in sorted(found, key=lambda pair: pair[0])]
