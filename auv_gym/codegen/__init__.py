"""Equations as data: traced once on symbols, differentiated, and printed as Python, NumPy or C."""
