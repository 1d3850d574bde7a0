"""Gains as data: the only place of the controllers' numbers."""
