"""Tune the gains of a controller on episodes of its own."""
