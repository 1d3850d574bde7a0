"""Pages of results on the frozen suites."""
