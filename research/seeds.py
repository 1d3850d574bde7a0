"""Ranges of seeds for the episodes of each study, all in `baselines.tools.seeds.STUDIES`."""

from __future__ import annotations

from baselines.tools.seeds import Seeds

FAILURE_RATE = Seeds(45_000_000, 55_000_000)
"""Failure rates."""
SENSITIVITY = Seeds(80_000_000, 90_000_000)
"""Sensitivity to model error and to other changes."""
TRANSFER = Seeds(120_000_000, 130_000_000)
"""Comparison of two simulators."""
FINE_TUNING = Seeds(140_000_000, 150_000_000)
"""Comparison of agents that were tuned to a vehicle; their hyper-parameters were chosen on the ten million before."""
