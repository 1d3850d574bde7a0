"""The loop of a plant in Python, see docs/plants.md: `serve` moves vehicles of any simulator with one vehicle each."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any, Protocol


class Vehicle(Protocol):
    """One vehicle of another simulator."""

    def place(self, state: dict[str, float]) -> None:
        """Set the state, by the names of the greeting."""

    def advance(self, inputs: dict[str, float], dt: float) -> list[float]:
        """Return the state after dt [s] of inputs, which are named in the greeting too."""


def serve(make: Callable[[dict[str, Any]], Vehicle]) -> None:
    """Answer lines from the standard input until it ends, with vehicles that `make` makes for the greeting.

    A ValueError of `make` is answered as an error.
    """
    hello = json.loads(sys.stdin.readline())
    try:
        vehicles = [make(hello) for _ in range(hello["vehicles"])]
    except ValueError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return
    print("{}", flush=True)
    for line in sys.stdin:
        question = json.loads(line)
        if "place" in question:
            for i, state in zip(question["place"], question["states"], strict=True):
                vehicles[i].place(dict(zip(hello["states"], state, strict=True)))
            print("{}", flush=True)
        else:
            inputs = (dict(zip(hello["inputs"], row, strict=True)) for row in question["inputs"])
            states = [vehicle.advance(row, hello["dt"]) for vehicle, row in zip(vehicles, inputs, strict=True)]
            print(json.dumps({"states": states}), flush=True)
