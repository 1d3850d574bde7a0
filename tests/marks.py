"""Marks of tests."""

import pytest


def slow_except(fast, values):
    """Return values for `pytest.mark.parametrize`; those that are not in `fast` are marked as slow."""
    return [value if value in fast else pytest.param(value, marks=pytest.mark.slow) for value in values]
