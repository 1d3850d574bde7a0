"""Analytic policy gradient."""
