"""Estimators of the vehicle's state and of the disturbances from noisy measurements."""
