"""Numbers as they are written, and series as they are thinned."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.reporting import figures
from groundstation.reporting.markup import Markup, element, fragment, table
from groundstation.reporting.units import (
    decimals,
    fixed,
    label,
    percent,
    quantity,
    readable,
    scale_for,
    significant,
    split_unit,
)


@pytest.mark.parametrize(
    ("name", "value", "std", "written"),
    [
        ("mass_kg", 1.82543, 0.0006, "1.8254 ± 0.0012 kg"),
        ("mass_kg", 0.0273, 0.0001, "27.30 ± 0.20 g"),
        ("ixx_kg_m2", 1.642e-5, 3e-7, "(16.42 ± 0.59)·10⁻⁶ kg m²"),
        ("ixy_kg_m2", -0.0011, 0.0001, "(−1.10 ± 0.20)·10⁻³ kg m²"),
        ("rotor_lag_up_s", 0.0417, 0.0009, "41.7 ± 1.8 ms"),
        ("thrust_coefficient_n_s2", 1.11e-5, 1e-8, "(11.100 ± 0.020)·10⁻⁶ N s²"),
        ("d_x_kg_s", 0.3021, 0.011, "0.302 ± 0.022 kg/s"),
        ("thrust_scale", 0.91, 0.01, "0.910 ± 0.020"),
        ("mass_kg", 1.8, 0.0, "1.80 kg"),
    ],
)
def test_digits_follow_from_the_interval_and_prefixes_from_the_size(name, value, std, written):
    assert quantity(name, Estimate.normal(value, std)) == written


@pytest.mark.parametrize(
    ("name", "stem", "unit"),
    [
        ("torque_to_thrust_m", "torque_to_thrust", "m"),
        ("gyro_bias_x_rad_s", "gyro_bias_x", "rad/s"),
        ("vx_m_s", "vx", "m/s"),
        ("torque_x_nm", "torque_x", "N m"),
        ("force_z_n", "force_z", "N"),
        ("izz_kg_m2", "izz", "kg m²"),
        ("thrust_scale", "thrust_scale", ""),
    ],
)
def test_the_unit_is_the_last_part_of_the_name(name, stem, unit):
    assert split_unit(name) == (stem, unit)


def test_parameters_are_called_by_the_fields_names():
    assert [label(name) for name in MASS_AND_TENSOR] == ["mass", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"]


@given(st.floats(1e-9, 1e6), st.sampled_from(["kg", "kg m²", "N m", "s", "N s²", "kg/s", "rad", "m"]))
def test_a_scaled_number_is_readable_and_the_same_quantity(size, unit):
    scale = scale_for(unit, [size])
    shown = size * scale.factor
    if unit == "kg" and size < 1e-7:
        return
    assert 0.099 < shown < 1e4
    prefix = {"µ": 1e6, "n": 1e9, "m": 1e3, "k": 1e-3}.get(scale.unit[0], 1.0) if scale.unit != unit else 1.0
    if scale.unit.startswith("10"):
        digits = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
        prefix = 10.0 ** -int(scale.unit.split()[0][2:].translate(digits))
    if scale.unit in {"g", "mg"}:
        prefix = 1e3 if scale.unit == "g" else 1e6
    assert math.isclose(prefix, scale.factor, rel_tol=1e-9)


@given(st.floats(1e-8, 1e3))
def test_two_digits_of_an_uncertainty_are_shown(u):
    shown = float(f"{u:.{decimals(u)}f}")
    assert abs(shown - u) <= max(0.051 * u, 0.5) if u > 10 else abs(shown - u) <= 0.051 * u


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1234567.0, "1.23·10⁶"),
        (-0.00001234, "−1.23·10⁻⁵"),
        (99.96, "100.0"),
        (float("nan"), "–"),
        (16.363, "16.4"),
    ],
)
def test_numbers_without_interval(value, text):
    assert significant(value) == text


def test_signs_are_typographic_and_zero_has_none():
    assert fixed(-0.0004, 2) == "0.00"
    assert percent(0.38) == "+38.0 %" and percent(-0.05) == "−5.0 %" and percent(0.00001) == "0.0 %"


@given(st.integers(2, 4000), st.integers(1, 50), st.integers(0, 2**32 - 1))
def test_an_envelope_is_made_of_samples_and_loses_no_extreme(k, bins, seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.9, 1.1, k))
    y = rng.standard_normal(k)
    thin_t, thin_y = figures.envelope(t, y, bins)
    assert np.all(np.diff(thin_t) > 0)
    assert set(zip(thin_t, thin_y, strict=True)) <= set(zip(t, y, strict=True))
    assert thin_y.min() == y.min() and thin_y.max() == y.max()
    assert len(thin_t) <= max(2 * bins, k if k <= 2 * bins else 0)
    # Each bin of samples keeps its own extremes, not only the whole.
    edges = np.linspace(0, k, bins + 1).astype(int)
    for a, b in itertools.pairwise(edges):
        if b > a:
            inside = thin_y[(thin_t >= t[a]) & (thin_t <= t[b - 1])]
            assert inside.min() == y[a:b].min() and inside.max() == y[a:b].max()


@pytest.mark.parametrize("bins", [1000, 20])
def test_no_line_is_drawn_across_a_gap(bins):
    t = np.concatenate([np.arange(0.0, 1.0, 0.01), np.arange(3.0, 4.0, 0.01)])
    thin_t, thin_y = figures.envelope(t, np.sin(t), bins)
    hole = np.flatnonzero(np.isnan(thin_t))
    assert len(hole) == 1 and np.isnan(thin_y[hole[0]])
    assert thin_t[hole[0] - 1] == pytest.approx(0.99) and thin_t[hole[0] + 1] == 3.0
    assert figures.stretches(t) == [pytest.approx((0.0, 0.99)), pytest.approx((3.0, 3.99))]


def test_a_spectrum_puts_a_tone_where_it_is_and_holds_its_power():
    t = np.arange(0.0, 60.0, 0.004)
    rng = np.random.default_rng(5)
    y = 0.3 * np.sqrt(2.0) * np.sin(2 * np.pi * 7.0 * t) + 0.1 * rng.standard_normal(len(t))
    frequency, density = figures.spectrum(t, y)
    assert frequency[np.argmax(density)] == pytest.approx(7.0, abs=0.1)
    power = np.sum(density**2) * (frequency[1] - frequency[0])
    assert power == pytest.approx(0.3**2 + 0.1**2, rel=0.03)


def test_text_is_escaped_and_markup_is_not():
    assert element("p", "<b>", Markup("<i>x</i>"), None, ["&", "'"], title='"<>') == (
        '<p title="&quot;&lt;&gt;">&lt;b&gt;<i>x</i>&amp;&#x27;</p>'
    )
    assert isinstance(fragment("a"), Markup)
    assert "<td" in table("c", ["<h>"], [["<r>", "<d>"]]) and "<d>" not in table("c", ["<h>"], [["<r>", "<d>"]])


def test_sentences_lose_their_snakes_but_names_and_paths_stay():
    text = "Izz varies with rate_z_rad_s, thrust_n. See com_offset and lab_x in configs/my_drone_m.toml (izz_kg_m2)."
    assert readable(text, {"com_offset"}) == (
        "Izz varies with rate z, thrust. See com offset and lab_x in configs/my_drone_m.toml (Izz)."
    )
