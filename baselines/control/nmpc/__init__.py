"""Nonlinear model predictive control on the estimates of the extended Kalman filter."""
