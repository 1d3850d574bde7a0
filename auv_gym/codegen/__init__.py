"""Code generation: equations are traced once on symbols, differentiated, and printed as Python, NumPy or C."""
