"""``groundstation doctor`` and ``reproduce``."""

from __future__ import annotations

import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from groundstation.commands.common import Choice, ProgressLine, Result, example, json_option, logs_option, packed
from groundstation.errors import BadInput

if TYPE_CHECKING:
    from pydantic import BaseModel

Verdict = Literal["ok", "note", "wrong"]
FREE_BYTES = 500_000_000


@dataclass(frozen=True, slots=True)
class Check:
    """One thing the doctor looked at, what it saw, and the remedy if that is not right."""

    name: str
    verdict: Verdict
    seen: str
    remedy: str = ""


def _python() -> Check:
    return Check("python", "ok", f"{platform.python_version()} on {platform.system()} {platform.machine()}")


def _packages() -> Check:
    from importlib.metadata import PackageNotFoundError, version

    found, missing = [], []
    for name in ("numpy", "scipy", "numba", "casadi", "eclipse-zenoh", "mcap", "pymavlink", "textual", "plotly"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return Check("packages", "wrong", f"missing: {', '.join(missing)}", "install groundstation again")
    return Check("packages", "ok", ", ".join(found))


def _configs() -> Check:
    from groundstation.paths import configs_dir

    root = configs_dir()
    counts = {kind: len(list((root / kind).glob("*.toml"))) for kind in ("vehicles", "plans", "scenarios", "stations")}
    return Check("configs", "ok", f"{root}: " + ", ".join(f"{count} {kind}" for kind, count in counts.items()))


def _bus() -> Check:
    from drivers import bus

    began = time.monotonic()
    try:
        with bus.open_session(listen=[bus.loopback(bus.free_port())]):
            pass
    except ConnectionError as error:
        return Check("bus", "wrong", str(error), "allow programs to listen on 127.0.0.1")
    return Check("bus", "ok", f"a loopback session opens in {1e3 * (time.monotonic() - began):.0f} ms")


def _serial() -> Check:
    from serial.tools import list_ports

    ports = list(list_ports.comports())
    if not ports:
        return Check("serial ports", "note", "none found", "plug the telemetry radio or flight controller in")
    closed = [port.device for port in ports if not os.access(port.device, os.R_OK | os.W_OK)]
    seen = ", ".join(f"{port.device} ({port.description})" for port in ports)
    if closed:
        remedy = "join the group that owns them (often dialout) and log in again"
        return Check("serial ports", "wrong", f"{seen}; no permission for {', '.join(closed)}", remedy)
    return Check("serial ports", "ok", seen)


def _mocap() -> Check:
    from drivers.mocap.session import SYSTEMS

    readers = ", ".join(system.maker for system in SYSTEMS.values())
    return Check("motion capture", "ok", f"{readers}; `groundstation doctor --mocap` looks for them")


def _clock() -> Check:
    info = time.get_clock_info("monotonic")
    verdict: Verdict = "ok" if info.resolution <= 1e-3 else "wrong"
    return Check("clock", verdict, f"monotonic, resolution {info.resolution:.0e} s", "run on another machine")


def _disk(logs: Path) -> Check:
    place = logs if logs.is_dir() else Path()
    free = shutil.disk_usage(place).free
    seen = f"{free / 1e9:.1f} GB free in {place.resolve()}"
    if not os.access(place, os.W_OK):
        return Check("logs", "wrong", f"{place.resolve()} cannot be written", "choose another folder with --logs")
    return Check(
        "logs", "ok" if free > FREE_BYTES else "wrong", seen, "make room, or choose another folder with --logs"
    )


@dataclass(frozen=True, slots=True)
class Setting:
    """A value that holds, and where it came from."""

    name: str
    value: str
    source: str


def _settings(model: BaseModel, source: str, prefix: str = "") -> Iterator[Setting]:
    """Every value of a validated file: from the file where it is written there, else the default."""
    from pydantic import BaseModel

    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from _settings(value, source, f"{prefix}{name}.")
        else:
            origin = source if name in model.model_fields_set else "default"
            yield Setting(f"{prefix}{name}", "no limit" if value is None else str(value), origin)


def _what_holds(vehicle: str, station: str) -> list[Setting]:
    from groundstation.flight.station import load_station
    from groundstation.paths import find_config
    from groundstation.vehicle import load_vehicle

    vehicle_file = find_config("vehicles", vehicle)
    declared = load_vehicle(vehicle_file)
    return [
        *_settings(load_station(station), f"station {station}", "station."),
        *_settings(declared.limits, vehicle_file.name, "limits."),
        *_settings(declared.identification, vehicle_file.name, "identification."),
    ]


@dataclass(frozen=True, slots=True)
class Cameras:
    """What ``doctor --mocap`` is asked."""

    host: tuple[str, ...]
    seconds: float
    link: str | None


@click.command(epilog=example("groundstation doctor --vehicle x500"))
@click.option("--vehicle", default=None, help="Also print the settings that hold for this vehicle, and where from.")
@click.option("--station", default="default", show_default=True, help="Station file for that, and for --mocap.")
@click.option(
    "--mocap", is_flag=True, help="Look for motion capture on the network: bodies, rates, clocks, what is wrong."
)
@click.option("--host", multiple=True, help="With --mocap: a computer to ask that answers no broadcast (Vicon, VRPN).")
@click.option(
    "--seconds",
    type=click.FloatRange(1.0, 60.0),
    default=3.0,
    show_default=True,
    help="With --mocap: how long to watch.",
)
@click.option("--link", help="With --mocap and --vehicle: compare with its gyro and accelerometer; turn it meanwhile.")
@logs_option
@json_option
@packed(Cameras)
def doctor(cameras: Cameras, vehicle: str | None, station: str, mocap: bool, logs: Path) -> Result:
    """Say what is installed, reachable and wrong here, and what to do about it."""
    if mocap:
        from groundstation.commands.mocap import mocap_report

        return mocap_report(station, cameras.host, cameras.seconds, cameras.link, vehicle)
    settings = _what_holds(vehicle, station) if vehicle is not None else []
    looks: list[Callable[[], Check]] = [
        _python,
        _packages,
        _configs,
        _bus,
        _serial,
        _mocap,
        _clock,
        lambda: _disk(logs),
    ]
    checks = [look() for look in looks]
    document = {
        "schema": "groundstation.doctor/1",
        "checks": [
            {"name": c.name, "verdict": c.verdict, "seen": c.seen, "remedy": c.remedy if c.verdict != "ok" else ""}
            for c in checks
        ],
        "settings": [{"name": s.name, "value": s.value, "source": s.source} for s in settings],
    }
    lines = []
    for check in checks:
        lines.append(f"{check.verdict:<6} {check.name:<15} {check.seen}")
        if check.verdict != "ok" and check.remedy:
            lines.append(f"{'':<22} -> {check.remedy}")
    width = max((len(s.name) for s in settings), default=0)
    lines += [f"{s.name:<{width}}  {s.value}  ({s.source})" for s in settings]
    return Result(document, "\n".join(lines))


@click.command(epilog=example("groundstation reproduce"))
@click.option("--keep", type=click.Path(path_type=Path, file_okay=False), help="Folder to leave the flights in.")
@json_option
def reproduce(keep: Path | None) -> Result:
    """Fly the paper's trajectory and circles on the simulated QBall 2, and print its tables beside ours."""
    from groundstation.reproduction import reproduce as run

    line = ProgressLine()
    document, text = run(keep, line.fraction)
    line.end()
    return Result(document, text)


SHELLS = {
    "bash": "~/.local/share/bash-completion/completions/groundstation",
    "zsh": "~/.zfunc/_groundstation",
    "fish": "~/.config/fish/completions/groundstation.fish",
}
"""Shell -> the file that it reads completions from."""


@click.command(
    epilog=example("groundstation completion bash > ~/.local/share/bash-completion/completions/groundstation")
)
@click.argument("shell", type=Choice(tuple(SHELLS)))
@click.pass_context
def completion(ctx: click.Context, shell: str) -> Result:
    """Print a completion script for bash, zsh or fish; write it where the shell looks for it, and open a new shell.

    \b
    bash  ~/.local/share/bash-completion/completions/groundstation
    zsh   ~/.zfunc/_groundstation, and in ~/.zshrc:
          fpath+=~/.zfunc; autoload -U compinit; compinit
    fish  ~/.config/fish/completions/groundstation.fish
    """  # noqa: D301 - click wants the character itself
    from click.shell_completion import get_completion_class

    completer = get_completion_class(shell)
    if completer is None:
        raise BadInput(f"{shell}: no completion; there are {', '.join(SHELLS)}.")
    script = completer(ctx.find_root().command, {}, "groundstation", "_GROUNDSTATION_COMPLETE").source()
    return Result({"schema": "groundstation.completion/1", "shell": shell, "script": script}, script)
