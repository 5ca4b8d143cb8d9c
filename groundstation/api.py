"""The Python API: one flight in, a model with intervals out. Commands and terminal UI call the same functions.

    from groundstation import api
    found = api.identify(flight := api.simulate("qball2", scenario="lab"))
    api.plot(found, flight).savefig("parameters.svg")

Vehicles, plans and scenarios are given as objects, as files, or by the name of a shipped one. Units are SI and stand at
the end of each name; angles are radians. The world has z up; the body has x forward, y left, z up; quaternions are
scalar first. Results have ``to_dict()`` (the JSON document of the command), ``records()`` and ``to_frame()`` (pandas,
where it is installed). Each function raises :class:`~groundstation.errors.BadInput` for wrong input and
:class:`~groundstation.errors.Refused` where the data cannot answer; both say what to do.
"""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from groundstation.errors import BadInput, GroundStationError, NotIdentifiable, Refused
from groundstation.json_types import Document, JsonObject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from groundstation.analysis.analyse import Analysis
    from groundstation.diagnosis.effect import EffectInfo
    from groundstation.diagnosis.results import Diagnosis
    from groundstation.fleet.comparison import Comparison
    from groundstation.flightdata import FlightData
    from groundstation.identification.results import Identification
    from groundstation.identification.work import Work
    from groundstation.model.prediction import Prediction
    from groundstation.planning.discriminate import Separation
    from groundstation.reporting.compare import Flown
    from groundstation.reporting.plots import Plottable
    from groundstation.trajectory import Plan
    from groundstation.vehicle import Vehicle

    Comparable = FlightData | Analysis | Identification | str | Path

__all__ = [
    "BadInput",
    "GroundStationError",
    "NotIdentifiable",
    "Refused",
    "analyse",
    "compare",
    "diagnose",
    "export",
    "identify",
    "load_flight",
    "load_plan",
    "load_scenario",
    "load_vehicle",
    "model_document",
    "plan_excitation",
    "plan_next_flight",
    "plot",
    "predict",
    "register_effect",
    "simulate",
    "write_report",
]

Progress = Callable[[float, str], None]
"""Called with the share of the work that is done (0 to 1) and what is being done."""


def _quiet(fraction: float, text: str) -> None:
    """No progress."""


def load_vehicle(vehicle: Vehicle | str | Path) -> Vehicle:
    """A declared vehicle: geometry, mass, tensor, rotors, limits.

    Args:
        vehicle: a vehicle file, or the name of a shipped one ("qball2", "x500", "crazyflie21").

    Examples:
        >>> load_vehicle("qball2").mass_kg
        1.79
    """
    from groundstation.paths import find_config
    from groundstation.vehicle import Vehicle, load_vehicle

    return vehicle if isinstance(vehicle, Vehicle) else load_vehicle(find_config("vehicles", vehicle))


def load_plan(plan: Plan | str | Path) -> Plan:
    """An excitation plan: a Fourier series in x, y, z (m) and yaw (rad).

    Args:
        plan: a plan file, or the name of a shipped one ("qball2", "paper_table2").

    Examples:
        >>> load_plan("qball2").series().duration_s
        40.0
    """
    from groundstation.paths import find_config
    from groundstation.trajectory import Plan, load_plan

    return plan if isinstance(plan, Plan) else load_plan(find_config("plans", plan))


def load_scenario(name: str | Path) -> JsonObject:
    """The document of a scenario, to be changed and given to :func:`simulate`: sensors, disturbance, true vehicle,
    effects.

    Args:
        name: a scenario file, or the name of a shipped one ("clean", "lab", "worn", "hall", "seed").

    Examples:
        >>> sorted(load_scenario("clean"))
        ['control', 'imu', 'mocap', 'motors', 'name', 'truth']
    """
    from groundstation.paths import find_config

    path = find_config("scenarios", name)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise BadInput(f"{path}: is not valid TOML ({error}); correct it there.") from None


def register_effect(effect: EffectInfo) -> None:
    """Add an effect of your own to what :func:`diagnose` tries, in this process.

    Args:
        effect: a :class:`groundstation.diagnosis.effect.Effect`: a wrench per unit of each parameter, shape (k, 6, n),
            N and N m in the body; parameters with plausible ranges; a sentence for people.
    """
    from groundstation.diagnosis.effect import register

    register(effect)


def load_flight(
    path: str | Path,
    *,
    vehicle: Vehicle | str | Path | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    everything: bool = False,
) -> FlightData:
    """Read a flight: MCAP recording, bundle folder, PX4 ULog, ArduPilot DataFlash, blackbox, ROS 2 bag or Crazyflie usd
    log.

    Args:
        path: the recording, or the folder of a flight.
        vehicle: replaces the vehicle declared in the recording; needed for a log that carries none.
        start_s: use the flight from this time on, s.
        end_s: use the flight up to this time, s.
        everything: use all of a flight of more than ten minutes, of which else the most informative stretch is used.

    Returns:
        Streams ``imu``, ``motors``, ``mocap``, ``battery``, ``setpoint``, ``state`` (None where it was not recorded).
        Each has ``t_s``, shape (k,), seconds on the device's clock, and ``values``, shape (k, len(columns)), units in
        the column names.
    """
    from groundstation.recording import load_flight

    declared = None if vehicle is None else load_vehicle(vehicle)
    return load_flight(path, vehicle=declared, start_s=start_s, end_s=end_s, everything=everything)


def plan_excitation(
    vehicle: Vehicle | str | Path | Sequence[Vehicle], *, progress: Progress = _quiet, **options: Any
) -> Plan:
    """The best excitation trajectory found for a vehicle within its limits.

    Args:
        vehicle: the vehicle, or several candidates for what it may be (then the worst case counts).
        progress: told how far the search is.
        **options: of :func:`groundstation.planning.plan_excitation`: ``criterion`` ("condition", "D", "A", "E"),
            ``duration_s``, ``harmonics``, ``base_frequency_rad_s``, ``seed``, ``time_budget_s``, and limits by their
            names (``x_max_m``, ``speed_max_m_s``, ``tilt_max_rad``, ...).

    Returns:
        A plan with ``coefficients``, ``condition_number`` and ``predicted_std`` (parameter -> standard deviation, SI).
    """
    from groundstation.planning import plan_excitation

    if isinstance(vehicle, Sequence) and not isinstance(vehicle, str):
        return plan_excitation(list(vehicle), progress=progress, **options)
    return plan_excitation(load_vehicle(vehicle), progress=progress, **options)


def simulate(
    vehicle: Vehicle | str | Path = "qball2",
    *,
    scenario: Document | str | Path = "seed",
    plan: Plan | str | Path | None = None,
    seed: int = 1,
    folder: str | Path | None = None,
) -> FlightData:
    """Fly a plan with the simulated drone, which runs as a process of its own; the same seed is the same flight.

    Args:
        vehicle: as declared; the scenario says how the true one differs.
        scenario: sensors, disturbance, true vehicle, effects: a scenario file, a shipped name ("clean", "lab", "worn",
            "hall", "seed"), or the document itself.
        plan: what to fly; by default the plan shipped for the vehicle, else a new one.
        seed: of all noise.
        folder: an empty or new folder that keeps the flight as a bundle; by default nothing is kept.

    Returns:
        The recorded flight, as :func:`load_flight` gives it, with the true vehicle as ``truth``.
    """
    from groundstation.flight.client.simulate import simulate

    declared = load_vehicle(vehicle)
    flown = _default_plan(declared) if plan is None else load_plan(plan)
    if folder is not None:
        return simulate(declared, flown, scenario, seed, Path(folder))
    with tempfile.TemporaryDirectory(prefix="groundstation-") as place:
        return simulate(declared, flown, scenario, seed, Path(place) / f"{declared.name}-{seed}")


def _default_plan(vehicle: Vehicle) -> Plan:
    """The plan shipped for a vehicle of this name, else a new one of 20 s."""
    try:
        return load_plan(vehicle.name)
    except BadInput:
        return plan_excitation(vehicle, duration_s=20.0, time_budget_s=4.0)


def _listed(flights: FlightData | Sequence[FlightData]) -> list[FlightData]:
    from groundstation.flightdata import FlightData

    return [flights] if isinstance(flights, FlightData) else list(flights)


def identify(
    flights: FlightData | Sequence[FlightData],
    *,
    exclude: Sequence[tuple[float, float]] = (),
    predictive: bool = True,
    progress: Progress = _quiet,
    work: Work | None = None,
) -> Identification:
    """Mass, inertia tensor, lag and thrust constants with 95 % intervals.

    Args:
        flights: one flight, or several of the same vehicle, which are pooled.
        exclude: parts (start, end) to leave out, seconds on the IMU's clock.
        predictive: also fit the model that predicts best (``prediction``), which takes some seconds.
        progress: told the fraction done and what is being done.
        work: what another analysis of the same flights has worked out, or where it is kept for one.

    Returns:
        ``methods[best].parameters`` maps each name to an estimate with ``value``, ``std``, ``ci95`` in the unit the
        name carries; ``model`` has lag, delay and thrust constants; what the flight does not reveal is in
        ``not_identifiable``.
    """
    from groundstation.diagnosis.doubted import identify
    from groundstation.options import AnalysisOptions

    options = AnalysisOptions(exclude=tuple(exclude))
    return identify(_listed(flights), options, predictive=predictive, progress=progress, work=work)


def diagnose(
    flights: FlightData | Sequence[FlightData],
    *,
    exclude: Sequence[tuple[float, float]] = (),
    references: Sequence[FlightData] = (),
    held_out: Sequence[FlightData] = (),
    model: Document | str | Path | None = None,
    progress: Progress = _quiet,
    work: Work | None = None,
) -> Diagnosis:
    """Which effects the declared vehicle lacks, with the error before and after on data that no estimate saw.

    Args:
        flights: one flight, or several of the same vehicle, which are pooled.
        exclude: parts (start, end) of them to leave out, seconds on the IMU's clock.
        references: healthy flights of the same vehicle; findings are then what differs from them.
        held_out: flights that are kept for judging.
        model: a model document or its file; what it holds is known, and findings are what it lacks.
        progress: told the fraction done and what is being done.
        work: as :func:`identify` takes it.

    Returns:
        ``verdict`` ("clean", "explained", "unexplained", "refused"), ``findings`` with parameters and confidence,
        ``error`` (RMS in N and N m by channel, before and after), ``next_flight`` in words.
    """
    from groundstation.diagnosis import diagnose
    from groundstation.options import AnalysisOptions

    groups = (_listed(flights), list(references), list(held_out))
    known: Mapping[str, Any] = {}
    if model is not None:
        from groundstation.reporting.exports import read_model
        from groundstation.reporting.identified import identified_from_document

        document = dict(model) if isinstance(model, Mapping) else read_model(model)
        known = document["effects"]
        vehicle = identified_from_document(document).vehicle
        groups = tuple([replace(flight, vehicle=vehicle) for flight in group] for group in groups)
    suspects, healthy, judges = groups
    options = AnalysisOptions(tuple(exclude), tuple(healthy), tuple(judges), known)
    return diagnose(suspects, options, progress=progress, work=work)


def model_document(identification: Identification, vehicle: Vehicle, diagnosis: Diagnosis | None = None) -> JsonObject:
    """The model as ``identification.toml`` holds it: what :func:`predict` and :func:`export` read.

    Args:
        identification: of the flight.
        vehicle: as declared (``flight.vehicle``).
        diagnosis: its findings become part of the model, with mass and tensor re-estimated beside them.
    """
    from groundstation.reporting.exports import model_document

    return model_document(identification, vehicle, diagnosis)


def predict(
    model: Document | str | Path,
    flight: FlightData,
    *,
    horizon_s: float = 0.5,
    own_state: bool = False,
    use: Literal["prediction", "physical"] = "prediction",
    progress: Progress = _quiet,
) -> Prediction:
    """Simulate ahead from every sample of a flight with its recorded inputs, and say how far off the model is.

    Args:
        model: a model document (:func:`model_document`), or the file it is in.
        flight: another flight of the vehicle.
        horizon_s: how far ahead, 0.01 to 10 s.
        own_state: start from and judge by the vehicle's own estimate instead of the smoothed state.
        use: the model's ``prediction`` part, where it has one, or its physical one. The former is held back towards
            constant velocity as far as it has missed of late in this flight.
        progress: told the fraction done and what is being done.

    Returns:
        ``error[predictor][horizon][quantity]["rms"]`` for the model, the declared vehicle and constant velocity:
        position (m), velocity (m/s), attitude (rad), body rate (rad/s). ``final`` holds the states predicted at the
        horizon: position and velocity (k, 3), quaternion (k, 4), rate (k, 3).
    """
    from groundstation.diagnosis.effect import library, wrench_of
    from groundstation.identification.predictive_choice import chosen_name, chosen_predictor
    from groundstation.identification.starts import flight_states
    from groundstation.model.prediction import predict
    from groundstation.model.vehicle_model import model_from_document
    from groundstation.reporting.exports import read_model
    from groundstation.vehicle import vehicle_from_dict

    document: dict[str, Any] = dict(model) if isinstance(model, Mapping) else read_model(model)
    declared = vehicle_from_dict(document["vehicle"], "the model" if isinstance(model, Mapping) else str(model))
    effects = document.get("effects", {})
    wrench = wrench_of(effects, declared) if any(name.partition("/")[0] in library() for name in effects) else None
    states = flight_states(flight, own=own_state)
    physical = model_from_document(document, declared, wrench)
    read = document if use == "prediction" else {}
    name = chosen_name(read)
    predictor = chosen_predictor(read, physical)
    return predict(
        predictor, states, horizon_s=horizon_s, predictor=name, hold_back="prediction" in read, progress=progress
    )


def plan_next_flight(
    diagnosis: Diagnosis | Document,
    vehicle: Vehicle | str | Path,
    *,
    duration_s: float | None = None,
    trials: int | None = None,
    seed: int = 3,
    progress: Progress = _quiet,
    **limits: float,
) -> Separation:
    """The flight that tells apart what a diagnosis left open, or else shows best what it gives a hint of.

    Args:
        diagnosis: the result of :func:`diagnose`, or its document.
        vehicle: as declared.
        duration_s: of the excitation, s.
        trials: motions tried, 0.1 s each; None for a second or two of search.
        seed: of the search.
        progress: told how far the search is.
        **limits: values that replace those of the vehicle's limits.

    Returns:
        ``plan``, and ``log_odds`` per pair of explanations: what the flight is expected to settle.
    """
    from groundstation.diagnosis.next_flight import DURATION_S, plan_next

    document = diagnosis if isinstance(diagnosis, Mapping) else diagnosis.to_dict()
    return plan_next(
        document,
        load_vehicle(vehicle),
        duration_s=duration_s or DURATION_S,
        trials=trials,
        seed=seed,
        progress=progress,
        **limits,
    )


def write_report(
    path: str | Path, flight: FlightData, identification: Identification | Refused, diagnosis: Diagnosis | None = None
) -> Path:
    """Write the HTML report of a flight: one file that opens without a network. Returns its path."""
    from groundstation.reporting.report import write_report

    return write_report(path, flight, identification, diagnosis)


def analyse(
    flights: FlightData | Sequence[FlightData],
    folder: str | Path,
    *,
    exclude: Sequence[tuple[float, float]] = (),
    references: Sequence[FlightData] = (),
    held_out: Sequence[FlightData] = (),
    progress: Progress = _quiet,
    source: str | None = None,
) -> Analysis:
    """Identify, diagnose and write everything into a folder: report, model, JSON documents, the next flight's plan.

    Arguments as in :func:`identify` and :func:`diagnose`; ``source`` is how the flights are named in the report's
    commands. The result has ``identification``, ``diagnosis`` and ``files``.
    """
    from groundstation.analysis.analyse import analyse
    from groundstation.options import AnalysisOptions

    options = AnalysisOptions(tuple(exclude), tuple(references), tuple(held_out))
    return analyse(_listed(flights), Path(folder), options, progress=progress, source=source)


def compare(
    first: Comparable | Sequence[Comparable],
    second: Comparable | Sequence[Comparable],
    *,
    progress: Progress = _quiet,
) -> Comparison:
    """What differs between two flights, or between two groups of flights: the numbers of ``compare`` and ``flights
    --compare``.

    Args:
        first, second: each a flight or a list of flights: the folder of one that was analysed, the result of
            :func:`analyse` or :func:`identify`, or a recording (:func:`load_flight`), which is analysed now.
        progress: told how far that is.

    Returns:
        ``parameters`` maps each name that both sides tell to ``first``, ``second``, ``size`` (second less first),
        ``std``, ``z``, ``p`` (corrected for the number of parameters), ``differs`` and ``change`` (in words);
        ``summary`` is a sentence. A group's value is the random-effects mean of its flights, so flights that scatter
        more than they say count for less.
    """
    from groundstation.fleet.comparison import compare_flights

    sides = [[_flown(one, progress) for one in _one_or_more(side)] for side in (first, second)]
    return compare_flights(*sides)


def _one_or_more(given: Comparable | Sequence[Comparable]) -> Sequence[Comparable]:
    return given if isinstance(given, Sequence) and not isinstance(given, str) else [given]


def _flown(given: Comparable, progress: Progress) -> Flown:
    """A flight's documents, as the analysis leaves them."""
    from groundstation.analysis.analyse import Analysis, identification_document
    from groundstation.flightdata import FlightData
    from groundstation.identification.results import Identification
    from groundstation.reporting.compare import Flown, read_flown

    if isinstance(given, FlightData):
        with tempfile.TemporaryDirectory(prefix="groundstation-") as folder:
            given = analyse(given, folder, progress=progress)
    if isinstance(given, Identification):
        return Flown(given.flight, identification_document(given), {})
    if isinstance(given, Analysis):
        found = identification_document(given.identification, given.diagnosis)
        return Flown(given.identification.flight, found, given.diagnosis.to_dict())
    return read_flown(Path(given))


def export(
    model: Document | str | Path,
    format_name: str,
    *,
    vehicle: Vehicle | str | Path | None = None,
    path: str | Path | None = None,
) -> str:
    """An identified model in the format of a simulator or autopilot.

    Args:
        model: a model document (:func:`model_document`), or the file it is in.
        format_name: "toml", "json", "csv", "vehicle", "mjcf", "rotorpy", "px4-sih", ... (``groundstation export
            --help``).
        vehicle: replaces the vehicle declared in the model.
        path: also write it there.
    """
    from groundstation.reporting.exports import export
    from groundstation.writing import write_whole

    text = export(model, format_name, None if vehicle is None else load_vehicle(vehicle))
    if path is not None:
        write_whole(path, text)
    return text


def plot(result: Plottable, flight: FlightData | None = None) -> Figure:
    """A matplotlib figure of a result: a flight, a plan, an identification, a diagnosis or a prediction.

    A flight: path and tilt. A plan: its channels. An identification: each parameter with its 95 % interval, and with a
    ``flight`` the declared value and, in simulation, the true one. A diagnosis: RMS error before and after. A
    prediction: RMS error by horizon.
    """
    from groundstation.reporting.plots import plot

    return plot(result, flight)
