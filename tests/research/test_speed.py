"""The page about speed has the decisions of all timed policies, and a slower run is noticed."""

import json

import pytest

from research.throughput.measure import DECISIONS, Figure, compared, context, written


def test_the_page_has_a_row_for_every_decision():
    rows = context("speed")["rows"]
    assert {row[0].rpartition(": ")[2] for row in rows if row[0].startswith("decision")} == set(DECISIONS)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(61.3, "s", "61.3 s"), (0.0121, "s", "12.1 ms"), (3.4e-8, "s", "34 ns"), (9.38, "x", "9.38 x")],
)
def test_numbers_have_readable_units(value, unit, text):
    assert written(value, unit) == text


def test_a_run_is_compared_with_the_last_good_one(tmp_path):
    file, runs = tmp_path / "history.jsonl", (10.0, 9.2, 8.0, 9.0)
    found = [compared(file, [Figure("steps", x, "x"), Figure("start", 1.0, "s")]) for x in runs]
    assert found == [[], [], ["steps: 8 x, 9.2 x in the last good run"], []]
    records = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    assert [record["good"] for record in records] == [True, True, False, True]
    assert records[2]["ratios"] == {"steps": 8.0}
