"""Start the simulated drone: ``python -P -m sim --connect tcp/127.0.0.1:7447 --vehicle qball2 --scenario seed``."""

from __future__ import annotations

import argparse
import sys

from groundstation.errors import GroundStationError
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from sim.arguments import Parser


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = Parser(prog="groundstation sim", description="A simulated drone on the bus.")
    parser.add_argument("--drone", default="drone1", help="its name on the bus")
    parser.add_argument(
        "--connect", required=True, metavar="ENDPOINT", help="where the core listens, tcp/127.0.0.1:PORT"
    )
    parser.add_argument("--vehicle", default="qball2", help="vehicle file, or the name of a shipped one")
    parser.add_argument("--scenario", default="seed", help="scenario file, or the name of a shipped one")
    parser.add_argument("--seed", type=int, default=1, help="of all noise; same seed, same flight")
    parser.add_argument("--real-time", action="store_true", help="pace by the wall clock instead of by credit")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run the drone; returns the exit status."""
    options = arguments(argv)
    from sim.process import serve_drone
    from sim.scenario import load_scenario

    try:
        vehicle = load_vehicle(find_config("vehicles", options.vehicle))
        scenario = load_scenario(find_config("scenarios", options.scenario))
        serve_drone(options.drone, options.connect, vehicle, scenario, options.seed, real_time=options.real_time)
    except GroundStationError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    except ConnectionError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
