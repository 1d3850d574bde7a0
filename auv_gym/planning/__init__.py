"""Reference planning: path families, sideslip, feasibility and the table of the reference."""
