"""How often does the diagnosis name what was hidden, without being told? Run with ``make blind``; kept in docs/diagnosis.md.

Every flight draws its vehicle, trajectory, true mass and inertia, disturbance, biases, stamp jitter and seed from a master seed
that is new each run and printed. One effect is hidden in a *single*, two in a *pair*, none in a *clean* flight, and in an
*invented* one something that no file of the library models. The diagnosis gets the recording and the declared vehicle, nothing
else. Sizes are drawn over a range around what such a vehicle shows; what is too small to see is counted apart, as effects.md
defines it: *detectable* is an expected t of 6 in the flight's own coloured noise, taken from the joint estimate with the hidden effects
told and kept out of the noise, and for kinematic effects and delays a size above those of effects.md. An invented force of a place is
told by the simulator's own formula; thrust with memory counts as detectable.
"""

from __future__ import annotations

import argparse
import json
import math
import secrets
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from flights import flight_data  # pyright: ignore[reportMissingImports]

from benchmarks.study import IMU_NOISE
from groundstation.diagnosis import diagnose
from groundstation.diagnosis.attribution import candidates
from groundstation.diagnosis.effect import Effect, ParameterInfo, library
from groundstation.diagnosis.evidence import Candidate, Evidence, FlightEvidence
from groundstation.diagnosis.pipeline import for_evidence
from groundstation.diagnosis.results import Diagnosis
from groundstation.errors import FlightAborted, Refused
from groundstation.flightdata import FlightData
from groundstation.frames import quat_rotate_inverse
from groundstation.identification.pipeline import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.identification.results import Estimate
from groundstation.model.signals import Signals
from groundstation.paths import find_config
from groundstation.planning import plan_excitation
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.effects.surroundings import magnet, wall
from sim.flight import simulate
from sim.scenario import Scenario, scenario_from_dict

VEHICLES = ("qball2", "x500")
DURATION_S = 40.0
PLANS = 2
"""Trajectories planned for each vehicle in a run."""
COMMANDED = ("motor_lag", "input_delay", "battery_sag")
"""Effects that show only where rotor speeds are commanded, not measured."""
DETECTABLE = 6.0
"""Estimate over standard deviation that is expected of an effect that a flight can show (effects.md)."""
MASS_BOUND, MOMENT_BOUND = 0.01, 0.02
INERTIA = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")

Random = np.random.Generator
Table = dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """One flight: what was hidden, what was said, and the error of mass and inertia before and after, as shares.

    ``met`` says whether they are within the bounds of the estimation study: mass 1 %, moments 2 % or three of their deviations.

    Of each hidden effect, ``t`` is the expected t (infinite where the sensors alone tell), and ``shares`` its RMS as a share of weight
    or of weight times arm (NaN where it is no force).
    """

    kind: str
    hidden: tuple[str, ...]
    verdict: str
    named: tuple[str, ...]
    alternatives: tuple[str, ...]
    rotors: tuple[bool, ...]
    before: float
    after: float
    met_before: bool
    met_after: bool
    seconds: float
    t: tuple[float, ...]
    shares: tuple[float, ...]

    def detectable(self) -> bool:
        """Whether the flight can show all that is hidden in it."""
        return min(self.t, default=math.inf) >= DETECTABLE

    def first(self) -> str:
        """The first name, or the verdict where there is none."""
        return self.named[0] if self.named else self.verdict


def _signed(random: Random, low: float, high: float) -> float:
    return float(random.choice([-1.0, 1.0]) * random.uniform(low, high))


def _turn(random: Random, size: float) -> list[float]:
    direction = random.standard_normal(3)
    return list(map(float, size * direction / np.linalg.norm(direction)))


def sizes(vehicle: Vehicle) -> dict[str, Callable[[Random], Table]]:
    """For each effect what its table in a scenario may be; forces scale with weight, torques with weight times arm."""
    mass, weight = vehicle.mass_kg, vehicle.mass_kg * vehicle.gravity_m_s2
    torque = weight * vehicle.arm_m()

    def per(scale: float, low: float, high: float) -> Callable[[Random], float]:
        return lambda r: float(scale * r.uniform(low, high))

    def rotor(r: Random) -> int:
        return int(r.integers(1, vehicle.rotors.count + 1))

    return {
        "motor_lag": lambda r: {"hover_s": per(1.0, 0.03, 0.08)(r)},
        "input_delay": lambda r: {"delay_s": per(1.0, 0.015, 0.04)(r)},
        "clock_offset": lambda r: {"offset_s": _signed(r, 0.005, 0.04)},
        "rotor_drag": lambda r: {"drag_kg_s": [per(mass, 0.06, 0.25)(r), per(mass, 0.06, 0.25)(r)]},
        "body_drag": lambda r: {"area_m2": [per(mass, 0.03, 0.12)(r)] * 3},
        "flapping_moment": lambda r: {"moment_n_s": per(torque, 0.005, 0.02)(r)},
        "angular_damping": lambda r: {"linear_nm_s": [per(torque, 0.004, 0.015)(r)] * 3},
        "translational_lift": lambda r: {"gain": per(1.0, 0.5, 1.0)(r)},
        "climb_inflow": lambda r: {"gain": per(1.0, 0.4, 1.0)(r)},
        "wind": lambda r: {"velocity_m_s": [*_turn(r, 1.0)[:2], 0.0], "gust_m_s": 0.1},
        "weak_rotor": lambda r: {"rotor": rotor(r), "loss": per(1.0, 0.03, 0.15)(r)},
        "rotor_degradation": lambda r: {
            "rotor": rotor(r),
            "loss": per(1.0, 0.04, 0.15)(r),
            "start_s": per(1, 18, 32)(r),
        },
        "thrust_curve": lambda r: {"exponent": 2.0 + _signed(r, 0.15, 0.4)},
        "com_offset": lambda r: {"offset_m": [_signed(r, 0.002, 0.01), _signed(r, 0.002, 0.01), 0.0]},
        "rotor_gyroscopic": lambda r: {"inertia_kg_m2": per(mass, 1e-5, 4e-5)(r)},
        "battery_sag": lambda r: {"strength": per(1.0, 0.5, 1.0)(r)},
        "payload_change": lambda r: {"mass_kg": per(mass, 0.015, 0.06)(r), "time_s": per(1, 18, 32)(r)},
        "slung_load": lambda r: {"mass_kg": per(mass, 0.02, 0.06)(r), "length_m": per(1.0, 0.3, 1.0)(r)},
        "tether": lambda r: {"stiffness_n_m": per(weight, 0.01, 0.04)(r)},
        "constant_wrench": lambda r: {
            "force_world_n": [*_turn(r, weight * r.uniform(0.0, 0.03))[:2], 0.0],
            "torque_body_nm": _turn(r, torque * r.uniform(0.01, 0.03)),
        },
        "imu_misalignment": lambda r: {"rotation_rad": _turn(r, r.uniform(0.01, 0.04))},
        "mocap_misalignment": lambda r: {"rotation_rad": _turn(r, r.uniform(0.01, 0.04)), "offset_m": [0.0] * 3},
        "mocap_tilt": lambda r: {"tilt_rad": [_signed(r, 0.008, 0.03), _signed(r, 0.008, 0.03)]},
        "attracting_wall": lambda r: {"strength_n_m3": per(weight, 0.06, 0.2)(r), "distance_m": per(1.0, 1.0, 1.6)(r)},
        "thrust_memory": lambda r: {"width_share": per(1.0, 0.04, 0.1)(r)},
        "magnet": lambda r: {"strength_n_m4": per(weight, 0.0005, 0.003)(r), "position_m": [0.4, 0.2, 0.4]},
    }


INVENTED = ("attracting_wall", "thrust_memory", "magnet")
FIELDS = ("attracting_wall", "magnet")
"""Invented ones that are a force at a place: the simulator's own formula says how detectable they are."""


def world(random: Random, hidden: dict[str, Table]) -> Scenario:
    """A laboratory with drawn disturbance, biases and jitter, whose clocks agree and whose rotors are as declared.

    Rotors whose speed is measured lag behind their commands as all rotors do; the diagnosis sees the speeds.
    """

    def clock(jitter_s: float) -> Table:
        return {"jitter_s": float(jitter_s * random.uniform(0.5, 2.0)), "latency_s": 0.004, "latency_jitter_s": 0.001}

    return scenario_from_dict(
        {
            "name": "unknown",
            "imu": {
                **IMU_NOISE,
                "clock": clock(2e-5),
            },
            "mocap": {
                "rate_hz": float(random.choice([60.0, 100.0, 120.0])),
                "position_std_m": 1.5e-4,
                "attitude_std_rad": 1e-3,
                "dropouts_per_minute": 1.0,
                "dropout_s": 0.1,
                "clock": clock(2e-4),
            },
            "motors": {"rate_hz": 500.0, "noise_share": 0.002, "clock": clock(2e-5)},
            "battery": {"rate_hz": 10.0, "voltage_std_v": 0.01, "current_std_a": 0.1},
            "disturbance": {
                "force_share": float(random.uniform(0.001, 0.004)),
                "torque_share": float(random.uniform(0.001, 0.003)),
                "correlation_s": float(random.uniform(0.2, 0.8)),
                "order": int(random.integers(1, 3)),
            },
            "truth": {
                "mass_factor": float(random.uniform(0.95, 1.05)),
                "inertia_factor": [float(f) for f in (*random.uniform(1.0, 1.2, 2), random.uniform(0.85, 1.0))],
                "product_share": [float(f) for f in random.uniform(-0.015, 0.015, 3)],
                **({} if set(hidden) & set(COMMANDED) else {"lag": {"up_s": 0.03, "down_s": 0.04}}),
            },
            "effects": hidden,
        }
    )


def declared(name: str, hidden: Iterable[str]) -> Vehicle:
    """A vehicle of configs/; with the speeds commanded, not measured, where the effect lies in between."""
    vehicle = load_vehicle(find_config("vehicles", name))
    if not set(hidden) & set(COMMANDED):
        return vehicle
    document = vehicle_to_dict(vehicle)
    document["rotors"]["speed_source"] = "command"
    return vehicle_from_dict(document)


def _error_of_parameters(estimates: Any, truth: Vehicle) -> float:
    """Root mean square of the relative errors of mass and of the moments of inertia; NaN where one is missing."""
    tensor = np.diag(truth.inertia_tensor())
    true = dict(zip(("mass_kg", *INERTIA), (truth.mass_kg, *tensor), strict=True))
    errors = [estimates[n].value / v - 1.0 if n in estimates else math.nan for n, v in true.items()]
    return float(np.sqrt(np.mean(np.square(errors))))


def _meets_bounds(parameters: Mapping[str, Estimate], truth: Vehicle) -> bool:
    """Whether mass and moments are as near as the estimation study asks: 1 % and the larger of 2 % and three deviations."""
    moments = [(parameters.get(name), getattr(truth.inertia_kg_m2, name[1:3])) for name in INERTIA]
    mass = parameters.get("mass_kg")
    return (
        mass is not None
        and abs(mass.value - truth.mass_kg) <= MASS_BOUND * truth.mass_kg
        and all(e is not None and abs(e.value - own) <= max(MOMENT_BOUND * own, 3.0 * e.std) for e, own in moments)
    )


def visibility(flight: FlightData, hidden: Sequence[tuple[str, Table]]) -> list[tuple[float, float]]:
    """Expected t and RMS share of each hidden effect, when the diagnosis is told all of them."""
    seen = {name: (math.inf, math.nan) for name, _ in hidden}
    modelled = [(name, table) for name, table in hidden if name in library() or name in FIELDS]
    if not modelled:
        return list(seen.values())
    suspect = for_evidence(prepare(flight))
    fitted = fit_dynamics([suspect])
    vehicle = suspect.record.vehicle
    plain = Evidence([FlightEvidence(suspect, fitted.best, fitted.options)])
    told = [_told(name, table, plain) for name, table in modelled]
    evidence = Evidence([FlightEvidence(suspect, fitted.best, fitted.options, told)])
    chosen = [(c, columns) for c in told if (columns := evidence.columns(c)) is not None]
    solution, first = evidence.solve(chosen), 0
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    scale = np.array([weight] * 3 + [weight * vehicle.arm_m()] * 3)
    for candidate, columns in chosen:
        count = len(candidate.effect.parameters)
        telling = candidate.effect.telling()
        t = math.sqrt(max(solution.wald(first, telling) - len(telling), 0.0))
        values, _ = solution.part(first, count)
        seen[candidate.identifier] = t, float(np.max(columns.wrench_rms @ np.abs(values) / scale))
        first += count
    return list(seen.values())


def _told(name: str, table: Table, evidence: Evidence) -> Candidate:
    """The library's model of a hidden effect: the right rotor, and the instant or length that serve best."""
    flight = evidence.flights[0]
    if name in FIELDS:
        return Candidate(_field(name, table), {})
    pool = [
        (candidate, columns)
        for candidate in candidates(flight.prepared.record.vehicle, flight.excited, [library()[name]])
        if candidate.settings.get("rotor") == table.get("rotor")
        and (columns := evidence.columns(candidate)) is not None
    ]
    everything = range(len(library()[name].parameters))
    return max(pool, key=lambda entry: evidence.solve([entry]).wald(0, everything))[0]


def _field(name: str, table: Table) -> Effect:
    """An invented field of the room by the simulator's own formula, at the poses that were measured; its one parameter is one."""
    scenario = scenario_from_dict({"name": name, "effects": {name: table}})

    def wrench(signals: Signals, vehicle: Vehicle, settings: Mapping[str, float]) -> np.ndarray:
        force, torque = np.zeros((2, len(signals.t_s), 3))
        for index, (place, q) in enumerate(zip(signals.position_m.tolist(), signals.quaternion.tolist(), strict=True)):
            if name == "magnet":
                force[index], torque[index] = magnet(scenario.effects.magnet, tuple(place), tuple(q))
            else:
                field = scenario.effects.attracting_wall
                force[index] = wall(
                    field, tuple(place), (math.cos(field.azimuth_rad), math.sin(field.azimuth_rad), 0.0)
                )
        return np.concatenate([quat_rotate_inverse(signals.quaternion, force), torque], axis=1)[:, :, None]

    return Effect(
        identifier=name,
        equation="the simulator's",
        source="invented",
        parameters=(ParameterInfo("times", lambda vehicle: 10.0),),
        confused_with=(),
        manoeuvre="",
        sentence="",
        wrench=wrench,
    )


def fly(kind: str, names: Sequence[str], vehicle_name: str, plan: Plan, random: Random) -> Outcome | None:
    """Hide, fly, diagnose; None where the vehicle could not fly it."""
    vehicle = declared(vehicle_name, names)
    hidden = {name: sizes(vehicle)[name](random) for name in names}
    try:
        simulated = simulate(vehicle, plan, world(random, hidden), int(random.integers(2**31)))
    except FlightAborted:
        return None
    flight = flight_data(simulated, "unknown")
    start = time.perf_counter()
    diagnosis: Diagnosis = diagnose([flight])
    seconds = time.perf_counter() - start
    try:
        seen = visibility(flight, list(hidden.items()))
    except Refused:
        seen = [(0.0, math.nan)] * len(names)
    rotors = tuple(
        f.rotor == hidden[f.effect]["rotor"] for f in diagnosis.findings if "rotor" in hidden.get(f.effect, {})
    )
    return Outcome(
        kind=kind,
        hidden=tuple(names),
        verdict=diagnosis.verdict,
        named=tuple(f.effect for f in diagnosis.findings),
        alternatives=diagnosis.findings[0].alternatives if diagnosis.findings else (),
        rotors=rotors,
        before=_error_of_parameters(diagnosis.parameters_before, simulated.truth),
        after=_error_of_parameters(diagnosis.parameters_after, simulated.truth),
        met_before=_meets_bounds(diagnosis.parameters_before, simulated.truth),
        met_after=_meets_bounds(diagnosis.parameters_after, simulated.truth),
        seconds=seconds,
        t=tuple(t for t, _ in seen),
        shares=tuple(share for _, share in seen),
    )


def schedule(random: Random, counts: dict[str, int]) -> list[tuple[str, tuple[str, ...]]]:
    """Kinds and hidden names; singles run through a fresh permutation of all effects, so that none is left out by chance."""
    known = [name for name in sizes(load_vehicle(find_config("vehicles", "x500"))) if name not in INVENTED]
    alone = [name for name in known if name != "wind"]
    singles: list[str] = []
    while len(singles) < counts["single"]:
        singles += [str(name) for name in random.permutation(alone)]
    work: list[tuple[str, tuple[str, ...]]] = [("single", (name,)) for name in singles[: counts["single"]]]
    work += [("clean", ())] * counts["clean"]
    for _ in range(counts["pair"]):
        pair = tuple(map(str, random.choice(known, 2, replace=False)))
        work.append(("pair", ("rotor_drag", "wind") if "wind" in pair else pair))  # air is felt through drag alone
    work += [("invented", (INVENTED[i % len(INVENTED)],)) for i in range(counts["invented"])]
    return [work[i] for i in random.permutation(len(work))]


def wilson(hits: int, count: int) -> str:
    """Share with its 95 % Wilson interval."""
    if count == 0:
        return "not run"
    z, share = 1.96, hits / count
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return f"{hits} of {count} ({share:.0%}; 95 % interval {max(centre - half, 0):.0%} to {min(centre + half, 1):.0%})"


def report(outcomes: Sequence[Outcome]) -> None:
    """Shares, confusion and bias."""
    kinds = {kind: [o for o in outcomes if o.kind == kind] for kind in ("single", "pair", "clean", "invented")}
    singles = [o for o in kinds["single"] if o.detectable()]
    right = [o for o in singles if o.first() == o.hidden[0]]
    told = [o for o in singles if o.first() == o.hidden[0] or o.hidden[0] in o.alternatives]
    silent = [o for o in singles if o.verdict in ("clean", "refused")]
    print(f"\nsingles, detectable                        {wilson(len(singles), len(kinds['single']))}")
    print(f"detectable singles, right first name       {wilson(len(right), len(singles))}")
    print(f"  first name or an alternative to it       {wilson(len(told), len(singles))}")
    print(f"  said clean or refused                    {wilson(len(silent), len(singles))}")
    rotors = [hit for o in singles for hit in o.rotors]
    print(f"  right rotor, where one was named         {wilson(sum(rotors), len(rotors))}")
    blind = [o for o in kinds["single"] if not o.detectable()]
    named = [o for o in blind if o.hidden[0] in o.named]
    wrong = [o for o in blind if o.named and o.hidden[0] not in o.named]
    print(f"too small to be detectable, named          {wilson(len(named), len(blind))}")
    print(f"  wrongly named                            {wilson(len(wrong), len(blind))}")
    pairs = [o for o in kinds["pair"] if o.detectable()]
    both = [o for o in pairs if set(o.hidden) <= set(o.named)]
    more = [o for o in singles + pairs if set(o.named) - set(o.hidden)]
    print(f"detectable pairs, both named               {wilson(len(both), len(pairs))}")
    print(f"detectable, with a further name beside     {wilson(len(more), len(singles + pairs))}")
    alarms = [o for o in kinds["clean"] if o.verdict != "clean"]
    print(f"clean flights, false alarms                {wilson(len(alarms), len(kinds['clean']))}")
    left = [o for o in kinds["invented"] if o.verdict == "unexplained"]
    print(f"invented, verdict unexplained              {wilson(len(left), len(kinds['invented']))}")
    shown = [o for o in kinds["invented"] if o.detectable()]
    left = [o for o in shown if o.verdict == "unexplained"]
    print(f"  of those detectable                      {wilson(len(left), len(shown))}")
    print("\nhidden (down), first name (counts)")
    for hidden in sorted({o.hidden for o in outcomes}):
        counts = Counter(o.first() for o in outcomes if o.hidden == hidden)
        print(f"  {' + '.join(hidden) or 'nothing':40} " + ", ".join(f"{n} {c}" for n, c in counts.most_common()))
    print(
        "\nhidden alone: detectable and right of all; RMS share of weight or weight times arm at which |t| is 6 (median)"
    )
    for name in sorted({o.hidden[0] for o in kinds["single"]}):
        own = [o for o in kinds["single"] if o.hidden[0] == name]
        seen = [o for o in own if o.detectable()]
        limits = [o.shares[0] * DETECTABLE / o.t[0] for o in own if np.isfinite(o.shares[0]) and o.t[0] > 0.0]
        limit = f"{np.median(limits):.2%}" if limits else "told by the sensors"
        print(f"  {name:20} {sum(o.first() == name for o in seen):3} of {len(seen):3} of {len(own):3}   {limit}")
    print("\nmass within 1 %, moments within 2 % or three of their deviations, of those detectable")
    for kind, members in (("single", singles), ("pair", pairs)):
        print(f"  {kind}s, before                          {wilson(sum(o.met_before for o in members), len(members))}")
        print(f"  {kind}s, after                           {wilson(sum(o.met_after for o in members), len(members))}")
    for kind in ("single", "pair"):
        sizes_of = np.array([(o.before, o.after) for o in kinds[kind] if o.named and np.isfinite(o.before + o.after)])
        if len(sizes_of):
            before, after = np.median(sizes_of, axis=0)
            print(f"\n{kind}s, RMS relative error of mass and inertia: median {before:.1%} before, {after:.1%} after")
    if outcomes:
        print(f"\ndiagnosis of {DURATION_S:.0f} s: median {np.median([o.seconds for o in outcomes]):.0f} s")


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.blind", description="Diagnosis of effects it was not told about.")
    for kind, number in (("singles", 44), ("pairs", 20), ("clean", 40), ("invented", 15)):
        parser.add_argument(f"--{kind}", type=int, default=number)
    parser.add_argument("--seed", type=int, default=None, help="master seed (default: a fresh one, printed)")
    parser.add_argument("--minutes", type=float, default=math.inf, help="start no flight after this time")
    parser.add_argument(
        "--rows", type=Path, default=None, help="append each flight's outcome to this file, as JSON lines"
    )
    options = parser.parse_args(argv)
    over = time.monotonic() + 60.0 * options.minutes
    master = secrets.randbits(32) if options.seed is None else options.seed
    counts = {"single": options.singles, "pair": options.pairs, "clean": options.clean, "invented": options.invented}
    print("master seed", master, counts, flush=True)
    random = np.random.default_rng(master)
    plans = {
        name: [
            plan_excitation(
                load_vehicle(find_config("vehicles", name)),
                criterion="A",
                duration_s=DURATION_S,
                seed=int(random.integers(2**31)),
                time_budget_s=5.0,
            )
            for _ in range(PLANS)
        ]
        for name in VEHICLES
    }
    outcomes, lost = [], 0
    work = schedule(random, counts)
    for (kind, names), own in zip(work, random.spawn(len(work)), strict=True):
        if time.monotonic() > over:
            print("out of time: the rest was not flown")
            break
        vehicle = str(own.choice(VEHICLES))
        outcome = fly(kind, names, vehicle, plans[vehicle][int(own.integers(PLANS))], own)
        if outcome is None:
            lost += 1
            continue
        outcomes.append(outcome)
        if options.rows is not None:
            with options.rows.open("a") as rows:
                rows.write(json.dumps({"seed": master, "vehicle": vehicle, **asdict(outcome)}) + "\n")
        print(
            f"{len(outcomes) + lost}/{len(work)} {vehicle:8} {kind:8} {' + '.join(names) or 'nothing':30} -> {outcome.verdict}: "
            f"{', '.join(outcome.named) or 'no finding'}",
            flush=True,
        )
    if lost:
        print(f"{lost} flights ended on the floor and are left out")
    report(outcomes)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
