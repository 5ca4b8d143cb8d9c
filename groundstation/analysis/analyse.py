"""What happens to a recording after landing: identify, diagnose, report. One function for the core's worker and the
CLI.

    python -P -m groundstation.analysis.analyse FOLDER

waits for a line on standard input and prints one JSON document per line on standard output: ``{"progress": 0.4, "text":
"...", "table": {...}}``.
"""

from __future__ import annotations

import importlib
import json
import math
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation.analysis.documents import finite, refusal, write_json
from groundstation.diagnosis.published import published
from groundstation.diagnosis.results import Diagnosis
from groundstation.errors import GroundStationError, NotIdentifiable, Refused
from groundstation.flightdata import FlightData
from groundstation.identification.results import MASS_AND_TENSOR, Estimate, Identification
from groundstation.json_types import JsonObject
from groundstation.options import DEFAULT_OPTIONS, AnalysisOptions
from groundstation.priority import set_nice
from groundstation.vehicle import Vehicle

if TYPE_CHECKING:
    from groundstation.identification.work import Work

AUGMENTED = "with findings"
"""The parameter set of the augmented model among the validations."""
Progress = Callable[[float, str], None]
Table = dict[str, tuple[float, float, float, float]]


@dataclass(frozen=True, slots=True)
class Analysis:
    """Results and the files they were written to, by name ("report", "identification", ...)."""

    identification: Identification
    diagnosis: Diagnosis
    files: Mapping[str, Path]


def parameter_table(
    identification: Identification, declared: Mapping[str, float], diagnosis: Diagnosis | None = None
) -> Table:
    """Rows nominal, estimate, low, high of mass and tensor as every place shows them; NaN where the flight does not
    tell.
    """
    from groundstation.reporting.canonical import canonical

    return _rows(canonical(identification, diagnosis).parameters, declared)


def _rows(
    parameters: Mapping[str, Estimate], declared: Mapping[str, float], names: Sequence[str] = MASS_AND_TENSOR
) -> Table:
    rows: Table = {}
    for name in names:
        estimate = parameters.get(name)
        value, (low, high) = (math.nan, (math.nan, math.nan)) if estimate is None else (estimate.value, estimate.ci95)
        rows[name] = (declared.get(name, math.nan), value, low, high)
    return rows


def preliminary(flight: FlightData) -> Table:
    """Weighted least squares with a centre of mass: ready in a third of a second; a first look, not the answer."""
    from groundstation.identification.preliminary import NAMES, first_estimate

    declared = flight.vehicle.parameters()
    return _rows(first_estimate(flight), {name: declared.get(name, 0.0) for name in NAMES}, NAMES)


def evolution(flight: FlightData) -> JsonObject:
    """How the live estimates moved during a flight, with their 95 % intervals; views draw it."""
    from groundstation.identification.recursive import SHOWN, replay

    found = replay(flight)
    columns: dict[str, Any] = {}
    for name in SHOWN:
        told = [(e.t_s, e.parameters[name]) for e in found if name in e.parameters]
        columns[name] = {
            "t_s": [t_s for t_s, _ in told],
            "value": [e.value for _, e in told],
            "low": [e.ci95[0] for _, e in told],
            "high": [e.ci95[1] for _, e in told],
        }
    return {"schema": "groundstation.evolution/1", "flight": flight.name, "parameters": columns}


def analyse(
    flights: Sequence[FlightData],
    folder: Path,
    options: AnalysisOptions = DEFAULT_OPTIONS,
    *,
    progress: Progress = lambda fraction, text: None,
    source: str | None = None,
) -> Analysis:
    """Identify, diagnose and report into ``folder``. A diagnosis that refuses or fails never costs the report.

    Args:
        options: stretches to leave out, references, flights kept for judging.
        source: the recordings and options as on the command line, for the report's commands that repeat it.

    Raises:
        Refused: the flights do not tell; the report holds the reason and the remedy.
        BadInput: a flight is malformed.
    """
    from groundstation.diagnosis.doubted import identify
    from groundstation.identification.work import Work
    from groundstation.reporting.report import write_report

    folder.mkdir(parents=True, exist_ok=True)
    work = Work()
    try:
        identifying = AnalysisOptions(exclude=options.exclude)
        identification = identify(
            flights,
            identifying,
            predictive=True,
            progress=lambda f, text: progress(0.05 + 0.5 * f, text),
            work=work,
        )
    except Refused as error:
        write_report(folder / "report.html", flights[0], error, source=source)
        raise
    write_identification(folder, identification, flights[0].vehicle)
    write_json(folder / "evolution.json", evolution(flights[0]))
    diagnosis = _diagnose(flights, options, lambda f, text: progress(0.55 + 0.35 * f, text), work)
    diagnosis = published(diagnosis, identification.not_identifiable)
    diagnosis, plan = with_next_flight(folder, diagnosis, flights[0].vehicle)
    identification = with_augmented_loop(flights[0], identification, diagnosis, options)
    files = write_identification(folder, identification, flights[0].vehicle, diagnosis)
    if plan is not None:
        files["next_flight"] = plan
    files["diagnosis"] = write_json(folder / "diagnosis.json", diagnosis.to_dict())
    progress(0.92, "writing the report")
    files["report"] = write_report(folder / "report.html", flights[0], identification, diagnosis, source=source)
    progress(1.0, "done")
    return Analysis(identification, diagnosis, files)


def _diagnose(flights: Sequence[FlightData], options: AnalysisOptions, progress: Progress, work: Work) -> Diagnosis:
    from groundstation.diagnosis import diagnose

    first = flights[0]
    try:
        return diagnose(flights, options, progress=progress, work=work)
    except Refused as error:
        return Diagnosis(first.name, first.vehicle.name, "refused", reason=str(error))
    except Exception as error:
        traceback.print_exc()
        reason = f"the diagnosis failed ({type(error).__name__}: {error}); this is a defect"
        return Diagnosis(first.name, first.vehicle.name, "refused", reason=reason)


def with_augmented_loop(
    flight: FlightData,
    identification: Identification,
    diagnosis: Diagnosis,
    options: AnalysisOptions = DEFAULT_OPTIONS,
) -> Identification:
    """Where the closed loop was simulated, the same with the augmented model: parameters and forces of the findings."""
    from groundstation.diagnosis.effect import wrench_of
    from groundstation.identification.validation import closed_loop_validation, parameter_sets
    from groundstation.reporting.exports import model_document

    loop = next((check for check in identification.validation if check.kind == "closed_loop"), None)
    if loop is None or not diagnosis.findings or flight.plan is None:
        return identification
    effects = model_document(identification, flight.vehicle, diagnosis)["effects"]
    values = {name: estimate.value for name, estimate in diagnosis.parameters_after.items()}
    nominal = parameter_sets(flight.vehicle, {})["nominal"]
    sets = {AUGMENTED: {name: values.get(name, declared) for name, declared in nominal.items()}}
    again = closed_loop_validation(
        flight,
        sets,
        mocap_minus_imu_s=identification.clock.mocap_minus_imu_s if identification.clock is not None else 0.0,
        exclude=options.exclude,
        wrenches={AUGMENTED: wrench_of(effects, flight.vehicle)},
    )
    both = replace(loop, rms={**loop.rms, **again.rms})
    return replace(identification, validation=tuple(both if c is loop else c for c in identification.validation))


HINT_TRIALS_AT_ONCE = 60
"""Motions tried for a hint while its flight's results are waited for, about two seconds."""


def with_next_flight(folder: Path, diagnosis: Diagnosis, vehicle: Vehicle) -> tuple[Diagnosis, Path | None]:
    """Where explanations remain, the plan that tells them apart as ``next_flight.toml``, named in the diagnosis; else
    the one for its first hint.

    Where no motion tells them apart, the diagnosis stays as it is: it names the manoeuvre or the measurement.
    """
    from groundstation.analysis.plans import write_plan
    from groundstation.diagnosis.next_flight import odds_sentence, plan_next

    open_ones = any(finding.alternatives for finding in diagnosis.findings)
    if not open_ones and not diagnosis.hints:
        return diagnosis, None
    try:
        found = plan_next(diagnosis.to_dict(), vehicle, trials=None if open_ones else HINT_TRIALS_AT_ONCE)
    except GroundStationError:
        return diagnosis, None
    path = write_plan(found.plan, folder / "next_flight.toml")
    text = f"{diagnosis.next_flight} Planned as {path.name}: {odds_sentence(found)}".strip()
    return replace(diagnosis, next_flight=text), path


def identification_document(identification: Identification, diagnosis: Diagnosis | None = None) -> JsonObject:
    """The document of an identification with the one estimate that every place shows, as ``estimate``."""
    from groundstation.reporting.canonical import canonical

    return {**identification.to_dict(), "estimate": canonical(identification, diagnosis).to_dict()}


def write_identification(
    folder: Path, identification: Identification, vehicle: Vehicle, diagnosis: Diagnosis | None = None
) -> dict[str, Path]:
    """``identification.json``, and as ``identification.toml`` the model that ``predict`` and ``export`` take."""
    from groundstation.reporting.exports import model_document, write_model

    return {
        "identification": write_json(
            folder / "identification.json", identification_document(identification, diagnosis)
        ),
        "model": write_model(folder / "identification.toml", model_document(identification, vehicle, diagnosis)),
    }


def _say(fraction: float, text: str, table: Table | None = None) -> None:
    print(json.dumps(finite({"progress": fraction, "text": text, **({"table": table} if table else {})})), flush=True)


def warm_up() -> None:
    """Import what takes seconds while the flight still goes on, behind everything that flies."""
    set_nice(5)
    for module in ("recording", "identification.preliminary", "identification.seed", "reporting", "diagnosis"):
        importlib.import_module(f"groundstation.{module}")


def first_look(flight: FlightData) -> None:
    """Show the preliminary table. What goes wrong here is told, and never costs the analysis proper."""
    try:
        _say(0.04, "preliminary: weighted least squares", preliminary(flight))
    except NotIdentifiable as error:
        _say(0.04, str(error))
    except Exception as error:
        traceback.print_exc()
        _say(0.04, f"no preliminary result ({type(error).__name__})")


def main(folder: Path) -> int:
    """The worker: waits for a line, then a preliminary table first, then everything."""
    try:
        warm_up()
        if not sys.stdin.readline():
            return 0  # whoever was to say "go" is gone
        from groundstation.recording import load_flight

        _say(0.01, "reading the recording")
        flight = load_flight(folder / "flight.mcap")
        first_look(flight)
        analysis = analyse([flight], folder, progress=_say)
        table = parameter_table(analysis.identification, flight.vehicle.parameters(), analysis.diagnosis)
        _say(1.0, f"identified by {analysis.identification.best}", table)
        return 0
    except Refused as error:
        write_json(folder / "refused.json", refusal(error))
        _say(1.0, str(error))
        return error.exit_status
    except GroundStationError as error:
        _say(1.0, str(error))
        return error.exit_status
    except Exception:
        traceback.print_exc()
        return 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
