"""Move a vehicle with six degrees of freedom for evaluate --plant: `python -m research plant VEHICLE`.

The protocol is that of docs/plants.md.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.physics.space import SpaceCoefficients
from auv_gym.physics.vehicle import Coefficients
from research.transfer.simulators import IN_SPACE, SIX_DOF_MODELS, SixDofSimulator


def coefficients_of(rows: Mapping[str, Array]) -> Coefficients | SpaceCoefficients:
    """Return the coefficients that a plant gets by name."""
    if "m11" in rows:
        return Coefficients(**rows)
    level, upright = (
        Coefficients(*(rows[f"{plane}_{name}"] for name in Coefficients._fields)) for plane in ("level", "upright")
    )
    return SpaceCoefficients(level, upright, *(rows[name] for name in SpaceCoefficients._fields[2:]))


def main(words: Sequence[str]) -> int:
    """Answer lines of JSON from the standard input until it ends, and return the exit status."""
    hello: Any = json.loads(sys.stdin.readline())
    models = IN_SPACE if hello["motion"] == "space" else SIX_DOF_MODELS
    (vehicle,) = words
    if vehicle not in models:
        print(json.dumps({"error": f"there is no {vehicle} with motion in {hello['motion']}"}), flush=True)
        return 1
    if hello["name"] not in ("", vehicle):
        print(json.dumps({"error": f"the scenario is for {hello['name']}, this plant is {vehicle}"}), flush=True)
        return 1
    simulator = SixDofSimulator(vehicle, hello["vehicles"], models)
    print("{}", flush=True)
    for line in sys.stdin:
        question, answer = json.loads(line), {}
        if "place" in question:
            true = coefficients_of(dict(zip(hello["parameters"], np.array(question["parameters"]).T, strict=True)))
            simulator.place(question["place"], np.array(question["states"]).T, true)
        else:
            states, forces = simulator.advance(np.array(question["inputs"]).T, hello["dt"])
            answer = {"states": states.T.tolist(), "forces": forces.T.tolist()}
        print(json.dumps(answer), flush=True)
    return 0
