"""Examples of other libraries that use the environments: `python -m examples` or `make examples`."""
