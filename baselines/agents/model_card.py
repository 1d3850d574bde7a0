"""Model card of an agent: its description in Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.control.open_loop import NO_EXPERT

CURVE_FILE = "learning_curve.png"  # file beside the card
_TEXT = """# {name}

A network that {own}, by at most {surge:g} of the surge limit and {yaw:g} of the yaw limit. It controls the
underactuated vehicle of `auv_gym` along a reference from noisy measurements.

{facts}

## Use

```
auv-gym evaluate --suite benchmark-v1 --policy PATH/{name}
```

`baselines.agents.agent.Agent.load(PATH).policy()` returns the policy. It runs on NumPy, without torch, and runs no code
from this folder.

## Limits

The agent was trained in simulated episodes of its scenarios only. Its correction is bounded. There is no other
guarantee of stability, in particular for other vehicles, speeds or sensors.
"""
_KNOWN_VEHICLE = """\
The parameters of the vehicle are an input of the network: `baselines.make_policy(PATH, vehicle=V)` returns the policy
for the vehicle V. `baselines.training.vehicle_models` defines the vehicles of its training.
"""


def model_card(name: str, record: Mapping[str, Any], curve: bool) -> str:
    """Return the card as Markdown.

    Args:
        name: of the agent.
        record: its description, the contents of `agent.json`.
        curve: whether the folder has a learning curve.
    """
    training, (surge, yaw) = record["training"], record["authority"]
    own = "acts alone" if record["expert"] == NO_EXPERT else f"corrects the policy `{record['expert']}`"
    lines = [_TEXT.format(name=name, own=own, surge=surge, yaw=yaw, facts="\n".join(_facts(record)))]
    if record["inputs"].get("nominal_vehicle"):
        lines += [_KNOWN_VEHICLE]
    if scores := training.get("scores"):
        lines += ["## Scores", "", "0 is the score of the expert `backstepping`, 1 that of `oracle`.", ""]
        lines += [*_table(scores), ""]
    if curve:
        lines += ["## Learning curve", "", f"![Score on validation episodes over control steps]({CURVE_FILE})", ""]
    return "\n".join(lines)


def _facts(record: Mapping[str, Any]) -> list[str]:
    network, training = dict(record["network"]), record["training"]
    kind = network.pop("kind")
    facts = {"network": f"{kind}, {_listed(network)}", "trained on": ", ".join(record["scenarios"]) or "not recorded"}
    config = training.get("config", {})
    known = training | {key: config[key] for key in ("hyperparameters", "timesteps", "seed") if key in config}
    for key in ("command", "hyperparameters", "timesteps", "seed", "seconds", "versions"):
        if key in known:
            value = known[key]
            facts[key] = _listed(value) if isinstance(value, Mapping) else f"`{value}`"
    facts["SHA-256 of the weights"] = f"`{record['weights_sha256']}`"
    return _table(facts)


def _listed(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in values.items())


def _table(rows: Mapping[str, Any]) -> list[str]:
    return ["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in rows.items())]
