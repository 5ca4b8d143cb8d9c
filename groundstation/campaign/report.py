"""The campaign's report: one page that shows the loop closing, and the same as lines for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from groundstation.campaign.campaign import Campaign, Round
from groundstation.campaign.deciding import paper_seconds
from groundstation.campaign.pooling import level_of
from groundstation.errors import BadInput
from groundstation.identification.results import Estimate
from groundstation.json_types import JsonObject
from groundstation.reporting.markup import Child, Markup, definition_list, element, fragment, sentence_list, table
from groundstation.reporting.page import Page
from groundstation.reporting.units import fixed, label, quantity, scale_for, significant, split_unit
from groundstation.targets import HALF_95
from groundstation.trajectory import load_plan
from groundstation.writing import write_whole

QUANTITIES = ("position_m", "velocity_m_s", "attitude_rad", "body_rate_rad_s")


def lines(campaign: Campaign) -> list[str]:
    """Each round in two lines, then how it ended."""
    out = []
    for number, done in enumerate(campaign.rounds, 1):
        out.append(f"flight {number} ({done.seconds:.0f} s): {done.why}")
        out.append(
            f"  {done.verdict or 'refused'}: {', '.join(done.names()).replace('_', ' ') or 'nothing found'}; "
            f"{_error_line(done)}"
        )
        out += [f"  {text}" for text in done.not_settled]
    out.append(campaign.sentence or "not finished")
    return out


def _error_line(done: Round) -> str:
    """Rate and velocity errors on the unseen flight before and after the effects."""
    if not done.judged:
        return "no model to judge yet"
    before, after = done.judged["before"], done.judged["after"]
    parts = [
        f"{label(n)} {significant(before[n])} → {significant(after[n])} {split_unit(n)[1]}"
        for n in ("velocity_m_s", "body_rate_rad_s")
    ]
    return f"0.5 s ahead on this unseen flight, without and with the effects: {', '.join(parts)}"


def write_campaign_report(path: Path, campaign: Campaign) -> Path:
    """One HTML file without a network."""
    page = Page(f"Campaign – {campaign.vehicle.name}")
    head = fragment(
        element("h1", f"Campaign: {campaign.vehicle.name}"),
        element(
            "p",
            f"{len(campaign.rounds)} flights · {sum(r.seconds for r in campaign.rounds):.0f} s of excitation",
            class_="sub",
        ),
    )
    open_ = campaign.rounds[-1].not_settled if campaign.rounds and not campaign.sentence else ()
    page.section(
        "verdict",
        "How it ended",
        element("p", campaign.sentence or "The campaign is not finished."),
        sentence_list(open_) if open_ else None,
    )
    page.section("rounds", "Round by round", *(_round(n, r) for n, r in enumerate(campaign.rounds, 1)))
    judged = [(n, r) for n, r in enumerate(campaign.rounds, 1) if r.judged]
    if judged:
        page.section(
            "errors",
            "Error on flights that no estimate had seen",
            element(
                "p",
                "RMS error half a second ahead on each flight, before that flight was used: by the declared vehicle, "
                "by the rigid body estimated from the flights before, and by the same with the effects found in them.",
            ),
            table("Before and after the effects", _error_header(), _error_rows(judged)),
            page.figure(_error_figure(judged), "Error of the body rate on each unseen flight, half a second ahead"),
        )
    if campaign.rounds:
        page.section(
            "intervals",
            "Parameters with their intervals",
            table(
                "Targets, flight by flight",
                ("parameter", *(f"flight {n}" for n in range(1, len(campaign.rounds) + 1))),
                _interval_rows(campaign),
            ),
            page.figure(
                _interval_figure(campaign),
                "Half widths of the 95 % intervals over their targets; below 1 the target is met",
            ),
        )
        _levels_section(page, campaign)
        _cost_section(page, campaign)
    return write_whole(path, page.html(head, element("p", "Intervals are 95 %.")))


def _levels_section(page: Page, campaign: Campaign) -> None:
    """What belongs to the vehicle, to the days and to the flights; where there is more than one flight."""
    found = campaign.rounds[-1].levels
    if not found:
        return
    count = len(campaign.rounds)
    rows: list[Sequence[Child]] = []
    for name, each in found.items():
        cells = [_level(name, level) for level in (each["vehicle"], *each["flights"])]
        rows.append(
            (
                _level_label(name),
                level_of(name),
                *cells,
                *(significant(each[k]) for k in ("scatter_days", "scatter_flights")),
            )
        )
    page.section(
        "levels",
        "Vehicle, day, flight",
        element(
            "p",
            "What another flight is expected to have, and each flight by itself, with 95 % intervals; beside them the "
            "scatter between days and between flights that no interval covers. Mass and tensor here leave out the "
            "error of the thrust constant, which all flights share.",
        ),
        table(
            "Each parameter by level",
            (
                "parameter",
                "belongs to the",
                "vehicle",
                *(f"flight {n}" for n in range(1, count + 1)),
                "between days",
                "between flights",
            ),
            rows,
        ),
    )


def _level_label(name: str) -> str:
    effect, _, parameter = name.rpartition(".")
    return f"{effect.replace('_', ' ')}: {label(parameter)}" if effect else label(name)


def _level(name: str, level: Mapping[str, float]) -> Child:
    parameter = name.rpartition(".")[2]
    estimate = Estimate.normal(level["value"], level["std"])
    return (
        quantity(parameter, estimate)
        if scale_for(split_unit(parameter)[1], [level["value"]])
        else significant(level["value"])
    )


def _cost_section(page: Page, campaign: Campaign) -> None:
    """Flown seconds against the paper's trajectory repeated to the same accuracy."""
    plans = []
    for done in campaign.rounds:
        try:
            plan = load_plan(Path(done.folder) / "plan.toml")
        except BadInput:
            return  # a given flight without a plan: what it told cannot be predicted
        plans.append(plan.as_flown(done.seconds))
    seconds = sum(r.seconds for r in campaign.rounds)
    number = campaign.model_round()
    if not number:
        return
    estimates = campaign.rounds[number - 1].estimates
    repeated = paper_seconds(campaign.vehicle, estimates, plans, list(campaign.targets))
    if not repeated:
        return
    rows = [(label(n), f"{seconds:.0f} s", f"{value:.0f} s", f"{value / seconds:.1f}") for n, value in repeated.items()]
    page.section(
        "cost",
        "What it cost",
        element(
            "p",
            "Seconds of excitation that were flown, and those that the paper's trajectory, repeated, would take to the "
            "same accuracy, by the information that both plans promise for the vehicle as it is estimated now.",
        ),
        table("Seconds of excitation", ("parameter", "campaign", "paper's trajectory repeated", "times"), rows),
    )


def _round(number: int, done: Round) -> Markup:
    """One round as terms with what they stand for: its sentences are too long for a table."""
    found = sentence_list(str(f["evidence"]) for f in done.findings) if done.findings else "nothing"
    pairs: list[tuple[Child, Child]] = [
        (f"Flight {number}", f"{done.seconds:.0f} s of excitation"),
        ("Why it was flown", done.why[:1].upper() + done.why[1:] + "."),
        ("Found in all flights so far", found),
        ("Left open", sentence_list(done.not_settled) if done.not_settled else "nothing"),
    ]
    return definition_list(pairs)


def _error_header() -> tuple[str, ...]:
    return ("flight", *(f"{label(q)} ({split_unit(q)[1]}): declared → rigid → with effects" for q in QUANTITIES))


def _error_rows(judged: Sequence[tuple[int, Round]]) -> list[Sequence[Child]]:
    return [
        (
            str(n),
            *(
                " → ".join(significant(r.judged[kind].get(q, float("nan"))) for kind in ("declared", "before", "after"))
                for q in QUANTITIES
            ),
        )
        for n, r in judged
    ]


def _error_figure(judged: Sequence[tuple[int, Round]]) -> JsonObject:
    x = [f"flight {n}" for n, _ in judged]
    data = [
        {
            "type": "bar",
            "x": x,
            "y": [r.judged[kind]["body_rate_rad_s"] for _, r in judged],
            "name": name,
            "marker": {"color": f"@{style}"},
        }
        for style, (kind, name) in enumerate(
            (("declared", "declared"), ("before", "rigid body"), ("after", "with effects")), 1
        )
    ]
    return {
        "data": data,
        "layout": {
            "height": 280,
            "barmode": "group",
            "yaxis": {"title": {"text": "body rate error (rad/s)"}},
        },
    }


def _interval_rows(campaign: Campaign) -> list[Sequence[Child]]:
    out: list[Sequence[Child]] = []
    for name in campaign.targets:
        cells = [_cell(name, r.estimates.get(name)) for r in campaign.rounds]
        out.append((label(name), *cells))
    return out


def _cell(name: str, entry: Mapping[str, float] | None) -> Child:
    if entry is None:
        return "not revealed"
    half = HALF_95 * entry["std"]
    estimate = Estimate(entry["value"], entry["std"], (entry["value"] - half, entry["value"] + half))
    return quantity(name, estimate) if scale_for(split_unit(name)[1], [entry["value"]]) else fixed(entry["value"], 4)


def _interval_figure(campaign: Campaign) -> JsonObject:
    x = [f"flight {n}" for n in range(1, len(campaign.rounds) + 1)]
    data = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "x": x,
            "y": [_plotted(r.reached.get(name)) for r in campaign.rounds],
            "name": label(name),
            "line": {"color": f"@{style}"},
        }
        for style, name in enumerate(campaign.targets, 1)
    ]
    shapes = [
        {
            "type": "line",
            "xref": "paper",
            "x0": 0,
            "x1": 1,
            "y0": 1,
            "y1": 1,
            "line": {"color": "@muted", "dash": "dash", "width": 1},
        }
    ]
    return {
        "data": data,
        "layout": {"height": 280, "shapes": shapes, "yaxis": {"type": "log", "title": {"text": "half width / target"}}},
    }


def _plotted(value: float | None) -> float | None:
    return None if value is None or value == float("inf") else value
