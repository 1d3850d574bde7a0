"""Commands that build, record and verify the frozen suites."""
