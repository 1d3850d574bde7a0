"""The description of a submission: author, link, text and training cost, which are options of evaluate.py."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, fields
from typing import Any

from baselines.tools.command_line import printable

_LONGEST = {"author": 80, "link": 200, "description": 280}
"""Largest number of characters of a text, by field."""
_LARGEST = 1e15
"""Largest cost of a training, in steps or seconds."""
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,39}")
"""Pattern of the name of an entry, which is also the name of its file."""


@dataclass(frozen=True)
class About:
    """The description of an entry by its author; all fields are optional."""

    author: str = ""
    """Name of the author."""
    link: str = ""
    """Address of a description or of the code, https://..."""
    description: str = ""
    """Description of the policy in one sentence."""
    training_steps: float | None = None
    """Number of control steps of the training or tuning."""
    training_seconds: float | None = None
    """Wall time of the training or tuning."""


NOTHING = About()
"""An empty description."""


def checked_name(name: Any) -> str:
    """Return the name of an entry if it is valid.

    Raises:
        ValueError: the name is invalid.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ValueError(
            f"an entry's name is {name!r:.60}; it must be up to 40 lower-case letters, digits and hyphens, such as "
            "my-controller"
        )
    return name


def checked_about(record: Any) -> About:
    """Return the description of an entry from a table.

    Raises:
        ValueError: it has other fields, or the value of a field is invalid.
    """
    known = [f.name for f in fields(About)]
    if not isinstance(record, dict) or not set(record) <= set(known):
        raise ValueError(f"the description of an entry must be a table with some of {', '.join(known)}")
    for name, most in _LONGEST.items():
        text = record.get(name, "")
        if not isinstance(text, str) or len(text) > most or text != printable(text):
            raise ValueError(f"{name} is {text!r}; it must be one line of at most {most} printable characters")
    link = record.get("link", "")
    if link and not re.fullmatch(r"https://[\w./~%#?=&+:@-]+", link, re.ASCII):
        raise ValueError(f"link is {link!r}; it must be an address that begins with https://")
    for name in ("training_steps", "training_seconds"):
        cost = record.get(name)
        number = isinstance(cost, (int, float)) and not isinstance(cost, bool)
        if cost is not None and not (number and math.isfinite(cost) and 0 <= cost <= _LARGEST):
            raise ValueError(f"{name} is {cost!r}; it must be a number from 0 to {_LARGEST:g}")
    return About(**record)
