"""How the firmware's software in the loop is started on this project's physics; the binaries are given, nothing of them
is kept.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FULL_V = 16.8
"""The x500's; firmware that takes no voltage from the physics reports it, where its own default is a smaller battery's.
"""
PX4_ENVIRONMENT = {"PX4_SIM_MODEL": "none_iris"}
SIH_ENVIRONMENT = {"PX4_SIM_MODEL": "sihsim_quadx"}
"""With this instead, PX4 flies its own simulated quadrotor."""


@contextmanager
def process(command: list[str], folder: Path, **environment: str) -> Iterator[None]:
    """A child with its output in a file, ended at the end."""
    with (folder / f"{Path(command[0]).name}-{command[1].strip('-')}.log").open("wb") as log:
        child = subprocess.Popen(
            command, cwd=folder, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env={**os.environ, **environment}
        )
        try:
            yield
        finally:
            child.terminate()
            child.wait(10)


def px4_command(binary: Path, folder: Path) -> list[str]:
    """PX4, its files in ``folder``; with :data:`PX4_ENVIRONMENT` it asks TCP 4560 for sensors and speaks to UDP
    14540.
    """
    return [str(binary), "-d", str(binary.resolve().parents[1] / "etc"), "-w", str(folder)]


def arducopter_command(
    binary: Path, folder: Path, parameters: str = "", link: str = "", model: str = "JSON:127.0.0.1"
) -> list[str]:
    """ArduCopter as an X quadrotor; it asks UDP 9002 for physics and serves TCP 5760, or speaks over ``link``
    (udpclient:HOST:PORT).

    Another ``model`` (``quad:FILE.json``) is physics of its own.
    """
    own = folder / "copter.parm"
    own.write_text(f"FRAME_CLASS 1\nFRAME_TYPE 1\nSIM_RATE_HZ 1000\nSIM_BATT_VOLTAGE {FULL_V:g}\n{parameters}")
    shipped = binary.resolve().parents[3] / "Tools" / "autotest" / "default_params" / "copter.parm"
    command = [str(binary), "--model", model, "--defaults", f"{shipped},{own}", "-w"]
    return [*command, f"--serial0={link}"] if link else command
