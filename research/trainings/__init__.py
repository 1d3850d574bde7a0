"""Trainings of the shipped agents, and studies that compare trainings."""
