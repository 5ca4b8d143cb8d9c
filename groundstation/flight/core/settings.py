"""The core process's command line: what one flight needs to know."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.access import Secrets, new_secrets, own_secrets


@dataclass(frozen=True, slots=True)
class Settings:
    """What one flight needs to know.

    ``drone`` is the module and arguments of the vehicle's process; ``take_over`` what it does with a vehicle in flight:
    the folder is then an interrupted flight's, and is continued.
    """

    folder: Path
    plan: Path
    vehicle: Path
    listen: tuple[str, ...]
    drone: tuple[str, ...]
    start: bool = False
    analyse: bool = True
    take_over: str = ""
    secrets: Secrets = field(default_factory=new_secrets, repr=False)


def parse(arguments: Sequence[str] | None) -> Settings:
    """The settings that a command line gives; the secrets come from the environment."""
    parser = argparse.ArgumentParser(
        prog="groundstation.flight.core.process", description="the core process of one flight"
    )
    parser.add_argument("--folder", type=Path, required=True, help="where this flight is kept")
    parser.add_argument("--plan", type=Path, required=True)
    parser.add_argument("--vehicle", type=Path, required=True)
    parser.add_argument("--listen", action="append", required=True, help="zenoh endpoint, e.g. tcp/127.0.0.1:7450")
    parser.add_argument("--start", action="store_true", help="fly as soon as the checks pass; else wait for a client")
    parser.add_argument("--no-analysis", action="store_true", help="end after landing")
    parser.add_argument("--take-over", default="", help="land or hold a vehicle found in flight; continues the folder")
    parser.add_argument("drone", nargs="+", help="module and arguments of the vehicle's process")
    options = parser.parse_args(arguments)
    return Settings(
        options.folder,
        options.plan,
        options.vehicle,
        tuple(options.listen),
        tuple(options.drone),
        options.start,
        not options.no_analysis,
        options.take_over,
        own_secrets(),
    )
