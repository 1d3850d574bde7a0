"""The scenarios that ship with the package by name alone, with their length: what the ids of the environments need."""

SPEED_RANGES = ("slow", "cruise")
"""Names of the ranges of speeds."""
CASES = ("calm", "noise", "current", "gauss-markov", "waves", "mismatch", "actuator", "storm")
"""Names of the kinds of trouble; the preset of each in a regime is called REGIME-CASE."""
STEPS = {"paper-circle": 1000, **{f"{speed_range}-{case}": 600 for speed_range in SPEED_RANGES for case in CASES}}
"""Control steps of each preset until truncation."""
