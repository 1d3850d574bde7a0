"""Model card of an agent: its description in Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.control.open_loop import NO_EXPERT

CURVE_FILE = "learning_curve.png"  # file beside the card
_TEXT = """# {name}

A network that {role}, by at most {surge:g} of the range in surge and {yaw:g} of that in {turn}. It controls the
underactuated vehicle of `auv_gym` along a reference from noisy measurements.

| | |
|---|---|
{facts}

`auv-gym evaluate --policy PATH/{name}` runs it, and `baselines.make_policy(PATH, vehicle=V)` returns the policy for a
vehicle. It runs on NumPy, without torch, and runs no code from this folder.

The agent was trained in simulated episodes of its scenarios only. There is no guarantee
of stability, in particular for other vehicles, speeds or sensors.
"""


def model_card(name: str, record: Mapping[str, Any], curve: bool) -> str:
    """Return the card as Markdown.

    Args:
        name: of the agent.
        record: its description, the contents of `agent.json`.
        curve: whether the folder has a learning curve.
    """
    training, (surge, *others) = record["training"], record["authority"]
    yaw, turn = others[-1], "yaw" if len(others) == 1 else "pitch and yaw"
    config = training.get("config", {})
    known = training | {key: config[key] for key in ("hyperparameters", "timesteps", "seed") if key in config}
    facts = {"network": record["network"], "trained on": ", ".join(record["scenarios"]) or "not recorded"}
    for key in ("command", "hyperparameters", "timesteps", "seed", "seconds", "versions", "scores"):
        if key in known:
            facts[key] = known[key]
    facts["SHA-256 of the weights"] = record["weights_sha256"]
    rows = "\n".join(f"| {key} | {_text(value)} |" for key, value in facts.items())
    role = "acts alone" if record["expert"] == NO_EXPERT else f"corrects the policy `{record['expert']}`"
    text = _TEXT.format(name=name, role=role, surge=surge, yaw=yaw, turn=turn, facts=rows)
    return f"{text}\n![Score on validation episodes over control steps]({CURVE_FILE})\n" if curve else text


def _text(value: Any) -> str:
    return ", ".join(f"{key} {one}" for key, one in value.items()) if isinstance(value, Mapping) else f"{value}"
