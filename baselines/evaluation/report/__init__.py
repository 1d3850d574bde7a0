"""The report of an evaluation: numbers, tables, figures, page."""
