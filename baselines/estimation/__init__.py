"""Estimators: the sea and the vehicle behind noisy measurements."""
