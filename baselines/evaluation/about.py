"""Who enters, with what, and what it cost: words and numbers that the submitter gives, options of evaluate.py."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, fields
from typing import Any

from baselines.tools.command_line import printable

_LONGEST = {"author": 80, "link": 200, "description": 280}
"""Most characters of a text, by field."""
_LARGEST = 1e15
"""Largest cost of a training, in steps or seconds."""
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,39}")
"""What an entry may be called: the name of its file."""


@dataclass(frozen=True)
class About:
    """What a submitter says of an entry; all of it may be left out."""

    author: str = ""
    """Who enters it."""
    link: str = ""
    """Where it is explained or its code can be had, https://..."""
    description: str = ""
    """What it is, in a sentence."""
    training_steps: float | None = None
    """Control steps that it was trained or tuned on."""
    training_seconds: float | None = None
    """How long that took, by the clock."""


NOTHING = About()
"""What is said where nothing is."""


def checked_name(name: Any) -> str:
    """Return the name of an entry.

    Raises:
        ValueError: it is no name.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ValueError(
            f"an entry's name is {name!r:.60}; it must be up to 40 lower-case letters, digits and hyphens, such as "
            "my-controller"
        )
    return name


def checked_about(record: Any) -> About:
    """Return what a table says of an entry.

    Raises:
        ValueError: it has other fields, or one of them is not what it must be.
    """
    known = [f.name for f in fields(About)]
    if not isinstance(record, dict) or not set(record) <= set(known):
        raise ValueError(f"what is said of an entry must be a table with some of {', '.join(known)}")
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
