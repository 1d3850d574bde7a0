"""Tune the gains of controllers on separate tuning episodes."""
