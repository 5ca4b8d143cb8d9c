"""Entry point: ``python -P -m sim.mocap --system natnet``: emulated cameras that see a drone on a figure, until
Ctrl-C.
"""

from __future__ import annotations

import sys
import time
from contextlib import suppress

from sim.arguments import Parser
from sim.mocap.server import Server, Setup

SYSTEMS = ("natnet", "qtm", "vicon", "vrpn", "zenoh", "ros2", "mavlink")


def main(arguments: list[str] | None = None) -> int:
    """Run one server."""
    parser = Parser(prog="sim.mocap", description=__doc__)
    parser.add_argument("--system", choices=SYSTEMS, required=True)
    parser.add_argument("--port", type=int, default=0, help="port; a free one by default")
    parser.add_argument("--rate", type=float, default=200.0, help="frames per second")
    parser.add_argument("--body", action="append", help="names of the bodies: the drone, and one that stands still")
    options = parser.parse_args(arguments)
    names = tuple(options.body) if options.body else ("drone", "wand")
    with (
        Server(Setup(options.system, options.rate, port=options.port, names=names)) as server,
        suppress(KeyboardInterrupt),
    ):
        print(f"{options.system} at {server.host}: {', '.join(names)} at {options.rate:g} Hz", flush=True)
        while True:
            time.sleep(1.0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
