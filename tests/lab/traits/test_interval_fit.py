"""Factors of intervals are found again from errors that were drawn with them."""

import numpy as np
import pytest
import yaml

from cherrypicker.geometry.error_terms import FACTORS_FILE
from cherrypicker_lab.traits.interval_fit import TraitCases, fit, fit_all

PRESENT = yaml.safe_load(FACTORS_FILE.read_text(encoding="utf-8"))


def drawn_cases(source, n, rng, least=2.0, shared=0.5):
    """Angles whose errors are `least` degrees and `shared` of the lean of their points."""
    lean = rng.uniform(0.5, 20.0, n)
    off = np.hypot(least, shared * lean) * rng.standard_normal(n)
    return [
        {
            "source": source, "tree": str(row % 8), "trait": "insertion_angle_deg", "true": 60.0,
            "found": 60.0 + off[row], "low": 59.0 + off[row], "high": 61.0 + off[row],
            "terms": {"angle_least_deg": 1.0, "angle_shared": lean[row]}, "at_least": False,
        }
        for row in range(n)
    ]  # fmt: skip


def test_factors_are_found_again_whatever_a_few_gross_errors_say():
    rng = np.random.default_rng(0)
    cases = drawn_cases("one", 4000, rng)
    for case in cases[::100]:
        case["found"] += 80.0
    found = fit(TraitCases(cases), {"angle_least_deg": 1.0, "angle_shared": 0.0})
    assert found["angle_least_deg"] == pytest.approx(2.0, rel=0.2)
    assert found["angle_shared"] == pytest.approx(0.5, rel=0.2)
    assert TraitCases(cases).cover(found)[0] == pytest.approx(0.9, abs=0.01)


def test_every_source_weighs_the_same_and_the_least_has_no_upper_end():
    rng = np.random.default_rng(1)
    few, many = drawn_cases("few", 8, rng), drawn_cases("many", 800, rng)
    cases = TraitCases(few + many)
    assert [cases.weight[:8].sum(), cases.weight[8:].sum()] == pytest.approx([1, 1])
    for case in few:
        case |= {"found": 30.0, "low": 25.0, "high": 31.0, "at_least": True}
    cases, factors = TraitCases(few), {"angle_least_deg": 1.0, "angle_shared": 0.1}
    assert cases.cover(factors)[0] == 1.0
    assert not cases.is_fitted.any()


def test_a_source_that_is_checked_is_not_fitted_to():
    rng = np.random.default_rng(2)
    cases = drawn_cases("one", 800, rng) + drawn_cases("two", 800, rng)
    cases += drawn_cases("foreign", 80, rng, least=20.0)
    factors, table = fit_all(cases, PRESENT, ["foreign"])
    entry = factors["angle_shared"]
    assert entry["value"] == pytest.approx(0.5, rel=0.3)
    assert entry["fitted_on"] == "1600 values of 16 trees: 8 one, 8 two"
    assert factors["top_error"] == PRESENT["top_error"]
    rows = {
        row[2]: row
        for row in ([cell.strip() for cell in line.split("|")] for line in table.splitlines())
    }
    assert float(rows["foreign"][8].split(" ")[0]) < 40
    assert float(rows["one"][8].split(" ")[0]) > 85
    assert float(rows["two"][7].split(" ")[0]) < 50  # the intervals as given are a degree wide
