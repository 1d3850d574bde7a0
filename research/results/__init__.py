"""The results page of the frozen suites."""
