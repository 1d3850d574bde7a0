"""Trained agents: their files, features, networks and actions; policies from other files."""
