"""``python -P -m sim.mavlink``: an autopilot that is not there, on real sockets."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from groundstation.errors import BadInput, GroundStationError
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from sim.arguments import Parser
from sim.mavlink.process import DEFAULT_LINKS, Service, attach

DRIFT = {"px4": -0.012, "arducopter": 0.0}
"""Clock against the host's, as measured on the firmwares' simulations."""


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = Parser(
        prog="groundstation sim --mavlink",
        description="A simulated vehicle that speaks MAVLink as PX4 or ArduCopter do.",
        epilog="example: python -P -m sim.mavlink --profile px4 --vehicle x500 --scenario clean --seed 1",
    )
    parser.add_argument("--profile", choices=sorted(DEFAULT_LINKS), required=True, help="whose manners it has")
    parser.add_argument(
        "--vehicle", default="x500", metavar="FILE", help="vehicle file, or the name of a shipped one (x500)"
    )
    parser.add_argument("--scenario", metavar="FILE", help="scenario file or name; without one an ideal laboratory")
    parser.add_argument("--seed", type=int, default=0, help="of all noise")
    parser.add_argument(
        "--link", action="append", default=[], metavar="URL",
        help="udpout://HOST:PORT, udpin://HOST:PORT, tcpin://HOST:PORT, tcp://HOST:PORT or serial://DEVICE:BAUD; "
             "repeatable",
    )  # fmt: skip
    parser.add_argument("--real-time", type=float, default=1.0, metavar="SPEED", help="simulated seconds per second")
    parser.add_argument(
        "--clock-drift", type=float, metavar="SHARE", help="how much faster its clock runs than the host's"
    )
    parser.add_argument("--just-booted", action="store_true", help="begin with the start-up, not a minute after it")
    parser.add_argument("--scripting", action="store_true", help="ArduCopter runs Lua scripts (needs the package lupa)")
    parser.add_argument("--key-file", type=Path, metavar="FILE", help="32 bytes: sign and verify every frame")
    parser.add_argument(
        "--natnet", metavar="HOST:PORT", help="motion capture of it, as an OptiTrack server (127.0.0.1:1510)"
    )
    parser.add_argument(
        "--fault", action="append", default=[], metavar="NAME@SECONDS", help="something goes wrong then; repeatable"
    )
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run until interrupted; the exit status."""
    options = arguments(argv)
    try:
        vehicle = load_vehicle(find_config("vehicles", options.vehicle))
        service = _service(options, vehicle)
    except GroundStationError as error:
        print(f"sim.mavlink: {error}", file=sys.stderr)
        return error.exit_status
    print(f"{options.profile} flies {vehicle.name}", flush=True)
    service.run()
    return 0


def _service(options: argparse.Namespace, vehicle) -> Service:  # type: ignore[no-untyped-def]
    from sim.mavlink.arducopter import ArduCopter
    from sim.mavlink.faults import FaultSchedule, parse_fault
    from sim.mavlink.plant import SimulatedAirframe
    from sim.mavlink.px4 import Px4
    from sim.scenario import Scenario, load_scenario

    schedule = FaultSchedule([parse_fault(text) for text in options.fault])
    scenario = load_scenario(find_config("scenarios", options.scenario)) if options.scenario else Scenario()
    kind = Px4 if options.profile == "px4" else ArduCopter
    airframe = SimulatedAirframe(vehicle, scenario, seed=options.seed)
    airframe.step(kind.TICK_US * 1e-6, (0.0,) * vehicle.rotors.count)  # compiles before the clock starts
    if options.natnet:
        airframe.filmed_from(options.natnet)
    drift = DRIFT[options.profile] if options.clock_drift is None else options.clock_drift
    boot_s = 2.25 if options.just_booted else 60.0
    autopilot = kind(vehicle, airframe, boot_s=boot_s, clock_drift=drift, unix_s=time.time(), seed=options.seed)
    if options.scripting:
        if not isinstance(autopilot, ArduCopter):
            raise BadInput("--scripting: only ArduCopter runs scripts.")
        autopilot.enable_scripting()
    transports = attach(autopilot, tuple(options.link) or DEFAULT_LINKS[options.profile], key=_key(options.key_file))
    return Service(autopilot, transports, speed=options.real_time, faults=schedule)


def _key(path: Path | None) -> bytes | None:
    if path is None:
        return None
    try:
        key = path.read_bytes()
    except OSError as error:
        raise BadInput(f"--key-file {path}: cannot be read ({error.strerror}).") from None
    if len(key) != 32:
        raise BadInput(f"--key-file {path}: a signing key has 32 bytes, not {len(key)}.")
    return key


if __name__ == "__main__":
    sys.exit(main())
