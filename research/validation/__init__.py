"""Comparisons with measured runs of real vessels: predictions of an identified model, and dead reckoning."""
