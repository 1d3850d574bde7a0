"""Nonlinear model predictive control on the extended Kalman filter."""
