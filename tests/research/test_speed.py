"""The page about speed has all measurements, with their goals."""

import json

import pytest

from baselines.tools.files import read_json
from research.throughput.measure import DECISIONS, THROUGHPUT_FILE, Figure, compared, context, written


def test_the_page_has_a_row_for_every_measurement():
    figures = read_json(THROUGHPUT_FILE)["figures"]
    rows = context("speed")["rows"]
    assert [row[0] for row in rows] == [figure["case"] for figure in figures]
    assert {row[0].rpartition(": ")[2] for row in rows if row[0].startswith("decision")} == set(DECISIONS)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(61.3, "s", "61.3 s"), (0.0121, "s", "12.1 ms"), (3.4e-8, "s", "34 ns"), (9.38, "x", "9.38 x")],
)
def test_numbers_have_readable_units(value, unit, text):
    assert written(value, unit) == text


def test_goals_are_minima_of_ratios_and_maxima_of_times():
    assert Figure("fast", 4.0, "x", 4.0).row == ("fast", "4 x", "4 x", "yes")
    assert Figure("fast", 3.9, "x", 4.0).row[3] == "no"
    assert Figure("slow", 0.1, "s", 0.1).row == ("slow", "100 ms", "100 ms", "yes")
    assert Figure("slow", 0.2, "s", 0.1).row[3] == "no"
    assert Figure("decision", 2e-5, "s").row == ("decision", "20 us", "", "")


def test_a_run_is_compared_with_the_last_good_one(tmp_path):
    file, runs = tmp_path / "history.jsonl", (10.0, 9.2, 8.0, 9.0)
    found = [compared(file, [Figure("steps", x, "x", 5.0), Figure("start", 1.0, "s")]) for x in runs]
    assert found == [[], [], ["steps: 8 x, 9.2 x in the last good run"], []]
    records = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    assert [record["good"] for record in records] == [True, True, False, True]
    assert records[2]["ratios"] == {"steps": 8.0}
