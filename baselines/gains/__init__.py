"""Gains of the tuned controllers, as JSON files. No other module contains such numbers."""
