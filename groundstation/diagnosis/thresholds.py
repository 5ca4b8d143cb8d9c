"""The tuned numbers that can change what a diagnosis says, in one table: value, reason, source, and what each was
chosen on.

The modules of the diagnosis read :data:`THRESHOLDS`; docs/diagnosis.md prints it
(``tests/test_diagnosis_thresholds.py`` holds it to this file). Guards against division by zero, grids and priors stand
where they are used: the least size of an effect in its own file, priors in the tables of parameters.

``chosen_on`` names the commit that brought the value and whether it came before or after the first blind bench was kept
(3707858, 2026-11-22 18:08). A value that came after it may have been influenced by that bench, and only benches with
other seeds or other physics say anything of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import log, radians
from typing import TypeVar

Number = TypeVar("Number", int, float, tuple[float, float])

BEFORE = "before the first blind bench"
AFTER = "after the first blind bench; data not recorded"


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the table: ``unit`` is empty where the value is a share, a count or a statistic."""

    name: str
    value: int | float | tuple[float, float]
    unit: str
    reason: str
    source: str
    chosen_on: str


def _entry(value: Number, reason: str, *, source: str, chosen_on: str, unit: str = "") -> Number:
    return field(default=value, metadata={"reason": reason, "source": source, "chosen_on": chosen_on, "unit": unit})


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Tuned constants of the diagnosis."""

    # Which effects are named: attribution.py, rivals.py, discrepancy.py
    effect_chance: float = _entry(
        1e-5,
        "Chance that noise alone names an effect, shared by its variants: about 25 effects give one false name in 4000 "
        "flights.",
        source="Bonferroni's inequality",
        chosen_on=f"c9bbce4, {BEFORE}",
    )
    hint_chance: float = _entry(
        1e-3,
        "Chance that noise alone gives a hint of an effect, shared by its variants: about 25 effects give one in 40 "
        "campaigns a flight that it does not need.",
        source="Bonferroni's inequality",
        chosen_on="decision 64, on four campaigns that missed a lift or a drag (seeds 2799776732 and 2830910586)",
    )
    effects_most: int = _entry(
        6,
        "Most effects named in one selection; more than a handful cannot be told apart on one flight.",
        source="judgement",
        chosen_on=f"c9bbce4, {BEFORE}",
    )
    passes_most: int = _entry(
        4,
        "Selections about one joint estimate after another; two are enough for nearly every flight.",
        source="Gauss-Newton steps",
        chosen_on=f"decision 33, {AFTER}",
    )
    refinements_most: int = _entry(
        4,
        "How often an instant, a length or a curve is looked at more closely, on a finer grid each time.",
        source="judgement",
        chosen_on=f"744ab89, {AFTER}",
    )
    rivals_most: int = _entry(
        6,
        "How many rivals contest a place, the strongest first; each costs a joint estimate.",
        source="judgement",
        chosen_on=f"5312b59, {AFTER}",
    )
    inseparable: float = _entry(
        9.0,
        "Two explanations whose chi squared differs by less (three standard deviations) are not told apart.",
        source="likelihood ratio of a normal distribution",
        chosen_on=f"c9bbce4, {BEFORE}",
    )
    material_share: float = _entry(
        5e-4,
        "Least RMS of an effect that is a finding: of its force as a share of weight, or of its torque as one of "
        "weight times arm.",
        source="decision 6",
        chosen_on="dc2e2a9, after the first blind bench, which had shown what a smaller limit lets through; 1e-3 "
        "before it",
    )
    plausible_margin_std: float = _entry(
        2.0,
        "Standard deviations by which an estimate may lie outside its plausible range and still be that of a plausible "
        "effect.",
        source="95 % of a normal distribution",
        chosen_on=f"c9bbce4, {BEFORE}",
    )
    form_error_share: float = _entry(
        0.1,
        "Share of an effect's amplitude that its formula may miss: each is an expansion about hover.",
        source="rule of thumb for first-order aerodynamic models",
        chosen_on=f"5312b59, {AFTER}; not changed since",
    )
    form_share: float = _entry(
        0.3,
        "Spread of the share in which a named effect may take another power of speed, height, thrust or rates, or act "
        "on one axis alone.",
        source="drag is proportional to a power of the speed between one and two; judgement",
        chosen_on="MuJoCo flights of seeds 7000 to 8200 (benchmarks.other_forms)",
    )
    pendulum_share: float = _entry(
        0.2,
        "Least share of the sideways residual force's power that a pendulum explains before it is tried. A disturbance "
        "as large as the load's pull leaves it 0.30; of flights without a load each gave 0.09 or less.",
        source="judgement",
        chosen_on="21 flights of two simulators, 13 of them with loads (benchmarks.slung_load, seeds 100 to 211)",
    )
    pendulum_uneven: float = _entry(
        0.3,
        "How far the load of each fourth of a swing may lie from that of the whole, as a share. Of those in step it "
        "was 0.17 at most, of those out of step and of flights without a load 0.39 at least.",
        source="judgement",
        chosen_on="21 flights of two simulators, 13 of them with loads (benchmarks.slung_load, seeds 100 to 211)",
    )
    swing_share: float = _entry(
        0.005,
        "RMS of the sideways force that thrust and weight leave, as a share of the weight, below which nothing is said "
        "of a swinging load: twice what rooms show.",
        source="judgement",
        chosen_on="12 flights of two simulators; looked at again on 28 with loads and 10 without (decision 47)",
    )
    swing_load: float = _entry(
        0.015,
        "Least load that is reported, as a share of the mass: a cable lighter than a disturbance points nowhere.",
        source="judgement",
        chosen_on="12 flights of two simulators; looked at again on 28 with loads and 10 without (decision 47)",
    )
    swing_left: float = _entry(
        0.4,
        "Share of that force's power that a swinging load may leave. With loads it was 0.29 at most, without 0.79 at "
        "least.",
        source="judgement",
        chosen_on="12 flights of two simulators; looked at again on 28 with loads and 10 without (decision 47)",
    )
    swing_driven: float = _entry(
        0.1,
        "Rate at which air may seem to drive a swinging load, as a share of its angular frequency: air takes energy, "
        "and what it seems to give is an error of the search.",
        source="judgement",
        chosen_on="the measured flights of shared/data, none of which carries a load (-0.22 and less in three)",
    )
    swing_form: float = _entry(
        0.05,
        "Share by which a load that is told by its force, and its cable's length, lie off, as a standard deviation: 3 "
        "to 5 % in 27 of 28.",
        source="judgement",
        chosen_on="28 flights of two simulators with loads (decision 47)",
    )
    worn_std: float = _entry(
        6.0,
        "Standard deviations of a rotor's loss from which an identification speaks of it. The largest of 40 flights "
        "with healthy rotors, drawn after it was chosen, was 3.7; the least of 16 with a weak one was 48.",
        source="judgement",
        chosen_on="63 flights (decision 57)",
    )
    worn_loss: float = _entry(
        0.02,
        "Least loss of a rotor that an identification speaks of: half a percent of a quadrotor's mass. Inflow and an "
        "IMU that is turned pass for 1.1 to 1.3 %.",
        source="judgement",
        chosen_on="63 flights (decision 57)",
    )

    held_out_blocks: int = _entry(
        6,
        "Blocks of time that a flight is divided into; each is judged by the parameters of the others.",
        source="cross-validation with 5 to 10 folds, Hastie, Tibshirani, Friedman 2009, 7.10",
        chosen_on=f"c9bbce4, {BEFORE}",
    )
    held_out_guard_s: float = _entry(
        1.5,
        "Left out of training on either side of a held-out block, so that the disturbance's memory does not tie the "
        "two.",
        source="blocked cross-validation, Burman, Chow, Nolan 1994",
        chosen_on=f"c9bbce4, {BEFORE}",
        unit="s",
    )

    # What is left when all findings are taken out: screen.py, proposal.py
    dependence_chance: float = _entry(
        1e-6,
        "Chance, over all pairs of channel and variable, that noise alone shows a dependence.",
        source="Bonferroni's inequality",
        chosen_on=f"ad99ea9, {BEFORE}",
    )
    dependence_knots: int = _entry(
        6,
        "Quantiles that the hat functions of a dependence stand on: enough for a bend, few enough for the rows of one "
        "flight.",
        source="judgement",
        chosen_on=f"ad99ea9, {BEFORE}",
    )
    term_chance: float = _entry(
        1e-5,
        "Chance, over all terms tried, that noise alone adds one to a proposed formula.",
        source="Bonferroni's inequality",
        chosen_on=f"bdc8ba9, {AFTER}",
    )
    terms_most: int = _entry(
        4,
        "Most terms of a proposed formula; a longer one is no explanation.",
        source="judgement",
        chosen_on=f"bdc8ba9, {AFTER}",
    )
    same_term_correlation: float = _entry(
        0.95,
        "Correlation from which two terms are one on this flight, and a formula takes one of them.",
        source="judgement",
        chosen_on=f"06b6001, {AFTER}",
    )

    # Lag, dead time and thrust constant: timing.py, scale.py
    timing_wald: float = _entry(
        25.0,
        "Wald statistic (five standard deviations) of a lag, a dead time or a thrust constant other than declared.",
        source="normal distribution: once in two million",
        chosen_on=f"ad99ea9, {BEFORE}",
    )
    timing_wald_joint_more: float = _entry(
        10.0,
        "By how much more the joint statistic of lag up, lag down and dead time has to be: it has three degrees of "
        "freedom.",
        source="chi squared distribution: 35 with three degrees of freedom is once in eight million",
        chosen_on=f"ad99ea9, {BEFORE}",
    )

    timing_told_wald: float = _entry(
        5.99,
        "Wald statistic, in what is published, of both lags from none, below which a lag is not named.",
        source="chi squared distribution: 95 % with two degrees of freedom",
        chosen_on="5f097b6, on a simulated flight whose battery sagged",
    )
    timing_divided_std: float = _entry(
        5.0,
        "Published standard deviations that each of lag and dead time has to be from none where both are named.",
        source="normal distribution: once in two million",
        chosen_on="94ce155, on a simulated campaign with a dead time whose battery sagged",
    )

    # Sensors among themselves: kinematic.py
    sensor_std: float = _entry(
        5.0,
        "Standard deviations from nothing that make a finding about clocks or frames.",
        source="normal distribution: once in two million",
        chosen_on=f"ad99ea9, {BEFORE}",
    )
    sensor_scale_most: float = _entry(
        0.5,
        "Error of a gyro's scale above which a reconstruction that is linear in small errors says nothing: the noise "
        "of a gyro that hardly sees the motion passes for its scale, and that for a turn of the marker body.",
        source="judgement; gyros are right to a few percent",
        chosen_on="5f097b6, on a simulated flight whose gyro rattles by 1 rad/s (benchmarks.odd_flights)",
    )
    rotor_upright_rad: float = _entry(
        radians(0.3),
        "How upright rotors stand in a frame, one standard deviation; it decides whether IMU or marker body is turned.",
        source="how well a frame is built; 0.3 degrees",
        chosen_on=f"43c9c84, {AFTER}",
        unit="rad",
    )

    # Thrust curve and the point of linearisation: curve.py, linearisation.py
    curve_error_share: float = _entry(
        0.5,
        "Share of the declared curve's squared error that another has to come below before all is estimated about it.",
        source="judgement; smaller departures are the linear effect's",
        chosen_on=f"0569b90, {AFTER}",
    )
    curve_low_pass_hz: float = _entry(
        1.0,
        "Thrust and specific force are compared below it, where neither rotor lag (tens of ms) nor sensor noise "
        "matters.",
        source="time constants of rotors",
        chosen_on=f"0569b90, {AFTER}",
        unit="Hz",
    )
    bent_base_cost: float = _entry(
        10.0,
        "Fall of half the minus-log-likelihood per coefficient from which the base is taken to be bent; chance gives a "
        "half.",
        source="likelihood ratio, Wilks 1938",
        chosen_on=f"06f80bb, {AFTER}",
    )

    # Noise and evidence: evidence.py, signals.py, whitening.py, pipeline.py
    evidence_rate_hz: float = _entry(
        50.0,
        "Rate to which evidence is averaged: effects move with the body, whose motion lies below 10 Hz.",
        source="bandwidth of attitude control",
        chosen_on=f"ad99ea9, {BEFORE}",
        unit="Hz",
    )
    drift_knot_s: float = _entry(
        6.0,
        "Time between corners of the drift that is kept out of the noise; faster changes are left to the noise.",
        source="judgement",
        chosen_on=f"9934c19, {BEFORE}",
        unit="s",
    )
    voltage_knot_s: float = _entry(
        6.0,
        "Time between corners of a battery's slow course, its instrument; a drop under load is faster.",
        source="judgement",
        chosen_on=f"b6c316d, {AFTER}",
        unit="s",
    )
    variants_in_noise: int = _entry(
        4,
        "How many settings of an effect are kept out of the noise before it is found; of those found, the very "
        "setting.",
        source="judgement",
        chosen_on=f"8d933ba, {AFTER}",
    )
    outlier_std: float = _entry(
        4.0,
        "Standard deviations of a whitened row from which it counts for less.",
        source="Huber 1964",
        chosen_on=f"c9bbce4, {BEFORE}",
    )
    instruments_strong: float = _entry(
        10.0,
        "F of a parameter's instruments below which a note says that its number rests on the motion as flown.",
        source="Staiger and Stock 1997; Stock and Yogo 2005",
        chosen_on=f"the literature, {AFTER}",
    )
    noise_refills: int = _entry(
        3,
        "Rounds in which the noise that generic columns take is put back and the noise fitted anew.",
        source="data augmentation, Tanner and Wong 1987",
        chosen_on="0bfb8c4, after the first blind bench; checked on clean flights of master seed 777",
    )
    band_bins: int = _entry(
        8,
        "Least number of frequencies that one value of a spectrum is averaged over: it is then known to a third.",
        source="averaged periodogram, Priestley 1981",
        chosen_on="0bfb8c4, after the first blind bench; checked on clean flights of master seed 777",
    )

    # Mean thrusts beside those of healthy flights: trim.py, pipeline.py
    trim_freedom_least: int = _entry(
        3,
        "Healthy flights that there have to be more of; fewer do not show how they scatter.",
        source="degrees of freedom of a covariance",
        chosen_on=f"4958ac4, {AFTER}",
    )
    trim_flying_share: float = _entry(
        0.6,
        "Share of the median total thrust from which the vehicle is taken to fly.",
        source="a vehicle that flies carries its weight in the mean",
        chosen_on=f"4958ac4, {AFTER}",
    )
    trim_settled_s: float = _entry(
        1.5,
        "How long after lift-off and before landing thrusts still turn the vehicle back to where it shall look.",
        source="settling time of yaw control",
        chosen_on=f"5a54091, {AFTER}",
        unit="s",
    )
    trim_scatter_shares: tuple[float, float] = _entry(
        (3e-3, 3e-2),
        "Between which scales trims of a healthy vehicle differ from session to session, as shares of the weight (and "
        "arm, and torque ratio), each as likely on a logarithmic scale: a battery of a quarter of the weight put in 1 "
        "mm aside shifts the centre of a nano-quadrotor by a hundredth of its arm. Healthy flights of one session do "
        "not tell this.",
        source="statics",
        chosen_on=f"5a54091, {AFTER}",
    )
    trim_healthy_chance: float = _entry(
        1e-3,
        "Probability below which what an explanation leaves is no healthy scatter.",
        source="judgement",
        chosen_on=f"4958ac4, {AFTER}",
    )
    trim_loss_most: float = _entry(
        0.5,
        "Largest loss of a rotor's thrust; with more no quadrotor hovers.",
        source="trim of four rotors with a reserve of about two",
        chosen_on=f"5a54091, {AFTER}",
    )
    trim_load_most: float = _entry(
        0.5,
        "Largest load, as a share of the weight; with more few vehicles hover.",
        source="trim of four rotors with a reserve of about two",
        chosen_on=f"4958ac4, {AFTER}",
    )
    trim_propeller_shortest: float = _entry(
        0.7,
        "Shortest propeller that still flies, as a share of its diameter: it gives a quarter of the thrust at the same "
        "speed.",
        source="thrust is proportional to the fourth power of the diameter",
        chosen_on=f"5a54091, {AFTER}",
    )
    trim_unexplained_share: float = _entry(
        0.25,
        "Share of a channel's squared difference from which what is left of it is reported as unexplained.",
        source="half of the amplitude",
        chosen_on=f"4958ac4, {AFTER}",
    )

    # What becomes of findings: adoption.py, published.py, next_flight.py
    prediction_worse: float = _entry(
        1.1,
        "Growth of a prediction's error that scatter of its few dozen windows does not make; findings that cause more "
        "are not adopted.",
        source="scatter of an RMS of dozens of windows",
        chosen_on="6697e6a; data not recorded",
    )
    channel_worse: float = _entry(
        1.05,
        "Ratio of errors on unseen data, after to before, from which a channel got worse: blocks of a flight differ by "
        "some percent.",
        source="scatter between blocks of a flight",
        chosen_on="8a47da1; data not recorded",
    )
    rival_settings_most: int = _entry(
        8,
        "Settings of a rival (instants, lengths, rotors) that a plan for the next flight tries against the truth.",
        source="cost of planning",
        chosen_on=f"dfc8911, {AFTER}",
    )
    log_odds_most: float = _entry(
        log(1e6),
        "Log odds past which other things than noise decide, so that a plan's prediction gives no number.",
        source="once in a million",
        chosen_on=f"dfc8911, {AFTER}",
    )


THRESHOLDS = Thresholds()


def entries() -> list[Entry]:
    """The table, in its order."""
    return [Entry(name=item.name, value=getattr(THRESHOLDS, item.name), **item.metadata) for item in fields(Thresholds)]
