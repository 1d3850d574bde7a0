"""Robustness of policies: failure rates, falsification, guards, and sensitivity to model error."""
