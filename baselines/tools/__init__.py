"""Shared functions for command lines, files, figures, seeds and worker processes."""
