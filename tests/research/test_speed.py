"""The page about speed is made of what was measured, and says what was missed."""

import json
from pathlib import Path

import pytest

from research.throughput.figures import SCENARIO, Figure, faster, takes, written
from research.throughput.page import page

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_that_of_the_measurements_kept_beside_it():
    record = json.loads((DOCS / "bench.json").read_text(encoding="utf-8"))
    figures = [Figure(**figure) for figure in record["figures"]]
    assert not record["quick"]
    assert (DOCS / "speed.md").read_text(encoding="utf-8") == page(figures, record["machine"], SCENARIO)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (61.3, "s", "61.3 s"),
        (0.0121, "s", "12.1 ms"),
        (3.4e-8, "s", "34 ns"),
        (9.38, "x", "9.38 x"),
        (0.5, "share", "0.5 share"),
    ],
)
def test_numbers_have_handy_units(value, unit, text):
    assert written(value, unit) == text


def test_goals_are_at_least_for_ratios_and_at_most_for_times():
    assert faster("a", 1.0, 4.0, 4).met
    assert not faster("a", 1.0, 3.9, 4).met
    assert takes("a", 0.1, 0.1).met
    assert not takes("a", 0.2, 0.1).met
    assert takes("a", 0.2).met is None
    text = page([faster("fast", 2.0, 1.0, 4), takes("slow", 2e-3, 1e-2)], "a machine", "a-scenario")
    assert "| fast | 0.5 x | 4 x | no |" in text
    assert "| slow | 2 ms | 10 ms | yes |" in text
