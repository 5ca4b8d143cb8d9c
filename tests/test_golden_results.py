"""Results on fixed flights are what they were (``python -m benchmarks.golden``)."""

from __future__ import annotations

import pytest

from studies import golden


@pytest.mark.parametrize("case", golden.SHORT, ids=lambda case: case.__name__)
def test_results_are_what_they_were(case: golden.Case) -> None:
    kept = golden.frozen()
    print(f"golden results of {kept['commit']}, seed {kept['seed']}")
    try:
        found = golden.compare(case, kept)
    except golden.Missing as missing:
        pytest.skip(str(missing))
    assert not found, "\n".join(
        [*found[:20], f"{len(found)} differ; if that is meant: python -m benchmarks.golden --freeze"]
    )


def test_every_bit_counts_here_and_half_a_standard_deviation_elsewhere() -> None:
    was = {"verdict": "clean", "x": {"value": 0.1, "std": 1e-3}, "series": [1.0, 1e-9]}
    near = was | {"x": {"value": 0.1 + 2e-17, "std": 1e-3}, "series": [1.0, 2e-9]}
    assert len(list(golden.differences(was, near))) == 2
    assert not list(golden.differences(was, near, exactly=False))
    assert len(list(golden.differences(was, was | {"x": {"value": 0.1007, "std": 1e-3}}, exactly=False))) == 1
    assert len(list(golden.differences(was, was | {"verdict": "explained"}, exactly=False))) == 1
    assert list(golden.differences(was, {"x": was["x"]}, exactly=False))


def test_no_finding_holds_zero_where_sets_without_it_explain_as_well() -> None:
    """A load let go once brought two rotors with it, a quarter of a percent and less, each as likely as not."""
    cases = [case["diagnose"] for case in golden.frozen()["cases"].values() if "diagnose" in case]
    findings = [finding for case in cases for finding in case["findings"]]
    assert len(findings) >= 10
    for finding in findings:
        if finding["confidence"] < 0.5 and not finding["alternatives"]:
            intervals = [p["ci95"] for p in finding["parameters"].values() if p["std"] > 0.0]
            assert any(low > 0.0 or high < 0.0 for low, high in intervals), finding
