"""How the frozen suites are made, recorded and verified."""
