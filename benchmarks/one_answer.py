"""Three flights, every place that shows their estimate: the same digits. `python -m benchmarks.one_answer`

A simulated flight whose clocks differ (scenario seed), one with a weak rotor (worn), and one of PX4's own firmware (a
ULog file).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from groundstation import api
from groundstation.analysis.analyse import analyse
from groundstation.reporting.canonical import estimate_in, estimate_of
from groundstation.reporting.units import interval_text, label, scale_for, split_unit
from tests.one_answer import SHOWN, places

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results" / "one_answer.json"


def main() -> int:
    """Analyse each, ask each place; prints a table and keeps it as JSON."""
    parser = argparse.ArgumentParser(prog="benchmarks.one_answer", description=__doc__)
    parser.add_argument("--px4", type=Path, help="a ULog file of a PX4 vehicle")
    parser.add_argument("--vehicle", default="x500", help="of the ULog file")
    options = parser.parse_args()
    flights = {f"simulated, {name}": api.simulate("qball2", scenario=name, seed=1) for name in ("seed", "worn")}
    if options.px4:
        flights["PX4's firmware"] = api.load_flight(options.px4, vehicle=options.vehicle)
    document = {"schema": "groundstation.one_answer/1", "flights": {}}
    for number, (name, flight) in enumerate(flights.items()):
        with tempfile.TemporaryDirectory() as logs:
            folder = Path(logs) / f"flight-{number}"
            done = analyse([flight], folder)
            known = estimate_in(json.loads((folder / "identification.json").read_text(encoding="utf-8")))
            found = {n: e for n in SHOWN if (e := estimate_of(known[1].get(n))) is not None}
            told = {
                place: all(same(n, e) for n, e in found.items())
                for place, same in places(folder, flight.vehicle).items()
            }
        shown = {
            label(n): f"{interval_text(e, s)} {s.unit}"
            for n, e in found.items()
            if (s := scale_for(split_unit(n)[1], [e.value]))
        }
        document["flights"][name] = {
            "source": known[0],
            "verdict": done.diagnosis.verdict,
            "estimate": shown,
            "equal": told,
        }
        print(f"{name} ({known[0]}, {done.diagnosis.verdict}): {', '.join(f'{k} {v}' for k, v in shown.items())}")
        print(f"  equal in {sum(told.values())} of {len(told)} places: {', '.join(told)}", flush=True)
    RESULTS.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return 0 if all(all(f["equal"].values()) for f in document["flights"].values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
