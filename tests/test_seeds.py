"""Two tables define the ranges of seeds and their use; other modules define no seeds."""

import itertools
import re
from pathlib import Path

import pytest

from baselines.tools import seeds as product
from baselines.tuning import search
from research import seeds as studies

ROOT = Path(__file__).parents[1]


def ranges(seeds):
    """Return the ranges of a table in the order of their definition."""
    return [value for value in vars(seeds).values() if isinstance(value, product.Seeds)]


@pytest.mark.parametrize("seeds", [product, studies])
def test_ranges_ascend_and_do_not_overlap(seeds):
    for a, b in itertools.pairwise(ranges(seeds)):
        assert a.first < a.end <= b.first < b.end


def test_seeds_of_studies_are_in_their_range():
    assert all(product.STUDIES.holds(own.first, own.end - own.first) for own in ranges(studies))


def test_only_the_tables_define_seeds():
    """Elsewhere no number of seven digits follows the word seed, except in the builder of frozen suites."""
    for file in (*ROOT.glob("baselines/**/*.py"), *ROOT.glob("research/**/*.py"), *ROOT.glob("*.py")):
        if file.name in ("seeds.py", "builder.py"):
            continue
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"(?i)seed\w*(: \w+)? = \d[\d_]{6,}", text), file


def test_a_range_holds_its_seeds():
    assert studies.TRANSFER.holds(studies.TRANSFER.first, 64)
    assert not studies.TRANSFER.holds(studies.TRANSFER.end - 1, 2)
    assert not studies.TRANSFER.holds(studies.TRANSFER.first - 1)
    assert product.TUNING.holds(search.TUNING_SEED)
    assert product.TUNING_CHECK.holds(search.VALIDATION_SEED, search.VALIDATION_EPISODES)
