"""What to cite: entries for software, paper, controllers, vehicles and libraries, as in CITATION.cff."""

import re
from pathlib import Path

import pytest

from auv_gym import __version__
from baselines import POLICIES, citation
from baselines.sources import _SOURCES, entries

ROOT = Path(__file__).parents[2]


def keys(text):
    return re.findall(r"^@\w+\{(\w+),$", text, re.MULTILINE)


def test_software_and_paper_are_always_there_as_in_the_file_for_github():
    text, file = citation(), (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert keys(text) == ["auv_gym", "repoulias2005trajectory"]
    assert f"version = {{{__version__}}}" in text
    assert f"version: {__version__}" in file
    for part in ("https://github.com/auv-gym/auv_gym", "1610", "1615", "2005"):
        assert part in text
        assert part in file


def test_controllers_agents_and_vehicles_have_their_sources():
    assert set(_SOURCES) <= set(POLICIES)
    assert {key for sources in _SOURCES.values() for key in sources} <= set(entries())
    assert keys(citation("nmpc"))[2:] == ["tassa2014control", "diehl2005realtime", "fossen2021handbook"]
    assert keys(citation("ppo-cruise"))[2:] == ["raffin2021stable"]
    assert keys(citation("helm"))[2:] == keys(citation("mine.py:Law"))[2:] == []
    assert citation(scenario="cruise-calm@lauv").splitlines()[-1].startswith("% vehicle lauv: uuvsimulator/lauv_gazebo")
    assert "%" not in citation(scenario="cruise-calm")
    assert keys(citation("mine.py:Law", "cruise-calm-setpoints"))[2:] == ["fossen2021handbook"]
    with pytest.raises(ValueError, match="unknown scenario"):
        citation(scenario="nothing")
    for wrong in ("los-pd", "", 3):
        with pytest.raises(ValueError, match="unknown policy"):
            citation(wrong)


def test_every_entry_is_complete():
    for key, text in entries().items():
        for field in ("title", "author", "year"):
            assert re.search(rf"^  {field} = \{{.+\}},?$", text, re.MULTILINE), (key, field)
        assert text.count("{") == text.count("}")
