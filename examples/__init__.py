"""Other people's libraries on the environments as they are: `python -m examples`, `make examples`."""
