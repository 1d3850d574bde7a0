"""Trainings with several seeds, compared."""
