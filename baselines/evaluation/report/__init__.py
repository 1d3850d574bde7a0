"""The report of an evaluation: numbers, tables, charts and page."""
