"""Plan: an excitation for a vehicle and a room, and what it will tell."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Mapping
from itertools import count
from pathlib import Path
from typing import ClassVar

import numpy as np
from textual.binding import Binding
from textual.containers import Grid, Horizontal
from textual.widgets import DataTable, Input, Label, ProgressBar, Select, Static
from textual.worker import get_current_worker

from groundstation.errors import BadInput, GroundStationError
from groundstation.reporting.units import label, readable, scale_for, significant, split_unit
from groundstation.trajectory import FourierSeries, Plan, rigid_motion
from groundstation.tui.screens.base import StationScreen, fill
from groundstation.tui.setup import shipped
from groundstation.tui.widgets.plots import Line, Plot

FIELDS = {
    "x_max_m": ("room, |x| below", "m", 1.0),
    "y_max_m": ("room, |y| below", "m", 1.0),
    "z_max_m": ("room, z below", "m", 1.0),
    "speed_max_m_s": ("speed below", "m/s", 1.0),
    "tilt_max_rad": ("tilt below", "°", math.pi / 180.0),
}
"""Limit -> its text, the unit it is typed in, and that unit in SI. An empty field leaves the vehicle's own limit."""
PERIOD_POINTS = 300
LONGEST_S = 3600.0
"""Of a search that somebody waits for."""


def numbers_in(typed: Mapping[str, str]) -> tuple[dict[str, float], list[str]]:
    """The numbers in the fields by name (empty ones left out), and what is wrong with the others, by their labels."""
    numbers, wrong = {}, []
    for name, text in typed.items():
        label_, unit, _ = FIELDS.get(name, ("search for", "s", 1.0))
        if not text.strip() and name != "budget":
            continue
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > 0.0):
            wrong.append(f"{label_}: '{text.strip()}' is no positive number of {unit}")
        elif name == "budget" and value > LONGEST_S:
            wrong.append(f"{label_}: at most {LONGEST_S:g} s")
        else:
            numbers[name] = value
    return numbers, wrong


class Planner(StationScreen):
    """The optimiser, its progress and its answer."""

    MODE = "plan"
    HELP_TEXT = """\
p starts the optimiser; the drawings follow what it tries, and c stops it with the best so far. Empty fields keep the
vehicle's own limits. The criterion "condition" is the seed paper's; A makes the sum of the variances small. The
table shows the standard deviation to expect of each parameter, beside that of the plan before; u goes back to that
one. w writes the plan to a file in the folder of the flights; the Fly screen flies the plan that is shown here."""
    BINDINGS: ClassVar = [
        Binding("p", "plan", "Plan"),
        Binding("c", "stop", "Stop with the best"),
        Binding("u", "undo", "Undo"),
        Binding("w", "write", "Write to a file"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._enough = threading.Event()
        self._before: Plan | None = None
        self._trial: FourierSeries | None = None
        self._tried = self._drawn = 0

    def body(self) -> Iterable:
        """Form, progress, answer, drawings."""
        with Grid(classes="panel form"):
            yield Label("vehicle")
            yield Select(
                [(name, name) for name in shipped("vehicles")],
                value=self.station.setup.vehicle,
                allow_blank=False,
                id="plan-vehicle",
                compact=True,
            )
            yield Label("criterion")
            names = [(name, name) for name in ("condition", "A", "D", "E")]
            yield Select(names, value="condition", allow_blank=False, id="criterion", compact=True)
            yield Label("search for, s")
            yield Input("6", id="budget", type="number", compact=True)
            for name, (text, unit, _) in FIELDS.items():
                yield Label(f"{text}, {unit}")
                yield Input(placeholder="the vehicle's", id=name, type="number", compact=True)
        progress = ProgressBar(total=1.0, show_eta=False, id="plan-progress")
        progress.display = False
        yield progress
        yield Static("p plans an excitation", id="plan-text", markup=False)
        yield Static("", id="trial", markup=False)
        with Horizontal(classes="columns"):
            yield Plot("path from above, y over x, m", id="path")
            yield Plot("tilt, °, over s", id="tilt")
        yield DataTable(id="accuracy", show_cursor=False)

    def on_mount(self) -> None:
        """Draw what is tried, five times a second."""
        self.set_interval(0.2, self._draw_trial)

    def on_screen_resume(self) -> None:
        """Show the plan that would be flown."""
        if self.station.plan is not None:
            self._show(self.station.plan)

    def action_plan(self) -> None:
        """Search on a thread."""
        if self.station.plan_worker_running:
            self.notify("the optimiser is running; c stops it with the best so far.")
            return
        try:
            problem = self._problem()
        except BadInput as error:
            self.say("#plan-text", str(error))
            return
        self._enough.clear()
        self.station.plan_worker_running = True
        self.refresh_bindings()
        self.run_worker(lambda: self._search(problem), thread=True, group="plan")

    def plan_for(self, vehicle: str) -> None:
        """Plan a flight of this vehicle, if it ships."""
        if vehicle in shipped("vehicles"):
            self.query_one("#plan-vehicle", Select).value = vehicle
        self.action_plan()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only what can be done now is offered."""
        searching = self.station.plan_worker_running
        if action == "plan":
            return not searching
        if action == "stop":
            return searching
        if action == "undo":
            return self._before is not None and not searching
        if action == "write":
            return self.station.plan is not None
        return True

    def action_undo(self) -> None:
        """Back to the plan before; a second time, forward again."""
        if self._before is None or self.station.plan is None:
            return
        self._before, self.station.plan = self.station.plan, self._before
        self._show(self.station.plan)
        self.notify("the plan before is back; u again undoes that.")

    def action_stop(self) -> None:
        """Take the best found so far."""
        self._enough.set()

    def action_write(self) -> None:
        """Write the plan shown into the folder of the flights."""
        from groundstation.analysis.plans import write_plan

        plan = self.station.plan
        if plan is None:
            self.notify("there is no plan yet; p makes one.")
            return
        folder: Path = self.station.logs / "plans"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            names = (folder / f"{plan.vehicle}-{number}.toml" for number in count(1))
            path = write_plan(plan, next(name for name in names if not name.exists()))
        except (BadInput, OSError) as error:
            self.say("#plan-text", str(error))
        else:
            self.notify(f"written: {path}", markup=False)

    def _problem(self) -> dict:
        """What the fields ask for.

        Raises:
            BadInput: one sentence that names every field that holds no number it can take.
        """
        from groundstation import api

        typed = {name: self.query_one(f"#{name}", Input).value for name in FIELDS}
        numbers, wrong = numbers_in({"budget": self.query_one("#budget", Input).value, **typed})
        if wrong:
            raise BadInput(f"{'; '.join(wrong)}. Correct {'it' if len(wrong) == 1 else 'them'}, then p.")
        problem: dict = {
            "vehicle": api.load_vehicle(str(self.query_one("#plan-vehicle", Select).value)),
            "criterion": self.query_one("#criterion", Select).value,
            "time_budget_s": numbers.pop("budget"),
        }
        return problem | {name: FIELDS[name][2] * value for name, value in numbers.items()}

    def _search(self, problem: dict) -> None:
        """On a thread: the optimiser gives its best so far when it is interrupted."""
        worker = get_current_worker()
        station, app = self.station, self.app

        def watch(series: FourierSeries) -> None:
            if self._enough.is_set() or worker.is_cancelled:
                raise KeyboardInterrupt
            self._trial, self._tried = series, self._tried + 1

        try:
            from groundstation import api

            self._tell(0.0, f"searching a plan for {problem['vehicle'].name}; c stops with the best so far")
            plan = api.plan_excitation(**problem, progress=self._tell, watch=watch)
        except GroundStationError as error:
            self._tell(0.0, str(error))
        else:
            app.call_from_thread(self._found, plan)
        finally:
            self._trial = None
            station.plan_worker_running = False
            app.call_from_thread(self.refresh_bindings)

    def _tell(self, fraction: float, text: str) -> None:
        """From the thread."""
        self.app.call_from_thread(self._progress, fraction, text)

    def _progress(self, fraction: float, text: str) -> None:
        bar = self.query_one(ProgressBar)
        bar.display = True  # an empty bar before anything is planned looks like something that hangs
        bar.update(progress=fraction)
        self.say("#plan-text", text)

    def _draw_trial(self) -> None:
        """The trajectory that the solver tries now, if it is another than the one drawn; crosses are the last plan."""
        trial = self._trial
        if trial is None or self._tried == self._drawn:
            return
        self._drawn = self._tried
        self.query_one(".columns").display = True
        self._draw(trial, self.station.plan)
        self.say("#trial", f"trying trajectory {self._tried}; crosses: the last plan")

    def _found(self, plan: Plan) -> None:
        self._before = self.station.plan
        self.station.plan = plan
        self._progress(1.0, "")
        self._show(plan)

    def _show(self, plan: Plan) -> None:
        """Draw path and tilt over one period, and write what it will tell."""
        self.query_one(".columns").display = True
        series = plan.series()
        before = self._before if self._before and self._before.vehicle == plan.vehicle else None
        self._draw(series, before)
        self.say("#trial", "crosses: the plan before" if before else "")
        condition = f", cond(W) {plan.condition_number:.2f}" if plan.condition_number else ""
        was = f" (before: {before.condition_number:.2f})" if before and before.condition_number and condition else ""
        self.say(
            "#plan-text",
            f"{plan.vehicle}: {series.duration_s:.0f} s, {series.a.shape[1]} harmonics, criterion "
            f"{plan.criterion}{condition}{was}.\n{readable(plan.note)}",
        )
        fill(
            self.query_one(DataTable),
            ("parameter", "expected std", "plan before", "unit"),
            self._accuracy(plan, before),
        )

    def _draw(self, series: FourierSeries, other: Plan | None) -> None:
        """One period's path from above and tilt, beside those of another plan."""
        drawn = [_path_and_tilt(series, PERIOD_POINTS), *([_path_and_tilt(other.series(), 60)] if other else [])]
        self.query_one("#path", Plot).draw([path for path, _ in drawn])
        self.query_one("#tilt", Plot).draw([tilt for _, tilt in drawn])

    def _accuracy(self, plan: Plan, before: Plan | None) -> Iterable[tuple[str, ...]]:
        was = before.predicted_std if before else {}
        for name, std in plan.predicted_std.items():
            scale = scale_for(split_unit(name)[1], [std])
            old = significant(was[name] * scale.factor) if name in was else "–"
            yield label(name), significant(std * scale.factor), old, scale.unit


def _path_and_tilt(series: FourierSeries, points: int) -> tuple[Line, Line]:
    t_s = np.linspace(0.0, min(series.period_s, series.duration_s), points)
    motion = rigid_motion(series.sample(t_s))
    tilt = np.degrees(np.arccos(np.cos(motion.euler_rad[:, 0]) * np.cos(motion.euler_rad[:, 1])))
    return Line(motion.position_m[:, 0], motion.position_m[:, 1]), Line(t_s, tilt)
