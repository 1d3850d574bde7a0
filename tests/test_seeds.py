"""One table says who draws from which seeds, and everybody keeps to it."""

import importlib
import inspect
import itertools
import re
from pathlib import Path

from baselines.tools import seeds
from baselines.tuning import search

ROOT = Path(__file__).parents[1]


def test_no_range_overlaps_another():
    for a, b in itertools.pairwise(seeds.TABLE):
        assert a.first < a.end <= b.first < b.end
    assert set(seeds.TABLE) == {value for value in vars(seeds).values() if isinstance(value, seeds.Seeds)}


def test_each_reader_draws_from_its_own_range_alone():
    names = {value: name for name, value in vars(seeds).items() if isinstance(value, seeds.Seeds)}
    for own in seeds.TABLE[1:]:
        source = inspect.getsource(importlib.import_module(own.reader))
        mine = {names[other] for other in seeds.TABLE if other.reader == own.reader}
        used = {name for name in names.values() if re.search(rf"\b{name}\b\.first", source)}
        assert names[own] in used <= mine


def test_nobody_has_seeds_beside_the_table():
    """A number of seven digits beside the word seed is one of the table, or the key of a frozen suite."""
    for file in (*ROOT.glob("baselines/**/*.py"), *ROOT.glob("*.py")):
        if file.name in ("seeds.py", "builder.py"):
            continue
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"(?i)seed\w*(: \w+)? = \d[\d_]{6,}", text), file


def test_a_range_knows_what_it_holds():
    assert seeds.FRESH.holds(seeds.FRESH.first, 64)
    assert not seeds.FRESH.holds(seeds.FRESH.end - 1, 2)
    assert not seeds.FRESH.holds(seeds.FRESH.first - 1)
    assert seeds.TUNING.holds(search.TUNING_SEED)
    assert seeds.TUNING_CHECK.holds(search.VALIDATION_SEED, search.VALIDATION_EPISODES)
