"""Ranges of seeds, one for the episodes of each study: parts of `baselines.tools.seeds.STUDIES`."""

from __future__ import annotations

from baselines.tools.seeds import Seeds

GUARD = Seeds(40_000_000, 45_000_000)
"""The thresholds of the guard were chosen on these."""
FAILURE_RATE = Seeds(45_000_000, 55_000_000)
"""Failures are counted on these."""
FALSIFICATION = Seeds(55_000_000, 60_000_000)
"""Disturbances that make a policy fail are searched for on these."""
HELD_OUT = Seeds(70_000_000, 80_000_000)
"""Policies are compared on these; nothing is chosen on them."""
SENSITIVITY = Seeds(80_000_000, 90_000_000)
"""Sensitivity to change and error is measured on these."""
OPTIMUM = Seeds(90_000_000, 100_000_000)
"""The full-information optimum is tested on these."""
TRANSFER = Seeds(120_000_000, 130_000_000)
"""Two simulators are compared on these."""
FINE_TUNING = Seeds(130_000_000, 140_000_000)
"""Agents that were tuned to a vehicle are compared on these."""

TABLE = (GUARD, FAILURE_RATE, FALSIFICATION, HELD_OUT, SENSITIVITY, OPTIMUM, TRANSFER, FINE_TUNING)
"""All ranges, in ascending order, without overlap."""
