"""Odd flights, and whether anything that cannot be is published of them (``benchmarks.odd_flights``).

A flight may be short, gentle, lossy, on a tether, in a corner, declared wrongly, of two axes only, carried by hand, or
without rotor speeds. What comes out may be a refusal, a partial answer or a wrong number with a wide interval; never a
number that no vehicle has, one that was hidden elsewhere, NaN, or a model file that this program then refuses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation import api
from groundstation.analysis.analyse import identification_document, write_identification
from groundstation.diagnosis.published import published
from groundstation.diagnosis.results import Diagnosis
from groundstation.errors import GroundStationError, Refused
from groundstation.flightdata import FlightData, Stream
from groundstation.identification.physical_limits import inside_polygon
from groundstation.identification.results import MASS_AND_TENSOR, Identification
from groundstation.paths import find_config
from groundstation.planning import plan_excitation
from groundstation.recording.repair import repair
from groundstation.reporting.exports import read_model
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle, load_vehicle
from sim.flight import simulate
from sim.scenario import scenario_from_dict
from studies.flown import flight_data
from studies.hidden import world
from studies.unplanned import PLANNERS, as_recorded

Array = NDArray[np.float64]
Random = np.random.Generator
Changed = Callable[[FlightData, Random], FlightData]

DURATION_S = 14.0
"""Of the planned flights."""
TRIANGLE = 1.0 + 1e-6
"""By which rounding may break the triangle inequality of a published tensor."""


def _plan(vehicle: Vehicle, seed: int, **limits: float) -> Plan:
    return plan_excitation(vehicle, criterion="A", duration_s=DURATION_S, seed=seed, time_budget_s=1.0, **limits)


def _flown(
    seed: int,
    effects: Mapping[str, Any] | None = None,
    *,
    truth: Mapping[str, Any] | None = None,
    change: Callable[[Plan], Any] = lambda plan: plan,
    **limits: float,
) -> FlightData:
    """A planned flight of a vehicle of configs/ in a drawn laboratory."""
    random = np.random.default_rng([45, seed])
    vehicle = load_vehicle(find_config("vehicles", ("qball2", "x500", "crazyflie21")[seed % 3]))
    if vehicle.rotors.thrust_coefficient_n_s2 is None:
        vehicle = load_vehicle(find_config("vehicles", "x500"))
    scenario = world(random, dict(effects or {}), vehicle)
    document = scenario.model_dump(exclude_none=True, exclude={"effects"})
    document |= {"effects": dict(effects or {}), "truth": {**document["truth"], **(truth or {})}}
    document["state"] = {"rate_hz": 100.0}
    return flight_data(simulate(vehicle, change(_plan(vehicle, seed, **limits)), scenario_from_dict(document), seed))


def _two_axes(plan: Plan) -> Plan:
    """Without what moves it along y: roll answers the disturbance alone."""
    moved = plan.coefficients.y
    still = moved.model_copy(update={"a": tuple(0.0 for _ in moved.a), "b": tuple(0.0 for _ in moved.b)})
    return plan.model_copy(update={"coefficients": plan.coefficients.model_copy(update={"y": still})})


def _unplanned(seed: int, planner: str, speed: float) -> FlightData:
    random = np.random.default_rng([46, seed])
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    path = PLANNERS[planner](random, speed)
    flown = simulate(vehicle, path, world(random, {}, vehicle), seed)  # type: ignore[arg-type]
    return as_recorded(flight_data(flown), 0.02, 0.015)


def _part(flight: FlightData, start: float, end: float) -> FlightData:
    """A share of the flight's window, everything else cut off."""
    first, last = flight.window_s or (float(flight.imu.t_s[0]), float(flight.imu.t_s[-1]))
    low, high = first + start * (last - first), first + end * (last - first)
    streams = {n: s.select((s.t_s >= low) & (s.t_s <= high)) for n, s in flight.streams().items()}
    streams.pop("setpoint", None)
    return replace(flight, plan=None, setpoint=None, window_s=None, **streams)


def _lossy(flight: FlightData, random: Random, share: float) -> FlightData:
    kept = {n: s.select(random.random(len(s)) > share) for n, s in flight.streams().items()}
    return replace(flight, **kept)


def _values(flight: FlightData, name: str, change: Callable[[Array], Array]) -> FlightData:
    stream: Stream = getattr(flight, name)
    return replace(flight, **{name: replace(stream, values=change(stream.values.copy()))})


def _declared(flight: FlightData, **update: Any) -> FlightData:
    return replace(flight, vehicle=flight.vehicle.model_copy(update=update))


def _by_hand(flight: FlightData, random: Random) -> FlightData:
    """Rotors that idle, a body that is carried: what the IMU feels is the hand."""
    return _values(flight, "motors", lambda v: 0.05 * v + random.normal(0.0, 1.0, v.shape))


def _without_speeds(flight: FlightData) -> FlightData:
    """Commands that nobody measured, as the controller asked for: smooth, ahead of the rotors, half as large."""
    rotors = flight.vehicle.rotors.model_copy(update={"speed_source": "command"})
    held = _values(flight, "motors", lambda v: np.repeat(v[::25], 25, axis=0)[: len(v)])
    return replace(held, vehicle=flight.vehicle.model_copy(update={"rotors": rotors}))


def _stuck_rotor(flight: FlightData) -> FlightData:
    """One rotor's speed stays what it was at first."""
    return _values(flight, "motors", lambda v: np.column_stack([np.full(len(v), v[len(v) // 2, 0]), v[:, 1:]]))


CORNER = {
    "ground_effect": {},
    "attracting_wall": {"strength_n_m3": 1.5, "distance_m": 1.2},
    "wind": {"velocity_m_s": [1.5, -1.0, 0.0], "gust_m_s": 0.6},
}
GENTLE = {"speed_max_m_s": 0.2, "tilt_max_rad": 0.03}

FLIGHTS: dict[str, Callable[[int, Random], FlightData]] = {
    "as planned": lambda s, r: _flown(s),
    "5 s of it": lambda s, r: _part(_flown(s), 0.3, 0.66),
    "2 s of it": lambda s, r: _part(_flown(s), 0.4, 0.55),
    "gentle": lambda s, r: _flown(s, **GENTLE),
    "gentle, half of it": lambda s, r: _part(_flown(s, **GENTLE), 0.2, 0.7),
    "mass declared 1.3 times": lambda s, r: _declared(f := _flown(s), mass_kg=1.3 * f.vehicle.mass_kg),
    "mass declared 0.6 times": lambda s, r: _declared(f := _flown(s), mass_kg=0.6 * f.vehicle.mass_kg),
    "three times as heavy as declared": lambda s, r: _declared(f := _flown(s), mass_kg=f.vehicle.mass_kg / 3.0),
    "inertia of another vehicle": lambda s, r: _flown(s, truth={"inertia_factor": [2.5, 2.5, 2.5]}),
    "gyro's x mirrored": lambda s, r: _values(_flown(s), "imu", lambda v: v * [-1, 1, 1, 1, 1, 1]),
    "accelerometer's y mirrored": lambda s, r: _values(_flown(s), "imu", lambda v: v * [1, 1, 1, 1, -1, 1]),
    "positions' y mirrored": lambda s, r: _values(_flown(s), "mocap", lambda v: v * [1, -1, 1, 1, 1, 1, 1]),
    "rotors in another order": lambda s, r: _values(_flown(s), "motors", lambda v: v[:, [1, 0, *range(2, v.shape[1])]]),
    "a third of all samples lost": lambda s, r: _lossy(_flown(s), r, 0.33),
    "nine in ten samples lost": lambda s, r: _lossy(_flown(s), r, 0.9),
    "poses at 5 Hz": lambda s, r: (f := _flown(s)) and replace(f, mocap=f.mocap.select(slice(None, None, 20))),
    "roll does not move": lambda s, r: _flown(s, change=_two_axes),
    "carried by hand": lambda s, r: _by_hand(_flown(s), r),
    "commands that nobody measured": lambda s, r: _without_speeds(_flown(s)),
    "a rotor's speed is stuck": lambda s, r: _stuck_rotor(_flown(s)),
    "on a tether": lambda s, r: _flown(s, {"tether": {"stiffness_n_m": 3.0, "pull_n": 2.0}}),
    "in a corner": lambda s, r: _flown(s, CORNER),
    "without an IMU": lambda s, r: replace(_flown(s), imu=None),
    "without poses": lambda s, r: replace(_flown(s), mocap=None),
    "without poses, plan and setpoints": lambda s, r: replace(_flown(s), mocap=None, plan=None, setpoint=None),
    "a load let go": lambda s, r: _flown(s, {"payload_change": {"mass_kg": 0.25, "time_s": 20.0}}),
    "a load that swings": lambda s, r: _flown(s, {"slung_load": {"mass_kg": 0.2, "length_m": 0.5}}),
    "a rotor that fails": lambda s, r: _flown(s, {"rotor_degradation": {"rotor": 2, "loss": 0.3, "start_s": 18.0}}),
    "rattling": lambda s, r: _values(_flown(s), "imu", lambda v: v + r.normal(0.0, 1.0, v.shape) * [1, 1, 1, 8, 8, 8]),
    "a pilot": lambda s, r: _unplanned(s, "pilot", 1.0),
    "a pilot, slowly": lambda s, r: _unplanned(s, "pilot", 0.2),
    "figures, 8 s of them": lambda s, r: _part(_unplanned(s, "figures", 1.5), 0.4, 0.6),
    "waypoints, speeds a fifth too large": lambda s, r: _values(
        _unplanned(s, "waypoints", 1.0), "motors", lambda v: 1.2 * v
    ),
}
"""Thirty-three of them, each from a seed."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one flight.

    Attributes:
        said: verdicts and refusals, in order.
        faults: what is published and cannot be, in sentences. Empty is right.
    """

    said: list[str]
    faults: list[str]


def judged(flight: FlightData, folder: Path) -> Outcome:
    """Run what the commands ``identify``, ``predict`` and ``diagnose`` run, and look at everything they publish."""
    said: list[str] = []
    faults: list[str] = []
    try:
        flight = repair(flight)
    except GroundStationError as refusal:
        return Outcome([f"read: {refusal}"], faults)
    identification: Identification | None = None
    try:
        identification = api.identify(flight)
        said.append(f"identify: {identification.best}, hidden {sorted(identification.not_identifiable)}")
        said += [f"warning: {text}" for text in identification.warnings]
        faults += _identified(identification, flight.vehicle)
    except Refused as refusal:
        said.append(f"identify refused: {refusal}")
    diagnosis = api.diagnose(flight)
    hidden = dict.fromkeys(MASS_AND_TENSOR, "refused") if identification is None else identification.not_identifiable
    diagnosis = published(diagnosis, hidden)
    named = {f.effect: {n: [e.value, e.std] for n, e in f.parameters.items()} for f in diagnosis.findings}
    left = [f"{u.channel} by {', '.join(u.depends_on)}" for u in diagnosis.unexplained]
    said.append(f"diagnose: {diagnosis.verdict}, {named}, left {left}")
    said += [f"warning: {text}" for text in diagnosis.warnings]
    faults += _diagnosed(diagnosis, flight.vehicle, hidden)
    for name, found in (("identify", None), ("diagnose", diagnosis)):
        if identification is None:
            continue
        file = write_identification(folder, identification, flight.vehicle, found)["model"]
        faults += [f"{name}'s model: {fault}" for fault in _model(file, flight, hidden, said)]
    return Outcome(said, faults)


def _identified(found: Identification, vehicle: Vehicle) -> Iterator[str]:
    document = identification_document(found)
    yield from _not_finite(document, "identification")
    values = {n: e.value for n, e in (*found.methods[found.best].parameters.items(), *found.model.items())}
    yield from _impossible(values, vehicle, "identify")
    yield from (f"{n} is hidden and published" for n in found.not_identifiable if n in values)


def _diagnosed(found: Diagnosis, vehicle: Vehicle, hidden: Mapping[str, str]) -> Iterator[str]:
    yield from _not_finite(found.to_dict(), "diagnosis")
    after = {name: e.value for name, e in found.parameters_after.items()}
    yield from _impossible(after, vehicle, "diagnose")
    yield from (f"{n} is hidden by identify and published by diagnose" for n in hidden if n in after)
    for finding in found.findings:
        values = {name: e.value for name, e in finding.parameters.items()}
        yield from _impossible(values, vehicle, finding.effect)
        loss = values.get("loss", 0.0)
        if finding.effect in ("weak_rotor", "rotor_degradation") and not -0.5 <= loss <= 1.0:
            yield f"{finding.effect} of {loss:.3g}"
        if finding.effect in ("payload_change", "slung_load"):
            load = values.get("load_kg", values.get("mass_change_kg", 0.0))
            if abs(load) > vehicle.mass_kg:
                yield f"{finding.effect} of {load:.3g} kg on {vehicle.mass_kg:.3g} kg"
    no_base = hidden.keys() >= {"ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"} or "mass_kg" in hidden
    if found.verdict == "explained" and no_base:
        yield "explained on a base that is hidden"


def _model(file: Path, flight: FlightData, hidden: Mapping[str, str], said: list[str]) -> Iterator[str]:
    """What is wrong with a model file and with the predictions by it."""
    document = read_model(file)
    yield from _not_finite(document, "model file")
    values = {n: e["value"] for part in ("parameters", "model") for n, e in document.get(part, {}).items()}
    yield from _impossible(values, flight.vehicle, "model file")
    yield from (f"{n} is hidden and stands in the file" for n in hidden if n in values)
    for use in ("prediction", "physical"):
        try:
            predicted = api.predict(file, flight, use=use)  # type: ignore[arg-type]
        except Refused as refusal:
            said.append(f"predict refused: {refusal}")
            continue
        except GroundStationError as error:
            yield f"predict by {use} takes it for wrong input: {error}"
            continue
        yield from _not_finite(predicted.to_dict(), f"prediction by {use}")
        if not predicted.windows or not predicted.error["model"]:
            yield f"prediction by {use} is empty"
        if not np.isfinite(predicted.final["rate"]).all():  # the others are unknown where no pose starts a window
            yield f"a rate predicted by {use} is not finite"


def _not_finite(document: object, where: str) -> Iterator[str]:
    if isinstance(document, Mapping):
        for key, value in document.items():
            yield from _not_finite(value, f"{where}/{key}")
    elif isinstance(document, (list, tuple)):
        for value in document:
            yield from _not_finite(value, where)
    elif isinstance(document, (float, np.floating)) and not math.isfinite(document):
        yield f"{where} is {document}"


def _impossible(values: Mapping[str, float], vehicle: Vehicle, where: str) -> Iterator[str]:
    """Numbers that no such vehicle has."""
    mass = values.get("mass_kg", vehicle.mass_kg)
    if mass <= 0.0:
        yield f"{where}: a mass of {mass:.3g} kg"
    most = max(mass, vehicle.mass_kg) * (2.0 * vehicle.arm_m()) ** 2
    moments = {a: values[f"i{a}{a}_kg_m2"] for a in "xyz" if f"i{a}{a}_kg_m2" in values}
    yield from (f"{where}: i{a}{a} of {v:.3g} kg m^2" for a, v in moments.items() if not 0.0 < v <= most)
    if len(moments) == 3:
        tensor = np.diag(list(moments.values()))
        for (i, j), name in {(0, 1): "ixy", (0, 2): "ixz", (1, 2): "iyz"}.items():
            tensor[i, j] = tensor[j, i] = values.get(f"{name}_kg_m2", 0.0)
        principal = np.linalg.eigvalsh(tensor)
        if principal[0] <= 0.0 or principal[2] > TRIANGLE * (principal[0] + principal[1]):
            yield f"{where}: no rigid body has principal moments {principal}"
    yield from _impossible_rotors(values, vehicle, where)


def _impossible_rotors(values: Mapping[str, float], vehicle: Vehicle, where: str) -> Iterator[str]:
    declared = vehicle.rotors.thrust_coefficient_n_s2
    if declared and not 0.0 < values.get("thrust_coefficient_n_s2", declared) / declared < 3.0:
        yield f"{where}: {values['thrust_coefficient_n_s2'] / declared:.3g} times the declared thrust"
    centre = [values[name] for name in ("com_offset_x_m", "com_offset_y_m") if name in values]
    if len(centre) == 2 and not inside_polygon(np.array(centre), np.array(vehicle.rotors.position_m)[:, :2]):
        yield f"{where}: a centre of mass outside the rotors: {centre}"
    if not 0.0 < values.get("thrust_scale", 1.0) < 3.0:
        yield f"{where}: {values['thrust_scale']:.3g} times the declared thrust"
    for name, value in values.items():
        late = name.startswith(("rotor_lag_up", "rotor_lag_down", "input_delay", "delay_s"))
        if late and not 0.0 <= value < 1.0:
            yield f"{where}: {name} of {value:.3g} s"


def seeded(name: str, first: int) -> tuple[int, Random]:
    """Seed and generator of a flight."""
    seed = first + list(FLIGHTS).index(name)
    return seed, np.random.default_rng([47, seed])


def flight_of(name: str, first: int) -> FlightData:
    """One of FLIGHTS."""
    return FLIGHTS[name](*seeded(name, first))
