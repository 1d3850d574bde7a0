"""Robustness of policies: failure rates, faults, guards, and sensitivity to model error."""
