"""Trainings of the shipped agents and studies of what makes agents better."""
