"""Scenarios as distributions of episodes: presets, mixtures, vehicle files, exogenous inputs."""
