"""Three 1 kHz logs of a Crazyflie 2.1 identified together, and the body rate it predicts on a part that no fit has
seen.

Run with ``python -m benchmarks.crazyflie DATA``, where DATA holds log10, log15 and log16 (© 2024 Jonas Eschmann, MIT);
the output is kept in docs/crazyflie.md. Against: constant rate; the declared vehicle (pendulum and bench values of
Foerster 2015); and the constants the logs' authors published (moments 1.03, 1.11 and 1.95e-5 kg m^2, one lag of 72 to
75 ms, accelerometer scaled by 9.18).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification.pipeline import identify
from groundstation.identification.predictive_choice import chosen_name, chosen_predictor
from groundstation.model.vehicle_model import declared_model, model_from_document
from groundstation.paths import find_config
from groundstation.recording import load_flight
from groundstation.reporting.exports import model_document
from groundstation.vehicle import load_vehicle
from studies.crazyflie import SEEN, UNSEEN, lateral_force, published, table


def main() -> None:
    """Identify, predict, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("data", type=Path)
    data: Path = parser.parse_args().data
    vehicle = load_vehicle(find_config("vehicles", "crazyflie21"))

    def load(part: tuple[str, float, float]) -> FlightData:
        return load_flight(data / part[0], vehicle=vehicle, start_s=part[1], end_s=part[2])

    for chosen in (SEEN, *((part,) for part in SEEN)):
        print("\n" + " + ".join(f"{name} {first:g} to {last:g} s" for name, first, last in chosen) + "\n")
        try:
            found = identify([load(part) for part in chosen], predictive=chosen is SEEN)
        except Refused as error:
            print(error)
            continue
        values = {**found.methods[found.best].parameters, **found.model}
        print("| parameter | estimate | 95 % interval |\n|---|---|---|")
        for name, e in values.items():
            if "bias" not in name:
                print(f"| {name} | {e.value:.4g} | {e.ci95[0]:.4g} .. {e.ci95[1]:.4g} |")
        for name, remedy in found.not_identifiable.items():
            print(f"| {name} | no number | {remedy} |")
        if chosen is SEEN:
            document = model_document(found, vehicle)
            known = model_from_document(document, vehicle)
            theirs = published(document, vehicle)
            models = {
                f"what predicts: {chosen_name(document)}": chosen_predictor(document, known),
                "identified together": known,
                "published constants": theirs,
                "declared": declared_model(vehicle),
                "identified, no disturbance carried on": replace(known, disturbance=None),
                "published constants, our disturbance carried on": replace(theirs, disturbance=known.disturbance),
            }
    print("\nLateral force in the torque that each fit leaves\n")
    print("| part | of roll | of pitch | height by roll | height by pitch |\n|---|---|---|---|---|")
    for part in (*SEEN, *UNSEEN):
        print(f"| {part[0]} {part[1]:g} to {part[2]:g} s | {lateral_force(load(part))} |")
    for part in UNSEEN:
        print(f"\nRMS error of the predicted body rate, rad/s, {part[0]} {part[1]:g} to {part[2]:g} s\n")
        print(table(models, load(part)))


if __name__ == "__main__":
    main()
