"""Gains that make calmer commands: the points of a front of error against effort and command rate.

Its first point is the gains that ship with the package. From these come the swept ones, in which the weights of the
commands are larger or smaller by a factor and nothing else has changed; and the priced ones, found by a search whose
objective pays for the change of the command, a JSON file for each controller, regime and price. Each such search begins
at the gains of the next lower price that there is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from baselines.gains.loading import checked_gains, load_gains
from baselines.tools.files import read_json
from baselines.tuning.search import GainSet
from baselines.tuning.tunables import TUNABLES
from research import DATA

PRICED_FOLDER = DATA / "priced"
FACTORS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Of the swept points; 1: the gains that ship."""
PRICES = (0.03, 0.1, 0.25)
"""Of the priced points."""
PRICED_EVALUATIONS = 108
"""Evaluations of a search for each price, the same for all controllers: 8 generations and the run-off."""


def priced_file(name: str, regime: str, price: float) -> Path:
    """Return where the gains of a controller for a regime at a positive price are kept."""
    return PRICED_FOLDER / f"{name}-{regime}-{price:g}.json"


def priced_record(name: str, regime: str, price: float) -> dict[str, Any]:
    """Return the file of a controller's gains at a price, with where they come from.

    Raises:
        ValueError: there is no such file, or it is not what it must be.
    """
    file = priced_file(name, regime, price)
    try:
        record = read_json(file)
    except OSError as error:
        raise ValueError(
            f"there are no gains in {file}: `auv-gym tune {name} --regime {regime} --price {price:g}`"
        ) from error
    if not isinstance(record, dict):
        raise ValueError(f"{file} holds no table")
    return record


def priced_gains(name: str, regime: str, price: float) -> GainSet:
    """Return the gains of a controller of `TUNABLES` for a regime at a price; 0: those that ship with the package.

    Raises:
        ValueError: there is no such file, or it is not what it must be.
    """
    names = TUNABLES[name].names
    if not price:
        return load_gains(name, regime, names)
    return checked_gains(priced_record(name, regime, price).get("gains"), names, str(priced_file(name, regime, price)))


def swept_gains(name: str, regime: str, factor: float) -> GainSet:
    """Return the gains of a controller that has a sweep in `TUNABLES` for a regime, swept by a factor.

    Raises:
        ValueError: there are no gains, or they are not what they must be.
    """
    sweep = TUNABLES[name].sweep
    return {key: gain * factor ** sweep.get(key, 0.0) for key, gain in priced_gains(name, regime, 0.0).items()}


def prices_of(name: str, regime: str) -> list[float]:
    """Return the prices at which a controller has gains for a regime, 0 first."""
    before = f"{name}-{regime}-"
    found = (file.stem.removeprefix(before) for file in PRICED_FOLDER.glob(f"{before}*.json"))
    return [0.0, *sorted(float(price) for price in found)]
