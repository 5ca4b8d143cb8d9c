"""Pictures of the terminal UI for the documentation: one rehearsal, every screen at 80x24 and at 200x60, Fly also at
120x40.

    python benchmarks/tui_pictures.py [--output docs/images] [--logs FOLDER]

It presses the keys a person would: r and s for the simulated flight, numbers for the screens.
"""

from __future__ import annotations

import argparse
import asyncio
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from textual.pilot import Pilot
from textual.widgets import DataTable

from groundstation.flight.sequence import FINAL, Phase
from groundstation.tui.app import GroundStation

SIZES = ((80, 24), (200, 60))
MIDDLE = (120, 40)
PATIENCE_S = 600.0


async def until(pilot: Pilot, condition: Callable[[], bool]) -> None:
    """Let the application run until something holds."""
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end_s:
            raise SystemExit(f"waited {PATIENCE_S:.0f} s in vain; {pilot.app.screen} is on")
        await pilot.pause(0.1)


async def picture(pilot: Pilot, folder: Path, name: str, sizes: tuple[tuple[int, int], ...] = SIZES) -> None:
    """The screen that is on, at each size."""
    for width, height in sizes:
        await pilot.resize_terminal(width, height)
        await pilot.pause(0.5)
        file = folder / f"tui-{name}-{width}x{height}.svg"
        file.write_text(pilot.app.export_screenshot(), encoding="utf-8")
        print(file)


async def take(folder: Path, logs: Path) -> None:
    """Plan, fly, identify, diagnose, and picture each."""
    app = GroundStation(logs)

    def phase() -> str:
        return app.core.newest.phase if app.core and app.core.newest else ""

    async with app.run_test(size=SIZES[0]) as pilot:
        await picture(pilot, folder, "first-run")
        await pilot.press("2", "p")
        await until(pilot, lambda: app.plan is not None)
        await picture(pilot, folder, "plan")
        await pilot.press("1", "r")
        await until(pilot, lambda: phase() == Phase.CHECKED)
        await picture(pilot, folder, "checked")
        await pilot.press("s")
        await until(pilot, lambda: phase() == Phase.EXCITING)
        await pilot.pause(12.0)
        await picture(pilot, folder, "fly", (SIZES[0], MIDDLE, SIZES[1]))
        await pilot.press("ctrl+p")
        await picture(pilot, folder, "palette", SIZES[:1])
        await pilot.press("escape")
        await pilot.press("1")
        await picture(pilot, folder, "station")
        await pilot.press("question_mark")
        await picture(pilot, folder, "help")
        await pilot.press("escape")
        await until(pilot, lambda: phase() in FINAL and app.results is not None)
        await pilot.press("4")
        await picture(pilot, folder, "identify")
        await pilot.press("5")
        await picture(pilot, folder, "diagnose")
        await pilot.press("6")
        await until(pilot, lambda: app.screen.query_one("#catalogue", DataTable).row_count > 0)
        await picture(pilot, folder, "flights")


def main() -> None:
    """Take them all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    parser.add_argument("--logs", type=Path, help="where the flight is kept; a temporary folder by default")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        asyncio.run(take(arguments.output, arguments.logs or Path(temporary)))


if __name__ == "__main__":
    main()
