"""Our side of Tables 3 to 12: the paper's processing, methods and validations on the simulated flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from groundstation.flightdata import FlightData
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.identification.seed import Regressions, filtered_regression, seed_methods, standard_regression
from groundstation.identification.seed_signals import Processing, process_flight
from groundstation.identification.validation import closed_loop_validation, output_validation, parameter_sets
from groundstation.reproduction.flights import CLOCK_S, Truth, circle_plan, fly, identification_plan
from groundstation.reproduction.published import CIRCLES, FILTERED, METHODS, STANDARD

PAPER_PERIOD_S = 0.002
"""The paper's T, at which its filter pair (35)-(36) is run here too."""
POSE_PERIOD_S = 1.0 / 30.0

Columns = Mapping[str, Mapping[str, float]]
Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class Ours:
    """What one true vehicle gave.

    Attributes:
        truth: the vehicle.
        parameters: Table 3 by method, and "nominal" and "truth".
        std: their claimed standard deviations, by method.
        closed_loop: Table 4, angles in degrees.
        outputs: Tables 5-12 by number.
        slow_fmls: FMLS with the filter pair (35)-(36) run at the poses' 30 Hz instead of 500 Hz.
        cutoff_hz: of the low-pass that the identification flight went through.
    """

    truth: Truth
    parameters: Columns
    std: Columns
    closed_loop: Columns
    outputs: Mapping[int, Columns]
    slow_fmls: Mapping[str, float]
    cutoff_hz: float


def run(truth: Truth, folder: Path, progress: Progress, *, circles: bool = True) -> Ours:
    """Fly, identify and validate as the paper does.

    Args:
        truth: the true vehicle.
        folder: where the flights go.
        progress: told the share done and what is being done.
        circles: fly those too (Tables 7-12).
    """
    progress(0.0, f"flying Table 2's trajectory ({truth.name})")
    plan = identification_plan()
    flight = fly(plan, truth, 1, folder / "identification")
    signals = process_flight(flight, Processing(mocap_minus_imu_s=CLOCK_S, accelerometer=False))
    methods = seed_methods(Regressions.of(signals, filter_period_s=PAPER_PERIOD_S), flight.vehicle, refuse=False)
    sets = parameter_sets(flight.vehicle, methods)
    progress(0.3, "simulating the closed loop with each parameter set")
    loop = closed_loop_validation(replace(flight, plan=plan), sets, mocap_minus_imu_s=CLOCK_S).rms
    outputs: dict[int, Columns] = dict(zip((5, 6), _outputs(flight, sets), strict=True))
    if circles:
        for index, (name, (radius, altitude)) in enumerate(CIRCLES.items()):
            progress(0.4 + 0.2 * index, f"flying {name}")
            circle = fly(circle_plan(radius, altitude), truth, 2 + index, folder / name.replace(" ", "-"))
            outputs |= dict(zip((7 + 2 * index, 8 + 2 * index), _outputs(circle, sets), strict=True))
    tensor = _truth_set(flight)
    return Ours(
        truth=truth,
        parameters={**sets, "truth": tensor},
        std={name: {key: methods[name].parameters[key].std for key in MASS_AND_TENSOR} for name in METHODS},
        closed_loop={name: _degrees(signals_rms) for name, signals_rms in loop.items()},
        outputs=outputs,
        slow_fmls=_slow_fmls(flight),
        cutoff_hz=signals.cutoff_hz,
    )


def _outputs(flight: FlightData, sets: Columns) -> tuple[Columns, Columns]:
    """RMS output errors on the standard and on the filtered model over the whole 50 s."""
    signals = process_flight(flight, Processing(mocap_minus_imu_s=CLOCK_S, accelerometer=False, transient_s=0.0))
    filtered = filtered_regression(signals, period_s=PAPER_PERIOD_S)
    return (
        output_validation(standard_regression(signals), _of(sets, STANDARD)).rms,
        output_validation(filtered, _of(sets, FILTERED)).rms,
    )


def _slow_fmls(flight: FlightData) -> dict[str, float]:
    """FMLS as it comes out if all is sampled at the poses' rate and the filters' T is that."""
    signals = process_flight(flight, Processing(mocap_minus_imu_s=CLOCK_S, accelerometer=False, period_s=POSE_PERIOD_S))
    result = seed_methods(Regressions.of(signals, filter_period_s=POSE_PERIOD_S), flight.vehicle, refuse=False)["FMLS"]
    return {key: result.parameters[key].value for key in MASS_AND_TENSOR}


def _of(sets: Columns, methods: tuple[str, ...]) -> Columns:
    return {name: sets[name] for name in ("nominal", *methods)}


def _truth_set(flight: FlightData) -> dict[str, float]:
    truth = flight.truth or flight.vehicle
    entries = (truth.mass_kg, *truth.inertia_tensor()[np.triu_indices(3)])
    return dict(zip(MASS_AND_TENSOR, map(float, entries), strict=True))


def _degrees(rms: Mapping[str, float]) -> dict[str, float]:
    return {
        key.replace("_rad", "_deg"): float(np.rad2deg(value)) if key.endswith("_rad") else value
        for key, value in rms.items()
    }
