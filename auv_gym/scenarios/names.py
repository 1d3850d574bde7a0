"""The names of the presets and the lengths of their episodes, which registration needs without further imports."""

SPEED_RANGES = ("slow", "cruise")
"""Names of the speed ranges."""
CASES = ("calm", "noise", "current", "gauss-markov", "waves", "mismatch", "actuator", "storm")
"""Names of the disturbance cases; the preset of a case in a speed range is RANGE-CASE."""
STEPS = {"paper-circle": 1000, **{f"{speed_range}-{case}": 600 for speed_range in SPEED_RANGES for case in CASES}}
"""Control steps of each preset until truncation."""
SPACE_CASES = ("calm", "noise", "current", "waves", "mismatch", "storm")
"""Names of the disturbance cases in space; the preset of a case is space-CASE."""
SPACE_STEPS = {f"space-{case}": 600 for case in SPACE_CASES}
"""Control steps of each preset in space."""
