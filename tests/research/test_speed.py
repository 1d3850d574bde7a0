"""The page about speed is made of what was measured, and says what was missed."""

import pytest

from baselines.tools.files import read_json
from research.throughput.figures import faster, takes, written
from research.throughput.page import THROUGHPUT_FILE, row


def test_what_is_kept_was_measured_in_full():
    record = read_json(THROUGHPUT_FILE)
    assert not record["quick"]
    assert record["steps_per_second"]


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
    assert row(faster("fast", 2.0, 1.0, 4)) == ("fast", "0.5 x", "4 x", "no")
    assert row(takes("  slow", 2e-3, 1e-2)) == ("… slow", "2 ms", "10 ms", "yes")
